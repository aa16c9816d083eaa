"""The picture of a rendered scene over its background."""

from __future__ import annotations

from infrablend.compositing.mapping import GreyImage, GreyMapping
from infrablend.compositing.occlusion import Share, put_behind, restore_front
from infrablend.compositing.overlay import compose, flat_layer, make_layer
from infrablend.compositing.radiometric import compose_radiance
from infrablend.compositing.sensor import Sensor, apply_sensor
from infrablend.config.recipe import Overlay
from infrablend.core.render import RenderResult


def overlay(
    rendered: RenderResult,
    background: GreyImage,
    mapping: GreyMapping,
    style: Overlay,
    sensor: Sensor | None = None,
    motion_px: tuple[float, float] = (0.0, 0.0),
    front: Share | None = None,
) -> GreyImage:
    """Lay a rendered scene over its background and return the picture.

    Args:
        rendered: The rendered scene.
        background: (h, w) grey levels.
        mapping: From radiance to the background's grey levels, or to radiance at the sensor for a background with
            temperatures.
        style: Softness of the edge, or flat silhouettes (paper), for pictures without `sensor`.
        sensor: The camera to imitate; None to imitate none.
        motion_px: The scene's motion tail; only with `sensor`.
        front: (h, w) share of each pixel of the background that stays in front; None for nothing.
    """
    if sensor is not None:
        layer = make_layer(rendered, mapping, sensor.layer_sigma_px(style.softness_px), motion_px, sensor.bloom)
    else:
        layer = flat_layer(rendered, mapping) if style.flat else make_layer(rendered, mapping, style.softness_px)
    if front is not None:
        layer = put_behind(layer, front)
    if mapping.scale is not None:
        picture = compose_radiance(background, layer, mapping.scale, sensor)
    else:
        picture = compose(background, layer) if sensor is None else apply_sensor(background, layer, sensor)
    return picture if front is None else restore_front(picture, background, front)
