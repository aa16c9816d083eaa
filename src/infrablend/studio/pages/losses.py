"""The page of original objects that lost their labels, and why."""

from __future__ import annotations

from collections import Counter

from nicegui import ui

from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.pages.layout import when_read

REASONS = {
    "covered": "covered completely by inserted objects",
    "category": "its class is not kept (labels.keep_categories)",
    "labels": "left out by the choice of labels.mode",
}
_SHOWN = 500


def build(run: OpenedRun) -> None:
    """Show the losses, each with a link to its frame."""
    when_read(run, lambda: _show(run))


def _show(run: OpenedRun) -> None:
    found = [(n, row.id, loss) for n, row in enumerate(run.rows) for loss in row.removed]
    ui.html("<h2>Original labels that the run removed</h2>", sanitize=False)
    if not found:
        ui.label("No original object lost its label.")
        return
    counts = Counter(str(loss.get("reason", "unknown")) for _, _, loss in found)
    for reason, count in counts.most_common():
        ui.label(f"{count} {REASONS.get(reason, reason)}")
    with ui.element("div").classes("scroll-x"), ui.element("table").classes("plain"):
        with ui.element("thead"), ui.element("tr"):
            for name in ("Frame", "Class", "Reason", "Covered"):
                with ui.element("th").props("scope=col"):
                    ui.label(name)
        with ui.element("tbody"):
            for number, frame_id, loss in found[:_SHOWN]:
                share = loss.get("covered_share")
                cells = (
                    str(loss.get("category", "")),
                    REASONS.get(str(loss.get("reason")), str(loss.get("reason", ""))),
                    f"{100 * share:.0f} %" if isinstance(share, int | float) else "",
                )
                with ui.element("tr"):
                    with ui.element("td"):
                        ui.link(frame_id, f"/review?frame={number}")
                    for text in cells:
                        with ui.element("td"):
                            ui.label(text)
    if len(found) > _SHOWN:
        ui.label(f"and {len(found) - _SHOWN} more; run.json and the records of the frames have all").classes("faint")
