"""The options of MONET's reader: their names, their values, and the keys that are tried by default."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.dataset import SPLITS, Split, TimeOfDay
from infrablend.errors import DatasetError, Problem

OPTIONS = {
    "pitch_sign": "-1 where negative pitch looks down, +1 where positive does; told from the majority by default",
    "pitch_key": "gimbal pitch in an image record, dotted for an object inside it, e.g. metadata.g_pitch",
    "altitude_key": "altitude in metres, likewise",
    "time_key": "time of capture, likewise",
    "angle_unit": "of the pitch: deg (default) or rad",
    "time_of_day": "of every image: day or night",
    "exclude": "sequences to leave out: a,b,c",
    "empty": "sequences without any pitch: exclude (default) or keep",
    "split": "of every image: train, val or test; told from folder and file names by default",
    "annotations": "pattern of the annotation files below the folder, e.g. annotations/*.json",
    "pictures": "folder of an annotation file's pictures below the data set's, e.g. {stem}/lwir",
}
# Only g_pitch and alt are read off a figure of the authors; the others are guesses that cost nothing.
PITCH_KEYS = ("g_pitch", "gimbal_pitch")
ALTITUDE_KEYS = ("alt", "altitude")
TIME_KEYS = ("timestamp", "time_stamp", "time", "date_captured")


@dataclass(frozen=True)
class MonetOptions:
    sign: int | None
    pitch: Sequence[str]
    altitude: Sequence[str]
    time: Sequence[str]
    radians: bool
    time_of_day: TimeOfDay | None
    exclude: tuple[str, ...]
    keep_empty: bool
    split: Split | None


def check_options(root: Path, given: Mapping[str, str | None]) -> MonetOptions:
    allowed: dict[str, Mapping[str, Any]] = {
        "pitch_sign": {"-1": -1, "+1": 1, "1": 1},
        "angle_unit": {"deg": False, "rad": True},
        "time_of_day": {"day": "day", "night": "night"},
        "empty": {"exclude": False, "keep": True},
        "split": {s: s for s in SPLITS},
    }
    problems: list[Problem] = []
    value: dict[str, Any] = {}
    for name, choices in allowed.items():
        text = given[name]
        if text is not None and text not in choices:
            problems.append(Problem(f"option {name}", "option-value", repr(text), f"one of {', '.join(choices)}"))
        value[name] = choices.get(text) if text is not None else None
    for name in ("pitch_key", "altitude_key", "time_key"):
        text = given[name]
        if text is not None and not all(text.split(".")):
            problems.append(Problem(f"option {name}", "option-value", repr(text), "a key, or keys joined by dots"))
    if problems:
        raise DatasetError(f"{root}: options that cannot be used", problems)

    def keys(name: str, otherwise: Sequence[str]) -> Sequence[str]:
        text = given[name]
        return otherwise if text is None else (text,)

    return MonetOptions(
        value["pitch_sign"], keys("pitch_key", PITCH_KEYS), keys("altitude_key", ALTITUDE_KEYS),
        keys("time_key", TIME_KEYS), bool(value["angle_unit"]), value["time_of_day"],
        tuple(sorted({s.strip() for s in (given["exclude"] or "").split(",") if s.strip()})), bool(value["empty"]),
        value["split"],
    )  # fmt: skip
