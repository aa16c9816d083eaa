"""Options that several commands share, and texts that hold lists."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Device(StrEnum):
    """Where Cycles renders."""

    AUTO = "auto"
    CPU = "cpu"
    CUDA = "cuda"
    OPTIX = "optix"
    HIP = "hip"
    METAL = "metal"
    ONEAPI = "oneapi"


DeviceOption = Annotated[Device, typer.Option(help="Where Cycles renders; auto takes a GPU if there is one.")]
WorkersOption = Annotated[int | None, typer.Option(min=1, help="Render processes [default: one per core].")]
SeedOption = Annotated[int, typer.Option(help="The same seed gives the same bytes.")]
JsonOption = Annotated[bool, typer.Option("--json", help="The result as JSON on stdout.")]
ReadingOption = Annotated[
    list[str] | None,
    typer.Option("--read", metavar="KEY=VALUE", help="Option of the dataset's reader (docs/formats); repeatable."),
]
DatasetArgument = Annotated[Path, typer.Argument(metavar="DATASET", help="The dataset's folder.")]
FormatOption = Annotated[
    str | None, typer.Option("--format", metavar="NAME", help="Read it as this format [default: detected].")
]
FormOption = Annotated[
    str | None, typer.Option(help="Read only this form of the dataset, e.g. rotate_json [default: all].")
]
MetadataOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="CSV or JSON of pitch and altitude, for a folder of images.")
]
SplitsOption = Annotated[
    str | None, typer.Option("--split", metavar="LIST", help="Some of train,val,test [default: all].")
]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="The folder that `generate` wrote.")]


def comma_list(text: str | None, option: str) -> tuple[str, ...] | None:
    """`"a, b"` as `("a", "b")`, without repeats; None for None.

    Raises:
        typer.BadParameter: If an item is empty; it names `option`.
    """
    if text is None:
        return None
    items = tuple(dict.fromkeys(part.strip() for part in text.split(",")))
    if not all(items):
        raise typer.BadParameter(f"{text!r} has an empty item; write a,b,c", param_hint=option)
    return items


def split_list(text: str | None) -> tuple[str, ...] | None:
    """The splits that `--split` names; None for None.

    Raises:
        typer.BadParameter: For a name that is no split.
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
    """`["a=1", "b=x=y"]` as `{"a": "1", "b": "x=y"}`.

    Raises:
        typer.BadParameter: For an item without `=`, or a key given twice; it names `option`.
    """
    found: dict[str, str] = {}
    for pair in pairs or ():
        key, equals, value = pair.partition("=")
        if not equals or not key or key in found:
            raise typer.BadParameter(f"{pair!r}: write KEY=VALUE, each key once", param_hint=option)
        found[key] = value
    return found
