"""The reports of a run: figures and plots of `realism`, `evaluate` and `experiment`, as far as they were run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nicegui import ui
from starlette.responses import PlainTextResponse, Response

from infrablend.errors import DatasetError
from infrablend.studio.found_results import ResultReport, find_results
from infrablend.studio.pages.layout import show_heading, show_picture, show_table
from infrablend.studio.pages.routes import KEEP

_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}


def picture(run: Path, further: Sequence[Path], report: int, number: int) -> Response:
    """Return a picture of a report. Both are named by number, so that no path comes from a request."""
    try:
        data, suffix = find_results(run, further).picture(report, number)
    except DatasetError as error:
        return PlainTextResponse(error.message, 404)
    return Response(data, media_type=_TYPES[suffix], headers=KEEP)


def build(run: Path, data: str, further: Sequence[Path]) -> None:
    """Show all reports, or the commands that write them."""
    found = find_results(run, further)
    ui.html("<h2>Results</h2>", sanitize=False)
    for text in found.unreadable:
        ui.label(text).classes("studio-error").props("role=alert")
    for number, report in enumerate(found.reports):
        _build_report(number, report)
    if not found.reports:
        ui.label("This run has no report yet. These commands write one:")
    else:
        ui.label("Further reports are written by:").classes("faint")
    for text in (
        f"infrablend realism {run} --against {data}",
        f"infrablend evaluate WEIGHTS {run} --out EVALUATION",
        f"infrablend studio --run {run} --results EVALUATION",
    ):
        ui.label(text).classes("tune-command")
    ui.label(
        "The page shows the reports in the folder of the run, where realism is written, and those in the folders that "
        "--results names: of an evaluation, or of the page of an experiment."
    ).classes("faint")


def _build_report(number: int, report: ResultReport) -> None:
    section = ui.element("section").classes("studio-card w-full")
    section.props["aria-label"] = report.title
    with section:
        show_heading(2, report.title)
        for line in report.lines:
            ui.label(line)
        for table in report.tables:
            show_heading(3, table.title)
            show_table(table.head, table.rows, "plain figures")
        with ui.element("div").classes("result-plots"):
            for k, path in enumerate(report.pictures):
                show_picture(f"/results/{number}/{k}", path.stem.replace("_", " "), path.name)
