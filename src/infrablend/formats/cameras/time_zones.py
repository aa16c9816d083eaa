"""Finds the time zone of each flight, and the pictures whose clock does not fit it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

from infrablend.formats.cameras.header_facts import EXIF_TIME, UTC_TAG, CameraFacts, Fact, zone_of

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
            text = f"EXIF DateTimeOriginal is {_hours(p.local - p.utc)} ahead of UTCAtExposure"
            if zone is not None:
                when = p.utc.replace(tzinfo=UTC).astimezone(zone)
                changed[p.key] = replace(f, facts={**f.facts, "captured": Fact(when.isoformat(), UTC_TAG)})
                text += f", but {_hours(zone.utcoffset(None))} in the rest of the flight; UTCAtExposure is used"
            else:
                text += ", which is no time zone; EXIF is used"
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
