"""Options that several commands share, and parsing of options that contain lists."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.completion import complete_read_format, complete_recipe

if TYPE_CHECKING:
    from infrablend.core.output import Existing
    from infrablend.formats.reading import Reading


class Device(StrEnum):
    """Where Cycles renders."""

    AUTO = "auto"
    CPU = "cpu"
    CUDA = "cuda"
    OPTIX = "optix"
    HIP = "hip"
    METAL = "metal"
    ONEAPI = "oneapi"


RecipeArgument = Annotated[
    str,
    typer.Argument(
        metavar="RECIPE",
        help="Name of a shipped recipe (see `recipes list`) or a YAML file.",
        autocompletion=complete_recipe,
    ),
]
DeviceOption = Annotated[Device, typer.Option(help="Device that Cycles renders on; auto uses a GPU if there is one.")]
WorkersOption = Annotated[int | None, typer.Option(min=1, help="Number of worker processes [default: one per core].")]
SeedOption = Annotated[int, typer.Option(help="The same seed gives the same bytes.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]
ReadingOption = Annotated[
    list[str] | None,
    typer.Option("--read", metavar="KEY=VALUE", help="Option of the dataset reader (docs/formats); repeatable."),
]
DatasetArgument = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of the dataset.")]
FormatOption = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="NAME",
        help="Format of the dataset to read [default: detected].",
        autocompletion=complete_read_format,
    ),
]
FormOption = Annotated[str | None, typer.Option(help="Annotation form to read, e.g. rotate_json [default: all].")]
MetadataOption = Annotated[Path | None, typer.Option(metavar="FILE", help="CSV or JSON table of pitch and altitude.")]
SplitsOption = Annotated[
    str | None, typer.Option("--split", metavar="LIST", help="Splits to read, from train,val,test [default: all].")
]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Folder that `generate` wrote.")]


def comma_list(text: str | None, option: str) -> tuple[str, ...] | None:
    r"""Parse `"a, b"` into `("a", "b")` without repeats; None stays None. A comma of a name is written `\,`.

    Raises:
        typer.BadParameter: An item is empty; the message names `option`.
    """
    if text is None:
        return None
    items = tuple(dict.fromkeys(split_at_commas(text)))
    if not all(items):
        raise typer.BadParameter(f"{text!r} has an empty item; write a,b,c", param_hint=option)
    return items


def split_at_commas(text: str) -> list[str]:
    r"""Return the items of a list, without blanks around them; a comma of an item is written `\,`."""
    return [part.strip().replace("\\,", ",") for part in re.split(r"(?<!\\),", text)]


def split_list(text: str | None) -> tuple[str, ...] | None:
    """Parse the value of `--split`; None stays None.

    Raises:
        typer.BadParameter: A name is not a split.
    """
    from infrablend.core.dataset import SPLITS

    splits = comma_list(text, "--split")
    unknown = [s for s in splits or () if s not in SPLITS]
    if unknown:
        raise typer.BadParameter(
            f"{', '.join(unknown)}: no such split; choose from {','.join(SPLITS)}", param_hint="--split"
        )
    return splits


def key_values(pairs: list[str] | None, option: str) -> dict[str, str]:
    """Parse `["a=1", "b=x=y"]` into `{"a": "1", "b": "x=y"}`.

    Raises:
        typer.BadParameter: An item has no `=`, or a key is given twice; the message names `option`.
    """
    found: dict[str, str] = {}
    for pair in pairs or ():
        key, equals, value = pair.partition("=")
        if not equals or not key or key in found:
            raise typer.BadParameter(f"{pair!r}: write KEY=VALUE, each key once", param_hint=option)
        found[key] = value
    return found


def yaml_values(pairs: list[str] | None, option: str) -> dict[str, Any]:
    """Parse `["a=1", "b=[2, 3]"]` into `{"a": 1, "b": [2, 3]}`.

    Raises:
        typer.BadParameter: An item has no `=`, a key comes twice, or a value is not YAML; the message names `option`.
    """
    from infrablend.core.yaml_text import read_yaml

    found = {}
    for key, text in key_values(pairs, option).items():
        try:
            found[key] = read_yaml(text)
        except ValueError as error:
            raise typer.BadParameter(f"{key}={text}: {error}", param_hint=option) from error
    return found


def earlier_output(resume: bool, overwrite: bool) -> Existing:
    """Return what `--resume` and `--overwrite` ask to do with earlier output.

    Raises:
        typer.BadParameter: Both are given.
    """
    if resume and overwrite:
        raise typer.BadParameter("--resume and --overwrite exclude each other; give one of them")
    return "resume" if resume else "overwrite" if overwrite else "refuse"


def make_reading(
    split: str | None = None,
    format: str | None = None,
    form: str | None = None,
    metadata: Path | None = None,
    options: list[str] | None = None,
) -> Reading:
    """Return the reading settings from the options `--split`, `--format`, `--form`, `--metadata` and `--read`.

    Raises:
        typer.BadParameter: A value is not what its option expects.
    """
    from infrablend.formats.reading import Reading

    if format is not None and "," in format:
        raise typer.BadParameter(
            f"{format!r}: name the one format of the dataset to read; --to lists the formats to write",
            param_hint="--format",
        )
    return Reading(split_list(split), format, form, metadata, key_values(options, "--read"))
