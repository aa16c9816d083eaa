"""Polygon overlap by exact clipping, for checks."""

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import clip_convex, polygon_area


def polygon_iou(a_xy: NDArray[np.float64], b_xy: NDArray[np.float64]) -> float:
    """Return the intersection over union of convex polygons (N, 2) and (M, 2), clockwise; 0 if both are empty."""
    both = polygon_area(clip_convex(a_xy, b_xy))
    union = polygon_area(a_xy) + polygon_area(b_xy) - both
    return both / union if union > 0 else 0.0
