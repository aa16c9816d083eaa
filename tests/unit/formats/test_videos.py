"""Videos without labels as datasets: one file, or a folder of clips."""

from __future__ import annotations

import shutil
import tracemalloc
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.dataset import Dataset
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.pictures import derived
from infrablend.formats.pictures.video import Video
from infrablend.formats.pictures.video import write_video as write_grey_video
from infrablend.formats.read_write import Reading
from tests.samples import picture
from tests.videos import bracketed, level, write_srt, write_video

av = pytest.importorskip("av")


def read(path: Path, every: int = 1, **reading: object) -> Dataset:
    return dataset_folder.read(path, Reading(options={"every": str(every)}, **reading))  # type: ignore[arg-type]


def codes(dataset: Dataset) -> list[str]:
    return sorted(p.code for p in dataset.problems)


def write_two_sizes(path: Path, first: int, second: int) -> Path:
    """Write a video whose later frames are larger."""
    with av.open(str(path), "w") as out:
        stream = out.add_stream("mjpeg", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        for k in range(first + second):
            width, height = (64, 48) if k < first else (96, 80)
            coder = av.CodecContext.create("mjpeg", "w")
            coder.width, coder.height, coder.pix_fmt, coder.time_base = width, height, "yuvj420p", Fraction(1, 10)
            frame = av.VideoFrame.from_ndarray(np.full((height, width, 3), 40, np.uint8)).reformat(format="yuvj420p")
            frame.pts = k
            for packet in coder.encode(frame):
                packet.stream, packet.time_base, packet.pts, packet.dts = stream, Fraction(1, 10), k, k
                out.mux(packet)
    return path


# -- what is read --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".mp4", ".avi", ".MKV"])
def test_a_video_is_a_sequence(tmp_path: Path, suffix: str) -> None:
    d = read(write_video(tmp_path / f"a{suffix}", frames=7), 3)
    assert (d.format, d.problems, d.categories) == ("videos", (), ())
    assert [(i.capture.sequence, i.capture.frame, i.capture.time_s) for i in d.images] == [
        ("a", 0, 0.0), ("a", 3, 0.3), ("a", 6, 0.6),
    ]  # fmt: skip
    assert {(i.split, i.size_wh, i.instances, i.capture.captured) for i in d.images} == {("train", (64, 48), (), None)}
    for image in d.images:
        with Image.open(image.path) as frame:
            assert frame.getextrema() == (level(image.capture.frame or 0),) * 2
    assert [p.name for p in tmp_path.iterdir()] == [f"a{suffix}"]


def test_every_thirtieth_frame_is_read_by_default(tmp_path: Path) -> None:
    d = dataset_folder.read(write_video(tmp_path / "a.mp4", frames=61))
    assert [i.capture.frame for i in d.images] == [0, 30, 60] and d.notes["every"] == 30


def test_clips_of_a_folder_have_splits_and_names_of_their_own(tmp_path: Path) -> None:
    for name in ("train/a.mp4", "test/a.mp4", "night/b.avi", "val/x/c.mp4"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        write_video(tmp_path / name, frames=2)
    d = read(tmp_path)
    assert d.problems == ()
    assert {(i.split, i.capture.sequence) for i in d.images} == {
        ("train", "train_a"), ("test", "test_a"), ("train", "b"), ("val", "c"),
    }  # fmt: skip
    assert {i.split for i in read(tmp_path, splits=("val",)).images} == {"val"}


def test_frames_are_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_video(tmp_path / "a.mp4", frames=4)
    paths = [i.path for i in read(path).images]
    monkeypatch.setattr(derived, "Video", None)
    assert [i.path for i in read(path).images] == paths


def test_a_table_states_what_the_clips_do_not(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", frames=2)
    (tmp_path / "metadata.csv").write_text("sequence,pitch_deg,hfov_deg\na,30,45\n")
    d = read(tmp_path)
    assert d.problems == () and {(i.capture.pitch_deg, i.capture.hfov_deg) for i in d.images} == {(30.0, 45.0)}


def test_subtitles_state_pitch_height_and_time(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", frames=20, created="2020-01-01T00:00:00Z")
    write_srt(tmp_path / "a.SRT", bracketed, blocks=20)
    d = read(path, 10)
    assert d.problems == () and d.notes["rows"]["with_telemetry"] == 2
    assert [(i.capture.pitch_deg, i.capture.altitude_m, i.capture.altitude_from) for i in d.images] == [
        (60.0, 10.0, "take-off"), (60.0, 11.0, "take-off"),
    ]  # fmt: skip
    assert [i.capture.captured for i in d.images] == ["2024-05-01T12:00:00.000", "2024-05-01T12:00:01.000"]
    assert {i.capture.time_of_day for i in d.images} == {"day"}


def test_the_container_states_the_time_where_nothing_else_does(tmp_path: Path) -> None:
    d = read(write_video(tmp_path / "a.mp4", frames=16, created="2024-05-01T22:00:00Z"), 15)
    assert [i.capture.captured for i in d.images] == ["2024-05-01T22:00:00.000+00:00", "2024-05-01T22:00:01.500+00:00"]


def test_a_labelled_clip_stays_with_its_format(tmp_path: Path) -> None:
    for name in ("4.avi", "7.avi", "9.avi"):
        write_video(tmp_path / name, frames=3, codec="mpeg4")
    for name in ("4.txt", "7.txt"):
        (tmp_path / name).write_text("1 2 9 8\n" * 3)
    (tmp_path / "osd.csv").write_text("file,field_of_view_deg,elevation_at_start_deg\n4.avi,1.2,3\n7.avi,1.3,4\n")
    one = read(tmp_path / "4.avi")
    assert (one.format, one.problems) == ("anti-uav", ())
    assert {(i.capture.sequence, i.capture.hfov_deg, len(i.instances)) for i in one.images} == {("4", 1.2, 1)}
    whole = read(tmp_path)
    assert whole.format == "anti-uav" and codes(whole) == ["label-missing"]
    assert "9.avi" in whole.problems[0].found and read(tmp_path / "9.avi").format == "videos"
    assert codes(read(tmp_path / "4.avi", format="videos")) == ["label-unread"]


def test_pictures_stay_a_folder_and_videos_can_be_asked_for(tmp_path: Path) -> None:
    picture(tmp_path / "p.png", 1)
    write_video(tmp_path / "a.mp4", frames=2)
    d = dataset_folder.read(tmp_path)
    assert d.format == "folder" and codes(d) == ["video-not-pictures"]
    assert {i.capture.sequence for i in read(tmp_path, format="videos").images} == {"a"}


def test_a_single_video_is_no_folder_of_another_format(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", frames=2)
    with pytest.raises(DatasetError, match=r"a video; expected a folder in the format coco\. Leave --format out"):
        dataset_folder.read(path, Reading(format="coco"))


def test_objects_are_inserted_into_a_video_and_rendered_again(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", frames=2)
    run = tmp_path / "run"
    settings = ["camera.pitch={fixed_deg: 60}", "configurations=1", "output.formats=[coco]"]
    execution = api.Execution(renderer="flat", in_process=True)
    reading = api.Reading(options={"every": "1"})
    api.generate("hit-uav-drone", path, run, execution=execution, settings=settings, reading=reading)
    written = dataset_folder.read(run)
    assert [(i.capture.sequence, i.capture.frame) for i in written.images] == [("a", 0), ("a", 1)]
    again = api.rerender(run, "train/a_000001_c0", tmp_path / "again.png")
    assert again.read_bytes() == (run / "images" / "train" / "a_000001_c0.png").read_bytes()
    shutil.rmtree(next(iter({i.path.parent for i in read(path).images})))
    with pytest.raises(DatasetError, match="decodes them again"):
        api.rerender(run, "train/a_000001_c0", tmp_path / "again.png", overwrite=True)


# -- what is wrong with them -----------------------------------------------------------------------------------------


def test_a_clip_of_one_frame_is_read(tmp_path: Path) -> None:
    d = read(write_video(tmp_path / "a.mp4", frames=1))
    assert d.problems == () and len(d.images) == 1


def test_a_broken_clip_costs_only_itself(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", frames=2)
    (tmp_path / "b.mp4").write_bytes(b"no video")
    (tmp_path / "c.avi").write_bytes(b"")
    d = read(tmp_path)
    assert {i.capture.sequence for i in d.images} == {"a"} and d.notes["rows"]["unread"] == 2
    assert [(p.where, p.code) for p in d.problems] == [("b.mp4", "video-unreadable"), ("c.avi", "video-unreadable")]
    with pytest.raises(DatasetError, match="no picture to read"):
        read(tmp_path / "b.mp4")


def test_a_truncated_clip_is_read_as_far_as_it_goes_and_said_each_time(tmp_path: Path) -> None:
    noise = [np.random.default_rng(k).integers(16, 236, (48, 64), np.uint8) for k in range(20)]
    path = write_video(tmp_path / "a.avi", noise, codec="ffv1")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    first = read(path)
    assert 0 < len(first.images) < 20 and "video-truncated" in codes(first)
    again = read(path)
    assert again.problems == first.problems and len(again.images) == len(first.images)


def test_damaged_frames_are_counted_each_time(tmp_path: Path) -> None:
    noise = [np.random.default_rng(k).integers(16, 236, (48, 64), np.uint8) for k in range(20)]
    path = write_video(tmp_path / "a.mp4", noise)
    data = bytearray(path.read_bytes())
    middle = (data.index(b"mdat") + len(data)) // 2
    data[middle : middle + 9000] = bytes(9000)
    path.write_bytes(data)
    first = read(path)
    lost = first.notes["rows"]["lost"]
    assert lost > 0 and lost + len(first.images) == 20
    assert codes(first) == ["frames-lost", "video-damaged"] and read(path).problems == first.problems


def test_frames_of_another_size_are_counted(tmp_path: Path) -> None:
    d = read(write_two_sizes(tmp_path / "a.mkv", 3, 2))
    assert len(d.images) == 3 and codes(d) == ["frames-lost", "image-size"]
    assert "2 frame(s) of another size than 64x48" in next(p.found for p in d.problems if p.code == "image-size")


def test_the_times_of_a_varying_rate_are_kept(tmp_path: Path) -> None:
    d = read(write_video(tmp_path / "a.mkv", frames=4, times_ms=[0, 40, 900, 2000]))
    assert codes(d) == ["video-rate"]
    assert [i.capture.time_s for i in d.images] == [0.0, 0.04, 0.9, 2.0]


def test_colours_of_a_palette_are_said_once_per_clip(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4"):
        write_video(tmp_path / name, frames=3, colour=40 if name == "a.mp4" else 0)
    d = read(tmp_path)
    (problem,) = d.problems
    assert (problem.where, problem.code, problem.severity) == ("a.mp4", "image-colour", "warning")
    assert problem.found.startswith("3 of 3 frame(s) in colour") and "palette" in problem.found
    assert d.notes["rows"]["colour"] == 3


@pytest.mark.parametrize("blocks", [200, 5])
def test_subtitles_of_another_length_are_said_and_cost_no_frame(tmp_path: Path, blocks: int) -> None:
    write_video(tmp_path / "a.mp4", frames=50)
    write_srt(tmp_path / "a.SRT", lambda k, s: bracketed(k, s).replace("FrameCnt", "Count"), blocks=blocks)
    d = read(tmp_path, 10)
    (problem,) = d.problems
    expected = ("log-other-flight", 0) if blocks == 200 else ("log-mismatch", 1)
    assert (problem.code, sum(i.capture.pitch_deg is not None for i in d.images)) == expected
    assert (problem.where, problem.severity, len(d.images)) == ("a.SRT", "warning", 5)


def test_subtitles_without_telemetry_cost_no_frame(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", frames=2)
    (tmp_path / "a.srt").write_text("1\n00:00:00,000 --> 00:00:01,000\nHello\n")
    d = read(tmp_path)
    assert len(d.images) == 2 and [(p.code, p.severity) for p in d.problems] == [("log-layout", "warning")]


def test_previews_and_links_out_of_the_folder_are_left_out(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    write_video(data / "a.mp4", frames=2)
    shutil.copy(data / "a.mp4", data / "a.LRF")
    (data / "b.mp4").symlink_to(write_video(tmp_path / "b.mp4", frames=2))
    d = read(data)
    assert {i.capture.sequence for i in d.images} == {"a"} and codes(d) == ["name-climbs", "video-preview"]


@pytest.mark.parametrize("name", ["a.json", "a_LABELS.mat", "a.txt"])
def test_a_file_that_may_hold_labels_is_named(tmp_path: Path, name: str) -> None:
    write_video(tmp_path / "a.mp4", frames=2)
    write_video(tmp_path / "a2.mp4", frames=2)
    (tmp_path / name).write_text('{"frames": 2}')
    named = [p for p in read(tmp_path).problems if p.where == "a.mp4"]
    assert [p.code for p in named] == ["label-unread"] and name in named[0].found


def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    def peak(frames: int) -> int:
        pictures = [np.full((480, 640), 16 + k, np.uint8) for k in range(frames)]
        path = write_video(tmp_path / f"{frames}.mp4", pictures, colour=40)
        tracemalloc.start()
        assert len(read(path).images) == frames
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    assert peak(24) < 1.5 * peak(4)


def test_a_written_video_shows_its_pictures_and_is_the_same_again(tmp_path: Path) -> None:
    rows = np.linspace(0, 255, 48)[:, None]
    pictures = [np.clip(np.broadcast_to(rows, (48, 65)) + 4 * k, 0, 255).astype(np.uint8) for k in range(6)]
    for name in ("a.mp4", "b.mp4"):
        write_grey_video(tmp_path / name, pictures, 25.0)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    video = Video(tmp_path / "a.mp4")
    assert video.size_wh == (64, 48)  # 4:2:0 has no odd width
    np.testing.assert_allclose(np.diff(video.timeline.times_s), 0.04, atol=1e-4)
    with video:
        for frame, grey in zip(video.frames(), pictures, strict=True):
            assert np.abs(frame.pixels.astype(float) - grey[:, :64]).mean() < 3
    deep = [1000 + 10 * p.astype(np.uint16) for p in pictures]
    write_grey_video(tmp_path / "c.mp4", deep, 25.0)
    with Video(tmp_path / "c.mp4") as video:
        assert np.ptp(next(iter(video.frames())).pixels) > 200
