"""Writes docs/reference/{recipe,cli,formats}.md from the code, so that they cannot drift from it.

`write_reference.py` writes them; with `--check` it only says whether they are up to date (exit code 1 if not).
"""

from __future__ import annotations

import sys
import types
import typing
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from pydantic import BaseModel
from pydantic.fields import FieldInfo

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "docs" / "reference"


def recipe_page() -> str:
    """The page on all recipe fields."""
    from infrablend.config import loading
    from infrablend.config.recipe import Recipe

    lines = [
        "# Recipe fields",
        "",
        "Written from `src/infrablend/config/recipe.py` by `make reference`: change the code, not this page.",
        "",
        "A recipe is a YAML file. Unknown keys and bad values are errors; all of them are reported at once, each with",
        "its field. Any field can be set from the command line: `--set camera.distance_m='[2, 8]'`,",
        "`--set objects.0.count=3`, `--set output.image=png`. A range is `[low, high]`; a number alone means that",
        "number. Draws are uniform unless the field says otherwise. Degrees and °C are used here and in the command",
        "line only; run folders and scene files hold radians and kelvin.",
        "",
        "Shipped recipes (`infrablend recipes list`, `infrablend recipes show NAME`):",
        "",
    ]
    for name in loading.list_recipes():
        lines.append(f"* `{name}`: {loading.load_recipe(name).description}")
    lines.append("")
    queue: list[tuple[str, type[BaseModel]]] = [("", Recipe)]
    done: set[type[BaseModel]] = set()
    while queue:
        prefix, model = queue.pop(0)
        if model in done:
            continue
        done.add(model)
        title = f"`{prefix.rstrip('.')}`: {model.__name__}" if prefix else "Top level"
        lines += [
            f"## {title}",
            "",
            _first(model.__doc__),
            "",
            "| field | values | default | meaning |",
            "|---|---|---|---|",
        ]
        for name, field in model.model_fields.items():
            inner = list(_models(field.annotation))
            values = _type_text(field.annotation, list(field.metadata))
            lines.append(f"| `{prefix}{name}` | {values} | {_default(field)} | {_cell(field.description or '')} |")
            listed = "tuple" in str(field.annotation)
            for m in inner:
                queue.append(
                    (f"{prefix}{name}.{'N.' if listed else '<part>.' if 'dict' in str(field.annotation) else ''}", m)
                )
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _first(doc: str | None) -> str:
    return " ".join((doc or "").strip().split("\n\n")[0].split())


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _models(annotation: Any) -> typing.Iterator[type[BaseModel]]:
    """Models inside an annotation, in order."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in typing.get_args(annotation):
        yield from _models(inner)


def _bounds(metadata: list[Any]) -> str:
    """Text of the limits that pydantic's metadata holds, e.g. `0 to 1`."""
    found: dict[str, Any] = {}
    for item in metadata:
        if isinstance(item, FieldInfo):
            metadata = metadata + list(item.metadata)
    for item in metadata:
        for key in ("ge", "gt", "le", "lt"):
            if (value := getattr(item, key, None)) is not None:
                found[key] = value
    low = f"{found['ge']:g}" if "ge" in found else f"above {found['gt']:g}" if "gt" in found else ""
    high = f"{found['le']:g}" if "le" in found else f"below {found['lt']:g}" if "lt" in found else ""
    return f"{low} to {high}" if low and high else f"at least {low}" if low else f"at most {high}" if high else ""


def _type_text(annotation: Any, metadata: list[Any]) -> str:
    """Words for an annotation: allowed words, numbers with limits, ranges, nested tables."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        return _type_text(arguments[0], [*metadata, *arguments[1:]])
    if origin is Literal:
        return " \\| ".join(f"`{a}`" for a in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join("nothing" if a is type(None) else _type_text(a, metadata) for a in arguments)
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is not Ellipsis:
            return f"range, {limits}" if (limits := _bounds(_end_metadata(arguments[0]))) else "pair"
        return f"list of {_type_text(arguments[0], [])}"
    if origin is dict:
        return f"mapping of {_type_text(arguments[0], [])} to {_type_text(arguments[1], [])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"{annotation.__name__} (below)"
    words = {int: "whole number", float: "number", str: "text", bool: "true or false"}.get(annotation, "any")
    limits = _bounds(metadata)
    return f"{words}, {limits}" if limits else words


def _end_metadata(annotation: Any) -> list[Any]:
    return list(typing.get_args(annotation)[1:]) if typing.get_origin(annotation) is Annotated else []


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, BaseModel):
        return "see below"
    if value is None:
        return "none"
    if isinstance(value, tuple):
        return "`[" + ", ".join(f"{v:g}" if isinstance(v, int | float) else str(v) for v in value) + "]`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`" if value not in ("", {}) else "empty"


def cli_page() -> str:
    """The page on all commands, from their own help."""
    from typer.main import get_command

    from infrablend.cli import exits
    from infrablend.cli.app import build_app

    lines = [
        "# Command line",
        "",
        "Written from the commands' own help by `make reference`: change the code, not this page.",
        "",
        "Results go to standard output, progress, warnings and errors to standard error.",
        "",
        "Exit codes:",
        "",
        "```text",
        *(exits.__doc__ or "").strip().split("\n\n", 1)[-1].splitlines(),
        "```",
        "",
    ]

    def add(command: Any, path: str, parent: Any) -> None:
        context = command.make_context(
            path.rsplit(" ", 1)[-1],
            [],
            parent=parent,
            resilient_parsing=True,
            max_content_width=100,
            terminal_width=100,
        )
        lines.extend([f"## `{path}`", "", "```text", command.get_help(context).rstrip(), "```", ""])
        if hasattr(command, "commands"):
            for name in command.commands:
                add(command.commands[name], f"{path} {name}", context)

    add(get_command(build_app()), "infrablend", None)
    return "\n".join(line.rstrip() for line in "\n".join(lines).splitlines()).rstrip() + "\n"


def formats_page() -> str:
    """The page on what every format holds."""
    from infrablend.core.format_table import FIELDS, FORMATS, NATIVE, WRITERS
    from infrablend.formats.detection import reader_options
    from infrablend.formats.losses import LOSSES

    lines = [
        "# Formats",
        "",
        "Written from `src/infrablend/core/format_table.py` by `make reference`: change the code, not this page. Every",
        "format has a page of its own in [docs/formats](../formats/).",
        "",
        "## Read",
        "",
        "In the order in which they are tried on a folder; `--read KEY=VALUE` sets an option.",
        "",
        "| format | what | options |",
        "|---|---|---|",
    ]
    for f in FORMATS:
        options = ", ".join(f"`{k}`" for k in reader_options(f))
        lines.append(f"| [`{f.name}`](../formats/{f.page}) | {_cell(f.title)} | {options} |")
    lines += [
        "",
        "## Written",
        "",
        f"`infrablend convert --to NAME`, `infrablend generate --format NAME,...`, `output.formats`; `{NATIVE}` is the",
        "format of the input. What a format does not hold is counted when it is written, under the name given in the",
        "table: in `run.json` as `<format>.<loss>`, in `convert.json` and on the screen.",
        "",
        "| format | what |",
        "|---|---|",
        *(f"| [`{w.name}`](../formats/{w.page}) | {_cell(w.title)} |" for w in WRITERS),
        "",
        "| | " + " | ".join(f"`{w.name}`" for w in WRITERS) + " |",
        "|---" * (len(WRITERS) + 1) + "|",
    ]
    for field, (words, loss) in FIELDS.items():
        cells = (
            "lost" if field in w.lacks else "table" if field == "telemetry" and w.table else "held" for w in WRITERS
        )
        lines.append(f"| {words} (`{loss}`) | " + " | ".join(cells) + " |")
    lines += [
        "",
        "`table`: in a `metadata.csv` beside the labels, unless the picture's name says it. HIT-UAV's two forms are",
        "taken together: what one of them does not hold is counted for it, `normal_json.obb_dropped`.",
        "",
        "## Losses",
        "",
        "| kind | meaning |",
        "|---|---|",
        *(f"| `{kind}` | {_cell(text)} |" for kind, text in LOSSES.items()),
    ]
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> int:
    """Write or check the pages."""
    pages = {"recipe.md": recipe_page(), "cli.md": cli_page(), "formats.md": formats_page()}
    stale = [n for n, text in pages.items() if not (f := REFERENCE / n).is_file() or f.read_text("utf-8") != text]
    if arguments == ["--check"]:
        if stale:
            print(f"docs/reference: {', '.join(stale)} out of date; run `make reference`", file=sys.stderr)
        return int(bool(stale))
    REFERENCE.mkdir(parents=True, exist_ok=True)
    for name, text in pages.items():
        (REFERENCE / name).write_text(text, "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
