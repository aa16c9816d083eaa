"""Measure the studio: `redraw DATA`, after a change of a setting; `open RUN`, many frames; `play RUN`, a sequence.

`open` and `play` need Chromium and what `make tools` installs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.ledger import DoneFrame, Ledger
from infrablend.core.run_folder import RunFolder
from infrablend.core.yaml_text import read_yaml
from infrablend.pipeline.compose.trial import TrialRequest
from infrablend.studio.page_pictures import to_png
from infrablend.studio.tuning import Tuning

_WAIT_MS = 120_000
_SEEN = """() => {
  const shown = [...document.querySelectorAll(".frame-cell img")];
  return shown.length && shown.every((i) => i.complete && i.naturalWidth);
}"""


def main() -> None:
    """Print one JSON object with the measured seconds and the load of the machine."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True, dest="command")
    redraw = commands.add_parser("redraw", help="from a changed temperature to the encoded picture with boxes")
    redraw.add_argument("data", type=Path)
    redraw.add_argument("--recipe", default="hit-uav-drone-physical")
    redraw.add_argument("--size-px", type=float, default=60.0, help="size of the drone in the picture")
    redraw.add_argument("--set", action="append", dest="settings", help="setting instead of the size; repeatable")
    redraw.add_argument("--repeats", type=int, default=40)
    opened = commands.add_parser("open", help="from the start of the studio to the pictures of a run in the browser")
    opened.add_argument("run", type=Path, help="run to repeat")
    opened.add_argument("--frames", type=int, default=10_000, help="frames of the run that is opened")
    played = commands.add_parser("play", help="frames per second of the first sequence of a run")
    played.add_argument("run", type=Path, help="run with tracks")
    played.add_argument("--seconds", type=float, default=8.0)
    played.add_argument("--speed", choices=("0.25", "0.5", "1", "2"), default="1")
    options = vars(parser.parse_args())
    measure = {"redraw": measure_redraw, "open": measure_open, "play": measure_play}[options.pop("command")]
    load = os.getloadavg()[0]
    print(json.dumps({**measure(**options), "load": [round(load, 1), round(os.getloadavg()[0], 1)]}))


def measure_redraw(data: Path, recipe: str, size_px: float, settings: list[str] | None, repeats: int) -> dict[str, Any]:
    """Return median and 95 % quantile of the seconds from a changed temperature to the picture."""
    tuning = Tuning(TrialRequest(recipe, data))
    try:
        background = tuning.backgrounds[0]
        # A drone has this size at a distance of 10 to 20 m.
        size = {"placement.size_px": [size_px * 0.9, size_px * 1.1], "objects.0.range_m": [10, 20]}
        chosen = size if settings is None else {k: read_yaml(v) for k, _, v in (s.partition("=") for s in settings)}
        seconds = []
        for warmth in np.linspace(2.0, 20.0, repeats + 2):
            changed = {**chosen, "environment.air_temperature_c": [warmth, warmth]}
            start = time.perf_counter()
            tuned = tuning.compose(recipe, changed, background)
            to_png(tuned.picture(boxes=True))
            seconds.append(time.perf_counter() - start)
        drawn = [max(i.box_xyxy[2:] - i.box_xyxy[:2]) for i in tuned.trial.frame.inserted]
    finally:
        tuning.close()
    # The first two frames load the models and the background.
    median, slow = np.percentile(seconds[2:], [50, 95])
    result = {"frames": repeats, "inserts_px": [round(float(d)) for d in drawn]}
    return {**result, "median_s": round(float(median), 3), "p95_s": round(float(slow), 3)}


def measure_open(run: Path, frames: int) -> dict[str, Any]:
    """Return what opening a large run takes, with an empty cache and with the one of the first time."""
    with tempfile.TemporaryDirectory() as folder:
        large = repeated(run, Path(folder) / "run", frames)
        cache = Path(folder) / "cache"
        return {"frames": frames, "cold": _open(large, cache), "warm": _open(large, cache)}


def repeated(run: Path, folder: Path, frames: int) -> Path:
    """Write a run with the frames of another one again and again, under other names; return its folder.

    The pictures are hard links; every record has a digest of its own, so that no two frames share a thumbnail.
    """
    source, target = RunFolder(run), RunFolder(folder)
    shutil.copytree(run, folder, ignore=shutil.ignore_patterns("images", "run.sqlite", "report.html"))
    records = list(source.records())
    with Ledger.create(folder, source.read_run()) as ledger:
        for number in range(frames):
            record = records[number % len(records)]
            split, _, name = record.frame_id.rpartition("/")
            frame_id, image = f"{split}/{number:05}_{name}", f"{split}/{number:05}_{Path(record.image).name}"
            digest = hashlib.sha256(frame_id.encode()).hexdigest()
            again = replace(record, frame_id=frame_id, image=image, image_sha256=digest)
            target.image(image).parent.mkdir(parents=True, exist_ok=True)
            os.link(source.image(record.image), target.image(image))
            ledger.add(frame_id, DoneFrame(image, 0, digest, len(record.inserted)), again.to_text())
    return folder


def _open(run: Path, cache: Path) -> dict[str, float]:
    """Return the seconds of each step, and the CPU seconds of the server in it.

    `opened` is from the command to the pictures of the first screen: the start of the server, the page, and the
    thumbnails. Then the grid jumps to its end. `filters` come last: they need all records.
    """
    command = [sys.executable, "-m", "infrablend", "-q", "studio", "--run", str(run), "--no-open"]
    environment = {**os.environ, "INFRABLEND_CACHE": str(cache)}
    with _browser_page() as page:
        watch = _Watch()
        with _started(command, environment) as (server, address):
            watch.note("server", server)
            page.goto(address)
            page.locator(".frame-cell").first.wait_for()
            watch.note("page", server)
            page.wait_for_function(_SEEN)
            watch.note("thumbnails", server)
            page.evaluate("() => { const b = document.querySelector('.frame-grid'); b.scrollTop = b.scrollHeight }")
            page.locator(f'[data-at="{_count(run) - 1}"]').wait_for()
            page.wait_for_function(_SEEN)
            watch.note("end", server)
            page.get_by_label("Sort by").first.wait_for()
            watch.note("filters", server)
    parts = ("server", "page", "thumbnails")
    opened = {
        f"opened_{unit}": round(sum(watch.noted[f"{p}_{unit}"] for p in parts), 2) for unit in ("s", "server_cpu_s")
    }
    return {**opened, **watch.noted}


def _count(run: Path) -> int:
    with RunFolder(run).ledger() as ledger:
        return len(ledger.frame_ids())


def measure_play(run: Path, seconds: float, speed: str) -> dict[str, Any]:
    """Return the frames per second that a sequence is played at, and the CPU seconds of the server per second."""
    command = [sys.executable, "-m", "infrablend", "-q", "studio", "--run", str(run), "--no-open"]
    with _browser_page() as page, _started(command, dict(os.environ)) as (server, address):
        page.goto(address)
        page.goto(address.partition("/?")[0] + "/sequences")
        page.locator(".player canvas").wait_for()
        page.wait_for_load_state("networkidle")  # what it fetches before it plays
        page.locator(".player select").select_option(speed)
        at, used, start = page.locator(".player input[type=range]"), _cpu_seconds(server), time.perf_counter()
        page.keyboard.press("Space")
        time.sleep(seconds)
        frames, took = int(at.input_value()), time.perf_counter() - start
        return {"per_s": round(frames / took, 1), "server_cpu": round((_cpu_seconds(server) - used) / took, 2)}


@contextmanager
def _browser_page() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
        page.set_default_timeout(_WAIT_MS)
        page.goto("about:blank")
        yield page
        browser.close()


class _Watch:
    """Notes the seconds between events, and the CPU seconds of the server in them."""

    def __init__(self) -> None:
        self.noted: dict[str, float] = {}
        self._last, self._used = time.perf_counter(), 0.0

    def note(self, event: str, server: int) -> None:
        """Note an event."""
        now, used = time.perf_counter(), _cpu_seconds(server)
        self.noted |= {f"{event}_s": round(now - self._last, 2), f"{event}_server_cpu_s": round(used - self._used, 2)}
        self._last, self._used = now, used


def _cpu_seconds(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(int(f) for f in fields[11:13]) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _started(command: list[str], environment: dict[str, str]) -> Iterator[tuple[int, str]]:
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.pid, process.stdout.readline().strip()
        finally:
            process.kill()


if __name__ == "__main__":
    main()
