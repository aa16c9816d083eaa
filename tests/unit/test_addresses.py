"""Tests that addresses of object storage are refused where a folder is expected."""

from pathlib import Path

import pytest

from infrablend import api
from infrablend.core.addresses import require_folder, without_user
from infrablend.errors import ArgumentError
from infrablend.pipeline.request import RunRequest

ADDRESS = "s3://key:secret@bucket/run"


@pytest.mark.parametrize("path", ["s3://b/run", "gs://b", "hf://datasets/a/b", "memory://x", "file:///tmp/x"])
def test_addresses_are_refused_as_text_and_as_paths(path: str) -> None:
    for value in (path, Path(path)):
        with pytest.raises(ArgumentError, match=r"out: found an address, \w+://\.\.\., expected a folder"):
            require_folder("out", value)


@pytest.mark.parametrize("path", ["run", "/data/s3:/run", "./s3:/run", "c:/run", "a:b"])
def test_folders_are_accepted(path: str) -> None:
    require_folder("out", path)


def test_a_folder_with_such_a_name_is_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "s3:").mkdir()
    monkeypatch.chdir(tmp_path)
    require_folder("out", "s3:/run")


def test_every_command_refuses_and_writes_and_tells_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=r"^out") as out:
        RunRequest("paper", tmp_path, Path(ADDRESS))
    with pytest.raises(ArgumentError, match=r"^data") as data:
        RunRequest("paper", Path(ADDRESS), tmp_path / "out")
    with pytest.raises(ArgumentError, match=r"^out") as status:
        api.status(ADDRESS)
    with pytest.raises(ArgumentError, match=r"^sources") as source:
        api.merge([ADDRESS], tmp_path / "out")
    with pytest.raises(ArgumentError, match=r"^out") as target:
        api.merge([tmp_path], ADDRESS)
    assert not any("secret" in str(e.value) for e in (out, data, status, source, target))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("generate --out s3://user:secret@bucket/x --seed 1", "generate --out s3://...@bucket/x --seed 1"),
        ("fetch hit-uav --url https://me:se@cret@host/a.zip", "fetch hit-uav --url https://...@host/a.zip"),
        ("--data a@b/c C:/x@y s3://bucket/a@b", "--data a@b/c C:/x@y s3://bucket/a@b"),
    ],
)
def test_passwords_in_addresses_are_not_shown(text: str, shown: str) -> None:
    assert without_user(text) == shown
