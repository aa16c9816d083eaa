"""Facts of a picture: EXIF and XMP in their forms, the lens, both makers."""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from infrablend.errors import DatasetError
from infrablend.formats.cameras.header_facts import DJI, CameraFacts, fov_of_35mm, read_facts, zoomed
from infrablend.formats.cameras.jpeg_segments import APP1, read_header
from infrablend.formats.cameras.xmp import EXTENDED, MAX_BYTES, STANDARD, read_xmp
from infrablend.lab.world.rjpeg_writing import Maker, segment_bytes
from tests.flights import plain_jpeg, shot, with_exif, with_xmp

HEAD = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
TAIL = b"</rdf:RDF></x:xmpmeta>"


def values(facts: CameraFacts) -> dict[str, Any]:
    return {name: fact.value for name, fact in facts.facts.items()}


@pytest.mark.parametrize("elements", [False, True])
@pytest.mark.parametrize("maker", ["dji", "flir"])
def test_facts_of_both_makers_and_both_forms_of_xmp(maker: Maker, elements: bool, tmp_path: Path) -> None:
    facts = read_facts(shot(tmp_path / "a.jpg", maker, pitch_deg=47.5, altitude_m=61.25, elements=elements))
    assert facts.raw == maker.upper() and facts.thermal and not facts.visible and not facts.problems
    found = values(facts)
    assert found["pitch_deg"] == 47.5 and found["altitude_m"] == 61.25
    assert found["captured"] == "2026-01-12T06:30:00"
    assert found["latitude_deg"] == pytest.approx(46.2) and found["longitude_deg"] == pytest.approx(15.1)
    assert found["hfov_deg"] == pytest.approx(fov_of_35mm(40, (160, 128)), abs=1e-3)


def test_other_pictures_are_not_radiometric(tmp_path: Path) -> None:
    for marker, data in ((0xE1, b"Exif\0\0" + bytes(100)), (0xE3, bytes(100))):
        path = plain_jpeg(tmp_path / "a.jpg")
        jpeg = path.read_bytes()
        path.write_bytes(jpeg[:2] + segment_bytes(marker, data) + jpeg[2:])
        assert read_facts(path).raw == ""


def test_the_laser_counts_more_than_the_height_above_take_off(tmp_path: Path) -> None:
    fact = read_facts(shot(tmp_path / "a.jpg", pitch_deg=30.0, altitude_m=80.0, laser_m=100.0)).facts["altitude_m"]
    assert fact.value == pytest.approx(50.0) and "LRFTargetDistance" in fact.source
    level = read_facts(shot(tmp_path / "b.jpg", pitch_deg=5.0, altitude_m=80.0, laser_m=900.0)).facts["altitude_m"]
    assert level.value == 80.0


@pytest.mark.parametrize(
    ("changes", "code", "missing"),
    [
        ({"altitude_m": -3.0}, "flight-altitude", "altitude_m"),
        ({"altitude_m": 0.0}, "flight-altitude", "altitude_m"),
        ({"pitch_deg": 130.0}, "flight-pitch", "pitch_deg"),
        ({"pitch_deg": -99.0}, "flight-pitch", "pitch_deg"),
    ],
)
def test_values_that_cannot_be_are_left_out(changes: dict[str, float], code: str, missing: str, tmp_path: Path) -> None:
    facts = read_facts(shot(tmp_path / "a.jpg", **changes))
    assert [p.code for p in facts.problems] == [code] and missing not in facts.facts


def test_a_camera_that_looks_up_has_a_negative_pitch(tmp_path: Path) -> None:
    assert read_facts(shot(tmp_path / "a.jpg", pitch_deg=-20.0)).value("pitch_deg") == -20.0


def test_the_time_in_utc_gives_the_time_zone(tmp_path: Path) -> None:
    facts = read_facts(shot(tmp_path / "a.jpg", utc=datetime(2026, 1, 12, 5, 30, 1)))
    assert facts.facts["captured"].value == "2026-01-12T06:30:00+01:00"


def test_the_35_mm_equivalent_is_that_of_the_diagonal() -> None:
    # DJI's M30T: 9.1 mm and 12 um pixels, 640 across; it states 40 mm.
    exact = math.degrees(2 * math.atan(640 * 0.012 / 2 / 9.1))
    assert fov_of_35mm(40, (640, 512)) == pytest.approx(exact, abs=0.2)


RESOURCE = b"""<rdf:Description rdf:about="" xmlns:d="%s"><d:CameraOrientationNED rdf:parseType="Resource">
<d:Roll>1.5</d:Roll><d:Pitch>-60.0</d:Pitch><d:Yaw>10</d:Yaw></d:CameraOrientationNED>
<d:RelativeAltitude>80</d:RelativeAltitude></rdf:Description>"""
ATTRIBUTES = b"""<rdf:Description rdf:about="" xmlns:d="%s" d:RelativeAltitude="80">
<d:CameraOrientationFLU d:Roll="9" d:Pitch="9" d:Yaw="9"/>
<d:CameraOrientationNED d:Roll="1.5" d:Pitch="-60.0" d:Yaw="10"/></rdf:Description>"""
NESTED = b"""<rdf:Description rdf:about="" xmlns:d="%s" d:RelativeAltitude="80"><d:CameraOrientationNED>
<rdf:Description d:Roll="1.5" d:Pitch="-60.0" d:Yaw="10"/></d:CameraOrientationNED></rdf:Description>"""
DJIS = (
    b'<rdf:Description rdf:about="" xmlns:d="%s" d:GimbalPitchDegree="-60.0" d:GimbalRollDegree="1.5" '
    b'd:GimbalYawDegree="10" d:RelativeAltitude="+80" d:GpsLatitude="47.1" d:GpsLongtitude="9.1"/>'
)
PARROTS = (
    b'<rdf:Description rdf:about="" xmlns:d="%s" xmlns:c="http://pix4d.com/camera/1.0/" d:CameraPitchDegree="-60.0" '
    b'd:CameraRollDegree="1.5" d:CameraYawDegree="10" c:Pitch="30.0" c:AboveGroundAltitude="20971520/262144"/>'
)
PIX4DS = (
    b'<rdf:Description rdf:about="" xmlns:d="%s" d:Pitch="30.0" d:Roll="1.5" d:Yaw="10" d:AboveGroundAltitude="80"/>'
)
SKYDIO = b"https://www.skydio.com/drone-skydio/1.0/"


@pytest.mark.parametrize(
    ("make", "text", "namespace"),
    [
        ("Autel Robotics", DJIS, b"http://www.autelrobotics.com/drone/1.0/"),
        ("Autel Robotics", DJIS, b"http://www.dji.com/drone-dji/1.0/"),
        ("Autel Robotics", PIX4DS, b"http://pix4d.com/camera/1.0"),
        ("Parrot", PARROTS, b"http://www.parrot.com/drone-parrot/1.0/"),
        ("Skydio", RESOURCE, SKYDIO), ("Skydio", ATTRIBUTES, SKYDIO), ("Skydio", NESTED, SKYDIO),
    ],
)  # fmt: skip
def test_pitch_and_height_of_other_makers(make: str, text: bytes, namespace: bytes, tmp_path: Path) -> None:
    path = plain_jpeg(tmp_path / "a.jpg", (640, 512), {0x010F: make})
    facts = read_facts(with_xmp(path, HEAD + text % namespace + TAIL))
    found = values(facts)
    assert (found["pitch_deg"], found["roll_deg"], found["yaw_deg"], found["altitude_m"]) == (60.0, 1.5, 10.0, 80.0)
    assert not facts.problems and facts.from_a_drone_camera


def test_pix4ds_angles_of_unknown_makers_are_not_read(tmp_path: Path) -> None:
    path = plain_jpeg(tmp_path / "a.jpg", (640, 512), {0x010F: "Yuneec"})
    facts = read_facts(with_xmp(path, HEAD + PIX4DS % b"http://pix4d.com/camera/1.0/" + TAIL))
    assert "pitch_deg" not in facts.facts and [p.code for p in facts.problems] == ["flight-unread"]


GPS = {1: "N", 2: (47.0, 6.0, 0.0), 3: "E", 4: (9.0, 6.0, 0.0), 7: (19.0, 0.0, 1.0), 29: "2024:05:14"}


@pytest.mark.parametrize(
    ("local", "expected"),
    [
        ("2024:05:14 21:00:00", "2024-05-14T21:00:00+02:00"),  # a zone away
        ("2024:05:14 21:07:00", "2024-05-14T19:00:01+00:00"),  # a wrong clock: the satellites' time
        ("", "2024-05-14T19:00:01+00:00"),
    ],
)
def test_the_time_of_the_satellites_counts(local: str, expected: str, tmp_path: Path) -> None:
    path = plain_jpeg(tmp_path / "a.jpg", (640, 512), {0x010F: "Autel Robotics"})
    facts = read_facts(with_exif(path, detail={0x9003: local} if local else {}, gps=GPS))
    assert facts.facts["captured"].value == expected and "EXIF GPSTimeStamp" in facts.facts["captured"].source


@pytest.mark.parametrize(
    ("make", "model", "size_wh", "fov"),
    [
        ("DJI", "MAVIC2-ENTERPRISE-ADVANCED", (640, 512), 46.2),
        ("DJI", "MAVIC2-ENTERPRISE-ADVANCED", (1600, 1200), None),  # its camera for visible light
        ("Skydio", "VT300-Z_40IR", (640, 512), 31.5),
        ("Autel Robotics", "XL709", (640, 512), 32.9),
        ("DJI", "FLIR", (640, 512), None),
        ("DJI", "M9X", (640, 512), None),
    ],
)
def test_the_lens_of_a_known_model(
    make: str, model: str, size_wh: tuple[int, int], fov: float | None, tmp_path: Path
) -> None:
    facts = read_facts(plain_jpeg(tmp_path / "a.jpg", size_wh, {0x010F: make, 0x0110: model}))
    assert facts.value("hfov_deg") == (None if fov is None else pytest.approx(fov, abs=0.05))
    assert fov is None or f"EXIF Model {model}: " in facts.facts["hfov_deg"].source
    lenses = [p.found for p in facts.problems]
    sold = "DJI FLIR, sold with several lenses (dji-xt2-13, dji-xt2-19, dji-xt2-25), does not state its own"
    assert lenses == ([sold] if model == "FLIR" else [])


@pytest.mark.parametrize(("per_unit", "unit", "fov"), [(2116.67, 2, 32.9), (83.333, 4, 32.9), (72.0, 2, None)])
def test_a_focal_length_with_the_resolution_of_the_detector(
    per_unit: float, unit: int, fov: float | None, tmp_path: Path
) -> None:
    path = plain_jpeg(tmp_path / "a.jpg", (640, 512), {0x010F: "Nobody"})
    facts = read_facts(with_exif(path, detail={0x920A: 13.0, 0xA20E: per_unit, 0xA210: unit}))
    assert facts.value("hfov_deg") == (None if fov is None else pytest.approx(fov, abs=0.05))


@pytest.mark.parametrize(
    ("detail", "gps"),
    [
        ({0x9003: "1970:01:01 00:00:10", 0xA405: 13, 0x920A: 13.0}, {}),
        ({}, {2: (47.0, 6.0, 0.0), 4: (9.0, 6.0, 0.0)}),
    ],
)
def test_values_that_say_nothing_are_no_facts(
    detail: dict[int, object], gps: dict[int, object], tmp_path: Path
) -> None:
    """A clock that was never set, a place without hemispheres, and a focal length repeated as its equivalent."""
    path = plain_jpeg(tmp_path / "a.jpg", (640, 512), {0x010F: "Autel Robotics"})
    assert read_facts(with_exif(path, detail=detail, gps=gps)).facts == {}


def test_digital_zoom_narrows_the_view() -> None:
    assert math.tan(math.radians(zoomed(40, 2) / 2)) == pytest.approx(math.tan(math.radians(20)) / 2)


def test_extended_xmp_is_joined_in_the_order_of_its_offsets(tmp_path: Path) -> None:
    text = HEAD + b'<rdf:Description xmlns:d="%s" d:GimbalPitchDegree="-33.0"/>' % DJI.encode() + TAIL
    guid = b"0123456789ABCDEF0123456789ABCDEF"
    main = HEAD + b'<rdf:Description xmlns:n="http://ns.adobe.com/xmp/note/" n:HasExtendedXMP="%s"/>' % guid + TAIL
    parts = []
    for at in (100, 0):
        chunk = text[at:] if at else text[:100]
        size = len(text).to_bytes(4, "big") + at.to_bytes(4, "big")
        parts.append(segment_bytes(APP1, EXTENDED + guid + size + chunk))
    path = plain_jpeg(tmp_path / "a.jpg")
    data = path.read_bytes()
    whole = data[:2] + b"".join(parts) + segment_bytes(APP1, STANDARD + main) + data[2:]
    path.write_bytes(whole)
    assert read_facts(path).value("pitch_deg") == 33.0
    path.write_bytes(whole.replace(len(text).to_bytes(4, "big") + bytes(4), (999).to_bytes(4, "big") + bytes(4)))
    assert [p.code for p in read_facts(path).problems] == ["xmp-extended"]


BOMB = b"<!DOCTYPE x [" + b"".join(b'<!ENTITY a%d "%s">' % (k, b"&a%d;" % (k - 1) * 10) for k in range(1, 9)) + b"]>"
OUTSIDE = b'<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>'


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (BOMB + HEAD + b"&a8;" + TAIL, "xmp-forbidden"),
        (OUTSIDE + HEAD + b"&e;" + TAIL, "xmp-forbidden"),
        (HEAD, "xmp-unreadable"),
        (b"", "xmp-unreadable"),
        (b"\xff\xfe\x00", "xmp-unreadable"),
        (HEAD + b"<a>" * 15_000, "xmp-unreadable"),
    ],
)
def test_hostile_xmp_is_refused_and_the_rest_is_read(text: bytes, code: str, tmp_path: Path) -> None:
    facts = read_facts(with_xmp(shot(tmp_path / "a.jpg"), text))
    assert [p.code for p in facts.problems] == [code] and facts.value("pitch_deg") == 60.0


@pytest.mark.parametrize("slash", ["", "/"])
@pytest.mark.parametrize("before", ["", '<?xml version="1.0" encoding="UTF-8"?>'])
@pytest.mark.parametrize("prefix", ["Camera", "p4"])
@pytest.mark.parametrize("note", ["", "<n:Note>Night &amp; Day</n:Note>", "<n:Note>Night & Day &x</n:Note>"])
def test_xmp_as_other_programs_write_it(slash: str, before: str, prefix: str, note: str, tmp_path: Path) -> None:
    """A final slash of the namespace, another prefix, a declaration behind the packet's header, a bare `&`."""
    jpeg = plain_jpeg(tmp_path / "a.jpg", exif={0x010F: "FLIR"})
    angles = "".join(f"<{prefix}:{k}>{v}/100</{prefix}:{k}>" for k, v in {"Pitch": -4500, "Roll": 200}.items())
    text = (
        f'<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?>{before}{HEAD.decode()}<rdf:Description xmlns:n="urn:n" '
        f'xmlns:{prefix}="http://pix4d.com/camera/1.0{slash}">{note}{angles}</rdf:Description>{TAIL.decode()}'
    )
    facts = read_facts(with_xmp(jpeg, text.encode()))
    assert (facts.value("pitch_deg"), facts.value("roll_deg")) == (45.0, 2.0) and not facts.problems


def test_more_xmp_than_any_camera_writes_is_not_parsed(tmp_path: Path) -> None:
    path = plain_jpeg(tmp_path / "a.jpg")
    data = path.read_bytes()
    big = segment_bytes(APP1, STANDARD + b" " * 60_000) * (MAX_BYTES // 60_000 + 1)
    path.write_bytes(data[:2] + big + data[2:])
    assert [p.code for p in read_xmp(read_header(path)).problems] == ["xmp-too-large"]


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"\x89PNG", "jpeg-missing"),
        (b"\xff\xd8", "jpeg-truncated"),
        (b"\xff\xd8\xff\xe1\xff\xff" + bytes(100), "jpeg-truncated"),
        (b"\xff\xd8\xff\xe1\x00\x01" + bytes(100), "jpeg-length"),
        (b"\xff\xd8" + b"\xff" * 500, "jpeg-truncated"),
        (b"\xff\xd8" + b"\xff\xe5\x00\x02" * 5000, "jpeg-segments"),
        (b"\xff\xd8\xff\xda", "jpeg-truncated"),
        (b"\xff\xd8\xff\xc0\x00\x04\x08\x00\xff\xda", "jpeg-length"),
        (b"\xff\xd8\xff\xc0\x00\x0b\x08\x00\x00\x00\x00\x01\x01\x11\x00\xff\xda", "jpeg-truncated"),
    ],
)
def test_lengths_that_lie_are_named(data: bytes, code: str, tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(data)
    with pytest.raises(DatasetError) as caught:
        read_header(path)
    assert [p.code for p in caught.value.problems] == [code]
