"""Logs of flights: DJI's subtitles in all dialects, AirData's and DJI's CSV, and values between their samples."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from infrablend.errors import DatasetError
from infrablend.formats.cameras.dji_srt import read_srt
from infrablend.formats.cameras.flight_csv import read_flight_csv
from infrablend.formats.cameras.flight_log import FlightLog, in_order, sample

GIMBAL = "[gb_yaw: 45.0 gb_pitch: -30.5 gb_roll: 0.5]"
DIALECTS = {
    "mini": (f"[latitude: 59.3] [longitude: 18.2] [rel_alt: 1.300 abs_alt: 132.860] {GIMBAL}", 30.5, 1.3),
    "font": (f'<font size="36">SrtCnt : 1, DiffTime : 33ms\n[iso : 100] [rel_alt: 1.3 abs_alt: 9] {GIMBAL}</font>',
             30.5, 1.3),
    "added gimbal": ("[rel_alt: 20.1 abs_alt: 9]\n[gimbal_heading(degrees): 3] [gimbal_pitch(degrees): -90.0]",
                     90.0, 20.1),
    "mavic pro": ("HOME(-4.0067,57.9816) 2017.07.29 11:58:52\nGPS(-4.0071,57.9811,18) BAROMETER:57.2\n"
                  "ISO:100 Shutter:320 EV:-2/3 Fnum:F2.2", None, 57.2),
    "matrice 300": ("2022.06.21 16:06:31\nGPS(36.6146,-6.1120,0.0M) BAROMETER:47.0M", None, 47.0),
    "phantom 4 rtk": ("F/5.6, SS 400, ISO 100, EV 0, GPS (-58.85, -34.23, 15), HOME (-58.84, -34.23, -57.98m), "
                      "D 698.70m, H 85.80m, H.S 0.00m/s, V.S 0.00m/s", None, 85.8),
    "inspire": ("F/2.8, SS 206.14, ISO 100, EV 0, DZOOM 1.000, GPS (1, 2, 15), D 6.70m, H 85.8m, "
                "F.PRY (1.0°, -2.4°, 89.8°), G.PRY (-20.9°, 0.0°, 89.8°)", 20.9, 85.8),
    "typo": ("[latitude : 51.5] [longtitude : -0.1] [rel_alt : 12.5 abs_alt : 3]", None, 12.5),
}  # fmt: skip


def srt(path: Path, *texts: str, step: int = 1) -> Path:
    blocks = [
        f"{k + 1}\n00:00:{k * step:02d},000 --> 00:00:{(k + 1) * step:02d},000\n{text}\n"
        for k, text in enumerate(texts)
    ]
    path.write_bytes("\n".join(blocks).replace("\n", "\r\n").encode("utf-8-sig"))
    return path


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_gives_pitch_and_height(tmp_path: Path, name: str) -> None:
    text, pitch, height = DIALECTS[name]
    log = read_srt(srt(tmp_path / "a.SRT", text, text))
    assert log.times_s.tolist() == [0.0, 1.0]
    assert log.values["altitude_m"].tolist() == [height, height]
    assert ("pitch_deg" in log.values) == (pitch is not None)
    if pitch is not None:
        assert log.values["pitch_deg"][0] == pitch


def test_frame_counts_dates_and_places_are_read(tmp_path: Path) -> None:
    text = '<font size="28">FrameCnt: {}, DiffTime: 33ms\n2024-05-01 12:00:0{},250,100\n[latitude: 45.5] [rel_alt: 2]'
    log = read_srt(srt(tmp_path / "a.SRT", text.format(1, 1), text.format(2, 2)))
    assert log.frames.tolist() == [0, 1]
    assert sample(log, [0.5]).captured == ("2024-05-01T12:00:01.750",)
    assert log.values["latitude_deg"].tolist() == [45.5, 45.5]


def test_a_bare_altitude_is_no_height(tmp_path: Path) -> None:
    log = read_srt(srt(tmp_path / "a.SRT", "[altitude: 80.5] [gb_pitch: -45]"))
    assert "altitude_m" not in log.values
    assert [p.code for p in log.problems] == ["log-height"]


@pytest.mark.parametrize("text", ["", "1\n00:00:00,000 --> 00:00:01,000\nHello there.\n", "not a subtitle"])
def test_subtitles_without_telemetry_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.srt").write_text(text)
    with pytest.raises(DatasetError, match=r"no telemetry|cannot be read"):
        read_srt(tmp_path / "a.srt")


def test_hostile_blocks_cost_no_time(tmp_path: Path) -> None:
    long = "a" * 300_000 + "<" * 300_000 + "gb_pitch:" * 30_000 + "G.PRY (" * 30_000
    with pytest.raises(DatasetError, match="no telemetry"):
        read_srt(srt(tmp_path / "a.srt", long, long))


def test_dates_of_uncertain_order_are_reported(tmp_path: Path) -> None:
    text = airdata(tmp_path / "a.csv").read_text("utf-8")
    assert not [p for p in read_flight_csv(tmp_path / "a.csv").problems if p.code == "log-date"]
    (tmp_path / "b.csv").write_text(text.replace("2024-05-01", "5/1/2024"), "utf-8")
    (warning,) = [p for p in read_flight_csv(tmp_path / "b.csv").problems if p.code == "log-date"]
    assert "'5/1/2024 10:00:00'" in warning.found


def test_rolls_are_those_of_cameras(tmp_path: Path) -> None:
    rolls = ((45, 180), (45, -12.5), (89, 180))
    log = read_srt(srt(tmp_path / "a.SRT", *(f"[rel_alt: 2] [gb_pitch: -{p} gb_roll: {r}]" for p, r in rolls)))
    assert np.nan_to_num(log.values["roll_deg"], nan=-1.0).tolist() == [-1.0, -12.5, 180.0]
    assert ["1 sample(s)" in p.found for p in log.problems if p.code == "log-roll"] == [True]


def airdata(path: Path, unit: str = "feet", rows: int = 41, ground: str = "") -> Path:
    lines = [
        f"time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff({unit}),"
        f"height_above_ground_at_drone_location({unit}),isVideo,gimbal_heading(degrees),gimbal_pitch(degrees)"
    ]
    for k in range(rows):
        video = int(10 <= k <= 30)
        lines.append(f"{k * 100},2024-05-01 10:00:{k // 10:02d},45.5,15.2,{100 + k},{ground or 0},{video},90,-45.5")
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def test_airdata_in_feet(tmp_path: Path) -> None:
    log = read_flight_csv(airdata(tmp_path / "log.csv"))
    assert log.dialect == "AirData CSV" and log.in_utc
    assert log.values["altitude_m"][:2] == pytest.approx([30.48, 30.7848])
    assert log.height == "height_above_takeoff(feet)"
    assert log.values["pitch_deg"][0] == 45.5
    assert log.recordings == ((1.0, 3.0),)
    assert sample(log, [0.0]).captured == ("2024-05-01T10:00:00.000+00:00",)


def test_heights_above_the_ground_are_preferred(tmp_path: Path) -> None:
    log = read_flight_csv(airdata(tmp_path / "log.csv", "meters", ground="33.5"))
    assert log.height == "height_above_ground_at_drone_location(meters)"
    assert log.values["altitude_m"][0] == 33.5


LITCHI = (
    "latitude,longitude,altitude(m),ascent(m),time(millisecond),datetime(utc),gimbalPitchRaw,gimbalRollRaw,gimbalYawRaw,"
    "isTakingVideo\n"
) + "".join(
    f"47.1,9.1,480,{50 + k / 10},{k * 100},2024-05-14 21:00:0{k // 10}.{k % 10}00000,-600,15,100,{int(10 <= k <= 30)}\n"
    for k in range(41)
)


def test_litchis_heights_are_above_take_off_and_its_angles_tenths(tmp_path: Path) -> None:
    for text, feet in ((LITCHI, 1.0), (LITCHI.replace("(m)", "(feet)"), 0.3048)):
        (tmp_path / "litchi.csv").write_text(text)
        log = read_flight_csv(tmp_path / "litchi.csv")
        assert log.dialect == "Litchi CSV" and log.in_utc and log.recordings == ((1.0, 3.0),) and not log.problems
        assert log.values["altitude_m"][:2] == pytest.approx([50.0 * feet, 50.1 * feet])
        assert [log.values[n][0] for n in ("pitch_deg", "roll_deg", "yaw_deg")] == pytest.approx([60.0, 1.5, 10.0])


def test_flytrex_has_heights_alone(tmp_path: Path) -> None:
    """The header of github.com/mikeemoo/dji-log-parser/issues/7."""
    text = (
        "latitude,longitude,altitude(feet),ascent(feet),speed(mph),distance(feet),time(millisecond),datetime(utc),"
        "satellites,voltage(v),max_altitude(feet),max_ascent(feet),max_speed(mph),max_distance(feet)\n"
        "14.54,-90.52,4800.2,336.2861,20.9,300.4,334100.0,2016-07-23 22:50:45.288000,19,15.284,4801,337.2,20.9,300.4\n"
        "14.54,-90.52,4800.5,336.6142,20.7,306.5,334300.0,2016-07-23 22:50:45.590000,19,15.284,4801,337.2,20.9,306.5\n"
    )
    (tmp_path / "flytrex.csv").write_text(text)
    log = read_flight_csv(tmp_path / "flytrex.csv")
    assert (log.dialect, log.height, log.recordings) == ("Flytrex CSV", "ascent(feet)", ())
    assert log.values["altitude_m"] == pytest.approx([102.5, 102.6]) and "pitch_deg" not in log.values
    (tmp_path / "flytrex.csv").write_text(text.replace("ascent", "height"))
    with pytest.raises(DatasetError, match="not a flight log of a known kind"):
        read_flight_csv(tmp_path / "flytrex.csv")


@pytest.mark.parametrize(
    ("header", "row", "height"),
    [
        ("CUSTOM.updateTime,GIMBAL.yaw,GIMBAL.pitch,GIMBAL.roll,OSD.height [m],CUSTOM.isVideo",
         "2024/05/01 10:00:0{}.50,3.0,-89.9,0.0,60.5,1", 60.5),
        ("sep=,\nCUSTOM.date [local],CUSTOM.updateTime [local],OSD.flyTime [s],OSD.height [ft],GIMBAL.pitch",
         "11/25/2024,7:05:0{}.97 PM,{}.0,200,-89.9", 60.96),
    ],
)  # fmt: skip
def test_dji_flight_records(tmp_path: Path, header: str, row: str, height: float) -> None:
    text = "\n".join([header, *(row.replace("{}", str(k)) for k in range(3))])
    (tmp_path / "log.csv").write_bytes(text.encode("latin-1") + b"\n\0")
    log = read_flight_csv(tmp_path / "log.csv")
    assert log.dialect == "DJI flight record"
    assert log.times_s.tolist() == [0.0, 1.0, 2.0]
    assert log.values["altitude_m"].tolist() == pytest.approx([height] * 3)
    assert log.values["pitch_deg"].tolist() == pytest.approx([89.9] * 3)


def test_a_date_whose_order_is_uncertain_is_left_out(tmp_path: Path) -> None:
    text = "CUSTOM.date [local],CUSTOM.updateTime [local],OSD.height [m],GIMBAL.pitch\n"
    text += "".join(f"3/4/2024,7:05:0{k}.0 PM,60,-90\n" for k in range(3))
    (tmp_path / "log.csv").write_text(text)
    log = read_flight_csv(tmp_path / "log.csv")
    assert log.clock_s is None
    assert log.times_s.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a,b\n1,2\n", "not a flight log"),
        ("time(millisecond),gimbal_pitch(degrees)\n", "empty AirData"),
        ("time(millisecond),gimbal_pitch(degrees)\n5,-9\n4,-9\n3,-9\n", "no usable times"),
        ("time(millisecond),gimbal_pitch(degrees)\nx,-9\nnan,-9\n", "no usable times"),
    ],
)
def test_csv_files_that_are_no_logs_are_refused(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(DatasetError, match=match):
        read_flight_csv(tmp_path / "log.csv")


def log_of(times: list[float], **values: list[float]) -> FlightLog:
    return FlightLog("a", "test", np.array(times), {k: np.array(v, np.float64) for k, v in values.items()})


def test_single_damaged_values_are_out_of_order() -> None:
    assert in_order([0, 1, 99, 2, 3, -5, 4, math.nan, 5]).tolist() == [1, 1, 0, 1, 1, 0, 1, 0, 1]
    assert in_order([]).tolist() == [] and in_order([math.nan]).tolist() == [False]


def test_values_between_samples_are_linear() -> None:
    got = sample(log_of([0, 1, 2], pitch_deg=[40, 50, 50], altitude_m=[10, 20, 40]), [0.0, 0.25, 1.5, 2.0]).values
    assert got["pitch_deg"].tolist() == [40.0, 42.5, 50.0, 50.0]
    assert got["altitude_m"].tolist() == [10.0, 12.5, 30.0, 40.0]


def test_angles_around_a_circle_go_the_short_way() -> None:
    log = log_of([0, 1, 2], yaw_deg=[170, -170, 10], roll_deg=[359, 1, 1])
    got = sample(log, [0.25, 0.5, 0.75, 1.0]).values
    assert got["yaw_deg"].tolist() == pytest.approx([175.0, 180.0, -175.0, -170.0])
    assert got["roll_deg"].tolist() == pytest.approx([-0.5, 0.0, 0.5, 1.0])


def test_times_outside_the_log_and_in_its_gaps_have_no_values() -> None:
    log = log_of([0, 1, 2, 10, 11], altitude_m=[0, 1, 2, 10, 11])
    got = sample(log, [-5.0, -0.5, 0.0, 5.0, 10.0, 11.5, 20.0])
    assert [None if math.isnan(v) else v for v in got.values["altitude_m"]] == [None, 0, 0, None, 10, 11, None]
    c = got.coverage
    assert (c.inside, c.before, c.after, c.in_gaps, c.largest_gap_s) == (4, 1, 1, 1, 8.0)
