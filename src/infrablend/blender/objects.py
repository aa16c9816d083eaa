"""Renders inserted objects: light, alpha, and the coverage of each object, in crops. The caller computes every value.

Cropping is exact: Cycles samples by absolute pixel position.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

import bpy
import numpy as np

from infrablend.blender import session
from infrablend.blender.materials import aov_name, object_material
from infrablend.blender.physical import set_world
from infrablend.core.wire import ObjectMessage, SceneMessage


class ObjectScenes:
    """Renders scenes of inserted objects, one after the other."""

    def __init__(self, stage: session.Stage) -> None:
        """Render on a stage, see `session.Stage`."""
        self._stage = stage
        self._scene = stage.scene

    def render(self, job: SceneMessage) -> dict[str, float]:
        """Render the crops of a scene to `0.exr`, `1.exr`, ..., and return the seconds that the steps took.

        Raises:
            RenderError: Cycles failed.
        """
        started = time.perf_counter()
        self._stage.set_camera(job["camera"])
        for name, value in job["cycles"].items():
            setattr(self._scene.cycles, name, value)
        self._set_aovs(1 + max(given["slot"] for given in job["objects"]))
        if job["sky"] is None:
            self._scene.world = None
        else:
            set_world(self._scene, job["sky"])
        with contextlib.ExitStack() as stack:
            for number, given in enumerate(job["objects"]):
                stack.enter_context(self._object(number, given, physical=job["sky"] is not None))
            built = time.perf_counter()
            for number, crop in enumerate(job["crops"]):
                self._set_crop(crop, job["camera"]["size_wh"])
                # What Cycles has built of the scene serves its next crop, but no other scene.
                self._scene.render.use_persistent_data = number + 1 < len(job["crops"])
                self._stage.render(job["what"], number)
        return {"build": built - started, "render": time.perf_counter() - built}

    def _set_crop(self, crop: tuple[int, int, int, int], size_wh: tuple[int, int]) -> None:
        x0, y0, x1, y1 = crop
        w, h = size_wh
        r = self._scene.render
        r.use_border = r.use_crop_to_border = True
        # Blender truncates border * size: aim at the middle of the rounding interval. Its rows count from the bottom.
        r.border_min_x, r.border_max_x = (x0 + 0.25) / w, (x1 + 0.25) / w
        r.border_min_y, r.border_max_y = (h - y1 + 0.25) / h, (h - y0 + 0.25) / h

    def _set_aovs(self, count: int) -> None:
        aovs = self._scene.view_layers[0].aovs
        while len(aovs) > count:
            aovs.remove(aovs[-1])
        while len(aovs) < count:
            aov = aovs.add()
            aov.name = aov_name(len(aovs) - 1)
            aov.type = "VALUE"

    @contextlib.contextmanager
    def _object(self, number: int, given: ObjectMessage, *, physical: bool) -> Iterator[None]:
        """Put the object with this number into the scene, and remove it and all its data at the end."""
        data = bpy.data.meshes.new(f"mesh_{number}")
        thing = None
        try:
            session.fill_mesh(data, given["vertices_m"], given["triangles"])
            data.polygons.foreach_set("use_smooth", np.ascontiguousarray(given["smooth"]))
            for name, values in given["values"].items():
                data.attributes.new(name, "FLOAT", "CORNER").data.foreach_set("value", values)
            data.update()
            translucent = given["translucent"]
            two_sided = given["two_sided"]
            slot = given["slot"]
            data.materials.append(
                object_material(slot, physical=physical, translucent=translucent, two_sided=two_sided)
            )
            thing = bpy.data.objects.new(f"thing_{number}", data)
            for name, value in given["properties"].items():
                thing[name] = value
            self._scene.collection.objects.link(thing)
            yield
        finally:
            # Blender keeps data until it is removed explicitly; without this, each frame would leak 0.4 MB.
            if thing is not None:
                bpy.data.objects.remove(thing, do_unlink=True)
            bpy.data.meshes.remove(data, do_unlink=True)
