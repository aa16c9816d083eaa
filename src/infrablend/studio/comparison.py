"""Two runs, or two recipes on the same backgrounds, frame by frame: which frames belong together, and what differs."""

from __future__ import annotations

import math
import re
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from infrablend.core.frame_row import FrameRow
from infrablend.studio.frame_index import value_of
from infrablend.studio.opened_run import RunFrames
from infrablend.studio.page_pictures import to_png

if TYPE_CHECKING:
    from infrablend.core.dataset import ImageRecord
    from infrablend.studio.tuning import Tuned, Tuning

MEASURES: Mapping[str, str] = {
    "inserted": "Number of inserts",
    "size_px": "Size of the smallest insert",
    "visibility": "Visible share",
    "contrast": "Contrast",
}
"""What is compared, with its name in the page."""

SORTS: Mapping[str, str] = {"difference": "Difference", **MEASURES, "id": "Name"}

# One object more or less counts as much as twice the size, half of the visible share, or 20 grey levels.
_WEIGHTS = {"inserted": 1.0, "size_px": 1.0, "visibility": 2.0, "contrast": 0.05}
_CONFIGURATION = re.compile(r"_(c\d+)$", re.ASCII)
_KEPT = 24


@dataclass(frozen=True)
class FramePair:
    """A frame of two runs, or of one of them.

    Attributes:
        id: Background and configuration, such as `test/a_c0`.
        a: Number of the frame in the first run; None if it has none.
        b: Number in the second run.
        changes: Second minus first value by measure; a size is given as the logarithm to base 2 of the ratio.
        same: Whether both pictures have the same bytes; None if that is not known.
    """

    id: str
    a: int | None
    b: int | None
    changes: Mapping[str, float] = field(default_factory=dict)
    same: bool | None = None

    @property
    def difference(self) -> float:
        """Sum of all changes, each in the unit of its measure."""
        return sum(_WEIGHTS[name] * abs(change) for name, change in self.changes.items())


def pair_id(row: FrameRow) -> str:
    """Return what the frames of one background and configuration share, whatever folders a run sorts them into."""
    split = row.id.partition("/")[0]
    configuration = _CONFIGURATION.search(row.id)
    return f"{split}/{row.background}" + (f"_{configuration[1]}" if configuration else "") if row.background else row.id


def pair_rows(first: Sequence[FrameRow], second: Sequence[FrameRow]) -> list[FramePair]:
    """Return the frames of two runs, matched by background and configuration, in the order of their ids."""
    a, b = ({pair_id(row): n for n, row in enumerate(rows)} for rows in (first, second))
    found = []
    for key in sorted({*a, *b}):
        n, m = a.get(key), b.get(key)
        if n is None or m is None:
            found.append(FramePair(key, n, m))
        else:
            same = bool(first[n].digest) and first[n].digest == second[m].digest
            found.append(FramePair(key, n, m, changes_of(first[n], second[m]), same))
    return found


def changes_of(a: FrameRow, b: FrameRow) -> dict[str, float]:
    """Return what differs between two frames, by measure; a measure that one of them lacks is left out."""
    found = {}
    for name in MEASURES:
        before, after = value_of(a, name), value_of(b, name)
        if before is None or after is None:
            continue
        is_ratio = name == "size_px"
        change = math.log2(max(after, 0.1) / max(before, 0.1)) if is_ratio else after - before
        if abs(change) > 1e-6:
            found[name] = float(change)
    return found


@dataclass(frozen=True)
class PairView:
    """The pairs that the list shows, and their order.

    Attributes:
        side: `both`, `a` or `b`: frames in both runs, or in one only.
        sort: One of `SORTS`; the largest change comes first.
        text: Text that ids must contain.
        changed: Whether to leave out pairs whose pictures are equal.
    """

    side: str = "both"
    sort: str = "difference"
    text: str = ""
    changed: bool = False

    @classmethod
    def from_query(cls, query: Mapping[str, str]) -> PairView:
        """Return the view in an address; what it does not know is left out."""
        side = query.get("side", "")
        sort = query.get("sort", "")
        return cls(
            side if side in ("a", "b") else "both",
            sort if sort in SORTS else "difference",
            query.get("text", ""),
            query.get("changed") == "1",
        )

    def to_query(self) -> dict[str, str]:
        """Return the view for an address; the inverse of `from_query`."""
        return {"side": self.side, "sort": self.sort, "text": self.text, "changed": str(int(self.changed))}

    def apply(self, pairs: Sequence[FramePair]) -> list[int]:
        """Return the numbers of the pairs to show, in order."""
        found = [n for n, pair in enumerate(pairs) if self._shows(pair)]
        if self.sort == "difference":
            found.sort(key=lambda n: -pairs[n].difference)
        elif self.sort != "id":
            found.sort(key=lambda n: -abs(pairs[n].changes.get(self.sort, 0.0)))
        return found

    def _shows(self, pair: FramePair) -> bool:
        side = "b" if pair.a is None else "a" if pair.b is None else "both"
        return side == self.side and self.text.lower() in pair.id.lower() and not (self.changed and pair.same)


class RunComparison:
    """Two runs whose frames can be shown beside each other.

    Attributes:
        runs: The runs.
    """

    def __init__(self, first: RunFrames, second: RunFrames) -> None:
        self.runs = first, second

    @property
    def names(self) -> tuple[str, str]:
        """Names of the runs' folders; with those around them where they are equal."""
        first, second = (run.layout.root.resolve() for run in self.runs)
        if first.name != second.name:
            return first.name, second.name
        return f"{first.parent.name}/{first.name}", f"{second.parent.name}/{second.name}"

    def pairs(self) -> list[FramePair]:
        """Return all pairs; waits until all records are read."""
        first, second = self.runs
        return pair_rows(first.rows, second.rows)

    def rows(self, pair: FramePair) -> tuple[FrameRow | None, FrameRow | None]:
        """Return the facts on both frames."""
        first, second = self.runs
        return None if pair.a is None else first.row(pair.a), None if pair.b is None else second.row(pair.b)

    def picture(self, side: int, number: int, *, boxes: bool, originals: bool) -> bytes:
        """Return the PNG of a frame of one side, 0 or 1.

        Raises:
            DatasetError: There is no such frame, or it cannot be read.
        """
        return self.runs[side].picture(number, boxes=boxes, originals=originals)


class RecipeComparison:
    """Two recipes on the same backgrounds, drawn when they are looked at.

    Attributes:
        names: Names of the recipes.
        runs: No runs.
    """

    runs = ()

    def __init__(self, tuning: Tuning, second: str) -> None:
        """Compare the recipe being tuned, as it is in its file, with a second one.

        Raises:
            RecipeError: The second recipe cannot be used.
        """
        tuning.read(second, {})
        self._tuning = tuning
        self.names = (tuning.recipe, second)
        self._lock = threading.Lock()
        self._drawn: OrderedDict[tuple[int, int], Tuned] = OrderedDict()
        self._rows: dict[tuple[int, int], FrameRow] = {}

    def pairs(self) -> list[FramePair]:
        """Return a pair per background; what differs is known of those that were drawn."""
        return [self._pair(n, image) for n, image in enumerate(self._tuning.backgrounds)]

    def rows(self, pair: FramePair) -> tuple[FrameRow | None, FrameRow | None]:
        """Return the facts on both frames, drawn now if need be.

        Raises:
            InfraBlendError: A recipe or the background cannot be used.
        """
        number = pair.a or 0
        for side in (0, 1):
            if (side, number) not in self._rows:
                self._draw(side, number)
        return self._rows[0, number], self._rows[1, number]

    def picture(self, side: int, number: int, *, boxes: bool, originals: bool) -> bytes:
        """Return the PNG of a frame of one side, 0 or 1.

        Raises:
            InfraBlendError: The recipe or the background cannot be used.
        """
        return to_png(self._draw(side, number).labelled(inserts=boxes, originals=originals))

    def _draw(self, side: int, number: int) -> Tuned:
        with self._lock:
            found = self._drawn.get((side, number))
            if found is None:
                found = self._tuning.compose(self.names[side], {}, self._tuning.background(number))
                self._drawn[side, number] = found
                self._rows[side, number] = FrameRow.of(found.trial.frame.record)
                while len(self._drawn) > _KEPT:
                    self._drawn.popitem(last=False)
            return found

    def _pair(self, number: int, image: ImageRecord) -> FramePair:
        key = f"{image.split}/{image.id}"
        a, b = (self._rows.get((side, number)) for side in (0, 1))
        if a is None or b is None:
            return FramePair(key, number, number)
        return FramePair(key, number, number, changes_of(a, b), a.digest == b.digest)


Comparison = RunComparison | RecipeComparison
