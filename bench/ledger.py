"""Measure the ledger of a run: size, time and memory of many rows, and what a kill leaves.

`bench/ledger.py [--rows N] [--kills K] [--record FILE]` adds N rows with a record of a usual size (or the JSON in FILE)
as a run does, asks what resuming asks, and reads a sample of the records. Then it kills a process that adds rows, K
times at random moments, and checks the file and that every row whose commit was reported is there.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from infrablend.core.ledger import LEDGER, DoneFrame, Ledger

_RECORD_BYTES = 6_000  # of one drone in a HIT-UAV picture
_SHA256 = "a" * 64


def add(ledger: Ledger, number: int, record: str) -> None:
    """Add a frame."""
    name = f"train/{number:07d}_c0"
    ledger.add(name, DoneFrame(f"{name}.jpg", 60_000, _SHA256, 1), record)


def measure(folder: Path, rows: int, record: str) -> dict[str, object]:
    """Return the figures of a ledger with so many rows."""
    started = time.process_time()
    with Ledger.create(folder, {"run": "bench"}) as ledger:
        for number in range(rows):
            add(ledger, number, record)
    added = time.process_time()
    with Ledger.open(folder) as ledger:
        done = len(ledger.done())
        asked = time.process_time()
        step = max(rows // 10_000, 1)
        for number in range(0, rows, step):
            ledger.record_text(f"train/{number:07d}_c0")
        read = time.process_time()
    return {
        "rows": done,
        "record_bytes": len(record),
        "file_bytes_per_row": round((folder / LEDGER).stat().st_size / rows),
        "add_cpu_ms_per_row": round(1e3 * (added - started) / rows, 4),
        "resume_query_cpu_s": round(asked - added, 3),
        "read_cpu_ms_per_record": round(1e3 * (read - asked) / len(range(0, rows, step)), 4),
        "peak_rss_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
    }


def child(folder: Path) -> None:
    """Add rows until killed, and print each number after its commit."""
    ledger, number = Ledger.create(folder, {"run": "bench"}), 0
    while True:
        for _ in range(random.randint(1, 20)):
            add(ledger, number, "x" * 6_000)
            number += 1
        ledger.commit()
        print(number, flush=True)


def kill_once(folder: Path, rng: random.Random) -> str | None:
    """Kill a writer; return what is wrong with what it left, None if nothing is."""
    words = [sys.executable, __file__, "--child", str(folder)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(rng.uniform(0, 0.1))
        writer.send_signal(signal.SIGKILL)
        committed = [int(line) for line in writer.stdout.read().split()]
    with Ledger.open(folder, write=True) as ledger:
        found = len(ledger.done())
        texts = sum(ledger.record_text(frame_id) == "x" * 6_000 for frame_id in ledger.frame_ids())
    with sqlite3.connect(folder / LEDGER) as database:
        (state,) = database.execute("PRAGMA integrity_check").fetchone()
    if state != "ok" or found < max(committed, default=0) or texts != found:
        return f"{state}: {found} rows and {texts} records, {max(committed, default=0)} were committed"
    return None


def main() -> None:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--record", type=Path)
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.child is not None:
        child(asked.child)
    record = "x" * _RECORD_BYTES if asked.record is None else asked.record.read_text("utf-8")
    rng = random.Random(0)
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        facts = measure(Path(folder), asked.rows, record) if asked.rows else {}
        (Path(folder) / LEDGER).unlink(missing_ok=True)
        faults = [fault for _ in range(asked.kills) if (fault := kill_once(Path(folder), rng)) is not None]
    print(json.dumps({**facts, "kills": asked.kills, "faults": faults}, indent=1))
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
