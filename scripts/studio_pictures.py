"""Takes the pictures of the studio for the docs: its pages on the run of `make demo` and on a flight.

Needs Chromium and what `make tools` installs.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
DEMO = ROOT / "build" / "demo"
IMAGES = ROOT / "docs" / "images"
WAIT_MS = 60_000


def main(demo: Path) -> None:
    """Start the studio on a demo's folder, and take a picture of each page."""
    recipe, world, second = "hit-uav-drone-physical", demo / "world", demo / "physical"
    infrablend = [sys.executable, "-m", "infrablend", "-q"]
    if not second.is_dir():
        subprocess.run([*infrablend, "generate", recipe, "--data", world, "--out", second], check=True)
    flight, people = demo / "flight", demo / "people"
    if not people.is_dir():
        world_of = [*infrablend, "world", "--layout", "flight", "--count", "150", "--out", flight]
        subprocess.run(world_of, check=True)
        subprocess.run([*infrablend, "generate", "people-video", "--data", flight, "--out", people], check=True)
    compared = ["--compare", second, "--results", ROOT / "docs" / "results"]
    with opened([*infrablend, "studio", recipe, "--run", demo / "run", "--data", world, *compared]) as (page, base):
        take(page, f"{base}/review", ".frame-cell img", "review")
        third = page.locator(".frame-name").nth(2).inner_text()
        take(page, f"{base}/review?frame={third}", ".crops img", "frame")
        take(page, f"{base}/results", "table.figures", "results")
        take(page, f"{base}/compare", ".wipe img", "compare")
        page.emulate_media(color_scheme="dark")
        take(page, f"{base}/tune", ".tune-facts .studio-card", "tune")
    with opened([*infrablend, "studio", "--run", people]) as (page, base):
        take(page, f"{base}/sequences?frame=train/flight_000_000080", ".player canvas", "sequence")


@contextmanager
def opened(command: Sequence[str | Path]) -> Iterator[tuple[Page, str]]:
    """Start a studio; yield a page of a browser that may see it, and its address."""
    command = [*command, "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as studio, sync_playwright() as playwright:
        assert studio.stdout is not None
        address = studio.stdout.readline().strip()
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="light").new_page()
        page.set_default_timeout(WAIT_MS)
        page.goto(address)
        yield page, address.partition("/?")[0]
        browser.close()
        studio.terminate()


def take(page: Page, address: str, ready: str, name: str) -> None:
    """Write the picture of a page once an element is there and its pictures are loaded."""
    page.goto(address)
    page.locator(ready).first.wait_for()
    page.wait_for_load_state("networkidle")
    page.wait_for_function("() => [...document.images].every(i => i.complete || i.loading == 'lazy')")
    page.screenshot(path=IMAGES / f"studio_{name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else DEMO)
