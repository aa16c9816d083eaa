"""The Blender renderer: turns a placed scene into a crop of linear radiance, alpha and coverage.

Scenes without a given number of samples, in which nothing mirrors other surfaces clearly, need no path tracing:
`rendering.lattice` draws them here. Blender starts with the first other one.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import CameraSpec
from infrablend.core.machine import Device
from infrablend.core.render import PlacedObject, PlacedScene, RenderResult, empty_result
from infrablend.core.scene import SceneSpec, Weather
from infrablend.core.wire import CameraMessage, ObjectMessage, SceneMessage
from infrablend.errors import MissingDependencyError, RenderError, WorkerDiedError
from infrablend.rendering.engine.process import BlenderProcess
from infrablend.rendering.engine.programs import find_blender
from infrablend.rendering.lattice import crop_of, crops_of, mirrors_surfaces, needs_no_tracing, render_on_lattice
from infrablend.rendering.surface_values import ground_radiance, is_two_sided, surface_values
from infrablend.thermal.radiometry import UNIT_W_M2_SR, ZERO_C_K, band_radiance
from infrablend.thermal.sky import window_transmittance

log = logging.getLogger(__name__)

# A part mirrors another part, which mirrors the sky. A third bounce would add less than 1 % of the mirrored 5 %.
PHYSICAL_BOUNCES = 2
# Bare metal mirrors up to 95 %: in its hollows, light that ended after two bounces would leave them black.
METAL_BOUNCES = 16
# Times that Blender may die on a frame before the frame fails.
ATTEMPTS = 3
_CLIP_M = (0.01, 10_000.0)


@dataclass(frozen=True)
class Sampling:
    """Sampling settings of Cycles.

    Attributes:
        samples: Samples per pixel; the maximum if sampling is adaptive.
        adaptive_threshold: Noise level at which sampling of a pixel stops; 0 switches adaptive sampling off.
        adaptive_min_samples: Samples before the first noise check; Cycles checks at every 16th sample only.
        pattern: Sample sequence as Cycles names it; AUTOMATIC is Blender's own choice.
    """

    samples: int
    adaptive_threshold: float = 0.0
    adaptive_min_samples: int = 0
    pattern: str = "AUTOMATIC"


# `quality: matched` for what `rendering.lattice` does not draw. The inside of a body is smooth and needs 16 samples,
# its outline needs more: docs/explanation/quality.md lists the alternatives.
MATCHED = Sampling(64, 0.006, 8, "TABULATED_SOBOL")


def sampling_for(samples: int) -> Sampling:
    """Return the sampling for a fixed number of samples; 0 selects `MATCHED`."""
    return Sampling(samples) if samples else MATCHED


class BlenderRenderer:
    """Renders with Cycles in Blender's process, cropped to the objects."""

    def __init__(self, device: Device = "cpu", blender: str | None = None, *, whole_frame: bool = False) -> None:
        """Keep the settings; nothing is started.

        Args:
            device: Device of Cycles; `auto` takes a GPU if there is one.
            blender: Which Blender, see `rendering.engine.programs.find_blender`.
            whole_frame: Render every pixel of the frame instead of a crop, and nothing without Cycles; for
                measurements.
        """
        self._device = device
        self._blender = blender
        self._whole_frame = whole_frame
        self._process: BlenderProcess | None = None
        self._opened = False

    def start(self) -> None:
        """Start Blender without waiting for it.

        Raises:
            MissingDependencyError: There is none.
        """
        if self._process is None:
            self._process = BlenderProcess(find_blender(self._blender))
            self._opened = False

    def render(self, scene: PlacedScene) -> RenderResult:
        """Render a scene, cropped to what its objects cover; a scene without objects gives an empty crop.

        Raises:
            MissingDependencyError: The scene needs Blender or a device, and there is none.
            RenderError: Cycles failed, or Blender died; the next call starts it again.
        """
        spec = scene.spec
        objects = scene.objects
        w, h = spec.camera.size_wh
        if not spec.samples and not self._whole_frame and needs_no_tracing(scene):
            return render_on_lattice(scene)
        started = time.perf_counter()
        crop = (0, 0, w, h) if self._whole_frame else crop_of(scene)
        if crop is None:
            return empty_result((w, h), len(objects))
        parts = [(crop, [*range(len(objects))])] if self._whole_frame else crops_of(scene)
        bounces = METAL_BOUNCES if mirrors_surfaces(scene) else PHYSICAL_BOUNCES if spec.weather is not None else 0
        slots = {k: slot for _, group in parts for slot, k in enumerate(group)}
        job: SceneMessage = {
            "what": spec.frame_id,
            "camera": camera_message(spec.camera, _CLIP_M),
            "crops": [part for part, _ in parts],
            "cycles": self._cycles(spec, bounces),
            "sky": None if spec.weather is None else _sky(spec.weather),
            "objects": [_object(placed, spec, slots.get(k, 0)) for k, placed in enumerate(objects)],
        }
        made = time.perf_counter()
        seconds, pictures = self._rendered(job)
        arrived = time.perf_counter()
        x0, y0, x1, y1 = crop
        layers = np.zeros((2 + len(objects), y1 - y0, x1 - x0), np.float32)
        for (part, group), channels in zip(parts, pictures, strict=True):
            left, top, right, bottom = part
            found = _layers(channels, len(group), (bottom - top, right - left), spec.frame_id)
            layers[[0, 1, *(2 + k for k in group)], top - y0 : bottom - y0, left - x0 : right - x0] = found
        if spec.weather is not None:
            layers[0] *= np.float32(UNIT_W_M2_SR)
        seconds["build"] += made - started
        seconds["read"] = time.perf_counter() - arrived
        return RenderResult((x0, y0), (w, h), layers[0], layers[1], layers[2:], ground_radiance(scene), seconds)

    def close(self) -> None:
        """End Blender's process."""
        if self._process is not None:
            self._process.close()
            self._process = None

    def _cycles(self, spec: SceneSpec, bounces: int) -> dict[str, object]:
        """Return the settings of Cycles that depend on the scene, by their names in Blender."""
        how = sampling_for(spec.samples)
        settings: dict[str, object] = {
            "seed": spec.render_seed,
            "samples": how.samples,
            "sampling_pattern": how.pattern,
            "use_adaptive_sampling": how.adaptive_threshold > 0,
        }
        if how.adaptive_threshold > 0:
            settings["adaptive_threshold"] = how.adaptive_threshold
            settings["adaptive_min_samples"] = how.adaptive_min_samples
        return settings | dict.fromkeys(("max_bounces", "diffuse_bounces", "glossy_bounces"), bounces)

    def _rendered(self, job: SceneMessage) -> tuple[dict[str, float], list[dict[str, NDArray[np.float32]]]]:
        """Have a scene rendered; return the seconds per step, and the channels of the picture of each crop."""
        for attempt in range(1, ATTEMPTS + 1):
            self.start()
            assert self._process is not None
            try:
                if not self._opened:
                    self._process.open("objects", self._device)
                    self._opened = True
                seconds: dict[str, float] = self._process.ask("render", job)
                return seconds, [self._process.channels(number) for number in range(len(job["crops"]))]
            except MissingDependencyError:
                self.close()  # it has ended, or lacks the device; the next scene gets the same words
                raise
            except WorkerDiedError as error:
                self.close()
                if attempt == ATTEMPTS:
                    raise WorkerDiedError(f"{job['what']}, attempt {attempt} of {ATTEMPTS}: {error.message}") from None
                log.warning("%s: %s; trying again", job["what"], error.message.partition("\n")[0])
        raise AssertionError("unreachable")


def camera_message(camera: CameraSpec, clip_m: tuple[float, float]) -> CameraMessage:
    """Return the camera as `blender.session.Stage.set_camera` takes it, with the near and far limit."""
    return {
        "position_m": np.asarray(camera.position_m, np.float64),
        "world_to_camera": camera.world_to_camera,
        "sensor_width_mm": camera.sensor_width_mm,
        "focal_length_mm": camera.focal_length_mm,
        "size_wh": camera.size_wh,
        "clip_m": clip_m,
    }


def channel(channels: dict[str, NDArray[np.float32]], what: str, *endings: str) -> NDArray[np.float32]:
    """Return the first channel whose name has one of these endings; `what` is shown in errors.

    Raises:
        RenderError: There is none.
    """
    for name, pixels in channels.items():
        if name.endswith(endings):
            return pixels
    raise RenderError(f"{what}: channel {endings[0]} is missing; found {sorted(channels)}")


def _layers(
    channels: dict[str, NDArray[np.float32]], objects: int, shape_hw: tuple[int, int], frame_id: str
) -> NDArray[np.float32]:
    """Return radiance, alpha, and the coverage of each object, (2 + n, h, w), from the channels of a picture."""

    def named(*endings: str) -> NDArray[np.float32]:
        pixels = channel(channels, frame_id, *endings)
        if pixels.shape != shape_hw:
            raise RenderError(f"{frame_id}: Cycles returned {pixels.shape} pixels for a crop of {shape_hw}")
        return pixels

    passes = [f"coverage_{k}" for k in range(objects)]  # `blender.materials.aov_name`
    coverage = [named(f"{name}.v", f"{name}.x", name) for name in passes]
    return np.stack([named("combined.r"), *(np.clip(layer, 0, 1) for layer in (named("combined.a"), *coverage))])


def _sky(weather: Weather) -> dict[str, float]:
    """Return the values of the sky's nodes, `blender.physical.SKY`; radiances in units of `UNIT_W_M2_SR`."""
    air, cloud, ground = (
        float(band_radiance(k)) / UNIT_W_M2_SR for k in (weather.air_k, weather.cloud_base_k, weather.ground_k)
    )
    through = window_transmittance(weather.air_k, weather.dew_point_k)
    return {"clear_at_zenith": through, "air": air, "cloud": cloud, "cover": weather.cloud, "ground": ground}


def _object(placed: PlacedObject, scene: SceneSpec, slot: int) -> ObjectMessage:
    look = scene.appearance
    mesh = placed.mesh
    properties = {
        "cold_c": look.cold_k - ZERO_C_K,
        "hot_c": look.hot_k - ZERO_C_K,
        "surroundings_c": look.surroundings_k - ZERO_C_K,
    }
    return {
        "slot": slot,
        "vertices_m": np.asarray(placed.world_m, np.float32),
        "triangles": mesh.triangles,
        "smooth": mesh.smooth,
        "values": surface_values(placed, scene),
        "properties": properties | ({} if scene.weather is None else _sky(scene.weather)),
        "translucent": any(placed.spec.parts[name].opacity < 1 for name in mesh.part_names),
        "two_sided": is_two_sided(mesh),
    }
