"""Names in data that collide, lead out of a folder, or that a format cannot hold, given on the command line."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.cli import main
from infrablend.core.format_table import written_names
from tests.flat_renderer import render_flat
from tests.run_files import edit_ledger, hashes, ledger_rows

pytestmark = pytest.mark.long

SETTINGS = ("--set", "camera.pitch={fixed_deg: 60}", "--set", "camera.size_px=[64, 48]")


@pytest.fixture(autouse=True)
def flat_renderer(monkeypatch, tmp_path):
    """Let the command line compute frames with the flat renderer in this process, which takes milliseconds."""
    render_flat(monkeypatch)
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))


def draw(path: Path, number: int = 0) -> Path:
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((60 + x + y + number).astype(np.uint8)).save(path)
    return path


def generate(data: Path, out: Path, *options: str, to: str = "coco,yolo") -> int:
    words = ["--data", str(data), "--out", str(out), "--set", f"output.formats=[{to}]", *SETTINGS, *options]
    return main(["generate", "hit-uav-drone", *words])


def names_in_coco(run: Path) -> list[str]:
    return [i["file_name"] for p in sorted((run / "coco").glob("*.json")) for i in json.loads(p.read_text())["images"]]


def folded(paths):
    return sorted(str(p).casefold() for p in paths)


# -- names of frames


def test_frames_of_backgrounds_named_like_frames_have_their_own_files(tmp_path):
    for k, name in enumerate(("a", "a_c0", "a_c0_2")):
        draw(tmp_path / "data" / f"{name}.png", k)
    run = tmp_path / "run"
    assert generate(tmp_path / "data", run, "--set", "output.originals=true", "--set", "configurations=2") == 0
    pictures = sorted((run / "images").rglob("*.png"))
    assert len(pictures) == len(set(names_in_coco(run))) == len(list((run / "yolo").rglob("*.png"))) == 9
    for name in ("a", "a_c0", "a_c0_2"):
        assert (run / "images/train" / f"{name}.png").read_bytes() == (tmp_path / "data" / f"{name}.png").read_bytes()


def test_output_with_originals_can_be_used_as_input_again_and_again(tmp_path):
    draw(tmp_path / "data" / "a.png")
    source = tmp_path / "data"
    for generation in range(1, 4):
        run = tmp_path / f"run{generation}"
        assert generate(source, run, "--set", "output.originals=true", "--set", "configurations=1", to="yolo") == 0
        source = run / "yolo"
        assert len(list((run / "images").rglob("*.png"))) == len(list(source.rglob("*.png"))) == 2**generation


def test_names_that_differ_in_case_alone_do_not_share_a_file_on_any_disk(tmp_path):
    for k, name in enumerate(("Dog.png", "dog.png", "DOG_2.png", "stra\u00dfe.png", "STRASSE.png")):
        draw(tmp_path / "data" / "train" / name, k)
    run, formats = tmp_path / "run", ("coco", "yolo", "voc", "dota", "hit-uav", "hit-uav-xml", "masks", "birdsai")
    assert generate(tmp_path / "data", run, "--set", "configurations=1", to=",".join(formats)) == 0
    files = folded(p.relative_to(run) for p in run.rglob("*") if p.is_file())
    assert len(files) == len(set(files))
    assert len([f for f in files if f.startswith("images/") and not f.endswith("metadata.jsonl")]) == 5
    for to in formats:
        converted = tmp_path / to
        assert main(["convert", str(run / "yolo"), str(converted), "--to", to]) == 0
        files = folded(p.relative_to(converted) for p in converted.rglob("*") if p.is_file())
        assert len(files) == len(set(files))
        assert len([f for f in files if f.endswith(".png") and "masks" not in f.split("/")]) % 5 == 0


# -- paths


def test_data_behind_a_symbolic_link_give_the_same_run(tmp_path):
    draw(tmp_path / "data" / "train" / "a.png")
    (tmp_path / "deep" / "er").mkdir(parents=True)
    link = tmp_path / "deep" / "er" / "link"
    link.symlink_to(tmp_path / "data")
    real, linked = tmp_path / "real", tmp_path / "linked"
    assert generate(tmp_path / "data", real, "--set", "configurations=1") == 0
    assert generate(link, linked, "--set", "configurations=1") == 0
    rows = ledger_rows(linked / "run.sqlite")
    assert rows == ledger_rows(real / "run.sqlite")
    assert str(tmp_path) not in repr(rows)
    assert generate(link, real, "--set", "configurations=1", "--resume") == 0
    assert ledger_rows(real / "run.sqlite") == rows


@pytest.mark.parametrize("path", ["/tmp/escaped.png", "train/../../../escaped.png"])
def test_a_ledger_that_names_a_path_outside_the_run_is_refused(tmp_path, path):
    draw(tmp_path / "data" / "train" / "a.png")
    run = tmp_path / "run"
    assert generate(tmp_path / "data", run, "--set", "configurations=1") == 0
    outside = (run / "images" / path).resolve()
    assert not outside.is_relative_to(run / "images")
    before = hashes(run)
    edit_ledger(run, "UPDATE frames SET image = ?", path)
    assert generate(tmp_path / "data", run, "--set", "configurations=1", "--resume") == 0
    assert hashes(run) == before
    assert not outside.exists()
    assert main(["rerender", str(run), "../../images/train/a_c0"]) in (2, 3)


@pytest.mark.parametrize(
    "text",
    [
        "../../../escaped/evil",
        "..",
        "",
        ".",
        "a\0b",
        "C:\\x",
        "a" * 300,
        "\u00e9" * 300,
        " .hidden ",
        "line\nbreak",
        "\udcff",
    ],
)
def test_texts_from_data_give_one_part_of_a_path(tmp_path, text):
    from infrablend.core.file_names import file_name

    name = file_name(text)
    (tmp_path / name).write_text("")
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert not name.startswith(".")


def test_distinct_names_keep_what_is_unambiguous():
    from infrablend.core.file_names import distinct_names, file_name

    assert distinct_names(["a", "b", "Person", "Person (2)"]) == ["a", "b", "Person", "Person (2)"]
    assert distinct_names(["a", "A", "a-2", "a"]) == ["a", "A-3", "a-2", "a-4"]
    assert file_name("Person (2) \u6771\u4eac") == "Person (2) \u6771\u4eac"


# -- names and values that a format cannot hold

HARD_NAMES = (
    "1e3", "010", "a:b", " x ", "a\x01b", "a\\x01b", "a\r\nb", "a\u2028b", "a\u0085b", "#hash", "true", "no", "~", "-",
    "[a]", "a;b", '"q"', "<b>", "&amp;", "\udcff", "", "background", "2020-01-01", "=", "a\ufffeb", "$x^{$",
    "Car", "car", "\u00e9",
)  # fmt: skip


def write_coco(root: Path, names=HARD_NAMES) -> Path:
    """Write one picture with an object of each class, and values that JSON and XML cannot hold."""
    draw(root / "a\u2028\x02.png")
    categories = [{"id": k, "name": n} for k, n in enumerate(names, 1)]
    boxes = [{"id": k, "image_id": 1, "category_id": k, "bbox": [k, k, 9, 8]} for k in range(1, len(names) + 1)]
    image = {
        "id": 1,
        "file_name": "a\u2028\x02.png",
        "width": 64,
        "height": 48,
        "sequence": "\x01/../..",
        "source_id": "\udcff",
    }
    info = {"info": {"a": float("nan"), "b": float("inf"), "c": "\udcff"}}
    top = {**info, "images": [image], "annotations": boxes, "categories": categories}
    (root / "train.json").write_text(json.dumps(top))
    return root


def inspected(root: Path, capsys) -> dict[str, int]:
    """Return the number of objects by class."""
    capsys.readouterr()
    assert main(["inspect", str(root), "--json"]) == 0
    classes = json.loads(capsys.readouterr().out)["classes"]
    return {name: sum(facts["objects"].values()) for name, facts in classes.items()}


@pytest.mark.parametrize("to", ["coco", "yolo", "yolo-obb", "voc", "hit-uav", "hit-uav-xml", "masks"])
def test_every_class_name_comes_back_as_it_was_announced(tmp_path, capsys, to):
    data = write_coco(tmp_path / "data")
    before = inspected(data, capsys)
    assert len(before) == len(HARD_NAMES)
    assert {"a\\x01b", "a\\x01b 2", "1e3", "unnamed", "\\udcff", "a\\u2028b"} <= before.keys()
    assert main(["convert", str(data), str(tmp_path / to), "--to", to]) == 0
    back = inspected(tmp_path / to, capsys)
    assert {n: back[n] for n in before} == before
    assert main(["check", str(tmp_path / to), "--no-decode"]) == 0


def test_a_run_holds_what_its_source_could_not_say(tmp_path, capsys):
    data, run = write_coco(tmp_path / "data"), tmp_path / "run"
    formats = ("coco", "yolo", "voc", "dota", "hit-uav", "monet")
    assert generate(data, run, "--set", "configurations=1", to=",".join(formats)) == 0
    assert "class-renamed" in (run / "run.json").read_text()
    for name in formats[:3]:
        assert dict.fromkeys(inspected(data, capsys), 1) | {"drone": 1} == inspected(run / name, capsys)


def test_values_that_json_cannot_hold_are_replaced_before_writing(tmp_path):
    data = tmp_path / "data"
    assert main(["convert", str(write_coco(tmp_path / "first", ("a",))), str(data), "--to", "hit-uav"]) == 0
    for file in data.rglob("train.json"):
        top = json.loads(file.read_text())
        top["info"] = {"a": float("nan"), "b": [float("inf"), "\udcff"]}
        file.write_text(json.dumps(top))
    assert generate(data, tmp_path / "run", "--set", "configurations=1", to="native") == 0
    (file,) = (tmp_path / "run" / "native").rglob("normal_json/annotations/train.json")
    assert json.loads(file.read_text())["info"] == {"a": None, "b": [None, "\\udcff"]}


def test_a_recipe_may_not_name_a_class_that_labels_cannot_hold(tmp_path):
    draw(tmp_path / "data" / "a.png")
    for setting in ('objects.0.category="a\\u2028b"', 'objects.0.category="a\\x85b"', 'labels.rename={x: "a\\u2028b"}'):
        assert generate(tmp_path / "data", tmp_path / "run", "--set", setting) == 2
    assert not (tmp_path / "run").exists()


def test_class_names_are_no_formulas_in_plots(tmp_path, monkeypatch):
    from infrablend.lab.evaluation import evaluate

    monkeypatch.setattr(evaluate, "_by_ultralytics", lambda case: None)  # it takes seconds to import
    names = ("$x^{ $", "$\\alpha$")
    data = write_coco(tmp_path / "data", names)
    found = json.loads((data / "train.json").read_text())
    for row in found["annotations"]:
        row["score"] = 0.9
    found["images"][0]["file_name"] = "train/a\u2028\x02.png"
    del found["info"]
    (tmp_path / "predictions.json").write_text(json.dumps(found))
    words = [str(tmp_path / "predictions.json"), str(data), "--out", str(tmp_path / "out"), "--split", "train"]
    assert main(["evaluate", *words, "--bootstrap", "0"]) == 0
    assert (tmp_path / "out" / "evaluation.html").is_file()
    assert main(["inspect", str(data), "--out", str(tmp_path / "inspected")]) == 0


# -- reports


def test_a_card_holds_no_script_and_no_link_to_one(tmp_path):
    data = write_coco(tmp_path / "data", ("<script>alert(1)</script>", "[x](javascript:alert(1))"))
    url = "javascript:alert(1)"
    licence = {"id": "other", "name": "<img src=x>", "url": url}
    (data / "SOURCE.json").write_text(json.dumps({"title": "<b>t</b>", "url": url, "licence": licence}))
    assert generate(data, tmp_path / "run", "--set", "configurations=1") == 0
    card = (tmp_path / "run" / "README.md").read_text()
    page = card.split("\n---\n", 1)[1]
    assert "](javascript:" not in page
    for tag in ("<script", "<img", "<b>"):
        assert tag not in page


def test_names_do_not_command_the_terminal(tmp_path, capsys):
    draw(tmp_path / "data" / "\x1b[31mred\x07.png")
    data = write_coco(tmp_path / "coco", ("\x1b]0;title\x07",))
    for words in (["inspect", str(tmp_path / "data")], ["inspect", str(data)], ["check", str(data), "--strict"]):
        main(words)
    shown = capsys.readouterr()
    assert not {"\x1b", "\x07"} & {*shown.out, *shown.err}


def test_sequences_that_differ_in_case_alone_do_not_share_a_file_in_monets_layout(tmp_path):
    for k, flight in enumerate(("Run", "run", "RUN")):
        draw(tmp_path / "data" / "images" / "train" / flight / f"a_{k}.png", k)
    labels = {"names": ["car"], "path": ".", "train": "images/train"}
    (tmp_path / "data" / "data.yaml").write_text(json.dumps(labels))
    source = tmp_path / "source"
    assert main(["convert", str(tmp_path / "data"), str(source), "--to", "coco"]) == 0
    for path in source.rglob("*.json"):
        top = json.loads(path.read_text())
        for k, image in enumerate(top.get("images", ())):
            image["sequence"] = ("Run", "run", "RUN")[k]
        path.write_text(json.dumps(top))
    (source / "convert.json").unlink()
    assert main(["convert", str(source), str(tmp_path / "monet"), "--to", "monet"]) == 0
    files = folded(p.relative_to(tmp_path / "monet") for p in (tmp_path / "monet").rglob("*") if p.is_file())
    assert len(files) == len(set(files)), files
    assert len([f for f in files if f.endswith(".json") and f.startswith("train/")]) == 3, files


def test_control_characters_in_errors_do_not_reach_the_terminal(tmp_path, capsys):
    name = "a\x1b]0;evil\x07\x1b[2J"
    draw(tmp_path / "data" / f"{name}.png")
    bad = tmp_path / "data" / f"{name}.json"
    bad.write_text("{")
    evil = str(tmp_path / name)
    assert main(["convert", evil, str(tmp_path / "a"), "--to", "coco"]) == 2
    assert main(["split", str(tmp_path / "data"), str(tmp_path / "b"), "--by", "gap", "--gap", "1"]) in (0, 1, 2)
    assert main(["check", str(tmp_path / "data")]) == 1
    assert main(["generate", evil, "--data", str(tmp_path / "data"), "--out", str(tmp_path / "c")]) == 2
    assert main(["experiment", evil]) == 2
    out = capsys.readouterr()
    assert "\x1b" not in out.out + out.err and "\x07" not in out.out + out.err
    assert "\\x1b" in out.err


def test_numbers_that_json_cannot_hold_in_predictions_are_left_out(tmp_path):
    draw(tmp_path / "data" / "images" / "test" / "a.png")
    (tmp_path / "data" / "labels" / "test").mkdir(parents=True)
    (tmp_path / "data" / "labels" / "test" / "a.txt").write_text("0 0.5 0.5 0.2 0.25\n")
    (tmp_path / "data" / "data.yaml").write_text("path: .\ntest: images/test\nnames: [car]\n")
    found = tmp_path / "predictions.json"
    found.write_text(
        """{"task": "detect", "categories": [{"id": 1, "name": "car"}], "annotations": [],
        "images": [{"id": 1, "file_name": "test/a.png", "width": 64, "height": 48}],
        "facts": {"a": NaN, "b": [Infinity, {"c": -1e999}]}}"""
    )
    out = tmp_path / "out"
    assert main(["evaluate", str(found), str(tmp_path / "data"), "--out", str(out), "--bootstrap", "0"]) == 0
    facts = json.loads((out / "predictions.json").read_text())["facts"]
    assert facts["a"] is None and facts["b"] == [None, {"c": None}]


# -- names of pictures that formats cannot hold

ODD_PICTURES = (
    "plain.png",
    "ends in a blank .png",
    " begins.png",
    "T:12.png",
    "ends\u3000.png",
    "two  blanks 1.png",
    "back\\slash.png",
)


@pytest.mark.parametrize("to", written_names())
def test_every_picture_is_read_back_in_its_split_whatever_its_name(tmp_path, capsys, to):
    source = tmp_path / "data"
    names = {"train": ODD_PICTURES, "test": tuple(f"test {n}" if n[0] != " " else f" test{n}" for n in ODD_PICTURES)}
    for split, listed in names.items():
        for k, name in enumerate(listed):
            draw(source / "images" / split / name, k + 20 * (split == "test"))
            label = source / "labels" / split / f"{name.removesuffix('.png')}.txt"
            label.parent.mkdir(parents=True, exist_ok=True)
            label.write_text(f"0 0.5 0.5 0.25 {0.25 + 0.0625 * k}\n")
    (source / "data.yaml").write_text("train: images/train\ntest: images/test\nnames: [Car]\n")
    boxes = ["--without-mask", "obb"] if to == "yolo-seg" else []
    without_pitch = ["--read", "empty=keep"] if to == "monet" else []
    assert main(["convert", str(source), str(tmp_path / "out"), "--to", to, *boxes]) == 0
    assert main(["check", str(tmp_path / "out"), *without_pitch]) == 0
    capsys.readouterr()
    assert main(["inspect", str(tmp_path / "out"), "--json", *without_pitch]) == 0
    found = json.loads(capsys.readouterr().out)
    every = dict.fromkeys(("train", "test"), len(ODD_PICTURES))
    assert {s: found["splits"][s]["images"] for s in every} == every
    assert {s: found["splits"][s]["objects"] for s in every} == every


@pytest.mark.parametrize("name", [".hidden", "..a"])
def test_hidden_pictures_with_labels_are_reported(tmp_path, name):
    for folder in ("images/train", "labels/train"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "data.yaml").write_text("train: images/train\nval: images/train\nnames: [Car]\n")
    for stem in ("seen", name, "._seen", ".seen.part", ".alone"):
        Image.new("L", (50, 40), 99).save(tmp_path / "images/train" / f"{stem}.png")
        if stem != ".alone":
            (tmp_path / "labels/train" / f"{stem}.txt").write_text("0 0.5 0.5 0.2 0.2\n")
    found = [p for p in api.read_dataset(tmp_path).problems if p.code == "picture-hidden"]
    assert [p.severity for p in found] == ["warning"]
    assert found[0].found.startswith("1 hidden picture(s)") and f"{name}.png" in found[0].found
    (tmp_path / "labels/train" / f"{name}.txt").unlink()
    assert not any(p.code == "picture-hidden" for p in api.read_dataset(tmp_path).problems)
