"""Ground that objects warm: the radiance against which renderers measure its glow."""

from __future__ import annotations

from infrablend.core.placed import PlacedScene
from infrablend.thermal.radiometry import band_radiance


def ground_radiance(scene: PlacedScene) -> float | None:
    """Return the radiance of ground at air temperature if all translucent parts of the scene are ground that glows.

    None if there is no such part, or if the scene has other parts without a label: a render does not separate them.
    """
    weather = scene.spec.weather
    unlabelled = [s for o in scene.objects for n in o.mesh.part_names if not (s := o.spec.parts[n]).label]
    separable = bool(unlabelled) and all(s.glow for s in unlabelled)
    if weather is None or not separable:
        return None
    return float(band_radiance(weather.air_k))
