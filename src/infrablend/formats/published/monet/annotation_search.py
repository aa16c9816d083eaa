"""Find MONET's annotation files in a folder, and decide whether it is MONET."""

from __future__ import annotations

import os
import re
from fnmatch import fnmatch
from pathlib import Path

from infrablend.core.file_names import leaves_folder, real_path
from infrablend.formats.base import Match
from infrablend.formats.pictures.listing import is_hidden
from infrablend.formats.published.monet.read_options import PITCH_KEYS

NAME = "monet"
# Not annotations: tables of pictures, and records of InfraBlend.
_NO_ANNOTATIONS = (
    "metadata.json",
    "world.json",
    "run.json",
    "package.json",
    "convert.json",
    "split.json",
    "SOURCE.json",
)
SKIPPED_FOLDERS = ("coco", "native", "scenes", "log")
_JSON_DEPTH = 4
SEQUENCE = re.compile(r"(?:runway|dirtroad)_\d+")


def find_files(root: Path, pattern: str | None = None) -> list[Path]:
    """Return the JSON files that may contain annotations, sorted: up to four levels down, or matching a pattern."""
    found: list[Path] = []
    for base, folders, names in os.walk(root):
        here = Path(base)
        depth = len(here.relative_to(root).parts)
        folders[:] = sorted(
            d for d in folders if not is_hidden(d) and depth < _JSON_DEPTH and (d not in SKIPPED_FOLDERS or pattern)
        )
        # No pipes or devices: opening them would block.
        files = [here / n for n in names if n.lower().endswith(".json") and not is_hidden(n) and (here / n).is_file()]
        if pattern is None:
            found += [p for p in files if p.name not in _NO_ANNOTATIONS]
        else:
            found += [p for p in files if fnmatch(p.relative_to(root).as_posix(), pattern)]
    return sorted(found)


def detect(root: Path) -> Match:
    """Decide whether `root` is MONET: its JSON contains a gimbal pitch, or its folders are named like sequences."""
    files = find_files(root)
    if not files:
        return Match(NAME, False, "no JSON file in the folder or up to four levels below")
    for path in files:
        key = _pitch_key_in(path)
        if key is not None:
            return Match(NAME, True, f"{path.relative_to(root).as_posix()} contains {key!r}")
    for base, folders, _ in os.walk(root):
        depth = len(Path(base).relative_to(root).parts)
        # Our writers of COCO and others keep sequence folders below `images`.
        folders[:] = sorted(d for d in folders if not is_hidden(d) and d != "images" and depth < _JSON_DEPTH)
        named = next((d for d in (real_path(Path(base)).name, *folders) if SEQUENCE.fullmatch(d)), None)
        if named is not None:
            return Match(NAME, True, f"JSON files and a sequence folder {named}")
    return Match(NAME, False, f"no JSON file contains {' or '.join(PITCH_KEYS)}, no folder runway_NN or dirtroad_NN")


def _pitch_key_in(path: Path) -> str | None:
    """Return the pitch key that a file contains as text, found without parsing it."""
    keys = [f'"{k}"'.encode() for k in PITCH_KEYS]
    keep = max(map(len, keys))
    if leaves_folder(path) or not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            tail = b""
            while chunk := file.read(1 << 20):
                block = tail + chunk
                for name, key in zip(PITCH_KEYS, keys, strict=True):
                    if key in block:
                        return name
                tail = block[-keep:]
    except OSError:
        return None
    return None
