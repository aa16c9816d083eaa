"""Whether a training may start, and be resumed."""

import dataclasses

import pytest

from infrablend import api
from infrablend.errors import DatasetError, OtherSettingsError
from infrablend.pipeline.detectors.train import require_same
from infrablend.pipeline.detectors.training_data import select_training_data
from infrablend.training.request import TrainRequest
from tests.samples import SAMPLES


def test_resuming_compares_settings_but_not_their_summary(tmp_path):
    settings = dataclasses.asdict(TrainRequest(preset="smoke").chosen_preset())
    asked = {"preset": "smoke", "settings": settings, "data": str(tmp_path), "content": "0"}
    # As recorded by an earlier version.
    summary = "a few steps, to see that everything runs"
    require_same(tmp_path, {**asked, "settings": {**settings, "summary": summary}}, asked)
    with pytest.raises(OtherSettingsError, match=r"settings\.passes"):
        require_same(tmp_path, {**asked, "settings": {**settings, "passes": 3}}, asked)


@pytest.mark.parametrize("preset", ["smoke", "small"])
def test_data_without_any_object_are_refused_by_every_preset(preset, tmp_path):
    dataset = api.read_dataset(SAMPLES["coco"](tmp_path / "data"))
    bare = dataclasses.replace(dataset, images=tuple(dataclasses.replace(i, instances=()) for i in dataset.images))
    with pytest.raises(DatasetError) as caught:
        select_training_data(bare, TrainRequest(preset=preset))
    assert "class-empty" in {p.code for p in caught.value.problems if p.severity == "error"}
