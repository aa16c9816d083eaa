"""The drone's telemetry in MONET's records: where it is found, what it means, and which sign looks down."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypedDict, TypeVar

from infrablend.core.dataset import ImageRecord
from infrablend.core.json_records import is_list
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import shorten
from infrablend.formats.picture_facts import Captures
from infrablend.formats.published.monet.folders import MonetOptions, below_split
from infrablend.formats.records import table_of
from infrablend.formats.values import to_key, to_number, to_time

# Object in an image record that takes the telemetry if the source had none.
NEST = "metadata"
Place = tuple[str, ...]
T = TypeVar("T")
# A gimbal that points straight down sometimes reads slightly beyond 90 degrees.
BEYOND_DEG = 1.0


def _places(record: Mapping[str, object], keys: Sequence[str]) -> Iterator[Place]:
    """Yield the places of the keys: as dotted path, in the record itself, in an object one level deeper."""
    for key in keys:
        path = tuple(key.split("."))
        if len(path) > 1 and _at(record, path) is not None:
            yield path
        if key in record:
            yield (key,)
        for nest, inside in sorted(record.items()):
            if isinstance(inside, dict) and key in inside:
                yield nest, key


def _at(record: Mapping[str, object], place: Place) -> object:
    value: object = record
    for key in place:
        if not isinstance(value, dict):
            return None
        value = value.get(key)
    return value


def _find(
    record: Mapping[str, object], keys: Sequence[str], read: Callable[[object], T | None]
) -> tuple[Place | None, object]:
    """Return the first place with a readable value, else the first with a value, else the first; and its value."""
    best: tuple[int, Place | None, object] = (0, None, None)
    for place in _places(record, keys):
        value = _at(record, place)
        rank = 1 if value in (None, "", [], {}) else 2 if read(value) is None else 3
        if rank > best[0]:
            best = rank, place, value
    return best[1], best[2] if best[0] > 1 else None


def join_lists(top: Mapping[str, object]) -> dict[int | str, dict[str, object]]:
    """Return, per image id, the objects of top-level lists other than annotations: telemetry beside the images."""
    joined: dict[int | str, dict[str, object]] = defaultdict(dict)
    for name, entries in sorted(top.items()):
        if name in ("images", "annotations", "categories", "licenses") or not is_list(entries):
            continue
        for entry in entries:
            number = to_key(entry.get("image_id")) if isinstance(entry, dict) else None
            if number is not None:
                joined[number][name] = {k: v for k, v in entry.items() if k != "image_id"}
    return joined


def _iso_time(value: object) -> str | None:
    when = to_time(value)
    return when.isoformat() if when else None


class Telemetry(TypedDict, total=False):
    """Where an image record states its telemetry, and how: kept in `ImageRecord.extra` for writing."""

    pitch: Place | None
    altitude: Place | None
    time: Place | None
    radians: bool
    sign: int


@dataclass(slots=True)
class Frame:
    """A picture whose telemetry has been found but not yet interpreted."""

    record: ImageRecord
    where: str
    raw_deg: float | None
    altitude_m: float | None
    sequence: str | None


@dataclass(slots=True)
class UnusableValues:
    """Unusable values of one file: their number, and the first few."""

    counts: Counter[str] = field(default_factory=Counter)
    shown: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))

    def add(self, what: str, text: str) -> None:
        """Count one unusable value."""
        self.counts[what] += 1
        if len(self.shown[what]) < 3:
            self.shown[what].append(text)

    def problems(self, where: str, expected: Mapping[str, str]) -> list[Problem]:
        """Return one warning per kind of value."""
        return [
            Problem(
                where, "metadata-value", f"{n} image(s) with {what} {', '.join(self.shown[what])}, ignored",
                expected[what], "correct the file, or leave it", "warning",
            )
            for what, n in sorted(self.counts.items())
        ]  # fmt: skip


def frame_of(
    record: ImageRecord, where: str, fields: dict[str, object], chosen: MonetOptions, tally: UnusableValues
) -> Frame:
    """Return a picture with its telemetry; unusable values are counted."""
    here = f"(image {record.source_id})"
    pitch_at, pitch = _find(fields, chosen.pitch, to_number)
    altitude_at, altitude = _find(fields, chosen.altitude, to_number)
    time_at, time = _find(fields, chosen.time, _iso_time)
    raw = to_number(pitch)
    if raw is not None and chosen.radians:
        raw = math.degrees(raw)
    if pitch is not None and (raw is None or abs(raw) > 90 + BEYOND_DEG):
        tally.add("pitch", f"{_show(pitch)} {here}")
        raw = None
    metres = to_number(altitude)
    if altitude is not None and (metres is None or not 0 <= metres <= 1e5):
        tally.add("altitude", f"{_show(altitude)} {here}")
        metres = None
    captured = _iso_time(time)
    if time is not None and captured is None:
        tally.add("time", f"{_show(time)} {here}")
    places = Telemetry(pitch=pitch_at, altitude=altitude_at, time=time_at, radians=chosen.radians)
    extra = {**record.extra, "fields": fields, "telemetry": places}
    known = replace(record.capture, captured=captured, time_of_day=chosen.time_of_day or record.capture.time_of_day)
    kept = replace(record, capture=known, extra=extra, file_name=below_split(record.name))
    return Frame(kept, where, raw, metres, known.sequence)


def _show(value: object) -> str:
    return ascii(value)[:40]


def set_pitches(root: Path, frames: list[Frame], chosen: MonetOptions, problems: list[Problem]) -> dict[str, object]:
    """Decide which sign looks down, convert all pitches to depression angles, and check the result per file."""
    raw = [f.raw_deg for f in frames if f.raw_deg is not None]
    below = sum(v < 0 for v in raw)
    above = sum(v > 0 for v in raw)
    keys = sorted({".".join(f.record.extra["telemetry"]["pitch"]) for f in frames if f.raw_deg is not None})
    name = ", ".join(keys)
    todo = "add --read pitch_sign=-1 (negative looks down) or pitch_sign=+1"
    if chosen.sign is None and raw and below == above and below > 0:
        found = f"{below} values of {name} below 0 and the same number above"
        problem = Problem(str(root), "pitch-sign", found, "most frames look down", todo)
        raise DatasetError(f"{root}: the sign of the gimbal pitch that looks down cannot be determined", [problem])
    sign = chosen.sign if chosen.sign is not None else -1 if below >= above else 1
    upward: Counter[str] = Counter()
    known: Counter[str] = Counter()
    clamped = 0
    for f in frames:
        if f.raw_deg is None:
            pitch = f.record.capture.pitch_deg
        else:
            # Avoids -0.0 for a level camera.
            pitch = sign * f.raw_deg + 0.0
            clamped += abs(pitch) > 90
            pitch = max(-90.0, min(90.0, pitch))
            upward[f.where] += pitch < 0
            known[f.where] += 1
        altitude = f.record.capture.altitude_m if f.altitude_m is None else f.altitude_m
        extra = {**f.record.extra, "telemetry": f.record.extra["telemetry"] | {"sign": sign}}
        capture = replace(f.record.capture, pitch_deg=pitch, altitude_m=altitude)
        f.record = replace(f.record, capture=capture, extra=extra)
    if chosen.sign is None:
        wrong = [w for w in sorted(known) if 2 * upward[w] > known[w]]
    else:
        wrong = ["all files"] if 2 * sum(upward.values()) > sum(known.values()) else []
        upward["all files"], known["all files"] = sum(upward.values()), sum(known.values())
    if wrong:
        faults = [
            Problem(w, "pitch-sign", f"{upward[w]} of {known[w]} cameras look up with pitch = {'+-'[sign < 0]}{name}",
                    "most cameras look down", todo)
            for w in wrong
        ]  # fmt: skip
        raise DatasetError(f"{root}: more than half of the pitches are negative", shorten(faults))
    said = f"pitch = {'+-'[sign < 0]}{name}: {below} values below 0, {above} above"
    if chosen.sign is None and raw:
        problems.append(
            Problem(root.name, "pitch-sign", said, "most frames look down",
                    f"if that is wrong, {todo}; either one silences this warning", "warning")
        )  # fmt: skip
    if not chosen.radians and len(raw) >= 10 and 0 < max(map(abs, raw)) <= math.pi / 2:
        found = f"all {len(raw)} values of {name} are within {max(map(abs, raw)):.4g}, as if in radians"
        problems.append(
            Problem(
                root.name, "pitch-unit", found, "degrees", "if they are radians, add --read angle_unit=rad", "warning"
            )
        )
    return {
        "key": name, "unit": "rad" if chosen.radians else "deg", "sign": sign,
        "sign_from": "majority" if chosen.sign is None else "pitch_sign", "below_0": below, "above_0": above,
        "missing": len(frames) - len(raw), "beyond_90_clamped": clamped,
    }  # fmt: skip


def apply_table(
    root: Path, metadata: Path | None, frames: Sequence[Frame], problems: list[Problem]
) -> tuple[Captures, str | None]:
    """Let a table complete or override the telemetry; return the sources of pitches and the table's name."""
    table, name = table_of(root, metadata)
    captures = Captures(table, problems)
    for f in frames:
        r = f.record
        f.record = replace(r, capture=captures.of(r.name, f"{r.split}/{r.name}", r.capture))
    if table is not None:
        problems += table.problems
        sequences = {f.record.capture.sequence for f in frames}
        problems += table.remarks(root, [f.record.name for f in frames], sequences)
    return captures, name["table"]


def require_pitch(root: Path, frames: Sequence[Frame], chosen: MonetOptions, problems: Sequence[Problem]) -> None:
    """Raise an error that lists the existing keys if no frame has a pitch: probably it has another key."""
    if any(f.record.capture.pitch_deg is not None for f in frames):
        return
    keys = {k for f in frames[:1000] for k in _dotted(f.record.extra["fields"])}
    there = ", ".join(sorted(keys)[:40]) or "no other keys"
    found = f"no {' or '.join(chosen.pitch)} with a value; image records contain {there}"
    todo = "name the key with --read pitch_key=KEY, or keep images without pitch with --read empty=keep"
    problem = Problem(str(root), "no-telemetry", found, "the gimbal pitch in image records", todo)
    raise DatasetError(f"{root}: no telemetry in {len(frames)} image(s)", [problem, *shorten(problems)])


def _dotted(record: Mapping[str, object], depth: int = 4) -> Iterator[str]:
    """Yield the keys of a record and of its nested objects, as the options accept them."""
    for key, value in record.items():
        if isinstance(value, dict) and value and depth:
            yield from (f"{key}.{inner}" for inner in _dotted(value, depth - 1))
        else:
            yield key
