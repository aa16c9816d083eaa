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

from infrablend.core.validation_messages import models_in

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "docs" / "reference"
# Order of the sections on the page about recipes.
SECTIONS = (
    "data", "objects", "placement", "occlusion", "camera", "environment", "appearance", "matching", "overlay", "sensor",
    "render", "labels", "output", "frames",
)  # fmt: skip
# Index of the page about recipes: questions, and the fields that answer them.
QUESTIONS = (
    ("Which object is inserted, and what is its class called?", ("objects.N.model", "objects.N.category")),
    ("How many objects are in a frame?", ("objects.N.count", "empty_share", "configurations")),
    (
        "How large are they in the picture?",
        ("objects.N.size_px", "objects.N.range_m", "objects.N.scale", "placement.size_px"),
    ),
    ("How far away and how high is the camera?", ("camera.distance_m", "camera.altitude", "camera.calibrate")),
    ("From which angle are they seen?", ("camera.pitch", "camera.roll_deg", "objects.N.yaw_deg")),
    ("Which lens does the camera have?", ("camera.model", "camera.focal_length_mm", "camera.field_of_view")),
    ("Where in the picture do they stand?", ("placement.mode", "placement.where", "placement.ground")),
    ("Where may they not stand?", ("placement.clear_of_labels", "placement.clear_of_ignored", "placement.where.masks")),
    ("What if an object finds no place?", ("placement.attempts", "placement.on_miss")),
    ("How do I place an object by hand?", ("frames.ID.objects",)),
    ("Do they come in groups or rows?", ("objects.N.group", "objects.N.align")),
    ("Do they move through a sequence?", ("objects.N.motion", "sensor.motion_px")),
    ("Are they partly hidden?", ("occlusion.share", "occlusion.visible", "placement.min_visibility")),
    ("Which poses and kinds of a model are used?", ("objects.N.options",)),
    ("How warm are they?", ("objects.N.delta_t_k", "objects.N.parts", "environment.air_temperature_c")),
    ("Is it day or night, clear or overcast?", ("environment.time_of_day", "environment.clear_share")),
    (
        "Are they black or white, bright or faint?",
        ("matching.polarity", "matching.low_percentile", "matching.local_share"),
    ),
    ("How faint may an object be?", ("placement.min_contrast",)),
    ("Which temperatures do 16-bit pictures hold?", ("data.unit", "matching.mode")),
    ("How are blur and noise matched to the camera?", ("sensor.profile", "sensor.optics", "sensor.noise")),
    ("How do I make a detector ready for other cameras?", ("sensor.randomise",)),
    ("Are the original labels kept, renamed, or left out?", ("labels.mode", "labels.rename", "labels.keep_categories")),
    ("How tight are the boxes?", ("labels.fit", "labels.loosen", "labels.occluded_box")),
    ("How are oriented boxes drawn?", ("labels.obb", "labels.loosen_obb")),
    ("Which formats are written?", ("output.formats", "output.layout")),
    ("Which file type do the pictures have, and how many bits?", ("output.image", "output.agc")),
    ("Are unchanged backgrounds in the dataset, too?", ("output.originals", "empty_share")),
    ("How much time does a frame take?", ("render.quality", "render.samples")),
)


def recipe_page() -> str:
    """Return the page on all recipe fields."""
    from infrablend.config import loading
    from infrablend.config.modes import REMOVED, Modes, sections_of
    from infrablend.config.recipe import PaperArtisticRecipe

    sections = sorted(sections_of(Modes()), key=SECTIONS.index)
    lines = [
        "# Recipe fields",
        "",
        "Written from `src/infrablend/config/recipe.py` by `make reference`: change the code, not this page.",
        "",
        "A recipe is a YAML 1.2 file. Unknown keys and bad values are errors; all of them are reported at once, each",
        "with its field. Any field can be set on the command line: `--set camera.distance_m='[2, 8]'`,",
        "`--set objects.0.count=3`, `--set output.image=png`. A range is `[low, high]`, drawn uniformly unless the",
        "field says otherwise; a number `n` means `[n, n]`. Recipes and the command line use degrees and °C; run",
        "folders and scene files use radians and kelvin.",
        "",
        "Shipped recipes (`infrablend recipes list`, `infrablend recipes show NAME`):",
        "",
        *(f"* `{name}`: {loading.load_recipe(name).description}" for name in loading.list_recipes()),
        "",
        "## By question",
        "",
        "| question | fields |",
        "|---|---|",
        *(f"| {question} | {', '.join(f'[`{n}`](#{n})' for n in names)} |" for question, names in QUESTIONS),
        "",
        "## Modes",
        "",
        "| setting | values | decides which fields exist in |",
        "|---|---|---|",
        "| `placement.mode` | `paper` (default), `metric` | `objects`, `camera`, `placement`, `sensor` |",
        "| `appearance.mode` | `artistic` (default), `physical` | `environment`, `appearance`, `matching` |",
        "| `sensor.profile` | `off` (default), a camera | `sensor` |",
        "| `matching.mode` | `radiometric`, or no such field | `environment`, `matching`, `sensor` |",
        "",
        "A field that has no meaning in the modes of the recipe is an error that names the mode it belongs to. A",
        "setting that changes a mode, such as `--set placement.mode=paper`, drops the fields that the recipe has for",
        "the old mode, and lists them on the screen, in `generate --plan` and in `run.json`. If it changes",
        "`placement.mode` and leaves the camera's lens or roll, a warning in the same places says which field to set.",
        "",
        "Some fields also depend on the model: in `placement.mode: metric`, `range_m` is for models that fly, and",
        "`z_m`, `group` and `align` are for models that stand. For other models, a value other than the default gives",
        "the warning `no-effect`; so does `sensor.headroom` in the artistic look.",
        "",
        "Fields of earlier versions:",
        "",
        *(f"* `{old}` was removed: {reason}." for old, reason in REMOVED.items()),
        "",
        "## Top level",
        "",
        *_table("", {n: f for n, f in PaperArtisticRecipe.model_fields.items() if n not in sections}),
        "| section | contents |",
        "|---|---|",
        *(f"| [`{n}`](#{n}) | {_cell(PaperArtisticRecipe.model_fields[n].description or '')} |" for n in sections),
        "",
    ]
    for section in sections:
        lines += _section(section)
    return _with_anchors("\n".join(lines).rstrip() + "\n")


def _with_anchors(page: str) -> str:
    """Return the page with an anchor at the first row of each field that the index names; all of them must exist."""
    for name in sorted({name for _, names in QUESTIONS for name in names}):
        row = f"\n| `{name}` |"
        assert row in page, f"QUESTIONS: {name} is no field of a recipe"
        page = page.replace(row, f'\n| <a id="{name}"></a>`{name}` |', 1)
    return page


def _section(section: str) -> list[str]:
    """Return the lines on one section: the fields of all modes, those of single modes, and the models inside."""
    from infrablend.config.modes import CHOICES, RADIOMETRIC, Modes, all_modes, sections_of
    from infrablend.config.recipe import Sensor

    prefix = f"{section}." + {"objects": "N.", "frames": "ID."}.get(section, "")
    modes_of_field: dict[tuple[str, str, str], list[Modes]] = {}
    fields: dict[tuple[str, str, str], FieldInfo] = {}
    for modes in all_modes():
        for name, field in sections_of(modes)[section].model_fields.items():
            key = (name, field.description or "", _default(field))
            modes_of_field.setdefault(key, []).append(modes)
            fields[key] = field
    groups: dict[str, dict[str, FieldInfo]] = {"": {}}
    for key, where in modes_of_field.items():
        fixed = [values.pop() if len(values := set(axis)) == 1 else None for axis in zip(*where, strict=True)]
        words = [f"`{name}: {value}`" for name, value in zip(CHOICES, fixed, strict=False) if value]
        if fixed[2]:
            words.append("`sensor.profile: off`" if fixed[2] == "off" else "a camera in `sensor.profile`")
        if fixed[3] == RADIOMETRIC:  # which needs the two other modes, and is therefore enough
            words = ["`matching.mode: radiometric`", *words[2:]]
        elif fixed[3] and not words:
            words = ["another matching than `matching.mode: radiometric`"]
        groups.setdefault(" and ".join(words), {})[key[0]] = fields[key]
    base = sections_of(Modes())[section]
    plain = base.__mro__[1] if base.__mro__[1].__name__ != "Strict" else base
    lines = [
        f"## `{section}`",
        "",
        _first(Sensor.__doc__ if section == "sensor" else plain.__doc__ if len(groups) > 1 else base.__doc__),
        "",
    ]
    for words, group in groups.items():
        if group:
            lines += [f"Only with {words}:", ""] if words else []
            lines += _table(prefix, group)
    inner: dict[type[BaseModel], str] = {}
    for group in groups.values():
        for name, field in group.items():
            _nested(f"{prefix}{name}", field, inner)
    for model, path in inner.items():
        lines += [f"### `{path.rstrip('.')}`: {model.__name__}", "", _first(model.__doc__), ""]
        lines += _table(path, model.model_fields)
    return lines


def _nested(path: str, field: FieldInfo, found: dict[type[BaseModel], str]) -> None:
    """Add the models inside a field to `found`, with the dotted names that lead to their fields."""
    for model in models_in(field.annotation):
        if model not in found:
            step = "N." if "tuple" in str(field.annotation) else "<part>." if "dict" in str(field.annotation) else ""
            found[model] = f"{path}.{step}"
            for name, inner in model.model_fields.items():
                _nested(f"{found[model]}{name}", inner, found)


def _table(prefix: str, fields: dict[str, FieldInfo]) -> list[str]:
    rows = [
        f"| `{prefix}{name}` | {_type_text(field.annotation, list(field.metadata))} | {_default(field)} "
        f"| {_cell(field.description or '')} |"
        for name, field in fields.items()
    ]
    return ["| field | values | default | meaning |", "|---|---|---|---|", *rows, ""]


def _first(doc: str | None) -> str:
    return " ".join((doc or "").strip().split("\n\n")[0].split())


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


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
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return "`[" + ", ".join(f"{v:g}" if isinstance(v, int | float) else str(v) for v in value) + "]`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`" if value not in ("", {}) else "empty"


def cli_page() -> str:
    """Return the page on all commands, from their own help."""
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
    """Return the page on what every format holds."""
    from infrablend.core.format_table import FIELDS, FORMATS, NATIVE, WRITERS
    from infrablend.formats.dataset_folder import reader_options
    from infrablend.formats.losses import LOSSES

    lines = [
        "# Formats",
        "",
        "Written from `src/infrablend/core/format_table.py` by `make reference`: change the code, not this page. Every",
        "format has a page of its own, which the tables link.",
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
        f"`infrablend convert --to NAME`, `infrablend generate --to NAME,...`, `output.formats`; `{NATIVE}` is the",
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
            "lost" if field in w.lacks else "table" if field in ("telemetry", "sequence") and w.table else "held"
            for w in WRITERS
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
