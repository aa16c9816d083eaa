"""Every labelled insert can be seen: it changes pixels of its picture, on all real data at hand."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.run_files import records

from infrablend import api

STATED = ["camera.pitch={fixed_deg: 45}", "camera.altitude={fixed_m: 60}"]
CASES = [
    ("hit-uav-drone-physical", "hit-uav", []),
    ("hit-uav-people", "hit-uav", ["objects.0.count=3"]),
    ("hit-uav-cars", "hit-uav", ["objects.0.count=3"]),
    ("hit-uav-drone-physical", "wisard", STATED),
    ("monet-deer-physical", "wisard", [*STATED, "camera.accept_height=true"]),  # its people say 92 m
    ("monet-deer-physical", "birdsai", STATED),
    ("deer-above", "hit-uav", []),
    ("deer-above", "wisard", []),
    ("drone-sky", "halmstad/backgrounds", ["sensor.randomise=null"]),
    ("drone-sky-halmstad", "halmstad/backgrounds", []),
]


@pytest.mark.realdata
@pytest.mark.parametrize(("recipe", "data", "settings"), CASES)
def test_no_label_without_a_visible_change(tmp_path, real_data: Path, recipe, data, settings):
    run = tmp_path / "run"
    api.generate(
        recipe,
        real_data / data,
        run,
        limit=3,
        settings=["output.image=png", "output.formats=[coco]", "configurations=1", *settings],
        execution=api.Execution(renderer="flat", in_process=True),
    )
    found = records(run)
    assert found
    for record in found:
        after = cv2.imread(str(run / "images" / record.image), cv2.IMREAD_GRAYSCALE).astype(int)
        before = cv2.imread(str(real_data / data / record.background["path"]), cv2.IMREAD_GRAYSCALE).astype(int)
        for label in record.inserted:
            x0, y0 = np.floor(label.box_xyxy[:2]).astype(int).clip(0)
            x1, y1 = np.ceil(label.box_xyxy[2:]).astype(int)
            assert np.abs(after - before)[y0:y1, x0:x1].max() >= 3, (record.frame_id, label.category)
            assert label.extra["changed_grey"] >= 3


@pytest.mark.realdata
def test_drones_are_as_bright_against_the_sky_as_real_ones(tmp_path, real_data: Path):
    """Real drones of the train clips have a median contrast of 138 levels, quartiles 74 and 152."""
    run = tmp_path / "run"
    api.generate(
        "drone-sky-halmstad",
        real_data / "halmstad/backgrounds",
        run,
        reading=api.Reading(splits=["val"]),
        settings=[
            "output.formats=[coco]",
            "objects.0.count=1",
            *(f"objects.{n}.count=0" for n in (1, 2, 3)),
            "configurations=1",
        ],
        execution=api.Execution(renderer="flat", in_process=True),
    )
    found = records(run)
    signed = [i.extra["contrast_grey"] for r in found for i in r.inserted]
    sky = [k for r in found for k in r.facts.get("matching", {}).get("behind", ())]
    assert len(signed) >= 0.8 * sum(r.facts != {} for r in found)
    # The others hover below the horizon or in front of trees.
    assert sky.count("sky") >= 0.8 * len(sky)
    assert np.median(signed) >= 60
    assert np.percentile(signed, 5) >= 17
