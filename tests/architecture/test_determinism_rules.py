"""Calls that could make outputs differ between equal runs are banned from the source."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted((ROOT / "src" / "infrablend").rglob("*.py"))

BANNED_MODULES = {"random", "uuid", "secrets"}
BANNED_CALLS = {
    "time.time": "a duration is time.perf_counter or time.monotonic; a date has no place in an output",
    "time.time_ns": "see time.time",
    "time.localtime": "no wall clock",
    "time.gmtime": "no wall clock",
    "time.ctime": "no wall clock",
    "datetime.now": "no wall clock",
    "datetime.utcnow": "no wall clock",
    "datetime.today": "no wall clock",
    "date.today": "no wall clock",
    "datetime.datetime.now": "no wall clock",
    "datetime.datetime.utcnow": "no wall clock",
    "datetime.date.today": "no wall clock",
    "os.urandom": "draws come from core.rng.stream",
    "hash": "differs from process to process for text: use hashlib",
    "np.random.default_rng": "draws come from core.rng.stream",
    "numpy.random.default_rng": "draws come from core.rng.stream",
}
# Allowed on the module np.random: types, and the generator that core.rng is made of.
NUMPY_RANDOM_ALLOWED = {"Generator", "PCG64", "BitGenerator", "SeedSequence"}

# These files show times to users but write none to outputs; each states so where it reads the clock.
ALLOWED: dict[str, set[str]] = {
    "pipeline/storage/store.py": {"random"},  # jobs pause differently between attempts; no output depends on that
    "studio/guard.py": {"secrets"},  # the token of a page's address, which must not be guessed
    "pipeline/storage/fetch.py": {"time.gmtime"},  # when a dataset was downloaded
    # Ultralytics draws from the global generators: the trainer's own process seeds them, from seed and epoch.
    "lab/training/training_job.py": {"random", "np.random.seed"},
}


def dotted(node: ast.AST) -> str:
    """`a.b.c` of an attribute chain, or an empty string."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (base := dotted(node.value)):
        return f"{base}.{node.attr}"
    return ""


def offences(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Return (line, name) of every banned call in a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, a.name) for a in node.names if a.name.partition(".")[0] in BANNED_MODULES)
        elif isinstance(node, ast.ImportFrom):
            module = (node.module or "").partition(".")[0]
            if module in BANNED_MODULES and node.level == 0:
                yield node.lineno, module
            if node.module in {"time", "os"}:
                yield from (
                    (node.lineno, f"{node.module}.{a.name}")
                    for a in node.names
                    if f"{node.module}.{a.name}" in BANNED_CALLS
                )
        elif isinstance(node, ast.Attribute):
            name = dotted(node)
            if name in BANNED_CALLS or (
                name.startswith(("np.random.", "numpy.random.")) and name.split(".")[2] not in NUMPY_RANDOM_ALLOWED
            ):
                yield node.lineno, name
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in BANNED_CALLS:
            yield node.lineno, node.func.id


def test_no_hidden_randomness_no_wall_clock_and_sorted_listings() -> None:
    found = []
    for path in SOURCES:
        name = path.relative_to(ROOT / "src" / "infrablend").as_posix()
        tree = ast.parse(path.read_text("utf-8"))
        banned = [(line, what) for line, what in offences(tree) if what not in ALLOWED.get(name, set())]
        unsorted = [(line, "a listing of a folder: sort it") for line in listings(tree)]
        found += [f"{name}:{line}: {what}" for line, what in banned + unsorted]
    assert found == []


@pytest.mark.parametrize(
    "source",
    [
        "import random",
        "from uuid import uuid4",
        "from time import time",
        "import time\ntime.time()",
        "import numpy as np\nnp.random.seed(3)",
        "import numpy as np\nnp.random.rand(3)",
        "import numpy as np\nnp.random.default_rng()",
        "from datetime import datetime\ndatetime.now()",
        "hash('a')",
    ],
)
def test_ban_detects_forbidden_calls(source: str) -> None:
    assert list(offences(ast.parse(source)))


def test_the_ban_leaves_generators_alone() -> None:
    source = "import numpy as np\ndef f(rng: np.random.Generator):\n    return rng.random()"
    assert not list(offences(ast.parse(source)))


def listings(tree: ast.Module) -> Iterator[int]:
    """Lines that list a folder without sorting on the spot."""
    sorted_inside = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and dotted(node.func) in {"sorted", "any", "all", "sum", "len", "set", "frozenset"}
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute) or id(node) in sorted_inside:
            continue
        if node.func.attr in {"iterdir", "glob", "rglob", "scandir", "listdir"}:
            yield node.lineno


def test_the_listing_rule_finds_what_it_bans() -> None:
    assert list(listings(ast.parse("for p in folder.iterdir(): pass"))) == [1]
    assert list(listings(ast.parse("for p in sorted(folder.iterdir()): pass"))) == []
