"""The page of `detectability`: how likely objects are found, by size and condition, and whether that can be trusted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from infrablend.detection.detectability_record import AreaRow, DetectabilityFacts, RecallFacts
from infrablend.report.charts import BLUE, ORANGE, estimate, legend, panels, plot_text, png_bytes
from infrablend.report.figures import decimals, interval
from infrablend.report.page import Table, render_page

PAGE: Final = "detectability.html"

_NOT_COUNTED: Mapping[str, str] = {
    "on_a_detection": "on something that the detector already finds there, which may be real",
    "of_no_real_size": "of a size that no real object has",
    "without_label": "without a label: hidden, outside, or covered by another one",
    "without_place": "for which there was no place in the picture, or none where they could be seen",
}


def recall_table(rows: Sequence[tuple[Sequence[str], RecallFacts]], names: Sequence[str], title: str) -> Table:
    """Return shares of inserted and real objects found; `names` head the first cells, which each row brings."""
    head = [*names, "inserted", "found", "95 %"]
    with_real = any("actual" in row for _, row in rows)
    if with_real:
        head += ["real", "found", "95 %", "difference", "95 %"]
    lines = []
    for cells, row in rows:
        line = [*cells, str(row["inserted"])]
        line += [decimals(row["predicted"]), interval((row["low"], row["high"]))]
        if "actual" in row:
            line += [str(row["real"]), decimals(row["actual"]), interval((row["actual_low"], row["actual_high"]))]
            apart = row.get("difference")
            line += [f"{apart[0]:+.3f}", interval(apart[1:], signed=True)] if apart else ["", ""]
        elif with_real:
            line += [""] * 5
        lines.append(line)
    return Table(head, lines, title)


def trust_text(facts: DetectabilityFacts) -> str:
    """Return whether the prediction can be trusted in these pictures; empty without enough real objects."""
    recall = facts["recall"]
    apart = recall.get("difference")
    if not apart or recall["real"] < 40:
        return ""
    cells = [c for c in facts["cells"] if c.get("real", 0) >= 40 and c.get("difference")]
    hold = sum(c["difference"][1] <= 0 <= c["difference"][2] for c in cells)
    text = (
        f"Of {recall['real']} real objects {decimals(recall['actual'])} are found, predicted were "
        f"{decimals(recall['predicted'])}: a difference of {apart[0]:+.3f} {interval(apart[1:], signed=True)}. "
    )
    if cells:
        text += f"The interval of the difference holds 0 in {hold} of {len(cells)} conditions with 40 real objects. "
    agrees = apart[1] <= 0 <= apart[2]
    return text + (
        "The prediction agrees with the real objects here."
        if agrees
        else "The prediction does not agree with the real objects here: trust it no further than this difference."
    )


def drawn_text(facts: DetectabilityFacts) -> str:
    """Return the range of the share found over the air and clothing drawn; empty if neither varies."""
    cells = [c for c in facts["cells"] if c["by"] in ("air", "clothing") and c["predicted"] is not None]
    if len(cells) < 2:
        return ""
    ordered = sorted(cells, key=lambda c: c["predicted"] or 0.0)
    least, most = (
        f"{decimals(c['predicted'])} [{interval((c['low'], c['high']))}] with {c['by']} {c['value']}"
        for c in (ordered[0], ordered[-1])
    )
    return f"Over the weather and clothing drawn, the share found is between {least} and {most}."


def draw_shares(facts: DetectabilityFacts) -> bytes:
    """Return a chart of the shares found, with intervals: by size on the left, by the other conditions on the right."""
    cells = facts["cells"]
    by_size = [c for c in cells if c["by"] == "size"]
    others = [c for c in cells if c["by"] not in ("size", "time, size")]
    rows = max(len(by_size), len(others), 1)
    figure, axes = panels(1, 2, (9, 1.0 + 0.22 * rows))
    for ax, of in zip(axes, (by_size, others), strict=True):
        places = range(len(of))[::-1]
        for at, cell in zip(places, of, strict=True):
            estimate(ax, cell["predicted"], (cell["low"], cell["high"]), at, color=BLUE)
            if "actual" in cell:
                estimate(ax, cell["actual"], (cell["actual_low"], cell["actual_high"]), at - 0.3, color=ORANGE)
        names = [c["value"] if c["by"] == "size" else f"{c['by']}: {c['value']}" for c in of]
        ax.set_yticks(places, [plot_text(n) for n in names], fontsize=8)
        ax.set_xlim(-0.02, 1.02)
        ax.plot([], [], "o", color=BLUE, label="inserted")
        ax.plot([], [], "o", color=ORANGE, label="real")
        legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return png_bytes(figure)


def area_table(areas: Iterable[AreaRow]) -> Table:
    """Return the probability of detection of the flight and of each sector."""
    rows = [
        [
            area["name"],
            f"{area['area_m2'] / 1e4:.2f}",
            decimals(area["photographed"]),
            decimals(area["pod"]),
            "" if area["pod"] is None else interval((area["low"], area["high"])),
            decimals(area["coverage"]),
        ]
        for area in areas
    ]
    return Table(["area", "hectares", "photographed", "POD", "range", "coverage C"], rows)


def detectability_page(facts: DetectabilityFacts, drawn_map: bytes | None = None) -> str:
    """Return the HTML page; the same facts give the same bytes.

    Args:
        facts: Content of `detectability.json`.
        drawn_map: Map of the flight as SVG; None without one.
    """
    confidences = [
        ((f"{row['confidence']:g}", decimals(row["alarms_per_picture"])), row) for row in facts["confidences"]
    ]
    cells = [((cell["by"], cell["value"]), cell) for cell in facts["cells"]]
    tables = [
        recall_table(confidences, ["confidence", "alarms a picture"], "By confidence"),
        recall_table(cells, ["by", "value"], f"By condition, at confidence {facts['confidence']:g}"),
    ]
    lost = [f"{n} inserted objects {_NOT_COUNTED.get(name, name)}" for name, n in facts["not_counted"].items()]
    tracks = facts["tracks"]
    return render_page(
        "detectability",
        title=f"Detectability of {facts['category']}",
        facts=facts,
        tables=tables,
        trust=trust_text(facts),
        drawn=drawn_text(facts),
        chart=draw_shares(facts),
        drawn_map=drawn_map,
        areas=area_table(facts["map"]["areas"]) if facts["map"] else None,
        tracks="" if tracks is None else f"{decimals(tracks['predicted'])} {interval((tracks['low'], tracks['high']))}",
        not_counted="; ".join(lost) or "Every object that was asked for was inserted and searched for.",
    )
