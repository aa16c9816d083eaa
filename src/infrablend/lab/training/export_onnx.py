"""Writes the weights of a training as ONNX, with what other programs need to use them the same way in its metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend.core.files import write_bytes
from infrablend.detection.onnx_detector import MARK
from infrablend.detection.predict import fitted_size
from infrablend.detection.scale import ONNX_WEIGHTS
from infrablend.lab.training.training_backends import BACKENDS
from infrablend.lab.training.training_record import TrainingRecord

# Tiles of training are small, since each is cut for an object; the network reads whole pictures as well, without seams.
_PICTURE_PX = 640
_MOST_PX = 1280
_STRIDE = 32
# What Ultralytics states about the moment and the folders of the export.
_UNREPEATABLE = ("date", "description", "args")


def export_onnx(weights: Path, record: TrainingRecord) -> Path:
    """Write `weights.onnx` beside the weights of a training by either library.

    The input has a fixed size: that of the pictures of the training, or of the size that they were scaled to, with the
    border that `fit_picture` adds, so that the network sees pictures of this size as its weights do.

    Raises:
        MissingDependencyError: A package is missing.
        RenderError: torch cannot express the network as ONNX.
    """
    backend = BACKENDS[record.get("backend", "ultralytics")]
    settings = record["settings"]
    tile, size = (int(str(settings[k])) for k in ("tile", "image_size"))
    pictures = min(record["prepared"].get("picture_px", _PICTURE_PX), _MOST_PX) if tile else size
    side = max(fitted_size((pictures, pictures), _STRIDE))
    model = backend.as_onnx(weights, side)
    stated = {p.key: p.value for p in model.metadata_props if p.key not in _UNREPEATABLE}
    del model.metadata_props[:]
    own = _metadata(record, tile, side)
    for key, value in sorted((stated | own | backend.onnx_metadata(side)).items()):
        model.metadata_props.add(key=key, value=value)
    return write_bytes(weights.with_name(ONNX_WEIGHTS), model.SerializeToString(deterministic=True))


def _metadata(record: TrainingRecord, tile: int, side: int) -> dict[str, str]:
    """Return what `infrablend detect` reads; all of it JSON."""
    own: Mapping[str, Any] = {
        MARK: {"tile": tile, "image_size": record["settings"]["image_size"], "agc": record.get("agc")},
        "class_names": {str(k): name for k, name in enumerate(record["classes"])},
        "tile_size": side,
    }
    return {key: json.dumps(value) for key, value in own.items()}
