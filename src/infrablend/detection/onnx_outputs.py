"""What the outputs of networks in ONNX files mean: told apart by metadata, names and shapes, and decoded to boxes.

| export | outputs | meaning |
|---|---|---|
| YOLOv5 | (b, 3 anchors, 5+n) | cx cy w h px, objectness, classes |
| YOLOv8, 11, 12 | (b, 4+n, anchors) | cx cy w h px, classes |
| YOLOv10, YOLO26, `nms=True` | (b, k, 6) | x0 y0 x1 y1 px, score, class |
| RT-DETR of Ultralytics | (b, k, 6) or (b, k, 4+n) | cx cy w h in 0..1, then score and class, or the classes |
| YOLOX | (b, anchors, 5+n) | like YOLOv5, or offsets to a grid of anchors |
| RT-DETR, D-FINE, DEIM | `labels`, `boxes`, `scores` | x0 y0 x1 y1 px of `orig_target_sizes` |
| the same by transformers | `logits`, `pred_boxes` | cx cy w h in 0..1 |
| RF-DETR | `dets`, `labels` | cx cy w h in 0..1, logits |

The number of anchors follows from the size of the input, which tells YOLOv5 with one class from rows of six.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_cxcywha

Outputs = Mapping[str, NDArray[Any]]
Candidates = tuple[NDArray[np.float64], NDArray[np.float64]]
"""(n, 4) boxes x0 y0 x1 y1 in px of the input, and (n, classes) scores in [0, 1]."""

_STRIDES = ((8, 16, 32), (8, 16, 32, 64), (4, 8, 16, 32), (16, 32))
_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_STD = (0.229, 0.224, 0.225)


@dataclass(frozen=True)
class NetworkForm:
    """How a network reads a picture, and what its outputs mean.

    Attributes:
        name: Kind of network, in words.
        classes: Number of its classes; 0 if the outputs do not show it.
        decode: Makes boxes and scores from the outputs on one picture.
        suppress: Whether several boxes for one object remain to be suppressed.
        divisor: What levels of 0 to 255 are divided by.
        mean: Subtracted from each channel afterwards.
        std: Each channel is divided by it last.
    """

    name: str
    classes: int
    decode: Callable[[Outputs], Candidates]
    suppress: bool = False
    divisor: float = 255.0
    mean: tuple[float, ...] = (0.0, 0.0, 0.0)
    std: tuple[float, ...] = (1.0, 1.0, 1.0)


def recognise(
    metadata: Mapping[str, str], inputs: Sequence[str], outputs: Outputs, side_wh: tuple[int, int], classes: int
) -> NetworkForm | None:
    """Return what the outputs mean; None for a network that is not known.

    Args:
        metadata: Metadata of the file.
        inputs: Names of the inputs.
        outputs: Outputs on one grey picture.
        side_wh: Size of the input, px.
        classes: Number of class names that are known, 0 for none.
    """
    if {"labels", "boxes", "scores"} <= {*outputs} and "orig_target_sizes" in inputs:
        return NetworkForm("RT-DETR, D-FINE or DEIM", 0, lambda o: _labelled(o["boxes"][0], o["scores"], o["labels"]))
    size = np.tile(np.array(side_wh, np.float64), 2)
    if {"logits", "pred_boxes"} <= {*outputs} and "pixel_values" in inputs:
        slots = outputs["logits"].shape[-1]
        if classes and slots != classes:
            return None  # DETR has a slot for no object, and other preprocessing
        return NetworkForm(
            "DETR of transformers", slots, lambda o: (_edges(o["pred_boxes"][0]) * size, _sigmoid(o["logits"][0]))
        )
    if {"dets", "labels"} <= {*outputs}:
        slots = outputs["labels"].shape[-1]
        kept = classes if slots == classes + 1 else slots  # the last slot is the background

        def decode(o: Outputs) -> Candidates:
            return _edges(o["dets"][0]) * size, _sigmoid(o["labels"][0][:, :kept])

        return NetworkForm("RF-DETR", kept, decode, mean=_IMAGENET_MEAN, std=_IMAGENET_STD)
    main = next(iter(outputs.values()))
    if main.ndim != 3 or (len(outputs) > 1 and metadata.get("task") != "segment"):
        return None
    return _by_shape(metadata, next(iter(outputs)), main[0], side_wh, classes)


def _by_shape(
    metadata: Mapping[str, str], name: str, rows: NDArray[Any], side_wh: tuple[int, int], classes: int
) -> NetworkForm | None:
    """Return the form of a network with one output, see `recognise`."""
    count, width = rows.shape
    size = np.tile(np.array(side_wh, np.float64), 2)
    # Masks have 32 further values, oriented boxes an angle.
    further = {"segment": 32, "obb": 1}.get(metadata.get("task", ""), 0)
    is_obb = metadata.get("task") == "obb"
    if metadata.get("head") == "RTDETRDecoder" and width == 6:
        return NetworkForm("RT-DETR of Ultralytics", 0, lambda o: _ranked(o[name][0], lambda b: _edges(b) * size))
    if metadata.get("head") == "RTDETRDecoder" or "rtdetr" in metadata.get("description", "").lower():
        return NetworkForm(
            "RT-DETR of Ultralytics", width - 4, lambda o: (_edges(o[name][0][:, :4]) * size, _wide(o[name][0][:, 4:]))
        )
    grids = [_anchors(side_wh, strides) for strides in _STRIDES]
    if width in (len(g) for g in grids) and count > 4 + further:
        own = count - 4 - further

        def decode(o: Outputs) -> Candidates:
            found = o[name][0].T
            return _boxes(found, found[:, -1:] if is_obb else None), _wide(found[:, 4 : 4 + own])

        return NetworkForm("YOLOv8, 11 or 12", own, decode, suppress=True)
    own = width - 5 - (further if further == 32 else 0)
    if own > 0 and count in (3 * len(g) for g in grids):
        return NetworkForm("YOLOv5", own, lambda o: _with_objectness(o[name][0], own), suppress=True)
    grid = next((g for g in grids if len(g) == count), None)
    if grid is not None and width > 5:
        return _yolox(name, rows, grid)
    if width == 6 + further:

        def place(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
            return _boxes(boxes, boxes[:, -1:]) if is_obb else boxes[:, :4]

        return NetworkForm("YOLOv10, YOLO26 or nms=True", 0, lambda o: _ranked(o[name][0], place))
    return None


def _yolox(name: str, trial: NDArray[Any], grid: NDArray[np.float64]) -> NetworkForm:
    """Return the form of YOLOX, whose file does not say whether boxes are decoded: their centres on a picture do."""
    strides = grid[:, 2:]
    from_grid = np.abs(trial[:, :2] - grid[:, :2]) / strides
    is_raw = float(np.median(np.abs(trial[:, :2]))) < float(np.median(from_grid))

    def decode(o: Outputs) -> Candidates:
        rows = _wide(o[name][0])
        if is_raw:
            centres = grid[:, :2] + rows[:, :2] * strides
            rows = np.concatenate([centres, np.exp(rows[:, 2:4]) * strides, rows[:, 4:]], axis=1)
        return _with_objectness(rows, rows.shape[1] - 5)

    return NetworkForm("YOLOX" + (" before decoding" if is_raw else ""), trial.shape[1] - 5, decode, True, divisor=1.0)


def _anchors(side_wh: tuple[int, int], strides: Sequence[int]) -> NDArray[np.float64]:
    """Return (n, 3) anchors: left and top edge of each cell in px, row by row, and the stride."""
    width, height = side_wh
    found = []
    for stride in strides:
        y, x = np.mgrid[: height // stride, : width // stride]
        found.append(np.stack([x * stride, y * stride, np.full(x.shape, stride)], axis=-1).reshape(-1, 3))
    return np.concatenate(found).astype(np.float64)


def _wide(values: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(values, np.float64)


def _sigmoid(logits: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(0.5 * (1 + np.tanh(0.5 * _wide(logits))))  # without overflow


def _edges(cxcywh: NDArray[Any]) -> NDArray[np.float64]:
    """Return the edges of (n, 4) boxes given by centre and size."""
    centre, half = _wide(cxcywh[:, :2]), _wide(cxcywh[:, 2:4]) / 2
    return np.concatenate([centre - half, centre + half], axis=1)


def _boxes(rows: NDArray[Any], angles: NDArray[Any] | None) -> NDArray[np.float64]:
    """Return the edges of boxes given by centre and size, and, with (n, 1) angles in radians, of those around them."""
    if angles is None:
        return _edges(rows)
    corners = corners_of_cxcywha(np.concatenate([_wide(rows[:, :4]), _wide(angles)], axis=1))
    return np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)


def _with_objectness(rows: NDArray[Any], classes: int) -> Candidates:
    found = _wide(rows)
    return _edges(found), found[:, 4:5] * found[:, 5 : 5 + classes]


def _ranked(rows: NDArray[Any], place: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Candidates:
    """Return rows of box, score and class; those with score 0 are padding."""
    found = _wide(rows)
    found = found[found[:, 4] > 0]
    return place(found), _by_class(found[:, 4], found[:, 5])


def _labelled(boxes: NDArray[Any], scores: NDArray[Any], labels: NDArray[Any]) -> Candidates:
    return _wide(boxes), _by_class(_wide(scores).reshape(-1), labels.reshape(-1))


def _by_class(scores: NDArray[np.float64], labels: NDArray[Any]) -> NDArray[np.float64]:
    """Return (n, highest class + 1) scores of rows that have one class each."""
    numbers = np.rint(_wide(labels)).astype(np.int64)
    table = np.zeros((len(scores), int(numbers.max(initial=-1)) + 1))
    table[np.arange(len(scores)), numbers] = scores
    return table
