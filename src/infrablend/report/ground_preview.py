"""A sheet of frames with the ground plane that metric placement assumes, so that errors in scale are visible.

It shows a grid of the ground plane, and a person of 1.7 m or a car of 4.6 x 1.8 x 1.45 m beside each annotated one. If
their sizes differ, the camera's height, pitch or focal length is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import Instance, known_class
from infrablend.core.ground_plane import ground_point
from infrablend.core.output_checks import require_outside_datasets
from infrablend.core.run_folder import RunFolder
from infrablend.core.scene import SceneSpec
from infrablend.errors import DatasetError
from infrablend.report.preview import (
    INK,
    TITLE_PX,
    PreviewFrame,
    Rgb,
    draw_polygon,
    font_of,
    grid,
    load_frames,
    to_rgb,
    write_sheet,
)
from infrablend.report.preview import strip as text_strip

# Plurals of the classes whose size in the scene is known.
_MANY = {"person": "people", "car": "cars"}
SCALE = 2
PERSON_M = (0.3, 0.5, 1.7)  # depth, width, height
CAR_M = (4.6, 1.8, 1.45)
_GRID = (74, 150, 170)
_PERSON = (255, 196, 0)
_CAR = (255, 64, 160)
_LABELLED = (112, 158, 120)
_LEGEND = {
    "the ground, as a grid": _GRID,
    "a person of 1.7 m": _PERSON,
    "a car of 4.6 m": _CAR,
    "labels, to compare in size": _LABELLED,
}
_LEGEND_PX = 14
_LEGEND_MARGIN_PX = 4
_SPACINGS_M = (1, 2, 5, 10, 20, 50, 100, 200)
_MAX_REFERENCES = 12
_STANDING_WITHIN_M = 0.5  # simulated motion may move an object a little off the ground


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
    sheet = grid(cells, min(len(cells), 2))
    sheet = np.concatenate([_legend(sheet.shape[1]), sheet])
    return write_sheet(out_png, sheet)


def comparable(instances: Sequence[Instance], scene: SceneSpec) -> list[Instance]:
    """Return the labels whose size can be compared on the ground: original objects, and inserted ones that stand.

    An object in flight is nearer to the camera than the ground behind it.
    """
    assert scene.view is not None
    ground_m = scene.view.ground_z_m
    flying = {o.category for o in scene.objects if abs(o.position_m[2] - ground_m) > _STANDING_WITHIN_M}
    return [i for i in instances if not (i.inserted and i.category in flying)]


def _legend(width: int) -> Rgb:
    """Return the legend in one row, or in two or four if the sheet is too narrow for it."""
    longest = max(font_of(_LEGEND_PX).getlength(text) for text in _LEGEND)
    columns = next((n for n in (4, 2) if longest <= width // n - _LEGEND_MARGIN_PX), 1)
    widths = np.diff(np.linspace(0, width, columns + 1).astype(int))
    rows = []
    texts = list(_LEGEND.items())
    for first in range(0, len(texts), columns):
        strips = zip(widths, texts[first : first + columns], strict=True)
        parts = [text_strip(int(w), TITLE_PX, text, _LEGEND_PX, colour) for w, (text, colour) in strips]
        rows.append(np.concatenate(parts, axis=1))
    return np.concatenate(rows)


def _cell(frame: PreviewFrame, scene: SceneSpec) -> Rgb:
    view = scene.view
    assert view is not None
    canvas, spacing = draw_ground(to_rgb(frame.pixels), frame.instances, scene)
    rests = ", ".join(f"{n} {k if n == 1 else _MANY.get(k, k)}" for k, n in sorted(view.anchors.items()))
    as_stated = view.camera_height_m == view.stated_height_m
    source = f"from {rests}" if rests else "as stated" if as_stated else "no object of known size"
    pitch = math.degrees(scene.camera.pitch_rad)
    title = (
        f"{frame.frame_id}   pitch {pitch:.0f}\u00b0   stated {view.stated_height_m:.0f} m, "
        f"used {view.camera_height_m:.0f} m ({source})   grid {spacing} m"
    )
    return np.concatenate([text_strip(canvas.shape[1], TITLE_PX, title, 14, INK), canvas])


def draw_ground(plain: Rgb, labels: Sequence[Instance], scene: SceneSpec) -> tuple[Rgb, int]:
    """Return a picture with the assumed ground over it, enlarged `SCALE` times, and the spacing of its lines, metres.

    People of 1.7 m stand beside labelled ones and at five places; cars stand beside labelled cars.
    """
    canvas = np.repeat(np.repeat(plain, SCALE, 0), SCALE, 1)
    camera = scene.camera
    view = scene.view
    assert view is not None
    spacing = _draw_grid(canvas, camera, view.ground_z_m)
    references = 0
    for label in comparable(labels, scene):
        x0, y0, x1, y1 = label.box_xyxy
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        draw_polygon(canvas, corners, _LABELLED, SCALE, (0, 0))
        size = {"person": PERSON_M, "car": CAR_M}.get(known_class(label.category) or "")
        place = ground_point(camera, float(x0 + x1) / 2, float(y0 + y1) / 2, view.ground_z_m)
        if size is None or place is None or references >= _MAX_REFERENCES:
            continue
        references += 1
        aside = 1.0 if size is PERSON_M else 4.0
        _draw_cuboid(canvas, camera, place + np.array([aside, 0, 0]), size, _PERSON if size is PERSON_M else _CAR)
    w, h = camera.size_wh
    for u, v in ((0.25, 0.25), (0.75, 0.25), (0.5, 0.5), (0.25, 0.75), (0.75, 0.75)):
        if (place := ground_point(camera, u * w, v * h, view.ground_z_m)) is not None:
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
