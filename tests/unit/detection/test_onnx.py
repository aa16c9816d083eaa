"""Detectors in ONNX files: each form of outputs gives the box that is in it, and unknown files are refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from infrablend.config.agc import FixedAgc
from infrablend.core.temperature import TemperatureScale
from infrablend.detection.finder import load_finder
from infrablend.detection.onnx_detector import MARK, load_onnx, run_network
from infrablend.detection.onnx_outputs import NetworkForm, recognise
from infrablend.errors import MissingDependencyError, ModelError
from tests.onnx_files import ANCHORS, CELL, SIDE, write_cells, write_constant, write_echo

NAMES = "{0: 'person', 1: 'car'}"
BOX = [15, 26, 25, 34]
CXCYWH = [20, 30, 10, 8]
SHARES = [v / SIDE for v in CXCYWH]
GREY = np.full((SIDE, SIDE), 90, np.uint8)


def rows(count: int, width: int, row: list[float], at: int = 3) -> np.ndarray[Any, Any]:
    """Return (1, count, width) float32 zeros but for one row."""
    table = np.zeros((1, count, width), np.float32)
    table[0, at, : len(row)] = row
    return table


def logit(share: float) -> float:
    return float(np.log(share / (1 - share)))


def raw_yolox() -> np.ndarray[Any, Any]:
    # Cell (2, 3) of stride 8: (2 + 0.5) * 8 = 20, (3 + 0.75) * 8 = 30, e^w * 8 = 10.
    return rows(ANCHORS, 7, [0.5, 0.75, np.log(10 / 8), 0.0, 0.9, 0.1, 0.8], at=3 * 8 + 2)


def decoded_yolox() -> np.ndarray[Any, Any]:
    table = np.zeros((1, ANCHORS, 7), np.float32)
    centres = [(x + 0.5, y + 0.5, s) for s in (8, 16, 32) for y in range(SIDE // s) for x in range(SIDE // s)]
    table[0, :, :2] = [(x * s, y * s) for x, y, s in centres]
    table[0, 26] = [*CXCYWH, 0.9, 0.1, 0.8]
    return table


MASKS = {"output1": np.zeros((1, 32, 16, 16), np.float32)}
SCORED = [0.0, 0.72]
CASES: dict[str, tuple[dict[str, Any], dict[str, str], dict[str, Any] | None]] = {
    "YOLOv5": ({"output0": rows(3 * ANCHORS, 7, [*CXCYWH, 0.9, 0.1, 0.8])}, {}, None),
    "YOLOv5 seg": ({"output0": rows(3 * ANCHORS, 39, [*CXCYWH, 0.9, 0.1, 0.8]), **MASKS}, {"task": "segment"}, None),
    "YOLOv8": ({"output0": rows(ANCHORS, 6, [*CXCYWH, *SCORED]).transpose(0, 2, 1)}, {}, None),
    "YOLOv8 seg": (
        {"output0": rows(ANCHORS, 38, [*CXCYWH, *SCORED]).transpose(0, 2, 1), **MASKS}, {"task": "segment"}, None,
    ),
    # Turned by a quarter: width and height swapped.
    "YOLOv8 obb": (
        {"output0": rows(ANCHORS, 7, [20, 30, 8, 10, *SCORED, np.pi / 2]).transpose(0, 2, 1)}, {"task": "obb"}, None,
    ),
    "YOLO26": ({"output0": rows(300, 6, [*BOX, 0.72, 1])}, {"end2end": "True"}, None),
    "nms=True": ({"output0": rows(300, 6, [*BOX, 0.72, 1])}, {}, None),
    "YOLO26 seg": ({"output0": rows(300, 38, [*BOX, 0.72, 1]), **MASKS}, {"task": "segment"}, None),
    "YOLO26 obb": ({"output0": rows(300, 7, [20, 30, 8, 10, 0.72, 1, np.pi / 2])}, {"task": "obb"}, None),
    "RT-DETR of Ultralytics": ({"output0": rows(300, 6, [*SHARES, 0.72, 1])}, {"head": "RTDETRDecoder"}, None),
    "older RT-DETR": (
        {"output0": rows(300, 6, [*SHARES, *SCORED])}, {"description": "Ultralytics rtdetr-l model"}, None,
    ),
    "YOLOX": ({"output": raw_yolox()}, {}, None),
    "decoded YOLOX": ({"output": decoded_yolox()}, {}, None),
    "D-FINE": (
        {"scores": np.float32([[0.72, 0.0]]), "labels": np.int64([[1, 0]]), "boxes": rows(2, 4, BOX, at=0)}, {},
        {"images": (1, 3, SIDE, SIDE), "orig_target_sizes": (1, 2)},
    ),
    "transformers": (
        {"logits": np.full((1, 2, 2), -20, np.float32) + rows(2, 2, [0, 20 + logit(0.72)], 1),
         "pred_boxes": rows(2, 4, SHARES, 1)}, {},
        {"pixel_values": ("b", 3, SIDE, SIDE), "pixel_mask": ("b", SIDE, SIDE)},
    ),
    "RF-DETR": (
        {"dets": rows(2, 4, SHARES, 1), "labels": np.full((1, 2, 3), -20, np.float32) + rows(
            2, 3, [0, 20 + logit(0.72), 40], 1)}, {}, {"input": (1, 3, SIDE, SIDE)},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_each_form_of_outputs_gives_its_box(name: str, tmp_path: Path) -> None:
    outputs, metadata, inputs = CASES[name]
    path = write_constant(tmp_path / "d.onnx", outputs, {"names": NAMES, **metadata}, inputs)
    finder = load_finder(path)
    found = finder.find(GREY, 0.25)
    assert finder.classes == ("person", "car")
    assert [finder.classes[k] for k in found.classes] == ["car"]
    # Boxes are 32-bit numbers up to 64, with errors of some 1e-6 of them; RF-DETR's logits have fewer digits.
    assert np.allclose(found.boxes_xyxy, [BOX], atol=1e-3)
    assert found.scores[0] == pytest.approx(0.72, abs=1e-5)
    assert finder.facts["network"]
    assert len(finder.find(GREY, 0.73)) == 0


def test_a_class_scores_only_if_it_reaches_the_confidence(tmp_path: Path) -> None:
    path = write_constant(tmp_path / "d.onnx", CASES["YOLOv5"][0], {"names": NAMES})
    assert load_finder(path).find(GREY, 0.05).scores.tolist() == pytest.approx([0.72, 0.09])


@pytest.mark.parametrize("shape", [("b", 3, "h", "w"), (2, 3, SIDE, SIDE), ("b", 1, SIDE, SIDE)])
def test_open_sizes_and_batches_are_handled(shape: tuple[int | str, ...], tmp_path: Path) -> None:
    outputs = {"output0": np.repeat(CASES["YOLOv8"][0]["output0"], 2 if shape[0] == 2 else 1, axis=0)}
    path = write_constant(tmp_path / "d.onnx", outputs, {"names": NAMES, "imgsz": "[64, 64]"}, {"images": shape})
    finder = load_finder(path)
    assert finder.facts["tile"] == [64, 64]
    assert np.allclose(finder.find(GREY).boxes_xyxy, [BOX], atol=1e-3)


@pytest.mark.parametrize("kind", ["float16", "uint8"])
def test_other_types_of_input_are_fed(kind: str, tmp_path: Path) -> None:
    path = write_constant(tmp_path / "d.onnx", CASES["YOLOv8"][0], {"names": NAMES}, kind=kind)
    assert len(load_finder(path).find(GREY)) == 1


def test_levels_reach_the_network_as_its_training_gave_them(tmp_path: Path) -> None:
    session = load_session(write_echo(tmp_path / "e.onnx"))
    tile = np.full((4, 4), 102, np.uint8)
    of = {name: form_of(name, tmp_path) for name in ("YOLOv8", "YOLOX", "RF-DETR")}
    levels = {name: run_network(session, tile, form)["echo"][0, :, 0, 0] for name, form in of.items()}
    assert levels["YOLOv8"] == pytest.approx([0.4] * 3)
    assert levels["YOLOX"] == pytest.approx([102.0] * 3)
    # (0.4 - mean) / standard deviation of ImageNet.
    expected = [(0.4 - m) / s for m, s in ((0.485, 0.229), (0.456, 0.224), (0.406, 0.225))]
    assert levels["RF-DETR"] == pytest.approx(expected, abs=1e-6)


def load_session(path: Path) -> Any:
    import onnxruntime

    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def form_of(name: str, folder: Path) -> NetworkForm:
    outputs, metadata, inputs = CASES[name]
    form = recognise(metadata, list(inputs or {"images": ()}), outputs, (SIDE, SIDE), 2)
    assert form is not None
    return form


# ---- 16 bits, scale


def test_sixteen_bits_go_through_the_gain_control_of_the_training(tmp_path: Path) -> None:
    agc = FixedAgc(mode="fixed", low_c=0, high_c=100)
    mark = json.dumps({"tile": 64, "image_size": 64, "agc": agc.model_dump()})
    finder = load_finder(write_cells(tmp_path / "d.onnx", {MARK: mark}))
    assert finder.agc == agc
    counts = np.full((SIDE, SIDE), 27315, np.uint16)
    counts[8:16, 24:32] = 27315 + 4000  # 40 degrees Celsius are level 102 of 255
    found = finder.find(counts, scale=TemperatureScale.of_unit("centikelvin"))
    assert found.boxes_xyxy.tolist() == [[24, 8, 32, 16]]
    assert found.scores[0] == pytest.approx(0.4, abs=1e-6)
    with pytest.raises(ValueError, match="scale"):
        finder.find(counts)


def test_sixteen_bits_go_through_a_line_where_the_training_is_unknown(tmp_path: Path) -> None:
    finder = load_finder(write_cells(tmp_path / "d.onnx"))
    assert finder.agc is None
    counts = np.full((SIDE, SIDE), 21000, np.uint16)
    counts[8:16, 24:32] = 21400
    assert finder.find(counts).scores.tolist() == [1.0]


def test_a_detector_of_whole_pictures_sees_them_scaled(tmp_path: Path) -> None:
    mark = json.dumps({"tile": 0, "image_size": 64, "agc": None})
    picture = np.zeros((96, 128), np.uint8)
    picture[32:48, 48:64] = 255  # 8x8 px at half the size
    # The picture is 64x48 px for the network, with 8 px above it.
    found = load_finder(write_cells(tmp_path / "d.onnx", {MARK: mark})).find(picture, 0.9)
    assert found.boxes_xyxy.tolist() == [[48, 32, 64, 48]]
    native = load_finder(tmp_path / "d.onnx", image_size=0).find(picture, 0.9)
    assert len(native) == 4


# ---- tiles


@pytest.mark.parametrize("x", range(0, 160, 8))
def test_an_object_is_found_once_wherever_it_is(x: int, tmp_path: Path) -> None:
    finder = load_finder(write_cells(tmp_path / "d.onnx", size_px=12), overlap_px=24)
    picture = np.zeros((112, 160), np.uint8)
    for y in (0, 40, 104):
        picture[y : y + CELL, x : x + CELL] = 255
    found = finder.find(picture, 0.5)
    centres = (found.boxes_xyxy[:, :2] + found.boxes_xyxy[:, 2:]) / 2
    edge = np.clip(x + 4, 5, 155)  # boxes at the edge are cut to the picture
    assert sorted(map(tuple, centres.tolist())) == [(edge, 5), (edge, 44), (edge, 107)]


@pytest.mark.parametrize("x", range(8, 144, 8))
def test_people_side_by_side_stay_two(x: int, tmp_path: Path) -> None:
    # Boxes of 12 px, 8 px apart, overlap by a fifth.
    finder = load_finder(write_cells(tmp_path / "d.onnx", size_px=12), overlap_px=24)
    picture = np.zeros((96, 160), np.uint8)
    picture[40:48, x : x + 2 * CELL] = 255
    assert len(finder.find(picture, 0.5)) == 2


# ---- refusals


def problem_of(path: Path, **settings: Any) -> str:
    with pytest.raises(ModelError) as caught:
        load_onnx(path, **settings)
    return str(caught.value)


def test_unknown_outputs_are_refused_with_what_was_found(tmp_path: Path) -> None:
    told = problem_of(write_constant(tmp_path / "d.onnx", {"logits": np.zeros((1, 1000), np.float32)}, {"a": "b"}))
    assert "logits (1, 1000)" in told
    assert "images (1, 3, 64, 64)" in told
    assert "metadata a" in told
    several = {"output0": CASES["YOLOv8"][0]["output0"], "other": np.zeros((1, 2), np.float32)}
    assert "other (1, 2)" in problem_of(write_constant(tmp_path / "d.onnx", several, {"names": NAMES}))
    slots = {"logits": np.zeros((1, 2, 3), np.float32), "pred_boxes": np.zeros((1, 2, 4), np.float32)}
    inputs = {"pixel_values": (1, 3, SIDE, SIDE)}
    assert "pred_boxes (1, 2, 4)" in problem_of(
        write_constant(tmp_path / "d.onnx", slots, {"names": NAMES}, inputs)
    )  # a slot for no object


@pytest.mark.parametrize("names", ["", "__import__('os').getcwd()", "[1, 2"])
def test_classes_without_names_are_asked_for(names: str, tmp_path: Path) -> None:
    path = write_constant(tmp_path / "d.onnx", CASES["YOLOv8"][0], {"names": names})
    told = problem_of(path)
    assert "--classes" in told
    assert "2 names" in told
    assert load_onnx(path, classes=("a", "b")).classes == ("a", "b")
    assert "3 names: a, b, c" in problem_of(path, classes=("a", "b", "c"))


def test_names_of_transformers_are_beside_the_file(tmp_path: Path) -> None:
    outputs, _, inputs = CASES["transformers"]
    (tmp_path / "config.json").write_text('{"id2label": {"1": "car", "0": "person"}}', "utf-8")
    (tmp_path / "onnx").mkdir()
    path = write_constant(tmp_path / "onnx" / "model.onnx", outputs, None, inputs)
    assert load_onnx(path).classes == ("person", "car")


def test_a_class_without_a_name_is_refused_when_it_is_found(tmp_path: Path) -> None:
    path = write_constant(tmp_path / "d.onnx", CASES["YOLO26"][0], {"names": "['person']"})
    with pytest.raises(ModelError, match="class 1 in the output"):
        load_finder(path).find(GREY)


@pytest.mark.parametrize(
    "inputs", [{"images": (1, 64, 64, 3)}, {"images": (1, 3, SIDE, SIDE), "im_shape": (1, 2)}, {"x": (1, 3, 64)}]
)
def test_other_inputs_are_refused(inputs: dict[str, Any], tmp_path: Path) -> None:
    assert "inputs " in problem_of(write_constant(tmp_path / "d.onnx", CASES["YOLOv8"][0], {"names": NAMES}, inputs))


def test_files_that_cannot_be_loaded_are_refused(tmp_path: Path) -> None:
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    assert "cannot be loaded" in problem_of(broken)
    assert "no such file" in problem_of(tmp_path / "none.onnx")
    mark = json.dumps({"tile": 64, "image_size": 64, "agc": {"mode": "other"}})
    assert "an AGC of" in problem_of(write_cells(tmp_path / "d.onnx", {MARK: mark}))
    with pytest.raises(MissingDependencyError, match="CPUExecutionProvider"):
        load_onnx(write_cells(tmp_path / "d.onnx"), device="cuda:7")


def test_weights_in_a_file_of_their_own_are_read_or_asked_for(tmp_path: Path) -> None:
    model = onnx.load(write_constant(tmp_path / "d.onnx", CASES["YOLOv8"][0], {"names": NAMES}))
    onnx.save(model, tmp_path / "d.onnx", save_as_external_data=True, location="d.data", size_threshold=0)
    assert load_onnx(tmp_path / "d.onnx").classes == ("person", "car")
    (tmp_path / "d.data").unlink()
    told = problem_of(tmp_path / "d.onnx")
    assert "d.data" in told
    assert "Put the file with the weights" in told
