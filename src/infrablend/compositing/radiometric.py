"""Inserts in 16-bit pictures with a temperature scale: radiance in, through the air, and back to temperatures.

Such a picture shows apparent temperatures at the sensor. An object of radiance L at a distance d arrives there as

    tau(d) L + (1 - tau(d)) L_air,

and is laid over the radiance of the background. There is no gain, and nothing is limited to what the picture held
before. The ground's temperature is read from the picture: that of the ring around the objects, without the air in front
of it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.gain import ring_level
from infrablend.compositing.local import Insert, describe_insert
from infrablend.compositing.mapping import GreyImage, GreyMapping, Place
from infrablend.compositing.overlay import Layer
from infrablend.compositing.sensor import Sensor, grain
from infrablend.core.boxes import boxes_mask
from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import Instance
from infrablend.core.ground_plane import ground_point
from infrablend.core.render import PlacedScene
from infrablend.core.scene import Weather
from infrablend.core.temperature import TemperatureScale
from infrablend.thermal.radiometry import band_radiance
from infrablend.thermal.sky import relative_humidity, transmittance

# Range of temperatures that radiance is converted in, and step of the table: interpolation is good to 1e-4 K.
_TABLE_K = (60.0, 2_500.0)
_STEP_K = 0.1
# The air's transmittance is known up to this distance.
_FARTHEST_M = 1_000.0
# Share of the picture's rows that must show ground for its median to be used.
_LEAST_GROUND = 0.05


@functools.cache
def _table() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return temperatures and their radiances, both ascending; hot bodies need more terms of the series."""
    kelvin = np.arange(_TABLE_K[0], _TABLE_K[1] + _STEP_K / 2, _STEP_K)
    return kelvin, band_radiance(kelvin, terms=40)


def radiance_of(kelvin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the radiance of blackbodies at these temperatures; those outside the table count as its ends."""
    return np.asarray(np.interp(kelvin, *_table()))


def temperature_of(radiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the apparent temperatures of these radiances, kelvin: the inverse of `radiance_of`."""
    kelvin, table = _table()
    return np.asarray(np.interp(radiance, table, kelvin))


def match_radiometric(
    scene: PlacedScene, counts: GreyImage, labels: Sequence[Instance], scale: TemperatureScale, air_source: str
) -> tuple[PlacedScene, GreyMapping, dict[str, object]]:
    """Give a scene the ground of its picture, and its objects the air in front of them.

    The scene has weather, a real camera and at least one object; labels are not ground.

    Returns:
        The scene whose weather has the picture's ground; the mapping to radiance at the sensor; and the facts.
    """
    spec = scene.spec
    weather = spec.weather
    view = spec.view
    if weather is None or view is None:
        raise ValueError(f"{spec.frame_id}: radiometric matching needs the weather and the real camera")
    inserts = [describe_insert(placed, weather, view) for placed in scene.objects]
    picture = np.asarray(scale.kelvin(counts), np.float32)
    free = ~boxes_mask((i.box_xyxy for i in labels), counts.shape)
    rings = [ring_level(picture, i.box_xyxy, free) for i in inserts]
    ground_k, source = _ground(inserts, rings, picture, free, spec.camera, view.ground_z_m, weather)
    weather = replace(weather, ground_k=ground_k)
    places = []
    through = []
    of_air = float(band_radiance(weather.air_k))
    for insert in inserts:
        assert insert.range_m is not None  # known with the real camera
        tau = _through(insert.range_m, weather)
        x, y = ((insert.box_xyxy[:2] + insert.box_xyxy[2:]) / 2).tolist()
        dark = (1 - tau) * of_air
        places.append(Place((x, y), dark, dark + tau))
        through.append(tau)
    mapping = GreyMapping.around(places, scale=scale)
    facts = {
        "mode": "radiometric",
        "scale": scale.to_json(),
        "air_k": round(weather.air_k, 3),
        "air": air_source,
        "ground_k": round(ground_k, 3),
        "ground": source,
        "ring_k": [round(r, 3) for r in rings],
        "transmittance": [round(t, 5) for t in through],
    }
    return replace(scene, spec=replace(spec, weather=weather)), mapping, facts


def _through(distance_m: float, weather: Weather) -> float:
    humidity = relative_humidity(weather.air_k, weather.dew_point_k)
    return float(transmittance(min(distance_m, _FARTHEST_M), weather.air_k, humidity))


def _ground(
    inserts: Sequence[Insert],
    rings: Sequence[float],
    picture: NDArray[np.float32],
    free: NDArray[np.bool_],
    camera: CameraSpec,
    ground_z_m: float,
    weather: Weather,
) -> tuple[float, str]:
    """Return the apparent temperature of the ground at its place, kelvin, and where it was read.

    It is the mean of the rings that show ground; else the median of the picture's rows below the horizon; else the air.
    """
    near = [(r, i.ground_range_m) for r, i in zip(rings, inserts, strict=True) if i.ground_range_m is not None]
    if near:
        seen = [_without_air(ring, distance, weather) for ring, distance in near]
        return float(temperature_of(np.asarray(np.mean(seen)))), "ring"
    rows = [
        (v, float(np.linalg.norm(point - camera.position_m)))
        for v in range(picture.shape[0])
        if (point := ground_point(camera, picture.shape[1] / 2, v + 0.5, ground_z_m)) is not None
    ]
    if len(rows) >= _LEAST_GROUND * picture.shape[0]:
        chosen = [v for v, _ in rows]
        of_rows = picture[chosen][free[chosen]]
        level = float(np.median(of_rows if of_rows.size else picture[chosen]))
        found = _without_air(level, rows[len(rows) // 2][1], weather)
        return float(temperature_of(np.asarray(found))), "picture"
    return weather.air_k, "air"


def _without_air(kelvin: float, distance_m: float, weather: Weather) -> float:
    """Return the radiance of ground that appears at this temperature through the air in front of it."""
    tau = _through(distance_m, weather)
    return (float(band_radiance(kelvin)) - (1 - tau) * float(band_radiance(weather.air_k))) / tau


def compose_radiance(
    background: GreyImage, layer: Layer, scale: TemperatureScale, sensor: Sensor | None = None
) -> GreyImage:
    """Lay a layer of radiance over a picture of temperatures; untouched pixels keep their counts to the bit.

    The layer is radiance at the sensor after the optics' blur. Only the noise of the sensor's chain is applied, in
    counts.
    """
    x0, y0 = layer.offset_xy
    rows, columns = layer.alpha.shape
    picture = background.copy()
    part = picture[y0 : y0 + rows, x0 : x0 + columns]
    touched = (layer.alpha > 0) | (layer.grey != 0)
    if not touched.any():
        return picture
    alpha = layer.alpha.astype(np.float64)
    mixed = layer.grey.astype(np.float64) + (1 - alpha) * radiance_of(scale.kelvin(part))
    kelvin = temperature_of(mixed)
    if sensor is not None and sensor.noise_grey > 0:
        # The background keeps (1 - alpha) of its own noise; this weight restores the full variance.
        weight = np.sqrt(alpha * (2 - alpha))
        noise = grain((rows, columns), sensor.noise_grey, sensor.noise_grain_px, sensor.noise_seed)
        kelvin = kelvin + weight * noise * abs(scale.slope_k)
    part[...] = np.where(touched, scale.counts(kelvin), part)
    return picture
