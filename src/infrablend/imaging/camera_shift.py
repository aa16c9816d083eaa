"""The movement of the background from one picture to another: corners, followed there and back, and a model of them.

Corners are followed by the pyramidal method of Lucas and Kanade; the model is fitted by RANSAC, a similarity as in
BoT-SORT, or a homography where a similarity leaves out many corners that a homography fits, such as of ground seen at
a slant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Points = NDArray[np.float32]
"""(n, 2) px, columns first."""

# Corners of the background that are followed, their least quality relative to the best, and how far apart they are.
_CORNERS = 400
_QUALITY = 0.01
_APART_PX = 7
# The picture has so many cells in a row and a column, each with at most so many: a flock must not outvote the rest.
_CELLS = 8
_IN_CELL = 12
# Halvings of the picture from which following begins.
_LEVELS = 4
# By how many px going there and back may miss.
_LOOP_PX = 0.7
# Half the window in which a corner is followed: nearer to the picture's edge it is pulled inwards.
_EDGE_PX = 11
# From such a change of direction or size on (its largest element), one picture is turned before corners are followed.
_TURNED = 0.03
# A model fits corners that it misses by at most this, px ...
_FIT_PX = 1.0
# ... and has to fit this number and this share of the followed ones.
LEAST_CORNERS = 12
_LEAST_SHARE = 0.5
# Features of a picture, their least contrast, how much nearer a match has to be than the second best, and by how much
# a model may miss it, px.
_FEATURES = 1500
_CONTRAST = 0.02
_RATIO = 0.8
_MATCH_PX = 3.0
# Errors that all corners share, px.
_BIAS_PX = 0.015
# Change of size beyond which a model is no movement of a camera.
_MOST_ZOOM = 0.25
# A homography has to fit at least so many corners, and so many times as many as the similarity.
_LEAST_FOR_HOMOGRAPHY = 40
_BETTER = 1.15
# Pixels compared for gain and offset: every so many px, smoothed over so many.
_STRIDE_PX = 4
_SMOOTH_PX = 2.0
# Levels that differ by less show no gain ...
_FLAT_LEVELS = 4.0
# ... nor do levels that correlate less.
_ALIKE = 0.8


@dataclass(frozen=True, eq=False)
class View:
    """A picture of a sequence.

    Attributes:
        grey: (h, w) 8-bit levels.
        blocked: (h, w) what is no background: labelled objects, text, reticle.
    """

    grey: NDArray[np.uint8]
    blocked: NDArray[np.bool_]

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height, px."""
        height, width = self.grey.shape
        return width, height

    @cached_property
    def corners(self) -> Points:
        """Corners of the background; none in plain sky."""
        return find_corners(self)

    @cached_property
    def features(self) -> tuple[Points, NDArray[np.uint8]]:
        """(n, 2) pixels and (n, 128) descriptors of what stands out; they are whole numbers."""
        finder = cv2.SIFT.create(nfeatures=_FEATURES, contrastThreshold=_CONTRAST)
        points, descriptors = finder.detectAndCompute(self.grey, (~self.blocked).astype(np.uint8))
        if descriptors is None:
            return np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8)
        return np.array([p.pt for p in points], np.float32), np.asarray(descriptors, np.uint8)

    @cached_property
    def smooth(self) -> NDArray[np.float32]:
        """(h, w) levels without grain."""
        return np.asarray(cv2.GaussianBlur(self.grey.astype(np.float32), (0, 0), _SMOOTH_PX))


@dataclass(frozen=True, eq=False)
class Shift:
    """Movement of the background from one view to another.

    Attributes:
        matrix: (3, 3) from pixels of the first view to those of the second.
        corners: Number of corners that could be followed.
        fitting: Number of those that fit.
        residual_px: Median distance of these from where the matrix puts them.
        error_px: Standard error of the matrix at the worst corner of the picture, from those distances.
    """

    matrix: Matrix
    corners: int
    fitting: int
    residual_px: float
    error_px: float


def find_corners(view: View, most: int = _CORNERS, apart_px: float = _APART_PX) -> Points:
    """Return corners of the background of a view, the clearest first."""
    free = (~view.blocked).astype(np.uint8)
    found = cv2.goodFeaturesToTrack(view.grey, 4 * most, _QUALITY, apart_px, mask=free)
    if found is None:
        return np.zeros((0, 2), np.float32)
    points = np.asarray(found[:, 0], np.float32)
    column, row = (np.asarray(points[:, k] * _CELLS / n, int) for k, n in enumerate(view.size_wh))
    cell = row * _CELLS + column
    taken = np.zeros(_CELLS**2, int)
    keep = []
    for k, c in enumerate(cell.tolist()):
        if taken[c] < _IN_CELL:
            taken[c] += 1
            keep.append(k)
    return points[keep[:most]]


def follow(first: View, second: View, corners: Points, guess: Matrix) -> tuple[Points, NDArray[np.bool_]]:
    """Return where corners of one view are in another, and which of them are certain.

    Args:
        first: View with the corners.
        second: Other view.
        corners: (n, 2) px in the first view.
        guess: (3, 3) about the movement between the views.
    """
    begin = corners[:, None]
    expected = moved(corners, guess)[:, None].astype(np.float32)
    start = cv2.OPTFLOW_USE_INITIAL_FLOW
    pair = (first.grey, second.grey)
    there, seen, _ = cv2.calcOpticalFlowPyrLK(*pair, begin, expected.copy(), maxLevel=_LEVELS, flags=start)
    home = (there + begin - expected).astype(np.float32)
    back, again, _ = cv2.calcOpticalFlowPyrLK(*pair[::-1], there, home, maxLevel=_LEVELS, flags=start)
    end = there[:, 0]
    width, height = second.size_wh
    inside = (
        (np.minimum(end, corners) >= _EDGE_PX) & (np.maximum(end, corners) < (width - _EDGE_PX, height - _EDGE_PX))
    ).all(axis=1)
    column, row = (np.clip(end[:, k].astype(int), 0, n - 1) for k, n in ((0, width), (1, height)))
    certain = (seen[:, 0] * again[:, 0] > 0) & (np.abs(back - begin)[:, 0].max(axis=1) < _LOOP_PX)
    return np.asarray(end, np.float32), inside & certain & ~second.blocked[row, column]


def find_shift(first: View, second: View, guess: Matrix) -> Shift | None:
    """Return the movement from one view to another; None if the background does not show it with certainty."""
    if len(first.corners) < LEAST_CORNERS:
        return None
    if np.abs(guess[:2, :2] - np.eye(2)).max() < _TURNED:
        return _shift(first, second, guess) or _shift(first, _levelled(second, first), guess)
    seen = _seen_from(second, guess, first.size_wh)
    found = _shift(first, seen, np.eye(3)) or _shift(first, _levelled(seen, first), np.eye(3))
    return None if found is None else replace(found, matrix=_scaled(guess @ found.matrix))


def match_features(first: View, second: View) -> Shift | None:
    """Return the movement between two views without knowing it about, by features; None if it is not certain."""
    (begin, of_begin), (end, of_end) = first.features, second.features
    if min(len(begin), len(end)) < LEAST_CORNERS:
        return None
    near = cv2.BFMatcher().knnMatch(of_begin.astype(np.float32), of_end.astype(np.float32), k=2)
    pairs = [m for m, other in near if m.distance < _RATIO * other.distance]
    if len(pairs) < LEAST_CORNERS:
        return None
    a, b = begin[[m.queryIdx for m in pairs]], end[[m.trainIdx for m in pairs]]
    found, fitting = cv2.estimateAffinePartial2D(a, b, ransacReprojThreshold=_MATCH_PX, refineIters=20)
    if (
        found is None
        or fitting.sum() < LEAST_CORNERS
        or abs(np.sqrt(abs(np.linalg.det(found[:, :2]))) - 1) > _MOST_ZOOM
    ):
        return None
    matrix = np.vstack([found, [0, 0, 1]]).astype(np.float64)
    # Corners that are followed tell it more exactly, if they can be.
    if (shift := find_shift(first, second, matrix)) is not None:
        return shift
    fits = fitting[:, 0] > 0
    apart = np.linalg.norm(moved(a[fits], matrix) - b[fits], axis=1)
    error = matrix_error(a[fits], apart, first.size_wh)
    return Shift(matrix, len(pairs), int(fits.sum()), float(np.median(apart)), error)


def _seen_from(view: View, matrix: Matrix, size_wh: tuple[int, int]) -> View:
    """Return a view as a camera sees it from which `matrix` leads to it: what surrounds a corner looks alike."""
    back = cv2.WARP_INVERSE_MAP
    grey = cv2.warpPerspective(view.grey, matrix, size_wh, flags=cv2.INTER_CUBIC | back, borderMode=cv2.BORDER_REFLECT)
    taken = cv2.warpPerspective(
        view.blocked.astype(np.uint8), matrix, size_wh, flags=cv2.INTER_NEAREST | back, borderValue=2
    )
    beyond = cv2.dilate((taken == 2).astype(np.uint8), np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8)) > 0
    return View(np.asarray(grey, np.uint8), beyond | (taken == 1))


def _scaled(matrix: Matrix) -> Matrix:
    return np.asarray(matrix / matrix[2, 2], np.float64)


def _shift(first: View, second: View, guess: Matrix) -> Shift | None:
    end, certain = follow(first, second, first.corners, guess)
    begin, end = first.corners[certain], end[certain]
    if len(begin) < LEAST_CORNERS:
        return None
    matrix, fits = _model(begin, end)
    if matrix is None or fits.sum() < max(LEAST_CORNERS, _LEAST_SHARE * len(begin)):
        return None
    if abs(float(np.sqrt(abs(np.linalg.det(matrix[:2, :2])))) - 1) > _MOST_ZOOM:
        return None
    apart = np.linalg.norm(moved(begin[fits], matrix) - end[fits], axis=1)
    error = matrix_error(begin[fits], apart, first.size_wh)
    return Shift(matrix, len(begin), int(fits.sum()), float(np.median(apart)), error)


def _levelled(view: View, like: View) -> View:
    """Return a view with the mean level and the contrast of another one: corners are followed at equal levels only."""
    here, there = (v.grey[~v.blocked].astype(np.float32) for v in (view, like))
    if not (here.size and there.size):
        return view
    gain = float(there.std() / max(float(here.std()), 1.0))
    levels = (view.grey - here.mean()) * gain + there.mean()
    return View(np.clip(np.rint(levels), 0, 255).astype(np.uint8), view.blocked)


def moved(points: NDArray[np.floating], matrix: Matrix) -> NDArray[np.float64]:
    """Return points (n, 2) where a matrix (3, 3) puts them."""
    if not len(points):
        return np.zeros((0, 2))
    return np.asarray(cv2.perspectiveTransform(points[None].astype(np.float64), matrix)[0])


def _model(begin: Points, end: Points) -> tuple[Matrix | None, NDArray[np.bool_]]:
    similar, fits = cv2.estimateAffinePartial2D(begin, end, ransacReprojThreshold=_FIT_PX, refineIters=20)
    none = np.zeros(len(begin), np.bool_)
    kept = none if similar is None else fits[:, 0] > 0
    if len(begin) >= _LEAST_FOR_HOMOGRAPHY and kept.sum() < len(begin) / _BETTER:
        found, fits = cv2.findHomography(begin, end, cv2.RANSAC, _FIT_PX)
        if found is not None and fits.sum() >= max(_LEAST_FOR_HOMOGRAPHY, _BETTER * kept.sum()):
            return np.asarray(found / found[2, 2], np.float64), fits[:, 0] > 0
    if similar is None:
        return None, none
    return np.vstack([similar, [0, 0, 1]]).astype(np.float64), kept


def matrix_error(begin: Points, apart: NDArray[np.float64], size_wh: tuple[int, int]) -> float:
    """Return the standard error of a similarity at the picture's corner farthest from the points it was fitted to."""
    n = len(begin)
    middle = begin.mean(axis=0)
    spread = float(((begin - middle) ** 2).sum())
    ends = np.array([(x, y) for x in (0, size_wh[0]) for y in (0, size_wh[1])], np.float64)
    farthest = float(((ends - middle) ** 2).sum(axis=1).max())
    variance = float((apart**2).sum()) / max(2 * n - 4, 1)  # of one coordinate
    return float(np.sqrt(2 * variance * (1 / n + farthest / max(spread, 1e-9)) + _BIAS_PX**2))


def find_levels(first: View, second: View, matrix: Matrix) -> tuple[float, float]:
    """Return gain and offset from the levels of one view to those of another, from the background that both show.

    `matrix` is that of the shift between them.
    """
    back = cv2.WARP_INVERSE_MAP
    there = cv2.warpPerspective(second.smooth, matrix, first.size_wh, flags=cv2.INTER_CUBIC | back)
    taken = cv2.warpPerspective(
        second.blocked.astype(np.uint8),
        matrix,
        first.size_wh,
        flags=cv2.INTER_NEAREST | back,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=1,
    )
    every = np.s_[::_STRIDE_PX, ::_STRIDE_PX]
    free = ((taken == 0) & ~first.blocked)[every]
    # Clipped pixels say nothing of either.
    x, y = first.smooth[every][free], there[every][free]
    inner = (x > 1) & (x < 254) & (y > 1) & (y < 254)
    x, y = x[inner], y[inner]
    if len(x) < LEAST_CORNERS:
        return 1.0, 0.0
    gain = 1.0
    keep = np.ones(len(x), np.bool_)
    for _ in range(3):  # least squares without what does not fit, such as what moves
        if np.ptp(np.percentile(x[keep], (5, 95))) >= _FLAT_LEVELS:
            gain = _slope(x[keep], y[keep])
        offset = float(np.median(y[keep] - gain * x[keep]))
        apart = np.abs(y - gain * x - offset)
        keep = apart <= max(3 * float(np.median(apart[keep])), 1.0)
    return gain, offset


def _slope(x: NDArray[np.float32], y: NDArray[np.float32]) -> float:
    """Return the ratio of the spreads: unlike that of least squares, noise in both does not make it smaller."""
    alike = float(np.corrcoef(x, y)[0, 1])
    return float(y.std() / x.std()) if alike >= _ALIKE else 1.0
