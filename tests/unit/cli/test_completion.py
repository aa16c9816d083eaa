"""Shell completion of names, and the one scheme of options for formats."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from infrablend.assets.catalogue import list_models
from infrablend.cli.app import build_app
from infrablend.config.experiment import list_experiments
from infrablend.config.loading import list_recipes
from infrablend.core.format_table import FORMATS, NATIVE, written_names
from infrablend.formats.sources import SOURCES

# Runs the program as the shell does for the tab key, then refuses if that loaded something heavy (Typer itself loads
# pydantic).
PROGRAM = """
import sys
from infrablend.cli import main
code = main([])
heavy = {"numpy", "infrablend.config", "cv2", "PIL", "bpy", "torch", "ruamel.yaml"} & set(sys.modules)
sys.exit(f"loaded {sorted(heavy)}" if heavy else code)
"""


def complete(line: str, folder: Path) -> list[str]:
    """Return what bash would offer for the last word of `line`."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(sys.path),
            "_INFRABLEND_COMPLETE": "complete_bash",
            "COMP_WORDS": line,
            "COMP_CWORD": str(len(line.split(" ")) - 1),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("infrablend generate ", list_recipes()),
        ("infrablend recipes show monet", [r for r in list_recipes() if r.startswith("monet")]),
        ("infrablend experiment ", list_experiments()),
        ("infrablend models show ", list_models()),
        ("infrablend models describe d", [m for m in list_models() if m.startswith("d")]),
        ("infrablend fetch ", [s.name for s in SOURCES]),
        ("infrablend check data --format ", sorted(f.name for f in FORMATS)),
        ("infrablend convert a b --to ", [*sorted(written_names()), NATIVE]),
        ("infrablend generate r --to coco,yolo-", ["coco,yolo-obb", "coco,yolo-seg"]),
    ],
)
def test_names_are_completed_without_loading_a_heavy_library(line: str, names: list[str], tmp_path: Path) -> None:
    assert complete(line, tmp_path) == names


def test_own_files_are_completed_beside_shipped_names(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    for name in ("hit-mine.yaml", "hit.txt", "mine/one.yml"):
        (tmp_path / name).touch()
    offered = complete("infrablend generate hit", tmp_path)
    assert offered == [*(r for r in list_recipes() if r.startswith("hit")), "hit-mine.yaml"]
    assert complete("infrablend generate mi", tmp_path) == ["mine/"]
    assert complete("infrablend models show mine/", tmp_path) == ["mine/one.yml"]


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
    assert {name for name, of in options.items() if "--to" in of} == {"generate", "convert", "split", "submit"}
    assert not any("format" in o for of in options.values() for o in set(of) - {"--format"})
