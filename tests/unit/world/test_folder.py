"""The output folder of `infrablend world`: an unfinished one is refused by readers and finished by the same command."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from infrablend.cli.app import build_app
from infrablend.errors import OutputError
from infrablend.world.dataset import WorldRequest, write_world
from infrablend.world.frame_files import FinishedFrame, make_frame
from infrablend.world.frames import FrameFacts
from tests.killing import run_until_killed

REQUEST = WorldRequest(2, 3, splits={"train": 1.0})


class Even:
    """Renderer of an even ground."""

    def render(self, plan):
        return np.full((512, 640), 290.0, np.float32), []


def frames(facts: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
    for frame in facts:
        yield make_frame(frame, 0, Even(), folder)


def tree(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def test_killed_world_is_refused_and_finished_by_the_same_command(tmp_path: Path) -> None:
    write_world(tmp_path / "fresh", REQUEST, frames)
    for renames in (0, 1, 4, 6):
        out = tmp_path / str(renames)
        run_until_killed(renames, functools.partial(write_world, out, REQUEST, frames))
        if (out / "world.json").is_file():
            ended = CliRunner().invoke(build_app(), ["-q", "check", str(out)])
            assert ended.exit_code == 2 and "infrablend world" in ended.stderr, ended.output
        write_world(out, REQUEST, frames)
        assert tree(out) == tree(tmp_path / "fresh")
    assert json.loads((out / "world.json").read_text())["status"] == "complete"
    assert CliRunner().invoke(build_app(), ["-q", "check", str(out)]).exit_code == 0


def test_folders_with_other_files_are_left_alone(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run_until_killed(4, functools.partial(write_world, out, REQUEST, frames))
    (out / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="not empty"):
        write_world(out, REQUEST, frames)
    assert (out / "mine.txt").read_text() == "mine"
    write_world(tmp_path / "whole", REQUEST, frames)
    before = tree(tmp_path / "whole")
    with pytest.raises(OutputError, match="not empty"):
        write_world(tmp_path / "whole", REQUEST, frames)
    assert tree(tmp_path / "whole") == before


def test_failed_world_leaves_nothing_behind(tmp_path: Path) -> None:
    def broken(facts: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
        yield from frames(facts[:1], folder)
        raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        write_world(tmp_path / "out", REQUEST, broken)
    assert not (tmp_path / "out").exists()
