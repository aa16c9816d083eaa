"""Training with Ultralytics: what it needs, which arguments it takes, and how its networks become ONNX."""

from __future__ import annotations

import json
import shutil
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend.detection import ultralytics_environment
from infrablend.detection.detections import Task
from infrablend.detection.finder import OVERLAP_PX
from infrablend.detection.onnx_detector import IOU
from infrablend.detection.scale import WEIGHTS
from infrablend.detection.ultralytics_environment import quiet_ultralytics, require_ultralytics
from infrablend.errors import MissingDependencyError, OutputError, Problem, RenderError
from infrablend.lab.training import start_weights
from infrablend.lab.training.presets import PRESETS, Preset
from infrablend.lab.training.start_weights import StartWeights
from infrablend.lab.training.train_request import PRESET_FIELDS

# Arguments of Ultralytics that follow from the request and its folder, and what to give in their place.
_OF_TRAINER = {
    "imgsz": "--set image_size", "device": "--device", "seed": "--seed", "val": "--set patience",
    "pretrained": "--weights", "task": "--task",
    **dict.fromkeys(
        ("data", "mode", "project", "name", "save_dir", "exist_ok", "resume", "single_cls"), "nothing in its place"
    ),
}  # fmt: skip


class UltralyticsBackend:
    """Ultralytics' YOLO networks."""

    weights = WEIGHTS
    result = WEIGHTS

    def require_packages(self, *, export: bool) -> None:
        """Raise MissingDependencyError if a package is missing."""
        require_ultralytics()
        if export:
            _require_onnx()

    def require_settings(self, preset: Preset, task: Task) -> None:
        """Raise OutputError for arguments of the user that InfraBlend sets itself, or that Ultralytics refuses.

        The latter are not checked where Ultralytics is missing. That check is slow: the presets' own arguments skip it.
        """
        fixed = [k for k in _OF_TRAINER if k in preset.arguments]
        if fixed:
            raise OutputError(
                "settings of the training",
                [Problem(f"--set {k}", "setting-malformed", "an argument that InfraBlend sets itself", _OF_TRAINER[k])
                 for k in fixed],
            )  # fmt: skip
        own = PRESETS[preset.name].arguments if preset.name in PRESETS else {}
        given = {k: v for k, v in preset.arguments.items() if k not in own or own[k] != v}
        wrong = (
            ultralytics_environment.wrong_arguments(given)
            if given and not ultralytics_environment.missing_packages()
            else ""
        )
        if wrong:
            where = " ".join(f"--set {k}" for k in given)
            expected = f"fields ({', '.join(PRESET_FIELDS)}) or Ultralytics' own"
            raise OutputError("settings of the training", [Problem(where, "setting-malformed", wrong, expected)])

    def require_start(self, wanted: str, preset: Preset, task: Task) -> None:
        """Raise FetchError or ModelError for start weights that cannot be used; nothing is downloaded."""
        start_weights.require_known(wanted, task)

    def find_start(self, wanted: str, preset: Preset, task: Task) -> StartWeights:
        """Return the weights to start from, after downloading them if needed."""
        return start_weights.find_start(wanted, preset, task)

    def network_of(self, wanted: str, preset: Preset, task: Task) -> str:
        """Return the name of the network that a training from these weights has; empty before a download."""
        return start_weights.network_of(wanted, preset, task)

    def as_onnx(self, weights: Path, side_px: int) -> Any:
        """Return the ONNX model of trained weights, for pictures of this side.

        Raises:
            MissingDependencyError: A package is missing.
            RenderError: torch cannot express the network as ONNX.
        """
        _require_onnx()
        import onnx

        with tempfile.TemporaryDirectory() as folder, quiet_ultralytics(), warnings.catch_warnings():
            # torch prefers its new exporter, which needs more packages.
            warnings.simplefilter("ignore")
            import ultralytics

            copy = Path(shutil.copy(weights, folder))
            try:
                made = ultralytics.YOLO(str(copy)).export(format="onnx", imgsz=side_px, simplify=False, device="cpu")
            except Exception as error:  # torch's exporter raises what it likes
                raise RenderError(f"{weights}: cannot be exported as ONNX: {error}") from error
            return onnx.load(made)

    def onnx_metadata(self, side_px: int) -> dict[str, str]:
        """Return what Deepness, a plugin of QGIS, reads of an ONNX file."""
        theirs: Mapping[str, Any] = {
            "model_type": "Detector",
            "det_type": "YOLO_Ultralytics",
            "tiles_size": side_px,
            "tiles_overlap": round(100 * OVERLAP_PX / side_px),  # percent
            "det_conf": 0.25,
            "det_iou_thresh": IOU,
        }
        return {key: json.dumps(value) for key, value in theirs.items()}


def _require_onnx() -> None:
    """Raise MissingDependencyError with the command to run if a package for exports is missing."""
    require_ultralytics()
    try:
        import onnx  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            'onnx is not installed, which --export onnx needs; install with\n  pip install "infrablend[train,onnx]"'
        ) from error
