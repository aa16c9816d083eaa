"""The time of day that a run uses, what it rests on, and what contradicts it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from infrablend import api
from infrablend.config.loading import load_recipe
from infrablend.core.capture import Capture
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.temperature import Radiometry, TemperatureScale
from infrablend.errors import Problem
from infrablend.formats.cameras.flight_headers import time_of_day
from infrablend.pipeline.plans.run_request import RunRequest
from infrablend.pipeline.plans.times import time_warnings, with_used_times
from infrablend.pipeline.runs.generate import describe_run, plan_request
from infrablend.sampling.weather import used_time
from tests.flights import flight
from tests.recipes import load_anywhere
from tests.run_files import records

PLACE = "environment.place={latitude_deg: 25.0, longitude_deg: 102.7}"
DUSK = "environment.time_of_day=dusk"
FLAT = api.Execution(renderer="flat", in_process=True)


def table(data: Path, *captures: tuple[str, str]) -> Path:
    rows = [f"DJI_{n:04}_T.JPG,{captured},{time}" for n, (captured, time) in enumerate(captures, 1)]
    (data / "metadata.csv").write_text("\n".join(["file,captured,time_of_day", *rows]) + "\n")
    return data


def backgrounds(data: Path, out: Path, *settings: str) -> list[Any]:
    api.generate("hit-uav-people", data, out, settings=["empty_share=1.0", *settings], execution=FLAT)
    return [(r.background.get("time_of_day"), r.background.get("time_from")) for r in records(out)]


def test_records_state_the_time_of_day_and_what_it_rests_on(tmp_path: Path) -> None:
    at_dusk = ("2021-01-16T18:20:00+08:00", "day")
    data = table(flight(tmp_path / "in", 2), at_dusk, ("2021-01-16T23:00:00+08:00", "night"))
    assert backgrounds(data, tmp_path / "own") == [("day", None), ("night", None)]
    assert backgrounds(data, tmp_path / "sun", PLACE) == [("dusk", "sun"), ("night", "sun")]
    assert backgrounds(data, tmp_path / "stated", PLACE, DUSK) == [("dusk", "recipe")] * 2
    page = (tmp_path / "stated" / "report.html").read_text()
    assert "dusk (recipe)" in page and "dusk (sun)" in (tmp_path / "sun" / "report.html").read_text()


def test_a_dataset_may_say_dusk_itself(tmp_path: Path) -> None:
    data = table(flight(tmp_path / "in", 2), ("2021-01-16", "dusk"), ("2021-01-16", "dawn"))
    assert backgrounds(data, tmp_path / "own") == [("dusk", None), ("dawn", None)]
    table(data, ("2021-01-16", "evening"), ("2021-01-16", "day"))
    (problem,) = [str(p) for p in api.read_dataset(data).problems if "evening" in str(p)]
    assert "expected day, dusk, night or dawn" in problem


def test_a_stated_time_that_replaces_others_is_reported_once(tmp_path: Path) -> None:
    data = table(flight(tmp_path, 2), ("2021-01-16", "day"), ("2021-01-16", "night"))

    def request(time: str) -> RunRequest:
        return RunRequest("hit-uav-people", data, settings={"environment.time_of_day": time})

    (remark,) = [str(p) for p in plan_request(request("dusk")).problems if p.code == "time-replaced"]
    assert "dusk for all pictures, but by their files or capture times they are: 1 by day, 1 by night" in remark
    assert remark in describe_run(request("dusk"))["kept_fields"]


def warned(captures: list[Capture], *settings: str) -> list[Problem]:
    recipe = load_anywhere("hit-uav-person", list(settings))
    images = tuple(ImageRecord(f"{k}", Path(f"{k}.png"), "train", (640, 512), (), c) for k, c in enumerate(captures))
    dataset = Dataset(Path(), "folder", (), images)
    return time_warnings(recipe, images, with_used_times(dataset, recipe).images)


def test_times_without_zone_are_reported() -> None:
    captures = [Capture(captured="2021-01-16T18:20:00"), Capture(captured="2021-01-16T18:20:00+08:00")]
    unknown, problem = warned(captures, PLACE)
    assert problem.code == "capture-zone" and problem.found.startswith("1 picture(s)")
    assert unknown.found.startswith("unknown time of day of 1 of 2 picture(s), which are taken as by night")
    for found in (warned(captures), warned([Capture(captured="2021-01-16"), Capture(captured="some day")], PLACE)):
        assert [p.code for p in found] == ["time-unknown"]
    assert warned([Capture(time_of_day="day")]) == [] == warned(captures, DUSK)


def test_a_stated_time_keeps_the_air_of_radiometric_pictures_and_says_so() -> None:
    scale = Radiometry(TemperatureScale(0.01, 0.0), air_k=281.0)
    radiometric = ["matching.mode=radiometric"]
    (problem,) = warned([Capture(radiometry=scale)], DUSK, *radiometric)
    assert problem.code == "time-replaced" and "the air of 1 picture(s) keeps the temperature" in problem.found
    assert warned([Capture(time_of_day="dusk")], DUSK, *radiometric) == []
    assert warned([Capture(radiometry=scale)], DUSK) == []


@pytest.mark.parametrize("name", ["hit-uav-drone", "monet-deer"])
def test_the_artistic_look_has_no_time_of_day(name: str) -> None:
    recipe = load_recipe(name)
    image = ImageRecord("a", Path("a.png"), "train", (640, 512), (), Capture(time_of_day="night"))
    dataset = Dataset(Path(), "folder", (), (image,))
    assert with_used_times(dataset, recipe) is dataset and time_warnings(recipe, (image,), (image,)) == []


def test_pictures_with_a_position_have_the_time_of_the_sun() -> None:
    place = 25.0, 102.7
    for clock, expected in (("08:20", "dawn"), ("13:00", "day"), ("18:20", "dusk"), ("23:00", "night")):
        fact = time_of_day(f"2021-01-16T{clock}:00+08:00", *place)
        assert fact is not None and (fact.value, fact.source) == (expected, "sun at time and place")
    # Without a zone, the clock is that of the longitude, here an hour ahead of the legal one.
    found = [time_of_day(f"2021-01-16T{clock}:00", *place) for clock in ("13:00", "17:20", "23:30")]
    assert [f.value for f in found if f is not None] == ["day", "dusk", "night"]
    assert [f.source.rpartition(", ")[2] for f in found if f is not None] == [
        "sun at place and local clock", "taken as UTC+07 by the longitude (+-1 h)", "sun at place and local clock",
    ]  # fmt: skip
    assert time_of_day("2021-01-16T13:00:00", None, None) is None and time_of_day("2021-01-16", *place) is None


@pytest.mark.parametrize(("captured", "expected"), [
    ("2021-01-16T13:00:00+08:00", "day"), ("2021-01-16T13:00:00", "day"), ("2021-01-16T23:00:00", "night"),
    ("2021-01-16", None), (None, None), ("0001-01-01T00:00:00", None),
])  # fmt: skip
def test_any_dataset_that_states_time_and_place_has_the_time_of_the_sun(
    captured: str | None, expected: str | None
) -> None:
    sky = load_recipe("hit-uav-people").environment.sky
    assert sky is not None
    capture = Capture(captured=captured, latitude_deg=25.0, longitude_deg=102.7)
    assert used_time(capture, sky).time_of_day == expected
    own = replace(capture, time_of_day="dusk")
    assert used_time(own, sky) == own
    assert used_time(replace(capture, longitude_deg=None), sky).time_of_day is None


def test_tables_and_headers_have_one_rule_for_the_time_of_the_sun() -> None:
    sky = load_recipe("hit-uav-people").environment.sky
    assert sky is not None
    for hour in range(24):
        captured = f"2021-06-16T{hour:02}:20:00"
        of_header = time_of_day(captured, 47.0, 8.0)
        assert of_header is not None
        capture = Capture(captured=captured, latitude_deg=47.0, longitude_deg=8.0)
        assert used_time(capture, sky).time_of_day == of_header.value, captured


def test_record_card_and_report_state_the_weather(tmp_path: Path) -> None:
    data = table(
        flight(tmp_path / "in", 2), ("2021-01-16T12:00:00+08:00", "day"), ("2021-01-16T23:00:00+08:00", "night")
    )
    settings = ["environment.air_temperature_c=25", "environment.overcast_share=1", PLACE, "empty_share=1.0"]
    report = api.generate("hit-uav-people", data, tmp_path / "run", settings=settings, execution=FLAT)
    said = "air 25.0 °C; sky closed in 2 of 2 pictures; sun 40.3 degrees high (by time and place) in 1"
    assert report.counts["weather"] == said
    assert f"* weather: {said}" in (tmp_path / "run" / "README.md").read_text()
    assert f"Weather over the inserted objects: {said}." in (tmp_path / "run" / "report.html").read_text()
    assert "weather" not in api.generate("hit-uav-drone", data, tmp_path / "art", execution=FLAT).counts
