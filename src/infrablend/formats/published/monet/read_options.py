"""The options of MONET's reader: their names, their values, and the keys that are tried by default."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, get_args

from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import SPLITS, Split
from infrablend.errors import DatasetError, Problem

T = TypeVar("T")
OPTIONS = {
    "pitch_sign": "-1 if negative pitch looks down, +1 if positive does; default: as most frames look down",
    "pitch_key": "key of the gimbal pitch in an image record, dotted for nested objects, e.g. metadata.g_pitch",
    "altitude_key": "key of the altitude in metres, likewise",
    "time_key": "key of the time of capture, likewise",
    "angle_unit": "unit of the pitch: deg (default) or rad",
    "time_of_day": "time of day of every image: day, dusk, night or dawn",
    "exclude": "sequences to leave out: a,b,c",
    "empty": "sequences without any pitch: exclude (default) or keep",
    "split": "split of every image: train, val or test; taken from folder and file names by default",
    "annotations": "pattern of the annotation files, relative to the folder, e.g. annotations/*.json",
    "pictures": "folder of an annotation file's pictures, relative to the dataset's folder, e.g. {stem}/lwir",
}
# g_pitch and alt appear in a figure of the authors; the others are guesses that cost nothing.
PITCH_KEYS = ("g_pitch", "gimbal_pitch")
ALTITUDE_KEYS = ("alt", "altitude")
TIME_KEYS = ("timestamp", "time_stamp", "time", "date_captured")


@dataclass(frozen=True)
class MonetOptions:
    """Options of MONET's reader, checked.

    Attributes:
        sign: -1 if negative pitch looks down, 1 if positive does; None decides by majority.
        pitch: Keys to try for the gimbal pitch; a dot leads into a nested object.
        altitude: Keys to try for the altitude.
        time: Keys to try for the time of capture.
        radians: Whether the pitch is in radians.
        time_of_day: Time of day of every image, if it is known.
        exclude: Sequences to leave out.
        keep_empty: Whether sequences without any pitch are kept.
        split: Split of every image; None takes it from folder and file names.
        annotations: Pattern of the annotation files; None searches for them.
        pictures: Folder of an annotation file's pictures; None searches for it.
    """

    sign: int | None
    pitch: Sequence[str]
    altitude: Sequence[str]
    time: Sequence[str]
    radians: bool
    time_of_day: TimeOfDay | None
    exclude: tuple[str, ...]
    keep_empty: bool
    split: Split | None
    annotations: str | None
    pictures: str | None


def check_options(root: Path, options: Mapping[str, str | None]) -> MonetOptions:
    """Return the options as values.

    Raises:
        TypeError: An option does not exist.
        DatasetError: At least one value is not allowed; all such values are listed.
    """
    if unknown := sorted(set(options) - set(OPTIONS)):
        raise TypeError(f"options {', '.join(unknown)}: expected some of {', '.join(OPTIONS)}")
    problems: list[Problem] = []

    def choose(name: str, choices: Mapping[str, T]) -> T | None:
        text = options.get(name)
        if text is None or text in choices:
            return None if text is None else choices[text]
        problems.append(Problem(f"option {name}", "option-value", repr(text), f"one of {', '.join(choices)}"))
        return None

    def keys(name: str, otherwise: Sequence[str]) -> Sequence[str]:
        text = options.get(name)
        if text is not None and not all(text.split(".")):
            problems.append(Problem(f"option {name}", "option-value", repr(text), "a key, or several joined by dots"))
        return otherwise if text is None else (text,)

    times: Mapping[str, TimeOfDay] = {time: time for time in get_args(TimeOfDay)}
    splits: Mapping[str, Split] = {s: s for s in SPLITS}
    excluded = (options.get("exclude") or "").split(",")
    chosen = MonetOptions(
        sign=choose("pitch_sign", {"-1": -1, "+1": 1, "1": 1}),
        radians=choose("angle_unit", {"deg": False, "rad": True}) or False,
        time_of_day=choose("time_of_day", times),
        keep_empty=choose("empty", {"exclude": False, "keep": True}) or False,
        split=choose("split", splits),
        pitch=keys("pitch_key", PITCH_KEYS),
        altitude=keys("altitude_key", ALTITUDE_KEYS),
        time=keys("time_key", TIME_KEYS),
        exclude=tuple(sorted({s.strip() for s in excluded if s.strip()})),
        annotations=options.get("annotations"),
        pictures=options.get("pictures"),
    )
    if problems:
        raise DatasetError(f"{root}: options with unusable values", problems)
    return chosen
