"""Objects that stay at their place through the pictures of a flight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infrablend.core.capture import Capture
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.ground_position import LocalFrame, ground_of_pixels, pixels_of_ground, pose_of
from infrablend.imaging.camera_shift import moved
from infrablend.pipeline.flights.flight_looks import as_flights, motion_by_pose

HOME = LocalFrame(48.0, 11.0)


def picture(k: int, north: float, pitch: float = 90.0, yaw: float = 0.0) -> ImageRecord:
    latitude, longitude = HOME.to_degrees(3.0 * k, north).tolist()
    capture = Capture(
        pitch_deg=pitch, altitude_m=50.0, hfov_deg=46.2, latitude_deg=latitude, longitude_deg=longitude, yaw_deg=yaw,
        captured=f"2026-05-01T10:00:{k:02}",
    )  # fmt: skip
    return ImageRecord(f"p{k}", Path(f"p{k}.png"), "train", (640, 512), (), capture)


def flight(*images: ImageRecord) -> Dataset:
    return Dataset(Path("flight"), "folder", (), images)


def test_overlapping_pictures_are_numbered_by_their_capture() -> None:
    images = [picture(k, 8.0 * k) for k in range(5)]
    found = as_flights(flight(*images[::-1]))
    assert found is not None
    assert [(i.id, i.capture.frame) for i in found.images] == [(f"p{k}", k) for k in range(5)]
    assert {i.capture.sequence for i in found.images} == {"flight part 1"}


@pytest.mark.parametrize("why", ["apart", "no pose", "clip", "single"])
def test_other_pictures_are_no_flight(why: str) -> None:
    images = [picture(k, (80.0 if why == "apart" else 8.0) * k) for k in range(5)]
    if why == "no pose":
        images[2] = replace(images[2], capture=replace(images[2].capture, latitude_deg=None))
    if why == "clip":
        images = [replace(i, capture=replace(i.capture, sequence="clip", frame=k)) for k, i in enumerate(images)]
    assert as_flights(flight(*images[: 1 if why == "single" else 5])) is None


@pytest.mark.parametrize("pitch", [90.0, 50.0])
def test_places_of_the_ground_stay_at_their_place(pitch: float) -> None:
    images = [picture(k, 8.0 * k, pitch, 20.0 * k) for k in range(4)]
    motion = motion_by_pose("flight", images)
    poses = [pose_of(i) for i in images]
    first, last = poses[0], poses[3]
    assert not isinstance(first, str)
    assert not isinstance(last, str)
    xy = np.array([[320.0, 400.0], [100.0, 300.0], [600.0, 500.0]])
    expected = pixels_of_ground(first, HOME, ground_of_pixels(last, HOME, xy))
    # The planes of two local frames some metres apart differ by less than a hundredth of a pixel.
    assert moved(xy, motion.moments[3].to_first) == pytest.approx(expected, abs=0.05)
