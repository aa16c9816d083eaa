"""The documentation as a site: a strict build finds broken links and anchors, and pages outside the navigation."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def site(mkdocs: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the site; building it gives no warning."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stderr
    return folder


@pytest.mark.slow
def test_every_page_is_in_the_site(site: Path) -> None:
    pages = {p.relative_to(ROOT / "docs").with_suffix(".html") for p in (ROOT / "docs").rglob("*.md")}
    assert sorted(p for p in pages if not (site / p).is_file()) == []
    assert (site / "tutorials" / "quickstart.html").is_file()


@pytest.mark.slow
def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
    loaded = re.compile(
        r"<(?:script|img|iframe)\b[^>]*\bsrc=\"?(?:https?:)?//[^\s>]+|<link\b[^>]*href=\"?https?://[^\s>]+"
    )
    outside = {p.name: found for p in site.rglob("*.html") if (found := loaded.findall(p.read_text("utf-8")))}
    assert outside == {}


@pytest.mark.slow
def test_links_out_of_the_docs_name_what_they_lead_to(site: Path) -> None:
    """While the address of the repository is unknown; with it they are links."""
    text = (site / "index.html").read_text("utf-8")
    assert "<code>CONTRIBUTING.md</code> in the repository" in text or "/blob/main/CONTRIBUTING.md" in text


@pytest.mark.slow
def test_the_python_pages_show_signatures_and_docstrings(site: Path) -> None:
    text = re.sub(r"<[^>]+>", "", (site / "reference" / "python" / "runs.html").read_text("utf-8"))
    assert "Insert rendered objects into a dataset" in text
    assert "on_progress: OnProgress | None = None" in re.sub(r"\s+", " ", text)
