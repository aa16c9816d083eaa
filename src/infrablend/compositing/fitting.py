"""Fit a sensor profile to pictures: measure them one by one (`Survey`), then fit the sensor chain (`fit_profile`)."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage
from infrablend.compositing.measure import (
    EDGE_PX,
    PLATEAU_PX,
    PROFILE_SIGMA_PX,
    block_steps,
    blockiness,
    edge_profiles,
    flat_blocks,
    grain_correlation,
    overshoots,
    profile_sigmas,
    true_grain,
    unsharpened_sigma,
)
from infrablend.compositing.overlay import Layer
from infrablend.compositing.sensor import PIXEL_BOX_VARIANCE, Sensor, apply_sensor, through_jpeg
from infrablend.config.sensor_profile import SensorProfile

LAGS = (1, 2, 3, 4)
MIN_EDGES = 30
_KEPT_EDGES = 50_000  # over all pictures; limits memory to 13 MB
_CODEC_SAMPLE = 12
_TRIED_QUALITIES = (100, 95, 90, 85, 80, 75, 70, 65, 60, 50, 40, 30, 20)
# Excess of blockiness over that of the file's own JPEG compression from which on a video codec is assumed.
_BLOCKY = 0.05
_GAINS = np.arange(0, 2.01, 0.05)
_RADII = np.arange(1.0, 4.51, 0.25)
_NO_HALO = (0.0, 1.6)


@dataclass
class Survey:
    """Measurements of pictures of one camera.

    Attributes:
        levels: Darkest and brightest level of all pictures; clipped areas do not count as flat.
        pictures: Expected number of pictures; limits the edges kept per picture.
        scale: Levels of the pictures per 8-bit level.
        profiles: (n, 65) edge profiles of each picture.
        sharpest: Sigma of the sharpest edges of each picture that has enough of them, px.
        noise: Grain of each picture with flat blocks, levels.
        correlations: Autocorrelation of the grain of each picture, at `LAGS`.
        steps: (8,) `block_steps` of each picture.
        qualities: JPEG quality of each JPEG file.
        shifted: Some pictures without their first rows and columns, to try codecs on.
        read: Number of pictures measured.
    """

    levels: tuple[float, float]
    pictures: int
    scale: float = 1.0
    profiles: list[NDArray[np.float32]] = field(default_factory=list)
    sharpest: list[float] = field(default_factory=list)
    noise: list[float] = field(default_factory=list)
    correlations: list[list[float]] = field(default_factory=list)
    steps: list[NDArray[np.float64]] = field(default_factory=list)
    qualities: list[int] = field(default_factory=list)
    shifted: list[NDArray[np.uint8]] = field(default_factory=list)
    read: int = 0

    def add(self, picture: GreyImage, free: NDArray[np.bool_] | None, jpeg_quality: int | None) -> None:
        """Measure one picture.

        `free` is false on annotated objects; only JPEG files have a quality.
        """
        self.read += 1
        profiles, _ = edge_profiles(picture, self.scale, free)
        sigma = profile_sigmas(profiles)
        profiles = profiles[~np.isnan(sigma)]
        sigma = sigma[~np.isnan(sigma)]
        if len(sigma) >= MIN_EDGES:
            self.sharpest.append(float(np.percentile(sigma, 20)))
        most = max(MIN_EDGES, _KEPT_EDGES // max(self.pictures, 1))
        self.profiles.append(profiles[:: max(1, math.ceil(len(profiles) / most))].astype(np.float32))
        blocks = flat_blocks(picture, self.levels, self.scale, free)
        if len(blocks):
            self.noise.append(float(np.median(blocks.std(axis=(1, 2)))))
            found = [grain_correlation(blocks, lag) for lag in LAGS]
            if found[0] is not None:
                self.correlations.append([c or 0.0 for c in found])
        steps = block_steps(picture)
        if steps is not None and steps.mean() > 0:
            self.steps.append(steps)
        if jpeg_quality is not None:
            self.qualities.append(jpeg_quality)
        every = max(1, self.pictures // _CODEC_SAMPLE)
        if picture.dtype == np.uint8 and min(picture.shape) >= 64 and self.read % every == 1 % every:
            # Shifted by half a block, so that the grid of a second codec falls between the lines of the first one.
            self.shifted.append(np.array(picture[4:, 4:], np.uint8))

    @property
    def edges(self) -> NDArray[np.float64]:
        """(n, 65) profiles of all pictures."""
        kept = [p for p in self.profiles if len(p)]
        return np.concatenate(kept).astype(np.float64) if kept else np.zeros((0, len(EDGE_PX)))


@dataclass(frozen=True, eq=False)
class SurveySummary:
    """Summary of a survey, of real pictures or of the output of a sensor chain.

    Attributes:
        sigmas_px: (n,) sigmas of all clean edges.
        sigma_px: 20th percentile of the sigmas.
        edge: (65,) median profile of the edges between the 10th and 30th percentile of sharpness, centred.
        overshoot: Overshoot of that profile on the bright and on the dark side, as shares of the step.
        typical_overshoot: Median overshoot of all edges, noise included; bright and dark side.
        noise_grey: Median standard deviation of flat blocks, 8-bit levels; None without flat blocks.
        correlations: Autocorrelation of the grain at `LAGS`; None without grain.
        blockiness: Median over the pictures; None if all are too small.
        steps: (8,) mean of `block_steps`, relative to their mean; None if all pictures are too small.
    """

    sigmas_px: NDArray[np.float64]
    sigma_px: float
    edge: NDArray[np.float64]
    overshoot: tuple[float, float]
    typical_overshoot: tuple[float, float]
    noise_grey: float | None
    correlations: tuple[float, ...] | None
    blockiness: float | None
    steps: NDArray[np.float64] | None

    def to_json(self) -> dict[str, object]:
        """Return the rounded figures as plain JSON values."""
        plain: dict[str, object] = {
            "edges": len(self.sigmas_px),
            "edge_sigma_px": _round(np.percentile(self.sigmas_px, [10, 20, 50]).tolist()),
            "overshoot": _round(self.overshoot),
            "typical_overshoot": _round(self.typical_overshoot),
        }
        if self.noise_grey is not None:
            plain["noise_grey"] = round(self.noise_grey, 4)
        if self.correlations is not None:
            plain["noise_correlations"] = _round(self.correlations)
        if self.blockiness is not None:
            plain["blockiness"] = round(self.blockiness, 4)
        return plain


def summarize_survey(survey: Survey) -> SurveySummary:
    """Summarise a survey.

    Raises:
        ValueError: Too few clean edges.
    """
    profiles = survey.edges
    if len(profiles) < MIN_EDGES:
        raise ValueError(f"{len(profiles)} clean edges")
    sigmas = profile_sigmas(profiles)
    low, high = np.percentile(sigmas, [10, 30])
    edge = np.median(_centred(profiles[(sigmas >= low) & (sigmas <= high)]), axis=0)
    bright, dark = overshoots(edge[None])[0]
    typical = np.median(overshoots(profiles), axis=0)
    steps = np.mean([s / s.mean() for s in survey.steps], axis=0) if survey.steps else None
    return SurveySummary(
        sigmas_px=sigmas,
        sigma_px=float(np.percentile(sigmas, 20)),
        edge=edge,
        overshoot=(max(float(bright), 0.0), max(float(dark), 0.0)),
        typical_overshoot=(float(typical[0]), float(typical[1])),
        noise_grey=float(np.median(survey.noise)) / survey.scale if survey.noise else None,
        correlations=tuple(np.median(survey.correlations, axis=0).tolist()) if survey.correlations else None,
        blockiness=statistics.median(blockiness(s) for s in survey.steps) if survey.steps else None,
        steps=steps,
    )


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted profile and the measurements behind it.

    Attributes:
        profile: The fitted profile.
        found: Summary of the pictures.
        chain: Summary of the fitted chain's own output.
        codec: (JPEG quality, blockiness) pairs, see `codec_curve`.
    """

    profile: SensorProfile
    found: SurveySummary
    chain: SurveySummary
    codec: tuple[tuple[int, float], ...]


def fit_profile(survey: Survey, name: str, description: str = "") -> Fit:
    """Fit the sensor chain whose output has the same readings as the survey.

    Sharpening is fitted to the side of the edge that overshoots less, because small warm objects raise the other side.

    Raises:
        ValueError: Too few clean edges.
    """
    found = summarize_survey(survey)
    curve = codec_curve(survey)
    gain, radius = _fit_halo(found)
    psf = min(max(unsharpened_sigma(found.sigma_px, gain, radius), 0.3), 6.0)
    bounds = (0.8 * found.sigma_px, 1.25 * found.sigma_px)
    if len(survey.sharpest) >= 8:
        low, high = (float(v) for v in np.percentile(survey.sharpest, [10, 90]))
        bounds = (min(bounds[0], low), max(bounds[1], min(high, 1.6 * found.sigma_px)))
    noise = 0.0
    grain = 0.5
    if found.noise_grey is not None:
        noise = found.noise_grey
        if found.correlations is not None:
            noise, grain = true_grain(noise, found.correlations[0], 1.0 if survey.scale == 1.0 else 0.0)
    profile = SensorProfile(
        name=name,
        description=description,
        psf_sigma_px=round(psf, 3),
        edge_bounds_px=tuple(round(min(max(b, 0.1), 10.0), 3) for b in bounds),
        halo_gain=round(gain, 3),
        halo_radius_px=round(radius, 2),
        noise_grey=round(noise, 3),
        noise_grain_px=round(max(grain, 0.3), 3),
        codec_quality=_fit_codec(survey, found, curve),
        levels=survey.levels if survey.scale == 1.0 else None,
        measured={"pictures": survey.read, "levels": list(survey.levels), **found.to_json()},
    )
    # The closed form ignores that a wide halo shifts the levels that an edge is measured against. Correct once for it.
    off = chain_readings(profile).sigma_px - found.sigma_px
    profile = profile.model_copy(update={"psf_sigma_px": round(min(max(psf - off, 0.3), 6.0), 3)})
    return Fit(profile, found, chain_readings(profile), curve)


def chain_readings(profile: SensorProfile) -> SurveySummary:
    """Return the readings of a profile's chain applied to ideal steps of 80 levels and to flat pictures.

    All steps have the same sharpness, so their median takes the place of a scene's 20th percentile. Blockiness depends
    on the scene and is not measured here.
    """
    size = 512
    fine = 4
    y, x = (np.mgrid[: size * fine, : size * fine].astype(np.float32) + np.float32(0.5)) / fine
    turn = math.radians(8.0)
    stripes = (np.floor((x * math.cos(turn) + y * math.sin(turn)) / 64) % 2).astype(np.float32)
    stripes = cv2.resize(stripes, (size, size), interpolation=cv2.INTER_AREA)
    blur = math.sqrt(max(profile.psf_sigma_px**2 - PIXEL_BOX_VARIANCE, 1e-4))
    stripes = cv2.GaussianBlur(stripes, (0, 0), blur)
    sensor = Sensor(
        profile=profile.name,
        halo_gain=profile.halo_gain,
        halo_radius_px=profile.halo_radius_px,
        noise_grey=profile.noise_grey,
        noise_grain_px=profile.noise_grain_px,
        codec_quality=profile.codec_quality,
    )
    survey = Survey((0.0, 255.0), 1)
    # Each flat picture has exactly the five blocks that are measured, so that no selection biases the grain.
    flat = [np.full((32, 160), 120.0, np.float32)] * 16
    for seed, picture in enumerate([(80 + 80 * stripes).astype(np.float32), *flat]):
        layer = Layer((0, 0), picture, np.ones(picture.shape, np.float32))
        ground = np.zeros(picture.shape, np.uint8)
        survey.add(apply_sensor(ground, layer, replace(sensor, noise_seed=seed)), None, None)
    survey.noise = survey.noise[-16:]
    survey.correlations = survey.correlations[-16:]
    found = summarize_survey(survey)
    profiles = survey.edges
    edge = np.median(_centred(profiles), axis=0)
    bright, dark = overshoots(edge[None])[0]
    return replace(
        found,
        sigma_px=float(np.median(found.sigmas_px)),
        edge=edge,
        overshoot=(max(float(bright), 0.0), max(float(dark), 0.0)),
        blockiness=None,
        steps=None,
    )


def _centred(profiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return profiles shifted so that each crosses 50 % at 0; Canny locates edges to whole pixels only."""
    middle = len(EDGE_PX) // 2
    moved = np.empty_like(profiles)
    for row, profile in enumerate(profiles):
        near = np.flatnonzero((profile[middle - 8 : middle + 8] < 0.5) & (profile[middle - 7 : middle + 9] >= 0.5))
        if not len(near):
            moved[row] = profile
            continue
        i = middle - 8 + int(near[np.argmin(np.abs(near - 8))])
        at = EDGE_PX[i] + 0.25 * (0.5 - profile[i]) / (profile[i + 1] - profile[i])
        moved[row] = np.interp(EDGE_PX + at, EDGE_PX, profile)
    return moved


def edge_model(sigma_px: float, gain: float, radius_px: float) -> NDArray[np.float64]:
    """Return the (65,) profile that `edge_profiles` measures on a sharpened Gaussian edge."""
    narrow = math.hypot(sigma_px, PROFILE_SIGMA_PX) * math.sqrt(2)
    wide = math.hypot(narrow, radius_px * math.sqrt(2))
    edge = np.array([0.5 + 0.5 * ((1 + gain) * math.erf(t / narrow) - gain * math.erf(t / wide)) for t in EDGE_PX])
    dark, bright = np.median(edge[EDGE_PX <= -PLATEAU_PX]), np.median(edge[EDGE_PX >= PLATEAU_PX])
    return np.asarray((edge - dark) / (bright - dark), np.float64)


def _fit_halo(found: SurveySummary) -> tuple[float, float]:
    """Return gain and radius of the sharpening that fit the edge's width and its smaller overshoot."""
    bright, dark = found.overshoot
    edge = found.edge if dark <= bright else 1 - found.edge[::-1]
    side = (EDGE_PX > -PLATEAU_PX) & (EDGE_PX <= 0)
    seen = float(profile_sigmas(edge[None])[0])
    if math.isnan(seen):
        return _NO_HALO
    misfit = np.array(
        [
            [
                math.sqrt(float(((edge_model(unsharpened_sigma(seen, g, r), g, r) - edge)[side] ** 2).mean()))
                for g in _GAINS.tolist()
            ]
            for r in _RADII.tolist()
        ]
    )
    row, column = np.unravel_index(int(np.argmin(misfit)), misfit.shape)
    gain = float(_GAINS[column])
    return (gain, float(_RADII[row])) if gain > 0 else _NO_HALO


def codec_curve(survey: Survey) -> tuple[tuple[int, float], ...]:
    """Return (JPEG quality, blockiness) pairs of the survey's pictures compressed again; 100 means no compression.

    The pictures are shifted by half a block first, so that their earlier compression does not count.
    """

    def blocky(quality: int) -> float:
        tried = (p if quality == 100 else through_jpeg(p, quality) for p in survey.shifted)
        return statistics.median(blockiness(s) for s in (block_steps(p) for p in tried) if s is not None)

    return tuple((q, blocky(q)) for q in _TRIED_QUALITIES) if survey.shifted else ()


def _fit_codec(survey: Survey, found: SurveySummary, curve: Sequence[tuple[int, float]]) -> int | None:
    """Return the JPEG quality that reproduces the blockiness; None if the compression of the files explains it."""
    if found.blockiness is None or not curve:
        return None
    # Coarser quantisation never reduces blockiness.
    qualities = [q for q, _ in curve]
    blocky = np.maximum.accumulate([b for _, b in curve])
    of_file = statistics.median(survey.qualities) if survey.qualities else 100
    explained = float(np.interp(-of_file, [-q for q in qualities], blocky))
    if found.blockiness <= explained + _BLOCKY:
        return None
    return round(float(np.interp(found.blockiness, blocky, qualities)))


def _round(values: Any) -> list[float]:
    return [round(float(v), 4) for v in values]
