"""The page on the architecture says how a command becomes files: each function that it names calls those below it."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "infrablend"
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
HEADING = "## From the command to the file"


def steps() -> list[tuple[int, str]]:
    """Depth and place of each line of the list after the heading: `package.module.function`."""
    section = PAGE.read_text("utf-8").partition(f"\n{HEADING}\n")[2].partition("\n## ")[0]
    return [(len(indent), place) for indent, place in re.findall(r"^( *)\* `([\w.]+)`", section, re.MULTILINE)]


def calls() -> Iterator[tuple[str, str]]:
    """Each step with the one that it is called by: the nearest line above that is less deep."""
    above: list[tuple[int, str]] = []
    for depth, place in steps():
        while above and above[-1][0] >= depth:
            above.pop()
        if above:
            yield above[-1][1], place
        above.append((depth, place))


def parts(place: str) -> tuple[ModuleType, list[str]]:
    """Module of a place, and the names in it, such as a class and its method."""
    words = place.split(".")
    files = [PACKAGE.joinpath(*words[:k]).with_suffix(".py") for k in range(1, len(words))]
    lengths = [k for k, file in enumerate(files, start=1) if file.is_file()]
    assert lengths, f"{place}: no such module"
    return importlib.import_module(".".join(("infrablend", *words[: lengths[0]]))), words[lengths[0] :]


def code_of(module: ModuleType, name: str) -> list[ast.AST]:
    """Definition with this name, and those of the module that it refers to, in whatever order."""
    tree = ast.parse(inspect.getsource(module))
    definitions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    assert name in definitions, f"{module.__name__} defines no {name}"
    found: dict[str, ast.AST] = {}
    wanted = [name]
    while wanted:
        one = wanted.pop()
        if one not in found:
            found[one] = definitions[one]
            wanted += [n.id for n in ast.walk(definitions[one]) if isinstance(n, ast.Name) and n.id in definitions]
    return list(found.values())


def value_of(module: ModuleType, node: ast.AST) -> object:
    """What a name, or a chain of names, stands for in a module; None for what is not known before the program runs."""
    if isinstance(node, ast.Name):
        return getattr(module, node.id, None)
    if isinstance(node, ast.Attribute) and (owner := value_of(module, node.value)) is not None:
        return getattr(owner, node.attr, None)
    return None


def test_the_page_leads_from_the_command_to_the_files_in_ten_lines() -> None:
    found = steps()
    assert len(found) == 10
    assert found[0] == (0, "cli.run_commands.generate") and found[-1][1] == "formats.writing.write"
    assert len(list(calls())) == len(found) - 1, "every line but the first is called by one above it"


@pytest.mark.parametrize(("caller", "called"), list(calls()))
def test_each_step_calls_those_below_it(caller: str, called: str) -> None:
    module, (name, *_) = parts(caller)
    target_module, (target_name, *method) = parts(called)
    target = getattr(target_module, target_name)
    known = (target, f"{target_module.__name__}:{target_name}")  # workers get the name of what makes frames
    nodes = [node for code in code_of(module, name) for node in ast.walk(code)]
    assert any(value_of(module, node) in known for node in nodes if isinstance(node, ast.Name | ast.Attribute)), (
        f"{caller} does not refer to {called}: bring the page up to date ({HEADING})"
    )
    for attribute in method:
        assert callable(getattr(target, attribute))
        assert any(isinstance(n, ast.Call) and getattr(n.func, "attr", "") == attribute for n in nodes)
