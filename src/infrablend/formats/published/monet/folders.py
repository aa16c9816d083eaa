"""Where MONET's pictures are, and what their folders state: split and sequence."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from infrablend.core.dataset import Split
from infrablend.errors import Problem
from infrablend.formats.base import SPLIT_FOLDERS
from infrablend.formats.pictures.listing import PictureFolder, list_pictures
from infrablend.formats.published.monet.annotation_search import SEQUENCE, SKIPPED_FOLDERS

_NUMBERED = re.compile(r"[A-Za-z]+_\d+")
_SAMPLE = 50


class Pictures:
    """All pictures of the dataset, and the folder to which each annotation file's picture names are relative."""

    def __init__(self, root: Path) -> None:
        self.by_path = list_pictures(root, SKIPPED_FOLDERS)
        self._by_name: dict[str, list[tuple[str, ...]]] = defaultdict(list)
        stems: dict[str, str] = {}
        for path in self.by_path:
            stem = path.rpartition(".")[0]
            stems.setdefault(stem, path)
            for known in (path, stem):
                parts = tuple(known.split("/"))
                self._by_name[parts[-1]].append(parts)
        self.folder = PictureFolder(root, self.by_path, stems)

    def resolve(self, name: str, base: str, strip: int) -> str:
        """Return a picture's name in an annotation file as path below the dataset's folder."""
        parts = PurePosixPath(name).parts[strip:]
        return str(PurePosixPath(base, *parts)) if parts else name

    def locate(self, names: Sequence[str], where: str) -> tuple[str, int] | Problem:
        """Find the folder to which an annotation file's names are relative.

        A folder that shares parts with the file's path (`runway_04.json`, `runway_04/...`) is preferred over one
        in which more pictures happen to have the same names.

        Returns:
            The folder, and the number of leading folders to remove from the names first; or why it is ambiguous.
        """
        step = max(1, len(names) // _SAMPLE)
        said = PurePosixPath(where).with_suffix("").parts
        votes: Counter[tuple[str, int]] = Counter()
        shared: dict[tuple[str, int], int] = defaultdict(int)
        for name in names[::step]:
            wanted = PurePosixPath(name).parts
            for parts in self._by_name.get(wanted[-1] if wanted else "", ()):
                same = 0
                while same < min(len(wanted), len(parts)) and wanted[-1 - same] == parts[-1 - same]:
                    same += 1
                known = sum(s in parts for s in said)
                for used in range(1, same + 1):
                    choice = ("/".join(parts[: len(parts) - used]), len(wanted) - used)
                    votes[choice] += 1
                    shared[choice] = max(shared[choice], known)
        if not votes:
            return "", 0

        def rank(choice: tuple[str, int]) -> tuple[int, int, int]:
            return shared[choice], -choice[1], votes[choice]

        best = max(rank(c) for c in votes)
        top = sorted(c for c in votes if rank(c) == best)
        if len({c[0] for c in top}) == 1:
            return top[0]
        found = f"pictures with its names ({names[0]}, ...) exist in {', '.join(c[0] or '.' for c in top[:4])}"
        return Problem(
            where, "pictures-ambiguous", found, "one folder", "name the folder, e.g. --read pictures={stem}/lwir"
        )

    def given(self, pattern: str, names: Sequence[str], where: str) -> tuple[str, int]:
        """Do the same as `locate` for the folder given by the option `pictures`."""
        path = PurePosixPath(where)
        base = pattern.replace("{stem}", path.stem).replace("{folder}", str(path.parent))
        base = str(PurePosixPath(base))
        deepest = max((len(PurePosixPath(n).parts) for n in names[:_SAMPLE]), default=1)
        counts = {
            strip: sum(self.resolve(n, base, strip) in self.by_path for n in names[:_SAMPLE])
            for strip in range(deepest)
        }
        return base, max(counts, key=lambda strip: (counts[strip], -strip))


def split_in(parts: Sequence[str]) -> Split | None:
    """Return the split after which a folder is named, such as `val` or `monet_val`."""
    for part in parts:
        name = part.lower().removeprefix("monet").lstrip("_-")
        if name in SPLIT_FOLDERS:
            return SPLIT_FOLDERS[name]
    return None


def split_in_stem(stem: str) -> Split | None:
    """Return the first split among the words of a file's stem, such as `instances_val2017`."""
    words = [w.rstrip("0123456789") for w in re.split(r"[^a-z0-9]+", stem.lower())]
    return next((SPLIT_FOLDERS[w] for w in words if w in SPLIT_FOLDERS), None)


def sequence_of(path: str, stem: str, root_name: str) -> str | None:
    """Return the sequence of a picture: the folder around `lwir`, else its folder, else the annotation file's name.

    The dataset's own folder is used if it is named like one of MONET's sequences: someone may have only that one.
    """
    folders = PurePosixPath(path).parent.parts
    if "lwir" in folders:
        folders = folders[: folders.index("lwir")]
        own = folders[-1] if folders else ""
    else:
        own = next((f for f in reversed(folders) if f not in ("images", ".")), "")
    if own and split_in([own]) is None:
        return own
    if SEQUENCE.fullmatch(root_name):
        return root_name
    return stem if _NUMBERED.fullmatch(stem) and split_in_stem(stem) is None else None


def below_split(path: str) -> str:
    """Return the path of a picture below its split's folder."""
    parts = PurePosixPath(path).parts
    at = next((k for k, p in enumerate(parts[:-1]) if split_in([p]) is not None), -1)
    return "/".join(parts[at + 1 :])
