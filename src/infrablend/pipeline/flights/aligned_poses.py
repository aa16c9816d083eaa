"""Poses of a flight, corrected by the overlap of its pictures."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from infrablend.core.camera import STRAIGHT_DOWN_DEG
from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame, Pose, StatedError
from infrablend.detection.truth import image_key
from infrablend.errors import Problem
from infrablend.imaging.overlap import MOST_TILT_DEG, Overlap, Place, fit_overlap, shorter_side
from infrablend.pipeline.flights.flight_poses import FlightPoses
from infrablend.pipeline.studies.flight_overlap import flight_order, link_pictures, spread_rows

# Fewer pictures have no overlap to speak of.
_LEAST = 4
# Standard errors of a picture relative to others of its flight: of its position, by satellites or joined to them by
# overlap; its yaw, pitch and roll.
_APART_M = 1.0
_JOINED_M = 0.15
_TURN_DEG = 0.5
_TILT_DEG = 0.2


@dataclass(frozen=True, eq=False)
class AlignedPoses:
    """Poses of a flight's pictures.

    Attributes:
        poses: Poses, with yaw and lens that overlap contradicts replaced.
        own: Poses as overlap has them, with the errors that are each picture's own: for joining what several show.
        problems: What was replaced, with both figures, or why overlap tells nothing.
    """

    poses: FlightPoses
    own: FlightPoses
    problems: Sequence[Problem]


def align_poses(where: str, images: Sequence[ImageRecord], poses: FlightPoses, shown: Collection[str]) -> AlignedPoses:
    """Return the poses of a flight, corrected by the overlap of its pictures where these look straight down.

    Args:
        where: Name of the data, for problems.
        images: The pictures.
        poses: Their poses, as stated.
        shown: `<split>/<name>` of pictures that show what is to be joined: these, and some others, are compared.
    """
    groups: dict[tuple[LocalFrame, tuple[int, int]], list[ImageRecord]] = defaultdict(list)
    for image in sorted(images, key=flight_order):
        pose = poses.known.get(image_key(image))
        if pose is not None and abs(STRAIGHT_DOWN_DEG - pose.pitch_deg) <= MOST_TILT_DEG:
            groups[poses.frames[image_key(image)], pose.size_wh].append(image)
    known = dict(poses.known)
    own = {key: _own(pose) for key, pose in known.items()}
    problems = []
    for (frame, size_wh), of_group in groups.items():
        keys = [image_key(i) for i in of_group]
        stated = [known[k] for k in keys]
        places = [_place(p, frame) for p in stated]
        lens = float(np.median([p.hfov_deg for p in stated]))
        rows = spread_rows(places, shorter_side(size_wh, lens))
        chosen = sorted({*rows, *(n for n, key in enumerate(keys) if key in shown)})
        if len(chosen) < _LEAST:
            continue
        at = [places[n] for n in chosen]
        found = fit_overlap(at, link_pictures([of_group[n] for n in chosen], at, lens), size_wh)
        if isinstance(found, str):
            expected = "pictures that show much of the same ground"
            problems.append(Problem(where, "no-overlap", found, expected, "poses stay as stated", "warning"))
            continue
        tracked = {chosen[n]: place for n, place in found.track.items()}
        for number, (key, pose) in enumerate(zip(keys, stated, strict=True)):
            own[key] = _joined(pose, found, frame, tracked.get(number))
        changes, texts = _contradicted(found, stated, size_wh[0])
        known.update((key, _changed(pose, changes)) for key, pose in zip(keys, stated, strict=True))
        expected = f"what overlap says ({found.pictures} pictures, {found.links} pairs)"
        problems += [Problem(where, "pose-corrected", t, expected, "replaced", "warning") for t in texts]
    return AlignedPoses(replace(poses, known=known), replace(poses, known=own), problems)


@dataclass(frozen=True)
class _Changes:
    """What overlap puts in the place of stated values; None keeps them.

    Attributes:
        yaw_error_deg: By how much yaws are too large.
        yaw_sigma_deg: Standard error of that.
        hfov_deg: Field of view.
        hfov_share: Standard error of that, as a share of it.
    """

    yaw_error_deg: float | None
    yaw_sigma_deg: float
    hfov_deg: float | None
    hfov_share: float


def _contradicted(found: Overlap, stated: Sequence[Pose], width: int) -> tuple[_Changes, list[str]]:
    """Return what overlap contradicts, beyond an interval of 95 %, and both figures in words."""
    texts = []
    yaw = found.yaw_error_deg
    half = found.wide * found.yaw_sigma_deg
    turned = abs(yaw) > half
    if turned:
        words = "too large" if yaw > 0 else "too small"
        texts.append(f"yaws of {len(stated)} pictures are {abs(yaw):.1f} +- {half:.1f} degrees {words}")
    lens = float(np.median([p.hfov_deg for p in stated]))
    height = float(np.median([p.errors["height_m"].value for p in stated]))
    seen = found.hfov_deg(width)
    half = found.wide * found.hfov_sigma_deg(width, height)
    other = abs(lens - seen) > half
    if other:
        texts.append(f"a field of view of {lens:.1f} degrees, where overlap shows {seen:.1f} +- {half:.1f}")
    share = found.hfov_sigma_deg(width, height) / seen
    changes = _Changes(yaw if turned else None, found.yaw_sigma_deg, seen if other else None, share)
    return changes, texts


def _changed(pose: Pose, changes: _Changes) -> Pose:
    errors = dict(pose.errors)
    if changes.yaw_error_deg is not None:
        errors["yaw_deg"] = StatedError(math.hypot(changes.yaw_sigma_deg, _TURN_DEG), "overlap of pictures")
        pose = replace(pose, yaw_deg=pose.yaw_deg - changes.yaw_error_deg)
    if changes.hfov_deg is not None:
        errors["hfov_share"] = StatedError(changes.hfov_share, "overlap of pictures")
        pose = replace(pose, hfov_deg=changes.hfov_deg)
    return replace(pose, errors=errors)


def _place(pose: Pose, frame: LocalFrame) -> Place:
    east, north = frame.to_metres(pose.latitude_deg, pose.longitude_deg).tolist()
    # Straight down, a roll only turns the picture.
    return Place(east, north, pose.yaw_deg + pose.roll_deg, pose.height_m, STRAIGHT_DOWN_DEG - pose.pitch_deg)


def _own(pose: Pose) -> Pose:
    """Return a pose with the errors that differ from picture to picture, or move places in different directions."""
    return _with_errors(pose, {"position_m": _APART_M})


def _joined(pose: Pose, found: Overlap, frame: LocalFrame, at: complex | None) -> Pose:
    """Return a pose as overlap has it, which knows the ground pixel, not lens and height apart."""
    errors = {"height_m": 0.0, "hfov_share": found.pixel_sigma, "pitch_deg": _TILT_DEG, "roll_deg": _TILT_DEG}
    errors["yaw_deg"] = math.hypot(found.yaw_sigma_deg, _TURN_DEG)
    errors["position_m"] = _APART_M if at is None else _JOINED_M
    if at is not None:
        latitude, longitude = frame.to_degrees(at.real, at.imag).tolist()
        pose = replace(pose, latitude_deg=latitude, longitude_deg=longitude)
    lens = found.hfov_deg(pose.size_wh[0])
    return _with_errors(replace(pose, yaw_deg=pose.yaw_deg - found.yaw_error_deg, hfov_deg=lens), errors)


def _with_errors(pose: Pose, errors: Mapping[str, float]) -> Pose:
    own = {name: StatedError(value, "relative to other pictures") for name, value in errors.items()}
    return replace(pose, errors={**pose.errors, **own})
