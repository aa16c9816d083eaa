"""Inserted against real tracks of the same clips, in time: `RUN` is a run of `drone-video` over clips with labels.

    .venv/bin/infrablend generate drone-video --data ../shared/data/anti-uav-clips --out build/tracks
    .venv/bin/python bench/tracks.py build/tracks

A row per sequence: AUC of telling windows of eight frames apart, and the floor, which is what the first and the second
half of the real track give; medians of the measures of `in_time`, real and inserted; and how much box height
and peak change from frame to frame, median and 95 %.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from in_time import FEATURES, floor_of, look_at, tell_apart, windows

from infrablend.core.run_folder import RunFolder
from infrablend.imaging.camera_shift import moved
from infrablend.pipeline.plans.sequence_motion import find_motion, sequences_of
from infrablend.pipeline.runs.record import RecordedRun


def main() -> None:
    """Print a row per sequence, and the means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--data", type=Path, help="folder of the backgrounds, if they have moved")
    options = parser.parse_args()
    run = RecordedRun.read(RunFolder(options.run))
    dataset = run.plan(options.data).dataset
    records = {r.background["id"]: r for r in RunFolder(options.run).records()}
    rows = []
    for name, images in sequences_of(dataset).items():
        motion = find_motion(name, images)
        tracks = defaultdict(dict)  # looks, boxes and first-frame places by kind and id
        for k, (image, moment) in enumerate(zip(images, motion.moments, strict=True)):
            record = records.get(image.id)
            if record is None or not moment.known:
                continue
            picture = cv2.imread(str(options.run / "images" / record.image), cv2.IMREAD_GRAYSCALE)
            for kind, instances in (("real", image.instances), ("inserted", record.inserted)):
                for i in instances:
                    box = i.box_xyxy
                    look = look_at(picture, (box[:2] + box[2:]) / 2 - 0.5)
                    first = None if look is None else moved(np.array([look.place_xy]), moment.to_first)[0]
                    tracks[kind, i.track_id][k] = (look, first, box)
        found = {"real": [], "inserted": []}
        steps = {"real": [], "inserted": []}
        for (kind, _), frames in tracks.items():
            n = len(images)
            looks = [frames[k][0] if k in frames else None for k in range(n)]
            first = np.array([frames[k][1] if k in frames and frames[k][1] is not None else (0, 0) for k in range(n)])
            shown = np.array([looks[k].place_xy if looks[k] is not None else (0, 0) for k in range(n)])
            found[kind].append(windows(looks, first, shown))
            heights = [frames[k][2][3] - frames[k][2][1] for k in sorted(frames)]
            peaks = [k.contrast for k in looks if k is not None]
            steps[kind].append((np.abs(np.diff(np.log(heights))), np.abs(np.diff(peaks)), peaks))
        real, inserted = (np.concatenate(found[kind]) for kind in ("real", "inserted"))
        apart, floor = tell_apart(real, inserted), floor_of(real)
        print(
            f"\n{name}: {len(real)} windows of real tracks, {len(inserted)} of inserted ones; "
            f"AUC {apart:.3f}, floor {floor:.3f}"
        )
        rows.append((apart, floor))
        for f, feature in enumerate(FEATURES):
            alone = tell_apart(real[:, [f]], inserted[:, [f]])
            a, b = (np.median(of[:, f]) for of in (real, inserted))
            print(f"  {feature:24} real {a:8.3f}  inserted {b:8.3f}  AUC alone {alone:.3f}")
        for kind in ("real", "inserted"):
            height, peak = (np.concatenate([s[j] for s in steps[kind]]) for j in (0, 1))
            a, b, c, d = (float(np.percentile(v, q)) for v in (height, peak) for q in (50, 95))
            level = np.median(np.concatenate([s[2] for s in steps[kind]]))
            steady = f"box height from frame to frame {a:.1%} / {b:.1%}, peak {c:.1f} / {d:.1f} levels"
            print(f"  {kind:9} {steady}; peak {level:.0f} levels in the median")
    print(f"\nmean: AUC {np.mean([r[0] for r in rows]):.3f}, floor {np.mean([r[1] for r in rows]):.3f}")


if __name__ == "__main__":
    main()
