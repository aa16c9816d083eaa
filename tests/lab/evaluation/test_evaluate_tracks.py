"""`evaluate --tracks` on saved detections with a tracker of our own; tests/contract uses those of Ultralytics."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.detection import tracking
from infrablend.detection.detections import Detections, Predictions, detections, write_predictions
from infrablend.errors import DatasetError, MissingDependencyError
from infrablend.lab.evaluation import evaluate as pipeline
from infrablend.lab.evaluation import evaluated_tracks
from infrablend.lab.evaluation.evaluate import evaluate_detector
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings

pytest.importorskip("trackeval", reason="NEEDS TRACKEVAL: `make train` installs it")

CLASSES = ("drone", "bird")


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Names of the pictures of each sequence that was tracked; ids of tracks are the class and the row of the box."""
    followed: list[list[str]] = []

    def follow(images: Sequence[ImageRecord], found: Sequence[Detections], settings: dict[str, Any]) -> list[Any]:
        assert settings["tracker_type"] == "bytetrack"
        followed.append([i.name for i in images])
        return [(of, np.round(of.boxes_xyxy[:, 1]).astype(np.int64)) for of in found]

    monkeypatch.setattr(pipeline, "missing_packages", lambda: ["ultralytics", "torch"])
    monkeypatch.setattr(pipeline, "draw_plots", lambda facts: {"pr.png": b"", "confusion.png": b""})
    monkeypatch.setattr(pipeline, "require_trackers", lambda *_: None)
    monkeypatch.setattr(evaluated_tracks, "tracker_settings", lambda name: {"tracker_type": name, "track_buffer": 30})
    monkeypatch.setattr(evaluated_tracks, "follow", follow)
    return followed


def picture(
    sequence: str | None, frame: int | None, *objects: tuple[str, int | None, float], name: str = ""
) -> ImageRecord:
    """A picture with objects of class, track, and upper edge, 20 px wide; they move by 5 px a frame."""
    x = 5.0 * (frame or 0)
    instances = tuple(Instance(c, np.array([x, y, x + 20, y + 10.0]), track_id=t) for c, t, y in objects)
    name = name or f"{sequence}_{frame}.png"
    return ImageRecord(name, Path(name), "test", (640, 512), instances, Capture(sequence=sequence, frame=frame))


def dataset(*images: ImageRecord) -> Dataset:
    return Dataset(Path("made-up"), "coco", tuple(Category(k, n) for k, n in enumerate(CLASSES)), images)


def two_sequences() -> list[ImageRecord]:
    # In the order of names, frame 10 comes before frame 2.
    frames = sorted(range(12), key=str)
    return [picture(s, k, ("drone", 7, 100.0), ("drone", 8, 200.0)) for s in ("b", "a") for k in frames]


def run(out: Path, data: Dataset, *, left: int = 0, **settings: Any) -> Any:
    """Evaluate detections that are the labels, but for the first `left` pictures."""
    found = {}
    for k, image in enumerate(data.images):
        objects = image.instances if k >= left else ()
        numbers = [CLASSES.index(i.category) for i in objects]
        found[f"test/{image.name}"] = detections([i.box_xyxy for i in objects], [0.9] * len(objects), numbers)
    predictions = Predictions("detect", CLASSES, found, dict.fromkeys(found, (640, 512)), {"weights": "made.pt"})
    saved = write_predictions(out.with_suffix(".json"), predictions)
    chosen = EvaluationSettings(**{"bootstrap": 20, "tracks": True, **settings})
    return evaluate_detector(saved, data, out, chosen)


def said(report: Any) -> dict[str, str]:
    return {p.code: p.found for p in report.problems if p.where == "tracks"}


def test_pictures_are_tracked_by_sequence_in_the_order_of_their_numbers(calls: list[list[str]], tmp_path: Path) -> None:
    report = run(tmp_path / "out", dataset(*two_sequences()))
    assert calls == [[f"{s}_{k}.png" for k in range(12)] for s in ("a", "b")]
    facts = report.metrics["tracks"]
    assert facts["counts"] == {"classes_without_tracks": 1, "pictures": 24, "sequences": 2}
    assert facts["tracker"] == {"tracker_type": "bytetrack", "track_buffer": 30}
    row = facts["classes"]["drone"]
    assert (row["sequences"], row["tracks"], row["objects"], row["found"], row["switches"]) == (2, 4, 48, 4, 0)
    assert [row[m] for m in ("hota", "mota", "idf1")] == pytest.approx([1, 1, 1])
    assert said(report) == {"class-without-tracks": "no labelled track of bird: no figures of tracks"}
    written = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert written["tracks"] == json.loads(json.dumps(facts))
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert "Tracks by bytetrack in 24 pictures of 2 sequences" in page
    assert "HOTA, interval" in page
    again = run(tmp_path / "again", dataset(*two_sequences()))
    for name in ("evaluation.json", "evaluation.html"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
    assert again.metrics == report.metrics


def test_figures_without_tracks_stay_as_they_are(calls: list[list[str]], tmp_path: Path) -> None:
    plain = run(tmp_path / "plain", dataset(*two_sequences()), tracks=False)
    assert not calls
    assert "tracks" not in plain.metrics
    tracked = run(tmp_path / "tracked", dataset(*two_sequences()))
    assert {k: v for k, v in tracked.metrics.items() if k not in ("tracks", "problems")} == {
        k: v for k, v in plain.metrics.items() if k != "problems"
    }
    assert "<h2>Tracks" not in (tmp_path / "plain" / "evaluation.html").read_text()


def test_all_that_does_not_count_is_counted_and_said(calls: list[list[str]], tmp_path: Path) -> None:
    images = [
        *two_sequences(),
        picture(None, None, ("drone", 1, 100.0), name="alone.png"),
        picture("b", None, ("drone", 1, 100.0), name="b_without.png"),
        picture("c", None, ("drone", 1, 100.0)),
        picture("a", 5, ("drone", 1, 100.0), name="z_again.png"),
        picture("d", 3, ("drone", 1, 100.0), ("drone", None, 200.0), ("drone", 1, 300.0)),
        picture("d", 8, ("drone", 1, 100.0), ("bird", None, 200.0)),
        replace(picture("d", 9), extra={"labelled": False}),
        replace(picture("e", 1), extra={"labelled": False}),
    ]
    report = run(tmp_path / "out", dataset(*images))
    facts = report.metrics["tracks"]
    assert facts["counts"] == {
        "classes_without_tracks": 1, "numbers_missing": 4, "objects_repeated": 1, "objects_without_track": 2,
        "pictures": 26, "pictures_not_labelled": 2, "pictures_of_same_number": 1, "pictures_without_number": 2,
        "pictures_without_sequence": 1,
        "sequences": 3, "sequences_without_numbers": 1,
    }  # fmt: skip
    assert sorted(said(report)) == sorted(
        [k.replace("_", "-") for k in facts["counts"] if k not in ("classes_without_tracks", "pictures", "sequences")]
        + ["class-without-tracks"]
    )
    assert said(report)["numbers-missing"].startswith("4 numbers are missing within sequences")
    assert calls[-1] == ["d_3.png", "d_8.png", "d_9.png"]
    row = facts["classes"]["drone"]
    assert (row["tracks"], row["objects"], row["mota"]) == (5, 50, 1)


def test_nothing_to_compare_with_is_an_error_that_says_why(calls: list[list[str]], tmp_path: Path) -> None:
    images = [picture(None, 3, ("drone", 1, 100.0)), picture("a", 1, ("drone", None, 100.0))]
    with pytest.raises(DatasetError, match="no labelled track") as failed:
        run(tmp_path / "out", dataset(*images))
    problem = failed.value.problems[0]
    assert "1 pictures without a sequence" in problem.found
    assert "1 objects in sequences have no track" in problem.found
    assert "leave out --tracks" in problem.todo
    assert not calls
    assert not (tmp_path / "out").exists()


def test_a_tracker_that_finds_nothing_is_said(calls: list[list[str]], tmp_path: Path) -> None:
    report = run(tmp_path / "out", dataset(*two_sequences()), left=24)
    assert said(report)["tracks-none"] == "the tracker found no track"
    assert report.metrics["tracks"]["classes"]["drone"]["hota"] == 0


def test_ignore_regions_hold_for_tracks(calls: list[list[str]], tmp_path: Path) -> None:
    images = [replace(i, instances=(*i.instances, picture("a", i.capture.frame, ("tree", None, 300.0)).instances[0]))
              for i in two_sequences()]  # fmt: skip
    data = replace(dataset(*images), categories=(*dataset().categories, Category(9, "tree", ignore=True)))
    found = {f"test/{i.name}": detections([o.box_xyxy for o in i.instances], [0.9] * 3, [0] * 3) for i in data.images}
    saved = write_predictions(
        tmp_path / "found.json", Predictions("detect", CLASSES, found, dict.fromkeys(found, (640, 512)))
    )
    for regions, mota, tracked in ((True, 1.0, 4), (False, 0.5, 6)):
        settings = EvaluationSettings(bootstrap=0, tracks=True, ignore_regions=regions)
        report = evaluate_detector(saved, data, tmp_path / str(regions), settings)
        row = report.metrics["tracks"]["classes"]["drone"]
        assert (row["mota"], row["found"]) == (mota, tracked)


def test_missing_packages_and_other_trackers_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tracking, "require_ultralytics", lambda: None)
    monkeypatch.setattr(tracking, "find_spec", lambda name: None)
    with pytest.raises(
        MissingDependencyError, match=r"lap and trackeval not installed(.|\n)*infrablend\[train,tracks\]"
    ):
        run(tmp_path / "out", dataset(*two_sequences()))
    assert not (tmp_path / "out").exists()
    with pytest.raises(DatasetError, match="tracker: found 'sort', expected one of bytetrack, botsort"):
        EvaluationSettings(tracker="sort")  # type: ignore[arg-type]
