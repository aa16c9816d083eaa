"""The fields of a recipe, with their units, ranges and defaults.

All models are strict (no silent conversion), frozen, and refuse unknown keys. Angles in degrees and temperatures in
degrees Celsius occur in recipes and on the command line only; the pipeline uses radians and kelvin.

Two settings are modes: `placement.mode` (paper or metric) and `appearance.mode` (artistic or physical). Each mode has
its own classes for the sections that depend on it, so that a recipe has no field without a meaning. A third,
`sensor.profile`, decides whether `sensor` has any further fields. `modes.py` knows which field belongs to which mode.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Final, Literal, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from infrablend.config.agc import Agc
from infrablend.config.camera_models import CameraModel
from infrablend.config.sensor_profile import PROFILES, SensorProfile, find_profile
from infrablend.core.capture import Capture, TimeOfDay
from infrablend.core.format_table import WrittenName
from infrablend.core.scene import LOW_EMISSIVITY
from infrablend.core.strict_model import Strict, in_order, range_of
from infrablend.core.surface_kinds import SurfaceKind
from infrablend.core.temperature import TemperatureScale, Unit
from infrablend.thermal.daytime import STORED_SHARE, between


def _distinct(value: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(value)) != len(value):
        raise ValueError("each item once")
    return value


def _five(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 5:
        raise ValueError("five quantiles: 5, 25, 50, 75 and 95 %")
    return tuple(value)


def _rising(value: tuple[float, ...]) -> tuple[float, ...]:
    if any(a > b for a, b in pairwise(value)):
        raise ValueError("five quantiles in rising order")
    return value


def _known_profile(value: Any) -> Any:
    if isinstance(value, str) and value not in PROFILES:
        raise ValueError(f"one of {', '.join(('off', *PROFILES))}, or the path of a profile's .json or .yaml")
    return value


# ---- Data


class Data(Strict):
    """Temperatures in the backgrounds. What is not stated stays as the dataset's own files have it."""

    unit: Unit | None = None
    """Unit of 16-bit TIFF and PNG pictures: `centikelvin` (0.01 K per count: TLinear in high resolution), `decikelvin`,
    or `counts`, whose scale is `slope` and `offset`. Counts without a slope are only counts, without temperatures."""
    slope: float | None = Field(None, ge=-10, le=10)
    """Kelvin per count, for the unit `counts`; TLinear in low resolution has 0.04."""
    offset: float | None = Field(None, ge=-10_000, le=10_000)
    """Temperature of count 0, kelvin, for the unit `counts`."""

    @model_validator(mode="after")
    def _one_scale(self) -> Self:
        if self.unit is None and (self.slope is not None or self.offset is not None):
            raise ValueError("unit: counts beside slope and offset; found no unit")
        if self.unit is not None:
            self.scale  # noqa: B018  # raises
        return self

    @property
    def scale(self) -> TemperatureScale | None:
        """Scale that is stated; None for counts without one, and where nothing is stated."""
        return None if self.unit is None else TemperatureScale.of_unit(self.unit, self.slope, self.offset)


# ---- Camera


Flight = TypeVar("Flight", "FlightHeight", "FlightNumbers")


def of_flight(entries: Iterable[Flight], picture: Capture) -> Flight | None:
    """Return the first entry that a picture belongs to, by its time of day, height and pitch; None if none fits."""
    for e in entries:
        limits = ((picture.altitude_m, e.below_m), (picture.pitch_deg, e.below_pitch_deg))
        below = all(limit is None or (value is not None and value < limit) for value, limit in limits)
        if below and e.time_of_day in (None, picture.time_of_day):
            return e
    return None


class FixedPitch(Strict):
    """One pitch for all frames."""

    fixed_deg: float = Field(ge=-90, le=100)
    """Depression angle of the camera, degrees: 0 level, 90 straight down, negative looking up."""


class RandomPitch(Strict):
    """A pitch drawn for each frame."""

    random_deg: range_of(-90, 100)  # type: ignore[valid-type]
    """Range of the depression angle, degrees."""


class HorizonPitch(Strict):
    """A pitch found in each background: the row where sky and ground meet. For cameras that look level or up."""

    from_horizon: Literal[True]
    """Take the pitch from the horizon in the picture, where the background's metadata have none."""
    else_deg: range_of(-90, 100) | None = None  # type: ignore[valid-type]
    """Range of the depression angle, degrees, where neither is there; it is drawn so that the horizon is below the
    picture if that shows the sky alone. Without it, nothing is inserted into such backgrounds."""


class FixedAltitude(Strict):
    """One height for all frames."""

    fixed_m: float = Field(gt=0, le=10_000)
    """Height of the camera above the ground, metres."""

    def at(self, share: float) -> float:
        """Return the height, whatever number in [0, 1) was drawn."""
        return self.fixed_m


class RandomAltitude(Strict):
    """A height drawn for each frame."""

    random_m: range_of(0.1, 10_000)  # type: ignore[valid-type]
    """Range of the camera's height above the ground, metres."""

    def at(self, share: float) -> float:
        """Return the height at a drawn share of the range, in [0, 1)."""
        low, high = self.random_m
        return float(low + (high - low) * share)


class Camera(Strict):
    """The virtual camera. It looks at the origin of the scene."""

    is_real: ClassVar[bool] = False
    """Whether it is the background's own camera, above the ground that the picture shows."""

    pitch: Literal["metadata"] | FixedPitch | RandomPitch | HorizonPitch = "metadata"
    """Depression angle: that of each background (`metadata`), `{fixed_deg: 0}`, `{random_deg: [0, 90]}`, or
    `{from_horizon: true, else_deg: [-30, -10]}`."""
    roll_deg: range_of(-180, 180) = (-10.0, 10.0)  # type: ignore[valid-type]
    """Rotation about the optical axis, degrees. Paper: phi_min, phi_max = -10, 10."""
    model: CameraModel | None = None
    """Camera whose focal length and sensor width the file or the settings of a recipe mean, as its maker states them.
    Its pictures show all that the detector sees: not cropped, and without digital zoom."""
    pixel_pitch_um: float | None = Field(None, gt=0, le=1_000)
    """Distance between the detector's pixels, micrometres, as data sheets state it: times the width of `size_px` it
    gives `sensor_width_mm`, for the focal length printed on a lens."""
    focal_length_mm: float = Field(50.0, gt=0, le=10_000)
    """Focal length, mm; together with `sensor_width_mm` it gives the horizontal field of view. For a printed focal
    length set `pixel_pitch_um`, or the real width of the sensor, too. The default, 50 mm on 36 mm, is Blender's; the
    paper states no field of view."""
    sensor_width_mm: float = Field(36.0, gt=0, le=1_000)
    """Width of the sensor, mm; the image's width covers it."""
    size_px: tuple[Annotated[int, Field(ge=16, le=16_384)], Annotated[int, Field(ge=16, le=16_384)]] = (
        640,
        512,
    )
    """Width and height of the images that the recipe is made for. A background of another size is rendered at its own
    size with the same horizontal field of view, and counted in the run record."""

    @property
    def stated_pitch_deg(self) -> tuple[float, float] | None:
        """Range of the pitch that is stated for all pictures; None if each picture has its own."""
        if isinstance(self.pitch, FixedPitch):
            return self.pitch.fixed_deg, self.pitch.fixed_deg
        if isinstance(self.pitch, RandomPitch):
            low, high = self.pitch.random_deg
            return low, high
        return None

    @property
    def horizon(self) -> HorizonPitch | None:
        """How the pitch is found in pictures that state none; None if it is not."""
        return self.pitch if isinstance(self.pitch, HorizonPitch) and self.pitch.from_horizon else None

    @property
    def stated_height_m(self) -> tuple[float, float] | None:
        """Range of the height that is stated for all pictures; None if each has its own, or none is needed."""
        return None

    @property
    def needs_height(self) -> bool:
        """Whether each picture has to state the height of its camera."""
        return False

    @property
    def needs_lens(self) -> bool:
        """Whether each picture of a known camera has to state its field of view."""
        return False

    def lens_mm(self, hfov_deg: float | None) -> float:
        """Return the focal length for a picture of this horizontal field of view (None if unknown)."""
        if hfov_deg is None or not self.needs_lens:
            return self.focal_length_mm
        return self.sensor_width_mm / 2 / math.tan(math.radians(hfov_deg) / 2)


class PaperCamera(Camera):
    """The virtual camera of `placement.mode: paper`: at a drawn distance from the origin of the scene."""

    distance_m: range_of(0.05, 100_000) = (1.0, 10.0)  # type: ignore[valid-type]
    """Distance from the camera to the scene's origin, metres. Paper: D_min, D_max = 1, 10."""


class FlightHeight(Strict):
    """True over stated height in pictures of one time of day, or taken below a height or at a low angle."""

    factor: Annotated[float, Field(ge=0.2, le=5)]
    """True over stated height."""
    time_of_day: Literal["day", "night"] | None = None
    """Time of day of these pictures; any by default."""
    below_m: float | None = Field(None, gt=0)
    """These pictures are stated to be taken below this height, metres; any height by default."""
    below_pitch_deg: float | None = Field(None, gt=-90, le=90)
    """These pictures are stated to have a smaller depression angle than this; any angle by default. Where names round
    angles, a level view is farther away than it seems."""
    spread: float | None = Field(None, gt=0, le=1)
    """Standard deviation of this factor's logarithm; by default that of all pictures."""


class StatedHeights(Strict):
    """How heights in names and tables of the dataset differ from true ones."""

    factor: Annotated[float, Field(ge=0.2, le=5)] = 1.15
    """True over stated height where no annotated object shows it."""
    by_flight: tuple[FlightHeight, ...] = ()
    """Factors for pictures of some times of day and heights: the first entry that fits a picture applies to it, and the
    factor above applies where none fits. Flights differ by their place of take-off."""
    spread: float = Field(0.16, gt=0, le=1)
    """Standard deviation of the factor's logarithm. The smaller it is, the less the objects of one picture count."""
    references: tuple[Literal["person", "car", "bicycle"], ...] = ("person", "car", "bicycle")
    """Classes whose annotated boxes show the true height."""
    box_looseness: Annotated[float, Field(ge=1, le=2)] = 1.0
    """How much wider and higher annotated boxes are than the objects in them (`infrablend profile` measures it)."""


class MetricCamera(Camera):
    """The real camera of `placement.mode: metric`: at a height above the ground."""

    is_real: ClassVar[bool] = True

    roll_deg: range_of(-180, 180) = (-10.0, 10.0)  # type: ignore[valid-type]
    """Rotation about the optical axis, degrees, added to the gimbal's roll if the background's file, table or log
    states it. 0 for a gimbal that holds the horizon."""
    altitude: Literal["metadata"] | FixedAltitude | RandomAltitude = "metadata"
    """Height above the ground: that of each background (`metadata`), `{fixed_m: 60}` or `{random_m: [60, 120]}`."""
    field_of_view: Literal["metadata", "recipe"] = "metadata"
    """Where the horizontal field of view comes from. `metadata`: from the picture's own file or table. Without one
    there, pictures of unknown cameras are seen through the recipe's lens, and frames of videos and pictures of a
    drone's own files are left out. `recipe`: the recipe's lens for all pictures. A `focal_length_mm` or
    `sensor_width_mm` set on the command line or in the studio implies `recipe`; one in the recipe's file does not."""
    calibrate: bool = True
    """With `altitude: metadata`: correct the height until the annotated people, cars and two-wheelers of the image have
    their real size. Heights in metadata count from take-off; in an image without such objects the height is multiplied
    by `stated_heights.factor`, unless it comes from the header of the picture itself or a flight log (`altitude_from`
    in the table)."""
    stated_heights: StatedHeights = StatedHeights()
    """With `calibrate`: how heights in names and tables of the dataset differ from true ones."""
    accept_height: bool = False
    """Use the height whatever size annotated people, cars and two-wheelers have. Otherwise a run is refused where they
    are more than 1.25 times larger or smaller than the height gives, and warned of where more than 1.08 times, if at
    least 8 objects agree."""

    @property
    def stated_height_m(self) -> tuple[float, float] | None:
        """Range of the height that is stated for all pictures; None if each has its own."""
        return None if self.altitude == "metadata" else (self.altitude.at(0), self.altitude.at(1))

    @property
    def needs_height(self) -> bool:
        """Whether each picture has to state the height of its camera."""
        return self.altitude == "metadata"

    @property
    def needs_lens(self) -> bool:
        """Whether each picture of a known camera has to state its field of view."""
        return self.field_of_view == "metadata"

    def height_m(self, known: float | None, share: float) -> float:
        """Return the stated height of the camera.

        Args:
            known: Height that the picture's metadata state; None if unknown.
            share: Drawn number in [0, 1) that sets the height within the recipe's range.

        Raises:
            ValueError: The height is needed and unknown.
        """
        if self.altitude != "metadata":
            return self.altitude.at(share)
        if known is None:
            raise ValueError("no altitude; the plan must have left this background out")
        return known


# ---- Objects


class Numbers(Strict):
    """A distribution of the number of objects in a frame."""

    values: tuple[Annotated[int, Field(ge=0, le=64)], ...] = Field(min_length=1)
    """Possible numbers of objects."""
    weights: tuple[Annotated[float, Field(ge=0)], ...] | None = None
    """Relative probability of each value, in the order of `values`; equal by default."""

    @model_validator(mode="after")
    def _weights_fit(self) -> Self:
        if self.weights is not None and (len(self.weights) != len(self.values) or sum(self.weights) <= 0):
            raise ValueError(f"{len(self.values)} weights, one per value, not all 0; found {list(self.weights)}")
        return self

    def draw(self, rng: np.random.Generator) -> int:
        """Draw a number."""
        weights = np.array(self.weights or [1.0] * len(self.values))
        return int(rng.choice(np.array(self.values), p=weights / weights.sum()))

    @property
    def mean(self) -> float:
        """Mean number."""
        return float(np.average(self.values, weights=self.weights))


class FlightNumbers(Numbers):
    """Numbers of objects in pictures of one time of day, or taken below a height or at a low angle."""

    time_of_day: Literal["day", "night"] | None = None
    """Time of day of these pictures; any by default."""
    below_m: float | None = Field(None, gt=0)
    """These pictures are stated to be taken below this height, metres; any height by default."""
    below_pitch_deg: float | None = Field(None, gt=-90, le=90)
    """These pictures have a smaller depression angle than this; any angle by default. They show more ground."""


class Count(Numbers):
    """A number of objects drawn for each frame."""

    by_flight: tuple[FlightNumbers, ...] = ()
    """Numbers for pictures of some times of day, heights and angles: the first entry that fits a picture applies to it,
    and the numbers above apply where none fits. Pilots fly low over groups, and high over single objects."""

    def of_flight(self, picture: Capture) -> Numbers:
        """Return the numbers for a picture."""
        return of_flight(self.by_flight, picture) or self


ALL_PARTS = "*"
"""Name for all parts of a model that are not named."""


class PartOverride(Strict):
    """Thermal properties of one part of a model, instead of the model's own."""

    delta_t_k: range_of(-100, 1000) | None = None  # type: ignore[valid-type]
    """Surface temperature minus air temperature, kelvin."""
    emissivity: range_of(0, 1) | None = None  # type: ignore[valid-type]
    """Emissivity at normal incidence."""


class Group(Strict):
    """Groups of objects: people walk in groups, cars are parked in rows. For models that stand on the ground."""

    share: float = Field(ge=0, le=1)
    """Share of the objects of this kind in a frame, not counting the first, that are placed beside an earlier one. An
    object that finds no place there is placed anywhere."""
    apart_m: range_of(0.1, 100) = (0.6, 2.5)  # type: ignore[valid-type]
    """Distance between the centres of the two objects, metres."""
    in_row: bool = False
    """Place the object at the other's side with the same or the opposite heading, within 4 degrees, as cars are parked;
    otherwise in any direction with a heading of its own. A row has the heading of its first object, so `align` aligns
    rows as a whole. Upright boxes around the objects do not intersect, but the objects may hide each other in the
    picture."""
    max_overlap: float = Field(0.3, ge=0, le=1)
    """Largest share of the smaller of two boxes that an object placed beside another may share with an insert. Others
    share at most 0.02."""


class Align(Strict):
    """Headings along one direction per picture, as cars stand."""

    share: float = Field(0.85, ge=0, le=1)
    """Share of the objects that stand along the direction of their picture; either end may be in front. The other
    objects have any heading in `yaw_deg`."""
    along: Literal["road", "lines", "view"] = "lines"
    """Direction. `road`: along the edges of the road or path that the object stands on, each at its own place. The
    others are one direction per picture. `lines`: along the lines on its ground (edges of roads, kerbs, walls) or at
    right angles to them, and any direction where no lines are clear. `view`: about along the line of sight, because
    pilots fly along rows of parked cars."""
    spread_deg: float = Field(4.0, ge=0, le=45)
    """Standard deviation of the headings from the direction of the picture, degrees."""
    turn_deg: float = Field(15.0, ge=0, le=90)
    """With `along: view`: standard deviation of the direction of a picture from that in which the camera looks. With
    `along: lines` it has no effect."""
    time_of_day: Literal["day", "night"] | None = None
    """Align objects in pictures of this time of day only; in all by default."""


class PathPoint(Strict):
    """Where an object is at a time: a point of the picture, or metres from where it was placed."""

    time_s: float = Field(ge=0, le=1e6)
    """Seconds in the sequence."""
    x_px: float | None = None
    """Column, in the picture of the frame in which the object was placed: the first of the sequence, or after a cut."""
    y_px: float | None = None
    """Row. For models that stand, a point of the ground."""
    range_m: float | None = Field(None, gt=0, le=10_000)
    """With a point of the picture, models that fly: distance from the camera; by default as placed."""
    offset_m: tuple[float, float, float] | None = None
    """Metres to the right, away from the camera and up from where the object was placed, instead of a point of the
    picture."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.x_px is None) != (self.y_px is None) or (self.x_px is None) == (self.offset_m is None):
            raise ValueError("x_px and y_px, or offset_m")
        return self


MotionKind = Literal["still", "walk", "graze", "run", "drive", "hover", "fly", "flock", "followed"]
ON_GROUND: tuple[MotionKind, ...] = ("still", "walk", "graze", "run", "drive")
IN_AIR: tuple[MotionKind, ...] = ("still", "hover", "fly", "flock", "followed")
SPEED_M_S: Mapping[MotionKind, tuple[float, float]] = {
    "still": (0.0, 0.0),
    "walk": (0.8, 1.6),
    "graze": (0.1, 0.3),
    "run": (2.0, 4.5),
    "drive": (3.0, 12.0),
    "hover": (0.1, 0.5),
    "fly": (3.0, 12.0),
    "flock": (6.0, 12.0),
    "followed": (0.0, 0.0),
}
"""Default range of the speed, m/s: people's gaits, cars in towns, drones in wind and in cruise, birds. A followed drone
is as fast as the camera turns."""


class Motion(Strict):
    """How an object moves through a sequence. Each sequence has its own objects, each of them a track."""

    kind: MotionKind = "still"
    """`still`; on the ground `walk`, `graze`, `run` or `drive`, around what does not suit the model; in the air
    `hover`, `fly` along curves, `flock` with all others of this entry, or `followed`: the camera holds the object near
    the middle of the picture, however it turns."""
    speed_m_s: range_of(0, 100) | None = None  # type: ignore[valid-type]
    """Range of the speed, m/s; one value per object. By default that of the kind: people walk at 0.8 to 1.6."""
    path: Annotated[tuple[PathPoint, ...], Field(min_length=1)] | None = None
    """A path by hand instead, for all objects of the entry: straight lines between points, at rest before the first and
    after the last: `[{time_s: 0, x_px: 100, y_px: 80, range_m: 60}, {time_s: 4, x_px: 300, y_px: 90}]`."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if any(a.time_s >= b.time_s for a, b in pairwise(self.path or ())):
            raise ValueError("path: points in the order of their times, each later than the one before")
        return self


CLASS_NAME = (
    r"^[^\s\x00-\x1f\x7f-\x9f\uFFFE\uFFFF]"
    r"([^\x00-\x1f\x7f-\x9f\u2028\u2029\uFFFE\uFFFF]*[^\s\x00-\x1f\x7f-\x9f\uFFFE\uFFFF])?$"
)
ClassName = Annotated[str, Field(pattern=CLASS_NAME)]


class ObjectKind(Strict):
    """A kind of object to insert."""

    only_standing: ClassVar[tuple[str, ...]] = ()
    """Fields that have no effect on models that fly."""
    only_flying: ClassVar[tuple[str, ...]] = ()
    """Fields that have no effect on models that stand on the ground."""

    model: str = Field(min_length=1)
    """Name in `infrablend models list`, or the path of your own model's YAML. A path in a recipe file is relative to
    that file; one that is set on the command line or in Python is relative to the current folder."""
    category: ClassName | None = None
    """Class of its labels; the model's own by default. With the name of a class that the dataset already
    has, the objects join this class; any other name is a new class."""
    count: Annotated[int, Field(ge=0, le=64)] | Count = 1
    """Objects per frame: a number, or `{values: [0, 1, 2], weights: [...]}`."""
    yaw_deg: range_of(-360, 360) = (0.0, 360.0)  # type: ignore[valid-type]
    """Heading, degrees counter-clockwise seen from above. Paper: 0, 360."""
    scale: range_of(1e-4, 1e4) = (1.0, 1.0)  # type: ignore[valid-type]
    """Factor on the model's size; log-uniform."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Options of the model, e.g. `pose: grazing`; `infrablend models describe NAME` lists them."""
    delta_t_k: range_of(-100, 1000) = (0.0, 0.0)  # type: ignore[valid-type]
    """Added to the temperatures of all parts of the object, also to those of `parts`, kelvin; one draw per object.
    Ground beside the object that it warms or shades stays as it is."""
    parts: dict[str, PartOverride] = Field(default_factory=dict)
    """Other temperatures or emissivities for named parts, and by the name `*` for all parts of the object that are not
    named: `{"*": {delta_t_k: [5, 15]}, motor: {delta_t_k: 40}}`."""

    def part_override(self, name: str, *, ground: bool) -> PartOverride | None:
        """Return what is stated for a part; `ground` says whether it is ground beside the object, which `*` is not."""
        return self.parts.get(name) or (None if ground else self.parts.get(ALL_PARTS))

    def draw_count(self, rng: np.random.Generator, picture: Capture) -> int:
        """Draw the number of objects in a picture; a fixed number takes nothing from `rng`."""
        return self.count if isinstance(self.count, int) else self.count.of_flight(picture).draw(rng)

    def mean_count(self, picture: Capture) -> float:
        """Return the mean number of objects in a picture."""
        return self.count if isinstance(self.count, int) else self.count.of_flight(picture).mean


class PaperObject(ObjectKind):
    """A kind of object in `placement.mode: paper`: at a drawn position around the origin of the scene."""

    motion: ClassVar[None] = None

    x_m: range_of(-100_000, 100_000) = (-3.0, 3.0)  # type: ignore[valid-type]
    """Position to the right of the scene's origin, metres. Paper: -3, 3."""
    y_m: range_of(-100_000, 100_000) = (-3.0, 3.0)  # type: ignore[valid-type]
    """Position beyond the scene's origin, seen from the camera, metres. Paper: -3, 3."""
    z_m: range_of(-100_000, 100_000) = (0.0, 0.0)  # type: ignore[valid-type]
    """Height above the scene's origin, metres. Paper: 0."""


class MetricObject(ObjectKind):
    """A kind of object in `placement.mode: metric`: on the ground, or in the air in front of the camera."""

    only_standing: ClassVar[tuple[str, ...]] = ("group", "align", "z_m")
    only_flying: ClassVar[tuple[str, ...]] = ("range_m", "size_px")

    z_m: range_of(-100_000, 100_000) = (0.0, 0.0)  # type: ignore[valid-type]
    """Models that stand: height above the ground, metres; a draw below 0 is rejected."""
    range_m: range_of(0.5, 10_000) = (15.0, 60.0)  # type: ignore[valid-type]
    """Models that fly: distance from the camera, metres."""
    size_px: range_of(1, 10_000) | None = None  # type: ignore[valid-type]
    """Models that fly: longest of length, width and height, in pixels of the picture, instead of `range_m`; the
    distance follows from it and the lens of the picture. Log-uniform: as many from 4 to 8 px as from 8 to 16 px. Boxes
    are smaller where the object is seen along that side, and up to 1.4 times as long where it is seen diagonally."""
    group: Group | None = None
    """Models that stand: place objects of this kind in groups, e.g. `{share: 0.7, apart_m: [0.6, 2.5]}`."""
    align: Align | None = None
    """Models that stand: headings along one direction per picture, e.g. `{share: 0.85, along: lines}`; by default all
    headings in `yaw_deg` are as likely."""
    motion: Motion | None = None
    """Movement through sequences of pictures, such as `{kind: walk}`. With it in any entry, the objects of a recipe are
    drawn once for each sequence and keep their shapes, temperatures and tracks through all of its frames; entries
    without it stay where they are. By default each picture has objects of its own."""


Object = PaperObject | MetricObject

# ---- Placement


class MinContrast(Strict):
    """Least contrast of an inserted object in the finished picture."""

    change_grey: float = Field(ge=0, le=255)
    """Least change, 8-bit grey levels: of the object's pixels by its insertion, and of its box (5 or 95 % quantile)
    against the ring around it."""
    scr: float = Field(0.0, ge=0, le=100)
    """Least signal to clutter: that change of the box over the standard deviation of the ring + 1."""


class Placement(Strict):
    """Where objects go, and which placements are accepted."""

    needs_levels: ClassVar[bool] = True
    """Whether the range of grey levels of the whole dataset has to be known."""

    attempts: int = Field(200, ge=1, le=100_000)
    """Largest number of draws per object; after that the object is left out of the frame, and counted. After an object
    without a place, the next object of its kind has half as many draws, but at least a twentieth."""
    min_inside: float = Field(0.5, ge=0, le=1)
    """Least share of the object's projected area that must be inside the frame."""
    min_depth_m: float = Field(0.3, ge=0.05, le=1000)
    """Least distance of any point of the object from the camera plane, metres."""
    size_px: range_of(0, 1e6) | None = None  # type: ignore[valid-type]
    """Smallest and largest allowed longest side of the object's box, pixels."""
    min_visibility: float = Field(0.0, ge=0, le=1)
    """Least visible share of an object, after the frame's edge and nearer objects; objects below it are not
    inserted."""
    min_contrast: Literal["real", "off"] | MinContrast | None = None
    """Least contrast in the finished picture: what 99 of 100 real objects of the class show (`real`), or
    `{change_grey: 20, scr: 1.5}`. By default `real` with `appearance.mode: physical`, else `off`. Objects below it are
    drawn again elsewhere (`placement.mode: metric`), and left out if that does not help."""

    @property
    def surfaces(self) -> Where | None:
        """Rules on the surfaces that objects stand on; None for any place."""
        return None


class PaperPlacement(Placement):
    """Placement around the origin of a virtual scene."""

    needs_levels: ClassVar[bool] = False
    contrast_redraws: ClassVar[int] = 0
    max_noise_grey: ClassVar[None] = None

    mode: Literal["paper"] = "paper"
    """`paper`: around the origin of a virtual scene."""
    on_miss: Literal["redraw", "redraw_position", "keep"] = "redraw"
    """What to do with a placement that is not accepted. `redraw`: draw distance, position, yaw and roll again;
    `redraw_position`: draw x and y again; `keep`: keep it, as the paper's text says, even outside the frame."""
    clear_of_ignored: bool = False
    """Reject placements that cover ignore regions (DontCare). The paper does not."""


Quantiles = Annotated[tuple[float, ...], BeforeValidator(_five), AfterValidator(_rising)]
"""5, 25, 50, 75 and 95 % quantiles."""


class RealGround(Strict):
    """Ground around annotated objects of a class, measured in rings half as wide as the longer side of their boxes.

    `infrablend realism` reports both for real and for inserted objects.
    """

    level_grey: Quantiles
    """5, 25, 50, 75 and 95 % quantiles of the ring's median minus the picture's median, 8-bit grey levels, warm ground
    positive. No object is placed on ground beyond the first or the last."""
    clutter_grey: Quantiles
    """The same quantiles of the ring's standard deviation, 8-bit grey levels."""


class GroundByTime(Strict):
    """Ground around annotated objects by day and by night."""

    day: RealGround | None = None
    """Pictures taken by day."""
    night: RealGround | None = None
    """Pictures taken by night."""


class Where(Strict):
    """Surfaces that objects stand on, as the shipped model finds them in each background (`infrablend places map`)."""

    surfaces: dict[SurfaceKind, Annotated[float, Field(ge=0, le=1)]] = Field(default_factory=dict)
    """Affinity to kinds of surface, instead of the models' own: `{road: 1, grass: 0.1}` puts ten times as many objects
    on an area of road as on one of grass, and none elsewhere. Kinds are `road`, `path`, `track`, `grass`, `soil`,
    `shrub`, `tree`, `structure`, `water` and `object`."""
    masks: str | None = None
    """Folder with a picture `<split>/<id>.png` or `<id>.png` per background: objects stand only where it is bright, 255
    or at least 128. Backgrounds without one are not restricted, and counted. A path in a recipe file is relative to
    that file."""
    learned: bool = True
    """Where a class of the recipe has labels in the dataset, stand on the kinds of ground that its labelled objects are
    on, as often as they are."""


class MetricPlacement(Placement):
    """Placement in the view of the real camera, at its real height above the ground."""

    mode: Literal["metric"]
    """`metric`: in the view of the real camera, at its real height. Models that stand are placed on the ground at a
    point drawn over the image, models that fly at the distance `objects.*.range_m` or `size_px`."""
    clear_of_labels: bool = True
    """Reject placements that cover annotated objects or other inserts: that share more than 0.02 of the smaller box.
    Inserts that are placed beside another one follow `group.max_overlap` among inserts."""
    clear_of_ignored: bool = True
    """Reject placements that cover ignore regions (DontCare): that share more than 0.02 of the smaller box."""
    max_relief_grey: float = Field(12.0, ge=0)
    """Models that stand: largest standard deviation of the background under the feet, 8-bit grey levels. Trees, roof
    edges and kerbs have more than level ground. 0 turns the check off."""
    where: Where | Literal["anywhere"] = Where()
    """Models that stand: surfaces that suit them: cars on roads, deer on grass. `anywhere` is any place on the plane of
    the ground that the other rules accept."""
    ground: GroundByTime | None = None
    """Models that stand: ground around real objects. Each object draws level and clutter from these distributions, and
    looks for such a place; after three quarters of its draws it takes any place whose level is possible. Without it,
    places are uniform over the image. Pictures of unknown time of day are not restricted."""
    contrast_redraws: int = Field(4, ge=0, le=50)
    """Number of times that the objects of a frame that fail `min_contrast` are drawn again elsewhere."""
    max_noise_grey: float = Field(12.0, gt=0)
    """Largest noise of a background, 8-bit grey levels; nothing is inserted into noisier ones. A camera that sees
    nothing but an empty sky raises its gain until the picture is pure noise."""

    @property
    def surfaces(self) -> Where | None:
        """Rules on the surfaces that objects stand on; None for any place."""
        return None if isinstance(self.where, str) else self.where


class Occlusion(Strict):
    """Partly hidden objects: branches, masts and fences that the background shows stay in front of them."""

    share: float = Field(0.0, ge=0, le=1)
    """Share of the objects that are to be partly hidden. With `placement.mode: metric`, such objects are placed where
    the background shows suitable structures; without such a place, an object is inserted in front of everything."""
    visible: range_of(0.05, 1) = (0.35, 0.8)  # type: ignore[valid-type]
    """Range of the visible share of partly hidden objects; an object below it is not inserted."""


# ---- Environment, appearance and matching


class Geolocation(Strict):
    """A place on Earth."""

    latitude_deg: float = Field(ge=-90, le=90)
    """Latitude, degrees, north positive."""
    longitude_deg: float = Field(ge=-180, le=180)
    """Longitude, degrees, east positive."""


class Environment(Strict):
    """The weather."""

    air_of_picture: ClassVar[bool] = False
    """Whether temperature and humidity of the air are those that the picture's file states, if it does."""

    air_temperature_c: range_of(-60, 60) = (5.0, 25.0)  # type: ignore[valid-type]
    """Air temperature, degrees Celsius; one value per frame. The temperatures of all parts are relative to it."""

    @property
    def sky(self) -> SkyEnvironment | None:
        """The weather with sky and sun; None if the look has neither."""
        return None


class SkyEnvironment(Environment):
    """The weather of `appearance.mode: physical`: air, sky and sun."""

    dew_point_below_air_k: range_of(0, 60) = (2.0, 12.0)  # type: ignore[valid-type]
    """Air temperature minus dew point, kelvin. Large values are dry air and a cold sky."""
    clear_share: float = Field(0.6, ge=0, le=1)
    """Share of frames under a clear sky; the others have a cloud cover drawn between 0 and 1."""
    overcast_share: float = Field(0.0, ge=0, le=1)
    """Share of frames under a closed cloud cover, which counts before `clear_share`: no direct sun, no shadows, ground
    and parts nearer to the temperature of the air."""
    time_of_day: TimeOfDay | None = None
    """Time of day of all backgrounds: `day`, `dusk`, `night` or `dawn`. By default that of the sun, where the time of
    capture and `place` are known, else the dataset's own."""
    sun_elevation_deg: range_of(0, 90) = (15.0, 60.0)  # type: ignore[valid-type]
    """Elevation of the sun by day, degrees; one value and one direction per sequence of backgrounds. At dusk and dawn
    it is between -6 and 8 degrees."""
    place: Geolocation | None = None
    """Where the backgrounds were taken, for the sun's elevation at their time of capture, and so for day, dusk, night
    or dawn. By default their own position, if their files state it; a clock without a time zone is then taken as that
    of the longitude. Backgrounds without a time of capture get an elevation from `sun_elevation_deg`, and so do those
    without a time zone where `place` is stated."""

    @property
    def sky(self) -> SkyEnvironment:
        """The weather with sky and sun."""
        return self

    def ground_above_air_k(self, time: TimeOfDay | None) -> tuple[float, float] | None:
        """Return the range of ground minus air temperature, kelvin; None if the picture shows the ground's."""
        return None


class PhysicalEnvironment(SkyEnvironment):
    """The weather of `appearance.mode: physical`, with the ground drawn."""

    ground_above_air_day_k: range_of(-40, 60) = (2.0, 15.0)  # type: ignore[valid-type]
    """Apparent ground temperature minus air temperature by day, kelvin."""
    ground_above_air_night_k: range_of(-40, 60) = (-1.0, 4.0)  # type: ignore[valid-type]
    """Apparent ground temperature minus air temperature by night and at an unknown time of day, kelvin. At dusk it is
    0.3 of the way to that by day, at dawn 0.15 of it farther away."""

    def ground_above_air_k(self, time: TimeOfDay | None) -> tuple[float, float]:
        """Return the range of ground minus air temperature, kelvin, at a time of day."""
        return between(self.ground_above_air_night_k, self.ground_above_air_day_k, STORED_SHARE[time or "night"])


class RadiometricEnvironment(SkyEnvironment):
    """The weather of `matching.mode: radiometric`: the ground's temperature is that of the picture.

    `air_temperature_c` applies to pictures whose files do not state the temperature of the air, and
    `dew_point_below_air_k` to those that do not state its humidity.
    """

    air_of_picture: ClassVar[bool] = True


class Appearance(Strict):
    """How temperature becomes radiance."""

    needs_levels: ClassVar[bool] = True
    """Whether the range of grey levels of the whole dataset has to be known."""
    follows_time_of_day: ClassVar[bool] = True
    """Whether models with parts that differ by day and by night follow the picture."""
    min_contrast: ClassVar[Literal["real", "off"]] = "real"
    """What `placement.min_contrast` is by default."""

    texture_k: float = Field(0.8, ge=0, le=50)
    """Amplitude of the smooth temperature variation over every body, kelvin."""

    @property
    def ends(self) -> ArtisticAppearance:
        """Ends that the flat renderer shows temperatures between: those of the artistic look, in every look."""
        return ArtisticAppearance()


class ArtisticAppearance(Appearance):
    """The paper's hand-tuned look (Emission, Color Ramp, Fresnel)."""

    needs_levels: ClassVar[bool] = False
    follows_time_of_day: ClassVar[bool] = False
    min_contrast: ClassVar[Literal["real", "off"]] = "off"

    mode: Literal["artistic"] = "artistic"
    """`artistic`: the paper's hand-tuned look. Grey levels are matched to percentiles of the background."""
    cold_below_air_k: float = Field(8.0, ge=0, le=500)
    """Air temperature minus the temperature that is shown at the background's dark end, kelvin."""
    hot_above_air_k: float = Field(20.0, gt=0, le=500)
    """Temperature that is shown at the background's bright end, minus air temperature, kelvin."""
    surroundings_below_air_k: float = Field(10.0, ge=-100, le=200)
    """Air temperature minus the apparent temperature that surfaces reflect (a mix of sky and ground), kelvin."""

    @property
    def ends(self) -> ArtisticAppearance:
        """Its own ends."""
        return self


class PhysicalAppearance(Appearance):
    """Radiance in the thermal band, with sky and ground reflected."""

    mode: Literal["physical"]
    """`physical`: radiance in the thermal band, with sky and ground reflected. Grey levels are matched to the radiance
    of the ground around each object."""


class Matching(Strict):
    """How radiance becomes grey levels of the background."""

    needs_temperatures: ClassVar[bool] = False
    """Whether backgrounds need 16 bits and a temperature scale."""
    uses_headroom: ClassVar[bool] = False
    """Whether `sensor.headroom` has an effect."""

    def is_black_hot(self, scale: TemperatureScale | None) -> bool:
        """Return whether hot is dark in a picture with this temperature scale (None without one)."""
        return scale is not None and scale.black_hot

    @property
    def percentiles(self) -> PercentileMatching:
        """Matching of frames without objects."""
        return PercentileMatching()


class GreyMatching(Matching):
    """How radiance becomes grey levels of a background without a temperature scale."""

    polarity: Literal["white-hot", "black-hot"] = "white-hot"
    """Whether hot is bright or dark in this dataset."""

    def is_black_hot(self, scale: TemperatureScale | None) -> bool:
        """Return whether hot is dark in this dataset."""
        return self.polarity == "black-hot"

    @property
    def percentiles(self) -> PercentileMatching:
        """Matching of frames without objects."""
        return PercentileMatching(polarity=self.polarity)


class PercentileMatching(GreyMatching):
    """Matching of `appearance.mode: artistic`: the dark and bright end are percentiles of the background."""

    low_percentile: float = Field(1.0, ge=0, le=100)
    """Percentile of the background's grey levels that the cold end is shown as."""
    high_percentile: float = Field(99.5, ge=0, le=100)
    """Percentile of the background's grey levels that the hot end is shown as."""
    min_span: float = Field(0.35, ge=0, le=1)
    """Least span between the two ends, as a share of the full range; keeps objects visible on flat backgrounds."""

    _in_order = in_order("low_percentile", "high_percentile")

    @property
    def percentiles(self) -> PercentileMatching:
        """Itself, for all frames."""
        return self


class LocalMatching(GreyMatching):
    """Matching of `appearance.mode: physical`: one map from radiance to grey per background, with a local share.

    Gain, local share and offset of the ground are estimated for each background.
    """

    uses_headroom: ClassVar[bool] = True

    gain_grey_per_k: range_of(0.1, 100) = (2.5, 12.0)  # type: ignore[valid-type]
    """Lower and upper bound of the gain, 8-bit grey levels per kelvin."""
    gain_prior_grey_per_k: float = Field(6.0, gt=0, le=100)
    """Expected gain before looking at the image, 8-bit grey levels per kelvin; HIT-UAV by night has about 6."""
    gain_prior_day_grey_per_k: float | None = Field(None, gt=0, le=100)
    """Expected gain by day, 8-bit grey levels per kelvin; `gain_prior_grey_per_k` by default."""
    gain_prior_spread: float = Field(0.3, gt=0, le=2)
    """Relative standard deviation of the expected gain."""
    clothing_above_air_k: float = Field(6.0, ge=-10, le=40)
    """Assumed temperature of the clothes of annotated people minus air temperature, kelvin, within 3: +2 to +8 in
    winter, +3 to +10 in summer."""
    local_share: float = Field(0.1, ge=0, le=1)
    """Share of the neighbourhood in an object's grey level: 0 if the level follows the temperature alone, 1 if it
    follows the grey of the place where the object is put. HIT-UAV by night: 0.0 (people) to 0.2 (cars)."""
    local_share_day: float | None = Field(0.2, ge=0, le=1)
    """The same by day; `local_share` if null. HIT-UAV: 0.24 (cars) to 0.41 (people)."""
    local_share_spread: float = Field(0.05, ge=0, le=1)
    """Standard deviation of the expected local share. Each background's share is drawn from what it and the annotated
    objects of the background leave open; a share of 0 or 1 is exact."""
    local_reach: float = Field(1.5, gt=0, le=10)
    """How far the neighbourhood reaches around an object, in lengths of its box's longer side, at least 12 px. Cars of
    HIT-UAV by night follow the ground within 0.5."""
    on_untrusted: Literal["use", "prior", "skip"] = "use"
    """What to do where an estimate cannot be trusted (a negative gain, one at a bound, anchors that contradict each
    other, a corrected height of the camera at its limit): `use` it; draw gain and local share from the `prior` instead,
    which leaves the height as it is; or `skip` the background, which stays in the dataset without inserted objects."""


class RadiometricMatching(Matching):
    """Matching of 16-bit pictures with a temperature scale: temperatures go in as they are, through the air.

    There is no gain, and nothing is clipped to the range of the background. The ground's temperature is that of the
    ring around the objects; the air's is stated by the picture's file, or drawn from `environment.air_temperature_c`.
    """

    needs_temperatures: ClassVar[bool] = True

    mode: Literal["radiometric"]
    """`radiometric`: for 16-bit pictures whose temperature scale is known (`data.unit`, or the dataset's own files).
    Needs `placement.mode: metric` and `appearance.mode: physical`."""


# ---- Overlay and sensor


class Overlay(Strict):
    """How the rendered object is laid over the background."""

    flat: bool = False
    """Show each object in one grey level, the median of its render, with a hard edge: the simplest paste, to compare
    with. Scenes and labels are those of the same recipe without it. Needs `sensor.profile: off`."""
    softness_px: float = Field(0.45, ge=0, le=10)
    """Gaussian blur (sigma) of the rendered layer, pixels; the default is the softness of Blender's pixel filter.
    Labels describe the object before it."""


class NoSensor(Strict):
    """No imitation of the background's camera: the render is blurred by `overlay.softness_px`, nothing else."""

    needs_levels: ClassVar[bool] = False
    motion_px: ClassVar[tuple[float, float]] = (0.0, 0.0)
    headroom: ClassVar[float] = 0.0
    randomise: ClassVar[None] = None

    profile: Literal["off"] = "off"
    """`off`: no imitation; the render is blurred by `overlay.softness_px`."""


class _Imitation(Strict):
    """Fields of every imitation of the background's own camera."""

    needs_levels: ClassVar[bool] = True
    """Whether the range of grey levels of the whole dataset has to be known."""

    profile: Annotated[Literal["hit-uav", "monet", "generic-640x512"] | SensorProfile, BeforeValidator(_known_profile)]
    """The camera: the name of a shipped profile, the path of a profile's .json or .yaml (relative to the recipe, or to
    the current folder where it is set on the command line; `infrablend profile` writes such files), or its fields.
    `monet` is provisional. Labels describe the object before the sensor."""
    optics: float = Field(1.0, ge=0, le=2)
    """Factor on the blur, which is estimated from the edges of each background; 0: `overlay.softness_px` instead."""
    motion_px: range_of(0, 40) = (0.0, 0.0)  # type: ignore[valid-type]
    """Length of the motion tail, pixels; its direction is drawn, too. HIT-UAV: 1 at 5 m/s and 100 m, 3 with a panning
    gimbal. Labels and scene give the mean position of the object."""

    def profile_at(self, grey_unit_k: float | None) -> str | SensorProfile:
        """Return the profile for pictures with this many kelvin per level; None for those without temperatures."""
        return self.profile


class Randomise(Strict):
    """Another camera for each picture, inserts and background alike, for detectors whose camera is not known."""

    share: float = Field(1.0, ge=0, le=1)
    """Share of the pictures that another camera takes; the others stay as they are. The shares below are of these."""
    blur_px: range_of(0, 5) = (0.0, 0.0)  # type: ignore[valid-type]
    """Sigma of an additional blur, pixels."""
    bloom: range_of(0, 0.5) = (0.0, 0.0)  # type: ignore[valid-type]
    """Share of the light that is scattered around each point."""
    gain: range_of(0.2, 4) = (1.0, 1.0)  # type: ignore[valid-type]
    """Factor on the contrast, around the picture's median level."""
    noise_grey: range_of(0, 40) = (0.0, 0.0)  # type: ignore[valid-type]
    """Standard deviation of additional noise, 8-bit grey levels."""
    halo: range_of(0, 3) = (0.0, 0.0)  # type: ignore[valid-type]
    """Gain of an additional detail enhancement, which draws rings around edges."""
    invert: float = Field(0.0, ge=0, le=1)
    """Share of the pictures whose polarity is inverted."""
    bits: range_of(2, 8) = (8.0, 8.0)  # type: ignore[valid-type]
    """Bits of the grey levels that are left, a whole number in this range; 8 for all."""
    vignette_grey: range_of(-100, 100) = (0.0, 0.0)  # type: ignore[valid-type]
    """Levels by which the corners become brighter (negative: darker) than the middle, 8-bit grey levels."""
    stripes_grey: range_of(0, 20) = (0.0, 0.0)  # type: ignore[valid-type]
    """Standard deviation of the offsets of whole columns, 8-bit grey levels."""
    graphics: float = Field(0.0, ge=0, le=1)
    """Share of the pictures with burnt-in text, a reticle, a bar of grey levels or dead rows at their edges. They stay
    clear of all labelled objects: in a sequence, a mark is missing from the frames in which one comes near."""


class Sensor(_Imitation):
    """Imitation of the background's own camera, for the inserts only. Strength 0 turns a step off, 1 is as measured."""

    halo: float = Field(1.0, ge=0, le=2)
    """Detail enhancement: sharpens the inserts and adds a faint ring around them, as the camera's processing does."""
    noise: float = Field(1.0, ge=0, le=2)
    """Noise of the inserts, matched in strength and grain size to flat areas of each background."""
    clip: bool = True
    """Keep inserts within the dataset's darkest and brightest level (before the codec)."""
    headroom: float = Field(0.0, ge=0, le=10)
    """How far levels may exceed the dataset's darkest and brightest level before the optics blur them, as a multiple of
    the range between those; `clip` then cuts them off. With 0, surfaces are cut off first, and the edges of saturated
    objects are as soft as all others. A camera cuts off last, which gives them hard edges. Physical look only."""
    codec: float = Field(1.0, ge=0, le=2)
    """Compression of the 8 px blocks that the inserts touch, by JPEG of quality 100 - codec * (100 - q), where q is
    the profile's quality. 8-bit images only."""
    randomise: Randomise | None = None
    """Another camera for each picture, drawn from ranges: `{blur_px: [0, 1.5], gain: [0.6, 1.6], invert: 0.3}`. It
    changes whole pictures, unchanged originals too, after their inserts have been matched to them. Boxes and contrasts
    are those from before."""


class PaperSensor(Sensor):
    """Imitation of the background's camera in `placement.mode: paper`."""

    defocus: ClassVar[float] = 0.0


class MetricSensor(Sensor):
    """Imitation of the background's camera in `placement.mode: metric`, where distances are real."""

    defocus: float = Field(1.0, ge=0, le=2)
    """Factor on the blur of objects that are nearer than the lens is focused."""


class RadiometricSensor(_Imitation):
    """Imitation of a radiometric camera, in kelvin: optics and noise.

    Such pictures have neither detail enhancement nor codec.
    """

    halo: ClassVar[float] = 0.0
    codec: ClassVar[float] = 0.0
    clip: ClassVar[bool] = False
    headroom: ClassVar[float] = 0.0
    randomise: ClassVar[None] = None

    noise: float = Field(1.0, ge=0, le=2)
    """Noise of the inserts, matched in strength and grain size to flat areas of each background. The sharpening,
    codec and grey levels of `sensor.profile` are not used."""
    netd_k: float = Field(0.05, gt=0, le=2)
    """Noise equivalent temperature difference (NETD) of the camera, kelvin: the noise where a background has no flat
    area; four times this is the most that is taken from a background."""
    defocus: float = Field(1.0, ge=0, le=2)
    """Factor on the blur of objects that are nearer than the lens is focused."""

    def profile_at(self, grey_unit_k: float | None) -> str | SensorProfile:
        """Return the profile without sharpening and codec, with this camera's noise."""
        if grey_unit_k is None:
            return self.profile
        noise = min(self.netd_k / grey_unit_k, 20.0)
        update = {"halo_gain": 0.0, "codec_quality": None, "levels": None, "noise_grey": noise}
        return find_profile(self.profile).model_copy(update=update)


def _sensor_tag(value: Any) -> str:
    profile = value.get("profile", "off") if isinstance(value, Mapping) else getattr(value, "profile", "off")
    return "off" if profile == "off" else "on"


# ---- Render, labels and output


class Render(Strict):
    """How finely surfaces are sampled, and by what."""

    quality: Literal["matched", "paper"] = "matched"
    """`paper`: exactly 640 samples per pixel, traced by Cycles; `matched`: surfaces are sampled on a lattice, without
    Cycles and without the light that they mirror from each other."""
    samples: int | None = Field(None, ge=1, le=65_536)
    """Samples per pixel, traced by Cycles; overrides `quality`."""


MAX_LOOSEN = 2.0
MAX_LOOSEN_PX = 32.0
LooseFactor = Annotated[float, Field(ge=1, le=MAX_LOOSEN)]
LoosePx = Annotated[float, Field(ge=0, le=MAX_LOOSEN_PX)]


def _exact_is_one(loosen: Any) -> Any:
    return 1.0 if loosen == "exact" else loosen


class Labels(Strict):
    """Which labels are written."""

    mode: Literal["merged", "new", "original"] = "merged"
    """`merged`: original and new labels; `new`: those of the inserts only; `original`: the original ones only."""
    rename: dict[str, ClassName] = Field(default_factory=dict)
    """New names of original categories, e.g. `{Car: vehicle, OtherVehicle: vehicle}`. Several categories may share a
    name, also with a new object."""
    similar_names: Literal["refuse", "keep"] = "refuse"
    """Classes of inserted objects that differ from a class of the dataset (after `rename`) in case or number alone,
    such as `person` beside `Person` or `people`: `refuse` them, or `keep` them as classes of their own."""
    keep_categories: tuple[str, ...] | None = None
    """Original categories whose labels are kept, by the name after `rename`; all by default."""
    obb: Literal["min_area", "heading"] = "min_area"
    """Oriented boxes: of smallest area, or aligned with the object's heading."""
    fit: Literal["shape", "visible"] = "shape"
    """Boxes of inserted objects, in all label formats, enclose the whole `shape`, or only what is `visible` in the
    finished picture, as people draw them; parts at the level of the ground are left out. Sides of the box that a
    structure of the background hides follow `occluded_box`. Masks stay as they are; COCO and the frame records also
    have the box of the shape."""
    loosen: Annotated[
        Literal["auto", "exact"] | LooseFactor | dict[ClassName, LooseFactor], AfterValidator(_exact_is_one)
    ] = 1.0
    """Factor by which to enlarge the boxes of inserted objects in all label formats, within the frame, to match
    hand-drawn boxes: one for all classes, or one per class such as `{Person: 1.15}` (1 for the others). Masks stay as
    they are; COCO and the frame records also have the exact boxes. `exact` is 1. With `auto`, the run begins by
    measuring the boxes that people drew in the dataset, and takes their factor or their margin, by class; its record
    states both. Classes with a distance in `loosen_px` have that one instead."""
    loosen_px: LoosePx | Literal["by_size"] | dict[ClassName, LoosePx | Literal["by_size"]] = 0.0
    """Distance, px, by which each side of these boxes moves outwards, after `loosen` and in the same formats: for
    annotators whose margin does not depend on the size of the object. `by_size`: what people leave on average, 2 px
    around objects of up to 8 px, 3 px from 11 to 37 px, and 0.08 of the longer side beyond."""
    loosen_obb: bool | None = None
    """Whether `loosen` and `loosen_px` enlarge oriented boxes, too. By default they do, but for `loosen: auto`, which
    leaves those exact."""
    occluded_box: Literal["visible", "amodal"] = "visible"
    """Boxes of objects that structures of the background hide in part: around the `visible` part, or `amodal`, as if
    nothing were in front. COCO contains both."""
    dont_care: Literal["drop", "keep"] = "drop"
    """YOLO formats only: leave DontCare regions out (paper), or keep them as a class of their own."""
    remove_covered: float = Field(0.99, gt=0, le=1)
    """Share of an original object's box that must be covered by new objects for its label to be removed."""
    seg_originals: Literal["omit", "obb"] = "omit"
    """Format yolo-seg only: leave original objects out (they have no masks), or write their oriented box as a
    polygon."""

    @property
    def merges(self) -> bool:
        """Whether original and new labels are written together."""
        return self.mode == "merged"


GroupKey = Literal["pitch", "altitude", "day_night"]


class Output(Strict):
    """Which files are written."""

    image: Literal["same", "png"] = "same"
    """`same`: the input's own file type (JPEG with the source's own tables); `png`: lossless."""
    formats: Annotated[tuple[WrittenName, ...], AfterValidator(_distinct)] = (
        "yolo",
        "yolo-obb",
        "yolo-seg",
        "coco",
        "native",
    )
    """Label formats to write, by their names in [formats](formats.md); `native` is that of the input."""
    ids: Literal["new", "source"] = "new"
    """Ids of images and annotations, in formats that have them: new numbers (the source's are kept as `source_id`), or
    the source's own. `source` needs `configurations: 1` and `originals: false`, since ids must be unique."""
    category_ids: Literal["source", "from_one"] = "source"
    """Ids of categories: the source's, or numbered from 1 in their order. Many tools, such as Datumaro and torchvision,
    treat COCO's category 0, which is HIT-UAV's Person, as background."""
    originals: bool = False
    """Also copy the unchanged backgrounds with their labels into the dataset."""
    group_by: Annotated[tuple[GroupKey, ...], AfterValidator(_distinct)] = ()
    """Folders below `<split>/`, in this order, e.g. `[pitch, altitude, day_night]`."""
    layout: Literal["files", "shards"] = "files"
    """`files`: a file per picture and record; `shards`: a tar and a table per shard (see
    [shards](../formats/shards.md)), which `infrablend merge` turns into `files`."""
    agc: Agc | None = None
    """16-bit pictures only: also write the dataset with 8-bit PNG pictures to `8bit/`, by this automatic gain control,
    the same for originals and inserts: `linear`, `plateau`, `{mode: fixed, low_c: 0, high_c: 40}`, or a mapping with
    `mode` and settings."""


NOT_IN_KEY = {"formats", "layout"}
"""Fields of `Output` that decide how frames are stored, and not what they are."""


# ---- Objects placed by hand


class ObjectByHand(Strict):
    """The place of one object in one frame; what is not stated stays as drawn, so that `{}` leaves the object alone."""

    x_px: float | None = Field(None, ge=-100_000, le=100_000)
    """Column of the object's origin in the picture, pixels from the left edge; needs `y_px`. The origin of models that
    stand is on the ground between their feet, that of models that fly in their middle."""
    y_px: float | None = Field(None, ge=-100_000, le=100_000)
    """Row of the object's origin, pixels from the top edge."""
    range_m: float | None = Field(None, gt=0, le=100_000)
    """Distance from the camera, metres. Not for models that stand, in `placement.mode: metric`: they are where the
    ground is."""
    yaw_deg: float | None = Field(None, ge=-360, le=360)
    """Heading, degrees counter-clockwise seen from above."""

    @model_validator(mode="after")
    def _whole_place(self) -> Self:
        if (self.x_px is None) != (self.y_px is None):
            raise ValueError("both x_px and y_px, or neither")
        return self


class FrameByHand(Strict):
    """Objects of one frame that are placed by hand."""

    objects: tuple[ObjectByHand, ...] = Field(min_length=1)
    """Objects of the frame in the order in which they are drawn; further ones stay as drawn."""


# ---- Recipe

MAX_CONFIGURATIONS = 1000
AUTO: Final = "auto"
"""Value of `configurations` that lets the plan choose the number."""
LookName = Literal["artistic", "physical", "radiometric"]
"""How temperatures become grey levels; it follows from `appearance.mode` and `matching.mode`."""


class _Sections(Strict):
    """Fields of every recipe."""

    look: ClassVar[LookName]

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    """Name of the recipe."""
    description: str = ""
    """One sentence on its purpose."""
    configurations: Annotated[int, Field(ge=1, le=MAX_CONFIGURATIONS)] | Literal["auto"] = 1
    """Scenes per background. `auto`: as many as ask for 2,000 objects of each entry with the first entry's class, in
    the usable backgrounds of train, or in all of them where there is no train split; 1 to 16. Not for objects with
    motion. Paper: N_config = 2 for HIT-UAV, 1 for MONET."""
    empty_share: float = Field(0.0, ge=0, le=1)
    """Share of frames without any insert."""
    data: Data = Data()
    """Temperatures in 16-bit backgrounds."""
    occlusion: Occlusion = Occlusion()
    """Partly hidden objects."""
    overlay: Overlay = Overlay()
    """How the render is laid over the background."""
    render: Render = Render()
    """Number of samples."""
    labels: Labels = Labels()
    """Which labels are written."""
    output: Output = Output()
    """Which files are written."""
    frames: dict[str, FrameByHand] = Field(default_factory=dict)
    """Frames whose objects are placed by hand, by id: `{test/a_c0: {objects: [{x_px: 320, y_px: 256, range_m: 30,
    yaw_deg: 90}]}}`. Their places are not checked, and they stay however faint they are. Weather, temperatures and all
    other objects stay as they are without this field."""

    @model_validator(mode="after")
    def _flat_without_sensor(self) -> Self:
        if self.overlay.flat and not isinstance(getattr(self, "sensor", None), NoSensor):
            raise ValueError("overlay.flat needs sensor.profile: off")
        return self

    @model_validator(mode="after")
    def _number_of_sequences(self) -> Self:
        if self.configurations == AUTO and self.in_sequences:
            raise ValueError(
                "configurations: auto counts objects in single pictures, but with objects.N.motion each scene is a "
                "whole sequence; state a number"
            )
        return self

    @property
    def scenes(self) -> int:
        """Scenes per background, after planning has made a number of `auto`."""
        assert self.configurations != AUTO
        return self.configurations

    @property
    def in_sequences(self) -> bool:
        """Whether objects are those of whole sequences, and not of single pictures."""
        return any(kind.motion is not None for kind in getattr(self, "objects", ()))

    @property
    def samples(self) -> int:
        """Samples per pixel; 0 lets the renderer choose within the documented error bars."""
        if self.render.samples is not None:
            return self.render.samples
        return 640 if self.render.quality == "paper" else 0

    @property
    def needs_blender(self) -> str:
        """Why Cycles renders, with the field that asks for it; empty where surfaces are sampled on a lattice."""
        if self.samples > 0:
            field = "render.samples" if self.render.samples is not None else "render.quality"
            return f"{field} asks for {self.samples} samples per pixel"
        parts = {
            f"objects.{n}.parts.{name}": part
            for n, kind in enumerate(getattr(self, "objects", ()))
            for name, part in kind.parts.items()
        }
        for where, part in parts.items():
            if self.look != "artistic" and part.emissivity and part.emissivity[0] < LOW_EMISSIVITY:
                return f"{where}.emissivity below {LOW_EMISSIVITY:g} makes a mirror of the part"
        return ""


class PaperSections(Strict):
    """Sections of `placement.mode: paper`."""

    objects: tuple[PaperObject, ...] = Field(min_length=1)
    """Kinds of objects to insert."""
    camera: PaperCamera = PaperCamera()
    """The virtual camera."""
    placement: PaperPlacement = PaperPlacement()
    """Where objects go."""
    sensor: Annotated[
        Annotated[NoSensor, Tag("off")] | Annotated[PaperSensor, Tag("on")], Discriminator(_sensor_tag)
    ] = NoSensor()
    """Imitation of the background's own camera."""


class MetricSections(Strict):
    """Sections of `placement.mode: metric`."""

    objects: tuple[MetricObject, ...] = Field(min_length=1)
    """Kinds of objects to insert."""
    camera: MetricCamera = MetricCamera()
    """The real camera."""
    placement: MetricPlacement
    """Where objects go."""


class MetricGreySections(MetricSections):
    """Sections of `placement.mode: metric` for backgrounds in grey levels."""

    sensor: Annotated[
        Annotated[NoSensor, Tag("off")] | Annotated[MetricSensor, Tag("on")], Discriminator(_sensor_tag)
    ] = NoSensor()
    """Imitation of the background's own camera."""


class ArtisticSections(Strict):
    """Sections of `appearance.mode: artistic`."""

    look: ClassVar[LookName] = "artistic"

    environment: Environment = Environment()
    """The weather."""
    appearance: ArtisticAppearance = ArtisticAppearance()
    """How temperature becomes radiance."""
    matching: PercentileMatching = PercentileMatching()
    """How radiance becomes grey levels."""


class PhysicalSections(Strict):
    """Sections of `appearance.mode: physical`."""

    look: ClassVar[LookName] = "physical"

    environment: PhysicalEnvironment = PhysicalEnvironment()
    """The weather."""
    appearance: PhysicalAppearance
    """How temperature becomes radiance."""
    matching: LocalMatching = LocalMatching()
    """How radiance becomes grey levels."""


class PaperArtisticRecipe(ArtisticSections, PaperSections, _Sections):
    """A recipe with the paper's placement and its hand-tuned look."""


class PaperPhysicalRecipe(PhysicalSections, PaperSections, _Sections):
    """A recipe with the paper's placement and radiance in the thermal band."""


class MetricArtisticRecipe(ArtisticSections, MetricGreySections, _Sections):
    """A recipe with metric placement and the paper's hand-tuned look."""


class MetricPhysicalRecipe(PhysicalSections, MetricGreySections, _Sections):
    """A recipe with metric placement and radiance in the thermal band."""


class RadiometricRecipe(MetricSections, _Sections):
    """A recipe for 16-bit pictures with temperatures: metric placement, and radiance in the thermal band."""

    look: ClassVar[LookName] = "radiometric"

    sensor: Annotated[
        Annotated[NoSensor, Tag("off")] | Annotated[RadiometricSensor, Tag("on")], Discriminator(_sensor_tag)
    ] = NoSensor()
    """Imitation of the background's own camera."""
    environment: RadiometricEnvironment = RadiometricEnvironment()
    """The weather."""
    appearance: PhysicalAppearance
    """How temperature becomes radiance."""
    matching: RadiometricMatching
    """How radiance becomes temperature."""


PaperRecipe = PaperArtisticRecipe | PaperPhysicalRecipe
MetricRecipe = MetricArtisticRecipe | MetricPhysicalRecipe | RadiometricRecipe
Recipe = PaperArtisticRecipe | PaperPhysicalRecipe | MetricArtisticRecipe | MetricPhysicalRecipe | RadiometricRecipe
