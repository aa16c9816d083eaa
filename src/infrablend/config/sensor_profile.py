"""What is known of a camera before looking at one of its pictures: shipped profiles, and files with further ones."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from infrablend.core.strict import Strict, range_of
from infrablend.core.wording import field_problems
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import Problem, RecipeError

PROFILE_SUFFIXES = (".json", ".yaml", ".yml")


class Lens(Strict):
    """The lens and detector that decide how blurred a near object is. The lens is taken to be focused at infinity."""

    focal_length_mm: float = Field(gt=0, le=2000)
    """Focal length, mm."""
    f_number: float = Field(gt=0, le=64)
    """Focal length over the aperture's diameter."""
    pixel_um: float = Field(gt=0, le=100)
    """Distance between the detector's pixels, micrometres."""
    enlargement: float = Field(1.0, gt=0, le=16)
    """Pixels of the stored picture for each of the detector's."""

    def blur_disc_px(self, range_m: float) -> float:
        """Diameter of the disc that a point at `range_m` (metres, above 0) becomes, px of the stored picture.

        By similar triangles behind a thin lens focused at infinity: aperture * focal length / range, exactly.
        """
        native = self.focal_length_mm**2 / (self.f_number * range_m * self.pixel_um)
        return native * self.enlargement


class SensorProfile(Strict):
    """A kind of picture; `infrablend profile` writes such a file. Pixels are those of the stored picture."""

    name: str = Field(min_length=1)
    """What the records call it."""
    description: str = ""
    """Where the numbers come from."""
    psf_sigma_px: float = Field(ge=0.3, le=10)
    """Gaussian (sigma) of all that blurs, the pixel included, before sharpening."""
    edge_bounds_px: range_of(0.1, 10)  # type: ignore[valid-type]
    """Least and largest sigma believed of a picture's sharpest edges, after sharpening."""
    halo_gain: float = Field(0.0, ge=0, le=4)
    """Detail enhancement: `P + gain * (P - G_radius * P)`."""
    halo_radius_px: float = Field(1.6, ge=0.3, le=20)
    """Its radius (sigma)."""
    noise_grey: float = Field(ge=0, le=50)
    """Standard deviation of the grain where a picture has no flat place, 8-bit levels."""
    noise_grain_px: float = Field(ge=0.3, le=10)
    """Sigma of the blur that gives white noise the pictures' grain."""
    codec_quality: int | None = Field(None, ge=5, le=100)
    """JPEG quality that stands for the stream the pictures came through; null for none."""
    levels: range_of(0, 255) | None = None  # type: ignore[valid-type]
    """Darkest and brightest level of 8-bit pictures; null: measured on the dataset of each run."""
    time_constant_s: float = Field(0.010, gt=0, le=1)
    """How slowly the detector follows, seconds: a motion of v px/s leaves a tail of v times this."""
    lens: Lens | None = None
    """For defocus; null for none."""
    measured: dict[str, Any] = Field(default_factory=dict)
    """What `infrablend profile` found on which pictures; for the reader."""


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
            # 3000 px of focal length are calibrated on a teaser; with a 12 um detector at its own size they are 36 mm.
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
    """The profile in a JSON or YAML file.

    Raises:
        RecipeError: It cannot be read, or has wrong fields; all of them are named.
    """
    try:
        data = read_yaml(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise RecipeError(
            f"sensor profile {path}: cannot be read ({error}); expected a file as `infrablend profile` writes it, or "
            f"one of the names {', '.join(PROFILES)}"
        ) from error
    try:
        # Through JSON, as recipes are: strict mode then takes lists for tuples.
        return SensorProfile.model_validate_json(json.dumps(data))
    except ValidationError as error:
        problems = field_problems(
            error, data, SensorProfile, "profile", "see sensor.profile in docs/reference/recipe.md"
        )
    except (TypeError, ValueError) as error:
        problems = [Problem(path.name, "profile-value", str(error), "plain numbers, texts, lists and mappings")]
    raise RecipeError(f"sensor profile {path}: {len(problems)} field(s) are wrong", problems)


def find_profile(profile: str | SensorProfile) -> SensorProfile:
    """The shipped profile of that name; a profile is itself.

    Raises:
        RecipeError: No such name.
    """
    if isinstance(profile, SensorProfile):
        return profile
    if profile not in PROFILES:
        raise RecipeError(f"sensor profile {profile!r}: no such profile; expected one of {', '.join(PROFILES)}")
    return PROFILES[profile]
