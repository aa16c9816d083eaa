"""`report.html`: every run has one, every number leads to its frames, names are text, and its size has a bound."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.frame_row import FrameRow, InsertRow, RemovedLabel
from infrablend.errors import Problem
from infrablend.report import run_page as page
from infrablend.report.run_charts import bin_edges
from infrablend.report.run_facts import RunFacts, removed_crops
from infrablend.report.run_page import run_page
from tests.command_line import done
from tests.flat_renderer import render_flat
from tests.run_files import frame_ids, without_times
from tests.samples import SAMPLES

HOSTILE = "<script>alert(1)</script>\"'><img src=x onerror=alert(1)>{{ 7*7 }}&amp;\u202e"


@pytest.fixture(autouse=True)
def flat(monkeypatch: pytest.MonkeyPatch) -> None:
    render_flat(monkeypatch)


class _Page(HTMLParser):
    """Elements and attributes of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.classes: list[str] = []
        self.handlers: list[str] = []
        self.text = ""
        self._depth = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._depth += tag in ("style", "script")
        for name, value in attrs:
            if name == "id":
                self.ids.append(str(value))
            if name in ("href", "src", "xlink:href", "action", "data", "poster", "srcset"):
                self.addresses.append(str(value))
            if name == "class":
                self.classes += str(value).split()
            if name.startswith("on"):
                self.handlers.append(name)

    def handle_endtag(self, tag: str) -> None:
        self._depth -= tag in ("style", "script")

    def handle_data(self, data: str) -> None:
        if not self._depth:
            self.text += data


def read(path: Path) -> _Page:
    return _Page(path.read_text("utf-8"))


@pytest.fixture
def made(tmp_path: Path) -> Path:
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(api.show_recipe("hit-uav-drone").replace("configurations: 2", "configurations: 1"))
    words = ["--set", "camera.pitch={fixed_deg: 60}", "--set", "camera.size_px=[64, 48]", "--to", "yolo,coco"]
    done("generate", recipe, "--data", SAMPLES["coco"](tmp_path / "data"), "--out", tmp_path / "run", *words)
    return tmp_path / "run"


def test_generate_writes_a_page_that_needs_nothing_else(made: Path) -> None:
    found = read(made / "report.html")
    frames = frame_ids(made)
    assert all(frame_id in found.text for frame_id in frames)
    assert "--seed 0" in found.text and "recipe.yaml" in found.text
    assert "Classes before and after" in found.text and "Smallest" in found.text
    assert re.search(r"[0-9.]+ s in all; [0-9.]+ s for frames", found.text)
    assert sum(a.startswith("data:image/") for a in found.addresses) >= len(frames)
    for address in found.addresses:
        if not address.startswith(("data:image/", "#")):
            assert (made / address).is_file(), address
    anchors = {a.removeprefix("#") for a in found.addresses if a.startswith("#")}
    assert anchors <= {*found.ids}
    assert len(found.ids) == len(set(found.ids))
    assert str(made.parent) not in (made / "report.html").read_text()


def test_a_list_of_frames_contains_the_frames_of_its_number(made: Path) -> None:
    text = (made / "report.html").read_text()
    (name, count) = re.findall(r'<tr><td><bdi>drone</bdi>.*?href="#(f\d+)"[^>]*>(\d+)<', text)[0]
    assert int(count) == len(frame_ids(made)) == _Page(text).classes.count(name)
    assert f"#{name}:target~#list>:not(.{name})" in text


def test_report_writes_the_same_page_again(made: Path) -> None:
    before = (made / "report.html").read_bytes()
    (made / "report.html").unlink()
    assert done("report", made).output.strip() == str(made / "report.html")
    assert without_times("report.html", (made / "report.html").read_bytes()) == without_times("report.html", before)


def test_excluded_frames_are_listed_with_their_reason_only(made: Path) -> None:
    left_out, *rest = frame_ids(made)
    done("exclude", made, left_out, "--reason", "too bright")
    found = read(made / "report.html")
    assert f"{left_out}: too bright" in found.text
    assert not [a for a in found.addresses if left_out.rpartition("/")[2] in a]
    assert all(any(f"images/{frame_id}." in a for a in found.addresses) for frame_id in rest)


# -- removed labels


def test_removed_labels_are_shown_beside_the_insert_over_them(tmp_path: Path) -> None:
    drone = InsertRow("drone", (0.0, 0.0, 20.0, 12.0))
    far, near = InsertRow("deer", (40.0, 30.0, 60.0, 44.0)), (5.0, 4.0, 8.0, 10.0)
    labels = (
        RemovedLabel("Person", "covered", 0.97, False, near),
        RemovedLabel("Car", "category", 0.0, False, (30, 1, 35, 4)),
    )
    frame = FrameRow("train/a", "a.png", size_wh=(64, 48), background="a", inserts=(far, drone), removed=labels)
    seen = RemovedLabel("Person", "covered", 0.91, False, near)
    other = dataclasses.replace(frame, id="train/b", removed=(seen, RemovedLabel("Person", "covered", 0.9)))
    found = removed_crops([frame, other], 8)
    assert [(c.frame, c.label.covered_share, c.cover) for c in found["covered"]] == [(1, 0.91, drone), (0, 0.97, drone)]
    assert found["covered"][0].window_xyxy == (0.0, 0.0, 20.0, 12.0)
    assert found["category"][0].cover is None and found["category"][0].window_xyxy == (30, 1, 35, 4)
    assert [c.frame for c in removed_crops([frame, other], 1)["covered"]] == [1]
    wide = dataclasses.replace(other, inserts=(InsertRow("drone", (0.0, 0.0, 400.0, 300.0)),))
    assert removed_crops([wide], 1)["covered"][0].window_xyxy == (0.0, 0.0, 38.0, 40.0)
    (tmp_path / "images").mkdir()
    Image.fromarray(np.zeros((48, 64), np.uint8)).save(tmp_path / "images/a.png")
    text = run_page(run_of(tmp_path, [frame, other]))
    section = text[text.index('<section id="removed">') : text.index('<section id="dropped">')]
    assert "Person 3 x 6 px, 91 % covered; over it: drone 20 x 12 px" in section
    assert section.count('class="lost"') == section.count("data:image/") == 3


# -- names from the data


def frames_of(root: Path, count: int, name: str = "a") -> Iterator[FrameRow]:
    for k in range(count):
        insert = InsertRow(name, (4.0 + k % 40, 5.0, 20.0 + k % 40, 15.0 + k % 7), 10 + k, 5.0 + k, -3.0 + k % 9, 0.9)
        removed = (RemovedLabel(name, "covered", 1.0, False, (6.0, 6.0, 9.0, 9.0)),) if k % 3 == 0 else ()
        yield FrameRow(
            f"train/{name}{k}",
            f"{name}{k % 2}.png",
            size_wh=(64, 48),
            background=name,
            time_of_day="day",
            pitch_deg=30.0,
            inserts=(insert,),
            removed=removed,
            drops=(name,),
            warnings=(Problem(name, name, name),),
        )


def run_of(root: Path, frames: list[FrameRow], name: str = "a") -> RunFacts:
    problem = Problem(f"{name}: object 1", name, name, name, name, "warning")
    return RunFacts(
        root, name, name, name, name, name, [(name, name)], {"labels": {name: 3}, "labels_inserted": {name: 3}},
        [problem, Problem(name, "frame-error", name)], {name: name}, {"seconds": 1.0, "worker_seconds": {name: 1.0}},
        {name: name}, frames,
    )  # fmt: skip


def test_names_from_the_data_are_text(tmp_path: Path) -> None:
    plain = _Page(run_page(run_of(tmp_path, list(frames_of(tmp_path, 5)))))
    hostile = _Page(run_page(run_of(tmp_path, list(frames_of(tmp_path, 5, HOSTILE)), HOSTILE)))
    assert hostile.tags == plain.tags
    assert hostile.handlers == []
    assert hostile.ids == plain.ids
    assert HOSTILE in hostile.text
    assert all(a.startswith(("#", "images/", "run.json", "data:")) for a in hostile.addresses)


def test_hostile_names_come_through_the_command_line(tmp_path: Path) -> None:
    name = "<b onclick=alert(1)>&quot;'x"
    (tmp_path / "data").mkdir()
    Image.fromarray(np.arange(64 * 48, dtype=np.uint16).reshape(48, 64).astype(np.uint8)).save(
        tmp_path / "data" / f"{name}.png"
    )
    words = ["--set", "camera.pitch={fixed_deg: 60}", "--set", "camera.size_px=[64, 48]", "--to", "yolo"]
    category = "objects=[{model: drone, category: '<b onclick=alert(1)>drone</b>'}]"
    done("generate", "hit-uav-drone", "--data", tmp_path / "data", "--out", tmp_path / "run", *words, "--set", category)
    found = read(tmp_path / "run/report.html")
    # A frame's name has no character that Windows refuses; the rest of the picture's name stays as it is.
    assert "_b onclick=alert(1)_&quot;'x" in found.text and "<b onclick=alert(1)>drone</b>" in found.text
    assert found.handlers == []


# -- size


def test_size_has_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "images").mkdir()
    for k in range(2):
        Image.fromarray(rng.integers(0, 255, (48, 64), np.uint8)).save(tmp_path / f"images/a{k}.png")
    monkeypatch.setattr(page, "LISTED", 60)
    monkeypatch.setattr(page, "EMBEDDED", 20)
    text = run_page(run_of(tmp_path, list(frames_of(tmp_path, 500))))
    found = _Page(text)
    assert 60 <= found.classes.count("frame") <= 60 + 4 * page.CROPS
    assert sum(a.startswith("data:image/jpeg") for a in found.addresses) == 20
    assert "of 500 frames are listed" in found.text
    assert {a.removeprefix("#") for a in found.addresses if a.startswith("#")} <= {*found.ids}


def test_ten_thousand_frames_take_less_than_twenty_megabytes(tmp_path: Path) -> None:
    text = run_page(run_of(tmp_path, list(frames_of(tmp_path, 10_000, "background_of_a_usual_name"))))
    # Pictures come on top: at most 1000 of them, of about 6 kB each.
    assert len(text.encode()) < 14e6


@pytest.mark.parametrize(("low", "high"), [(0, 1), (5, 5), (3, 400), (0.01, 9000), (-130, 95), (60, 60.001), (1e-9, 1)])
def test_bins_are_few_and_cover_every_value(low: float, high: float) -> None:
    edges = bin_edges(low, high)
    assert edges[0] <= low and edges[-1] > high
    assert edges == sorted(set(edges))
    assert 2 <= len(edges) <= 26
