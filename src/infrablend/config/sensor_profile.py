"""Sensor profiles: prior knowledge of a camera. Some are shipped, others are read from files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from infrablend.core.strict_model import Strict, range_of
from infrablend.core.validation_messages import read_model
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import RecipeError

PROFILE_SUFFIXES = (".json", ".yaml", ".yml")


class Lens(Strict):
    """Lens and detector, which decide the blur of near objects. The lens is assumed to be focused at infinity."""

    focal_length_mm: float = Field(gt=0, le=2000)
    """Focal length, mm."""
    f_number: float = Field(gt=0, le=64)
    """Focal length divided by the diameter of the aperture."""
    pixel_um: float = Field(gt=0, le=100)
    """Pixel pitch of the detector, micrometres."""
    enlargement: float = Field(1.0, gt=0, le=16)
    """Pixels of the stored image per detector pixel."""

    def blur_disc_px(self, range_m: float) -> float:
        """Return the diameter of the disc that a point at `range_m` (metres, above 0) becomes, px of the stored image.

        For a thin lens focused at infinity, similar triangles give aperture * focal length / range, exactly.
        """
        native = self.focal_length_mm**2 / (self.f_number * range_m * self.pixel_um)
        return native * self.enlargement


class SensorProfile(Strict):
    """Properties of the images of a camera; `infrablend profile` writes such a file. Pixels are those of the files."""

    name: str = Field(min_length=1)
    """Name in the records."""
    description: str = ""
    """Origin of the numbers."""
    psf_sigma_px: float = Field(ge=0.3, le=10)
    """Sigma of the Gaussian blur of optics, pixel and processing together, before sharpening, pixels."""
    edge_bounds_px: range_of(0.1, 10)  # type: ignore[valid-type]
    """Smallest and largest accepted sigma of an image's sharpest edges, after sharpening, pixels."""
    bloom_share: float = Field(0.0, ge=0, le=0.5)
    """Share of an object's light that the optics scatter around it: the glow of saturated objects."""
    bloom_px: float = Field(2.0, ge=0.5, le=20)
    """Sigma of the Gaussian that this light spreads over, pixels."""
    halo_gain: float = Field(0.0, ge=0, le=4)
    """Gain of the detail enhancement `P + gain * (P - G_radius * P)`."""
    halo_radius_px: float = Field(1.6, ge=0.3, le=20)
    """Radius (sigma) of the detail enhancement, pixels."""
    noise_grey: float = Field(ge=0, le=50)
    """Standard deviation of the noise for images without a flat area, 8-bit levels."""
    noise_grain_px: float = Field(ge=0.3, le=10)
    """Sigma of the blur that gives white noise the grain size of the images, pixels."""
    codec_quality: int | None = Field(None, ge=5, le=100)
    """JPEG quality that imitates the video codec of the images; null for none."""
    levels: range_of(0, 255) | None = None  # type: ignore[valid-type]
    """Darkest and brightest level of 8-bit images; null: measured on the dataset of each run."""
    time_constant_s: float = Field(0.010, gt=0, le=1)
    """Time constant of the detector, seconds: a motion of v px/s leaves a tail of v times this length."""
    lens: Lens | None = None
    """Lens, for defocus; null for none."""
    measured: dict[str, Any] = Field(default_factory=dict)
    """Measurements of `infrablend profile` and their images, for information only."""


PROFILES: Mapping[str, SensorProfile] = {
    p.name: p
    for p in (
        SensorProfile(
            name="hit-uav",
            description="Measured on HIT-UAV; the lens is inferred from sizes: 25 mm f/1.1, 17 um, enlarged 1.4 times.",
            psf_sigma_px=0.9,
            edge_bounds_px=(0.5, 0.8),
            halo_gain=0.6,
            halo_radius_px=1.6,
            noise_grey=1.5,
            noise_grain_px=1.05,
            codec_quality=68,
            lens=Lens(focal_length_mm=25.0, f_number=1.1, pixel_um=17.0, enlargement=1.4),
        ),
        SensorProfile(
            name="monet",
            # A focal length of 3000 px was calibrated on a published teaser image; with a 12 um detector that is 36 mm.
            description="Provisional: HIT-UAV's sharpening, grain and codec; 36 mm f/1.0 and 12 um assumed for the "
            "3000 px of focal length that persons and cars show.",
            psf_sigma_px=0.9,
            edge_bounds_px=(0.5, 0.9),
            halo_gain=0.6,
            halo_radius_px=1.6,
            noise_grey=1.5,
            noise_grain_px=1.05,
            codec_quality=75,
            lens=Lens(focal_length_mm=36.0, f_number=1.0, pixel_um=12.0),
        ),
        SensorProfile(
            name="generic-640x512",
            description="A straight 9.1 mm f/1.0, 12 um frame, neither enlarged nor sharpened; computed, not measured.",
            psf_sigma_px=0.55,
            edge_bounds_px=(0.45, 1.3),
            halo_gain=0.0,
            noise_grey=1.5,
            noise_grain_px=0.5,
            lens=Lens(focal_length_mm=9.1, f_number=1.0, pixel_um=12.0),
        ),
    )
}


def read_profile(path: Path) -> SensorProfile:
    """Return the profile in a JSON or YAML file.

    Raises:
        RecipeError: If the file cannot be read or has wrong fields; all of them are listed.
    """
    try:
        data = read_yaml(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise RecipeError(
            f"sensor profile {path}: cannot be read ({error}); expected a file as `infrablend profile` writes it, or "
            f"one of the names {', '.join(PROFILES)}"
        ) from error
    see = "see sensor.profile in docs/reference/recipe.md"
    found = read_model(SensorProfile, data, path.name, "profile", see)
    if isinstance(found, SensorProfile):
        return found
    raise RecipeError(f"sensor profile {path}: {len(found)} field(s) are wrong", found)


def find_profile(profile: str | SensorProfile) -> SensorProfile:
    """Return the shipped profile of that name, or a `SensorProfile` as it is; a `RecipeError` if there is none."""
    if isinstance(profile, SensorProfile):
        return profile
    if profile not in PROFILES:
        raise RecipeError(f"sensor profile {profile!r}: no such profile; expected one of {', '.join(PROFILES)}")
    return PROFILES[profile]
