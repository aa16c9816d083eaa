"""Labels of packed shards: what is known of a picture comes back, also from shards of earlier versions."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from infrablend.formats.labels.shard_tar import image_of, label_text
from tests.samples import records, with_facts


def test_camera_and_origin_of_the_height_come_back(tmp_path: Path) -> None:
    """Without them, a height that the aircraft measured would be corrected like one from a table."""
    images, categories = records(tmp_path)
    ids = {c.name: c.id for c in categories}
    flown = with_facts(images[0], camera="DJI M3T", altitude_from="laser")
    again = image_of(json.loads(label_text("train/a", flown, ids)), tmp_path)
    assert again.capture == flown.capture
    assert all(a.equals(b) for a, b in zip(again.instances, flown.instances, strict=True))
    # Pictures that state neither have the labels that they always had.
    plain = json.loads(label_text("train/a", images[0], ids))
    assert not {"camera", "altitude_from"} & set(plain) and image_of(plain, tmp_path).capture == images[0].capture
    with pytest.raises(ValueError, match="altitude_from"):
        image_of(plain | {"altitude_from": 3}, tmp_path)
