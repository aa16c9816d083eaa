"""The output folder of `infrablend world`: whole or not there, and finished by the same command."""

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
from infrablend.lab.world.frame_files import FinishedFrame, make_frame
from infrablend.lab.world.world_dataset import WorldRequest, write_world
from infrablend.lab.world.world_frames import FrameFacts
from tests.killing import run_until_killed

REQUEST = WorldRequest(2, 3)


class Even:
    """Renderer of an even ground."""

    def render(self, plan):
        return np.full((512, 640), 290.0, np.float32), []


def frames(facts: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
    for frame in facts:
        yield make_frame(frame, 0, Even(), folder)


def tree(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def test_killed_world_is_not_there_and_finished_by_the_same_command(tmp_path: Path) -> None:
    write_world(tmp_path / "fresh", REQUEST, frames)
    for renames in (0, 1, 4, 6):
        out = tmp_path / str(renames)
        run_until_killed(renames, functools.partial(write_world, out, REQUEST, frames))
        assert not out.exists()
        write_world(out, REQUEST, frames)
        assert tree(out) == tree(tmp_path / "fresh")
    assert json.loads((out / "world.json").read_text())["seed"] == 3
    assert CliRunner().invoke(build_app(), ["-q", "check", str(out)]).exit_code == 0


def test_a_world_is_replaced_only_if_asked_for(tmp_path: Path) -> None:
    out = tmp_path / "whole"
    write_world(out, REQUEST, frames)
    before = tree(out)
    with pytest.raises(OutputError, match="not empty"):
        write_world(out, REQUEST, frames)
    assert tree(out) == before
    write_world(out, WorldRequest(1, 3), frames, overwrite=True)
    assert len(json.loads((out / "world.json").read_text())["frames"]) == 1


def test_failed_world_leaves_nothing_behind(tmp_path: Path) -> None:
    def broken(facts: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
        yield from frames(facts[:1], folder)
        raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        write_world(tmp_path / "out", REQUEST, broken)
    assert list(tmp_path.iterdir()) == []
