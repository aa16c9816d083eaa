"""The folder of a training: only its own files are deleted, and never through a link."""

import dataclasses
import json
import logging

import pytest

from infrablend.core.output import OutputFolder
from infrablend.errors import OtherSettingsError, OutputError
from infrablend.pipeline.training.folder import (
    JOB,
    RECORD,
    WORKING_FILES,
    begin_training,
    remove_working_files,
    require_same,
)
from infrablend.training import trainer
from infrablend.training.request import TrainRequest


def a_training(out):
    """Write the folder of an interrupted training, and a note of the user's."""
    (out / "data" / "labels").mkdir(parents=True)
    (out / "run").mkdir()
    for name in (trainer.CHECKPOINT, trainer.WEIGHTS, JOB, "note.txt", "data/labels/a.txt"):
        (out / name).write_text("{}")
    (out / RECORD).write_text(json.dumps({"infrablend": "0.1.0", "status": "interrupted"}))
    return out


def test_overwriting_deletes_only_own_files(tmp_path):
    out = a_training(tmp_path / "out")
    assert begin_training(out, "overwrite") is None
    assert [p.name for p in out.iterdir()] == ["note.txt"]


def test_resuming_deletes_nothing(tmp_path):
    out = a_training(tmp_path / "out")
    before = sorted(out.rglob("*"))
    record = begin_training(out, "resume")
    assert record is not None and record["status"] == "interrupted"
    assert sorted(out.rglob("*")) == before


def test_a_finished_training_keeps_weights_job_and_record(tmp_path):
    out = a_training(tmp_path / "out")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept.txt").write_text("")
    (out / "ultralytics").symlink_to(elsewhere)
    remove_working_files(out)
    assert sorted(p.name for p in out.iterdir()) == sorted([JOB, "note.txt", RECORD, trainer.WEIGHTS])
    assert (elsewhere / "kept.txt").is_file(), "deleted through a link"


def test_a_finished_training_succeeds_if_its_working_files_cannot_be_deleted(tmp_path, monkeypatch, caplog):
    asked = []

    def refuse(self, names):
        asked.append(tuple(names))
        raise OutputError(f"cannot write {self.root}: Device or resource busy")

    monkeypatch.setattr(OutputFolder, "remove", refuse)
    with caplog.at_level(logging.WARNING):
        remove_working_files(tmp_path)
    assert asked == [WORKING_FILES]
    assert "Device or resource busy" in caplog.text and "the training is complete" in caplog.text


def test_resuming_compares_settings_but_not_their_summary(tmp_path):
    settings = dataclasses.asdict(TrainRequest(preset="smoke").chosen_preset())
    asked = {"preset": "smoke", "settings": settings, "data": str(tmp_path), "content": "0"}
    # As recorded by an earlier version.
    summary = "a few steps, to see that everything runs"
    require_same(tmp_path, {**asked, "settings": {**settings, "summary": summary}}, asked)
    with pytest.raises(OtherSettingsError, match=r"settings\.passes"):
        require_same(tmp_path, {**asked, "settings": {**settings, "passes": 3}}, asked)
