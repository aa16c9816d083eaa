"""Frames of two runs matched and compared, and what a run offers of its original labels."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from infrablend.core.frame_row import FrameRow, InsertRow
from infrablend.errors import ArgumentError, DatasetError
from infrablend.studio.comparison import FramePair, PairView, RunComparison, pair_rows
from infrablend.studio.open_studio import Session
from infrablend.studio.opened_run import RunFrames
from infrablend.studio.run_labels import RunLabels
from infrablend.studio.studio_request import StudioRequest
from tests.studio_runs import frame_record, write_run


def row(frame_id: str, background: str, digest: str, inserts: int = 1, **values: float) -> FrameRow:
    """Return a frame with some equal inserts, by default of 10 px, whole, and with a contrast of 20."""
    size_px = values.get("size_px", 10)
    insert = InsertRow(
        "drone",
        (0, 0, size_px, 3),
        visibility=values.get("visibility", 1),
        signed_grey=values.get("contrast", 20),
    )
    return FrameRow(frame_id, digest=digest, background=background, inserts=(insert,) * inserts)


FIRST = (
    row("test/night/a_c0", "a", "1"),
    row("test/night/a_c1", "a", "2"),
    row("test/b_c0", "b", "3", 0),
    row("val/a_c0", "a", "4"),
)
SECOND = (
    row("test/a_c0", "a", "1"),
    row("test/a_c1", "a", "9", 3, size_px=40, visibility=0.5, contrast=18),
    row("test/c_c0", "c", "5", 0),
    row("val/a_c0", "a", "6", contrast=25),
)


def test_frames_are_matched_by_background_and_configuration() -> None:
    pairs = {pair.id: pair for pair in pair_rows(FIRST, SECOND)}
    assert {k: (p.a, p.b) for k, p in pairs.items()} == {
        "test/a_c0": (0, 0), "test/a_c1": (1, 1), "test/b_c0": (2, None), "test/c_c0": (None, 2), "val/a_c0": (3, 3),
    }  # fmt: skip
    assert pairs["test/a_c0"].same
    assert not pairs["test/a_c0"].changes
    assert pairs["test/a_c1"].changes == {"inserted": 2, "size_px": 2, "visibility": -0.5, "contrast": -2}


def test_the_largest_difference_comes_first_and_single_frames_have_lists_of_their_own() -> None:
    pairs = pair_rows(FIRST, SECOND)

    def shown(**fields: object) -> list[str]:
        return [pairs[n].id for n in PairView(**fields).apply(pairs)]  # type: ignore[arg-type]

    assert shown() == ["test/a_c1", "val/a_c0", "test/a_c0"]
    assert shown(sort="contrast") == ["val/a_c0", "test/a_c1", "test/a_c0"]
    assert shown(changed=True, sort="id") == ["test/a_c1", "val/a_c0"]
    assert shown(side="a") == ["test/b_c0"]
    assert shown(side="b") == ["test/c_c0"]
    view = PairView("a", "contrast", "x", True)
    assert PairView.from_query(view.to_query()) == view
    assert PairView.from_query({"side": "../x", "sort": "evil"}) == PairView()


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Path, Path]]:
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    both = [frame_record(f"test/{n}_c0", background={"id": n, "path": f"{n}.png", "size_wh": [64, 48]}) for n in "ab"]
    first = write_run(tmp_path / "first", {r["frame_id"]: r for r in both})
    yield first, write_run(tmp_path / "second", {both[1]["frame_id"]: both[1]})


def test_nothing_outside_both_runs_is_shown(runs: tuple[Path, Path]) -> None:
    compared = RunComparison(*(RunFrames(run) for run in runs))
    assert compared.pairs() == [FramePair("test/a_c0", 0, None), FramePair("test/b_c0", 1, 0, {}, True)]
    assert compared.picture(1, 0, boxes=True, originals=True)[:4] == b"\x89PNG"
    with pytest.raises(DatasetError, match="no such frame"):
        compared.picture(1, 1, boxes=False, originals=False)
    image = runs[1] / "images/test/b_c0.png"
    image.unlink()
    image.symlink_to(runs[0] / "images/test/a_c0.png")
    with pytest.raises(DatasetError, match="link out of"):
        compared.picture(1, 0, boxes=False, originals=False)


def test_a_second_run_needs_a_first_one(runs: tuple[Path, Path]) -> None:
    first, second = runs
    with pytest.raises(ArgumentError, match="itself"):
        Session(StudioRequest(run=first, compare=str(first)))
    with pytest.raises(ArgumentError, match="no such folder"):
        Session(StudioRequest(run=first, compare="hit-uav-person"))
    with closing(Session(StudioRequest(run=first, compare=str(second)))) as session:
        assert session.comparison is not None
        assert session.comparison.names == ("first", "second")


def test_original_labels_come_from_the_tables_of_the_run(runs: tuple[Path, Path], tmp_path: Path) -> None:
    objects = {"bbox": [[1, 2, 3, 4], [5, 6, 7, 8]], "category": ["Car", "drone"], "inserted": [False, True]}
    table = runs[0] / "images/test/metadata.jsonl"
    lines = [json.dumps({"file_name": "a_c0.png", "objects": objects}), "{", '{"file_name": "b_c0.png"}']
    table.write_text("\n".join(lines))
    found = RunLabels(RunFrames(runs[0]).layout)
    assert [(o.category, o.box_xyxy) for o in found.of("test/a_c0.png") if not o.inserted] == [("Car", (1, 2, 4, 6))]
    assert found.of("test/b_c0.png") == ()
    (tmp_path / "outside.jsonl").write_text(table.read_text())
    table.unlink()
    table.symlink_to(tmp_path / "outside.jsonl")
    assert RunLabels(RunFrames(runs[0]).layout).of("test/a_c0.png") == (), "a link out of the run is not followed"
