"""`infrablend convert`: write a dataset in another format."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.completion import complete_written_format
from infrablend.cli.options import (
    FormatOption,
    FormOption,
    JsonOption,
    MetadataOption,
    ReadingOption,
    SplitsOption,
    comma_list,
    key_values,
    make_reading,
    split_at_commas,
)

if TYPE_CHECKING:
    from infrablend.cli.session import Session


class Ids(StrEnum):
    """Where image and annotation ids come from."""

    NEW = "new"
    SOURCE = "source"


class CategoryIds(StrEnum):
    """Where category ids come from."""

    SOURCE = "source"
    FROM_ONE = "from_one"


class DontCare(StrEnum):
    """How to write regions to ignore."""

    DROP = "drop"
    KEEP = "keep"


class WithoutMask(StrEnum):
    """How to write objects without a mask."""

    OMIT = "omit"
    OBB = "obb"


def convert(
    ctx: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="SRC", help="Folder of the dataset to read.")],
    out: Annotated[Path, typer.Argument(metavar="DST", help="Folder to write.")],
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="Format to write: yolo, coco, ... or native.",
            autocompletion=complete_written_format,
        ),
    ],
    split: SplitsOption = None,
    format: FormatOption = None,
    form: FormOption = None,
    metadata: MetadataOption = None,
    options: ReadingOption = None,
    rename: Annotated[
        list[str] | None,
        typer.Option(metavar="OLD=NEW,...", help="Rename classes; several may become one; repeatable."),
    ] = None,
    drop: Annotated[
        str | None,
        typer.Option("--drop-class", metavar="LIST", help="Leave out labels of these classes (names after --rename)."),
    ] = None,
    only: Annotated[
        str | None, typer.Option("--only-class", metavar="NAME", help="Keep only the labels of this class.")
    ] = None,
    with_class: Annotated[
        str | None, typer.Option(metavar="NAME", help="Take only pictures that show this class (name after --rename).")
    ] = None,
    without: Annotated[
        str | None, typer.Option(metavar="LIST", help="Take only pictures that show none of these classes.")
    ] = None,
    images: Annotated[int | None, typer.Option(metavar="N", help="Draw N of the pictures at random.")] = None,
    objects: Annotated[
        int | None, typer.Option(metavar="N", help="Draw pictures that together show N objects of --with-class.")
    ] = None,
    like: Annotated[
        str | None,
        typer.Option(
            "--like-class",
            metavar="NAME",
            help="Draw pictures, some several times, to match times of day, heights, pitches and grey levels of those "
            "that show this class.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the draw.")] = 0,
    loosen: Annotated[
        float,
        typer.Option(
            "--loosen-inserted",
            metavar="FACTOR",
            help="Enlarge boxes of inserted objects by this factor, to match hand-drawn ones.",
        ),
    ] = 1.0,
    loosen_px: Annotated[
        float,
        typer.Option(
            "--loosen-inserted-px",
            metavar="PX",
            help="Move each side of these boxes outwards by this distance, after the factor.",
        ),
    ] = 0.0,
    ids: Annotated[Ids, typer.Option(help="New ids, or those of the source, where the format has ids.")] = Ids.NEW,
    category_ids: Annotated[
        CategoryIds, typer.Option(help="Category ids of the source, or from 1: many tools read 0 as background.")
    ] = CategoryIds.SOURCE,
    dont_care: Annotated[DontCare, typer.Option(help="YOLO: drop regions to ignore, or keep them as a class.")] = (
        DontCare.DROP
    ),
    without_mask: Annotated[
        WithoutMask, typer.Option(help="yolo-seg: omit objects without a mask, or write their oriented box.")
    ] = WithoutMask.OMIT,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier conversion in DST.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a dataset in another format; pictures are linked, and every loss is counted and reported."""
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.results import facts, print_json, print_problems, print_result, table
    from infrablend.formats.losses import LOSSES
    from infrablend.formats.writing import WriteSettings
    from infrablend.pipeline.convert import ClassChanges
    from infrablend.pipeline.select import Selection

    pairs = [pair for text in rename or () for pair in split_at_commas(text)]
    report = api.convert(
        source,
        out,
        to,
        reading=make_reading(split, format, form, metadata, options),
        classes=ClassChanges(key_values(pairs, "--rename"), comma_list(drop, "--drop-class") or (), only),
        selection=Selection(with_class, comma_list(without, "--without") or (), images, objects, like, seed),
        loosen=loosen,
        loosen_px=loosen_px,
        writing=WriteSettings(ids.value, category_ids.value, dont_care.value, without_mask.value),
        overwrite=overwrite,
    )
    print_problems(report.problems, session.log_path, report.out / "convert.json")
    if as_json:
        print_json(report.to_json())
    else:
        rows = facts({k: v for k, v in report.counts.items() if k != "selection"})
        if selection := report.counts.get("selection"):
            rows["selection"] = _selection_text(selection)
        print_result(table(rows))
        for kind, n in report.losses.items():
            print_result(f"lost: {kind} {n}: {LOSSES[kind.rpartition('.')[2]]}")
        print_result(str(report.out))
    if not report.ok:
        raise typer.Exit(PARTIAL)


def _selection_text(selection: Mapping[str, Any]) -> str:
    """Describe what was selected and what was left out."""
    named = selection["with_class"]
    parts = [f"pictures with {named}"] if named is not None else []
    parts += [f"no pictures with {' or '.join(selection['without'])}"] if selection["without"] else []
    if selection["images"] is not None:
        parts.append(f"{selection['images']} pictures drawn")
    if selection["objects"] is not None:
        parts.append(f"{selection['objects_taken']} of {selection['objects']} requested objects of {named}")
    if selection["like"] is not None:
        parts.append(f"matched to those of {selection['like']}, {selection['drawn_again']} of them copies")
    parts += [f"seed {selection['seed']}"] if "drawn_again" in selection or selection["images"] is not None else []
    left_out = ", ".join(f"{n} {why}" for why, n in selection["left_out"].items())
    return ", ".join(parts) + (f"; left out: {left_out}" if left_out else "")
