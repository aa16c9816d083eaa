"""Measure the CPU seconds of inspecting a folder of radiometric JPEG files, with the start of the program.

    .venv/bin/python bench/flights.py [--count 1000] [--real FOLDER]

Writes made-up DJI and FLIR files of 640 x 512 pixels with their raw layers, one every two seconds of a flight; with
`--real`, copies of the JPEG files of a folder instead. The exit code is 1 if `LIMIT_S` per 1,000 files is exceeded.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from infrablend.lab.world.rjpeg_writing import MAKERS, Shot, radiometric_jpeg

LIMIT_S = 20.0
SHAPE = (512, 640)
_START = datetime(2026, 1, 12, 6, 30)


def write_made_up(folder: Path, count: int) -> None:
    """Write the files; they differ in the time of capture alone."""
    noise = np.random.default_rng(0).normal(0, 12, SHAPE)
    grey = np.clip(110 + noise, 0, 255).astype(np.uint8)
    counts = (15_000 + 4 * grey.astype(np.uint16)).astype(np.uint16)
    for maker in MAKERS:
        data = radiometric_jpeg(maker, grey, counts, Shot(captured=_START))
        stamp = f"{_START:%Y:%m:%d %H:%M:%S}".encode()
        assert data.count(stamp) == 1
        for k in range(count // len(MAKERS)):
            when = f"{_START + timedelta(seconds=2 * k):%Y:%m:%d %H:%M:%S}".encode()
            (folder / f"{maker.upper()}_{k:04}_T.JPG").write_bytes(data.replace(stamp, when))


def copy_real(source: Path, folder: Path, count: int) -> None:
    """Copy the JPEG files of a folder until there are enough."""
    found = sorted(p for p in source.iterdir() if p.suffix.lower() in (".jpg", ".jpeg"))
    for k in range(count):
        shutil.copy(found[k % len(found)], folder / f"{k:04}_{found[k % len(found)].name}")


def main() -> int:
    """Print the CPU seconds; return 1 if they are too many."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--real", type=Path, help="folder of real files; they are not changed")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if given.real:
            copy_real(given.real, folder, given.count)
        else:
            write_made_up(folder, given.count)
        program = "from infrablend.cli import main; main()"
        command = [sys.executable, "-c", program, "inspect", "--json", str(folder)]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=os.environ)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        flight = json.loads(done.stdout)["notes"]["flight"]
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        limit_s = LIMIT_S * given.count / 1000
        radiometric = f"{flight['pictures']} pictures, {flight['radiometric']} of them radiometric"
        result = f"{seconds:.2f} CPU-s (<= {limit_s:g}), peak {after.ru_maxrss >> 10} MiB"
        print(f"{'FAIL' if seconds > limit_s else 'PASS'}  {radiometric}: {result}")
    return int(seconds > limit_s)


if __name__ == "__main__":
    sys.exit(main())
