"""A map of how likely the flight detects what stands somewhere, cumulated over its pictures.

Each cell of the ground has a look from every picture that shows its middle. A look detects with the share of inserted
objects found under its conditions. Looks at the same cell depend on each other: a person who is hard to see stays so.
The best look counts whole, each other one by 1 - rho, where rho is the correlation between looks at one object:
1 - (1 - p1) * prod (1 - p) ** (1 - rho). With rho 0 looks are independent, with 1 only the best one counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame, Pose, footprint, ground_pixel_m, pixels_of_ground, pose_of
from infrablend.detection.detections import FloatArray
from infrablend.detection.recall import Share
from infrablend.detection.sightings import Sighting
from infrablend.pipeline.flights.corrected_counts import LookShares
from infrablend.pipeline.flights.insert_trials import GROUND_PIXEL_CM, UNKNOWN_TIME, in_range

ASSUMED_RHO = 0.5
_MOST_CELLS = 2500
_LEAST_PAIRS = 50


@dataclass(frozen=True)
class Dependence:
    """Correlation between looks at the same object.

    Attributes:
        rho: The correlation, in [0, 1].
        origin: `measured`, from objects inserted into several pictures, or `assumed`.
    """

    rho: float
    origin: str


@dataclass(frozen=True, eq=False)
class SearchMap:
    """Probability of detection by cell of the ground.

    Attributes:
        frame: Local plane of the flight.
        cell_m: Side of a cell.
        middles_m: (n, 2) middles of the photographed cells, metres east and north.
        looks: (n,) number of pictures that show each cell.
        pod: (n,) probability of detection, NaN where no share is known.
        low: (n,) its lower end: with the lower ends of the shares, and only the best look.
        high: (n,) its upper end: with the upper ends, and independent looks.
        dependence: Correlation between looks.
        without_pose: Pictures without a pose, which the map leaves out.
    """

    frame: LocalFrame
    cell_m: float
    middles_m: FloatArray
    looks: FloatArray
    pod: FloatArray
    low: FloatArray
    high: FloatArray
    dependence: Dependence
    without_pose: int


@dataclass(frozen=True)
class AreaFigures:
    """Figures of an area: the flight, or a sector.

    Attributes:
        area_m2: Its area.
        photographed: Share of the area that some picture shows.
        pod: Mean probability of detection over the area, with 0 where no picture was taken.
        low: Its lower end.
        high: Its upper end.
    """

    area_m2: float
    photographed: float
    pod: float
    low: float
    high: float


def find_dependence(inserted: Sequence[Sighting], confidence: float) -> Dependence:
    """Return the correlation of finding the same inserted object in two pictures; assumed without enough pairs."""
    by_track: dict[str, list[bool]] = {}
    for sighting in inserted:
        if sighting.track:
            by_track.setdefault(sighting.track, []).append(sighting.score >= confidence)
    pairs = np.array([pair for looks in by_track.values() for pair in combinations(looks, 2)], np.float64)
    if len(pairs) < _LEAST_PAIRS:
        return Dependence(ASSUMED_RHO, "assumed")
    both = np.concatenate([pairs, pairs[:, ::-1]])
    share = float(both.mean())
    if not 0 < share < 1:
        return Dependence(ASSUMED_RHO, "assumed")
    covariance = float((both[:, 0] * both[:, 1]).mean()) - share**2
    return Dependence(min(max(covariance / (share * (1 - share)), 0.0), 1.0), "measured")


def map_detection(
    images: Sequence[ImageRecord],
    shares: LookShares,
    dependence: Dependence,
    cell_m: float | None = None,
) -> SearchMap | None:
    """Return the map of the pictures whose poses are known; None without any that shows ground.

    Args:
        images: Pictures that were searched.
        shares: Share found in one look.
        dependence: Correlation between looks.
        cell_m: Side of a cell; by default the ground is divided into some 2,500 cells.
    """
    posed = [(image, pose) for image in images if not isinstance(pose := pose_of(image), str)]
    if not posed:
        return None
    frame = LocalFrame(posed[0][1].latitude_deg, posed[0][1].longitude_deg)
    outlines = [footprint(pose, frame) for _, pose in posed]
    seen = [o for o in outlines if len(o)]
    if not seen:
        return None
    corners = np.concatenate(seen)
    low, high = corners.min(axis=0), corners.max(axis=0)
    side = cell_m or _nice(math.sqrt(float(np.prod(high - low)) / _MOST_CELLS))
    east, north = (np.arange(a + side / 2, b + side / 2, side) for a, b in zip(low, high, strict=True))
    middles = np.stack(np.meshgrid(east, north), axis=-1).reshape(-1, 2)
    looks: list[list[Share]] = [[] for _ in middles]
    for (image, pose), outline in zip(posed, outlines, strict=True):
        for k, share in _looks(image, pose, frame, outline, middles, shares):
            looks[k].append(share)
    shown = [k for k, of in enumerate(looks) if of]
    pods = np.array([_cumulated(looks[k], dependence.rho) for k in shown]).reshape(-1, 3)
    counts = np.array([len(looks[k]) for k in shown], np.float64)
    pod, lower, upper = pods.T
    left_out = len(images) - len(posed)
    return SearchMap(frame, side, middles[shown], counts, pod, lower, upper, dependence, left_out)


def _looks(
    image: ImageRecord, pose: Pose, frame: LocalFrame, outline: FloatArray, middles: FloatArray, shares: LookShares
) -> list[tuple[int, Share]]:
    """Return the cells that a picture shows, and the share found there in one look."""
    if not len(outline):
        return []
    near = np.flatnonzero(((middles >= outline.min(axis=0)) & (middles <= outline.max(axis=0))).all(axis=1))
    xy = pixels_of_ground(pose, frame, middles[near])
    inside = ((xy >= 0) & (xy < pose.size_wh)).all(axis=1)
    ground_m = ground_pixel_m(pose, xy[inside])
    time = image.capture.time_of_day or UNKNOWN_TIME
    return [
        (int(k), shares[time, in_range(100 * pixel, GROUND_PIXEL_CM, "cm")])
        for k, pixel in zip(near[inside], ground_m, strict=True)
        if np.isfinite(pixel)
    ]


def _cumulated(looks: Sequence[Share], rho: float) -> tuple[float, float, float]:
    """Return the probability of detection over all looks, and its ends; NaN if a share is unknown."""
    known = [
        (s.value, s.low, s.high) for s in looks if s.value is not None and s.low is not None and s.high is not None
    ]
    if len(known) < len(looks):
        return math.nan, math.nan, math.nan
    value, low, high = np.array(known).T
    return cumulate(value, rho), cumulate(low, 1.0), cumulate(high, 0.0)


def cumulate(p: FloatArray, rho: float) -> float:
    """Return the probability that one of (n,) looks detects, with a correlation between them.

    >>> [round(cumulate(np.array([0.5, 0.5]), rho), 3) for rho in (0.0, 0.5, 1.0)]
    [0.75, 0.646, 0.5]
    """
    missed = 1 - np.sort(p)[::-1]
    return float(1 - missed[0] * np.prod(missed[1:] ** (1 - rho)))


def _nice(side_m: float) -> float:
    """Return the next larger 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(side_m))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= side_m)


def whole_figures(found: SearchMap) -> AreaFigures:
    """Return the figures of what the flight photographed."""
    known = np.isfinite(found.pod)
    area = len(found.pod) * found.cell_m**2
    mean = [float(v[known].mean()) if known.any() else math.nan for v in (found.pod, found.low, found.high)]
    return AreaFigures(area, 1.0, *mean)


def sector_figures(found: SearchMap, rings_m: Sequence[FloatArray]) -> AreaFigures:
    """Return the figures of a sector; cells that no picture shows count 0.

    Args:
        found: The map.
        rings_m: Its outer ring and any holes, each (k, 2) metres east and north of the map's frame.
    """
    area = _area(rings_m[0]) - sum(_area(ring) for ring in rings_m[1:])
    inside = np.array([_is_inside(rings_m, middle) for middle in found.middles_m], np.bool_)
    inside &= np.isfinite(found.pod)
    cell = found.cell_m**2
    # Cells at the border are counted by their middles, so that the sum may exceed the area by a few of them.
    share = min(1.0, float(inside.sum()) * cell / area)
    means = [float(v[inside].mean()) * share if inside.any() else 0.0 for v in (found.pod, found.low, found.high)]
    return AreaFigures(area, share, *means)


def _is_inside(rings_m: Sequence[FloatArray], place_m: FloatArray) -> bool:
    point = (float(place_m[0]), float(place_m[1]))
    hits = [cv2.pointPolygonTest(ring.astype(np.float32), point, False) >= 0 for ring in rings_m]
    return hits[0] and not any(hits[1:])


def _area(ring_m: FloatArray) -> float:
    x, y = ring_m.T
    return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2
