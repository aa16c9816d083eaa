"""Figures of tracks by hand: trackeval gets what we mean, and draws of sequences are those of repeated sequences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from infrablend.detection.detections import Detections, detections
from infrablend.detection.truth import Truth
from infrablend.lab.evaluation.evaluated_tracks import MEASURES, Followed, only_tracked, track_figures

pytest.importorskip("trackeval", reason="NEEDS TRACKEVAL: `make train` installs it")

Object = tuple[object, float] | tuple[object, float, int]
"""Id, left edge and class of a box of 10 px."""


def box(x: float) -> list[float]:
    return [x, 0, x + 10, 10]


def labels(*objects: Object, regions: Sequence[tuple[float, int]] = ()) -> Truth:
    """Labels of a picture: objects, then regions (left edge, class) to ignore."""
    return Truth(
        "a",
        (640, 512),
        np.array([box(o[1]) for o in objects] + [box(x) for x, _ in regions], np.float64).reshape(-1, 4),
        np.array([o[2] if len(o) > 2 else 0 for o in objects] + [c for _, c in regions], np.int64),
        np.array([False] * len(objects) + [True] * len(regions), np.bool_),
        track_ids=(*(o[0] for o in objects), *(None for _ in regions)),  # type: ignore[arg-type]
    )


def found(*objects: Object) -> tuple[Detections, np.ndarray]:
    of = detections([box(o[1]) for o in objects], [0.9] * len(objects), [o[2] if len(o) > 2 else 0 for o in objects])
    return of, np.array([o[0] for o in objects], np.int64)


def sequence(*pictures: tuple[Truth, tuple[Detections, np.ndarray]], name: str = "s") -> Followed:
    truths, made = zip(*pictures, strict=True)
    return Followed(name, [only_tracked(t)[0] for t in truths], made)


def figures(*sequences: Followed, classes: int = 1, draws: int = 0) -> dict[str, Any]:
    return track_figures(sequences, [f"c{k}" for k in range(classes)], "detect", draws, 0)


def row(*pictures: tuple[Truth, tuple[Detections, np.ndarray]]) -> dict[str, Any]:
    rows = figures(sequence(*pictures))
    assert rows["all"] == rows["c0"]
    return rows["c0"]


def near(**values: float) -> dict[str, Any]:
    return {k: pytest.approx(v, abs=1e-9) for k, v in values.items()}


def test_tracks_that_agree_in_everything_have_the_best_figures() -> None:
    of = row(*((labels(("a", k), (7, 100.0)), found((1, k), (2, 100.0))) for k in range(10)))
    assert of == near(hota=1, deta=1, assa=1, mota=1, idf1=1) | {
        "sequences": 1, "tracks": 2, "objects": 20, "found": 2, "switches": 0, "ci": None,
    }  # fmt: skip


def test_an_object_whose_id_changes_halfway() -> None:
    of = row(*((labels((1, k)), found((1 + k // 5, k))) for k in range(10)))
    assert of | near(hota=math.sqrt(0.5), deta=1, assa=0.5, mota=0.9, idf1=0.5) == of
    assert (of["switches"], of["found"]) == (1, 2)


def test_two_objects_that_swap_their_ids() -> None:
    of = row(*((labels((1, 0), (2, 100)), found((1 + k // 5, 0), (2 - k // 5, 100))) for k in range(10)))
    assert of | near(hota=math.sqrt(1 / 3), deta=1, assa=1 / 3, mota=0.9, idf1=0.5) == of
    assert of["switches"] == 2


def test_an_object_that_is_missed_in_four_of_ten_pictures() -> None:
    of = row(*((labels((1, k)), found((1, k)) if k < 6 else found()) for k in range(10)))
    assert of | near(hota=0.6, deta=0.6, assa=0.6, mota=0.6, idf1=0.75) == of
    assert of["switches"] == 0


def test_a_track_of_nothing() -> None:
    of = row(*((labels((1, k)), found((1, k), (2, 300))) for k in range(10)))
    assert of | near(hota=math.sqrt(0.5), deta=0.5, assa=1, mota=0, idf1=2 / 3) == of


def test_no_track_and_no_object() -> None:
    nothing = row(*((labels((1, k)), found()) for k in range(3)))
    assert nothing | near(hota=0, deta=0, assa=0, mota=0, idf1=0) == nothing
    rows = figures(sequence((labels((1, 0)), found((1, 0), (2, 50, 1)))), classes=2)
    assert rows["c1"] == {"sequences": 0, "tracks": 0, "objects": 0, "found": 1, "ci": None} | dict.fromkeys(MEASURES)
    assert rows["all"]["hota"] == rows["c0"]["hota"] == pytest.approx(1)


def test_what_overlaps_nothing_but_a_region_to_ignore_is_no_error() -> None:
    regions = [(100.0, -1), (200.0, 0), (300.0, 1)]
    picture = labels((1, 0), regions=regions), found((1, 0), (2, 100), (3, 202), (4, 300))
    of = figures(sequence(picture, picture), classes=2)["c0"]
    assert (of["found"], of["mota"]) == (2, 0)  # the crowd of the other class hides nothing
    assert figures(sequence((labels((1, 0), regions=[(0.0, -1)]), found((1, 0)))))["c0"]["hota"] == pytest.approx(1)


def test_objects_without_a_track_and_second_ones_of_a_track_do_not_count() -> None:
    picture = labels((1, 0), (None, 100), (1, 200), (1, 300, 1))
    kept, without, repeated = only_tracked(picture)
    assert (kept.ignore.tolist(), without, repeated) == ([False, True, True, False], 1, 1)
    of = figures(sequence((picture, found((1, 0), (2, 100), (3, 200)))), classes=2)
    assert of["c0"] | near(hota=1, mota=1, idf1=1) | {"found": 1, "objects": 1} == of["c0"]
    assert of["c1"]["mota"] == 0


def test_the_mean_of_classes_and_the_sum_of_switches() -> None:
    pictures = [(labels((1, k), (2, 100, 1)), found((1 + k // 5, k), (3 + k // 2, 100, 1))) for k in range(10)]
    rows = figures(sequence(*pictures), classes=3)
    for measure in MEASURES[:-1]:
        assert rows["all"][measure] == pytest.approx((rows["c0"][measure] + rows["c1"][measure]) / 2)
    assert [rows[n]["switches"] for n in ("all", "c0", "c1", "c2")] == [5, 1, 4, None]
    assert [rows[n]["tracks"] for n in ("all", "c0", "c1", "c2")] == [2, 1, 1, 0]


def varied(name: str, misses: int, switches: int, length: int = 12) -> Followed:
    pictures = []
    for k in range(length):
        mine = [(1 + k * (switches + 1) // length, k)] if k >= misses else []
        pictures.append((labels((1, k), (2, 100, 1)), found(*mine, (50, 101.0, 1), (60, 300))))
    return sequence(*pictures, name=name)


def test_a_sequence_drawn_twice_counts_as_two() -> None:
    from infrablend.lab.evaluation.evaluated_tracks import _measure, _sequence_data

    data = [_sequence_data(s, 0, "detect") for s in (varied("a", 1, 0), varied("b", 5, 2), varied("c", 0, 3, 7))]
    weights = np.array([[1, 1, 1], [2, 0, 1], [0, 3, 0]], np.int32)
    drawn = _measure(data, weights)
    for k, of in enumerate(weights):
        copies = [d for d, n in zip(data, of, strict=True) for _ in range(n)]
        assert drawn[k] == pytest.approx(_measure(copies, np.ones((1, len(copies)), np.int32))[0], abs=1e-12)


def test_intervals_hold_the_figure_and_need_two_sequences() -> None:
    sequences = [varied(f"s{k}", k % 5, k % 3) for k in range(8)]
    rows = figures(*sequences, classes=2, draws=200)
    for name in ("all", "c0"):
        for measure in MEASURES:
            low, high = rows[name]["ci"][measure]
            assert low < rows[name][measure] < high
    assert figures(*sequences, classes=2, draws=200) == rows
    assert figures(*sequences, classes=2)["all"]["ci"] is None
    assert figures(sequences[0], classes=2, draws=50)["all"]["ci"] is None
