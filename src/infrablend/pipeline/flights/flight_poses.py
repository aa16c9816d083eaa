"""The poses of a flight's pictures, and what the others lack for one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame, Pose, PoseErrors, pose_of
from infrablend.detection.truth import image_key

# Pictures farther apart than this are on maps of their own: there, a plane is no longer the earth.
_SAME_MAP_M = 20_000.0


@dataclass(frozen=True, eq=False)
class FlightPoses:
    """Poses of the pictures of a flight, by `<split>/<name>`.

    Attributes:
        known: Pose of each picture.
        frames: Frame in which its metres are.
        lacking: What the other pictures lack for one.
    """

    known: Mapping[str, Pose]
    frames: Mapping[str, LocalFrame]
    lacking: Mapping[str, str]


def find_poses(images: Sequence[ImageRecord], errors: PoseErrors | None = None) -> FlightPoses:
    """Return the poses of pictures that state all that is needed, with standard errors replaced where given."""
    known: dict[str, Pose] = {}
    frames: dict[str, LocalFrame] = {}
    lacking: dict[str, str] = {}
    origins: list[LocalFrame] = []
    for image in images:
        key = image_key(image)
        pose = pose_of(image, errors)
        if isinstance(pose, str):
            lacking[key] = pose
            continue
        place = pose.latitude_deg, pose.longitude_deg
        near = [o for o in origins if np.linalg.norm(o.to_metres(*place)) <= _SAME_MAP_M]
        if not near:
            origins += (near := [LocalFrame(*place)])
        known[key], frames[key] = pose, near[0]
    return FlightPoses(known, frames, lacking)
