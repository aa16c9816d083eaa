"""`infrablend frames`: extract frames of videos, with telemetry from subtitles or flight logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.options import JsonOption, comma_list
from infrablend.cli.profile import Time

if TYPE_CHECKING:
    from infrablend.pipeline.extraction.report import Clip


def frames(
    ctx: typer.Context,
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO...", help="Video files; each becomes a sequence.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset folder to write.")],
    every: Annotated[str, typer.Option(metavar="STEP", help="Step: 2s or 500ms, or 60f for every 60th frame.")] = "2s",
    start: Annotated[str, typer.Option(metavar="TIME", help="Time of the first frame: seconds or [h:]m:s.")] = "",
    end: Annotated[str, typer.Option(metavar="TIME", help="Take no frame after this time.")] = "",
    log: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="DJI subtitles (.SRT), AirData CSV or DJI flight record CSV [default: subtitles beside the video].",
        ),
    ] = None,
    no_log: Annotated[bool, typer.Option("--no-log", help="Extract without telemetry.")] = False,
    offset: Annotated[
        float, typer.Option(metavar="SECONDS", help="Seconds to add to the video's time to get the log's time.")
    ] = 0.0,
    log_start: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Second of a flight log at which the video starts [default: found]."),
    ] = None,
    time: Annotated[
        Time | None, typer.Option(help="Time of day of the flight [default: by the sun, where known].")
    ] = None,
    hfov: Annotated[
        float | None,
        typer.Option(
            min=0.1, max=170, metavar="DEGREES", help="Field of view across the width of the video, for the table."
        ),
    ] = None,
    sequence: Annotated[
        str | None, typer.Option(metavar="LIST", help="Names of the sequences [default: names of the videos].")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier extraction in DIR.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Extract frames of videos as PNG, with pitch, height and time from subtitles or a flight log."""
    if no_log and log is not None:
        raise typer.BadParameter("--log and --no-log exclude each other; give one of them", param_hint="--no-log")
    ctx.obj.json = as_json

    from infrablend import api
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_json, print_problems, print_result
    from infrablend.core.finished import FRAMES_FILE
    from infrablend.formats.log_alignment import Clock
    from infrablend.pipeline.extraction.clips import FlightFacts, FrameChoice

    flight = FlightFacts(
        log, not no_log, Clock(offset, log_start), None if time is None else time.value, hfov,
        comma_list(sequence, "--sequence") or (),
    )  # fmt: skip
    with shown_progress(ctx.obj, "extracting") as on_progress:
        report = api.extract_frames(
            videos, out, FrameChoice(every, start, end), flight, overwrite=overwrite, on_progress=on_progress
        )
    print_problems(report.problems, ctx.obj.log_path, out / FRAMES_FILE)
    if as_json:
        print_json({"out": str(out), **report.to_json()})
    else:
        print_result("\n\n".join(_block(clip) for clip in report.clips) + f"\n\n{out}")
    if not report.ok:
        raise typer.Exit(PARTIAL)


def _block(clip: Clip) -> str:
    """Return the lines on one video."""
    from infrablend.cli.results import table
    from infrablend.report.figures import human_seconds

    facts = clip.facts
    width, height = facts["size_wh"]
    kind = "in colour" if clip.colour == clip.frames else "grey" if not clip.colour else f"{clip.colour} in colour"
    rows = {
        "video": f"{clip.video.name}: {width}x{height}, {facts['codec']}, {facts['frames']} frames, "
        f"{human_seconds(facts['duration_s'])}" + (", varying rate" if facts["variable_rate"] else ""),
        "extracted": f"{clip.frames} frames, {kind}, sequence {clip.sequence}",
    }
    if clip.coverage is None:
        rows["telemetry"] = "none"
        return table(rows)
    c = clip.coverage
    rows["telemetry"] = f"{clip.log['name']} ({clip.log['kind']}), matched by {clip.log['matched_by']}"
    rows["covered"] = (
        f"{c.inside} frames; {c.before} before the log, {c.after} after it, {c.in_gaps} in gaps; largest gap "
        f"{c.largest_gap_s:.2f} s"
    )
    known = [f"{name} {n}" for name, n in clip.known.items() if n]
    rows["known"] = ", ".join(known) or "nothing"
    if clip.log["height"]:
        rows["height from"] = clip.log["height"]
    return table(rows)
