"""Counts the same thing in several overlapping pictures once: sightings on the ground become objects.

Pictures are taken in the order of time. The sightings of each are assigned to the objects so far, one to one and at the
least cost; two of one picture are never one object. A sighting fits an object where it fits all its sightings: by their
own errors, and by how far things go in the time between (complete linkage: a chain of neighbours is no object). Of
those, the cost is how badly it fits where the object is expected, standing still or walking on, and how much class and
size differ.

Errors that all pictures of a flight share, such as of its lens, move all places alike and are no own errors.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from infrablend.core.mesh import FloatArray

GATE = 9.21
"""Quantile 0.99 of chi squared with two degrees of freedom."""
WALK_M_S = 1.6
"""How fast things move that nobody has told: people and grazing animals."""
# Cost of another class; of a size that differs by this factor, as for one deviation; of movement, which is less usual
# than rest.
_OTHER_CLASS = 4.0
_SIZE_FACTOR = 1.4
_MOVING = 2.0
# Walkers turn: the acceleration of a random walk of the velocity, as a share of the speed per root of a second.
_TURNING = 0.12
# The assignment is ambiguous where more others than this are expected in the gate.
_RIVALS = 0.3
# An object moves if its speed is so many times its standard error, and the fit improves by the quantile above.
_SURE = 3.0
# Density of objects that are new among sightings as a share of that of all: for joining; and where those that walked
# out of view are counted, among which some are not new. Found with virtual flights over walking people.
_NEW = 0.1
_UNSEEN = 0.3
_FAR = 1e6


@dataclass(frozen=True, eq=False)
class PlacedSighting:
    """One detection on the ground.

    Attributes:
        picture: Key of its picture.
        time_s: When that was taken; None if unknown.
        place_m: (2,) metres east and north.
        covariance_m2: (2, 2) of the errors that are the picture's and the detection's own.
        size_m: Longer side.
        category: Class.
    """

    picture: str
    time_s: float | None
    place_m: FloatArray
    covariance_m2: FloatArray
    size_m: float
    category: str


@dataclass(frozen=True, eq=False)
class FlightObject:
    """A thing on the ground.

    Attributes:
        sightings: Numbers of its sightings, in the order of time.
        category: Class of most of them.
        place_m: (2,) where it is, of a moving one when it was seen last.
        covariance_m2: (2, 2) of the own errors of that.
        moves: Whether it moves; None if one moment alone shows it.
        speed_m_s: Its speed, 0 if it does not move.
        ambiguous: Whether a sighting of it may as well be of another object.
    """

    sightings: tuple[int, ...]
    category: str
    place_m: FloatArray
    covariance_m2: FloatArray
    moves: bool | None
    speed_m_s: float
    ambiguous: bool


@dataclass(frozen=True, eq=False)
class FlightCount:
    """The objects of a flight.

    Attributes:
        objects: Sightings that are of one object, in the order of the first ones. What walks out of view and is seen
            again elsewhere is two of these, unless no other comes into question.
        expected: Expected number of objects: those, less what may be of one object by the chance that it is.
        fewest: Number of objects if all are one that may be.
        most: Number if none are one of which it is not certain.
    """

    objects: tuple[FlightObject, ...]
    expected: float
    fewest: int
    most: int


@dataclass(eq=False)
class _Track:
    """An object so far.

    Attributes:
        members: Numbers of its sightings.
        state: (4,) place and velocity when it was seen last.
        spread: (4, 4) covariance of that.
        resting: (2, 2) inverse covariance of its place if it stands still, and (2,) that times the place.
        unsure: Number of sightings that may as well be another object's.
        earlier: Whether it may be an object that had been lost.
        later: Whether an object that began later may be it.
        unfound: Chance that none of those is it.
    """

    members: list[int]
    state: FloatArray
    spread: FloatArray
    resting: tuple[FloatArray, FloatArray]
    unsure: int = 0
    earlier: bool = False
    later: bool = False
    unfound: float = 1.0


def count_objects(sightings: Sequence[PlacedSighting], area_m2: float, speed_m_s: float = WALK_M_S) -> FlightCount:
    """Join the sightings of a flight.

    Args:
        sightings: All sightings; if a picture has no time, all stand still, and pictures are taken by their keys.
        area_m2: Ground that the pictures show, what several show counted as often: how dense sightings are.
        speed_m_s: How fast things move at most; 0 if none do.
    """
    if any(s.time_s is None for s in sightings):
        speed_m_s = 0.0
    joining = _Joining(sightings, area_m2, speed_m_s)
    order = sorted(range(len(sightings)), key=lambda k: (sightings[k].time_s or 0.0, sightings[k].picture, k))
    for _, of_picture in itertools.groupby(order, key=lambda k: sightings[k].picture):
        joining.take(list(of_picture))
    tracks = joining.tracks
    return FlightCount(
        tuple(_object(t, sightings, speed_m_s) for t in tracks),
        joining.expected,
        len(tracks) - sum(t.earlier for t in tracks),
        len(tracks) + sum(t.unsure for t in tracks),
    )


class _Joining:
    """The tracks so far, and how many objects are expected behind them."""

    def __init__(self, sightings: Sequence[PlacedSighting], area_m2: float, speed_m_s: float) -> None:
        self._all = sightings
        self._speed = speed_m_s
        self._density = max(len(sightings), 1) / area_m2
        # Twice the negative logarithm of the density of new objects: costs of joining are that of those in the gate.
        self._begin = -2 * math.log(2 * math.pi * self._density * _NEW)
        self.tracks: list[_Track] = []
        self.expected = 0.0

    def take(self, numbers: Sequence[int]) -> None:
        """Assign the sightings of a picture to the tracks, and begin others."""
        near = [t for t in self.tracks if any(self._in_reach(t, k) for k in numbers)]
        cost = np.full((len(numbers), len(near) + len(numbers)), _FAR)
        gates = np.zeros((len(numbers), len(near)))
        for row, k in enumerate(numbers):
            cost[row, len(near) + row] = self._begin
            for column, track in enumerate(near):
                if self._in_reach(track, k):
                    cost[row, column], gates[row, column] = self._cost(track, k)
        chosen = assign(cost)
        lost = [t for c, t in enumerate(near) if c not in chosen]
        for row, (k, column) in enumerate(zip(numbers, chosen, strict=True)):
            if column < len(near):
                self._join(near[column], k)
                near[column].unsure += int(self._density * gates[row, column] > _RIVALS)
                continue
            self.tracks.append(self._new(k))
            may_be = [t for t in lost if self._moves(t) is not False and self._in_reach(t, k)]
            self.expected += self._chance(k, may_be)
            other = next((t for t in may_be if not t.later), None)
            if other is not None:
                other.later = self.tracks[-1].earlier = True

    def _elapsed(self, a: int, b: int) -> float:
        return abs((self._all[a].time_s or 0.0) - (self._all[b].time_s or 0.0)) if self._speed else 0.0

    def _in_reach(self, track: _Track, k: int) -> bool:
        """Whether a sighting fits each of a track's."""
        one = self._all[k]
        for m in reversed(track.members):
            other = self._all[m]
            way = self._speed * self._elapsed(m, k)
            covariance = one.covariance_m2 + other.covariance_m2 + way**2 / GATE * np.eye(2)
            if other.picture == one.picture or _misfit(one.place_m - other.place_m, covariance) > _gate(track):
                return False
        return True

    def _cost(self, track: _Track, k: int) -> tuple[float, float]:
        """Return how badly a sighting fits a track, `_FAR` if it is not where that is expected, and the gate's area."""
        one = self._all[k]
        still = np.linalg.inv(track.resting[0])
        expected = [(still @ track.resting[1], still, 0.0)]
        if self._speed:
            state, spread = self._later(track, k)
            expected.append((state[:2], spread[:2, :2], _MOVING))
        best, area = _FAR, 0.0
        for place, covariance, penalty in expected:
            total = covariance + one.covariance_m2
            size = math.sqrt(float(np.linalg.det(total)))
            cost = _misfit(one.place_m - place, total)
            if cost <= _gate(track) and cost + 2 * math.log(size) + penalty < best:
                best, area = cost + 2 * math.log(size) + penalty, math.pi * GATE * size
        members = [self._all[m] for m in track.members]
        larger = math.log(max(one.size_m, 1e-3) / max(float(np.median([s.size_m for s in members])), 1e-3))
        differs = (one.category != _usual(members)) * _OTHER_CLASS + min((larger / math.log(_SIZE_FACTOR)) ** 2, GATE)
        return best + differs, area

    def _chance(self, k: int, lost: Sequence[_Track]) -> float:
        """Return with what chance a sighting that fits no track is of a thing that was not seen before.

        Objects that were lost and may have walked there make it smaller; each can be found again once.
        """
        one = self._all[k]
        known = [m for t in self.tracks if (m := self._moves(t)) is not None]
        moving = (sum(known) + 0.5) / (len(known) + 1)
        likely = np.zeros(len(lost))
        for n, track in enumerate(lost):
            state, spread = self._later(track, k)
            total = spread[:2, :2] + one.covariance_m2
            density = math.exp(-_misfit(one.place_m - state[:2], total) / 2) / math.sqrt(float(np.linalg.det(total)))
            likely[n] = track.unfound * (self._moves(track) or moving) * density / (2 * math.pi)
        unseen = self._density * _UNSEEN
        every = unseen + float(likely.sum())
        for track, share in zip(lost, (likely / every).tolist(), strict=True):
            track.unfound *= 1 - share
        return unseen / every

    def _moves(self, track: _Track) -> bool | None:
        """Return whether a track moves, by its speed; None if one moment alone shows it."""
        if not self._speed:
            return False
        if len(track.members) < 2:
            return None
        return _misfit(track.state[2:], track.spread[2:, 2:]) > GATE

    def _later(self, track: _Track, k: int) -> tuple[FloatArray, FloatArray]:
        """Return place and velocity of a track at the time of a sighting, and their covariance."""
        t = self._elapsed(track.members[-1], k)
        on = np.eye(4)
        on[:2, 2:] = t * np.eye(2)
        faster = float(track.state[2:] @ track.state[2:] + np.trace(track.spread[2:, 2:]))
        turning = _TURNING**2 * faster * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        return on @ track.state, on @ track.spread @ on.T + np.kron(turning, np.eye(2))

    def _join(self, track: _Track, k: int) -> None:
        one = self._all[k]
        state, spread = self._later(track, k)
        gain = spread[:, :2] @ np.linalg.inv(spread[:2, :2] + one.covariance_m2)
        track.state = state + gain @ (one.place_m - state[:2])
        track.spread = spread - gain @ spread[:2]
        inverse = np.asarray(np.linalg.inv(one.covariance_m2))
        track.resting = track.resting[0] + inverse, track.resting[1] + inverse @ one.place_m
        track.members.append(k)

    def _new(self, k: int) -> _Track:
        one = self._all[k]
        spread = np.zeros((4, 4))
        spread[:2, :2] = one.covariance_m2
        spread[2:, 2:] = (self._speed / 2) ** 2 * np.eye(2)
        inverse = np.asarray(np.linalg.inv(one.covariance_m2))
        return _Track([k], np.array([*one.place_m, 0.0, 0.0]), spread, (inverse, inverse @ one.place_m))


def _usual(members: Sequence[PlacedSighting]) -> str:
    """Return the class of most sightings, the first of those that are as many."""
    return Counter(s.category for s in members).most_common(1)[0][0]


def _gate(track: _Track) -> float:
    """Return the gate of a track: it has as many tests as sightings, and the true one fits all with the same chance."""
    return GATE + 2 * math.log(len(track.members))


def _misfit(apart: FloatArray, covariance: FloatArray) -> float:
    return float(apart @ np.linalg.solve(covariance, apart))


def assign(cost: FloatArray) -> list[int]:
    """Return the column of each row, no column twice, whose costs add up to the least: the Hungarian method.

    Args:
        cost: (n, m) costs, n <= m.
    """
    n, m = cost.shape
    of_row, of_column = np.zeros(n + 1), np.zeros(m + 1)
    row_of = np.zeros(m + 1, int)  # row of each column, from 1; column 0 holds the row to place
    for row in range(1, n + 1):
        row_of[0] = row
        column = 0
        least = np.full(m + 1, np.inf)
        before = np.zeros(m + 1, int)
        done = np.zeros(m + 1, np.bool_)
        while row_of[column]:
            done[column] = True
            here = row_of[column]
            reduced = np.concatenate([[np.inf], cost[here - 1] - of_row[here] - of_column[1:]])
            better = ~done & (reduced < least)
            least[better], before[better] = reduced[better], column
            nearest = int(np.where(done, np.inf, least).argmin())
            step = least[nearest]
            of_row[row_of[done]] += step
            of_column[done] -= step
            least[~done] -= step
            column = nearest
        while column:
            row_of[column] = row_of[before[column]]
            column = int(before[column])
    found = {int(r): c for c, r in enumerate(row_of.tolist()) if c and r}
    return [found[r] - 1 for r in range(1, n + 1)]


def _object(track: _Track, sightings: Sequence[PlacedSighting], speed_m_s: float) -> FlightObject:
    """Return the object of a track, told still from moving by the fit of a place and of a place and a velocity."""
    members = [sightings[k] for k in track.members]
    place, covariance, still = _fit(members, 2)
    moves: bool | None = None
    speed = 0.0
    times = {s.time_s for s in members}
    if speed_m_s and len(times) > 1:
        state, spread, walking = _fit(members, 4)
        speed = float(np.hypot(*state[2:]))
        along = state[2:] / max(speed, 1e-9)
        moves = speed > _SURE * math.sqrt(float(along @ spread[2:, 2:] @ along)) and still - walking > GATE
        if moves:
            place, covariance = state[:2], spread[:2, :2]
    speed = speed if moves else 0.0
    return FlightObject(tuple(track.members), _usual(members), place, covariance, moves, speed, track.unsure > 0)


def _fit(members: Sequence[PlacedSighting], unknowns: int) -> tuple[FloatArray, FloatArray, float]:
    """Return place (and velocity) when last seen, their covariance, and the sum of squares of what is left."""
    last = members[-1].time_s or 0.0
    information, weighted = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    models = []
    for s in members:
        model = np.hstack([np.eye(2), ((s.time_s or 0.0) - last) * np.eye(2)])[:, :unknowns]
        inverse = np.linalg.inv(s.covariance_m2)
        information += model.T @ inverse @ model
        weighted += model.T @ inverse @ s.place_m
        models.append((model, inverse, s.place_m))
    covariance = np.asarray(np.linalg.inv(information))
    found = covariance @ weighted
    left = sum((float((p - m @ found) @ i @ (p - m @ found)) for m, i, p in models), 0.0)
    return found, covariance, left
