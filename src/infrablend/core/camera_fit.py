"""Pitch, roll, height and lens of a camera from boxes of objects of known size on level ground.

Near the horizon boxes are small, below it they grow: their sizes at their places give the row of the horizon and the
height, whatever the lens. Pitch follows from that row by the lens. Steeper views bend the relation, which tells of the
lens, too.

What is sought are few numbers that many boxes share, some of them wrong (sitting people, vans called cars, feet behind
walls): least squares by Levenberg and Marquardt, with the weights of Cauchy's distribution, from several pitches.
Intervals come from the boxes' scatter, with an object counted once (sandwich estimate).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray
from infrablend.core.quantiles import quantile
from infrablend.core.reference_sizes import HEADINGS_RAD, REFERENCES, alike_headings, expected_sides

# Pitches, degrees, from which the search begins, and number of boxes that it begins with.
_BEGIN_DEG = (-5.0, 0.0, 5.0, 15.0, 30.0, 45.0, 60.0, 80.0)
_BEGIN_SHARES = (0.2, 0.5, 0.8)
_FIRST_BOXES = 150
_FIRST_STEPS = 8
_STEPS = 30
# Headings that are tried: a few are enough for the mean of people, whose headings do not show.
_TRIED = HEADINGS_RAD[::2]
_FEW = HEADINGS_RAD[::4]
# Sizes of standing people, or of cars, scatter by this. What is farther off counts the less, the farther it is: it is
# better to fit most boxes well than to fit all of them badly.
_SCATTER = 0.07
# Standard error of the side of a box drawn by hand, px.
_EDGE_PX = 0.7
# Fields of view are about this wide where nothing states one: between half and twice as much in nineteen of twenty.
_USUAL_HFOV_DEG = 35.0
_LENS_SD = 0.35
# Cameras that stand or are held are level to this; a roll that straight lines tell is right to that.
_LEVEL_SD_RAD = np.radians(2.0)
_TOLD_SD_RAD = np.radians(1.0)
# Rays less steep than this count as this steep: no place is infinitely far away.
_LEAST_DOWN = 1e-3
# The mean size of a class in one place differs from the known one by this share.
_CLASS_SD = 0.04


@dataclass(frozen=True, eq=False)
class SizedBoxes:
    """Boxes of objects of known size, and what is known of the camera that saw each of them.

    Attributes:
        kinds: (n,) classes.
        boxes: (n, 4) left, top, right and bottom from the middle of the picture, px.
        objects: (n,) numbers of the objects: those of one object share its error.
        spans: (n,) numbers of the spans, from 0; a camera has one pitch and one roll in each.
        turned: (n, 3, 3) from a picture's pixels to those of the first of its span, both from the middle.
        pitch_rad: (n,) stated pitch, to which the one sought is added; 0 where none is stated.
        roll_rad: (n,) stated roll, the same.
        height_m: (n,) stated height, which is multiplied by the one sought; 1 where none is stated.
        size_wh: Size of the pictures.
    """

    kinds: NDArray[np.str_]
    boxes: FloatArray
    objects: NDArray[np.int64]
    spans: NDArray[np.int64]
    turned: FloatArray
    pitch_rad: FloatArray
    roll_rad: FloatArray
    height_m: FloatArray
    size_wh: tuple[int, int]

    def __len__(self) -> int:
        """Return the number of boxes."""
        return len(self.boxes)

    def part(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> SizedBoxes:
        """Return some of the boxes."""
        arrays: Any = {name: value[chosen] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)


@dataclass(frozen=True, eq=False)
class CameraFit:
    """A camera that boxes agree with, as differences from what is stated; errors are standard errors.

    Attributes:
        focal_px: Focal length in pixels.
        focal_sd: Relative error; 0 for a lens that was given.
        factor: Height over the stated height, in metres where none is stated.
        factor_sd: Relative error, with that of what the mean size of a class is.
        pitch_rad: (spans,) pitch in the first picture of each span.
        pitch_sd: (spans,) its errors, radians.
        roll_rad: (spans,) roll.
        roll_sd: (spans,) its errors, radians.
        ratios: (n,) logarithms of sizes of boxes over expected sizes.
    """

    focal_px: float
    focal_sd: float
    factor: float
    factor_sd: float
    pitch_rad: FloatArray
    pitch_sd: FloatArray
    roll_rad: FloatArray
    roll_sd: FloatArray
    ratios: FloatArray


def axes_of(pitch_rad: FloatArray, roll_rad: FloatArray) -> FloatArray:
    """Return (n, 3, 3) rotations from the world to cameras; rows are a camera's axes, as `CameraSpec` has them."""
    zero = np.zeros_like(pitch_rad)
    right = np.stack([zero + 1, zero, zero], axis=-1)
    down = np.stack([zero, -np.sin(pitch_rad), -np.cos(pitch_rad)], axis=-1)
    forward = np.stack([zero, np.cos(pitch_rad), -np.sin(pitch_rad)], axis=-1)
    c, s = np.cos(roll_rad)[:, None], np.sin(roll_rad)[:, None]
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=1)


def turn_angles(
    pitch_rad: FloatArray, roll_rad: FloatArray, turned: FloatArray, focal_px: float
) -> tuple[FloatArray, FloatArray]:
    """Return pitch and roll, (n,) each, of pictures that show the first of their span turned.

    The horizon is a line of the first picture; where it is in another one gives its angles.

    Args:
        pitch_rad: (n,) pitch of the first pictures.
        roll_rad: (n,) roll of the first pictures.
        turned: (n, 3, 3) from a picture's pixels to those of the first, both from the middle.
        focal_px: Focal length in pixels.
    """
    up = axes_of(pitch_rad, roll_rad)[:, :, 2]
    lens = np.array([focal_px, focal_px, 1.0])
    seen = np.einsum("nji,nj->ni", turned, up / lens) * lens
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    return -np.arcsin(np.clip(seen[:, 2], -1, 1)), np.arctan2(-seen[:, 0], -seen[:, 1])


def fit_camera(
    boxes: SizedBoxes,
    focal_px: float | None = None,
    pitch_rad: FloatArray | None = None,
    roll_rad: FloatArray | None = None,
) -> CameraFit:
    """Find the camera that boxes of known size agree with best.

    Args:
        boxes: At least one box in each span.
        focal_px: Focal length in pixels; None seeks it, near that of usual cameras unless boxes say otherwise.
        pitch_rad: (spans,) pitch that is taken as given, beside what is stated; None seeks it.
        roll_rad: (spans,) roll near which it is sought; NaN where nothing tells it, so that it is about level.
    """
    spread = boxes.part(np.unique(np.linspace(0, len(boxes) - 1, _FIRST_BOXES).astype(int)))
    first = _Search(spread, focal_px, pitch_rad, roll_rad)
    base = float(np.median(boxes.pitch_rad))
    begins = [0.0] if base or pitch_rad is not None else [float(p) for p in np.radians(_BEGIN_DEG)]
    starts = [first.start(begin, share) for begin in begins for share in _BEGIN_SHARES]
    found = [first.best(start, _FIRST_STEPS) for start in starts]
    start = min(found, key=first.cost)
    search = _Search(boxes, focal_px, pitch_rad, roll_rad)
    return search.described(search.best(start, _STEPS))


def size_ratios(boxes: SizedBoxes, fit: CameraFit) -> FloatArray:
    """Return (n,) logarithms of sizes of boxes of the same spans over those that a camera gives."""
    unknowns = np.concatenate([[np.log(fit.factor), np.log(fit.focal_px)], fit.pitch_rad, fit.roll_rad])
    return _Search(boxes, None, fit.pitch_rad, None).ratios(unknowns)


class _Search:
    """The search for a camera: its unknowns are the logarithms of height and focal length, then pitches, then rolls."""

    def __init__(
        self,
        boxes: SizedBoxes,
        focal_px: float | None,
        pitch_rad: FloatArray | None,
        roll_rad: FloatArray | None,
    ) -> None:
        """Set what is given."""
        self.boxes = boxes
        self.focal_px = focal_px
        self.pitch_rad = pitch_rad
        self.spans = int(boxes.spans.max()) + 1 if pitch_rad is None else len(pitch_rad)
        usual = boxes.size_wh[0] / 2 / np.tan(np.radians(_USUAL_HFOV_DEG) / 2)
        self.usual = np.zeros(2 + 2 * self.spans)
        self.usual[1] = np.log(focal_px or usual)
        self.loose = np.full(2 + 2 * self.spans, np.inf)
        self.loose[1] = _LENS_SD
        self.loose[2 + self.spans :] = _LEVEL_SD_RAD
        if roll_rad is not None:
            told = np.flatnonzero(np.isfinite(roll_rad))
            self.usual[2 + self.spans + told] = roll_rad[told]
            self.loose[2 + self.spans + told] = _TOLD_SD_RAD
        self.free = np.ones(2 + 2 * self.spans, np.bool_)
        self.free[1] = focal_px is None
        self.free[2 : 2 + self.spans] = pitch_rad is None
        self.headings = np.zeros(len(boxes), np.int64)
        self.scatter = np.hypot(_SCATTER, self._edge_sd())

    def _edge_sd(self) -> FloatArray:
        side = np.minimum(*np.moveaxis(self.boxes.boxes[:, 2:] - self.boxes.boxes[:, :2], 1, 0))
        tall = self.boxes.boxes[:, 3] - self.boxes.boxes[:, 1]
        return np.asarray(_EDGE_PX / np.where(self.boxes.kinds == "person", tall, side))

    def start(self, pitch_rad: float, share: float) -> FloatArray:
        """Return unknowns with a pitch, and a height that a share of the boxes say is too large."""
        found = self.usual.copy()
        found[2 : 2 + self.spans] = pitch_rad if self.pitch_rad is None else self.pitch_rad
        found[0] = np.log(10.0 / np.median(self.boxes.height_m))
        # Sizes go with the height once more wherever the middle of an object is.
        for _ in range(3):
            found[0] -= quantile(self.ratios(found), share)
        return found

    def ratios(self, unknowns: FloatArray, *, keep_headings: bool = False) -> FloatArray:
        """Return (n,) logarithms of sizes of boxes over the expected ones, of people by their height.

        Others have the heading that is most like their box, or that of the last call: slopes are those of one heading.
        """
        boxes = self.boxes
        focal = float(np.exp(unknowns[1]))
        pitch, roll = self.angles(unknowns, focal)
        axes = axes_of(pitch, roll)
        rays = np.column_stack([(boxes.boxes[:, :2] + boxes.boxes[:, 2:]) / 2 / focal, np.ones(len(boxes))])
        down = -np.einsum("ni,ni->n", rays, axes[:, :, 2])
        height = np.exp(unknowns[0]) * boxes.height_m
        width, tall = boxes.boxes[:, 2] - boxes.boxes[:, 0], boxes.boxes[:, 3] - boxes.boxes[:, 1]
        found = np.empty(len(boxes))
        for kind in np.unique(boxes.kinds).tolist():
            of = boxes.kinds == kind
            reference = REFERENCES[kind]
            # A camera below the middle of an object sees no ground; sizes only have to stay finite there.
            above = np.maximum(height[of] - reference.size_m[2] / 2, 0.05 * height[of])
            middles = rays[of] * (above / np.maximum(down[of], _LEAST_DOWN))[:, None]
            headings = _TRIED if reference.turns else _FEW
            sides = expected_sides(middles, axes[of], focal, reference.corners(shaped=True), headings)
            if reference.turns:
                if not keep_headings:
                    self.headings[of] = alike_headings(sides, width[of], tall[of])
                chosen = sides[np.arange(len(sides)), self.headings[of]]
                found[of] = np.log(width[of] * tall[of] / (chosen[:, 0] * chosen[:, 1])) / 2
            else:
                # Arms and strides widen people; from above, where height is little, both sides count.
                steep = (down[of] / np.linalg.norm(rays[of], axis=1)) ** 2 / 2
                wide, high = np.log(np.column_stack([width[of], tall[of]]) / sides.mean(axis=1)).T
                found[of] = steep * wide + (1 - steep) * high
        return np.nan_to_num(found, nan=-3.0)

    def angles(self, unknowns: FloatArray, focal_px: float) -> tuple[FloatArray, FloatArray]:
        """Return pitch and roll, (n,) each, of the picture of each box."""
        of = self.boxes.spans
        pitch, roll = unknowns[2 : 2 + self.spans][of], unknowns[2 + self.spans :][of]
        stated = self.boxes
        return turn_angles(pitch + stated.pitch_rad, roll + stated.roll_rad, stated.turned, focal_px)

    def cost(self, unknowns: FloatArray) -> float:
        """Return the cost of a camera: Cauchy's for boxes, squares for what is usual."""
        scaled = self.ratios(unknowns) / self.scatter
        usual = ((unknowns - self.usual) / self.loose) ** 2
        return float(np.log1p(scaled**2).sum() + usual.sum() / 2)

    def best(self, unknowns: FloatArray, steps: int) -> FloatArray:
        """Return the unknowns of least cost near these, after at most so many steps."""
        damping = 1e-3
        cost = self.cost(unknowns)
        for _ in range(steps):
            slope, curve, _ = self._normal(unknowns)
            step = np.linalg.solve(curve + damping * np.diag(np.diag(curve) + 1e-9), -slope)
            tried = unknowns.copy()
            tried[self.free] += np.clip(step, -0.3, 0.3)
            lower = self.cost(tried)
            if lower >= cost:
                damping *= 5
                continue
            done = cost - lower < 1e-5 * len(self.boxes)
            unknowns = tried
            cost = lower
            damping = max(damping / 5, 1e-9)
            if done:
                break
        return unknowns

    def _normal(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return slope and curvature of the cost, by the free unknowns, and (n, free) slopes of single boxes."""
        ratios = self.ratios(unknowns)
        changes = np.zeros((len(ratios), len(unknowns)))
        blocks = [np.array([0]), np.array([1])]
        blocks += [2 + k * self.spans + np.arange(self.spans) for k in (0, 1)]
        for block in blocks:
            if not self.free[block].all():
                continue
            moved = unknowns.copy()
            moved[block] += 1e-5
            change = (self.ratios(moved, keep_headings=True) - ratios) / 1e-5
            # A span's angles change the boxes of that span alone.
            columns = block[self.boxes.spans] if len(block) > 1 else np.full(len(ratios), block[0])
            changes[np.arange(len(ratios)), columns] = change
        changes = changes[:, self.free]
        scaled = ratios / self.scatter
        weight = 1 / (1 + scaled**2) / self.scatter**2
        of_boxes = changes * (weight * ratios)[:, None]
        # Half of the slope of Cauchy's cost; of what is usual, that of the half square.
        slope = of_boxes.sum(axis=0) + ((unknowns - self.usual) / self.loose**2)[self.free]
        curve = (changes * weight[:, None]).T @ changes + np.diag(self.loose[self.free] ** -2.0)
        return slope, curve, of_boxes

    def described(self, unknowns: FloatArray) -> CameraFit:
        """Return the camera of these unknowns, with its errors."""
        _, curve, of_boxes = self._normal(unknowns)
        _, numbers = np.unique(self.boxes.objects, return_inverse=True)
        of_objects = np.zeros((numbers.max() + 1, of_boxes.shape[1]))
        np.add.at(of_objects, numbers, of_boxes)
        inverse = np.linalg.pinv(curve)
        scatter = of_objects.T @ of_objects + np.diag(self.loose[self.free] ** -2.0)
        sd = np.zeros(len(unknowns))
        # The larger of both estimates: with few objects the scatter of their slopes is small by chance.
        variance = np.maximum(np.diag(inverse @ scatter @ inverse), np.diag(inverse))
        sd[self.free] = np.sqrt(variance)
        pitches, rolls = slice(2, 2 + self.spans), slice(2 + self.spans, None)
        return CameraFit(
            float(np.exp(unknowns[1])),
            float(sd[1]),
            float(np.exp(unknowns[0])),
            float(np.hypot(sd[0], _CLASS_SD)),
            unknowns[pitches],
            sd[pitches],
            unknowns[rolls],
            sd[rolls],
            self.ratios(unknowns),
        )
