#!/usr/bin/env python3
"""Draw the pictures of docs/how_to/tune_the_look.md from the virtual world: no real data, the same bytes every time.

Usage: python scripts/look_pictures.py [OUT [WORLD]]   (default: docs/images/tune_the_look.png; takes about two minutes)
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from infrablend import api

RECIPE = "hit-uav-drone-physical"
FRAME = "train/1_90_30_0_00004_c0"
COUNT = 12
# Caption and settings of each picture.
ROWS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("as the recipe has it", ()),
    ("matching.gain_grey_per_k=[2.5, 3]", ("matching.gain_grey_per_k=[2.5, 3]",)),
    ("matching.gain_grey_per_k=[15, 16]", ("matching.gain_grey_per_k=[15, 16]",)),
    ("objects.0.parts: motors at air temperature", ("objects.0.parts.motor.delta_t_k=[0, 0]",)),
    ("environment: ground 10 K above the air", ("environment.ground_above_air_night_k=[10, 10]",)),
    ("sensor.optics=2", ("sensor.optics=2",)),
    ("sensor.motion_px=[12, 12]", ("sensor.motion_px=[12, 12]",)),
    ("objects.0.range_m=[15, 18]", ("objects.0.range_m=[15, 18]",)),
)
COLUMNS, WINDOW_WH, ZOOM = 4, (100, 75), 3
GAP, CAPTION = 8, 22
PAPER, FAINT = (24, 26, 30), (190, 196, 204)


def main(out: Path, world: Path | None) -> None:
    """Compose the frame with each of the settings and draw the surroundings of its insert, enlarged."""
    width, height = (side * ZOOM for side in WINDOW_WH)
    rows = -(-len(ROWS) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * (width + GAP) + GAP, rows * (height + CAPTION + GAP) + GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    with tempfile.TemporaryDirectory() as scratch:
        data = world or Path(scratch) / "world"
        if world is None:
            api.make_world(data, count=COUNT, seed=0)
        for k, (caption, settings) in enumerate(ROWS):
            x, y = GAP + k % COLUMNS * (width + GAP), GAP + k // COLUMNS * (height + CAPTION + GAP)
            sheet.paste(picture(data, settings), (x, y))
            draw.text((x, y + height + 3), caption, fill=FAINT, font=ImageFont.load_default(14))
    out.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(out, optimize=True)
    print(out)


def picture(data: Path, settings: tuple[str, ...]) -> Image.Image:
    """Return the surroundings of the frame's first insert, enlarged."""
    frame = api.try_recipe(RECIPE, data, FRAME, settings=settings).frame
    if not frame.inserted:
        raise SystemExit(f"{FRAME}: no insert with {', '.join(settings)}; no picture was written")
    x0, y0, x1, y1 = frame.inserted[0].box_xyxy
    height, width = frame.pixels.shape
    left = round(min(max(0, (x0 + x1 - WINDOW_WH[0]) / 2), width - WINDOW_WH[0]))
    top = round(min(max(0, (y0 + y1 - WINDOW_WH[1]) / 2), height - WINDOW_WH[1]))
    part = np.asarray(frame.pixels)[top : top + WINDOW_WH[1], left : left + WINDOW_WH[0]]
    size = (WINDOW_WH[0] * ZOOM, WINDOW_WH[1] * ZOOM)
    return Image.fromarray(part).convert("RGB").resize(size, Image.Resampling.NEAREST)


if __name__ == "__main__":
    main(
        Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs/images/tune_the_look.png"),
        Path(sys.argv[2]) if len(sys.argv) > 2 else None,
    )
