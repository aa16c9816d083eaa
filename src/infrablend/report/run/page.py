"""The HTML page of a run: charts, tables, crops, and a list of frames that every number leads to.

The size of the page is bounded: at most `LISTED` frames are listed, of which `EMBEDDED`, spread over the run, have a
picture inside the page; all numbers count all frames. A frame takes about 1 kB, its picture about 6 kB.
"""

from __future__ import annotations

import base64
import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from infrablend.errors import Problem
from infrablend.report.figures import compact, human_seconds
from infrablend.report.page import page_part, render_page
from infrablend.report.run.charts import Chart, Share, frame_histogram, histogram, position_map, shares
from infrablend.report.run.facts import Box, Filters, FrameFacts, InsertFacts, RemovedCrop, RunFacts, removed_crops
from infrablend.report.run.pictures import Crop, crop, read_levels, thumbnail

LISTED = 10_000
EMBEDDED = 1000
CROPS = 8
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
    "no_horizon": "no horizon known, found or stated",
    "noise": "the picture is little but noise",
}


def run_page(run: RunFacts) -> str:
    """Return the HTML page of a run; equal runs give equal bytes, except for the section of times."""
    frames, filters = run.frames, Filters()
    warnings = _problem_groups(run, filters)
    charts = _charts(frames, filters)
    groups = _share_groups(run, filters)
    content = {
        "tiles": _tiles(run, filters),
        "warnings": [w for w in warnings if w["severity"] == "warning"],
        "errors": [w for w in warnings if w["severity"] != "warning"],
        "charts": charts,
        "share_groups": groups,
        "classes": _class_rows(run, filters),
        "removed": _removed_rows(frames, filters),
        "dropped": _dropped_rows(frames, filters),
        "time_text": _time_text(run.timing),
        "time_rows": _time_rows(run.timing),
    }
    extremes = _extremes(frames)
    taken = removed_crops(frames, CROPS)
    boxes = [(k, i.box_xyxy) for _, _, found in extremes for k, i in found]
    boxes += [(c.frame, c.window_xyxy) for found in taken.values() for c in found]
    listed = _listed(len(frames), {k for k, _ in boxes})
    pictures = _pictures(run, listed, boxes)
    members = filters.classes(len(frames))
    script = page_part("run_script.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return render_page(
        "run",
        run=run,
        objects=", ".join(f"{name} {n}" for name, n in run.counts.get("labels_inserted", {}).items()),
        excluded=list(run.excluded.items())[:SHOWN_FRAMES],
        extremes=[
            (title, note, [_crop_entry(k, frames[k], i, pictures.crops.get((k, i.box_xyxy))) for k, i in found])
            for title, note, found in extremes
        ],
        removed_crops=[
            (REASONS.get(reason, reason), [_removed_entry(frames[c.frame], c, pictures) for c in found])
            for reason, found in taken.items()
        ],
        filters=filters.all,
        frames=[_frame_entry(k, frames[k], pictures.thumbnails.get(k), members[k]) for k in listed],
        embedded=len(pictures.thumbnails),
        script=script,
        script_digest=digest,
        **content,
    )


# ---- numbers


def _tiles(run: RunFacts, filters: Filters) -> list[tuple[str, str, str]]:
    """Return (number, what it counts, link)."""
    frames, counts = run.frames, run.counts
    without = [k for k, f in enumerate(frames) if not f.inserts]
    dropped = sum(len(f.dropped) for f in frames)
    removed = sum(len(f.removed) for f in frames)
    rows = [
        (len(frames), "frames", "#frames"),
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
    return [(str(n), what, link if n else "") for n, what, link in rows]


def _charts(frames: Sequence[FrameFacts], filters: Filters) -> list[Chart]:
    found = [
        histogram(frames, lambda i: i.size_px, "Size: longer side of the box", filters, unit=" px"),
        histogram(frames, lambda i: i.range_m, "Range: camera to object", filters, unit=" m"),
        frame_histogram(frames, lambda f: f.pitch_deg, "Pitch of the camera below the horizon", filters, "°"),
        histogram(frames, lambda i: i.change_grey, "Visible change of the picture, grey levels", filters),
        histogram(frames, lambda i: i.signed_grey, "Contrast in grey levels, below 0 for darker", filters),
        histogram(frames, lambda i: i.visibility, "Visible share of the object", filters, unit=" %", share=True),
        position_map(frames, filters),
    ]
    return [c for c in found if c is not None]


def _share_groups(run: RunFacts, filters: Filters) -> list[tuple[str, list[Share]]]:
    def rows(key: Callable[[FrameFacts], str], what: str) -> list[Share]:
        members: dict[str, list[int]] = {}
        for k, f in enumerate(run.frames):
            members.setdefault(key(f), []).append(k)
        return shares(
            [(name, len(m), f"{len(m)}", filters.add(f"{what}: {name}", m)) for name, m in sorted(members.items())]
        )

    return [
        ("Frames by time of day", rows(lambda f: f.time_of_day or "unknown", "Time of day")),
        ("Frames by split", rows(lambda f: f.frame_id.partition("/")[0], "Split")),
        ("Frames by number of inserted objects", rows(lambda f: str(len(f.inserts)), "Inserted objects per frame")),
    ]


def _class_rows(run: RunFacts, filters: Filters) -> list[dict[str, Any]]:
    after = run.counts.get("labels", {})
    inserted: dict[str, list[int]] = {}
    removed: dict[str, list[int]] = {}
    for k, f in enumerate(run.frames):
        for i in f.inserts:
            inserted.setdefault(i.category, []).append(k)
        for r in f.removed:
            if not r.inserted:
                removed.setdefault(r.category, []).append(k)
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


def _removed_rows(frames: Sequence[FrameFacts], filters: Filters) -> list[dict[str, Any]]:
    members: dict[tuple[str, str], list[int]] = {}
    for k, f in enumerate(frames):
        for r in f.removed:
            members.setdefault((r.reason, r.category), []).append(k)
    return [
        {
            "why": REASONS.get(reason, reason.replace("_", " ")),
            "category": category,
            "count": len(found),
            "link": filters.add(f"Removed labels of {category}: {REASONS.get(reason, reason)}", found),
        }
        for (reason, category), found in sorted(members.items())
    ]


def _dropped_rows(frames: Sequence[FrameFacts], filters: Filters) -> list[Share]:
    members: dict[str, list[int]] = {}
    for k, f in enumerate(frames):
        for reason in f.dropped:
            members.setdefault(reason, []).append(k)
    rows = []
    for reason, found in sorted(members.items(), key=lambda m: (-len(m[1]), m[0])):
        text = REASONS.get(reason, reason.replace("_", " "))
        rows.append((text, len(found), str(len(found)), filters.add(f"Dropped objects: {text}", found)))
    return shares(rows)


def _problem_groups(run: RunFacts, filters: Filters) -> list[dict[str, Any]]:
    """Return the problems by code, each with the first ones in words and the frames behind them."""
    of_name: dict[str, list[int]] = {}
    of_code: dict[str, list[int]] = {}
    for k, f in enumerate(run.frames):
        for name in (f.frame_id, *sorted(f.background)):
            of_name.setdefault(name, []).append(k)
        for code in sorted(f.warnings):
            of_code.setdefault(code, []).append(k)
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


def _time_rows(timing: Mapping[str, Any]) -> list[Share]:
    stages = timing.get("worker_seconds", {})
    return shares(
        [(str(name), float(s), human_seconds(float(s)), "") for name, s in sorted(stages.items(), key=lambda s: -s[1])]
    )


# ---- frames and crops

Extreme = tuple[str, str, list[tuple[int, InsertFacts]]]


def _extremes(frames: Sequence[FrameFacts]) -> list[Extreme]:
    """Return (title, note, inserts with the numbers of their frames) of the inserts that are worth a look."""
    every = [(k, i) for k, f in enumerate(frames) for i in f.inserts]

    def first(key: Callable[[InsertFacts], float | None], sign: int) -> list[tuple[int, InsertFacts]]:
        known = [(sign * v, k, i) for k, i in every if (v := key(i)) is not None]
        return [(k, i) for _, k, i in sorted(known, key=lambda e: (e[0], e[1], e[2].box_xyxy))[:CROPS]]

    found: list[Extreme] = [
        ("Smallest", "Can the object still be told from the background?", first(lambda i: i.size_px, 1)),
        ("Faintest", "Smallest visible change of the picture.", first(lambda i: i.change_grey, 1)),
        ("Largest", "Do shape, edge and texture hold up?", first(lambda i: i.size_px, -1)),
        (
            "Most hidden",
            "Smallest visible share: hidden by something in front, or cut by the frame.",
            first(_hidden, 1),
        ),
    ]
    return [e for e in found if e[2]]


def _hidden(insert: InsertFacts) -> float | None:
    return insert.visibility if insert.visibility is not None and insert.visibility < 0.995 else None


def _listed(count: int, always: Iterable[int]) -> list[int]:
    """Return the numbers of the frames to list: all, or some spread over the run and those in `always`."""
    if count <= LISTED:
        return list(range(count))
    return sorted({*_spread(count, LISTED), *always})


def _spread(count: int, wanted: int) -> list[int]:
    return list(range(count)) if count <= wanted else [(2 * k + 1) * count // (2 * wanted) for k in range(wanted)]


@dataclass(frozen=True)
class _Pictures:
    """Pictures inside the page, by frame and by frame and box."""

    thumbnails: Mapping[int, str]
    crops: Mapping[tuple[int, Box], Crop]


def _pictures(run: RunFacts, listed: Sequence[int], boxes: Sequence[tuple[int, Box]]) -> _Pictures:
    """Read each picture once, and keep small ones only: `boxes` are the crops, (frame, box)."""
    of_frame: dict[int, list[Box]] = {}
    for k, box in boxes:
        of_frame.setdefault(k, []).append(box)
    shown = {listed[n] for n in _spread(len(listed), EMBEDDED)}
    thumbnails: dict[int, str] = {}
    crops: dict[tuple[int, Box], Crop] = {}
    for k in sorted(shown | of_frame.keys()):
        pixels = read_levels(run.root / run.frames[k].image)
        if pixels is None:
            continue
        if k in shown:
            thumbnails[k] = thumbnail(pixels)
        crops |= {(k, box): crop(pixels, box) for box in of_frame.get(k, ())}
    return _Pictures(thumbnails, crops)


def _crop_entry(number: int, frame: FrameFacts, insert: InsertFacts, picture: Crop | None) -> dict[str, Any]:
    return {
        "number": number,
        "frame_id": frame.frame_id,
        "picture": picture,
        "boxes": [("", _rectangle(insert.box_xyxy))],
        "text": describe_insert(insert),
    }


def _removed_entry(frame: FrameFacts, shown: RemovedCrop, pictures: _Pictures) -> dict[str, Any]:
    boxes = [("lost", _rectangle(shown.box_xyxy))]
    _, _, width, height = boxes[0][1]
    text = f"{shown.label.category} {width:.0f} x {height:.0f} px, {100 * shown.label.covered_share:.0f} % covered"
    if shown.cover is not None:
        boxes.append(("", _rectangle(shown.cover.box_xyxy)))
        text += f"; over it: {describe_insert(shown.cover)}"
    return {
        "number": shown.frame,
        "frame_id": frame.frame_id,
        "picture": pictures.crops.get((shown.frame, shown.window_xyxy)),
        "boxes": boxes,
        "text": text,
    }


def _frame_entry(number: int, frame: FrameFacts, picture: str | None, members: Sequence[str]) -> dict[str, Any]:
    facts = [
        *([] if frame.pitch_deg is None else [f"pitch {compact(round(frame.pitch_deg, 1))}°"]),
        *([] if frame.altitude_m is None else [f"altitude {compact(frame.altitude_m)} m"]),
        *([] if frame.time_of_day is None else [frame.time_of_day]),
    ]
    dropped, removed = Counter(frame.dropped), Counter(r.category for r in frame.removed)
    notes = [f"dropped: {n} {REASONS.get(why, why.replace('_', ' '))}" for why, n in sorted(dropped.items())]
    notes += [f"removed labels: {n} {category}" for category, n in sorted(removed.items())]
    notes += [f"warning {code}" for code in sorted(frame.warnings)]
    changes = [i.change_grey for i in frame.inserts if i.change_grey is not None]
    seen = [i.visibility for i in frame.inserts if i.visibility is not None]
    return {
        "number": number,
        "frame_id": frame.frame_id,
        "href": quote(frame.image, errors="replace"),
        "picture": picture,
        "size_wh": frame.size_wh,
        "boxes": [_rectangle(i.box_xyxy) for i in frame.inserts[:SHOWN_INSERTS]],
        "facts": ", ".join(facts),
        "inserts": [describe_insert(i) for i in frame.inserts[:SHOWN_INSERTS]],
        "more": max(0, len(frame.inserts) - SHOWN_INSERTS),
        "notes": notes,
        "members": " ".join(members),
        "size": compact(min((i.size_px for i in frame.inserts), default=None)),
        "change": compact(min(changes, default=None)),
        "seen": compact(min(seen, default=None)),
    }


def _rectangle(box: Box) -> tuple[float, float, float, float]:
    x0, y0, x1, y1 = box
    return round(x0, 1), round(y0, 1), round(x1 - x0, 1), round(y1 - y0, 1)


def describe_insert(insert: InsertFacts) -> str:
    """Return class, size, range, contrast and visibility of an inserted object in words."""
    _, _, width, height = _rectangle(insert.box_xyxy)
    parts = [f"{insert.category} {width:.0f} x {height:.0f} px"]
    if insert.range_m is not None:
        parts.append(f"{compact(round(insert.range_m, 1))} m away")
    if insert.change_grey is not None:
        parts.append(f"change {insert.change_grey:.0f}")
    if insert.visibility is not None and insert.visibility < 0.995:
        parts.append(f"{100 * insert.visibility:.0f} % visible")
    return ", ".join(parts)
