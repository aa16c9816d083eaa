"""New splits: whole groups, requested shares, no neighbours across splits, the same bytes each time."""

from __future__ import annotations

import hashlib
import itertools
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend import api
from infrablend.core.capture import Capture
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.errors import ArgumentError, DatasetError, OutputError
from infrablend.formats.image_groups import assign_groups, time_blocks
from infrablend.pipeline.datasets.split import check_shares, split_warnings
from tests.command_line import done, run
from tests.samples import SAMPLES, picture


def tree(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def clips(root: Path) -> Path:
    """Six clips of ten frames in steps of two, which the original splits divide."""
    for clip in range(6):
        for n in range(10):
            split = ("train", "train", "val", "test")[(clip + n) % 4]
            path = picture(root / "images" / split / f"clip{clip}_{2 * n:05}.png", 10 * clip + n)
            label = root / "labels" / split / f"{path.stem}.txt"
            label.parent.mkdir(parents=True, exist_ok=True)
            label.write_text(f"{clip % 2} 0.5 0.5 0.1 0.1\n" * (clip + 1))
    (root / "data.yaml").write_text("train: images/train\nval: images/val\ntest: images/test\nnames: [fox, hare]\n")
    return root


def test_runs_of_frames_stay_together(tmp_path: Path) -> None:
    root = clips(tmp_path / "data")
    before = tree(root)
    report = api.split(root, tmp_path / "out", api.SplitRule(by="gap", shares=(0.5, 0.2, 0.3)))
    assert len(report.groups) == 6 and len(set(report.groups.values())) == 3
    assert report.before[0].near > 0 and [one.near for one in report.after] == [0, 0, 0]
    assert sum(report.images.values()) == 60 and set(report.images.values()) <= {10, 20, 30, 40}
    again = api.read_dataset(tmp_path / "out")
    assert (again.format, len(again.images)) == ("yolo", 60)
    held = {i.name: i.split for i in again.images}
    assert all(len({held[f"clip{c}_{2 * n:05}.png"] for n in range(10)}) == 1 for c in range(6))
    counts = {s: sum(i.split == s for i in again.images) for s in report.images}
    assert counts == report.images
    assert tree(root) == before
    one = next(i for i in again.images)
    assert one.path.stat().st_nlink > 1  # a hard link
    record = json.loads((tmp_path / "out" / "split.json").read_text())
    assert record["groups"] == report.groups and record["image_shares"] == report.shares(report.images)
    api.split(root, tmp_path / "second", api.SplitRule(by="gap", shares=(5, 2, 3)))
    assert tree(tmp_path / "out") == tree(tmp_path / "second")


def test_named_groups_are_test_and_the_others_are_not(tmp_path: Path) -> None:
    root = clips(tmp_path / "data")
    names = sorted(api.split(root, tmp_path / "all", api.SplitRule(by="gap")).groups)
    done("split", root, tmp_path / "out", "--by", "gap", "--test", f"{names[4]},{names[1]}", "--shares", "0.7,0.3,0.9")
    made = json.loads((tmp_path / "out/split.json").read_text())["groups"]
    assert {n for n, split in made.items() if split == "test"} == {names[1], names[4]}
    assert set(made.values()) == {"train", "val", "test"}
    with pytest.raises(DatasetError, match="--test: wolf; expected names of groups"):
        api.split(root, tmp_path / "none", api.SplitRule(by="gap", test=("wolf",)))


def test_a_split_with_hardly_any_object_of_a_class_is_a_warning(tmp_path: Path) -> None:
    """The day with the ten pictures for test holds one hare; that with most pictures all others."""
    root = tmp_path / "data"
    for day, hares, pictures in (("20200101", 39, 40), ("20200102", 0, 4), ("20200103", 1, 10)):
        for n in range(pictures):
            path = picture(root / "images" / "train" / f"{day}_{n:03}.png", n)
            label = root / "labels" / "train" / f"{path.stem}.txt"
            label.parent.mkdir(parents=True, exist_ok=True)
            label.write_text("0 0.5 0.5 0.1 0.1\n" + ("1 0.5 0.2 0.1 0.1\n" if n < hares else ""))
    (root / "data.yaml").write_text("train: images/train\nnames: [fox, hare]\n")
    images = api.read_dataset(root).images
    of_day = {"20200101": "train", "20200102": "val", "20200103": "test"}
    dealt = [replace(i, split=of_day[i.name[:8]]) for i in images]  # type: ignore[arg-type]
    found = split_warnings(dealt, ["fox", "hare"], (0.7, 0.1, 0.2), "date", 3)
    assert [(p.where, p.code, p.severity) for p in found] == [
        ("val", "class-absent", "warning"),
        ("test", "class-scarce", "warning"),
    ]
    assert "only 1 of 40 objects of hare; expected about 20 % of the objects" in str(found[1])
    assert "--by gap" in found[0].todo and "--by gap" in found[1].todo
    assert split_warnings([replace(i, split=s) for i in images for s in ("train", "val", "test")],
                           ["fox", "hare"], (0.4, 0.3, 0.3), "gap", 9) == ()  # fmt: skip


def test_splits_without_pictures_are_a_warning(tmp_path: Path) -> None:
    SAMPLES["coco"](tmp_path / "data")
    ended = done("split", tmp_path / "data", tmp_path / "out", "--by", "gap", "--gap", "100000", "--to", "voc")
    expected = "val and test are empty: one group holds all pictures. Use a smaller --gap, or another --by"
    assert expected in " ".join(ended.stderr.split())


def test_lists_only(tmp_path: Path) -> None:
    root = clips(tmp_path / "data")
    ended = done("split", root, tmp_path / "out", "--by", "gap", "--list", "--json")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["split.json", "test.txt", "train.txt", "val.txt"]
    lines = [p for s in ("train", "val", "test") for p in (tmp_path / "out" / f"{s}.txt").read_text().split()]
    assert len(set(lines)) == 60 and all((root / line).is_file() for line in lines)
    assert json.loads(ended.stdout)["format"] == "list"


@pytest.mark.parametrize("name", sorted(n for n in SAMPLES if n != "folder:plain"))
def test_every_sample_is_written_back_in_its_own_format(name: str, tmp_path: Path) -> None:
    root = SAMPLES[name](tmp_path / "data")
    source = api.read_dataset(root)
    try:
        report = api.split(root, tmp_path / "out", api.SplitRule(by="gap", gap=1, shares=(0.5, 0.25, 0.25)))
    except DatasetError as error:  # a format that is read alone
        assert "written" in error.message or "group" in error.message
        return
    again = api.read_dataset(tmp_path / "out")
    assert {i.split for i in again.images} == {s for s, n in report.images.items() if n}
    assert len(again.images) == len(source.images)
    assert sum(len(i.instances) for i in again.images) == sum(len(i.instances) for i in source.images)
    assert [str(p) for p in again.problems if p.severity == "error"] == []


def test_pictures_of_like_name_do_not_meet(tmp_path: Path) -> None:
    root = tmp_path / "data"
    for k, split in enumerate(("train", "val", "test")):
        picture(root / split / "1.png", k).with_suffix(".txt").write_text("0 0.5 0.5 0.1 0.1\n")
        picture(root / split / "50.png", k + 3).with_suffix(".txt").write_text("0 0.5 0.5 0.1 0.1\n")
    api.split(root, tmp_path / "out", api.SplitRule(by="gap", shares=(1, 0, 1)))
    again = api.read_dataset(tmp_path / "out")
    assert len({i.path for i in again.images}) == 6 == sum(len(i.instances) for i in again.images)


def test_impossible_requests_are_reported_before_writing(tmp_path: Path) -> None:
    root = clips(tmp_path / "data")
    dates = run("split", root, tmp_path / "out", "--by", "date")
    assert dates.exit_code == 2 and "without a date" in dates.stderr
    for words in (
        ("--by", "gap", "--shares", "1,2"),
        ("--by", "gap", "--shares", "1,0,0"),
        ("--by", "gap", "--shares", "a,b,c"),
        ("--by", "date", "--gap", "3"),
        ("--by", "gap", "--to", "xyz"),
        ("--by", "gap", "--to", "coco", "--list"),
        ("--by", "weather"),
    ):
        assert run("split", root, tmp_path / "out", *words).exit_code == 2, words
    assert not (tmp_path / "out").exists()
    with pytest.raises(OutputError, match="inside the data folder"):
        api.split(root, root / "out", api.SplitRule(by="gap"))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("x")
    with pytest.raises(OutputError, match="not empty"):
        api.split(root, tmp_path / "full", api.SplitRule(by="gap"))
    plain = SAMPLES["folder:plain"](tmp_path / "plain")
    shutil.move(plain / "a.jpg", plain / "a1.jpg")
    with pytest.raises(DatasetError, match="own format"):
        api.split(plain, tmp_path / "out", api.SplitRule(by="gap"))


def roboflow(root: Path, name: Callable[[int, int], str]) -> Path:
    """Roboflow's YOLO layout: four runs of four frames, each in three versions."""
    for run_, n, copy in itertools.product(range(4), range(4), range(3)):
        stem = name(100 * run_ + n, copy)
        picture(root / "train" / "images" / f"{stem}.jpg", n)
        label = root / "train" / "labels" / f"{stem}.txt"
        label.parent.mkdir(parents=True, exist_ok=True)
        label.write_text("0 0.5 0.5 0.1 0.1\n")
    (root / "data.yaml").write_text("train: train/images\nval: valid/images\nnc: 1\nnames: [car]\n")
    return root


def key_of(*values: int) -> str:
    return hashlib.md5(repr(values).encode(), usedforsecurity=False).hexdigest()


def test_versions_of_a_frame_stay_together(tmp_path: Path) -> None:
    """The digits of Roboflow's hashes are no frame numbers, and a guess does not check itself."""
    root = roboflow(tmp_path / "data", lambda n, copy: f"DJI_{n:04}_jpg.rf.{key_of(n, copy)}")
    ended = done("split", root, tmp_path / "out", "--by", "gap", "--shares", "0.5,0.25,0.25")
    assert "4 groups by gap" in ended.stdout and "not counted" in ended.stdout and "0 of" not in ended.stdout
    of_run: dict[str, set[str]] = {}
    for i in api.read_dataset(tmp_path / "out").images:
        of_run.setdefault(i.path.name[:6], set()).add(i.split)
    assert len(of_run) == 4 and all(len(splits) == 1 for splits in of_run.values())


@pytest.mark.parametrize("form", ["{key}", "img-{key}", "{n}000"])
def test_groups_of_one_picture_each_are_refused(tmp_path: Path, form: str) -> None:
    root = roboflow(tmp_path / "data", lambda n, copy: form.format(key=key_of(n, copy), n=3 * n + copy))
    ended = run("split", root, tmp_path / "out", "--by", "gap")
    assert ended.exit_code == 2 and "cannot group by gap" in ended.stderr
    assert not (tmp_path / "out").exists()


@given(st.integers(3, 40), st.integers(1, 5), st.integers(0, 3))
def test_shares_are_met_within_the_largest_group(groups: int, classes: int, seed: int) -> None:
    rng = np.random.default_rng(groups * 100 + classes)
    counts = rng.integers(0, 30, (groups, 1 + classes)).astype(np.float64)
    counts[:, 0] += 1
    chosen = assign_groups(counts, (0.7, 0.1, 0.2), seed)
    assert len(chosen) == groups and set(chosen) <= {0, 1, 2}
    assert assign_groups(counts, (0.7, 0.1, 0.2), seed) == chosen
    # With one column every split is within one group of its share.
    of_images = assign_groups(counts[:, :1], (0.7, 0.1, 0.2), seed)
    for k, share in enumerate((0.7, 0.1, 0.2)):
        held = counts[np.array(of_images) == k, 0].sum()
        assert abs(held - share * counts[:, 0].sum()) <= counts[:, 0].max()


def test_split_with_share_zero_is_empty() -> None:
    assert set(assign_groups(np.ones((20, 1)), (0.8, 0.0, 0.2), 0)) == {0, 2}
    assert check_shares((8, 0, 2)) == (0.8, 0.0, 0.2)


def one_flight(root: Path, count: int, times: bool = True) -> Path:
    """A flight whose names are in another order than its times, if it has times; without, names count frames."""
    rows = ["file,captured,sequence"]
    for k in range(count):
        name = f"{'f' if times else ''}{(7 * k) % count if times else k:04}.png"
        picture(root / "images" / name, k)
        label = root / "labels" / f"{name[:-4]}.txt"
        label.parent.mkdir(parents=True, exist_ok=True)
        label.write_text("0 0.5 0.5 0.1 0.1\n")
        rows.append(f"{name},2026-01-12T07:{k // 60:02}:{k % 60:02},one")
    (root / "data.yaml").write_text("train: images\nnames: [fox]\n")
    if times:
        (root / "metadata.csv").write_text("\n".join(rows))
    return root


@pytest.mark.parametrize("times", [True, False])
def test_one_flight_is_cut_into_blocks_of_time_with_a_gap(tmp_path: Path, times: bool) -> None:
    root = one_flight(tmp_path / "data", 100, times)
    said = done("split", root, tmp_path / "out", "--by", "time").output
    record = json.loads((tmp_path / "out/split.json").read_text())
    assert record["images"] == {"train": 63, "val": 9, "test": 18} and record["gap"] == 5
    assert "10 picture(s) with 10 object(s) between the blocks are left out" in said
    assert "10 picture(s) with 10 object(s)" in (tmp_path / "out/README.md").read_text()
    place = {f"f{(7 * k) % 100:04}.png" if times else f"{k:04}.png": k for k in range(100)}
    held: dict[str, list[int]] = {}
    for image in api.read_dataset(tmp_path / "out").images:
        held.setdefault(image.split, []).append(place[image.name])
    assert {s: (min(v), max(v), len(v)) for s, v in held.items()} == {
        "train": (0, 62, 63), "val": (68, 76, 9), "test": (82, 99, 18),
    }  # fmt: skip
    if not times:
        assert [one["near"] for one in record["leakage_after"]] == [0, 0, 0]
    api.split(root, tmp_path / "second", api.SplitRule(by="time"))
    assert tree(tmp_path / "out") == tree(tmp_path / "second")


@pytest.mark.parametrize("count", [7, 8, 20, 21, 1000])
@pytest.mark.parametrize("shares", [(0.7, 0.1, 0.2), (0.98, 0.01, 0.01), (0.01, 0.01, 0.98), (0.5, 0, 0.5)])
def test_blocks_of_time_follow_the_shares_and_lose_only_the_gaps(count: int, shares: tuple[float, ...]) -> None:
    capture = Capture(sequence="one")
    images = [ImageRecord(str(k), Path(f"{k}.png"), "train", None, (), replace(capture, frame=k)) for k in range(count)]
    blocks = time_blocks(images[::-1], shares, 2)
    assert [split for split, share in zip(("train", "val", "test"), shares, strict=True) if share] == [
        b[0].split for b in blocks
    ]
    numbers = [[i.capture.frame for i in block] for block in blocks]
    assert all(n == list(range(n[0], n[-1] + 1)) for n in numbers) and numbers[0][0] == 0
    assert all(after[0] - before[-1] == 3 for before, after in itertools.pairwise(numbers))
    assert numbers[-1][-1] == count - 1
    kept = sum(map(len, numbers))
    for n, share in zip(numbers, (s for s in shares if s), strict=True):
        assert abs(len(n) - kept * share) <= 2


def test_a_flight_that_cannot_be_cut_is_refused(tmp_path: Path) -> None:
    root = one_flight(tmp_path / "data", 8)
    for words, said in (
        (("--gap", "3"), "use a smaller --gap"),
        (("--test", "one"), "the last block of time is test"),
    ):
        result = run("split", root, tmp_path / "out", "--by", "time", *words)
        assert result.exit_code and said in result.output.casefold()
    for by in ("sequence", "date"):
        assert (
            "or --by time, which cuts it into blocks" in run("split", root, tmp_path / by, "--by", by).output.casefold()
        )
    shutil.rmtree(root / "labels")
    (root / "metadata.csv").unlink()
    for k, path in enumerate(sorted(root.rglob("*.png"))):
        path.rename(path.with_name("abcdefgh"[k] + ".png"))
    result = run("split", root, tmp_path / "out", "--by", "time", "--to", "coco")
    assert result.exit_code and "without a time of capture or a frame number" in " ".join(result.output.split())


def flown(root: Path, flights: dict[str, tuple[str, str, int]], split: str = "train") -> Path:
    """A YOLO set whose table states sequence and time of capture of the pictures of each flight: (.., .., pictures)."""
    rows = ["file,pitch_deg,sequence,captured"]
    for name, (sequence, captured, pictures) in flights.items():
        for n in range(pictures):
            path = picture(root / "images" / split / f"{name}-{n}.png", len(rows))
            label = root / "labels" / split / f"{path.stem}.txt"
            label.parent.mkdir(parents=True, exist_ok=True)
            label.write_text("0 0.5 0.5 0.1 0.1\n")
            rows.append(f"{path.name},45,{sequence},{captured}")
    (root / "metadata.csv").write_text("\n".join(rows) + "\n")
    (root / "data.yaml").write_text(f"{split}: images/{split}\nnames: [fox]\n")
    return root


THREE_DAYS = {
    "a": ("evening", "2024-05-01T23:50:00", 4),
    "b": ("evening", "2024-05-02T00:10:00", 4),
    "c": ("noon", "2024-05-01T12:00:00", 8),
    "d": ("dawn", "2024-05-03T05:00:00", 4),
}


def held_splits(dataset: Dataset) -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for image in dataset.images:
        found.setdefault(image.path.stem[0], set()).add(image.split)
    return found


def test_val_is_made_of_whole_days_and_sequences(tmp_path: Path) -> None:
    root = flown(tmp_path / "data", THREE_DAYS)
    dataset = api.read_dataset(root, api.Reading(val_share=0.2))
    assert held_splits(dataset) == {"a": {"train"}, "b": {"train"}, "c": {"train"}, "d": {"val"}}
    assert dataset.notes["val"] == {"share": 0.2, "groups": ["2024-05-03"]}
    assert not [p for p in dataset.problems if p.where == "--val-share"]
    only = api.read_dataset(root, api.Reading(val_share=0.2, splits=("train",)))
    assert len(only.images) == 16 and {i.split for i in only.images} == {"train"}


@pytest.mark.parametrize(
    ("flights", "codes", "val"),
    [
        ({"a": ("s", "2024-05-01", 9), "b": ("t", "2024-05-01", 2)}, ["val-same-day"], {"b"}),
        ({"a": ("s", "", 9), "b": ("t", "", 2)}, [], {"b"}),
        ({"a": ("", "2024-05-01", 9), "b": ("", "2024-05-02", 2)}, [], {"b"}),
        ({"a": ("s", "2024-05-01", 5), "b": ("t", "2024-05-02", 5)}, ["val-share-far"], {"a"}),
    ],
)
def test_val_follows_what_the_pictures_state(
    tmp_path: Path, flights: dict[str, tuple[str, str, int]], codes: list[str], val: set[str]
) -> None:
    dataset = api.read_dataset(flown(tmp_path / "data", flights), api.Reading(val_share=0.2))
    assert {name for name, splits in held_splits(dataset).items() if splits == {"val"}} == val
    assert [p.code for p in dataset.problems if p.where == "--val-share"] == codes


@pytest.mark.parametrize(
    ("flights", "split", "found"),
    [
        ({"a": ("s", "2024-05-01", 3)}, "val", "3 picture(s) in val already"),
        ({"a": ("s", "2024-05-01", 3)}, "test", "no picture in train"),
        ({"a": ("s", "2024-05-01", 3)}, "train", "all 3 training pictures are of s"),
        (
            {"a": ("s", "2024-05-01", 3), "b": ("", "", 2)},
            "train",
            "2 of 5 training pictures have neither a sequence nor a date",
        ),
    ],
)
def test_data_that_cannot_be_divided_are_refused(
    tmp_path: Path, flights: dict[str, tuple[str, str, int]], split: str, found: str
) -> None:
    root = flown(tmp_path / "data", flights, split)
    ended = run("generate", "hit-uav-drone", "--data", root, "--out", tmp_path / "out", "--val-share", 0.2)
    assert ended.exit_code == 2 and found in " ".join(ended.stderr.split()) and not (tmp_path / "out").exists()


def test_a_run_with_a_val_split_is_resumed_and_judged_as_made(tmp_path: Path) -> None:
    root, flat = flown(tmp_path / "data", THREE_DAYS), api.Execution(renderer="flat", in_process=True)
    settings, reading = ["output.formats=[coco]"], api.Reading(val_share=0.2)
    report = api.generate("hit-uav-drone", root, tmp_path / "run", settings=settings, reading=reading, execution=flat)
    assert report.ok and report.counts["images_per_split"] == {"train": 32, "val": 8}
    assert len({i.split for i in api.read_dataset(tmp_path / "run").images}) == 2
    api.exclude(tmp_path / "run", ["val/d-0_c0"])
    assert api.rerender(tmp_path / "run", "val/d-1_c1", tmp_path / "again.png").is_file()
    with pytest.raises(ArgumentError, match="none of the 4 frames is in val"):
        api.generate(
            "hit-uav-drone", root, tmp_path / "few", limit=2, settings=settings, reading=reading, execution=flat
        )


def test_hit_uav_without_neighbours(real_data: Path, tmp_path: Path) -> None:
    report = api.split(
        real_data / "hit-uav",
        tmp_path / "out",
        api.SplitRule(by="gap"),
        reading=api.Reading(form="rotate_json"),
        lists=True,
    )
    assert report.before[0].near == 403
    assert [one.near for one in report.after] == [0, 0, 0]
    for counts in (report.images, *report.objects.values()):
        for share, wanted in zip(report.shares(counts).values(), (0.7, 0.1, 0.2), strict=True):
            assert abs(share - wanted) < 0.02
