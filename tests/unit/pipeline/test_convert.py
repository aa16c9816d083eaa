"""`infrablend convert`: any dataset to any writable format, with every loss reported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from infrablend import api
from infrablend.core.format_table import WRITERS, written_names
from infrablend.errors import DatasetError, OutputError, UnknownFormatError
from infrablend.formats import dataset_folder, writing
from infrablend.formats.losses import LOSSES
from infrablend.formats.pictures.listing import read_size
from tests.command_line import done, run
from tests.flights import flight
from tests.samples import SAMPLES, picture


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["coco"](tmp_path / "data")


@pytest.mark.parametrize("to", written_names())
def test_every_format_is_written_from_the_command_line(to: str, data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    ended = run("convert", data, out, "--to", to)
    whole = to != "yolo-seg"  # which has no cars and bicycles any more, as these have no masks
    said = ended.stdout
    assert ended.exit_code == (0 if whole else 1), ended.output
    assert whole or "class Car: all 1 object(s) left out" in ended.stderr
    assert "Person 2" in said and said.endswith(f"{out}\n")
    record = json.loads((out / "convert.json").read_text())
    assert (record["format"], record["source_format"], record["ok"]) == (to, "coco", whole)
    assert {k.rpartition(".")[2] for k in record["losses"]} <= set(LOSSES)
    lost = {words[1]: line for line in said.splitlines() if (words := line.split())[0] == "lost:"}
    for (form, _, kind), n in ((k.rpartition("."), n) for k, n in record["losses"].items()):
        assert f"{form} {n}" in lost[kind] and lost[kind].endswith(LOSSES[kind])
    again = api.read_dataset(out)
    assert len(again.images) == 4
    linked = {p.stat().st_ino for p in data.rglob("*.jpg")}
    assert {i.path.stat().st_ino for i in again.images} <= linked


def test_json_output_equals_the_record(data: Path, tmp_path: Path) -> None:
    said = json.loads(done("convert", data, tmp_path / "out", "--to", "yolo", "--split", "train,val", "--json").stdout)
    record = json.loads((tmp_path / "out/convert.json").read_text())
    assert {k: record[k] for k in ("ok", "counts", "losses", "problems")} == {
        k: said[k] for k in ("ok", "counts", "losses", "problems")
    }
    assert said["counts"]["images_per_split"] == {"train": 2, "val": 1}
    assert said["losses"] == {"ignore_dropped": 1, "mask_dropped": 2, "obb_dropped": 1}


def test_classes_are_renamed_joined_and_dropped(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ("--rename", "Car=vehicle,Bicycle=vehicle", "--drop-class", "DontCare,OtherVehicle")
    done("convert", data, out, "--to", "yolo-obb", *options)
    record = json.loads((out / "convert.json").read_text())
    assert record["counts"]["labels"] == {"Person": 2, "vehicle": 2}
    assert record["counts"]["labels_dropped"] == {"DontCare": 1}
    assert "ignore_dropped" not in record["losses"]
    assert [c.name for c in api.read_dataset(out).categories] == ["Person", "vehicle"]


def test_names_with_commas_are_chosen_with_a_backslash(data: Path, tmp_path: Path) -> None:
    done("convert", data, tmp_path / "a", "--to", "coco", "--rename", r"Car=car\, truck,Person=P")
    assert {"car, truck", "P"} <= {c.name for c in api.read_dataset(tmp_path / "a").categories}
    done("convert", tmp_path / "a", tmp_path / "b", "--to", "coco", "--drop-class", r"car\, truck, P")
    assert not {"car, truck", "P"} & {c.name for c in api.read_dataset(tmp_path / "b").categories}


def test_ids_stay_where_that_is_asked(data: Path, tmp_path: Path) -> None:
    source = {i.name: i.source_id for i in api.read_dataset(data).images}
    api.convert(data, tmp_path / "out", "hit-uav", writing=api.WriteSettings(ids="source"))
    assert {i.name: i.source_id for i in api.read_dataset(tmp_path / "out").images} == source
    yolo = SAMPLES["yolo:detect"](tmp_path / "yolo")
    with pytest.raises(DatasetError, match=r"ids cannot be kept[\s\S]*without an id in the source"):
        api.convert(yolo, tmp_path / "no", "coco", writing=api.WriteSettings(ids="source"))
    assert not (tmp_path / "no").exists()


def test_native_is_the_format_of_the_source(tmp_path: Path) -> None:
    for name, format_ in (("yolo:obb", "yolo-obb"), ("hit-uav:xml", "hit-uav-xml"), ("dota", "dota"), ("coco", "coco")):
        report = api.convert(SAMPLES[name](tmp_path / name), tmp_path / f"{name}-out", "native")
        assert report.format == format_
    bare = SAMPLES["folder:plain"](tmp_path / "bare")
    with pytest.raises(DatasetError, match="cannot be written in its own format"):
        api.convert(bare, tmp_path / "no", "native")


def test_telemetry_that_names_do_not_hold_goes_into_a_table(tmp_path: Path) -> None:
    data = SAMPLES["folder:yolo"](tmp_path / "data")
    for to in ("yolo", "dota", "masks", "coco"):
        report = api.convert(data, tmp_path / to, to)
        assert "telemetry_dropped" not in report.losses
        again = {i.name: i for i in api.read_dataset(tmp_path / to).images}
        capture = again["b 0.jpg"].capture
        assert (capture.pitch_deg, capture.altitude_m, capture.time_of_day) == (30, 50, "day")
    report = api.convert(data, tmp_path / "xml", "hit-uav-xml")
    assert report.losses["telemetry_dropped"] == 1


def test_an_unlabelled_flight_comes_back_from_yolo(tmp_path: Path) -> None:
    flight(tmp_path / "card", 3)
    api.convert(tmp_path / "card", tmp_path / "yolo", "yolo")
    again = api.read_dataset(tmp_path / "yolo")
    assert (again.format, len(again.images), again.categories) == ("yolo", 3, ())
    assert {i.capture.altitude_from for i in again.images} == {"take-off"}
    assert [p for p in again.problems if p.severity == "error"] == []
    label = next((tmp_path / "yolo" / "labels").rglob("*.txt"))
    label.write_text("0 0.5 0.5 0.1 0.1\n")
    with pytest.raises(DatasetError, match="no class names") as error:
        api.read_dataset(tmp_path / "yolo")
    assert "labels of 1 class" in error.value.problems[0].found


def test_pictures_whose_names_clash_are_renamed_and_counted(tmp_path: Path) -> None:
    data = tmp_path / "data"
    for k, name in enumerate(("train/a.png", "train/a.jpg", "train/sub/b.png", "test/b.png")):
        path = picture(data / name, k)
        path.with_suffix(".txt").write_text("0 0.5 0.5 0.25 0.25\n")
    (data / "classes.txt").write_text("fox\n")
    for to, renamed in (("yolo", 2), ("dota", 3), ("hit-uav", 2), ("hit-uav-xml", 4), ("coco", 0), ("masks", 2)):
        report = api.convert(data, tmp_path / to, to)
        assert report.losses.get("name_changed", 0) == renamed, to
        again = api.read_dataset(tmp_path / to)
        assert [p for p in again.problems if p.severity == "error"] == []
        assert sorted(i.path.read_bytes() for i in again.images) == sorted(
            p.read_bytes() for p in data.rglob("*") if p.suffix in (".png", ".jpg")
        ), to


def test_source_problems_are_reported_with_exit_code_1(data: Path, tmp_path: Path) -> None:
    file = data / "annotations/instances_train.json"
    top = json.loads(file.read_text())
    top["annotations"][0]["bbox"] = [1, 2, -3, 4]
    top["annotations"][1]["category_id"] = 77
    file.write_text(json.dumps(top))
    ended = run("convert", data, tmp_path / "out", "--to", "coco")
    assert ended.exit_code == 1
    assert "2 problem(s)" in ended.stderr and "category_id 77" in ended.stderr and "size -3x4" in ended.stderr
    record = json.loads((tmp_path / "out/convert.json").read_text())
    assert [p["code"] for p in record["problems"]] == ["box-empty", "category-unknown", "category-zero"]


def test_only_an_earlier_conversion_is_replaced(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    api.convert(data, out, "yolo")
    with pytest.raises(OutputError, match="not empty"):
        api.convert(data, out, "coco")
    api.convert(data, out, "coco", overwrite=True)
    assert sorted(p.name for p in out.iterdir()) == [
        "README.md",
        "SOURCE.json",
        "annotations",
        "convert.json",
        "images",
    ]
    (out / "mine.txt").write_text("notes")
    with pytest.raises(OutputError, match=r"not part of the conversion \(mine.txt\)"):
        api.convert(data, out, "yolo", overwrite=True)
    assert (out / "mine.txt").exists() and (out / "images").exists()
    other = tmp_path / "other"
    picture(other / "a.png", 1)
    for text in (None, "{}", '{"infrablend": 1, "status": "complete", "entries": ["../data"]}'):
        if text is not None:
            (other / "convert.json").write_text(text)
        with pytest.raises(OutputError, match="nothing was touched"):
            api.convert(data, other, "yolo", overwrite=True)
    assert (other / "a.png").exists() and data.is_dir()


def test_the_same_bytes_each_time(data: Path, tmp_path: Path) -> None:
    trees = []
    for name in ("a", "b"):
        api.convert(data, tmp_path / name, "hit-uav")
        trees.append({p.relative_to(tmp_path / name): p.read_bytes() for p in (tmp_path / name).rglob("*.*")})
    assert trees[0] == trees[1]


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"to": "pascal"}, UnknownFormatError, "'pascal' cannot be written: expected one of hit-uav, .* write coco"),
        (
            {"to": "yolo", "classes": api.ClassChanges({"car": "x"})},
            DatasetError,
            r"--rename: car; expected classes of the dataset",
        ),
        (
            {"to": "yolo", "classes": api.ClassChanges({"Car": ""})},
            DatasetError,
            "--rename: new name ''; expected a name",
        ),
        (
            {"to": "yolo", "classes": api.ClassChanges({"Car": "a\nb", "Person": " c"})},
            DatasetError,
            r"new name 'a\\nb', ' c'; expected",
        ),
        (
            {"to": "yolo", "classes": api.ClassChanges(drop=["car"])},
            DatasetError,
            r"--drop-class: car; expected classes of the dataset",
        ),
        ({"to": "yolo", "reading": api.Reading(format="dota")}, DatasetError, "labelTxt"),
    ],
)
def test_invalid_requests_write_nothing(
    options: dict, error: type[Exception], text: str, data: Path, tmp_path: Path
) -> None:
    with pytest.raises(error, match=text):
        api.convert(data, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_the_source_is_never_written_to(data: Path) -> None:
    for out in (data, data / "out", data.parent):
        with pytest.raises(OutputError):
            api.convert(data, out, "yolo")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--images", "2", "--seed", "3"], "2 pictures drawn, seed 3; left out:"),
        (["--with-class", "Car"], "pictures with Car"),
        (["--without", "Car"], "no pictures with Car"),
        (["--with-class", "Car", "--objects", "1", "--images", "1"], "1 of 1 requested objects of Car, seed 0"),
    ],
)
def test_selection_is_described_in_words(words: list[str], said: str, data: Path, tmp_path: Path) -> None:
    result = run("convert", data, tmp_path / "out", "--to", "coco", *words)
    (line,) = [x for x in result.output.splitlines() if x.startswith("selection")]
    assert said in line and "None" not in line and "_" not in line


def test_a_converted_wisard_is_read_without_a_new_warning(tmp_path: Path) -> None:
    """WiSARD has one split: data.yaml of Ultralytics needs two, and the second one only points to the first."""
    source = SAMPLES["wisard"](tmp_path / "data")
    before = {p.code for p in api.read_dataset(source).problems}
    for to in ("native", "yolo", "yolo-obb", "coco", "voc"):
        api.convert(source, tmp_path / to, to)
        again = api.read_dataset(tmp_path / to)
        assert {p.code for p in again.problems} <= before, to
        assert {i.split for i in again.images} == {"train"}
    assert yaml.safe_load((tmp_path / "yolo" / "data.yaml").read_text())["stand_ins"] == ["val"]


def test_the_lost_mark_of_inserted_objects_is_counted(tmp_path: Path) -> None:
    marked = []
    for image in api.read_dataset(SAMPLES["coco"](tmp_path / "data")).images:
        with_size = image if image.size_wh else replace(image, size_wh=read_size(image.path, image.id)[0])
        marked.append(replace(with_size, instances=tuple(replace(o, inserted=True) for o in image.instances)))
    categories = api.read_dataset(tmp_path / "data").categories
    count = sum(len(i.instances) for i in marked)
    for writer in WRITERS:
        losses = writing.write(writer.name, tmp_path / writer.name, marked, categories).losses
        assert losses.get("inserted_dropped", 0) == (count if "inserted" in writer.lacks else 0), writer.name
        again = dataset_folder.read(tmp_path / writer.name)
        kept = any(o.inserted for i in again.images for o in i.instances)
        assert kept == ("inserted" not in writer.lacks), writer.name


def test_regions_to_ignore_that_become_objects_are_a_warning(data: Path, tmp_path: Path) -> None:
    report = api.convert(data, tmp_path / "joined", "coco", classes=api.ClassChanges(rename={"DontCare": "Car"}))
    (warning,) = [p for p in report.problems if p.code == "ignore-renamed"]
    assert (warning.where, warning.severity) == ("Car", "warning") and "DontCare" in warning.found
    report = api.convert(
        data, tmp_path / "named", "coco", classes=api.ClassChanges(rename={"DontCare": "crowd", "Car": "vehicle"})
    )
    assert not [p for p in report.problems if p.code == "ignore-renamed"]
