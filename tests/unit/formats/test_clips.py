"""Clips of pan-tilt cameras: texts of boxes, fields of view, and drones painted out of their frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont

from infrablend import api
from infrablend.core.dataset import Dataset
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.pictures.images import load_background
from infrablend.formats.read_write import Reading
from infrablend.imaging.paint_out import Shown, find_written, paint_out
from tests.run_files import records
from tests.samples import SAMPLES
from tests.videos import write_video

SIZE_WH = (160, 128)
SEPARATORS = (",", " ", "\t", ", ", ";")


def scene(seed: int = 1) -> np.ndarray:
    """Return a wide view: trees below a sky, with the noise of a camera."""
    rng = np.random.default_rng(seed)
    picture = np.full((128, 480), 70.0)
    picture[64:] = 140 + sum(np.kron(rng.normal(0, 15, (64 // n, 480 // n)), np.ones((n, n))) for n in (4, 8, 16, 32))
    return np.clip(picture + rng.normal(0, 2, picture.shape), 20, 230).astype(np.uint8)


def frame(k: int, drone_xy: tuple[int, int] | None, pan: int = 2, text: str = "AZ 17.54") -> np.ndarray:
    """Return the view after a pan of `pan` px per frame, with a drone of 8x4 px and text."""
    view = scene()[:, pan * k : pan * k + 160].copy()
    if drone_xy is not None:
        x, y = drone_xy
        view[y : y + 4, x : x + 8] = 235
    picture = Image.fromarray(view)
    ImageDraw.Draw(picture).text((6, 6), text, fill=235, font=ImageFont.load_default(14))
    return np.array(picture)


def write_clip(
    root: Path, name: str = "4.avi", frames: int = 60, between: str = ",", pan: int = 2, rows: str = "", **lines: str
) -> Path:
    """Write a clip whose drone stays in the middle of the picture; `lines` replace those of some frames (`at12=`)."""
    root.mkdir(parents=True, exist_ok=True)
    write_video(
        root / name,
        [frame(k, (76, 90), pan) for k in range(frames)],
        codec="ffv1" if name.endswith("avi") else "libx264",
    )
    text = [between.join(("76", "90", "8", "4"))] * frames
    for key, line in lines.items():
        text[int(key.removeprefix("at"))] = line
    (root / name).with_suffix(".txt").write_text("\n".join(text) + "\n")
    if rows:
        (root / "osd.csv").write_text("file,field_of_view_deg,elevation_at_start_deg\n" + rows)
    return root


def read(root: Path, **options: str) -> Dataset:
    return dataset_folder.read(root, Reading(options={"every": "20", **options}))


def codes(dataset: Dataset) -> list[str]:
    return sorted(p.code for p in dataset.problems)


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.array(picture).astype(int)


@pytest.mark.parametrize(("suffix", "between"), [("mp4", ","), ("mkv", ","), *(("avi", b) for b in SEPARATORS)])
def test_clips_are_read(tmp_path: Path, suffix: str, between: str) -> None:
    d = read(write_clip(tmp_path, f"4.{suffix}", 41, between, rows=f"4.{suffix},0.5,3.6\n"))
    assert d.format == "anti-uav" and d.problems == ()
    assert [(i.capture.sequence, i.capture.frame, i.capture.hfov_deg, i.capture.pitch_deg) for i in d.images] == [
        ("4", k, 0.5, -3.6) for k in (0, 20, 40)
    ]
    assert [i.capture.time_s for i in d.images] == [0, 2, 4]  # ten frames per second
    assert {(i.size_wh, i.split, i.instances[0].track_id, i.instances[0].category) for i in d.images} == {
        (SIZE_WH, "train", 0, "drone")
    }
    assert d.images[0].instances[0].box_xyxy.tolist() == [76, 90, 84, 94]


def test_folders_of_splits_divide_clips(tmp_path: Path) -> None:
    write_clip(write_clip(tmp_path / "train", frames=2).parent / "test", "7.avi", 2)
    assert [(i.capture.sequence, i.split) for i in read(tmp_path).images] == [("4", "train"), ("7", "test")]


@pytest.mark.parametrize("line", ["", "0,0,0,0", "nan,nan,nan,nan", "NaN NaN NaN NaN", "0 0 0 0"])
def test_frames_without_a_drone(tmp_path: Path, line: str) -> None:
    d = read(write_clip(tmp_path, frames=41, at20=line))
    assert [len(i.instances) for i in d.images] == [1, 0, 1] and d.problems == ()
    assert d.notes["rows"]["absent"] == 1


@pytest.mark.parametrize(
    ("line", "code", "kept"),
    [
        ("1,2,3", "annotation-layout", 2),
        ("a b c d", "annotation-layout", 2),
        ("5,5,nan,4", "box-not-finite", 2),
        ("500,90,8,4", "box-outside", 2),
        ("156,90,8,4", "box-clipped", 3),
        ("76,90,1,1", "", 3),
    ],
)  # fmt: skip
def test_lines_that_are_no_box_are_said(tmp_path: Path, line: str, code: str, kept: int) -> None:
    root = write_clip(tmp_path, frames=41, at20=line)
    for drones in ("keep", "paint-out"):
        d = read(root, drones=drones)
        # A warning of painting by guess may be added.
        assert code in codes(d) or not code
        rows = d.notes["rows"]
        # A frame whose drone nobody knows the place of is no background without drones.
        pictures = kept if drones == "paint-out" else 3
        assert (len(d.images), rows["objects"], rows["read"]) == (pictures, 3, kept)


@pytest.mark.parametrize("extra", [-10, 10])
def test_other_numbers_of_lines_and_frames_are_counted(tmp_path: Path, extra: int) -> None:
    root = write_clip(tmp_path, frames=50)
    lines = (root / "4.txt").read_text().splitlines()
    (root / "4.txt").write_text("\n".join(lines[:extra] if extra < 0 else [*lines, *lines[:extra]]))
    d = read(root)
    assert codes(d) == ["annotation-length"] and len(d.images) == (2 if extra < 0 else 3)
    assert (d.notes["rows"]["unlabelled"], d.notes["rows"]["without_picture"]) == ((10, 0) if extra < 0 else (0, 10))


@pytest.mark.parametrize(
    ("rows", "expected", "known"),
    [
        ("4.avi,0.73,3.6\n9.avi,1,2\n", ["table-unused"], True),
        ("9.avi,1,2\n", ["table-unused", "table-value"], False),
        ("4.avi,wide,3.6\n", ["table-value", "table-value"], False),
        ("4.avi,0.0127,0.06\n", ["table-value", "table-value"], False),  # radians
        ("4.avi,0.73,360\n", ["table-value", "table-value"], False),
        ("4.avi,0.73,3.6,5\n", ["table-value", "table-value"], False),
        ("4.avi,0.73,3.6\n4.avi,1.24,3.6\n", ["table-duplicate"], True),
        ("4,0.73,3.6\n", [], True),
        ('4.avi,"0,73"\n', ["table-value", "table-value"], False),
    ],
)  # fmt: skip
def test_bad_rows_of_views_are_said(tmp_path: Path, rows: str, expected: list[str], known: bool) -> None:
    d = read(write_clip(tmp_path, frames=2, rows=rows))
    assert codes(d) == expected and len(d.images) == 1
    assert d.images[0].capture.hfov_deg == (0.73 if known else None)


def test_a_table_without_its_columns_is_said(tmp_path: Path) -> None:
    root = write_clip(tmp_path, frames=2)
    (root / "osd.csv").write_text("name,angle\n4.avi,1\n")
    assert codes(read(root)) == ["table-columns"]


def test_videos_with_other_texts_are_no_clips(tmp_path: Path) -> None:
    root = write_clip(tmp_path, frames=2)
    for text in ("0 0.5 0.5 0.1 0.1\n", "Recorded on a tower.\n", ""):
        (root / "4.txt").write_text(text)
        d = dataset_folder.read(root)
        assert d.format == "videos" and codes(d) == ["label-unread"]


def test_a_clip_that_does_not_decode_costs_only_itself(tmp_path: Path) -> None:
    root = write_clip(write_clip(tmp_path, frames=2), "7.avi", 2)
    (root / "4.avi").write_bytes(b"no video")
    d = read(root, drones="paint-out")
    assert [i.capture.sequence for i in d.images] == ["7"] and "video-unreadable" in codes(d)


def test_a_clip_that_ends_early_is_said_once(tmp_path: Path) -> None:
    root = write_clip(tmp_path)
    whole = (root / "4.avi").read_bytes()
    (root / "4.avi").write_bytes(whole[: len(whole) // 2])
    d = read(root, drones="paint-out")
    assert 1 <= len(d.images) < 3 and all(i.instances == () for i in d.images)
    found = codes(d)
    assert "video-truncated" in found and "annotation-length" in found and len({*found}) == len(found)


# -- painted out -------------------------------------------------------------------------------------------------


def test_drones_are_painted_out_of_moving_views(tmp_path: Path) -> None:
    root = write_clip(tmp_path)
    kept, painted = read(root), read(root, drones="paint-out")
    assert [i.instances for i in painted.images] == [()] * 3 and painted.problems == ()
    assert painted.notes["rows"]["painted"] == 3
    assert [(i.id, i.capture, i.size_wh) for i in painted.images] == [(i.id, i.capture, i.size_wh) for i in kept.images]
    for was, now in zip(kept.images, painted.images, strict=True):
        before, after = pixels(was.path), pixels(now.path)
        truth = np.rint((scene()[:, 2 * was.capture.frame :][:, :160].astype(int) - 16) * 255 / 219)
        changed = np.argwhere(before != after)
        assert changed.min(axis=0).tolist() >= [80, 60] and changed.max(axis=0).tolist() <= [104, 100]
        assert np.abs(after - truth)[90:94, 76:84].mean() < 4  # the noise of two frames
        # As much grain as there was.
        assert after[88:96, 74:86].std() > 0.8 * truth[88:96, 74:86].std()


def test_keeping_does_not_touch_the_frames(tmp_path: Path) -> None:
    root = write_clip(tmp_path)
    first = read(root)
    bytes_of = [i.path.read_bytes() for i in first.images]
    read(root, drones="paint-out")
    again = read(root, drones="keep")
    assert [i.path for i in again.images] == [i.path for i in first.images]
    assert [i.path.read_bytes() for i in again.images] == bytes_of


def test_painted_frames_do_not_depend_on_what_was_asked_for_before(tmp_path: Path, monkeypatch: Any) -> None:
    root = write_clip(tmp_path)
    made = {}
    for name, steps in (("a", ("20",)), ("b", ("30", "20"))):
        monkeypatch.setattr("infrablend.formats.pictures.derived.FOLDER", str(tmp_path / "cache" / name))
        for every in steps:
            d = read(root, drones="paint-out", every=every)
        made[name] = [i.path.read_bytes() for i in d.images]
        assert read(root, drones="paint-out").problems == d.problems
    assert made["a"] == made["b"]


def test_drones_that_stay_are_painted_from_around_them(tmp_path: Path) -> None:
    d = read(write_clip(tmp_path, pan=0), drones="paint-out")
    assert [i.instances for i in d.images] == [()] * 3 and codes(d) == ["painted-by-guess"]
    assert d.notes["rows"]["painted_by_guess"] == 3
    assert pixels(d.images[0].path)[88:96, 74:86].max() < 240


def test_text_over_a_drone_stays(tmp_path: Path) -> None:
    frames = [frame(k, (20, 8)) for k in range(60)]
    shown = [Shown(f, np.array([20.0, 8, 28, 12])) for f in frames]
    elsewhere = [Shown(frame(k, (90, 40)), np.array([90.0, 40, 98, 44])) for k in range(0, 60, 6)]
    written = find_written([*shown[:4], *elsewhere])
    assert written.strokes.any() and written.marked[written.strokes].all()
    result, _ = paint_out(shown[30], [(6 * k - 30, e) for k, e in enumerate(elsewhere) if k != 5], written)
    assert (result == frames[30])[written.strokes].all()
    assert np.abs(result.astype(int) - frame(30, None))[~written.strokes].mean() < 1


@pytest.mark.parametrize(
    ("kind", "shape"), [(np.uint8, (128, 160)), (np.uint16, (128, 160)), (np.uint8, (128, 160, 3))]
)
def test_noise_alone_is_painted_by_guess(kind: type, shape: tuple[int, ...]) -> None:
    rng, unit = np.random.default_rng(0), 257 if kind == np.uint16 else 1
    frames = [(rng.normal(100, 8, shape).clip(0, 255) * unit).astype(kind) for _ in range(8)]
    box = np.array([76.0, 60, 84, 64])
    frames[0][60:64, 76:84] = 255 * unit
    others = [Shown(f, box) for f in frames[1:]]
    result, how = paint_out(Shown(frames[0], box), list(enumerate(others, 1)), find_written(others))
    assert how == "guessed" and result.dtype == kind and result.shape == shape
    assert 0.6 < result[56:68, 72:88].std() / (8 * unit) < 1.4


@pytest.mark.parametrize("box", [(0, 0, 1, 1), (159, 127, 160, 128), (0, 60, 160, 70), (80, 60, 81, 61)])
def test_any_box_can_be_painted(box: tuple[int, ...]) -> None:
    shown = [Shown(frame(k, None), np.array(box, float)) for k in range(0, 50, 10)]
    result, _ = paint_out(shown[0], list(enumerate(shown[1:], 1)), find_written(shown))
    assert result.shape == shown[0].pixels.shape


def test_folders_of_pictures_keep_their_drones(tmp_path: Path) -> None:
    d = dataset_folder.read(SAMPLES["anti-uav"](tmp_path), Reading(options={"drones": "paint-out"}))
    assert sum(len(i.instances) for i in d.images) == 3 and codes(d) == ["not-painted"] * 2


def test_drones_is_one_of_two_words(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="not allowed"):
        read(write_clip(tmp_path, frames=2), drones="remove")


# -- with a recipe -----------------------------------------------------------------------------------------------


def test_the_recipe_sees_the_clip_through_its_own_lens(tmp_path: Path) -> None:
    """The example of docs/how_to/narrow_views.md."""
    data = write_clip(tmp_path / "data", frames=21, rows="4.avi,0.5,3.6\n")
    run = api.generate(
        "drone-sky", data, tmp_path / "run",
        reading=api.Reading(options={"every": "20", "drones": "paint-out"}),
        settings=["placement.min_contrast=off", "configurations=10"],
        execution=api.Execution(renderer="flat", in_process=True),
    )  # fmt: skip
    assert run is not None
    found = list(records(tmp_path / "run"))
    assert sum(r.scene.draws["rejected"].get("on_text", 0) for r in found) >= 1
    assert sum(len(r.inserted) for r in found) >= 1
    for record in found:
        camera = record.scene.camera
        across = 2 * np.degrees(np.arctan(camera.sensor_width_mm / 2 / camera.focal_length_mm))
        assert across == pytest.approx(0.5) and np.degrees(camera.pitch_rad) == pytest.approx(-3.6)
        for label in record.inserted:
            x0, y0, x1, y1 = label.box_xyxy
            assert 3 <= max(x1 - x0, y1 - y0) <= 131


def test_a_clip_in_colours_of_a_palette(tmp_path: Path) -> None:
    root = write_clip(tmp_path)
    write_video(root / "4.avi", [frame(k, (76, 90)) for k in range(60)], codec="ffv1", colour=40)
    d = read(root, drones="paint-out")
    assert [i.instances for i in d.images] == [()] * 3 and d.notes["rows"]["painted"] == 3
    assert pixels(d.images[0].path).shape == (*SIZE_WH[::-1], 3)
    assert "image-colour" in [p.code for p in load_background(d.images[0].path).problems]


def test_a_clip_of_noise_alone(tmp_path: Path) -> None:
    root, rng = write_clip(tmp_path), np.random.default_rng(0)
    noise = [rng.integers(20, 230, SIZE_WH[::-1]).astype(np.uint8) for _ in range(60)]
    write_video(root / "4.avi", noise, codec="ffv1")
    d = read(root, drones="paint-out")
    assert len(d.images) == d.notes["rows"]["painted_by_guess"] == 3 and codes(d) == ["painted-by-guess"]


def test_a_drone_without_a_usable_box_is_no_background_without_one(tmp_path: Path) -> None:
    root = write_clip(tmp_path / "clips", rows="4.avi,1.2,3\n", at20="76,90,-8,4")
    kept, painted = read(root), read(root, drones="paint-out")
    assert [i.capture.frame for i in kept.images] == [0, 20, 40]
    assert [i.capture.frame for i in painted.images] == [0, 40] and not any(i.instances for i in painted.images)
    (said,) = [p for p in painted.problems if p.code == "not-painted"]
    assert said.found.startswith("1 frame(s)")
