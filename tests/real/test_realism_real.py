"""The realism measures on HIT-UAV's own objects: published contrasts and features, controls within their bounds."""

from pathlib import Path

import numpy as np
import pytest

from infrablend import api
from infrablend.compositing.object_contrast import eight_bit
from infrablend.formats.pictures.images import encode_image, load_background
from infrablend.lab.realism import classify
from infrablend.lab.realism.controls import paste_controls
from infrablend.lab.realism.features import FEATURES, MEASURES, Labels, measure, reason_not_measured

pytestmark = pytest.mark.long

LEVELS = (16.0, 235.0)


@pytest.fixture(scope="module")
def night(real_data_or_none: Path | None):
    """Night images of the train split."""
    if real_data_or_none is None:
        return ()
    dataset = api.read_dataset(real_data_or_none / "hit-uav", api.Reading(splits=["train"]))
    return tuple(i for i in dataset.images if i.capture.time_of_day == "night")


def survey(images, category, most_images):
    found = []
    with_it = [i for i in images if any(o.category == category for o in i.instances)]
    for image in with_it[:: max(1, len(with_it) // most_images)]:
        background = load_background(image.path)
        picture = eight_bit(background.pixels, LEVELS)
        labels = Labels(picture.shape, image.instances)
        objects = [
            (n, o, measure(picture, o, labels.free, key=f"{image.id}#{n}", group=image.id))
            for n, o in enumerate(image.instances)
            if o.category == category and reason_not_measured(o, labels) is None
        ]
        found.append((image, background, picture, labels, objects))
    return found


def medians(objects, rows):
    return dict(zip(rows, np.nanmedian(list(objects), axis=0), strict=True))


@pytest.mark.slow
def test_contrasts_and_features_are_the_published_ones(real_data, night):
    people = [m for *_, objects in survey(night, "Person", 200) for _, _, m in objects]
    cars = [m for *_, objects in survey(night, "Car", 300) for _, _, m in objects]
    person = medians([m.measures for m in people], MEASURES)
    assert person["p95_minus_ring"] == pytest.approx(101, abs=10)
    assert medians([m.measures for m in cars], MEASURES)["centre_minus_ring"] == pytest.approx(-46, abs=8)
    seen = medians([m.features for m in people], FEATURES)
    published = {"max": 246, "p99": 243.6, "std": 6.9, "highpass_inside": 5.9, "dark_ring": 0.14, "share_236": 0.33}
    published |= {"gradient_max": 0.47, "gradient_p90": 0.35}
    for name, value in published.items():
        assert seen[name] == pytest.approx(value, rel=0.25), name


@pytest.mark.slow
def test_controls_have_their_expected_values(real_data, night):
    real, floor, hard = [], [], []
    for image, background, picture, labels, objects in survey(night, "Person", 150):
        chosen = [(n, o) for n, o, m in objects if not m.flaw]
        made = paste_controls(picture, labels, chosen, image.id)
        placed, free = made.labels, made.free
        of_image = {n: m for n, _, m in objects}
        for pasted, into in ((made.real, floor), (made.flat, hard)):
            data = encode_image(np.clip(np.rint(pasted), 0, 255).astype(np.uint8), background)
            saved = eight_bit(decoded(data), LEVELS)
            into += [measure(saved, o, free, key=str(n), group=image.id) for n, o in sorted(placed.items())]
        real += [of_image[n] for n in sorted(placed)]
    assert len(real) >= 400
    kept = [(r, f, h) for r, f, h in zip(real, floor, hard, strict=True) if not (f.flaw or h.flaw)]
    real, floor, hard = (list(column) for column in zip(*kept, strict=True))
    assert classify.score(real, hard, "logistic").auc >= 0.99
    assert 0.68 <= classify.score(real, floor, "logistic").auc <= 0.82


def decoded(data: bytes) -> np.ndarray:
    import cv2

    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
