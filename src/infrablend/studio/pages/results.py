"""The reports of a run: figures and plots of `realism`, `evaluate` and `experiment`, as far as they were run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nicegui import ui
from starlette.responses import PlainTextResponse, Response

from infrablend.errors import DatasetError
from infrablend.studio.pages.run_routes import KEEP
from infrablend.studio.results import ResultReport, ResultTable, find_results

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
        with ui.element("h2"):
            ui.label(report.title)
        for line in report.lines:
            ui.label(line)
        for table in report.tables:
            _build_table(table)
        with ui.element("div").classes("result-plots"):
            for k, path in enumerate(report.pictures):
                with ui.element("figure"):
                    shown = ui.element("img")
                    shown.props["alt"], shown.props["src"] = path.stem.replace("_", " "), f"/results/{number}/{k}"
                    shown.props["loading"] = "lazy"
                    with ui.element("figcaption").classes("faint"):
                        ui.label(path.name)


def _build_table(table: ResultTable) -> None:
    with ui.element("h3"):
        ui.label(table.title)
    with ui.element("div").classes("scroll-x").props("tabindex=0"), ui.element("table").classes("plain figures"):
        with ui.element("thead"), ui.element("tr"):
            for name in table.head:
                with ui.element("th").props("scope=col"):
                    ui.label(name)
        with ui.element("tbody"):
            for row in table.rows:
                with ui.element("tr"):
                    for text in row:
                        with ui.element("td"):
                            ui.label(text)
