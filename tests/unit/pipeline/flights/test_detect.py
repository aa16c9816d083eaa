"""`detect` writes what a detector finds in pictures, and names each picture that it could not search."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infrablend.config.agc import LinearAgc
from infrablend.core.dataset import Dataset
from infrablend.core.ground_position import LocalFrame
from infrablend.detection.detections import read_predictions
from infrablend.detection.onnx_detector import MARK
from infrablend.errors import ArgumentError, DatasetError, OutputError
from infrablend.formats.dataset_folder import read
from infrablend.formats.pictures.images import png_bytes
from infrablend.pipeline.flights.detect import DetectReport, detect_objects
from infrablend.pipeline.flights.detect_request import DetectRequest
from tests.command_line import said
from tests.onnx_files import write_cells

CELLS = {"a": [(8, 16)], "b": [(40, 40), (56, 0)], "c": []}
"""Left and top edge of the bright cells of each picture of 96x80 px."""


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    folder = tmp_path / "flight"
    folder.mkdir()
    for name, cells in CELLS.items():
        pixels = np.full((80, 96), 20, np.uint8)
        for k, (x, y) in enumerate(cells):
            pixels[y : y + 8, x : x + 8] = 204 - 51 * k
        (folder / f"{name}.png").write_bytes(png_bytes(pixels))
    return folder


@pytest.fixture
def detector(tmp_path: Path) -> Path:
    return write_cells(tmp_path / "cells.onnx")


def detect(detector: Path, data: Path | Dataset, out: Path, **settings: object) -> DetectReport:
    dataset = data if isinstance(data, Dataset) else read(data)
    return detect_objects(detector, dataset, out, DetectRequest(**settings))


def test_everything_that_is_found_is_written(flight: Path, detector: Path, tmp_path: Path) -> None:
    report = detect(detector, flight, tmp_path / "out")
    assert (report.pictures, report.found, report.with_some, report.ok) == (3, {"person": 3}, 2, True)
    rows = list(csv.DictReader((tmp_path / "out" / "detections.csv").read_text("utf-8").splitlines()))
    got = [(r["picture"], float(r["left"]), float(r["top"]), r["class"], float(r["score"])) for r in rows]
    assert got == [
        ("train/a.png", 8, 16, "person", 0.8),
        ("train/b.png", 40, 40, "person", 0.8),
        ("train/b.png", 56, 0, "person", 0.6),
    ]
    # The file also has what is below the confidence, and reads again.
    saved = read_predictions(tmp_path / "out" / "predictions.json")
    assert saved.sizes_wh == dict.fromkeys(("train/a.png", "train/b.png", "train/c.png"), (96, 80))
    assert len(saved.images["train/c.png"]) == 120  # cells of level 20
    record = json.loads((tmp_path / "out" / "detect.json").read_text("utf-8"))
    assert record["detector"]["network"] == "YOLOv8, 11 or 12"
    assert record["confidence"] == 0.25
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert page.count("<li><svg") == 3 + 2  # crops, and pictures with detections
    assert 'href="http' not in page


def test_detections_have_places_where_pictures_have_a_pose(flight: Path, detector: Path, tmp_path: Path) -> None:
    pose = "90,60,50,0,46.5,11.3"
    table = f"file,pitch_deg,altitude_m,hfov_deg,yaw_deg,latitude_deg,longitude_deg\na.png,{pose}\nb.png,{pose}\n"
    (flight / "metadata.csv").write_text(table)
    report = detect(detector, flight, tmp_path / "out")
    assert report.placed == 3
    rows = list(csv.DictReader((tmp_path / "out" / "detections.csv").read_text("utf-8").splitlines()))
    # 60 m and 50 degrees over 96 px are 0.583 m a pixel; the cell is 36 px left of the middle and 20 px above it.
    frame = LocalFrame(46.5, 11.3)
    place = frame.to_metres(float(rows[0]["latitude"]), float(rows[0]["longitude"]))
    assert place == pytest.approx(0.5829 * np.array([-36, 20]), abs=0.02)
    assert float(rows[0]["ellipse_long_m"]) > float(rows[0]["ellipse_short_m"]) > 2
    points = json.loads((tmp_path / "out" / "detections.geojson").read_text("utf-8"))["features"]
    assert [p["id"] for p in points] == ["train/a.png 0", "train/b.png 0", "train/b.png 1"]
    record = json.loads((tmp_path / "out" / "detect.json").read_text("utf-8"))
    assert record["places"]["lacking"].keys() == {"train/c.png"}
    assert "1 of 3 pictures are not on the map, such as train/c.png" in str(report.problems)
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "data:image/svg+xml" in page
    assert "satellite position without corrections" in page


def test_without_any_pose_there_is_no_map(flight: Path, detector: Path, tmp_path: Path) -> None:
    report = detect(detector, flight, tmp_path / "out")
    assert report.placed == 0
    assert "3 of 3 pictures are not on the map" in str(report.problems[-1])
    assert not list((tmp_path / "out").glob("*.geojson"))
    assert "data:image/svg+xml" not in (tmp_path / "out" / "report.html").read_text("utf-8")


def test_the_same_pictures_give_the_same_bytes(flight: Path, detector: Path, tmp_path: Path) -> None:
    detect(detector, flight, tmp_path / "one")
    detect(detector, flight, tmp_path / "two", threads=1)
    for name in ("predictions.json", "detections.csv", "report.html", "detect.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_pictures_that_cannot_be_read_are_listed(flight: Path, detector: Path, tmp_path: Path) -> None:
    (flight / "b.png").write_bytes((flight / "b.png").read_bytes()[:120])
    report = detect(detector, flight, tmp_path / "out")
    assert (report.pictures, report.found, report.ok) == (2, {"person": 1}, False)
    assert [p.where for p in report.problems if p.severity == "error"] == ["b.png"]
    for name in "ac":
        (flight / f"{name}.png").write_bytes((flight / "b.png").read_bytes())
    with pytest.raises(DatasetError, match="no picture can be searched"):
        detect(detector, flight, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_nothing_found_is_said_and_not_success(flight: Path, detector: Path, tmp_path: Path) -> None:
    report = detect(detector, flight, tmp_path / "out", confidence=0.9)
    assert not report.ok
    assert "the best has 0.800" in str(report.problems[-1])


def test_saved_detections_are_matched_with_their_pictures(flight: Path, detector: Path, tmp_path: Path) -> None:
    detect(detector, flight, tmp_path / "first")
    again = detect(tmp_path / "first", flight, tmp_path / "again", confidence=0.7)
    assert (again.found, again.ok) == ({"person": 2}, True)
    dataset = read(flight)
    lacking = replace(dataset, images=(*dataset.images[:2], replace(dataset.images[2], id="d", file_name="d.png")))
    report = detect(tmp_path / "first", lacking, tmp_path / "lacking")
    assert report.pictures == 2
    assert [(p.where, p.severity) for p in report.problems] == [
        ("train/d.png", "error"),
        ("predictions.json", "warning"),
        ("flight", "warning"),  # no poses
    ]
    other = replace(dataset, images=(replace(dataset.images[0], size_wh=(80, 96)),))
    with pytest.raises(DatasetError, match="96x80"):
        detect(tmp_path / "first", other, tmp_path / "other")


@pytest.mark.parametrize("agc", [None, LinearAgc(mode="linear")])
@pytest.mark.parametrize("deep", [False, True])
def test_another_gain_control_is_said(agc: LinearAgc | None, deep: bool, flight: Path, tmp_path: Path) -> None:
    if deep:
        pixels = np.random.default_rng(0).integers(20_000, 21_000, (80, 96)).astype(np.uint16)
        for name in CELLS:
            (flight / f"{name}.png").write_bytes(png_bytes(pixels))
    mark = {MARK: json.dumps({"tile": 64, "image_size": 64, "agc": None if agc is None else agc.model_dump()})}
    report = detect(write_cells(tmp_path / "d.onnx", mark), flight, tmp_path / "out")
    codes = [p.code for p in report.problems if p.code.startswith("agc")]
    assert codes == {(True, True): ["agc-unknown"], (False, False): ["agc-other"]}.get((deep, agc is None), [])


def test_the_command_prints_counts_and_refuses_what_it_may_not_replace(
    flight: Path, detector: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    printed = said("detect", detector, flight, "--out", out, "--classes", "man", "--confidence", "0.7")
    assert "pictures searched 3" in printed
    assert "man 2" in printed
    assert "--overwrite" in said("detect", detector, flight, "--out", out, code=2)
    assert "above" not in said("detect", detector, flight, "--out", out, "--overwrite")
    assert "nothing found" in said("detect", detector, flight, "--out", tmp_path / "n", "--confidence", "0.9", code=1)
    with pytest.raises(OutputError, match="contains the data"):
        detect(detector, flight, flight)


def test_tracks_go_through_a_sequence(ultralytics: None, tmp_path: Path) -> None:
    flight = tmp_path / "flight"
    flight.mkdir()
    for k in range(5):
        pixels = np.full((64, 64), 20, np.uint8)
        pixels[16:24, 8 * k : 8 * k + 8] = 255  # walks
        pixels[48:56, 40:48] = 230  # stands, and is hidden once
        pixels[48:56, 40:48] = 20 if k == 2 else 230
        (flight / f"clip_{k:03}.png").write_bytes(png_bytes(pixels))
    detector = write_cells(tmp_path / "d.onnx", size_px=24)
    report = detect(detector, flight, tmp_path / "out", tracks=True)
    assert report.ok
    rows = list(csv.DictReader((tmp_path / "out" / "detections.csv").read_text("utf-8").splitlines()))
    walking = [r["track"] for r in rows if float(r["top"]) < 30]
    standing = [r["track"] for r in rows if float(r["top"]) > 30]
    assert len(walking) == 5
    assert len(standing) == 4
    assert len({*walking}) == len({*standing}) == 1
    assert {*walking} != {*standing}
    (flight / "other.png").write_bytes((flight / "clip_000.png").read_bytes())
    for k in range(5):
        (flight / f"clip_{k:03}.png").unlink()
    with pytest.raises(DatasetError, match="no picture has a sequence"):
        detect(detector, flight, tmp_path / "none", tracks=True)


@pytest.mark.parametrize("wrong", [{"confidence": 0}, {"confidence": 1.5}, {"overlap": -1}, {"classes": "a"}])
def test_values_out_of_range_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ArgumentError):
        DetectRequest(**wrong)
