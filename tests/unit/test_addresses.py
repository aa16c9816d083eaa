"""Tests of telling addresses of object storage from folders, and of refusing them where a folder is expected."""

import logging
from pathlib import Path

import pytest

from infrablend import api
from infrablend.cli.call_state import LogFileHandler
from infrablend.core.addresses import address_of, require_folder, require_known, shown, without_user
from infrablend.core.files import write_bytes
from infrablend.errors import ArgumentError, DatasetError, MissingDependencyError, StorageError
from infrablend.pipeline.plans.run_request import RunRequest
from infrablend.pipeline.storage.store import Store
from tests.command_line import run

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
    (tmp_path / "night:").mkdir()
    monkeypatch.chdir(tmp_path)
    require_folder("out", "night:/run")


def test_no_folder_hides_object_storage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "s3:").mkdir()
    monkeypatch.chdir(tmp_path)
    assert address_of(Path("s3://bucket/run")) == "s3://bucket/run"
    assert address_of("S3://bucket//./a/") == "s3://bucket/a"


@pytest.mark.parametrize(
    "words",
    [
        ["convert", "DATA", ADDRESS, "--to", "yolo"], ["split", "DATA", ADDRESS, "--by", "gap"], ["check", ADDRESS],
        ["inspect", "DATA", "--out", ADDRESS], ["world", "--out", ADDRESS], ["report", ADDRESS],
        ["profile", "DATA", "--out", ADDRESS], ["train", ADDRESS, "--out", "x"],
        ["models", "show", "drone", "--out", ADDRESS],
        ["merge", ADDRESS, "x"], ["merge", "DATA", ADDRESS], ["generate", "paper", "--data", ADDRESS, "--out", "x"],
    ],
)  # fmt: skip
def test_commands_refuse_addresses(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DATA").mkdir()
    ended = run(*words)
    assert ended.exit_code == 2
    assert "found" in ended.output
    assert "s3://..." in ended.output
    assert "secret" not in ended.output
    assert [p.name for p in tmp_path.iterdir()] == ["DATA"]


def test_logs_hold_no_secrets_of_addresses(tmp_path: Path) -> None:
    handler = LogFileHandler(tmp_path / "log")
    error = OSError("no route to https://me:secret@host/a?signature=secret")
    handler.emit(logging.LogRecord("x", logging.INFO, "", 0, "%s", (error,), (OSError, error, None)))
    handler.close()
    assert (tmp_path / "log").read_text().count("https://...@host/a?...") == 2
    assert "secret" not in (tmp_path / "log").read_text()


def test_functions_write_to_no_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match="out: found an address"):
        api.make_world("s3://bucket/world", 1)
    with pytest.raises(ArgumentError, match="out: found an address"):
        write_bytes(Path("s3://bucket/a.png"), b"")
    assert not list(tmp_path.iterdir())


def test_no_command_writes_or_shows_an_address_with_a_password(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_commands_that_need_a_folder_show_what_to_do() -> None:
    with pytest.raises(DatasetError) as found:
        api.read_dataset(Path("s3://bucket/run"))
    assert "s3://bucket/run: no such folder" in str(found.value)
    assert "`infrablend merge` if it is a run" in str(found.value)


def test_addresses_survive_paths() -> None:
    for text in ("s3://bucket/a/b", "gs://b/c", "hf://datasets/user/name/run", "az://container/run"):
        assert address_of(text) == address_of(Path(text)) == address_of(f"{text}/") == shown(Path(text)) == text
        require_known("out", Path(text))
    assert address_of("runs/full") is None
    assert shown(Path("runs/full")) == "runs/full"


@pytest.mark.parametrize(
    "text", ["http://b/run", "memory://x/y", "s3://b", "s3://key@b/run", "gs://b/run?x=1", "s3://b/a/../c"]
)
def test_addresses_that_are_refused(text: str) -> None:
    with pytest.raises(ArgumentError, match=r"^out: found "):
        require_known("out", Path(text))


@pytest.mark.parametrize(
    ("address", "says"),
    [("abfs://container/run", "adlfs"), ("gs://bucket/run", "gcsfs"), ("nonsense://bucket/run", "nonsense")],
)
def test_storage_without_its_package_is_named(address: str, says: str) -> None:
    pytest.importorskip("fsspec", reason="NEEDS FSSPEC")
    with pytest.raises((MissingDependencyError, StorageError), match=says):
        Store(address)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("generate --out s3://user:secret@bucket/x --seed 1", "generate --out s3://...@bucket/x --seed 1"),
        ("fetch hit-uav --url https://me:se@cret@host/a.zip", "fetch hit-uav --url https://...@host/a.zip"),
        ("--out s3://b/run?token=se", "--out s3://b/run?..."),
        ("no '/a?b=c' at 'https://h/a?X-Amz-Signature=se' at all?", "no '/a?b=c' at 'https://h/a?...' at all?"),
        ("--data a@b/c C:/x@y s3://bucket/a@b", "--data a@b/c C:/x@y s3://bucket/a@b"),
    ],
)
def test_passwords_in_addresses_are_not_shown(text: str, shown: str) -> None:
    assert without_user(text) == shown
