"""Measure the error of inserted temperatures on a made-up 16-bit flight.

    .venv/bin/python bench/radiometric.py [OUT] [--frames N] [--flat]

Renders the virtual world in centikelvin, inserts deer of one temperature all over, four times as large as real ones,
and compares the pixels that they fill with the apparent temperature by Planck's law, emissivity, mirrored surroundings
and air, integrated here. With Blender, surfaces mirror sky and ground in parts that depend on their shape, so an
emissivity of 1 is used; `--flat` shades without Blender, and uses 0.9. The exit code is 1 if the mean error exceeds
`LIMIT_K`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from infrablend import api
from infrablend.assets.catalogue import load_model
from infrablend.core.frame_row import FrameRecord
from infrablend.core.run_folder import RunFolder

LIMIT_K = 0.1
ABOVE_AIR_K = 45.0
_UM = np.linspace(8e-6, 14e-6, 2001)


def planck(kelvin: float) -> float:
    """Return the radiance of a blackbody from 8 to 14 um by the trapezoidal rule."""
    h, c, k = 6.62607015e-34, 299_792_458.0, 1.380649e-23
    spectrum = 2 * h * c**2 / _UM**5 / np.expm1(h * c / (_UM * k * kelvin))
    return float((spectrum[1:] + spectrum[:-1]).sum() / 2 * (_UM[1] - _UM[0]))


def expected_k(record: FrameRecord, emissivity: float, number: int) -> float:
    """Return the apparent temperature at the sensor of an object, kelvin."""
    scene = record.scene
    assert scene is not None and scene.weather is not None
    w, tau = scene.weather, record.facts["matching"]["transmittance"][number]
    own = emissivity * planck(w.air_k + ABOVE_AIR_K) + (1 - emissivity) * planck(w.ground_k)
    target = tau * own + (1 - tau) * planck(w.air_k)
    low, high = 200.0, 500.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if planck(middle) < target else (low, middle)
    return low


def settings(emissivity: float) -> dict[str, Any]:
    """Return the recipe's settings: one deer per frame, of one temperature, without the sensor chain."""
    part = {"delta_t_k": [ABOVE_AIR_K] * 2, "emissivity": [emissivity] * 2}
    parts = {n: part for n, p in load_model("deer").parts.items() if p.label}
    return {
        "matching.mode": "radiometric",
        "objects": [{"model": "deer", "count": 1, "scale": 4, "parts": parts}],
        "appearance.texture_k": 0.0,
        "camera.calibrate": False,
        "placement.min_inside": 1.0,
        "placement.size_px": [24, 400],
        "sensor": {"profile": "off"},
        "output.formats": ["coco"],
        "output.agc": {"mode": "plateau"},
    }


def errors_k(run: Path, emissivity: float) -> list[float]:
    """Return the mean error of each inserted object, kelvin, over the pixels that it fills with their neighbours."""
    folder, found = RunFolder(run), []
    for record in folder.records():
        with Image.open(folder.image(record.image)) as picture:
            kelvin = np.array(picture).astype(np.float64) / 100
        for number, label in enumerate(record.inserted):
            core = _core(label.mask.to_array()) if label.mask is not None else np.zeros(kelvin.shape, np.bool_)
            if core.sum() >= 4:
                found.append(float(kelvin[core].mean()) - expected_k(record, emissivity, number))
    return found


def _core(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0)


def main() -> int:
    """Print the errors; return 1 if their mean is too large or nothing could be measured."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path, nargs="?", help="Folder for flight and run; a temporary one by default.")
    parser.add_argument("--frames", type=int, default=12, help="Number of frames of the flight.")
    parser.add_argument("--flat", action="store_true", help="Shade without Blender.")
    args = parser.parse_args()
    emissivity = 0.9 if args.flat else 1.0
    with tempfile.TemporaryDirectory() as temporary:
        out: Path = args.out or Path(temporary)
        if not (out / "flight").exists():
            api.make_world(out / "flight", args.frames, 7, layout="radiometric")
        execution = api.Execution(renderer="flat" if args.flat else "blender")
        run = out / ("run_flat" if args.flat else "run")
        api.generate(
            "hit-uav-car", out / "flight", run, settings=settings(emissivity), execution=execution,
            existing="overwrite" if run.exists() else "refuse",
        )  # fmt: skip
        found = errors_k(run, emissivity)
    if not found:
        print("no object is large enough to be measured")
        return 1
    mean, worst = float(np.mean(np.abs(found))), float(np.max(np.abs(found)))
    print(f"{len(found)} objects: mean error {mean:.4f} K, largest {worst:.4f} K (limit {LIMIT_K} K on average)")
    return int(mean > LIMIT_K)


if __name__ == "__main__":
    sys.exit(main())
