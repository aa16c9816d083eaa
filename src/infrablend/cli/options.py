"""Options of commands: made from the fields of requests, shared by several commands, and parsed.

A command is a function whose parameters are Typer's, or requests: `settings: Annotated[EvaluationSettings, Fields()]`
stands for an option per field. The field gives name, type and default of its option, and the docstring of the request
gives the help, so that a new field is a new option. Parsers raise `typer.BadParameter` for wrong values.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import MISSING, Field, fields
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from infrablend.assets.catalogue import list_models
from infrablend.cli.call_state import Session
from infrablend.core.files import RECIPES
from infrablend.core.format_table import FORMATS, NATIVE, written_names
from infrablend.core.workspace import Existing
from infrablend.formats.published.sources import SOURCES
from infrablend.formats.read_write import Reading

_YAML = (".yaml", ".yml")


def offered(names: Callable[[], Iterable[str]], *, files: bool = False) -> Callable[[str], list[str]]:
    """Return a function for Typer: the names, and with `files` the YAML files, that begin like the text so far."""

    def complete(incomplete: str) -> list[str]:
        return _beginning(names(), incomplete) + (_yaml_files(incomplete) if files else [])

    return complete


complete_recipe = offered(lambda: RECIPES.names, files=True)
complete_shipped_recipe = offered(lambda: RECIPES.names)
complete_model = offered(list_models, files=True)
complete_source = offered(lambda: (s.name for s in SOURCES))
complete_read_format = offered(lambda: sorted(f.name for f in FORMATS))
complete_written_format = offered(lambda: [*sorted(written_names()), NATIVE])


def complete_written_formats(incomplete: str) -> list[str]:
    """Return what a list of formats can become once its last name is completed."""
    before, comma, last = incomplete.rpartition(",")
    given = before.split(",")
    return [f"{before}{comma}{name}" for name in complete_written_format(last) if name not in given]


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _yaml_files(incomplete: str) -> list[str]:
    """Return the folders and YAML files beside the path typed so far; none before anything is typed."""
    if not incomplete:
        return []
    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    prefix = incomplete[: incomplete.rfind("/") + 1]
    try:
        beside = sorted(folder.iterdir())
    except OSError:
        return []
    shown = [p for p in beside if not p.name.startswith(".") and (p.suffix in _YAML or p.is_dir())]
    return _beginning((prefix + p.name + ("/" if p.is_dir() else "") for p in shown), incomplete)


JsonSession = Annotated[Session, "--json"]
"""Session of a command that can print its result as JSON: the command gets the option `--json`."""

_GIVEN = {"ctx", "session"}
"""Parameters of commands that are no options."""

_FieldOption = tuple[inspect.Parameter, Callable[[Any], Any]]
"""An option, as a parameter for Typer, and what makes the value of the field from the value of the option."""


class Fields:
    """Annotation of a parameter that is a request: which of its fields are options, and how.

    Args:
        names: Names of the fields, separated by blanks; empty for all.
        options: What a field does not say, by its name: a `typer.Option` with flags, metavar, bounds or parser, and
            with a help text if the field's would not do; or `Annotated[list[str] | None, typer.Option(...), convert]`
            for an option of another type, with the function that makes the field's value from it, if there is one.
        request: Class of a request that also needs other values: the parameter is then a dictionary with the fields.
    """

    def __init__(self, names: str = "", /, request: type | None = None, **options: Any) -> None:
        self.names = names.split()
        self.request = request
        self.options = options


def with_options(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function for Typer with a parameter per option, which calls `function` with session and requests."""
    given = inspect.signature(function, eval_str=True).parameters
    options = [_parameter("ctx", typer.Context)]
    requests: dict[str, tuple[Callable[..., Any], list[_FieldOption]]] = {}
    for name, parameter in given.items():
        kind, *marks = get_args(parameter.annotation) or (parameter.annotation,)
        wanted = next((mark for mark in marks if isinstance(mark, Fields)), None)
        if wanted is not None:
            requests[name] = (kind, _field_options(wanted.request or kind, wanted))
            options += [option for option, _ in requests[name][1]]
        elif name not in _GIVEN:
            options.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
    as_json = "session" in given and given["session"].annotation == JsonSession
    if as_json:
        options.append(_parameter("as_json", JsonOption, False))

    def command(ctx: typer.Context, **values: Any) -> None:
        if as_json:
            values.pop("as_json")  # set before
        for name, (make, of_fields) in requests.items():
            found = {o.name: (values.pop(o.name), convert) for o, convert in of_fields}
            values[name] = make(**{n: convert(v) for n, (v, convert) in found.items() if v not in (None, [])})
        values |= {n: v for n, v in (("ctx", ctx), ("session", ctx.obj)) if n in given}
        function(**values)

    command.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in options}
    command.__doc__ = function.__doc__
    return command


def _parameter(name: str, annotation: Any, default: Any = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _field_options(request: type, wanted: Fields) -> list[_FieldOption]:
    texts = attribute_texts(request)
    types = get_type_hints(request)
    return [
        _field_option(f, types[f.name], texts[f.name], wanted.options.get(f.name, typer.Option()))
        for f in fields(request)
        if not wanted.names or f.name in wanted.names
    ]


def _field_option(field: Field[Any], of: Any, text: str, given: Any) -> _FieldOption:
    """Return the option of one field: of the field's type, or of the type that `given` names."""
    named = get_origin(given) is Annotated
    kind, option, *convert = get_args(given) if named else (None, given)
    option = deepcopy(option)
    option.help = option.help or text
    default: Any = None if named or field.default in (MISSING, ()) else field.default
    if field.default is MISSING and field.default_factory is MISSING:
        default = inspect.Parameter.empty
    if not named:
        # Typer keeps the first flag of an option where its other parameters have their default.
        flag = option.default if isinstance(option.default, str) else f"--{field.name.replace('_', '-')}"
        inner = next(part for part in get_args(of) if part is not NoneType) if NoneType in get_args(of) else of
        kind = Path | None if Path in get_args(of) else of
        if get_origin(inner) is Mapping:
            kind = list[str] | None
            option.metavar = option.metavar or "KEY=VALUE"
            convert = [partial(key_values if get_args(inner)[1] is str else yaml_values, option=flag)]
        elif get_origin(inner) is Sequence:
            kind = str | None
            option.metavar = option.metavar or "LIST"
            option.parser = option.parser or comma_list
        elif default is False:
            option.default = flag  # else Typer adds `--no-...`
    return _parameter(field.name, Annotated[kind, option], default), convert[0] if convert else lambda value: value


def attribute_texts(request: type) -> dict[str, str]:
    """Return the text of each field from the `Attributes` of a class's docstring."""
    section = (inspect.getdoc(request) or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    entries = re.split(r"^    (?=\w)", section, flags=re.MULTILINE)
    pairs = (entry.partition(": ") for entry in entries if entry)
    return {name: " ".join(text.split()).rstrip() for name, _, text in pairs}


def comma_list(text: str) -> tuple[str, ...]:
    r"""Parse `"a, b"` into `("a", "b")` without repeats; no item may be empty. A comma of a name is written `\,`."""
    items = tuple(dict.fromkeys(split_at_commas(text)))
    if not all(items):
        raise typer.BadParameter(f"{text!r} has an empty item; write a,b,c")
    return items


def reported(parse: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return a parser for Typer that reports the `ValueError` of another one as wrong usage of the option."""

    def parse_or_report(text: str) -> Any:
        try:
            return parse(text)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error

    return parse_or_report


def split_at_commas(text: str) -> list[str]:
    r"""Return the items of a list, without blanks around them; a comma of an item is written `\,`."""
    return [part.strip().replace("\\,", ",") for part in re.split(r"(?<!\\),", text)]


def split_list(text: str) -> tuple[str, ...]:
    """Parse the value of `--split`."""
    from infrablend.core.dataset import SPLITS

    splits = comma_list(text)
    unknown = [s for s in splits if s not in SPLITS]
    if unknown:
        raise typer.BadParameter(f"{', '.join(unknown)}: no such split; choose from {','.join(SPLITS)}")
    return splits


def one_format(text: str) -> str:
    """Return the value of `--format`, which is no list."""
    if "," in text:
        raise typer.BadParameter(
            f"{text!r}: name the one format of the dataset to read; --to lists the formats to write"
        )
    return text


def key_values(pairs: Sequence[str] | None, option: str) -> dict[str, str]:
    """Parse `["a=1", "b=x=y"]` into `{"a": "1", "b": "x=y"}`; each key once."""
    found: dict[str, str] = {}
    for pair in pairs or ():
        key, equals, value = pair.partition("=")
        if not equals or not key or key in found:
            raise typer.BadParameter(f"{pair!r}: write KEY=VALUE, each key once", param_hint=option)
        found[key] = value
    return found


def yaml_values(pairs: Sequence[str] | None, option: str) -> dict[str, object]:
    """Parse `["a=1", "b=[2, 3]"]` into `{"a": 1, "b": [2, 3]}`; each key once."""
    from infrablend.core.yaml_text import read_yaml

    found = {}
    for key, text in key_values(pairs, option).items():
        try:
            found[key] = read_yaml(text)
        except ValueError as error:
            raise typer.BadParameter(f"{key}={text}: {error}", param_hint=option) from error
    return found


def earlier_output(resume: bool, overwrite: bool) -> Existing:
    """Return what `--resume` and `--overwrite`, of which one may be given, ask to do with earlier output."""
    if resume and overwrite:
        raise typer.BadParameter("--resume and --overwrite exclude each other; give one of them")
    return "resume" if resume else "overwrite" if overwrite else "refuse"


RecipeArgument = Annotated[
    str,
    typer.Argument(
        metavar="RECIPE",
        help="Name of a shipped recipe (see `recipes list`) or a YAML file.",
        autocompletion=complete_recipe,
    ),
]
DatasetArgument = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of the dataset, or a video.")]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Folder that `generate` wrote.")]
WorkersOption = Annotated[int | None, typer.Option(min=1, help="Number of worker processes [default: one per core].")]
SeedOption = Annotated[int, typer.Option(help="The same seed gives the same bytes.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]
BackgroundsOption = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder of the backgrounds, if it has moved.")
]
SettingsOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a recipe field, e.g. output.image=png; repeatable."),
]


def _reading(names: str) -> Fields:
    return Fields(
        names,
        splits=typer.Option("--split", parser=split_list),
        format=typer.Option(metavar="NAME", parser=one_format, autocompletion=complete_read_format),
        metadata=typer.Option(metavar="FILE"),
        options=typer.Option("--read"),
        val_share=typer.Option(metavar="SHARE"),
    )


ReadingWithVal = Annotated[Reading, _reading("")]
ReadingOptions = Annotated[Reading, _reading("splits format form metadata options")]
ReadingOfAllSplits = Annotated[Reading, _reading("format form metadata options")]
ReadingOfFormat = Annotated[Reading, _reading("format options")]
ReadingOfPictures = Annotated[Reading, _reading("splits format options")]
ReadingOfSplits = Annotated[Reading, _reading("splits")]
