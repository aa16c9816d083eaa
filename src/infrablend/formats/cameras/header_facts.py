"""What one picture's file states about how it was taken, each fact with the tag that it comes from."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta, timezone
from pathlib import Path

from infrablend.config.camera_models import OPTICS, models_of_header
from infrablend.core.camera import fov_of_width, is_plausible_roll, pitch_of_gimbal, roll_of_gimbal
from infrablend.errors import DatasetError, Problem
from infrablend.formats.cameras.exif import Exif, read_exif
from infrablend.formats.cameras.flir_block import SIGNATURE, CameraRecord, FlirBlock
from infrablend.formats.cameras.jpeg_segments import APP1, JpegHeader, read_header
from infrablend.formats.cameras.raw_temperatures import dji_segments
from infrablend.formats.cameras.xmp import Xmp, read_xmp
from infrablend.formats.values import is_place, to_number

FIELDS = (
    "pitch_deg",
    "roll_deg",
    "yaw_deg",
    "flight_yaw_deg",
    "altitude_m",
    "hfov_deg",
    "captured",
    "latitude_deg",
    "longitude_deg",
    "time_of_day",
)
"""Facts in the order of tables. Pitch is the angle below the horizon, the height is that above the ground."""

DJI = "http://www.dji.com/drone-dji/1.0/"
FLIR = "http://ns.flir.com/xmp/1.0/"
PIX4D = "http://pix4d.com/camera/1.0/"
AUTEL = "http://www.autelrobotics.com/drone/1.0/"
PARROT = "http://www.parrot.com/drone-parrot/1.0/"
SKYDIO = "https://www.skydio.com/drone-skydio/1.0/"
# Words of the addresses of makers' namespaces, which differ between firmwares.
_MAKERS = {"drone-dji": DJI, "autel": AUTEL, "drone-parrot": PARROT, "skydio": SKYDIO}
UTC_AT_EXPOSURE = (DJI, "UTCAtExposure")
UTC_TAG = "XMP drone-dji:UTCAtExposure"
GPS_TIME = "EXIF GPSTimeStamp"
UNREAD = "flight-unread"
"""Code of the warning about properties that look like pitch or height, of an unknown meaning."""
EXIF_TIME = "EXIF DateTimeOriginal"
_CLOCK_NEVER_SET = date(1970, 1, 1)
_QUARTER = timedelta(minutes=15)
_MOST_OFF = timedelta(minutes=1)
_XMP_DATES = (("http://ns.adobe.com/xap/1.0/", "CreateDate"), ("http://ns.adobe.com/xap/1.0/", "ModifyDate"))
# Below this pitch a laser that points along the camera's axis hits the ground too far away to give a height.
_LEAST_LASER_PITCH_DEG = 15.0
# DJI's range finders reach 3 km.
_MOST_LASER_M = 5_000.0
# A relative height below this is a drone that flew into a valley, or a barometer that drifted: no height over ground.
_LEAST_ALTITUDE_M = 0.0
_MOST_ALTITUDE_M = 1e5
# Laser and barometer differ with the terrain; by more than this factor, one of them measured something else.
_LASER_FACTOR = 2.0
# Statements about one lens agree to a few per cent; rounding of the 35 mm equivalent is below 3 % from 15 mm on.
_LENS_FACTOR = 1.15
# A picture that was only scaled keeps the ratio of its sides but for rounding.
_SAME_RATIO = 0.01
# Cameras state the focal length of the 35 mm camera with the same diagonal field of view, as EXIF asks: 9.1 mm on
# 640x512 pixels of 12 um are 40 mm (diagonal), not 43 mm (width).
_DIAGONAL_35MM = math.hypot(36.0, 24.0)
# Pitch of the pixels, micrometres, where the file states neither a field of view nor a 35 mm equivalent: the FLIR core
# inside the XT2. Maker and model as in EXIF, and the size of the picture in pixels.
_PIXEL_PITCH_UM = {("DJI", "FLIR", (640, 512)): 17.0, ("DJI", "FLIR", (336, 256)): 17.0}
_NUMBER = re.compile(r"([+-]?\d{1,15}(?:\.\d{0,15})?(?:[eE][+-]?\d{1,3})?)(?:/(\d{1,15}))?", re.ASCII)
_OFFSET = re.compile(r"([+-])(0\d|1[0-4]):([0-5]\d)", re.ASCII)
_EXIF_DATE = re.compile(r"(\d{4})[:\-](\d\d)[:\-](\d\d)[ T](\d\d):(\d\d):(\d\d)", re.ASCII)
# DJI's cameras end file names with the lens: wide, zoom, visible; T and R are thermal.
_VISIBLE_NAME = re.compile(r"_([WZVS])(?:_\d+)?$", re.ASCII)
_THERMAL_NAME = re.compile(r"_(T|R|IR|THRM)(?:_\d+)?$", re.ASCII)


# Angles of the camera in degrees, north-east-down: pitch 0 level, -90 straight down. Autel's names are DJI's. Sources:
# developer.parrot.com (photo metadata), support.skydio.com (camera and metadata overview), OpenAthena's readers.
_ANGLES = (
    (DJI, "Gimbal{}Degree"),
    (AUTEL, "Gimbal{}Degree"),
    (PARROT, "Camera{}Degree"),
    (SKYDIO, "CameraOrientationNED:{}"),
)
# Heading of the aircraft, which Autel spells as DJI does.
_FLIGHT_YAWS = ((DJI, "FlightYawDegree"), (AUTEL, "FlightYawDegree"))
_HEIGHTS = (
    (DJI, "RelativeAltitude"),
    (AUTEL, "RelativeAltitude"),
    (SKYDIO, "RelativeAltitude"),
    (FLIR, "MAVRelativeAltitude"),
    (PIX4D, "AboveGroundAltitude"),
)
_LATITUDES = ((DJI, "GpsLatitude"), (AUTEL, "GpsLatitude"), (SKYDIO, "Latitude"))
# With DJI's own spelling, which Autel has taken over.
_LONGITUDES = (
    *((maker, name) for maker in (DJI, AUTEL) for name in ("GpsLongitude", "GpsLongtitude")),
    (SKYDIO, "Longitude"),
)
_FOCAL_LENGTHS_PX = (
    (DJI, "CalibratedFocalLength"),
    (AUTEL, "CalibratedFocalLength"),
    (SKYDIO, "CalibratedFocalLength:X"),
)
# Properties that are numbers; a text in one of them is a fault of the file.
_NUMBERS = (
    *((maker, name.format(axis)) for axis in ("Pitch", "Roll", "Yaw") for maker, name in _ANGLES),
    *_HEIGHTS,
    (DJI, "LRFTargetDistance"),
    *_FLIGHT_YAWS,
    *_LATITUDES,
    *_LONGITUDES,
    *_FOCAL_LENGTHS_PX,
)
_PREFIXES = {
    DJI: "drone-dji",
    FLIR: "FLIR",
    PIX4D: "Camera",
    AUTEL: "drone",
    PARROT: "drone-parrot",
    SKYDIO: "drone-skydio",
}
# What properties of other makers are called that state a fact; the aircraft's own pitch is not the camera's.
_UNREAD_NAMES = {
    "pitch_deg": re.compile(
        r"(.*:)?(gimbal|camera|payload|mount)?_?(pitch|tilt)_?(angle)?_?(degrees?|deg)?", re.IGNORECASE
    ),
    "altitude_m": re.compile(
        r".*(rel(ative)?_?(alt|height)|above_?(ground|take_?off|home)|(alt|altitude|height)_?agl).*", re.IGNORECASE
    ),
}
# Pixels of detectors; what EXIF states beyond is a unit or a resolution of something else.
_LEAST_PITCH_UM = 0.5
_MOST_PITCH_UM = 60.0
# Positions of EXIF and XMP are rounded differently; degrees.
_PLACES_APART_DEG = 0.005


@dataclass(frozen=True)
class Fact:
    """A value, and the tag or tags that it comes from."""

    value: float | str
    source: str


@dataclass(frozen=True)
class CameraFacts:
    """What one picture's file states.

    Attributes:
        path: The file.
        size_wh: Width and height of the picture in pixels.
        camera: Maker and model; empty if not stated.
        raw: `DJI` or `FLIR` for a picture with a radiometric layer; empty for others.
        thermal: Whether the file itself says that the picture is thermal.
        visible: Why the picture is one of visible light; empty if nothing says so.
        facts: Known facts by name, see `FIELDS`.
        clocks: Times of capture without time zone by their tag.
        problems: Faults of the file, as warnings.
        zoom: Digital zoom of the picture; the radiometric layer has none.
        turned: Whether EXIF says that the picture is to be turned; nothing says so of the radiometric layer.
        utc: Time of capture in UTC, without time zone; None if not stated.
        utc_tag: Tag of that time.
    """

    path: Path
    size_wh: tuple[int, int]
    camera: str
    raw: str
    thermal: bool
    visible: str
    facts: Mapping[str, Fact]
    clocks: Mapping[str, datetime]
    problems: tuple[Problem, ...]
    zoom: float = 1.0
    turned: bool = False
    utc: datetime | None = None
    utc_tag: str = UTC_TAG

    @property
    def from_a_drone_camera(self) -> bool:
        """Whether the file looks like one of a drone's or a FLIR camera, or states flight data."""
        maker = self.camera.split(" ")[0].upper()
        known = maker in ("DJI", "FLIR", "AUTEL", "PARROT", "SKYDIO", "YUNEEC")
        return bool(self.raw) or known or "pitch_deg" in self.facts or any(p.code == UNREAD for p in self.problems)

    @property
    def states_a_fact(self) -> bool:
        """Whether camera, lens, place or time of capture are stated, or the file looks like a drone's."""
        stated = EXIF_TIME in self.clocks or not self.facts.keys().isdisjoint(("hfov_deg", "latitude_deg"))
        return bool(self.camera) or stated or self.from_a_drone_camera

    def value(self, name: str) -> float | None:
        """Return a known number, or None."""
        fact = self.facts.get(name)
        return None if fact is None or isinstance(fact.value, str) else fact.value


def read_facts(path: Path) -> CameraFacts:
    """Return what a picture's file states; only headers are read.

    Raises:
        DatasetError: The file is no JPEG file, or its segments contradict themselves; with one problem.
    """
    header = read_header(path)
    exif = read_exif(header)
    xmp = _with_known_makers(read_xmp(header))
    problems = [*exif.problems, *xmp.problems]
    record = _camera_record(header, problems)
    raw = "FLIR" if header.find(APP1, SIGNATURE) else "DJI" if dji_segments(header) else ""
    facts: dict[str, Fact] = {}
    for key in _NUMBERS:
        if (text := xmp.values.get(key)) and _as_number(text) is None:
            found = f"XMP {_PREFIXES[key[0]]}:{key[1]} {text[:40]!r}, left out"
            problems.append(_warning(path, "flight-value", found, "a number"))

    def warn(*found: str) -> None:
        problems.append(_warning(path, *found))

    for add in (_add_angles, _add_altitude):
        add(facts, exif, xmp, warn)
    _warn_of_unread(facts, xmp, warn)
    _add_field_of_view(facts, exif, xmp, record, header.size_wh, warn)
    clocks = _clocks(exif, xmp)
    utc = _as_time(xmp.values.get(UTC_AT_EXPOSURE, ""))
    utc_tag = UTC_TAG if utc else GPS_TIME
    utc = utc or _as_time(exif.gps_time)
    _add_time(facts, exif, record, clocks, utc, utc_tag)
    _add_place(facts, exif, xmp, warn)
    source = xmp.values.get((DJI, "ImageSource"), "")
    infrared = "infrared" in source.lower() or "thermal" in source.lower()
    name_says = _VISIBLE_NAME.search(path.stem.upper())
    visible = ""
    if source and not infrared:
        visible = f"ImageSource {source[:40]}"
    elif name_says and not raw and not infrared and exif.make.upper() in ("", "DJI"):
        visible = f"file name ends in _{name_says[1]}"
    return CameraFacts(
        path,
        header.size_wh,
        " ".join(dict.fromkeys(p for p in (exif.make, exif.model.strip("* ")) if p)),
        raw,
        bool(raw) or infrared or _THERMAL_NAME.search(path.stem.upper()) is not None,
        visible,
        facts,
        clocks,
        tuple(problems),
        max(1.0, exif.zoom or 1.0),
        exif.turned,
        utc,
        utc_tag,
    )


def _with_known_makers(xmp: Xmp) -> Xmp:
    """Return the properties with one namespace per maker."""
    found = {w: [ns for ns, _ in xmp.values if w in ns.lower()] for w in _MAKERS}
    makers = {ns: _MAKERS[word] for word, spelled in found.items() for ns in spelled}
    return Xmp({(makers.get(ns, ns), name): text for (ns, name), text in xmp.values.items()}, xmp.problems)


Warn = Callable[[str, str, str], None]


def _warning(path: Path, code: str, found: str, expected: str) -> Problem:
    return Problem(path.name, code, found, expected, severity="warning")


def _camera_record(header: JpegHeader, problems: list[Problem]) -> CameraRecord | None:
    if not header.find(APP1, SIGNATURE):
        return None
    try:
        return FlirBlock(header).camera()
    except DatasetError as error:
        problems += [Problem(p.where, p.code, p.found, p.expected, p.todo, "warning") for p in error.problems]
        return None


def _xmp_number(xmp: Xmp, *names: tuple[str, str]) -> tuple[float, str] | None:
    for namespace, name in names:
        found = _as_number(xmp.values.get((namespace, name)))
        if found is not None:
            return found, f"XMP {_PREFIXES[namespace]}:{name}"
    return None


def _as_number(text: str | None) -> float | None:
    """Return the number in the text of a property, which may be a fraction such as `475/10`; None for anything else."""
    match = _NUMBER.fullmatch(text) if text else None
    if match is None or (match[2] is not None and not int(match[2])):
        return None
    return to_number(float(match[1]) / int(match[2] or 1))


def _is_flir(exif: Exif) -> bool:
    return exif.make.upper().startswith("FLIR")


def _angle(exif: Exif, xmp: Xmp, axis: str) -> tuple[float, str] | None:
    """Return an angle of the camera: `Pitch`, `Roll` or `Yaw`."""
    names = [(maker, name.format(axis)) for maker, name in _ANGLES]
    found = _xmp_number(xmp, *names)
    # Pix4D's names are used with several zeros; known are FLIR's use of them, MAVLink's, and that of Autel's older
    # firmware and of Parrot, which is Pix4D's own: 0 straight down, 90 level.
    pix4d = _xmp_number(xmp, (PIX4D, axis)) if found is None else None
    if pix4d is None or _is_flir(exif):
        return found or pix4d
    value, source = pix4d
    if not exif.make.upper().startswith(("AUTEL", "PARROT")):
        return None
    return (value - 90.0, source) if axis == "Pitch" else pix4d


def _add_angles(facts: dict[str, Fact], exif: Exif, xmp: Xmp, warn: Warn) -> None:
    pitch = _angle(exif, xmp, "Pitch")
    below = None
    if pitch is not None:
        below = pitch_of_gimbal(pitch[0])
        if -90.0 <= below <= 90.0:
            facts["pitch_deg"] = Fact(round(below, 6), pitch[1])
        else:
            warn("flight-pitch", f"{pitch[1]} {pitch[0]:g}, left out", "-90 (straight down) to 90 degrees")
    roll = _angle(exif, xmp, "Roll")
    if roll is not None:
        turned = roll_of_gimbal(roll[0])
        if abs(roll[0]) <= 360.0 and is_plausible_roll(turned, below):
            facts["roll_deg"] = Fact(round(turned, 6), roll[1])
        else:
            warn("flight-roll", f"{roll[1]} {roll[0]:g}, left out", "-45 to 45 degrees, or any near straight down")
    for name, yaw in (("yaw_deg", _angle(exif, xmp, "Yaw")), ("flight_yaw_deg", _xmp_number(xmp, *_FLIGHT_YAWS))):
        if yaw is not None and abs(yaw[0]) <= 360.0:
            facts[name] = Fact(*yaw)


def _add_altitude(facts: dict[str, Fact], exif: Exif, xmp: Xmp, warn: Warn) -> None:
    """Add the height above the ground: from the laser if it hit it, else that above take-off."""
    relative = _xmp_number(xmp, *_HEIGHTS)
    laser = _xmp_number(xmp, (DJI, "LRFTargetDistance"))
    pitch = facts.get("pitch_deg")
    status = xmp.values.get((DJI, "LRFStatus"), "Normal")
    if laser is not None and laser[0] > 0 and status == "Normal" and pitch is not None:
        assert isinstance(pitch.value, float)
        if laser[0] > _MOST_LASER_M:
            found = f"{laser[1]} {laser[0]:g} m, left out"
            warn("flight-laser", found, f"at most {_MOST_LASER_M:g} m")
        elif pitch.value >= _LEAST_LASER_PITCH_DEG:
            height = laser[0] * math.sin(math.radians(pitch.value))
            facts["altitude_m"] = Fact(round(height, 3), f"{laser[1]} and pitch")
            if relative is not None and _are_apart(height, relative[0], _LASER_FACTOR):
                found = (
                    f"{laser[1]} gives a height of {height:.1f} m, {relative[1]} {relative[0]:g} m; the laser is used"
                )
                warn("flight-laser", found, "heights that differ by the terrain")
            return
    if relative is not None:
        if _LEAST_ALTITUDE_M < relative[0] <= _MOST_ALTITUDE_M:
            facts["altitude_m"] = Fact(round(relative[0], 6), relative[1])
        else:
            found = f"{relative[1]} {relative[0]:g} m, left out"
            warn("flight-altitude", found, "a height above take-off")


def _warn_of_unread(facts: Mapping[str, Fact], xmp: Xmp, warn: Warn) -> None:
    """Warn of a property that looks like a fact that no known one states: its zero and its sign are not known."""
    for name, pattern in _UNREAD_NAMES.items():
        likely = [
            (key, text)
            for key, text in xmp.values.items()
            if name not in facts and key not in _NUMBERS and pattern.fullmatch(key[1]) and _as_number(text) is not None
        ]
        for (namespace, local), text in likely[:1]:
            warn(UNREAD, f"XMP {local} {text[:40]!r} ({namespace}) is not read", f"a maker whose {local} is known")


def _are_apart(one: float, other: float, factor: float) -> bool:
    """Return whether two numbers above 0 differ by more than a factor; a number that is not above 0 says nothing."""
    return min(one, other) > 0 and max(one, other) > factor * min(one, other)


def _add_field_of_view(
    facts: dict[str, Fact],
    exif: Exif,
    xmp: Xmp,
    record: CameraRecord | None,
    size_wh: tuple[int, int],
    warn: Warn,
) -> None:
    """Add the field of view, from the first statement about the lens that the file has."""
    if not _is_uncut(exif, size_wh, warn):
        return
    found = _lens_statements(exif, xmp, record, size_wh)
    if not found:
        if sold := models_of_header(exif.make, exif.model, size_wh):
            lenses = f"{exif.make} {exif.model}, sold with several lenses ({', '.join(sold)}), does not state its own"
            warn("flight-lens", lenses, "a focal length, or one of these as camera.model")
        return
    (fov, source), *others = found
    for other, name in others:
        if _are_apart(fov, other, _LENS_FACTOR):
            both = f"{source} gives {fov:.1f} degrees across, {name} {other:.1f}; the first is used"
            warn("flight-lens", both, "one field of view")
    if exif.zoom is not None and exif.zoom > 1:
        fov = zoomed(fov, exif.zoom)
        source = f"{source}, DigitalZoomRatio"
    if 0.1 <= fov <= 170.0:
        facts["hfov_deg"] = Fact(round(fov, 4), source)


def _lens_statements(
    exif: Exif, xmp: Xmp, record: CameraRecord | None, size_wh: tuple[int, int]
) -> list[tuple[float, str]]:
    """Return what the file states about the lens as fields of view without zoom, the most reliable first."""
    found = []
    pitch_um = _PIXEL_PITCH_UM.get((exif.make, exif.model, size_wh))
    if pitch_um is None and _LEAST_PITCH_UM <= (exif.pixel_pitch_um or 0.0) <= _MOST_PITCH_UM:
        pitch_um = exif.pixel_pitch_um
    calibrated = _xmp_number(xmp, *_FOCAL_LENGTHS_PX)
    # The real focal length again is no equivalent of it on a detector far below 36 mm.
    if exif.focal_length_35mm is not None and exif.focal_length_35mm != exif.focal_length_mm:
        found.append((fov_of_35mm(exif.focal_length_35mm, size_wh), "EXIF FocalLengthIn35mmFilm"))
    if record is not None and record.hfov_deg is not None:
        found.append((record.hfov_deg, "FLIR FieldOfView"))
    if exif.focal_length_mm is not None and pitch_um is not None:
        fov = fov_of_width(pitch_um * size_wh[0] / 1000, exif.focal_length_mm)
        found.append((fov, f"EXIF FocalLength, {pitch_um:g} um pixels"))
    if calibrated is not None and calibrated[0] > 0:
        found.append((fov_of_width(size_wh[0], calibrated[0]), calibrated[1]))
    models = models_of_header(exif.make, exif.model, size_wh)
    if len(models) == 1:
        optics = OPTICS[models[0]]
        lens = f"{optics.focal_length_mm:g} mm, {optics.pixel_pitch_um:g} um pixels"
        fov = fov_of_width(optics.sensor_width_mm, optics.focal_length_mm)
        found.append((fov, f"EXIF Model {exif.model}: {lens}"))
    return found


def fov_of_35mm(focal_length_35mm: float, size_wh: tuple[int, int]) -> float:
    """Return the horizontal field of view, degrees, of a 35 mm equivalent focal length in mm."""
    width_mm = _DIAGONAL_35MM * size_wh[0] / math.hypot(*size_wh)
    return fov_of_width(width_mm, focal_length_35mm)


def zoomed(hfov_deg: float, zoom: float) -> float:
    """Return the field of view, degrees, that is left of one by digital zoom."""
    return math.degrees(2 * math.atan(math.tan(math.radians(hfov_deg) / 2) / zoom))


def _is_uncut(exif: Exif, size_wh: tuple[int, int], warn: Warn) -> bool:
    """Return whether the picture shows all that the lens saw; a program may have cropped or turned it and kept EXIF."""
    if exif.size_wh is None or exif.size_wh == size_wh:
        return True
    (w, h), (was_w, was_h) = size_wh, exif.size_wh
    sizes = f"{w}x{h} pixels, but EXIF says {was_w:g}x{was_h:g}"
    if abs(w * was_h / (h * was_w) - 1) <= _SAME_RATIO:
        warn("flight-size", f"{sizes}; taken as scaled, not cropped", "the picture as the camera wrote it")
        return True
    warn("flight-size", f"{sizes}: cropped or turned; field of view left out", "the picture as the camera wrote it")
    return False


def _clocks(exif: Exif, xmp: Xmp) -> dict[str, datetime]:
    """Return the times of capture by their tag, without time zone."""
    texts = {**exif.dates, **{f"XMP xmp:{k[1]}": xmp.values.get(k, "") for k in _XMP_DATES}}
    clocks: dict[str, datetime] = {}
    for tag, text in texts.items():
        if (when := _as_time(text)) is not None:
            clocks[tag] = when
    return clocks


def _as_time(text: str) -> datetime | None:
    match = _EXIF_DATE.match(text)
    try:
        when = datetime(*(int(g) for g in match.groups())) if match else None  # type: ignore[arg-type]
    except ValueError:
        return None
    return None if when is None or when.date() == _CLOCK_NEVER_SET else when


def zone_of(local: datetime, utc: datetime) -> timezone | None:
    """Return the time zone of a local time, from the same time in UTC; None if no zone is that far from UTC.

    Zones differ from UTC by quarters of an hour; the two times may have been taken some seconds apart.
    """
    quarters = round((local - utc) / _QUARTER)
    off = abs(local - utc - quarters * _QUARTER)
    return timezone(quarters * _QUARTER) if abs(quarters) <= 14 * 4 and off <= _MOST_OFF else None


def _flir_zone(local: datetime, stamp: datetime) -> timezone | None:
    """Return the time zone of FLIR's own time stamp, if it is the same moment and its zone was set (not 0)."""
    offset = stamp.utcoffset()
    same = abs(stamp.replace(tzinfo=None) - local) <= timedelta(seconds=2)
    return timezone(offset) if same and offset else None


def _add_time(
    facts: dict[str, Fact],
    exif: Exif,
    record: CameraRecord | None,
    clocks: Mapping[str, datetime],
    utc: datetime | None,
    utc_tag: str,
) -> None:
    original = clocks.get(EXIF_TIME)
    if original is not None:
        source = EXIF_TIME
        zone = None if utc is None else zone_of(original, utc)
        if zone is not None:
            source += f", {utc_tag}"
        elif (zone := _as_zone(exif.offset)) is not None:
            source += ", OffsetTimeOriginal"
        elif utc is not None and utc_tag == GPS_TIME:
            original = utc
            zone = UTC
            source = GPS_TIME
        elif record is not None and record.captured is not None:
            zone = _flir_zone(original, datetime.fromisoformat(record.captured))
            source += "" if zone is None else ", FLIR DateTimeOriginal"
        facts["captured"] = Fact(original.replace(tzinfo=zone).isoformat(), source)
    elif record is not None and record.captured is not None:
        facts["captured"] = Fact(record.captured, "FLIR DateTimeOriginal")
    elif clocks:
        tag, when = next(iter(clocks.items()))
        facts["captured"] = Fact(when.isoformat(), tag)
    elif utc is not None:
        facts["captured"] = Fact(utc.replace(tzinfo=UTC).isoformat(), utc_tag)


def _as_zone(text: str) -> timezone | None:
    match = _OFFSET.fullmatch(text)
    if match is None:
        return None
    offset = timedelta(hours=int(match[2]), minutes=int(match[3]))
    return timezone(-offset if match[1] == "-" else offset)


def _add_place(facts: dict[str, Fact], exif: Exif, xmp: Xmp, warn: Warn) -> None:
    latitude = _xmp_number(xmp, *_LATITUDES)
    longitude = _xmp_number(xmp, *_LONGITUDES)
    known = latitude is not None and longitude is not None and is_place(latitude[0], longitude[0])
    if exif.latitude_deg is not None and exif.longitude_deg is not None:
        facts["latitude_deg"] = Fact(exif.latitude_deg, "EXIF GPSLatitude")
        facts["longitude_deg"] = Fact(exif.longitude_deg, "EXIF GPSLongitude")
        if known and latitude and longitude:
            apart = abs(latitude[0] - exif.latitude_deg), abs(longitude[0] - exif.longitude_deg)
            if max(apart) > _PLACES_APART_DEG:
                both = f"EXIF GPS {exif.latitude_deg:.5f} {exif.longitude_deg:.5f}, {latitude[1]} {latitude[0]:.5f} "
                warn("flight-place", f"{both}{longitude[0]:.5f}; EXIF is used", "one position")
    elif known and latitude and longitude:
        facts["latitude_deg"], facts["longitude_deg"] = Fact(*latitude), Fact(*longitude)
