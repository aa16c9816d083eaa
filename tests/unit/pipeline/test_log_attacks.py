"""Logs and videos as other programs write them, through `infrablend frames`: right values, or a named problem."""

from __future__ import annotations

import csv
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.command_line import said
from tests.videos import FRAMES, av, bracketed, timecode, write_srt, write_video

pytestmark = pytest.mark.long

HEADER = "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),isVideo,gimbal_pitch(degrees)"


def extracted(folder: Path, *options: object, video: Path | None = None) -> tuple[str, list[dict[str, str]]]:
    out = folder / "out"
    text = said("frames", video or write_video(folder / "V.MP4"), "--every", "1s", "--out", out, *options)
    return text, list(csv.DictReader((out / "metadata.csv").read_text("utf-8").splitlines()))


refused = partial(said, "frames", code=2)


# ---- Subtitles


@pytest.mark.parametrize(
    ("line", "pitch", "height"),
    [
        (lambda n, s: f"[rel_alt: {10 + s:.3f} abs_alt: 9] [gb_pitch: -60.5]".replace(".", ","), "60.500", "11.000"),
        (lambda n, s: f"[rel_alt: {100 + s:.1f}ft abs_alt: 9] [gb_pitch: -60.5]", "60.500", "30.785"),
        (lambda n, s: f"FrameCnt: {n - 1} [rel_alt: {10 + s} abs_alt: 9] [gb_pitch: -60]", "60.000", "11.000"),
        (lambda n, s: f"[rel_alt: {10 + s} abs_alt: 9] [gb_pitch: -60] [rel_alt: 99]", "60.000", "11.000"),
    ],
    ids=["decimal commas", "feet", "frames counted from 0", "a name twice"],
)
def test_other_spellings_of_numbers(line: Callable[[int, float], str], pitch: str, height: str, tmp_path: Path) -> None:
    write_srt(tmp_path / "V.SRT", line)
    _, rows = extracted(tmp_path)
    assert (rows[1]["pitch_deg"], rows[1]["altitude_m"]) == (pitch, height)


def test_a_drone_without_a_fix_has_no_place_and_no_sun(tmp_path: Path) -> None:
    write_srt(tmp_path / "V.SRT", lambda n, s: bracketed(n, s).replace("45.5]", "0.0]").replace("15.25]", "0.0]"))
    _, rows = extracted(tmp_path)
    assert all(r["latitude_deg"] == r["longitude_deg"] == r["time_of_day"] == "" and r["captured"] for r in rows)


def test_a_block_with_a_negative_time_costs_only_itself(tmp_path: Path) -> None:
    text = "".join(
        f"{k + 1}\n{'-' if k == 10 else ''}{timecode(k / 10)} --> {timecode(k / 10 + 0.1)}\n"
        f"[rel_alt: {999 if k == 10 else 10 + k / 10}] [gb_pitch: -60]\n\n"
        for k in range(FRAMES)
    )
    (tmp_path / "V.SRT").write_text(text)
    output, rows = extracted(tmp_path)
    assert rows[1]["altitude_m"] == "11.000" and "1 of 50 subtitle(s) out of order" in output


# ---- Flight logs


def log(folder: Path, change: Callable[[str], str] = str, height: str = "{:.1f}", header: str = HEADER) -> Path:
    lines = [header]
    for k in range(81):
        feet = height.format(100 + k)
        lines.append(f"{k * 100},2024-05-01 10:00:{k // 10:02d},45.5,15.2,{feet},{int(10 <= k <= 60)},-45.5")
    (folder / "log.csv").write_text(change("\n".join(lines) + "\n"), "utf-8")
    return folder / "log.csv"


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.replace(",", ";"),
        lambda t: t.replace(",", ";").replace(".", ","),
        lambda t: t.replace(",", "\t"),
        lambda t: "\ufeff" + t.replace("\n", "\r\n"),
    ],
    ids=["semicolons", "decimal commas", "tabs", "a mark and CRLF"],
)
def test_other_separators_give_the_same_values(change: Callable[[str], str], tmp_path: Path) -> None:
    _, rows = extracted(tmp_path, "--log", log(tmp_path, change))
    assert (rows[0]["altitude_m"], rows[0]["pitch_deg"], rows[0]["latitude_deg"]) == ("33.528", "45.500", "45.5000000")


def test_commas_beside_decimal_points_separate_thousands(tmp_path: Path) -> None:
    _, rows = extracted(tmp_path, "--log", log(tmp_path, height='"1,{:.0f}"'))
    assert rows[0]["altitude_m"] == "338.328"  # 1,110 feet


def test_a_column_twice_is_reported_if_the_values_differ(tmp_path: Path) -> None:
    header = HEADER.replace("isVideo", "height_above_takeoff(feet),isVideo")
    output, rows = extracted(tmp_path, "--log", log(tmp_path, header=header, height="{:.1f},9999"))
    assert rows[0]["altitude_m"] == "33.528" and "several columns 'height_above_takeoff(feet)'" in output


def test_a_log_without_a_fix_has_no_place(tmp_path: Path) -> None:
    _, rows = extracted(tmp_path, "--log", log(tmp_path, lambda t: t.replace("45.5,15.2", "0,0")))
    assert rows[0]["latitude_deg"] == rows[0]["time_of_day"] == "" and rows[0]["altitude_m"] == "33.528"


def test_times_in_an_unknown_unit_are_no_times(tmp_path: Path) -> None:
    given = log(tmp_path, lambda t: t.replace("(millisecond)", "(tick)").replace("2024", "x"))
    message = refused(write_video(tmp_path / "V.MP4"), "--log", given, "--log-start", "0", "--out", tmp_path / "out")
    assert "column 'time(tick)' has no known unit" in message


def test_times_of_day_go_on_at_midnight(tmp_path: Path) -> None:
    rows = [f"3/4/2024,11:59:{57 + k / 10:04.1f} PM,{k},-90" for k in range(30)]
    rows += [f"3/4/2024,12:00:{k / 10:04.1f} AM,{30 + k},-90" for k in range(30)]
    header = "CUSTOM.date [local],CUSTOM.updateTime [local],OSD.height [m],GIMBAL.pitch"
    (tmp_path / "log.csv").write_text("\n".join([header, *rows]))
    _, table = extracted(tmp_path, "--log", tmp_path / "log.csv", "--log-start", "0")
    assert [r["altitude_m"] for r in table] == [f"{k}.000" for k in (0, 10, 20, 30, 40)]


@pytest.mark.parametrize("option", ["--log-start", "--offset"])
@pytest.mark.parametrize("value", ["nan", "inf", "1e308"])
def test_clocks_that_cannot_be_are_refused(option: str, value: str, tmp_path: Path) -> None:
    message = refused(write_video(tmp_path / "V.MP4"), "--log", log(tmp_path), option, value, "--out", tmp_path / "out")
    assert "expected at most 4e+09 s" in message and not (tmp_path / "out").exists()


def test_a_step_that_no_number_holds_is_refused(tmp_path: Path) -> None:
    video = write_video(tmp_path / "V.MP4", frames=2)
    assert "expected a shorter step" in refused(video, "--every", "9" * 400 + "f", "--out", tmp_path / "out")


# ---- Videos


def test_a_playlist_opens_no_other_file(tmp_path: Path) -> None:
    write_video(tmp_path / "V.MP4")
    playlist = tmp_path / "list.m3u8"
    playlist.write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\n{tmp_path}/V.MP4\n#EXT-X-ENDLIST\n")
    assert "cannot be opened" in refused(playlist, "--out", tmp_path / "out")


@pytest.mark.parametrize(
    ("kind", "codec", "suffix"),
    [("gray16be", "rawvideo", "nut"), ("gbrp16le", "ffv1", "mkv"), ("rgb48be", "png", "mov"), ("ya16be", "png", "mov")],
)
def test_grey_of_16_bits_stays_so_in_any_format(kind: str, codec: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"V.{suffix}"
    with av.open(str(path), "w") as out:
        stream = out.add_stream(codec, rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, kind
        for k in range(2):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64), 28_000 + k, np.uint16), format="gray16le")
            frame.pts = k
            out.mux(stream.encode(frame if frame.format.name == kind else frame.reformat(format=kind)))
        out.mux(stream.encode())
    _, rows = extracted(tmp_path, "--every", "1f", video=path)
    for k, row in enumerate(rows):
        with Image.open(tmp_path / "out" / row["file"]) as picture:
            assert (np.asarray(picture) == 28_000 + k).all()
