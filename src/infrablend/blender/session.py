"""Setup of the Blender process: an empty scene in which every setting that affects pixels has a fixed value.

`bpy` has one global scene per process, which this module owns. Blender's default picture processing (tone mapping,
dither, denoising, sample clamping, soft pixel filter) would falsify thermal data and is switched off.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

from infrablend.core.wire import CameraMessage
from infrablend.errors import MissingDependencyError, RenderError

# `auto` tries them in this order.
GPU_BACKENDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")
# Parameter numbers from glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
# An eighth of this block size took 5 % more time and saved 4 MB.
_LARGE_BLOCK_BYTES = 2**20
# Free memory at the end of the heap that stays with the process. With 1 MiB, a frame spent 13 of 74 ms on 10,000 pages
# that it gave back and took again.
_KEPT_BYTES = 2**26


class Stage:
    """The scene of the process, emptied, with a camera, and the folder of the float files that it is rendered to.

    Attributes:
        scene: The scene, with all settings pinned that affect pixels.
        device: Kind of device that it is rendered on: `cpu`, `cuda`, ...
    """

    def __init__(self, device: str, folder: str) -> None:
        """Empty the scene and discard user preferences; render to a folder on a device, see `use_device`."""
        return_large_blocks()
        # Factory settings also guarantee that scripts in .blend files stay off (use_scripts_auto_execute).
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.preferences.filepaths.use_scripts_auto_execute = False
        s = self.scene = bpy.context.scene
        pin_settings(s)
        self.device = use_device(s, device)
        self._folder = Path(folder)
        self._camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        s.collection.objects.link(self._camera)
        s.camera = self._camera
        settings = s.render.image_settings
        settings.file_format = "OPEN_EXR_MULTILAYER"
        settings.color_mode = "RGBA"
        settings.color_depth = "32"
        settings.exr_codec = "NONE"
        s.render.use_file_extension = False

    def set_camera(self, camera: CameraMessage, oversample: int = 1) -> None:
        """Set the camera and the size of renders, in samples per pixel and direction.

        Blender raises a focal length or sensor width below 1 mm to 1 mm. Only their ratio counts, so both are scaled
        up.

        Args:
            camera: Its place, direction, lens, size in pixels, and near and far limit.
            oversample: Samples per pixel and direction.
        """
        data = self._camera.data
        scale = max(1.0, 1 / min(camera["sensor_width_mm"], camera["focal_length_mm"]))
        data.sensor_fit = "HORIZONTAL"
        data.sensor_width = scale * camera["sensor_width_mm"]
        data.lens = scale * camera["focal_length_mm"]
        data.clip_start, data.clip_end = camera["clip_m"]
        # Blender's camera looks along -Z with +Y up; ours along +z with +y down.
        matrix = np.eye(4)
        matrix[:3, :3] = camera["world_to_camera"].T @ np.diag([1.0, -1.0, -1.0])
        matrix[:3, 3] = camera["position_m"]
        self._camera.matrix_world = mathutils.Matrix(matrix.tolist())
        r = self.scene.render
        w, h = camera["size_wh"]
        r.resolution_x, r.resolution_y = w * oversample, h * oversample

    def render(self, what: str, number: int = 0) -> None:
        """Render the scene to the file `NUMBER.exr`; `what` is shown in errors.

        Raises:
            RenderError: Cycles failed.
        """
        file = self._folder / f"{number}.exr"
        file.unlink(missing_ok=True)
        self.scene.render.filepath = str(file)
        try:
            bpy.ops.render.render(write_still=True)
        except RuntimeError as error:
            raise RenderError(f"{what}: Cycles failed: {error}") from error
        if not file.is_file():
            raise RenderError(f"{what}: Cycles wrote no picture; is the disk full?")


def fill_mesh(data: bpy.types.Mesh, vertices_m: Any, triangles: Any) -> None:
    """Give an empty mesh its (V, 3) vertices and (T, 3) triangles."""
    count = len(triangles)
    data.vertices.add(len(vertices_m))
    data.vertices.foreach_set("co", np.ascontiguousarray(vertices_m, np.float32).ravel())
    data.loops.add(3 * count)
    data.loops.foreach_set("vertex_index", np.ascontiguousarray(triangles).ravel())
    data.polygons.add(count)
    data.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))


def return_large_blocks() -> None:
    """Make the C library return every large block to the system when it is freed; applies to the whole process.

    By default glibc keeps them in its heap, which fragments: the process grew by some 3 MB per 100 frames. Does nothing
    without glibc.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    mallopt(_M_MMAP_THRESHOLD, _LARGE_BLOCK_BYTES)
    mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def pin_settings(scene: bpy.types.Scene) -> None:
    """Pin all settings that affect pixels: linear float output, no tone mapping, no filter wider than a pixel."""
    r = scene.render
    c = scene.cycles
    r.engine = "CYCLES"
    r.film_transparent = True
    r.dither_intensity = 0.0
    r.use_compositing = False
    r.use_sequencer = False
    r.use_stamp = False
    r.use_motion_blur = False
    r.use_persistent_data = False
    r.resolution_percentage = 100
    r.pixel_aspect_x = r.pixel_aspect_y = 1.0
    c.use_denoising = False
    c.use_adaptive_sampling = False
    c.sample_clamp_direct = c.sample_clamp_indirect = 0.0
    # A box of one pixel is the footprint of a detector element, so alpha is the covered share of the pixel, which
    # labels are derived from. Compositing adds the blur of the optics.
    c.pixel_filter_type = "BOX"
    c.filter_width = 1.0
    c.max_bounces = 0
    c.diffuse_bounces = c.glossy_bounces = c.transmission_bounces = c.volume_bounces = 0
    # Rays must pass the translucent propeller discs of several drones in a row.
    c.transparent_max_bounces = 64
    # An AOV is written on every surface up to the first one with this alpha.
    scene.view_layers[0].pass_alpha_threshold = 1.0
    c.caustics_reflective = c.caustics_refractive = False
    c.use_auto_tile = False
    c.texture_limit_render = "OFF"
    c.use_light_tree = False
    view = scene.view_settings
    display = scene.display_settings
    display.display_device = "sRGB"
    view.view_transform = "Raw"
    view.look = "None"
    view.exposure = 0.0
    view.gamma = 1.0
    view.use_curve_mapping = False


def use_device(scene: bpy.types.Scene, device: str) -> str:
    """Set the device that Cycles renders on, and return its kind; `auto` takes a GPU if there is one, else the CPU.

    Raises:
        MissingDependencyError: No device of the requested GPU backend was found.
    """
    # Workers run in parallel, so one thread each gives the best throughput.
    scene.render.threads_mode = "FIXED"
    scene.render.threads = 1
    scene.cycles.device = "CPU"
    if device == "cpu":
        return "cpu"
    found = gpu_devices()
    wanted = GPU_BACKENDS if device == "auto" else (device.upper(),)
    for backend in wanted:
        if found.get(backend):
            preferences = _cycles_preferences()
            preferences.compute_device_type = backend
            for d in preferences.devices:
                d.use = d.type == backend
            scene.cycles.device = "GPU"
            return backend.lower()
    if device == "auto":
        return "cpu"
    names = sorted(k.lower() for k, v in found.items() if v)
    raise MissingDependencyError(
        f"--device {device}: Blender finds no such device here; found {', '.join(names) or 'no GPU at all'}. "
        "Use --device cpu or --device auto, or install the driver of the GPU."
    )


def gpu_devices() -> dict[str, list[str]]:
    """Return the names of the GPUs that Cycles finds, by backend (`OPTIX`, `CUDA`, ...)."""
    preferences = _cycles_preferences()
    found: dict[str, list[str]] = {}
    for backend in GPU_BACKENDS:
        try:
            devices = preferences.get_devices_for_type(backend)
        except (ValueError, TypeError):  # not supported by this build
            continue
        found[backend] = [d.name for d in devices if d.type == backend]
    return found


def _cycles_preferences() -> Any:
    return bpy.context.preferences.addons["cycles"].preferences
