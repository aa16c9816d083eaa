"""Fuzzes every reader for as long as wanted, outside CI: `fuzz_readers.py --minutes 60 [--format coco] [--seed 1]`.

Takes the samples of tests/samples.py, breaks them as tests/fuzzing.py does, reads, checks and inspects them. A finding
is printed with its seed and kept, ready to be read again; the exit code is 1 if there was any. Where `atheris` is
installed (it is not required), `--atheris` lets it drive: coverage of the readers then guides what is broken.
"""

from __future__ import annotations

import argparse
import random
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "src")]

from tests.fuzzing import TooSlow, bounded_memory, exercise, make_outside, mutate, watched  # noqa: E402
from tests.samples import SAMPLES  # noqa: E402

GROWTH_KIB = 700 << 10


def attempt(name: str, seed: int, keep: Path) -> str | None:
    """Break a sample and read it; what went wrong, or None. The broken dataset is kept if something did."""
    choose = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        root = SAMPLES[name](Path(folder) / "data")
        outside = make_outside(Path(folder) / "outside")
        done = [mutate(root, outside, choose) for _ in range(choose.randint(1, 6))]
        fault = None
        before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            with bounded_memory(), watched(root, outside) as seen:
                exercise(root, name.partition(":")[0])
            if seen:
                fault = f"left the dataset: {seen}\n"
            grown_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib
            if grown_kib > GROWTH_KIB:
                fault = f"grew by {grown_kib >> 10} MiB\n"
        except (Exception, TooSlow):
            fault = traceback.format_exc()
        if fault is not None:
            kept = keep / f"{name.replace(':', '-')}-{seed}"
            shutil.rmtree(kept, ignore_errors=True)
            shutil.copytree(root, kept, symlinks=True, ignore=_no_pipes)
            fault = f"{name} seed {seed}: {'; '.join(done)}\n{fault}kept as {kept}"
        return fault


def _no_pipes(folder: str, names: list[str]) -> list[str]:
    return [n for n in names if (Path(folder) / n).is_fifo()]


def main(arguments: list[str]) -> int:
    """Fuzz until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--format", help="only samples whose name begins so")
    parser.add_argument("--seed", type=int, default=0, help="the first seed; each attempt takes the next one")
    parser.add_argument("--keep", type=Path, default=ROOT / "build" / "fuzz")
    parser.add_argument("--atheris", action="store_true")
    given = parser.parse_args(arguments)
    names = [n for n in sorted(SAMPLES) if n.startswith(given.format or "")]
    if not names:
        parser.error(f"--format {given.format}: no such sample; there are {', '.join(sorted(SAMPLES))}")
    if given.atheris:
        return _with_atheris(names, given.keep, given.minutes)
    warnings.simplefilter("error")  # as in the tests
    ends_at = time.monotonic() + 60 * given.minutes
    tried, found, seed = 0, 0, given.seed
    while time.monotonic() < ends_at:
        for name in names:
            fault = attempt(name, seed, given.keep)
            tried += 1
            if fault is not None:
                found += 1
                print(fault, flush=True)
        seed += 1
    print(f"{tried} broken datasets, {found} findings")
    return int(found > 0)


def _with_atheris(names: list[str], keep: Path, minutes: float) -> int:
    try:
        import atheris
    except ImportError:
        print("atheris is not installed; leave --atheris out", file=sys.stderr)
        return 2
    with atheris.instrument_imports(include=["infrablend.formats"]):
        from infrablend.formats.published import hit_uav, monet  # noqa: F401

    def one(data: bytes) -> None:
        provider = atheris.FuzzedDataProvider(data)
        fault = attempt(names[provider.ConsumeIntInRange(0, len(names) - 1)], provider.ConsumeUInt(4), keep)
        if fault is not None:
            raise RuntimeError(fault)

    atheris.Setup([sys.argv[0], f"-max_total_time={int(60 * minutes)}"], one)
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
