"""Every main command under Windows' rules, see `tests/windows_rules`, gives the bytes that it gives without them."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.run_files import hashes
from tests.samples import picture

RULES = Path(__file__).resolve().parents[1] / "windows_rules"
PACKAGES = Path(__file__).resolve().parents[2] / "src"
WAIT_S = 120
"""Far above what any command needs."""

# Names that Windows cannot have, or takes for another one.
NAMES = ("a.png", "A.png", "con.png", "NUL.tar.png", "what?.png", "b:c.png", "day/end ./x.png", "day/dots../y.png")


@dataclass(frozen=True)
class System:
    """A folder to work in, with the environment of its processes."""

    folder: Path
    environment: dict[str, str]

    def start(self, *words: str) -> subprocess.Popen[str]:
        """Start a command."""
        command = [sys.executable, "-m", "infrablend", "-q", *words]
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen(command, cwd=self.folder, env=self.environment, text=True, **pipes)

    def run(self, *words: str, code: int = 0) -> str:
        """Run a command and return what it printed."""
        process = self.start(*words)
        out, errors = process.communicate(timeout=WAIT_S)
        assert process.returncode == code, f"{words}: {process.returncode}\n{out}\n{errors}"
        return out


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory, write_tiny_hit_uav) -> dict[str, System]:
    """Two systems, with the same data beside them: `../data` and `../odd`."""
    root = tmp_path_factory.mktemp("systems")
    write_tiny_hit_uav(root / "data")
    for number, name in enumerate(NAMES):
        picture(root / "odd" / "images" / name, number)
        labels = root / "odd" / "labels" / Path(name).with_suffix(".txt")
        labels.parent.mkdir(parents=True, exist_ok=True)
        labels.write_text(f"0 0.5 0.5 0.{number + 1} 0.2\n")
    (root / "odd" / "data.yaml").write_text("path: .\ntrain: images\nnames:\n  0: person\n")
    found = {}
    for name in ("linux", "windows"):
        folder = root / name
        (folder / "tmp").mkdir(parents=True)
        own = {"INFRABLEND_CACHE": str(folder / "cache"), "TMPDIR": str(folder / "tmp"), "INFRABLEND_BLENDER": "none"}
        own["INFRABLEND_LOG"] = str(folder / "log.txt")
        path = [str(PACKAGES)]
        if name == "windows":
            path.insert(0, str(RULES))
            own["WINDOWS_RULES"] = str(folder)
        found[name] = System(folder, {**os.environ, **own, "PYTHONPATH": os.pathsep.join(path)})
    return found


def on_both(both: dict[str, System], work: Callable[[System], Any]) -> list[Any]:
    """Do something on both systems at once; return what it gives."""
    with ThreadPoolExecutor() as threads:
        return list(threads.map(work, both.values()))


def digests(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


GENERATE = ("generate", "hit-uav-drone", "--data", "../data", "--workers", "2", "--set", "configurations=2")


def generated(system: System) -> None:
    system.run(*GENERATE, "--out", "run")


@pytest.fixture(scope="module")
def runs(both) -> dict[str, System]:
    """The systems, each with a run of eight frames in `run`."""
    on_both(both, generated)
    return both


def test_generate_with_two_workers(runs) -> None:
    linux, windows = (hashes(system.folder / "run") for system in runs.values())
    assert len([name for name in linux if name.startswith("images/")]) >= 8
    assert windows == linux
    assert [p.name for system in runs.values() for p in system.folder.glob(".run*")] == []
    assert [list((system.folder / "tmp").iterdir()) for system in runs.values()] == [[], []]


def same_frames(found: Path, expected: Path) -> None:
    """Check that two runs are the same but for the record of how they were made, and the page that shows it."""
    one, other = hashes(found), hashes(expected)
    assert {**one, "run.json": "", "report.html": ""} == {**other, "run.json": "", "report.html": ""}


def test_resume_after_a_kill(runs) -> None:
    system = runs["windows"]
    process = system.start(*GENERATE, "--out", "killed")
    end = time.monotonic() + WAIT_S
    while not list((system.folder / ".killed.partial" / "images").rglob("*.jpg")):
        assert time.monotonic() < end and process.poll() is None
        time.sleep(0.01)
    workers = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.communicate()
    assert workers and not psutil.wait_procs(workers, timeout=WAIT_S)[1]
    assert (system.folder / ".killed.partial").is_dir()
    system.run(*GENERATE, "--out", "killed", "--resume")
    same_frames(system.folder / "killed", runs["linux"].folder / "run")


def test_shards_and_merge(runs) -> None:
    system = runs["windows"]
    for number in (1, 2):
        system.run(*GENERATE, "--out", "shards", "--shard", f"{number}/2")
    system.run("merge", "shards", "merged")
    same_frames(system.folder / "merged", runs["linux"].folder / "run")


def pages(system: System) -> dict[str, str]:
    system.run("preview", "run", "--out", "sheet.png")
    system.run("report", "run")
    system.run("show", "run", "train/0_60_30_0_00001_c0")
    system.run("exclude", "run", "train/0_60_30_0_00001_c0", "--reason", "ünfit")
    return {**hashes(system.folder / "run"), "sheet": (system.folder / "sheet.png").read_bytes().hex()}


def test_preview_report_and_exclude(runs) -> None:
    linux, windows = on_both(runs, pages)
    assert windows == linux


def converted(system: System) -> dict[str, str]:
    for to in ("yolo", "coco"):
        system.run("convert", "../odd", to, "--to", to)
    found = {f"{to}/{name}": of for to in ("yolo", "coco") for name, of in digests(system.folder / to).items()}
    found["check"] = system.run("check", "yolo", "--json")
    system.run("convert", "../odd", "yolo", "--to", "yolo", "--overwrite")
    assert digests(system.folder / "yolo").keys() == {n[5:] for n in found if n.startswith("yolo/")}
    return found


def test_convert_and_check_names_that_windows_does_not_have(both) -> None:
    linux, windows = on_both(both, converted)
    assert windows == linux
    assert len([n for n in linux if n.startswith("yolo/images/")]) == len(NAMES)


def test_two_writers_are_refused(both) -> None:
    system = both["windows"]
    code = "import sys, pathlib; from infrablend.core.workspace import workspace\n"
    code += "with workspace(pathlib.Path('busy'), 'run', 'run.json'): print(1, flush=True); sys.stdin.readline()"
    words = [sys.executable, "-c", code]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, cwd=system.folder, env=system.environment, **pipes) as other:
        other.stdout.readline()
        process = system.start("convert", "../data", "busy", "--to", "yolo")
        _, errors = process.communicate(timeout=WAIT_S)
        other.stdin.write("\n")
    assert process.returncode == 2
    assert "another process is writing" in errors


@pytest.mark.usefixtures("nicegui")
def test_the_studio_starts(runs) -> None:
    system = runs["windows"]
    process = system.start("studio", "--run", "run", "--no-open")
    try:
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:"), process.communicate()
        keeps_token = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        with keeps_token.open(address, timeout=WAIT_S) as answer:
            assert answer.status == 200
    finally:
        process.kill()
        process.communicate()


# ---- the rules themselves

BREAKS = {
    "import fcntl": "No module named 'fcntl'",
    "import os; os.getuid()": "no attribute 'getuid'",
    "import signal; signal.SIGKILL": "no attribute 'SIGKILL'",
    "import subprocess; subprocess.Popen(['true'], pass_fds=[1])": "no pass_fds",
    "from pathlib import Path; Path('con.txt').touch()": "no name on Windows",
    "from pathlib import Path; Path('a:b').mkdir()": "no name on Windows",
    "from pathlib import Path; Path('x').touch(); Path('X').touch()": "is x on Windows",
    "from pathlib import Path; Path('x').touch(); Path('y').symlink_to('x')": "no links",
    "from pathlib import Path; Path('x').touch(); Path('y').hardlink_to('x')": "no links",
    "from pathlib import Path; Path('x').touch(); Path('y').touch(); Path('y').rename('x')": "is there",
    "from pathlib import Path; Path('x').touch(); f = Path('y').open('wb'); Path('x').replace('y')": "is open",
    "from pathlib import Path; Path('d').mkdir(); f = Path('d/y').open('wb'); Path('d').rename('e')": "is open",
    "from pathlib import Path; f = Path('y').open('wb'); Path('y').unlink()": "is open",
    "import os; os.mkdir('d'); os.open('d', os.O_RDONLY)": "no folder can be opened",
    "from pathlib import Path; Path('t').write_text('ł')": "UnicodeEncodeError",
    "from pathlib import Path; Path('t').write_text('\\n'); assert Path('t').read_bytes() == b'\\n'": "AssertionError",
}


@pytest.mark.parametrize("code", BREAKS)
def test_the_rules_are_kept(both, tmp_path: Path, code: str) -> None:
    system = both["windows"]
    environment = {**system.environment, "WINDOWS_RULES": str(tmp_path)}
    words = [sys.executable, "-c", f"exec({code!r}, {{'__name__': 'infrablend.some_module'}})"]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert BREAKS[code] in done.stderr
