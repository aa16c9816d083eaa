"""A sheet of frames with the ground plane that metric placement assumes, so that errors in scale are visible.

It shows a grid of the ground plane, and a person of 1.7 m or a car of 4.6 x 1.8 x 1.45 m beside each annotated one, in
frames of a run or in pictures of a dataset. If their sizes differ, the camera's height, pitch or focal length is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import Dataset, ImageRecord, Instance, known_class
from infrablend.core.ground_plane import at_height, ground_point, ground_z_m
from infrablend.core.ledger import LEDGER
from infrablend.core.output_checks import require_outside_datasets
from infrablend.core.run_folder import RUN_FILE, SHARDS_FILE, RunFolder
from infrablend.core.scene import SceneSpec
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background
from infrablend.report.preview import (
    PreviewFrame,
    Rgb,
    draw_polygon,
    grid,
    legend,
    load_frames,
    spread,
    titled,
    to_rgb,
    write_sheet,
)
from infrablend.sampling.calibration import FROM_TABLE, PRIORS, calibrate

# Plurals of the classes whose size in the scene is known.
_MANY = {"person": "people", "car": "cars"}
SCALE = 2
PERSON_M = (0.3, 0.5, 1.7)  # depth, width, height
CAR_M = (4.6, 1.8, 1.45)
_GRID = (74, 150, 170)
_PERSON = (255, 196, 0)
_CAR = (255, 64, 160)
_LABELLED = (112, 158, 120)
LEGEND = {
    "the ground, as a grid": _GRID,
    "a person of 1.7 m": _PERSON,
    "a car of 4.6 m": _CAR,
    "labels of the data, to compare": _LABELLED,
}
_SPACINGS_M = (1, 2, 5, 10, 20, 50, 100, 200)
_MAX_REFERENCES = 12
# What a picture of a dataset has to state, and the width of a sensor by which its lens is described.
_NEEDED = ("pitch_deg", "altitude_m", "hfov_deg")
_SENSOR_MM = 36.0


def ground_sheet(run: Path, out_png: Path, count: int = 6) -> Path:
    """Write a PNG of frames with the assumed ground drawn over them.

    Args:
        run: Folder of a run with metric placement.
        out_png: File to write, as a whole or not at all.
        count: Largest number of frames.

    Raises:
        DatasetError: There is no run, or it has no metric placement.
        OutputError: The sheet cannot be written, or would be written into a dataset.
    """
    require_outside_datasets(run, out_png)
    cells = []
    for frame in load_frames(run, count):
        scene = RunFolder(run).record(frame.frame_id).scene
        if scene is None or scene.view is None:
            raise DatasetError(
                f"{run}: objects are placed as in the paper, without a real ground; expected a run with metric "
                "placement. Use a recipe with placement.mode: metric, such as hit-uav-drone-physical."
            )
        cells.append(_cell(frame, scene))
    return _write(cells, out_png)


def is_data(folder: Path) -> bool:
    """Return whether a folder holds a dataset that no run made, finished or not."""
    return folder.is_dir() and not any((folder / name).exists() for name in (RUN_FILE, SHARDS_FILE, LEDGER))


def data_ground_sheet(dataset: Dataset, out_png: Path, count: int = 6) -> Path:
    """Write a PNG of pictures of a dataset with the ground that their stated pitch, height and lens mean.

    Args:
        dataset: Dataset, before any run; pictures with labels are preferred.
        out_png: File to write, as a whole or not at all.
        count: Largest number of pictures.

    Raises:
        DatasetError: No picture states all three, or one cannot be read.
        OutputError: The sheet cannot be written, or would be written into a dataset.
    """
    require_outside_datasets(dataset.root, out_png)
    stated = [i for i in dataset.images if all(getattr(i.capture, name) is not None for name in _NEEDED)]
    if not stated:
        found = f"no picture of {len(dataset.images)} states all of {', '.join(_NEEDED)}"
        todo = "state them in metadata.csv (or --metadata FILE); or make a run, whose recipe may state them"
        problem = Problem(dataset.root.name, "flight-missing", found, "pitch, height and lens of the camera", todo)
        raise DatasetError(f"{dataset.root}: the ground cannot be drawn", [problem])
    chosen = [i for i in stated if i.instances] or stated
    return _write([_data_cell(chosen[k]) for k in spread(len(chosen), count)], out_png)


def _data_cell(image: ImageRecord) -> Rgb:
    capture = image.capture
    assert capture.pitch_deg is not None and capture.altitude_m is not None and capture.hfov_deg is not None
    background = load_background(image.path, image.size_wh)
    stated_m = capture.altitude_m
    focal_mm = _SENSOR_MM / 2 / math.tan(math.radians(capture.hfov_deg) / 2)
    turns = (math.radians(capture.pitch_deg), math.radians(capture.roll_deg or 0.0))
    camera = at_height(CameraSpec(1.0, *turns, focal_mm, _SENSOR_MM, background.size_wh), stated_m)
    prior = PRIORS.get(str(capture.altitude_from), FROM_TABLE)
    by_labels = calibrate(camera, stated_m, _real(image.instances), prior)
    canvas, spacing = draw_ground(to_rgb(background.pixels), image.instances, camera, ground_z_m(camera, stated_m))
    rests = _counted(by_labels.anchors)
    source = f"{by_labels.height_m:.3g} m with the size of {rests}" if rests else "no label of known size"
    title = f"{image.split}/{image.name}   pitch {capture.pitch_deg:.0f}\u00b0   stated {stated_m:.3g} m, {source}"
    return titled(canvas, f"{title}   grid {spacing} m")


def _real(instances: Sequence[Instance]) -> list[Instance]:
    """Return the labels of what the camera saw: inserted objects have the size that is to be checked."""
    return [i for i in instances if not i.inserted]


def _counted(anchors: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {k if n == 1 else _MANY.get(k, k)}" for k, n in sorted(anchors.items()))


def _write(cells: Sequence[Rgb], out_png: Path) -> Path:
    sheet = grid(cells, min(len(cells), 2))
    return write_sheet(out_png, np.concatenate([legend(sheet.shape[1], LEGEND), sheet]))


def _cell(frame: PreviewFrame, scene: SceneSpec) -> Rgb:
    view = scene.view
    assert view is not None
    canvas, spacing = draw_ground(to_rgb(frame.pixels), frame.instances, scene.camera, view.ground_z_m)
    rests = _counted(view.anchors)
    as_stated = view.camera_height_m == view.stated_height_m
    source = f"from {rests}" if rests else "as stated" if as_stated else "no object of known size"
    pitch = math.degrees(scene.camera.pitch_rad)
    title = (
        f"{frame.frame_id}   pitch {pitch:.0f}\u00b0   stated {view.stated_height_m:.0f} m, "
        f"used {view.camera_height_m:.0f} m ({source})   grid {spacing} m"
    )
    return titled(canvas, title)


def draw_ground(plain: Rgb, labels: Sequence[Instance], camera: CameraSpec, ground_m: float) -> tuple[Rgb, int]:
    """Return a picture with the assumed ground over it, enlarged `SCALE` times, and the spacing of its lines, metres.

    People of 1.7 m stand beside labelled ones and at five places; cars stand beside labelled cars. Inserted objects
    are no such labels: they have the size that the camera gives them, whether it is right or wrong.
    """
    canvas = np.repeat(np.repeat(plain, SCALE, 0), SCALE, 1)
    spacing = _draw_grid(canvas, camera, ground_m)
    references = 0
    for label in _real(labels):
        x0, y0, x1, y1 = label.box_xyxy
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        draw_polygon(canvas, corners, _LABELLED, SCALE, (0, 0))
        size = {"person": PERSON_M, "car": CAR_M}.get(known_class(label.category) or "")
        if size is None or references >= _MAX_REFERENCES:
            continue
        # Its middle is the box's: low cameras see the ground there far behind it.
        place = ground_point(camera, float(x0 + x1) / 2, float(y0 + y1) / 2, ground_m + size[2] / 2)
        if place is None:
            continue
        place[2] = ground_m
        references += 1
        aside = 1.0 if size is PERSON_M else 4.0
        _draw_cuboid(canvas, camera, place + np.array([aside, 0, 0]), size, _PERSON if size is PERSON_M else _CAR)
    w, h = camera.size_wh
    for u, v in ((0.25, 0.25), (0.75, 0.25), (0.5, 0.5), (0.25, 0.75), (0.75, 0.75)):
        if (place := ground_point(camera, u * w, v * h, ground_m)) is not None:
            _draw_cuboid(canvas, camera, place, PERSON_M, _PERSON)
    return canvas, spacing


def _draw_grid(canvas: Rgb, camera: CameraSpec, ground_m: float) -> int:
    """Draw lines of the ground plane and return their spacing in metres."""
    w, h = camera.size_wh
    corners = [ground_point(camera, u, v, ground_m) for u in (0.0, w / 2, float(w)) for v in (0.0, h / 2, float(h))]
    seen = np.array([c for c in corners if c is not None])
    if not len(seen):
        return 0
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    # Near the horizon the plane extends for kilometres.
    high = np.minimum(high, low + 400.0)
    spacing = next((s for s in _SPACINGS_M if (high - low).max() / s <= 14), _SPACINGS_M[-1])
    low, high = np.floor(low / spacing) * spacing, np.ceil(high / spacing) * spacing
    for axis in (0, 1):
        along = np.linspace(low[1 - axis], high[1 - axis], 60)
        for value in np.arange(low[axis], high[axis] + spacing / 2, spacing):
            points = np.empty((len(along), 3))
            points[:, axis], points[:, 1 - axis], points[:, 2] = value, along, ground_m
            xy, depth = camera.project(points)
            if (depth > 0).sum() > 1:
                draw_polygon(canvas, xy[depth > 0], _GRID, SCALE, (0, 0), closed=False)
    return spacing


def _draw_cuboid(
    canvas: Rgb,
    camera: CameraSpec,
    foot_m: NDArray[np.float64],
    size_m: tuple[float, float, float],
    colour: tuple[int, int, int],
) -> None:
    """Draw the outline of a cuboid standing on the ground, with its length across the view."""
    length, width, height = size_m
    if size_m is PERSON_M:
        length, width = width, length
    box = np.array([(i * length, j * width, k * height) for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (0, 1)])
    xy, depth = camera.project(box + foot_m)
    if (depth > 0.1).all():
        hull = cv2.convexHull(xy.astype(np.float32)).reshape(-1, 2).astype(np.float64)
        draw_polygon(canvas, hull, colour, SCALE, (0, 0))
