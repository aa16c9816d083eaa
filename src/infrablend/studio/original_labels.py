"""Boxes of the original objects in a run's frames, from the tables that the run wrote beside its pictures."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from infrablend.core.dataset import SPLITS, finite
from infrablend.core.files import read_regular
from infrablend.core.run_layout import PICTURE_TABLES, RunLayout

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class OriginalLabel:
    """A kept label of a background.

    Attributes:
        category: Class.
        box_xyxy: Box, pixels.
    """

    category: str
    box_xyxy: Box


class OriginalLabels:
    """The kept original labels of all frames of a run, read when they are first asked for."""

    def __init__(self, layout: RunLayout) -> None:
        """Read nothing yet."""
        self._layout = layout
        self._lock = threading.Lock()
        self._found: dict[str, tuple[OriginalLabel, ...]] | None = None

    def of(self, image: str) -> tuple[OriginalLabel, ...]:
        """Return the labels of an image, a path below `images/`."""
        with self._lock:
            if self._found is None:
                self._found = dict(_from_tables(self._layout)) or dict(_from_coco(self._layout))
        return self._found.get(image, ())


def _from_tables(layout: RunLayout) -> Iterator[tuple[str, tuple[OriginalLabel, ...]]]:
    for split, name in zip(SPLITS, PICTURE_TABLES, strict=True):
        try:
            lines = read_regular(layout.root / name, layout.root).splitlines()
        except (OSError, ValueError):
            continue
        for line in lines:
            try:
                row = json.loads(line)
                objects = row["objects"]
                columns = zip(objects["bbox"], objects["category"], objects["inserted"], strict=True)
                yield f"{split}/{row['file_name']}", tuple(_label(b, c) for b, c, inserted in columns if not inserted)
            except (ValueError, LookupError, TypeError):
                continue


def _from_coco(layout: RunLayout) -> Iterator[tuple[str, tuple[OriginalLabel, ...]]]:
    """Yield the labels of runs that have no tables, which older versions did not write."""
    for split in SPLITS:
        try:
            content = json.loads(read_regular(layout.coco_file(split), layout.root))
            names = {c["id"]: str(c["name"]) for c in content["categories"]}
            files = {i["id"]: f"{split}/{i['file_name']}" for i in content["images"]}
            found: dict[str, list[OriginalLabel]] = {}
            for label in content["annotations"]:
                if not label.get("inserted"):
                    one = _label(label["bbox"], names[label["category_id"]])
                    found.setdefault(files[label["image_id"]], []).append(one)
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            continue
        yield from ((image, tuple(labels)) for image, labels in found.items())


def _label(bbox: Any, category: Any) -> OriginalLabel:
    x, y, w, h = (float(v) for v in finite(bbox))
    return OriginalLabel(str(category), (x, y, x + w, y + h))
