"""Labels of a run's frames, original and inserted, from the tables that the run wrote beside its pictures."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from infrablend.core.dataset import SPLITS, finite
from infrablend.core.files import read_regular
from infrablend.core.run_folder import PICTURE_TABLES, RunFolder

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class RunLabel:
    """A label of a frame; its box is in pixels, and `ignore` marks a region to ignore.

    `track` is the id of its track; empty without one.
    """

    category: str
    box_xyxy: Box
    inserted: bool = False
    ignore: bool = False
    track: str = ""


@dataclass(frozen=True)
class Place:
    """Where a frame is in its sequence, `<split>/<name>`: its number there, and its time."""

    sequence: str
    frame: int
    time_s: float | None


_Found = tuple[tuple[RunLabel, ...], Place | None]


class RunLabels:
    """The labels of all frames of a run, read when they are first asked for."""

    def __init__(self, layout: RunFolder) -> None:
        self._layout = layout
        self._lock = threading.Lock()
        self._found: dict[str, _Found] | None = None

    def of(self, image: str) -> tuple[RunLabel, ...]:
        """Return the labels of an image, a path below `images/`."""
        return self._get(image)[0]

    def place(self, image: str) -> Place | None:
        """Return where an image is in its sequence; None if it is in none."""
        return self._get(image)[1]

    def _get(self, image: str) -> _Found:
        with self._lock:
            if self._found is None:
                self._found = dict(_from_tables(self._layout))
        return self._found.get(image, ((), None))


def _from_tables(layout: RunFolder) -> Iterator[tuple[str, _Found]]:
    for split, name in zip(SPLITS, PICTURE_TABLES, strict=True):
        try:
            lines = read_regular(layout.root / name, layout.root).splitlines()
        except (OSError, ValueError):
            continue
        for line in lines:
            try:
                row = json.loads(line)
                objects = row["objects"]
                inserted = objects["inserted"]
                ignore = objects.get("ignore", [False] * len(inserted))
                tracks = objects.get("track_id", [""] * len(inserted))
                columns = zip(objects["bbox"], objects["category"], inserted, ignore, tracks, strict=True)
                labels = tuple(_label(*values) for values in columns)
                yield f"{split}/{row['file_name']}", (labels, _place(split, row))
            except (ValueError, LookupError, TypeError):
                continue


def _place(split: str, row: Mapping[str, Any]) -> Place | None:
    if not row.get("sequence"):
        return None
    time_s = row.get("time_s")
    return Place(f"{split}/{row['sequence']}", int(row.get("frame") or 0), None if time_s is None else float(time_s))


def _label(bbox: Any, category: Any, inserted: Any, ignore: Any, track: Any = "") -> RunLabel:
    x, y, w, h = (float(v) for v in finite(bbox))
    return RunLabel(str(category), (x, y, x + w, y + h), bool(inserted), bool(ignore), str(track))
