"""Looks: from the temperatures of a scene to grey levels over its background.

`make_look` makes the look of a recipe, once: `artistic` and `physical` by `appearance.mode`, `radiometric` by
`matching.mode`. A look of the caller's own (`extensions`) changes what these paint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from infrablend.compositing.contrast import Least, real_least
from infrablend.compositing.gain import Backdrop, GainPrior, SharePrior
from infrablend.compositing.local import LocalSettings, Settled, match_locally
from infrablend.compositing.mapping import GreyImage, GreyMapping, percentile_mapping
from infrablend.compositing.occlusion import Share
from infrablend.compositing.picture import overlay
from infrablend.compositing.radiometric import match_radiometric
from infrablend.compositing.sensor import Sensor
from infrablend.config.recipe import (
    LocalMatching,
    MetricPhysicalRecipe,
    PaperPhysicalRecipe,
    Recipe,
)
from infrablend.core.capture import TimeOfDay
from infrablend.core.render import PlacedScene, RenderResult
from infrablend.core.rng import stream
from infrablend.errors import ArgumentError
from infrablend.formats.pictures.images import Background
from infrablend.pipeline.compose.extensions import LookRequest
from infrablend.pipeline.compose.settings import FrameSettings
from infrablend.pipeline.plans.backgrounds import is_ground, require_temperatures, require_thermal_levels
from infrablend.pipeline.plans.plan import PlannedFrame
from infrablend.sampling.weather import air_source


@dataclass(frozen=True, eq=False)
class Match:
    """A scene with its map to grey levels.

    Attributes:
        scene: The scene, without objects if the gain cannot be trusted and the recipe skips such backgrounds.
        mapping: From radiance to the background's grey levels.
        facts: Estimates made on the way, for the frame's record.
        faint: Expected contrast, 8-bit levels, of the objects that are certainly too faint, before rendering.
        settled: What the map follows from, for other frames of a sequence; only with the physical look.
    """

    scene: PlacedScene
    mapping: GreyMapping
    facts: Mapping[str, object] = field(default_factory=dict)
    faint: Mapping[int, float] = field(default_factory=dict)
    settled: Settled | None = None


@dataclass(frozen=True, eq=False)
class Earlier:
    """The match of another frame of a sequence, and what the camera has done to its levels since.

    Attributes:
        match: That match.
        gain: Level of this frame per level of that one.
        offset: Level of this frame where that has 0.
    """

    match: Match
    gain: float
    offset: float


class ArtisticLook:
    """The paper's hand-tuned look: cold and hot surfaces are shown at two percentiles of the background.

    It also has what all looks share, and frames without objects are matched as here whatever the look.
    """

    def __init__(self, recipe: Recipe, settings: FrameSettings) -> None:
        self._recipe = recipe
        self._settings = settings

    def check(self, frame: PlannedFrame, background: Background) -> None:
        """Refuse a background that the look cannot be matched to.

        Raises:
            DatasetError: The background cannot be used.
        """

    def match(
        self, scene: PlacedScene, frame: PlannedFrame, background: Background, earlier: Earlier | None = None
    ) -> Match:
        """Choose the grey levels of a scene, or follow those of the sequence."""
        if earlier is not None:
            known = earlier.match.mapping
            dark, bright = (earlier.gain * v + earlier.offset for v in (known.dark, known.bright))
            return Match(scene, replace(known, dark=dark, bright=bright))
        return Match(scene, percentile_mapping(background.pixels, self._recipe.matching.percentiles))

    def paint(
        self, match: Match, rendered: RenderResult, background: GreyImage, sensor: Sensor | None, front: Share | None
    ) -> GreyImage:
        """Return the (h, w) picture, with any look of the caller's own over that of the recipe.

        Args:
            match: The scene with its map to grey levels.
            rendered: The rendered scene.
            background: (h, w) grey levels.
            sensor: The camera to imitate; None to imitate none.
            front: (h, w) share of each pixel of the background that stays in front; None for nothing.

        Raises:
            ArgumentError: The caller's look returned another size or type.
        """
        motion_px = match.scene.spec.motion_px
        own = self._settings.extensions.look
        picture = overlay(rendered, background, match.mapping, self._recipe.overlay, sensor, motion_px, front)
        if own is None:
            return picture
        changed = own.apply(LookRequest(picture, background, rendered, match.scene))
        if changed.shape != picture.shape or changed.dtype != picture.dtype:
            raise ArgumentError(
                f"look: returned {changed.shape} {changed.dtype}, expected {picture.shape} {picture.dtype}"
            )
        return changed


class PhysicalLook(ArtisticLook):
    """Radiance in the thermal band, with a gain that is estimated for each background."""

    def __init__(self, recipe: PaperPhysicalRecipe | MetricPhysicalRecipe, settings: FrameSettings) -> None:
        super().__init__(recipe, settings)
        self._matching = recipe.matching
        self._headroom = recipe.sensor.headroom

    def check(self, frame: PlannedFrame, background: Background) -> None:
        """Refuse a picture with grey levels that do not follow temperature."""
        require_thermal_levels(background)

    def match(
        self, scene: PlacedScene, frame: PlannedFrame, background: Background, earlier: Earlier | None = None
    ) -> Match:
        """Match each object to the ground, the sky or the skyline around it."""
        if not scene.objects:
            return super().match(scene, frame, background)
        assert self._settings.levels is not None
        source = frame.as_read
        time = source.capture.time_of_day
        # Under clouds, roofs of cars are no anchors: as at an unknown time, people alone are.
        overcast = scene.spec.weather is not None and scene.spec.weather.overcast
        of_anchors = None if overcast and time == "night" else time
        backdrop = Backdrop(background.pixels, source.instances, of_anchors, self._settings.levels)
        # The same stream at each attempt, so that a moved object does not influence the gain.
        rng = stream(self._settings.seed, frame.frame_id, "matching")
        settings = local_settings(self._matching, time, self._headroom)
        found = match_locally(scene, backdrop, settings, rng, self._settled(earlier))
        facts = {"matching": found.facts}
        height_at_limit = scene.spec.view is not None and scene.spec.view.at_limit
        if (found.untrusted or height_at_limit) and self._matching.on_untrusted == "skip":
            empty = scene.without(range(len(scene.objects)), "untrusted")
            return Match(empty, super().match(empty, frame, background).mapping, facts)
        faint = {}
        for k, (placed, contrast) in enumerate(zip(scene.objects, found.contrasts, strict=True)):
            least = least_contrast(self._recipe, placed.spec.category, time)
            if least is not None and contrast < least.change * backdrop.grey_unit:
                faint[k] = contrast / backdrop.grey_unit
        return Match(scene, found.mapping, facts, faint, found.settled)

    def _settled(self, earlier: Earlier | None) -> Settled | None:
        """Return the map of the sequence as it is in a frame."""
        if earlier is None or earlier.match.settled is None:
            return None
        gain = earlier.gain
        offset = earlier.offset
        if self._matching.polarity == "black-hot":  # the map is that of the picture turned to white-hot
            assert self._settings.levels is not None
            offset = (1 - gain) * sum(self._settings.levels) - offset
        return earlier.match.settled.through(gain, offset)


class RadiometricLook(ArtisticLook):
    """Temperatures as they are, through the air, for 16-bit pictures with a temperature scale."""

    def check(self, frame: PlannedFrame, background: Background) -> None:
        """Refuse a picture without temperatures of a scene in 16 bits."""
        scale = frame.as_read.capture.scale
        require_temperatures(background, scale, is_ground(frame.background, self._recipe))

    def match(
        self, scene: PlacedScene, frame: PlannedFrame, background: Background, earlier: Earlier | None = None
    ) -> Match:
        """Give the scene the ground of its picture, and its objects the air in front of them."""
        scale = frame.as_read.capture.scale
        if not scene.objects or scale is None:
            return super().match(scene, frame, background)
        air = air_source(frame.key(background.size_wh), self._recipe.environment)
        scene, mapping, facts = match_radiometric(scene, background.pixels, frame.as_read.instances, scale, air)
        return Match(scene, mapping, {"matching": facts})


_LOOKS: Mapping[str, Callable[[Any, FrameSettings], ArtisticLook]] = {
    "artistic": ArtisticLook,
    "physical": PhysicalLook,
    "radiometric": RadiometricLook,
}


def make_look(recipe: Recipe, settings: FrameSettings) -> ArtisticLook:
    """Return the look of a run's frames."""
    return _LOOKS[recipe.look](recipe, settings)


def local_settings(matching: LocalMatching, time_of_day: TimeOfDay | None, headroom: float = 0.0) -> LocalSettings:
    """Return the settings of matching by physics for a background of this time of day.

    Args:
        matching: The recipe's matching.
        time_of_day: Time of day of the background; None if unknown.
        headroom: How far levels may exceed those of the dataset, which the sensor then cuts off; see `LocalSettings`.
    """
    m = matching
    low, high = m.gain_grey_per_k
    mean = m.gain_prior_grey_per_k
    share = m.local_share
    if time_of_day == "day" and m.gain_prior_day_grey_per_k is not None:
        mean = m.gain_prior_day_grey_per_k
    if time_of_day == "day" and m.local_share_day is not None:
        share = m.local_share_day
    prior = GainPrior(mean, mean * m.gain_prior_spread, low, high)
    local_share = SharePrior(share, m.local_share_spread, m.local_reach)
    return LocalSettings(prior, m.polarity, m.clothing_above_air_k, local_share, m.on_untrusted, headroom)


def least_contrast(recipe: Recipe, category: str, time_of_day: TimeOfDay | None) -> Least | None:
    """Return the least contrast of an inserted object of this class; None for no limit."""
    wanted = recipe.placement.min_contrast or recipe.appearance.min_contrast
    if wanted == "off":
        return None
    if wanted == "real":
        return real_least(category, time_of_day)
    return Least(wanted.change_grey, wanted.scr)
