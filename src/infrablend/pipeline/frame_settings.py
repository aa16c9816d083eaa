"""Settings of frame workers: what a run hands to each of them, and what each step takes from the recipe."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from infrablend.annotation.merge import MergeSettings
from infrablend.compositing.contrast import Least, real_least
from infrablend.compositing.gain import GainPrior, SharePrior
from infrablend.compositing.local import LocalSettings
from infrablend.compositing.mapping import PercentileSettings
from infrablend.compositing.sensor import SensorStrength
from infrablend.config.recipe import (
    LocalMatching,
    Matching,
    MetricSensor,
    MinContrast,
    PaperSensor,
    PercentileMatching,
    RadiometricSensor,
    Recipe,
)
from infrablend.config.sensor_profile import SensorProfile, find_profile
from infrablend.core.capture import TimeOfDay
from infrablend.pipeline.extensions import NO_EXTENSIONS, Extensions


@dataclass(frozen=True)
class FrameSettings:
    """Settings that all workers of a run share; picklable.

    Attributes:
        out: Folder of the run; None for frames in memory.
        data_root: Folder of the backgrounds as it was given; their paths are recorded relative to it.
        recipe_json: The recipe.
        seed: The run's seed.
        renderer: Name in `rendering.RENDERERS`.
        device: Device that Cycles computes on.
        pin_cores: Whether each worker keeps to a processor core of its own.
        levels: Darkest and brightest level that the dataset uses; for `appearance.mode: physical` and the sensor.
        ignored: The source's own names of the categories that mark ignore regions.
        extensions: The caller's own sampler, backgrounds and look.
        run: Identity of the run, for the records of its frames.
    """

    out: Path | None
    data_root: Path
    recipe_json: str
    seed: int
    renderer: str = "blender"
    device: str = "cpu"
    pin_cores: bool = True
    levels: tuple[float, float] | None = None
    ignored: tuple[str, ...] = ()
    extensions: Extensions = NO_EXTENSIONS
    run: str = ""


def local_settings(
    matching: LocalMatching, time_of_day: TimeOfDay | None, sensor: PaperSensor | MetricSensor | None = None
) -> LocalSettings:
    """Return the settings of matching by physics for a background of this time of day.

    Args:
        matching: The recipe's matching.
        time_of_day: Time of day of the background; None if unknown.
        sensor: The recipe's sensor, which cuts off what exceeds the levels; None for none.
    """
    m = matching
    low, high = m.gain_grey_per_k
    mean = m.gain_prior_grey_per_k
    if time_of_day == "day" and m.gain_prior_day_grey_per_k is not None:
        mean = m.gain_prior_day_grey_per_k
    share = m.local_share
    if time_of_day == "day" and m.local_share_day is not None:
        share = m.local_share_day
    prior = GainPrior(mean, mean * m.gain_prior_spread, low, high)
    local_share = SharePrior(share, m.local_share_spread, m.local_reach)
    headroom = 0.0 if sensor is None else sensor.headroom
    return LocalSettings(prior, m.polarity, m.clothing_above_air_k, local_share, m.on_untrusted, headroom)


def least_contrast(recipe: Recipe, category: str, time_of_day: TimeOfDay | None) -> Least | None:
    """Return the least contrast of an inserted object of this class; None for no limit."""
    wanted = recipe.placement.min_contrast
    if wanted is None:
        wanted = "real" if recipe.appearance.mode == "physical" else "off"
    if isinstance(wanted, MinContrast):
        return Least(wanted.change_grey, wanted.scr)
    return real_least(category, time_of_day) if wanted == "real" else None


def percentile_settings(matching: Matching) -> PercentileSettings:
    """Return the settings of matching by percentiles: of the artistic look, and of physical frames without objects."""
    if isinstance(matching, PercentileMatching):
        m = matching
    else:
        m = PercentileMatching(polarity=matching.polarity if isinstance(matching, LocalMatching) else "white-hot")
    return PercentileSettings(m.low_percentile, m.high_percentile, m.min_span, m.polarity)


def sensor_strength(sensor: PaperSensor | MetricSensor | RadiometricSensor) -> SensorStrength:
    """Return the strength of each step of the sensor chain."""
    s = sensor
    if isinstance(s, RadiometricSensor):
        return SensorStrength(s.optics, 0.0, s.noise, 0.0, False, s.defocus)
    defocus = s.defocus if isinstance(s, MetricSensor) else 0.0
    return SensorStrength(s.optics, s.halo, s.noise, s.codec, s.clip, defocus)


def sensor_profile(
    sensor: PaperSensor | MetricSensor | RadiometricSensor, grey_unit_k: float | None
) -> str | SensorProfile:
    """Return the profile of a sensor; that of a radiometric camera has neither sharpening nor codec.

    Args:
        sensor: The recipe's sensor.
        grey_unit_k: Kelvin per level of an 8-bit picture of the same range; None for pictures without temperatures.
    """
    if not isinstance(sensor, RadiometricSensor) or grey_unit_k is None:
        return sensor.profile
    noise = min(sensor.netd_k / grey_unit_k, 20.0)
    update = {"halo_gain": 0.0, "codec_quality": None, "levels": None, "noise_grey": noise}
    return find_profile(sensor.profile).model_copy(update=update)


def merge_settings(recipe: Recipe) -> MergeSettings:
    """Return the kinds of labels on an image.

    Ignore regions stay in the record: each format leaves them out, or not, when it is written.
    """
    return MergeSettings(recipe.labels.mode, recipe.labels.keep_categories, recipe.labels.remove_covered)
