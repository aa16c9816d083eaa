"""DUT-Anti-UAV, detection (Zhao et al. 2022): drones in visible light, VOC files.

    {train,val,test}/img/NNNNN.jpg   {train,val,test}/xml/NNNNN.xml     perhaps doubled: train/train/img

The pictures are in colour, taken by daylight: they show sizes, shapes and numbers of drones but are not thermal
backgrounds. Every record has `modality` `visible` in its `extra`, and a run leaves such pictures out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from infrablend.core.dataset import Category, Dataset
from infrablend.formats.base import Match, check_splits, names_of, require_options
from infrablend.formats.labels import voc
from infrablend.formats.records import KEEP_OR_DROP, Findings

NAME = "dut-anti-uav"
OPTIONS = voc.OPTIONS
CATEGORIES = (Category(0, "UAV"),)


def _split_folders(root: Path) -> list[Path]:
    """Return the folders of splits, or folders of the same name in them, that contain `img` and `xml`."""
    folders = [f for s in ("train", "val", "test") for f in (root / s, root / s / s)]
    return [f for f in folders if (f / "img").is_dir() and (f / "xml").is_dir()]


def detect(root: Path) -> Match:
    """Decide whether `root` contains `img` and `xml` folders in the folders of splits."""
    folders = _split_folders(root)
    if not folders:
        return Match(NAME, False, "no train, val or test with folders img and xml in it")
    found = ", ".join(f.relative_to(root).as_posix() for f in folders)
    return Match(NAME, True, f"img and xml in {found}")


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    origin: str = "0",
    unlabelled: str = "keep",
) -> Dataset:
    """Read pictures and labels; see `voc.read` for the arguments and errors."""
    require_options(root, origin=(origin, ("0", "1")), unlabelled=(unlabelled, KEEP_OR_DROP))
    wanted = check_splits(splits)
    found = Findings(root)
    records = voc.read_folder(found, wanted, origin == "1", unlabelled)
    others = [n for n in names_of(records) if n != "UAV"]
    if others:
        text = f"{', '.join(others)}, taken as new categories"
        found.warn(root.name, "category-unknown", text, "only UAV")
    categories = [*CATEGORIES, *(Category(k, n) for k, n in enumerate(others, 1))]
    visible = [replace(r, extra={**r.extra, "modality": "visible"}) for r in records]
    notes = {"labels": NAME, "origin": int(origin), "modality": "visible", "rows": found.rows(*voc.COUNTS)}
    return found.dataset(NAME, visible, categories, notes, metadata=metadata, splits=wanted)
