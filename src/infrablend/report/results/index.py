"""The index of all results pages in a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend.core.files import load_json
from infrablend.report.figures import markdown_table
from infrablend.report.results.text import figure, paper_and_ours, run_state

INTRO = (
    "Each page is written by `infrablend experiment`, never by hand, and that includes negative and unfinished results."
)
_HOW_TO = Path("how_to/experiments.md")
_REALISM = "realism.md"


def index_text(out: Path) -> str:
    """Return the page that lists all results in a folder, as Markdown."""
    rows = []
    for path in sorted(out.glob("*.json")):
        try:
            rows.append(_row(load_json(path), path.stem))
        except (OSError, ValueError, KeyError, TypeError):
            continue  # not one of ours
    intro = INTRO
    if (out.parent / _HOW_TO).is_file():  # InfraBlend's own documentation
        intro += f" How to run the experiments: [experiments](../{_HOW_TO.as_posix()})."
    if (out / _REALISM).is_file():
        intro += f" `infrablend realism` writes the page on [inserted and real objects side by side]({_REALISM})."
    head = ["Experiment", "Scale", "Status", "First row, mAP50: paper → ours", "Conclusions that hold"]
    return "\n\n".join(["# Results", intro, markdown_table(head, rows) if rows else "No results yet."]) + "\n"


def _row(facts: Mapping[str, Any], stem: str) -> list[str]:
    verdicts = [c["holds"] for c in facts["checks"] if c["holds"] is not None]
    return [
        f"[{facts['title']}]({stem}.md)",
        facts["scale"],
        run_state(facts),
        _headline(facts),
        f"{verdicts.count(True)} of {len(verdicts)}" if verdicts else "-",
    ]


def _headline(facts: Mapping[str, Any]) -> str:
    """Return the mAP50 of the first row of the first table."""
    for table in facts["tables"]:
        for r in table["rows"]:
            ours = figure((r["ours"] or {}).get("map50"))
            return f"{r['title']}: {paper_and_ours(figure(r['paper']['map50']), ours)}"
    return "-"
