"""Contact sheets: frames with their labels, and every inserted object enlarged to show its edge.

`load_frames` reads the folder of a run, `contact_sheet` draws, `preview_run` does both.
"""

from __future__ import annotations

import io
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from infrablend.core.arguments import require_choices, require_whole
from infrablend.core.dataset import SPLITS, Instance, finite
from infrablend.core.files import DAMAGED, LinkOutError, load_json, read_regular, write_bytes
from infrablend.core.output_checks import require_outside_datasets, require_replaceable
from infrablend.core.rle_masks import Mask
from infrablend.core.run_folder import RunFolder
from infrablend.errors import DatasetError, OutputError
from infrablend.formats.pictures.listing import is_decodable, open_picture

Draw = Literal["boxes", "obb", "masks"]
ALL_DRAWN: tuple[Draw, ...] = ("boxes", "obb", "masks")

Rgb = NDArray[np.uint8]
Colour = tuple[int, int, int]

CONTACT_SHEET = "InfraBlend contact sheet"
"""The mark in the pictures, by which a later call knows that it may replace them."""

PAPER: Colour = (24, 26, 30)
INK: Colour = (236, 238, 242)
FAINT: Colour = (150, 156, 166)

# Inserted objects: one colour per kind of label, distinct for most colour-blind readers too.
INSERTED: dict[Draw, Colour] = {"boxes": (255, 196, 0), "obb": (0, 214, 255), "masks": (255, 64, 160)}
ORIGINAL: dict[Draw, Colour] = {"boxes": (112, 158, 120), "obb": (96, 128, 172), "masks": (112, 158, 120)}
_ORIGINAL_NAME: Colour = (168, 204, 174)
FILL = 0.22  # opacity of the mask's colour

GAP_PX = 12
TITLE_PX = 26
TITLE_FONT_PX = 14
INSET_WH = (310, 240)
INSET_CAPTION_PX = 18
INSET_MARGIN_PX = 8
MAX_INSETS = 3  # pairs per frame
MAX_ZOOM = 4
MIN_ZOOM = 2

_SUBPIXEL_BITS = 4

ANIMATED = {".webp": "WEBP", ".gif": "GIF"}

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PreviewFrame:
    """A frame of a contact sheet.

    Attributes:
        title: Line above the frame: name, split, pitch, altitude.
        pixels: (h, w) or (h, w, 3); uint8 is shown unchanged, other types are stretched from percentile 0.5 to 99.5.
        instances: Labels of the frame.
        frame_id: Id of the frame in its run; empty outside a run.
    """

    title: str
    pixels: NDArray[Any]
    instances: tuple[Instance, ...]
    frame_id: str = ""


# ---- drawing


def contact_sheet(
    frames: Sequence[PreviewFrame],
    out_png: Path,
    draw: Sequence[Draw] = ALL_DRAWN,
    compress_level: int = 6,
) -> Path:
    """Write the frames as one PNG and return its path. The same frames give the same bytes.

    Args:
        frames: Frames in reading order, at least one; sizes may differ.
        out_png: File to write, whole or not at all; its folder is created.
        draw: Labels to draw: `boxes` (thin), `obb`, `masks` (outline and light fill).
        compress_level: zlib's level; 1 takes a third of the time of 6, for larger files.

    Raises:
        OutputError: The file cannot be written.
    """
    columns = min(len(frames), 2 if len(frames) <= 4 else 3 if len(frames) <= 12 else 4)
    sheet = grid([_cell(f, draw) for f in frames], columns)
    sheet = np.concatenate([_legend(sheet.shape[1], draw), sheet])
    return write_sheet(out_png, sheet, compress_level)


def write_sheet(path: Path, sheet: Rgb, compress_level: int = 6) -> Path:
    """Write a contact sheet as a PNG that names InfraBlend as its software, and return its path.

    Raises:
        OutputError: The file exists and is not such a sheet, or cannot be written.
    """
    require_replaceable(path, "contact sheet", ours=_software_of(path) == CONTACT_SHEET)
    buffer = io.BytesIO()
    mark = PngInfo()
    mark.add_text("Software", CONTACT_SHEET)
    Image.fromarray(sheet).save(buffer, "PNG", compress_level=compress_level, pnginfo=mark)
    return write_bytes(path, buffer.getvalue())


def draw_labels(
    picture: Rgb,
    instances: Sequence[Instance],
    draw: Sequence[Draw] = ALL_DRAWN,
    scale: int = 1,
    origin_xy: tuple[int, int] = (0, 0),
    names: bool = True,
) -> Rgb:
    """Return a copy of a picture with labels drawn over it: muted for original objects, inserted ones on top.

    Args:
        picture: (h, w, 3) uint8; pixel (0, 0) is the top left corner of frame pixel `origin_xy`, and each frame pixel
            is `scale` x `scale` pixels.
        instances: Labels in frame coordinates.
        draw: Kinds of label to draw.
        scale: Size of a frame pixel in `picture`.
        origin_xy: Frame pixel in the top left corner of `picture`.
        names: Write the category beside each object.
    """
    canvas = picture.copy()
    ordered = sorted(instances, key=lambda i: i.inserted)
    for i in ordered:
        colours = INSERTED if i.inserted else ORIGINAL
        if "masks" in draw and i.mask is not None:
            _draw_mask(canvas, i.mask, colours["masks"], scale, origin_xy)
        if "boxes" in draw:
            x0, y0, x1, y1 = i.box_xyxy
            corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
            draw_polygon(canvas, corners, colours["boxes"], scale, origin_xy)
        if "obb" in draw and i.corners_xy is not None:
            draw_polygon(canvas, i.corners_xy, colours["obb"], scale, origin_xy)
    return _with_names(canvas, ordered, draw, scale, origin_xy) if names else canvas


def draw_polygon(
    canvas: Rgb,
    corners_xy: NDArray[np.float64],
    colour: Colour,
    scale: int,
    origin_xy: tuple[int, int],
    closed: bool = True,
) -> None:
    """Draw lines through (n, 2) points of the frame; see `draw_labels`."""
    # cv2 counts from pixel centres, we from pixel corners.
    points = (corners_xy - np.asarray(origin_xy)) * scale - 0.5
    # Far outside the canvas cv2 would overflow; clip well beyond what can be seen.
    fixed = np.round(np.clip(points, -30_000, 30_000) * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(canvas, [fixed], closed, colour, 1, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_mask(canvas: Rgb, mask: Mask, colour: Colour, scale: int, origin_xy: tuple[int, int]) -> None:
    h, w = math.ceil(canvas.shape[0] / scale), math.ceil(canvas.shape[1] / scale)
    x, y = origin_xy
    part = mask.to_array()[y : y + h, x : x + w].astype(np.uint8)
    if not part.any():
        return
    part = np.repeat(np.repeat(part, scale, 0), scale, 1)[: canvas.shape[0], : canvas.shape[1]]
    inside = np.zeros(canvas.shape[:2], np.bool_)
    inside[: part.shape[0], : part.shape[1]] = part > 0
    tint = np.asarray(colour, np.float64)
    canvas[inside] = np.round((1 - FILL) * canvas[inside] + FILL * tint).astype(np.uint8)
    outlines, _ = cv2.findContours(part, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(canvas, outlines, -1, colour, 1)


def _with_names(
    canvas: Rgb, instances: Sequence[Instance], draw: Sequence[Draw], scale: int, origin_xy: tuple[int, int]
) -> Rgb:
    image = Image.fromarray(canvas)
    pen = ImageDraw.Draw(image)
    of_inserted = next((INSERTED[d] for d in ALL_DRAWN if d in draw), INK)
    for i in instances:
        font = font_of(13 if i.inserted else 11)
        text = i.category
        if i.inserted and i.visibility is not None and i.visibility < 0.995:
            text += f" {100 * i.visibility:.0f}%"
        x0, y0, _, y1 = ((i.box_xyxy.reshape(2, 2) - origin_xy) * scale).ravel()
        left, top, right, bottom = font.getbbox(text)
        w, h = math.ceil(right - left) + 4, math.ceil(bottom - top) + 4
        x = min(max(0, round(x0)), canvas.shape[1] - w)
        y = round(y0) - h - 2
        if y < 0:  # no room above: below, or inside at the top
            y = round(y1) + 2 if round(y1) + 2 + h <= canvas.shape[0] else max(0, round(y0) + 2)
        colour = of_inserted if i.inserted else _ORIGINAL_NAME
        pen.text(
            (x + 2 - left, y + 2 - top),
            text,
            fill=colour,
            font=font,
            stroke_width=2 if i.inserted else 1,
            stroke_fill=PAPER,
        )
    return np.asarray(image)


def _cell(frame: PreviewFrame, draw: Sequence[Draw]) -> Rgb:
    """Return a frame with its title and, below it, its inserted objects enlarged, without and with labels."""
    plain = to_rgb(frame.pixels)
    rows = [draw_labels(plain, frame.instances, draw)]
    inserted = [i for i in frame.instances if i.inserted]
    for instance in inserted[:MAX_INSETS]:
        rows.append(_inset_pair(plain, frame.instances, instance, draw))
    if len(inserted) > MAX_INSETS:
        more = f"and {len(inserted) - MAX_INSETS} more inserted object(s)"
        rows.append(strip(plain.shape[1], INSET_CAPTION_PX, more, 12, FAINT))
    width = max(r.shape[1] for r in rows)
    return titled(np.concatenate([_pad(r, r.shape[0], width) for r in rows]), frame.title)


def inset_window(instance: Instance, frame_wh: tuple[int, int]) -> tuple[tuple[int, int, int, int], int]:
    """Return the part of the frame that an inset shows, columns and rows `x0, y0, x1, y1`, and its zoom.

    The whole object is shown at the largest whole zoom from 4 down to 2 that fits. If none fits, zoom 2 shows the
    surroundings of the topmost part of the object's edge.
    """
    w, h = frame_wh
    x0, y0, x1, y1 = instance.box_xyxy
    zoom = MAX_ZOOM
    while zoom > MIN_ZOOM and (
        (x1 - x0 + 2 * INSET_MARGIN_PX) * zoom > INSET_WH[0] or (y1 - y0 + 2 * INSET_MARGIN_PX) * zoom > INSET_WH[1]
    ):
        zoom -= 1
    view_w, view_h = min(w, INSET_WH[0] // zoom), min(h, INSET_WH[1] // zoom)
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    if x1 - x0 > view_w or y1 - y0 > view_h:
        cx, cy = _top_of_edge(instance)
    left = min(max(0, round(cx - view_w / 2)), w - view_w)
    top = min(max(0, round(cy - view_h / 2)), h - view_h)
    return (left, top, left + view_w, top + view_h), zoom


def _top_of_edge(instance: Instance) -> tuple[float, float]:
    if instance.mask is not None and instance.mask.area_px:
        rows, columns = np.nonzero(instance.mask.to_array())
        return float(np.median(columns[rows == rows.min()])), float(rows.min())
    x0, y0, x1, _ = (float(v) for v in instance.box_xyxy)
    return (x0 + x1) / 2, y0


def _inset_pair(plain: Rgb, instances: Sequence[Instance], instance: Instance, draw: Sequence[Draw]) -> Rgb:
    (x0, y0, x1, y1), zoom = inset_window(instance, (plain.shape[1], plain.shape[0]))
    large = np.repeat(np.repeat(plain[y0:y1, x0:x1], zoom, 0), zoom, 1)
    labelled = draw_labels(large, instances, draw, zoom, (x0, y0), names=False)
    w, h = INSET_WH
    pair = np.concatenate([_pad(large, h, w), np.full((h, GAP_PX, 3), PAPER, np.uint8), _pad(labelled, h, w)], axis=1)
    bw, bh = instance.box_xyxy[2:] - instance.box_xyxy[:2]
    caption = f"{instance.category}, {bw:.1f} x {bh:.1f} px, enlarged {zoom} times"
    gap = np.full((GAP_PX // 2, pair.shape[1], 3), PAPER, np.uint8)
    return np.concatenate([gap, pair, strip(pair.shape[1], INSET_CAPTION_PX, caption, 12, FAINT)])


def _legend(width: int, draw: Sequence[Draw]) -> Rgb:
    words: dict[Draw, str] = {"boxes": "box", "obb": "oriented box", "masks": "mask"}
    entries = {f"inserted: {words[kind]}": INSERTED[kind] for kind in ALL_DRAWN if kind in draw}
    # Original masks have the colour of original boxes.
    entries |= {f"original: {words[kind]}": ORIGINAL[kind] for kind in ("boxes", "obb") if kind in draw}
    return legend(width, {**entries, "96%: visible share of the object": FAINT})


def legend(width: int, entries: Mapping[str, Colour]) -> Rgb:
    """Return a strip with words in their colours, in as many rows as they need."""
    font = font_of(TITLE_FONT_PX)
    places = []
    x, y = GAP_PX, 0
    for text in entries:
        text_px = math.ceil(font.getlength(text))
        if x > GAP_PX and x + text_px > width:
            x, y = GAP_PX, y + TITLE_PX
        places.append((x, y + (TITLE_PX - TITLE_FONT_PX) // 2))
        x += text_px + 2 * GAP_PX
    image = Image.new("RGB", (width, y + TITLE_PX), PAPER)
    pen = ImageDraw.Draw(image)
    for place, (text, colour) in zip(places, entries.items(), strict=True):
        pen.text(place, text, fill=colour, font=font)
    return np.asarray(image)


def titled(picture: Rgb, title: str) -> Rgb:
    """Return a picture under a line of text."""
    return np.concatenate([strip(picture.shape[1], TITLE_PX, title, TITLE_FONT_PX, INK), picture])


def grid(cells: Sequence[Rgb], columns: int) -> Rgb:
    """Return the pictures as one, `columns` in a row."""
    width = max(c.shape[1] for c in cells)
    rows = []
    for start in range(0, len(cells), columns):
        row = list(cells[start : start + columns])
        height = max(c.shape[0] for c in row)
        blank = np.full((height, width, 3), PAPER, np.uint8)
        padded = row + [blank] * (columns - len(row))
        rows.append(np.concatenate([_pad(c, height + GAP_PX, width + GAP_PX, GAP_PX // 2) for c in padded], axis=1))
    return np.concatenate(rows)


def _pad(picture: Rgb, height: int, width: int, offset_px: int = 0) -> Rgb:
    canvas = np.full((max(height, picture.shape[0]), max(width, picture.shape[1]), 3), PAPER, np.uint8)
    canvas[offset_px : offset_px + picture.shape[0], offset_px : offset_px + picture.shape[1]] = picture
    return canvas


def strip(width: int, height: int, text: str, size_px: int, colour: Colour) -> Rgb:
    """Return a strip with a line of text, shortened with dots if it is too long."""
    image = Image.new("RGB", (width, height), PAPER)
    pen = ImageDraw.Draw(image)
    font = font_of(size_px)
    if pen.textlength(text, font=font) > width - 4:
        while text and pen.textlength(text + "...", font=font) > width - 4:
            text = text[:-1]
        text += "..."
    pen.text((2, (height - size_px) // 2 - 1), text, fill=colour, font=font)
    return np.asarray(image)


def font_of(size_px: int) -> ImageFont.FreeTypeFont:
    """Return Pillow's own outline font, which is the same on every machine."""
    return ImageFont.load_default(size_px)


def to_rgb(pixels: NDArray[Any]) -> Rgb:
    """Return grey or RGB pixels as (h, w, 3) uint8; other types than 8 bit are stretched."""
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise ValueError(f"pixels must be (h, w) or (h, w, 3), got {pixels.shape}")
    pixels = to_8_bit(pixels)
    return pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)


def to_8_bit(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Return 8-bit pixels unchanged, and others stretched from percentile 0.5 to 99.5."""
    if pixels.dtype == np.uint8:
        return pixels
    low, high = np.percentile(pixels, [0.5, 99.5])
    levels = np.clip((pixels - low) / max(float(high - low), 1e-12) * 255, 0, 255)
    return np.asarray(levels.round(), np.uint8)


# ---- reading a run


def preview_run(run: Path, out_png: Path, count: int = 12, draw: Sequence[Draw] = ALL_DRAWN) -> Path:
    """Write the contact sheet of a run folder and return its path.

    A file with the suffix `.webp` or `.gif` is an animation of the first `count` frames with inserted objects, one
    after the other.

    Raises:
        ArgumentError: `count` is below 1, or `draw` is not a list of `Draw`.
        DatasetError: The folder is not a run, or contains no frames.
        OutputError: The sheet cannot be written, or would be written into a dataset.
    """
    require_outside_datasets(run, out_png)
    require_choices("draw", draw, get_args(Draw))
    if out_png.suffix.lower() in ANIMATED:
        return _animation(load_frames(run, count, in_a_row=True), out_png, draw)
    return contact_sheet(load_frames(run, count), out_png, draw=draw)


def _animation(frames: Sequence[PreviewFrame], out: Path, draw: Sequence[Draw]) -> Path:
    """Write the frames one after the other, as far as they have the size of the first, and return the path."""
    require_replaceable(out, "contact sheet", ours=_software_of(out) == CONTACT_SHEET)
    shown = [Image.fromarray(draw_labels(to_rgb(f.pixels), f.instances, draw)) for f in frames]
    same = [picture for picture in shown if picture.size == shown[0].size]
    buffer = io.BytesIO()
    mark = CONTACT_SHEET.encode()
    same[0].save(
        buffer, ANIMATED[out.suffix.lower()], save_all=True, append_images=same[1:], duration=40, loop=0,
        comment=mark, xmp=mark,
    )  # fmt: skip
    return write_bytes(out, buffer.getvalue())


def load_frames(run: Path, count: int | None = None, *, in_a_row: bool = False) -> list[PreviewFrame]:
    """Return frames of a run folder with their labels.

    Labels are read from the COCO files. A run without these is read from its ledger, which contains only the inserted
    objects.

    Args:
        run: Folder of a run.
        count: Largest number of frames, spread evenly over those with inserted objects, or over all if there are none.
        in_a_row: Return the first of them instead, one after the other.

    Raises:
        ArgumentError: `count` is below 1.
        OutputError: The folder is not a run.
        DatasetError: It contains no frames, or a frame cannot be read.
    """
    if count is not None:
        require_whole("count", count, 1)
    layout = RunFolder(run)
    found = [entry for split in SPLITS if layout.coco_file(split).is_file() for entry in _coco_entries(layout, split)]
    if not found:
        found = [(r.frame_id.split("/")[0], layout.image(r.image), r.inserted) for r in layout.records()]
    if not found:
        raise DatasetError(f"{run}: a run without frames; expected at least one")
    found = [entry for entry in found if any(i.inserted for i in entry[2])] or found
    frames = []
    wanted = len(found) if count is None else count
    for n in range(min(wanted, len(found))) if in_a_row else spread(len(found), wanted):
        split, path, instances = found[n]
        frame_id = f"{split}/{path.stem}"
        pixels = decode_picture(path, "a frame of the run. Run `generate --resume`", run)
        frames.append(PreviewFrame(_title(layout, frame_id), pixels, instances, frame_id))
    return frames


def spread(count: int, wanted: int) -> list[int]:
    """Return at most `wanted` of `count` numbers at even steps."""
    return list(range(count)) if count <= wanted else [(2 * k + 1) * count // (2 * wanted) for k in range(wanted)]


def _coco_entries(layout: RunFolder, split: str) -> list[tuple[str, Path, tuple[Instance, ...]]]:
    path = layout.coco_file(split)
    try:
        document = load_json(path)
        names = {int(c["id"]): str(c["name"]) for c in document["categories"]}
        sizes = {i["id"]: (int(i["width"]), int(i["height"])) for i in document["images"]}
        by_image: dict[Any, list[Instance]] = {}
        for a in document["annotations"]:
            by_image.setdefault(a["image_id"], []).append(_instance(a, names, sizes[a["image_id"]]))
        images = sorted(document["images"], key=lambda i: str(i["file_name"]))
        return [(split, layout.image(f"{split}/{i['file_name']}"), tuple(by_image.get(i["id"], ()))) for i in images]
    except DAMAGED as e:
        raise DatasetError(
            f"{path}: not a COCO file that InfraBlend wrote ({type(e).__name__}: {e}). Run `generate --resume`."
        ) from e


def _instance(a: Mapping[str, Any], names: Mapping[int, str], size_wh: tuple[int, int]) -> Instance:
    x, y, w, h = (float(v) for v in a["bbox"])
    corners = finite(a["obb"]).reshape(4, 2) if a.get("obb") else None
    visibility = a.get("visibility")
    outline = a.get("segmentation")
    mask = None
    # An outline that was derived from a box is not a mask.
    if outline and a.get("segmentation_from", "mask") == "mask":
        read = Mask.from_rings if isinstance(outline, list) else Mask.from_coco
        mask = read(outline, size_wh[::-1])
    return Instance(
        names[int(a["category_id"])],
        finite([x, y, x + w, y + h]),
        corners,
        mask,
        None if visibility is None else float(visibility),
        inserted=bool(a.get("inserted")),
        source_id=a.get("id"),
    )


def _title(layout: RunFolder, frame_id: str) -> str:
    """Return name, pitch, altitude and time of day, as far as they are known."""
    parts = [frame_id]
    facts = {}
    try:
        record = layout.record(frame_id)
        facts = dict(record.background)
        if record.scene is not None:
            # Pitch and height of the camera differ from the metadata if a recipe fixes or draws them.
            facts["pitch_deg"] = math.degrees(record.scene.camera.pitch_rad)
            if (view := record.scene.view) is not None:
                facts["altitude_m"] = round(view.stated_height_m, 1)
    except OutputError:
        log.debug("%s: no record, so its title is shorter", frame_id)
    if facts.get("pitch_deg") is not None:
        parts.append(f"pitch {round(float(facts['pitch_deg']), 1):g}\u00b0")
    if facts.get("altitude_m") is not None:
        parts.append(f"altitude {float(facts['altitude_m']):g} m")
    if facts.get("time_of_day"):
        parts.append(str(facts["time_of_day"]) + (f" ({facts['time_from']})" if facts.get("time_from") else ""))
    return "   ".join(parts)


def decode_picture(path: Path, expected: str, folder: Path | None = None) -> NDArray[Any]:
    """Return the pixels of a picture, (h, w), or (h, w, 3) in the order red, green, blue.

    Args:
        path: The file.
        expected: What it should be, and what to do if it is not, in words.
        folder: Folder that owns it, see `open_regular`.

    Raises:
        DatasetError: It cannot be read, is a link out of the folder, or has more than `MAX_PIXELS` pixels.
    """
    pixels = None
    try:
        data = read_regular(path, folder)
        if is_decodable(data):
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except LinkOutError as error:
        raise DatasetError(f"{path}: {error}") from error
    except (OSError, ValueError, cv2.error) as error:
        log.debug("%s: %s", path, error)
    if pixels is None:
        raise DatasetError(f"{path}: not a readable picture; expected {expected}")
    return np.ascontiguousarray(pixels[:, :, 2::-1] if pixels.ndim == 3 else pixels)


def _software_of(path: Path) -> str | None:
    """Return the program that a picture names as its author; None if it names none or cannot be read."""
    try:
        with open_picture(path, ("PNG", "WEBP", "GIF")) as picture:
            named = next((v for k in ("Software", "comment", "xmp") if (v := picture.info.get(k)) is not None), None)
    except (OSError, ValueError, SyntaxError, ImportError):  # Ultralytics, once imported, tries a library it may lack
        return None
    return named.decode("utf-8", "replace") if isinstance(named, bytes) else named
