"""Measures maps of places on points of real pictures that people labelled by eye.

    INFRABLEND_REAL_DATA=DIR .venv/bin/python bench/places.py

`stand`: ground to stand on against trees, shrubs, roofs, walls, water, vehicles and objects. `drive`: roads to drive on
against the same. `road_grass`: the same roads against grass. Points that the labeller was sure of. Figures are areas
under the ROC curve, with intervals of 95 % from drawing the pictures again. Boxes of labels are not used. The points
hold hardly any water, roof or shrub and no sky, so they say nothing of these.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from infrablend.core.surface_kinds import SURFACES
from infrablend.places.surfaces import DRIVE, STAND, find_surfaces, model_version
from infrablend.realism.classify import auc, bootstrap

OFF_LIMITS = {"tree", "shrub", "roof", "wall", "water", "vehicle", "object"}
SURE = 2


def main() -> int:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("INFRABLEND_REAL_DATA"))
    data = parser.parse_args().data
    if data is None:
        parser.error("set INFRABLEND_REAL_DATA, or give --data")
    names = ("hit-uav", "wisard", "bambi")
    pictures = {p.name: p for name in names for p in sorted((data / name).rglob("*")) if p.suffix.lower() != ".json"}
    rows, seconds = [], []
    for number, frame in enumerate(json.loads((data / "places" / "points.json").read_text())):
        pixels = cv2.imread(str(pictures[frame["file"]]), cv2.IMREAD_GRAYSCALE)
        begun = time.process_time()
        found = find_surfaces(pixels)
        seconds.append(time.process_time() - begun)
        stand, drive, kinds = found.share(STAND), found.share(DRIVE), found.kinds()
        for p in frame["points"]:
            if p["sure"] >= SURE and p["surface"] != "unclear":
                x, y = min(int(p["x"]), pixels.shape[1] - 1), min(int(p["y"]), pixels.shape[0] - 1)
                rows.append((number, p, float(stand[y, x]), float(drive[y, x]), SURFACES[kinds[y, x]]))

    frames = np.array([r[0] for r in rows])
    off = np.array([r[1]["surface"] in OFF_LIMITS for r in rows])
    roads = np.array([r[1]["surface"] == "road" and r[1]["drive"] == 1 for r in rows])
    ground = np.array([r[1]["stand"] == 1 for r in rows])
    grass = np.array([r[1]["surface"] == "grass" for r in rows])
    scores = {"stand": np.array([r[2] for r in rows]), "drive": np.array([r[3] for r in rows])}
    sides = {
        "stand": (scores["stand"], ground, off), "drive": (scores["drive"], roads, off),
        "road_grass": (scores["drive"], roads, grass),
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
