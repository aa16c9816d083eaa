"""Partly hidden objects of a frame: where they may be placed, what is in front of them, and their labels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.annotation.labels import Drop, LabelReport, annotate, label_occluded
from infrablend.assets.model import ObjectModel
from infrablend.compositing.mapping import GreyImage
from infrablend.compositing.occlusion import Occluder, Scenery, Share, Wanted, front_matte
from infrablend.config.recipe import Labels, Occlusion
from infrablend.core.boxes import box_of_points
from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import Instance
from infrablend.core.mesh import FloatArray
from infrablend.core.raster import project_triangles, silhouette
from infrablend.core.render import PlacedScene, RenderResult
from infrablend.sampling.placement import PlacementRequest

# Places with less texture than this share of what has to be hidden, this far around them, are not examined further.
_LEAST_TEXTURE = 0.5
_AROUND_PX = 10.0


@dataclass(frozen=True)
class Front:
    """What is in front of a track, as it was found in its anchor.

    Attributes:
        occluder: The structures, with strengths in the levels of the frame; None for none.
        stays: Whether the object stays in its place, so that the same structures are in front of it in all frames.
    """

    occluder: Occluder | None
    stays: bool


@dataclass(frozen=True, eq=False)
class Cover:
    """What a background can hide, for the objects of one frame.

    Attributes:
        rules: The recipe's section.
        scenery: The background.
        models: The recipe's models, by the name used in the recipe.
    """

    rules: Occlusion
    scenery: Scenery
    models: Mapping[str, ObjectModel]

    def has_structure(self, x: float, y: float, stands: bool) -> bool:
        """Return whether structures around a position in the picture may hide an object that stands or flies there."""
        around = np.array([x - _AROUND_PX, y - _AROUND_PX, x + _AROUND_PX, y + _AROUND_PX])
        if stands:
            return self.scenery.is_tangled(around)
        return bool(self.scenery.texture(around) > _LEAST_TEXTURE * (1 - self.rules.visible[1]))

    def hides(self, camera: CameraSpec, world_m: FloatArray, item: PlacementRequest) -> bool:
        """Return whether the background can hide an object with these world vertices as much as it asks for."""
        if item.visible_aim is None:
            return False
        roles = item.model.roles(item.params)
        labelled = np.array([roles[n].label for n in item.mesh.part_names])[item.mesh.part_of_triangle]
        xy = project_triangles(camera, world_m, item.mesh.triangles[labelled]).xy
        return self._find(xy, camera.size_wh, item.visible_aim, item.model.stands) is not None

    def find(self, scene: PlacedScene, fronts: Mapping[int, Front]) -> dict[int, Occluder]:
        """Return the occluder of each object that is to be hidden and can be, by its number.

        `fronts`, by track, is what was in front of objects in the anchors of their sequence. Objects that move and had
        nothing in front of them there may get behind something later.
        """
        found = {}
        for k, placed in enumerate(scene.objects):
            spec = placed.spec
            if spec.visible_aim is None:
                continue
            labelled = np.array([spec.parts[n].label for n in placed.mesh.part_names])[placed.mesh.part_of_triangle]
            xy = placed.triangles_of(labelled).xy
            stands = self.models[spec.model].stands
            front = fronts.get(spec.track or 0)
            occluder = self._find(xy, placed.camera.size_wh, spec.visible_aim, stands, front)
            if occluder is not None:
                found[k] = occluder
        return found

    def _find(
        self, xy: FloatArray, size_wh: tuple[int, int], aim: float, stands: bool, front: Front | None = None
    ) -> Occluder | None:
        if not len(xy):
            return None
        box = np.clip(box_of_points(xy.reshape(-1, 2)), 0, np.array([*size_wh, *size_wh]))
        if (box[2:] <= box[:2]).any():  # outside the frame
            return None
        offset_xy = (math.floor(box[0]), math.floor(box[1]))
        crop_wh = (math.ceil(box[2]) - offset_xy[0], math.ceil(box[3]) - offset_xy[1])
        shape = silhouette(xy, offset_xy, crop_wh)
        if front is not None and front.occluder is not None:
            return self.scenery.again(front.occluder, shape, offset_xy, in_tangle=stands and not front.stays)
        if front is not None and front.stays:
            return None
        return self.scenery.find(shape, offset_xy, Wanted(aim, *self.rules.visible), lines=not stands)


def front_of(occluders: Mapping[int, Occluder], scenery: Scenery | None, rendered: RenderResult) -> Share | None:
    """Return the (h, w) share of each pixel of the picture that stays in front of the objects; None for nothing."""
    if scenery is None or not occluders:
        return None
    return front_matte(occluders, scenery, rendered.coverage, rendered.offset_xy)


def recorded_front(facts: Mapping[str, Any], background: GreyImage, rendered: RenderResult) -> Share | None:
    """Return the same from the facts of a frame's record."""
    recorded = {o["object"]: Occluder.from_json(o) for o in facts.get("occlusion", ()) if "window" in o}
    return front_of(recorded, Scenery(background), rendered)


def behind_front(rendered: RenderResult, front: Share | None, numbers: Iterable[int]) -> RenderResult:
    """Return the render with the coverage of some objects reduced to what is visible behind `front`."""
    if front is None:
        return rendered
    (x, y), (h, w) = rendered.offset_xy, rendered.alpha.shape
    seen = rendered.coverage.copy()
    seen[list(numbers)] *= 1 - front[y : y + h, x : x + w]
    return replace(rendered, coverage=seen)


def label_objects(
    scene: PlacedScene, rendered: RenderResult, seen: RenderResult, occluded: Iterable[int], labels: Labels
) -> tuple[tuple[Instance, ...], LabelReport]:
    """Label the objects of a frame, some of which are partly hidden.

    Args:
        scene: The scene.
        rendered: The rendered scene.
        seen: The same with the coverage of what is visible.
        occluded: Numbers of the partly hidden objects.
        labels: The recipe's section.
    """
    found, report = annotate(scene, seen, labels.obb)
    hidden = set(occluded)
    result = []
    for k, label in zip(report.kept, found, strict=True):
        if k in hidden:
            # In double precision, because sums in single precision depend on the version of numpy.
            left, whole = (float(r.coverage[k].sum(dtype=np.float64)) for r in (seen, rendered))
            share = left / max(whole, 1e-9)
            label = label_occluded(label, scene.objects[k], share, labels.occluded_box, labels.obb)
        result.append(label)
    return tuple(result), report


def behind_text(
    labels: Sequence[Instance], report: LabelReport, seen: RenderResult, written: NDArray[np.bool_]
) -> tuple[tuple[Instance, ...], LabelReport, RenderResult]:
    """Return labels and report without the objects that text hides, and with the visible shares of the others.

    `seen` has the coverage of what would be visible without the text; that with it is returned, too.
    """
    left = behind_front(seen, written.astype(np.float32), range(len(seen.coverage)))
    kept = []
    found = []
    hidden = []
    for k, label in zip(report.kept, labels, strict=True):
        after, before = (float(r.coverage[k].sum(dtype=np.float64)) for r in (left, seen))
        if after <= 0:
            hidden.append(Drop(k, label.category, "behind_text"))
        else:
            kept.append(k)
            share = after / max(before, 1e-9)
            found.append(label if label.visibility is None else replace(label, visibility=label.visibility * share))
    drops = tuple(sorted((*report.drops, *hidden), key=lambda d: d.index))
    return tuple(found), replace(report, kept=tuple(kept), drops=drops), left


def too_hidden(
    labels: Sequence[Instance], report: LabelReport, occluded: Iterable[int], rules: Occlusion, min_visibility: float
) -> list[int]:
    """Return the numbers of the partly hidden objects of which less is visible than the recipe asks for.

    Both `occlusion.visible` and `placement.min_visibility` are limits.
    """
    visible = {k: label.visibility or 0.0 for k, label in zip(report.kept, labels, strict=True)}
    return [k for k in sorted(occluded) if visible.get(k, 0.0) < max(rules.visible[0], min_visibility)]


def occlusion_facts(scene: PlacedScene, occluders: Mapping[int, Occluder]) -> list[dict[str, object]]:
    """Return what the record of a frame says about the objects that were to be hidden."""
    facts: list[dict[str, object]] = []
    for k, placed in enumerate(scene.objects):
        if (aim := placed.spec.visible_aim) is not None:
            found = occluders[k].to_json() if k in occluders else {"reason": "no_occluder"}
            facts.append({"object": k, "aim": aim, **found})
    return facts
