"""What is in the way of a temporary file: links and pipes are not followed, leftovers are replaced."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from infrablend.core.files import part_path, write_bytes, write_chunks


@pytest.mark.timeout(60)
@pytest.mark.parametrize("way", ["link", "hard link", "pipe", "leftover"])
@pytest.mark.parametrize("chunks", [False, True])
def test_nothing_is_written_through_what_is_in_the_way(tmp_path: Path, way: str, chunks: bool) -> None:
    mine, target = tmp_path / "mine", tmp_path / "out" / "labels.txt"
    mine.write_bytes(b"mine")
    target.parent.mkdir()
    part = part_path(target)
    if way == "link":
        part.symlink_to(mine)
    elif way == "hard link":
        os.link(mine, part)
    elif way == "pipe":
        os.mkfifo(part)
    else:
        part.write_bytes(b"of a killed process, and longer")
    written = write_chunks(target, ["n", "ew"]) if chunks else write_bytes(target, b"new")
    assert written.read_bytes() == b"new" and target.is_file() and not target.is_symlink()
    assert mine.read_bytes() == b"mine" and not os.path.lexists(part)
