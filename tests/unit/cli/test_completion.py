"""Shell completion of names, and the one scheme of options for formats."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import typer

from infrablend.assets.catalogue import list_models
from infrablend.cli.app import build_app
from infrablend.config.loading import list_recipes
from infrablend.core.format_table import FORMATS, NATIVE, written_names
from infrablend.formats.published.sources import SOURCES
from infrablend.lab.experiments.definition import list_experiments

# Completes lines as the shell does for the tab key, then refuses if that loaded something heavy (Typer itself loads
# pydantic).
PROGRAM = """
import contextlib, io, json, os, sys
from infrablend.cli import main
for line in json.loads(sys.argv[1]):
    os.environ |= {"COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1)}
    with contextlib.redirect_stdout(io.StringIO()) as offered:
        assert main([]) == 0
    print(json.dumps(offered.getvalue().split()))
heavy = {"numpy", "infrablend.config", "cv2", "PIL", "bpy", "torch", "ruamel.yaml"} & set(sys.modules)
sys.exit(f"loaded {sorted(heavy)}" if heavy else 0)
"""


def complete(folder: Path, *lines: str) -> list[list[str]]:
    """Return what bash would offer for the last word of each line."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "_INFRABLEND_COMPLETE": "complete_bash"}
    words = [sys.executable, "-c", PROGRAM, json.dumps(lines)]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_names_are_completed_without_loading_a_heavy_library(tmp_path: Path) -> None:
    offered = {
        "generate ": list_recipes(),
        "recipes show monet": [r for r in list_recipes() if r.startswith("monet")],
        "experiment ": list_experiments(),
        "models show ": list_models(),
        "models describe d": [m for m in list_models() if m.startswith("d")],
        "fetch ": [s.name for s in SOURCES],
        "check data --format ": sorted(f.name for f in FORMATS),
        "convert a b --to ": [*sorted(written_names()), NATIVE],
        "generate r --to coco,yolo-": ["coco,yolo-obb", "coco,yolo-seg"],
    }
    assert complete(tmp_path, *(f"infrablend {line}" for line in offered)) == list(offered.values())


def test_own_files_are_completed_beside_shipped_names(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    for name in ("hit-mine.yaml", "hit.txt", "mine/one.yml"):
        (tmp_path / name).touch()
    lines = ("infrablend generate hit", "infrablend generate mi", "infrablend models show mine/")
    recipes = [r for r in list_recipes() if r.startswith("hit")]
    assert complete(tmp_path, *lines) == [[*recipes, "hit-mine.yaml"], ["mine/"], ["mine/one.yml"]]


def test_every_command_reads_with_format_and_writes_with_to() -> None:
    """`--format` names what is read, `--to` what is written, in every command."""
    commands = typer.main.get_command(build_app()).commands  # type: ignore[attr-defined]
    options = {
        name: {o: p.help for p in command.make_context(name, [], resilient_parsing=True).command.params for o in p.opts}
        for name, command in commands.items()
        if not hasattr(command, "commands")
    }
    reads = {name for name, of in options.items() if "--read" in of}
    assert {name for name, of in options.items() if "--format" in of} == reads >= {"generate", "convert", "train"}
    assert {of["--format"] for of in options.values() if "--format" in of} == {
        "Format of the dataset to read [default: detected]."
    }
    assert {name for name, of in options.items() if "--to" in of} == {"generate", "convert", "split"}
    assert not any("format" in o for of in options.values() for o in set(of) - {"--format"})
