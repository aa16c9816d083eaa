"""The Blender renderer: turns a placed scene into a crop of linear radiance, alpha and coverage."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from infrablend.blender import session
from infrablend.blender.materials import aov_name, object_material
from infrablend.blender.physical import UNIT_W_M2_SR, set_world, sky_values
from infrablend.blender.quality import sampling_for
from infrablend.core.machine import Device
from infrablend.core.placed import PlacedObject, PlacedScene
from infrablend.core.render import RenderResult, empty_result
from infrablend.core.scene import SceneSpec
from infrablend.errors import RenderError
from infrablend.rendering.emission import crop_of, crops_of, only_emits, render_emission
from infrablend.rendering.surfaces import ZERO_C_K, ground_radiance, is_two_sided, surface_values

# A part mirrors another part, which mirrors the sky. A third bounce would add less than 1 % of the mirrored 5 %.
PHYSICAL_BOUNCES = 2
# Bare metal mirrors up to 95 %: in its hollows, light that ended after two bounces would leave them black.
METAL_BOUNCES = 16
_LOW_EMISSIVITY = 0.5


class BlenderRenderer:
    """Renders with Cycles, cropped to the objects. Cropping is exact: Cycles samples by absolute pixel position.

    Scenes without a given number of samples, in which surfaces only emit, need no path tracing: `rendering.emission`.
    """

    def __init__(self, device: Device = "cpu", *, whole_frame: bool = False) -> None:
        """Start from an empty Blender scene.

        `whole_frame` renders every pixel of the frame instead of a crop; for measurements.
        """
        self._whole_frame = whole_frame
        self._stage = session.Stage(device)
        self._scene = self._stage.scene

    def render(self, scene: PlacedScene) -> RenderResult:
        """Render a scene, cropped to what its objects cover; a scene without objects gives an empty crop."""
        spec, objects = scene.spec, scene.objects
        w, h = spec.camera.size_wh
        if not spec.samples and not self._whole_frame and only_emits(scene):
            return render_emission(scene)
        started = time.perf_counter()
        crop = (0, 0, w, h) if self._whole_frame else crop_of(scene)
        if crop is None:
            return empty_result((w, h), len(objects))
        parts = [(crop, [*range(len(objects))])] if self._whole_frame else crops_of(scene)
        slots = {k: slot for _, group in parts for slot, k in enumerate(group)}
        self._stage.set_camera(spec.camera, (0.01, 10_000.0))
        self._set_sampling(spec.samples, spec.render_seed)
        self._set_aovs(max((len(group) for _, group in parts), default=0))
        self._set_light(scene)
        x0, y0, x1, y1 = crop
        layers = np.zeros((2 + len(objects), y1 - y0, x1 - x0), np.float32)
        with contextlib.ExitStack() as stack:
            for k, placed in enumerate(objects):
                stack.enter_context(self._object(k, slots.get(k, 0), placed, spec))
            built = time.perf_counter()
            for number, (part, group) in enumerate(parts, 1):
                self._set_crop(part, (w, h))
                # What Cycles has built of the scene serves the frame's next part, but no other frame.
                self._scene.render.use_persistent_data = number < len(parts)
                self._stage.render(spec.frame_id)
                left, top, right, bottom = part
                place = (slice(top - y0, bottom - y0), slice(left - x0, right - x0))
                for layer, pixels in self._read(group, (bottom - top, right - left), spec.frame_id):
                    layers[layer][place] = pixels
        radiance, alpha, coverage = layers[0], layers[1], layers[2:]
        if spec.weather is not None:
            radiance *= np.float32(UNIT_W_M2_SR)
        seconds = {"build": built - started, "render": time.perf_counter() - built}
        return RenderResult((x0, y0), (w, h), radiance, alpha, coverage, ground_radiance(scene), seconds)

    def close(self) -> None:
        """Remove the scratch folder and empty the scene."""
        self._stage.close()
        bpy.ops.wm.read_factory_settings(use_empty=True)

    def _set_crop(self, crop: tuple[int, int, int, int], size_wh: tuple[int, int]) -> None:
        x0, y0, x1, y1 = crop
        w, h = size_wh
        r = self._scene.render
        r.use_border = r.use_crop_to_border = True
        # Blender truncates border * size: aim at the middle of the rounding interval. Its rows count from the bottom.
        r.border_min_x, r.border_max_x = (x0 + 0.25) / w, (x1 + 0.25) / w
        r.border_min_y, r.border_max_y = (h - y1 + 0.25) / h, (h - y0 + 0.25) / h

    def _set_sampling(self, samples: int, seed: int) -> None:
        c, how = self._scene.cycles, sampling_for(samples)
        c.seed, c.samples, c.sampling_pattern = seed, how.samples, how.pattern
        c.use_adaptive_sampling = how.adaptive_threshold > 0
        if c.use_adaptive_sampling:
            c.adaptive_threshold, c.adaptive_min_samples = how.adaptive_threshold, how.adaptive_min_samples

    def _set_light(self, scene: PlacedScene) -> None:
        """Set the world: none in the artistic look; in the physical look, sky and ground, which surfaces mirror."""
        weather, c = scene.spec.weather, self._scene.cycles
        if weather is None:
            self._scene.world = None
        else:
            set_world(self._scene, weather)
        c.max_bounces = c.diffuse_bounces = c.glossy_bounces = 0 if weather is None else _bounces(scene)

    def _set_aovs(self, count: int) -> None:
        aovs = self._scene.view_layers[0].aovs
        while len(aovs) > count:
            aovs.remove(aovs[-1])
        while len(aovs) < count:
            aov = aovs.add()
            aov.name = aov_name(len(aovs) - 1)
            aov.type = "VALUE"

    @contextlib.contextmanager
    def _object(self, number: int, slot: int, placed: PlacedObject, scene: SceneSpec) -> Iterator[None]:
        """Put one object into the scene, with a pass for its coverage; remove it and all its data at the end."""
        data = bpy.data.meshes.new(f"mesh_{number}")
        thing = None
        try:
            _fill_mesh(data, placed, scene)
            translucent = any(placed.spec.parts[name].opacity < 1 for name in placed.mesh.part_names)
            physical, two_sided = scene.weather is not None, is_two_sided(placed.mesh)
            material = object_material(slot, physical=physical, translucent=translucent, two_sided=two_sided)
            data.materials.append(material)
            thing = bpy.data.objects.new(f"thing_{number}", data)
            look = scene.appearance
            thing["cold_c"] = look.cold_k - ZERO_C_K
            thing["hot_c"] = look.hot_k - ZERO_C_K
            thing["surroundings_c"] = look.surroundings_k - ZERO_C_K
            if scene.weather is not None:
                for name, value in sky_values(scene.weather).items():
                    thing[name] = value
            self._scene.collection.objects.link(thing)
            yield
        finally:
            # Blender keeps data until it is removed explicitly; without this, each frame would leak 0.4 MB.
            if thing is not None:
                bpy.data.objects.remove(thing, do_unlink=True)
            bpy.data.meshes.remove(data, do_unlink=True)

    def _read(
        self, group: Sequence[int], shape_hw: tuple[int, int], frame_id: str
    ) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Yield the layers of what was rendered: 0 for radiance, 1 for alpha, 2 + k for the coverage of object k."""
        channels = self._stage.channels()

        def named(*endings: str) -> NDArray[np.float32]:
            pixels = session.channel(channels, frame_id, *endings)
            if pixels.shape != shape_hw:
                raise RenderError(f"{frame_id}: Cycles returned {pixels.shape} pixels for a crop of {shape_hw}")
            return pixels

        yield 0, named("combined.r")
        yield 1, np.clip(named("combined.a"), 0, 1)
        for slot, k in enumerate(group):
            yield 2 + k, np.clip(named(f"{aov_name(slot)}.v", f"{aov_name(slot)}.x", aov_name(slot)), 0, 1)


def _bounces(scene: PlacedScene) -> int:
    """Return the number of times that light is followed from surface to surface, in the physical look."""
    states = [placed.spec.parts[name] for placed in scene.objects for name in placed.mesh.part_names]
    return METAL_BOUNCES if any(s.metal or s.emissivity < _LOW_EMISSIVITY for s in states) else PHYSICAL_BOUNCES


def _fill_mesh(data: bpy.types.Mesh, placed: PlacedObject, scene: SceneSpec) -> None:
    mesh = placed.mesh
    session.fill_mesh(data, placed.world_m, mesh.triangles)
    data.polygons.foreach_set("use_smooth", np.ascontiguousarray(mesh.smooth))
    for name, values in surface_values(placed, scene).items():
        data.attributes.new(name, "FLOAT", "CORNER").data.foreach_set("value", values)
    data.update()
