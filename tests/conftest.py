"""Fixtures and settings for all tests: real data, optional tools, parallel runs, hypothesis profiles."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from PIL import Image

from infrablend.formats.pictures import derived
from tests.short_run import LONG_FILES, LONG_FIXTURES, is_long, thinned_out

# The same examples on every machine and in every run; shared machines make deadlines meaningless.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    database=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")

ROOT = Path(__file__).resolve().parents[1]
REAL_DATA_VARIABLE = "INFRABLEND_REAL_DATA"
# First word of the reason where the environment lacks what a test needs: the summary counts these skips.
NEEDS = "NEEDS"
WORKER_MEMORY_BYTES = 3 * 1024**3
"""Memory of one parallel test worker with the processes that its tests start: torch and Blender at most."""


@pytest.fixture(scope="session", autouse=True)
def derived_pictures_apart(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep pictures that readers make from videos out of the user's cache; published weights stay there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(derived, "FOLDER", str(tmp_path_factory.mktemp("derived")))
        yield


@pytest.fixture(scope="session")
def real_data_or_none() -> Path | None:
    """Return the folder of real data that the environment names, or None; fail if it is named but missing."""
    named = os.environ.get(REAL_DATA_VARIABLE, "")
    if not named:
        return None
    folder = Path(named)
    if not folder.is_dir():
        pytest.fail(f"{REAL_DATA_VARIABLE}={named}: no such folder; name the one that contains hit-uav, or unset it")
    return folder.resolve()


@pytest.fixture
def real_data(real_data_or_none: Path | None) -> Path:
    """Return the folder of real data, which contains `hit-uav/` and is read-only; skip the test without one."""
    if real_data_or_none is None:
        pytest.skip(f"{NEEDS} REAL DATA: set {REAL_DATA_VARIABLE} to the folder that contains hit-uav")
    return real_data_or_none


@pytest.fixture(scope="session")
def ultralytics() -> None:
    """Skip the test where Ultralytics is not installed; fail it where it should be."""
    if find_spec("ultralytics") is None:
        _skip_or_fail(f"{NEEDS} Ultralytics: run `make train`, which first shows the download size")


@pytest.fixture(scope="session")
def yolox() -> None:
    """Skip the test where YOLOX is not installed; fail it where it should be."""
    if find_spec("yolox") is None:
        _skip_or_fail(f"{NEEDS} YOLOX: run `make train`, which first shows the download size")


@pytest.fixture(scope="session")
def tools_python() -> Path:
    """Return the Python of .venv-tools, which has libraries that load datasets; skip or fail the test without it."""
    python = ROOT / ".venv-tools" / "bin" / "python"
    if not python.exists():
        _skip_or_fail(f"{NEEDS} .venv-tools: run `make tools`, which first shows the download size")
    return python


@pytest.fixture(scope="session")
def nicegui() -> None:
    """Skip the test where NiceGUI is not installed; fail it where it should be."""
    if find_spec("nicegui") is None:
        _skip_or_fail(f"{NEEDS} NiceGUI: run `make studio`")


@pytest.fixture(scope="session")
def mkdocs() -> None:
    """Skip the test where MkDocs and what our pages need are not installed; fail it where they should be."""
    if any(find_spec(name) is None for name in ("mkdocs", "material", "mkdocstrings_handlers")):
        _skip_or_fail(f"{NEEDS} MkDocs: run `make docs`; the links of the documentation are not checked without it")


@pytest.fixture(scope="session")
def chromium(nicegui: None) -> str:
    """Return the path of Chromium; skip the test without it or without Playwright, which drives it."""
    if find_spec("playwright") is None:
        _skip_or_fail(f"{NEEDS} Playwright: run `make tools`")
    found = shutil.which("chromium")
    if found is None:  # an operating system's package, which set-up cannot always install
        pytest.skip(f"{NEEDS} CHROMIUM: apt-get install chromium; the studio's pages are not tested without it")
    return found


@pytest.fixture
def charts() -> None:
    """Have charts drawn in a file that leaves them out otherwise: they take most of the time of a page."""


def _skip_or_fail(message: str) -> NoReturn:
    if os.environ.get("INFRABLEND_REQUIRE_TOOLS") == "1":
        pytest.fail(message)
    pytest.skip(message)


HIT_UAV_CATEGORIES = ("Person", "Car", "Bicycle", "OtherVehicle", "DontCare")
# Split, file name, objects as (category, cx, cy, w, h, angle): a cut object, an empty image, a region to ignore.
TINY_FRAMES = (
    ("train", "0_60_30_0_00001.jpg", ((1, 120.5, 200.25, 60.0, 28.0, 0.5), (0, 400.0, 300.0, 12.0, 20.0, 0.0))),
    ("train", "1_90_60_0_00002.jpg", ()),
    ("val", "1_100_50_0_00003.jpg", ((2, 610.0, 480.0, 24.0, 12.0, 0.0), (4, 300.0, 100.0, 80.0, 40.0, 0.0))),
    ("test", "0_130_90_0_00004.jpg", ((3, 320.0, 256.0, 70.0, 30.0, 2.0),)),
)


@pytest.fixture(scope="session")
def write_tiny_hit_uav() -> Callable[..., Path]:
    """Write a made-up dataset of four 640 x 512 images in HIT-UAV's layout: (folder, forms) -> folder."""

    def write(root: Path, forms: tuple[str, ...] = ("normal_json", "rotate_json")) -> Path:
        sizes = {"width": 640, "height": 512}
        for form in forms:
            for split in ("train", "val", "test"):
                images, annotations = [], []
                for image_id, (of_split, name, objects) in enumerate(TINY_FRAMES):
                    if of_split != split:
                        continue
                    path = root / form / split / name
                    path.parent.mkdir(parents=True, exist_ok=True)
                    _tiny_picture(image_id).save(path, quality=90)
                    day, altitude, pitch, weather, _ = path.stem.split("_")
                    images.append({"id": image_id, "filename": name, **sizes})
                    if form == "normal_json":
                        images[-1]["date_captured"] = "20210101"
                    else:
                        facts = {"scenario": day, "weather": weather, "perspective": pitch, "altitude": altitude}
                        images[-1] |= {"depth": 1, **facts, "date": "20210101"}
                    for k, (category, *box) in enumerate(objects):
                        common = {"id": 10 * image_id + k, "image_id": image_id, "category_id": category}
                        annotations.append(common | _tiny_annotation(form, box))
                key = "annotation" if form == "normal_json" else "annotations"
                content = {
                    "info": {"description": "made up"},
                    "licenses": [],
                    "images": images,
                    "categories": [{"id": i, "name": name} for i, name in enumerate(HIT_UAV_CATEGORIES)],
                    key: annotations,
                }
                target = root / form / "annotations" / f"{split}.json"
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(json.dumps(content))
        return root

    return write


def _tiny_picture(number: int) -> Image.Image:
    """A smooth ramp with a few steps: something that JPEG and percentiles can work on."""
    x, y = np.meshgrid(np.arange(640), np.arange(512))
    return Image.fromarray((60 + x / 10 + y / 20 + 10 * number + 15 * ((x // 80 + y // 64) % 2)).astype(np.uint8))


def _tiny_annotation(form: str, box: list[float]) -> dict[str, object]:
    """The box fields of one annotation; the axis-aligned form is truncated as HIT-UAV's is."""
    if form == "rotate_json":
        return {"difficult": False, "bbox": box}
    cx, cy, w, h, angle = box
    c, s = abs(math.cos(angle)), abs(math.sin(angle))
    half_w, half_h = (w * c + h * s) / 2, (w * s + h * c) / 2
    x0, y0, x1, y1 = (int(v) for v in (cx - half_w, cy - half_h, cx + half_w, cy + half_h))
    corners = [x0, y0, x1, y0, x1, y1, x0, y1]
    return {"segmentation": [corners], "area": (x1 - x0) * (y1 - y0), "bbox": [x0, y0, x1 - x0, y1 - y0]}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the long run."""
    parser.addoption("--all", action="store_true", help="also run tests with the mark `long`, and thinned ones whole")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files that import what only the long run installs."""
    left_out = not config.option.all and collection_path.as_posix().endswith(LONG_FILES)
    return True if left_out else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests by their fixtures and folders, and leave out those of the long run unless it was asked for.

    With `-n`, files with slow tests begin first, so that no worker is left with one at the end.
    """
    if not config.option.all:
        thinned = thinned_out(items)
        left_out = [item for item in items if item in thinned or is_long(item)]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]
    for item in items:
        if {"real_data", "real_data_or_none"} & set(getattr(item, "fixturenames", ())):
            item.add_marker("realdata")
        if "blender" in item.path.relative_to(ROOT).parts:
            item.add_marker("blender")
        # Coverage costs half of the time of a test again, so only the quick ones are measured, and those of object
        # storage, which needs a server.
        quick = item.path.relative_to(ROOT).parts[1] in ("unit", "property", "lab")
        needs_tools = not LONG_FIXTURES.isdisjoint(getattr(item, "fixturenames", ()))
        if item.path.name != "test_storage.py" and (not quick or needs_tools or item.get_closest_marker("slow")):
            item.add_marker("no_cover")
    if not (hasattr(config, "workerinput") or getattr(config.option, "numprocesses", None)):
        return
    slow = {item.path for item in items if item.get_closest_marker("slow") or item.get_closest_marker("blender")}
    items.sort(key=lambda item: item.path not in slow)  # stable: the order is kept otherwise


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport() -> Iterator[None]:
    """Escape lone surrogates in what a test printed and logged: parallel workers cannot send them."""
    outcome = yield
    report = outcome.get_result()  # type: ignore[attr-defined]
    report.sections = [(title, text.encode("utf-8", "backslashreplace").decode()) for title, text in report.sections]


def pytest_configure(config: pytest.Config) -> None:
    """Share the cores among parallel workers, which inherit this: waiting threads of torch and OpenBLAS spin."""
    if workers := getattr(config.option, "numprocesses", None):
        from infrablend.core.operating_system import usable_processors

        os.environ.setdefault("OMP_NUM_THREADS", str(max(1, len(usable_processors()) // workers)))


def pytest_xdist_auto_num_workers() -> int:
    """Return the workers of `-n auto`: one per usable core, as far as the memory allows."""
    from infrablend.core.machine import usable_cores, usable_memory_bytes

    return max(1, min(int(usable_cores()), usable_memory_bytes() // WORKER_MEMORY_BYTES))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List the tests that were skipped because data or tools are missing."""
    reasons: Counter[str] = Counter()
    for report in terminalreporter.stats.get("skipped", ()):
        reason = str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)
        reason = reason.removeprefix("Skipped: ")
        if reason.startswith(NEEDS):
            reasons[reason] += 1
    if reasons:
        terminalreporter.section("not tested for lack of data or tools", yellow=True, bold=True)
        for reason, count in sorted(reasons.items()):
            terminalreporter.line(f"{count} tests were skipped. {reason}", yellow=True)
