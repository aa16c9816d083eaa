"""Controls that bound a classifier's score: real objects pasted elsewhere, and hard flat silhouettes.

The first is as good as an insert can be: only its place distinguishes it from an untouched object. The second is as
bad as one can be: a classifier that misses it is blind.

The sensor chain, switched on step by step, shows what each step does for realism.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.object_contrast import Picture
from infrablend.compositing.sensor import Sensor
from infrablend.core.boxes import pixel_box
from infrablend.core.dataset import Instance
from infrablend.core.rng import stream
from infrablend.lab.realism.features import EDGE_MARGIN_PX, Bool, Labels, Outline, outline, ring

PLACES = 6
TRIES = 200
_GAP_PX = 4  # between a paste and any label
_SOFT_PX = 1.0
_MARGIN_PX = 4  # ground that is pasted along with an object, since its halo is part of it
_THREE = np.ones((3, 3), np.uint8)
SENSOR_STEPS = ("chain_off", "psf", "halo", "noise", "codec")
"""Names of the steps; each includes the ones before it, and `codec` is the whole chain."""


def moved(instance: Instance, shift_xy: tuple[int, int]) -> Instance:
    """Return the label at the new place."""
    dx, dy = shift_xy
    return replace(instance, box_xyxy=instance.box_xyxy + np.array([dx, dy, dx, dy], np.float64), corners_xy=None)


def free_place(
    picture: Picture, instance: Instance, level: float, free: Bool, taken: Bool, rng: np.random.Generator
) -> tuple[tuple[int, int], float] | None:
    """Choose a place for an object: among six free places, the one whose ground is most similar to its own.

    The similarity of the ground decides how hard the real control is to detect. On HIT-UAV's night people its logistic
    AUC is 0.86 with the better of two places, 0.75 with five, 0.70 with eight; the method's publication has 0.73 to
    0.75.

    Args:
        picture: (h, w) in 8-bit levels.
        instance: The object to move.
        level: Median level of its ring.
        free: (h, w) pixels in no label's box; rings are read there.
        taken: (h, w) pixels in labels' boxes and earlier pastes.
        rng: Draws the places.

    Returns:
        Shift (dx, dy) in whole pixels and the level of the ring there; None if no place is free.
    """
    h, w = taken.shape
    x0, y0, x1, y1 = pixel_box(instance.box_xyxy, taken.shape)
    margin = EDGE_MARGIN_PX + 1
    if x1 - x0 + 2 * margin >= w or y1 - y0 + 2 * margin >= h:
        return None
    found: list[tuple[float, tuple[int, int], float]] = []
    for _ in range(TRIES):
        left = int(rng.integers(margin, w - margin - (x1 - x0)))
        top = int(rng.integers(margin, h - margin - (y1 - y0)))
        near = (slice(top - _GAP_PX, top + y1 - y0 + _GAP_PX), slice(left - _GAP_PX, left + x1 - x0 + _GAP_PX))
        if taken[near].any():
            continue
        shift = (left - x0, top - y0)
        there = ring(picture, moved(instance, shift).box_xyxy, free)
        if there is not None:
            found.append((abs(there - level), shift, there))
        if len(found) == PLACES:
            break
    if not found:
        return None
    _, shift, there = min(found)
    return shift, there


def paste_real(source: Picture, target: Picture, found: Outline, ground: float, shift_xy: tuple[int, int]) -> None:
    """Paste an object's own pixels elsewhere with a soft matte, shifted by the difference in ground level.

    Args:
        source: (h, w) picture of the object.
        target: Picture of the same shape to paste into; changed in place.
        found: Outline of the object in `source`.
        ground: Level of the ring at the new place.
        shift_xy: Offset from the old place to the new one.
    """
    alpha = cv2.GaussianBlur(
        cv2.dilate(_extended_silhouette(source, found), _THREE, iterations=_MARGIN_PX).astype(np.float32),
        (0, 0),
        _SOFT_PX,
    )
    moved = source[found.part] + np.float32(ground - found.level)
    # Pixels at the sensor's ceiling cannot become brighter.
    moved = np.minimum(moved, max(float(source[found.part][found.silhouette].max()), 235.0))
    _paste(target, found.part, shift_xy, alpha, moved)


def paste_flat(source: Picture, target: Picture, found: Outline, ground: float, shift_xy: tuple[int, int]) -> None:
    """Paste a hard-edged silhouette of one level: the new ground plus the object's median contrast."""
    level = float(np.median(source[found.part][found.silhouette])) - found.level + ground
    alpha = found.silhouette.astype(np.float32)
    _paste(target, found.part, shift_xy, alpha, np.full(alpha.shape, min(max(level, 16.0), 235.0), np.float32))


@dataclass(frozen=True, eq=False)
class Controls:
    """The controls of one picture.

    Attributes:
        real: (h, w) picture with the real pastes.
        flat: (h, w) picture with the flat pastes.
        labels: New label of each pasted object, by its number; objects without a free place are missing.
        free: (h, w) pixels in no box of an old or new label.
    """

    real: Picture
    flat: Picture
    labels: dict[int, Instance]
    free: Bool


def paste_controls(picture: Picture, labels: Labels, objects: Sequence[tuple[int, Instance]], key: str) -> Controls:
    """Paste both controls of some of a picture's objects, given with their numbers, each at its own free place."""
    real = picture.copy()
    flat = picture.copy()
    taken = ~labels.free
    placed: dict[int, Instance] = {}
    for number, instance in objects:
        found = outline(picture, instance.box_xyxy, labels.free)
        if not isinstance(found, Outline):
            continue
        place = free_place(picture, instance, found.level, labels.free, taken, stream(0, "paste", key, number))
        if place is None:
            continue
        shift, ground = place
        paste_real(picture, real, found, ground, shift)
        paste_flat(picture, flat, found, ground, shift)
        placed[number] = moved(instance, shift)
        x0, y0, x1, y1 = pixel_box(placed[number].box_xyxy, taken.shape)
        taken[y0:y1, x0:x1] = True
    return Controls(real, flat, placed, ~taken)


def _extended_silhouette(source: Picture, found: Outline) -> NDArray[np.uint8]:
    """Extend the silhouette by nearby pixels that differ from the ground by a quarter of the contrast."""
    differs = np.abs(source[found.part] - found.level) > 0.25 * abs(found.contrast)
    near = cv2.dilate(found.silhouette.astype(np.uint8), _THREE, iterations=2)
    return np.asarray((differs & (near > 0)) | found.silhouette, np.uint8)


def _paste(
    target: Picture,
    part: tuple[slice, slice],
    shift_xy: tuple[int, int],
    alpha: NDArray[np.float32],
    level: NDArray[np.float32],
) -> None:
    h, w = target.shape
    top = part[0].start + shift_xy[1]
    left = part[1].start + shift_xy[0]
    rows, columns = alpha.shape
    a, b = max(-top, 0), max(-left, 0)
    c, d = min(rows, h - top), min(columns, w - left)
    under = target[top + a : top + c, left + b : left + d]
    weight = alpha[a:c, b:d]
    under[...] = weight * level[a:c, b:d] + (1 - weight) * under


def sensor_steps(sensor: Sensor) -> dict[str, Sensor]:
    """Return the chain of each step. The range limits come with the halo, whose overshoot they cut off."""
    off = replace(
        sensor,
        blur_sigma_px=None,
        defocus_sigma_px=0.0,
        halo_gain=0.0,
        noise_grey=0.0,
        limits=None,
        codec_quality=None,
    )
    psf = replace(off, blur_sigma_px=sensor.blur_sigma_px, defocus_sigma_px=sensor.defocus_sigma_px)
    halo = replace(psf, halo_gain=sensor.halo_gain, limits=sensor.limits)
    noise = replace(halo, noise_grey=sensor.noise_grey)
    return dict(zip(SENSOR_STEPS, (off, psf, halo, noise, sensor), strict=True))
