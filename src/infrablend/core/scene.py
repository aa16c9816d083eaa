"""A scene in a few plain numbers: all that is needed to make one frame again.

SI, kelvin and radians inside; `to_json`/`from_json` lose nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from infrablend.core.camera import CameraSpec


@dataclass(frozen=True)
class PartState:
    """One part of an object in one frame.

    Attributes:
        temperature_k: Of its surface.
        emissivity: Looked at straight on.
        label: Whether boxes and masks count it.
        ior: Refractive index that makes its rim mirror the surroundings; 1 for rough surfaces (fur, cloth) and metals.
        roughness: Of the mirror image on smooth surfaces and metals.
        metal: Mirrors at all angles. Physical look only, as roughness.
        opacity: In (0, 1]. Below 1 what lies behind shows through, and for labels the part is not there.

    Raises:
        ValueError: A value outside its limits.
    """

    temperature_k: float
    emissivity: float
    label: bool = True
    ior: float = 1.5
    roughness: float = 0.1
    metal: bool = False
    opacity: float = 1.0

    def __post_init__(self) -> None:
        if not self.temperature_k > 0:
            raise ValueError(f"a surface of {self.temperature_k:g} K; expected a temperature above 0 K")
        if not 0 <= self.emissivity <= 1:
            raise ValueError(f"emissivity {self.emissivity:g}; expected a number from 0 to 1")
        if not 0 < self.opacity <= 1 or (self.opacity < 1 and self.label):
            raise ValueError(f"opacity {self.opacity:g}; expected above 0 and up to 1, below 1 only without label")


@dataclass(frozen=True)
class ObjectSpec:
    """One object in the scene.

    Attributes:
        model: Name in the catalogue, or path of a user's model description.
        category: The class its label carries.
        params: What the model's `build` takes: shape, pose, size. JSON values only.
        parts: State of each part, by name.
        position_m: Of the object's origin in the world.
        yaw_rad: Heading, counter-clockwise from above, 0 along +X.
        scale: Extra factor on the model's size.
    """

    model: str
    category: str
    params: Mapping[str, Any]
    parts: Mapping[str, PartState]
    position_m: tuple[float, float, float]
    yaw_rad: float
    scale: float = 1.0


@dataclass(frozen=True)
class Weather:
    """What a frame's surfaces stand in and mirror; used by the physical look.

    Attributes:
        air_k: Air temperature.
        dew_point_k: At most the air temperature; how much the clear sky shines.
        cloud: Covered share of the sky, in [0, 1].
        cloud_base_k: Temperature of the clouds.
        ground_k: Apparent temperature of the ground.
    """

    air_k: float
    dew_point_k: float
    cloud: float
    cloud_base_k: float
    ground_k: float


@dataclass(frozen=True)
class View:
    """The real camera above the real ground: metric placement.

    Attributes:
        camera_height_m: Above the ground, as calibrated.
        stated_height_m: As the metadata or the recipe say.
        ground_z_m: Height of the ground plane in the world.
        anchors: Annotated objects that the calibration rests on, by class.
        factor_sd: Standard deviation of the logarithm of true over stated height.
    """

    camera_height_m: float
    stated_height_m: float
    ground_z_m: float
    anchors: Mapping[str, int]
    factor_sd: float


@dataclass(frozen=True)
class Appearance:
    """How temperature becomes light.

    `artistic`: the paper's hand-tuned look; `cold_k` emits 0, `hot_k` emits 1, before emissivity; `surroundings_k` is
    the apparent temperature that surfaces mirror. `physical`: band radiance, W m^-2 sr^-1, from the `Weather`.
    `texture_k` is the amplitude of the low-frequency temperature pattern on every part.
    """

    mode: Literal["artistic", "physical"] = "artistic"
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
        split: Of the background.
        configuration: Number of the configuration, from 0.
        camera: The virtual camera.
        objects: What is inserted, in drawing-independent order; may be empty.
        ambient_k: Air temperature that part temperatures were drawn against.
        appearance: How temperature becomes light.
        samples: Path-tracing samples per pixel; 0 lets the renderer choose by object size.
        render_seed: Seed of the path tracer's sampling pattern.
        draws: Facts about sampling (attempts, first distance drawn, why an object is absent).
        weather: Needed by the physical look; None with the artistic one.
        motion_px: How far (right, down) a motion tail has moved the objects on average; `objects` and `camera` are
            after that move. The tail stretches this way, the objects move the other. (0, 0) for none.
        view: The real camera's height over the ground; None with the paper's placement.
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

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> SceneSpec:
        """The spec that `to_json` wrote."""
        d = dict(data)
        camera = dict(d["camera"])
        camera["size_wh"] = tuple(camera["size_wh"])
        d["camera"] = CameraSpec(**camera)
        d["appearance"] = Appearance(**d["appearance"])
        if weather := d.get("weather"):
            # Scenes of earlier versions also have the wind, which never had an effect.
            d["weather"] = Weather(**{k: v for k, v in weather.items() if k != "wind_m_s"})
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
