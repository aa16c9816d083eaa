"""Counts and charts of `inspect`."""

from __future__ import annotations

import hashlib
import itertools
import json
import uuid
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from infrablend import api
from infrablend.cli.app import build_app
from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord
from infrablend.errors import DatasetError, OutputError
from infrablend.formats.image_groups import frame_places, group_images, leakage
from infrablend.report.inspection import _binned, write_charts
from tests.samples import SAMPLES, with_facts


def image(name: str, split: str = "train", **facts: object) -> ImageRecord:
    return ImageRecord(f"{split}/{name}", Path(name), split, None, (), Capture(**facts), file_name=name)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_every_sample_can_be_inspected(name: str, tmp_path: Path) -> None:
    root = SAMPLES[name](tmp_path / "data")
    facts = api.inspect(root, tmp_path / "out", decode=True)
    dataset = api.read_dataset(root)
    assert facts.format == name.partition(":")[0] and facts.reason
    assert sum(of["images"] for of in facts.splits.values()) == len(dataset.images)
    objects = sum(len(i.instances) for i in dataset.images)
    assert sum(of["objects"] + of["ignore_regions"] for of in facts.splits.values()) == objects
    assert sum(n for of in facts.classes.values() for n in of.values()) == objects == facts.labels["boxes"]
    assert sum(facts.coverage.values()) == len(dataset.images) == sum(facts.decoded["pictures"].values())
    written = json.loads((tmp_path / "out" / "inspect.json").read_text())
    assert {k: written[k] for k in facts.to_json()} == json.loads(json.dumps(facts.to_json()))
    with Image.open(tmp_path / "out" / "inspect.png") as chart:
        assert chart.size == (1300, 900)
    once = (tmp_path / "out" / "inspect.png").read_bytes()
    assert write_charts(facts, tmp_path / "again.png").read_bytes() == once


def test_charts_replace_earlier_charts_and_no_other_file(tmp_path: Path, write_tiny_hit_uav) -> None:
    data, out = write_tiny_hit_uav(tmp_path / "data"), tmp_path / "out"
    for _ in range(2):
        api.inspect(data, out)
    (out / "inspect.json").write_text("{}")
    with pytest.raises(OutputError, match="not a report of InfraBlend"):
        api.inspect(data, out)
    assert (out / "inspect.json").read_text() == "{}"


def test_numbers_of_the_tiny_hit_uav(tmp_path: Path, write_tiny_hit_uav) -> None:
    facts = api.inspect(write_tiny_hit_uav(tmp_path / "data"))
    assert facts.splits["train"] == {"images": 2, "objects": 2, "ignore_regions": 0, "without_objects": 1}
    assert facts.splits["val"] == {"images": 1, "objects": 1, "ignore_regions": 1, "without_objects": 0}
    assert facts.ignored == ("DontCare",)
    assert facts.quantiles("Bicycle")["0.5"] == pytest.approx(np.sqrt(24 * 12), abs=0.01)
    assert facts.quantiles("DontCare")["1"] == pytest.approx(np.sqrt(80 * 40), abs=0.01)
    assert facts.coverage["30°", "60 m"] == 1
    assert (facts.pitches, facts.altitudes) == (("30°", "50°", "60°", "90°"), ("60 m", "90 m", "100 m", "130 m"))
    assert facts.time_of_day == {"train": {"day": 1, "night": 1}, "val": {"night": 1}, "test": {"day": 1}}
    assert facts.dates == {"2021-01-01": 4}
    assert set(facts.sequences) == {
        "20210101-day-60m-30deg", "20210101-night-90m-60deg", "20210101-night-100m-50deg", "20210101-day-130m-90deg",
    }  # fmt: skip
    assert facts.remarks == ()  # HIT-UAV's layout, not HIT-UAV


def test_text_for_people_and_json_for_programs(tmp_path: Path, write_tiny_hit_uav) -> None:
    root = write_tiny_hit_uav(tmp_path / "data")
    (root / "normal_json" / "val" / "1_100_50_0_00003.jpg").unlink()
    (root / "rotate_json" / "val" / "1_100_50_0_00003.jpg").unlink()
    made = CliRunner().invoke(build_app(), ["inspect", str(root), "--decode"])
    assert made.exit_code == 0, made.output
    for text in ("objects by class", "DontCare (ignored)", "130 m", "JPEG, 8 bit, 1 channel 3", "annotations/val.json"):
        assert text in made.stdout, text
    data = json.loads(CliRunner().invoke(build_app(), ["inspect", str(root), "--json"]).stdout)
    assert [p["code"] for p in data["problems"]] == ["image-missing"]
    assert data["leakage"][0] == {"split": "test", "other": "train", "images": 1, "near": 1, "distance": 5}


def test_pictures_without_labels_get_no_table_of_classes(tmp_path: Path) -> None:
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(tmp_path / "a.png")
    shown = CliRunner().invoke(build_app(), ["inspect", str(tmp_path)]).output
    assert "images" in shown and "objects by class" not in shown


def test_bins_contain_the_stated_range() -> None:
    assert _binned([30.0, None, -5.0], "°") == (["30°", "unknown", "-5°"], ("-5°", "30°", "unknown"))
    of, order = _binned([float(v) for v in range(0, 100, 3)], " m")
    assert order[0] == "0 to 10 m" and order[-1] == "90 to 100 m" and len(order) == 10
    assert of[4] == "10 to 20 m"
    assert len(_binned([float(v) for v in range(1000)], " m")[1]) <= 12


def frame_place(one: ImageRecord) -> tuple[str, int] | None:
    return frame_places([one])[0]


def test_frames_are_counted_within_their_own_numbering() -> None:
    assert frame_place(image("1_130_90_0_04077_c2.jpg")) == ("", 4077)
    assert frame_place(image("clip a/x 12.jpg")) == ("clip a/x *", 12)
    # The number of a generated picture is that of its background, and not that of its scene.
    assert frame_place(image("clip a/x 12_c0.jpg")) == frame_place(image("clip a/x 12_c3-1.jpg")) == ("clip a/x *", 12)
    assert frame_place(image("clip a/x 12.jpg", sequence="7")) == ("7", 12)
    assert frame_place(image("a.jpg", sequence="7", frame=3)) == ("7", 3)
    assert frame_place(image("a.jpg")) is None
    near = [image("a/1.jpg"), image("a/6.jpg", "test"), image("b/2.jpg", "test"), image("a/12.jpg", "test")]
    (one,) = leakage(near)
    assert (one.split, one.other, one.images, one.near) == ("test", "train", 3, 1)
    assert leakage(near, 11)[0].near == 2
    assert leakage([image("a/1.jpg")]) == ()


@pytest.mark.parametrize(
    "form",
    [
        "DJI_{n:04}_jpg.rf.{hash}.jpg",
        "DJI_{n:04}_png.rf.{hash}.jpg",
        "{short}-DJI_{n:04}.jpg",
        "{uuid}_{n:04}.jpg",
        "DJI_2024051412{n:04}_{n:04}_T.JPG",
        "clip{clip}_{n:04}_640x512.png",
        "clip{clip}_{n:04}_640.png",
        "clip{clip}_{n:04}_v2_8.png",
        "{clip}/{n}.png",
    ],
)
@pytest.mark.parametrize("copy", ["", "_v2", "_320x256", "_crop3", "_aug_7", " (1)", "_v2 (1)"])
def test_the_digits_that_count_are_frame_numbers(form: str, copy: str) -> None:
    """Two clips with three runs of four frames, and copies of every second frame: copies stay with their frame."""
    images = []
    for clip, n in itertools.product((1, 2), (1, 2, 3, 4, 51, 52, 53, 54, 91, 92, 93, 94)):
        for suffix in ("", copy) if n % 2 and copy else ("",):
            number = n if "{clip}" in form else n + 1000 * (clip - 1)
            key = hashlib.sha256(f"{clip} {n} {suffix}".encode()).hexdigest()
            ids = {"hash": key[:32], "short": key[:8], "uuid": uuid.UUID(key[:32]), "clip": clip, "n": number}
            marks = [m for m in ("_jpg.rf", "_png.rf", ".") if m in form]
            stem, dot, ending = form.format(**ids).partition(marks[0])
            images.append(image(f"{stem}{suffix}{dot}{ending}"))
    groups = group_images(images, "gap").values()
    assert len(groups) == 6 and len({len(g) for g in groups}) == 1


def test_words_of_hexadecimal_letters_are_no_hashes() -> None:
    for name in ("face0012.jpg", "bead_0012.jpg", "decade00000012.jpg", "20240514_0012.jpg"):
        place = frame_place(image(name))
        assert place is not None and place[1] == 12, name
    assert frame_place(image("3fa9c2bd77e01b.jpg")) is None


def test_groups_are_runs_days_or_flights() -> None:
    images = [image(f"a/{n}.jpg", captured=f"2021-01-0{n % 2 + 1}T10:00", sequence=f"s{n % 3}") for n in (1, 2, 7, 13)]
    plain = [with_facts(i, sequence=None) for i in images]
    names = {by: [[i.name for i in g] for g in group_images(images, by).values()] for by in ("date", "sequence")}
    names["gap"] = [[i.name for i in g] for g in group_images(plain, "gap", 5).values()]
    assert names["gap"] == [["a/1.jpg", "a/2.jpg", "a/7.jpg"], ["a/13.jpg"]]
    assert names["date"] == [["a/2.jpg"], ["a/1.jpg", "a/7.jpg", "a/13.jpg"]]
    assert names["sequence"] == [["a/1.jpg", "a/7.jpg", "a/13.jpg"], ["a/2.jpg"]]
    with pytest.raises(DatasetError, match="1 of 4 images without a date of capture"):
        group_images([with_facts(images[0], captured=None), *images[1:]], "date")


def test_real_data_leaks_and_says_so(real_data: Path) -> None:
    facts = api.inspect(real_data / "hit-uav", reading=api.Reading(form="rotate_json"))
    test = facts.leakage[0]
    assert (test.split, test.other, test.images) == ("test", "train", 579)
    # 525 with all 2,029 training images; 1,000 of them are here.
    assert test.near == 403
    text = "\n".join(facts.remarks)
    assert "525 of the 579" in text and "24 boxes labelled Car in 4 picture(s) are people" in text
    assert len(facts.dates) == 9 and facts.quantiles("Person")["0.5"] == pytest.approx(15, abs=0.5)
    assert sum(facts.coverage.values()) == 1869
