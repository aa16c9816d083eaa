"""WiSARD (Broyles et al. 2022): clips of thermal and visible frames with a YOLO label file beside each picture.

    <YYMMDD>_<Site>_<Platform>[_FLIR]_{VIS|IR}_<clip>/<anything><frame>.jpg|.jpeg    <same stem>.txt    [count.txt]

A line of a label file is `0 cx cy w h` in shares of the picture; the only class is human. An empty label file means
that nobody is visible, a missing one that the picture was not labelled. `count.txt` is not a label file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.formats.base import Match, check_splits, option_error, require_options
from infrablend.formats.box_checks import snap
from infrablend.formats.pictures.listing import by_folder, is_hidden, sidecar_labels
from infrablend.formats.published.sidecar import Fault, LabelledFolder, Stated, checked, if_file, yolo_lines
from infrablend.formats.records import KEEP_OR_DROP, Findings
from infrablend.formats.values import iso_date, to_floats

NAME = "wisard"
OPTIONS = {
    "modality": "clips to read: ir (the default), vis or all",
    "unlabelled": "keep or drop pictures without a label file; keep is the default",
    "logo": "region to ignore in clips of a FLIR camera, because its logo is burnt in: auto (the default: the left "
    "fifth of the lowest eighth, an assumption), none, or x0,y0,x1,y1 in px",
    "split": "split of all clips, since WiSARD has no splits: train (the default), val or test",
}
CATEGORIES = (Category(0, "human"), Category(1, "Logo", ignore=True))

_DATE = re.compile(r"(\d\d)(\d\d)(\d\d)_", re.ASCII)
_FRAME = re.compile(r"[_ ](\d{1,12})$", re.ASCII)
# With six decimals, rounding moves the edge of a box at the frame's edge outside by up to 1e-6 of the frame.
_ROUNDING = 2e-6
_LOGO_SHARES = (0.0, 0.875, 0.2, 1.0)


def modality_of(clip: str) -> str | None:
    """Return `ir` or `vis` from the name of a clip's folder; None if it is not a clip."""
    parts = clip.split("_")
    if _DATE.match(clip) is None:
        return None
    return "ir" if "IR" in parts else "vis" if "VIS" in parts else None


def _clips(root: Path) -> dict[str, dict[str, Path]]:
    return {f: p for f, p in by_folder(root).items() if modality_of(_clip_name(root, f)) is not None}


def _clip_name(root: Path, folder: str) -> str:
    return (root / folder).absolute().name


def detect(root: Path) -> Match:
    """Decide whether `root` contains or is a folder of pictures named like WiSARD's clips."""
    clips = _clips(root)
    if not clips:
        return Match(NAME, False, "no folder of pictures named like a clip, <YYMMDD>_<Site>_..._IR_<n> or ..._VIS_<n>")
    if not sidecar_labels(clips, ".txt"):
        return Match(NAME, False, f"{len(clips)} clip(s), but no label file beside a picture")
    return Match(NAME, True, f"{len(clips)} clip(s) such as {_clip_name(root, next(iter(clips)))}")


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    modality: str = "ir",
    unlabelled: str = "keep",
    logo: str = "auto",
    split: str = "train",
) -> Dataset:
    """Read the clips below a folder, or one clip; a warning counts those of the other modality.

    Raises:
        DatasetError: An option has a wrong value, or no picture can be read.
    """
    require_options(
        root,
        modality=(modality, ("ir", "vis", "all")),
        unlabelled=(unlabelled, KEEP_OR_DROP),
        split=(split, SPLITS),
    )
    region = _logo_region(root, logo)
    wanted = check_splits(splits)
    (of_all,) = check_splits([split])
    found = Findings(root)
    records: list[ImageRecord] = []
    for folder, pictures in _clips(root).items() if of_all in wanted else ():
        clip = _clip_name(root, folder)
        if modality not in (modality_of(clip), "all"):
            found.counts["other_clips"] += 1
            found.counts["other_pictures"] += len(pictures)
            continue
        found.counts["clips"] += 1
        _report_strays(found, folder, pictures)
        for record in _labelled(clip, pictures, of_all).read(found, unlabelled, _read_label):
            logos = _logo(found, record, region) if "FLIR" in clip.split("_") else []
            records.append(replace(record, instances=(*record.instances, *logos)))
    counts = found.counts
    counts["objects"] += counts["malformed"]
    counts["without_area"] = counts["box-empty"] + counts["box-outside"]
    _summarise(found, modality, logo)
    categories = CATEGORIES if counts["logos"] else CATEGORIES[:1]
    keys = ("clips", "labelled", "empty", "unlabelled", "objects", "read", "snapped", "without_area", "logos")
    rows = found.rows(*keys, "other_clips", "other_pictures")
    notes = {"labels": NAME, "modality": modality, "logo": logo, "rows": rows}
    return found.dataset(NAME, records, categories, notes, metadata=metadata, splits=wanted)


def _labelled(clip: str, pictures: Mapping[str, Path], split: Split) -> LabelledFolder:
    date = _DATE.match(clip)
    captured = iso_date(f"20{date[1]}", date[2], date[3]) if date else None

    def capture_of(stem: str) -> Capture:
        frame = _FRAME.search(stem)
        return Capture(sequence=clip, captured=captured, frame=int(frame[1]) if frame else None)

    return LabelledFolder(
        where=clip,
        pictures={f"{clip}/{name}": path for name, path in pictures.items()},
        label_of=lambda picture: if_file(picture.with_suffix(".txt")),
        missing="no .txt file",
        capture_of=capture_of,
        split=split,
        is_visible=lambda _: modality_of(clip) == "vis",
    )


def _report_strays(found: Findings, folder: str, pictures: Mapping[str, Path]) -> None:
    stems = {path.stem for path in pictures.values()}
    texts = sorted(p for p in (found.root / folder).glob("*.txt") if not is_hidden(p.name) and p.name != "count.txt")
    strays = [p.name for p in texts if p.stem not in stems]
    if strays:
        text = f"{len(strays)} label file(s) without a picture: {', '.join(strays[:3])}"
        found.warn(folder, "image-missing", text, "a picture per label file", "restore them")


def _read_label(found: Findings, _: Path, label: Path, size_wh: tuple[int, int]) -> list[Instance] | None:
    lines = yolo_lines(found, label)
    if lines is None:
        return None
    return checked(found, ((here, _stated(found, number, v, size_wh)) for here, number, v in lines), size_wh)


def _stated(found: Findings, number: int, values: Sequence[float], size_wh: tuple[int, int]) -> Stated:
    if number != 0 or len(values) != 4:
        return Fault("category-unknown", f"class {number} with {len(values)} numbers", "0 cx cy w h")
    cx, cy, bw, bh = values
    w, h = size_wh
    written = [(cx - bw / 2) * w, (cy - bh / 2) * h, (cx + bw / 2) * w, (cy + bh / 2) * h]
    snapped = [snap(v, size_wh[k % 2], _ROUNDING * size_wh[k % 2]) for k, v in enumerate(written)]
    found.counts["snapped"] += snapped != written
    return Instance("human", np.array(snapped))


def _logo_region(root: Path, logo: str) -> tuple[float, ...] | None:
    """Return the region of the option `logo`, in px or, if no value exceeds 1, in shares of the picture; or None."""
    if logo in ("auto", "none"):
        return _LOGO_SHARES if logo == "auto" else None
    region = to_floats(logo.split(","), 4)
    if region is None or not all(map(math.isfinite, region)) or region[0] >= region[2] or region[1] >= region[3]:
        raise option_error(root, "logo", logo, "auto, none, or x0,y0,x1,y1 in px with x0 < x1 and y0 < y1")
    return region


def _logo(found: Findings, image: ImageRecord, region: tuple[float, ...] | None) -> list[Instance]:
    """Return the region of the burnt-in logo as an object to ignore; nothing for `logo=none`."""
    if region is None or image.size_wh is None:
        return []
    if max(region) <= 1:
        region = tuple(v * image.size_wh[i % 2] for i, v in enumerate(region))
    box = found.box(region, image.size_wh, f"{found.place(image.path)}: logo")
    found.counts["logos"] += box is not None
    return [] if box is None else [Instance("Logo", box)]


def _summarise(found: Findings, modality: str, logo: str) -> None:
    name = found.root.name
    counts = found.counts
    if counts["other_clips"]:
        text = f"{counts['other_clips']} clip(s) with {counts['other_pictures']} pictures left out"
        found.warn(name, "modality-excluded", text, f"modality={modality}")
    if counts["logos"] and logo == "auto":
        text = f"the position of the logo in {counts['logos']} pictures of FLIR clips is assumed"
        todo = "check it in one picture, and add --read logo=x0,y0,x1,y1 or --read logo=none"
        found.warn(name, "logo-assumed", text, "a region given by an option", todo)
