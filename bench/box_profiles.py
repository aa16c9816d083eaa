"""Measure the levels from the top to the bottom of the boxes of cold objects, over the ground.

`bench/box_profiles.py DATA... [--category Car] [--split train] [--time night]` prints, per dataset, range of pitch and
shape (broad: wider than 1.3 times the height), the median level over the ring around the box at heights from 0 (top) to
1 (bottom), averaged over the middle two fifths of the width. Only boxes inside the picture count, whose middle is at
least 12 levels darker than the ring. A box that reaches below what is visible has the level of the ground there.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from data_options import data_parser
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord
from infrablend.formats.detection import read
from infrablend.realism.contrasts import object_contrast

PITCH_BELOW_DEG = (35.0, 55.0, 75.0, np.inf)
HEIGHTS = np.linspace(-0.1, 1.1, 13)
ALONG = np.linspace(0.3, 0.7, 9)
MIDDLE = (HEIGHTS > 0.25) & (HEIGHTS < 0.75)
LEAST_GREY = 12.0
LEAST_PX, CLEAR_PX = 16.0, 8.0
BROAD = 1.3
LEAST_BOXES = 8


def main() -> None:
    """Print a line per dataset, range of pitch and shape."""
    parser = data_parser(__doc__)
    parser.add_argument("--time", default="night", choices=("day", "night"))
    options = parser.parse_args()
    print(f"height in the box: {HEIGHTS.round(1).tolist()}")
    for data in options.data:
        images = [i for i in read(data).images if i.split == options.split and i.capture.time_of_day == options.time]
        rows = np.array([row for image in images for row in profiles(image, options.category)])
        rows = rows.reshape(-1, 2 + len(HEIGHTS))
        low = 0.0
        for high in PITCH_BELOW_DEG:
            for broad in (True, False):
                of = rows[(rows[:, 0] >= low) & (rows[:, 0] < high) & ((rows[:, 1] > BROAD) == broad)]
                if len(of) >= LEAST_BOXES:
                    levels = np.median(of[:, 2:], axis=0).round().astype(int).tolist()
                    shape = "broad" if broad else "tall"
                    print(f"{data}, pitch {low:g} to {high:g}, {shape}, {len(of)} boxes: {levels}")
            low = high


def profiles(image: ImageRecord, category: str) -> Iterator[list[float]]:
    """Yield the pitch, the width over the height and the levels over the ring, per cold object of a picture."""
    own = [i for i in image.instances if i.category == category]
    if not own:
        return
    picture: NDArray[np.float32] = np.asarray(cv2.imread(str(image.path), cv2.IMREAD_GRAYSCALE), np.float32)
    h, w = picture.shape
    for instance in own:
        x0, y0, x1, y1 = instance.box_xyxy.tolist()
        inside = min(x0, y0, w - x1, h - y1) >= CLEAR_PX and y1 - y0 >= LEAST_PX
        contrast = object_contrast(picture, instance, image.instances) if inside else None
        if contrast is None:
            continue
        x, y = np.meshgrid(x0 + ALONG * (x1 - x0) - 0.5, y0 + HEIGHTS * (y1 - y0) - 0.5)
        grey = cv2.remap(picture, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        levels = grey.mean(axis=1) - contrast.ring
        if levels[MIDDLE].mean() <= -LEAST_GREY:
            yield [image.capture.pitch_deg or 0.0, (x1 - x0) / (y1 - y0), *levels.tolist()]


if __name__ == "__main__":
    main()
