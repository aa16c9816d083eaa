"""Sheets for people who judge where inserted objects stand, and the counts of their answers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from infrablend import api
from tests.run_files import records

KEY = {str(n): {"run": "a" if n <= 6 else "b"} for n in range(1, 11)}
FIRST = "right right right right grass roof right right kerb unclear"
SECOND = "right right right grass grass roof grass right right right"


@pytest.fixture
def sheets(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "scripts"))
    import blind_sheets

    return blind_sheets


@pytest.fixture(scope="module")
def runs(tmp_path_factory, write_tiny_hit_uav) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("runs")
    data = write_tiny_hit_uav(folder / "data")
    how = api.Execution(renderer="flat", in_process=True)
    for seed in (1, 2):
        settings = ["configurations=1", "objects.0.count={values: [4]}", "output.formats=[yolo]"]
        out = folder / f"run-{seed}"
        api.generate("hit-uav-drone", data, out, settings=settings, seed=seed, execution=how)
    return {"old": folder / "run-1", "new": folder / "run-2"}


def make(sheets, runs, out, count=16, category="drone") -> int:
    named = [word for name, run in runs.items() for word in ("--run", f"{name}={run}")]
    return sheets.main(["make", *named, "--class", category, "--count", str(count), "--out", str(out)])


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


def answers(path: Path, places: str, headings: Sequence[str] = ("",) * 10) -> Path:
    rows = [
        f"{n},{place},{heading}" for n, (place, heading) in enumerate(zip(places.split(), headings, strict=True), 1)
    ]
    path.write_text("\n".join(["number,place,heading", *rows]))
    return path


@pytest.fixture
def judged(tmp_path) -> Path:
    (tmp_path / "key.json").write_text(json.dumps(KEY))
    return tmp_path


def test_objects_of_all_runs_are_mixed_and_listed_in_the_key(sheets, runs, tmp_path):
    assert make(sheets, runs, tmp_path / "sheets") == 0
    key = json.loads((tmp_path / "sheets" / "key.json").read_text())
    assert set(key) == {str(n) for n in range(1, 17)}
    of_runs = [key[str(n)]["run"] for n in range(1, 17)]
    assert of_runs.count("old") == of_runs.count("new") == 8
    assert of_runs not in (sorted(of_runs), sorted(of_runs, reverse=True))
    pictures = [(one["run"], one["picture"]) for one in key.values()]
    assert {pictures.count(p) for p in pictures} == {2}  # spread over the four pictures of each
    known = {
        (name, r.image, tuple(round(float(v), 2) for v in i.box_xyxy))
        for name, run in runs.items() for r in records(run) for i in r.inserted
    }  # fmt: skip
    found = {(one["run"], one["picture"], tuple(one["box_xyxy"])) for one in key.values()}
    assert len(found) == 16 and found <= known
    assert sorted(contents(tmp_path / "sheets")) == ["answers.csv", "key.json", "sheet_01.png", "sheet_02.png"]
    lines = (tmp_path / "sheets" / "answers.csv").read_text().splitlines()
    assert lines == ["number,place,heading", *(f"{n},," for n in range(1, 17))]


def test_the_same_input_gives_the_same_bytes(sheets, runs, tmp_path):
    for name in ("first", "second"):
        assert make(sheets, runs, tmp_path / name) == 0
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


def test_no_more_than_three_of_a_picture(sheets, runs, tmp_path, capsys):
    assert make(sheets, {"old": runs["old"]}, tmp_path / "sheets", count=100) == 0
    assert "old: 12 of 100 objects in 4 pictures" in capsys.readouterr().out


def test_answers_are_not_replaced(sheets, runs, tmp_path, capsys):
    kept = answers(tmp_path / "answers.csv", FIRST)
    before = kept.read_bytes()
    assert make(sheets, runs, tmp_path) == 2
    assert "expected a new folder" in capsys.readouterr().err and kept.read_bytes() == before


def test_a_class_that_was_not_inserted_and_wrong_runs_are_refused(sheets, runs, tmp_path, capsys):
    assert make(sheets, runs, tmp_path / "sheets", category="Car") == 2
    assert "no inserted object of class 'Car'; it has drone" in capsys.readouterr().err
    for wrong in ("old", "=DIR", "old="):
        with pytest.raises(SystemExit, match="2"):
            sheets.main(["make", "--run", wrong, "--class", "drone", "--out", str(tmp_path / "sheets")])
    assert make(sheets, {"old": tmp_path}, tmp_path / "sheets") == 2


@pytest.mark.parametrize(
    ("box", "zoom", "left_top"),
    [
        ([300, 200, 330, 220], 2, (215, 130)),
        ([300, 200, 400, 260], 1, (150, 70)),
        ([0, 0, 30, 20], 2, (0, 0)),
        ([100, 100, 500, 300], 0.5, (0, 0)),
    ],
)
def test_a_cell_shows_the_surroundings_and_leaves_the_object_free(sheets, box, zoom, left_top):
    pixels = np.full((512, 640, 3), 90, np.uint8)
    x0, y0, x1, y1 = box
    pixels[y0:y1, x0:x1] = 200
    shown = sheets.cell(7, pixels, np.array(box, np.float64))[sheets.TITLE_PX :]
    assert shown.shape == ((256, 320, 3) if zoom < 1 else (320, 400, 3))
    x0, y0, x1, y1 = (round((v - (*left_top, *left_top)[k]) * zoom) for k, v in enumerate(box))
    assert (shown[y0:y1, x0:x1] == 200).all()
    assert (shown == 200).all(axis=2).sum() == (y1 - y0) * (x1 - x0)
    ticks = np.argwhere(shown[:, :, 0] > 200)
    assert 0 < len(ticks) < 120
    np.testing.assert_allclose(ticks.max(axis=0), [y1 + 2, x1 + 2], atol=1)


def test_counts_by_run(sheets, judged, capsys):
    assert (
        sheets.main(["score", str(judged), str(answers(judged / "one.csv", FIRST, ["yes", "no", "yes", *[""] * 7]))])
        == 0
    )
    rows = [[c.strip() for c in line.split("|")[1:-1]] for line in capsys.readouterr().out.splitlines() if "|" in line]
    assert rows[2:] == [
        ["a", "6", "0", "4", "0.667 (0.300 to 0.903)", "grass 1, roof 1", "2 of 3"],
        ["b", "3", "1", "2", "0.667 (0.208 to 0.939)", "kerb 1", "0 of 0"],
    ]


def test_wilson_interval(sheets):
    assert sheets.wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert sheets.wilson(0, 10) == pytest.approx((0, 0.2775), abs=1e-4)
    assert sheets.wilson(0, 0) is None


def test_agreement_of_two_judges(sheets, judged, capsys):
    files = [str(answers(judged / name, places)) for name, places in (("one.csv", FIRST), ("two.csv", SECOND))]
    assert sheets.main(["score", str(judged), *files]) == 0
    # Of nine: both right 4, neither 2, the first alone 2, the second alone 1. By chance (6*5 + 3*4) / 81 = 42 / 81;
    # kappa (54 - 42) / (81 - 42).
    assert "Both judged 9: right or not is equal for 0.667 of them, kappa 0.308" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("places", "expected"),
    [("right right", (2, 1.0, None)), ("right roof", (2, 1.0, 1.0)), ("unclear unclear", (0, None, None))],
)
def test_agreement_without_variety_has_no_kappa(sheets, places, expected):
    given = {str(n): (place, "") for n, place in enumerate(places.split())}
    assert sheets.agreement(given, given) == expected


def test_files_of_spreadsheets_are_read(sheets, judged):
    text = "number;place;heading;note\n" + "".join(f"{n};Right ;YES;\u00fc\n" for n in KEY) + ";;;\n"
    (judged / "sheet.csv").write_bytes(text.replace("\n", "\r\n").encode("cp1252"))
    found, wrong = sheets.read_answers(judged / "sheet.csv", KEY)
    assert wrong == [] and found == dict.fromkeys(KEY, ("right", "yes"))


def test_all_errors_are_named_at_once(sheets, judged, capsys):
    text = "number,place,heading\n1,right,maybe\n1,right,\n11,right,\n2,lake,\n3,,no\n4\n"
    (judged / "wrong.csv").write_text(text)
    (judged / "other.csv").write_text("number,surface\n1,right\n")
    assert sheets.main(["score", str(judged), str(judged / "wrong.csv"), str(judged / "other.csv")]) == 2
    said = capsys.readouterr()
    lines = [line.removeprefix(str(judged)) for line in said.err.splitlines()]
    assert said.out == "" and [line.partition(", expected")[0] for line in lines] == [
        "/wrong.csv, line 2: heading 'maybe'",
        "/wrong.csv, line 3: number '1'",
        "/wrong.csv, line 4: number '11'",
        "/wrong.csv, line 5: place 'lake'",
        "/wrong.csv, line 6: place ''",
        "/wrong.csv: no answer for 4, 5, 6, 7, 8, 9, 10",
        "/other.csv: columns ['number', 'surface']",
    ]


def test_folders_without_a_key_are_refused(sheets, tmp_path, capsys):
    assert sheets.main(["score", str(tmp_path), str(tmp_path / "one.csv")]) == 2
    assert "key.json" in capsys.readouterr().err
