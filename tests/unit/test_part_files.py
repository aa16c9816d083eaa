"""What is in the way of a temporary file: links and pipes are not followed, only own leftovers are replaced."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from infrablend.core.files import link_or_copy, part_path, write_bytes, write_chunks
from infrablend.errors import OutputError


@pytest.mark.timeout(60)
@pytest.mark.parametrize("way", ["link", "link to nothing", "hard link", "pipe", "leftover"])
@pytest.mark.parametrize("kind", ["bytes", "chunks", "link or copy"])
def test_nothing_is_written_through_what_is_in_the_way(tmp_path: Path, way: str, kind: str) -> None:
    mine, target, source = tmp_path / "mine", tmp_path / "out" / "labels.txt", tmp_path / "source"
    mine.write_bytes(b"mine")
    source.write_bytes(b"new")
    target.parent.mkdir()
    part = part_path(target)
    if way.startswith("link"):
        part.symlink_to(mine if way == "link" else tmp_path / "nothing")
    elif way == "hard link":
        os.link(mine, part)
    elif way == "pipe":
        os.mkfifo(part)
    else:
        part.write_bytes(b"of a killed process, and longer")
    if kind == "link or copy":
        written = link_or_copy(source, target)
    else:
        written = write_chunks(target, ["n", "ew"]) if kind == "chunks" else write_bytes(target, b"new")
    assert written.read_bytes() == b"new" and target.is_file() and not target.is_symlink()
    assert mine.read_bytes() == b"mine" and not os.path.lexists(part)
    assert not (tmp_path / "nothing").exists()


def test_files_and_folders_of_others_with_temporary_names_are_kept(tmp_path: Path) -> None:
    target = tmp_path / "sheet.png"
    mine = [tmp_path / name for name in (".sheet.part.png", "sheet.png.part")]
    for path in mine:
        path.write_bytes(b"mine")
    assert write_bytes(target, b"new").read_bytes() == b"new"
    assert sorted(tmp_path.iterdir()) == sorted([*mine, target]) and all(p.read_bytes() == b"mine" for p in mine)
    part_path(target).mkdir()
    with pytest.raises(OutputError, match="cannot write"):
        write_bytes(target, b"newer")
    assert part_path(target).is_dir() and target.read_bytes() == b"new"


def test_temporary_names_fit_the_file_system_and_differ_by_file(tmp_path: Path) -> None:
    names = ["a.png", "a.jpg", "b.png", "a", f"{'x' * 250}.png", f"{'x' * 249}y.png"]
    parts = [part_path(tmp_path / name) for name in names]
    assert len({p.name for p in parts}) == len(names) and all(len(p.name) <= 255 for p in parts)
    assert [p.suffix for p in parts] == [Path(n).suffix for n in names[:3]] + [".part", ".png", ".png"]


def test_file_made_by_others_meanwhile_is_kept(tmp_path: Path) -> None:
    target = tmp_path / "labels.txt"

    def chunks() -> Iterator[str]:
        yield "new"

    part_path(target).symlink_to(tmp_path / "victim")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "unlink", lambda path, missing_ok: None)  # it was free before
        for write in (lambda: write_bytes(target, b"new"), lambda: write_chunks(target, chunks())):
            with pytest.raises(OutputError, match="File exists"):
                write()
    assert part_path(target).is_symlink() and not (tmp_path / "victim").exists() and not target.exists()
