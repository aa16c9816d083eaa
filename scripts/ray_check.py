#!/usr/bin/env python3
"""Runs a generation on a Ray cluster of one head and three nodes on this machine while workers and nodes are killed.

Each round compares the run with that of one process, byte by byte: nothing lost, nothing twice. Prints a line per
round, and exits with 1 if a round differs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("RAY_AUTH_MODE", "disabled")
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
# A lost machine is noticed after a second instead of half a minute, as the check is about what happens then.
os.environ.setdefault("RAY_health_check_period_ms", "500")
os.environ.setdefault("RAY_health_check_failure_threshold", "2")

NODES = 3
# Differ between runs: times, machine, logs.
TIMED = {"run.json", "report.html", "workers.log"}


def contents(run: Path) -> dict[str, str]:
    """Return the digests of the files that do not depend on time and machine; of the ledger, those of its rows."""
    files = [p for p in sorted(run.rglob("*")) if p.is_file() and p.name not in TIMED]
    return {str(p.relative_to(run)): hashlib.sha256(data_of(p)).hexdigest() for p in files}


def data_of(path: Path) -> bytes:
    """Return the bytes of a file, or the rows of frames and records of a ledger."""
    if path.suffix != ".sqlite":
        return path.read_bytes()
    with sqlite3.connect(path) as ledger:
        rows = [
            ledger.execute(f"SELECT * FROM {table} ORDER BY frame_id").fetchall() for table in ("frames", "records")
        ]
    return repr(rows).encode()


def kill_worker(rng: random.Random) -> str:
    """Kill one of the processes that compute frames."""
    import psutil

    found = [p for p in psutil.process_iter(["cmdline"]) if "RayWorker" in " ".join(p.info["cmdline"] or ())]
    if not found:
        return "no worker to kill"
    os.kill(rng.choice(found).pid, signal.SIGKILL)
    return "killed a worker"


def one_round(
    number: int, given: argparse.Namespace, settings: list[str], expected: dict[str, str], folder: Path
) -> bool:
    """Generate on a new cluster, kill in the middle, and compare."""
    from ray.cluster_utils import Cluster

    from infrablend import api
    from infrablend.pipeline.plans.run_request import Execution

    rng = random.Random(given.seed * 1000 + number)
    node_bytes = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "memory": 2 * 2**30}
    cluster = Cluster(initialize_head=True, head_node_args={**node_bytes, "num_cpus": 0, "include_dashboard": False})
    nodes = [cluster.add_node(**node_bytes) for _ in range(NODES)]
    total = sum(name.endswith((".png", ".jpg")) and name.startswith("images/") for name in expected)
    at_worker, at_node = (rng.randrange(1, max(2, total - NODES * 2)) for _ in range(2))
    done: list[str] = []

    def on_progress(progress: object) -> None:
        count = progress.done  # type: ignore[attr-defined]
        if count >= at_worker and "worker" not in done:
            done.append("worker")
            kill_worker(rng)
        if count >= at_node and "node" not in done:
            done.append("node")
            cluster.remove_node(rng.choice(nodes), allow_graceful=False)

    out, started = folder / f"round-{number}", time.monotonic()
    try:
        execution = Execution(NODES, renderer="flat", executor="ray", address=cluster.address)
        report = api.generate(
            given.recipe, folder / "backgrounds", out, settings=settings, execution=execution, on_progress=on_progress
        )
        found = contents(out)
        counts = json.loads((out / "run.json").read_text())["counts"]
    finally:
        import ray

        ray.shutdown()
        cluster.shutdown()
    equal = report.ok and found == expected and sorted(done) == ["node", "worker"]
    print(
        f"round {number}: {counts['frames']} frames, worker killed at {at_worker}, node at {at_node}, "
        f"{'same bytes' if equal else 'DIFFERENT'}, {time.monotonic() - started:.0f} s",
        flush=True,
    )
    shutil.rmtree(out)
    return equal


def main() -> int:
    """Run the rounds."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--frames", type=int, default=400, help="frames per round")
    options.add_argument("--rounds", type=int, default=20)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--recipe", default="hit-uav-drone")
    given = options.parse_args()
    from infrablend import api
    from infrablend.pipeline.plans.run_request import Execution

    with tempfile.TemporaryDirectory(prefix="ray-check-") as name:
        folder = Path(name)
        data = folder / "backgrounds"
        api.make_world(data, min(16, given.frames), workers=1)
        copies = -(-given.frames // min(16, given.frames))
        settings = [f"configurations={copies}"]
        one = Execution(renderer="flat", in_process=True)
        api.generate(given.recipe, data, folder / "one", settings=settings, execution=one)
        expected = contents(folder / "one")
        rounds = range(1, given.rounds + 1)
        good = sum(one_round(n, given, settings, expected, folder) for n in rounds)
    print(f"{good} of {given.rounds} rounds with the bytes of one process")
    return 0 if good == given.rounds else 1


if __name__ == "__main__":
    sys.exit(main())
