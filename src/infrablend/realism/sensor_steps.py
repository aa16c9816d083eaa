"""The sensor chain switched on step by step, to show what each step does for realism."""

from __future__ import annotations

from dataclasses import replace

from infrablend.compositing.sensor import Sensor

SENSOR_STEPS = ("chain_off", "psf", "halo", "noise", "codec")
"""Names of the steps; each includes the ones before it, and `codec` is the whole chain."""


def sensor_steps(sensor: Sensor) -> dict[str, Sensor]:
    """Return the chain of each step. The range limits come with the halo, whose overshoot they cut off."""
    off = replace(
        sensor,
        blur_sigma_px=None,
        defocus_sigma_px=0.0,
        halo_gain=0.0,
        noise_grey=0.0,
        limits=None,
        codec_quality=None,
    )
    psf = replace(off, blur_sigma_px=sensor.blur_sigma_px, defocus_sigma_px=sensor.defocus_sigma_px)
    halo = replace(psf, halo_gain=sensor.halo_gain, limits=sensor.limits)
    noise = replace(halo, noise_grey=sensor.noise_grey)
    return dict(zip(SENSOR_STEPS, (off, psf, halo, noise, sensor), strict=True))
