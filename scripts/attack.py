"""Attack the command line: kill it, break its inputs, take its disk away. By hand and nightly, not in `make test`.

    scripts/attack.py                       everything, an hour or two on one core
    scripts/attack.py --only kills --attempts 50 --seed 7
    scripts/attack.py --jobs 4 --json

Prints one table: attempts, silent losses, unexpected errors, hangs and files written outside the output, for each kind
of attack. The exit code is 1 if any of them is not zero. docs/explanation/reliability.md explains what is promised.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import gc
import json
import pickle
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "src")]

from tests.attack import broken_inputs, kills, surroundings  # noqa: E402
from tests.attack.child import fork_command, import_what_it_imported, keep_commands  # noqa: E402
from tests.attack.findings import Finding, Tally  # noqa: E402
from tests.attack.scenarios import PLACE, SCENARIOS, new_lab  # noqa: E402

Attack = Callable[[Path, int, int, tuple[int, int]], Iterator[tuple[str, list[Finding]]]]

ATTACKS: dict[str, tuple[Attack, int]] = {
    "kills": (kills.run, 400),
    "surroundings": (surroundings.run, 240),
    "inputs": (broken_inputs.run, 10_500),
}
"""Attacks by name, with the number of attempts of a full run."""


def main(arguments: list[str]) -> int:
    """Run the attacks and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help=f"names of attacks, separated by commas: {', '.join(ATTACKS)}")
    parser.add_argument("--attempts", type=int, help="number per attack [default: those of a full run]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    names = given.only.split(",") if given.only else list(ATTACKS)
    unknown = [n for n in names if n not in ATTACKS]
    if unknown:
        parser.error(f"--only {','.join(unknown)}: there are {', '.join(ATTACKS)}")
    with tempfile.TemporaryDirectory(prefix="attack-") as folder:
        os.environ["YOLO_CONFIG_DIR"] = folder  # Ultralytics writes its settings when it is imported
        _warm_up(Path(folder))
        tally = Tally()
        for other in _side_by_side(names, given.attempts, given.seed, given.jobs, Path(folder)):
            tally.merge(other)
    if given.json:
        findings = [asdict(f) for f in tally.findings]
        print(json.dumps({"rows": tally.rows(), "findings": findings}, indent=1))
    else:
        for f in tally.findings:
            print(f"{f.fault}: {f.kind}: {f.case}\n    {f.detail}\n")
        print(tally.table())
    return int(bool(tally.findings))


def _warm_up(folder: Path) -> None:
    """Import what the commands import, so that forked processes need not."""
    keep_commands()
    for scenario in SCENARIOS.values():
        lab = new_lab(folder / "warm", scenario.prepare)
        fork_command(scenario.words(lab), lab, lab / PLACE, flat=scenario.flat)
        import_what_it_imported(lab)
    shutil.rmtree(folder / "warm")
    gc.freeze()  # forked processes share the memory


def _side_by_side(names: list[str], attempts: int | None, seed: int, jobs: int, folder: Path) -> Iterator[Tally]:
    children = []
    for n in range(jobs):
        sys.stdout.flush()
        child = os.fork()
        if not child:
            code = 1
            try:
                (folder / f"tally{n}").write_bytes(
                    pickle.dumps(_one(names, attempts, seed, (n, jobs), folder / str(n)))
                )
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        children.append(child)
    for n, child in enumerate(children):
        if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
            raise SystemExit(f"process {n} failed")
        yield pickle.loads((folder / f"tally{n}").read_bytes())


def _one(names: list[str], attempts: int | None, seed: int, part: tuple[int, int], folder: Path) -> Tally:
    tally = Tally()
    for name in names:
        attack, number = ATTACKS[name]
        for kind, found in attack(folder / name, attempts or number, seed, part):
            tally.add(kind, found)
            for f in found:
                print(f"{f.fault}: {f.kind}: {f.case}: {f.detail[:300]}", file=sys.stderr, flush=True)
        shutil.rmtree(folder / name, ignore_errors=True)
    return tally


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
