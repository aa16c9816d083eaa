"""Alpha-over of a premultiplied float layer onto a grey background, quantised once, at the end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage, GreyMapping
from infrablend.core.render import RenderResult


@dataclass(frozen=True, eq=False)
class Layer:
    """What is laid over: premultiplied grey levels and alpha of a crop, after the optics' blur.

    Attributes:
        offset_xy: Column and row of the crop's top left pixel in the frame.
        grey: (h, w) float32 premultiplied by alpha, in the background's levels.
        alpha: (h, w) float32 in [0, 1].
    """

    offset_xy: tuple[int, int]
    grey: NDArray[np.float32]
    alpha: NDArray[np.float32]


def blur_radius_px(softness_px: float) -> int:
    """How far the blur reaches, in whole pixels: three sigma."""
    return math.ceil(3 * softness_px) if softness_px > 0 else 0


def make_layer(result: RenderResult, mapping: GreyMapping, softness_px: float) -> Layer:
    """The rendered crop as a layer in the background's levels, blurred by a Gaussian of sigma `softness_px`.

    The crop grows by the blur's reach and is cut to the frame. Light that the blur would carry beyond the frame's
    edge is lost, as in a camera; the frame's edge darkens nothing, since grey and alpha lose the same share.
    """
    (x0, y0), (w, h) = result.offset_xy, result.frame_wh
    if not result.alpha.size:
        return Layer((0, 0), np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32))
    grey, alpha = mapping.apply(result.radiance, result.alpha), result.alpha
    reach = blur_radius_px(softness_px)
    if reach:
        rows, columns = alpha.shape
        left, top = min(reach, x0), min(reach, y0)
        right, bottom = min(reach, w - x0 - columns), min(reach, h - y0 - rows)
        # At the frame's own edge the object goes on beyond it: repeat its last pixels there.
        stacked = np.stack([grey, alpha], axis=-1)
        inner = cv2.copyMakeBorder(stacked, top, bottom, left, right, cv2.BORDER_CONSTANT, value=0)
        kernel = cv2.getGaussianKernel(2 * reach + 1, softness_px, cv2.CV_32F)
        soft = cv2.sepFilter2D(inner, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
        grey, alpha = np.ascontiguousarray(soft[..., 0]), np.ascontiguousarray(soft[..., 1])
        x0, y0 = x0 - left, y0 - top
    return Layer((x0, y0), grey, np.clip(alpha, 0, 1))


def compose_float(background: GreyImage, layer: Layer) -> NDArray[np.float32]:
    """(h, w) float32 picture `layer.grey + (1 - alpha) * background`, unquantised; for measurements."""
    picture = background.astype(np.float32)
    rows, columns = layer.alpha.shape
    x0, y0 = layer.offset_xy
    part = picture[y0 : y0 + rows, x0 : x0 + columns]
    part[...] = layer.grey + (1 - layer.alpha) * part
    return picture


def compose(background: GreyImage, layer: Layer) -> GreyImage:
    """The picture in the background's own type. Pixels the layer does not touch keep their value to the bit."""
    top = np.iinfo(background.dtype).max
    picture = background.copy()
    rows, columns = layer.alpha.shape
    x0, y0 = layer.offset_xy
    part = picture[y0 : y0 + rows, x0 : x0 + columns]
    mixed = layer.grey.astype(np.float64) + (1 - layer.alpha.astype(np.float64)) * part
    part[...] = np.where(layer.alpha > 0, np.clip(np.rint(mixed), 0, top), part).astype(background.dtype)
    return picture
