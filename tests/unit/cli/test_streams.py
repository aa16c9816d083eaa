"""Where output and log go: full disks, pipes and files that are no logs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command_line import run
from tests.samples import SAMPLES

FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no /dev/full here")


def call(*words: object, stdout: object = subprocess.PIPE, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "infrablend", *map(str, words)],
        stdout=stdout,  # type: ignore[call-overload]
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
        timeout=120,
        check=False,
    )


@needs_full
@pytest.mark.parametrize("option", [[], ["--json"]])
def test_a_result_that_cannot_be_printed_is_a_named_error(option: list[str], tmp_path: Path) -> None:
    data = SAMPLES["coco"](tmp_path / "data")
    with FULL.open("w") as full:
        ended = call("check", data, *option, stdout=full, INFRABLEND_LOG=str(tmp_path / "log"))
    assert ended.returncode == 3, ended.stderr
    assert "could not be printed" in ended.stderr and "Traceback" not in ended.stderr


@needs_full
def test_a_full_disk_under_the_log_changes_nothing(tmp_path: Path) -> None:
    data = SAMPLES["coco"](tmp_path / "data")
    ended = call("check", data, INFRABLEND_LOG=str(FULL))
    assert ended.returncode == 0 and "clean" in ended.stdout and "Traceback" not in ended.stderr, ended.stderr


def test_a_warning_is_shown_once_and_logged_each_time(tmp_path: Path) -> None:
    code = (
        "import logging; from pathlib import Path; from infrablend.cli.call_state import open_session\n"
        f"with open_session(False, False, Path({str(tmp_path / 'log')!r})):\n"
        "    for text in ('first', 'second', 'first'):\n"
        "        logging.getLogger('x').warning('%s thing', text)\n"
        "        logging.getLogger('x').error('%s fault', text)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert (ended.stderr.count("first thing"), ended.stderr.count("second thing")) == (1, 1)
    assert ended.stderr.count("first fault") == 2
    assert (tmp_path / "log").read_text().count("first thing") == 2


def test_a_file_that_is_no_log_is_left_alone(tmp_path: Path) -> None:
    data = SAMPLES["coco"](tmp_path / "data")
    labels = sorted(data.rglob("*.json"))[0]
    before = labels.read_bytes()
    ended = run("--log", labels, "check", data)
    assert ended.exit_code == 2 and "not a log of InfraBlend" in ended.output
    assert labels.read_bytes() == before
    os.mkfifo(tmp_path / "pipe")
    assert "not a log of InfraBlend" in run("--log", tmp_path / "pipe", "check", data).output
    for _ in range(2):  # the second call appends
        assert run("--log", tmp_path / "my.log", "check", data).exit_code == 0
    assert (tmp_path / "my.log").read_text().count("infrablend ") >= 2


def test_records_of_any_size_are_refused_without_reading_them(tmp_path: Path) -> None:
    data = SAMPLES["coco"](tmp_path / "data")
    made = tmp_path / "voc"
    assert run("convert", data, made, "--to", "voc").exit_code == 0
    with (made / "convert.json").open("rb+") as record:
        record.truncate(3 << 30)  # sparse
    for words in (["check", made], ["convert", data, made, "--to", "voc", "--overwrite"]):
        ended = run(*words)
        assert ended.exit_code in (0, 1, 2) and "Unexpected" not in ended.output, ended.output
