#!/usr/bin/env python
"""Prints the size and shape of the code: statements, files, names, records, long functions, import circles, docs.

    .venv/bin/python scripts/figures.py            the figures of this tree
    .venv/bin/python scripts/figures.py --list     also the places behind each figure
    .venv/bin/python scripts/figures.py --root DIR the figures of another checkout

A statement is a statement of Python's grammar. Docstrings and imports do not count, and an assignment of N names to N
values counts as N, so that neither explaining nor packing changes the figure. The core is everything but
`infrablend.lab`. A circle is a set of modules that import each other, counting imports inside functions and under
TYPE_CHECKING.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

LONG = 45
LAB = "lab/"
UNTYPED = re.compile(r"(?:dict|Dict|Mapping)\[str, Any\]")
# The package of the recipe classes. Looks and placements are taken from tables by the name of the mode.
RECIPES = "config/"


class Tree:
    """Parsed Python files below one folder."""

    def __init__(self, folder: Path) -> None:
        """Read all files."""
        paths = sorted(folder.rglob("*.py"))
        self.texts = {p.relative_to(folder).as_posix(): p.read_text(encoding="utf-8") for p in paths}
        self.modules = {name: ast.parse(text) for name, text in self.texts.items()}

    @property
    def lines(self) -> int:
        """Number of lines."""
        return sum(text.count("\n") for text in self.texts.values())

    def statements(self, *, core: bool = False) -> int:
        """Return the number of statements, of the core alone if that is asked for."""
        return sum(
            count_statements(tree.body) for name, tree in self.modules.items() if not (core and name.startswith(LAB))
        )

    def packages(self) -> list[str]:
        """Return the names of the packages directly below the folder."""
        return sorted({name.split("/")[0] for name in self.modules if "/" in name})

    def long_functions(self) -> list[str]:
        """Return the functions with more than `LONG` statements, longest first."""
        found = []
        for name, tree in self.modules.items():
            for node in ast.walk(tree):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    count = count_statements(node.body)
                    if count > LONG:
                        found.append((count, f"{name}:{node.lineno} {node.name}"))
        return [f"{place} ({count})" for count, place in sorted(found, reverse=True)]

    def packed(self) -> list[str]:
        """Return the assignments of several values to as many names."""
        return [
            f"{name}:{node.lineno} {ast.unparse(node)}"
            for name, tree in self.modules.items()
            for node in ast.walk(tree)
            if isinstance(node, ast.stmt) and values_assigned(node) > 1
        ]

    def shared_names(self) -> list[str]:
        """Return the files whose name another file has, too."""
        files = [name for name in self.modules if not name.endswith("__init__.py")]
        times = Counter(name.split("/")[-1] for name in files)
        return [name for name in files if times[name.split("/")[-1]] > 1]

    def untyped_records(self) -> list[str]:
        """Return the uses of mappings from text to anything as a type."""
        return [
            f"{name}:{number} {line.strip()}"
            for name, text in self.texts.items()
            for number, line in enumerate(text.splitlines(), 1)
            for _ in UNTYPED.findall(line)
        ]

    def unformatted(self) -> list[str]:
        """Return the places that the formatter leaves alone."""
        return [
            f"{name}:{number}"
            for name, text in self.texts.items()
            for number, line in enumerate(text.splitlines(), 1)
            if "# fmt: skip" in line
        ]

    def switches(self) -> list[str]:
        """Return the `isinstance` on recipe classes and the comparisons of `.mode` outside the recipe classes."""
        classes = {
            node.name
            for name, tree in self.modules.items()
            if name.startswith("config/")
            for node in tree.body
            if isinstance(node, ast.ClassDef)
        }
        found = []
        for name, tree in self.modules.items():
            if name.startswith(RECIPES):
                continue
            for node in ast.walk(tree):
                if _is_class_check(node, classes) or _is_mode_comparison(node):
                    found.append(f"{name}:{node.lineno} {ast.unparse(node)}")
        return found

    def circles(self, package: str) -> list[list[str]]:
        """Return the sets of modules that import each other."""
        names = {_module(package, path): path for path in self.modules}
        graph = {name: {*_imports(self.modules[path], name, path, names)} - {name} for name, path in names.items()}
        reach = {name: _reachable(graph, name) for name in graph}
        circles, seen = [], set()
        for name in sorted(graph):
            circle = [other for other in sorted(reach[name]) if name in reach[other]]
            if len(circle) > 1 and name not in seen:
                circles.append(circle)
                seen |= {*circle}
        return circles


def count_statements(body: Iterable[ast.stmt]) -> int:
    """Return the number of statements in a body, without docstrings and imports."""
    return sum(values_assigned(node) for top in body for node in ast.walk(top) if isinstance(node, ast.stmt))


def values_assigned(node: ast.stmt) -> int:
    """Return how often a statement counts: 0 for imports and docstrings, else 1, or as often as it assigns a value."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        return 0
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
        return 0
    if isinstance(node, ast.Assign):
        target = node.targets[0]
        value = node.value
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
            return len(value.elts)
    return 1


def _is_class_check(node: ast.AST, classes: set[str]) -> bool:
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "isinstance"):
        return False
    return any(isinstance(inner, ast.Name) and inner.id in classes for inner in ast.walk(node.args[1]))


def _is_mode_comparison(node: ast.AST) -> bool:
    if not isinstance(node, ast.Compare):
        return False
    sides = (node.left, *node.comparators)
    texts = [s.value for s in sides if isinstance(s, ast.Constant) and isinstance(s.value, str)]
    # Pictures have a mode, too: `L`, `RGB`.
    ours = texts and all(text.islower() for text in texts)
    return bool(ours) and any(isinstance(side, ast.Attribute) and side.attr == "mode" for side in sides)


def _module(package: str, path: str) -> str:
    parts = path.removesuffix(".py").split("/")
    return ".".join([package, *(parts[:-1] if parts[-1] == "__init__" else parts)])


def _imports(tree: ast.Module, module: str, path: str, names: dict[str, str]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".") if path.endswith("__init__.py") else module.split(".")[:-1]
                base = ".".join([*parts[: len(parts) - node.level + 1], *([base] if base else [])])
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                if inner in names:
                    yield inner
                elif base in names:
                    yield base


def _reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    found: set[str] = set()
    todo = [start]
    while todo:
        for other in graph[todo.pop()]:
            if other not in found:
                found.add(other)
                todo.append(other)
    return found


def docs_lines(root: Path) -> int:
    """Return the lines of hand-written documentation: without results and generated reference pages."""
    generated = {"docs/reference/recipe.md", "docs/reference/cli.md"}
    pages = [p for p in sorted((root / "docs").rglob("*.md")) if "results" not in p.relative_to(root / "docs").parts]
    return sum(p.read_text("utf-8").count("\n") for p in pages if p.relative_to(root).as_posix() not in generated)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[1])
    parser.add_argument("--list", action="store_true", help="print the places behind each figure")
    asked = parser.parse_args()
    source, tests = Tree(asked.root / "src" / "infrablend"), Tree(asked.root / "tests")
    places = {
        "packages": source.packages(),
        "files whose name another file has": source.shared_names(),
        "records without types": source.untyped_records(),
        "assignments of several values": source.packed(),
        "places left alone by the formatter": source.unformatted(),
        f"functions of more than {LONG} statements": source.long_functions(),
        "isinstance on recipe classes, comparisons of modes": source.switches(),
        "import circles": [", ".join(circle) for circle in source.circles("infrablend")],
    }
    figures = {
        "src: statements": source.statements(),
        "src: statements of the core": source.statements(core=True),
        "src: lines": source.lines,
        "src: files": len(source.modules),
        **{name: len(found) for name, found in places.items()},
        "tests: lines": tests.lines,
        "docs: hand-written lines": docs_lines(asked.root),
        "CHANGELOG.md: lines": (asked.root / "CHANGELOG.md").read_text("utf-8").count("\n"),
        "bench: scripts": len([*(asked.root / "bench").glob("*.py")]),
    }
    for name, value in figures.items():
        print(f"{value:8,}  {name}")
        for place in places.get(name, ()) if asked.list else ():
            print(f"          {place}")


if __name__ == "__main__":
    main()
