"""Grey levels by physics: one map from radiance to grey for the whole picture, with a local share.

A camera maps radiance to grey mostly by one curve for the whole picture; part of the result follows the neighbourhood
(local contrast enhancement). With the local share s, an object of radiance L in front of something that the picture
shows at `ring` is shown at

    grey = level + gain * (L - L_reference) + s * (ring - level),

where level and L_reference are those of the picture's ground, or of its sky for objects in front of it. With s = 1 an
object is matched to the ring around it alone; with s = 0 its level follows its temperature and not the place where it
is put. Gain, local share and the offset of the ground are estimated for each picture (`gain`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.behind import Behind, Kind, look_behind
from infrablend.compositing.gain import (
    ANCHORS,
    CLIP_MARGIN,
    Anchor,
    Backdrop,
    GainFacts,
    GainPrior,
    SharePrior,
    draw_gain,
    draw_share,
    find_anchors,
    is_untrusted,
    ring_level,
)
from infrablend.compositing.mapping import GreyMapping, Place
from infrablend.core.boxes import pixel_box
from infrablend.core.camera import CameraSpec
from infrablend.core.ground_plane import ground_point
from infrablend.core.render import PlacedObject, PlacedScene
from infrablend.core.scene import View, Weather
from infrablend.thermal.radiometry import band_radiance, radiance_at
from infrablend.thermal.sky import relative_humidity, sky_radiance, transmittance

# Share of an object's labelled area that must stand out from the ground.
_SEEN_SHARE = 0.1
# Standard deviation of trees and ground near the horizon against the air, kelvin. That of the sky is not part of it:
# the weather is drawn, and the gain follows from the weather that was drawn.
_LAND_K = 4.0

# A box shows the other kind if its pixels are nearer to that one's level by this factor.
_CLEARLY = 0.5

OnDoubt = Literal["use", "prior", "skip"]
Side = Literal["warm", "cold"]
SIDES: tuple[Side, ...] = get_args(Side)


@dataclass(frozen=True)
class LocalSettings:
    """Settings of local matching.

    Attributes:
        prior: The gain expected beforehand; scaled by the range of the dataset's levels for 16-bit pictures.
        polarity: Polarity of the background; black-hot pictures are inverted on the way in and out.
        clothing_k: Assumed excess of people's clothes over the air temperature.
        local_share: Share of the neighbourhood in the level of an object, as expected beforehand.
        on_untrusted: What to do with a gain that is not to be trusted: use it all the same, draw it from the prior
            instead, or insert nothing.
        headroom: How far levels may lie outside those of the dataset before the optics, as a multiple of their range.
    """

    prior: GainPrior = field(default_factory=GainPrior)
    polarity: Literal["white-hot", "black-hot"] = "white-hot"
    clothing_k: float = 6.0
    local_share: SharePrior = field(default_factory=SharePrior)
    on_untrusted: OnDoubt = "use"
    headroom: float = 0.0


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


class MatchFacts(TypedDict):
    """How a picture's levels were matched, as plain JSON values; lists have an item per object."""

    ring_grey: list[float]
    behind: list[Kind]
    behind_grey: Mapping[str, float | None]
    warm: list[bool]
    local_share: Mapping[str, object]
    gain: Mapping[Side, GainFacts]
    anchors: Mapping[str, int]
    levels: list[float]


@dataclass(frozen=True, eq=False)
class LocalMatch:
    """The result of matching one frame.

    Attributes:
        mapping: The grey-level mapping.
        facts: Estimates made on the way, as plain JSON values.
        contrasts: Expected contrast of each object against its ground, in the picture's levels; see
            `expected_contrast`.
        settled: What the mapping was computed from, for other frames of the sequence.
    """

    mapping: GreyMapping
    facts: MatchFacts
    contrasts: tuple[float, ...]
    settled: Settled

    @property
    def untrusted(self) -> bool:
        """Whether there is a reason not to trust a gain that was used; the prior alone is no such reason."""
        return any(is_untrusted(gain["doubts"]) for gain in self.facts["gain"].values())


def match_locally(
    scene: PlacedScene,
    backdrop: Backdrop,
    settings: LocalSettings,
    rng: np.random.Generator,
    settled: Settled | None = None,
) -> LocalMatch:
    """Match the objects of a scene (at least one) to the ground around each of them.

    With `settled`, the map is that of the sequence; only what is around each object is measured in the picture.
    """
    weather = scene.spec.weather
    if weather is None:
        raise ValueError(f"{scene.spec.frame_id}: local matching needs the weather")
    inserts = [describe_insert(placed, weather, scene.spec.view) for placed in scene.objects]
    # The camera's pitch is that of the picture only where the placement is metric.
    camera = None if scene.spec.view is None else scene.spec.camera
    mapping, facts, settled = local_mapping(backdrop, inserts, weather, settings, rng, camera, settled)
    places: Sequence[GreyMapping | Place] = mapping.places or (mapping,)
    contrasts = [
        expected_contrast(placed, place, ring, weather)
        for placed, place, ring in zip(scene.objects, places, facts["ring_grey"], strict=True)
    ]
    return LocalMatch(mapping, facts, tuple(contrasts), settled)


def describe_insert(placed: PlacedObject, weather: Weather, view: View | None) -> Insert:
    """Describe a placed object for matching; distances are known only where `view` gives the real camera's height."""
    box = placed.box_xyxy
    warm = is_warm(placed, weather)
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
    camera: CameraSpec | None = None,
    settled: Settled | None = None,
) -> tuple[GreyMapping, MatchFacts, Settled]:
    """Return the mapping for the inserts of one frame, the estimates behind it, and what other frames may share.

    Cameras apply different gains above and below the ground's temperature, so the gain of warm inserts comes mainly
    from warm anchors, that of cold ones from cold. The contrast between sky and land, if the picture shows both, is an
    anchor as well. The gain of warm inserts also holds in front of the sky, which is colder than everything else.
    Without a camera whose horizon is known, all is ground.
    """
    low, high = backdrop.levels
    black_hot = settings.polarity == "black-hot"
    picture = backdrop.pixels.astype(np.float32)
    if black_hot:
        picture = low + high - picture
    free = backdrop.free()
    behind = look_behind(picture, free, backdrop.grey_unit, camera, weather)
    reach = settings.local_share.reach
    anchors: tuple[Anchor, ...] = ()
    if settled is None:
        on_ground = find_anchors(picture, free, backdrop, weather.air_k, settings.clothing_k, behind.ground_grey, reach)
        anchors = (*on_ground, *_land_anchors(behind, backdrop, weather))
        settled = Settled(_estimate(on_ground, anchors, backdrop.grey_unit, weather, settings, rng), behind)
    curve = settled.curve
    behind = settled.over(behind)

    around = [_kind_and_ring(behind, picture, free, insert.box_xyxy, reach) for insert in inserts]
    places = []
    for insert, (kind, ring) in zip(inserts, around, strict=True):
        dark, span = curve.line(insert, behind, kind, ring, weather)
        if black_hot:
            dark = low + high - dark
            span = -span
        x, y = ((insert.box_xyxy[:2] + insert.box_xyxy[2:]) / 2).tolist()
        places.append(Place((x, y), dark, dark + span))
    beyond = settings.headroom * (high - low)
    mapping = GreyMapping.around(places, (low - beyond, high + beyond))

    def shown(level: float) -> float:
        """Return a level as the picture has it, rounded."""
        return round(low + high - level if black_hot else level, 3)

    found_behind = {"ground": behind.ground_grey, "sky": behind.sky_grey, "skyline": behind.skyline_grey}
    used = {_side(insert, kind) for insert, (kind, _) in zip(inserts, around, strict=True)}
    facts: MatchFacts = {
        "ring_grey": [shown(ring) for _, ring in around],
        "behind": [kind for kind, _ in around],
        "behind_grey": {what: None if level is None else shown(level) for what, level in found_behind.items()},
        "warm": [i.warm for i in inserts],
        "local_share": curve.share_facts,
        "gain": {side: curve.gain_facts[side] for side in SIDES if side in used},
        "anchors": {kind: sum(a.kind == kind for a in anchors) for kind in ANCHORS},
        "levels": [low, high],
    }
    return mapping, facts, settled


@dataclass(frozen=True, eq=False)
class Settled:
    """The map of a sequence, estimated in one of its frames.

    Attributes:
        curve: From radiance to grey.
        behind: Levels of ground, sky and skyline.
    """

    curve: Curve
    behind: Behind

    def through(self, gain: float, offset: float) -> Settled:
        """Return the map in a frame whose levels are `gain` times those of this one, plus `offset`."""
        known = {k: v for k in _LEVELS if (v := getattr(self.behind, k)) is not None}
        behind = replace(self.behind, **{k: gain * v + offset for k, v in known.items()})
        return Settled(self.curve.times(gain), behind)

    def over(self, behind: Behind) -> Behind:
        """Return what is where in a frame, with the levels of the sequence as far as it has shown them."""
        known = {k: v for k in _LEVELS if (v := getattr(self.behind, k)) is not None and getattr(behind, k) is not None}
        return replace(behind, **known)


_LEVELS = ("ground_grey", "sky_grey", "skyline_grey")


@dataclass(frozen=True, eq=False)
class Curve:
    """The map from radiance to grey of one picture, white-hot.

    Attributes:
        share: Local share.
        gain: Gain of warm and of cold inserts, levels per radiance.
        offset: Offset of the ground, levels, for warm and for cold inserts.
        share_facts: How the share was estimated.
        gain_facts: How each gain was estimated.
    """

    share: float
    gain: Mapping[Side, float]
    offset: Mapping[Side, float]
    share_facts: Mapping[str, object]
    gain_facts: Mapping[Side, GainFacts]

    def times(self, gain: float) -> Curve:
        """Return the map of a frame whose levels are this many times as far apart."""
        gains: dict[Side, float] = {side: gain * g for side, g in self.gain.items()}
        offsets: dict[Side, float] = {side: gain * o for side, o in self.offset.items()}
        return replace(self, gain=gains, offset=offsets)

    def line(self, insert: Insert, behind: Behind, kind: Kind, ring: float, weather: Weather) -> tuple[float, float]:
        """Return the level of radiance 0 of an insert, and the levels per radiance; both include the air before it."""
        side = _side(insert, kind)
        level, reference = _reference(behind, kind, weather, ring)
        clearer, hazier = _through_air(insert, weather, kind)
        level += self.share * (ring - level)
        if kind == "ground":
            level += self.offset[side]
        gain = self.gain[side]
        return level - gain * reference + gain * hazier * radiance_at(weather.air_k), gain * clearer


def _side(insert: Insert, kind: Kind) -> Side:
    """Return whose gain an insert has; the sky is colder than everything in front of it."""
    return "warm" if insert.warm or kind == "sky" else "cold"


def _estimate(
    on_ground: Sequence[Anchor],
    anchors: Sequence[Anchor],
    unit: float,
    weather: Weather,
    settings: LocalSettings,
    rng: np.random.Generator,
) -> Curve:
    """Draw share, gains and offsets of a picture from their posteriors."""
    of_ground = radiance_at(weather.ground_k)
    prior = settings.prior
    share, share_facts = draw_share(on_ground, weather.air_k, of_ground, unit, settings.local_share, prior, rng)
    gains: dict[Side, float] = {}
    offsets: dict[Side, float] = {}
    gain_facts: dict[Side, GainFacts] = {}
    for side in SIDES:  # always draw both, so that no insert's gain depends on the others
        args = (weather.air_k, of_ground, unit, prior, side == "warm")
        gains[side], offsets[side], gain_facts[side] = draw_gain(anchors, *args, rng, share)
        if settings.on_untrusted == "prior" and is_untrusted(gain_facts[side]["doubts"]):
            doubts = gain_facts[side]["doubts"]
            gains[side], offsets[side], gain_facts[side] = draw_gain((), *args, rng, share)
            gain_facts[side]["doubts"] = doubts
            gain_facts[side]["from_prior"] = True
    if any(facts.get("from_prior") for facts in gain_facts.values()):
        # The share came from the same anchors.
        share, share_facts = draw_share((), weather.air_k, of_ground, unit, settings.local_share, prior, rng)
    return Curve(share, gains, offsets, share_facts, gain_facts)


def _land_anchors(behind: Behind, backdrop: Backdrop, weather: Weather) -> tuple[Anchor, ...]:
    """Return the anchor of land against the sky: near the horizon, ground and trees look about as warm as the air.

    The step at the skyline is used and not the levels of large areas, from which local enhancement takes the contrast.
    """
    if behind.sky_grey is None or behind.step_grey <= 0:
        return ()
    rise = behind.step_grey
    if behind.ground_grey is not None:
        rise = max(rise, behind.ground_grey - behind.sky_grey)
    ceiling = backdrop.levels[1] - CLIP_MARGIN * backdrop.grey_unit
    clipped = behind.sky_grey + rise >= ceiling
    return (Anchor("land_clipped" if clipped else "land", rise, weather.air_k, _LAND_K, 0.0, behind.sky_radiance),)


def _kind_and_ring(
    behind: Behind,
    picture: NDArray[np.float32],
    free: NDArray[np.bool_],
    box_xyxy: NDArray[np.float64],
    reach: float,
) -> tuple[Kind, float]:
    """Return what is behind a box, and the level of its surroundings of that kind.

    The pixels in the box decide between sky and what stands above the horizon if they clearly look like the other one:
    clouds that touch a roof are found as part of it, and trees without a steep edge as part of the sky.
    """
    kind = behind.kind_at(box_xyxy)
    ring = ring_level(picture, box_xyxy, _like(behind, free, kind), reach)
    if kind == "ground" or not (behind.land & free).any():
        return kind, ring
    other: Kind = "skyline" if kind == "sky" else "sky"
    of_other = ring_level(picture, box_xyxy, _like(behind, free, other), reach)
    x0, y0, x1, y1 = pixel_box(box_xyxy, picture.shape)
    inside = float(np.median(picture[y0:y1, x0:x1]))
    looks_like_other = abs(inside - of_other) < _CLEARLY * abs(inside - ring)
    if kind == "skyline" and inside < of_other + behind.step_grey / 2:
        # What passes for land around the box may be sky as well.
        looks_like_other |= abs(inside - of_other) <= abs(inside - ring)
    return (other, inside) if looks_like_other else (kind, ring)


def _like(behind: Behind, free: NDArray[np.bool_], kind: Kind) -> NDArray[np.bool_]:
    """Return the free pixels of the same kind as what is behind an insert."""
    if behind.sky_grey is None:
        return free
    return np.asarray(free & (behind.sky if kind == "sky" else behind.land))


def _reference(behind: Behind, kind: Kind, weather: Weather, ring: float) -> tuple[float, float]:
    """Return level and radiance of what an insert is compared with: the picture's ground, sky or skyline.

    The sky counts as one surface: its model is too warm within a few degrees of the horizon, where real drones still
    have two thirds of their contrast at 12 degrees (Halmstad, train).
    """
    if kind == "sky":
        assert behind.sky_grey is not None
        return behind.sky_grey, behind.sky_radiance
    if kind == "skyline" and behind.skyline_grey is not None:
        return behind.skyline_grey, radiance_at(weather.air_k)
    return ring if behind.ground_grey is None else behind.ground_grey, radiance_at(weather.ground_k)


def is_warm(placed: PlacedObject, weather: Weather) -> bool:
    """Return whether an object as a whole looks warmer than the ground.

    Labelled parts are weighted by their visible area and assumed to reflect half sky and half ground.
    """
    zenith = _zenith(weather)
    ground = radiance_at(weather.ground_k)
    parts = {name: part for name, part in placed.spec.parts.items() if part.label}
    own = band_radiance([part.temperature_k + placed.part_sun_rise_k[name] for name, part in parts.items()]).tolist()
    total = 0.0
    for (name, part), light in zip(parts.items(), own, strict=True):
        mirrored = (1 - part.emissivity) * (zenith + ground) / 2
        total += placed.part_areas_px[name] * (part.emissivity * light + mirrored - ground)
    return bool(total > 0)


def expected_contrast(placed: PlacedObject, place: GreyMapping | Place, ring_grey: float, weather: Weather) -> float:
    """Return the contrast to the ground, in picture levels, that a tenth of an object's labelled area reaches.

    Each part is assumed to reflect the ground or the zenith, and to have its coldest or its warmest temperature,
    whichever gives more contrast. The result is an upper estimate: an object that is too faint here is certainly too
    faint in the picture.
    """
    around = (_zenith(weather), radiance_at(weather.ground_k))
    areas = placed.part_areas_px
    rises = placed.part_sun_range_k
    parts = {name: part for name, part in placed.spec.parts.items() if part.label and areas[name] > 0}
    own = band_radiance([[part.temperature_k + rise for rise in rises[name]] for name, part in parts.items()]).tolist()
    found: list[tuple[float, float]] = []
    for (name, part), lights in zip(parts.items(), own, strict=True):
        levels = [
            place.dark + (place.bright - place.dark) * (part.emissivity * light + (1 - part.emissivity) * mirrored)
            for mirrored in around
            for light in lights
        ]
        found.append((max(abs(v - ring_grey) for v in levels), areas[name]))
    total = sum(area for _, area in found)
    seen = 0.0
    for contrast, area in sorted(found, reverse=True):
        seen += area
        if seen >= _SEEN_SHARE * total:
            return contrast
    return 0.0


@lru_cache(maxsize=1)
def _zenith(weather: Weather) -> float:
    """Return the sky's radiance straight up."""
    return float(sky_radiance(weather.air_k, weather.dew_point_k, 0.0, weather.cloud, weather.cloud_base_k))


def _through_air(insert: Insert, weather: Weather, kind: Kind) -> tuple[float, float]:
    """Return the factors on radiance and air's path radiance of an object, relative to its background's contrast.

    With tau(d) of the object's path and tau(R) of the ground's, grey is ground + gain / tau(R) * (tau(d) L +
    (1 - tau(d)) L_air - tau(R) L_ground - (1 - tau(R)) L_air). For an object on the ground both paths are equal. The
    sky's radiance already includes that of all the air in front of it.
    """
    if insert.range_m is None:
        return 1.0, 0.0
    humidity = relative_humidity(weather.air_k, weather.dew_point_k)
    if kind == "sky":
        near = float(transmittance(min(insert.range_m, 1_000.0), weather.air_k, humidity))
        return near, 1 - near
    if insert.ground_range_m is None or insert.range_m >= insert.ground_range_m:
        return 1.0, 0.0
    near, far = (
        float(transmittance(d, weather.air_k, humidity)) for d in (insert.range_m, min(insert.ground_range_m, 1_000.0))
    )
    return near / far, (far - near) / far
