"""Yaw, ground pixel and lens of a flight from the overlap of its pictures.

Pictures that look straight down on flat ground differ by a shift, a turn and a scale. The shift in pixels, turned by
the stated yaw, against the track in metres is one complex number: its modulus is the size of a pixel on the ground, its
argument the error of the yaw. Ground pixels go with height, so the number is fitted to pixels times stated height.

Shifts between pairs are joined to one track in pixels, to which positions are fitted: an error of a position counts
once, however many pairs it is part of. Pairs and positions that contradict most others are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import STRAIGHT_DOWN_DEG
from infrablend.core.capture import Capture
from infrablend.core.ground_position import LocalFrame
from infrablend.imaging.camera_shift import Matrix, View, match_features

Complex = NDArray[np.complex128]

# Pictures may look so far from straight down, degrees.
MOST_TILT_DEG = 5.0
# Pictures are neighbours if their middles are at most this share of the picture's shorter side apart ...
_NEAR = 0.6
# ... and none of two is of use that are nearer than this.
_APART = 0.1
# The field of view that is taken for finding neighbours where none is stated.
_USUAL_HFOV_DEG = 45.0
# How far pictures are apart, as a share of their shorter side, where no height is stated.
_USUAL_STEP = 0.3
# Fewer positions tell nothing.
_LEAST = 4
# Pairs and positions are left out that miss the fit by more than so many times the median deviation, and by this, m.
_OUTLIER = 4.0
_EXACT_M = 0.05
# No movement is known better, px.
_EXACT_PX = 0.1
# No result whose standard error is a larger share.
_MOST_SIGMA = 0.1
# A median of distances in the plane, times this, is the deviation of one coordinate.
_MEDIAN_TO_DEVIATION = 1 / math.sqrt(2 * math.log(2))


@dataclass(frozen=True)
class Place:
    """What is stated of a picture that looks about straight down.

    Attributes:
        east_m: Position to the east of a common origin.
        north_m: Position to the north of it.
        yaw_deg: Direction of the picture's upper edge, clockwise from north.
        height_m: Height above the ground.
        tilt_deg: By how much the camera looks ahead of straight down.
    """

    east_m: float
    north_m: float
    yaw_deg: float
    height_m: float
    tilt_deg: float = 0.0


@dataclass(frozen=True, eq=False)
class Link:
    """The movement of the background from one picture to another.

    Attributes:
        first: Number of the picture.
        second: Number of the other one.
        matrix: (3, 3) from pixels of the first to those of the second, where the middle of the first pixel is at 0.
        error_px: Standard error of that at the worst corner of the picture.
    """

    first: int
    second: int
    matrix: Matrix
    error_px: float


@dataclass(frozen=True, eq=False)
class Overlap:
    """What overlap says of a flight.

    Attributes:
        yaw_error_deg: By how much the stated yaw is too large.
        yaw_sigma_deg: Standard error of that.
        pixel_share: Ground pixel per height: metres on the ground per metre of height and pixel.
        pixel_sigma: Standard error of that as a share of it.
        height_m: Median height of the pictures that were used.
        residual_m: Deviation of stated positions from the track that the pictures show, per axis.
        free: Degrees of freedom of that.
        pictures: Number of pictures that were used.
        links: Number of pairs that were used.
        left_out: Number of pairs and of positions that contradict these.
        track: Position in that track by number of picture, metres east and north as a complex number.
    """

    yaw_error_deg: float
    yaw_sigma_deg: float
    pixel_share: float
    pixel_sigma: float
    height_m: float
    residual_m: float
    free: int
    pictures: int
    links: int
    left_out: int
    track: dict[int, complex]

    @property
    def wide(self) -> float:
        """Standard errors in half an interval of 95 %: the quantile of Student's t, to 0.01 from 8 degrees on."""
        return 1.96 + 2.4 / self.free + 3.0 / self.free**2

    @property
    def ground_pixel_m(self) -> float:
        """Metres on the ground per pixel at the median height."""
        return self.pixel_share * self.height_m

    def hfov_deg(self, width: int) -> float:
        """Return the field of view across pictures of some width, px."""
        return math.degrees(2 * math.atan(self.pixel_share * width / 2))

    def hfov_sigma_deg(self, width: int, height_sigma_m: float) -> float:
        """Return the standard error of the field of view, with that of the height."""
        share = math.hypot(self.pixel_sigma, height_sigma_m / self.height_m)
        return math.degrees(math.sin(math.radians(self.hfov_deg(width))) * share)


class OverlapValue(TypedDict):
    """A value that overlap tells.

    Attributes:
        name: Name of the fact; `yaw_error_deg` and `flight_yaw_error_deg` are by how much a stated yaw is too large.
        value: The value.
        low: Lower end of its interval of 95 %.
        high: Upper end of it.
        stated: What headers state, the median; None if nothing.
        contradicts: Whether what is stated is outside the interval.
        source: What it follows from.
    """

    name: str
    value: float
    low: float
    high: float
    stated: float | None
    contradicts: bool
    source: str


def shorter_side(size_wh: tuple[int, int], hfov_deg: float | None) -> float:
    """Return the ground along the shorter side of pictures, per height; for a usual lens if none is stated."""
    return 2 * math.tan(math.radians(hfov_deg or _USUAL_HFOV_DEG) / 2) / size_wh[0] * min(size_wh)


def looks_down(c: Capture) -> bool:
    """Whether a picture states that it looks straight down, in which direction and from where."""
    known = c.place is not None and c.yaw_deg is not None and c.pitch_deg is not None
    return known and abs(STRAIGHT_DOWN_DEG - (c.pitch_deg or 0.0)) <= MOST_TILT_DEG


def places_of(captures: Sequence[Capture], size_wh: tuple[int, int]) -> list[Place]:
    """Return what pictures state for which `looks_down`, in metres of the first one.

    Unless all state their height, it is taken to be such that pictures overlap by 70 %; the ground pixel does not
    depend on it.
    """
    origin = captures[0].place
    assert origin is not None
    at = LocalFrame(*origin).to_metres(*np.array([c.place for c in captures], np.float64).T)
    heights = [c.altitude_m for c in captures]
    if None in heights:
        step = float(np.median(np.linalg.norm(np.diff(at, axis=0), axis=1)))
        heights = [step / _USUAL_STEP / shorter_side(size_wh, captures[0].hfov_deg)] * len(captures)
    found = []
    for c, (east, north), height in zip(captures, at.tolist(), heights, strict=True):
        assert c.pitch_deg is not None and c.yaw_deg is not None and height is not None
        # Straight down, a roll only turns the picture.
        found.append(Place(east, north, c.yaw_deg + (c.roll_deg or 0.0), height, STRAIGHT_DOWN_DEG - c.pitch_deg))
    return found


def seen_middle(one: Place, other: Place, size_wh: tuple[int, int], hfov_deg: float) -> tuple[float, float]:
    """Return at which pixel a picture shows the middle of one before, by what both state."""
    way = complex(one.east_m - other.east_m, one.north_m - other.north_m) * np.exp(1j * math.radians(other.yaw_deg))
    way /= 2 * math.tan(math.radians(hfov_deg) / 2) / size_wh[0] * other.height_m
    return size_wh[0] / 2 + way.real, size_wh[1] / 2 - way.imag


def neighbours(places: Sequence[Place], size_wh: tuple[int, int], hfov_deg: float | None) -> Iterator[tuple[int, int]]:
    """Yield pairs of pictures that show much of the same ground: those that follow each other first, near ones next."""
    at = np.array([complex(p.east_m, p.north_m) for p in places])
    side = shorter_side(size_wh, hfov_deg) * np.array([p.height_m for p in places])
    apart = np.abs(at[:, None] - at) / np.minimum(side[:, None], side)
    first, second = np.nonzero(np.triu((apart <= _NEAR) & (apart >= _APART), 1))
    later = second - first
    order = np.lexsort((first, apart[first, second], np.minimum(later, 3)))
    yield from zip(first[order].tolist(), second[order].tolist(), strict=True)


def find_link(first: int, second: int, views: Sequence[View]) -> Link | None:
    """Return the movement between two pictures; None if these do not show it with certainty."""
    shift = match_features(views[first], views[second])
    return None if shift is None else Link(first, second, shift.matrix, shift.error_px)


def fit_overlap(places: Sequence[Place], links: Sequence[Link], size_wh: tuple[int, int]) -> Overlap | str:
    """Return what overlap says of a flight, or in words why it says nothing.

    Args:
        places: What is stated of each picture.
        links: Pairs of these.
        size_wh: Size of the pictures, px.
    """
    tilted = sum(abs(p.tilt_deg) > MOST_TILT_DEG for p in places)
    if tilted:
        return f"{tilted} pictures do not look straight down, where pitch and lens cannot be told apart"
    # The point that a picture looks at is ahead of the position by the tilt, in a direction that the result tells.
    found = _fit([replace(p, tilt_deg=0.0) for p in places], links, size_wh, 0.0)
    for _ in range(2):
        if isinstance(found, str):
            return found
        found = _fit(places, links, size_wh, math.radians(found.yaw_error_deg))
    return found


def _fit(places: Sequence[Place], links: Sequence[Link], size_wh: tuple[int, int], turn: float) -> Overlap | str:
    """Return what overlap says if the stated yaw is too large by `turn`, radians, in the direction of tilts."""
    heading = np.exp(-1j * np.radians([p.yaw_deg for p in places]))
    height = np.array([p.height_m for p in places])
    stated = np.array([complex(p.east_m, p.north_m) for p in places])
    ahead = 1j * np.exp(1j * turn) * heading * height * np.tan(np.radians([p.tilt_deg for p in places]))
    at = stated + ahead
    first, second = (np.array([getattr(k, end) for k in links], int) for end in ("first", "second"))
    steps = np.array([_step(k, size_wh, heading, height) for k in links], np.complex128)
    kept = _agreeing(steps, at[second] - at[first])
    error = np.maximum([k.error_px for k in links], _EXACT_PX)
    group, track = _joined(len(places), first[kept], second[kept], steps[kept], 1 / error[kept] ** 2)
    used = np.isin(np.arange(len(places)), [first[kept], second[kept]])
    compared = int(used.sum())
    if compared < _LEAST:
        return f"{compared} pictures can be compared with others, expected at least {_LEAST}"
    fitted = _regress(at, track, group, used)
    for _ in range(3):
        used &= np.abs(fitted.rest) <= _limit(np.abs(fitted.rest[used]))
        fitted = _regress(at, track, group, used)
    groups = len(np.unique(group[used]))
    if used.sum() - groups < _LEAST - 1:
        return f"{int(used.sum())} pictures agree with each other, expected at least {_LEAST}"
    rest = fitted.rest[used]
    free = 2 * (len(rest) - groups) - 2
    deviation = math.sqrt(float((np.abs(rest) ** 2).sum()) / free)
    sigma = deviation * math.sqrt(_alike(rest, group[used]) / fitted.moment) / abs(fitted.number)
    if sigma > _MOST_SIGMA:
        return "the positions move too little, or not as the pictures do"
    known = np.flatnonzero(np.isin(group, group[used])).tolist()
    return Overlap(
        yaw_error_deg=math.degrees(math.atan2(fitted.number.imag, fitted.number.real)),
        yaw_sigma_deg=math.degrees(sigma),
        pixel_share=abs(fitted.number),
        pixel_sigma=sigma,
        height_m=float(np.median(height[used])),
        residual_m=deviation,
        free=free,
        pictures=int(used.sum()),
        links=int(kept.sum()),
        left_out=len(links) - int(kept.sum()) + compared - int(used.sum()),
        track={k: complex(stated[k] - fitted.rest[k]) for k in known},
    )


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Positions as a number times the track, apart from an origin for each group.

    Attributes:
        number: Metres per pixel and metre of height; its argument is the error of the yaw.
        moment: Sum of squares of the track.
        rest: What positions differ from that.
    """

    number: complex
    moment: float
    rest: Complex


def _regress(at: Complex, track: Complex, group: NDArray[np.int_], used: NDArray[np.bool_]) -> _Fitted:
    place, way = (_centred(v, group, used) for v in (at, track))
    moment = float((np.abs(way[used]) ** 2).sum())
    number = complex((np.conj(way[used]) * place[used]).sum() / max(moment, 1e-12))
    return _Fitted(number, moment, place - number * way)


def _step(link: Link, size_wh: tuple[int, int], heading: Complex, height: NDArray[np.float64]) -> complex:
    """Return the shift of the camera in pixels times height, turned by the stated yaw: the mean of both pictures."""
    middle = (np.array(size_wh) - 1) / 2
    there, back = (m @ [*middle, 1.0] for m in (link.matrix, np.linalg.inv(link.matrix)))
    on_first, on_second = ((v[:2] / v[2] - middle) @ (1, -1j) for v in (back, there))
    of_first = height[link.first] * on_first * heading[link.first]
    of_second = height[link.second] * on_second * heading[link.second]
    return complex(of_first - of_second) / 2


def _agreeing(steps: Complex, ways: Complex) -> NDArray[np.bool_]:
    """Return which pairs agree about the number from shifts to ways: with the pair that most agree with."""
    if not len(steps):
        return np.zeros(0, np.bool_)
    best = min(
        (ways / np.where(steps == 0, 1e-9, steps)).tolist(), key=lambda g: float(np.median(np.abs(ways - g * steps)))
    )
    miss = np.abs(ways - best * steps)
    return np.asarray(miss <= _limit(miss), np.bool_)


def _limit(miss: NDArray[np.float64]) -> float:
    """Return what is too far from the fit, m."""
    return max(_OUTLIER * _MEDIAN_TO_DEVIATION * float(np.median(miss)), _EXACT_M)


def _joined(
    count: int, first: NDArray[np.int_], second: NDArray[np.int_], steps: Complex, weight: NDArray[np.float64]
) -> tuple[NDArray[np.int_], Complex]:
    """Return the group of each picture that pairs join, and its place in the track of the group."""
    group = np.arange(count)
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        group[group == group[b]] = group[a]
    # Normal equations; the first picture of each group is at 0, which no shift between pictures tells.
    normal = np.diag((np.unique(group, return_index=True)[1][:, None] == np.arange(count)).any(axis=0).astype(float))
    sums = np.zeros(count, np.complex128)
    for one, other, sign in ((first, second, -1), (second, first, 1)):
        np.add.at(normal, (one, one), weight)
        np.add.at(normal, (one, other), -weight)
        np.add.at(sums, one, sign * weight * steps)
    return group, np.asarray(np.linalg.solve(normal.astype(np.complex128), sums))


def _centred(values: Complex, group: NDArray[np.int_], used: NDArray[np.bool_]) -> Complex:
    """Return values less the mean of those used of their group."""
    found = values.copy()
    for g in np.unique(group[used]):
        found[group == g] -= values[used & (group == g)].mean()
    return found


def _alike(rest: Complex, group: NDArray[np.int_]) -> float:
    """Return by what the variance grows because errors of pictures that follow each other are alike."""
    total = float((np.abs(rest) ** 2).sum())
    grown = 1.0
    for lag in range(1, len(rest) // 2):
        same = group[lag:] == group[:-lag]
        alike = float((rest[lag:] * np.conj(rest[:-lag])).real[same].sum()) / max(total, 1e-12)
        if alike <= 0:
            break
        grown += 2 * alike
    return grown
