#!/usr/bin/env python3
"""Draw the pictures of the README and of docs/explanation/paper.md from the virtual world: no real data, same bytes.

Usage: python scripts/paper_pictures.py [FOLDER]      (default: docs/images; takes about two minutes)
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont, ImageOps
from pycocotools import mask as coco_mask

from infrablend import api

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
        (310, 40, 440),
    ),
)
# Frames of both runs for the figure of viewpoints, by index of the row; three per line.
VIEWPOINTS: tuple[tuple[int, str, str], ...] = (
    (0, "train/1_90_30_0_00004_c0", "drone, pitch 30°"),
    (0, "test/1_60_40_0_00001_c1", "drone, pitch 40°"),
    (0, "train/1_100_50_0_00009_c1", "drone, pitch 50°"),
    (0, "train/0_130_70_0_00006_c1", "drone, pitch 70°"),
    (0, "train/0_80_80_0_00008_c1", "drone, pitch 80°"),
    (0, "train/1_70_90_0_00003_c1", "drone, pitch 90°"),
    (1, "train/dirtroad_02_image00000_c0", "deer, pitch 28°"),
    (1, "test/dirtroad_03_image00000_c0", "deer, pitch 48°"),
    (1, "train/dirtroad_02_image00001_c0", "deer, pitch 79°"),
)
# The lower part of the sheet of a model: its parts, numbered, beside their temperatures.
MODELS: tuple[tuple[str, dict[str, str]], ...] = (("drone", {}), ("deer", {"pose": "walking"}))
PARTS_WH = (1140, 480)
PANEL_WH = (400, 300)
GAP, HEADER, CAPTION = 8, 28, 24
PAPER, INK, FAINT = (24, 26, 30), (236, 238, 242), (150, 156, 166)
BOX, ORIENTED, MASK, ORIGINAL = (255, 196, 0), (0, 214, 255), (255, 64, 160), (112, 190, 130)


def main(folder: Path) -> None:
    """Make the worlds and runs in a temporary folder and draw one picture after the other."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        runs = [generate(Path(scratch) / recipe, options, recipe) for _, options, recipe, _, _ in ROWS]
        for name, sheet in (
            ("before_after.png", before_after(runs)),
            ("models.png", models(Path(scratch))),
            ("viewpoints.png", viewpoints(runs)),
        ):
            sheet.save(folder / name, optimize=True)
            print(folder / name)


def before_after(runs: list[Path]) -> Image.Image:
    """Draw a row per run: a background, the same with the insert, and its labels."""
    width = 3 * PANEL_WH[0] + 4 * GAP
    height = HEADER + len(ROWS) * (PANEL_WH[1] + CAPTION + GAP)
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(15)
    for column, title in enumerate(("background", "with the inserted object", "with its labels")):
        draw.text((GAP + column * (PANEL_WH[0] + GAP), 6), title, fill=INK, font=font)
    for row, (caption, _options, _recipe, frame_id, window) in enumerate(ROWS):
        top = HEADER + row * (PANEL_WH[1] + CAPTION + GAP)
        for column, panel in enumerate(panels(runs[row], frame_id, window)):
            sheet.paste(panel, (GAP + column * (PANEL_WH[0] + GAP), top))
        draw.text((GAP, top + PANEL_WH[1] + 3), caption, fill=FAINT, font=font)
    return sheet


def models(folder: Path) -> Image.Image:
    """Draw the numbered parts of the paper's two models, one below the other."""
    sheet = Image.new("RGB", (PARTS_WH[0], len(MODELS) * (PARTS_WH[1] + GAP) - GAP), PAPER)
    for row, (name, options) in enumerate(MODELS):
        shown = Image.open(api.show_model(name, folder / f"{name}.png", options=options)).convert("RGB")
        parts = shown.crop((0, shown.height - PARTS_WH[1], PARTS_WH[0], shown.height))
        sheet.paste(parts, (0, row * (PARTS_WH[1] + GAP)))
    return sheet


def viewpoints(runs: list[Path]) -> Image.Image:
    """Draw whole pictures of both runs, from small to large camera pitch."""
    width, height = 3 * PANEL_WH[0] + 4 * GAP, PANEL_WH[0] * 4 // 5 + CAPTION + GAP
    sheet = Image.new("RGB", (width, GAP + len(VIEWPOINTS) // 3 * height), PAPER)
    draw = ImageDraw.Draw(sheet)
    for k, (run, frame_id, caption) in enumerate(VIEWPOINTS):
        record = json.loads(call([COMMAND, "show", str(runs[run]), frame_id]))
        left, top = GAP + k % 3 * (PANEL_WH[0] + GAP), GAP + k // 3 * height
        picture = Image.open(runs[run] / "images" / record["image"]).convert("RGB")
        sheet.paste(ImageOps.fit(picture, (PANEL_WH[0], height - CAPTION - GAP)), (left, top))
        draw.text((left, top + height - CAPTION - GAP + 3), caption, fill=FAINT, font=ImageFont.load_default(15))
    return sheet.convert("L")


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
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images"))
