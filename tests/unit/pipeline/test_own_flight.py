"""A folder of pictures off the card goes through `generate` without a table: each picture through its own lens."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.frame_row import FrameRecord
from infrablend.errors import DatasetError
from infrablend.formats.cameras.header_facts import fov_of_35mm
from infrablend.lab.world.rjpeg_writing import Maker
from infrablend.pipeline.plans.run_request import RunRequest
from infrablend.pipeline.runs.generate import describe_run, plan_request
from tests.flights import SIZE_WH, START, flight, shot
from tests.run_files import records

FLAT = api.Execution(renderer="flat", in_process=True)


def run(data: Path, out: Path, *settings: str) -> list[FrameRecord]:
    # Without objects: the camera of a frame does not depend on them.
    api.generate("hit-uav-people", data, out, settings=["empty_share=1.0", *settings], execution=FLAT)
    return records(out)


def hfov(record: FrameRecord) -> float:
    c = record.scene.camera
    return float(np.degrees(2 * np.arctan(c.sensor_width_mm / 2 / c.focal_length_mm)))


@pytest.mark.parametrize("maker", ["dji", "flir"])
def test_each_picture_is_seen_through_its_own_lens_from_its_own_height(maker: Maker, tmp_path: Path) -> None:
    data = flight(tmp_path / "in", 1, maker, focal_length_35mm=40.0)
    shot(data / "DJI_0002_T.JPG", maker, 1, focal_length_35mm=80.0, altitude_m=25.0, pitch_deg=45.0)
    wide, narrow = run(data, tmp_path / "out")
    assert hfov(wide) == pytest.approx(fov_of_35mm(40, SIZE_WH), abs=0.01)
    assert hfov(narrow) == pytest.approx(fov_of_35mm(80, SIZE_WH), abs=0.01)
    assert np.degrees(narrow.scene.camera.pitch_rad) == pytest.approx(45.0)
    view = narrow.scene.view
    assert view is not None and view.camera_height_m == pytest.approx(25.0)  # not HIT-UAV's 1.15 times as much


def test_a_plan_says_where_lens_and_time_of_day_come_from(tmp_path: Path) -> None:
    data = flight(tmp_path / "in", 2)
    facts = api.plan("hit-uav-people", data).facts
    assert facts["lens"] == "EXIF FocalLengthIn35mmFilm (2)"
    assert "sun at place and local clock" in facts["time_of_day"]
    facts = api.plan("hit-uav-people", data, settings=["camera.focal_length_mm=100"]).facts
    assert facts["lens"] == "from the recipe, 20.4 degrees across (2)"
    nowhere = flight(tmp_path / "nowhere", 2, place=None)
    plan = api.plan("hit-uav-people", nowhere).facts
    assert plan["time_of_day"] == "unknown, taken as night (2)"
    assert "unknown time of day of 2 of 2 picture(s), which are taken as by night, without sun" in str(plan["warnings"])
    stated = api.plan("hit-uav-people", nowhere, settings=["environment.time_of_day=day"]).facts
    assert stated["time_of_day"] == "day (recipe) (2)"


def test_the_sun_stands_where_the_picture_was_taken(tmp_path: Path) -> None:
    """By the sun of 12 January at noon in 46.2 N it is 22 degrees high; without a position it is drawn."""
    for name, place, source in (("there", (46.2, 15.1), "computed"), ("nowhere", None, "drawn")):
        data = flight(tmp_path / name, 1, captured=START.replace(hour=12), place=place)
        (data / "metadata.csv").write_text("file,time_of_day\nDJI_0001_T.JPG,day\n")
        (record,) = run(data, tmp_path / f"{name} out")
        sun = record.scene.weather.sun
        assert sun is not None and sun.source == source
        assert source == "drawn" or np.degrees(sun.elevation_rad) == pytest.approx(22.1, abs=0.3)


def test_a_lens_on_the_command_line_counts_more(tmp_path: Path) -> None:
    (record,) = run(flight(tmp_path / "in", 1), tmp_path / "out", "camera.focal_length_mm=100")
    assert record.scene.camera.focal_length_mm == 100.0


def test_a_table_counts_more_than_the_header(tmp_path: Path) -> None:
    data = flight(tmp_path / "in", 1)
    (data / "metadata.csv").write_text("file,hfov_deg,pitch_deg\nDJI_0001_T.JPG,20,70\n")
    (record,) = run(data, tmp_path / "out")
    assert hfov(record) == pytest.approx(20.0) and np.degrees(record.scene.camera.pitch_rad) == pytest.approx(70.0)


def test_frames_of_a_video_without_a_field_of_view_are_named(tmp_path: Path) -> None:
    flight(tmp_path, 1, raw=False)
    with Image.open(tmp_path / "DJI_0001_T.JPG") as picture:
        picture.save(tmp_path / "frame.png")
    (tmp_path / "DJI_0001_T.JPG").unlink()
    (tmp_path / "metadata.csv").write_text("file,pitch_deg,altitude_m,altitude_from\nframe.png,60,40,take-off\n")
    with pytest.raises(DatasetError) as caught:
        api.plan("hit-uav-people", tmp_path)
    assert [p.code for p in caught.value.problems] == ["no-field-of-view"]
    assert "set camera.field_of_view to recipe" in caught.value.problems[0].todo
    assert api.plan("hit-uav-people", tmp_path, settings=["camera.focal_length_mm=60"]).facts["frames"] == 1
    assert api.plan("hit-uav-people", tmp_path, settings=["camera.field_of_view=recipe"]).facts["frames"] == 1


def test_deer_above_has_its_own_lens_over_pictures_of_any(tmp_path: Path) -> None:
    data = flight(tmp_path / "in", 1, focal_length_35mm=80.0)
    shot(data / "DJI_0002_T.JPG", number=1, focal_length_35mm=None)
    settings = ["empty_share=1.0"]
    api.generate("deer-above", data, tmp_path / "out", settings=settings, execution=FLAT)
    assert [round(hfov(r)) for r in records(tmp_path / "out")] == [50, 50]


def test_a_lens_that_differs_from_the_files_is_reported_once(tmp_path: Path) -> None:
    data = flight(tmp_path, 3, focal_length_35mm=40.0)
    true_deg = fov_of_35mm(40, SIZE_WH)

    def remarks(hfov_deg: float) -> list[str]:
        settings = [f"camera.focal_length_mm={18 / np.tan(np.radians(hfov_deg) / 2)}"]
        plan = plan_request(RunRequest("hit-uav-people", data, settings=settings))
        return [str(p) for p in plan.problems if p.code == "lens-replaced"]

    assert remarks(true_deg * 1.1) == []
    (remark,) = remarks(true_deg * 1.3)
    assert f"the files of 3 picture(s) state {true_deg:.1f}" in remark
    assert not [p for p in plan_request(RunRequest("hit-uav-people", data)).problems if p.code == "lens-replaced"]


def test_a_pitch_that_differs_from_the_files_is_reported_once(tmp_path: Path) -> None:
    data = flight(tmp_path, 3)  # 60 degrees

    def remarks(**pitch: object) -> list[str]:
        plan = plan_request(RunRequest("hit-uav-people", data, settings={"camera.pitch": pitch}))
        return [str(p) for p in plan.problems if p.code == "pitch-replaced"]

    assert remarks(fixed_deg=50) == remarks(random_deg=[30, 50]) == []
    (remark,) = remarks(fixed_deg=90)
    assert "the files of 3 picture(s) state 60 to 60 degrees" in remark
    assert remarks(random_deg=[80, 90]) == [remark]


def test_a_height_that_differs_from_the_files_is_reported_once(tmp_path: Path) -> None:
    data = flight(tmp_path, 3, altitude_m=80.0)

    def remarks(recipe: str = "hit-uav-people", **altitude: object) -> list[str]:
        settings = {"camera.altitude": altitude} if altitude else {}
        plan = plan_request(RunRequest(recipe, data, settings=settings))
        return [str(p) for p in plan.problems if p.code == "height-replaced"]

    assert remarks() == remarks(fixed_m=100) == remarks(random_m=[20, 65]) == []
    (remark,) = remarks(fixed_m=160)
    assert "160 m for all pictures, but the files of 3 picture(s) state 80 to 80 m" in remark
    (drawn,) = remarks("deer-above")
    assert "17 to 42 m for all pictures" in drawn and "camera.altitude to metadata" in drawn
    (shown,) = (p for p in describe_run(RunRequest("deer-above", data))["kept_fields"] if "altitude" in p)
    assert shown == drawn


def test_daylight_that_is_not_stated_is_reported(tmp_path: Path) -> None:
    data = flight(tmp_path, 2)
    rows = ["file,captured,time_of_day"]
    rows += [f"DJI_000{n}_T.JPG,2021-06-21T12:00:00+08:00,{time}" for n, time in ((1, "night"), (2, "day"))]
    (tmp_path / "metadata.csv").write_text("\n".join(rows) + "\n")

    def remarks(longitude_deg: float) -> list[str]:
        place = {"latitude_deg": 25, "longitude_deg": longitude_deg}
        plan = plan_request(RunRequest("hit-uav-people", data, settings={"environment.place": place}))
        return [str(p) for p in plan.problems if p.code == "sun-above-horizon"]

    (remark,) = remarks(102.7)
    assert "in 1 picture(s) stated to be by night" in remark
    assert remarks(-77.3) == []


def test_every_picture_that_is_left_out_counts_as_skipped(tmp_path: Path) -> None:
    data = flight(tmp_path / "in", 6)
    for number, changes in enumerate(({"pitch_deg": -40.0}, {"pitch_deg": None}, {"altitude_m": -4.0}), start=1):
        shot(data / f"DJI_000{number + 1}_T.JPG", number=number, **changes)
    shot(data / "DJI_0005_T.JPG", number=4, focal_length_35mm=None)
    execution = api.Execution(renderer="flat", in_process=True)
    report = api.generate("hit-uav-people", data, tmp_path / "out", execution=execution)
    reasons = {"above-horizon": 1, "no-altitude": 1, "no-field-of-view": 1, "no-pitch": 1}
    assert report.counts["dataset_errors"] == reasons
    assert report.counts["skipped_backgrounds"] == 4 and report.counts["frames"] == 2
    assert not report.ok


def test_a_fact_that_some_pictures_lack_is_asked_for_in_the_table_first(tmp_path: Path) -> None:
    data = flight(tmp_path, 3)
    shot(data / "DJI_0002_T.JPG", number=1, pitch_deg=None)
    (missing,) = [p for p in plan_request(RunRequest("hit-uav-people", data)).problems if p.code == "no-pitch"]
    (asked,) = [p for p in api.read_dataset(data).problems if p.code == "flight-missing"]
    for text in (str(missing), str(asked)):
        assert text.index("metadata.csv") < text.index("camera.pitch")
        assert text.endswith("for all pictures, also those that have one")
    for number in (0, 2):
        shot(data / f"DJI_000{number + 1}_T.JPG", number=number, pitch_deg=None)
    (asked,) = [p for p in api.read_dataset(data).problems if p.code == "flight-missing"]
    assert "metadata.csv" in str(asked) and "for all pictures" not in str(asked)


def test_the_camera_is_rolled_with_the_gimbal(tmp_path: Path) -> None:
    data = flight(tmp_path / "in", 1, roll_deg=10.0)
    shot(data / "DJI_0002_T.JPG", number=1, roll_deg=-180.0, pitch_deg=90.0)
    shot(data / "DJI_0003_T.JPG", number=2, roll_deg=0.0)
    shot(data / "DJI_0004_T.JPG", number=3, roll_deg=7.0)
    (data / "metadata.csv").write_text("file,roll_deg\nDJI_0004_T.JPG,0\n")
    rolled, from_above, level, corrected = (r.scene.camera for r in run(data, tmp_path / "out"))
    assert np.degrees(rolled.roll_rad) == pytest.approx(10.0)
    assert np.degrees(from_above.roll_rad) == pytest.approx(180.0)
    assert level.roll_rad == corrected.roll_rad == 0.0


def test_a_roll_to_the_right_lowers_the_right_side_of_the_camera(tmp_path: Path) -> None:
    """As DJI defines it: its right side down, so the horizon in the picture rises to the right."""
    data = flight(tmp_path / "in", 1, roll_deg=10.0, pitch_deg=20.0)
    (record,) = run(data, tmp_path / "out")
    camera = record.scene.camera
    right_of_camera, down = camera.world_to_camera[0], np.array([0.0, 0.0, -1.0])
    assert right_of_camera @ down > 0
    # Two points far away on the horizon, to the left and to the right.
    far = np.array([[-1e5, 1e6, 0.0], [1e5, 1e6, 0.0]]) + camera.position_m * [1, 1, 1]
    (left, right), _ = camera.project(far)
    tilt = np.degrees(np.arctan2(left[1] - right[1], right[0] - left[0]))
    assert tilt == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize(("roll", "words"), [(180.0, "GimbalRollDegree 180, left out"), (60.0, "60, left out")])
def test_a_roll_that_may_be_a_turned_picture_is_left_out(roll: float, words: str, tmp_path: Path) -> None:
    dataset = api.read_dataset(flight(tmp_path, 1, roll_deg=roll, pitch_deg=45.0))
    assert dataset.images[0].capture.roll_deg is None
    assert any(p.code == "flight-roll" and words in p.found for p in dataset.problems)


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"pitch_deg": -40.0}, "above-horizon", "the whole picture is above the horizon"),
        ({"focal_length_35mm": None}, "no-field-of-view", "unknown field of view of DJI WORLD-T"),
        ({"altitude_m": -4.0}, "no-altitude", "unknown camera height"),
        ({"pitch_deg": None}, "no-pitch", "unknown camera pitch"),
    ],
)
def test_pictures_that_cannot_be_used_are_named(changes: dict[str, Any], code: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as caught:
        api.plan("hit-uav-people", flight(tmp_path, 2, **changes))
    found = [p for p in caught.value.problems if p.code == code]
    assert len(found) == 2 and words in found[0].found
