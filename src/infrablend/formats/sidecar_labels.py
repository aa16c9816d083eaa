"""Pictures with one label file each beside them: the loop that WiSARD and WIT-UAS share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from infrablend.core.dataset import Instance
from infrablend.errors import Problem
from infrablend.formats.pictures import read_size
from infrablend.formats.records import unlabelled_problems

ReadLabel = Callable[[Path, Path, tuple[int, int], list[Problem], "Counter[str]"], list[Instance] | None]
"""Reads a label file: root, file, size of the picture, problems and counts to add to; None if it cannot be read."""


@dataclass(frozen=True)
class SidecarPicture:
    """A picture and the objects in its label file.

    Attributes:
        name: File name.
        path: The file.
        where: Path below the dataset's folder, for problems.
        size_wh: Width and height, px.
        labelled: Whether there is a label file.
        instances: Objects in the label file.
    """

    name: str
    path: Path
    where: str
    size_wh: tuple[int, int]
    labelled: bool
    instances: tuple[Instance, ...]


@dataclass(frozen=True)
class SidecarLabels:
    """How to read label files that are beside their pictures.

    Attributes:
        root: Folder of the dataset.
        suffix: Suffix of label files.
        unlabelled: `keep` or `drop` pictures without a label file.
        read_label: Reader of a label file.
        problems: List to which problems are added.
        counts: Counter to which the reader's counts and `unlabelled` are added.
    """

    root: Path
    suffix: str
    unlabelled: str
    read_label: ReadLabel
    problems: list[Problem] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def read(self, where: str, pictures: Mapping[str, Path]) -> Iterator[SidecarPicture]:
        """Read the pictures of one folder; those that cannot be read, or whose labels cannot, are left out.

        Args:
            where: Name of the folder, for problems.
            pictures: Paths by file name.
        """
        missing = 0
        for name, path in pictures.items():
            label = path.with_suffix(self.suffix)
            labelled = label.is_file()
            missing += not labelled
            if not labelled and self.unlabelled == "drop":
                continue
            here = path.relative_to(self.root).as_posix()
            size_wh, problem = read_size(path, here)
            if size_wh is None:
                self.problems.extend([problem] if problem else [])
                continue
            found = self.read_label(self.root, label, size_wh, self.problems, self.counts) if labelled else []
            if found is not None:
                yield SidecarPicture(name, path, here, size_wh, labelled, tuple(found))
        self.counts["unlabelled"] += missing
        self.problems.extend(unlabelled_problems(where, missing, self.unlabelled, f"no {self.suffix} file"))
