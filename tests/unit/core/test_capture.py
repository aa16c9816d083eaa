"""What is known of a picture: the one form of its facts in files."""

from __future__ import annotations

import json

import pytest

from infrablend.core.capture import FACTS, UNKNOWN, Capture
from infrablend.core.temperature import Radiometry, TemperatureScale

ALL = {
    "pitch_deg": 35.5, "altitude_m": 80.0, "time_of_day": "night", "hfov_deg": 33.0, "roll_deg": -7.5,
    "altitude_from": "laser", "sequence": "flight 1", "captured": "2021-01-31T08:30", "frame": 12, "time_s": 0.48,
    "camera": "DJI M3T", "latitude_deg": -1.4585, "longitude_deg": -48.4468, "yaw_deg": 61.3,
    "flight_yaw_deg": 55.0,
}  # fmt: skip


def test_every_fact_comes_back_and_unknown_ones_are_left_out() -> None:
    assert list(FACTS) == list(ALL)
    assert Capture.from_json(json.loads(json.dumps(Capture(**ALL).to_json()))) == Capture(**ALL)
    assert Capture(**ALL).to_json() == ALL
    assert (UNKNOWN.to_json(), Capture.from_json({"width": 640, "pitch_deg": None})) == ({}, UNKNOWN)
    assert Capture.from_json({k: str(v) for k, v in ALL.items()}) == Capture(**ALL)


@pytest.mark.parametrize(
    ("fact", "value"),
    [
        ("pitch_deg", 91), ("pitch_deg", True), ("pitch_deg", [1]), ("altitude_m", -1), ("altitude_m", float("nan")),
        ("hfov_deg", 0), ("roll_deg", "x"), ("time_of_day", "noon"), ("altitude_from", "barometer"), ("sequence", ""),
        ("captured", 3), ("frame", 1.5), ("frame", -1), ("frame", float("inf")), ("camera", {}),
        ("time_s", -0.04), ("time_s", 1e8),
    ],
)  # fmt: skip
def test_a_value_that_is_no_such_fact_is_refused_or_unknown(fact: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"{fact}: found .*, expected "):
        Capture.from_json({fact: value})
    assert Capture.from_json({"time_of_day": "day", fact: value}, strict=False).to_json().keys() <= {"time_of_day"} - {
        fact
    }


def test_rolls_in_any_number_of_turns_are_one() -> None:
    assert Capture.from_json({"roll_deg": 350}).roll_deg == -10


def test_facts_complete_and_contradict_each_other() -> None:
    scale = Radiometry(TemperatureScale(0.04))
    one, other = Capture(30.0, sequence="a", radiometry=scale), Capture(60.0, 50.0, sequence="b")
    assert one.over(other) == Capture(30.0, 50.0, sequence="a", radiometry=scale)
    assert one.conflicts(other) == ["pitch_deg: 30.0 and 60.0"]
    assert (one.scale, other.scale) == (scale.scale, None)
