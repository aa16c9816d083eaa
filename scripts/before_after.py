#!/usr/bin/env python3
"""Draw the before-and-after picture of the README from the virtual world: no real data, the same bytes every time.

Usage: python scripts/before_after.py [OUT]      (default: docs/images/before_after.png; takes about two minutes)
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from pycocotools import mask as coco_mask

COMMAND = str(Path(sys.executable).with_name("infrablend"))
# Title, options of `world`, recipe, frame, and the part of the picture to show: left, top, width (4:3).
ROWS: tuple[tuple[str, tuple[str, ...], str, str, tuple[int, int, int]], ...] = (
    (
        "drone, the paper's look (hit-uav-drone)",
        ("--count", "12", "--seed", "0"),
        "hit-uav-drone",
        "train/1_100_50_0_00009_c0",
        (20, 150, 400),
    ),
    (
        "deer, real camera and physics (monet-deer-physical)",
        ("--count", "8", "--seed", "1", "--layout", "monet"),
        "monet-deer-physical",
        "test/dirtroad_03_image00000_c0",
        (60, 40, 400),
    ),
)
PANEL_WH = (400, 300)
GAP, HEADER, CAPTION = 8, 28, 24
PAPER, INK, FAINT = (24, 26, 30), (236, 238, 242), (150, 156, 166)
BOX, ORIENTED, MASK, ORIGINAL = (255, 196, 0), (0, 214, 255), (255, 64, 160), (112, 190, 130)


def main(out: Path) -> None:
    """Make the worlds and runs in a temporary folder and draw one row per run."""
    width = 3 * PANEL_WH[0] + 4 * GAP
    height = HEADER + len(ROWS) * (PANEL_WH[1] + CAPTION + GAP)
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(15)
    for column, title in enumerate(("background", "with the inserted object", "with its labels")):
        draw.text((GAP + column * (PANEL_WH[0] + GAP), 6), title, fill=INK, font=font)
    with tempfile.TemporaryDirectory() as scratch:
        for row, (caption, world_options, recipe, frame_id, window) in enumerate(ROWS):
            run = generate(Path(scratch) / str(row), world_options, recipe)
            top = HEADER + row * (PANEL_WH[1] + CAPTION + GAP)
            for column, panel in enumerate(panels(run, frame_id, window)):
                sheet.paste(panel, (GAP + column * (PANEL_WH[0] + GAP), top))
            draw.text((GAP, top + PANEL_WH[1] + 3), caption, fill=FAINT, font=font)
    out.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(out, optimize=True)
    print(out)


def generate(folder: Path, world_options: tuple[str, ...], recipe: str) -> Path:
    """Render a virtual world and a run on it; returns the run folder."""
    world, run = folder / "world", folder / "run"
    call([COMMAND, "-q", "world", "--out", str(world), *world_options])
    # Some images of the virtual MONET have no telemetry, as in the real one; a run without them exits with 1.
    call([COMMAND, "-q", "generate", recipe, "--data", str(world), "--out", str(run), "--seed", "0"], accepted=(0, 1))
    return run


def call(command: list[str], accepted: tuple[int, ...] = (0,)) -> str:
    """Return what a command prints; exit with its messages if its exit code is not accepted."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in accepted:
        text = f"{' '.join(command)}\nended with exit code {done.returncode}; no picture was written:\n{done.stderr}"
        raise SystemExit(text)
    return done.stdout


def panels(run: Path, frame_id: str, window: tuple[int, int, int]) -> list[Image.Image]:
    """Background, generated picture, and the picture with its labels, all cropped to the window."""
    record = json.loads(call([COMMAND, "show", str(run), frame_id]))
    root = Path(json.loads((run / "run.json").read_text("utf-8"))["data"]["root"])
    before = Image.open(root / record["background"]["path"]).convert("RGB")
    after = Image.open(run / "images" / record["image"]).convert("RGB")
    return [crop(before, window), crop(after, window), labelled(after, run, record["image"], window)]


def crop(picture: Image.Image, window: tuple[int, int, int]) -> Image.Image:
    """Return the window of a picture, scaled to a panel."""
    left, top, width = window
    height = width * PANEL_WH[1] // PANEL_WH[0]
    return picture.crop((left, top, left + width, top + height)).resize(PANEL_WH, Image.Resampling.LANCZOS)


def labelled(picture: Image.Image, run: Path, name: str, window: tuple[int, int, int]) -> Image.Image:
    """Return the window with boxes, oriented boxes and masks drawn at the panel's resolution."""
    labels = json.loads((run / "coco" / f"{name.partition('/')[0]}.json").read_text("utf-8"))
    image = next(i for i in labels["images"] if i["file_name"].endswith(Path(name).name))
    annotations: list[dict[str, Any]] = [a for a in labels["annotations"] if a["image_id"] == image["id"]]
    pixels = np.array(picture)
    for a in annotations:
        if a.get("inserted"):
            mask = coco_mask.decode(a["segmentation"]).astype(bool)
            pixels[mask] = (0.55 * pixels[mask] + 0.45 * np.array(MASK)).astype(np.uint8)
    panel = crop(Image.fromarray(pixels), window)
    draw = ImageDraw.Draw(panel)
    left, top, width = window
    scale = PANEL_WH[0] / width

    def at(x: float, y: float) -> tuple[float, float]:
        return (x - left) * scale, (y - top) * scale

    for a in annotations:
        x, y, w, h = a["bbox"]
        if a.get("inserted"):
            corners = np.array(a["obb"]).reshape(-1, 2)
            draw.polygon([at(*c) for c in corners], outline=ORIENTED, width=2)
            draw.rectangle([at(x, y), at(x + w, y + h)], outline=BOX, width=2)
        else:
            draw.rectangle([at(x, y), at(x + w, y + h)], outline=ORIGINAL, width=1)
    return panel


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/before_after.png"))
