"""Where a picture's pixels lie on the ground, from the pose of its camera, and how uncertain that is.

Ground is a level plane under the camera. Places are metres east and north of an origin (`LocalFrame`); angles are those
of `core.capture`: yaw clockwise from north, pitch below the horizon, roll clockwise as seen from behind the camera, in
this order. Straight down, yaw is the direction of the picture's upper edge. Pixels are as in `core.camera`: (0, 0) is
the outer corner of the first one.

Errors are standard errors, independent of each other, and are carried to the ground by differences (Jacobian). Rays
flatter than `LEAST_DEPRESSION_DEG` have no place: there, the distribution on the ground is far from normal, and
ellipses would not hold what they state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import pymap3d

from infrablend.core.camera import STRAIGHT_DOWN_DEG
from infrablend.core.dataset import ImageRecord
from infrablend.core.mesh import FloatArray
from infrablend.errors import ArgumentError

LEAST_DEPRESSION_DEG = 15.0
"""Rays less steep than this reach no ground: at most 3.7 heights away."""
PROBABILITY = 0.9
"""Probability with which ellipses hold the true place."""

NEAR_NADIR_DEG = 5.0
"""Within this of straight down, a gimbal's yaw is not to be trusted (gimbal lock)."""
EARTH_M = 6_371_000.0
"""Mean radius of the earth."""
_NEEDED = ("latitude_deg", "longitude_deg", "altitude_m", "pitch_deg", "hfov_deg")
# Points along each edge of a picture that outline a footprint with an arc.
_ALONG_EDGE = 32


@dataclass(frozen=True)
class PoseErrors:
    """Standard errors of a pose; None takes the default of what states the value.

    Attributes:
        position_m: Of the camera's position, in east and in north.
        height_m: Of the height above the ground at the target.
        yaw_deg: Of the heading.
        pitch_deg: Of the angle below the horizon.
        roll_deg: Of the roll, and of the tilt sideways, which no stated angle holds for a camera that looks down.
        hfov_share: Of the field of view, as a share of it.
        pixel_px: Of a detection's place in the picture, in x and in y.

    Raises:
        ArgumentError: An error is below 0, or no number.
    """

    position_m: float | None = None
    height_m: float | None = None
    yaw_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    hfov_share: float | None = None
    pixel_px: float | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not 0 <= value < math.inf:
                raise ArgumentError(f"errors: found {name} {value:g}, expected 0 or more")


@dataclass(frozen=True)
class StatedError:
    """A standard error, and why it is as large as it is."""

    value: float
    source: str


@dataclass(frozen=True)
class Pose:
    """Where the camera of one picture was, and how it looked.

    Attributes:
        size_wh: Size of the picture, px.
        hfov_deg: Field of view across its width.
        pitch_deg: Angle of the optical axis below the horizon; 90 straight down.
        roll_deg: Rotation about the axis, positive clockwise as seen from behind the camera.
        yaw_deg: Heading of the axis, clockwise from north; straight down, that of the picture's upper edge.
        height_m: Height above the ground at the target.
        latitude_deg: Latitude of the camera.
        longitude_deg: Longitude of the camera.
        errors: Standard errors by the names of `PoseErrors`, each with its source.
    """

    size_wh: tuple[int, int]
    hfov_deg: float
    pitch_deg: float
    roll_deg: float
    yaw_deg: float
    height_m: float
    latitude_deg: float
    longitude_deg: float
    errors: Mapping[str, StatedError]

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.size_wh[0] / 2 / math.tan(math.radians(self.hfov_deg) / 2)

    @property
    def is_near_nadir(self) -> bool:
        """Whether the camera looks straight down, but for a few degrees."""
        return abs(STRAIGHT_DOWN_DEG - self.pitch_deg) <= NEAR_NADIR_DEG


@dataclass(frozen=True)
class LocalFrame:
    """A plane that touches the earth at an origin: metres east and north of it, for one flight (some kilometres)."""

    latitude_deg: float
    longitude_deg: float

    def to_metres(self, latitude_deg: float | FloatArray, longitude_deg: float | FloatArray) -> FloatArray:
        """Return (..., 2) metres east and north of WGS 84 degrees."""
        east, north, _ = pymap3d.geodetic2enu(
            latitude_deg, longitude_deg, 0.0, self.latitude_deg, self.longitude_deg, 0.0
        )
        return np.stack([np.asarray(east, np.float64), np.asarray(north, np.float64)], axis=-1)

    def to_degrees(self, east_m: float | FloatArray, north_m: float | FloatArray) -> FloatArray:
        """Return (..., 2) WGS 84 latitude and longitude, degrees, of metres east and north."""
        # The plane leaves the earth; its point at sea level is this much below it.
        up = -(np.square(east_m) + np.square(north_m)) / (2 * EARTH_M)
        latitude, longitude, _ = pymap3d.enu2geodetic(east_m, north_m, up, self.latitude_deg, self.longitude_deg, 0.0)
        return np.stack([np.asarray(latitude, np.float64), np.asarray(longitude, np.float64)], axis=-1)


@dataclass(frozen=True)
class Ellipse:
    """An ellipse on the ground that holds the true place with a stated probability.

    Attributes:
        major_m: Longer semi-axis.
        minor_m: Shorter semi-axis.
        azimuth_deg: Direction of the longer one, clockwise from north, in [0, 180).
    """

    major_m: float
    minor_m: float
    azimuth_deg: float

    def covariance(self, probability: float = PROBABILITY) -> FloatArray:
        """Return the (2, 2) covariance, east and north, of a normal error that it holds with some probability."""
        turn = math.radians(self.azimuth_deg)
        axes = np.array([[math.sin(turn), math.cos(turn)], [math.cos(turn), -math.sin(turn)]])
        spread = np.diag([self.major_m**2, self.minor_m**2]) / (-2 * math.log1p(-probability))
        return np.asarray(axes.T @ spread @ axes)


def pose_of(image: ImageRecord, errors: PoseErrors | None = None) -> Pose | str:
    """Return the pose of a picture's camera, or the names of the facts that are missing for it, joined by commas.

    Args:
        image: The picture, with its size.
        errors: Standard errors that replace the defaults.
    """
    c = image.capture
    missing = [name for name in _NEEDED if getattr(c, name) is None]
    yaw_deg = c.flight_yaw_deg if c.yaw_deg is None else c.yaw_deg
    if yaw_deg is None:
        missing.append("yaw_deg")
    if c.altitude_m == 0:
        missing.append("altitude_m above 0")
    if image.size_wh is None:
        missing.append("size of the picture")
    if missing:
        return ", ".join(missing)
    assert image.size_wh is not None and c.latitude_deg is not None and c.longitude_deg is not None
    assert c.altitude_m is not None and c.pitch_deg is not None and yaw_deg is not None and c.hfov_deg is not None
    pose = Pose(
        image.size_wh, c.hfov_deg, c.pitch_deg, c.roll_deg or 0.0, yaw_deg, c.altitude_m,
        c.latitude_deg, c.longitude_deg, {},
    )  # fmt: skip
    yaw = StatedError(5.0, "gimbal yaw, compass")
    if pose.is_near_nadir and c.flight_yaw_deg is not None:
        # Roll only turns the picture there, and gimbals trade it for yaw.
        pose = replace(pose, yaw_deg=c.flight_yaw_deg, roll_deg=0.0)
        yaw = StatedError(3.0, "heading of the aircraft")
    elif pose.is_near_nadir:
        yaw = StatedError(12.0, "gimbal yaw near straight down")
    stated = {
        "position_m": StatedError(1.5, "satellite position without corrections"),
        "height_m": StatedError(1.0, "laser")
        if c.altitude_from == "laser"
        else StatedError(2.0, "height above take-off, ground taken as level"),
        "yaw_deg": yaw,
        "pitch_deg": StatedError(0.5, "gimbal"),
        "roll_deg": StatedError(0.5, "gimbal")
        if c.roll_deg is not None
        else StatedError(1.0, "roll not stated, taken as 0"),
        "hfov_share": StatedError(0.03, "lens as stated"),
        "pixel_px": StatedError(1.0, "box of the detection"),
    }
    given = {f.name: getattr(errors, f.name) for f in fields(PoseErrors)} if errors is not None else {}
    replaced = {name: StatedError(value, "given") for name, value in given.items() if value is not None}
    return replace(pose, errors=stated | replaced)


def ground_of_pixels(pose: Pose, frame: LocalFrame, xy: FloatArray) -> FloatArray:
    """Return (n, 2) metres east and north where the rays of (n, 2) pixels meet level ground.

    NaN for rays above the horizon or flatter than `LEAST_DEPRESSION_DEG`.
    """
    vector = _vector(pose, frame)
    return np.asarray(_ground(vector, pose.size_wh, xy) * _reaching(_directions(vector, pose.size_wh, xy))[:, None])


def pixels_of_ground(pose: Pose, frame: LocalFrame, en: FloatArray) -> FloatArray:
    """Return (n, 2) pixels at which (n, 2) places of level ground, metres, are seen; NaN behind the camera.

    Places beside the picture have pixels outside it.
    """
    vector = _vector(pose, frame)
    below = np.column_stack([en - vector[:2], np.full(len(en), -pose.height_m)])
    seen = below @ _axes(vector).T
    depth = np.where(seen[:, 2] > 0, seen[:, 2], np.nan)
    return np.asarray(seen[:, :2] / depth[:, None] * pose.focal_px + np.array(pose.size_wh) / 2)


def ground_to_pixels(pose: Pose, frame: LocalFrame) -> FloatArray:
    """Return the (3, 3) homography from metres east and north of level ground to pixels, of any scale."""
    vector = _vector(pose, frame)
    east, north = vector[:2]
    width, height = pose.size_wh
    lens = np.array([[pose.focal_px, 0, width / 2], [0, pose.focal_px, height / 2], [0, 0, 1]])
    below = np.array([[1, 0, -east], [0, 1, -north], [0, 0, -pose.height_m]])
    return np.asarray(lens @ _axes(vector) @ below)


def footprint(pose: Pose, frame: LocalFrame) -> FloatArray:
    """Return (k, 2) corners, metres east and north, of the ground that the picture shows, clockwise in the picture.

    It ends where rays reach no ground: on an arc about the camera. Without any ground, k is 0.
    """
    width, height = pose.size_wh
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float64)
    if np.isfinite(on_ground := ground_of_pixels(pose, frame, corners)).all():
        return on_ground
    share = np.arange(_ALONG_EDGE)[:, None] / _ALONG_EDGE
    edges = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    rim = np.concatenate(edges)
    on_ground = ground_of_pixels(pose, frame, rim)
    flat = np.isnan(on_ground[:, 0])
    if flat.all() and np.isnan(ground_of_pixels(pose, frame, np.array([[width, height]]) / 2)).any():
        return np.zeros((0, 2))
    vector = _vector(pose, frame)
    along = _directions(vector, pose.size_wh, rim[flat])[:, :2]
    reach_m = pose.height_m / math.tan(math.radians(LEAST_DEPRESSION_DEG))
    on_ground[flat] = vector[:2] + along / np.linalg.norm(along, axis=1)[:, None] * reach_m
    return on_ground


def ground_pixel_m(pose: Pose, xy: FloatArray) -> FloatArray:
    """Return (n,) metres across the line of sight that one pixel covers where (n, 2) pixels meet the ground; else NaN.

    Along the line of sight, a pixel covers more ground than that by the sine of the ray's depression.
    """
    rays = rays_of_pixels(pose, xy)
    with np.errstate(divide="ignore"):
        return np.asarray(pose.height_m / -rays[:, 2] / pose.focal_px * _reaching(rays))


def rays_of_pixels(pose: Pose, xy: FloatArray) -> FloatArray:
    """Return (n, 3) east, north and up along the rays of (n, 2) pixels, as far as a depth of 1."""
    return _directions(_vector(pose, LocalFrame(pose.latitude_deg, pose.longitude_deg)), pose.size_wh, xy)


def position_covariance(pose: Pose, frame: LocalFrame, xy: FloatArray) -> FloatArray:
    """Return (n, 2, 2) covariances, square metres, of the places east and north that `ground_of_pixels` gives.

    NaN where it gives none. With errors replaced in the pose (0 for those that all pictures of a flight share), this
    is the covariance of what is the picture's own.
    """
    e = {name: stated.value for name, stated in pose.errors.items()}
    lens = e["hfov_share"] * pose.hfov_deg
    angles = (e["yaw_deg"], e["pitch_deg"], e["roll_deg"], e["roll_deg"])
    sigma = (e["position_m"], e["position_m"], e["height_m"], lens, *angles)
    at = _vector(pose, frame)
    columns = []
    for k, s in enumerate(sigma):
        # A step far below the error, so that differences are derivatives, and far above rounding.
        step = np.zeros(len(at))
        step[k] = 1e-4
        ahead, behind = _ground(at + step, pose.size_wh, xy), _ground(at - step, pose.size_wh, xy)
        columns.append((ahead - behind) / 2e-4 * s)
    for axis in np.eye(2):
        ahead, behind = _ground(at, pose.size_wh, xy + 0.01 * axis), _ground(at, pose.size_wh, xy - 0.01 * axis)
        columns.append((ahead - behind) / 0.02 * e["pixel_px"])
    jacobian = np.stack(columns, axis=-1)
    reaching = _reaching(_directions(at, pose.size_wh, xy))
    return np.asarray(jacobian @ jacobian.transpose(0, 2, 1) * reaching[:, None, None])


def ellipse(covariance: FloatArray, probability: float = PROBABILITY) -> Ellipse:
    """Return the ellipse that holds a normal error of a (2, 2) covariance, east and north, with some probability."""
    values, vectors = np.linalg.eigh(covariance)
    # Quantile of chi squared with two degrees of freedom.
    minor, major = np.sqrt(np.maximum(values, 0.0) * -2 * math.log1p(-probability))
    east, north = vectors[:, 1]
    return Ellipse(float(major), float(minor), math.degrees(math.atan2(east, north)) % 180.0)


def _vector(pose: Pose, frame: LocalFrame) -> FloatArray:
    """Return (8,) east, north, height, field of view, yaw, pitch, roll, and 0 for the tilt sideways."""
    east, north = frame.to_metres(pose.latitude_deg, pose.longitude_deg)
    angles = (pose.hfov_deg, pose.yaw_deg, pose.pitch_deg, pose.roll_deg, 0.0)
    return np.array([east, north, pose.height_m, *angles])


def _axes(vector: FloatArray) -> FloatArray:
    """Return (3, 3): the camera's axes right, down and forward as rows, in east, north and up."""
    y, p, r, t = np.radians(vector[4:])
    level = np.array([np.cos(y), -np.sin(y), 0.0])
    forward = np.array([np.sin(y) * np.cos(p), np.cos(y) * np.cos(p), -np.sin(p)])
    down = np.cross(forward, level)
    right = np.cos(r) * level + np.sin(r) * down
    below = np.cos(r) * down - np.sin(r) * level
    return np.stack([np.cos(t) * right - np.sin(t) * forward, below, np.cos(t) * forward + np.sin(t) * right])


def _directions(vector: FloatArray, size_wh: tuple[int, int], xy: FloatArray) -> FloatArray:
    """Return (n, 3) east, north and up along the rays of (n, 2) pixels, of depth 1."""
    focal_px = size_wh[0] / 2 / math.tan(math.radians(vector[3]) / 2)
    rays = np.column_stack([(xy - np.array(size_wh) / 2) / focal_px, np.ones(len(xy))])
    return np.asarray(rays @ _axes(vector))


def _ground(vector: FloatArray, size_wh: tuple[int, int], xy: FloatArray) -> FloatArray:
    """Return (n, 2) metres east and north where rays, however flat, meet the plane below the camera."""
    rays = _directions(vector, size_wh, xy)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(vector[:2] - rays[:, :2] * (vector[2] / rays[:, 2])[:, None])


def _reaching(rays: FloatArray) -> FloatArray:
    """Return (n,) 1 for rays that reach the ground, NaN for those that are too flat."""
    steepness = -rays[:, 2] / np.linalg.norm(rays, axis=1)
    return np.where(steepness < math.sin(math.radians(LEAST_DEPRESSION_DEG)), np.nan, 1.0)
