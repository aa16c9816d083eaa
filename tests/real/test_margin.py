"""Black margins of real pictures: none of them gets an object, and other pictures have none."""

from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.run_files import records

from infrablend import api
from infrablend.imaging.margin import find_margin


@pytest.mark.realdata
@pytest.mark.parametrize("where", ["{learned: true}", "anywhere"])
def test_no_deer_where_the_undistorted_picture_is_black(tmp_path, real_data: Path, where: str):
    run = tmp_path / "run"
    api.generate(
        "deer-above",
        real_data / "bambi",
        run,
        settings=["configurations=3", "output.formats=[coco]", f"placement.where={where}"],
        execution=api.Execution(renderer="flat", in_process=True),
    )
    rejected: Counter[str] = Counter()
    inserted = 0
    for record in records(run):
        picture = cv2.imread(str(real_data / "bambi" / record.background["path"]), cv2.IMREAD_GRAYSCALE)
        rejected.update(record.scene.draws["rejected"])
        for label in record.inserted:
            x0, y0, x1, y1 = (int(v) for v in np.rint(label.box_xyxy))
            assert (picture[y0:y1, x0:x1] == 0).mean() < 0.5, (record.frame_id, label.box_xyxy)
            inserted += 1
    assert inserted >= 15
    # Where surfaces are known, hardly any place is drawn there.
    assert where != "anywhere" or rejected["on_margin"] >= 5


@pytest.mark.realdata
def test_night_pictures_without_margin_stay_usable(real_data: Path):
    pictures = sorted((real_data / "hit-uav" / "normal_json").rglob("*.jpg"))
    assert len(pictures) > 100
    for path in pictures:
        assert find_margin(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) is None, path.name
