"""Output folders: the same rules for every command that writes."""

from __future__ import annotations

from pathlib import Path

import pytest

from infrablend.core.output import OutputFolder, require_apart, require_replaceable
from infrablend.errors import OutputError


def folder(root: Path, **more: bool) -> OutputFolder:
    return OutputFolder(root, "run", "run.json", **more)


def test_new_and_empty_folders_are_accepted(tmp_path: Path) -> None:
    assert folder(tmp_path).require_empty() == []
    assert folder(tmp_path / "new").require_empty() == [] and not (tmp_path / "new").exists()
    folder(tmp_path / "new").make_writable()
    assert (tmp_path / "new").is_dir() and not any((tmp_path / "new").iterdir())


@pytest.mark.parametrize(
    ("options", "advice"),
    [
        ({}, "Give another folder."),
        (
            {"can_overwrite": True},
            "Use --overwrite (overwrite=True in Python) to replace an earlier run, or give another folder.",
        ),
        (
            {"can_resume": True, "can_overwrite": True},
            'Use --resume (existing="resume" in Python) to finish an interrupted one, --overwrite '
            '(existing="overwrite" in Python) to replace an earlier run, or give another folder.',
        ),
    ],
)
def test_the_refusal_names_what_the_command_can_do(options: dict[str, bool], advice: str, tmp_path: Path) -> None:
    for name in "abcde":
        (tmp_path / name).touch()
    with pytest.raises(OutputError) as refused:
        folder(tmp_path, **options).require_empty()
    assert str(refused.value) == (
        f"{tmp_path}: not empty (found a, b, c, d ...); expected an empty or new folder. {advice}"
    )
    assert folder(tmp_path, **options).require_empty(existing="overwrite") == list("abcde")


def test_files_and_dangling_links_are_no_folders(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for name, found in (("file", "is a file"), ("link", "is a link that leads nowhere")):
        with pytest.raises(OutputError, match=found):
            folder(tmp_path / name).entries()
        with pytest.raises(OutputError, match=found), folder(tmp_path / name).claimed():
            pass


def test_only_names_in_the_folder_are_removed_and_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.txt").touch()
    out = tmp_path / "out"
    (out / "images").mkdir(parents=True)
    (out / "link").symlink_to(tmp_path / "mine")
    folder(out).remove(["images", "link", "absent"])
    assert folder(out).entries() == [] and (tmp_path / "mine" / "a.txt").exists()
    for name in ("../mine", "..", "", "a/b"):
        with pytest.raises(OutputError, match="nothing was touched"):
            folder(out).remove([name])
    with pytest.raises(OutputError, match=r"not part of the run \(notes.txt\)"):
        folder(out).require_only(["run.json"], ["notes.txt", "run.json"])


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with (
        folder(tmp_path).claimed(),
        pytest.raises(OutputError, match="another process is writing this run"),
        folder(tmp_path).claimed(),
    ):
        pass
    with folder(tmp_path).claimed():  # the lock ended with the block
        pass


def test_data_and_output_must_be_apart(tmp_path: Path) -> None:
    for data, out in (("a", "a"), ("a/b", "a"), ("a", "a/b")):
        with pytest.raises(OutputError, match="data folder"):
            require_apart(tmp_path / data, tmp_path / out)
    require_apart(tmp_path / "a", tmp_path / "ab")


def test_foreign_file_is_not_replaced(tmp_path: Path) -> None:
    file = tmp_path / "sheet.png"
    require_replaceable(file, "contact sheet", ours=False)
    file.write_text("mine")
    require_replaceable(file, "contact sheet", ours=True)
    with pytest.raises(OutputError, match=r"sheet\.png: exists and is not a contact sheet of InfraBlend; nothing was"):
        require_replaceable(file, "contact sheet", ours=False)
    with pytest.raises(OutputError, match="is a folder"):
        require_replaceable(tmp_path, "contact sheet", ours=True)
