"""Scene specification: cameras, objects and looks as plain numbers, everything needed to render a frame again.

SI units, kelvin and radians; `to_json` and `from_json` lose nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal

from infrablend.core.camera import CameraSpec

LOW_EMISSIVITY = 0.5
"""Emissivity below which a surface shows others so clearly that their light has to be traced."""


@dataclass(frozen=True)
class PartState:
    """State of one part of an object in one frame.

    Attributes:
        temperature_k: Surface temperature; where the scene has a sun, that without its light.
        emissivity: Emissivity seen straight on.
        label: Whether boxes and masks count the part.
        ior: Refractive index, which makes the rim mirror the surroundings; 1 for rough surfaces (fur, cloth) and
            metals.
        roughness: Roughness of the mirror image on smooth surfaces and metals; physical look only.
        metal: Whether the surface mirrors at all angles; physical look only.
        opacity: Share of the light from behind that the part blocks, in (0, 1]. Labels ignore a part below 1.
        sun_k: Rise of the surface temperature by an irradiance of 1 kW/m².
        glow: Whether a translucent part is ground that the object warms: the light by which it exceeds ground at air
            temperature is added to the background, whatever that shows, and nothing is blocked.

    Raises:
        ValueError: A value is outside its limits.
    """

    temperature_k: float
    emissivity: float
    label: bool = True
    ior: float = 1.5
    roughness: float = 0.1
    metal: bool = False
    opacity: float = 1.0
    sun_k: float = 0.0
    glow: bool = False

    def __post_init__(self) -> None:
        if not self.temperature_k > 0:
            raise ValueError(f"a surface of {self.temperature_k:g} K; expected a temperature above 0 K")
        if not 0 <= self.emissivity <= 1:
            raise ValueError(f"emissivity {self.emissivity:g}; expected a number from 0 to 1")
        if not 0 < self.opacity <= 1 or (self.opacity < 1 and self.label):
            raise ValueError(f"opacity {self.opacity:g}; expected above 0 and up to 1, below 1 only without label")
        if self.glow and self.opacity == 1:
            raise ValueError("a glow of opacity 1; expected an opacity below 1")

    @property
    def mirrors(self) -> bool:
        """Whether the part mirrors other surfaces clearly."""
        return self.metal or self.emissivity < LOW_EMISSIVITY


@dataclass(frozen=True)
class ObjectSpec:
    """One object in the scene.

    Attributes:
        model: Name in the catalogue, or path of a user's model description.
        category: Class of the object's label.
        params: Arguments of the model's `build`: shape, pose, size. JSON values only.
        parts: State of each part, by name.
        position_m: Position of the object's origin in the world.
        yaw_rad: Heading, counter-clockwise seen from above, 0 along +X.
        scale: Extra factor on the model's size.
        kind: Number of the recipe's entry, from 0.
        visible_aim: Visible share that structures of the background should leave; None for an object in front of them.
        shaded: Whether the sun's rays do not reach the object, by day.
        by_hand: Whether the recipe states the object's place.
        track: Number of the object in its sequence; None in single pictures.
        number: Number among the objects drawn for the frame, from 0, whether or not the others have a place; None
            in scenes that were read from their JSON, which does not have it.
    """

    model: str
    category: str
    params: Mapping[str, Any]
    parts: Mapping[str, PartState]
    position_m: tuple[float, float, float]
    yaw_rad: float
    scale: float = 1.0
    kind: int = 0
    visible_aim: float | None = None
    shaded: bool = False
    by_hand: bool = False
    track: int | None = None
    number: int | None = field(default=None, compare=False)

    @property
    def stays(self) -> bool:
        """Whether the object is not moved, and not left out for being faint: its place was stated or decided before."""
        return self.by_hand or self.track is not None


@dataclass(frozen=True)
class Sun:
    """The sun over a frame.

    Attributes:
        azimuth_rad: Direction towards the sun in the world, counter-clockwise seen from above, 0 along +X.
        elevation_rad: Elevation above the horizon.
        direct_w_m2: Irradiance by its rays of a surface at right angles to them.
        diffuse_w_m2: Irradiance of level ground by the rest of the sky.
        source: `computed` from capture time and place; `drawn`; or `contradicted`: drawn, because they have it below
            the horizon by day.
    """

    azimuth_rad: float
    elevation_rad: float
    direct_w_m2: float
    diffuse_w_m2: float
    source: Literal["computed", "drawn", "contradicted"] = "drawn"


@dataclass(frozen=True)
class Weather:
    """Air, sky and ground around a frame's objects; a scene with weather has the physical look.

    Attributes:
        air_k: Air temperature.
        dew_point_k: Dew point, at most the air temperature; decides the radiance of a clear sky.
        cloud: Share of the sky that clouds cover, in [0, 1].
        cloud_base_k: Temperature of the clouds.
        ground_k: Apparent temperature of the ground.
        sun: The sun, at dusk and dawn also below the horizon; None by night and at an unknown time of day.
    """

    air_k: float
    dew_point_k: float
    cloud: float
    cloud_base_k: float
    ground_k: float
    sun: Sun | None = None

    @property
    def overcast(self) -> bool:
        """Whether clouds cover the whole sky."""
        return self.cloud == 1


def weather_from_json(data: Mapping[str, Any] | None) -> Weather | None:
    """Return the weather of a scene's JSON values; None for none."""
    if not data:
        return None
    sun = data.get("sun")
    return Weather(**{**data, "sun": Sun(**sun) if sun else None})


@dataclass(frozen=True)
class View:
    """The real camera above the real ground: metric placement.

    Attributes:
        camera_height_m: Height above the ground after calibration.
        stated_height_m: Height according to the metadata or the recipe.
        ground_z_m: Height of the ground plane in the world.
        anchors: Number of annotated objects used for the calibration, by class.
        factor_sd: Standard deviation of the logarithm of true over stated height.
        at_limit: Whether the calibration reached a limit of the correction.
    """

    camera_height_m: float
    stated_height_m: float
    ground_z_m: float
    anchors: Mapping[str, int]
    factor_sd: float
    at_limit: bool = False


@dataclass(frozen=True)
class Appearance:
    """Rules that turn temperature into light.

    Attributes:
        cold_k: Temperature that emits 0 in the artistic look, before emissivity.
        hot_k: Temperature that emits 1 in the artistic look, before emissivity.
        surroundings_k: Apparent temperature that surfaces mirror in the artistic look.
        texture_k: Amplitude of the low-frequency temperature pattern on every part.
    """

    cold_k: float = 278.15
    hot_k: float = 313.15
    surroundings_k: float = 263.15
    texture_k: float = 0.8


@dataclass(frozen=True)
class SceneSpec:
    """One frame before rendering.

    Attributes:
        frame_id: `<split>/<background id>_c<configuration>`; unique in the run.
        background_id: Id of the image record.
        split: Split of the background.
        configuration: Number of the configuration, from 0.
        camera: Camera that the objects are rendered with.
        objects: Inserted objects, in an order that does not depend on drawing; may be empty.
        ambient_k: Air temperature that the parts' temperatures were drawn against.
        appearance: Rules that turn temperature into light.
        samples: Path-tracing samples per pixel; 0 leaves the choice to the renderer.
        render_seed: Seed of the path tracer's sampling pattern.
        draws: Facts about sampling (attempts, first distance drawn, reasons why objects are absent).
        weather: Air, sky and ground, which decide light and surroundings in the physical look: band radiance,
            W m^-2 sr^-1. None with the paper's hand-tuned look, whose levels are from 0 to 1.
        motion_px: Mean displacement (right, down) by the motion tail. The tail stretches this way while the objects
            move the other way; `objects` and `camera` already include the displacement. (0, 0) for none.
        view: Height of the real camera over the ground; None with the paper's placement.
        left_out: Why objects of the frame are not in the scene, by their numbers; not in its JSON, which counts them in
            `draws`.
    """

    frame_id: str
    background_id: str
    split: str
    configuration: int
    camera: CameraSpec
    objects: tuple[ObjectSpec, ...]
    ambient_k: float
    appearance: Appearance
    samples: int
    render_seed: int
    draws: Mapping[str, Any] = field(default_factory=dict)
    weather: Weather | None = None
    motion_px: tuple[float, float] = (0.0, 0.0)
    view: View | None = None
    left_out: Mapping[int, str] = field(default_factory=dict, compare=False)

    def without(self, numbers: Collection[int], reason: str) -> SceneSpec:
        """Return the scene without some of its objects, counted in `draws` as absent for `reason`."""
        gone = set(numbers)
        draws = dict(self.draws)
        absent = dict(draws.get("absent", {}))
        absent[reason] = absent.get(reason, 0) + len(gone)
        draws["absent"] = absent
        left_out = {**self.left_out, **{n: reason for k in gone if (n := self.objects[k].number) is not None}}
        kept = tuple(o for k, o in enumerate(self.objects) if k not in gone)
        return replace(self, objects=kept, draws=draws, left_out=left_out)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        data: dict[str, Any] = _plain(self)
        del data["left_out"]
        for o in data["objects"]:
            del o["number"]
            if not o["by_hand"]:
                del o["by_hand"]
            if o["track"] is None:
                del o["track"]
        return data

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> SceneSpec:
        """Return the spec that `to_json` wrote."""
        d = dict(data)
        camera = dict(d["camera"])
        camera["size_wh"] = tuple(camera["size_wh"])
        d["camera"] = CameraSpec(**camera)
        d["appearance"] = Appearance(**d["appearance"])
        d["weather"] = weather_from_json(d.get("weather"))
        dx, dy = d.get("motion_px", (0.0, 0.0))
        d["motion_px"] = (dx, dy)
        d["view"] = View(**d["view"]) if d.get("view") else None
        objects = []
        for o in d["objects"]:
            o = dict(o)
            o["position_m"] = tuple(o["position_m"])
            o["parts"] = {k: PartState(**v) for k, v in o["parts"].items()}
            objects.append(ObjectSpec(**o))
        d["objects"] = tuple(objects)
        return cls(**d)


def _plain(value: Any) -> Any:
    """Return a value of a spec as plain values; `dataclasses.asdict` would copy each number on its own."""
    if isinstance(value, (str, int, float, type(None))):
        return value
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    return type(value)(map(_plain, value))
