"""`infrablend show`: what is known of a frame, also of one that failed, and of an unfinished run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from infrablend.pipeline.compose.frame import FrameComposer
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.run_files import frame_ids
from tests.samples import SAMPLES


@pytest.fixture
def words(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[object]:
    render_flat(monkeypatch)
    data = SAMPLES["coco"](tmp_path / "data")
    return ["generate", "hit-uav-drone", "--data", data, "--out", tmp_path / "run", "--to", "yolo"]


def test_a_finished_frame_is_shown_as_json(words: list[object], tmp_path: Path) -> None:
    done(*words)
    frame, *_ = frame_ids(tmp_path / "run")
    shown = json.loads(done("show", tmp_path / "run", frame).stdout)
    assert shown["frame_id"] == frame and shown["scene"]["camera"] and shown["inserted"]
    ended = run("show", tmp_path / "run", "test/none")
    assert ended.exit_code == 2 and "no finished frame 'test/none'" in ended.output and "such as" in ended.output
    ended = run("show", tmp_path / "data", frame)
    assert ended.exit_code == 2 and "not the folder of a run" in ended.output


def test_a_failed_frame_is_shown_with_its_traceback(
    words: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compose = FrameComposer.compose

    def fail_once(self: FrameComposer, frame: object) -> object:
        if frame.frame_id.endswith("_c1"):  # type: ignore[attr-defined]
            raise ZeroDivisionError("of this test")
        return compose(self, frame)  # type: ignore[arg-type]

    monkeypatch.setattr(FrameComposer, "compose", fail_once)
    assert run(*words).exit_code == 1
    made = frame_ids(tmp_path / "run")[0]
    failed = json.loads(done("show", tmp_path / "run", made.replace("_c0", "_c1")).stdout)["failure"]
    assert failed["error"] == "ZeroDivisionError" and "in fail_once" in failed["traceback"]


def test_frames_of_an_unfinished_run_are_shown(
    words: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("infrablend.pipeline.runs.run.export_run", interrupt)
    assert run(*words).exit_code not in (0, 1)
    assert not (tmp_path / "run").exists()
    shown = json.loads(done("show", tmp_path / "run", "test/1_90_90_0_00034_c0").stdout)
    assert shown["scene"]
