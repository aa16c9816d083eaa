"""Names in data that collide, lead out of a folder, or that a format cannot hold, given on the command line."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.cli import main
from infrablend.core.file_names import distinct_names, file_name
from infrablend.pipeline import request

SETTINGS = ("--set", "camera.pitch={fixed_deg: 60}", "--set", "camera.size_px=[64, 48]")


@pytest.fixture(autouse=True)
def flat_renderer(monkeypatch, tmp_path):
    """Let the command line compute frames with the flat renderer in this process, which takes milliseconds."""
    real = request.Execution
    monkeypatch.setattr(request, "Execution", lambda workers, device: real(workers, device, "flat", True))
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))


def draw(path: Path, number: int = 0) -> Path:
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((60 + x + y + number).astype(np.uint8)).save(path)
    return path


def generate(data: Path, out: Path, *options: str, to: str = "coco,yolo") -> int:
    return main(["generate", "hit-uav-drone", "--data", str(data), "--out", str(out), "--to", to, *SETTINGS, *options])


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
    assert len([f for f in files if f.startswith("images/")]) == 5
    for to in formats:
        converted = tmp_path / to
        assert main(["convert", str(run / "yolo"), str(converted), "--to", to]) == 0
        files = folded(p.relative_to(converted) for p in converted.rglob("*") if p.is_file())
        assert len(files) == len(set(files))
        assert len([f for f in files if f.endswith(".png") and "masks" not in f.split("/")]) % 5 == 0


# -- paths


def records(run: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted((run / "scenes").rglob("*.json"))}


def test_data_behind_a_symbolic_link_give_the_same_run(tmp_path):
    draw(tmp_path / "data" / "train" / "a.png")
    (tmp_path / "deep" / "er").mkdir(parents=True)
    link = tmp_path / "deep" / "er" / "link"
    link.symlink_to(tmp_path / "data")
    real, linked = tmp_path / "real", tmp_path / "linked"
    assert generate(tmp_path / "data", real, "--set", "configurations=1") == 0
    assert generate(link, linked, "--set", "configurations=1") == 0
    assert records(linked) == records(real)
    assert str(tmp_path) not in b"".join(records(linked).values()).decode()
    assert generate(link, real, "--set", "configurations=1", "--resume") == 0
    assert records(linked) == records(real)


@pytest.mark.parametrize("path", ["/tmp/escaped.png", "train/../../../escaped.png"])
def test_a_record_that_names_a_path_outside_the_run_is_made_again(tmp_path, path):
    draw(tmp_path / "data" / "train" / "a.png")
    run = tmp_path / "run"
    assert generate(tmp_path / "data", run, "--set", "configurations=1") == 0
    before, (file,) = records(run), (run / "scenes").rglob("*.json")
    edited = json.loads(file.read_text())
    edited["image"] = path
    outside = (run / "images" / path).resolve()
    assert not outside.is_relative_to(run / "images")
    file.write_text(json.dumps(edited))
    assert generate(tmp_path / "data", run, "--set", "configurations=1", "--resume") == 0
    assert records(run) == before
    assert names_in_coco(run) == ["a_c0.png"]
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
    name = file_name(text)
    (tmp_path / name).write_text("")
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert not name.startswith(".")


def test_distinct_names_keep_what_is_unambiguous():
    assert distinct_names(["a", "b", "Person", "Person (2)"]) == ["a", "b", "Person", "Person (2)"]
    assert distinct_names(["a", "A", "a-2", "a"]) == ["a", "A-3", "a-2", "a-4"]
    assert file_name("Person (2) \u6771\u4eac") == "Person (2) \u6771\u4eac"
