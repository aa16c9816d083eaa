"""Setup of the Blender process: an empty scene in which every setting that affects pixels has a fixed value.

`bpy` has one global scene per process, which this module owns. Blender's default picture processing (tone mapping,
dither, denoising, sample clamping, soft pixel filter) would falsify thermal data and is switched off.
"""

from __future__ import annotations

import ctypes
import logging
from typing import Any

import bpy

from infrablend.core.camera import CameraSpec
from infrablend.core.machine import Device
from infrablend.errors import MissingDependencyError

log = logging.getLogger(__name__)

# `auto` tries them in this order.
GPU_BACKENDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")
# Parameter numbers from glibc's malloc.h. An eighth of this block size took 5 % more time and saved 4 MB.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LARGE_BLOCK_BYTES = 2**20
# Free memory at the end of the heap that stays with the process. With 1 MiB, a frame spent 13 of 74 ms on 10,000 pages
# that it gave back and took again.
_KEPT_BYTES = 2**26


def reset() -> bpy.types.Scene:
    """Empty the scene, discard user preferences and pin all settings that affect pixels."""
    # Factory settings also guarantee that scripts in .blend files stay off (use_scripts_auto_execute).
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    scene = bpy.context.scene
    pin_settings(scene)
    return scene


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
    scene.render.engine = "CYCLES"
    r, c = scene.render, scene.cycles
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
    view, display = scene.view_settings, scene.display_settings
    display.display_device = "sRGB"
    view.view_transform = "Raw"
    view.look = "None"
    view.exposure, view.gamma = 0.0, 1.0
    view.use_curve_mapping = False


def set_lens(data: bpy.types.Camera, camera: CameraSpec) -> None:
    """Set the horizontal field of view of a Blender camera.

    Blender raises a focal length or sensor width below 1 mm to 1 mm. Only their ratio counts, so both are scaled up.
    """
    scale = max(1.0, 1 / min(camera.sensor_width_mm, camera.focal_length_mm))
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = scale * camera.sensor_width_mm
    data.lens = scale * camera.focal_length_mm


def use_device(scene: bpy.types.Scene, device: Device, threads: int = 0) -> str:
    """Set the device that Cycles renders on and return its name, e.g. `cpu` or `cuda`.

    Args:
        scene: Scene to change.
        device: Device to use; `auto` takes a GPU if there is one, else the CPU.
        threads: CPU threads per render; 0 lets Blender decide.

    Raises:
        MissingDependencyError: No device of the requested GPU backend was found.
    """
    if threads:
        scene.render.threads_mode = "FIXED"
        scene.render.threads = threads
    if device == "cpu":
        scene.cycles.device = "CPU"
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
        scene.cycles.device = "CPU"
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
