"""A map of how likely the flight detects what stands somewhere, cumulated over its pictures.

Each cell of the ground has a look from every picture that shows its middle. A look detects with the share of inserted
objects found under its conditions. Looks at the same cell depend on each other: a person who is hard to see stays so.
The best look counts whole, each other one by 1 - rho, where rho is the correlation between looks at one object:
1 - (1 - p1) * prod (1 - p) ** (1 - rho). With rho 0 looks are independent, with 1 only the best one counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import polygon_area
from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame, Pose, footprint, ground_pixel_m, pixels_of_ground
from infrablend.detection.detections import FloatArray
from infrablend.detection.recall import Share
from infrablend.detection.sightings import Sighting
from infrablend.detection.truth import image_key
from infrablend.formats.maps.map_files import MapFeature
from infrablend.formats.maps.search_sectors import Sector
from infrablend.pipeline.flights.corrected_counts import LookShares
from infrablend.pipeline.flights.insert_trials import GROUND_PIXEL_CM, UNKNOWN_TIME, in_range
from infrablend.pipeline.studies.flight_overlap import flight_order

ASSUMED_RHO = 0.5
_MOST_CELLS = 2500
_LEAST_PAIRS = 50
# Most steps along each side of a sector, at which it is sampled.
_MOST_STEPS = 800
# A strip ends where the course turns by more, or a step is so many times as long as others.
_TURN_DEG = 30.0
_LONG_STEP = 4.0


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
        searched_m2: Sum of the ground in the pictures: what several show counts several times.
        track_m: Length of the flight's strips.
        track_points_m: (p, 2) points on them at even distances, metres east and north.
        sweep_width_m: Mean sweep width of its strips: the integral of the probability of detection across a strip.
            None without a strip.
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
    searched_m2: float
    track_m: float
    track_points_m: FloatArray
    sweep_width_m: float | None

    def corners_m(self, k: int) -> FloatArray:
        """Return the (4, 2) corners of a cell, metres east and north."""
        half = self.cell_m / 2
        return np.asarray(self.middles_m[k] + half * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]))


@dataclass(frozen=True)
class AreaFigures:
    """Figures of an area: the flight, or a sector.

    Attributes:
        name: Its name.
        area_m2: Its area.
        photographed: Share of the area that some picture shows.
        pod: Mean probability of detection over the area, with 0 where no picture was taken.
        low: Its lower end.
        high: Its upper end.
        coverage: Sweep width times the track length over it, by area; None without a sweep width.
    """

    name: str
    area_m2: float
    photographed: float
    pod: float
    low: float
    high: float
    coverage: float | None


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
    poses: Mapping[str, Pose],
    shares: LookShares,
    dependence: Dependence,
    cell_m: float | None = None,
) -> SearchMap | None:
    """Return the map of the pictures whose poses are known; None without any that shows ground.

    Args:
        images: Pictures that were searched.
        poses: Known poses of pictures, by `<split>/<name>`.
        shares: Share found in one look.
        dependence: Correlation between looks.
        cell_m: Side of a cell; by default the ground is divided into some 2,500 cells.
    """
    posed = [(image, poses[key]) for image in images if (key := image_key(image)) in poses]
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
    of_picture = [
        _looks(image, pose, frame, outline, middles, shares)
        for (image, pose), outline in zip(posed, outlines, strict=True)
    ]
    looks = _by_cell(of_picture, len(middles))
    shown = [k for k, of in enumerate(looks) if of]
    if not shown:
        return None
    pod, lower, upper = np.array([_cumulated(looks[k], dependence.rho) for k in shown]).reshape(-1, 3).T
    counts = np.array([len(looks[k]) for k in shown], np.float64)
    places = frame.to_metres(*np.array([(p.latitude_deg, p.longitude_deg) for _, p in posed]).T)
    strips = find_strips([i for i, _ in posed], places)
    track_m, width_m = _sweep(strips, places, of_picture, middles, side, dependence.rho)
    points = _along(strips, places, side)
    return SearchMap(
        frame,
        side,
        middles[shown],
        counts,
        pod,
        lower,
        upper,
        dependence,
        without_pose=len(images) - len(posed),
        searched_m2=sum(abs(polygon_area(outline - outline[0])) for outline in seen),
        track_m=track_m,
        track_points_m=points,
        sweep_width_m=width_m,
    )


Looks = list[tuple[int, Share]]
"""Number of each cell that a picture shows, and the share found there in one look."""


def _looks(
    image: ImageRecord, pose: Pose, frame: LocalFrame, outline: FloatArray, middles: FloatArray, shares: LookShares
) -> Looks:
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


def _by_cell(of_picture: Sequence[Looks], cells: int) -> list[list[Share]]:
    looks: list[list[Share]] = [[] for _ in range(cells)]
    for seen in of_picture:
        for k, share in seen:
            looks[k].append(share)
    return looks


def _cumulated(looks: Sequence[Share], rho: float) -> tuple[float, float, float]:
    """Return the probability of detection over all looks, and its ends; NaN if a share is unknown."""
    ends = [(s.value, s.low, s.high) for s in looks if s.value is not None and s.low is not None and s.high is not None]
    if len(ends) < len(looks):
        return math.nan, math.nan, math.nan
    value, low, high = np.array(ends).T
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


def find_strips(images: Sequence[ImageRecord], places_m: FloatArray) -> list[list[int]]:
    """Return the numbers of the pictures of each straight strip, in the order of the flight, two or more each.

    Args:
        images: Pictures, in any order.
        places_m: (n, 2) their places, metres east and north.
    """
    order = sorted(range(len(images)), key=lambda k: flight_order(images[k]))
    steps = np.diff(places_m[order], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    usual = float(np.median(lengths[lengths > 0])) if (lengths > 0).any() else 0.0
    strips: list[list[int]] = []
    course: FloatArray | None = None
    for step, length, start, end in zip(steps, lengths, order, order[1:], strict=False):
        if not 0 < length <= _LONG_STEP * usual:
            course = None
            continue
        goes_on = course is not None and float(step @ course) >= length * math.cos(math.radians(_TURN_DEG))
        if goes_on:
            strips[-1].append(end)
        else:
            strips.append([start, end])
            course = step / length
    return strips


def _along(strips: Sequence[Sequence[int]], places_m: FloatArray, step_m: float) -> FloatArray:
    """Return (p, 2) points on straight strips, some `step_m` apart, each of which stands for as much of the track."""
    total = sum(float(np.linalg.norm(places_m[s[-1]] - places_m[s[0]])) for s in strips)
    step = max(step_m, total / _MOST_CELLS)
    points = [np.zeros((0, 2))]
    for strip in strips:
        start, end = places_m[strip[0]], places_m[strip[-1]]
        count = max(1, round(float(np.linalg.norm(end - start)) / step))
        points.append(start + (np.arange(count)[:, None] + 0.5) / count * (end - start))
    return np.concatenate(points)


def _sweep(
    strips: Sequence[Sequence[int]], places_m: FloatArray, of_picture: Sequence[Looks], middles: FloatArray,
    cell_m: float, rho: float,
) -> tuple[float, float | None]:  # fmt: skip
    """Return the length of all strips, and their mean sweep width weighted by length.

    The sweep width of a strip is the integral of the probability of detection across it: the sum over the cells beside
    its track, by area, over its length.
    """
    track_m = 0.0
    swept_m2 = 0.0
    for strip in strips:
        start, end = places_m[strip[0]], places_m[strip[-1]]
        length = float(np.linalg.norm(end - start))
        along = (middles - start) @ ((end - start) / length)
        looks = _by_cell([of_picture[k] for k in strip], len(middles))
        pods = [_cumulated(of, rho)[0] for of, at in zip(looks, along, strict=True) if of and 0 <= at < length]
        swept_m2 += float(np.nansum(pods)) * cell_m**2
        track_m += length
    return track_m, swept_m2 / track_m if track_m else None


def area_figures(found: SearchMap, sector: Sector | None = None) -> AreaFigures:
    """Return the figures of a sector, in which cells that no picture shows count 0; by default of the whole map.

    Cells whose share is unknown are left out of a mean of the whole map, and count 0 in a sector.
    """
    values = np.stack([found.pod, found.low, found.high])
    known = np.isfinite(found.pod)
    if sector is None:
        area = len(found.pod) * found.cell_m**2
        pod, lower, upper = values[:, known].mean(axis=1) if known.any() else np.full(3, math.nan)
        return AreaFigures("flight", area, 1.0, float(pod), float(lower), float(upper), _coverage(found, area))
    corners = np.concatenate([found.frame.to_metres(*ring.T) for ring in sector.rings])
    low, high = corners.min(axis=0), corners.max(axis=0)
    # Fine enough for a sector that is smaller than a cell, and not too fine for one that is much larger.
    step = max(float((high - low).max()) / _MOST_STEPS, min(found.cell_m / 4, float((high - low).min()) / 20))
    columns, rows = (np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    inside = points[_contains(sector, found, points)]
    origin = found.middles_m[0] - found.cell_m / 2
    places = np.rint((found.middles_m - found.middles_m[0]) / found.cell_m).astype(np.int64)
    number = {tuple(place): k for k, place in enumerate(places.tolist()) if known[k]}
    cells = np.floor((inside - origin) / found.cell_m).astype(np.int64)
    hits = [number[key] for place in cells.tolist() if (key := tuple(place)) in number]
    count = max(len(inside), 1)
    area = len(inside) * step**2
    pod, lower, upper = values[:, hits].sum(axis=1) / count
    share_of_track = float(_contains(sector, found, found.track_points_m).mean()) if len(found.track_points_m) else 0.0
    coverage = _coverage(found, area, share_of_track)
    return AreaFigures(sector.name, area, len(hits) / count, float(pod), float(lower), float(upper), coverage)


def _contains(sector: Sector, found: SearchMap, points_m: FloatArray) -> NDArray[np.bool_]:
    return sector.contains(found.frame.to_degrees(*points_m.T))


def _coverage(found: SearchMap, area_m2: float, share_of_track: float = 1.0) -> float | None:
    if found.sweep_width_m is None or not area_m2:
        return None
    return found.sweep_width_m * found.track_m * share_of_track / area_m2


def map_features(found: SearchMap) -> list[MapFeature]:
    """Return the cells as areas of a map; `pod` is null where no share is known."""
    features = []
    for k in range(len(found.middles_m)):
        pod = float(found.pod[k])
        known = math.isfinite(pod)
        facts: dict[str, object] = {"pod": None, "low": None, "high": None}
        if known:
            facts = {"pod": round(pod, 4), "low": round(float(found.low[k]), 4), "high": round(float(found.high[k]), 4)}
        title = f"POD {pod:.2f}" if known else "POD unknown"
        outline = found.frame.to_degrees(*found.corners_m(k).T)
        looks = int(found.looks[k])
        features.append(
            MapFeature(f"cell {k}", title, f"{looks} looks", outline, _shade(pod), {**facts, "looks": looks})
        )
    return features


def _shade(pod: float) -> str:
    """Return a colour from red for 0 to green for 1; grey for unknown."""
    if not math.isfinite(pod):
        return "#999999"
    return f"#{round(200 * (1 - pod)):02x}{round(180 * pod):02x}40"
