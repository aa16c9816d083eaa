"""Rows of objects, as cars park: side by side, or behind one another."""

from __future__ import annotations

import math
from collections.abc import Sequence

from infrablend.config.recipe import Group
from infrablend.sampling.placement import Pose

# Which objects are of one row: how far from its line they may be, metres, and how far turned against another, degrees.
_WIDTH_M = 1.5
_PARALLEL_DEG = 15.0


def goes_on_behind(mate: Pose, mates: Sequence[Pose], group: Group) -> bool | None:
    """Return whether an object's row goes on behind and before it rather than beside it; None for one without a row."""
    nearest_m = {}
    for behind, turn_rad, reach_m in ((True, 0.0, group.behind_m[1]), (False, math.pi / 2, group.apart_m[1])):
        row = _on_line(mate, mates, mate[3] + turn_rad)
        nearest_m[behind] = min((abs(m) for m, pose in row if pose is not mate and abs(m) <= reach_m), default=math.inf)
    if min(nearest_m.values()) == math.inf:
        return None
    return nearest_m[True] < nearest_m[False]


def end_of_row(mate: Pose, mates: Sequence[Pose], towards_rad: float, reach_m: float) -> Pose:
    """Return the last object of a row in a direction, from one of its objects on."""
    end = mate
    end_m = 0.0
    for along_m, pose in _on_line(mate, mates, towards_rad):
        if end_m < along_m <= end_m + reach_m:
            end = pose
            end_m = along_m
    return end


def _on_line(mate: Pose, mates: Sequence[Pose], towards_rad: float) -> list[tuple[float, Pose]]:
    """Return the parallel objects on a line through one of them, from back to front, with metres from that one."""
    cos = math.cos(towards_rad)
    sin = math.sin(towards_rad)
    return sorted(
        ((pose[0] - mate[0]) * cos + (pose[1] - mate[1]) * sin, pose)
        for pose in mates
        if abs((pose[1] - mate[1]) * cos - (pose[0] - mate[0]) * sin) < _WIDTH_M
        and abs(math.remainder(pose[3] - mate[3], math.pi)) < math.radians(_PARALLEL_DEG)
    )
