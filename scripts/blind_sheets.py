#!/usr/bin/env python
"""Lets people judge where inserted objects stand, without knowing which run made them.

    .venv/bin/python scripts/blind_sheets.py make --run before=RUN --run after=RUN --class Car --out sheets
    .venv/bin/python scripts/blind_sheets.py score sheets sheets/answers.csv [OTHER.csv]

`make` draws objects of the runs, a few per picture, and writes them mixed and numbered: `sheet_01.png` and so on,
`answers.csv` to fill in, and `key.json`, which says what was what and stays closed until then. Runs with frames of the
same names give the same pictures, where these have such objects. `score` counts the answers by run.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from infrablend.core.dataset import Instance
from infrablend.core.files import load_json, write_json, write_text
from infrablend.core.output_checks import require_outside_datasets
from infrablend.core.rng import stream
from infrablend.core.run_folder import RunFolder
from infrablend.errors import ArgumentError, InfraBlendError
from infrablend.report.figures import decimals, interval
from infrablend.report.page import Table
from infrablend.report.preview import (
    INK,
    INSERTED,
    TITLE_PX,
    Rgb,
    decode_picture,
    draw_polygon,
    grid,
    strip,
    to_rgb,
    write_sheet,
)

RIGHT, UNCLEAR = "right", "unclear"
PLACES = (RIGHT, "grass", "kerb", "court", "tree", "roof", "water", "object", "road", "other", UNCLEAR)
HEADINGS = ("yes", "no", "")
COLUMNS = ("number", "place", "heading")
PER_PICTURE = 3
VIEW_WH = (400, 320)
ENLARGED, SHOWN = 0.25, 0.5  # largest share of a cell's sides: of boxes shown at twice their size, and of any box
SHEET_COLUMNS, SHEET_CELLS = 3, 12
TICK_PX, TICK_GAP_PX = 9, 3
Answers = Mapping[str, tuple[str, str]]
"""Place and heading by number."""


def drawn(name: str, run: Path, category: str, count: int, seed: int) -> list[tuple[str, str, Instance]]:
    """Return at most `count` inserted objects of a run, each with the run's name and its picture.

    One of each picture comes first, then a second one, up to `PER_PICTURE`.
    """
    found: list[tuple[int, float, str, Instance]] = []
    seen: Counter[str] = Counter()
    for record in RunFolder(run).records():
        seen.update(i.category for i in record.inserted)
        objects = [i for i in record.inserted if i.category == category]
        place = float(stream(seed, record.frame_id).random())
        order = stream(seed, record.frame_id, name).permutation(len(objects))[:PER_PICTURE]
        found += [(turn, place, record.image, objects[n]) for turn, n in enumerate(order)]
    if not found:
        raise ArgumentError(f"{run}: no inserted object of class {category!r}; it has {', '.join(sorted(seen)) or '-'}")
    return [(name, picture, one) for _, _, picture, one in sorted(found, key=lambda f: f[:3])[:count]]


def cell(number: int, pixels: Rgb, box_xyxy: np.ndarray[Any, Any]) -> Rgb:
    """Return the surroundings of an object under its number, with ticks outside the corners of its box."""
    shrink = math.ceil(((box_xyxy[2:] - box_xyxy[:2]) / VIEW_WH).max() / SHOWN)
    if shrink > 1:
        pixels, box_xyxy = cv2.resize(pixels, None, None, 1 / shrink, 1 / shrink, cv2.INTER_AREA), box_xyxy / shrink
    frame_wh, size_wh = np.array(pixels.shape[1::-1]), box_xyxy[2:] - box_xyxy[:2]
    zoom = 2 if (size_wh / VIEW_WH).max() * 2 <= ENLARGED else 1
    view_wh = np.minimum(frame_wh, np.array(VIEW_WH) // zoom)
    middle = (box_xyxy[:2] + box_xyxy[2:]) / 2
    x, y = (int(v) for v in np.clip(np.round(middle - view_wh / 2), 0, frame_wh - view_wh))
    part = pixels[y : y + view_wh[1], x : x + view_wh[0]]
    canvas = np.repeat(np.repeat(part, zoom, 0), zoom, 1)
    gap, arm_wh = TICK_GAP_PX / zoom, np.minimum(TICK_PX / zoom, size_wh / 3)
    for way in np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]):
        corner = middle + way * (size_wh / 2 + gap)
        ends = corner - way * arm_wh
        tick = np.array([[ends[0], corner[1]], corner, [corner[0], ends[1]]])
        draw_polygon(canvas, tick, INSERTED["boxes"], zoom, (x, y), closed=False)
    return np.vstack([strip(canvas.shape[1], TITLE_PX, str(number), 18, INK), canvas])


def make(runs: Mapping[str, Path], category: str, count: int, seed: int, out: Path) -> None:
    """Write the sheets, the key and the answers to fill in."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ArgumentError(f"{out}: exists; expected a new folder. Nothing was touched")
    objects = []
    for k, (name, run) in enumerate(runs.items()):
        require_outside_datasets(run, out / "key.json")
        wanted = count // len(runs) + (k < count % len(runs))
        objects += (of_run := drawn(name, run, category, wanted, seed))
        print(f"{name}: {len(of_run)} of {wanted} objects in {len({p for _, p, _ in of_run})} pictures")
    objects = [objects[n] for n in stream(seed, "order").permutation(len(objects))]
    key, cells = {}, []
    for number, (name, picture, one) in enumerate(objects, 1):
        box = [round(float(v), 2) for v in one.box_xyxy]
        key[str(number)] = {"run": name, "picture": picture, "box_xyxy": box, "class": category}
        file = RunFolder(runs[name]).image(picture)
        pixels = to_rgb(decode_picture(file, "a frame of the run. Run `generate --resume`", runs[name]))
        cells.append(cell(number, pixels, one.box_xyxy))
    for start in range(0, len(cells), SHEET_CELLS):
        sheet = grid(cells[start : start + SHEET_CELLS], SHEET_COLUMNS)
        title = f"{category} between the corners.  place: {', '.join(PLACES)}.  heading: yes, no or nothing"
        sheet = np.vstack([strip(sheet.shape[1], TITLE_PX, title, 14, INK), sheet])
        write_sheet(out / f"sheet_{start // SHEET_CELLS + 1:02}.png", sheet)
    write_json(out / "key.json", key)
    write_text(out / "answers.csv", "".join(f"{line}\n" for line in [",".join(COLUMNS), *(f"{n},," for n in key)]))


def read_answers(path: Path, key: Mapping[str, Any]) -> tuple[Answers, list[str]]:
    """Return the answers of a file, and what is wrong with it; spreadsheets may have written it."""
    text = path.read_text("utf-8-sig", errors="replace")
    rows = csv.DictReader(io.StringIO(text), delimiter=";" if ";" in text.partition("\n")[0] else ",")
    if not set(COLUMNS) <= set(rows.fieldnames or ()):
        return {}, [f"{path}: columns {rows.fieldnames}, expected {', '.join(COLUMNS)}"]
    found: dict[str, tuple[str, str]] = {}
    wrong = []
    for row in rows:
        number, place, heading = ((row[c] or "").strip().lower() for c in COLUMNS)
        if not place + heading:
            continue
        where = f"{path}, line {rows.line_num}: "
        if number not in key or number in found:
            wrong.append(f"{where}number {number!r}, expected each from 1 to {len(key)} once")
        if place not in PLACES:
            wrong.append(f"{where}place {place!r}, expected {', '.join(PLACES)}")
        if heading not in HEADINGS:
            wrong.append(f"{where}heading {heading!r}, expected yes, no or nothing")
        found[number] = place, heading
    if missing := sorted(key.keys() - found.keys(), key=int):
        wrong.append(f"{path}: no answer for {', '.join(missing)}")
    return found, wrong


def wilson(hits: int, count: int) -> tuple[float, float] | None:
    """Return the 95 % interval of a share after Wilson; None if nothing was counted."""
    if not count:
        return None
    z = 1.959964
    share, scale = hits / count, 1 + z**2 / count
    middle = (share + z**2 / (2 * count)) / scale
    half = z / scale * math.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def table(answers: Answers, key: Mapping[str, Any]) -> str:
    """Return the counts of one judge by run."""
    rows = []
    for name in sorted({of["run"] for of in key.values()}):
        given = [answers[n] for n, of in key.items() if of["run"] == name]
        places, headings = (Counter(column) for column in zip(*given, strict=True))
        judged, right = len(given) - places[UNCLEAR], places[RIGHT]
        share = f"{decimals(right / judged if judged else None)} ({interval(wilson(right, judged))})"
        wrong = ", ".join(f"{p} {places[p]}" for p in PLACES[1:-1] if places[p]) or "-"
        heading = f"{headings['yes']} of {headings['yes'] + headings['no']}"
        rows.append([name, str(judged), str(places[UNCLEAR]), str(right), share, wrong, heading])
    return Table(["run", "judged", "unclear", "right", "share (95 %)", "wrong", "heading right"], rows).markdown()


def agreement(first: Answers, second: Answers) -> tuple[int, float | None, float | None]:
    """Return how many objects two judges judged both, the share they agree on, right or not, and Cohen's kappa."""
    both = [(first[n][0], second[n][0]) for n in first if UNCLEAR not in (first[n][0], second[n][0])]
    if not both:
        return 0, None, None
    right = np.array(both) == RIGHT
    equal = float((right[:, 0] == right[:, 1]).mean())
    a, b = right.mean(axis=0)
    chance = float(a * b + (1 - a) * (1 - b))
    return len(both), equal, (equal - chance) / (1 - chance) if chance < 1 else None


def score(folder: Path, files: list[Path]) -> list[str]:
    """Print the counts by run, and the agreement of two judges; return what is wrong with the answers instead."""
    key = load_json(folder / "key.json")
    read = [read_answers(path, key) for path in files]
    if wrong := [line for _, lines in read for line in lines]:
        return wrong
    for path, (answers, _) in zip(files, read, strict=True):
        print(f"{path}\n\n{table(answers, key)}\n")
    if len(read) > 1:
        count, equal, kappa = agreement(read[0][0], read[1][0])
        print(f"Both judged {count}: right or not is equal for {decimals(equal)} of them, kappa {decimals(kappa)}")
    return []


def main(words: list[str] | None = None) -> int:
    """Make sheets, or score answers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    of_make = commands.add_parser("make", help="write sheets of inserted objects")
    of_make.add_argument("--run", action="append", required=True, metavar="NAME=DIR", help="run; repeatable")
    of_make.add_argument("--class", dest="category", required=True, help="class of the objects")
    of_make.add_argument("--count", type=int, default=100, help="objects of all runs together [100]")
    of_make.add_argument("--seed", type=int, default=1, help="the same seed gives the same bytes [1]")
    of_make.add_argument("--out", type=Path, required=True, help="new folder")
    of_score = commands.add_parser("score", help="count answers by run")
    of_score.add_argument("folder", type=Path, help="folder of the sheets")
    of_score.add_argument("answers", type=Path, nargs="+", help="answers of one judge, or of two")
    asked = parser.parse_args(words)
    try:
        if asked.command == "score":
            if len(asked.answers) > 2:
                of_score.error(f"{len(asked.answers)} files of answers, expected one or two")
            wrong = score(asked.folder, asked.answers)
            print("\n".join(wrong), end="\n" if wrong else "", file=sys.stderr)
            return 2 if wrong else 0
        pairs = [run.partition("=")[::2] for run in asked.run]
        runs = {name: Path(run) for name, run in pairs if name and run}
        if len(runs) < len(pairs) or asked.count < len(pairs):
            of_make.error("expected --run NAME=DIR, each NAME once, and --count of at least one per run")
        make(runs, asked.category, asked.count, asked.seed, asked.out)
    except (InfraBlendError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
