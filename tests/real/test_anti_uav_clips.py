"""Clips of pan-tilt cameras with real text, reticles and drones."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from infrablend.formats import dataset_folder
from infrablend.formats.pictures.images import load_background
from infrablend.formats.read_write import Reading
from infrablend.imaging.burnt_in import find_burnt_in

# Clips whose camera moves so far that only text and reticle stay in place.
MOVING = ("4", "18", "40")


@pytest.mark.realdata
def test_text_and_reticle_of_moving_clips_are_found(real_data: Path):
    dataset = dataset_folder.read(real_data / "anti-uav-clips", Reading(options={"every": "50"}))
    kernel = np.ones((7, 7), np.uint8)
    for clip in MOVING:
        frames = [load_background(i.path).pixels for i in dataset.images if i.capture.sequence == clip]
        kinds = (cv2.MORPH_TOPHAT, cv2.MORPH_BLACKHAT)
        strokes = [np.maximum(*(cv2.morphologyEx(f, kind, kernel) for kind in kinds)) > 30 for f in frames]
        written = np.mean(strokes, axis=0) > 0.7
        written[:3] = written[-3:] = False  # the codec's stripes at the picture's edge
        for pixels in frames:
            covered = np.zeros(pixels.shape, bool)
            for x0, y0, x1, y1 in np.clip(find_burnt_in(pixels.astype(np.float32)), 0, None).astype(int):
                covered[y0:y1, x0:x1] = True
            assert covered[written].mean() > 0.98, clip
            assert covered.mean() < 0.2, clip


@pytest.mark.realdata
def test_clips_are_read_with_their_views_and_without_drones(real_data: Path):
    folder = real_data / "anti-uav-clips"
    kept = dataset_folder.read(folder, Reading(options={"every": "100"}))
    assert kept.problems == () and all(len(i.instances) == 1 for i in kept.images)
    views = {i.capture.sequence: (i.capture.hfov_deg, i.capture.pitch_deg) for i in kept.images}
    assert views == {"4": (1.24, -3.6), "7": (0.73, -0.87), "18": (1.4, -1.76), "40": (0.8, -0.89)}
    painted = dataset_folder.read(folder, Reading(options={"every": "100", "drones": "paint-out"}))
    assert {p.code for p in painted.problems} <= {"painted-by-guess"}
    for was, now in zip(kept.images, painted.images, strict=True):
        before, after = (load_background(i.path).pixels.astype(int) for i in (was, now))
        x0, y0, x1, y1 = was.instances[0].box_xyxy.astype(int)
        around = np.s_[max(y0 - 12, 0) : y1 + 12, max(x0 - 12, 0) : x1 + 12]
        assert now.instances == () and (before != after)[around].sum() == (before != after).sum() > 0
        # What remains is no brighter than what is around it.
        rim = np.concatenate([after[around][[0, -1]].ravel(), after[around][:, [0, -1]].ravel()])
        assert after[y0:y1, x0:x1].max() <= rim.max() + 12


@pytest.mark.realdata
def test_clips_are_also_read_alone_and_without_their_labels(real_data: Path, tmp_path: Path):
    folder = real_data / "anti-uav-clips"
    whole = dataset_folder.read(folder, Reading(options={"every": "100"}))
    alone = dataset_folder.read(folder / "4.avi", Reading(options={"every": "100"}))
    assert alone.problems == ()
    labelled = [i for i in whole.images if i.capture.sequence == "4"]
    assert [(i.capture, i.size_wh) for i in alone.images] == [(i.capture, i.size_wh) for i in labelled]
    assert all(a.instances[0].equals(b.instances[0]) for a, b in zip(alone.images, labelled, strict=True))
    shutil.copy(folder / "4.avi", tmp_path / "copy.avi")
    bare = dataset_folder.read(tmp_path / "copy.avi", Reading(options={"every": "100"}))
    assert (bare.format, bare.problems) == ("videos", ()) and [i.capture.time_s for i in bare.images][1:3] == [4, 8]
    assert all(
        np.array_equal(load_background(a.path).pixels, load_background(b.path).pixels)
        for a, b in zip(bare.images, labelled, strict=True)
    )
