"""Alpha-over of a premultiplied float layer onto a grey background, quantised once, at the end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage, GreyMapping
from infrablend.core.render import RenderResult

_NOTHING = 1e-6  # alpha below this is rounding
_LEAST_WIDTH_PX = 0.3
_TABLE_STEP_PX = 0.02
_TAIL_LENGTHS = 5.0  # where a tail is cut off: 0.25 % of it lie beyond, 6 lengths from its beginning


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


def make_layer(
    result: RenderResult, mapping: GreyMapping, softness_px: float, motion_px: tuple[float, float] = (0.0, 0.0)
) -> Layer:
    """The rendered crop as a layer in the background's levels, blurred by a Gaussian of sigma `softness_px`.

    With `motion_px` (right, down) also by a motion tail that stretches that way and displaces nothing on average, see
    `motion_kernel`. The crop grows by the blur's reach and is cut to the frame. Light that the blur would carry beyond
    the frame's edge is lost, as in a camera; that edge darkens nothing, since grey and alpha lose the same share.
    """
    (x0, y0), (w, h) = result.offset_xy, result.frame_wh
    if not result.alpha.size:
        return Layer((0, 0), np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32))
    grey, alpha = mapping.apply(result.radiance, result.alpha, (x0, y0)), result.alpha
    moves = math.hypot(*motion_px) > 0
    if moves:
        kernel = motion_kernel(motion_px, softness_px)
        reach = kernel.shape[0] // 2
    else:
        reach = blur_radius_px(softness_px)
    if reach:
        rows, columns = alpha.shape
        left, top = min(reach, x0), min(reach, y0)
        right, bottom = min(reach, w - x0 - columns), min(reach, h - y0 - rows)
        # At the frame's own edge the object goes on beyond it: repeat its last pixels there.
        stacked = np.stack([grey, alpha], axis=-1)
        inner = cv2.copyMakeBorder(stacked, top, bottom, left, right, cv2.BORDER_CONSTANT, value=0)
        if moves:
            # OpenCV correlates: turned by 180 degrees that is a convolution.
            soft = cv2.filter2D(inner, cv2.CV_32F, kernel[::-1, ::-1], borderType=cv2.BORDER_REPLICATE)
            soft[soft[..., 1] < _NOTHING] = 0  # a large kernel goes by Fourier transform, which leaves rounding errors
        else:
            line = cv2.getGaussianKernel(2 * reach + 1, softness_px, cv2.CV_32F)
            soft = cv2.sepFilter2D(inner, cv2.CV_32F, line, line, borderType=cv2.BORDER_REPLICATE)
        grey, alpha = np.ascontiguousarray(soft[..., 0]), np.ascontiguousarray(soft[..., 1])
        x0, y0 = x0 - left, y0 - top
    return Layer((x0, y0), grey, np.clip(alpha, 0, 1))


def flat_layer(result: RenderResult, mapping: GreyMapping) -> Layer:
    """Every object in one level, the median of what it would show, with a hard edge at half a pixel's coverage.

    An object that covers no pixel by half gets the one it covers most: none that has a label is invisible.
    """
    grey = mapping.apply(result.radiance, result.alpha, result.offset_xy)
    alpha, level = np.zeros_like(result.alpha), np.zeros_like(result.alpha)
    for share in result.coverage:
        if not share.size or share.max() <= 0:
            continue
        own = share >= min(0.5, float(share.max()))
        alpha[own] = 1
        level[own] = np.median(grey[own] / np.maximum(result.alpha[own], _NOTHING))
    return Layer(result.offset_xy, level, alpha)


def motion_kernel(motion_px: tuple[float, float], sigma_px: float) -> NDArray[np.float32]:
    """(2 r + 1, 2 r + 1) kernel of a Gaussian of `sigma_px` with a one-sided exponential tail, as slow detectors leave.

    The exponential's length is that of `motion_px` (right, down), the way it stretches; it is shifted back by its mean,
    so that the kernel's centroid is its middle pixel's centre: what was blurred stays where it was, on average.
    Both are convolved in closed form and then sampled, as OpenCV samples its Gaussians; what sampling moves the
    centroid is taken back. A line needs some width to be sampled: less than 0.3 px becomes that.
    """
    length = math.hypot(*motion_px)
    ux, uy = motion_px[0] / length, motion_px[1] / length
    sigma = max(sigma_px, _LEAST_WIDTH_PX)
    r = math.ceil(_TAIL_LENGTHS * length + 3 * sigma)
    y, x = np.mgrid[-r : r + 1, -r : r + 1].astype(np.float64)
    # The profile along the motion is tabulated once, finely enough for linear interpolation.
    far = 1.5 * r + 1
    table_px = np.linspace(-far, far, 2 * math.ceil(far / _TABLE_STEP_PX) + 1)
    table = _tailed_gaussian(table_px, length, sigma)
    at_x = at_y = 0.0
    for _ in range(20):
        along = (x - at_x) * ux + (y - at_y) * uy
        across = (y - at_y) * ux - (x - at_x) * uy
        kernel = np.interp(along, table_px, table) * np.exp(-0.5 * (across / sigma) ** 2)
        kernel /= kernel.sum()
        off_x, off_y = float((kernel * x).sum()), float((kernel * y).sum())
        if math.hypot(off_x, off_y) < 1e-9:
            break
        at_x, at_y = at_x - off_x, at_y - off_y
    return np.asarray(kernel, np.float32)


def _tailed_gaussian(t: NDArray[np.float64], length: float, sigma: float) -> NDArray[np.float64]:
    """Gaussian of `sigma` convolved with `exp(-s / length) / length` for s > 0, the mean shifted to 0; unnormalised.

    `exp(a) erfc(b)` with a large and b large overflows where a tail is short against the Gaussian: there the product
    goes through logarithms.
    """
    s = t + length
    ratio = sigma / length
    b = (ratio - s / sigma) / math.sqrt(2)
    log_exp = 0.5 * ratio**2 - s / length
    log_erfc = np.array([_log_erfc(v) for v in b.tolist()])
    return np.asarray(np.exp(log_exp + log_erfc), np.float64)


def _log_erfc(x: float) -> float:
    """Logarithm of the complementary error function; above 5 by its asymptotic series, good to 1e-5."""
    if x < 5:
        return math.log(math.erfc(x))
    q = 1 / (2 * x * x)
    return -x * x - math.log(x * math.sqrt(math.pi)) + math.log1p(-q + 3 * q * q - 15 * q**3)


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
