"""The pages of the studio in Chromium: every request stays on this machine, keys work, and a kill loses nothing."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from tests.lab.pages.test_studio_results import REALISM
from tests.onnx_files import write_constant
from tests.run_files import edit_ledger
from tests.samples import picture
from tests.studio_runs import frame_record, write_run, write_sequence

from infrablend import api
from infrablend.config.loading import load_recipe
from infrablend.formats.pictures.images import png_bytes
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.runs.review_file import Verdict, read_verdicts

pytestmark = pytest.mark.slow
WAIT_MS = 60_000


@contextmanager
def browser_page(chromium: str, **options: Any) -> Iterator[tuple[Any, list[str], list[str]]]:
    """Yield a page, the addresses that it asked for, and its errors without those of a connection that was cut."""
    from playwright.sync_api import sync_playwright

    asked: list[str] = []
    errors: list[str] = []

    def note(kind: str, text: str) -> None:
        if kind == "error" and "ERR_CONNECTION" not in text and "WebSocket" not in text:
            errors.append(text)

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_context(viewport={"width": 1280, "height": 800}, **options).new_page()
        page.set_default_timeout(WAIT_MS)
        page.on("request", lambda r: asked.append(r.url))
        page.on("websocket", lambda w: asked.append(w.url))
        page.on("pageerror", lambda e: note("error", str(e)))
        page.on("console", lambda m: note(m.type, m.text))
        yield page, asked, errors
        browser.close()


@contextmanager
def studio(chromium: str, folder: Path, *words: object, **options: Any) -> Iterator[Any]:
    """Start the studio in a folder and open it; yield `page`, `asked`, `errors`, `process` and `base`, its address."""
    command = [sys.executable, "-m", "infrablend", "-q", "studio", *map(str, words), "--no-open"]
    environment = {**os.environ, "INFRABLEND_CACHE": str(folder / "cache")}
    # Playwright's own loop must not keep the process's output open.
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            address = process.stdout.readline().strip()
            assert address.startswith("http://127.0.0.1:"), address
            with browser_page(chromium, **options) as (page, asked, errors):
                page.goto(address)
                base = address.partition("/?")[0]
                yield SimpleNamespace(page=page, asked=asked, errors=errors, process=process, base=base)
        finally:
            process.kill()


@contextmanager
def tuned_run(
    chromium: str, write: Callable[..., Path], folder: Path, recipe: str, settings: dict[str, Any] | None = None
) -> Iterator[Any]:
    """Tune a run of one picture, over backgrounds in `folder`: yield as `studio` does, at the first picture."""
    data, run = write(folder / "data"), folder / "run"
    flat = Execution(renderer="flat", in_process=True)
    api.generate(recipe, data, run, limit=1, settings=settings or {}, execution=flat)
    with studio(chromium, folder, "--run", run) as opened:
        opened.page.goto(f"{opened.base}/tune")
        opened.page.locator("img.picture[src]").wait_for()
        yield opened


def records_of(*names: str, **changes: Any) -> dict[str, dict[str, Any]]:
    """Return the records of frames by id."""
    return {f"test/{n}_c0": frame_record(f"test/{n}_c0", **changes) for n in names}


def test_a_run_is_reviewed_by_keyboard_and_a_kill_loses_no_verdict(chromium: str, tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", records_of(*(f"f{n:04}" for n in range(60))))
    with studio(chromium, tmp_path, "--run", run) as opened:
        page = opened.page
        page.locator(".frame-cell img").first.wait_for()
        assert "token" not in page.url
        assert page.locator(".frame-cell").count() < 60, "only visible cells are in the page"
        page.locator(".frame-cell:focus").wait_for()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Enter")
        for key, frame in (("a", "f0002"), ("r", "f0003"), ("3", "f0004")):
            page.locator(".verdict").wait_for()
            page.keyboard.press(key)
            page.locator(f'.verdict[data-frame="test/{frame}_c0"]').wait_for()
        page.keyboard.press("u")
        page.locator('.verdict[data-frame="test/f0003_c0"][data-verdict=""]').wait_for()
        page.keyboard.press("r")
        page.locator('.verdict[data-frame="test/f0004_c0"]').wait_for()
        opened.process.send_signal(signal.SIGKILL)
        opened.process.wait()
    assert read_verdicts(run / "review.json") == {
        "test/f0001_c0": Verdict("accept"), "test/f0002_c0": Verdict("reject"), "test/f0003_c0": Verdict("reject"),
    }  # fmt: skip
    own = (opened.base, opened.base.replace("http", "ws"), "data:", "blob:")
    assert opened.asked and all(a.startswith(own) for a in opened.asked)
    assert opened.errors == []
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cache", "run"], "nothing else is written"


def test_each_frame_has_an_address_and_back_keeps_the_view_and_its_place(chromium: str, tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", records_of(*(f"f{n:04}" for n in range(90))))

    def place() -> int:
        return int(page.evaluate("() => document.querySelector('.frame-grid').scrollTop"))

    with studio(chromium, tmp_path, "--run", run) as opened:
        page = opened.page
        page.locator(".frame-cell img").first.wait_for()
        page.get_by_role("switch", name="Largest first").click()
        page.locator(".frame-cell", has_text="f0089").click()
        page.wait_for_url(f"{opened.base}/review?descending=1&frame=test/f0089_c0")
        page.keyboard.press("Escape")
        page.wait_for_url(f"{opened.base}/review?descending=1")
        page.locator(".frame-cell:focus", has_text="f0089").wait_for()
        for _ in range(9):
            page.keyboard.press("ArrowDown")
        page.wait_for_function("() => history.state.top > 400")
        top = place()
        page.keyboard.press("Enter")
        first = page.locator(".verdict").get_attribute("data-frame")
        page.wait_for_url(f"{opened.base}/review?descending=1&frame={first}")
        page.keyboard.press("ArrowRight")
        shown = page.locator(f'.verdict:not([data-frame="{first}"])').get_attribute("data-frame")
        page.wait_for_url(f"{opened.base}/review?descending=1&frame={shown}")
        page.reload()
        page.locator(f'.verdict[data-frame="{shown}"]').wait_for()
        page.go_back()
        page.locator(".frame-cell:focus", has_text=shown).wait_for()
        assert place() == top, "the place in the list, although the frame was loaded again"
        page.go_forward()
        page.locator(f'.verdict[data-frame="{shown}"]').wait_for()
        page.go_back()
        page.locator(".frame-cell:focus").wait_for()
        page.reload()
        page.locator(".frame-cell:focus").wait_for()
        assert place() == top
        assert page.get_by_role("switch", name="Largest first").is_checked()
        page.goto(f"{opened.base}/review?frame=test/x_c0")
        page.get_by_text("test/x_c0: no such frame; the run has 90").wait_for()
    assert opened.errors == []


_WATCH = """() => new Promise((done) => {
  const canvas = document.querySelector("canvas"), found = { frames: [], wrong: [] };
  function look() {
    const at = +document.querySelector("input[type=range]").value;
    const box = document.querySelector(".player-stage g:not(.original) rect");
    if (found.frames.at(-1) !== at) {
      found.frames.push(at);
      const x = box ? +box.getAttribute("x") : 2 + 2 * at;
      const pixel = (dx) => canvas.getContext("2d").getImageData(x + dx, 23, 1, 1).data[0] > 128;
      if (pixel(0) !== !!box || pixel(5) !== !!box || pixel(-1)) found.wrong.push(at);
    }
    if (document.querySelector(".player button").innerText.startsWith("Play")) done(found);
    else requestAnimationFrame(look);
  }
  requestAnimationFrame(look);
})"""


def test_a_sequence_is_played_with_its_tracks_on_their_frames(chromium: str, tmp_path: Path) -> None:
    run = write_sequence(tmp_path / "run")
    with studio(chromium, tmp_path, "--run", run) as opened:
        page = opened.page

        def wait_for(frame: int) -> None:
            page.locator(f'canvas[aria-label="Frame test/s_{frame:06d}"]').wait_for()

        page.goto(f"{opened.base}/review?frame=test/s_000003")
        page.locator(".verdict").wait_for()
        page.keyboard.press("p")
        wait_for(3)
        page.get_by_text("24 frames; tracks: 1 inserted, 1 original").wait_for()
        page.keyboard.press("Space")
        watched = page.evaluate(_WATCH)
        assert watched["wrong"] == []
        assert watched["frames"] == list(range(watched["frames"][0], 24)), "every frame, in order"
        page.keyboard.press("Space")
        page.wait_for_function("() => document.querySelector('input[type=range]').value == '12'")
        page.keyboard.press("Space")
        for key, frame in (("End", 23), ("ArrowLeft", 22), ("Home", 0), ("ArrowRight", 1), ("Shift+ArrowRight", 11)):
            page.keyboard.press(key)
            wait_for(frame)
        assert page.locator(".player-stage g").count() == 1, "the inserted one is out of view"
        spans = page.locator(".timeline-bar:not(.original) rect")
        ends = [tuple(float(s.get_attribute(k) or 0) for k in ("x", "width")) for s in spans.all()]
        assert ends == [(0, 10), (14, 10)]
        bar = page.locator(".timeline-bar").first.bounding_box()
        page.mouse.click(bar["x"] + bar["width"] * 18.5 / 24, bar["y"] + 3)
        wait_for(18)
        page.wait_for_url(f"{opened.base}/sequences?frame=test/s_000018")
        page.keyboard.press("o")
        page.locator(".player-stage g.original").wait_for(state="detached")
        page.keyboard.press("b")
        page.locator(".player-stage g").wait_for(state="detached")
        page.reload()
        wait_for(18)
        page.get_by_role("button", name="drone 2, inserted: frames 1 to 10, 15 to 24").click()
        wait_for(0)
        page.get_by_role("link", name="Review this frame").click()
        page.locator('.verdict[data-frame="test/s_000000"]').wait_for()
        page.go_back()
        wait_for(0)
        page.goto(f"{opened.base}/sequences?frame=test/x")
        page.get_by_role("alert").get_by_text("test/x: no such frame in a sequence of the run").wait_for()
        assert page.request.get(f"{opened.base}/run/sequences/1").status == 404
    assert opened.errors == []


def test_any_name_of_a_sequence_is_kept_in_addresses(chromium: str, tmp_path: Path) -> None:
    name = "Flug #1 & 50%2F+é 'x'"
    run = write_sequence(tmp_path / "run", 3, name)
    with studio(chromium, tmp_path, "--run", run) as opened:
        page = opened.page
        page.goto(f"{opened.base}/sequences")
        last = page.get_by_label(f"Frame test/{name}_000002", exact=True)
        page.get_by_label(f"Frame test/{name}_000000", exact=True).wait_for()
        page.keyboard.press("End")
        last.wait_for()
        page.get_by_role("link", name="Review this frame").click()
        page.locator(".verdict").wait_for()
        assert page.locator(".verdict").get_attribute("data-frame") == f"test/{name}_000002"
        page.go_back()
        last.wait_for()
        assert opened.errors == []


def test_a_sequence_goes_on_after_a_picture_that_is_gone(chromium: str, tmp_path: Path) -> None:
    run = write_sequence(tmp_path / "run")
    (run / "images/test/s_000005.png").unlink()
    with studio(chromium, tmp_path, "--run", run) as opened:
        page = opened.page
        page.goto(f"{opened.base}/sequences?frame=test/s_000002")
        page.locator('canvas[aria-label="Frame test/s_000002"]').wait_for()
        page.keyboard.press("Space")
        page.get_by_role("alert").get_by_text("s_000005.png: not a readable picture").wait_for()
        page.locator('canvas[aria-label="Frame test/s_000005"]').wait_for()
        page.keyboard.press("ArrowRight")
        page.locator('canvas[aria-label="Frame test/s_000006"]').wait_for()
        page.get_by_role("alert").wait_for(state="detached")


def test_pictures_records_and_connections_that_are_gone_are_named(chromium: str, tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", records_of(*"abc"))
    with studio(chromium, tmp_path, "--run", run) as opened:
        page = opened.page
        page.locator(".frame-cell img").first.wait_for()
        (run / "images/test/b_c0.png").unlink()
        edit_ledger(run, "DELETE FROM records WHERE frame_id = 'test/c_c0'")
        for name, words in (("b", "test/b_c0.png: not a readable picture"), ("c", "no finished frame 'test/c_c0'")):
            page.goto(f"{opened.base}/review?frame=test/{name}_c0")
            page.get_by_role("alert").get_by_text(words).wait_for()
            assert not page.locator("img.picture").is_visible()
        # Each key after the page has answered the one before: the frame of `b` is shown on the way back as well.
        for key, shown in (("ArrowLeft", "test/b_c0"), ("ArrowLeft", "test/a_c0"), ("a", "test/b_c0")):
            page.keyboard.press(key)
            page.locator(f'.verdict[data-frame="{shown}"]').wait_for()
        opened.process.kill()
        page.locator("#popup").get_by_text("Connection lost").wait_for()
    assert read_verdicts(run / "review.json") == {"test/a_c0": Verdict("accept")}


def test_a_run_that_changes_while_it_is_open_gets_no_verdict_on_another_frame(chromium: str, tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", records_of(*"abc"))
    with studio(chromium, tmp_path, "--run", run) as opened:
        page = opened.page
        page.locator(".frame-cell img").first.wait_for()
        page.goto(f"{opened.base}/review?frame=test/b_c0")
        page.locator('.verdict[data-frame="test/b_c0"]').wait_for()
        # As `exclude` does: frame 1 is now another one.
        edit_ledger(run, "UPDATE frames SET excluded = 'x' WHERE frame_id = 'test/a_c0'")
        os.utime(run / "run.json")
        page.keyboard.press("a")
        page.get_by_text("have changed since this page was opened").first.wait_for()
        assert not (run / "review.json").exists()
        run.rename(tmp_path / "elsewhere")
        page.keyboard.press("ArrowRight")
        page.get_by_text("its frames are gone").first.wait_for()
        page.goto(f"{opened.base}/results")
        page.get_by_role("alert").get_by_text("expected the run that was opened").wait_for()


def background_of(name: str) -> dict[str, object]:
    return {"id": name, "path": f"{name}.png", "size_wh": [64, 48]}


def test_detections_are_judged_by_keyboard(chromium: str, tmp_path: Path) -> None:
    flight = tmp_path / "flight"
    flight.mkdir()
    pixels = np.full((64, 64), 20, np.uint8)
    for k, level in enumerate((250, 200, 150)):
        pixels[16 * k : 16 * k + 8, :8] = level
    (flight / "a.png").write_bytes(png_bytes(pixels))
    named = {"names": "['person', 'dog']"}
    outputs = {"output0": np.zeros((1, 6, 84), np.float32)}
    for k, score in enumerate((0.9, 0.8, 0.7)):
        outputs["output0"][0, :, k] = [4, 16 * k + 4, 8, 8, score, 0]
    api.detect(write_constant(tmp_path / "d.onnx", outputs, named), flight, tmp_path / "found")
    with studio(chromium, tmp_path, "--detections", tmp_path / "found") as opened:
        page = opened.page
        for key, number in (("a", 0), ("2", 1), ("r", 2)):
            page.locator(f'.verdict[data-frame="train/a.png#{number}"][data-verdict=""]').wait_for()
            page.wait_for_function("document.querySelector('img.picture').naturalWidth === 64")
            page.keyboard.press(key)
        page.locator('.verdict[data-frame="train/a.png#2"][data-verdict="reject"]').wait_for()
        page.keyboard.press("u")
        page.locator('.verdict[data-frame="train/a.png#2"][data-verdict=""]').wait_for()
        page.keyboard.press("ArrowLeft")
        page.locator('.verdict[data-frame="train/a.png#1"][data-verdict="accept"]').wait_for()
        assert "2 accepted, 0 rejected" in page.content()
        assert opened.errors == []
    assert read_verdicts(tmp_path / "found" / "review.json") == {
        "train/a.png#0": Verdict("accept"), "train/a.png#1": Verdict("accept", category="dog"),
    }  # fmt: skip


def test_two_runs_are_compared_by_keyboard(chromium: str, tmp_path: Path) -> None:
    fainter = frame_record("x")["inserted"][0] | {"extra": {"contrast_grey": -4.0}}
    ours, theirs = (
        {k: r for n in names for k, r in records_of(n, background=background_of(n), image_sha256=f"{n}{names}").items()}
        for names in ("abc", "bcd")
    )
    theirs["test/b_c0"]["inserted"] = [fainter]
    first, second = write_run(tmp_path / "first", ours), write_run(tmp_path / "second", theirs)
    with studio(chromium, tmp_path, "--run", first, "--compare", second) as opened:
        page = opened.page
        page.goto(f"{opened.base}/compare")
        page.get_by_text("2 frames in both, 0 with equal pictures; 1 only in A, 1 only in B").wait_for()
        page.locator(".pair-line[aria-current]", has_text="test/b_c0").wait_for()
        divider = page.get_by_label("Divider", exact=True).and_(page.locator("input[type=range]"))
        divider.focus()
        page.keyboard.press("ArrowRight")
        page.locator('.wipe-line[style*="51%"]').wait_for()
        page.locator(".pair-line[aria-current]").focus()
        page.keyboard.press("ArrowDown")
        page.keyboard.press("Enter")
        page.locator(".pair-line[aria-current]", has_text="test/c_c0").wait_for()
        page.keyboard.press("p")
        page.locator(".pair-line[aria-current]", has_text="test/b_c0").wait_for()
        page.get_by_role("switch", name="Divider").click()
        page.locator(".compare-sides img").nth(1).wait_for()
        for path in ("/compare/c/picture/0.png", "/compare/a/picture/9.png", "/compare/b/picture/..%2f..%2fx.png"):
            assert page.request.get(opened.base + path).status in (404, 422)
    assert any("/compare/b/picture/" in a for a in opened.asked)
    assert opened.errors == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_no_serious_issue(
    chromium: str, theme: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path
) -> None:
    run = write_sequence(tmp_path / "run")
    (run / "review.json").write_text('{"frames": {"test/s_000000": {"verdict": "accept"}}}')
    other = write_run(tmp_path / "other", {f"test/s_{k:06d}": frame_record(f"test/s_{k:06d}") for k in range(2)})
    data = write_tiny_hit_uav(tmp_path / "data")
    shown = {"/review": ".frame-cell", "/review?frame=test/s_000001": "img.picture", "/sequences": ".player canvas"}
    shown |= {"/losses": "h2", "/tune": ".tune-form h2", "/compare": ".wipe img", "/results": ".result-plots img"}
    picture(run / "realism/car_random.png", 1)
    (run / "realism/realism.json").write_text(json.dumps(REALISM))
    found = []
    words = ("hit-uav-drone", "--run", run, "--data", data, "--compare", other)
    with studio(chromium, tmp_path, *words, color_scheme=theme) as opened:
        for path, selector in shown.items():
            opened.page.goto(opened.base + path)
            opened.page.locator(selector).first.wait_for()
            found += [(path, *issue) for issue in serious_issues(opened.page)]
    assert found == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_no_serious_issue_in_the_report_of_a_run(
    chromium: str, theme: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path
) -> None:
    data, run = write_tiny_hit_uav(tmp_path / "data"), tmp_path / "run"
    flat = Execution(renderer="flat", in_process=True)
    api.generate("hit-uav-drone", data, run, limit=2, execution=flat)
    report = run / "report.html"
    with browser_page(chromium, color_scheme=theme) as (page, asked, errors):
        page.goto(report.as_uri())
        page.locator("h1").first.wait_for()
        assert serious_issues(page) == []
    assert all(a.startswith(("file:", "data:")) for a in asked)
    assert errors == []


def serious_issues(page: Any) -> list[tuple[str, str]]:
    """Return what axe finds in a page once its menus have faded out: rule, and the first element."""
    page.wait_for_function("document.querySelector('.q-menu') === null")
    page.evaluate(resources.files("axe_playwright_python").joinpath("axe.min.js").read_text("utf-8"))
    found = page.evaluate("async () => (await axe.run()).violations")
    return [(i["id"], i["nodes"][0]["html"][:200]) for i in found if i["impact"] in ("serious", "critical")]


def wait_for_value(page: Any, label: str, value: str | re.Pattern[str]) -> None:
    """Wait until a field has a value: the server may set it after the text that a test has waited for."""
    expect = pytest.importorskip("playwright.sync_api").expect
    expect(page.get_by_label(label, exact=True)).to_have_value(value, timeout=WAIT_MS)


def test_a_run_alone_can_be_tuned_or_says_what_is_missing(
    chromium: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path
) -> None:
    data, run = write_tiny_hit_uav(tmp_path / "data"), tmp_path / "run"
    flat = Execution(renderer="flat", in_process=True)
    api.generate("hit-uav-drone", data, run, limit=1, settings={"camera.distance_m": [3, 4]}, execution=flat)
    for words in (None, "no such folder; expected the backgrounds of this run"):
        with studio(chromium, tmp_path, "--run", run) as opened:
            page = opened.page
            page.get_by_role("link", name="Tune").click()
            if words is None:
                page.locator("img.picture[src]").wait_for()
                wait_for_value(page, "File", "hit-uav-drone-tuned.yaml")
                wait_for_value(page, "distance, m, to", "4")
            else:
                page.get_by_role("alert").get_by_text(words).wait_for()
            assert opened.errors == []
        if words is None:
            data.rename(tmp_path / "moved")


def test_a_wrong_field_is_marked_and_the_last_picture_stays(
    chromium: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path
) -> None:
    pytest.importorskip("bpy")
    data = write_tiny_hit_uav(tmp_path / "data")
    with studio(chromium, tmp_path, "hit-uav-drone", "--data", data) as opened:
        page = opened.page
        page.locator("img.picture[src]").wait_for()
        first = page.get_attribute("img.picture", "src")
        page.get_by_label("scale, to", exact=True).fill("3")
        page.wait_for_function("s => document.querySelector('img.picture').getAttribute('src') != s", arg=first)
        page.get_by_label("scale, from", exact=True).fill("5")
        page.locator(".studio-error", has_text="objects.0.scale").wait_for()
        page.locator(".q-field--error").first.wait_for()
        page.get_by_label("scale, from", exact=True).fill("2")
        page.locator(".studio-error", has_text="objects.0.scale").wait_for(state="hidden")
        opened.process.send_signal(signal.SIGINT)
        assert opened.process.wait(timeout=30) == 0
    assert opened.errors == []


def test_backgrounds_have_addresses_and_the_saved_recipe_a_path(
    chromium: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path
) -> None:
    many = {"objects.0.count": 3, "objects.0.scale": [6, 6], "placement.min_visibility": 0.9, "configurations": 2}
    with tuned_run(chromium, write_tiny_hit_uav, tmp_path, "hit-uav-drone", settings=many) as opened:
        page = opened.page
        page.get_by_text("hit-uav-drone (as opened)").wait_for()
        page.get_by_text("drone, was left out: ").first.wait_for()
        assert page.locator(".stage-handle").count() > 0
        before = page.locator(".stage-handle").count()
        page.get_by_role("button", name="Place object").first.click()
        page.wait_for_function("n => document.querySelectorAll('.stage-handle').length > n", arg=before)
        page.wait_for_function("() => [...document.querySelectorAll('.tune-list img')].every(i => i.naturalWidth)")
        rows = page.locator(".tune-list .q-virtual-scroll__content tr")
        name = rows.nth(1).locator("td").nth(1).inner_text().strip()
        shown = page.get_by_role("status").get_by_text(f"{name}_c0")
        rows.nth(1).click()
        shown.wait_for()
        page.wait_for_function("end => location.href.endsWith(end)", arg=f"/tune?background={name}&configuration=0")
        page.get_by_label("Configuration", exact=True).fill("1")
        page.get_by_role("status").get_by_text(f"{name}_c1").wait_for()
        page.reload()
        page.get_by_role("status").get_by_text(f"{name}_c1").wait_for()
        page.go_back()
        shown.wait_for()
        wait_for_value(page, "Configuration", "0")
        page.get_by_role("button", name="Save recipe").click()
        saved = tmp_path / "hit-uav-drone-tuned.yaml"
        page.get_by_text(f"Saved as {saved}").wait_for()
        wait_for_value(page, "File", str(saved))
        assert serious_issues(page) == []
        assert opened.errors == []


def test_all_wrong_fields_are_marked_in_their_places(
    chromium: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path
) -> None:
    with tuned_run(chromium, write_tiny_hit_uav, tmp_path, "hit-uav-drone") as opened:
        page = opened.page
        page.get_by_label("scale, from", exact=True).fill("5")
        page.get_by_role("button", name="camera").click()
        page.get_by_label("pitch", exact=True).fill("{fixed_deg: x}")
        page.get_by_label("distance, m, from", exact=True).fill("")
        page.locator(".q-field--error", has_text="expected a number").first.wait_for()
        page.locator(".q-field--error", has_text="fixed_deg").wait_for()
        page.locator(".q-field--error", has_text="low end").first.wait_for()
        page.get_by_role("button", name="Save recipe").click()
        page.get_by_text("correct the marked fields first").wait_for()
        assert not (tmp_path / "hit-uav-drone-tuned.yaml").exists()
        assert serious_issues(page) == []
        assert opened.errors == []


def test_options_are_chosen_from_lists_and_a_run_is_made(
    chromium: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path
) -> None:
    drawn = {"objects.0.count": {"values": [1, 2], "weights": [3, 1]}}
    with tuned_run(chromium, write_tiny_hit_uav, tmp_path, "hit-uav-drone", settings=drawn) as opened:
        page = opened.page
        page.get_by_label("category", exact=True).fill("roe deer")
        page.get_by_label("count 2, weight", exact=True).fill("")
        page.get_by_label("count 1, weight", exact=True).fill("")
        page.locator(".q-field--error", has_text="not all 0").first.wait_for()
        page.get_by_label("count 3, weight", exact=True).fill("2")
        page.get_by_role("combobox", name="model").click()
        page.wait_for_function("() => document.querySelectorAll('.q-menu .tune-model').length > 3")
        page.get_by_role("option", name="deer", exact=True).click()
        page.get_by_role("button", name="options of deer").click()
        page.get_by_role("combobox", name="pose").click()
        for pose in ("walking", "lying"):
            page.get_by_role("option", name=pose, exact=True).click()
        page.keyboard.press("Escape")
        page.get_by_label("weight of walking", exact=True).fill("3")
        page.get_by_role("button", name="temperatures of deer").click()
        page.get_by_label("belly, K, from", exact=True).fill("4")
        page.get_by_label("shoulder height m, from", exact=True).fill("90")
        page.locator(".q-field--error", has_text="90").first.wait_for()
        page.get_by_label("shoulder height m, from", exact=True).fill("")
        page.get_by_role("status").get_by_text("last valid recipe").wait_for(state="hidden")
        page.get_by_label("Output folder", exact=True).fill("made")
        page.get_by_label("Pictures at most, empty for all", exact=True).fill("1")
        page.get_by_role("button", name="Save and generate").click()
        page.get_by_text("Done. Review it with").wait_for()
        assert serious_issues(page) == []
        assert opened.errors == []
    saved = (tmp_path / "hit-uav-drone-tuned.yaml").read_text()
    (kind,) = load_recipe(tmp_path / "hit-uav-drone-tuned.yaml").objects
    assert (kind.model, kind.category) == ("deer", "roe deer"), saved
    assert kind.count.model_dump(include={"values", "weights"}) == {"values": (3,), "weights": (2.0,)}
    assert kind.options == {"pose": {"walking": 3.0, "lying": 1.0}}
    assert kind.parts["belly"].delta_t_k == (4.0, 4.0)
    assert (tmp_path / "made/run.json").is_file()


def test_a_path_is_drawn_on_the_picture(chromium: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> None:
    with tuned_run(chromium, write_tiny_hit_uav, tmp_path, "hit-uav-drone-physical") as opened:
        page = opened.page
        page.get_by_role("combobox", name="Path").click()
        page.get_by_role("option", name="objects 0", exact=True).click()
        box = page.locator(".stage-paint").bounding_box()
        for number, share in enumerate((0.25, 0.5, 0.75), 1):
            page.mouse.click(box["x"] + share * box["width"], box["y"] + box["height"] / 4)
            page.locator(".stage-point").nth(number - 1).wait_for()

        def path() -> list[dict[str, float]]:
            return list((json.loads(page.get_by_label("motion", exact=True).input_value()) or {})["path"])

        wait_for_value(page, "motion", re.compile(r"(time_s.*){3}"))
        assert [p["time_s"] for p in path()] == [0, 1, 2]
        assert [p["x_px"] for p in path()] == pytest.approx([160, 320, 480], abs=1)
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + box["height"] / 4)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + box["height"] / 2)
        page.mouse.up()
        wait_for_value(page, "motion", re.compile(r'"y_px": 25[4-8]'))  # the inputs below are those of the moved point
        page.get_by_label("point 2, time, s", exact=True).fill("1.5")
        wait_for_value(page, "motion", re.compile(r'"time_s": 1\.5'))
        page.get_by_label("point 1, distance, m", exact=True).fill("60")
        wait_for_value(page, "motion", re.compile(r'"range_m": 60'))
        page.locator(".stage-point").nth(2).press("Delete")
        page.locator(".stage-point").nth(2).wait_for(state="detached")
        wait_for_value(page, "motion", re.compile(r"^((?!time_s).)*(time_s((?!time_s).)*){2}$"))
        first, second = path()
        assert first["range_m"] == 60 and second["time_s"] == 1.5
        assert second["y_px"] == pytest.approx(256, abs=2)
        assert serious_issues(page) == []
        assert opened.errors == []


def test_a_mask_is_painted_over_a_map(chromium: str, write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> None:
    with tuned_run(chromium, write_tiny_hit_uav, tmp_path, "hit-uav-person") as opened:
        page = opened.page
        for label, option in (("Map", "Surfaces"), ("Brush", "Not allowed"), ("Pen", "64 px")):
            page.get_by_role("combobox", name=label).click()
            page.get_by_role("option", name=option, exact=True).click()
        page.locator(".tune-legend").get_by_text("%").first.wait_for()
        assert serious_issues(page) == []

        def paint() -> None:
            box = page.locator(".stage-paint").bounding_box()
            page.mouse.move(box["x"] + box["width"] / 4, box["y"] + box["height"] / 2)
            page.mouse.down()
            page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
            page.mouse.up()

        before = page.get_attribute("img.picture", "src")
        paint()
        page.wait_for_function("s => document.querySelector('img.picture').getAttribute('src') != s", arg=before)
        (mask,) = (tmp_path / "data.places").rglob("*.png")
        pixels = cv2.imread(str(mask), cv2.IMREAD_UNCHANGED)
        assert not pixels[256, 160:320].any() and pixels[[200, 312]].all()
        wait_for_value(page, "where", re.compile(r"data\.places"))
        shutil.rmtree(tmp_path / "data.places")
        (tmp_path / "data.places").write_text("a file")
        paint()
        page.get_by_role("alert").get_by_text("data.places").first.wait_for()
        assert opened.errors == []
