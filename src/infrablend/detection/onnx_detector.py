"""Detectors in ONNX files, which onnxruntime runs without torch: on tiles at native resolution, or whole pictures."""

from __future__ import annotations

import ast
import json
import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.config.agc import Agc, agc_from_json
from infrablend.core.files import read_object, sha256_of
from infrablend.core.machine import usable_cores
from infrablend.detection.detections import MAX_DETECTIONS, Detections, detections
from infrablend.detection.onnx_outputs import NetworkForm, Outputs, recognise
from infrablend.detection.seams import joined, windows
from infrablend.detection.tiles import PAD_GREY
from infrablend.detection.ultralytics_environment import kept_indices
from infrablend.errors import MissingDependencyError, ModelError, Problem

IOU = 0.7  # as for weights of Ultralytics
MARK = "infrablend"
"""Entry of the metadata in which `infrablend train --export onnx` states tile, scale and AGC, as JSON."""
_SIDE = 640  # for files of any size that do not state one
_TYPES: Mapping[str, type[np.generic]] = {
    "tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8,
}  # fmt: skip

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class OnnxDetector:
    """Loaded detector.

    Attributes:
        session: Session of onnxruntime.
        form: How it reads pictures, and what its outputs mean.
        classes: Names of its classes, in its order.
        side_wh: Size of its input, px.
        image_size: Longer side that pictures are scaled to, px; 0 leaves them their own size.
        overlap_px: Least overlap of tiles.
        agc: Automatic gain control for 16-bit pictures that the file states; None if unknown.
        facts: Name and SHA-256 of the file, kind of network, tiles, versions.
    """

    session: Any
    form: NetworkForm
    classes: tuple[str, ...]
    side_wh: tuple[int, int]
    image_size: int
    overlap_px: int
    agc: Agc | None
    facts: dict[str, object]

    def find(self, levels: NDArray[np.uint8], confidence: float) -> Detections:
        """Return the detections in (h, w) grey levels, at most 300, in px of the picture.

        Raises:
            ModelError: The network gives a class that has no name.
        """
        size = np.array(levels.shape[::-1], np.float64)
        seen = levels
        if self.image_size and self.image_size != max(levels.shape):
            scaled = np.ceil(size * self.image_size / size.max()).astype(int)
            seen = np.asarray(cv2.resize(levels, scaled.tolist(), interpolation=cv2.INTER_LINEAR), np.uint8)
        scale = np.array(seen.shape[::-1]) / size
        found: list[tuple[NDArray[Any], ...]] = []
        tiles = windows((seen.shape[1], seen.shape[0]), self.side_wh, self.overlap_px)
        for n, window in enumerate(tiles):
            boxes, scores, numbers = self._in_tile(window.crop(seen, self.side_wh), confidence)
            boxes = boxes + np.tile(np.array(window.origin_xy, np.float64), 2)
            own = window.owns(boxes)
            found.append((boxes[own], scores[own], numbers[own], np.full(int(own.sum()), n, np.int64)))
        boxes, scores, numbers, owner = (np.concatenate(column) for column in zip(*found, strict=True))
        kept = joined(boxes, scores, numbers, owner, tiles)[:MAX_DETECTIONS]
        edges = (boxes[kept].reshape(-1, 2, 2) / scale).clip(0, size).reshape(-1, 4)
        return detections(edges, scores[kept], numbers[kept])

    def _in_tile(
        self, tile: NDArray[np.uint8], confidence: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Return boxes (px of the tile), scores and classes in one tile, without doubles."""
        boxes, table = self.form.decode(run_network(self.session, tile, self.form))
        rows, numbers = np.nonzero(table >= confidence)
        if len(numbers) and int(numbers.max()) >= len(self.classes):
            found = f"class {int(numbers.max())} in the output, but {len(self.classes)} names: {self.classes}"
            raise _refused(Path(str(self.facts["weights"])), found, "a name per class", "name them all with --classes")
        scores = table[rows, numbers]
        kept = np.arange(len(rows))
        if self.form.suppress:
            # Moved apart by class, so that boxes of different classes do not overlap.
            apart = boxes[rows] + numbers[:, None] * 2.0 * max(self.side_wh)
            kept = kept_indices(apart.astype(np.float32), scores.astype(np.float32), IOU)
        return boxes[rows][kept], scores[kept], numbers[kept]


def run_network(session: Any, tile: NDArray[np.uint8], form: NetworkForm | None) -> Outputs:
    """Return the outputs by name on one (h, w) tile; without a form, for the first look at a network."""
    fed: dict[str, NDArray[Any]] = {}
    height, width = tile.shape
    for entry in session.get_inputs():
        if len(entry.shape) == 4:
            batch = entry.shape[0] if isinstance(entry.shape[0], int) else 1
            kind = _TYPES[entry.type]
            levels = tile.astype(np.float32)
            if form is not None and kind is not np.uint8:
                levels /= form.divisor
            values = np.repeat(levels[None], _channels(entry.shape), axis=0)
            if form is not None and any(form.mean):
                values = (values - np.array(form.mean)[:, None, None]) / np.array(form.std)[:, None, None]
            values = values.astype(kind, copy=False)
            fed[entry.name] = np.ascontiguousarray(np.broadcast_to(values, (batch, *values.shape)))
        elif entry.name == "orig_target_sizes":
            fed[entry.name] = np.array([[width, height]], np.int64)
        elif entry.name == "pixel_mask":
            fed[entry.name] = np.ones((1, height, width), np.int64)
    return {o.name: v for o, v in zip(session.get_outputs(), session.run(None, fed), strict=True)}


def load_onnx(
    path: Path,
    *,
    device: str = "auto",
    classes: Sequence[str] = (),
    threads: int = 0,
    image_size: int | None = None,
    overlap_px: int = 96,
) -> OnnxDetector:
    """Return the detector in an ONNX file.

    Args:
        path: The file.
        device: auto, cpu or cuda.
        classes: Names of its classes, where the file has none.
        threads: Threads of the network; 0 for one per usable core.
        image_size: Longer side of the pictures, px; 0 for their own size; by default what the file states, else 0.
        overlap_px: Least overlap of tiles, twice the size of the largest object.

    Raises:
        MissingDependencyError: onnxruntime is not installed, or there is no such device.
        ModelError: The file cannot be loaded, its outputs are not known, or its classes have no names.
    """
    session = _session(path, device, threads)
    metadata: Mapping[str, str] = session.get_modelmeta().custom_metadata_map
    side = _side(_picture_input(path, session).shape, metadata)
    names = _names(path, metadata)
    form = _form(path, session, metadata, side, len(names) or len(classes))
    names = _named(path, names, classes, form)
    mark = _json(metadata.get(MARK))
    if image_size is None:
        stated = mark.get("image_size")
        image_size = stated if isinstance(stated, int) and not mark.get("tile") else 0
    agc = mark.get("agc")
    facts: dict[str, object] = {
        "weights": path.name,
        "weights_sha256": sha256_of(path),
        "network": form.name,
        "device": "cuda" if "CUDA" in session.get_providers()[0] else "cpu",
        "onnxruntime": _onnxruntime().__version__,
        "tile": list(side),
        "tile_overlap": overlap_px,
        "image_size": image_size,
        "iou": IOU,
        "max_detections": MAX_DETECTIONS,
        **({"agc": agc} if agc else {}),
    }
    with suppress(ValueError):
        known = agc_from_json(agc) if isinstance(agc, Mapping) else None
        return OnnxDetector(session, form, names, side, image_size, overlap_px, known, facts)
    raise _refused(path, f"an AGC of {agc} in the metadata", "one of this version of InfraBlend")


def _picture_input(path: Path, session: Any) -> Any:
    """Return the input that takes pictures."""
    inputs = session.get_inputs()
    of = [i for i in inputs if len(i.shape) == 4 and i.type in _TYPES and _channels(i.shape) in (1, 3)]
    if len(of) != 1 or not {i.name for i in inputs} <= {of[0].name, "orig_target_sizes", "pixel_mask"}:
        expected = "one of pictures, (b, 1 or 3, height, width), and sizes or masks at most"
        raise _refused(path, f"inputs {_described(inputs)}", expected)
    return of[0]


def _form(path: Path, session: Any, metadata: Mapping[str, str], side_wh: tuple[int, int], classes: int) -> NetworkForm:
    """Return what the outputs mean, by a run on an even picture, which shows sizes that the file leaves open."""
    try:
        outputs = run_network(session, np.full(side_wh[::-1], PAD_GREY, np.uint8), None)
    except Exception as error:  # onnxruntime has no common base for its errors
        log.debug("%s", path, exc_info=True)
        found = f"a network that does not run on a picture of {side_wh[0]}x{side_wh[1]} px: {error}"
        raise _refused(path, found[:300], "one that takes its own size") from error
    form = recognise(metadata, [i.name for i in session.get_inputs()], outputs, side_wh, classes)
    if form is None:
        sizes = ", ".join(f"{name} {values.shape}" for name, values in outputs.items())
        found = f"outputs {sizes} with inputs {_described(session.get_inputs())} and {_stated(metadata)}"
        expected = "those of YOLOv5 to v12, YOLO26, YOLOX, RT-DETR, D-FINE, DEIM or RF-DETR"
        raise _refused(path, found, expected, "convert its detections to COCO, and give that file")
    return form


def _onnxruntime() -> Any:
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingDependencyError(
            "onnxruntime is not installed, which detectors in ONNX files need; install with\n  pip install "
            '"infrablend[onnx]"'
        ) from error
    return onnxruntime


def _session(path: Path, device: str, threads: int) -> Any:
    ort = _onnxruntime()
    gpu = "CUDAExecutionProvider"
    has_gpu = gpu in ort.get_available_providers()
    if device not in ("auto", "cpu", "cuda") or (device == "cuda" and not has_gpu):
        raise MissingDependencyError(
            f"device {device!r}: this onnxruntime has {', '.join(ort.get_available_providers())}; expected auto, cpu, "
            "or cuda with onnxruntime-gpu"
        )
    if not path.is_file():
        raise _refused(path, "no such file", "an ONNX file")
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads or max(int(usable_cores()), 1)
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # idle threads burn no time
    options.log_severity_level = 3
    providers = ([gpu] if has_gpu and device != "cpu" else []) + ["CPUExecutionProvider"]
    try:
        return ort.InferenceSession(str(path), options, providers=providers)
    except Exception as error:  # onnxruntime has no common base for its errors
        log.debug("%s", path, exc_info=True)
        text = " ".join(str(error).split())[:300]
        todo = ""
        if "external" in text.lower():
            todo = "put the file with the weights, often NAME.onnx.data, beside it under its first name"
        raise _refused(path, f"cannot be loaded: {text}", "a complete ONNX file", todo) from error


def _side(shape: Sequence[int | str | None], metadata: Mapping[str, str]) -> tuple[int, int]:
    """Return width and height of the input: fixed ones, else those of the metadata, else 640."""
    stated = _literal(metadata.get("imgsz", ""))
    stated = [stated, stated] if isinstance(stated, int) else stated
    if not (isinstance(stated, list | tuple) and len(stated) == 2 and all(isinstance(v, int) for v in stated)):
        stated = [_SIDE, _SIDE]
    height, width = (s if isinstance(s, int) else v for s, v in zip(shape[2:], stated, strict=True))
    return int(width), int(height)


def _names(path: Path, metadata: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the classes in the metadata, or in transformers' config.json beside the file."""
    found: Any = _literal(metadata.get("names", "")) or _literal(metadata.get("class_names", ""))
    if not found:
        for folder in (path.parent, path.parent.parent):
            found = found or (read_object(folder / "config.json") or {}).get("id2label")
    if isinstance(found, Mapping):
        with suppress(ValueError, TypeError):
            found = [found[k] for k in sorted(found, key=int)]
    return tuple(str(name) for name in found) if isinstance(found, list | tuple) else ()


def _named(path: Path, own: tuple[str, ...], given: Sequence[str], form: NetworkForm) -> tuple[str, ...]:
    """Return the names of the classes: those of the file, or those given."""
    names = tuple(given) or own
    if names and len(names) == (form.classes or len(names)) and len(own) in (0, len(names)):
        return names
    wanted = f"{form.classes or len(own) or 'its'} names"
    found = f"{len(names)} names: {', '.join(names)}" if names else "no names of classes in the file"
    raise _refused(path, found, wanted, "name them in the order of the training, with --classes a,b")


def _literal(text: str) -> Any:
    """Return a Python literal or JSON value of the metadata; None for other text."""
    with suppress(ValueError, SyntaxError, RecursionError, MemoryError):
        return ast.literal_eval(text)
    with suppress(ValueError, RecursionError):
        return json.loads(text)
    return None


def _json(text: str | None) -> Mapping[str, Any]:
    found = _literal(text or "")
    return found if isinstance(found, Mapping) else {}


def _channels(shape: Sequence[Any]) -> int:
    return shape[1] if isinstance(shape[1], int) else 3


def _stated(metadata: Mapping[str, str]) -> str:
    return f"metadata {', '.join(sorted(metadata))}" if metadata else "no metadata"


def _described(entries: Sequence[Any]) -> str:
    return ", ".join(f"{e.name} {tuple(e.shape)} {e.type}" for e in entries)


def _refused(path: Path, found: str, expected: str, todo: str = "") -> ModelError:
    return ModelError(f"{path}: no detector that can be used", [Problem(path.name, "detector", found, expected, todo)])
