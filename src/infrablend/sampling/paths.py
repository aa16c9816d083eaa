"""Paths of objects through a sequence: people walk, deer graze, cars drive, drones hover and fly.

A path is computed once for a sequence, on a fixed grid of time, forwards and backwards from the moment at which the
object was placed. The same streams give the same path whatever the frame rate and whichever frames are made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from infrablend.config.recipe import MotionKind
from infrablend.core.mesh import FloatArray

STEP_S = 0.1
_GRAVITY = 9.81


@dataclass(frozen=True)
class _Gait:
    """Limits of a movement on the ground: acceleration, m/s²; turns, rad/s, and their wander, rad/√s."""

    acceleration: float
    turn: float
    wander: float


_GAITS: Mapping[MotionKind, _Gait] = {
    "walk": _Gait(1.5, 1.5, 0.12),
    "graze": _Gait(0.5, 0.8, 0.3),
    "run": _Gait(2.0, 1.0, 0.1),
    "drive": _Gait(2.5, 0.4, 0.0),
}
# Grazing animals take a few steps, and then stand and eat: periods of both, seconds.
_STEPS_S = (1.0, 4.0)
_MEAL_S = (4.0, 15.0)
# A heading wanders in curves: what turns it lasts so long, seconds.
_CURVE_S = 1.0
# What stops an object is looked for this long ahead, and at least so far.
_AHEAD_S = 1.0
_AHEAD_M = 0.6
# Largest acceleration of what flies, m/s²: 22 degrees of bank.
_ACCELERATION = 4.0
# Drag of multirotors, per metre: they lean 10 degrees forward at 8 m/s.
_DRAG = 0.027
# Periods of what a hovering drone does in the wind, seconds.
_HOVER_S = (3.0, 12.0)
# Periods of the wander of a drone in the picture, seconds.
_WANDER_S = (5.0, 25.0)

Fits = Callable[[float, float], bool]
"""Whether an object may be at a place on the ground, x and y in metres."""


@dataclass(frozen=True, eq=False)
class Path:
    """Where an object is over time, in the world of the moment at which it was placed.

    Attributes:
        times_s: (n,) seconds from that moment, ascending.
        place_m: (n, 3) position.
        yaw_rad: (n,) heading, continuous over whole turns.
        lean_rad: (n,) nose down.
        bank_rad: (n,) right side down.
        way_m: (n,) metres gone, negative before that moment.
    """

    times_s: FloatArray
    place_m: FloatArray
    yaw_rad: FloatArray
    lean_rad: FloatArray
    bank_rad: FloatArray
    way_m: FloatArray

    def at(self, times_s: FloatArray) -> Path:
        """Return the path at other times, between those of the grid."""

        def between(values: FloatArray) -> FloatArray:
            return np.asarray(np.interp(times_s, self.times_s, values))

        place = np.stack([between(self.place_m[:, k]) for k in range(3)], axis=1)
        rest = (self.yaw_rad, self.lean_rad, self.bank_rad, self.way_m)
        return Path(times_s, place, *(between(v) for v in rest))


def find_path(
    kind: MotionKind,
    start: tuple[float, float, float, float],
    speed_m_s: float,
    span_s: tuple[float, float],
    rng: np.random.Generator,
    fits: Fits = lambda x, y: True,
) -> Path:
    """Return the path of an object that is at `start` (x, y, z, yaw) at time 0, from `span_s[0]` <= 0 to `span_s[1]`.

    The directions of all that flies in a `flock` are those of its stream, whatever their yaw.

    Raises:
        ValueError: The kind has no path of its own: a drone that is `followed` moves in the picture.
    """
    before, after = (math.ceil(abs(t) / STEP_S) + 1 for t in span_s)
    if kind == "still":
        return _still(start, before, after)
    if kind in _GAITS:
        ahead = _branch(rng)
        past = _branch(rng)
        there = _march(kind, start, speed_m_s, after, ahead, fits)
        x, y, z, yaw = start
        turned = (x, y, z, yaw + math.pi)
        back = _march(kind, turned, speed_m_s, before, past, fits)
        return _joined(back, there)
    if kind in ("fly", "flock"):
        return _flight(kind, start, speed_m_s, before, after, rng)
    if kind == "hover":
        return _hover(start, speed_m_s, before, after, rng)
    raise ValueError(f"{kind}: no path of its own")


def sway(times_s: FloatArray, size: float, periods_s: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """Return (n,) smooth values about 0 that stay within `size`: three waves with periods of the range."""
    low, high = (math.log(p) for p in periods_s)
    periods = np.exp(rng.uniform(low, high, 3))
    phases = rng.uniform(0, 2 * np.pi, 3)
    shares = np.array([0.5, 0.3, 0.2])
    waves = np.sin(2 * np.pi * times_s[:, None] / periods + phases)
    return np.asarray(size * (waves * shares).sum(axis=1))


def _branch(rng: np.random.Generator) -> np.random.Generator:
    """Return a stream of its own, which one number of another stream starts."""
    return np.random.Generator(np.random.PCG64(int(rng.integers(2**63))))


def _grid(before: int, after: int) -> FloatArray:
    return np.asarray(STEP_S * np.arange(-before, after + 1), np.float64)


def _still(start: tuple[float, float, float, float], before: int, after: int) -> Path:
    times = _grid(before, after)
    zero = np.zeros_like(times)
    return Path(times, np.tile(start[:3], (len(times), 1)), np.full_like(times, start[3]), zero, zero, zero)


def _march(
    kind: MotionKind,
    start: tuple[float, float, float, float],
    speed: float,
    count: int,
    rng: np.random.Generator,
    fits: Fits,
) -> Path:
    """Step forwards over the ground, around what is in the way, or to a stop before it."""
    gait = _GAITS[kind]
    x, y, z, yaw = start
    of_meals = _branch(rng)  # a stream of its own: neither depends on how long the other one is
    wander = _curves(gait.wander * math.sqrt(STEP_S) * rng.standard_normal(count))
    moves = _appetite(count, of_meals) if kind == "graze" else np.ones(count)
    v = speed * moves[0]
    turn_to = 0.0
    way = 0.0
    rows = [(x, y, yaw, way)]
    for k in range(count):
        want = speed * moves[k]
        turned = 0.0
        look = max(_AHEAD_M, v * _AHEAD_S + v * v / (2 * gait.acceleration))
        if want > 0 and not fits(x + look * math.cos(yaw), y + look * math.sin(yaw)):
            if kind == "drive":
                want = 0.0
            else:
                if turn_to == 0.0:
                    turn_to = _way_out(x, y, yaw, look, fits, side=1.0 if wander[k] >= 0 else -1.0)
                turned = math.copysign(gait.turn * STEP_S, turn_to)
                if abs(turn_to) > math.pi / 2:
                    want = 0.0
        else:
            turn_to = 0.0
        v += min(max(want - v, -gait.acceleration * STEP_S), gait.acceleration * STEP_S)
        turn = turned or wander[k] * v / max(speed, 1e-9)  # who stands does not turn
        yaw += min(max(turn, -gait.turn * STEP_S), gait.turn * STEP_S)
        x += v * STEP_S * math.cos(yaw)
        y += v * STEP_S * math.sin(yaw)
        way += v * STEP_S
        rows.append((x, y, yaw, way))
    found = np.array(rows)
    zero = np.zeros(len(rows))
    place = np.column_stack([found[:, :2], np.full(len(rows), z)])
    return Path(_grid(0, count), place, found[:, 2], zero, zero, found[:, 3])


def _curves(steps: FloatArray) -> FloatArray:
    """Return random steps that follow each other smoothly and add up to a wander as wide as that of the given ones."""
    share = STEP_S / _CURVE_S
    found = np.empty_like(steps)
    last = steps[0] * math.sqrt(share / (2 - share)) if len(steps) else 0.0
    for k, step in enumerate(steps):
        found[k] = last = last + share * (step - last)
    return found


def _way_out(x: float, y: float, yaw: float, look: float, fits: Fits, side: float) -> float:
    """Return the smallest turn after which nothing is in the way; to one side if all ways are blocked."""
    for turn in np.radians([30, 60, 90, 120, 150, 180]):
        for to in (side * turn, -side * turn):
            if fits(x + look * math.cos(yaw + to), y + look * math.sin(yaw + to)):
                return float(to)
    return side * math.pi


def _appetite(count: int, rng: np.random.Generator) -> FloatArray:
    """Return (count,) 1 while an animal steps on, 0 while it eats."""
    moves: list[float] = []
    stepping = bool(rng.random() < 0.2)
    while len(moves) < count:
        low, high = _STEPS_S if stepping else _MEAL_S
        moves += [float(stepping)] * round(rng.uniform(low, high) / STEP_S)
        stepping = not stepping
    return np.array(moves[:count])


def _joined(back: Path, there: Path) -> Path:
    """Return one path of a march into the past, heading the other way, and one into the future."""

    def both(past: FloatArray, future: FloatArray) -> FloatArray:
        return np.concatenate([past[:0:-1], future])

    return Path(
        both(-back.times_s, there.times_s),
        both(back.place_m, there.place_m),
        both(back.yaw_rad - math.pi, there.yaw_rad),
        both(back.lean_rad, there.lean_rad),
        both(back.bank_rad, there.bank_rad),
        both(-back.way_m, there.way_m),
    )


def _flight(
    kind: MotionKind,
    start: tuple[float, float, float, float],
    speed: float,
    before: int,
    after: int,
    rng: np.random.Generator,
) -> Path:
    """Fly curves at an even speed, facing where it goes, and bank in them."""
    times = _grid(before, after)
    most = min(_ACCELERATION / max(speed, 1e-6), 0.8)  # rad/s
    mean = float(rng.uniform(0.15, 0.6) * most)
    turned = float(rng.uniform(0, 2 * math.pi))
    sign = 1.0 if rng.random() < 0.5 else -1.0
    turns = sign * mean + sway(times, most - mean, (6.0, 20.0), rng)
    yaw = np.cumsum(turns) * STEP_S
    yaw += (turned if kind == "flock" else start[3]) - yaw[before]
    flat = np.stack([np.cos(yaw), np.sin(yaw)], axis=1) * speed
    climbs = sway(times, min(1.5, 0.2 * speed), (6.0, 20.0), rng)
    step = np.column_stack([flat, climbs]) * STEP_S
    place = np.cumsum(step, axis=0)
    place += np.array(start[:3]) - place[before]
    bank = -np.arctan(speed * turns / _GRAVITY)  # a turn to the left has the right side up
    lean = np.full_like(times, math.atan(_DRAG * speed**2 / _GRAVITY))
    return Path(times, place, yaw, lean, bank, speed * times)


def _hover(
    start: tuple[float, float, float, float], speed: float, before: int, after: int, rng: np.random.Generator
) -> Path:
    """Drift a little to and fro, and lean against the wind."""
    times = _grid(before, after)
    size = speed * _HOVER_S[0] / (2 * math.pi)  # the fastest waves have this speed
    place = np.stack([sway(times, s, _HOVER_S, rng) for s in (size, size, size / 2)], axis=1)
    place += np.array(start[:3]) - place[before]
    yaw = sway(times, 0.15, _WANDER_S, rng)
    yaw += start[3] - yaw[before]
    lean, bank = (sway(times, math.radians(6), _HOVER_S, rng) for _ in range(2))
    return Path(times, place, yaw, lean, bank, np.zeros_like(times))
