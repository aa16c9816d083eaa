"""The frames of a run as rows to sort and filter."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from infrablend.core.frame_row import FrameRow

if TYPE_CHECKING:
    from infrablend.studio.run_labels import Disagreement

SORTS: Mapping[str, str] = {
    "id": "Name",
    "size_px": "Size of the smallest insert",
    "visibility": "Visible share",
    "contrast": "Contrast",
    "pitch_deg": "Pitch",
    "altitude_m": "Height",
    "inserted": "Number of inserts",
    "removed": "Removed labels",
    "warnings": "Warnings",
    "disagreement": "Detector disagrees",
}
"""Columns to sort by, with their names in the page."""

NONE: Mapping[str, Disagreement] = {}


def value_of(row: FrameRow, name: str) -> float | None:
    """Return what frames are sorted by in a column of `SORTS`; None if it is not known."""
    if name == "warnings":
        return len(row.remarks)
    if name == "inserted":
        return len(row.inserts)
    if name == "removed":
        return len(row.removed)
    value: float | None = getattr(row, name)
    return value


@dataclass(frozen=True)
class View:
    """The frames that a list shows, and their order.

    Attributes:
        sort: One of `SORTS`.
        descending: Whether the largest come first.
        category: Class of inserts that frames must have; empty for any. `none` keeps frames without inserts.
        time_of_day: `day`, `night`, `unknown`, or empty for any.
        verdict: `accept`, `reject`, `open`, or empty for any.
        warned: Whether frames must have a warning.
        text: Text that ids must contain.
        limits: Smallest and largest value of columns, by name; frames without the value are left out.
    """

    sort: str = "id"
    descending: bool = False
    category: str = ""
    time_of_day: str = ""
    verdict: str = ""
    warned: bool = False
    text: str = ""
    limits: tuple[tuple[str, float | None, float | None], ...] = ()

    @classmethod
    def from_query(cls, query: Mapping[str, str]) -> View:
        """Return the view in an address; what it does not know is left out."""
        ends = {name: (query.get(f"{name}_min"), query.get(f"{name}_max")) for name in SORTS}
        limits = tuple((name, _number(low), _number(high)) for name, (low, high) in ends.items() if low or high)
        return cls(
            query["sort"] if query.get("sort") in SORTS else "id",
            query.get("descending") == "1",
            query.get("category", ""),
            query.get("time_of_day", ""),
            query.get("verdict", ""),
            query.get("warned") == "1",
            query.get("text", ""),
            limits,
        )

    def to_query(self) -> dict[str, str]:
        """Return the view for an address; the inverse of `from_query`."""
        found = {k: str(getattr(self, k)) for k in ("category", "time_of_day", "verdict", "text")}
        found["sort"] = "" if self.sort == "id" else self.sort
        found |= {k: "1" for k in ("descending", "warned") if getattr(self, k)}
        for name, low, high in self.limits:
            found |= {f"{name}_{end}": f"{v:g}" for end, v in (("min", low), ("max", high)) if v is not None}
        return {k: v for k, v in found.items() if v}

    @property
    def needs_names_only(self) -> bool:
        """Whether the ids of the frames and the verdicts decide what is shown."""
        return self.sort == "id" and not (self.category or self.time_of_day or self.warned or self.limits)

    def apply(
        self, rows: Sequence[FrameRow], verdicts: Mapping[str, str], disagreement: Mapping[str, Disagreement] = NONE
    ) -> list[int]:
        """Return the numbers of the rows to show, in order.

        Args:
            rows: All rows.
            verdicts: `accept` or `reject` by frame id.
            disagreement: Disagreement of a detector by image.
        """
        found = [n for n, row in enumerate(rows) if self._shows(row, verdicts.get(row.id, "open"))]
        if self.sort == "id":
            return found[::-1] if self.descending else found
        if self.sort == "disagreement":
            known = [(float(d.total), n) for n in found if (d := disagreement.get(rows[n].image)) is not None]
        else:
            known = [(v, n) for n in found if (v := value_of(rows[n], self.sort)) is not None]
        known.sort(key=lambda pair: (-pair[0] if self.descending else pair[0], pair[1]))
        # Frames without the value come last in either order.
        listed = {n for _, n in known}
        return [n for _, n in known] + [n for n in found if n not in listed]

    def _shows(self, row: FrameRow, verdict: str) -> bool:
        if self.category and self.category not in (row.classes or ["none"]):
            return False
        if self.time_of_day and self.time_of_day != (row.time_of_day or "unknown"):
            return False
        if (self.verdict and verdict != self.verdict) or (self.warned and not row.remarks):
            return False
        if self.text.lower() not in row.id.lower():
            return False
        for name, low, high in self.limits:
            value = value_of(row, name)
            if value is None or (low is not None and value < low) or (high is not None and value > high):
                return False
        return True


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None
