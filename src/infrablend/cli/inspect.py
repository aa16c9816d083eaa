"""`infrablend inspect`: show what a dataset contains."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.options import (
    DatasetArgument,
    FormatOption,
    FormOption,
    JsonOption,
    MetadataOption,
    ReadingOption,
    SplitsOption,
    make_reading,
)

if TYPE_CHECKING:
    from infrablend.report.inspection import Inspection

SHOWN = 12


def inspect(
    ctx: typer.Context,
    data: DatasetArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write inspect.png (charts) and inspect.json there.")
    ] = None,
    decode: Annotated[bool, typer.Option("--decode", help="Decode the pictures: bit depth, channels, levels.")] = False,
    split: SplitsOption = None,
    form: FormOption = None,
    format: FormatOption = None,
    metadata: MetadataOption = None,
    options: ReadingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show what a dataset contains: splits, classes, sizes, pitch and altitude, sequences, leakage, problems."""
    from infrablend import api
    from infrablend.cli.results import print_json, print_result

    ctx.obj.json = as_json
    facts = api.inspect(
        data,
        out,
        reading=make_reading(split, format, form, metadata, options),
        decode=decode,
    )
    if as_json:
        print_json(facts.to_json())
        return
    print_result("\n\n".join(_blocks(facts)))
    if out is not None:
        print_result(f"\n{out / 'inspect.png'}\n{out / 'inspect.json'}")


def _blocks(facts: Inspection) -> list[str]:
    """Return the paragraphs of the text."""
    from infrablend.cli.results import grid, table

    splits = list(facts.splits)
    blocks = [f"{facts.root}: {facts.format} ({facts.reason})"]
    keys = ("images", "without_objects", "objects", "ignore_regions")
    rows = [[k.replace("_", " "), *_summed([facts.splits[s][k] for s in splits])] for k in keys]
    blocks.append(grid(["", *splits, "all"], rows))
    rows = []
    for name, of in facts.classes.items():
        q = facts.quantiles(name)
        sizes = [f"{q[k]:.0f}" if q else "-" for k in ("0", "0.05", "0.5", "0.95", "1")]
        title = f"{name} (ignored)" if name in facts.ignored else name
        rows.append([title, *_summed([of[s] for s in splits]), *sizes])
    header = ["objects by class", *splits, "all", "size px min", "5 %", "50 %", "95 %", "max"]
    if rows:
        blocks.append(grid(header, rows) + "\n(size: square root of the box's area)")
    blocks.append(_coverage(facts))
    kinds = sorted({k for of in facts.time_of_day.values() for k in of})
    rows = [[k, *_summed([facts.time_of_day[s].get(k, 0) for s in splits])] for k in kinds]
    blocks.append(grid(["images by time of day", *splits, "all"], rows))
    blocks.append(table(_further(facts)))
    if "flight" in facts.notes:
        blocks.append(_flight(facts.notes["flight"]))
    if facts.leakage:
        lines = [
            f"  {one.near} of {one.images} {one.split} images have a {one.other} image at most {one.distance} frame "
            "numbers away"
            for one in facts.leakage
        ]
        blocks.append("\n".join(["neighbours across splits", *lines]))
    if facts.remarks:
        blocks.append("\n".join(["known faults of this dataset", *(f"  - {r}" for r in facts.remarks)]))
    return [*blocks, _problems(facts)]


def _flight(note: Mapping[str, Any]) -> str:
    """Return the table of what the pictures' own headers state, and where."""
    from infrablend.cli.results import grid

    rows = []
    for row in note["facts"]:
        low, high = row["lowest"], row["highest"]
        span = "" if low is None else _value(low) if low == high else f"{_value(low)} to {_value(high)}"
        rows.append([row["field"], row["source"] or "missing", row["count"], span])
    lines = [grid(["flight data", "source", "pictures", "range"], rows)]
    lines += [f"camera: {camera} ({count})" for camera, count in note["cameras"].items()]
    lines += [f"left out: {count} {reason}" for reason, count in note["left_out"].items()]
    if note["radiometric"]:
        lines.append(f"with a radiometric layer: {note['radiometric']}")
    return "\n".join(lines)


def _value(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _summed(counts: list[int]) -> list[int]:
    return [*counts, sum(counts)]


def _coverage(facts: Inspection) -> str:
    from infrablend.cli.results import grid

    rows = [[p, *(facts.coverage.get((p, a), "") for a in facts.altitudes)] for p in facts.pitches]
    return grid(["images by pitch, altitude", *facts.altitudes], rows)


def _further(facts: Inspection) -> dict[str, str]:
    """Return one line each on labels, sequences, dates, tracks and pictures."""
    rows: dict[str, Any] = {"labels": _listed(facts.labels)}
    if facts.sequences:
        mean = sum(facts.sequences.values()) / len(facts.sequences)
        rows["sequences"] = f"{len(facts.sequences)}, {mean:.1f} images each on average, at most "
        rows["sequences"] += f"{max(facts.sequences.values())}"
    if facts.dates:
        rows["dates"] = _listed(facts.dates)
    if facts.tracks:
        mean = sum(facts.tracks.values()) / len(facts.tracks)
        rows["tracks"] = f"{len(facts.tracks)}, {mean:.1f} objects each on average"
    rows["picture sizes"] = _listed(facts.picture_sizes)
    if facts.temperatures:
        rows["temperatures"] = _listed(facts.temperatures)
    if facts.decoded:
        rows["pictures"] = _listed(facts.decoded["pictures"])
        rows["grey levels"] = ", ".join(f"{k} {v:g}" for k, v in facts.decoded["grey_levels"].items())
    return rows


def _listed(counts: Any) -> str:
    shown = [f"{k.replace('_', ' ')} {n}" for k, n in list(counts.items())[:SHOWN]]
    more = len(counts) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def _problems(facts: Inspection) -> str:
    if not facts.problems:
        return "no problems found in the labels; `infrablend check` also checks the pictures"
    lines = [f"{len(facts.problems)} problem(s)", *(f"  - {p.severity}: {p}" for p in facts.problems[:SHOWN])]
    if len(facts.problems) > SHOWN:
        lines.append(f"  ... and {len(facts.problems) - SHOWN} more; --json lists all")
    return "\n".join(lines)
