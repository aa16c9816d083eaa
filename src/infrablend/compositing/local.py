"""Grey levels by physics: around each inserted object, grey = ground grey + gain * (radiance - ground radiance).

The ground's grey is read from the picture around the object, the gain is estimated for the whole background (`gain`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.gain import ANCHORS, Backdrop, GainPrior, draw_gain, find_anchors, ring_level
from infrablend.compositing.mapping import GreyMapping, Place
from infrablend.core.ground_plane import ground_point
from infrablend.core.placed import PlacedObject, PlacedScene
from infrablend.core.scene import ObjectSpec, View, Weather
from infrablend.thermal.radiometry import band_radiance
from infrablend.thermal.sky import relative_humidity, sky_radiance, transmittance

# Share of an object's labelled area that must stand out from the ground.
_SEEN_SHARE = 0.2


@dataclass(frozen=True)
class LocalSettings:
    """Settings of local matching.

    Attributes:
        prior: The gain expected beforehand; scaled by the range of the dataset's levels for 16-bit pictures.
        polarity: Polarity of the background; black-hot pictures are inverted on the way in and out.
        clothing_k: Assumed excess of people's clothes over the air temperature.
    """

    prior: GainPrior = field(default_factory=GainPrior)
    polarity: Literal["white-hot", "black-hot"] = "white-hot"
    clothing_k: float = 6.0


@dataclass(frozen=True)
class Insert:
    """An inserted object as matching sees it.

    Attributes:
        box_xyxy: (4,) box in pixels; may reach outside the frame.
        range_m: Distance from the camera, or None with a virtual camera, whose distances are not real.
        ground_range_m: Distance from the camera to the ground behind the object, or None if the camera sees none there.
        warm: Whether the object as a whole is warmer than the ground.
    """

    box_xyxy: NDArray[np.float64]
    range_m: float | None = None
    ground_range_m: float | None = None
    warm: bool = True


@dataclass(frozen=True, eq=False)
class LocalMatch:
    """The result of matching one frame.

    Attributes:
        mapping: The grey-level mapping.
        facts: Estimates made on the way, as plain JSON values.
        contrasts: Expected contrast of each object against its ground, in the picture's levels; see
            `expected_contrast`.
    """

    mapping: GreyMapping
    facts: dict[str, Any]
    contrasts: tuple[float, ...]


def match_locally(
    scene: PlacedScene, backdrop: Backdrop, settings: LocalSettings, rng: np.random.Generator
) -> LocalMatch:
    """Match the objects of a scene (at least one) to the ground around each of them.

    Args:
        scene: A scene with weather.
        backdrop: The background.
        settings: Prior, polarity and clothing.
        rng: Draws the gain from its posterior.
    """
    weather = scene.spec.weather
    if weather is None:
        raise ValueError(f"{scene.spec.frame_id}: local matching needs the weather")
    inserts = [describe_insert(placed, weather, scene.spec.view) for placed in scene.objects]
    mapping, facts = local_mapping(backdrop, inserts, weather, settings, rng)
    places: Sequence[GreyMapping | Place] = mapping.places or (mapping,)
    contrasts = [
        expected_contrast(placed.spec, placed.part_areas_px, place, ground, weather)
        for placed, place, ground in zip(scene.objects, places, facts["ground_grey"], strict=True)
    ]
    return LocalMatch(mapping, facts, tuple(contrasts))


def describe_insert(placed: PlacedObject, weather: Weather, view: View | None) -> Insert:
    """Describe a placed object for matching; distances are known only where `view` gives the real camera's height."""
    box, warm = placed.box_xyxy, is_warm(placed.spec, placed.part_areas_px, weather)
    if view is None:
        return Insert(box, warm=warm)
    u, v = ((box[:2] + box[2:]) / 2).tolist()
    below = ground_point(placed.camera, u, v, view.ground_z_m)
    ground = None if below is None else float(np.linalg.norm(below - placed.camera.position_m))
    return Insert(box, placed.range_m, ground, warm)


def local_mapping(
    backdrop: Backdrop,
    inserts: Sequence[Insert],
    weather: Weather,
    settings: LocalSettings,
    rng: np.random.Generator,
) -> tuple[GreyMapping, dict[str, Any]]:
    """Return the mapping for the inserts of one frame, and the estimates behind it.

    Each insert is matched to the ground around it. Cameras apply different gains above and below
    the ground's temperature, so the gain of warm inserts comes mainly from warm anchors, that of cold ones from cold.

    Args:
        backdrop: The background.
        inserts: At least one.
        weather: Air and ground temperature.
        settings: Prior, polarity and clothing.
        rng: Draws the gain from its posterior.
    """
    low, high = backdrop.levels
    black_hot = settings.polarity == "black-hot"
    picture = backdrop.pixels.astype(np.float32)
    if black_hot:
        picture = low + high - picture
    free = backdrop.free()
    anchors = find_anchors(picture, free, backdrop, weather.air_k, settings.clothing_k)
    gains, gain_facts = {}, {}
    for warm in (True, False):  # draw both in any case, so that the gain of an insert does not depend on other inserts
        gains[warm], gain_facts[warm] = draw_gain(anchors, weather, backdrop.grey_unit, settings.prior, warm, rng)

    of_ground, of_air = float(band_radiance(weather.ground_k)), float(band_radiance(weather.air_k))
    grounds, places = [], []
    for insert in inserts:
        ground = ring_level(picture, insert.box_xyxy, free)
        # The gain applies to the ground, seen through all the air; a nearer object loses less contrast to the air.
        clearer, hazier = _through_air(insert, weather)
        gain = gains[insert.warm]
        span = gain * clearer
        dark = ground - gain * of_ground + gain * hazier * of_air
        if black_hot:
            dark, span = low + high - dark, -span
        middle = (insert.box_xyxy[:2] + insert.box_xyxy[2:]) / 2
        places.append(Place((float(middle[0]), float(middle[1])), dark, dark + span))
        grounds.append(round(ground, 3))
    first = places[0]
    mapping = GreyMapping(first.dark, first.bright, (low, high), tuple(places) if len(places) > 1 else ())
    used = {i.warm for i in inserts}
    facts = {
        "ground_grey": grounds,
        "warm": [i.warm for i in inserts],
        "gain": {("warm" if w else "cold"): gain_facts[w] for w in (True, False) if w in used},
        "anchors": {kind: sum(a.kind == kind for a in anchors) for kind in ANCHORS},
        "levels": [low, high],
    }
    return mapping, facts


def is_warm(item: ObjectSpec, areas: Mapping[str, float], weather: Weather) -> bool:
    """Return whether an object as a whole looks warmer than the ground.

    Labelled parts are weighted by their visible area (`areas`) and assumed to reflect half sky and half ground.
    """
    zenith, ground = _zenith(weather), float(band_radiance(weather.ground_k))
    total = 0.0
    for name, part in item.parts.items():
        if part.label:
            own = part.emissivity * float(band_radiance(part.temperature_k))
            total += areas.get(name, 0.0) * (own + (1 - part.emissivity) * (zenith + ground) / 2 - ground)
    return bool(total > 0)


def expected_contrast(
    item: ObjectSpec, areas: Mapping[str, float], place: GreyMapping | Place, ground_grey: float, weather: Weather
) -> float:
    """Return the contrast to the ground, in picture levels, that a fifth of an object's labelled area reaches.

    Each part is assumed to reflect the ground or the zenith, whichever gives more contrast. The result is an upper
    estimate: an object that is too faint here is certainly too faint in the picture.

    Args:
        item: The object.
        areas: Visible area of each part, in any unit.
        place: The mapping there.
        ground_grey: Level of the ground there.
        weather: Sky and ground.
    """
    around = (_zenith(weather), float(band_radiance(weather.ground_k)))
    found = []
    for name, part in item.parts.items():
        if part.label and areas.get(name, 0.0) > 0:
            own = part.emissivity * float(band_radiance(part.temperature_k))
            levels = [
                place.dark + (place.bright - place.dark) * (own + (1 - part.emissivity) * mirrored)
                for mirrored in around
            ]
            found.append((max(abs(v - ground_grey) for v in levels), areas[name]))
    total, seen = sum(area for _, area in found), 0.0
    for contrast, area in sorted(found, reverse=True):
        seen += area
        if seen >= _SEEN_SHARE * total:
            return contrast
    return 0.0


def _zenith(weather: Weather) -> float:
    """Return the sky's radiance straight up."""
    return float(sky_radiance(weather.air_k, weather.dew_point_k, 0.0, weather.cloud, weather.cloud_base_k))


def _through_air(insert: Insert, weather: Weather) -> tuple[float, float]:
    """Return the factors of the object's radiance and of the air's radiance that account for the air in between.

    tau(d) is the transmittance of the path to the object, tau(R) that of the path to the ground. Then grey = ground +
    gain / tau(R) * (tau(d) L + (1 - tau(d)) L_air - tau(R) L_ground - (1 - tau(R)) L_air), and the factors are
    tau(d) / tau(R) and (tau(R) - tau(d)) / tau(R). For an object on the ground both paths are equal: 1 and 0.
    """
    if insert.range_m is None or insert.ground_range_m is None or insert.range_m >= insert.ground_range_m:
        return 1.0, 0.0
    humidity = relative_humidity(weather.air_k, weather.dew_point_k)
    near, far = (
        float(transmittance(d, weather.air_k, humidity)) for d in (insert.range_m, min(insert.ground_range_m, 1_000.0))
    )
    return near / far, (far - near) / far
