"""The recipe: every knob of a run, with its unit and range.

All models are strict (no silent conversion), frozen, and refuse unknown keys. Degrees and degrees Celsius live here
and in the command line only; the stages get radians and kelvin.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from infrablend.config.sensor_profile import PROFILES, SensorProfile
from infrablend.core.strict import Strict, range_of


def _distinct(value: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(value)) != len(value):
        raise ValueError("each item once")
    return value


def _known_profile(value: Any) -> Any:
    if value is False:  # YAML's own reading of an unquoted off
        return "off"
    known = ("off", *PROFILES)
    if isinstance(value, str) and value not in known:
        raise ValueError(f"one of {', '.join(known)}, or the path of a profile's .json or .yaml")
    return value


class FixedPitch(Strict):
    """One pitch for all frames."""

    fixed_deg: float = Field(ge=-90, le=100)
    """Depression angle of the camera, degrees: 0 level, 90 straight down, negative looking up."""


class RandomPitch(Strict):
    """A pitch drawn for each frame."""

    random_deg: range_of(-90, 100)  # type: ignore[valid-type]
    """Range of the depression angle, degrees; uniform."""


class FixedAltitude(Strict):
    """One height for all frames."""

    fixed_m: float = Field(gt=0, le=10_000)
    """Height of the camera above the ground, metres."""


class RandomAltitude(Strict):
    """A height drawn for each frame."""

    random_m: range_of(0.1, 10_000)  # type: ignore[valid-type]
    """Range of the camera's height above the ground, metres; uniform."""


class Camera(Strict):
    """The virtual camera; it looks at the scene's origin."""

    distance_m: range_of(0.05, 100_000) = (1.0, 10.0)  # type: ignore[valid-type]
    """Distance from the camera to the scene's origin, metres; uniform. Paper: D_min, D_max = 1, 10. Paper placement
    only."""
    pitch: Literal["metadata"] | FixedPitch | RandomPitch = "metadata"
    """Depression angle: each background's own (`metadata`), `{fixed_deg: 0}` or `{random_deg: [0, 90]}`."""
    altitude: Literal["metadata"] | FixedAltitude | RandomAltitude = "metadata"
    """Metric placement: height above the ground, each background's own (`metadata`), `{fixed_m: 60}` or
    `{random_m: [60, 120]}`."""
    calibrate: bool = True
    """Metric placement: correct the metadata's height until the annotated people, cars and two-wheelers of the image
    have their real size. Such heights count from take-off; without any annotated object they are taken 1.15 times."""
    roll_deg: range_of(-180, 180) = (-10.0, 10.0)  # type: ignore[valid-type]
    """Turn about the optical axis, degrees; uniform. Paper: phi_min, phi_max = -10, 10."""
    focal_length_mm: float = Field(50.0, gt=0, le=10_000)
    """Focal length, mm. The paper does not state its field of view; 50 mm on 36 mm is Blender's own camera."""
    sensor_width_mm: float = Field(36.0, gt=0, le=1_000)
    """Width the image's width covers on the sensor, mm."""
    size_px: tuple[Annotated[int, Field(ge=16, le=16_384)], Annotated[int, Field(ge=16, le=16_384)]] = (
        640,
        512,
    )
    """Width and height the virtual camera is meant for. A background of another size is rendered at its own size
    with the same horizontal field of view, and counted."""


class Count(Strict):
    """A number of objects drawn for each frame: `weights[n]` is the weight of the n-th value of `values`."""

    values: tuple[Annotated[int, Field(ge=0, le=64)], ...] = Field(min_length=1)
    """Possible numbers of objects."""
    weights: tuple[Annotated[float, Field(ge=0)], ...] | None = None
    """Weight of each value; equal by default."""

    @model_validator(mode="after")
    def _weights_fit(self) -> Count:
        if self.weights is not None and (len(self.weights) != len(self.values) or sum(self.weights) <= 0):
            raise ValueError(
                f"weights must be {len(self.values)} numbers, one for each value, not all 0; got {list(self.weights)}"
            )
        return self


class PartOverride(Strict):
    """Other thermal numbers for one part of a model."""

    delta_t_k: range_of(-100, 1000) | None = None  # type: ignore[valid-type]
    """Surface minus air temperature, kelvin; uniform."""
    emissivity: range_of(0, 1) | None = None  # type: ignore[valid-type]
    """Emissivity at normal incidence; uniform."""


class Group(Strict):
    """Company that objects keep: people walk in groups, cars are parked in rows. Metric placement, what stands."""

    share: float = Field(ge=0, le=1)
    """Share of a frame's objects of this kind, after its first, that are put beside one that is already there; one
    that finds no place so is put anywhere."""
    apart_m: range_of(0.1, 100) = (0.6, 2.5)  # type: ignore[valid-type]
    """Distance between the middles of the two, metres; uniform."""
    in_row: bool = False
    """To the other's side, with its heading or the opposite one, give or take 4 degrees: as cars are parked. Else in
    any direction, with a heading of its own."""
    max_overlap: float = Field(0.3, ge=0, le=1)
    """Share of an object's box that may lie over the box of another insert; without company 0.02."""


CLASS_NAME = r"^[^\s\x00-\x1f\x7f]([^\x00-\x1f\x7f]*[^\s\x00-\x1f\x7f])?$"
ClassName = Annotated[str, Field(pattern=CLASS_NAME)]


class Object(Strict):
    """A kind of object to insert."""

    model: str = Field(min_length=1)
    """Name in `infrablend models list`, or the path of your own model's YAML (relative to the recipe)."""
    category: ClassName | None = None
    """Class of its labels; the model's own by default. The name of a class of the dataset adds no new class."""
    count: Annotated[int, Field(ge=0, le=64)] | Count = 1
    """How many per frame: a number, or `{values: [0, 1, 2], weights: [...]}`."""
    x_m: range_of(-100_000, 100_000) = (-3.0, 3.0)  # type: ignore[valid-type]
    """Position to the right of the scene's origin, metres; uniform. Paper: -3, 3. Paper placement only, as y."""
    y_m: range_of(-100_000, 100_000) = (-3.0, 3.0)  # type: ignore[valid-type]
    """Position away from the camera, metres; uniform. Paper: -3, 3."""
    z_m: range_of(-100_000, 100_000) = (0.0, 0.0)  # type: ignore[valid-type]
    """Height above the scene's origin, metres; uniform. Paper: 0. Metric placement: above the ground, if it stands."""
    range_m: range_of(0.5, 10_000) = (15.0, 60.0)  # type: ignore[valid-type]
    """Metric placement: distance from the camera of what flies, metres; uniform."""
    yaw_deg: range_of(-360, 360) = (0.0, 360.0)  # type: ignore[valid-type]
    """Heading, degrees counter-clockwise seen from above; uniform. Paper: 0, 360."""
    scale: range_of(1e-4, 1e4) = (1.0, 1.0)  # type: ignore[valid-type]
    """Factor on the model's size; log-uniform."""
    group: Group | None = None
    """Company it keeps: none, or `{share: 0.7, apart_m: [0.6, 2.5]}`."""
    options: dict[str, Any] = Field(default_factory=dict)
    """What the model lets a recipe fix, e.g. `pose: grazing`; see `infrablend models show NAME`."""
    parts: dict[str, PartOverride] = Field(default_factory=dict)
    """Other temperatures or emissivities for named parts."""


class Placement(Strict):
    """Where objects go, when a draw counts, and what happens if it does not."""

    mode: Literal["paper", "metric"] = "paper"
    """`paper`: around the origin of a virtual scene. `metric`: in the real camera's view, at its real height over the
    ground: what stands, stands on the ground at a place drawn over the image; what flies is drawn at `range_m`."""
    on_miss: Literal["redraw", "redraw_position", "keep"] = "redraw"
    """`redraw`: distance, position, yaw and roll are drawn again together; `redraw_position`: x and y alone;
    `keep`: the paper's literal text, the object may lie outside the frame."""
    attempts: int = Field(200, ge=1, le=100_000)
    """Draws at most; after that the frame stays without that object, and is counted."""
    min_inside: float = Field(0.5, ge=0, le=1)
    """Share of the object's projected area that must lie inside the frame."""
    min_depth_m: float = Field(0.3, ge=0.05, le=1000)
    """No point of the object may be nearer to the camera plane than this, metres."""
    size_px: range_of(0, 1e6) | None = None  # type: ignore[valid-type]
    """Smallest and largest allowed longest side of the object's box, pixels."""
    min_visibility: float = Field(0.0, ge=0, le=1)
    """Least visible share of an object (frame's edge and nearer objects count); less is not inserted."""
    clear_of_labels: bool = True
    """Metric placement: never on annotated objects or other inserts."""
    clear_of_ignored: bool | None = None
    """Never on ignore regions (DontCare); by default with metric placement only, as the paper takes no notice."""
    max_relief_grey: float = Field(12.0, ge=0)
    """Metric placement: what stands needs even ground under its feet: at most this standard deviation there, 8-bit
    grey levels (trees, roofs' edges and kerbs have more). 0: no check."""
    min_contrast_grey: float = Field(4.0, ge=0)
    """`matching.mode: local`: an object of which less than a fifth would differ by this much from the ground is not
    inserted, 8-bit grey levels."""


class Environment(Strict):
    """The weather parts are warmer or colder than."""

    air_temperature_c: range_of(-60, 60) = (5.0, 25.0)  # type: ignore[valid-type]
    """Air temperature, degrees Celsius; uniform per frame."""
    dew_point_below_air_k: range_of(0, 60) = (2.0, 12.0)  # type: ignore[valid-type]
    """Dew point below air temperature, kelvin; uniform. Dry: cold sky. Physical look only, as what follows."""
    clear_share: float = Field(0.6, ge=0, le=1)
    """Share of frames under a clear sky; the others draw a cover between 0 and 1."""
    wind_m_s: range_of(0, 40) = (0.0, 4.0)  # type: ignore[valid-type]
    """Wind, metres per second; uniform."""
    ground_above_air_day_k: range_of(-40, 60) = (2.0, 15.0)  # type: ignore[valid-type]
    """Apparent temperature of the ground above that of the air by day, kelvin; uniform."""
    ground_above_air_night_k: range_of(-40, 60) = (-1.0, 4.0)  # type: ignore[valid-type]
    """The same by night, and where the time of day is unknown."""


class Appearance(Strict):
    """How temperature becomes light."""

    mode: Literal["artistic", "physical"] = "artistic"
    """`artistic`: the paper's hand-tuned look (Emission, Color Ramp, Fresnel). `physical`: band radiance, with sky and
    ground mirrored; the next three fields then mean nothing, and `matching.mode` must be `local`."""
    cold_below_air_k: float = Field(8.0, ge=0, le=500)
    """This much below air temperature is shown as the background's dark end, kelvin."""
    hot_above_air_k: float = Field(20.0, gt=0, le=500)
    """This much above air temperature is shown as the background's bright end, kelvin."""
    surroundings_below_air_k: float = Field(10.0, ge=-100, le=200)
    """What surfaces mirror looks this much colder than air, kelvin (a mix of sky and ground)."""
    texture_k: float = Field(0.8, ge=0, le=50)
    """Amplitude of the slow temperature pattern on every body, kelvin."""


class Matching(Strict):
    """How light becomes grey levels of the background."""

    mode: Literal["percentile", "local"] = "percentile"
    """`percentile`: dark and bright end are percentiles of the background's own grey levels. `local`: by radiance
    from the ground around the object, with a gain estimated for each background (physical look only)."""
    gain_grey_per_k: range_of(0.1, 100) = (2.5, 12.0)  # type: ignore[valid-type]
    """`local`: bounds of the gain, 8-bit grey levels per kelvin."""
    gain_prior_grey_per_k: float = Field(6.0, gt=0, le=100)
    """`local`: expected gain before looking at the image; HIT-UAV by night has about 6."""
    gain_prior_day_grey_per_k: float | None = Field(None, gt=0, le=100)
    """`local`: the same by day; as by night if not given."""
    gain_prior_spread: float = Field(0.3, gt=0, le=2)
    """`local`: relative standard deviation of that expectation."""
    clothing_above_air_k: float = Field(6.0, ge=-10, le=40)
    """`local`: how much warmer than the air the clothes of annotated people are taken to be, kelvin, give or take 3:
    winter's +2..+8, summer's +3..+10."""
    low_percentile: float = Field(1.0, ge=0, le=100)
    """Percentile of the background shown for the cold end."""
    high_percentile: float = Field(99.5, ge=0, le=100)
    """Percentile of the background shown for the hot end."""
    min_span: float = Field(0.35, ge=0, le=1)
    """Least span between both ends, as a share of the full range: keeps objects visible on flat backgrounds."""
    polarity: Literal["white-hot", "black-hot"] = "white-hot"
    """Whether hot is bright or dark in this dataset."""

    @model_validator(mode="after")
    def _in_order(self) -> Matching:
        if self.low_percentile >= self.high_percentile:
            raise ValueError(
                f"low_percentile {self.low_percentile:g} must be below high_percentile {self.high_percentile:g}"
            )
        return self


class Overlay(Strict):
    """How the rendered object is laid over the background."""

    flat: bool = False
    """Each object in one grey level, the median of what it would show, with a hard edge: the simplest paste, to compare
    with. Scenes and labels are those of the same recipe without it. Needs `sensor.profile: off`."""
    softness_px: float = Field(0.45, ge=0, le=10)
    """Gaussian blur (sigma) of the rendered layer, pixels: the softness Blender's default pixel filter would give.
    Labels describe the object before it."""


class Sensor(Strict):
    """The background's own camera, imitated for the inserts alone. Strength 0 leaves a step out, 1 is as measured."""

    profile: Annotated[
        Literal["off", "hit-uav", "monet", "generic-640x512"] | SensorProfile, BeforeValidator(_known_profile)
    ] = "off"
    """What the pictures come from: a shipped profile's name, the path of a profile's .json or .yaml (relative to the
    recipe; `infrablend profile` writes such files), or its fields. `off` blurs by `overlay.softness_px` and does
    nothing else. `monet` is provisional. Labels describe the object before it."""
    optics: float = Field(1.0, ge=0, le=2)
    """Factor on the blur, which is estimated from each background's own edges; 0: `overlay.softness_px` instead."""
    defocus: float = Field(1.0, ge=0, le=2)
    """Factor on the blur of objects nearer than the lens is focused. Only with metric placement: the paper's
    distance is not the real camera's."""
    motion_px: range_of(0, 40) = (0.0, 0.0)  # type: ignore[valid-type]
    """Length of the tail that motion against the camera leaves, px; uniform, as its direction. HIT-UAV: 1 at 5 m/s and
    100 m, 3 with a panning gimbal. Labels and scene say where the object is on average."""
    halo: float = Field(1.0, ge=0, le=2)
    """Detail enhancement: sharpens the inserts and rings them faintly, as the camera's processing does."""
    noise: float = Field(1.0, ge=0, le=2)
    """Grain under the inserts, matched to each background's flat places in strength and size."""
    clip: bool = True
    """Keep inserts within the dataset's darkest and brightest level (before the codec)."""
    codec: float = Field(1.0, ge=0, le=2)
    """Compression of the 8 px blocks the inserts touch, by a JPEG of the profile's quality q: 100 - codec * (100 - q).
    8-bit pictures only."""


class Render(Strict):
    """Path tracing."""

    quality: Literal["matched", "paper"] = "matched"
    """`paper`: exactly 640 samples per pixel; `matched`: as few as the documented error bars allow."""
    samples: int | None = Field(None, ge=1, le=65_536)
    """Samples per pixel, over `quality`."""


class Labels(Strict):
    """What is written about the objects."""

    mode: Literal["merged", "new", "original"] = "merged"
    """Original and new labels, the new ones alone, or the original ones alone."""
    rename: dict[str, ClassName] = Field(default_factory=dict)
    """Other names for original categories, e.g. `{Car: vehicle, OtherVehicle: vehicle}`; several may become one, and a
    new object may have such a name, too."""
    keep_categories: tuple[str, ...] | None = None
    """Original categories whose labels are kept, by the name after `rename`; all by default."""
    obb: Literal["min_area", "heading"] = "min_area"
    """Oriented boxes: of smallest area, or aligned with the object's heading."""
    dont_care: Literal["drop", "keep"] = "drop"
    """YOLO formats only: leave DontCare regions out (paper), or keep them as a class of their own."""
    remove_covered: float = Field(0.99, gt=0, le=1)
    """An original object loses its label once this share of its box lies under new objects."""
    seg_originals: Literal["omit", "obb"] = "omit"
    """yolo-seg: leave originals out (they have no masks), or write their oriented box as a polygon."""


GroupKey = Literal["pitch", "altitude", "day_night"]
Format = Literal[
    "yolo", "yolo-obb", "yolo-seg", "birdsai", "coco", "dota", "hit-uav", "hit-uav-xml", "masks", "monet", "voc",
    "native",
]  # fmt: skip
FORMATS: tuple[Format, ...] = ("yolo", "yolo-obb", "yolo-seg", "coco", "native")


class Output(Strict):
    """What is written where."""

    image: Literal["same", "png"] = "same"
    """`same`: the input's own file type (JPEG with the source's own tables); `png`: lossless."""
    formats: Annotated[tuple[Format, ...], AfterValidator(_distinct)] = FORMATS
    """Label formats to write; `native` is that of the input."""
    ids: Literal["new", "source"] = "new"
    """Ids of images and annotations, in formats that have them: numbered anew (the source's are kept as `source_id`),
    or the source's own, which needs them to be unique: one configuration, no originals."""
    category_ids: Literal["source", "from_one"] = "source"
    """Ids of categories: the source's, or numbered from 1 in their order. Many tools, Datumaro and torchvision among
    them, take COCO's category 0, which is HIT-UAV's Person, for background."""
    originals: bool = False
    """Also copy the unchanged backgrounds with their labels into the dataset."""
    group_by: Annotated[tuple[GroupKey, ...], AfterValidator(_distinct)] = ()
    """Folders below `<split>/`, in this order, e.g. `[pitch, altitude, day_night]`."""


class Recipe(Strict):
    """A whole recipe."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    """Name of the recipe."""
    description: str = ""
    """One sentence on what it is for."""
    configurations: int = Field(1, ge=1, le=1000)
    """Scenes per background. Paper: N_config = 2 for HIT-UAV, 1 for MONET."""
    empty_share: float = Field(0.0, ge=0, le=1)
    """Share of frames left without any insert."""
    objects: tuple[Object, ...] = Field(min_length=1)
    """What to insert."""
    camera: Camera = Camera()
    """The virtual camera."""
    placement: Placement = Placement()
    """When a draw counts."""
    environment: Environment = Environment()
    """The weather."""
    appearance: Appearance = Appearance()
    """How temperature becomes light."""
    matching: Matching = Matching()
    """How light becomes grey levels."""
    overlay: Overlay = Overlay()
    """How the render is laid over the background."""
    sensor: Sensor = Sensor()
    """The background's own camera."""
    render: Render = Render()
    """Path tracing."""
    labels: Labels = Labels()
    """What is written about the objects."""
    output: Output = Output()
    """What is written where."""

    @model_validator(mode="after")
    def _look_fits_matching(self) -> Recipe:
        if (self.appearance.mode == "physical") != (self.matching.mode == "local"):
            raise ValueError(
                f"appearance.mode {self.appearance.mode} does not go with matching.mode {self.matching.mode}: "
                "physical needs local, artistic needs percentile"
            )
        if self.overlay.flat and self.sensor.profile != "off":
            raise ValueError("overlay.flat does not go with a sensor: set sensor.profile to off")
        if self.placement.mode == "paper" and any(o.group is not None for o in self.objects):
            raise ValueError("objects.group needs placement.mode metric: the paper's placement knows no ground")
        return self

    @property
    def samples(self) -> int:
        """Samples per pixel; 0 lets the renderer choose within the documented error bars."""
        if self.render.samples is not None:
            return self.render.samples
        return 640 if self.render.quality == "paper" else 0
