"""The documentation agrees with the code: links, commands, fields, functions, layers, dependencies, notebook."""

from __future__ import annotations

import ast
import functools
import inspect
import json
import os
import pkgutil
import re
import shlex
import subprocess
import sys
import tomllib
import typing
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
ROOT_PAGES = sorted(ROOT.glob("*.md"))
"""Pages beside those of the site, whose links and anchors its strict build checks (test_site.py)."""
PAGES = sorted([*ROOT_PAGES, *(ROOT / "docs").rglob("*.md")])
SOURCES = sorted((ROOT / "src" / "infrablend").rglob("*.py"))
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
NOTEBOOK = ROOT / "docs" / "tutorials" / "quickstart.ipynb"


def page_id(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path, language: str) -> list[str]:
    """Fenced code blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text("utf-8"), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", ROOT_PAGES, ids=page_id)
def test_links_inside_the_repository_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text("utf-8"))
    broken = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert broken == []


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as repository hosts derive them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S), re.M)
    plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", h).lower() for h in headings]
    return {re.sub(r"[^\w\- ]", "", h).strip().replace(" ", "-") for h in plain}


@pytest.mark.parametrize("page", ROOT_PAGES, ids=page_id)
def test_links_to_headings_lead_to_one(page: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", page.read_text("utf-8"))
    targets = [(page.parent / link if link else page, anchor) for link, anchor in links if "://" not in link]
    assert [a for target, a in targets if target.suffix == ".md" and a not in anchors(target)] == []


def test_pages_that_code_and_commands_name_exist() -> None:
    files = [*SOURCES, *(ROOT / "src").rglob("*.yaml"), *(ROOT / "scripts").iterdir(), *(ROOT / "bench").iterdir()]
    files += [ROOT / "Makefile", *(ROOT / "examples").rglob("*.py"), *PAGES]
    named = {
        (page_id(path), name)
        for path in files
        if path.is_file()
        for name in re.findall(r"(?<![\w/])docs/[\w./-]*\w", path.read_bytes().decode("utf-8", "ignore"))
    }
    assert len(named) > 10
    assert sorted(f"{where}: {name}" for where, name in named if not (ROOT / name).exists()) == []


def test_pages_that_docstrings_and_comments_name_exist() -> None:
    pages = {path.name for path in PAGES}
    for path in SOURCES:
        named = set(re.findall(r"(?<![\w/.<-])([a-z][a-z_0-9]+\.md)\b", path.read_text("utf-8")))
        assert sorted(named - pages - {"readme.md"}) == [], page_id(path)


def table_rows(page: Path, heading: str) -> list[list[str]]:
    """Cells of the rows of the first table after a heading."""
    text = page.read_text("utf-8").partition(f"\n{heading}\n")[2]
    assert text, f"{page_id(page)} has no heading {heading}"
    lines = re.search(r"(?:^\|.*\n?)+", text, re.MULTILINE)
    assert lines, f"{page_id(page)}: no table after {heading}"
    return [[c.strip() for c in line.strip("|").split("|")] for line in lines.group().splitlines()[2:]]


@pytest.mark.parametrize(
    ("container", "heading"),
    [("infrablend", "## Layers"), ("infrablend.pipeline", "### Packages of the pipeline")],
)
def test_the_table_of_layers_is_the_import_contract(container: str, heading: str) -> None:
    contracts = PYPROJECT["tool"]["importlinter"]["contracts"]
    (contract,) = [c for c in contracts if c.get("containers") == [container]]
    layers = [set(re.findall(r"\w+", layer)) for layer in contract["layers"]]
    rows = table_rows(ROOT / "docs" / "explanation" / "architecture.md", heading)
    documented = [set(re.findall(r"`(\w+)`", row[0])) for row in rows]
    assert documented == [layer for layer in layers if layer != {"__main__"}]


def test_the_contract_on_blender_names_every_other_package() -> None:
    (contract,) = [c for c in PYPROJECT["tool"]["importlinter"]["contracts"] if "bpy" in c.get("forbidden_modules", ())]
    package = ROOT / "src" / "infrablend"
    rooms = {p.stem for p in package.iterdir() if p.suffix == ".py" or (p / "__init__.py").is_file()}
    assert {m.removeprefix("infrablend.") for m in contract["source_modules"]} == rooms - {
        "__init__", "__main__", "blender"
    }  # fmt: skip


def required(requirements: list[str]) -> set[str]:
    return {re.split(r"[<>=!~\[; ]", text)[0].lower() for text in requirements}


def test_the_page_on_dependencies_lists_those_of_the_project() -> None:
    page = ROOT / "docs" / "explanation" / "dependencies.md"
    project = PYPROJECT["project"]

    def listed(heading: str, column: int) -> set[str]:
        return {name.lower() for row in table_rows(page, heading) for name in re.findall(r"`([^`]+)`", row[column])}

    assert listed("## At run time", 0) == required(project["dependencies"])
    assert listed("## Extras", 0) == set(project["optional-dependencies"])
    for row in table_rows(page, "## Extras"):
        (extra,), packages = (re.findall(r"`([^`]+)`", cell.partition(", with ")[0]) for cell in row[:2])
        assert required(project["optional-dependencies"][extra]) == set(packages)
    development = page.read_text("utf-8").partition("## For development\n")[2].partition("\n## ")[0]
    named = {name.lower() for name in re.findall(r"`([^`]+)`", development.partition("; ")[0])}
    assert named == required(PYPROJECT["dependency-groups"]["dev"])


@functools.cache
def attributes_read() -> dict[str, set[str]]:
    """Names of the attributes that each module of the package reads, by the module's path in it."""
    return {
        path.relative_to(ROOT / "src" / "infrablend").as_posix(): {
            node.attr
            for node in ast.walk(ast.parse(path.read_text("utf-8")))
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)
        }
        for path in SOURCES
    }


def test_every_field_of_a_recipe_is_read() -> None:
    """A field that no code reads has no effect."""
    from pydantic import BaseModel

    from infrablend.config.recipe import Recipe

    found: set[str] = set()

    def collect(kind: object, path: str) -> None:
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            for name, field in kind.model_fields.items():
                found.add(f"{path}.{name}".removeprefix("."))
                collect(field.annotation, f"{path}.{name}")
        for part in typing.get_args(kind):
            collect(part, path)

    collect(Recipe, "")
    assert len(found) > 100
    read = set().union(*attributes_read().values())
    assert sorted(field for field in found if field.rpartition(".")[2] not in read) == []


def test_every_fact_of_a_scene_is_read() -> None:
    """What a scene stores of weather, look, camera and objects has an effect on its picture."""
    from infrablend.core import camera, scene

    # `sampling` draws them.
    elsewhere = (n for m, n in attributes_read().items() if m != "core/scene.py" and not m.startswith("sampling/"))
    read = set().union(*elsewhere)
    for kind in (scene.Weather, scene.Appearance, scene.PartState, scene.ObjectSpec, camera.CameraSpec):
        assert [f.name for f in fields(kind) if f.name not in read] == [], kind.__name__


def test_the_reasons_of_removal_are_those_that_occur() -> None:
    from infrablend.annotation import merge_labels
    from infrablend.pipeline.runs.run_card import REMOVAL_TEXTS

    tree = ast.parse(Path(merge_labels.__file__).read_text("utf-8"))
    reasons = set(typing.get_args(merge_labels.RemovalReason))
    # The literal itself is an assignment at the top of the module: only what functions use occurs.
    used = {
        node.value
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        for node in ast.walk(function)
        if isinstance(node, ast.Constant) and node.value in reasons
    }
    assert used == reasons == set(REMOVAL_TEXTS)
    page = (ROOT / "docs" / "reference" / "run_folder.md").read_text("utf-8")
    for reason in reasons:
        assert f"`{reason}`" in page


def test_every_setting_of_merging_is_set_by_the_pipeline() -> None:
    """A setting that only tests set is a removal that cannot occur."""
    from infrablend.annotation.merge_labels import MergeSettings

    given: set[str] = set()
    for text in (path.read_text("utf-8") for path in SOURCES):
        for node in ast.walk(ast.parse(text)) if "MergeSettings(" in text else ():
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "MergeSettings":
                given |= {f.name for f, _ in zip(fields(MergeSettings), node.args, strict=False)}
                given |= {k.arg for k in node.keywords if k.arg}
    assert given == {f.name for f in fields(MergeSettings)}


def test_the_pages_agree_on_the_levels_of_a_run_per_split() -> None:
    """The levels are measured on the images that are read: all splits, or the one that `--split` names."""
    for name in ("how_to/cluster.md", "explanation/physical_look.md"):
        text = " ".join((ROOT / "docs" / name).read_text("utf-8").split())
        assert "measured on the splits that the run reads" in text, name
        assert "`--limit` does not change them" in text, name


def commands() -> list[tuple[str, list[str]]]:
    """(page, words) of every `infrablend ...` line in the pages' shell blocks."""
    found = []
    for page in PAGES:
        for block in blocks(page, "bash"):
            for line in block.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                for i, word in enumerate(words):
                    if word.rsplit("/", 1)[-1] == "infrablend" and "pip" not in words[:i]:
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
            command.make_context("infrablend", [], resilient_parsing=True)  # makes the options
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
    from infrablend.errors import RecipeError
    from infrablend.lab.training.presets import Preset

    of_trainer = {f.name for f in fields(Preset)}  # `infrablend train --set`
    commands = []
    for page in PAGES:
        for line in page.read_text("utf-8").replace("\\\n", " ").splitlines():
            if "infrablend experiment" in line:  # settings of trainings, some of them Ultralytics' own
                continue
            found = re.findall(r"--set ('[^']*'|[^\s`']+(?:'[^']*')?)", line)
            words = [shlex.split(text)[0] for text in found]
            settings = [w for w in words if w != "KEY=VALUE" and w.split("=")[0] not in of_trainer]
            if settings:
                commands.append(settings)
    assert sum(map(len, commands)) > 5
    for settings in commands:
        # A field may belong to a mode that only some recipes have.
        refusals = []
        for recipe in ("hit-uav-drone", "hit-uav-drone-physical"):
            try:
                load_recipe(recipe, settings)
            except RecipeError as error:
                refusals.append(error)
        assert len(refusals) < 2, refusals


def test_fields_that_the_docs_name_exist() -> None:
    from infrablend.config.modes import REMOVED, all_modes, fields_of

    existing = {f"{section}.{field}" for modes in all_modes() for section, field in fields_of(modes)}
    sections = "|".join(sorted({name.partition(".")[0] for name in existing}))
    # The changelog and the list of removed fields name them.
    gone = {*REMOVED}
    # Files, a field of `run.json`, and attributes of the frames of `api.frames`.
    others = {"data.yaml", "data.root", "frames.ids", "frames.json", "frames.problems", "labels.txt"}
    for page in PAGES:
        for name in re.findall(rf"`((?:{sections})\.[a-z_]+)(?=[`:= ])", page.read_text("utf-8")):
            assert name in existing | others or (name in gone and page.name in ("CHANGELOG.md", "recipe.md")), (
                page_id(page),
                name,
            )


def test_the_python_pages_name_what_the_package_offers() -> None:
    import infrablend
    from infrablend import api, errors

    pages = sorted((ROOT / "docs" / "reference" / "python").glob("*.md"))
    found = [n for page in pages for n in re.findall(r"^::: infrablend\.([\w.]+)$", page.read_text("utf-8"), re.M)]
    named = [n.rpartition(".")[2] for n in found]
    assert len(set(named)) == len(named)
    own_errors = {n for n, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, Exception)}
    assert set(named) == {*api.__all__, *infrablend.__all__, *own_errors, "InsertDataset"} - {"__version__"}
    modules = [import_module(f"{api.__name__}.{m.name}") for m in pkgutil.iter_modules(api.__path__)]
    functions = {n for m in modules for n, f in vars(m).items() if inspect.isfunction(f) and f.__module__ == m.__name__}
    assert {n for n in functions if not n.startswith("_")} <= set(api.__all__)
    for block in blocks(ROOT / "docs" / "reference" / "python" / "index.md", "python"):
        compile(block, "index.md", "exec")


def test_only_the_page_on_installation_installs_the_package() -> None:
    """Until it is in an index, every installation is from a clone, which one page describes."""
    command = re.compile(r"\b(?:pip|pipx|uv|conda) (?:pip )?(?:install|add|download) [^`&|;$]*(?<![\w/.])infrablend\b")
    found = {
        (page_id(page), line)
        for page in PAGES
        if page.name != "CHANGELOG.md"
        for line in page.read_text("utf-8").splitlines()
        if command.search(line)
    }
    # From wheels that were built in a clone.
    assert found == {("docs/how_to/install.md", "pip install --no-index -f wheels infrablend")}


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
    assert paper["year"] == 2025 and paper["identifiers"][0]["value"].endswith("arXiv.2507.06797")
    from infrablend import __version__

    assert citation["version"] == __version__


def test_badges_and_links_to_the_repository_wait_for_its_address() -> None:
    """`project.urls.Repository` is the one place that holds it; what cannot read it from there says the same."""
    address = PYPROJECT["project"]["urls"].get("Repository")
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8")).get("repository-code") == address
    badge = re.compile(r"shields\.io|badge\.svg|colab\.research\.google\.com/github|mybinder\.org")
    with_badges = [page_id(p) for p in [*PAGES, NOTEBOOK] if badge.search(p.read_text("utf-8"))]
    assert with_badges == [] or address, with_badges


def notebook_code() -> str:
    cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
    return "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")


def test_the_notebook_is_stored_without_outputs() -> None:
    for cell in json.loads(NOTEBOOK.read_text("utf-8"))["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


@pytest.mark.slow
def test_the_notebook_runs_without_blender(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", notebook_code()],
        cwd=tmp_path,
        env={**os.environ, "INFRABLEND_BLENDER": "none"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "build" / "quickstart" / "contact_sheet.png").stat().st_size > 1000
    assert "\nTrue\n" in done.stdout
