"""Tracks through the pictures of a sequence, from detections on them, by Ultralytics' trackers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, corners_of_cxcywha, cxcywha_of_corners
from infrablend.core.dataset import ImageRecord
from infrablend.detection.detections import Detections
from infrablend.detection.ultralytics_environment import quiet_ultralytics, require_ultralytics
from infrablend.errors import MissingDependencyError
from infrablend.formats.pictures.images import load_background

Tracker = Literal["bytetrack", "botsort"]


def require_trackers(*further: str) -> None:
    """Raise MissingDependencyError with the command to run if Ultralytics, lap or a further package is missing."""
    require_ultralytics()
    missing = [name for name in ("lap", *further) if find_spec(name) is None]
    if missing:
        raise MissingDependencyError(
            f"{' and '.join(missing)} not installed, which tracks need; install with\n"
            '  pip install "infrablend[train,tracks]"\n'
            "which needs NumPy 2.3.2 or later (in a checkout: make train)"
        )


def tracker_settings(tracker: Tracker) -> dict[str, object]:
    """Return Ultralytics' default settings of a tracker."""
    with quiet_ultralytics():
        from ultralytics.utils import ROOT, YAML

        return dict(YAML.load(ROOT / "cfg" / "trackers" / f"{tracker}.yaml"))


def follow(
    images: Sequence[ImageRecord], found: Sequence[Detections], settings: Mapping[str, object]
) -> list[tuple[Detections, NDArray[np.int64]]]:
    """Return what a new tracker makes of the detections on each picture of a sequence: boxes, and ids of the tracks.

    As in Ultralytics' own tracking, a box has one class, the one with the highest score, and tracks may change their
    class. Places are those of the tracker, masks those of the detector.

    Args:
        images: Pictures in order; only BoT-SORT reads them, for the motion of the camera.
        found: Detections on each picture.
        settings: Settings from `tracker_settings`.
    """
    return [(tracked, ids) for tracked, ids, _ in _followed(images, found, settings)]


def track_ids(
    images: Sequence[ImageRecord], found: Sequence[Detections], settings: Mapping[str, object]
) -> list[dict[int, int]]:
    """Return the id of the track of each detection on each picture, by its number; see `follow`."""
    return [dict(zip(of.tolist(), ids.tolist(), strict=True)) for _, ids, of in _followed(images, found, settings)]


_Followed = tuple[Detections, NDArray[np.int64], NDArray[np.int64]]
"""Detections on a picture at the places of the tracker, ids of their tracks, and their numbers among all."""


def _followed(
    images: Sequence[ImageRecord], found: Sequence[Detections], settings: Mapping[str, object]
) -> list[_Followed]:
    with quiet_ultralytics():
        from ultralytics.trackers.track import TRACKER_MAP
        from ultralytics.utils import IterableSimpleNamespace

        tracker = TRACKER_MAP[settings["tracker_type"]](IterableSimpleNamespace(**settings))
        looks = settings["tracker_type"] == "botsort"
        return [_update(tracker, of, _grey(image) if looks else None) for image, of in zip(images, found, strict=True)]


def _update(tracker: Any, found: Detections, picture: NDArray[np.uint8] | None) -> _Followed:
    from ultralytics.engine.results import OBB, Boxes

    turned = found.corners_xy is not None
    places = found.boxes_xyxy if found.corners_xy is None else cxcywha_of_corners(found.corners_xy)
    _, first = np.unique(places, axis=0, return_index=True)  # the detector lists a box once per class, best score first
    named = found.take(np.sort(first))
    rows = np.column_stack([places[np.sort(first)], named.scores, named.classes])
    # The size of the picture, here 1, is for relative coordinates, which trackers do not use.
    said = tracker.update((OBB if turned else Boxes)(rows, (1, 1)), picture).reshape(-1, 9 if turned else 8)
    numbers = np.sort(first)[said[:, -1].astype(np.int64)]
    tracked = found.take(numbers)
    ids = said[:, -4].astype(np.int64)
    if not turned:
        return replace(tracked, boxes_xyxy=said[:, :4].astype(np.float64)), ids, numbers
    corners = corners_of_cxcywha(said[:, :5].astype(np.float64))
    boxes = np.array([box_of_points(c) for c in corners], np.float64).reshape(-1, 4)
    return replace(tracked, boxes_xyxy=boxes, corners_xy=corners), ids, numbers


def _grey(image: ImageRecord) -> NDArray[np.uint8]:
    pixels: Any = load_background(image.path, image.size_wh).pixels
    if pixels.dtype != np.uint8:
        pixels = cv2.normalize(pixels, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)
    return np.asarray(pixels[..., None])
