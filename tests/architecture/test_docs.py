"""The documentation says what the code does: links, commands, fields, functions, notebook."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
NOTEBOOK = ROOT / "docs" / "tutorials" / "quickstart.ipynb"


def page_id(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path, language: str) -> list[str]:
    """Fenced code blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text("utf-8"), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_links_inside_the_repository_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text("utf-8"))
    broken = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert broken == []


def test_every_page_is_reachable_from_the_index() -> None:
    seen: set[Path] = set()
    queue = [ROOT / "README.md"]
    while queue:
        page = queue.pop()
        if page in seen or page.suffix != ".md" or not page.exists():
            continue
        seen.add(page)
        for link in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text("utf-8")):
            if "://" not in link:
                target = (page.parent / link).resolve()
                # A link to a folder is a link to what lies in it.
                queue += sorted(target.glob("*.md")) if target.is_dir() else [target]
    assert [page_id(p) for p in PAGES if p not in seen and p.parent != ROOT] == []


def commands() -> list[tuple[str, list[str]]]:
    """(page, words) of every `infrablend ...` line in the pages' shell blocks."""
    found = []
    for page in PAGES:
        for block in blocks(page, "bash"):
            for line in block.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                for i, word in enumerate(words):
                    if word.rsplit("/", 1)[-1] == "infrablend":
                        found.append((page_id(page), words[i + 1 :]))
    return found


def test_commands_in_the_docs_exist_with_these_options() -> None:
    import click
    from typer.main import get_command

    from infrablend.cli.app import build_app

    assert len(commands()) > 5
    wrong = []
    for page, words in commands():
        command: click.Command = get_command(build_app())
        rest = list(words)
        known: set[str] = set()
        while True:
            known |= {o for p in command.params for o in (*p.opts, *p.secondary_opts)}
            while rest and rest[0].startswith("-"):
                known_here = rest.pop(0)
                if known_here not in known:
                    wrong.append(f"{page}: {known_here}")
            if not hasattr(command, "commands"):
                break
            if not rest or rest[0] not in command.commands:
                wrong.append(f"{page}: infrablend {' '.join(words)}")
                break
            command = command.commands[rest.pop(0)]
        wrong += [f"{page}: {w}" for w in rest if w.startswith("--") and w.split("=")[0] not in known]
    assert wrong == []


def test_settings_in_the_docs_are_recipe_fields() -> None:
    from infrablend.config.loading import load_recipe
    from infrablend.training.presets import Preset

    of_trainer = {f.name for f in fields(Preset)}  # `infrablend train --set`
    commands = []
    for page in PAGES:
        for line in page.read_text("utf-8").replace("\\\n", " ").splitlines():
            found = re.findall(r"--set ('[^']*'|[^\s`']+(?:'[^']*')?)", line)
            words = [shlex.split(text)[0] for text in found]
            commands.append([w for w in words if w != "KEY=VALUE" and w.split("=")[0] not in of_trainer])
    assert sum(map(len, commands)) > 5
    for settings in commands:
        load_recipe("hit-uav-drone", settings)


def test_fields_that_the_docs_name_exist() -> None:
    reference = (ROOT / "docs" / "reference" / "recipe.md").read_text("utf-8")
    for page in PAGES:
        for section, field in re.findall(
            r"`(camera|placement|matching|overlay|render|labels|output)\.([a-z_]+)", page.read_text("utf-8")
        ):
            assert f"`{section}.{field}" in reference, page_id(page)


def test_the_python_page_names_what_the_api_offers() -> None:
    from infrablend import api

    text = (ROOT / "docs" / "reference" / "python_api.md").read_text("utf-8")
    table = [line for line in text.splitlines() if line.startswith("| `")]
    named = set(re.findall(r"`(\w+)\(", "\n".join(table)))
    offered = {name for name in api.__all__ if name[0].islower()}
    assert named == offered
    functions = {n for n, f in vars(api).items() if getattr(f, "__module__", "") == api.__name__ and callable(f)}
    assert {n for n in functions if n[0].islower() and not n.startswith("default_")} == offered
    for block in blocks(ROOT / "docs" / "reference" / "python_api.md", "python"):
        compile(block, "python_api.md", "exec")


def test_the_reference_pages_are_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "write_reference.py", "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_the_model_description_in_the_docs_is_valid() -> None:
    from infrablend.assets.user_model import UserModel

    first, _ = blocks(ROOT / "docs" / "how_to" / "own_model.md", "yaml")
    model = UserModel.model_validate_json(json.dumps(yaml.safe_load(first)))
    assert set(model.parts) == {"body", "eyes", "base"}


def test_the_citation_names_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["cff-version"] == "1.2.0"
    paper = citation["preferred-citation"]
    assert paper["title"] == "Unlocking Thermal Aerial Imaging: Synthetic Enhancement of UAV Datasets"
    assert [a["family-names"] for a in paper["authors"]] == ["Barisic Kulas", "Jurasovic", "Bogdan"]
    from infrablend import __version__

    assert citation["version"] == __version__


def notebook_code() -> str:
    cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
    return "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")


def test_the_notebook_is_stored_without_outputs() -> None:
    for cell in json.loads(NOTEBOOK.read_text("utf-8"))["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


@pytest.mark.blender
@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", notebook_code()], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "build" / "quickstart" / "contact_sheet.png").stat().st_size > 1000
    assert "complete True" in done.stdout
