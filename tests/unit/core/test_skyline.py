"""Sky, horizon, noise and burnt-in text are found in pictures."""

import cv2
import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont

from infrablend.imaging.burnt_in import find_burnt_in
from infrablend.imaging.skyline import find_skyline, noise_of

SHAPE = (256, 320)


def outlook(row=180, sky=95.0, land=210.0, noise=1.5, seed=0):
    """A picture with sky above `row` and land below it, seen through optics."""
    rng = np.random.default_rng(seed)
    picture = np.where(np.arange(SHAPE[0])[:, None] < row, sky, land) * np.ones(SHAPE)
    soft = cv2.GaussianBlur(picture, (0, 0), 0.8)
    return np.clip(soft + rng.normal(0, noise, SHAPE), 0, 255).astype(np.float32)


@pytest.mark.parametrize("row", [120, 180, 240])
def test_the_horizon_is_the_lowest_sky(row):
    found = find_skyline(outlook(row))
    assert found.horizon_px == pytest.approx(row, abs=3)
    assert found.step_grey == pytest.approx(115, abs=5)
    assert found.sky[: row - 4].all()
    assert found.land[row + 4 :].all()
    assert not (found.sky & found.land).any()


def test_trees_and_masts_do_not_raise_the_horizon():
    picture = outlook()
    picture[120:180, 40:70] = 215
    picture[20:180, 200:203] = 230
    found = find_skyline(picture)
    assert found.horizon_px == pytest.approx(180, abs=3)
    assert found.land[150, 55] and not found.sky[150, 55]
    assert found.sky[60, 150]


def test_clouds_and_aircraft_are_islands_in_the_sky():
    picture = outlook()
    picture[60:66, 100:110] = 250
    found = find_skyline(picture)
    assert found.horizon_px == pytest.approx(180, abs=3)
    assert not found.land[100, 105]


def test_sky_alone_has_no_horizon():
    found = find_skyline(outlook(row=300))
    assert found.horizon_px is None
    assert found.step_grey == 0
    assert found.sky.mean() > 0.95


def test_land_that_is_no_warmer_than_the_sky_is_no_horizon():
    """Nothing but a step towards warmer levels is taken for a skyline."""
    assert find_skyline(outlook(sky=200, land=90)).horizon_px is None


def test_levels_of_sixteen_bit_pictures_are_scaled():
    eight = find_skyline(outlook())
    sixteen = find_skyline(outlook() * 40, 40)
    assert sixteen.horizon_px == eight.horizon_px
    assert sixteen.step_grey == pytest.approx(40 * eight.step_grey)


@pytest.mark.parametrize("sigma", [1.0, 5.0, 20.0])
def test_noise_is_measured(sigma):
    rng = np.random.default_rng(1)
    picture = np.clip(np.rint(120 + rng.normal(0, sigma, SHAPE)), 0, 255).astype(np.uint8)
    assert noise_of(picture) == pytest.approx(sigma, rel=0.35)


def test_text_is_found_and_nothing_else():
    picture = outlook()
    assert not len(find_burnt_in(picture))
    picture[60:66, 100:110] = 255  # an aircraft
    assert not len(find_burnt_in(picture))
    cv2.putText(picture, "WHITE HOT", (30, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.3, 255.0, 1)
    boxes = find_burnt_in(picture)
    assert len(boxes)
    assert (boxes[:, 1] < 25).all() and (boxes[:, 3] < 30).all()


@pytest.mark.parametrize("level", [255.0, 235.0, 200.0])
@pytest.mark.parametrize("size", [10, 12, 16, 20, 26, 32])
def test_all_text_is_found_at_any_size(size, level):
    """Smoothed text that a camera writes, with marks that are no row of glyphs; no inserts may touch any of them."""
    noise = np.random.default_rng(size).normal(110, 4, (256, 320))
    picture = Image.fromarray(np.clip(noise, 0, 255).astype(np.uint8))
    pen = ImageDraw.Draw(picture)
    pen.text((20, 60), "WHITE HOT 12:45", fill=int(level), font=ImageFont.load_default(size))
    pen.text((20, 130), "REC", fill=int(level) - 20, font=ImageFont.load_default(size))
    pen.rectangle((250, 20, 272, 31), outline=int(level) - 10)  # a battery
    grey = np.array(picture)
    covered = np.zeros(grey.shape, bool)
    for x0, y0, x1, y1 in find_burnt_in(grey.astype(np.float32)).astype(int):
        covered[max(y0, 0) : y1, max(x0, 0) : x1] = True
    assert covered[grey > 150].mean() > 0.98
    assert covered.mean() < 0.4


def reticle(at=(20, 30)):
    """Return a bright sky above dark ground with text, bright on one side and black on the other, and lines."""
    grey = np.random.default_rng(3).normal(90, 3, (256, 320))
    grey[:, 160:] += 130
    picture = Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8))
    pen, font, written = ImageDraw.Draw(picture), ImageFont.load_default(14), Image.new("L", (320, 256))
    marks = ImageDraw.Draw(written)
    for xy, text, level in ((at, "AZ 17.54 1.24", 255), ((at[0] + 180, at[1]), "10:18:59", 0)):
        pen.text(xy, text, fill=level, font=font)
        marks.text(xy, text, fill=255, font=font)
    for x, level in ((100, 255), (220, 0)):
        for box in ((x, 140, x + 40, 141), (x, 140, x + 1, 180)):
            pen.rectangle(box, fill=level)
            marks.rectangle(box, fill=255)
    return np.array(picture, np.float32), np.array(written) > 120


@pytest.mark.parametrize("at", [(10, 10), (60, 90), (10, 235)])
def test_black_text_and_lines_are_found_beside_bright_text(at):
    grey, written = reticle(at)
    covered = np.zeros(grey.shape, bool)
    for x0, y0, x1, y1 in find_burnt_in(grey).astype(int):
        covered[max(y0, 0) : y1, max(x0, 0) : x1] = True
    assert covered[written].mean() > 0.98
    assert not covered[150:175, 110:135].any()  # what the lines enclose is free


def test_lines_without_text_are_the_scene():
    grey, _ = reticle()
    grey[:60] = 90
    assert not len(find_burnt_in(grey))
