"""Measures maps of places on points of real pictures that people labelled by eye.

    INFRABLEND_REAL_DATA=DIR .venv/bin/python bench/places.py

`stand`: ground to stand on against trees, shrubs, roofs, walls, water, vehicles and objects. `drive`: roads to drive
on against the same. `road_grass`: the same roads against grass. Points that the labeller was sure of. Figures are
areas under the ROC curve, with intervals of 95 % from drawing the pictures again. `labelled` are the same with the
factors that HIT-UAV's labels of cars give to kinds of ground, learned without the pictures that have points. Boxes of
labels are not used otherwise. The points hold hardly any water, roof or shrub and no sky, so they say nothing of
these.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from infrablend import api
from infrablend.core.dataset import ImageRecord
from infrablend.core.surface_kinds import SURFACES
from infrablend.formats.pictures.images import load_background
from infrablend.imaging.surfaces import DRIVE, STAND, find_surfaces, model_version
from infrablend.lab.realism.classify import auc, bootstrap
from infrablend.report.preview import spread
from infrablend.sampling.labelled_ground import LabelledGround, learn_ground, with_labels

OFF_LIMITS = {"tree", "shrub", "roof", "wall", "water", "vehicle", "object"}
SURE = 2


def learn_cars(images: Sequence[ImageRecord]) -> LabelledGround:
    """Return on which kinds of ground labelled cars are, from 300 pictures."""
    shown = [i for i in images if any(o.category == "Car" for o in i.instances)]
    some = [shown[k] for k in spread(len(shown), 300)]
    return learn_ground(
        ((load_background(i.path, i.size_wh).pixels, i.instances, i.capture.time_of_day) for i in some), {"Car"}
    )


def main() -> int:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("INFRABLEND_REAL_DATA"))
    data = parser.parse_args().data
    if data is None:
        parser.error("set INFRABLEND_REAL_DATA, or give --data")
    names = ("hit-uav", "wisard", "bambi")
    pictures = {p.name: p for name in names for p in sorted((data / name).rglob("*")) if p.suffix.lower() != ".json"}
    labelled = {i.path.name: i for i in api.read_dataset(data / "hit-uav").images}
    points = json.loads((data / "places" / "points.json").read_text())
    cars = learn_cars([i for name, i in labelled.items() if name not in {f["file"] for f in points}])
    rows, seconds = [], []
    for number, frame in enumerate(points):
        pixels = cv2.imread(str(pictures[frame["file"]]), cv2.IMREAD_GRAYSCALE)
        begun = time.process_time()
        found = find_surfaces(pixels)
        seconds.append(time.process_time() - begun)
        of_set = labelled.get(frame["file"])
        time_of_day = None if of_set is None else of_set.capture.time_of_day
        stand, drive, kinds = found.share(STAND), found.share(DRIVE), found.kinds()
        learned = found.share(with_labels(DRIVE, {} if of_set is None else cars, "Car", time_of_day))
        for p in frame["points"]:
            if p["sure"] >= SURE and p["surface"] != "unclear":
                x, y = min(int(p["x"]), pixels.shape[1] - 1), min(int(p["y"]), pixels.shape[0] - 1)
                rows.append(
                    (number, p, float(stand[y, x]), float(drive[y, x]), SURFACES[kinds[y, x]], float(learned[y, x]))
                )

    frames = np.array([r[0] for r in rows])
    off = np.array([r[1]["surface"] in OFF_LIMITS for r in rows])
    roads = np.array([r[1]["surface"] == "road" and r[1]["drive"] == 1 for r in rows])
    ground = np.array([r[1]["stand"] == 1 for r in rows])
    grass = np.array([r[1]["surface"] == "grass" for r in rows])
    scores = {name: np.array([r[k] for r in rows]) for name, k in (("stand", 2), ("drive", 3), ("labelled", 5))}
    sides = {
        "stand": (scores["stand"], ground, off), "drive": (scores["drive"], roads, off),
        "road_grass": (scores["drive"], roads, grass), "labelled_drive": (scores["labelled"], roads, off),
        "labelled_road_grass": (scores["labelled"], roads, grass),
    }  # fmt: skip
    found_areas = {}
    for name, (score, yes, no) in sides.items():
        judged = yes | no
        y, scores_, of_frame = yes[judged].astype(np.int64), score[judged], frames[judged]
        low, high = bootstrap(y, scores_, of_frame)
        found_areas[name] = {
            "auc": round(auc(y, scores_), 3), "ci": [round(low, 3), round(high, 3)],
            "yes": int(yes.sum()), "no": int(no.sum()),
        }  # fmt: skip
    seen = sorted({r[1]["surface"] for r in rows})
    confusion = {
        s: {k: n for k in SURFACES if (n := sum(r[1]["surface"] == s and r[4] == k for r in rows))} for s in seen
    }
    report = {"model": model_version(), **found_areas, "cpu_s": round(float(np.median(seconds)), 3), "found": confusion}
    print(json.dumps(report, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
