"""Measures maps of places on points of real pictures that people labelled by eye.

    INFRABLEND_REAL_DATA=DIR .venv/bin/python bench/places.py

`given` are the points of `places/points.json` in the folder, `own` those of `places_by_day.json` beside this script,
labelled at other pictures before anything was tuned to them; `_by_day` are those of either that are known to show the
day. Points that could not be told are not among `own`; their number is stated.

`stand`: ground to stand on against trees, shrubs, roofs, walls, water, vehicles and objects. `drive`: roads to drive
on against the same. `road_grass`: the same roads against grass. Points that the labeller was sure of. Figures are
areas under the ROC curve, with intervals of 95 % from drawing the pictures again. `labelled` are the same with the
factors that HIT-UAV's labels of cars give to kinds of ground, learned without the pictures that have points. Boxes of
labels are not used otherwise. The points hold hardly any water or shrub and no sky, so they say nothing of these.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from infrablend import api
from infrablend.core.dataset import ImageRecord
from infrablend.core.surface_kinds import SURFACES
from infrablend.errors import DatasetError
from infrablend.formats.cameras.raw_temperatures import read_temperatures
from infrablend.formats.pictures.images import load_background
from infrablend.imaging.surfaces import DRIVE, STAND, Grey, find_surfaces, model_version
from infrablend.lab.realism.classify import auc, bootstrap
from infrablend.report.preview import spread
from infrablend.sampling.labelled_ground import LabelledGround, learn_ground, with_labels

OFF_LIMITS = {"tree", "shrub", "roof", "wall", "water", "vehicle", "object"}
SURE = 2
OWN = Path(__file__).parent / "places_by_day.json"
FOLDERS = ("hit-uav", "wisard", "bambi", "camel", "flight")


@dataclass(frozen=True)
class Found:
    """A labelled point, and what the map of its picture says there.

    Attributes:
        frame: Number of its picture.
        own: Whether it is one of this repository's.
        by_day: Whether its picture is known to show the day.
        surface: What people see there.
        stand: 1 for ground to stand on.
        drive: 1 for ground to drive on.
        scores: The map's, by name.
        kind: The likeliest kind of surface.
    """

    frame: int
    own: bool
    by_day: bool
    surface: str
    stand: int
    drive: int
    scores: Mapping[str, float]
    kind: str


def learn_cars(images: Sequence[ImageRecord]) -> LabelledGround:
    """Return on which kinds of ground labelled cars are, from 300 pictures."""
    shown = [i for i in images if any(o.category == "Car" for o in i.instances)]
    some = [shown[k] for k in spread(len(shown), 300)]
    return learn_ground(
        ((load_background(i.path, i.size_wh).pixels, i.instances, i.capture.time_of_day) for i in some), {"Car"}
    )


def read_pixels(path: Path) -> Grey:
    """Return the levels of a picture: raw counts where it has them."""
    try:
        return read_temperatures(path).counts
    except DatasetError:
        return load_background(path).pixels


def find_points(data: Path, frames: Sequence[Mapping[str, Any]], own: int) -> tuple[list[Found], list[float]]:
    """Return the points that the labeller was sure of, and the processor seconds of each map.

    Args:
        data: Folder of real pictures.
        frames: Pictures with their points; the first ones are given.
        own: Number of the first picture of the others.
    """
    pictures = {p.name: p for name in FOLDERS for p in sorted((data / name).rglob("*")) if p.suffix.lower() != ".json"}
    labelled = {i.path.name: i for i in api.read_dataset(data / "hit-uav").images}
    cars = learn_cars([i for name, i in labelled.items() if name not in {f["file"] for f in frames}])
    rows, seconds = [], []
    for number, frame in enumerate(frames):
        pixels = read_pixels(pictures[frame["file"]])
        begun = time.process_time()
        found = find_surfaces(pixels)
        seconds.append(time.process_time() - begun)
        of_set = labelled.get(frame["file"])
        time_of_day = frame.get("time") if of_set is None else of_set.capture.time_of_day
        affinity = with_labels(DRIVE, {} if of_set is None else cars, "Car", time_of_day)
        shares = {"stand": found.share(STAND), "drive": found.share(DRIVE), "labelled": found.share(affinity)}
        kinds = found.kinds()
        for p in frame["points"]:
            if p["sure"] >= SURE and p["surface"] != "unclear":
                x, y = min(int(p["x"]), pixels.shape[1] - 1), min(int(p["y"]), pixels.shape[0] - 1)
                scores = {name: float(share[y, x]) for name, share in shares.items()}
                facts = (number >= own, time_of_day == "day", p["surface"], p["stand"], p["drive"])
                rows.append(Found(number, *facts, scores, SURFACES[kinds[y, x]]))
    return rows, seconds


def judged(rows: Sequence[Found]) -> dict[str, object]:
    """Return areas under the curve, and which kinds are found for each surface."""
    frames = np.unique([r.frame for r in rows], return_inverse=True)[1]
    off = np.array([r.surface in OFF_LIMITS for r in rows])
    roads = np.array([r.surface == "road" and r.drive == 1 for r in rows])
    ground = np.array([r.stand == 1 for r in rows])
    grass = np.array([r.surface == "grass" for r in rows])
    sides = {
        "stand": ("stand", ground, off), "drive": ("drive", roads, off), "road_grass": ("drive", roads, grass),
        "labelled_drive": ("labelled", roads, off), "labelled_road_grass": ("labelled", roads, grass),
    }  # fmt: skip
    report: dict[str, object] = {}
    for name, (score, yes, no) in sides.items():
        use = yes | no
        y, scores = yes[use].astype(np.int64), np.array([r.scores[score] for r in rows])[use]
        low, high = bootstrap(y, scores, frames[use])
        report[name] = {
            "auc": round(auc(y, scores), 3), "ci": [round(low, 3), round(high, 3)],
            "yes": int(yes.sum()), "no": int(no.sum()),
        }  # fmt: skip
    surfaces = sorted({r.surface for r in rows})
    report["found"] = {
        s: {k: n for k in SURFACES if (n := sum(r.surface == s and r.kind == k for r in rows))} for s in surfaces
    }
    return report


def main() -> int:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("INFRABLEND_REAL_DATA"))
    data = parser.parse_args().data
    if data is None:
        parser.error("set INFRABLEND_REAL_DATA, or give --data")
    given, own = (json.loads(path.read_text()) for path in (data / "places" / "points.json", OWN))
    rows, seconds = find_points(data, [*given, *own], len(given))
    report: dict[str, object] = {"model": model_version(), "cpu_s": round(float(np.median(seconds)), 3)}
    report["undecided"] = sum(f["undecided"] for f in own)
    for name, of_set in (("given", [r for r in rows if not r.own]), ("own", [r for r in rows if r.own])):
        report[name] = judged(of_set)
        report[f"{name}_by_day"] = judged([r for r in of_set if r.by_day])
    print(json.dumps(report, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
