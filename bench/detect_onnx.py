"""Measure the CPU seconds of `detect` with an ONNX file against onnxruntime alone on the same tiles.

    .venv/bin/python bench/detect_onnx.py WEIGHTS.onnx DATA [--split test] [--count 40] [--threads 2]

Both sides use the same session settings: the same number of threads, without spinning. `detect` reads the pictures,
cuts tiles, decodes boxes and writes all its files. In turns, the best of three each; the exit code is 1 above the
limit. The time to load the network is measured apart, and belongs to neither side.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from infrablend import api
from infrablend.detection.onnx_detector import load_onnx
from infrablend.detection.seams import windows
from infrablend.formats.pictures.images import load_background
from infrablend.pipeline.flights.detect import detect_objects
from infrablend.pipeline.flights.detect_request import DetectRequest

REPEATS = 3
LIMIT = 1.25


def cpu_seconds(work: Callable[[], object]) -> float:
    """Return the CPU seconds of all threads for one call."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def main() -> int:
    """Print both figures and their ratio; return 1 if the limit is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("weights", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    dataset = api.read_dataset(args.data, api.Reading((args.split,)))
    step = max(len(dataset.images) // args.count, 1)
    dataset = replace(dataset, images=dataset.images[::step][: args.count])
    loading = cpu_seconds(lambda: load_onnx(args.weights, threads=args.threads))
    detector = load_onnx(args.weights, threads=args.threads)
    (entry,) = detector.session.get_inputs()
    fed = []
    for image in dataset.images:
        pixels = np.asarray(load_background(image.path).pixels, np.uint8)
        for window in windows((pixels.shape[1], pixels.shape[0]), detector.side_wh, detector.overlap_px):
            tile = window.crop(pixels, detector.side_wh).astype(np.float32) / detector.form.divisor
            fed.append(np.repeat(tile[None, None], 3, axis=1))

    def bare() -> None:
        for tile in fed:
            detector.session.run(None, {entry.name: tile})

    def whole() -> None:
        with tempfile.TemporaryDirectory() as folder:
            detect_objects(args.weights, dataset, Path(folder) / "out", DetectRequest(threads=args.threads))

    bare()
    times = [(cpu_seconds(bare), cpu_seconds(whole) - loading) for _ in range(REPEATS)]
    alone, ours = (min(column) for column in zip(*times, strict=True))
    missed = ours > LIMIT * alone
    print(f"{len(dataset.images)} pictures, {len(fed)} tiles of {detector.side_wh} px, {args.threads} threads")
    print(f"loading {loading:.2f} CPU-s, onnxruntime {alone:.2f}, detect {ours:.2f}")
    print(f"{'FAIL' if missed else 'PASS'}  ratio {ours / alone:.3f} (<= {LIMIT})")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
