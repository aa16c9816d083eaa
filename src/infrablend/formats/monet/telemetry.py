"""The drone's telemetry in MONET's records: where it is found, what it means, and which sign looks down."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from infrablend.core.dataset import ImageRecord, Split
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import few, to_floats, to_int
from infrablend.formats.capture import Capture, Captures, find_table, read_table
from infrablend.formats.monet.folders import below_split
from infrablend.formats.monet.options import MonetOptions

# Where the writer puts telemetry if the source had none.
NEST = "metadata"
Place = tuple[str, ...]
T = TypeVar("T")
# A gimbal that points straight down reads a little more at times.
BEYOND_DEG = 1.0


def _places(record: Mapping[str, Any], keys: Sequence[str]) -> Iterator[Place]:
    """Where one of the keys stands: as dotted path, in the record itself, in an object one level inside."""
    for key in keys:
        path = tuple(key.split("."))
        if len(path) > 1 and _at(record, path) is not None:
            yield path
        if key in record:
            yield (key,)
        for nest, inside in sorted(record.items()):
            if isinstance(inside, dict) and key in inside:
                yield nest, key


def _at(record: Mapping[str, Any], place: Place) -> Any:
    value: Any = record
    for key in place:
        if not isinstance(value, dict):
            return None
        value = value.get(key)
    return value


def _find(record: Mapping[str, Any], keys: Sequence[str], read: Callable[[Any], T | None]) -> tuple[Place | None, Any]:
    """The first place whose value can be read, else the first with a value, else the first; and the value there."""
    best: tuple[int, Place | None, Any] = (0, None, None)
    for place in _places(record, keys):
        value = _at(record, place)
        rank = 1 if value in (None, "", [], {}) else 2 if read(value) is None else 3
        if rank > best[0]:
            best = rank, place, value
    return best[1], best[2] if best[0] > 1 else None


def join_lists(top: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    """Top-level lists of objects with an `image_id`, other than the annotations: telemetry kept beside the images."""
    joined: dict[int, dict[str, Any]] = defaultdict(dict)
    for name, entries in sorted(top.items()):
        if name in ("images", "annotations", "categories", "licenses") or not isinstance(entries, list):
            continue
        for entry in entries:
            number = to_int(entry.get("image_id")) if isinstance(entry, dict) else None
            if number is not None:
                joined[number][name] = {k: v for k, v in entry.items() if k != "image_id"}
    return joined


def _iso_time(value: Any) -> str | None:
    """ISO 8601 of a time in a form of it, None of anything else."""
    try:
        return datetime.fromisoformat(value.strip()).isoformat() if isinstance(value, str) else None
    except ValueError:
        return None


@dataclass(slots=True)
class Frame:
    """A picture as read, its telemetry not yet interpreted."""

    record: ImageRecord
    where: str
    raw_deg: float | None
    altitude_m: float | None
    sequence: str | None


@dataclass(slots=True)
class Tally:
    """Values of one file that cannot be used: how many, and the first few."""

    counts: Counter[str] = field(default_factory=Counter)
    shown: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))

    def add(self, what: str, text: str) -> None:
        self.counts[what] += 1
        if len(self.shown[what]) < 3:
            self.shown[what].append(text)

    def problems(self, where: str, expected: Mapping[str, str]) -> list[Problem]:
        return [
            Problem(
                where, "metadata-value", f"{n} image(s) with {what} {', '.join(self.shown[what])}, ignored",
                expected[what], "correct the file, or leave it", "warning",
            )
            for what, n in sorted(self.counts.items())
        ]  # fmt: skip


def frame_of(
    record: ImageRecord,
    where: str,
    split: Split,
    sequence: str | None,
    fields: dict[str, Any],
    chosen: MonetOptions,
    tally: Tally,
) -> Frame:
    """A record with its telemetry looked up; what cannot be used is tallied."""
    here = f"(image {record.source_id})"
    pitch_at, pitch = _find(fields, chosen.pitch, _number)
    altitude_at, altitude = _find(fields, chosen.altitude, _number)
    time_at, time = _find(fields, chosen.time, _iso_time)
    raw = _number(pitch)
    if raw is not None and chosen.radians:
        raw = math.degrees(raw)
    if pitch is not None and (raw is None or abs(raw) > 90 + BEYOND_DEG):
        tally.add("pitch", f"{_show(pitch)} {here}")
        raw = None
    metres = _number(altitude)
    if altitude is not None and (metres is None or not 0 <= metres <= 1e5):
        tally.add("altitude", f"{_show(altitude)} {here}")
        metres = None
    captured = _iso_time(time)
    if time is not None and captured is None:
        tally.add("time", f"{_show(time)} {here}")
    places = {"pitch": pitch_at, "altitude": altitude_at, "time": time_at, "radians": chosen.radians}
    extra = {**record.extra, "fields": fields, "telemetry": places}
    kept = replace(
        record, split=split, sequence=sequence or record.sequence, captured=captured, extra=extra,
        file_name=below_split(record.name), time_of_day=chosen.time_of_day or record.time_of_day,
    )  # fmt: skip
    return Frame(kept, where, raw, metres, kept.sequence)


def _number(value: Any) -> float | None:
    numbers = to_floats([value], 1)
    return numbers[0] if numbers is not None and math.isfinite(numbers[0]) else None


def _show(value: Any) -> str:
    return ascii(value)[:40]


def set_pitches(root: Path, frames: list[Frame], chosen: MonetOptions, problems: list[Problem]) -> dict[str, Any]:
    """Decide which sign looks down, turn all pitches into depression angles, and judge the result file by file."""
    raw = [f.raw_deg for f in frames if f.raw_deg is not None]
    below, above = sum(v < 0 for v in raw), sum(v > 0 for v in raw)
    keys = sorted({".".join(f.record.extra["telemetry"]["pitch"]) for f in frames if f.raw_deg is not None})
    name = ", ".join(keys)
    todo = "give --read pitch_sign=-1 (negative looks down) or +1"
    if chosen.sign is None and raw and below == above and below > 0:
        found = f"{below} values of {name} below 0 and as many above"
        problem = Problem(str(root), "pitch-sign", found, "most frames looking down", todo)
        raise DatasetError(f"{root}: which sign of the gimbal's pitch looks down cannot be told", [problem])
    sign = chosen.sign if chosen.sign is not None else -1 if below >= above else 1
    upward: Counter[str] = Counter()
    known: Counter[str] = Counter()
    clamped = 0
    for f in frames:
        if f.raw_deg is None:
            pitch = f.record.pitch_deg
        else:
            # Not -0.0 for a level camera.
            pitch = sign * f.raw_deg + 0.0
            clamped += abs(pitch) > 90
            pitch = max(-90.0, min(90.0, pitch))
            upward[f.where] += pitch < 0
            known[f.where] += 1
        altitude = f.record.altitude_m if f.altitude_m is None else f.altitude_m
        extra = {**f.record.extra, "telemetry": f.record.extra["telemetry"] | {"sign": sign}}
        f.record = replace(f.record, pitch_deg=pitch, altitude_m=altitude, extra=extra)
    if chosen.sign is None:
        wrong = [w for w in sorted(known) if 2 * upward[w] > known[w]]
    else:
        wrong = ["all files"] if 2 * sum(upward.values()) > sum(known.values()) else []
        upward["all files"], known["all files"] = sum(upward.values()), sum(known.values())
    if wrong:
        faults = [
            Problem(w, "pitch-sign", f"{upward[w]} of {known[w]} cameras look up with pitch = {'+-'[sign < 0]}{name}",
                    "most cameras looking down", todo)
            for w in wrong
        ]  # fmt: skip
        raise DatasetError(f"{root}: more than half of the pitches are negative", few(faults))
    said = f"pitch = {'+-'[sign < 0]}{name}: {below} values below 0, {above} above"
    if chosen.sign is None and raw:
        problems.append(
            Problem(root.name, "pitch-sign", said, "most frames looking down",
                    f"if that is wrong, {todo}; giving it silences this", "warning")
        )  # fmt: skip
    if not chosen.radians and len(raw) >= 10 and 0 < max(map(abs, raw)) <= math.pi / 2:
        found = f"all {len(raw)} values of {name} lie within {max(map(abs, raw)):.4g}: radians?"
        problems.append(
            Problem(root.name, "pitch-unit", found, "degrees", "if so, give --read angle_unit=rad", "warning")
        )
    return {
        "key": name, "unit": "rad" if chosen.radians else "deg", "sign": sign,
        "sign_from": "majority" if chosen.sign is None else "pitch_sign", "below_0": below, "above_0": above,
        "missing": len(frames) - len(raw), "beyond_90_clamped": clamped,
    }  # fmt: skip


def apply_table(
    root: Path, metadata: Path | None, frames: Sequence[Frame], problems: list[Problem]
) -> tuple[Captures, str | None]:
    """Let a table say more, or otherwise, than the telemetry; what counted where pitch came from, the table's name."""
    path = metadata or find_table(root)
    table = read_table(path) if path else None
    captures = Captures(table, problems)
    for f in frames:
        r = f.record
        own = Capture(r.pitch_deg, r.altitude_m, r.time_of_day)
        known = captures.of(r.name, f"{r.split}/{r.name}", own, r.sequence)
        f.record = replace(r, pitch_deg=known.pitch_deg, altitude_m=known.altitude_m, time_of_day=known.time_of_day)
    if table is not None:
        problems += table.problems
        unused = table.unused([f.record.name for f in frames], {f.record.sequence for f in frames})
        if unused:
            found = f"{len(unused)} row(s) of the table name no picture and no sequence: {', '.join(unused[:3])}"
            expected = "a picture or sequence for each row"
            problems.append(Problem(root.name, "table-unused", found, expected, severity="warning"))
    return captures, path.name if path else None


def require_pitch(root: Path, frames: Sequence[Frame], chosen: MonetOptions, problems: Sequence[Problem]) -> None:
    """An error that names the keys there are, if no frame at all has a pitch: the key is another one, likely."""
    if any(f.record.pitch_deg is not None for f in frames):
        return
    keys = {k for f in frames[:1000] for k in _dotted(f.record.extra["fields"])}
    there = ", ".join(sorted(keys)[:40]) or "nothing more"
    found = f"no {' or '.join(chosen.pitch)} with a value; image records hold {there}"
    todo = "name it with --read pitch_key=KEY, or take the images without pitch with --read empty=keep"
    problem = Problem(str(root), "no-telemetry", found, "the gimbal's pitch in image records", todo)
    raise DatasetError(f"{root}: no telemetry in {len(frames)} image(s)", [problem, *few(problems)])


def _dotted(record: Mapping[str, Any], depth: int = 4) -> Iterator[str]:
    """The keys of a record and of objects inside it, as the options take them."""
    for key, value in record.items():
        if isinstance(value, dict) and value and depth:
            yield from (f"{key}.{inner}" for inner in _dotted(value, depth - 1))
        else:
            yield key
