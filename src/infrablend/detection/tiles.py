"""Object-centred tiles cut from pictures at native resolution, so that a person of 15 px keeps its size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import clip_boxes, clip_convex, corners_of_box, smallest_rectangle_inside
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.files import replace_atomically
from infrablend.core.rle_masks import Mask
from infrablend.core.rng import stream
from infrablend.formats.pictures.images import load_background

# Least share of a box inside a tile for the label to be kept; every object is whole in at least one tile.
MIN_SHARE = 0.25
# Margin around the object that a tile is cut for, px, as far as the picture has it.
MARGIN_PX = 4
PAD_GREY = 114  # what Ultralytics pads with


@dataclass(frozen=True)
class Tile:
    """Window of a picture.

    Attributes:
        image: Record of the picture.
        origin_xy: Upper left corner of the window in the picture, px.
        span_px: Side of the window in the picture's pixels; larger than `side_px` for an object larger than a tile.
        side_px: Side of the written tile, px.
    """

    image: ImageRecord
    origin_xy: tuple[int, int]
    span_px: int
    side_px: int

    @property
    def scale(self) -> float:
        """Tile pixels per picture pixel; 1 at native resolution."""
        return self.side_px / self.span_px

    def crop(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the (side, side) pixels of the tile, padded beyond the picture."""
        x, y = self.origin_xy
        part = pixels[y : y + self.span_px, x : x + self.span_px]
        whole = np.full((self.span_px, self.span_px), PAD_GREY, np.uint8)
        whole[: part.shape[0], : part.shape[1]] = part
        if self.span_px == self.side_px:
            return whole
        return np.asarray(cv2.resize(whole, (self.side_px, self.side_px), interpolation=cv2.INTER_AREA), np.uint8)

    def label(self, instance: Instance) -> Instance | None:
        """Return the label of an object in the tile; None if less than `MIN_SHARE` of its box is inside."""
        assert self.image.size_wh is not None
        shift = np.array(self.origin_xy, np.float64)
        # The window may extend beyond the picture; labels are clipped to the picture.
        size = np.minimum(self.span_px, np.array(self.image.size_wh) - shift)
        size_wh = (int(size[0]), int(size[1]))
        box = instance.box_xyxy - np.tile(shift, 2)
        cut = clip_boxes(box[None], size_wh)[0]
        whole = _area(box)
        seen = _area(cut)
        if seen <= 0 or seen < MIN_SHARE * whole:
            return None
        corners = instance.corners_xy
        if corners is not None:
            corners = corners - shift
            if not np.allclose(cut, box, rtol=0, atol=1e-9):
                inside = clip_convex(corners, corners_of_box(np.array([0, 0, *size_wh], np.float64)))
                if len(inside) < 3:
                    return None
                corners = smallest_rectangle_inside(inside, size_wh)
        mask = None if instance.mask is None else self._mask(instance.mask)
        truncated = True if seen < whole - 1e-9 else instance.truncated
        return replace(
            instance,
            box_xyxy=cut * self.scale,
            corners_xy=None if corners is None else corners * self.scale,
            mask=mask,
            truncated=truncated,
        )

    def _mask(self, mask: Mask) -> Mask:
        # Padding is darker than half of 255, and so belongs to no mask.
        return Mask.from_array(self.crop(np.asarray(mask.to_array() * 255, np.uint8)) > 127)


def _area(box: NDArray[np.float64]) -> float:
    return float(max(box[2] - box[0], 0) * max(box[3] - box[1], 0))


def plan_tiles(images: Sequence[ImageRecord], side_px: int, *, seed: int, most: int = 0) -> list[Tile]:
    """Return windows such that every object is whole in at least one of them.

    Each object that no window contains yet gets a new window at a random position that contains it. Objects larger than
    a tile get a larger window, which is scaled down. Pictures without objects get one window.

    Args:
        images: Pictures with known `size_wh`, without labels of categories to ignore.
        side_px: Side of a tile, px.
        seed: Seed of the training.
        most: Maximum number of tiles, evenly spread over the pictures; 0 for all.
    """
    tiles: list[Tile] = []
    for image in images:
        tiles += _tiles_of(image, side_px, seed)
    if most and len(tiles) > most:
        tiles = [tiles[i] for i in np.linspace(0, len(tiles) - 1, most).round().astype(int)]
    return tiles


def _tiles_of(image: ImageRecord, side: int, seed: int) -> list[Tile]:
    assert image.size_wh is not None
    rng = stream(seed, f"{image.split}/{image.id}", "tiles")
    size = np.array(image.size_wh, np.int64)
    boxes = [i.box_xyxy for i in image.instances]
    if not boxes:
        most = np.maximum(size - side, 0)
        x, y = (int(rng.integers(0, m + 1)) for m in most)
        return [Tile(image, (x, y), side, side)]
    tiles: list[Tile] = []
    done = [False] * len(boxes)
    for n, box in enumerate(boxes):
        if done[n]:
            continue
        frame = np.tile(size.astype(np.float64), 2)
        inner = np.clip(box, 0, frame)
        length = float(max(inner[2] - inner[0], inner[3] - inner[1]))
        needed = int(np.ceil(length)) + 2 * MARGIN_PX
        # A larger window is never larger than the picture's longer side.
        span = side if needed <= side else int(min(max(needed * 1.15, side), max(size.max(), side)))
        origin = []
        for axis in (0, 1):
            low = int(np.ceil(max(0.0, inner[axis + 2] + MARGIN_PX - span)))
            high = int(np.floor(min(inner[axis] - MARGIN_PX, float(size[axis] - span))))
            low = min(low, max(0, int(size[axis]) - span))
            origin.append(int(rng.integers(low, high + 1)) if high > low else max(0, min(low, int(size[axis]) - span)))
        tile = Tile(image, (origin[0], origin[1]), span, side)
        tiles.append(tile)
        window = np.array([*origin, origin[0] + span, origin[1] + span], np.float64)
        for k, other in enumerate(boxes):
            o = np.clip(other, 0, frame)
            whole = (o[:2] >= window[:2]).all() and (o[2:] <= window[2:]).all()
            # A window at reduced scale settles its own object, and others that are too large for a tile.
            if whole and (span == side or k == n or max(o[2] - o[0], o[3] - o[1]) + 2 * MARGIN_PX > side):
                done[k] = True
    return tiles


def write_tiles(tiles: Iterable[Tile], folder: Path) -> tuple[list[ImageRecord], Counter[str]]:
    """Write tiles as PNG files.

    Returns:
        A record per tile, and counts: `labels` (in all tiles), `labels_cut` (partly inside a tile), `labels_left_out`
        (less than `MIN_SHARE` inside, so not labelled there), `tiles_reduced` (not at native resolution).
    """
    records = []
    counts: Counter[str] = Counter({"labels": 0, "labels_cut": 0, "labels_left_out": 0, "tiles_reduced": 0})
    last: tuple[Path, NDArray[np.uint8]] | None = None
    numbers: Counter[str] = Counter()
    for tile in tiles:
        image = tile.image
        if last is None or last[0] != image.path:
            pixels = load_background(image.path, image.size_wh).pixels
            if pixels.dtype != np.uint8:  # a training refuses such pictures before it cuts tiles
                raise ValueError(f"{image.path}: found {pixels.dtype}, expected an 8-bit picture")
            last = (image.path, np.asarray(pixels, np.uint8))
        key = f"{image.split}/{image.id}"
        name = f"{image.id.replace('/', '_')}_t{numbers[key]}.png"
        numbers[key] += 1
        path = folder / image.split / name
        ok, data = cv2.imencode(".png", tile.crop(last[1]), [cv2.IMWRITE_PNG_COMPRESSION, 1])
        assert ok
        with replace_atomically(path) as temporary:
            temporary.write_bytes(data.tobytes())
        labels = []
        window = np.array([*tile.origin_xy, *tile.origin_xy], np.float64) + [0, 0, tile.span_px, tile.span_px]
        for instance in image.instances:
            label = tile.label(instance)
            if label is not None:
                labels.append(label)
                counts["labels_cut"] += bool(label.truncated and not instance.truncated)
            else:
                low = np.maximum(instance.box_xyxy[:2], window[:2])
                high = np.minimum(instance.box_xyxy[2:], window[2:])
                counts["labels_left_out"] += bool(_area(np.concatenate([low, high])) > 0)
        counts["labels"] += len(labels)
        counts["tiles_reduced"] += tile.span_px != tile.side_px
        record = replace(image, id=Path(name).stem, path=path, size_wh=(tile.side_px, tile.side_px), file_name=name)
        records.append(replace(record, instances=tuple(labels), source_id=None, extra={}))
    return records, counts
