"""Writes the weights of a training as ONNX, with what other programs need to use them the same way in its metadata."""

from __future__ import annotations

import json
import shutil
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend.core.files import write_bytes
from infrablend.detection.finder import OVERLAP_PX
from infrablend.detection.onnx_detector import IOU, MARK
from infrablend.detection.predict import fitted_size
from infrablend.detection.scale import ONNX_WEIGHTS
from infrablend.detection.ultralytics_environment import quiet_ultralytics, require_ultralytics
from infrablend.errors import MissingDependencyError, RenderError
from infrablend.lab.training.training_record import TrainingRecord
from infrablend.lab.training.yolox_network import network_as_onnx, require_yolox

# Tiles of training are small, since each is cut for an object; the network reads whole pictures as well, without seams.
_PICTURE_PX = 640
_MOST_PX = 1280
_STRIDE = 32
# What Ultralytics states about the moment and the folders of the export.
_UNREPEATABLE = ("date", "description", "args")


def require_onnx() -> None:
    """Raise MissingDependencyError with the command to run if a package for exports is missing."""
    require_ultralytics()
    try:
        import onnx  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            'onnx is not installed, which --export onnx needs; install with\n  pip install "infrablend[train,onnx]"'
        ) from error


def export_onnx(weights: Path, record: TrainingRecord) -> Path:
    """Write `weights.onnx` beside the weights of a training by either library.

    The input has a fixed size: that of the pictures of the training, or of the size that they were scaled to, with the
    border that `fit_picture` adds, so that the network sees pictures of this size as its weights do.

    Raises:
        MissingDependencyError: A package is missing.
        RenderError: torch cannot express the network as ONNX.
    """
    is_yolox = record.get("backend") == "yolox"
    settings = record["settings"]
    tile, size = (int(str(settings[k])) for k in ("tile", "image_size"))
    pictures = min(record["prepared"].get("picture_px", _PICTURE_PX), _MOST_PX) if tile else size
    side = max(fitted_size((pictures, pictures), _STRIDE))
    model = _yolox_model(weights, side) if is_yolox else _ultralytics_model(weights, side)
    stated = {p.key: p.value for p in model.metadata_props if p.key not in _UNREPEATABLE}
    del model.metadata_props[:]
    own = _metadata(record, tile, side)
    for key, value in sorted((stated | own | ({} if is_yolox else _for_deepness(side))).items()):
        model.metadata_props.add(key=key, value=value)
    return write_bytes(weights.with_name(ONNX_WEIGHTS), model.SerializeToString(deterministic=True))


def _yolox_model(weights: Path, side: int) -> Any:
    require_yolox()
    import onnx

    return onnx.load_from_string(network_as_onnx(weights, side))


def _ultralytics_model(weights: Path, side: int) -> Any:
    require_onnx()
    import onnx

    with tempfile.TemporaryDirectory() as folder, quiet_ultralytics(), warnings.catch_warnings():
        # torch prefers its new exporter, which needs more packages.
        warnings.simplefilter("ignore")
        import ultralytics

        copy = Path(shutil.copy(weights, folder))
        try:
            made = ultralytics.YOLO(str(copy)).export(format="onnx", imgsz=side, simplify=False, device="cpu")
        except Exception as error:  # torch's exporter raises what it likes
            raise RenderError(f"{weights}: cannot be exported as ONNX: {error}") from error
        return onnx.load(made)


def _metadata(record: TrainingRecord, tile: int, side: int) -> dict[str, str]:
    """Return what `infrablend detect` reads; all of it JSON."""
    own: Mapping[str, Any] = {
        MARK: {"tile": tile, "image_size": record["settings"]["image_size"], "agc": record.get("agc")},
        "class_names": {str(k): name for k, name in enumerate(record["classes"])},
        "tile_size": side,
    }
    return {key: json.dumps(value) for key, value in own.items()}


def _for_deepness(side: int) -> dict[str, str]:
    """Return what Deepness, a plugin of QGIS, reads besides; it does not know what YOLOX expects and returns."""
    theirs: Mapping[str, Any] = {
        "model_type": "Detector",
        "det_type": "YOLO_Ultralytics",
        "tiles_size": side,
        "tiles_overlap": round(100 * OVERLAP_PX / side),  # percent
        "det_conf": 0.25,
        "det_iou_thresh": IOU,
    }
    return {key: json.dumps(value) for key, value in theirs.items()}
