"""The frames of a run as rows to sort and filter: one small row per frame, read from its record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from infrablend.core.dataset import finite

if TYPE_CHECKING:
    from infrablend.studio.disagreement import Disagreement

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


@dataclass(frozen=True)
class FrameRow:
    """A frame in lists; until its record is read, only the id is known.

    Attributes:
        background: Id of its background.
        image: Path of its image below `images/`.
        digest: SHA-256 of the image.
        classes: Classes of its inserts, each once, sorted.
        boxes: Boxes of its inserts, `(left, top, right, bottom)`, pixels.
        size_px: Longest side of the smallest insert's box, pixels; None without inserts.
        visibility: Least visible share of an insert.
        contrast: Least contrast of an insert, 8-bit grey levels.
        time_of_day: `day`, `night` or None.
        inserted: Number of inserts.
        removed: Original labels that the frame lost, each with a reason.
        warnings: Warnings, in words.
    """

    id: str
    background: str = ""
    image: str = ""
    digest: str = ""
    classes: tuple[str, ...] = ()
    boxes: tuple[tuple[float, float, float, float], ...] = ()
    size_px: float | None = None
    visibility: float | None = None
    contrast: float | None = None
    pitch_deg: float | None = None
    altitude_m: float | None = None
    time_of_day: str | None = None
    inserted: int = 0
    removed: tuple[Mapping[str, Any], ...] = ()
    warnings: tuple[str, ...] = ()


def row_of(record: Mapping[str, Any]) -> FrameRow:
    """Return the row of a frame's record."""
    inserted = record["inserted"]
    background = record["background"]
    corners = [finite(i["box_xyxy"]) for i in inserted]
    boxes = tuple((float(x0), float(y0), float(x1), float(y1)) for x0, y0, x1, y1 in corners)
    extra = [i.get("extra") or {} for i in inserted]
    warnings = [str(w.get("found") or w.get("code") or "warning") for w in record.get("warnings", ())]
    if unplaced := sum((record.get("scene") or {}).get("draws", {}).get("absent", {}).values()):
        warnings.append(f"{unplaced} object(s) not inserted")
    return FrameRow(
        id=str(record["frame_id"]),
        background=str(background["id"]),
        image=str(record["image"]),
        digest=str(record["image_sha256"]),
        classes=tuple(sorted({str(i["category"]) for i in inserted})),
        boxes=boxes,
        size_px=min((max(b[2] - b[0], b[3] - b[1]) for b in boxes), default=None),
        visibility=_least(i.get("visibility") for i in inserted),
        contrast=_least(abs(e["contrast_grey"]) for e in extra if "contrast_grey" in e),
        pitch_deg=background.get("pitch_deg"),
        altitude_m=background.get("altitude_m"),
        time_of_day=background.get("time_of_day"),
        inserted=len(inserted),
        removed=tuple(record.get("removed", ())),
        warnings=tuple(warnings),
    )


def _least(values: Any) -> float | None:
    return min((float(v) for v in values if v is not None), default=None)


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
            known = [(v, n) for n in found if (v := self._value(rows[n], self.sort)) is not None]
        known.sort(key=lambda pair: (-pair[0] if self.descending else pair[0], pair[1]))
        # Frames without the value come last in either order.
        listed = {n for _, n in known}
        return [n for _, n in known] + [n for n in found if n not in listed]

    def _shows(self, row: FrameRow, verdict: str) -> bool:
        if self.category and self.category not in (row.classes or ("none",)):
            return False
        if self.time_of_day and self.time_of_day != (row.time_of_day or "unknown"):
            return False
        if (self.verdict and verdict != self.verdict) or (self.warned and not row.warnings):
            return False
        if self.text.lower() not in row.id.lower():
            return False
        for name, low, high in self.limits:
            value = self._value(row, name)
            if value is None or (low is not None and value < low) or (high is not None and value > high):
                return False
        return True

    @staticmethod
    def _value(row: FrameRow, name: str) -> float | None:
        value = getattr(row, name, None)
        if isinstance(value, tuple):
            return float(len(value))
        return None if value is None or isinstance(value, str) else float(value)


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None
