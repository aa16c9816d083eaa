"""MONET: places of telemetry, the sign of its pitch, sequences without any, unusual layouts."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from infrablend import api
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder, writing
from infrablend.formats.published import monet
from infrablend.formats.read_write import Reading
from tests.samples import with_facts

CATEGORIES = [{"id": 1, "name": "person"}, {"id": 2, "name": "vehicle"}]


def picture(path: Path, size_wh: tuple[int, int] = (64, 48)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full(size_wh[::-1], 90, np.uint8)).save(path)
    return path


def sequence(
    root: Path,
    name: str,
    telemetry: list[Any],
    *,
    split: str = "train",
    nest: str | None = "metadata",
    file: str = "{split}/{name}.json",
    names: str = "lwir/image{k:05d}.png",
    change: Callable[[dict[str, Any]], object] | None = None,
) -> Path:
    """Pictures of one sequence and their JSON; an image's telemetry is an object, put into `nest` or the record."""
    images = []
    for k, t in enumerate(telemetry):
        picture(root / split / name / "lwir" / f"image{k:05d}.png")
        record = {"id": k, "file_name": names.format(k=k, split=split, name=name), "width": 64, "height": 48}
        images.append(record | (t if nest is None else {nest: t}))
    boxes = [
        {"id": k, "image_id": k, "category_id": 1 + k % 2, "bbox": [5, 6, 9, 8 + k]} for k in range(len(telemetry))
    ]
    top = {"images": images, "annotations": boxes, "categories": CATEGORIES}
    if change is not None:
        change(top)
    path = root / file.format(split=split, name=name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(top))
    return path


def down(*pitches: float | None) -> list[dict[str, Any]]:
    return [{} if p is None else {"g_pitch": p, "alt": 51} for p in pitches]


def codes(dataset: Dataset, severity: str = "warning") -> list[str]:
    return sorted(p.code for p in dataset.problems if p.severity == severity)


# ---- places of telemetry


@pytest.mark.parametrize(
    ("nest", "telemetry", "options"),
    [
        ("metadata", {"g_pitch": -35, "alt": 99.5}, {}),
        ("telemetry", {"g_pitch": "-35", "alt": "99.5"}, {}),
        (None, {"g_pitch": -35.0, "alt": 99.5}, {}),
        ("drone", {"cam": {"p": -35}, "h": 99.5}, {"pitch_key": "drone.cam.p", "altitude_key": "h"}),
        (None, {"tilt": -math.radians(35), "alt": 99.5}, {"pitch_key": "tilt", "angle_unit": "rad"}),
    ],
)
def test_telemetry_is_found(tmp_path: Path, nest: str | None, telemetry: Any, options: dict[str, str]) -> None:
    sequence(tmp_path, "runway_04", [telemetry], nest=nest)
    d = dataset_folder.read(tmp_path, Reading(options=options))
    (image,) = d.images
    assert d.format == "monet"
    assert (image.capture.altitude_m, image.capture.sequence, image.split, image.id) == (
        99.5,
        "runway_04",
        "train",
        "runway_04_image00000",
    )
    assert image.capture.pitch_deg == pytest.approx(35, abs=1e-12)
    assert d.notes["gimbal_pitch"]["sign"] == -1 and codes(d) == ["pitch-sign"]


def test_telemetry_may_be_a_list_beside_the_images(tmp_path: Path) -> None:
    def move(top: dict[str, Any]) -> None:
        top["meta"] = [{"image_id": i["id"], **i.pop("metadata")} for i in top["images"]]

    sequence(tmp_path, "runway_04", down(-35, -40), change=move)
    d = dataset_folder.read(tmp_path)
    assert [i.capture.pitch_deg for i in d.images] == [35, 40]
    writing.write("native", tmp_path / "out", d.images, d.categories, source=d)
    assert [i.capture.pitch_deg for i in dataset_folder.read(tmp_path / "out").images] == [35, 40]


def test_telemetry_belongs_to_ids_that_are_texts(tmp_path: Path) -> None:
    def as_text(top: dict[str, Any]) -> None:
        for record in top["images"]:
            record["id"] = str(record["id"])
        for record in top["annotations"]:
            record["image_id"] = str(record["image_id"])

    sequence(tmp_path, "runway_04", down(-35, -40), change=as_text)
    d = dataset_folder.read(tmp_path)
    assert [i.capture.pitch_deg for i in d.images] == [35, 40] and all(len(i.instances) == 1 for i in d.images)


def test_missing_key_error_lists_existing_keys(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", [{"gimbalPitch": -35, "speed": {"x": {"m_s": 1}}}])
    with pytest.raises(DatasetError, match=r"no telemetry in 1 image") as caught:
        dataset_folder.read(tmp_path)
    assert "metadata.gimbalPitch, metadata.speed.x.m_s" in str(caught.value) and "pitch_key=KEY" in str(caught.value)
    assert (
        dataset_folder.read(tmp_path, Reading(options={"pitch_key": "gimbalPitch"})).images[0].capture.pitch_deg == 35
    )
    d = dataset_folder.read(tmp_path, Reading(options={"empty": "keep"}))
    assert [i.capture.pitch_deg for i in d.images] == [None] and d.notes["frames_without_pitch"] == {
        "train/runway_04": 1
    }


# ---- the sign


def test_the_majority_looks_down_and_the_rest_is_kept(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", down(-35, -90.4, 40, 0))
    d = dataset_folder.read(tmp_path)
    assert [i.capture.pitch_deg for i in d.images] == [35, 90, -40, 0]
    assert math.copysign(1, d.images[3].capture.pitch_deg or 0) == 1
    facts = d.notes["gimbal_pitch"]
    assert (facts["below_0"], facts["above_0"], facts["beyond_90_clamped"], facts["sign_from"]) == (2, 1, 1, "majority")
    assert "2 values below 0, 1 above" in str(next(p for p in d.problems if p.code == "pitch-sign"))
    other = sequence(tmp_path / "b", "runway_04", down(35, 90, -40))
    d = dataset_folder.read(other.parents[1])
    assert [i.capture.pitch_deg for i in d.images] == [35, 90, -40] and d.notes["gimbal_pitch"]["sign"] == 1


def test_pitch_sign_overrides_and_silences(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", down(-35, 40))
    with pytest.raises(DatasetError, match="cannot be determined"):
        dataset_folder.read(tmp_path)
    for sign, pitches in (("-1", [35, -40]), ("+1", [-35, 40])):
        d = dataset_folder.read(tmp_path, Reading(options={"pitch_sign": sign}))
        assert [i.capture.pitch_deg for i in d.images] == pitches and codes(d) == []
    sequence(tmp_path, "runway_05", down(-35, -40))
    with pytest.raises(DatasetError, match="more than half of the pitches are negative"):
        dataset_folder.read(tmp_path, Reading(options={"pitch_sign": "1"}))


def test_opposite_pitch_sign_in_one_file_stops_the_reader(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", down(-35, -36, -37, -38))
    sequence(tmp_path, "runway_05", down(35, 36, -1))
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(tmp_path)
    assert [p.where for p in caught.value.problems] == ["train/runway_05.json"]
    assert "2 of 3 cameras look up" in str(caught.value)
    assert len(dataset_folder.read(tmp_path, Reading(options={"pitch_sign": "-1"})).images) == 7


def test_small_numbers_are_suspected_to_be_radians(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", down(*(-0.1 * k for k in range(1, 12))))
    assert "pitch-unit" in codes(dataset_folder.read(tmp_path))
    d = dataset_folder.read(tmp_path, Reading(options={"angle_unit": "rad"}))
    assert "pitch-unit" not in codes(d) and d.images[0].capture.pitch_deg == pytest.approx(5.7296, abs=1e-4)


# ---- sequences and frames without telemetry


def test_empty_sequences_are_left_out_and_counted(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_01", down(None, None))
    sequence(tmp_path, "runway_04", down(-35, None, -37))
    d = dataset_folder.read(tmp_path)
    assert [i.capture.pitch_deg for i in d.images] == [35, None, 37]
    assert d.notes["excluded"] == {"train/runway_01": {"why": "no telemetry in any frame", "images": 2, "labels": 2}}
    assert d.notes["frames_without_pitch"] == {"train/runway_04": 1}
    assert d.notes["gimbal_pitch"]["missing"] == 3
    assert d.notes["pitch"] == "annotation (2 of 3), none (1 of 3)"
    assert codes(d) == ["pitch-sign", "sequence-excluded"]
    kept = dataset_folder.read(tmp_path, Reading(options={"empty": "keep"}))
    assert len(kept.images) == 5 and codes(kept) == ["pitch-sign"]


def test_sequences_are_left_out_by_name(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_01", down(-35))
    sequence(tmp_path, "runway_04", down(-35, -36))
    d = dataset_folder.read(tmp_path, Reading(options={"exclude": "runway_01, dirtroad_01"}))
    assert {i.capture.sequence for i in d.images} == {"runway_04"}
    assert d.notes["excluded"]["train/runway_01"]["images"] == 1
    assert codes(d) == ["option-value", "pitch-sign", "sequence-excluded"]
    with pytest.raises(DatasetError, match="nothing to read"):
        dataset_folder.read(tmp_path, Reading(options={"exclude": "runway_01,runway_04"}))


def test_a_table_counts_more_and_fills_an_empty_sequence(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_01", down(None))
    sequence(tmp_path, "runway_04", down(-35))
    (tmp_path / "metadata.csv").write_text(
        "file,pitch_deg,time_of_day\nrunway_01,20,night\nrunway_04/lwir/image00000.png,36,\nz,1,\n"
    )
    d = dataset_folder.read(tmp_path)
    assert [(i.capture.sequence, i.capture.pitch_deg, i.capture.time_of_day) for i in d.images] == [
        ("runway_01", 20, "night"), ("runway_04", 36, None),
    ]  # fmt: skip
    assert codes(d) == ["metadata-disagrees", "pitch-sign", "table-unused"]
    assert d.notes["pitch"] == "table metadata.csv per file (1 of 2), table metadata.csv per sequence (1 of 2)"


@pytest.mark.parametrize(
    ("key", "value", "code"),
    [
        ("g_pitch", math.nan, "metadata-value"),
        ("g_pitch", -math.inf, "metadata-value"),
        ("g_pitch", "steep", "metadata-value"),
        ("g_pitch", [-35], "metadata-value"),
        ("g_pitch", {"deg": -35}, "metadata-value"),
        ("g_pitch", True, "metadata-value"),
        ("g_pitch", -95, "metadata-value"),
        ("g_pitch", -(10**400), "metadata-value"),
        ("alt", -3, "metadata-value"),
        ("alt", 1e9, "metadata-value"),
        ("timestamp", "yesterday", "metadata-value"),
        ("timestamp", 1656662400.5, "metadata-value"),
    ],
)
def test_values_that_cannot_be_used_are_counted_once_for_a_file(
    tmp_path: Path, key: str, value: Any, code: str
) -> None:
    good = {"g_pitch": -35, "alt": 51, "timestamp": "2022-07-01T10:00:00+02:00"}
    sequence(tmp_path, "runway_04", [good, good | {key: value}, good | {key: value}, good])
    d = dataset_folder.read(tmp_path)
    assert codes(d) == sorted([code, "pitch-sign"]) and codes(d, "error") == []
    assert "2 image(s) with" in str(next(p for p in d.problems if p.code == code))
    field = {"g_pitch": "pitch_deg", "alt": "altitude_m", "timestamp": "captured"}[key]
    assert [getattr(i.capture, field) is None for i in d.images] == [False, True, True, False]


# ---- layouts


@pytest.mark.parametrize(
    ("file", "names"),
    [
        ("{split}/{name}/annotations.json", "lwir/image{k:05d}.png"),
        ("{split}/{name}/lwir/coco.json", "image{k:05d}.png"),
        ("annotations/{split}/{name}.json", "image{k:05d}.png"),
        ("annotations/{name}.json", "monet/{split}/{name}/lwir/image{k:05d}.png"),
        ("{split}/{name}/{name}.json", "{name}/lwir/image{k:05d}"),
    ],
)
def test_pictures_are_found_wherever_the_json_lies(tmp_path: Path, file: str, names: str) -> None:
    # Every sequence has pictures of the same names; the second misses one, the first has one more than the JSON.
    for split, name in (("train", "runway_04"), ("train", "dirtroad_02"), ("val", "runway_05")):
        sequence(tmp_path, name, down(-35, -36, -37), split=split, file=file, names=names)
    (tmp_path / "train" / "dirtroad_02" / "lwir" / "image00001.png").unlink()
    picture(tmp_path / "train" / "runway_04" / "lwir" / "image00009.png")
    d = dataset_folder.read(tmp_path)
    assert codes(d, "error") == ["image-missing"]
    assert len(d.images) == 8
    for image in d.images:
        assert image.path.parent == tmp_path / image.split / str(image.capture.sequence) / "lwir"
        assert image.name == f"{image.capture.sequence}/lwir/{image.path.name}"
        assert image.capture.pitch_deg == 35 + int(image.path.stem[-1])
        assert (image.capture.sequence == "runway_05") == (image.split == "val")


def test_names_that_fit_several_folders_are_not_guessed(tmp_path: Path) -> None:
    for name in ("runway_04", "runway_05"):
        sequence(tmp_path, name, down(-35), names="image{k:05d}.png", file="labels.json")
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(tmp_path)
    assert "train/runway_04/lwir, train/runway_05/lwir" in str(caught.value)
    d = dataset_folder.read(tmp_path, Reading(options={"pictures": "train/runway_05/lwir"}))
    assert [i.capture.sequence for i in d.images] == ["runway_05"]


def test_one_json_of_all_and_a_split_by_option(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", down(-35), split="a", file="all.json", names="runway_04/lwir/image{k:05d}.png")
    assert [i.split for i in dataset_folder.read(tmp_path).images] == ["train"]
    assert [i.split for i in dataset_folder.read(tmp_path, Reading(options={"split": "val"})).images] == ["val"]
    (tmp_path / "a").rename(tmp_path / "monet_test")
    assert [i.split for i in dataset_folder.read(tmp_path).images] == ["test"]
    # Given alone, the folder's own name tells.
    (tmp_path / "all.json").rename(tmp_path / "monet_test" / "x.json")
    assert [i.split for i in dataset_folder.read(tmp_path / "monet_test").images] == ["test"]


def test_one_sequence_alone_is_named_by_its_folder(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", [{"p": -35}], file="train/runway_04/labels.json")
    d = dataset_folder.read(tmp_path / "train" / "runway_04", Reading(options={"pitch_key": "p"}))
    assert [(i.capture.sequence, i.split, i.name) for i in d.images] == [("runway_04", "train", "lwir/image00000.png")]


def test_a_picture_in_two_files_counts_once(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", down(-35, -36))
    (tmp_path / "train" / "again.json").write_text((tmp_path / "train" / "runway_04.json").read_text())
    names = "runway_04/lwir/image{k:05d}.png"
    sequence(tmp_path, "runway_04", down(-35, -36), file="train/again.json", names=names)
    d = dataset_folder.read(tmp_path)
    assert len(d.images) == 2 and codes(d, "error") == ["image-duplicate"]


def test_sizes_that_are_missing_come_from_the_pictures(tmp_path: Path) -> None:
    def drop(top: dict[str, Any]) -> None:
        del top["images"][0]["width"]

    sequence(tmp_path, "runway_04", down(-35, -35), change=drop)
    d = dataset_folder.read(tmp_path)
    assert [i.size_wh for i in d.images] == [(64, 48)] * 2 and "image-size-unknown" in codes(d)


def test_splits_are_read_one_by_one(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", down(-35))
    sequence(tmp_path, "runway_05", down(-36), split="val")
    assert [i.split for i in dataset_folder.read(tmp_path, Reading(splits=["val"])).images] == ["val"]
    with pytest.raises(DatasetError, match="nothing to read in the splits test"):
        dataset_folder.read(tmp_path, Reading(splits=["test"]))


def test_regions_to_ignore_are_recognised_by_name(tmp_path: Path) -> None:
    def ignore(top: dict[str, Any]) -> None:
        top["categories"].append({"id": 7, "name": "don't care"})

    sequence(tmp_path, "runway_04", down(-35), change=ignore)
    d = dataset_folder.read(tmp_path)
    assert [(c.id, c.name, c.ignore) for c in d.categories] == [
        (1, "person", False), (2, "vehicle", False), (7, "don't care", True),
    ]  # fmt: skip


# ---- bad input


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"images": 3}', "[" * 100_000, "\x00"])
def test_non_coco_json_is_reported(tmp_path: Path, text: str) -> None:
    sequence(tmp_path, "runway_04", down(-35))
    (tmp_path / "train" / "runway_05.json").write_text(text)
    d = dataset_folder.read(tmp_path)
    assert len(d.images) == 1
    assert [p.where for p in d.problems if p.code.startswith("annotation")] == ["train/runway_05.json"]
    (tmp_path / "train" / "runway_04.json").unlink()
    with pytest.raises(DatasetError, match=r"train/runway_05\.json"):
        monet.read(tmp_path)


@pytest.mark.parametrize("name", ["../../outside.png", "/etc/passwd", "C:\\x.png", "", "\0", None, 3, "gone.png"])
def test_names_that_lead_out_or_nowhere_are_errors(tmp_path: Path, name: Any) -> None:
    picture(tmp_path / "outside.png")

    def rename(top: dict[str, Any]) -> None:
        top["images"][0]["file_name"] = name

    sequence(tmp_path / "data", "runway_04", down(-35, -36), change=rename)
    d = dataset_folder.read(tmp_path / "data")
    assert [i.capture.pitch_deg for i in d.images] == [36]
    assert codes(d, "error")[0] in ("name-climbs", "name-missing", "image-missing")


def test_a_link_that_leads_out_is_refused(tmp_path: Path) -> None:
    sequence(tmp_path / "data", "runway_04", down(-35, -36))
    link = tmp_path / "data" / "train" / "runway_04" / "lwir" / "image00000.png"
    link.unlink()
    link.symlink_to(picture(tmp_path / "outside.png"))
    d = dataset_folder.read(tmp_path / "data")
    assert [i.capture.pitch_deg for i in d.images] == [36] and "name-climbs" in codes(d, "error")


def test_options_are_checked_together(tmp_path: Path) -> None:
    sequence(tmp_path, "runway_04", down(-35))
    bad = {"pitch_sign": "2", "angle_unit": "grad", "time_of_day": "noon", "split": "dev", "pitch_key": "a..b"}
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(tmp_path, Reading(options=bad))
    assert {p.where for p in caught.value.problems} == {f"option {k}" for k in bad}
    with pytest.raises(DatasetError, match="annotations=PATTERN"):
        dataset_folder.read(tmp_path, Reading(options={"annotations": "labels/*.json"}))
    assert (
        dataset_folder.read(tmp_path, Reading(options={"time_of_day": "night"})).images[0].capture.time_of_day
        == "night"
    )


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["g_pitch", "alt", "x"]), inner),
    max_leaves=6,
)
KEYS = st.sampled_from(["g_pitch", "alt", "timestamp", "metadata", "width", "id", "file_name", "sequence"])


@given(st.lists(st.dictionaries(KEYS, JSON, max_size=4) | JSON, min_size=1, max_size=4), JSON)
def test_any_telemetry_gives_a_dataset_or_our_own_error(
    tmp_path_factory: pytest.TempPathFactory, records: list[Any], more: Any
) -> None:
    root = tmp_path_factory.mktemp("fuzz")

    def spoil(top: dict[str, Any]) -> None:
        base = top["images"]
        top["images"] = [b | r if isinstance(r, dict) else r for b, r in zip(base, records, strict=False)] + base[4:]
        top["extra"] = more

    sequence(root, "runway_04", down(-35, -36, -37, -38, -39), change=spoil)
    try:
        d = monet.read(root)
    except DatasetError:
        return
    assert all(i.capture.pitch_deg is None or -90 <= i.capture.pitch_deg <= 90 for i in d.images)
    assert all(i.path.resolve().is_relative_to(root.resolve()) for i in d.images)
    writing.write("monet", root / "out", d.images, d.categories, source=d)
    assert all(json.loads(p.read_text()) for p in (root / "out").rglob("*.json"))
    again = monet.read(root / "out", empty="keep", pitch_sign=f"{d.notes['gimbal_pitch']['sign']:+d}")
    assert [i.capture.pitch_deg for i in again.images] == [i.capture.pitch_deg for i in d.images]


# ---- writing


def test_every_read_field_is_written(tmp_path: Path) -> None:
    telemetry = {"g_pitch": -35.25, "alt": 51, "speed_x": 1.5, "nan": math.nan, "list": [1, {"a": None}]}
    sequence(tmp_path / "in", "runway_04", [telemetry, {}])
    d = dataset_folder.read(tmp_path / "in")
    mask = np.zeros((48, 64), np.bool_)
    mask[3:9, 4:20] = True
    corners = np.array([[4.0, 3.0], [20.0, 3.0], [20.0, 9.0], [4.0, 9.0]])
    box = np.array([4.0, 3.0, 20.0, 9.0])
    deer = Instance("deer", box, corners, Mask.from_array(mask), 0.75, True, None, True, track_id=4)
    first, second = d.images
    changed = [
        with_facts(replace(first, instances=(*first.instances, deer)), time_of_day="night", pitch_deg=36.0),
        second,
    ]
    categories = (*d.categories, replace(d.categories[0], id=3, name="deer"))
    written = writing.write("native", tmp_path / "out", changed, categories, source=d)
    assert written.losses == {"not_finite_dropped": 1}
    assert set(written.files) == {p for p in (tmp_path / "out").rglob("*") if p.is_file()}
    records = json.loads((tmp_path / "out/train/runway_04.json").read_text())["images"]
    assert records[0]["metadata"] == telemetry | {"g_pitch": -36, "nan": None, "alt": 51}
    assert records[1]["metadata"] == {}
    again = dataset_folder.read(tmp_path / "out")
    assert [(i.id, i.capture.pitch_deg, i.capture.time_of_day, i.name) for i in again.images] == [
        (i.id, i.capture.pitch_deg, i.capture.time_of_day, i.name) for i in changed
    ]
    for before, after in zip(changed, again.images, strict=True):
        for a, b in zip(before.instances, after.instances, strict=True):
            assert replace(b, source_id=None).equals(replace(a, source_id=None), 1e-6)
    assert again.categories[-1].name == "deer"


def test_deer_come_into_frames_that_look_down_and_up(tmp_path: Path) -> None:
    """The paper's recipe without Blender: negative pitch is used, frames without are skipped, all is in the card."""
    data = tmp_path / "data"
    sequence(data, "runway_01", down(None))
    sequence(data, "runway_04", down(-35, 12.5, None, -90))
    for path in data.rglob("*.png"):
        picture(path, (800, 600))
    for path in data.rglob("*.json"):
        path.write_text(path.read_text().replace('"width": 64, "height": 48', '"width": 800, "height": 600'))
    settings = {"output.formats": ["native"]}
    report = api.generate(
        "monet-deer",
        data,
        tmp_path / "run",
        execution=api.Execution(renderer="flat", in_process=True),
        settings=settings,
    )
    assert (report.counts["images"], report.counts["skipped_backgrounds"]) == (3, 1)
    again = dataset_folder.read(tmp_path / "run" / "native")
    assert [i.capture.pitch_deg for i in again.images] == [35, -12.5, 90]
    assert [sum(o.inserted for o in i.instances) for i in again.images] == [1, 1, 1]
    notes = json.loads((tmp_path / "run" / "run.json").read_text())["data"]["notes"]
    assert notes["excluded"]["train/runway_01"]["images"] == 1 and notes["frames_without_pitch"] == {
        "train/runway_04": 1
    }
    card = (tmp_path / "run" / "README.md").read_text()
    expected = "Sequences of the source that were left out: train/runway_01 (1 pictures, no telemetry in any frame)."
    assert expected in card


def test_records_of_elsewhere_get_metadata(tmp_path: Path) -> None:
    """Labels of another format become MONET: telemetry in `metadata`, pictures below the split without a sequence."""
    path = picture(tmp_path / "a.png")
    sequence(tmp_path / "in", "runway_04", down(-35))
    image = replace(dataset_folder.read(tmp_path / "in").images[0], path=path, file_name="a.png", extra={})
    image = with_facts(image, sequence=None, captured="2021-01-20")
    monet.write(tmp_path / "out", [image], dataset_folder.read(tmp_path / "in").categories)
    (record,) = json.loads((tmp_path / "out/train/train.json").read_text())["images"]
    assert record["metadata"] == {"g_pitch": -35, "alt": 51, "timestamp": "2021-01-20"}
    (again,) = dataset_folder.read(tmp_path / "out").images
    assert (again.capture.sequence, again.capture.pitch_deg, again.name) == (None, 35, "lwir/a.png")
    assert again.capture.captured is not None and again.capture.captured.startswith("2021-01-20")
    with pytest.raises(ValueError, match="second picture"):
        monet.write(tmp_path / "out", [image, replace(image, id="b")], dataset_folder.read(tmp_path / "in").categories)


def test_files_without_any_pitch_are_still_detected(tmp_path: Path) -> None:
    instance = Instance("deer", np.array([3.0, 4.0, 20.0, 30.0]))
    path = picture(tmp_path / "a.png")
    image = ImageRecord("a", path, "train", (64, 48), (instance,))
    written = monet.write(tmp_path / "out", [image], [Category(0, "deer")])
    assert [p.code for p in written.problems] == ["telemetry-absent"]
    # It must not be read as a folder of pictures without labels.
    with pytest.raises(DatasetError, match="empty=keep"):
        dataset_folder.read(tmp_path / "out")
    (again,) = dataset_folder.read(tmp_path / "out", Reading(options={"empty": "keep"})).images
    assert again.instances[0].box_xyxy.tolist() == [3.0, 4.0, 20.0, 30.0]
    known = with_facts(image, pitch_deg=40.0)
    assert not monet.write(tmp_path / "known", [known], [Category(0, "deer")]).problems
