"""Binary masks, run-length encoded as COCO does, and polygons made of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as _coco


@dataclass(frozen=True)
class Mask:
    """A binary mask of a whole image: COCO's compressed run lengths (column-major) and the image's size."""

    counts: str
    size_hw: tuple[int, int]

    @classmethod
    def from_array(cls, mask: NDArray[np.bool_]) -> Mask:
        """Encode a (h, w) boolean array."""
        rle = _coco.encode(np.asfortranarray(mask, np.uint8))
        return cls(rle["counts"].decode("ascii"), (int(mask.shape[0]), int(mask.shape[1])))

    def to_array(self) -> NDArray[np.bool_]:
        """The mask as (h, w) bool."""
        return np.asarray(_coco.decode(self.to_coco()), np.bool_)

    def to_coco(self) -> dict[str, object]:
        """COCO's form: `{"size": [h, w], "counts": "..."}`."""
        return {"size": list(self.size_hw), "counts": self.counts}

    @property
    def area_px(self) -> int:
        """Number of pixels set."""
        return int(_coco.area(self.to_coco()))
