"""WiSARD (Broyles et al. 2022): clips of thermal and visible frames with a YOLO label file beside each picture.

    <YYMMDD>_<Site>_<Platform>[_FLIR]_{VIS|IR}_<clip>/<anything><frame>.jpg|.jpeg    <same stem>.txt    [count.txt]

A line of a label file is `0 cx cy w h` in shares of the picture; the only class is human. An empty label file means
that nobody is visible, a missing one that the picture was not labelled. `count.txt` is not a label file.
"""

from __future__ import annotations

import datetime
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import read_text
from infrablend.formats.base import Match, check_splits, require_options
from infrablend.formats.box_checks import check_box, snap
from infrablend.formats.pictures import by_folder, is_hidden, sidecar_labels
from infrablend.formats.records import KEEP_OR_DROP, make_dataset
from infrablend.formats.sidecar_labels import SidecarLabels
from infrablend.formats.values import to_floats
from infrablend.formats.yolo import parse_labels

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
    """Return the pictures by clip folder (relative) and name."""
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
    """Read the clips below a folder.

    Args:
        root: Folder of clips, or one clip.
        splits: Splits to read; only `split` has any pictures.
        metadata: Table of pitch and altitude, by file or by clip (`sequence`); None uses any `metadata.csv` or `.json`.
        modality: Clips to read: `ir`, `vis` or `all`; a warning counts the others.
        unlabelled: Whether to `keep` or `drop` pictures without a label file.
        logo: Region to ignore in `_FLIR_` clips, see `OPTIONS`.
        split: Split of all clips.

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
    problems: list[Problem] = []
    counts: Counter[str] = Counter()
    beside = SidecarLabels(root, ".txt", unlabelled, _read_label, problems, counts)
    records: list[ImageRecord] = []
    for folder, pictures in _clips(root).items() if of_all in wanted else ():
        clip = _clip_name(root, folder)
        kind = str(modality_of(clip))
        if modality not in (kind, "all"):
            counts["other_clips"] += 1
            counts["other_pictures"] += len(pictures)
            continue
        counts["clips"] += 1
        _report_strays(root, folder, pictures, problems)
        for p in beside.read(clip, pictures):
            counts["logos"] += len(logos := _logo(clip, region, p.size_wh, p.where, problems))
            frame = _FRAME.search(p.path.stem)
            extra: dict[str, Any] = {} if p.labelled else {"labelled": False}
            extra |= {"modality": "visible"} if kind == "vis" else {}
            records.append(
                ImageRecord(
                    "",
                    p.path,
                    of_all,
                    p.size_wh,
                    (*p.instances, *logos),
                    capture=Capture(sequence=clip, captured=_captured(clip), frame=int(frame[1]) if frame else None),
                    extra=extra,
                    file_name=f"{clip}/{p.name}",
                )
            )
    problems += _summary(root, modality, logo, counts)
    categories = CATEGORIES if counts["logos"] else CATEGORIES[:1]
    keys = ("clips", "labelled", "empty", "unlabelled", "objects", "read", "snapped", "without_area", "logos")
    rows = {k: counts[k] for k in (*keys, "other_clips", "other_pictures")}
    notes = {"labels": NAME, "modality": modality, "logo": logo, "rows": rows}
    return make_dataset(root, NAME, records, categories, problems, notes, metadata=metadata, splits=wanted)


def _captured(clip: str) -> str | None:
    """Return the date at the start of a clip's name as ISO 8601; None if there is no valid date."""
    found = _DATE.match(clip)
    try:
        return None if found is None else datetime.date(2000 + int(found[1]), int(found[2]), int(found[3])).isoformat()
    except ValueError:
        return None


def _report_strays(root: Path, folder: str, pictures: Mapping[str, Path], problems: list[Problem]) -> None:
    stems = {path.stem for path in pictures.values()}
    texts = sorted(p for p in (root / folder).glob("*.txt") if not is_hidden(p.name) and p.name != "count.txt")
    strays = [p.name for p in texts if p.stem not in stems]
    if strays:
        found = f"{len(strays)} label file(s) without a picture: {', '.join(strays[:3])}"
        problems.append(Problem(folder, "image-missing", found, "a picture per label file", "restore them", "warning"))


def _read_label(
    root: Path, path: Path, size_wh: tuple[int, int], problems: list[Problem], counts: Counter[str]
) -> list[Instance] | None:
    """Return the people in a label file; None, with a problem, if it cannot be read."""
    where = path.relative_to(root).as_posix()
    text, problem = read_text(path, where, "a YOLO label file")
    if problem is not None:
        problems.append(problem)
        return None
    lines = parse_labels(text, where)
    problems += lines.problems
    counts["labelled"] += 1
    counts["empty"] += not lines.rows and not lines.problems
    counts["objects"] += sum(bool(line.strip()) for line in text.splitlines())
    w, h = size_wh
    instances = []
    for n, number, values in lines.rows:
        here = f"{where}: line {n}"
        if number != 0 or len(values) != 4:
            found = f"class {number} with {len(values)} numbers"
            problems.append(Problem(here, "category-unknown", found, "0 cx cy w h", "correct the line"))
            continue
        cx, cy, bw, bh = values
        edges = ((cx - bw / 2) * w, (cy - bh / 2) * h, (cx + bw / 2) * w, (cy + bh / 2) * h)
        raw = [snap(v, size_wh[i % 2], _ROUNDING * size_wh[i % 2]) for i, v in enumerate(edges)]
        counts["snapped"] += any(a != b for a, b in zip(raw, edges, strict=True))
        box, problem = check_box(raw, size_wh, here)
        if problem is not None:
            problems.append(problem)
            counts["without_area"] += problem.code in ("box-empty", "box-outside")
        if box is not None:
            instances.append(Instance("human", box))
    counts["read"] += len(instances)
    return instances


def _logo_region(root: Path, logo: str) -> tuple[float, ...] | None:
    """Return the region of the option `logo`, in px or, if no value exceeds 1, in shares of the picture; or None."""
    if logo in ("auto", "none"):
        return _LOGO_SHARES if logo == "auto" else None
    region = to_floats(logo.split(","), 4)
    if region is None or not all(map(math.isfinite, region)) or region[0] >= region[2] or region[1] >= region[3]:
        expected = "auto, none, or x0,y0,x1,y1 in px with x0 < x1 and y0 < y1"
        problem = Problem("option logo", "option-value", f"logo={logo}", expected)
        raise DatasetError(f"{root}: an option has a value that is not allowed", [problem])
    return region


def _logo(
    clip: str, region: tuple[float, ...] | None, size_wh: tuple[int, int], where: str, problems: list[Problem]
) -> list[Instance]:
    """Return the region of the burnt-in logo as an object to ignore; nothing for other cameras and `logo=none`."""
    if region is None or "FLIR" not in clip.split("_"):
        return []
    if max(region) <= 1:
        region = tuple(v * size_wh[i % 2] for i, v in enumerate(region))
    box, problem = check_box(region, size_wh, f"{where}: logo")
    problems += [problem] if problem else []
    return [] if box is None else [Instance("Logo", box)]


def _summary(root: Path, modality: str, logo: str, counts: Counter[str]) -> list[Problem]:
    problems = []
    if counts["other_clips"]:
        found = f"{counts['other_clips']} clip(s) with {counts['other_pictures']} pictures left out"
        problems.append(Problem(root.name, "modality-excluded", found, f"modality={modality}", "", "warning"))
    if counts["logos"] and logo == "auto":
        found = f"the position of the logo in {counts['logos']} pictures of FLIR clips is assumed"
        todo = "check it in one picture, and add --read logo=x0,y0,x1,y1 or --read logo=none"
        problems.append(Problem(root.name, "logo-assumed", found, "a region given by an option", todo, "warning"))
    return problems
