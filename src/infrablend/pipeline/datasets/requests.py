"""What callers ask of datasets: classes to change, pictures to select, and how to split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NotRequired, TypedDict

from infrablend.core.arguments import require_names

MOST_COPIES = 4
"""Upper limit on the copies of one picture, however rare its flight conditions are."""


@dataclass(frozen=True)
class ClassChanges:
    """Classes to rename and to leave out.

    Attributes:
        rename: Rename classes; several may become one; repeatable.
        drop: Leave out labels of these classes (names after --rename).
        only: Keep only the labels of this class.

    Raises:
        ArgumentError: `drop` is no list of names.
    """

    rename: Mapping[str, str] = field(default_factory=dict)
    drop: Sequence[str] = ()
    only: str | None = None

    def __post_init__(self) -> None:
        require_names("drop", self.drop)


KEEP_CLASSES = ClassChanges()


@dataclass(frozen=True)
class Selection:
    """Pictures to select; the default selects all.

    Ignored classes (DontCare) are allowed in `without`. A picture is drawn up to `MOST_COPIES` times for `like`; each
    copy has its own name.

    Attributes:
        with_class: Take only pictures that show this class (name after --rename).
        without: Take only pictures that show none of these classes.
        images: Draw N of the pictures at random.
        objects: Draw pictures that together show N objects of --with-class.
        like: Draw pictures, some several times, to match times of day, heights, pitches and grey levels of those that
            show this class.
        seed: Seed of the draw.

    Raises:
        ArgumentError: `without` is no list of names.
    """

    with_class: str | None = None
    without: Sequence[str] = ()
    images: int | None = None
    objects: int | None = None
    like: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        require_names("without", self.without)

    def __bool__(self) -> bool:
        return self != Selection(seed=self.seed)

    def to_json(self) -> SelectionFacts:
        """Return plain JSON values."""
        return {
            "with_class": self.with_class,
            "without": sorted(self.without),
            "images": self.images,
            "objects": self.objects,
            "like": self.like,
            "seed": self.seed,
        }


class SelectionFacts(TypedDict):
    """A selection, and what it took and left out, as plain JSON values."""

    with_class: str | None
    without: list[str]
    images: int | None
    objects: int | None
    like: str | None
    seed: int
    left_out: NotRequired[dict[str, int]]
    objects_taken: NotRequired[int]
    pictures: NotRequired[int]
    drawn_again: NotRequired[int]


SELECT_ALL = Selection()


SplitBy = Literal["sequence", "date", "gap", "time"]


@dataclass(frozen=True)
class SplitRule:
    """Rule for splitting a dataset.

    Attributes:
        by: What stays in one split: a flight, a day, a run of frame numbers, or one block of time per split.
        gap: End a run where the next frame is more than N away [default: 5]; with --by time, leave N pictures out
            between two blocks [default: a twentieth, at most 5].
        shares: Shares of train, val and test [default: 0.7,0.1,0.2].
        seed: The same seed gives the same bytes.
        test: Sequences, days or runs that are test, as `split.json` names them; the others become train and val.
    """

    by: SplitBy
    gap: int | None = None
    shares: Sequence[float] = (0.7, 0.1, 0.2)
    seed: int = 0
    test: Sequence[str] = ()
