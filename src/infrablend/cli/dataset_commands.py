"""Commands about datasets: `inspect`, `check`, `convert`, `split` and `fetch`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend import api
from infrablend.cli.exits import PARTIAL, printable, problem_lines
from infrablend.cli.options import (
    DatasetArgument,
    Fields,
    JsonSession,
    ReadingOfAllSplits,
    ReadingOptions,
    comma_list,
    complete_source,
    complete_written_format,
    key_values,
    split_at_commas,
)
from infrablend.cli.output import (
    facts,
    grid,
    loss_lines,
    print_result,
    show_report,
    show_result,
    shown_fetch,
    shown_progress,
    table,
)
from infrablend.errors import format_problems

if TYPE_CHECKING:
    from infrablend.imaging.overlap import OverlapValue
    from infrablend.pipeline.datasets.requests import SelectionFacts
    from infrablend.report.checking import CheckReport
    from infrablend.report.inspection import Inspection

SHOWN = 12
SHOWN_EACH = 3


def inspect(
    session: JsonSession,
    *,
    data: DatasetArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write inspect.png (charts) and inspect.json there.")
    ] = None,
    decode: Annotated[bool, typer.Option("--decode", help="Decode the pictures: bit depth, channels, levels.")] = False,
    reading: ReadingOptions,
) -> None:
    """Show what a dataset contains: splits, classes, sizes, pitch and altitude, sequences, leakage, problems."""
    found = api.inspect(data, out, reading=reading, decode=decode)
    written = [] if out is None else [f"{out / 'inspect.png'}\n{out / 'inspect.json'}"]
    show_result(session, found.to_json(), lambda: "\n\n".join([*_contents(found), *written]))


def _contents(found: Inspection) -> list[str]:
    splits = list(found.splits)
    blocks = [f"{found.root}: {found.format} ({found.reason})"]
    keys = ("images", "without_objects", "objects", "ignore_regions")
    rows = [[k.replace("_", " "), *_summed([found.splits[s][k] for s in splits])] for k in keys]
    blocks.append(grid(["", *splits, "all"], rows))
    rows = []
    for name, of in found.classes.items():
        q = found.quantiles(name)
        sizes = [f"{q[k]:.0f}" if q else "-" for k in ("0", "0.05", "0.5", "0.95", "1")]
        title = f"{name} (ignored)" if name in found.ignored else name
        rows.append([title, *_summed([of[s] for s in splits]), *sizes])
    header = ["objects by class", *splits, "all", "size px min", "5 %", "50 %", "95 %", "max"]
    if rows:
        blocks.append(grid(header, rows) + "\n(size: square root of the box's area)")
    rows = [[p, *(found.coverage.get((p, a), "") for a in found.altitudes)] for p in found.pitches]
    blocks.append(grid(["images by pitch, altitude", *found.altitudes], rows))
    kinds = sorted({k for of in found.time_of_day.values() for k in of})
    rows = [[k, *_summed([found.time_of_day[s].get(k, 0) for s in splits])] for k in kinds]
    blocks.append(grid(["images by time of day", *splits, "all"], rows))
    blocks.append(table(_further(found)))
    if "flight" in found.notes:
        blocks.append(_flight(found.notes["flight"]))
    if found.overlap is not None:
        blocks.append(_overlap(found.overlap))
    if found.leakage:
        lines = [
            f"  {one.near} of {one.images} {one.split} images have a {one.other} image at most {one.distance} frame "
            "numbers away"
            for one in found.leakage
        ]
        blocks.append("\n".join(["neighbours across splits", *lines]))
    if found.remarks:
        blocks.append("\n".join(["known faults of this dataset", *(f"  - {r}" for r in found.remarks)]))
    return [*blocks, _problem_list(found)]


def _overlap(found: Sequence[OverlapValue] | str) -> str:
    if isinstance(found, str):
        return f"from overlap: nothing, as {found}"
    rows = [
        [
            v["name"],
            _value(v["value"]),
            f"{_value(v['low'])} to {_value(v['high'])}",
            "" if v["stated"] is None else _value(v["stated"]),
            "contradicts" if v["contradicts"] else "",
        ]
        for v in found
    ]
    shown = grid(["from overlap", "value", "95 %", "stated", ""], rows)
    return f"{shown}\n({found[0]['source']}; --metadata FILE sets the values of pictures)"


def _flight(note: Mapping[str, Any]) -> str:
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


def _further(found: Inspection) -> dict[str, str]:
    rows = {"labels": _listed(found.labels)}
    if found.sequences:
        mean = sum(found.sequences.values()) / len(found.sequences)
        rows["sequences"] = f"{len(found.sequences)}, {mean:.1f} images each on average, at most "
        rows["sequences"] += f"{max(found.sequences.values())}"
    if found.dates:
        rows["dates"] = _listed(found.dates)
    if found.tracks:
        mean = sum(found.tracks.values()) / len(found.tracks)
        rows["tracks"] = f"{len(found.tracks)}, {mean:.1f} objects each on average"
    rows["picture sizes"] = _listed(found.picture_sizes)
    if found.temperatures:
        rows["temperatures"] = _listed(found.temperatures)
    if found.decoded:
        rows["pictures"] = _listed(found.decoded["pictures"])
        rows["grey levels"] = ", ".join(f"{k} {v:g}" for k, v in found.decoded["grey_levels"].items())
        rows["surfaces"] = ", ".join(f"{k} {v:.2f}" for k, v in found.decoded["surfaces"].items() if v >= 0.005)
    return rows


def _listed(counts: Any) -> str:
    shown = [f"{k.replace('_', ' ')} {n}" for k, n in list(counts.items())[:SHOWN]]
    more = len(counts) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def _problem_list(found: Inspection) -> str:
    if not found.problems:
        return "no problems found in the labels; `infrablend check` also checks the pictures"
    kinds = [(k, [p for p in found.problems if p.severity == k]) for k in ("error", "warning")]
    alike = [f"  - {severity}: {line}" for severity, same in kinds for line in format_problems(same)]
    more = [f"  ... and {len(alike) - SHOWN} more; --json lists all"] if len(alike) > SHOWN else []
    return "\n".join([f"{len(found.problems)} problem(s)", *alike[:SHOWN], *more])


def check(
    session: JsonSession,
    *,
    data: DatasetArgument,
    strict: Annotated[bool, typer.Option("--strict", help="Treat warnings as errors.")] = False,
    no_decode: Annotated[bool, typer.Option("--no-decode", help="Read only the headers of the pictures.")] = False,
    reading: ReadingOptions,
) -> None:
    """List every problem of a dataset's labels and pictures; exit code 1 if there are errors."""
    with shown_progress(session, "checking") as on_progress:
        report = api.check(data, reading=reading, decode=not no_decode, on_progress=on_progress)
    show_result(session, report.to_json(), lambda: "\n".join(_check_lines(report)))
    if not report.ok(strict):
        raise typer.Exit(PARTIAL)


def _check_lines(report: CheckReport) -> list[str]:
    lines: list[str] = []
    for title, problems in (("errors", report.errors), ("warnings", report.warnings)):
        if problems:
            lines += [f"{len(problems)} {title if len(problems) > 1 else title[:-1]}"]
        for code in dict.fromkeys(p.code for p in problems):
            same = [p for p in problems if p.code == code]
            lines.append(f"  {code}: {len(same)}")
            alike = format_problems(same)
            lines += [f"    {line}" for line in alike[:SHOWN_EACH]]
            if len(alike) > SHOWN_EACH:
                lines.append(f"    ... and {len(alike) - SHOWN_EACH} more; --json lists all")
    how = "pictures decoded" if report.decoded else "pictures not decoded"
    kinds = f" ({', '.join(f'{n} {kind}' for kind, n in report.suffixes.items())})" if len(report.suffixes) > 1 else ""
    what = f"{report.format or 'unreadable'}, {report.images} images{kinds}, {report.objects} objects, {how}"
    totals = f"{len(report.errors)} error(s), {len(report.warnings)} warning(s)"
    return [*lines, f"{report.root}: {what}: {totals if report.problems else 'clean'}"]


def _renamed(texts: list[str] | None) -> dict[str, str]:
    return key_values([pair for text in texts or () for pair in split_at_commas(text)], "--rename")


def convert(
    session: JsonSession,
    *,
    source: Annotated[Path, typer.Argument(metavar="SRC", help="Folder of the dataset to read, or a video.")],
    out: Annotated[Path, typer.Argument(metavar="DST", help="Folder to write.")],
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT", help="Format to write: yolo, coco, ... or native.", autocompletion=complete_written_format
        ),
    ],
    reading: ReadingOptions,
    classes: Annotated[
        api.ClassChanges,
        Fields(
            rename=Annotated[list[str] | None, typer.Option(metavar="OLD=NEW,..."), _renamed],
            drop=typer.Option("--drop-class"),
            only=typer.Option("--only-class", metavar="NAME"),
        ),
    ],
    selection: Annotated[
        api.Selection,
        Fields(
            with_class=typer.Option(metavar="NAME"),
            images=typer.Option(metavar="N"),
            objects=typer.Option(metavar="N"),
            like=typer.Option("--like-class", metavar="NAME"),
            seed=typer.Option(metavar="N"),
        ),
    ],
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
    writing: Annotated[api.WriteSettings, Fields("ids category_ids dont_care without_mask")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier conversion in DST.")] = False,
) -> None:
    """Write a dataset in another format; pictures are linked, and every loss is counted and reported."""
    report = api.convert(
        source,
        out,
        to,
        reading=reading,
        classes=classes,
        selection=selection,
        loosen=loosen,
        loosen_px=loosen_px,
        writing=writing,
        overwrite=overwrite,
    )
    record = report.out / "convert.json"
    show_report(session, report, record, report.to_json(), lambda: "\n".join(_conversion_lines(report)))


def _conversion_lines(report: api.ConvertReport) -> list[str]:
    rows = facts({k: v for k, v in report.counts.items() if k != "selection"})
    selection: SelectionFacts | None = report.counts.get("selection")
    if selection:
        rows["selection"] = _selection_text(selection)
    return [table(rows), *loss_lines(report.losses), str(report.out)]


def _selection_text(selection: SelectionFacts) -> str:
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


def _shares(text: str) -> list[float]:
    try:
        wanted = [float(part) for part in text.split(",")]
    except ValueError:
        wanted = []
    if len(wanted) != 3:
        raise typer.BadParameter(f"{text!r}: three numbers, such as 0.7,0.1,0.2")
    return wanted


def split(
    session: JsonSession,
    *,
    data: DatasetArgument,
    out: Annotated[Path, typer.Argument(metavar="DST", help="Folder to write.")],
    rule: Annotated[
        api.SplitRule,
        Fields(
            gap=typer.Option(min=1, metavar="N"), shares=Annotated[Any, typer.Option(metavar="LIST", parser=_shares)]
        ),
    ],
    to: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Format to write [default: that of the dataset].",
            autocompletion=complete_written_format,
        ),
    ] = None,
    lists: Annotated[bool, typer.Option("--list", help="Write only three lists of pictures and split.json.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier split dataset in DST.")] = False,
    reading: ReadingOfAllSplits,
) -> None:
    """Write a dataset with new splits that do not share neighbouring frames; pictures are hard links."""
    if rule.gap is not None and rule.by not in ("gap", "time"):
        raise typer.BadParameter("--gap goes with --by gap or --by time", param_hint="--gap")
    if to is not None and lists:
        raise typer.BadParameter("--list writes no dataset; leave out --to", param_hint="--to")
    report = api.split(data, out, rule, to=to or "native", lists=lists, reading=reading, overwrite=overwrite)
    for problem in report.problems:
        typer.echo(printable(f"{problem.severity}: {problem}"), err=True)
    show_result(session, {"out": str(report.out)} | report.to_json(), lambda: "\n\n".join(_split_blocks(report)))


def _split_blocks(report: api.SplitReport) -> list[str]:
    splits = list(report.images)
    rows = []
    for name, of in {"images": report.images, **report.objects}.items():
        shares = report.shares(of)
        rows.append([name, *(f"{of[s]} ({100 * shares[s]:.1f} %)" for s in splits)])
    wanted = ["wanted", *(f"{100 * w:.1f} %" for w in report.wanted)]
    blocks = [f"{len(report.groups)} groups by {report.by}", grid(["", *splits], [wanted, *rows])]
    # What was grouped by the numbers can only be apart by the same numbers.
    by_itself = report.by == "gap" and all(one.distance <= report.gap for one in report.after)
    after = {} if by_itself else {(one.split, one.other): one for one in report.after}
    near = []
    for one in report.before:
        then = after.get((one.split, one.other))
        near.append(
            [
                f"{one.split} near {one.other}",
                _near(one.near, one.images),
                _near(then.near, then.images) if then else "-",
            ]
        )
    if not near and not by_itself:
        near = [[f"{one.split} near {one.other}", "-", _near(one.near, one.images)] for one in report.after]
    if near:
        blocks.append(grid(["neighbours (at most 5 frames away)", "before", "after"], near))
    if by_itself:
        blocks.append(
            "neighbours after: not counted, the groups come from the same numbers; look at some groups in split.json"
        )
    if report.losses:
        blocks.append("\n".join(loss_lines(report.losses)))
    return [*blocks, f"{report.out}: {report.format}, {report.files} files"]


def _near(near: int, images: int) -> str:
    return f"{near} of {images}"


def fetch(
    session: JsonSession,
    *,
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Dataset, see --list.", autocompletion=complete_source)
    ] = None,
    out: Annotated[Path | None, typer.Argument(metavar="DST", help="Output folder: new, or an earlier DST.")] = None,
    part: Annotated[
        Any, typer.Option(metavar="LIST", parser=comma_list, help="Parts to fetch, see --list [default: all].")
    ] = None,
    url: Annotated[str | None, typer.Option(metavar="URL", help="Fetch the file from this address instead.")] = None,
    sha256: Annotated[str | None, typer.Option(metavar="HEX", help="Required SHA-256 of the file.")] = None,
    archive: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Unpack this file instead of fetching it.")
    ] = None,
    keep_archive: Annotated[bool, typer.Option("--keep-archive", help="Keep the archive in DST.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="List the datasets and their licences.")] = False,
) -> None:
    """Fetch a public dataset; without DST, show its address and licence.

    Repeat the command with another --part to add it to DST.
    """
    if listing:
        sources = api.list_sources()
        rows = {s.name: _line(s) for s in sources}
        show_result(session, [asdict(s) for s in sources], lambda: table(rows))
        return
    if name is None:
        raise typer.BadParameter("give the NAME of a dataset, or --list", param_hint="NAME")
    if out is None:
        print_result(api.describe_source(name))
        return
    typer.echo(api.describe_source(name, licence_only=True), err=True)
    request = api.FetchRequest(part, url, sha256, archive, keep_archive)
    with shown_fetch(session) as on_progress:
        report = api.fetch(name, out, request, on_progress=on_progress)
    if report.problems:
        lines = problem_lines(report.problems, session.log_path)
        typer.echo("\n".join([f"{len(report.problems)} warning(s):", *lines]), err=True)
    wanted = ("fetched", "present", "files", "size_bytes")
    brief = facts({k: v for k, v in report.to_json().items() if k in wanted})
    show_result(session, report.to_json(), lambda: f"{table(brief)}\n{report.out}")


def _line(source: api.SourceEntry) -> str:
    how = "fetched" if source.fetched else "by hand"
    several = f", parts {','.join(source.parts)}" if len(source.parts) > 1 else ""
    return f"{how}, licence {source.licence}{several}  {source.page}"
