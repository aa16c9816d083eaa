"""`infrablend convert`: a dataset in another format."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.options import JsonOption, ReadingOption, comma_list, key_values, split_list

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
    """What becomes of regions to ignore."""

    DROP = "drop"
    KEEP = "keep"


class WithoutMask(StrEnum):
    """What becomes of objects without a mask."""

    OMIT = "omit"
    OBB = "obb"


def convert(
    ctx: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="SRC", help="The dataset to read.")],
    out: Annotated[Path, typer.Argument(metavar="DST", help="The folder to write.")],
    to: Annotated[str, typer.Option(metavar="FORMAT", help="Format to write: yolo, coco, ... or native.")],
    split: Annotated[str | None, typer.Option(metavar="LIST", help="Some of train,val,test [default: all].")] = None,
    format_in: Annotated[str | None, typer.Option(metavar="FORMAT", help="Format of SRC [default: detected].")] = None,
    reading: ReadingOption = None,
    metadata: Annotated[
        Path | None, typer.Option(metavar="FILE", help="CSV or JSON of pitch and altitude of the pictures.")
    ] = None,
    rename: Annotated[
        list[str] | None,
        typer.Option(metavar="OLD=NEW,...", help="Other names for classes; several may become one; repeatable."),
    ] = None,
    drop: Annotated[
        str | None,
        typer.Option("--drop-class", metavar="LIST", help="Classes to leave out, by their name after --rename."),
    ] = None,
    only: Annotated[
        str | None, typer.Option("--only-class", metavar="NAME", help="Keep this class's labels alone.")
    ] = None,
    with_class: Annotated[
        str | None, typer.Option(metavar="NAME", help="Only pictures that show this class (name after --rename).")
    ] = None,
    without: Annotated[
        str | None, typer.Option(metavar="LIST", help="Only pictures that show none of these classes.")
    ] = None,
    images: Annotated[int | None, typer.Option(metavar="N", help="Draw so many of the pictures.")] = None,
    objects: Annotated[
        int | None, typer.Option(metavar="N", help="Draw them so that they show so many of --with-class.")
    ] = None,
    like: Annotated[
        str | None,
        typer.Option(
            "--like-class",
            metavar="NAME",
            help="Draw pictures, some several times, with times of day, heights and pitches as of those that show this "
            "class.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Of the draw.")] = 0,
    loosen: Annotated[
        float,
        typer.Option(
            "--loosen-inserted", metavar="FACTOR", help="Inserted objects' boxes as much wider and higher, as by hand."
        ),
    ] = 1.0,
    ids: Annotated[Ids, typer.Option(help="Ids numbered anew, or the source's, where the format has ids.")] = Ids.NEW,
    category_ids: Annotated[
        CategoryIds, typer.Option(help="Category ids of the source, or from 1: many tools take 0 for background.")
    ] = CategoryIds.SOURCE,
    dont_care: Annotated[DontCare, typer.Option(help="YOLO: regions to ignore are left out, or a class.")] = (
        DontCare.DROP
    ),
    without_mask: Annotated[
        WithoutMask, typer.Option(help="yolo-seg: objects without mask are left out, or their oriented box is written.")
    ] = WithoutMask.OMIT,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier conversion in DST.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a dataset in another format; pictures are linked, every loss is counted and said."""
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.results import facts, say, say_json, table, tell_problems
    from infrablend.formats.losses import LOSSES

    pairs = [pair for text in rename or () for pair in text.split(",")]
    report = api.convert(
        source,
        out,
        to,
        splits=split_list(split),
        format=format_in,
        metadata=metadata,
        options=key_values(reading, "--read"),
        rename=key_values(pairs, "--rename"),
        drop=comma_list(drop, "--drop-class") or (),
        only=only,
        with_class=with_class,
        without=comma_list(without, "--without") or (),
        images=images,
        objects=objects,
        like=like,
        seed=seed,
        loosen=loosen,
        ids=ids.value,
        category_ids=category_ids.value,
        dont_care=dont_care.value,
        without_mask=without_mask.value,
        overwrite=overwrite,
    )
    tell_problems(report.problems, session.log_path, report.out / "convert.json")
    if as_json:
        say_json(report.to_json())
    else:
        rows = facts({k: v for k, v in report.counts.items() if k != "selection"})
        if selection := report.counts.get("selection"):
            rows["selection"] = _in_words(selection)
        say(table(rows))
        for kind, n in report.losses.items():
            say(f"lost: {kind} {n}: {LOSSES[kind.rpartition('.')[2]]}")
        say(str(report.out))
    if not report.ok:
        raise typer.Exit(PARTIAL)


def _in_words(selection: Mapping[str, Any]) -> str:
    """What was asked for, and what was left out."""
    named = selection["with_class"]
    parts = [f"pictures that show {named}"] if named is not None else []
    parts += [f"none that shows {' or '.join(selection['without'])}"] if selection["without"] else []
    if selection["images"] is not None:
        parts.append(f"{selection['images']} pictures drawn")
    if selection["objects"] is not None:
        parts.append(f"{selection['objects_taken']} objects of {named}, {selection['objects']} asked for")
    if selection["like"] is not None:
        parts.append(f"as those of {selection['like']}, {selection['drawn_again']} drawn again")
    parts += [f"seed {selection['seed']}"] if "drawn_again" in selection or selection["images"] is not None else []
    left_out = ", ".join(f"{n} {why}" for why, n in selection["left_out"].items())
    return ", ".join(parts) + (f"; left out: {left_out}" if left_out else "")
