"""The page of original objects that lost their labels, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from nicegui import ui

from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.pages.layout import show_table, when_read

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
    show_table(("Frame", "Class", "Reason", "Covered"), [_cells(*one) for one in found[:_SHOWN]])
    if len(found) > _SHOWN:
        ui.label(f"and {len(found) - _SHOWN} more; run.json and the records of the frames have all").classes("faint")


def _cells(number: int, frame_id: str, loss: Mapping[str, Any]) -> list[str | tuple[str, str]]:
    reason, share = str(loss.get("reason", "")), loss.get("covered_share")
    covered = f"{100 * share:.0f} %" if isinstance(share, int | float) else ""
    return [(frame_id, f"/review?frame={number}"), str(loss.get("category", "")), REASONS.get(reason, reason), covered]
