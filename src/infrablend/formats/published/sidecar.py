"""Label files beside pictures: a reader states where both lie and what an entry means, and all are read in one way.

A `LabelledFolder` states what the place of some pictures says of them. An entry of a label file, such as a line, states
an object: an `Instance` whose box is still as written, or a `Fault`. `checked` makes objects of these statements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from infrablend.core.capture import UNKNOWN, Capture
from infrablend.core.dataset import ImageRecord, Instance, Split
from infrablend.formats.box_checks import check_box
from infrablend.formats.labels.yolo import parse_labels
from infrablend.formats.records import Findings, unlabelled_problems

ReadLabel = Callable[[Findings, Path, Path, tuple[int, int]], list[Instance] | None]
"""Reads the labels of a picture of some size from a file; None if it cannot be read."""
Look = Callable[[Findings, Path], tuple[Path, tuple[int, int] | None]]
"""Returns the picture to read in place of one, and its size, None if it cannot be read."""


@dataclass(frozen=True)
class Fault:
    """Why an entry of a label file states no object: it is left out, with this problem."""

    code: str
    found: str
    expected: str
    todo: str = "correct the line"


Stated = Instance | Fault | None
"""What an entry states: an object with its box as written, a fault, or nothing that is an object."""


def checked(
    found: Findings, entries: Iterable[tuple[str, Stated]], size_wh: tuple[int, int], silent: Sequence[str] = ()
) -> list[Instance]:
    """Return the objects of a picture, with boxes that `check_box` has checked.

    Args:
        found: Problems, and counts, to which `read` and the codes of problems of boxes are added.
        entries: Places in files, with what is stated there.
        size_wh: Size of the picture.
        silent: Codes of problems that are only counted.
    """
    objects = []
    for here, stated in entries:
        if isinstance(stated, Fault):
            found.add(here, stated.code, stated.found, stated.expected, stated.todo)
        elif stated is not None:
            box, problem = check_box(stated.box_xyxy.tolist(), size_wh, here)
            if problem is not None:
                found.counts[problem.code] += 1
                found.problems += [] if problem.code in silent else [problem]
            if box is not None:
                objects.append(replace(stated, box_xyxy=box))
    found.counts["read"] += len(objects)
    return objects


def text_lines(found: Findings, path: Path, expected: str) -> list[tuple[str, str]] | None:
    """Return place and text of each line that is not blank, an object each; None if the file cannot be read."""
    text = found.text(path, expected)
    if text is None:
        return None
    lines = [(f"{found.place(path)}: line {n}", s.strip()) for n, s in enumerate(text.splitlines(), 1) if s.strip()]
    found.counts["labelled"] += 1
    found.counts["empty"] += not lines
    found.counts["objects"] += len(lines)
    return lines


def yolo_lines(found: Findings, path: Path) -> list[tuple[str, int, tuple[float, ...]]] | None:
    """Return place, class and values of each line of a YOLO label file; None if it cannot be read."""
    text = found.text(path, "a YOLO label file")
    if text is None:
        return None
    where = found.place(path)
    labels = parse_labels(text, where)
    found.problems += labels.problems
    found.counts["labelled"] += 1
    found.counts["empty"] += not labels.rows and not labels.problems
    found.counts["objects"] += len(labels.rows)
    found.counts["malformed"] += sum(p.severity == "error" for p in labels.problems)
    return [(f"{where}: line {row.n}", row.class_, row.values) for row in labels.rows]


def line_reader(expected: str, state: Callable[[str, tuple[int, int]], Stated]) -> ReadLabel:
    """Return the reader of label files with an object a line, of which `state` says what it means."""

    def read_label(found: Findings, _: Path, label: Path, size_wh: tuple[int, int]) -> list[Instance] | None:
        lines = text_lines(found, label, expected)
        if lines is None:
            return None
        return checked(found, ((here, state(line, size_wh)) for here, line in lines), size_wh)

    return read_label


def if_file(path: Path) -> Path | None:
    """Return the path if there is a file."""
    return path if path.is_file() else None


def as_it_is(found: Findings, picture: Path) -> tuple[Path, tuple[int, int] | None]:
    """Return a picture of a dataset with its size."""
    return picture, found.size(picture, found.place(picture))


@dataclass(frozen=True)
class LabelledFolder:
    """Pictures of one folder, where their labels are, and what their place in the dataset says of them.

    Attributes:
        where: Name of the folder, for problems.
        pictures: Paths by the name that each gets in the dataset.
        label_of: Returns the label file of a picture; None without one.
        missing: What a picture without one lacks, for problems.
        capture_of: Returns what a picture's stem and its folder say of the capture.
        split: Split of all pictures.
        is_visible: Whether a picture of this stem was taken in visible light.
        extra: Further facts of all pictures.
        look: Returns the picture to read, which may be one made from that of the dataset.
    """

    where: str
    pictures: Mapping[str, Path]
    label_of: Callable[[Path], Path | None]
    missing: str
    capture_of: Callable[[str], Capture] = lambda _: UNKNOWN
    split: Split = "train"
    is_visible: Callable[[str], bool] = lambda _: False
    extra: Mapping[str, object] = field(default_factory=dict)
    look: Look = as_it_is

    def read(self, found: Findings, unlabelled: str, read_label: ReadLabel) -> Iterator[ImageRecord]:
        """Yield the records of the pictures; those that cannot be read, or whose labels cannot, are left out.

        Args:
            found: Problems, and counts, to which `unlabelled` is added.
            unlabelled: `keep` or `drop` pictures without a label file.
            read_label: Reader of a label file.
        """
        missing = 0
        for name, path in self.pictures.items():
            label = self.label_of(path)
            missing += label is None
            if label is None and unlabelled == "drop":
                continue
            picture, size_wh = self.look(found, path)
            if size_wh is None:
                continue
            objects = [] if label is None else read_label(found, picture, label, size_wh)
            if objects is None:
                continue
            extra = dict(self.extra)
            if self.is_visible(path.stem):
                extra["modality"] = "visible"
            if label is None:
                extra["labelled"] = False
            capture = self.capture_of(path.stem)
            yield ImageRecord("", picture, self.split, size_wh, tuple(objects), capture, extra=extra, file_name=name)
        found.counts["unlabelled"] += missing
        found.problems += unlabelled_problems(self.where, missing, unlabelled, self.missing)
