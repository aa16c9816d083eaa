"""The paper's placement: objects around the origin of a virtual scene, redrawn until they are visible."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from infrablend.config.recipe import PaperObject, PaperRecipe
from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import boxes_of
from infrablend.imaging.margin import on_margin
from infrablend.sampling.placement import (
    DrawStatistics,
    PlacementRequest,
    Pose,
    attempts_after,
    examine,
    is_covered,
)
from infrablend.sampling.placer import Arrangement, Placer, Streams
from infrablend.sampling.site import Site


@dataclass(frozen=True, eq=False)
class PaperPlacer(Placer):
    """The placement of `placement.mode: paper`; objects that are too faint keep their places, or are left out."""

    recipe: PaperRecipe

    def arrange(
        self,
        like: CameraSpec,
        wanted: Sequence[PlacementRequest],
        site: Site | None,
        streams: Streams,
        tally: DrawStatistics,
    ) -> Arrangement:
        """Draw the camera and a pose per object.

        The first object is drawn together with the camera (paper: d, x, y, yaw, roll). The others are then drawn one by
        one in the view of that camera, because redrawing all objects until they fit together would take far too many
        draws.
        """
        rules = self.recipe.placement
        rng = streams("placement")
        ignored = [i for i in site.labels if i.category in site.ignored] if site and rules.clear_of_ignored else []
        avoid = boxes_of(ignored)
        margin = site.margin if site else None
        camera = self._camera(like, rng)
        tally.first_distance_m = camera.distance_m
        poses: list[Pose | None] = []
        missed: dict[int, int] = {}  # by identity of the kind: objects in a row, up to now, without a place
        for number, item in enumerate(wanted):
            pose = _draw_pose(item, rng)
            if item.model.needed_ground(item.params) is not None:  # there is no ground here
                tally.left_out[item.number] = "no_ground"
                poses.append(None)
                continue
            if rules.on_miss == "keep":
                tally.attempts += 1
                poses.append(pose)
                continue
            accepted = False
            in_a_row = missed.get(id(item.kind), 0)
            for attempt in range(attempts_after(in_a_row, rules.attempts)):
                if attempt and rules.on_miss == "redraw" and number == 0:
                    camera = self._camera(like, rng)
                if attempt:
                    fresh = _draw_pose(item, rng)
                    pose = fresh if rules.on_miss == "redraw" else (fresh[0], fresh[1], pose[2], pose[3])
                tally.attempts += 1
                reason, box = examine(camera, item.in_world(pose), item, rules)
                tally.note_size(reason, box)
                if reason is None and is_covered(box, avoid):
                    reason = "on_ignored"
                elif reason is None and on_margin(margin, box):
                    reason = "on_margin"
                if reason is None:
                    accepted = True
                    break
                tally.rejected[reason] += 1
            if not accepted:
                tally.left_out[item.number] = "no_place"
            missed[id(item.kind)] = 0 if accepted else in_a_row + 1
            poses.append(pose if accepted else None)
        return Arrangement(camera, None, poses)

    def _camera(self, like: CameraSpec, rng: np.random.Generator) -> CameraSpec:
        c = self.recipe.camera
        distance_m = float(rng.uniform(*c.distance_m))
        return replace(like, distance_m=distance_m, roll_rad=math.radians(rng.uniform(*c.roll_deg)))


def _draw_pose(item: PlacementRequest, rng: np.random.Generator) -> Pose:
    kind = cast(PaperObject, item.kind)
    x, y, z = (float(rng.uniform(*r)) for r in (kind.x_m, kind.y_m, kind.z_m))
    return x, y, z, math.radians(rng.uniform(*kind.yaw_deg))
