"""The folder of a training: only its own files are deleted, and never through a link."""

import dataclasses
import json
import logging

import pytest

from infrablend.core.files import write_json, write_text
from infrablend.core.manifest import JOURNAL, REPLACED
from infrablend.core.output import OutputFolder
from infrablend.errors import OtherSettingsError, OutputError
from infrablend.pipeline.training.folder import (
    JOB,
    RECORD,
    begin_training,
    remove_working_files,
    require_own_weights,
    require_same,
)
from infrablend.training.files import CHECKPOINT, NEW_CHECKPOINT, WEIGHTS, open_manifest
from infrablend.training.request import TrainRequest


def a_training(out):
    """Write the folder of an interrupted training, and a note of the user's."""
    (out / "data" / "labels").mkdir(parents=True)
    (out / "run").mkdir()
    with open_manifest(out).recording():
        for name in (WEIGHTS, JOB, "data/labels/a.txt"):
            write_text(out / name, "{}")
        write_json(out / RECORD, {"infrablend": "0.1.0", "status": "interrupted"})
    for name in (CHECKPOINT, "note.txt", "data/labels/a.cache", "run/results.csv"):
        (out / name).write_text("{}")
    return out


def test_overwriting_deletes_only_own_files(tmp_path):
    out = a_training(tmp_path / "out")
    assert begin_training(out, "overwrite", open_manifest(out)) is None
    assert sorted(p.name for p in out.iterdir()) == [JOURNAL, "note.txt", RECORD]
    assert json.loads((out / RECORD).read_text())["status"] == "overwritten"
    # Killed here, the overwrite can be repeated; resuming starts again.
    for existing in ("overwrite", "resume"):
        assert begin_training(out, existing, open_manifest(out)) is None
    with pytest.raises(OutputError, match="--resume"):
        begin_training(out, "refuse", open_manifest(out))


def test_overwriting_moves_edited_and_foreign_files_aside(tmp_path):
    out = a_training(tmp_path / "out")
    for name in (WEIGHTS, JOB, RECORD, "data/labels/a.txt"):
        text = (out / name).read_text()
        (out / name).write_text(text.replace("}", "    }"))
    (out / "run" / "mine.png").write_text("mine")
    manifest = open_manifest(out)
    assert begin_training(out, "overwrite", manifest) is None
    kept = sorted(p.relative_to(out / REPLACED).as_posix() for p in (out / REPLACED).rglob("*") if p.is_file())
    assert kept == sorted([WEIGHTS, JOB, RECORD, "data/labels/a.txt", "run/mine.png"])
    assert sorted(manifest.moved.values()) == kept


def test_resuming_deletes_nothing(tmp_path):
    out = a_training(tmp_path / "out")
    before = sorted(out.rglob("*"))
    record = begin_training(out, "resume", open_manifest(out))
    assert record is not None and record["status"] == "interrupted"
    assert sorted(out.rglob("*")) == before


def test_a_finished_training_keeps_weights_job_and_record(tmp_path):
    out = a_training(tmp_path / "out")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept.txt").write_text("")
    (out / "ultralytics").symlink_to(elsewhere)
    remove_working_files(out, open_manifest(out))
    assert sorted(p.name for p in out.iterdir()) == sorted([JOB, "note.txt", RECORD, WEIGHTS, JOURNAL, REPLACED])
    assert (out / REPLACED / "ultralytics").is_symlink()
    assert (elsewhere / "kept.txt").is_file(), "deleted through a link"


@pytest.mark.parametrize("how", ["edited", "linked", "unlisted"])
def test_weights_that_the_training_did_not_write_are_refused(tmp_path, how):
    out = a_training(tmp_path / "out")
    require_own_weights(out, open_manifest(out))
    if how == "unlisted":
        (out / JOURNAL).write_text("")
    elif how == "edited":
        (out / WEIGHTS).write_text("[]")
    else:
        (out / WEIGHTS).rename(tmp_path / "other.pt")
        (out / WEIGHTS).symlink_to(tmp_path / "other.pt")
    with pytest.raises(OutputError, match=r"weights\.pt: (a link|changed).*--overwrite"):
        require_own_weights(out, open_manifest(out))


def test_a_finished_training_succeeds_if_its_working_files_cannot_be_deleted(tmp_path, monkeypatch, caplog):
    asked = []

    def refuse(self, names):
        asked.append(tuple(names))
        raise OutputError(f"cannot write {self.root}: Device or resource busy")

    monkeypatch.setattr(OutputFolder, "remove", refuse)
    with caplog.at_level(logging.WARNING):
        remove_working_files(tmp_path, open_manifest(tmp_path))
    assert asked == [(CHECKPOINT, NEW_CHECKPOINT)]
    assert "Device or resource busy" in caplog.text and "the training is complete" in caplog.text


def test_resuming_compares_settings_but_not_their_summary(tmp_path):
    settings = dataclasses.asdict(TrainRequest(preset="smoke").chosen_preset())
    asked = {"preset": "smoke", "settings": settings, "data": str(tmp_path), "content": "0"}
    # As recorded by an earlier version.
    summary = "a few steps, to see that everything runs"
    require_same(tmp_path, {**asked, "settings": {**settings, "summary": summary}}, asked)
    with pytest.raises(OtherSettingsError, match=r"settings\.passes"):
        require_same(tmp_path, {**asked, "settings": {**settings, "passes": 3}}, asked)
