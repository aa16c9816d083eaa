"""Small networks in ONNX files: outputs that do not depend on the picture, and a network that finds bright cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

SIDE = 64
ANCHORS = 84  # of a picture of 64x64 px, at strides 8, 16 and 32
CELL = 8
_TYPES = {"float32": TensorProto.FLOAT, "float16": TensorProto.FLOAT16, "uint8": TensorProto.UINT8,
          "int64": TensorProto.INT64}  # fmt: skip
Shape = Sequence[int | str]


def write_constant(
    path: Path,
    outputs: Mapping[str, NDArray[Any]],
    metadata: Mapping[str, str] | None = None,
    inputs: Mapping[str, Shape] | None = None,
    kind: str = "float32",
) -> Path:
    """Write a network with these outputs, whatever it is given."""
    nodes = [helper.make_node("Identity", [f"{name}_value"], [name]) for name in outputs]
    values = [numpy_helper.from_array(np.asarray(v), f"{name}_value") for name, v in outputs.items()]
    shapes = inputs or {"images": (1, 3, SIDE, SIDE)}
    entries = [(name, kind if len(shape) == 4 else "int64", shape) for name, shape in shapes.items()]
    made = [(name, str(np.asarray(v).dtype), np.asarray(v).shape) for name, v in outputs.items()]
    return _write(path, nodes, values, entries, made, metadata)


def write_echo(path: Path, channels: int = 3, kind: str = "float32", side: int = 4) -> Path:
    """Write a network that returns what it is given."""
    nodes = [helper.make_node("Identity", ["images"], ["echo"])]
    entry = (kind, (1, channels, side, side))
    return _write(path, nodes, [], [("images", *entry)], [("echo", *entry)], {})


def write_cells(path: Path, metadata: Mapping[str, str] | None = None, size_px: float = CELL) -> Path:
    """Write a network of YOLOv8's form that finds each cell of 8x8 px by its mean level, with boxes of a fixed size."""
    at = np.arange(CELL / 2, SIDE, CELL)
    x, y = (v.ravel() for v in np.meshgrid(at, at))
    boxes = np.zeros((1, 4, ANCHORS), np.float32)
    boxes[0, :, : len(x)] = np.stack([x, y, np.full_like(x, size_px), np.full_like(x, size_px)])
    rest = np.zeros((1, 1, ANCHORS - len(x)), np.float32)
    values = [numpy_helper.from_array(v, name) for name, v in (
        ("boxes", boxes), ("rest", rest), ("flat", np.array([1, 1, -1], np.int64)),
        ("zero", np.array([0], np.int64)), ("one", np.array([1], np.int64)),
    )]  # fmt: skip
    nodes = [
        helper.make_node("Slice", ["images", "zero", "one", "one"], ["grey"]),
        helper.make_node("AveragePool", ["grey"], ["means"], kernel_shape=[CELL, CELL], strides=[CELL, CELL]),
        helper.make_node("Reshape", ["means", "flat"], ["cells"]),
        helper.make_node("Concat", ["cells", "rest"], ["scores"], axis=2),
        helper.make_node("Concat", ["boxes", "scores"], ["output0"], axis=1),
    ]
    named = {"names": "{0: 'person'}", **(metadata or {})}
    entry = ("images", "float32", (1, 3, SIDE, SIDE))
    return _write(path, nodes, values, [entry], [("output0", "float32", (1, 5, ANCHORS))], named)


def _write(
    path: Path,
    nodes: list[Any],
    values: list[Any],
    inputs: Sequence[tuple[str, str, Shape]],
    outputs: Sequence[tuple[str, str, Shape]],
    metadata: Mapping[str, str] | None,
) -> Path:
    entries, made = (
        [helper.make_tensor_value_info(name, _TYPES[kind], list(shape)) for name, kind, shape in of]
        for of in (inputs, outputs)
    )
    graph = helper.make_graph(nodes, "test", entries, made, values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, dict(metadata or {}))
    onnx.save(model, path)
    return path
