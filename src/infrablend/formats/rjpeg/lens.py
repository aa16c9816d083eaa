"""Field of view of a picture across its width, from what its file states about the lens.

Cameras state the focal length of the 35 mm camera with the same **diagonal** field of view, as EXIF asks: 9.1 mm on
640x512 pixels of 12 um are 40 mm (diagonal), not 43 mm (width). Digital zoom cuts the picture's edges off: the picture
beside an untouched raw layer is enlarged by it.
"""

from __future__ import annotations

import math

_DIAGONAL_35MM = math.hypot(36.0, 24.0)

# Pitch of the pixels, micrometres, where the file states neither a field of view nor a 35 mm equivalent: the FLIR core
# inside the XT2. Maker and model as in EXIF, and the size of the picture in pixels.
PIXEL_PITCH_UM = {("DJI", "FLIR", (640, 512)): 17.0, ("DJI", "FLIR", (336, 256)): 17.0}


def fov_of_35mm(focal_length_35mm: float, size_wh: tuple[int, int]) -> float:
    """Return the horizontal field of view, degrees, of a 35 mm equivalent focal length in mm."""
    width_mm = _DIAGONAL_35MM * size_wh[0] / math.hypot(*size_wh)
    return fov_of_width(width_mm, focal_length_35mm)


def fov_of_width(width: float, focal_length: float) -> float:
    """Return the field of view, degrees, across a width in the unit of the focal length."""
    return math.degrees(2 * math.atan(width / 2 / focal_length))


def zoomed(hfov_deg: float, zoom: float) -> float:
    """Return the field of view, degrees, that is left of one by digital zoom."""
    return math.degrees(2 * math.atan(math.tan(math.radians(hfov_deg) / 2) / zoom))
