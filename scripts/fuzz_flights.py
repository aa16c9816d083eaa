"""Damages radiometric JPEG files and reads them, outside CI: `fuzz_flights.py --count 10000 [--real FOLDER]`.

Takes made-up DJI and FLIR files, and with `--real` also the JPEG files of a folder, damages each as
tests/flight_fuzzing.py does, and reads header, flight data, temperatures and picture. A finding is printed with its
seed and kept; the exit code is 1 if there was any.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "src")]

from tests.flight_fuzzing import TooSlow, damage, exercise  # noqa: E402
from tests.flights import shot  # noqa: E402
from tests.fuzzing import make_outside  # noqa: E402

from infrablend.lab.world.rjpeg_writing import MAKERS  # noqa: E402


def main(arguments: list[str]) -> int:
    """Damage and read files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="first seed; each file takes the next one")
    parser.add_argument("--real", type=Path, help="folder of real radiometric files; they are not changed")
    parser.add_argument("--keep", type=Path, default=ROOT / "build" / "fuzz")
    given = parser.parse_args(arguments)
    warnings.simplefilter("error")  # as in the tests
    outcomes: Counter[str] = Counter()
    found, slowest = 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        outside = make_outside(Path(folder) / "outside")
        sources = [shot(Path(folder) / "made" / f"{m}{e}.jpg", m, elements=bool(e)) for m in MAKERS for e in (0, 1)]
        sources += sorted(p for p in given.real.iterdir() if p.suffix.lower() == ".jpg") if given.real else []
        contents = [p.read_bytes() for p in sources]
        path = Path(folder) / "data" / "a.jpg"
        path.parent.mkdir()
        for seed in range(given.seed, given.seed + given.count):
            data, done = damage(contents[seed % len(contents)], seed)
            path.write_bytes(data)
            started = time.process_time()
            try:
                exercise(path, outside, outcomes)
            except (Exception, TooSlow):
                found += 1
                given.keep.mkdir(parents=True, exist_ok=True)
                kept = given.keep / f"flight-{seed}.jpg"
                kept.write_bytes(data)
                print(
                    f"{sources[seed % len(sources)].name} seed {seed}: {done}\n{traceback.format_exc()}kept as {kept}"
                )
            slowest = max(slowest, time.process_time() - started)
    for outcome, number in sorted(outcomes.items()):
        print(f"{number:8} {outcome}")
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    print(f"{given.count} damaged files, {found} findings, slowest {slowest:.2f} CPU-s, peak {peak_mib} MiB")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
