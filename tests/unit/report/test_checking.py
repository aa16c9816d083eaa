"""`check`: problems found, messages, exit codes."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFile
from typer.testing import CliRunner, Result

from infrablend import api
from infrablend.cli.app import build_app
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.report import checking
from infrablend.report.checking import check_objects
from tests.file_opens import count_opens
from tests.samples import SAMPLES


def run(*words: object) -> Result:
    return CliRunner().invoke(build_app(), ["check", *map(str, words)])


def codes(root: Path, **options: bool) -> dict[str, int]:
    return api.check(root, **options).by_code()


@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_samples_have_no_errors(name: str, tmp_path: Path) -> None:
    root = SAMPLES[name](tmp_path / "data")
    for decode in (True, False):
        report = api.check(root, decode=decode)
        assert [str(p) for p in report.errors] == []
        assert report.images == len(api.read_dataset(root).images)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["hit-uav:json"](tmp_path / "data")


def pictures(root: Path, name: str) -> list[Path]:
    return sorted(root.rglob(name))


def edit(path: Path, change) -> None:
    top = json.loads(path.read_text())
    change(top)
    path.write_text(json.dumps(top))


def test_a_broken_picture_and_one_of_another_size(data: Path) -> None:
    for path in pictures(data, "1_90_90_0_00034.jpg"):
        path.write_bytes(path.read_bytes()[:-60])
    for path in pictures(data, "1_90_60_0_00023.jpg"):
        path.unlink()
        Image.fromarray(np.arange(40 * 40, dtype=np.uint8).reshape(40, 40)).save(path)
    # The person's box 40..50 lies outside the true size.
    assert codes(data) == {"box-outside": 1, "image-size": 1, "image-truncated": 1}
    assert codes(data, decode=False) == {"box-outside": 1, "image-size": 1}
    ended = run(data)
    assert ended.exit_code == 1
    assert "test/1_90_90_0_00034.jpg" in ended.stdout and "3 error(s)" in ended.stdout


def test_copies_across_splits_are_errors_and_within_one_warnings(data: Path) -> None:
    source = pictures(data, "0_60_30_0_00001.jpg")[0]
    for target in pictures(data, "1_90_90_0_00034.jpg") + pictures(data, "1_90_60_0_00012.jpg"):
        target.unlink()
        shutil.copy(source, target)
    for decode in (True, False):
        report = api.check(data, decode=decode)
        assert report.by_code() == {"image-leak": 1}
        assert "train/0_60_30_0_00001.jpg" in report.errors[0].found and "test/1_90" in report.errors[0].found
    for target in pictures(data, "1_90_90_0_00034.jpg"):
        target.unlink()
        Image.fromarray(np.tile(np.arange(64, dtype=np.uint8), (48, 1))).save(target)
    assert codes(data) == {"image-repeated": 1}


def test_empty_picture(data: Path) -> None:
    for path in pictures(data, "1_90_90_0_00034.jpg"):
        path.unlink()
        Image.fromarray(np.full((48, 64), 90, np.uint8)).save(path)
    report = api.check(data)
    assert report.by_code() == {"image-constant": 1} and report.ok() and not report.ok(strict=True)
    assert (run(data).exit_code, run(data, "--strict").exit_code) == (0, 1)
    assert codes(data, decode=False) == {}


def test_impossible_labels(data: Path) -> None:
    def spoil(top: dict) -> None:
        person, bicycle = json.loads(json.dumps(top["annotation"][0])), top["annotation"][0]
        bicycle["category_id"] = 77
        for k, box in enumerate(([10, 20, 0, 5], [float("nan"), 0, 5, 5], [600, 5, 9, 9], [60, 40, 9, 9], "none")):
            top["annotation"].append(person | {"id": 900 + k, "bbox": box})
        top["images"].append({"id": 901, "filename": "../../secret.jpg", "width": 64, "height": 48})

    (data / "normal_json/test/extra.jpg").write_bytes(pictures(data, "1_90_90_0_00034.jpg")[0].read_bytes())
    edit(data / "normal_json/annotations/test.json", spoil)
    shutil.rmtree(data / "rotate_json")
    report = api.check(data)
    assert report.by_code() == {
        "box-empty": 1, "box-malformed": 1, "box-not-finite": 1, "box-outside": 1, "category-unknown": 1,
        "name-climbs": 1, "box-clipped": 1, "image-unlisted": 1,
    }  # fmt: skip
    assert all("annotations/test.json" in p.where for p in report.problems if p.code != "image-unlisted")
    ended = run(data, "--json")
    listed = json.loads(ended.stdout)
    assert ended.exit_code == 1 and (listed["errors"], listed["warnings"]) == (6, 2)
    assert [p["code"] for p in listed["problems"]] == sorted(p["code"] for p in listed["problems"][:6]) + [
        "box-clipped",
        "image-unlisted",
    ]


def test_problems_that_differ_in_their_place_only_share_a_line(tmp_path: Path) -> None:
    for k in range(9):
        Image.fromarray(np.full((8, 9, 3), (200, 40 + k, 10), np.uint8)).save(tmp_path / f"{k}.png")
    lines = [line for line in run(tmp_path).stdout.splitlines() if "in colour" in line]
    assert len(lines) == 1 and "train/0.png, train/1.png, train/2.png and 6 more: in colour" in lines[0]


def test_the_work_for_duplicates_grows_with_their_number_and_not_its_square(monkeypatch: pytest.MonkeyPatch) -> None:
    """2,000 objects, each of them twice: each is looked at a bounded number of times."""
    calls = 0
    key = checking._key

    def counted(o: Instance) -> tuple[object, ...]:
        nonlocal calls
        calls += 1
        return key(o)

    monkeypatch.setattr(checking, "_key", counted)
    boxes = [np.array([k % 600, k % 500, k % 600 + 5, k % 500 + 5], np.float64) for k in range(1_000)]
    many = tuple(Instance("Car", b) for b in boxes * 2)
    found = check_objects(ImageRecord("a", Path("a.png"), "train", (640, 512), many), "a", (640, 512))
    assert sum(p.code == "object-duplicate" for p in found) >= 500
    assert calls <= 2 * len(many)


def test_duplicates_and_boxes_that_disagree() -> None:
    box = np.array([10.0, 10.0, 20.0, 20.0])
    corners = np.array([[10.0, 10.0], [20.0, 10.0], [20.0, 24.0], [10.0, 24.0]])
    labels = (
        Instance("Car", box),
        Instance("Car", box.copy()),
        Instance("Person", box),
        Instance("Car", box, corners),
        Instance("Truck", box, corners, inserted=True),
        Instance("Car", np.array([1.0, 1.0, 1.5, 9.0])),
    )
    image = ImageRecord("a", Path("a.png"), "train", (64, 48), labels)
    found = {(p.where, p.code) for p in check_objects(image, "a", (64, 48))}
    assert found == {("a: object 1", "object-duplicate"), ("a: object 3", "obb-disagrees"), ("a: object 5", "box-tiny")}


def test_text_labels_without_a_picture_and_lines_given_twice(tmp_path: Path) -> None:
    root = SAMPLES["yolo:detect"](tmp_path / "data")
    (root / "labels/train/orphan.txt").write_text("0 0.5 0.5 0.1 0.1\n")
    label = root / "labels/test/1_90_90_0_00034.txt"
    label.write_text(label.read_text() * 2)
    report = api.check(root)
    assert report.by_code() == {"label-without-picture": 1, "object-duplicate": 1}
    assert {p.where for p in report.warnings} == {"labels/train/orphan.txt", "labels/test/1_90_90_0_00034.txt: line 2"}


def test_unreadable_dataset_and_wrong_usage_have_different_exit_codes(data: Path, tmp_path: Path) -> None:
    for path in data.rglob("*.json"):
        path.write_text("{")
    ended = run(data, "--json")
    assert ended.exit_code == 1
    assert set(json.loads(ended.stdout)["by_code"]) == {"annotation-not-json", "more"}
    assert run(tmp_path / "nowhere").exit_code == 2
    assert run(data, "--read", "colour=red").exit_code == 2
    assert run(data, "--form", "no_form").exit_code == 2
    assert run(data, "--split", "dev").exit_code == 2
    (tmp_path / "empty").mkdir()
    assert run(tmp_path / "empty").exit_code == 2


def test_real_labels_are_clean_and_no_picture_is_decoded(real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time that it takes is in bench/reading.py; what costs most of it is counted here."""
    root = real_data / "hit-uav"
    monkeypatch.setattr(ImageFile.ImageFile, "load", lambda picture: pytest.fail("a picture is decoded"))
    with count_opens(root) as opens:
        report = api.check(root, decode=False)
    assert report.images == 1869 and report.by_code() == {"form-partial": 2}
    pictures = [n for p, n in opens.items() if p.suffix == ".jpg"]
    assert len(pictures) == 1869
    assert sum(pictures) < 2_000  # once for its size, again only where another file has as many bytes
    assert max(opens.values()) <= 2, "detection looks into annotation files, then they are read once"


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_pictures(real_data: Path) -> None:
    code = (
        "import resource, sys; from infrablend import api; from infrablend.report import checking\n"
        "from dataclasses import replace\n"
        "d = api.read_dataset(sys.argv[1]); d = replace(d, images=d.images[: int(sys.argv[2])])\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "checking.check_dataset(d); print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    grown = [
        int(subprocess.check_output([sys.executable, "-c", code, str(real_data / "hit-uav"), str(n)]).decode())
        for n in (200, 1869)
    ]
    page_kib = resource.getpagesize() / 1024
    assert grown[1] - grown[0] < 10_000 + page_kib, grown


# -- label files that nobody can read


@pytest.mark.parametrize(
    ("sample", "pattern", "change"),
    [
        ("voc", "*.xml", lambda text: text[: len(text) // 2]),
        ("voc", "*.xml", lambda text: ""),
        ("voc:flat", "*.xml", lambda text: '<!DOCTYPE annotation SYSTEM "x.dtd">' + text),
        ("coco", "*.json", lambda text: text[: len(text) // 2]),
        ("coco", "*.json", lambda text: ""),
    ],
)
def test_label_files_that_cannot_be_read_are_errors_by_name(tmp_path, sample, pattern, change) -> None:
    root = SAMPLES[sample](tmp_path / "data")
    damaged = sorted(root.rglob(pattern))
    for path in damaged:
        path.write_text(change(path.read_text()))
    errors = api.check(root, decode=False).errors
    for path in damaged:
        name = path.relative_to(root).as_posix()
        assert any(name in (p.where, *p.found.split()) or path.name == p.where for p in errors), name


def test_label_files_of_another_name_are_errors_too(tmp_path) -> None:
    root = SAMPLES["yolo:detect"](tmp_path / "data")
    for path in sorted(root.rglob("labels/train/*.txt")):
        path.rename(path.with_suffix(".TXT"))
    assert codes(root, decode=False)["label-unread"] == 2
    (root / "data.yaml").unlink()  # a plain folder of pictures and labels
    ended = run(root, "--json", "--no-decode")
    assert (ended.exit_code, json.loads(ended.stdout)["by_code"]["label-unread"]) == (1, 2)
    broken = SAMPLES["coco"](tmp_path / "coco")
    (broken / "annotations" / "more.json").write_text('{"images": [{"id": 1')
    assert codes(broken, decode=False)["label-unread"] == 1


def test_a_damaged_file_does_not_hide_intact_annotations(tmp_path) -> None:
    root = SAMPLES["voc"](tmp_path / "data")
    for k in range(30):
        (root / "Annotations" / f"0{k}.xml").write_text("<annotation><obj")
    report = api.check(root, decode=False)
    assert (report.format, len(report.errors)) == ("voc", 30) and report.objects > 0
