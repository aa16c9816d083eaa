"""The Blender renderer: turns a placed scene into a crop of linear radiance, alpha and coverage."""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import mathutils
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from infrablend.blender import session
from infrablend.blender.materials import aov_name, object_material
from infrablend.blender.physical import UNIT_W_M2_SR, set_world, sky_values
from infrablend.blender.quality import sampling_for
from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import FloatArray, Mesh
from infrablend.core.placed import PlacedObject, PlacedScene
from infrablend.core.render import Device, RenderResult, empty_result
from infrablend.core.scene import SceneSpec
from infrablend.errors import RenderError
from infrablend.rendering.glow import ground_radiance

ZERO_C_K = 273.15
# A part mirrors another part, which mirrors the sky. A third bounce would add less than 1 % of the mirrored 5 %.
PHYSICAL_BOUNCES = 2
# One pixel more than the projected outline, so that rounding loses nothing.
CROP_MARGIN_PX = 1


class BlenderRenderer:
    """Renders with Cycles, cropped to the objects. Cropping is exact: Cycles samples by absolute pixel position."""

    def __init__(
        self,
        device: Device = "cpu",
        threads: int = 1,
        scratch: Path | None = None,
        *,
        whole_frame: bool = False,
    ) -> None:
        """Start from an empty Blender scene.

        Args:
            device: Device that Cycles computes on.
            threads: CPU threads of one render; workers run in parallel, so 1 gives the best throughput.
            scratch: Folder for the render's float file; by default $TMPDIR, else memory (/dev/shm) where it exists.
            whole_frame: Render every pixel of the frame instead of a crop; for measurements.
        """
        self._whole_frame = whole_frame
        session.return_large_blocks()
        self._scene = session.reset()
        self.device = session.use_device(self._scene, device, threads)
        shm = "/dev/shm" if Path("/dev/shm").is_dir() else None
        # Workers get a TMPDIR in memory that their parent removes, so a killed one leaves nothing behind.
        self._folder = tempfile.TemporaryDirectory(prefix="infrablend_", dir=scratch or os.environ.get("TMPDIR") or shm)
        self._file = Path(self._folder.name) / "render.exr"
        s = self._scene
        camera = bpy.data.cameras.new("camera")
        self._camera = bpy.data.objects.new("camera", camera)
        s.collection.objects.link(self._camera)
        s.camera = self._camera
        settings = s.render.image_settings
        settings.file_format = "OPEN_EXR_MULTILAYER"
        settings.color_mode = "RGBA"
        settings.color_depth = "32"
        settings.exr_codec = "NONE"
        s.render.use_file_extension = False
        s.render.filepath = str(self._file)

    def render(self, scene: PlacedScene) -> RenderResult:
        """Render a scene, cropped to what its objects cover; a scene without objects gives an empty crop."""
        spec, objects = scene.spec, scene.objects
        w, h = spec.camera.size_wh
        started = time.perf_counter()
        crop = (0, 0, w, h) if self._whole_frame else crop_of(scene)
        if crop is None:
            return empty_result((w, h), len(objects))
        x0, y0, x1, y1 = crop
        self._set_camera(spec.camera)
        self._set_crop(crop, (w, h))
        self._set_sampling(spec.samples, spec.render_seed)
        self._set_aovs(len(objects))
        self._set_light(spec)
        with contextlib.ExitStack() as stack:
            for slot, placed in enumerate(objects):
                stack.enter_context(self._object(slot, placed, spec))
            built = time.perf_counter()
            self._file.unlink(missing_ok=True)
            try:
                bpy.ops.render.render(write_still=True)
            except RuntimeError as error:
                raise RenderError(f"{spec.frame_id}: Cycles failed: {error}") from error
        rendered = time.perf_counter()
        radiance, alpha, coverage = self._read(len(objects), (y1 - y0, x1 - x0), spec.frame_id)
        if spec.appearance.mode == "physical":
            radiance = np.asarray(radiance * UNIT_W_M2_SR, np.float32)
        seconds = {
            "build": built - started,
            "render": rendered - built,
            "read": time.perf_counter() - rendered,
        }
        return RenderResult((x0, y0), (w, h), radiance, alpha, coverage, ground_radiance(scene), seconds)

    def close(self) -> None:
        """Remove the scratch folder and empty the scene."""
        self._folder.cleanup()
        bpy.ops.wm.read_factory_settings(use_empty=True)

    def _set_camera(self, camera: CameraSpec) -> None:
        data = self._camera.data
        data.sensor_fit = "HORIZONTAL"
        data.sensor_width = camera.sensor_width_mm
        data.lens = camera.focal_length_mm
        data.clip_start, data.clip_end = 0.01, 10_000.0
        # Blender's camera looks along -Z with +Y up; ours along +z with +y down.
        axes = camera.world_to_camera.T @ np.diag([1.0, -1.0, -1.0])
        matrix = np.eye(4)
        matrix[:3, :3] = axes
        matrix[:3, 3] = camera.position_m
        self._camera.matrix_world = mathutils.Matrix(matrix.tolist())
        r = self._scene.render
        r.resolution_x, r.resolution_y = camera.size_wh

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

    def _set_light(self, scene: SceneSpec) -> None:
        """Set the world: none in the artistic look; in the physical look, sky and ground, which surfaces mirror."""
        physical = scene.appearance.mode == "physical"
        if physical:
            if scene.weather is None:
                raise ValueError(f"{scene.frame_id}: the physical look needs the weather")
            set_world(self._scene, scene.weather)
        else:
            self._scene.world = None
        c = self._scene.cycles
        c.max_bounces = c.diffuse_bounces = c.glossy_bounces = PHYSICAL_BOUNCES if physical else 0

    def _set_aovs(self, count: int) -> None:
        aovs = self._scene.view_layers[0].aovs
        while len(aovs) > count:
            aovs.remove(aovs[-1])
        while len(aovs) < count:
            aov = aovs.add()
            aov.name = aov_name(len(aovs) - 1)
            aov.type = "VALUE"

    @contextlib.contextmanager
    def _object(self, slot: int, placed: PlacedObject, scene: SceneSpec) -> Iterator[None]:
        """Put one object into the scene, and remove it and all its data at the end."""
        data = bpy.data.meshes.new(f"mesh_{slot}")
        thing = None
        try:
            _fill_mesh(data, placed, scene)
            translucent = any(placed.spec.parts[name].opacity < 1 for name in placed.mesh.part_names)
            material = object_material(slot, scene.appearance.mode, translucent=translucent)
            data.materials.append(material)
            thing = bpy.data.objects.new(f"thing_{slot}", data)
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
        self, objects: int, shape_hw: tuple[int, int], frame_id: str
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        if not self._file.is_file():
            raise RenderError(f"{frame_id}: Cycles wrote no picture")
        with OpenEXR.File(str(self._file), separate_channels=True) as exr:
            channels = {k.lower(): np.array(v.pixels, np.float32) for k, v in exr.channels().items()}

        def named(*endings: str) -> NDArray[np.float32]:
            for name, pixels in channels.items():
                if name.endswith(endings):
                    if pixels.shape != shape_hw:
                        raise RenderError(f"{frame_id}: Cycles returned {pixels.shape} pixels for a crop of {shape_hw}")
                    return pixels
            raise RenderError(f"{frame_id}: channel {endings[0]} is missing; found {sorted(channels)}")

        coverage = [np.clip(named(f"{aov_name(k)}.v", f"{aov_name(k)}.x", aov_name(k)), 0, 1) for k in range(objects)]
        return named("combined.r"), np.clip(named("combined.a"), 0, 1), np.stack(coverage)


def crop_of(scene: PlacedScene) -> tuple[int, int, int, int] | None:
    """Return the smallest pixel rectangle x0, y0, x1, y1 that contains all objects in the frame; None if none is."""
    w, h = scene.spec.camera.size_wh
    lows, highs = [], []
    for placed in scene.objects:
        xy, depth = placed.xy, placed.depth_m
        if (depth <= 0.01).any():
            if (depth <= 0.01).all():
                continue
            return (0, 0, w, h)  # reaches behind the camera, so its outline is unbounded
        lows.append(xy.min(axis=0))
        highs.append(xy.max(axis=0))
    if not lows:
        return None
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    x0, y0 = (max(0, math.floor(v) - CROP_MARGIN_PX) for v in low)
    x1, y1 = min(w, math.ceil(high[0]) + CROP_MARGIN_PX), min(h, math.ceil(high[1]) + CROP_MARGIN_PX)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _fill_mesh(data: bpy.types.Mesh, placed: PlacedObject, scene: SceneSpec) -> None:
    spec, mesh, world_m = placed.spec, placed.mesh, placed.world_m
    count = len(mesh.triangles)
    data.vertices.add(len(world_m))
    data.vertices.foreach_set("co", np.ascontiguousarray(world_m, np.float32).ravel())
    data.loops.add(3 * count)
    data.loops.foreach_set("vertex_index", np.ascontiguousarray(mesh.triangles).ravel())
    data.polygons.add(count)
    data.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    data.polygons.foreach_set("use_smooth", np.ascontiguousarray(mesh.smooth))
    states = [spec.parts[name] for name in mesh.part_names]
    temperature_c = np.array([s.temperature_k - ZERO_C_K for s in states])
    glow = np.repeat(np.array([s.glow for s in states])[mesh.part_of_triangle], 3)
    columns = {
        "temperature_c": _corner_values(mesh, temperature_c, mesh.smooth)
        + np.where(glow, 0, _pattern(mesh, scene.appearance.texture_k, scene.render_seed)[mesh.triangles.ravel()])
        + placed.sun_rise_k.astype(np.float32),
        "emissivity": _corner_values(mesh, np.array([s.emissivity for s in states]), mesh.smooth),
        "ior": _corner_values(mesh, np.array([s.ior for s in states])),
        "label": _corner_values(mesh, np.array([float(s.label) for s in states])),
    }
    if scene.appearance.mode == "physical":
        columns["roughness"] = _corner_values(mesh, np.array([s.roughness for s in states]))
        columns["metal"] = _corner_values(mesh, np.array([float(s.metal) for s in states]))
    opacity = np.array([s.opacity for s in states])
    if (opacity < 1).any():
        # Opacity is averaged among translucent parts only: labels count opaque parts in full.
        columns["opacity"] = _corner_values(mesh, opacity, mesh.smooth & (opacity < 1)[mesh.part_of_triangle])
    for name, values in columns.items():
        data.attributes.new(name, "FLOAT", "CORNER").data.foreach_set("value", values)
    data.update()


def _corner_values(mesh: Mesh, of_part: FloatArray, blend: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
    """Return the (3T,) value per face corner, averaged over the triangles `blend` (T,) that share a vertex.

    Averaging blends neighbouring parts of one skin (flank, leg) into each other. Parts that are separate bodies share
    no vertices and stay sharp.
    """
    per_triangle = of_part[mesh.part_of_triangle]
    corners = np.repeat(per_triangle, 3)
    if blend is not None and blend.any():
        smooth = np.repeat(blend, 3)
        at = mesh.triangles.ravel()[smooth]
        size = len(mesh.vertices_m)
        total = np.bincount(at, corners[smooth], size)
        number = np.bincount(at, minlength=size)
        corners[smooth] = (total / np.maximum(number, 1))[at]
    return corners.astype(np.float32)


def _pattern(mesh: Mesh, amplitude_k: float, seed: int) -> NDArray[np.float32]:
    """Return a (V,) temperature pattern in [-amplitude, amplitude] that varies slowly over the body.

    No real surface has a uniform temperature. The pattern is a mean of plane waves of about half the body's length, in
    object coordinates, with phases from the scene's seed.
    """
    phase = np.random.Generator(np.random.PCG64(seed)).uniform(0, 2 * np.pi, len(_WAVES))
    extent = max(float(mesh.size_m.max()), 1e-9)
    waves = np.cos(mesh.vertices_m @ (_WAVES.T * (2 * np.pi / extent)) + phase)
    return np.asarray(amplitude_k * waves.mean(axis=1), np.float32)


_WAVES = np.array([[1.6, 0.7, 0.4], [-0.9, 1.7, 0.6], [0.5, -1.1, 2.0], [2.6, 1.9, -1.3]])
