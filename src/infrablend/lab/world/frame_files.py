"""One frame of the virtual world: its plan, its image as a thermal camera stores it, its labels and its record.

The record is the entry in `world.json`. As the radiometric JPEG file of a camera, a frame is part of a made-up flight
off the card.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from infrablend.core.boxes import (
    box_of_points,
    clip_triangles_to_rect,
    convex_hull,
    corners_of_box,
    smallest_rectangle_inside,
)
from infrablend.core.camera import CameraSpec
from infrablend.core.capture import Capture, TimeOfDay
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.files import write_bytes
from infrablend.core.mesh import FloatArray, IntArray
from infrablend.core.quantiles import percentile
from infrablend.core.rng import stream
from infrablend.core.temperature import Radiometry, TemperatureScale
from infrablend.formats.pictures.images import png_bytes
from infrablend.formats.published import monet
from infrablend.lab.world.countryside import athletics, courts, forest, river, suburb
from infrablend.lab.world.ground_cover import Patch, draw_materials, draw_water
from infrablend.lab.world.rjpeg_writing import PLANCK, Shot, radiometric_jpeg
from infrablend.lab.world.scene_plan import PlaceKind, WorldPlan
from infrablend.lab.world.scene_site import Site
from infrablend.lab.world.setting import FOCAL_PX, SIZE_WH, Draws, draw_weather, world_camera
from infrablend.lab.world.townscape import airfield, court, dirt_road, park, parking, street
from infrablend.lab.world.world_frames import FrameFacts, telemetry_of
from infrablend.thermal.radiometry import ObjectSettings

# An object below this visible share, or with fewer visible pixels, gets no label, because nobody could annotate it.
MIN_VISIBILITY = 0.25
MIN_PIXELS = 6.0
# From this visible share on, an object counts as unhidden; its box is that of its geometry, to sub-pixel precision.
UNHIDDEN = 0.97


@dataclass(frozen=True, eq=False)
class VisibleSamples:
    """Samples of the id pass that show one object.

    Attributes:
        mask: Whether each sample shows the object, cropped to the area where it can appear.
        offset_xy: Column and row of the first sample of the crop.
        oversample: Samples per pixel and direction.
    """

    mask: NDArray[np.bool_]
    offset_xy: tuple[int, int]
    oversample: int


@dataclass(frozen=True, eq=False)
class Label:
    """One object of a frame, labelled or dropped.

    Attributes:
        category: Class of the object.
        box_xyxy: (4,) half-open float pixels, inside the frame; None if the object has no label.
        corners_xy: (4, 2) corners of the oriented box, or None.
        visibility: Visible pixels divided by the pixels there would be without occluders and frame edges.
        truncated: Whether the frame cuts the object.
        dropped: Reason for having no label: "hidden", "small" or "outside"; "" for a labelled object.
        outline_xy: (N, 2) convex outline of what the box is around, clockwise; None if the object has no label.
    """

    category: str
    box_xyxy: FloatArray | None
    corners_xy: FloatArray | None
    visibility: float
    truncated: bool
    dropped: str = ""
    outline_xy: FloatArray | None = None


def silhouette_area_px(
    xy: FloatArray, triangles: IntArray, size_wh: tuple[int, int], oversample: int = 4
) -> tuple[float, float]:
    """Return the area in pixels of the union of projected triangles: in total, and inside the frame."""
    low = np.floor(xy.min(axis=0)).astype(int) - 1
    size = np.ceil(xy.max(axis=0)).astype(int) + 2 - low
    mask = np.zeros((int(size[1]) * oversample, int(size[0]) * oversample), np.uint8)
    # Fixed point with 4 fractional bits; OpenCV has pixel centres at integers, hence the half sample.
    points = np.round(((xy - low) * oversample - 0.5) * 16).astype(np.int32)
    for t in points[triangles]:
        cv2.fillConvexPoly(mask, t, 1, lineType=cv2.LINE_8, shift=4)
    x0, y0 = np.maximum(-low, 0) * oversample
    x1, y1 = np.maximum(np.array(size_wh) - low, 0) * oversample
    return float(mask.sum()) / oversample**2, float(mask[y0:y1, x0:x1].sum()) / oversample**2


def label_object(
    category: str,
    camera: CameraSpec,
    vertices_m: FloatArray,
    triangles: IntArray,
    visible: VisibleSamples,
    upright: bool,
) -> Label:
    """Return the label of one object.

    `vertices_m` are (V, 3) in the world; `upright` aligns the oriented box with the image axes, as HIT-UAV does for
    people.
    """
    w, h = camera.size_wh
    xy, depth = camera.project(vertices_m)
    if not (depth > 0.1).all():
        return Label(category, None, None, 0.0, True, "outside")
    low, high = xy.min(axis=0), xy.max(axis=0)
    truncated = bool((low < 0).any() or high[0] > w or high[1] > h)
    points = clip_triangles_to_rect(xy[triangles], np.array([0.0, 0.0, w, h])) if truncated else xy
    if not len(points):
        return Label(category, None, None, 0.0, True, "outside")
    area, framed = silhouette_area_px(xy, triangles, (w, h))
    shown = float(visible.mask.sum()) / visible.oversample**2
    visibility = min(shown / max(area, 1e-9), 1.0)
    if shown < MIN_PIXELS or visibility < MIN_VISIBILITY:
        reason = "outside" if framed < MIN_VISIBILITY * area else "small" if framed < MIN_PIXELS else "hidden"
        return Label(category, None, None, visibility, truncated, reason)
    if shown < UNHIDDEN * framed - 0.5:
        # Something is in front of it: the samples of the id pass bound the box, to one sample.
        points = _points_within(points, visible)
    box = box_of_points(points)
    if (box[2:] - box[:2] < 1).any():
        return Label(category, None, None, visibility, truncated, "small")
    corners = corners_of_box(box) if upright else smallest_rectangle_inside(points, (w, h))
    return Label(category, box, corners, visibility, truncated, outline_xy=convex_hull(points))


def _points_within(points_xy: FloatArray, visible: VisibleSamples) -> FloatArray:
    """Return the outline points of the visible samples, clipped to the box of the projected geometry."""
    i, j = np.nonzero(visible.mask)
    corners = np.concatenate([np.stack([j + dj, i + di], axis=1) for dj in (0, 1) for di in (0, 1)])
    outline = convex_hull((corners + visible.offset_xy) / visible.oversample)
    box = box_of_points(points_xy)
    return np.clip(outline, box[:2], box[2:])


# Each fills a site and returns the name of the material that covers the rest of the ground.
PLACES: dict[PlaceKind, Callable[[Site], str]] = {
    "street": street,
    "parking": parking,
    "court": court,
    "park": park,
    "runway": airfield,
    "dirtroad": dirt_road,
    "forest": forest,
    "river": river,
    "suburb": suburb,
    "courts": courts,
    "athletics": athletics,
}
# Places drawn at random; the others have to be asked for by name.
TOWN: tuple[PlaceKind, ...] = ("street", "parking", "court", "park")
TOWN_SHARES = (0.42, 0.22, 0.18, 0.18)


def sample_world(
    rng: np.random.Generator,
    pitch_deg: float,
    altitude_m: float,
    time_of_day: TimeOfDay,
    kind: PlaceKind | None = None,
    size_wh: tuple[int, int] = SIZE_WH,
    focal_px: float = FOCAL_PX,
) -> WorldPlan:
    """Draw the plan of a scene.

    Pitches are depression angles in [10, 90], so that neither horizon nor sky shows; 90 looks straight down. Without a
    kind, one is drawn from `TOWN`. `focal_px` is the focal length in pixels of a picture 640 wide.
    """
    if kind is None:
        kind = TOWN[int(rng.choice(len(TOWN), p=TOWN_SHARES))]
    draws = Draws(rng)
    weather = draw_weather(draws, time_of_day)
    materials = draw_materials(draws, weather) + ((draw_water(draws, weather),) if kind == "river" else ())
    site = Site(draws, world_camera(pitch_deg, altitude_m, size_wh, focal_px), weather)
    base = PLACES[kind](site)
    wear(site)
    u = draws.uniform
    night = weather.night
    return WorldPlan(
        camera=site.camera,
        pitch_deg=pitch_deg,
        altitude_m=altitude_m,
        time_of_day=time_of_day,
        kind=kind,
        air_k=weather.air_k,
        sky_drop_k=weather.sky_drop_k,
        sun=weather.sun,
        shade_k=0.0 if night else u(5.0, 10.0) * weather.solar,
        gain_per_k=u(5.6, 8.2) if night else u(4.6, 7.4),
        mean_grey=float(np.clip(draws.normal(126 if night else 129, 10 if night else 17), 96, 162)),
        std_grey=float(np.clip((35 if night else 45) * np.exp(draws.normal(0, 0.28)), 19, 58)),
        seed=draws.integer(2**31),
        base=base,
        materials=materials,
        roads=tuple(site.roads),
        patches=tuple(site.patches),
        vehicles=tuple(site.vehicles),
        people=tuple(site.people),
        cycles=tuple(site.cycles),
        trees=tuple(site.trees),
        buildings=tuple(site.buildings),
        furniture=tuple(site.furniture),
    )


def wear(site: Site) -> None:
    """Add traces of use to the ground: cracks, stains and repairs."""
    draws = site.draws
    weather = site.weather
    for _ in range(draws.integer(2, 6)):  # cracks wander
        x, y, a = draws.uniform(site.x0, site.x1), draws.uniform(site.y0, site.y1), draws.uniform(0, 6.28)
        amount = draws.uniform(-1.2, -0.5) if weather.night else draws.uniform(1.2, 3.0)
        for _ in range(draws.integer(6, 22)):
            step = draws.uniform(0.4, 1.2)
            x, y = x + step * math.cos(a), y + step * math.sin(a)
            site.patches.append(Patch("rect", x, y, a, 1.15 * step, 0.05, None, amount, 0.05))
            a += draws.uniform(-0.5, 0.5)
    for _ in range(draws.integer(6, 15)):
        x, y = draws.uniform(site.x0, site.x1), draws.uniform(site.y0, site.y1)
        k = 1.0 if weather.night else 2.5
        if draws.chance(0.5):
            site.patches.insert(
                0,
                Patch("ellipse", x, y, draws.uniform(0, 3.1), draws.uniform(0.8, 5), draws.uniform(0.5, 3), None,
                      k * draws.uniform(-0.7, 0.6), draws.uniform(0.4, 1.5)),
            )  # fmt: skip
        else:
            heading = site.roads[0].heading_rad if site.roads else 0.0
            site.patches.insert(
                0,
                Patch("rect", x, y, heading, draws.uniform(1, 6), draws.uniform(0.8, 2.5), None,
                      k * draws.uniform(-0.5, 0.5), 0.15),
            )  # fmt: skip


Field = NDArray[np.float32]
# HIT-UAV keeps the limited range of video; the camera holds the mean near mid-grey.
LOW_GREY = 16.0
HIGH_GREY = 235.0
MEAN_GREY = 126.0
HEADROOM_GREY = 95.0
# Noise equivalent temperature difference of uncooled cameras at f/1.0, by their data sheets.
NETD_K = 0.05
CENTIKELVIN = TemperatureScale(0.01, 0.0, "centikelvin")


def optics(kelvin: Field, sigma_px: float) -> Field:
    """Return the image blurred by the lens."""
    return np.asarray(cv2.GaussianBlur(kelvin, (0, 0), sigma_px), np.float32)


def gain(kelvin: Field, gain_per_k: float, std_grey: float, mean_grey: float = MEAN_GREY) -> Field:
    """Return grey levels, linear in temperature as HIT-UAV's histograms suggest; not yet clipped or rounded.

    Args:
        kelvin: (h, w) scene temperatures.
        gain_per_k: Nominal grey levels per kelvin; the gain stays within 0.8 to 2 times this, so flat scenes stay flat.
        std_grey: Target deviation of the grey levels.
        mean_grey: Target mean, after clipping to the displayable range.
    """
    # A few very hot or cold spots must not set the gain.
    centre = float(np.median(kelvin))
    limit = 110.0 / gain_per_k
    inner = np.clip(kelvin, centre - limit, centre + limit)
    slope = float(np.clip(std_grey / max(float(inner.std()), 1e-6), 0.8 * gain_per_k, 2.0 * gain_per_k))
    # Leave headroom above the ground, so that people do not vanish on a white road.
    slope = min(slope, HEADROOM_GREY / max(percentile(inner, 96) - float(inner.mean()), 1e-6))
    grey = (kelvin - np.float32(inner.mean())) * np.float32(slope) + np.float32(mean_grey)
    for _ in range(4):
        grey += np.float32(mean_grey) - np.clip(grey, LOW_GREY, HIGH_GREY).mean()
    return np.asarray(grey, np.float32)


def detail(grey: Field, strength: float, radius_px: float) -> Field:
    """Apply the camera's detail enhancement: light and dark fringes along strong edges."""
    return np.asarray(grey + np.float32(strength) * (grey - cv2.GaussianBlur(grey, (0, 0), radius_px)), np.float32)


def noise(rng: np.random.Generator, shape_hw: tuple[int, int], std_grey: float) -> Field:
    """Return noise as measured on HIT-UAV: neighbouring pixels correlate by about 0.79."""
    white = rng.standard_normal(shape_hw).astype(np.float32)
    n = cv2.GaussianBlur(white, (0, 0), 1.05)
    return np.asarray(n * np.float32(std_grey / float(n.std())), np.float32)


def vignette(shape_hw: tuple[int, int], depth_grey: float) -> Field:
    """Return grey levels to add: 0 in the middle of the frame, `-depth_grey` in its corners."""
    h, w = shape_hw
    y = np.linspace(-1, 1, h, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, w, dtype=np.float32)[None, :]
    return np.asarray(-np.float32(depth_grey) * ((x * x + y * y) / 2) ** 1.5, np.float32)


def codec(grey: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Return a frame after lossy video coding."""
    return np.asarray(Image.open(io.BytesIO(jpeg_bytes(grey, quality))), np.uint8).copy()


def thermal_frame(
    kelvin: Field, gain_per_k: float, std_grey: float, mean_grey: float, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return the (h, w) uint8 white-hot image of (h, w) float32 scene temperatures in kelvin."""
    h, w = kelvin.shape
    grey = gain(optics(kelvin, float(rng.uniform(0.7, 0.95))), gain_per_k, std_grey, mean_grey)
    # Clipped before the enhancement: bodies far above the range get no fringe of matching size.
    grey = detail(np.clip(grey, LOW_GREY - 25, HIGH_GREY + 25), float(rng.uniform(0.45, 0.8)), 1.6)
    grey = grey + noise(rng, (h, w), float(rng.uniform(1.3, 2.1))) + vignette((h, w), float(rng.uniform(2, 8)))
    levels = np.round(np.clip(grey, LOW_GREY + 1, HIGH_GREY)).astype(np.uint8)
    return np.clip(codec(levels, int(rng.integers(58, 80))), int(LOW_GREY), int(HIGH_GREY)).astype(np.uint8)


def radiometric_frame(kelvin: Field, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return the (h, w) centikelvin that a radiometric camera stores: optics and noise, neither gain nor codec."""
    seen = optics(kelvin, float(rng.uniform(0.45, 0.6)))
    seen = seen + (rng.standard_normal(kelvin.shape) * NETD_K).astype(np.float32)
    return CENTIKELVIN.counts(seen)


def tiff_bytes(counts: NDArray[np.uint16]) -> bytes:
    """Encode a radiometric frame: 16-bit grey TIFF."""
    buffer = io.BytesIO()
    Image.fromarray(counts).save(buffer, "TIFF")
    return buffer.getvalue()


def jpeg_bytes(grey: NDArray[np.uint8], quality: int = 95) -> bytes:
    """Encode a frame as HIT-UAV stores it: 8-bit grey JPEG."""
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


# Scale of the made-up DJI counts. Real cameras do not state theirs.
DJI_SCALE = TemperatureScale(0.02, -20.0)
_PLACE = (46.2, 15.1)
# Local time of the first frame, hours ahead of UTC, and seconds between frames.
_START = datetime(2026, 1, 12, 5, 0)
_ZONE_H = 1
_STEP_S = 20
# Blur of the lens, and noise of one reading.
_BLUR_PX = 0.6
_NOISE_K = 0.04
# Every second frame has the laser's distance.
_LASER_EVERY = 2


class PlanRenderer(Protocol):
    """Renderer of a plan, such as `infrablend.lab.world.world_renderer.WorldRenderer`."""

    def render(self, plan: WorldPlan) -> tuple[NDArray[np.float32], list[Label]]:
        """Return the (h, w) temperatures of a frame in kelvin, and a label for every thing that has a class."""


@dataclass(frozen=True, eq=False)
class FinishedFrame:
    """A frame with its image on disk.

    Attributes:
        number: Number of the frame in the dataset, from 0.
        image: Record of the image with its labels.
        facts: Entry of the frame in `world.json`.
    """

    number: int
    image: ImageRecord
    facts: dict[str, object]


def make_frame(frame: FrameFacts, seed: int, renderer: PlanRenderer, folder: Path) -> FinishedFrame:
    """Draw the scene of a frame, render it and write its image to `folder`/<split>/."""
    rng = stream(seed, "world", frame.number, "plan")
    plan = sample_world(rng, frame.pitch_deg, frame.altitude_m, frame.time_of_day, frame.kind, frame.size_wh)
    kelvin, labels = renderer.render(plan)
    look = stream(seed, "world", frame.number, "look")
    path = folder / frame.split / frame.name
    if frame.radiometric:
        write_bytes(path, tiff_bytes(radiometric_frame(kelvin, look)))
    else:
        grey = thermal_frame(kelvin, plan.gain_per_k, plan.std_grey, plan.mean_grey, look)
        if frame.maker is not None:
            counts = stream(seed, "world", frame.number, "counts")
            write_bytes(path, camera_file(frame, plan, kelvin, grey, counts))
        else:
            write_bytes(path, jpeg_bytes(grey) if frame.sequence is None else png_bytes(grey))
    facts = _facts(frame, plan, labels)
    if frame.sequence is not None:
        return FinishedFrame(frame.number, _monet_record(frame, plan, labels, path, seed), facts)
    if frame.maker is not None:
        # What the file of a camera states is in its header, and it has no labels.
        return FinishedFrame(frame.number, ImageRecord(path.stem, path, frame.split, plan.camera.size_wh, ()), facts)
    return FinishedFrame(frame.number, _hit_uav_record(frame, plan, labels, path), facts)


def _hit_uav_record(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label], path: Path) -> ImageRecord:
    instances = tuple(
        Instance(
            category=label.category,
            box_xyxy=np.asarray(label.box_xyxy, np.float64),
            corners_xy=label.corners_xy,
            visibility=label.visibility,
            truncated=label.truncated,
            difficult=label.visibility < 0.5,
            extra={"tight_box": True},
        )
        for label in labels
        if label.box_xyxy is not None
    )
    return ImageRecord(
        id=path.stem,
        path=path,
        split=frame.split,
        size_wh=plan.camera.size_wh,
        instances=instances,
        capture=Capture(
            pitch_deg=frame.pitch_deg,
            altitude_m=frame.altitude_m,
            time_of_day=frame.time_of_day,
            radiometry=Radiometry(CENTIKELVIN, "virtual world", air_k=plan.air_k) if frame.radiometric else None,
        ),
        extra={"weather": "0"},
    )


def _monet_record(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label], path: Path, seed: int) -> ImageRecord:
    """Return MONET's record: axis-aligned boxes of persons and vehicles, and telemetry in `metadata`, if any."""
    boxes = [("person" if i.category == "Person" else "vehicle", i.box_xyxy) for i in labels]
    instances = [Instance(category, np.asarray(box, np.float64)) for category, box in boxes if box is not None]
    return ImageRecord(
        id=f"{frame.sequence}_{path.stem}",
        path=path,
        split=frame.split,
        size_wh=plan.camera.size_wh,
        instances=tuple(instances),
        capture=Capture(
            pitch_deg=frame.pitch_deg if frame.telemetry else None,
            altitude_m=frame.altitude_m if frame.telemetry else None,
            sequence=frame.sequence,
        ),
        extra={"fields": {monet.NEST: telemetry_of(frame, seed)}},
        file_name=frame.name,
    )


def _facts(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label]) -> dict[str, object]:
    """Return the camera, the place, and every object that has a class with its visibility."""
    return {
        "name": frame.name,
        "split": frame.split,
        "kind": plan.kind,
        "air_k": plan.air_k,
        "camera": asdict(plan.camera),
        "objects": [
            {
                "category": label.category,
                "visibility": round(label.visibility, 4),
                "truncated": label.truncated,
                "dropped": label.dropped,
            }
            for label in labels
        ],
    }


def camera_file(
    frame: FrameFacts,
    plan: WorldPlan,
    kelvin: NDArray[np.float32],
    grey: NDArray[np.uint8],
    rng: np.random.Generator,
) -> bytes:
    """Return the radiometric JPEG of a frame: its picture, its temperatures as raw counts, and how it was taken."""
    assert frame.maker is not None
    camera = plan.camera
    w, h = camera.size_wh
    captured = _START + timedelta(seconds=_STEP_S * frame.number)
    shot = Shot(
        pitch_deg=frame.pitch_deg,
        altitude_m=frame.altitude_m,
        captured=captured,
        # Of the same diagonal: the focal length in units of the picture's diagonal, times that of the film.
        focal_length_35mm=camera.focal_px / math.hypot(w, h) * math.hypot(36, 24),
        place=(_PLACE[0] + 1e-4 * frame.number, _PLACE[1]),
        laser_m=frame.altitude_m / math.sin(math.radians(frame.pitch_deg)) if frame.number % _LASER_EVERY else None,
        utc=captured - timedelta(hours=_ZONE_H),
        settings=ObjectSettings(reflected_k=plan.air_k, air_k=plan.air_k),
    )
    seen = optics(kelvin, _BLUR_PX) + _NOISE_K * rng.standard_normal(kelvin.shape).astype(np.float32)
    if frame.maker == "dji":
        counts = DJI_SCALE.counts(seen)
    else:
        counts = np.clip(np.rint(PLANCK.counts(seen.astype(np.float64))), 0, 65_535).astype(np.uint16)
    return radiometric_jpeg(frame.maker, grey, counts, shot)
