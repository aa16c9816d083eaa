"""From any broken or hostile dataset, a reader returns a dataset or raises one of our errors.

The damage and the watch for file access are in tests/fuzzing.py; the damaged datasets are those of tests/samples.py.
"""

from __future__ import annotations

import json
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.fuzzing import bounded_memory, exercise, make_outside, mutate, watched, with_size
from tests.samples import SAMPLES, picture

from infrablend import api
from infrablend.errors import DatasetError
from infrablend.formats import annotation_files
from infrablend.formats.pictures.listing import read_size

pytestmark = pytest.mark.long

GROWTH_KIB = 700 * 1024


@pytest.mark.parametrize("name", sorted(SAMPLES))
@settings(max_examples=40)
@given(st.integers(0, 2**32), st.integers(1, 4))
def test_broken_samples_give_a_dataset_or_our_own_error(name: str, seed: int, times: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = SAMPLES[name](Path(folder) / "data")
        outside = make_outside(Path(folder) / "outside")
        choose = random.Random(seed)
        done = [mutate(root, outside, choose) for _ in range(times)]
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with bounded_memory(), watched(root, outside) as seen:
            exercise(root, name.partition(":")[0])
        assert seen == [], done
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < GROWTH_KIB, done


def test_file_watch_detects_access(tmp_path: Path) -> None:
    outside = make_outside(tmp_path / "outside")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "a.txt").symlink_to(outside / "secret.txt")
    with watched(tmp_path / "data", outside) as seen:
        (tmp_path / "data" / "a.txt").read_text()
        list(outside.iterdir())
        (tmp_path / "data" / "b.txt").write_text("x")
    listing = "os.listdir" if sys.version_info < (3, 13) else "os.scandir"
    assert [s.split()[0] for s in seen] == ["open", listing, "open"]


MEASURE = """
import resource, sys
from pathlib import Path
from infrablend import api
from infrablend.errors import InfraBlendError
from infrablend.formats.read_write import Reading
import infrablend.formats.published.hit_uav, infrablend.formats.labels.coco, infrablend.formats.labels.yolo
import infrablend.report.checking
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    report = api.check(sys.argv[1], reading=Reading(format=sys.argv[2]))
    print(sorted(report.by_code()))
except InfraBlendError as error:
    print([p.code for p in error.problems])
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def measure(root: Path, format: str) -> tuple[str, int]:
    """Return the output of `check`, and the growth of the process in KiB."""
    command = [sys.executable, "-c", MEASURE, str(root), format]
    out = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert out.returncode == 0, out.stderr
    said, grown = out.stdout.splitlines()
    return said, int(grown)


@pytest.mark.parametrize("name", ["hit-uav:json", "coco", "monet"])
def test_a_gigabyte_of_json_is_read_until_the_first_fault(name: str, tmp_path: Path) -> None:
    root = SAMPLES[name](tmp_path / "data")
    for path in root.rglob("*.json"):
        with path.open("wb") as file:
            file.write(b'{"images": [')
            file.truncate(1 << 30)  # sparse: it costs no disk
    said, grown = measure(root, name.partition(":")[0])
    assert "annotation-not-json" in said, said
    assert grown < 100 * 1024


@pytest.mark.slow
def test_gigabytes_of_other_text_are_refused_unread(tmp_path: Path) -> None:
    for name in ("yolo:detect", "voc", "dota", "folder:yolo", "hit-uav:xml"):
        root = SAMPLES[name](tmp_path / name.replace(":", "-"))
        for path in [p for p in root.rglob("*") if p.suffix in (".txt", ".xml", ".yaml", ".csv")]:
            with path.open("ab") as file:
                file.truncate(1 << 30)
        said, grown = measure(root, name.partition(":")[0])
        assert "annotation-too-large" in said, (name, said)
        assert grown < 100 * 1024, name


@pytest.mark.parametrize("text", ['{"a":' * 200_000, "[" * 10_000_000, '{"images": ' + "[" * 900 + "]" * 900 + "}"])
def test_json_nested_too_deeply_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "train.json"
    path.write_text(text)
    with pytest.raises(DatasetError, match="nested"):
        annotation_files.read_json(path)


@pytest.mark.slow
def test_json_of_many_tiny_values_is_never_built(tmp_path: Path) -> None:
    root = SAMPLES["coco"](tmp_path / "data")
    first, *others = sorted(root.rglob("*.json"))
    first.write_text('{"images": [' + "[]," * 6_000_000 + "[]]}")
    for path in others:
        path.unlink()
    said, grown = measure(root, "coco")
    assert "annotation-missing" in said, said
    assert grown < 100 * 1024  # as lists they would take 400 MB


@pytest.mark.parametrize("side", [12_000, 30_000])
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_giant_header_is_refused(suffix: str, side: int, tmp_path: Path) -> None:
    path = picture(tmp_path / f"a{suffix}", 1)
    path.write_bytes(with_size(path.read_bytes(), side, side))
    size_wh, problem = read_size(path, "a")
    assert size_wh is None and problem is not None and problem.code == "image-too-large"
    assert api.check(tmp_path).by_code() == {"image-too-large": 1}


def test_link_to_a_file_outside_is_a_clear_error(tmp_path: Path) -> None:
    for name in ("yolo:detect", "folder:yolo", "hit-uav:json", "coco"):
        root = SAMPLES[name](tmp_path / name.replace(":", "-"))
        outside = make_outside(tmp_path / "outside")
        path = sorted(root.rglob("*.jpg"))[0]
        shutil.move(path, outside / path.name)
        path.symlink_to(outside / path.name)
        report = api.check(root)
        assert report.by_code().get("name-climbs", 0) >= 1, (name, report.by_code())
        assert json.dumps(report.to_json())
