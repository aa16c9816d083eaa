"""Cutting real objects out and pasting them: they keep their contrast, and the rest of the picture stays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from infrablend.compositing.contrast import measure_contrast
from infrablend.lab.experiments.pasting import CutOut, cut_out, fits, offset_at, paste, placed_box

BOX = np.array([40.0, 30.0, 60.0, 44.0])


def sky(level: float, noise: float = 1.5, seed: int = 0) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(rng.normal(level, noise, (96, 128))), 0, 255).astype(np.uint8)


def with_blob(level: float, contrast: float, noise: float = 1.5) -> NDArray[np.uint8]:
    """A picture with a blob of 12 by 6 pixels in the middle of `BOX`, with soft edges."""
    blob = np.zeros((96, 128), np.float32)
    blob[34:40, 44:56] = contrast
    picture = sky(level, noise).astype(np.float32) + cv2.GaussianBlur(blob, (0, 0), 0.8)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def cut(contrast: float = 80, noise: float = 1.5) -> CutOut:
    found = cut_out(with_blob(100, contrast, noise), BOX)
    assert found is not None
    return found


@pytest.mark.parametrize("contrast", [80, -60, 25])
@pytest.mark.parametrize("level", [70, 120])
def test_pasted_object_keeps_its_contrast(contrast: float, level: float) -> None:
    source, target = with_blob(100, contrast), sky(level, seed=1)
    found = cut(contrast)
    pasted = paste(target, found, (10, 50))
    before = measure_contrast(source, BOX)
    after = measure_contrast(pasted, placed_box(found, (10, 50)))
    assert before is not None and after is not None
    assert after.signed == pytest.approx(before.signed, abs=4)
    assert after.ring == pytest.approx(level, abs=1)


def test_only_the_object_is_pasted() -> None:
    target, found = sky(70, seed=1), cut()
    pasted = paste(target, found, (10, 50))
    x0, y0, x1, y1 = (int(v) for v in placed_box(found, (10, 50)))
    outside = np.ones(target.shape, np.bool_)
    outside[y0 - 2 : y1 + 2, x0 - 2 : x1 + 2] = False
    assert np.array_equal(pasted[outside], target[outside])
    # Within its loose box, the sky around the object stays, too.
    assert np.array_equal(pasted[y0, x0:x1], target[y0, x0:x1])
    assert not np.array_equal(pasted, target) and target.max() < 90


def test_level_follows_the_new_place_and_not_other_objects() -> None:
    target = sky(70, seed=1)
    found = cut()
    other = placed_box(found, (32, 50))
    x0, y0, x1, y1 = (int(v) for v in other)
    target[y0:y1, x0:x1] = 250
    apart = paste(target, found, (10, 50), [other])
    assert np.array_equal(apart[:, :30], paste(sky(70, seed=1), found, (10, 50))[:, :30])


def test_object_hides_what_is_behind_it() -> None:
    target = sky(70, 0.1, seed=1)
    target[:, 20:22] = 90  # a mast behind the object
    found = cut(100)
    pasted = paste(target, found, offset_at(found, (21, 60)))
    assert abs(float(pasted[58:62, 20:22].mean()) - float(pasted[58:62, 17:19].mean())) < 4


def test_levels_saturate() -> None:
    assert paste(sky(220, seed=1), cut(100), (10, 50)).max() == 255
    assert paste(sky(20, seed=1), cut(-60), (10, 50)).min() == 0


@pytest.mark.parametrize(
    "box", [[0.0, 30.0, 20.0, 44.0], [110.0, 30.0, 128.0, 44.0], [80.0, 60.0, 100.0, 74.0], [60.0, 44.0, 60.0, 44.0]]
)
def test_cut_or_invisible_objects_are_not_cut_out(box: list[float]) -> None:
    assert cut_out(with_blob(100, 80), np.array(box)) is None


def test_what_is_not_joined_to_the_object_stays_behind() -> None:
    picture = with_blob(100, 80)
    picture[27, 37] = 160  # a hot pixel in the corner of a box that is very loose
    found = cut_out(picture, BOX + np.array([-4, -4, 4, 4]))
    assert found is not None
    assert np.abs(found.difference[:5, :5]).max() == 0 and found.cover.max() == 1


def test_position_follows_the_centre_of_the_box() -> None:
    found = cut()
    x0, y0, x1, y1 = placed_box(found, offset_at(found, (70.0, 50.0)))
    assert ((x0 + x1) / 2, (y0 + y1) / 2) == (70, 50)
    assert fits(found, (0, 0), (128, 96)) and not fits(found, (-1, 0), (128, 96))
    assert not fits(found, (0, 0), (found.size_wh[0] - 1, 96))
