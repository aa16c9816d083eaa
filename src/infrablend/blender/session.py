"""One Blender process: an empty scene with every setting that touches pixels pinned.

`bpy` has one global scene per process; this module owns it. What Blender does by default to pictures (tone
mapping, dither, denoising, sample clamping, soft pixel filter) would falsify thermal data, so all of it is off.
"""

from __future__ import annotations

import ctypes
import logging
from typing import Any, Literal

import bpy

from infrablend.errors import MissingDependencyError

log = logging.getLogger(__name__)

Device = Literal["auto", "cpu", "cuda", "optix", "hip", "metal", "oneapi"]
# In the order in which `auto` tries them.
GPU_BACKENDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")
# glibc's names (malloc.h); an eighth of this cost 5 % more time and kept 4 MB less.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LARGE_BLOCK_BYTES = 2**20


def reset() -> bpy.types.Scene:
    """Empty the process's scene, drop user preferences, pin all settings that touch pixels."""
    # Factory settings also guarantee that scripts in .blend files stay off (use_scripts_auto_execute).
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    scene = bpy.context.scene
    pin_settings(scene)
    return scene


def return_large_blocks() -> None:
    """Have the C library give every large block back to the system once it is freed; for the whole process.

    By default it starts to keep them in its heap, where small blocks that live on soon lie between them: nothing is
    lost, yet the process grows by some 3 MB per 100 frames (measured). Does nothing where there is no glibc.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    for option in (_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD):
        mallopt(option, _LARGE_BLOCK_BYTES)


def pin_settings(scene: bpy.types.Scene) -> None:
    """Set everything that touches pixel values: linear float out, no tone mapping, no filter beyond the pixel."""
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
    # A box of one pixel is the detector's own footprint: alpha is then the covered share of the pixel, which is
    # what labels are made of. The optics' blur is a later step, in compositing.
    c.pixel_filter_type = "BOX"
    c.filter_width = 1.0
    c.max_bounces = 0
    c.diffuse_bounces = c.glossy_bounces = c.transmission_bounces = c.volume_bounces = 0
    # Behind propeller discs of several drones in a row there is still something to be seen ...
    c.transparent_max_bounces = 64
    # ... and counted: an AOV is written on every surface up to the first one of this alpha.
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


def use_device(scene: bpy.types.Scene, device: Device, threads: int = 0) -> str:
    """Choose where Cycles computes; returns the device used, e.g. `cpu` or `cuda`.

    Args:
        scene: The scene to set.
        device: `auto` takes a GPU if there is one, else the CPU.
        threads: CPU threads per render; 0 leaves it to Blender.

    Raises:
        MissingDependencyError: If a GPU backend is asked for and has no device here.
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
        "Use --device cpu or --device auto, or install the GPU's driver."
    )


def gpu_devices() -> dict[str, list[str]]:
    """Names of the GPUs Cycles finds, by backend (`OPTIX`, `CUDA`, ...); empty lists where there are none."""
    preferences = _cycles_preferences()
    found: dict[str, list[str]] = {}
    for backend in GPU_BACKENDS:
        try:
            devices = preferences.get_devices_for_type(backend)
        except (ValueError, TypeError):  # this build knows no such backend
            continue
        found[backend] = [d.name for d in devices if d.type == backend]
    return found


def _cycles_preferences() -> Any:
    return bpy.context.preferences.addons["cycles"].preferences
