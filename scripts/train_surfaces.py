#!/usr/bin/env python
"""Trains the model that finds surfaces, `infrablend/imaging/surfaces.onnx.xz`, on the virtual world alone.

    .venv/bin/python scripts/train_surfaces.py render build/surfaces --count 1200       # needs Blender
    TRAIN/python scripts/train_surfaces.py train build/surfaces --steps 2400            # needs torch
    TRAIN/python scripts/train_surfaces.py export build/surfaces                        # needs torch and onnx

`render` makes scenes of all kinds of places, seen by cameras of many fields of view from many heights, as temperatures
and the kind of surface at each pixel. `train` shows them to the network as very different cameras would: gain,
clipping, local contrast, polarity, blur, noise, codec. It goes on from its last checkpoint. `export` writes the model.
No real picture is used. `bench/places.py` measures the model on real ones.
"""

from __future__ import annotations

import argparse
import lzma
import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from infrablend.lab.world.fixtures import Tree

ROOT = Path(__file__).resolve().parents[1]
MODEL = ROOT / "src/infrablend/imaging/surfaces.onnx.xz"
SIZE_WH = (320, 256)
SEED = 42
# Kinds of places, and how often each is drawn.
PLACES = {
    "street": 0.2, "parking": 0.11, "court": 0.04, "park": 0.13, "runway": 0.02, "dirtroad": 0.05, "forest": 0.12,
    "river": 0.05, "suburb": 0.12, "courts": 0.08, "athletics": 0.08,
}  # fmt: skip
# Range of focal lengths in pixels of a picture 640 wide, of heights and of widths of the ground seen, metres.
FOCAL_PX, HEIGHT_M, WIDTH_M = (450.0, 2300.0), (18.0, 140.0), (18.0, 130.0)
NIGHT, STRAIGHT_DOWN, LEAST_PITCH_DEG, LEAST_TOP_DEG, MOST_TREES = 0.55, 0.2, 22.0, 14.0, 1500
# Ten kinds of surface; the rare ones count more.
WEIGHTS = (1.0, 1.0, 1.5, 1.0, 1.2, 1.5, 1.3, 1.0, 1.2, 1.0)
# Grass, soil, shrubs, trees and structures, and how often they get other temperatures.
VARIED, PLANTS, PAVED, OTHER_LOOKS = (3, 4, 5, 6, 7), (3, 4, 5, 6), (0, 1), 0.7
CHANNELS = (16, 24, 32, 48, 48, 48)

Scene = tuple[NDArray[np.float16], NDArray[np.uint8]]


# ---- Scenes


def render(folder: Path, count: int) -> None:
    """Render scenes to `folder`/scenes, unless they are there; scene k is the same whatever `count` is."""
    from infrablend.lab.world.frame_files import sample_world
    from infrablend.lab.world.world_renderer import WorldRenderer

    out = folder / "scenes"
    out.mkdir(parents=True, exist_ok=True)
    renderer = WorldRenderer()
    names, shares = list(PLACES), np.array(list(PLACES.values()))
    for k in range(count):
        path = out / f"{k:05d}.npz"
        if path.exists():
            continue
        rng = np.random.Generator(np.random.PCG64([SEED, k]))
        kind: Any = names[int(rng.choice(len(names), p=shares / shares.sum()))]
        while True:
            focal, height = (math.exp(rng.uniform(*np.log(limits))) for limits in (FOCAL_PX, HEIGHT_M))
            pitch = 90.0 if rng.random() < STRAIGHT_DOWN else rng.uniform(LEAST_PITCH_DEG, 90)
            top_deg = pitch - math.degrees(math.atan(256 / focal))
            if (
                WIDTH_M[0] < height / math.sin(math.radians(pitch)) * 640 / focal < WIDTH_M[1]
                and top_deg > LEAST_TOP_DEG
            ):
                break
        plan = sample_world(rng, pitch, height, "night" if rng.random() < NIGHT else "day", kind, SIZE_WH, focal)
        plan = replace(plan, trees=_varied(rng, plan.trees))
        if len(plan.trees) > MOST_TREES:
            continue
        kelvin, kinds = renderer.render_surfaces(plan)
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, k=(kelvin - np.median(kelvin)).astype(np.float16), s=kinds)
        part.replace(path)
    renderer.close()


def _varied(rng: np.random.Generator, trees: Sequence[Tree]) -> tuple[Tree, ...]:
    """Return the trees of a scene, larger or smaller, a share of them as conifers or without leaves."""
    conifers, bare = rng.permutation([rng.uniform() if rng.random() < 0.5 else 0.0, 0.4 * rng.random()])
    tall, slender, grown = rng.uniform(0.8, 1.7), rng.uniform(0.4, 0.8), math.exp(rng.uniform(-0.2, 0.7))
    varied = []
    for tree in trees:
        tree = replace(tree, height_m=tree.height_m * grown, radius_m=tree.radius_m * grown)
        draw = rng.random()
        if tree.kind == "crown" and draw < conifers:
            tree = replace(tree, kind="conifer", height_m=tree.height_m * tall, radius_m=tree.radius_m * slender)
        elif tree.kind == "crown" and draw > 1 - bare:
            tree = replace(tree, kind="bare")
        varied.append(tree)
    return tuple(varied)


# ---- Cameras


class Cameras:
    """Draws scenes as pictures of many cameras."""

    def __init__(self, seed: int | list[int]) -> None:
        """Start the draws."""
        self._rng = np.random.default_rng(seed)
        self._scenes: dict[Path, Scene] = {}

    def batch(self, files: list[Path], size: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Return (size, 1, h, w) pictures as the network takes them, and (size, h / 2, w / 2) kinds of surface."""
        pictures, kinds = zip(*(self._sample(files) for _ in range(size)), strict=True)
        return np.stack(pictures)[:, None], np.stack(kinds)[:, ::2, ::2].astype(np.int64)

    def _sample(self, files: list[Path]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        path, u = files[int(self._rng.integers(len(files)))], self._rng.uniform
        if path not in self._scenes:
            with np.load(path) as data:
                self._scenes[path] = data["k"], data["s"]
        kelvin, kinds = self._scenes[path]
        h, w = kelvin.shape
        zoom = math.exp(u(-0.35, 0.45))
        matrix = cv2.getRotationMatrix2D((w / 2, h / 2), u(-12, 12), zoom)
        if self._rng.random() < 0.5:
            matrix = matrix @ np.array([[-1, 0, w - 1], [0, 1, 0], [0, 0, 1.0]])
        room = max(0.0, (zoom - 1) / 2 + 0.02)
        matrix[:, 2] += [u(-room, room) * w, u(-room, room) * h]
        turned = cv2.warpAffine(kelvin.astype(np.float32), matrix, (w, h), borderMode=cv2.BORDER_REFLECT)
        moved = cv2.warpAffine(kinds, matrix, (w, h), flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REFLECT)
        if self._rng.random() < OTHER_LOOKS:
            turned = self._other_looks(turned, moved)
        grey = self._look(turned).astype(np.float32)
        return (grey - grey.mean()) / max(float(grey.std()), 4.0), np.asarray(moved, np.uint8)

    def _other_looks(self, kelvin: NDArray[np.float32], kinds: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return temperatures with plants, soil and walls smoother or rougher, and more or less alike.

        Trees and lawns differ by a kelvin or by nothing at all, with the season, the hour and the lens.
        """
        rng, u = self._rng, self._rng.uniform
        plants = np.isin(kinds, PLANTS)
        middle, alike = float(kelvin[plants].mean()) if plants.any() else 0.0, u(0, 1)
        if rng.random() < 0.5:  # shade, and ground that kept the cold of it
            paved = cv2.GaussianBlur(np.isin(kinds, PAVED).astype(np.float32), (0, 0), 0.8)
            shade = cv2.resize(rng.standard_normal((4, 5)).astype(np.float32), kelvin.shape[::-1])
            kelvin = kelvin + paved * u(0, 2.0) * shade
        share = cv2.GaussianBlur(1 - np.isin(kinds, VARIED).astype(np.float32), (0, 0), 0.8)
        changed = share * kelvin
        for kind in VARIED:
            mask = (kinds == kind).astype(np.float32)
            if not mask.any():
                continue
            near = cv2.GaussianBlur(mask, (0, 0), 5.0) + 1e-3
            level = float(kelvin[mask > 0].mean())
            smooth = (cv2.GaussianBlur(mask * kelvin, (0, 0), 5.0) + 1e-3 * level) / near
            if kind in PLANTS:
                slow, fast = math.exp(u(-1.6, 0.3)), math.exp(u(-1.6, 0.5))
                to = alike * middle + (1 - alike) * level + rng.normal(0, 0.5)
            else:
                slow, fast = math.exp(u(-1.0, 0.3)), math.exp(u(-1.0, 1.0))
                to = level + rng.normal(0, 1.5)
            changed += cv2.GaussianBlur(mask, (0, 0), 0.8) * (to + slow * (smooth - level) + fast * (kelvin - smooth))
        return np.asarray(changed, np.float32)

    def _look(self, kelvin: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Return the 8-bit picture that some camera makes of temperatures."""
        rng, u = self._rng, self._rng.uniform
        h, w = kelvin.shape
        if rng.random() < 0.5:  # slow differences over the ground
            slow = rng.standard_normal((8, 10)).astype(np.float32)
            kelvin = kelvin + cv2.resize(slow, (w, h), interpolation=cv2.INTER_CUBIC) * u(0, 1.0)
        kelvin = cv2.GaussianBlur(kelvin, (0, 0), u(0.3, 1.3))
        low, high = np.percentile(kelvin, [u(0.2, 6), u(93, 99.8)])
        level = (kelvin - (low + high) / 2) / max((high - low) / 2, u(1.0, 3.0)) * u(0.3, 0.65) + 0.5
        grey = np.asarray(255 * np.clip(level, 0, 1) ** math.exp(u(-0.5, 0.5)), np.uint8)
        if rng.random() < 0.35:
            tiles = int(rng.integers(2, 9))
            grey = cv2.createCLAHE(u(1, 4), (tiles, tiles)).apply(grey)
        level = grey.astype(np.float32)
        if rng.random() < 0.5:
            level += u(0.2, 1.0) * (level - cv2.GaussianBlur(level, (0, 0), u(1, 3)))
        if rng.random() < 0.12:
            level = 255 - level
        noise = rng.standard_normal((h, w)).astype(np.float32)
        if rng.random() < 0.6:
            noise = cv2.GaussianBlur(noise, (0, 0), u(0.4, 1.1))
            noise /= noise.std()
        level += noise * u(0, 7)
        if rng.random() < 0.3:
            level += rng.standard_normal((1, w)) * u(0, 4)
        y, x = np.linspace(-1, 1, h)[:, None], np.linspace(-1, 1, w)[None]
        level -= u(-6, 18) * (x * x + y * y) / 2
        grey = np.clip(level, 0, 255).astype(np.uint8)
        if rng.random() < 0.5:
            quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(40, 95))]
            grey = cv2.imdecode(cv2.imencode(".jpg", grey, quality)[1], 0)
        return np.asarray(grey, np.uint8)


# ---- Network


def make_network() -> Any:
    """Return the network: a U-Net at half the size of its input, without the last softmax."""
    import torch
    from torch import nn
    from torch.nn import functional

    def block(inside: int, outside: int) -> nn.Sequential:
        layers: list[nn.Module] = []
        for channels in (inside, outside):
            layers += [nn.Conv2d(channels, outside, 3, padding=1, bias=False), nn.BatchNorm2d(outside), nn.ReLU()]
        return nn.Sequential(*layers)

    class Surfaces(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            c = CHANNELS
            self.stem = nn.Sequential(
                nn.Conv2d(1, c[0], 5, stride=2, padding=2, bias=False), nn.BatchNorm2d(c[0]), nn.ReLU()
            )
            self.e = nn.ModuleList(block(i, o) for i, o in zip((c[0], *c), c, strict=False))
            self.d = nn.ModuleList(block(c[k] + c[k - 1], c[k - 1]) for k in range(len(c) - 1, 0, -1))
            self.o = nn.Conv2d(c[0], len(WEIGHTS), 1)

        def forward(self, x: Any) -> Any:
            x, kept = self.stem(x), []
            for n, encode in enumerate(self.e):
                x = encode(x if n == 0 else functional.max_pool2d(x, 2))
                kept.append(x)
            for n, decode in enumerate(self.d):
                x = functional.interpolate(x, scale_factor=2, mode="nearest")
                x = decode(torch.cat([x, kept[-2 - n]], 1))
            return self.o(x)

    return Surfaces()


def train(folder: Path, steps: int, batch: int, threads: int, begin: Path | None) -> None:
    """Train for a number of steps in all, from the last checkpoint in the folder on, or at first from `begin`."""
    import torch
    from torch.nn import functional

    torch.manual_seed(SEED)
    torch.set_num_threads(threads)
    cv2.setNumThreads(1)
    net = make_network()
    if begin is not None:
        net.load_state_dict(torch.load(begin, weights_only=False)["net"])
    optimizer = torch.optim.AdamW(net.parameters(), 2e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=steps, pct_start=0.1)
    checkpoint, start = folder / "checkpoint.pt", 0
    if checkpoint.exists():
        kept = torch.load(checkpoint, weights_only=False)
        for part, name in ((net, "net"), (optimizer, "opt"), (schedule, "sched")):
            part.load_state_dict(kept[name])
        start = kept["step"]
    cameras, files = Cameras([SEED, start]), []
    weights, begun = torch.tensor(WEIGHTS), time.monotonic()
    net.train()
    for step in range(start, steps):
        if step % 200 == 0 or not files:  # `render` may still be at work
            files = sorted(f for f in (folder / "scenes").glob("*.npz") if ".part" not in f.name)
        x, y = (torch.from_numpy(a) for a in cameras.batch(files, batch))
        loss = functional.cross_entropy(net(x), y, weight=weights, label_smoothing=0.05)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 2.0)
        optimizer.step()
        schedule.step()
        if (step + 1) % 200 == 0 or step + 1 == steps:
            print(f"{step + 1}/{steps}  loss {loss.item():.3f}  {time.monotonic() - begun:.0f} s", flush=True)
            state = {"net": net.state_dict(), "opt": optimizer.state_dict(), "sched": schedule.state_dict()}
            torch.save({**state, "step": step + 1}, checkpoint)


def export(folder: Path) -> None:
    """Write the trained network as compressed ONNX; the size of its input is free.

    Weights are rounded to half precision, which OpenCV does not compute with, so that the file is half as large.
    """
    import onnx
    import torch
    from onnx import numpy_helper

    net = make_network()
    net.load_state_dict(torch.load(folder / "checkpoint.pt", weights_only=False)["net"])
    net.eval()
    axes = {"x": {2: "h", 3: "w"}, "scores": {2: "h2", 3: "w2"}}
    torch.onnx.export(
        net, (torch.zeros(1, 1, SIZE_WH[1], SIZE_WH[0]),), str(folder / "surfaces.onnx"), dynamo=False,
        opset_version=12, input_names=["x"], output_names=["scores"], dynamic_axes=axes,
    )  # fmt: skip
    model = onnx.load(folder / "surfaces.onnx")
    for weights in model.graph.initializer:
        values = numpy_helper.to_array(weights)
        if values.dtype == np.float32:
            rounded = values.astype(np.float16).astype(np.float32)
            weights.CopyFrom(numpy_helper.from_array(rounded, weights.name))
    MODEL.write_bytes(lzma.compress(model.SerializeToString(), preset=9))
    print(f"{MODEL}: {MODEL.stat().st_size / 1000:.0f} kB")


def main() -> int:
    """Run one step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("render", "train", "export"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=1200, help="scenes to render")
    parser.add_argument("--steps", type=int, default=2400)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--begin", type=Path, help="checkpoint of another training, whose weights to start with")
    given = parser.parse_args()
    if given.step == "render":
        render(given.folder, given.count)
    elif given.step == "train":
        train(given.folder, given.steps, given.batch, given.threads, given.begin)
    else:
        export(given.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
