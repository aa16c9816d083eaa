"""Compares runs: what differs between equal runs are times, the machine, and the layout of the ledger's pages."""

from __future__ import annotations

import hashlib
import json
import re
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from infrablend.core.frame_row import FrameRecord
from infrablend.core.ledger import Ledger
from infrablend.core.run_folder import RunFolder

_TIMES = re.compile(rb'<section id="time">.*?</section>', re.DOTALL)


def without_times(name: str, data: bytes) -> bytes:
    """Return the bytes of a file of a run; those of its report without the section of times."""
    return _TIMES.sub(b"", data) if name.endswith("report.html") else data


def ledger_rows(file: Path) -> list[tuple[object, ...]]:
    """Return the rows about frames in a ledger: equal for equal runs."""
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as ledger:
        frames = ledger.execute("SELECT * FROM frames ORDER BY frame_id").fetchall()
        return frames + ledger.execute("SELECT * FROM records ORDER BY frame_id").fetchall()


def records(run: Path) -> list[FrameRecord]:
    """Return the records of the frames of a finished run, by id."""
    return list(RunFolder(run).records())


def frame_ids(run: Path) -> list[str]:
    """Return the ids of the frames of a finished run that are not left out."""
    with Ledger.open(run) as ledger:
        return ledger.frame_ids()


def excluded(run: Path) -> Mapping[str, str]:
    """Return the frames of a run that are left out, each with its reason."""
    with Ledger.open(run) as ledger:
        return ledger.excluded()


def edit_ledger(run: Path, query: str, *values: object) -> None:
    """Change the ledger of a run behind its back."""
    with sqlite3.connect(run / "run.sqlite") as ledger:
        ledger.execute(query, values)
    ledger.close()


def hashes(run: Path) -> dict[str, str]:
    """Digest of every file of a run; of its ledger the rows, of its records what does not differ between equal runs."""
    found = {}
    for path in sorted(p for p in run.rglob("*") if p.is_file() and p.name != "workers.log"):
        name = path.relative_to(run).as_posix()
        data = without_times(name, path.read_bytes())
        if name == "run.sqlite":
            data = repr(ledger_rows(path)).encode()
        if name == "run.json":
            record = json.loads(data)
            for key in ("timing", "machine"):
                record.pop(key)
            data = json.dumps(record, sort_keys=True).encode()
        found[name] = hashlib.sha256(data).hexdigest()
    return found
