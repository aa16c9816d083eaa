"""Measure whether a camera sharpens strong edges as much as faint ones.

    .venv/bin/python bench/edge_contrast.py DATA [--split train] [--count 300]

Prints, by time of day and height of the step, the overshoot of the median profile across sharp clean edges on its
bright and dark side, percent of the step, and beside it that of a made-up scene seen through the chain of `hit-uav`,
whose sharpening is the same for all edges. Small warm objects raise the bright side.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend import api
from infrablend.compositing.measure import edge_profiles, overshoots, profile_sigmas
from infrablend.compositing.sensor import enhance, grain, through_jpeg
from infrablend.config.sensor_profile import PROFILES

STEPS = (35, 50, 70, 100, 150)
"""Heights of steps, levels of 8 bit."""
_SHARP_PX = (0.45, 0.8)
_LEAST_EDGES = 40
_SCENES = 40
_SHAPES = 60


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", default="train")
    parser.add_argument("--count", type=int, default=300)
    args = parser.parse_args()
    print(f"{'levels':10}" + "".join(f"{f'{low} to {high}':>24}" for low, high in pairwise(STEPS)))
    for time in ("night", "day"):
        images = [
            i for i in api.read_dataset(args.data).images if (i.split, i.capture.time_of_day) == (args.split, time)
        ]
        chosen = np.random.default_rng(0).permutation(len(images))[: args.count]
        _print_row(time, (_grey(images[k].path) for k in chosen))
    _print_row("chain", (_scene(k) for k in range(_SCENES)))


def _grey(path: Path) -> NDArray[np.uint8]:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)


def _scene(seed: int) -> NDArray[np.uint8]:
    """Return squares of many contrasts on even ground, (512, 640), through the optics, sharpening, grain and codec."""
    profile = PROFILES["hit-uav"]
    rng = np.random.default_rng(seed)
    scene = np.full((512, 640), rng.uniform(60, 110))
    for _ in range(_SHAPES):
        centre = float(rng.integers(30, 610)), float(rng.integers(30, 480))
        side = rng.uniform(24, 60)
        corners = cv2.boxPoints((centre, (side, side), rng.uniform(0, 90)))
        step = rng.uniform(12, 140) * (1 if rng.random() < 0.5 else -1)
        level = np.clip(scene[int(centre[1]), int(centre[0])] + step, 35, 200)
        cv2.fillPoly(scene, [corners.astype(np.int32)], float(level))
    seen = enhance(cv2.GaussianBlur(scene, (0, 0), profile.psf_sigma_px), profile.halo_gain, profile.halo_radius_px)
    seen += grain(seen.shape, profile.noise_grey, profile.noise_grain_px, seed)
    assert profile.codec_quality is not None
    return through_jpeg(np.clip(np.rint(seen), 16, 235).astype(np.uint8), profile.codec_quality)


def _print_row(title: str, pictures: Iterable[NDArray[np.uint8]]) -> None:
    profiles, heights = (np.concatenate(of) for of in zip(*(edge_profiles(p) for p in pictures), strict=True))
    sigma = profile_sigmas(profiles)
    sharp = (sigma > _SHARP_PX[0]) & (sigma < _SHARP_PX[1])
    cells = []
    for low, high in pairwise(STEPS):
        some = profiles[sharp & (heights >= low) & (heights < high)]
        if len(some) < _LEAST_EDGES:
            cells.append(f"{len(some)} edges")
            continue
        bright, dark = 100 * overshoots(np.median(some, axis=0)[None])[0]
        cells.append(f"{bright:.1f} / {dark:.1f} ({len(some)})")
    print(f"{title:10}" + "".join(f"{cell:>24}" for cell in cells))


if __name__ == "__main__":
    main()
