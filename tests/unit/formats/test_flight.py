"""A folder of pictures from a DJI or FLIR card is a dataset without any table."""

from __future__ import annotations

import os
import shutil
import time
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.errors import DatasetError
from infrablend.formats.cameras import flight_headers as flight_data
from infrablend.formats.pictures.images import REFUSED_COLOUR
from infrablend.lab.world.rjpeg_writing import Maker, Shot, radiometric_jpeg
from tests.command_line import run
from tests.flights import START, counts, flight, grey, plain_jpeg, shot, with_exif, with_exif_size, with_xmp
from tests.samples import SAMPLES, picture


def codes(dataset: Dataset) -> dict[str, str]:
    return {p.code: str(p) for p in dataset.problems if p.code.startswith("flight-")}


@pytest.mark.parametrize("maker", ["dji", "flir"])
def test_every_picture_gets_what_its_header_states(maker: Maker, tmp_path: Path) -> None:
    dataset = api.read_dataset(flight(tmp_path, 3, maker))
    assert [(i.capture.pitch_deg, i.capture.altitude_m, i.size_wh) for i in dataset.images] == [
        (60.0, 50.0, (160, 128))
    ] * 3
    assert all(i.capture.hfov_deg is not None and i.capture.captured is not None for i in dataset.images)
    assert len({i.capture.sequence for i in dataset.images}) == 1 and not codes(dataset)


def test_a_table_counts_more_than_the_header(tmp_path: Path) -> None:
    flight(tmp_path, 2)
    (tmp_path / "metadata.csv").write_text("file,pitch_deg,altitude_m,hfov_deg\nDJI_0001_T.JPG,80,44,20\n")
    one, two = api.read_dataset(tmp_path).images
    assert (one.capture.pitch_deg, one.capture.altitude_m, one.capture.hfov_deg) == (
        80.0,
        44.0,
        20.0,
    ) and two.capture.pitch_deg == 60.0


def test_visible_twins_and_other_files_are_left_out_and_counted(tmp_path: Path) -> None:
    flight(tmp_path, 3)
    for k in range(3):
        exif = {0x010F: "DJI", 0x0110: "M3T"} if k else {}
        plain_jpeg(tmp_path / f"DJI_{k + 1:04}_W.JPG", (640, 480), exif)
    plain_jpeg(tmp_path / "IMG_77.jpg", exif={0x010F: "Apple", 0x0110: "iPhone 12"})
    plain_jpeg(tmp_path / "DJI_0009.JPG", (2000, 1500), {0x010F: "DJI", 0x0110: "XT2"})
    dataset = api.read_dataset(tmp_path)
    assert [i.path.name for i in dataset.images] == [f"DJI_{k:04}_T.JPG" for k in (1, 2, 3)]
    assert dataset.notes["flight"]["left_out"] == {
        "of another camera (Apple iPhone 12)": 1,
        "visible light (far larger than the thermal pictures)": 1,
        "visible light (file name ends in _W)": 3,
    }
    assert sum(p.code == "flight-left-out" for p in dataset.problems) == 3


def test_a_card_of_damaged_files_is_reported(tmp_path: Path) -> None:
    flight(tmp_path, 2)
    for path in tmp_path.glob("*.JPG"):
        path.write_bytes(path.read_bytes().replace(b"<x:xmpmeta", b"<xmpmeta", 1))  # the segment's length is now wrong
    assert "its flight data are not read" in " ".join(str(p) for p in api.read_dataset(tmp_path).problems)


@pytest.mark.parametrize("behind", [False, True])
def test_telemetry_in_tiff_is_said_to_be_unread(behind: bool, tmp_path: Path) -> None:
    """Tags before or, as libtiff writes them, behind the pixels; with a table nothing is missing."""
    xmp = b'<x:xmpmeta xmlns:FLIR="http://ns.flir.com/xmp/1.0/">37543/1000</x:xmpmeta>'
    pixels = Image.fromarray(np.full((400, 600), 7000, np.uint16))
    for name in ("a.tiff", "b.TIF"):
        pixels.save(tmp_path / name, "TIFF", tiffinfo={} if behind else {700: xmp})
        with (tmp_path / name).open("ab") as stream:
            stream.write(xmp if behind else b"")
    (problem,) = [p for p in api.read_dataset(tmp_path).problems if p.code == "flight-unread"]
    assert problem.severity == "warning" and "2 picture(s) in TIFF" in problem.found
    ended = run("temperatures", tmp_path, "--out", tmp_path.parent / f"{tmp_path.name}_k")
    assert ended.exit_code == 2 and "a TIFF file" in ended.stderr and "from the card" not in ended.stderr
    (tmp_path / "metadata.csv").write_text("stem,pitch_deg,altitude_m\na,45,37\nb,45,37\n")
    assert not [p for p in api.read_dataset(tmp_path).problems if p.code == "flight-unread"]


@pytest.mark.parametrize(("suffix", "maker"), [(".png", "Autel Robotics"), (".webp", "Skydio"), (".png", "DJI")])
def test_exif_in_other_files_is_said_to_be_unread(suffix: str, maker: str, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x010F] = maker
    grey = Image.fromarray(np.full((64, 80), 90, np.uint8))
    grey.save(tmp_path / f"a{suffix}", exif=exif, lossless=True)
    (problem,) = [p for p in api.read_dataset(tmp_path).problems if p.code == "flight-unread"]
    assert problem.severity == "warning" and "1 picture(s) in TIFF, PNG or WebP" in problem.found
    (tmp_path / f"a{suffix}").unlink()
    grey.save(tmp_path / f"b{suffix}")
    assert not [p for p in api.read_dataset(tmp_path).problems if p.code == "flight-unread"]


def test_labelled_pictures_are_kept(tmp_path: Path) -> None:
    flight(tmp_path, 2)
    plain_jpeg(tmp_path / "DJI_0009.JPG", (2000, 1500), {0x010F: "DJI"})
    (tmp_path / "DJI_0009.txt").write_text("0 0.5 0.5 0.1 0.1\n")
    assert len(api.read_dataset(tmp_path).images) == 3


def test_what_is_missing_is_asked_for_once_per_field(tmp_path: Path) -> None:
    flight(tmp_path, 3)
    for k in range(4, 6):
        shot(tmp_path / f"DJI_{k:04}_T.JPG", number=k, altitude_m=None, pitch_deg=None, focal_length_35mm=None)
    found = [str(p) for p in api.read_dataset(tmp_path).problems if p.code == "flight-missing"]
    assert len(found) == 3
    assert "camera pitch missing in 2 of 5 pictures: DJI_0004_T.JPG, DJI_0005_T.JPG" in found[0]
    assert "a column altitude_m in metadata.csv, or --set camera.altitude='{fixed_m: 80}' for all pictures" in found[1]
    assert "camera.focal_length_mm" in found[2] and "hfov_deg" in found[2]


def test_two_cameras_in_one_folder_are_reported(tmp_path: Path) -> None:
    flight(tmp_path, 2)
    shot(tmp_path / "FLIR0001.jpg", "flir")
    text = codes(api.read_dataset(tmp_path))["flight-cameras"]
    assert "DJI WORLD-T, 160x128" in text and "FLIR Vue Pro R, 160x128" in text


def test_one_camera_without_a_field_of_view_in_some_pictures_is_one_camera(tmp_path: Path) -> None:
    flight(tmp_path, 2)
    shot(tmp_path / "DJI_0003_T.JPG", focal_length_35mm=None)
    found = codes(api.read_dataset(tmp_path))
    assert "flight-cameras" not in found and "flight-missing" in found


def test_a_fault_of_many_pictures_is_one_message(tmp_path: Path) -> None:
    for k in range(5):
        shot(tmp_path / f"DJI_{k + 1:04}_T.JPG", number=k, altitude_m=-5.0 - k)
    shot(tmp_path / "DJI_0006_T.JPG", pitch_deg=130.0)
    found = [str(p) for p in api.read_dataset(tmp_path).problems if p.code in ("flight-altitude", "flight-pitch")]
    assert len(found) == 2
    text = next(t for t in found if "RelativeAltitude" in t)
    assert "DJI_0001_T.JPG: XMP drone-dji:RelativeAltitude -5 m, left out; so in 4 more: DJI_0002_T.JPG" in text


def test_a_laser_that_hit_something_else_is_reported(tmp_path: Path) -> None:
    shot(tmp_path / "DJI_0001_T.JPG", altitude_m=100.0, laser_m=12.0)
    dataset = api.read_dataset(tmp_path)
    assert (
        "gives a height of 10.4 m" in codes(dataset)["flight-laser"] and dataset.images[0].capture.altitude_m == 10.392
    )
    shot(tmp_path / "DJI_0001_T.JPG", altitude_m=60.0, laser_m=100.0)
    assert not codes(api.read_dataset(tmp_path))


@pytest.mark.parametrize(
    ("size_wh", "words", "known"),
    [
        ((640, 512), "scaled, not cropped", True),
        ((320, 128), "cropped or turned", False),
        ((128, 160), "turned", False),
    ],
)
def test_pictures_changed_since_are_reported(size_wh: tuple[int, int], words: str, known: bool, tmp_path: Path) -> None:
    with_exif_size(shot(tmp_path / "DJI_0001_T.JPG"), size_wh)
    dataset = api.read_dataset(tmp_path)
    assert words in codes(dataset)["flight-size"] and (dataset.images[0].capture.hfov_deg is not None) == known


def test_the_size_that_the_camera_wrote_is_no_fault(tmp_path: Path) -> None:
    with_exif_size(shot(tmp_path / "DJI_0001_T.JPG"), (160, 128))
    assert not codes(api.read_dataset(tmp_path))


def test_statements_about_the_lens_that_differ_are_reported(tmp_path: Path) -> None:
    def calibrated(pixels: float) -> bytes:
        start = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        return start + (
            b'<rdf:Description xmlns:d="http://www.dji.com/drone-dji/1.0/" d:CalibratedFocalLength="%g"/>'
            b"</rdf:RDF></x:xmpmeta>" % pixels
        )

    one = with_xmp(shot(tmp_path / "DJI_0001_T.JPG"), calibrated(80.0))
    dataset = api.read_dataset(tmp_path)
    assert "EXIF FocalLengthIn35mmFilm gives 45.8 degrees across" in codes(dataset)["flight-lens"]
    assert "CalibratedFocalLength 90.0" in codes(dataset)["flight-lens"]
    with_xmp(shot(one), calibrated(190.0))
    assert "flight-lens" not in codes(api.read_dataset(tmp_path))


def test_clocks_an_hour_apart_are_reported(tmp_path: Path) -> None:
    flight(tmp_path, 3)
    for k in range(3):
        late = START + timedelta(hours=1, seconds=10 * k)
        shot(tmp_path / "second" / f"FLIR_{k + 1:04}.jpg", "flir", k, captured=late)
    text = codes(api.read_dataset(tmp_path))["flight-clocks"]
    assert "1:00 h apart in pictures with the same numbers (3)" in text


def test_day_and_night_come_from_the_sun(tmp_path: Path) -> None:
    for name, hour in (("noon", 12), ("midnight", 0), ("dawn", 7)):
        shot(tmp_path / f"{name}_T.jpg", captured=START.replace(hour=hour))
    assert {i.id: i.capture.time_of_day for i in api.read_dataset(tmp_path).images} == {
        "noon_T": "day", "midnight_T": "night", "dawn_T": "dawn",
    }  # fmt: skip


def test_a_local_clock_near_dawn_is_that_of_the_longitude_and_says_so(tmp_path: Path) -> None:
    shot(tmp_path / "a_T.jpg", captured=START.replace(hour=7))
    (row,) = [r for r in api.read_dataset(tmp_path).notes["flight"]["facts"] if r["field"] == "time_of_day"]
    assert row["source"] == "sun at place and local clock, taken as UTC+01 by the longitude (+-1 h)"
    shot(tmp_path / "a_T.jpg", captured=START.replace(hour=7), utc=START.replace(hour=6))
    (row,) = [r for r in api.read_dataset(tmp_path).notes["flight"]["facts"] if r["field"] == "time_of_day"]
    assert row["source"] == "sun at time and place"


def test_an_unknown_time_of_day_is_asked_for(tmp_path: Path) -> None:
    flight(tmp_path, 2, place=None)
    (problem,) = [p for p in api.read_dataset(tmp_path).problems if p.code == "flight-missing"]
    assert "time of day missing in 2 of 2" in problem.found
    assert "--set environment.time_of_day=day; else it is taken to be night, without sun" in problem.todo


XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    b'<rdf:Description rdf:about="" xmlns:d="%s" %s/></rdf:RDF></x:xmpmeta>'
)


def test_a_header_counts_whatever_the_maker(tmp_path: Path) -> None:
    """EXIF of any maker states lens, place and time; what looks like a pitch of an unknown one is named."""
    path = plain_jpeg(tmp_path / "a.jpg", (640, 512), {0x010F: "Nobody", 0x0110: "N1"})
    with_exif(path, detail={0xA405: 65, 0x9003: "2024:05:14 12:00:00", 0x9011: "+02:00"})
    with_xmp(path, XMP % (b"http://nobody.example/1.0/", b'd:CameraTilt="-45.0" d:FlightPitchDegree="3.0"'))
    dataset = api.read_dataset(tmp_path)
    capture = dataset.images[0].capture
    assert (capture.camera, capture.captured) == ("Nobody N1", "2024-05-14T12:00:00+02:00")
    assert capture.hfov_deg == pytest.approx(29.14, abs=0.01) and capture.pitch_deg is None
    assert "XMP CameraTilt '-45.0' (http://nobody.example/1.0/) is not read" in codes(dataset)["flight-unread"]
    # Cameras of other things than drones are not asked for pitch and height.
    plain_jpeg(path, (640, 512), {0x010F: "Nobody", 0x0110: "N1"})
    with_exif(path, detail={0xA405: 65, 0x9003: "2024:05:14 12:00:00"}, main={0x0132: "2026:01:01 09:00:00"})
    dataset = api.read_dataset(tmp_path)
    assert dataset.images[0].capture.hfov_deg is not None and not codes(dataset)


def test_positions_that_contradict_each_other_are_reported(tmp_path: Path) -> None:
    path = shot(tmp_path / "DJI_0001_T.JPG")
    with_xmp(path, XMP % (b"http://www.dji.com/drone-dji/1.0/", b'd:GpsLatitude="47.2" d:GpsLongitude="15.1"'))
    assert (
        "XMP drone-dji:GpsLatitude 47.20000 15.10000; EXIF is used" in codes(api.read_dataset(tmp_path))["flight-place"]
    )


def test_a_break_starts_another_flight(tmp_path: Path) -> None:
    for k, minutes in enumerate((0, 5, 30, 32)):
        shot(tmp_path / f"DJI_{k:04}_T.JPG", captured=START + timedelta(minutes=minutes))
    sequences = [i.capture.sequence for i in api.read_dataset(tmp_path).images]
    assert sequences == ["flight-20260112-063000"] * 2 + ["flight-20260112-070000"] * 2


def test_a_damaged_header_is_named_and_the_others_are_read(tmp_path: Path) -> None:
    flight(tmp_path, 2)
    (tmp_path / "DJI_0003_T.JPG").write_bytes(b"\xff\xd8\xff\xe1\xff\xff")
    dataset = api.read_dataset(tmp_path)
    assert "jpeg-truncated" in {p.code for p in dataset.problems} and dataset.images[0].capture.pitch_deg == 60.0


@pytest.mark.parametrize("maker", ["dji", "flir"])
def test_a_folder_of_radiometric_pictures_gets_a_hint(maker: Maker, tmp_path: Path) -> None:
    (found,) = api.inspect(flight(tmp_path, 3, maker)).problems
    assert (found.code, found.severity) == ("image-radiometric", "warning")
    assert (
        f"3 of 3 pictures are radiometric ({maker.upper()})" in found.found
        and "the temperatures are not used" in found.todo
        and f"infrablend temperatures {tmp_path} --out {tmp_path.name}_k" in found.todo
    )


def test_inspect_says_that_generate_refuses_a_palette_as_it_does(tmp_path: Path) -> None:
    data = tmp_path / "a flight"
    data.mkdir()
    for k in range(2):
        level = grey(k)
        palette = np.stack([level, 255 - level, level // 2], axis=2)
        one = replace(Shot(), captured=START + timedelta(seconds=k))
        (data / f"DJI_{k:04}_T.JPG").write_bytes(radiometric_jpeg("dji", palette, counts(k), one))
    (found,) = api.inspect(data).problems
    assert "2 of 2 that were looked at are in colour" in found.found and REFUSED_COLOUR in found.found
    assert "go on" not in found.todo and "infrablend temperatures" in found.todo and "artistic" in found.todo
    report = api.generate("sar-people", data, tmp_path / "run", execution=api.Execution(renderer="flat"))
    refused = [p.found for p in report.problems if p.code == "image-colour-mapped"]
    assert len(refused) == 2 and all(REFUSED_COLOUR in text for text in refused)


def test_radiometric_insertion_into_camera_files_names_the_command(tmp_path: Path) -> None:
    data = flight(tmp_path / "a flight", 2)
    settings = {"matching.mode": "radiometric", "placement.mode": "metric", "appearance.mode": "physical"}
    with pytest.raises(DatasetError) as caught:
        api.plan("hit-uav-person", data, settings=settings)
    (_, last) = [p for p in caught.value.problems if p.code == "no-temperature-scale"]
    assert f"infrablend temperatures '{data}' --out 'a flight_k'" in last.todo and "--slope" in last.todo


def test_pictures_of_public_datasets_are_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("infrablend.formats.cameras.flight_headers.read_facts", lambda path: pytest.fail(str(path)))
    for name in ("birdsai", "monet", "wisard"):
        api.read_dataset(SAMPLES[name](tmp_path / name))


def test_pipes_are_not_opened(tmp_path: Path) -> None:
    """A pipe among the pictures would make the reader wait for ever."""
    os.mkfifo(tmp_path / "a.jpg")
    image = ImageRecord("a", tmp_path / "a.jpg", "train", (8, 8), ())
    assert flight_data.add_flight_data(Dataset(tmp_path, "folder", (), (image,))).problems == ()


def test_plain_pictures_stay_as_they_are(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / f"{k}.jpg", k)
    dataset = api.read_dataset(tmp_path)
    assert "flight" not in dataset.notes and all(i.size_wh is None for i in dataset.images)


def test_inspect_shows_what_was_found_where(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from infrablend.cli.app import build_app

    shot(flight(tmp_path, 2) / "DJI_0003_T.JPG", altitude_m=None)
    text = CliRunner().invoke(build_app(), ["inspect", str(tmp_path)], env={"COLUMNS": "200"}).output
    assert "XMP drone-dji:GimbalPitchDegree" in text and "with a radiometric layer: 3" in text
    (row,) = [line.split() for line in text.splitlines() if line.startswith("altitude_m") and "missing" in line]
    assert row == ["altitude_m", "missing", "1"]


def test_headers_of_many_pictures_are_read_quickly(tmp_path: Path) -> None:
    one = shot(tmp_path / "DJI_0000_T.JPG")
    for k in range(1, 200):
        shutil.copy(one, tmp_path / f"DJI_{k:04}_T.JPG")
    start = time.process_time()
    flight_data.add_flight_data(api.read_dataset(tmp_path))
    assert time.process_time() - start < 4.0


@pytest.mark.parametrize(("ahead", "text"), [(10, "1:10 h"), (120, "3:00 h")])
def test_clocks_that_jump_within_a_flight_are_one_message(ahead: int, text: str, tmp_path: Path) -> None:
    for k in range(5):
        utc = START - timedelta(hours=1) + timedelta(seconds=10 * k)
        local = utc + timedelta(hours=1, minutes=ahead if k > 2 else 0)
        shot(tmp_path / f"DJI_{k + 1:04}_T.JPG", number=k, captured=local, utc=utc)
    dataset = api.read_dataset(tmp_path)
    (problem,) = [p for p in dataset.problems if p.code == "flight-clocks"]
    assert f"EXIF DateTimeOriginal is {text} ahead of UTCAtExposure, but 1:00 h in the rest" in problem.found
    assert "2 picture(s): DJI_0004_T.JPG, DJI_0005_T.JPG" in problem.found
    assert [i.capture.captured for i in dataset.images] == [f"2026-01-12T06:30:{10 * k:02}+01:00" for k in range(5)]
    assert len({i.capture.sequence for i in dataset.images}) == 1


def test_a_clock_that_is_no_time_zone_off_gives_none(tmp_path: Path) -> None:
    flight(tmp_path / "a", 3, utc=START - timedelta(hours=1, minutes=5))
    dataset = api.read_dataset(tmp_path / "a")
    (problem,) = [p for p in dataset.problems if p.code == "flight-clocks"]
    assert "which is no time zone; EXIF is used (3 picture(s)" in problem.found
    assert {i.capture.captured for i in dataset.images} == {f"2026-01-12T06:30:{s}" for s in ("00", "10", "20")}


def test_two_flights_may_have_two_time_zones(tmp_path: Path) -> None:
    for k, zone in enumerate((1, 1, 2, 2)):
        utc = START + timedelta(hours=k // 2, seconds=10 * k)
        shot(tmp_path / f"DJI_{k + 1:04}_T.JPG", number=k, captured=utc + timedelta(hours=zone), utc=utc)
    dataset = api.read_dataset(tmp_path)
    assert not [p for p in dataset.problems if p.code == "flight-clocks"]
    assert [str(i.capture.captured)[-6:] for i in dataset.images] == ["+01:00"] * 2 + ["+02:00"] * 2
