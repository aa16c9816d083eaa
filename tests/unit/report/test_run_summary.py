"""The report's summary: plain words for what a run holds, and a meaning for each warning about runs."""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from infrablend.core.frame_row import FrameRow, InsertRow, RemovedLabel
from infrablend.errors import Problem
from infrablend.pipeline.plans import checks, times
from infrablend.report import run_warnings as warnings
from infrablend.report.run_facts import MEANINGS, RunFacts, plain_summary
from infrablend.report.run_page import run_page


def run_of(*frames: FrameRow, problems: tuple[Problem, ...] = (), **counts: Any) -> RunFacts:
    return RunFacts(Path(), "r", "", "", "", "1", (), counts, problems, {}, {}, {}, frames)


def sentences(*frames: FrameRow, **counts: Any) -> list[str]:
    return [text for text, _ in plain_summary(run_of(*frames, **counts))]


def frame(n: int, *inserts: InsertRow, time: str | None = "night", **facts: Any) -> FrameRow:
    facts = {"size_wh": (640, 512), "pitch_deg": 60.0, "altitude_m": 80.0, **facts}
    return FrameRow(f"train/{n}", time_of_day=time, inserts=inserts, **facts)


def test_numbers_and_links_of_a_run() -> None:
    person, hidden = InsertRow("person", (0, 0, 8, 20)), InsertRow("person", (0, 0, 6, 7), visibility=0.5)
    frames = (
        frame(0, person, hidden),
        frame(1, InsertRow("deer", (0, 0, 30, 40)), time="day", drops=("no_ground", "no_place")),
        frame(2, time=None, removed=(RemovedLabel("car", "covered", 0.9),)),
    )
    problem = Problem("placement", "objects-absent", "a", "b", "c", "warning")
    text = plain_summary(run_of(*frames, problems=(problem, problem), labels={"person": 5}))
    assert [t for t, _ in text] == [
        "3 objects were inserted into 2 of 3 pictures: 2 x person, 1 x deer. Each has a label.",
        "Half of them are at least 20 pixels long, the smallest is 7; 1 of 3 is smaller than 10 pixels.",
        "1 object was partly hidden, or cut by the picture's edge.",
        "Time of day: 1 by night, 1 by day, 1 at an unknown time.",
        "2 more objects were wanted, but are missing or without label, for the reasons listed below.",
        "1 label of real objects was removed; all others stay.",
        "There is one thing to check before the run is used.",
    ]
    assert dict(text)["There is one thing to check before the run is used."] == "#warnings"


def test_a_run_without_anything_says_so() -> None:
    assert sentences() == ["Nothing was inserted."]
    assert sentences(frame(0), labels={"person": 1})[-1] == "All labels of real objects stay."


def test_one_of_each_is_in_the_singular() -> None:
    one = frame(0, InsertRow("person", (0, 0, 8, 20), visibility=0.5), drops=("no_place",))
    assert sentences(one, labels={"person": 1}, failed_frames=1, skipped_backgrounds=1) == [
        "1 object was inserted into 1 of 1 picture: 1 x person. Each has a label.",
        "It is 20 pixels long.",
        "1 object was partly hidden, or cut by the picture's edge.",
        "Time of day: 1 by night.",
        "1 more object was wanted, but is missing or without label, for the reasons listed below.",
        "1 background could not be used.",
        "1 picture could not be made.",
    ]


def test_an_object_of_a_sequence_is_one_object() -> None:
    person = InsertRow("person", (0, 0, 8, 20), visibility=0.5, track="a c0 1")
    text = sentences(frame(0, person), frame(1, person), frame(2))
    assert text[0] == "1 object was inserted into 2 of 3 pictures, with 2 labels: 2 x person. Each has a label."
    assert text[2] == "1 object was partly hidden, or cut by the picture's edge."


def test_objects_without_labels_were_inserted_as_well() -> None:
    bare = RemovedLabel("person", "labels", 0.0, inserted=True)
    assert sentences(frame(0, removed=(bare, bare)), labels={"car": 3})[::2] == [
        "2 objects were inserted without label, as the recipe asks for.", "All labels of real objects stay.",
    ]  # fmt: skip
    lost = frame(0, InsertRow("person", (0, 0, 8, 20)), removed=(RemovedLabel("car", "labels", 0.0),))
    assert sentences(lost, labels={"person": 1})[-1] == "1 label of real objects was removed, and none is left."


def test_all_links_lead_to_sections_of_the_page_and_names_are_text(tmp_path: Path) -> None:
    name, warning = "<b>car</b>", Problem("placement", "objects-absent", "a", "b", "c", "warning")
    failed = Problem("train/9", "frame-crashed", "a", "b", "c")
    full = frame(0, InsertRow(name, (0, 0, 8, 20), visibility=0.5, track="a c0 1"), drops=("no_place",))
    full = replace(full, removed=(RemovedLabel(name, "covered", 0.9),))
    runs = [
        run_of(), run_of(frame(0)), run_of(full), run_of(frame(0), full, problems=(warning,), labels={name: 2}),
        run_of(full, problems=(failed, warning), failed_frames=1, skipped_backgrounds=2),
    ]  # fmt: skip
    for run in runs:
        page = run_page(replace(run, root=tmp_path))
        anchors = set(re.findall(r'id="([^"]+)"', page))
        assert {link for _, link in plain_summary(run) if link} <= {f"#{a}" for a in anchors}
        assert set(re.findall(r'href="#([^"]+)"', page)) <= anchors
        assert name not in page


def test_every_warning_about_runs_has_a_meaning() -> None:
    """Codes are the second argument of `Problem`, or the first field of a table of reasons."""
    codes = {r.code for r in warnings._REASONS.values()} | {d[0] for d in warnings._DOUBTS.values()}
    for module in (warnings, checks, times):
        for call in ast.walk(ast.parse(inspect.getsource(module))):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "Problem" and len(call.args) == 6:
                code = ast.unparse(call.args[1])
                if code not in ("code", "reason.code"):
                    codes.add(eval(code, vars(module)))
    assert codes <= set(MEANINGS), codes - set(MEANINGS)
