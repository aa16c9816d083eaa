"""Whether a training may be resumed."""

import dataclasses

import pytest

from infrablend.errors import OtherSettingsError
from infrablend.pipeline.detectors.train import require_same
from infrablend.training.request import TrainRequest


def test_resuming_compares_settings_but_not_their_summary(tmp_path):
    settings = dataclasses.asdict(TrainRequest(preset="smoke").chosen_preset())
    asked = {"preset": "smoke", "settings": settings, "data": str(tmp_path), "content": "0"}
    # As recorded by an earlier version.
    summary = "a few steps, to see that everything runs"
    require_same(tmp_path, {**asked, "settings": {**settings, "summary": summary}}, asked)
    with pytest.raises(OtherSettingsError, match=r"settings\.passes"):
        require_same(tmp_path, {**asked, "settings": {**settings, "passes": 3}}, asked)
