"""The report's summary: plain words for what a run holds, and a meaning for each warning about runs."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

from infrablend.errors import Problem
from infrablend.pipeline.plans import checks, times
from infrablend.pipeline.runs import warnings
from infrablend.report.run.facts import FrameFacts, InsertFacts, RemovedLabel, RunFacts
from infrablend.report.run.summary import MEANINGS, plain_summary


def run_of(*frames: FrameFacts, problems: tuple[Problem, ...] = ()) -> RunFacts:
    return RunFacts(Path(), "r", "", "", "", "1", (), {}, problems, {}, {}, {}, frames)


def frame(n: int, *inserts: InsertFacts, time: str | None = "night", **facts: object) -> FrameFacts:
    fields = {"removed": (), "dropped": (), **facts}
    return FrameFacts(f"train/{n}", "", (640, 512), frozenset(), time, 60.0, 80.0, inserts, **fields)  # type: ignore[arg-type]


def test_numbers_and_links_of_a_run() -> None:
    person, hidden = InsertFacts("person", (0, 0, 8, 20)), InsertFacts("person", (0, 0, 6, 7), visibility=0.5)
    frames = (
        frame(0, person, hidden),
        frame(1, InsertFacts("deer", (0, 0, 30, 40)), time="day", dropped=("no_ground", "no_place")),
        frame(2, time=None, removed=(RemovedLabel("car", "covered", 0.9),)),
    )
    problem = Problem("placement", "objects-absent", "a", "b", "c", "warning")
    text = plain_summary(run_of(*frames, problems=(problem, problem)))
    assert [t for t, _ in text] == [
        "3 objects were inserted into 2 of 3 pictures: 2 x person, 1 x deer. Each has a label.",
        "Half of them are larger than 20 pixels, the smallest is 7.0 pixels long; 1 of 3 is below 10 pixels.",
        "1 object was partly hidden, or cut by the picture's edge.",
        "Time of day: 1 by night, 1 by day, 1 at an unknown time.",
        "2 objects more were wanted and left out, for the reasons listed below.",
        "1 label of real objects was removed; all others stay.",
        "There is one thing to check before the run is used.",
    ]
    assert dict(text)["There is one thing to check before the run is used."] == "#warnings"


def test_tracks_are_objects_with_many_labels() -> None:
    one, two = InsertFacts("person", (0, 0, 8, 20), track="1"), InsertFacts("person", (0, 0, 8, 20), track="2")
    said = plain_summary(run_of(frame(0, one), frame(1, one, two)))[0][0]
    assert said == "2 objects with 3 labels were inserted into 2 of 2 pictures: 3 x person."


def test_a_run_without_anything_says_so() -> None:
    assert [t for t, _ in plain_summary(run_of())] == [
        "Nothing was inserted.", "All labels of real objects stay.",
    ]  # fmt: skip


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
