"""`infrablend frames`: pictures without loss, telemetry at the right times, clear reports."""

from __future__ import annotations

import csv
import json
import shutil
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.pipeline.plans.run_request import RunRequest
from infrablend.pipeline.runs.generate import plan_request
from tests.command_line import run, said
from tests.videos import FRAMES, RATE, SIZE_WH, av, bracketed, level, write_srt, write_video

done = partial(said, "frames")


def rows(out: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((out / "metadata.csv").read_text("utf-8").splitlines()))


def flight(folder: Path, name: str = "DJI_0001") -> Path:
    write_srt(folder / f"{name}.SRT", bracketed)
    return write_video(folder / f"{name}.MP4")


def test_frames_and_telemetry_agree(tmp_path: Path) -> None:
    out = tmp_path / "out"
    text = done(flight(tmp_path), "--every", "1.5s", "--out", out, "--time", "day", "--hfov", "48.5")
    assert "matched by frame numbers" in text and "missing" not in text and "no " not in text
    table = rows(out)
    assert [(int(r["frame"]), r["time_s"]) for r in table] == [(0, "0"), (15, "1.5"), (30, "3"), (45, "4.5")]
    assert [i.capture.time_s for i in dataset_folder.read(out).images] == [0, 1.5, 3, 4.5]
    assert [float(r["altitude_m"]) for r in table] == [10.0, 11.5, 13.0, 14.5]
    assert {r["pitch_deg"] for r in table} == {"60.000"} and {r["time_of_day"] for r in table} == {"day"}
    assert {r["hfov_deg"] for r in table} == {"48.5"}
    assert table[1]["captured"] == "2024-05-01T12:00:01.500"
    for row in table:
        with Image.open(out / row["file"]) as picture:
            assert (picture.mode, picture.size) == ("L", SIZE_WH)
            assert picture.getextrema() == (level(int(row["frame"])),) * 2
    facts = json.loads(run("inspect", out, "--json").output)
    assert facts["sequences"] == {"DJI_0001": 4}
    assert facts["coverage"] and not facts["problems"]


def test_pictures_are_those_of_the_video(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(16, 236, SIZE_WH[::-1], np.uint8) for _ in range(3)]
    out = tmp_path / "out"
    done(write_video(tmp_path / "noise.mp4", pictures), "--every", "1f", "--out", out)
    for k, luminance in enumerate(pictures):
        with Image.open(out / f"noise/noise_{k:06d}.png") as picture:
            assert (np.array(picture) == np.rint((luminance - 16.0) * 255 / 219)).all()


def test_several_videos_are_sequences_for_split(tmp_path: Path) -> None:
    videos = [flight(tmp_path, f"DJI_000{k}") for k in range(1, 4)]
    out, new = tmp_path / "out", tmp_path / "split"
    done(*videos, "--every", "20f", "--out", out, "--sequence", "north,south,west")
    said("split", out, new, "--by", "sequence", "--to", "coco", "--shares", "0.4,0.3,0.3")
    record = json.loads((new / "split.json").read_text("utf-8"))
    assert sorted(record["groups"]) == ["north", "south", "west"]
    assert sorted(record["groups"].values()) == ["test", "train", "val"]


def test_the_same_arguments_give_the_same_bytes_and_overwrite_replaces(tmp_path: Path) -> None:
    video = flight(tmp_path)
    done(video, "--every", "1s", "--out", tmp_path / "a")
    assert "not empty" in done(video, "--every", "1s", "--out", tmp_path / "a", code=2)
    done(video, "--every", "2s", "--out", tmp_path / "b")
    done(video, "--every", "1s", "--out", tmp_path / "b", "--overwrite")
    found = [{p.relative_to(d): p.read_bytes() for p in sorted(d.rglob("*")) if p.is_file()}
             for d in (tmp_path / "a", tmp_path / "b")]  # fmt: skip
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("options", "numbers"),
    [
        (["--every", "20f"], [0, 20, 40]),
        (["--every", "20 frames", "--start", "0:01"], [10, 30]),
        (["--every", "1s", "--start", "1.95", "--end", "00:04.0s"], [20, 30, 40]),
        (["--every", "0.001s", "--end", "0.35"], [0, 1, 2, 3]),
        (["--every", "1000000000s"], [0]),
    ],
)
def test_steps_and_ends(tmp_path: Path, options: list[str], numbers: list[int]) -> None:
    done(flight(tmp_path), *options, "--out", tmp_path / "out")
    assert [int(r["frame"]) for r in rows(tmp_path / "out")] == numbers


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--every", "2"], "expected a step such as 2s"),
        (["--every", "0s"], "expected a step above 0"),
        (["--every", "1.5f"], "expected a step such as 2s"),
        (["--start", "x"], "expected seconds such as 12.5"),
        (["--start", "3", "--end", "2"], "is before start"),
        (["--start", "60"], "no frame to extract"),
        (["--sequence", "a,b"], "expected one for each of 1 video"),
        (["--log", "x.csv", "--no-log"], "exclude each other"),
        (["--log", "missing.csv"], "cannot be read"),
    ],
)
def test_wrong_options_write_nothing(tmp_path: Path, options: list[str], message: str) -> None:
    assert message in done(flight(tmp_path), "--out", tmp_path / "out", *options, code=2)
    assert not (tmp_path / "out").exists()


def test_the_sun_tells_day_from_night(tmp_path: Path) -> None:
    video = flight(tmp_path)
    done(video, "--every", "2s", "--out", tmp_path / "day")
    assert {r["time_of_day"] for r in rows(tmp_path / "day")} == {"day"}
    log = tmp_path / "DJI_0001.SRT"
    log.write_text(log.read_text("utf-8").replace("2024-05-01 12:", "2024-05-01 00:"), "utf-8")
    done(video, "--every", "2s", "--out", tmp_path / "night")
    assert {r["time_of_day"] for r in rows(tmp_path / "night")} == {"night"}


def test_heights_of_a_log_are_measured_ones(tmp_path: Path) -> None:
    done(flight(tmp_path), "--every", "2s", "--out", tmp_path / "out")
    images = dataset_folder.read(tmp_path / "out").images
    assert {i.capture.altitude_from for i in images} == {"take-off"}
    table = tmp_path / "out" / "metadata.csv"
    table.write_text(table.read_text("utf-8").replace("take-off", "guess", 1), "utf-8")
    assert "table-value" in {p.code for p in dataset_folder.read(tmp_path / "out").problems}


def test_an_offset_moves_the_log(tmp_path: Path) -> None:
    out = tmp_path / "out"
    text = done(flight(tmp_path), "--every", "1s", "--offset", "2", "--out", out)
    assert [r["altitude_m"] for r in rows(out)] == ["12.000", "13.000", "14.000", "14.900", ""]
    assert "0 frame(s) before the log, 1 after it" in text


def test_subtitles_of_each_second_are_interpolated(tmp_path: Path) -> None:
    video, out = write_video(tmp_path / "a.mp4"), tmp_path / "out"
    line = "2022.06.21 16:06:17\nGPS(36.6,-6.1,0.0M) BAROMETER:{:.1f}M"
    write_srt(tmp_path / "a.srt", lambda _, s: line.format(20 + 3 * s), blocks=5, step_s=1.0)
    text = done(video, "--every", "5f", "--out", out)
    assert "matched by times" in text
    assert "no gimbal pitch and field of view in a.srt" in text and "camera.pitch" in text
    assert "camera.altitude" not in text
    assert [float(r["altitude_m"]) for r in rows(out)][:4] == [20.0, 21.5, 23.0, 24.5]


def subtitled(path: Path, text: str, codec: str) -> Path:
    """Write three seconds of video with a track of subtitles, one a second."""
    styles = b"[Script Info]\n[V4+ Styles]\nFormat: Name, Fontname, Fontsize\nStyle: Default,Arial,16\n[Events]\n"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height = SIZE_WH
        stream.pix_fmt = "yuv420p"
        track = container.add_stream(codec)
        track.codec_context.subtitle_header = styles
        grey = np.full(SIZE_WH[::-1], 90, np.uint8)
        for _ in range(30):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="gray").reformat(format="yuv420p")))
        container.mux(stream.encode())
        for k in range(3):
            data = text.format(height=60 + k).encode()
            packet = av.Packet((len(data).to_bytes(2, "big") if codec == "mov_text" else b"") + data)
            packet.stream, packet.time_base = track, Fraction(1, 1000)
            packet.pts = packet.dts = 1000 * k
            packet.duration = 1000
            container.mux(packet)
    return path


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "mov_text"), ("a.mkv", "subrip")])
def test_subtitles_in_the_video_are_read(tmp_path: Path, name: str, codec: str) -> None:
    out = tmp_path / "out"
    text = "[rel_alt: {height}.0 abs_alt: 300.0] [gb_yaw: 1.0 gb_pitch: -40.0 gb_roll: 0.0]"
    assert "matched by times" in done(subtitled(tmp_path / name, text, codec), "--every", "1s", "--out", out)
    assert [(float(r["pitch_deg"]), float(r["altitude_m"])) for r in rows(out)] == [(40, 60), (40, 61), (40, 62)]


def test_captions_without_telemetry_are_reported(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done(subtitled(tmp_path / "a.mp4", "a caption {height}", "mov_text"), "--every", "1s", "--out", out)
    problems = json.loads((out / "frames.json").read_text("utf-8"))["problems"]
    assert {"log-layout", "telemetry-missing"} <= {p["code"] for p in problems}


def test_everything_that_is_missing_is_named_at_once(tmp_path: Path) -> None:
    text = done(write_video(tmp_path / "a.mp4"), "--out", tmp_path / "out")
    words = ("no gimbal pitch, height and field of view", "--hfov", "camera.pitch", "camera.altitude")
    assert all(word in text for word in words)


def test_frames_without_a_log_are_not_seen_through_the_recipes_lens(tmp_path: Path) -> None:
    settings = ["camera.pitch={fixed_deg: 60}", "camera.altitude={fixed_m: 40}"]
    video = write_video(tmp_path / "a.mp4")
    done(video, "--every", "3s", "--out", tmp_path / "blind", "--no-log")
    with pytest.raises(DatasetError) as caught:
        plan_request(RunRequest("hit-uav-people", tmp_path / "blind", settings=settings))
    assert {p.code for p in caught.value.problems if p.severity == "error"} == {"no-field-of-view"}
    lens = [*settings, "camera.focal_length_mm=40"]
    assert plan_request(RunRequest("hit-uav-people", tmp_path / "blind", settings=lens)).frames
    done(video, "--every", "3s", "--out", tmp_path / "seen", "--no-log", "--hfov", "40")
    assert plan_request(RunRequest("hit-uav-people", tmp_path / "seen", settings=settings)).frames


def airdata(path: Path, day: str = "2024-05-01", video: range = range(100, 150), rows: int = 300) -> Path:
    lines = ["time(millisecond),datetime(utc),height_above_takeoff(meters),isVideo,gimbal_pitch(degrees)"]
    lines += [
        f"{k * 100},{day} 10:00:{k // 10:02d},{k / 10},{int(k in video)},{-30 - k / 10}" for k in range(rows)
    ]  # fmt: skip
    path.write_text("\n".join(lines), "utf-8")
    return path


def test_a_flight_log_is_matched_by_its_recording(tmp_path: Path) -> None:
    video, log = write_video(tmp_path / "a.mp4"), airdata(tmp_path / "log.csv")
    text = done(video, "--every", "1s", "--log", log, "--out", tmp_path / "out")
    assert "the recording of this length" in text
    assert [float(r["altitude_m"]) for r in rows(tmp_path / "out")] == [10.0, 11.0, 12.0, 13.0, 14.0]
    assert [float(r["pitch_deg"]) for r in rows(tmp_path / "out")] == [40.0, 41.0, 42.0, 43.0, 44.0]


def test_a_flight_log_is_matched_by_clocks_or_by_hand(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mp4", created="2024-05-01T10:00:05Z")
    log = airdata(tmp_path / "log.csv", video=range(0))
    assert "matched by clocks" in done(video, "--every", "2s", "--log", log, "--out", tmp_path / "a")
    assert [float(r["altitude_m"]) for r in rows(tmp_path / "a")] == [5.0, 7.0, 9.0]
    done(video, "--every", "2s", "--log", log, "--log-start", "20", "--out", tmp_path / "b")
    assert [float(r["altitude_m"]) for r in rows(tmp_path / "b")] == [20.0, 22.0, 24.0]


@pytest.mark.parametrize("day", ["2024-05-02", "1999-01-01"])
def test_the_log_of_another_flight_is_refused(tmp_path: Path, day: str) -> None:
    video = write_video(tmp_path / "a.mp4", created="2024-05-01T10:00:05Z")
    log = airdata(tmp_path / "log.csv", day, video=range(200))
    text = done(video, "--log", log, "--out", tmp_path / "out", code=2)
    assert "log of another flight" in text and "--log-start" in text
    assert not (tmp_path / "out").exists()


def test_subtitles_of_a_longer_video_are_refused(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mp4")
    write_srt(tmp_path / "a.SRT", bracketed, blocks=500)
    assert "for a video of 4.9 s" in done(video, "--out", tmp_path / "out", code=2)


def test_subtitles_with_lying_times_are_matched_by_frame(tmp_path: Path) -> None:
    video, out = write_video(tmp_path / "a.mp4"), tmp_path / "out"
    path = write_srt(tmp_path / "a.SRT", bracketed)
    text = path.read_text("utf-8")
    for k in range(FRAMES):  # every block claims to start at 99 hours
        text = text.replace(f"\n\n{k + 1}\n00:", f"\n\n{k + 1}\n99:")
    path.write_text(text, "utf-8")
    text = done(video, "--every", "2s", "--out", out)
    assert "The frames' times are used" in text
    assert [float(r["altitude_m"]) for r in rows(out)] == [10.0, 12.0, 14.0]


def test_damaged_blocks_cost_only_themselves(tmp_path: Path) -> None:
    video, out = write_video(tmp_path / "a.mp4"), tmp_path / "out"
    path = write_srt(tmp_path / "a.SRT", bracketed)
    text = path.read_text("utf-8").replace("FrameCnt: 11,", "FrameCnt: 99999,").replace("FrameCnt: 31,", "Frame: 31,")
    path.write_text(text.replace("00:00:04,000 -->", "77:00:04,000 -->"), "utf-8")
    told = done(video, "--every", "1s", "--out", out)
    assert "matched by frame numbers" in told and "2 of 50 subtitle(s) out of order" in told
    assert [float(r["altitude_m"]) for r in rows(out)] == [10.0, 11.0, 12.0, 13.0, 14.0]


def test_times_that_do_not_increase_are_refused(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mp4")
    write_srt(tmp_path / "a.SRT", lambda _, s: f"BAROMETER:{s}M", blocks=9, step_s=0.0)
    assert "times that increase" in done(video, "--out", tmp_path / "out", code=2)


def test_negative_heights_and_cameras_that_look_back_are_left_empty(tmp_path: Path) -> None:
    video, out = write_video(tmp_path / "a.mp4"), tmp_path / "out"
    write_srt(tmp_path / "a.SRT", lambda n, s: f"[rel_alt: {s - 2:.1f} abs_alt: 9] [gb_pitch: {-110 + 10 * s:.1f}]")
    text = done(video, "--every", "1s", "--out", out)
    assert [r["altitude_m"] for r in rows(out)] == ["", "", "0.000", "1.000", "2.000"]
    assert [r["pitch_deg"] for r in rows(out)] == ["", "", "90.000", "80.000", "70.000"]
    assert "below the take-off point" in text and "looks back under the aircraft" in text
    problems = json.loads(run("inspect", out, "--json").output)["problems"]
    missing = [
        "camera pitch missing in 2 of 5",
        "height above the ground missing in 2 of 5",
        "field of view missing in 5 of 5",
        "time of day missing in 5 of 5",
    ]
    assert [p["found"].split(" pictures")[0] for p in problems] == missing


def test_a_varying_rate_is_matched_by_time(tmp_path: Path) -> None:
    times = [0, 100, 200, 1500, 1600, 3100, 3200, 3300, 1_000_000_000]
    video, out = write_video(tmp_path / "a.mkv", frames=len(times), times_ms=times), tmp_path / "out"
    text = done(video, "--every", "1s", "--out", out)
    assert [int(r["frame"]) for r in rows(out)] == [0, 3, 5, 8]
    assert "a varying frame rate" in text


def test_a_truncated_video_gives_what_it_has(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "whole.mkv", codec="ffv1")
    (tmp_path / "cut.mkv").write_bytes(whole.read_bytes()[: whole.stat().st_size * 6 // 10])
    result = run("frames", tmp_path / "cut.mkv", "--every", "5f", "--out", tmp_path / "out")
    assert result.exit_code in (0, 1), result.output
    assert 0 < len(rows(tmp_path / "out")) < FRAMES / 5
    mp4 = flight(tmp_path)
    (tmp_path / "cut.mp4").write_bytes(mp4.read_bytes()[:-400])
    assert "the index at its end" in done(tmp_path / "cut.mp4", "--out", tmp_path / "none", code=2)


def test_a_damaged_video_counts_its_losses(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", [np.random.default_rng(k).integers(16, 236, (48, 64), np.uint8)
                                            for k in range(20)])  # fmt: skip
    data = bytearray(path.read_bytes())
    start = data.index(b"mdat") + 4
    middle = start + (len(data) - start) // 2
    data[middle : middle + 9000] = bytes(9000)
    path.write_bytes(data)
    result = run("frames", path, "--every", "1f", "--out", tmp_path / "out")
    assert result.exit_code in (1, 2)
    assert "cannot be decoded" in result.output or "no frame" in result.output


@pytest.mark.parametrize("kind", ["text", "empty", "sound", "missing", "folder"])
def test_files_that_are_no_videos_are_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.mp4"
    if kind == "text":
        path.write_text("hello\n" * 100)
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "folder":
        path.mkdir()
    elif kind == "sound":
        path = tmp_path / "a.wav"
        with av.open(str(path), "w") as out:
            stream = out.add_stream("pcm_s16le", rate=8000)
            sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
            sound.rate = 8000
            out.mux(stream.encode(sound))
    text = done(path, "--out", tmp_path / "out", code=2)
    assert {"sound": "no video stream", "missing": "no such file", "folder": "a folder; expected video files"}.get(
        kind, "cannot be opened"
    ) in text
    assert not (tmp_path / "out").exists()


def test_colour_is_kept_and_reported(tmp_path: Path) -> None:
    out = tmp_path / "out"
    text = done(write_video(tmp_path / "a.mp4", colour=40), "--out", out)
    assert "in colour, written as RGB" in text
    with Image.open(out / "a/a_000000.png") as picture:
        assert picture.mode == "RGB"


def test_sixteen_bits_stay_sixteen(tmp_path: Path) -> None:
    path, out = tmp_path / "a.mkv", tmp_path / "out"
    with av.open(str(path), "w") as file:
        stream = file.add_stream("ffv1", rate=RATE)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "gray16le"
        levels = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64) + 29_000
        file.mux(stream.encode(av.VideoFrame.from_ndarray(levels, "gray16le")))
        file.mux(stream.encode())
    done(path, "--every", "1f", "--out", out)
    with Image.open(out / "a/a_000000.png") as picture:
        assert (np.array(picture) == levels).all()


def test_a_foreign_folder_is_left_alone(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    done(flight(tmp_path), "--out", out, "--overwrite", code=2)
    assert [p.name for p in out.iterdir()] == ["notes.txt"]


def test_names_of_videos_cannot_leave_the_folder(tmp_path: Path) -> None:
    shutil.copy(flight(tmp_path), tmp_path / "..mp4")
    out = tmp_path / "out"
    done(tmp_path / "DJI_0001.MP4", "--every", "20f", "--sequence", "../../evil", "--out", out)
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_dir()) == ["out"]
    assert all((out / r["file"]).is_file() for r in rows(out))


def test_videos_of_one_name_say_which_sequence_was_renamed(tmp_path: Path) -> None:
    """Files from two cards: their frames must not end in one folder, nor in another without notice."""
    for card in ("one", "two"):
        (tmp_path / card).mkdir()
    first, second = (write_video(tmp_path / card / "E.MP4") for card in ("one", "two"))
    text = done(first, second, "--every", "3s", "--out", tmp_path / "out", "--no-log")
    assert "another video is also named 'E', so the sequence of this one is 'E" in text and "--sequence" in text
    assert len({r["sequence"] for r in rows(tmp_path / "out")}) == 2
    named = done(first, second, "--every", "3s", "--out", tmp_path / "named", "--no-log", "--sequence", "a,b")
    assert "also named" not in named


def test_all_bad_videos_are_reported_at_once(tmp_path: Path) -> None:
    good, bad = write_video(tmp_path / "a.mp4"), tmp_path / "b.mp4"
    bad.write_text("no video")
    text = done(good, bad, tmp_path, tmp_path / "c.mp4", "--out", tmp_path / "out", code=2)
    assert "3 of 4 videos cannot be read" in text and "cannot be opened" in text and "no such file" in text
    assert "a folder; expected video files" in text and not (tmp_path / "out").exists()
