"""Completes pictures as cameras write them, drones' above all, with what their own headers state about the flight.

Pitch, height, field of view, time and place of each picture come from its EXIF, XMP and FLIR block (`formats.cameras`).
What a table, an annotation or a file name states counts more. Pictures of visible light are left out, and what is
missing is asked for once per field.
"""

from __future__ import annotations

import re
import shlex
import statistics
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta

from infrablend.core.capture import Capture
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.files import open_regular
from infrablend.core.format_table import FORMATS
from infrablend.core.workspace import FRAMES_FILE, TEMPERATURES_FILE
from infrablend.errors import DatasetError, Problem
from infrablend.formats.cameras.header_facts import (
    EXIF_TIME,
    FIELDS,
    GPS_TIME,
    UNREAD,
    CameraFacts,
    Fact,
    read_facts,
    zone_of,
)
from infrablend.formats.picture_facts import pitch_note
from infrablend.formats.pictures.images import COLOUR_REMEDY, COLOURS, REFUSED_COLOUR, some_in_colour
from infrablend.formats.pictures.listing import JPEG_SUFFIXES
from infrablend.formats.values import is_place, to_time
from infrablend.thermal.daytime import time_by_sun

# Pictures whose headers are not read, and what marks headers between the pixels of some.
_UNREAD_SUFFIXES = (".tif", ".tiff", ".png", ".webp")
_MARKS = {".png": (b"eXIf", b"XML:com.adobe.xmp"), ".webp": (b"EXIF", b"XMP ")}
_MAKERS = (b"drone-dji", b"DJI", b"FLIR", b"Autel", b"Parrot", b"PARROT", b"Skydio", b"Yuneec")
# Pictures opened to decide whether a dataset comes from such a camera; all of a small one.
_LOOKED_AT = 64
_HEAD_BYTES = 65536
# A picture without a radiometric layer and this many times larger than those with one is a visible twin.
_TWIN_SIZE = 4
# Clocks that differ by this much in at least three pictures are reported; a larger gap means other flights.
_CLOCKS_S = (60.0, 25 * 3600.0)
_LEAST_PAIRS = 3
_NUMBER = re.compile(r"(\d{4,5})(?:_[A-Z]{1,4})?$", re.ASCII)
_ANY_NUMBER = re.compile(r"[+-]?\d[\d.]*(?:[eE][+-]?\d+)?", re.ASCII)
_ASKED = {
    "pitch_deg": ("camera pitch", "--set camera.pitch='{fixed_deg: 60}'", ""),
    "altitude_m": ("height above the ground", "--set camera.altitude='{fixed_m: 80}'", ""),
    "hfov_deg": (
        "field of view",
        "--set camera.model=NAME, or --set camera.focal_length_mm=MM --set camera.pixel_pitch_um=UM, of your camera",
        "",
    ),
    "time_of_day": ("time of day", "--set environment.time_of_day=day", "; else it is taken to be night, without sun"),
}
FLIGHT_MISSING = "flight-missing"
"""Code of the warning about pictures without a pitch, a height or a field of view."""
FOR_ALL = " for all pictures, also those that have one"
"""What a field of the recipe does that replaces a value which only some pictures lack."""
GIVEN = "table, annotation or file name"


def add_flight_data(dataset: Dataset) -> Dataset:
    """Return the dataset with the flight data of its pictures, or as it is if they are not from such a camera.

    `notes["flight"]` then holds the table of facts: per field and source the number of pictures and the range.
    """
    if not any(f.any_camera for f in FORMATS if f.name == dataset.format):
        return dataset
    dataset = replace(dataset, problems=(*dataset.problems, *_unread_headers(dataset)))
    jpegs = [i for i in dataset.images if _is_file(i)]
    step = max(1, len(jpegs) // _LOOKED_AT)
    sample = jpegs[::step][:_LOOKED_AT]
    looked_at = {i.id: f for i in sample if isinstance(f := _read(i), CameraFacts)}
    damaged = [i for i in sample if i.id not in looked_at]
    if not any(f.states_a_fact for f in looked_at.values()) and not any(map(_names_a_drone_camera, damaged)):
        return _with_missing(dataset)
    faults: list[Problem] = []
    facts: dict[str, CameraFacts] = {}
    for image in jpegs:
        found = looked_at.get(image.id) or _read(image)
        if isinstance(found, CameraFacts):
            facts[_key(image)] = found
            faults += found.problems
        else:
            faults.append(found)
    facts, zones_apart = with_agreed_zones(facts)
    problems = _alike_together(faults)
    for gap, names in zones_apart:
        text = f"{gap} ({len(names)} picture(s): {_some(names)})"
        todo = "correct the clock (exiftool -AllDates-=0:10) if day, night or flights matter"
        problems.append(_warning(dataset, "flight-clocks", text, "one time zone in a flight", todo))
    left_out = _left_out(dataset.images, facts)
    kept = [i for i in dataset.images if _key(i) not in left_out]
    if not kept:
        kept = list(dataset.images)
        left_out = {}
    problems += _left_out_warnings(dataset, left_out)
    facts |= {_key(i): _with_time_of_day(i, facts[_key(i)]) for i in kept if _key(i) in facts}
    images = _with_flights([_complete(i, facts.get(_key(i))) for i in kept])
    known = [facts[_key(i)] for i in kept if _key(i) in facts]
    of_drones = [f for f in facts.values() if f.from_a_drone_camera]
    problems += _missing(dataset, images) if of_drones else []
    problems += _cameras(dataset, known) + _clocks(dataset, of_drones)
    problems += _with_temperatures(dataset, [(i, facts[_key(i)]) for i in kept if _key(i) in facts])
    rows = _rows(kept, facts)
    note = {
        "pictures": len(images),
        "left_out": dict(sorted(Counter(left_out.values()).items())),
        "cameras": dict(sorted(Counter(_camera(f) for f in known).items())),
        "radiometric": sum(bool(f.raw) for f in known),
        "facts": [asdict(row) for row in rows],
    }
    pitches = pitch_note({r.source or "none": r.count for r in rows if r.field == "pitch_deg"})
    notes = {**dataset.notes, "pitch": pitches, "flight": note}
    return replace(dataset, images=tuple(images), problems=(*dataset.problems, *problems), notes=notes)


def was_extracted(dataset: Dataset) -> bool:
    """Return whether `infrablend frames` or `infrablend temperatures` wrote the dataset from a camera's files."""
    return any((dataset.root / name).is_file() for name in (FRAMES_FILE, TEMPERATURES_FILE))


def _with_missing(dataset: Dataset) -> Dataset:
    """Return a dataset without flight data of its own; that of an own flight is asked for what is missing, too."""
    if not was_extracted(dataset):
        return dataset
    return replace(dataset, problems=(*dataset.problems, *_missing(dataset, dataset.images)))


def _key(image: ImageRecord) -> str:
    return f"{image.split}/{image.id}"


def _is_file(image: ImageRecord, suffixes: Sequence[str] = JPEG_SUFFIXES) -> bool:
    """Return whether a picture is a file with one of these suffixes, and no link; a pipe would wait for ever."""
    path = image.path
    return path.suffix.lower() in suffixes and path.is_file() and not path.is_symlink()


def _names_a_drone_camera(image: ImageRecord) -> bool:
    """Return whether the head or, as TIFF has its tags there, the end of a file names the maker of a drone's camera."""
    try:
        with open_regular(image.path) as stream:
            ends = stream.read(_HEAD_BYTES)
            stream.seek(max(0, image.path.stat().st_size - _HEAD_BYTES))
            ends += stream.read(_HEAD_BYTES)
    except OSError:
        return False
    marks = _MARKS.get(image.path.suffix.lower())
    return (marks is None or any(mark in ends for mark in marks)) and any(name in ends for name in _MAKERS)


def _unread_headers(dataset: Dataset) -> list[Problem]:
    """Return a warning if files of a camera that are no JPEG may state the pitch or height that their records lack."""
    lacking = [i for i in dataset.images if i.capture.pitch_deg is None or i.capture.altitude_m is None]
    others = [i for i in lacking if _is_file(i, _UNREAD_SUFFIXES)]
    if was_extracted(dataset) or not any(map(_names_a_drone_camera, others[:: max(1, len(others) // _LOOKED_AT)])):
        return []
    found = f"{len(others)} picture(s) in TIFF, PNG or WebP of a drone's camera, whose EXIF and XMP are not read, lens "
    found += f"and place included: {_some([i.name for i in others])}"
    todo = "give pitch_deg, altitude_m and hfov_deg in metadata.csv; exiftool -csv lists what the files state"
    return [_warning(dataset, UNREAD, found, "the camera's JPEG files, or a table", todo)]


def _read(image: ImageRecord) -> CameraFacts | Problem:
    try:
        return read_facts(image.path)
    except DatasetError as error:
        fault = error.problems[0]
        return replace(fault, found=f"{fault.found}; its flight data are not read", severity="warning")


# ---- Leaving pictures out


def _left_out(images: Sequence[ImageRecord], facts: Mapping[str, CameraFacts]) -> dict[str, str]:
    """Return the reason for each picture that is not thermal; none if nothing shows which pictures are thermal."""
    if not any(f.thermal for f in facts.values()):
        return {}
    largest = max((_pixels(f) for f in facts.values() if f.raw), default=0)
    reasons = {}
    for image in images:
        f = facts.get(_key(image))
        if f is None or f.thermal or image.instances:
            continue
        if f.visible:
            reasons[_key(image)] = f"visible light ({f.visible})"
        elif f.camera and not f.from_a_drone_camera:
            reasons[_key(image)] = f"of another camera ({f.camera})"
        elif largest and _pixels(f) >= _TWIN_SIZE * largest:
            reasons[_key(image)] = "visible light (far larger than the thermal pictures)"
    return reasons


def _pixels(f: CameraFacts) -> int:
    return f.size_wh[0] * f.size_wh[1]


def _left_out_warnings(dataset: Dataset, left_out: Mapping[str, str]) -> list[Problem]:
    by_reason: dict[str, list[str]] = defaultdict(list)
    for key, reason in left_out.items():
        by_reason[reason].append(key.rpartition("/")[2])
    return [
        _warning(dataset, "flight-left-out", f"{len(names)} picture(s) left out: {reason}; {_some(names)}", "")
        for reason, names in sorted(by_reason.items())
    ]


def _alike_together(faults: Sequence[Problem]) -> list[Problem]:
    """Return one problem for the same kind of fault in many pictures, so that a flight's do not hide the others."""
    groups: dict[tuple[str, str, str, str], list[Problem]] = defaultdict(list)
    for fault in faults:
        # Numbers apart, which are those of one picture: a tag's names hold none.
        groups[fault.code, _ANY_NUMBER.sub("", fault.found), fault.expected, fault.todo].append(fault)
    together = []
    for first, *others in groups.values():
        more = f"; so in {len(others)} more: {_some([p.where for p in others])}" if others else ""
        together.append(replace(first, found=first.found + more))
    return together


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _warning(dataset: Dataset, code: str, found: str, expected: str, todo: str = "") -> Problem:
    return Problem(dataset.root.name, code, found, expected, todo, "warning")


# ---- Completing records


def _complete(image: ImageRecord, f: CameraFacts | None) -> ImageRecord:
    if f is None:
        return image
    stated = Capture.from_json({name: fact.value for name, fact in f.facts.items()}, strict=False)
    if image.capture.altitude_m is None and stated.altitude_m is not None:
        stated = replace(stated, altitude_from="laser" if "LRF" in f.facts["altitude_m"].source else "take-off")
    if image.capture.yaw_deg is not None:
        # A heading that somebody gives counts more than any in the file.
        stated = replace(stated, flight_yaw_deg=None)
    known = replace(image.capture.over(stated), camera=f.camera or image.capture.camera)
    return replace(image, size_wh=image.size_wh or f.size_wh, capture=known)


def _with_time_of_day(image: ImageRecord, f: CameraFacts) -> CameraFacts:
    """Return the facts with the time of day by the sun, at the time and place that count."""
    known = image.capture.over(Capture.from_json({name: fact.value for name, fact in f.facts.items()}, strict=False))
    by_sun = time_of_day(known.captured, known.latitude_deg, known.longitude_deg)
    return f if by_sun is None else replace(f, facts={**f.facts, "time_of_day": by_sun})


def time_of_day(captured: str | None, latitude: float | None, longitude: float | None) -> Fact | None:
    """Return the time of day by the sun, with what it rests on; None if time or place are unknown.

    Args:
        captured: Time, ISO 8601; without a zone it is local time.
        latitude: Degrees north.
        longitude: Degrees east.
    """
    if latitude is None or longitude is None or not is_place(latitude, longitude):
        return None
    found = time_by_sun(captured, latitude, longitude)
    return None if found is None else Fact(*found)


def _with_flights(images: Sequence[ImageRecord]) -> list[ImageRecord]:
    """Return the records with a flight each: pictures of a folder and camera without a break of ten minutes."""
    groups: dict[tuple[str, str], list[tuple[datetime, int]]] = defaultdict(list)
    for k, image in enumerate(images):
        when = _naive(image.capture.captured)
        if image.capture.sequence is None and when is not None:
            groups[str(image.path.parent), image.capture.camera or ""].append((when, k))
    flights: dict[int, str] = {}
    for times in groups.values():
        start = None
        last = None
        for when, k in sorted(times):
            if last is None or (when - last).total_seconds() > BREAK_S:
                start = when
            last = when
            assert start is not None
            flights[k] = f"flight-{start:%Y%m%d-%H%M%S}"
    return [
        replace(i, capture=replace(i.capture, sequence=flights[k])) if k in flights else i for k, i in enumerate(images)
    ]


def _naive(captured: str | None) -> datetime | None:
    """Return a time of capture without its time zone; None for a date alone."""
    when = to_time(captured) if captured is not None and len(captured) > 10 else None
    return when.replace(tzinfo=None) if when else None


# ---- What is missing, and what does not fit together


def _missing(dataset: Dataset, images: Sequence[ImageRecord]) -> list[Problem]:
    problems = []
    for name, (title, setting, default) in _ASKED.items():
        lacking = [i.name for i in images if getattr(i.capture, name) is None]
        if lacking:
            found = f"{title} missing in {len(lacking)} of {len(images)} pictures: {_some(lacking)}"
            todo = f"give a column {name} in metadata.csv, or {setting}"
            todo += (FOR_ALL if len(lacking) < len(images) else "") + default
            problems.append(_warning(dataset, FLIGHT_MISSING, found, "it in EXIF or XMP, or from you", todo))
    return problems


def _with_temperatures(dataset: Dataset, known: Sequence[tuple[ImageRecord, CameraFacts]]) -> list[Problem]:
    makers = [f.raw for _, f in known if f.raw]
    if not makers:
        return []
    which = " and ".join(sorted(set(makers)))
    found = f"{len(makers)} of {len(known)} pictures are radiometric ({which}), but read as plain pictures"
    layers = shlex.quote(f"{dataset.root.resolve().name}_k")
    command = f"infrablend temperatures {shlex.quote(str(dataset.root))} --out {layers} and take {layers} as data"
    todo = f"go on if the grey levels suffice: the temperatures are not used; to use them, run {command}"
    expected = "pictures whose grey levels are all that is needed"
    looked_at = some_in_colour([i.path for i, f in known if f.raw])
    if any(looked_at.values()):
        found += f"; {sum(looked_at.values())} of {len(looked_at)} that were looked at are {COLOURS}; {REFUSED_COLOUR}"
        todo = f"run {command}; or {COLOUR_REMEDY}, or use appearance.mode: artistic for a palette"
    return [_warning(dataset, "image-radiometric", found, expected, todo)]


def _camera(f: CameraFacts) -> str:
    fov = f.value("hfov_deg")
    return f"{f.camera or 'unknown'}, {f.size_wh[0]}x{f.size_wh[1]}" + ("" if fov is None else f", {fov:.1f} degrees")


def _cameras(dataset: Dataset, known: Sequence[CameraFacts]) -> list[Problem]:
    if len({(f.camera, f.size_wh) for f in known}) < 2:
        return []
    counts = Counter(_camera(f) for f in known)
    found = "pictures of several cameras: " + "; ".join(f"{c} ({n})" for c, n in sorted(counts.items()))
    todo = "put each camera's pictures into a folder of their own, with a sensor profile each"
    return [_warning(dataset, "flight-cameras", found, "one camera", todo)]


def _clocks(dataset: Dataset, facts: Iterable[CameraFacts]) -> list[Problem]:
    """Return warnings about clocks that disagree, within a file and between cameras that took the same numbers."""
    problems = []
    apart: dict[int, list[str]] = defaultdict(list)
    numbered: dict[str, dict[str, datetime]] = defaultdict(dict)
    for f in facts:
        times = sorted(f.clocks.values())
        if times and (times[-1] - times[0]).total_seconds() >= _CLOCKS_S[0]:
            apart[round((times[-1] - times[0]).total_seconds() / 60)].append(f.path.name)
        number = _NUMBER.search(f.path.stem.upper())
        if times and number:
            numbered[_lens(f)].setdefault(number[1], times[0])
    for minutes, names in sorted(apart.items()):
        found = f"clocks {_minutes(minutes)} apart inside {len(names)} picture(s): {_some(names)}"
        problems.append(_warning(dataset, "flight-clocks", f"{found}; EXIF DateTimeOriginal is used", "one time"))
    lenses = sorted(numbered)
    for k, one in enumerate(lenses):
        for other in lenses[k + 1 :]:
            both = numbered[one].keys() & numbered[other].keys()
            gaps = [(numbered[other][n] - numbered[one][n]).total_seconds() for n in sorted(both)]
            if len(gaps) >= _LEAST_PAIRS and _CLOCKS_S[0] <= abs(statistics.median(gaps)) <= _CLOCKS_S[1]:
                found = f"the clocks of {one} and {other} are {_minutes(round(statistics.median(gaps) / 60))} apart"
                todo = "compare captures by number instead of time, or correct one clock (exiftool -AllDates+=1)"
                found += f" in pictures with the same numbers ({len(gaps)})"
                problems.append(_warning(dataset, "flight-clocks", found, "one clock", todo))
    return problems


def _lens(f: CameraFacts) -> str:
    return f"{f.camera or 'an unknown camera'} ({f.size_wh[0]}x{f.size_wh[1]})"


def _minutes(minutes: int) -> str:
    return f"{abs(minutes) // 60}:{abs(minutes) % 60:02d} h"


# ---- The table


@dataclass(frozen=True)
class FactRow:
    """One row of the table of facts: how many pictures have a fact from a source.

    Attributes:
        field: Name of the fact.
        source: Tag or tags that it comes from; empty for pictures that lack it.
        count: Number of pictures.
        lowest: Smallest value; None for missing facts.
        highest: Largest value; None for missing facts.
    """

    field: str
    source: str
    count: int
    lowest: float | str | None = None
    highest: float | str | None = None


def _rows(given: Sequence[ImageRecord], facts: Mapping[str, CameraFacts]) -> list[FactRow]:
    """Return the table of facts; `given` are the records as read, without facts from the pictures."""
    rows = []
    for name in FIELDS:
        values: dict[str, list[float | str]] = defaultdict(list)
        lacking = 0
        for image in given:
            own = getattr(image.capture, name, None)
            f = facts.get(_key(image))
            fact = None if f is None else f.facts.get(name)
            if own is not None:
                values[GIVEN].append(own)
            elif fact is not None:
                values[fact.source].append(fact.value)
            else:
                lacking += 1
        rows += [FactRow(name, source, len(v), min(v), max(v)) for source, v in sorted(values.items())]
        rows += [FactRow(name, "", lacking)] if lacking else []
    return rows


BREAK_S = 600.0
"""A longer break between two pictures starts another flight."""


@dataclass(frozen=True)
class _Picture:
    """A picture that states its time by two clocks: its key, and the times, both without time zone."""

    key: str
    local: datetime
    utc: datetime


def with_agreed_zones(facts: Mapping[str, CameraFacts]) -> tuple[dict[str, CameraFacts], list[tuple[str, list[str]]]]:
    """Return the facts with one time zone per flight, and what disagrees, each with the names of its pictures.

    DJI's cameras state the local time and that in UTC. All pictures of a flight have one zone, that of most of them;
    where the local clock says otherwise, the time is that in UTC, in the zone of the flight.
    """
    changed: dict[str, CameraFacts] = {}
    apart: dict[str, list[str]] = defaultdict(list)
    for flight in _flights(facts):
        zones = Counter(z for p in flight if (z := zone_of(p.local, p.utc)) is not None)
        zone = zones.most_common(1)[0][0] if zones else None
        for p in flight:
            if zone is not None and zone_of(p.local, p.utc) == zone:
                continue
            f = facts[p.key]
            tag = re.split("[: ]", f.utc_tag)[-1]
            text = f"EXIF DateTimeOriginal is {_hours(p.local - p.utc)} ahead of {tag}"
            if zone is not None:
                when = p.utc.replace(tzinfo=UTC).astimezone(zone)
                changed[p.key] = replace(f, facts={**f.facts, "captured": Fact(when.isoformat(), f.utc_tag)})
                text += f", but {_hours(zone.utcoffset(None))} in the rest of the flight; {tag} is used"
            else:
                text += f", which is no time zone; {tag if f.utc_tag == GPS_TIME else 'EXIF'} is used"
            apart[text].append(f.path.name)
    return {**facts, **changed}, sorted(apart.items())


def _flights(facts: Mapping[str, CameraFacts]) -> Iterator[Sequence[_Picture]]:
    """Yield the pictures of each folder and camera without a longer break, by UTC."""
    groups: dict[tuple[str, str], list[_Picture]] = defaultdict(list)
    for key, f in facts.items():
        if f.utc is not None and (local := f.clocks.get(EXIF_TIME)) is not None:
            groups[str(f.path.parent), f.camera].append(_Picture(key, local, f.utc))
    for pictures in groups.values():
        flight: list[_Picture] = []
        for p in sorted(pictures, key=lambda p: (p.utc, p.key)):
            if flight and (p.utc - flight[-1].utc).total_seconds() > BREAK_S:
                yield flight
                flight = []
            flight.append(p)
        yield flight


def _hours(gap: timedelta) -> str:
    minutes = round(gap.total_seconds() / 60)
    return f"{'-' if minutes < 0 else ''}{abs(minutes) // 60}:{abs(minutes) % 60:02d} h"
