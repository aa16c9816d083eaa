"""Commands about cameras and their pictures: `frames`, `temperatures`, `camera`, `profile`, `motion` and `places`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from infrablend import api
from infrablend.cli.exits import PARTIAL, problem_lines
from infrablend.cli.options import (
    DatasetArgument,
    Fields,
    JsonSession,
    ReadingOfPictures,
    ReadingOfSplits,
    ReadingOptions,
    reported,
)
from infrablend.cli.output import grid, show_report, show_result, shown_progress, table
from infrablend.core.surface_kinds import SURFACES
from infrablend.report.figures import human_seconds

if TYPE_CHECKING:
    from infrablend.api import CameraEstimate
    from infrablend.pipeline.extraction.temperature_pictures import TemperaturesReport
    from infrablend.pipeline.extraction.video_frames import Clip
    from infrablend.pipeline.studies.profile import ObjectFigures, ProfileReport
    from infrablend.pipeline.studies.surface_maps import LearnedReport


def frames(
    session: JsonSession,
    *,
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO...", help="Video files; each becomes a sequence.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset folder to write.")],
    choice: Annotated[
        api.FrameChoice,
        Fields(
            every=typer.Option(metavar="STEP"), start=typer.Option(metavar="TIME"), end=typer.Option(metavar="TIME")
        ),
    ],
    flight: Annotated[
        api.FlightFacts,
        Fields(
            "log time_of_day hfov_deg names",
            log=typer.Option(metavar="FILE"),
            time_of_day=typer.Option("--time"),
            hfov_deg=typer.Option("--hfov", min=0.1, max=170, metavar="DEGREES"),
            names=typer.Option("--sequence"),
        ),
    ],
    no_log: Annotated[bool, typer.Option("--no-log", help="Extract without telemetry.")] = False,
    clock: Annotated[
        api.Clock,
        Fields(
            offset_s=typer.Option("--offset", metavar="SECONDS"),
            log_start_s=typer.Option("--log-start", metavar="SECONDS"),
        ),
    ],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier extraction in DIR.")] = False,
) -> None:
    """Extract frames of videos as PNG, with pitch, height and time from subtitles or a flight log."""
    from infrablend.core.workspace import FRAMES_FILE

    if no_log and flight.log is not None:
        raise typer.BadParameter("--log and --no-log exclude each other; give one of them", param_hint="--no-log")
    flight = replace(flight, use_log=not no_log, clock=clock)
    with shown_progress(session, "extracting") as on_progress:
        report = api.extract_frames(videos, out, choice, flight, overwrite=overwrite, on_progress=on_progress)
    data = {"out": str(out), **report.to_json()}
    clips = (_clip(clip) for clip in report.clips)
    show_report(session, report, out / FRAMES_FILE, data, lambda: "\n\n".join([*clips, str(out)]))


def _clip(clip: Clip) -> str:
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


def temperatures(
    session: JsonSession,
    *,
    data: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset folder to write.")],
    scale: Annotated[
        api.CountScale,
        Fields(
            slope_k=typer.Option("--slope"),
            offset_k=typer.Option("--offset"),
            spots=Annotated[
                list[Any] | None,
                typer.Option("--spot", metavar="FILE:X,Y=DEGREES", parser=reported(api.Spot.of_text)),
                tuple,
            ],
            converted=typer.Option(metavar="DIR"),
            unit=typer.Option("--converted-unit"),
        ),
    ],
    reading: ReadingOfSplits,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier extraction in DIR.")] = False,
) -> None:
    """Extract the radiometric layers of DJI and FLIR pictures as 16-bit PNG with their temperature scale."""
    from infrablend.core.workspace import TEMPERATURES_FILE

    with shown_progress(session, "extracting") as on_progress:
        report = api.extract_temperatures(
            data, out, scale, reading=reading, overwrite=overwrite, on_progress=on_progress
        )
    found = {"out": str(out), **report.to_json()}
    show_report(session, report, out / TEMPERATURES_FILE, found, lambda: f"{table(_temperatures(report))}\n\n{out}")


def _temperatures(report: TemperaturesReport) -> dict[str, str]:
    rows = {"pictures": str(report.pictures), **{text: str(n) for text, n in report.scales.items()}}
    if report.range_k is not None:
        low, high = (k - 273.15 for k in report.range_k)
        rows["apparent temperatures"] = f"{low:.1f} to {high:.1f} degrees Celsius"
    for s in report.spots:
        rows[f"{s.spot.file}:{s.spot.xy[0]},{s.spot.xy[1]}={s.spot.celsius:g}"] = s.describe()
    return rows


def camera(
    session: JsonSession,
    *,
    data: DatasetArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Table to write for --metadata, such as metadata.csv; beside it FILE.png, the ground."
        ),
    ] = None,
    settings: Annotated[
        api.CameraSettings, Fields(hfov_deg=typer.Option("--hfov", min=0.1, max=170, metavar="DEGREES"))
    ],
    reading: ReadingOptions,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier table.")] = False,
) -> None:
    """Estimate pitch, roll, height and lens of each sequence's camera from labelled people, cars and bicycles.

    What the data state, the horizon, upright lines and the overlap of flights are compared with it.
    """
    with shown_progress(session, "looking") as on_progress:
        report = api.estimate_camera(data, out, settings, reading=reading, overwrite=overwrite, on_progress=on_progress)
    written = [str(path) for path in report.written]
    blocks = (_camera(one) for one in report.cameras)
    record = session.log_path or Path()
    show_report(session, report, record, report.to_json(), lambda: "\n\n".join([*blocks, *written]))


def _camera(found: CameraEstimate) -> str:
    how = "turns" if found.turns else "is still, or states how it moves"
    rows = [[v.name, v.source, f"{v.value:g}", f"+- {v.half:g}", v.verdict] for v in found.values]
    sizes = [
        [kind, s.boxes, s.objects, f"{s.offset:+.1%}", f"{s.error:.1%}", s.outlying] for kind, s in found.sizes.items()
    ]
    left_out = [f"left out: {', '.join(f'{n} {reason}' for reason, n in found.left_out.items())}"]
    return "\n".join(
        [
            f"{found.name}: {found.known} of {found.pictures} pictures; the camera {how}",
            grid(["value", "by", "median", "95 %", ""], rows),
            grid(["labels", "boxes", "objects", "larger by", "error", "other sizes"], sizes),
            *(left_out if found.left_out else []),
        ]
    )


def profile(
    session: JsonSession,
    *,
    data: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of pictures or of a dataset.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for profile.json and profile.png.")],
    count: Annotated[int, typer.Option(min=1, help="Number of pictures to fit the camera to, evenly spread.")] = 64,
    time: Annotated[
        Literal["day", "night"] | None, typer.Option(help="Use only pictures taken by day or by night.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the profile [default: that of the folder].")] = None,
    against: Annotated[
        str | None, typer.Option(metavar="PROFILE", help="Shipped profile to compare with, e.g. hit-uav.")
    ] = None,
    rendered: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Run with inserted objects, to correct the looseness of boxes with."),
    ] = None,
    reading: ReadingOfPictures,
) -> None:
    """Measure a camera's sharpness, sharpening, grain, levels and codec in its pictures; write a sensor profile.

    Where objects are annotated, also how far grey levels follow the neighbourhood, and how loose the boxes are.
    """
    with shown_progress(session, "reading") as on_progress:
        report = api.profile(
            data,
            out,
            count=count,
            time=time,
            name=name,
            against=against,
            rendered=rendered,
            reading=reading,
            on_progress=on_progress,
        )
    show_result(session, report.to_json(), lambda: "\n".join(_profile_lines(report)))
    if report.problems:
        typer.echo("\n".join(problem_lines(report.problems, session.log_path)), err=True)
        raise typer.Exit(PARTIAL)


def _profile_lines(report: ProfileReport) -> list[str]:
    rows = [[what, *cells] for what, cells in report.rows]
    fit = grid(["", *report.columns], rows)
    return [fit, *_object_lines(report.objects), str(report.path), str(report.plot)]


def _object_lines(objects: ObjectFigures) -> list[str]:
    lines = []
    for time, share in objects["local_share"].items():
        bound = f"at most {share['upper_bound']:.2f} ({share['ci'][0]:.2f} to {share['ci'][1]:.2f})"
        fields = {"night": "matching.local_share", "day": "matching.local_share_day"}
        field = fields.get(time, "matching.local_share")
        lines.append(f"local share of the camera, {time}: {bound}; for recipes: {field}={share['recommended']}")
    for category, boxes in objects["box_looseness"].items():
        factor = f"{boxes['factor']:.2f} ({boxes['ci'][0]:.2f} to {boxes['ci'][1]:.2f})"
        margin = f"{boxes['margin_px']:.1f} px on each side"
        line = f"boxes of {category}: {factor} times the visible extent, or wider by {margin}; {boxes['n']:,} boxes"
        if against := boxes.get("against_rendered"):
            corrected = f"{against['factor']:.2f} ({against['ci'][0]:.2f} to {against['ci'][1]:.2f})"
            line += f"; {corrected} times the boxes of inserted objects (labels.loosen)"
            line += f", or wider by {max(against['margin_px'], 0.0):.1f} px on each side (labels.loosen_px)"
            line += f"; the {against['better']} fits better"
        else:
            line += "; not for recipes, as parts that cannot be seen are beyond this extent: see --rendered"
        lines.append(line)
    return lines


def map_places(
    session: JsonSession,
    *,
    data: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the maps and the sheet.")],
    reading: ReadingOfSplits,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier maps in DIR.")] = False,
) -> None:
    """Write maps of where objects can stand and drive in each picture, and a sheet of the surfaces."""
    with shown_progress(session, "mapping") as on_progress:
        report = api.map_places(data, out, reading=reading, overwrite=overwrite, on_progress=on_progress)
    facts_ = {"maps": str(report.maps), "surfaces": ", ".join(f"{k} {v:.2f}" for k, v in report.surfaces.items())}
    show_report(session, report, out / "places.json", report.to_json(), lambda: f"{table(facts_)}\n{out}")


def find_motion(
    session: JsonSession,
    *,
    data: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for a JSON file and a page per sequence.")],
    reading: ReadingOptions,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier movements in DIR.")] = False,
) -> None:
    """Find how the camera moves through each sequence, from the background of its pictures."""
    with shown_progress(session, "following") as on_progress:
        report = api.find_motion(data, out, reading=reading, overwrite=overwrite, on_progress=on_progress)
    rows = {name: ", ".join(f"{state} {n}" for state, n in states.items()) for name, states in report.sequences.items()}
    show_report(session, report, out / "motion.json", report.to_json(), lambda: f"{table(rows)}\n{out}")


def learn_places(
    session: JsonSession,
    *,
    data: DatasetArgument,
    count: Annotated[int, typer.Option(min=1, help="Number of pictures to read, spread over those with labels.")] = 200,
    reading: ReadingOfSplits,
) -> None:
    """Show on which kinds of ground the labelled objects are; recipes of metric placement use it by themselves."""
    with shown_progress(session, "learning") as on_progress:
        report = api.learn_places(data, count=count, reading=reading, on_progress=on_progress)
    show_report(session, report, session.log_path or Path(), report.to_json(), lambda: _learned_table(report))


def _learned_table(report: LearnedReport) -> str:
    kinds = [k for k in SURFACES if any(g.around[k] >= 0.01 for t in report.ground.values() for g in t.values())]
    rows = [
        (
            name,
            time,
            g.objects,
            *(f"{g.around[k]:.2f}" + (f" ({g.factors[k]:g}x)" if k in g.factors else "") for k in kinds),
        )
        for name, by_time in report.ground.items()
        for time, g in by_time.items()
    ]
    return f"{report.pictures} pictures; around objects, and times as often as anywhere\n" + grid(
        ("class", "time", "objects", *kinds), rows
    )
