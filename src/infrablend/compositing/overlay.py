"""Compositing of a premultiplied float layer over a grey background, with a single rounding at the end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage, GreyMapping
from infrablend.core.render import RenderResult

_NOTHING = 1e-6  # alpha below this is a rounding error
_LEAST_WIDTH_PX = 0.3
_TABLE_STEP_PX = 0.02
_TAIL_LENGTHS = 5.0  # the tail is cut off here, which is 6 lengths from its start; the rest is 0.25 % of it


@dataclass(frozen=True, eq=False)
class Layer:
    """A rendered crop in the background's grey levels, after the optics' blur.

    Attributes:
        offset_xy: Column and row of the crop's top left pixel in the frame.
        grey: (h, w) float32 premultiplied by alpha, in the background's levels; where alpha is 0, light that is added.
        alpha: (h, w) float32 in [0, 1].
    """

    offset_xy: tuple[int, int]
    grey: NDArray[np.float32]
    alpha: NDArray[np.float32]


@dataclass(frozen=True)
class Bloom:
    """Light that optics and detector scatter around bright objects, which the blur alone does not reach.

    Attributes:
        share: Share of the light of each point that is scattered.
        sigma_px: Sigma of the Gaussian that it spreads over.
    """

    share: float = 0.0
    sigma_px: float = 0.0

    @property
    def reach_px(self) -> int:
        """How far it spreads, in whole pixels."""
        return blur_radius_px(self.sigma_px) if self.share else 0


NO_BLOOM = Bloom()


def blur_radius_px(softness_px: float) -> int:
    """Return the reach of the blur in whole pixels: three sigma."""
    return math.ceil(3 * softness_px) if softness_px > 0 else 0


def make_layer(
    result: RenderResult,
    mapping: GreyMapping,
    softness_px: float,
    motion_px: tuple[float, float] = (0.0, 0.0),
    bloom: Bloom = NO_BLOOM,
) -> Layer:
    """Turn the rendered crop into a layer in the background's levels, blurred by a Gaussian of sigma `softness_px`.

    `motion_px` (right, down) adds a motion tail in that direction without a mean displacement, see `motion_kernel`. The
    crop grows by the blur's reach and is clipped to the frame. Light that the blur carries across the frame's edge is
    lost, as in a camera. Pixels at the edge do not get darker, because grey and alpha lose the same share.
    """
    x0, y0 = result.offset_xy
    w, h = result.frame_wh
    if not result.alpha.size:
        return Layer((0, 0), np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32))
    grey = mapping.apply(result.radiance, result.alpha, (x0, y0))
    alpha = result.alpha
    if result.ground_radiance is not None:
        # The translucent share adds its light to the background: what it has in common with the ground is taken out.
        solid = np.minimum(result.coverage.sum(axis=0), alpha)
        ground = alpha - solid
        grey = grey - mapping.apply(np.float32(result.ground_radiance) * ground, ground, (x0, y0))
        alpha = solid
    moves = math.hypot(*motion_px) > 0
    if moves:
        kernel = motion_kernel(motion_px, softness_px)
        reach = kernel.shape[0] // 2
    else:
        reach = blur_radius_px(softness_px)
    reach = max(reach, bloom.reach_px)
    if reach:
        rows, columns = alpha.shape
        left = min(reach, x0)
        top = min(reach, y0)
        right = min(reach, w - x0 - columns)
        bottom = min(reach, h - y0 - rows)
        # At the frame's own edge the object continues beyond it: repeat its last pixels there.
        stacked = np.stack([grey, alpha], axis=-1)
        inner = cv2.copyMakeBorder(stacked, top, bottom, left, right, cv2.BORDER_CONSTANT, value=0)
        if moves:
            # OpenCV correlates; a kernel turned by 180 degrees makes that a convolution.
            soft = cv2.filter2D(inner, cv2.CV_32F, kernel[::-1, ::-1], borderType=cv2.BORDER_REPLICATE)
            # OpenCV applies large kernels by Fourier transform, which leaves rounding errors.
            soft[np.abs(soft).max(axis=-1) < _NOTHING] = 0
        else:
            soft = _blurred(inner, softness_px)
        if bloom.share:
            soft = np.float32(1 - bloom.share) * soft + np.float32(bloom.share) * _blurred(inner, bloom.sigma_px)
        grey = np.ascontiguousarray(soft[..., 0])
        alpha = np.ascontiguousarray(soft[..., 1])
        x0, y0 = x0 - left, y0 - top
    return Layer((x0, y0), grey, np.clip(alpha, 0, 1))


def _blurred(picture: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Return an (h, w, n) picture blurred by a Gaussian; as it is with a sigma of 0."""
    if not (reach := blur_radius_px(sigma_px)):
        return picture
    line = cv2.getGaussianKernel(2 * reach + 1, sigma_px, cv2.CV_32F)
    return np.asarray(cv2.sepFilter2D(picture, cv2.CV_32F, line, line, borderType=cv2.BORDER_REPLICATE), np.float32)


def flat_layer(result: RenderResult, mapping: GreyMapping) -> Layer:
    """Return a layer that shows each object in a single level, the median of its grey levels, with a hard edge.

    Pixels covered by at least half belong to the object. If there is none, the pixel with the largest coverage does, so
    that no labelled object is invisible.
    """
    grey = mapping.apply(result.radiance, result.alpha, result.offset_xy)
    alpha = np.zeros_like(result.alpha)
    level = np.zeros_like(result.alpha)
    for share in result.coverage:
        if not share.size or share.max() <= 0:
            continue
        own = share >= min(0.5, float(share.max()))
        alpha[own] = 1
        level[own] = np.median(grey[own] / np.maximum(result.alpha[own], _NOTHING))
    return Layer(result.offset_xy, level, alpha)


def motion_kernel(motion_px: tuple[float, float], sigma_px: float) -> NDArray[np.float32]:
    """Return the (2 r + 1, 2 r + 1) kernel of a Gaussian with the one-sided tail that slow detectors leave.

    The Gaussian has sigma `sigma_px`. The tail is an exponential along `motion_px` (right, down); its decay length is
    the length of that vector. It is shifted back by its mean, so that the kernel's centroid is the centre of the middle
    pixel and the blur displaces nothing on average. The convolution of the two is computed in closed form and then
    sampled, as OpenCV samples its Gaussians; the centroid's shift due to sampling is removed. A sigma below 0.3 px
    cannot be sampled and is raised to 0.3 px.
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

    If the tail is short compared with the Gaussian, `exp(a) erfc(b)` has large a and b and overflows, so the product is
    computed with logarithms.
    """
    s = t + length
    ratio = sigma / length
    b = (ratio - s / sigma) / math.sqrt(2)
    log_exp = 0.5 * ratio**2 - s / length
    return np.asarray(np.exp(log_exp + _log_erfc(b)), np.float64)


def _log_erfc(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithm of the complementary error function; above 5 by its asymptotic series, good to 1e-5."""
    found = np.empty_like(x)
    near = x < 5
    far = x[x >= 5]
    found[near] = np.log(np.fromiter(map(math.erfc, x[near].tolist()), np.float64))
    q = 1 / (2 * far * far)
    found[~near] = -far * far - np.log(far * math.sqrt(math.pi)) + np.log1p(-q + 3 * q * q - 15 * q**3)
    return found


def compose(background: GreyImage, layer: Layer) -> GreyImage:
    """Lay the layer over a background and return the picture in the background's own type.

    Pixels that the layer does not touch keep their value to the bit.
    """
    top = np.iinfo(background.dtype).max
    picture = background.copy()
    part = picture[_covered(layer)]
    part[...] = np.clip(np.rint(blend(background, layer)), 0, top)
    return picture


def blend(background: GreyImage, layer: Layer) -> NDArray[np.float64]:
    """Return the (h, w) grey levels of the layer's crop over the background, before rounding."""
    ground = background[_covered(layer)]
    return np.asarray(layer.grey.astype(np.float64) + (1 - layer.alpha.astype(np.float64)) * ground)


def _covered(layer: Layer) -> tuple[slice, slice]:
    """Return the rows and columns of the frame that the layer covers."""
    x0, y0 = layer.offset_xy
    rows, columns = layer.alpha.shape
    return slice(y0, y0 + rows), slice(x0, x0 + columns)
