"""The HTML page of a run: charts, tables, crops, and a list of frames that every number leads to.

The size of the page is bounded: at most `LISTED` frames are listed, of which `EMBEDDED`, spread over the run, have a
picture inside the page; all numbers count all frames. A frame takes about 1 kB, its picture about 6 kB.

Boxes are drawn over the pictures by the page, so that they never hide pixels for good.
"""

from __future__ import annotations

import base64
import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.file_names import leaves_folder
from infrablend.core.frame_row import Box, FrameRow, InsertRow
from infrablend.core.run_folder import IMAGES
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background
from infrablend.report.figures import compact, human_seconds
from infrablend.report.page import page_part, render_page
from infrablend.report.preview import spread, to_8_bit
from infrablend.report.run_charts import Chart, Part, frame_counts, histogram, position_map
from infrablend.report.run_facts import MEANINGS, Filters, RemovedCrop, RunFacts, plain_summary, removed_crops
from infrablend.report.run_warnings import warning_codes

Key = TypeVar("Key", str, tuple[str, str])

LISTED = 10_000
EMBEDDED = 1000
CROPS = 8
TRACKS = 12
SHOWN_INSERTS = 4
SHOWN_PROBLEMS = 5
SHOWN_FRAMES = 100

REASONS: Mapping[str, str] = {
    "covered": "covered by inserted objects",
    "category": "class not kept by the recipe",
    "labels": "left out by the recipe's choice of labels",
    "hidden": "hidden behind another inserted object",
    "min_size": "smaller than the least size",
    "min_visibility": "hardly visible",
    "outside_frame": "outside the frame",
    "low_contrast": "too faint to be seen",
    "too_hidden": "too much hidden by the background",
    "untrusted": "gain of the background not trusted",
    "camera_lost": "the camera's motion is not known in these frames",
    "out_of_view": "tracks that are out of view",
    "behind_text": "behind burnt-in text",
    "no_anchor": "no frame of the sequence that objects could be drawn in",
    "no_horizon": "no horizon known, found or stated",
    "no_ground": "no ground in the picture that suits them",
    "noise": "the picture is little but noise",
}


def run_page(run: RunFacts) -> str:
    """Return the HTML page of a run; equal runs give equal bytes, except for the section of times."""
    frames = run.frames
    filters = Filters()
    problems = _problem_groups(run, filters)
    content = {
        "warnings": [p for p in problems if p["severity"] == "warning"],
        "errors": [p for p in problems if p["severity"] != "warning"],
        "charts": _charts(frames, filters),
        "share_groups": _share_groups(run, filters),
        "summary": plain_summary(run),
        "tiles": _tiles(run, filters),
        "classes": _class_rows(run, filters),
        "removed": _removed_rows(frames, filters),
        "dropped": _dropped_rows(frames, filters),
        "time_text": _time_text(run.timing),
        "time_rows": _time_rows(run.timing),
    }
    extremes = _extremes(frames)
    tracks = _tracks(frames)
    taken = removed_crops(frames, CROPS)
    boxes = [(k, i.box_xyxy) for _, _, found in (*extremes, *tracks) for k, i in found]
    boxes += [(c.frame, c.window_xyxy) for found in taken.values() for c in found]
    # All frames, or some spread over the run and those with a crop.
    listed = sorted({*spread(len(frames), LISTED), *(k for k, _ in boxes)})
    thumbnails, crops = _pictures(run, listed, boxes)

    def entries(found: Sequence[tuple[int, InsertRow]]) -> list[dict[str, object]]:
        return [_insert_entry(k, frames[k], i, crops.get((k, i.box_xyxy))) for k, i in found]

    members = filters.classes(len(frames))
    script = page_part("run_script.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return render_page(
        "run",
        run=run,
        objects=", ".join(f"{name} {n}" for name, n in run.counts.get("labels_inserted", {}).items()),
        excluded=list(run.excluded.items())[:SHOWN_FRAMES],
        insert_groups=[
            (name, heading, [(title, note, entries(found)) for title, note, found in groups])
            for name, heading, groups in (("extremes", "Inserts to look at", extremes), ("tracks", "Tracks", tracks))
            if groups
        ],
        removed_crops=[
            (_why(reason), [_removed_entry(c, frames[c.frame], crops.get((c.frame, c.window_xyxy))) for c in found])
            for reason, found in taken.items()
        ],
        filters=filters.all,
        frames=[_frame_entry(k, frames[k], thumbnails.get(k), members[k]) for k in listed],
        embedded=len(thumbnails),
        script=script,
        script_digest=digest,
        **content,
    )


# ---- numbers


def _why(reason: str) -> str:
    return REASONS.get(reason, reason.replace("_", " "))


def _grouped(found: Iterable[tuple[Key, int]]) -> dict[Key, list[int]]:
    """Return the numbers of the frames by what was found in them, sorted by it."""
    groups: dict[Key, list[int]] = {}
    for key, frame in found:
        groups.setdefault(key, []).append(frame)
    return dict(sorted(groups.items()))


def _tiles(run: RunFacts, filters: Filters) -> list[tuple[str, str, str]]:
    """Return (number, what it counts, link)."""
    frames = run.frames
    counts = run.counts
    without = [k for k, f in enumerate(frames) if not f.inserts]
    dropped = sum(len(f.missing) for f in frames)
    removed = sum(len(f.removed) for f in frames)
    rows = [
        (len(frames), "frames", "#frames"),
        (len({i.track for f in frames for i in f.inserts if i.track}), "tracks", "#tracks"),
        (sum(len(f.inserts) for f in frames), "inserted objects",
         filters.add("Frames with inserted objects", (k for k, f in enumerate(frames) if f.inserts))),
        (len(without), "frames without inserted object", filters.add("Frames without inserted object", without)),
        (dropped, "dropped objects", "#dropped"),
        (removed, "removed labels", "#removed"),
        (counts.get("failed_frames", 0), "failed frames", "#problems"),
        (counts.get("skipped_backgrounds", 0), "skipped backgrounds", "#problems"),
        (len(run.excluded), "excluded frames", "#excluded"),
        (sum(p.severity == "warning" for p in run.problems), "warnings", "#warnings"),
    ]  # fmt: skip
    return [(str(n), what, link if n else "") for n, what, link in rows if n or what != "tracks"]


def _charts(frames: Sequence[FrameRow], filters: Filters) -> list[Chart]:
    inserts = [(i, k) for k, f in enumerate(frames) for i in f.inserts]
    pitches = [(f.camera_pitch_deg, k) for k, f in enumerate(frames)]
    seen = [(100 * i.visibility, k) for i, k in inserts if i.visibility is not None]
    found = [
        histogram([(i.size_px, k) for i, k in inserts], "Size: longer side of the box", filters, " px"),
        histogram([(i.range_m, k) for i, k in inserts], "Range: camera to object", filters, " m"),
        histogram(pitches, "Pitch of the camera below the horizon", filters, "°", "frames"),
        histogram([(i.change_grey, k) for i, k in inserts], "Visible change of the picture, grey levels", filters),
        histogram([(i.signed_grey, k) for i, k in inserts], "Contrast in grey levels, below 0 for darker", filters),
        histogram(seen, "Visible share of the object", filters, " %", edges=range(0, 101, 10)),
        position_map(frames, filters),
    ]
    return [c for c in found if c is not None]


def _share_groups(run: RunFacts, filters: Filters) -> list[tuple[str, list[Part]]]:
    found = []
    for title, what, key in _SHARED:
        members = _grouped((key(f), k) for k, f in enumerate(run.frames))
        found.append((title, frame_counts(members.items(), what, filters)))
    return found


_SHARED: tuple[tuple[str, str, Callable[[FrameRow], str]], ...] = (
    ("Frames by time of day", "Time of day", lambda f: f.time_text or "unknown"),
    ("Frames by split", "Split", lambda f: f.id.partition("/")[0]),
    ("Frames by number of inserted objects", "Inserted objects per frame", lambda f: str(len(f.inserts))),
)


def _class_rows(run: RunFacts, filters: Filters) -> list[dict[str, object]]:
    after = run.counts.get("labels", {})
    inserted = _grouped((i.category, k) for k, f in enumerate(run.frames) for i in f.inserts)
    removed = _grouped((r.category, k) for k, f in enumerate(run.frames) for r in f.removed if not r.inserted)
    names = sorted({*after, *inserted, *removed})
    return [
        {
            "name": name,
            "before": after.get(name, 0) - len(inserted.get(name, ())) + len(removed.get(name, ())),
            "removed": len(removed.get(name, ())),
            "removed_link": filters.add(f"Removed labels of {name}", removed.get(name, ())),
            "inserted": len(inserted.get(name, ())),
            "inserted_link": filters.add(f"Inserted: {name}", inserted.get(name, ())),
            "after": after.get(name, 0),
        }
        for name in names
    ]


def _removed_rows(frames: Sequence[FrameRow], filters: Filters) -> list[dict[str, object]]:
    members = _grouped(((r.reason, r.category), k) for k, f in enumerate(frames) for r in f.removed)
    return [
        {
            "why": _why(reason),
            "category": category,
            "count": len(found),
            "link": filters.add(f"Removed labels of {category}: {_why(reason)}", found),
        }
        for (reason, category), found in members.items()
    ]


def _dropped_rows(frames: Sequence[FrameRow], filters: Filters) -> list[Part]:
    members = _grouped((reason, k) for k, f in enumerate(frames) for reason in f.missing)
    most_first = sorted(members.items(), key=lambda m: -len(m[1]))
    return frame_counts(((_why(reason), found) for reason, found in most_first), "Dropped objects", filters)


def _problem_groups(run: RunFacts, filters: Filters) -> list[dict[str, object]]:
    """Return the problems by code, each with its meaning, the first ones in words, and the frames behind them."""
    of_name = _grouped((name, k) for k, f in enumerate(run.frames) for name in (f.id, *f.background_names))
    of_code = _grouped((code, k) for k, f in enumerate(run.frames) for code in warning_codes(f))
    groups: dict[tuple[str, str], list[Problem]] = {}
    for p in run.problems:
        groups.setdefault((p.severity, p.code), []).append(p)
    rows = []
    for (severity, code), problems in sorted(groups.items()):
        found = {*of_code.get(code, ())}
        for p in problems:
            found.update(of_name.get(p.where.partition(": ")[0], ()))
        rows.append(
            {
                "severity": severity,
                "code": code,
                "meaning": MEANINGS.get(code, ""),
                "count": len(problems),
                "texts": [str(p) for p in problems[:SHOWN_PROBLEMS]],
                "more": max(0, len(problems) - SHOWN_PROBLEMS),
                "frames": len(found),
                "link": filters.add(f"Warning {code}", found),
            }
        )
    return rows


def _time_text(timing: Mapping[str, Any]) -> str:
    named = (("seconds", "in all"), ("frames_seconds", "for frames"), ("labels_seconds", "for labels"))
    parts = [f"{human_seconds(float(timing[key]))} {what}" for key, what in named if key in timing]
    if resumed := timing.get("resumed_frames"):
        parts.append(f"{resumed} frames were there already")
    return "; ".join(parts) + "." if parts else "The record of the run has no times."


def _time_rows(timing: Mapping[str, Any]) -> list[Part]:
    stages = sorted(timing.get("worker_seconds", {}).items(), key=lambda s: -s[1])
    most = float(stages[0][1]) or 1.0 if stages else 1.0
    return [Part(str(name), human_seconds(float(s)), float(s) / most) for name, s in stages]


# ---- frames and crops

Extreme = tuple[str, str, list[tuple[int, InsertRow]]]


def _extremes(frames: Sequence[FrameRow]) -> list[Extreme]:
    """Return (title, note, inserts with the numbers of their frames) of the inserts that are worth a look."""
    every = [(k, i) for k, f in enumerate(frames) for i in f.inserts]

    def first(key: Callable[[InsertRow], float | None], sign: int = 1) -> list[tuple[int, InsertRow]]:
        known = [(sign * v, k, i) for k, i in every if (v := key(i)) is not None]
        return [(k, i) for _, k, i in sorted(known, key=lambda e: (e[0], e[1], e[2].box_xyxy))[:CROPS]]

    found: list[Extreme] = [
        ("Smallest", "Can the object still be told from the background?", first(lambda i: i.size_px)),
        ("Faintest", "Smallest visible change of the picture.", first(lambda i: i.change_grey)),
        ("Largest", "Do shape, edge and texture hold up?", first(lambda i: i.size_px, -1)),
        ("Most hidden", "Smallest visible share: hidden by something in front, or cut by the frame.", first(_hidden)),
    ]
    return [e for e in found if e[2]]


def _tracks(frames: Sequence[FrameRow]) -> list[Extreme]:
    """Return the longest tracks, each at moments spread over its length; empty for single pictures."""
    of_track: dict[str, list[tuple[int, InsertRow]]] = {}
    for k, f in enumerate(frames):
        for i in f.inserts:
            if i.track:
                of_track.setdefault(i.track, []).append((k, i))
    longest = sorted(of_track.items(), key=lambda t: (-len(t[1]), t[0]))[:TRACKS]
    note = "From its first frame to its last: does it keep its shape, its level and its place?"
    return [
        (f"{seen[0][1].category} {name}, {len(seen)} frames", note, [seen[n] for n in _ends_and_between(len(seen))])
        for name, seen in longest
    ]


def _ends_and_between(count: int) -> list[int]:
    """Return at most `CROPS` of `count` numbers at even steps, the first and the last among them."""
    return list(range(count)) if count <= CROPS else [k * (count - 1) // (CROPS - 1) for k in range(CROPS)]


def _hidden(insert: InsertRow) -> float | None:
    return insert.visibility if insert.visibility is not None and insert.visibility < 0.995 else None


def _pictures(
    run: RunFacts, listed: Sequence[int], boxes: Sequence[tuple[int, Box]]
) -> tuple[dict[int, str], dict[tuple[int, Box], Crop]]:
    """Read each picture once; return thumbnails by frame, and crops by what `boxes` has: frame and box."""
    of_frame: dict[int, list[Box]] = {}
    for k, box in boxes:
        of_frame.setdefault(k, []).append(box)
    shown = {listed[n] for n in spread(len(listed), EMBEDDED)}
    thumbnails: dict[int, str] = {}
    crops: dict[tuple[int, Box], Crop] = {}
    for k in sorted(shown | of_frame.keys()):
        pixels = read_levels(run.root / IMAGES / run.frames[k].image)
        if pixels is None:
            continue
        if k in shown:
            thumbnails[k] = thumbnail(pixels)
        crops |= {(k, box): crop(pixels, box) for box in of_frame.get(k, ())}
    return thumbnails, crops


def _insert_entry(number: int, frame: FrameRow, insert: InsertRow, picture: Crop | None) -> dict[str, object]:
    boxes = [("", _rectangle(insert.box_xyxy))]
    text = _describe(insert)
    return {"number": number, "frame_id": frame.id, "picture": picture, "boxes": boxes, "text": text}


def _removed_entry(shown: RemovedCrop, frame: FrameRow, picture: Crop | None) -> dict[str, object]:
    boxes = [("lost", _rectangle(shown.box_xyxy))]
    _, _, width, height = boxes[0][1]
    text = f"{shown.label.category} {width:.0f} x {height:.0f} px, {100 * shown.label.covered_share:.0f} % covered"
    if shown.cover is not None:
        boxes.append(("", _rectangle(shown.cover.box_xyxy)))
        text += f"; over it: {_describe(shown.cover)}"
    return {"number": shown.frame, "frame_id": frame.id, "picture": picture, "boxes": boxes, "text": text}


def _frame_entry(number: int, frame: FrameRow, picture: str | None, members: Sequence[str]) -> dict[str, object]:
    facts = [
        *([] if frame.camera_pitch_deg is None else [f"pitch {compact(round(frame.camera_pitch_deg, 1))}°"]),
        *([] if frame.camera_height_m is None else [f"altitude {compact(frame.camera_height_m)} m"]),
        *([] if frame.time_text is None else [frame.time_text]),
    ]
    dropped = Counter(frame.missing)
    removed = Counter(r.category for r in frame.removed)
    notes = [f"dropped: {n} {_why(reason)}" for reason, n in sorted(dropped.items())]
    notes += [f"removed labels: {n} {category}" for category, n in sorted(removed.items())]
    notes += [f"warning {code}" for code in sorted(warning_codes(frame))]
    changes = [i.change_grey for i in frame.inserts if i.change_grey is not None]
    return {
        "number": number,
        "frame_id": frame.id,
        "href": quote(f"{IMAGES}/{frame.image}", errors="replace"),
        "picture": picture,
        "size_wh": frame.size_wh,
        "boxes": [_rectangle(i.box_xyxy) for i in frame.inserts[:SHOWN_INSERTS]],
        "facts": ", ".join(facts),
        "inserts": [_describe(i) for i in frame.inserts[:SHOWN_INSERTS]],
        "more": max(0, len(frame.inserts) - SHOWN_INSERTS),
        "notes": notes,
        "members": " ".join(members),
        "size": compact(frame.size_px),
        "change": compact(min(changes, default=None)),
        "seen": compact(frame.visibility),
    }


def _rectangle(box: Box) -> tuple[float, float, float, float]:
    x0, y0, x1, y1 = box
    return round(x0, 1), round(y0, 1), round(x1 - x0, 1), round(y1 - y0, 1)


def _describe(insert: InsertRow) -> str:
    _, _, width, height = _rectangle(insert.box_xyxy)
    parts = [f"{insert.category} {width:.0f} x {height:.0f} px"]
    if insert.range_m is not None:
        parts.append(f"{compact(round(insert.range_m, 1))} m away")
    if insert.change_grey is not None:
        parts.append(f"change {insert.change_grey:.0f}")
    if insert.visibility is not None and insert.visibility < 0.995:
        parts.append(f"{100 * insert.visibility:.0f} % visible")
    return ", ".join(parts)


THUMBNAIL_PX = 200
CROP_PX = 240
_MIN_WINDOW_PX = 48
_THUMBNAIL_QUALITY = 70
_CROP_QUALITY = 88


@dataclass(frozen=True)
class Crop:
    """A part of a frame around an object.

    Attributes:
        uri: Picture as a data URI.
        view: Left, top, width and height in the frame, pixels.
        zoom: Factor by which the page enlarges it.
    """

    uri: str
    view: tuple[int, int, int, int]
    zoom: float


def read_levels(path: Path) -> NDArray[np.uint8] | None:
    """Return the (h, w) 8-bit levels of a frame, 16-bit ones stretched; None if it cannot be read."""
    if leaves_folder(path):
        return None
    try:
        pixels: NDArray[Any] = load_background(path).pixels
    except DatasetError:
        return None
    return to_8_bit(pixels)


def thumbnail(pixels: NDArray[np.uint8]) -> str:
    """Return a small JPEG of a frame as a data URI."""
    return _jpeg(_at_most(pixels, THUMBNAIL_PX), _THUMBNAIL_QUALITY)


def crop(pixels: NDArray[np.uint8], box: Box) -> Crop:
    """Return the part of a frame around a box."""
    height, width = pixels.shape
    left, top, wide, high = _window(box, (width, height))
    part = pixels[top : top + high, left : left + wide]
    small = max(wide, high) <= CROP_PX // 2
    uri = _uri(".png", part, (), "png") if small else _jpeg(_at_most(part, CROP_PX), _CROP_QUALITY)
    return Crop(uri, (left, top, wide, high), round(CROP_PX / wide, 1))


def _window(box: Box, frame_wh: Sequence[int]) -> tuple[int, int, int, int]:
    """Return left, top, width and height of a window of 4:3 around a box, inside the frame."""
    x0, y0, x1, y1 = box
    wide = max(_MIN_WINDOW_PX, 1.5 * (x1 - x0), 1.5 * 4 / 3 * (y1 - y0))
    w, h = min(frame_wh[0], round(wide)), min(frame_wh[1], round(wide * 3 / 4))
    left = min(max(0, round((x0 + x1 - w) / 2)), frame_wh[0] - w)
    top = min(max(0, round((y0 + y1 - h) / 2)), frame_wh[1] - h)
    return left, top, w, h


def _at_most(pixels: NDArray[np.uint8], side_px: int) -> NDArray[np.uint8]:
    height, width = pixels.shape
    factor = side_px / max(width, height)
    if factor >= 1:
        return pixels
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def _jpeg(pixels: NDArray[np.uint8], quality: int) -> str:
    return _uri(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, quality), "jpeg")


def _uri(suffix: str, pixels: NDArray[np.uint8], options: Sequence[int], kind: str) -> str:
    done, data = cv2.imencode(suffix, np.ascontiguousarray(pixels), list(options))
    assert done
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
