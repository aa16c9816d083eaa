"""The page on what must not matter: a detector's figures under changes of the same pictures."""

from __future__ import annotations

from typing import Final

import numpy as np

from infrablend.lab.evaluation.evaluation_record import EvaluationRecord, StressFacts
from infrablend.report.charts import BLUE, ORANGE, legend, pair_of_panels, png_bytes
from infrablend.report.figures import decimals
from infrablend.report.page import Table, render_page

STRESS_PAGE: Final = "stress.html"


def stress_table(stress: StressFacts, name: str = "all") -> Table:
    """Return the figures of a class, or of `all`, without a change and under each one."""
    rows = []
    for of in stress["changes"]:
        row = of["classes"][name]
        shares = (row["map50"], row["map10"], row["found"], row["named"], row["false_alarms"])
        rows.append([of["change"], str(row["objects"]), *map(decimals, shares)])
    return Table(
        ["change", "objects", "AP50", "AP10", "found", "named", "false alarms a picture"],
        rows,
        f"{name}: the same pictures under changes that must not matter, at confidence {stress['confidence']:.3f}",
    )


def draw_stress(stress: StressFacts) -> bytes:
    """Return a chart of AP, and of the shares found and named, under each change; lines are those without one."""
    of_all = {of["change"]: of["classes"]["all"] for of in stress["changes"]}
    figure, (left, right), places = pair_of_panels([*of_all], 0.22)
    for ax, colour, label, values in (
        (left, BLUE, "AP50", [row["map50"] for row in of_all.values()]),
        (left, ORANGE, "AP10", [row["map10"] for row in of_all.values()]),
        (right, BLUE, "found", [row["found"] for row in of_all.values()]),
        (right, ORANGE, "named, of found", [row["named"] for row in of_all.values()]),
    ):
        known = np.array(values, np.float64)  # NaN where there is none, which is not drawn
        ax.plot(known, places, "o", ms=4, color=colour, label=label)
        ax.axvline(known[0], color=colour, lw=0.8, alpha=0.6)
        ax.set_xlim(-0.02, 1.02)
        legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return png_bytes(figure)


def stress_page(facts: EvaluationRecord) -> str:
    """Return the HTML page; the same facts give the same bytes."""
    stress = facts["stress"]
    names = [n for n, row in stress["changes"][0]["classes"].items() if row["objects"]]
    return render_page(
        "stress",
        __package__,
        title="What must not matter",
        facts=facts,
        tables=[stress_table(stress, n) for n in (names if len(names) > 2 else names[:1])],
        crops=[of for of in stress["changes"] if of["objects_cut"] or of["objects_outside"]],
        chart=draw_stress(stress),
    )
