"""Cells of detectabilities: conditions in which recall is predicted by inserted objects, and measured by real ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

from infrablend.detection.detectability_record import CellFacts, DetectabilityFacts
from infrablend.lab.experiments.definition import Check, Detectability, RecallCells
from infrablend.lab.experiments.graph import OTHER_SCALES
from infrablend.lab.experiments.result_record import Claim, DetectabilityFigures
from infrablend.pipeline.flights.detectability_figures import LEAST_COMPARED


def detectability_figures(name: str, spec: Detectability, facts: DetectabilityFacts) -> DetectabilityFigures:
    """Return what the page shows of a detectability."""
    compared = compared_cells(facts["cells"], LEAST_COMPARED)
    return {
        "title": spec.title or name,
        "kind": facts["kind"],
        "recipe": facts["recipe"],
        "trained_on": facts["trained_on"],
        "category": facts["category"],
        "confidence": facts["confidence"],
        "pictures": facts["pictures"],
        "recall": facts["recall"],
        "confidences": facts["confidences"],
        "cells": facts["cells"],
        "not_counted": facts["not_counted"],
        "real_of_other_sizes": facts["real_of_other_sizes"],
        "compared": len(compared),
        "holding": sum(_holds_zero(c) for c in compared),
    }


def compared_cells(cells: Sequence[CellFacts], least_real: int) -> list[CellFacts]:
    """Return the cells with so many real objects, and with inserted ones to compare them with."""
    return [c for c in cells if c.get("real", 0) >= least_real and "difference" in c]


def _holds_zero(cell: CellFacts) -> bool:
    _, low, high = cell["difference"]
    return low <= 0 <= high


def check_recall(
    claim: Claim, check: Check, measured: Mapping[str, DetectabilityFigures], left_out: Mapping[str, str]
) -> None:
    """Add to a claim the largest difference of predicted and actual recall, and whether it holds.

    Args:
        claim: Claim to complete.
        check: Check of recall; its detectabilities that do not belong to the scale are not used.
        measured: Figures of the detectabilities, by name.
        left_out: Reason why one has no figures, by name.
    """
    wanted = check.recall
    assert wanted is not None
    names = [n for n in wanted.of if left_out.get(n) != OTHER_SCALES]
    claim["recall_of"] = names
    claim["least"] = check.least
    claim["most"] = check.most
    claim["metric"] = "recall"
    claim["class"] = ", ".join(dict.fromkeys(measured[n]["category"] for n in names if n in measured)) or "all"
    if lacking := [n for n in names or wanted.of if n not in measured]:
        claim["missing"] = next((left_out[n] for n in lacking if n in left_out), "not run yet")
        return
    rows = [(measured[n]["title"], cell) for n in names for cell in _chosen(measured[n], wanted)]
    if not rows:
        claim["missing"] = f"no such condition with {wanted.least_real} real objects"
        return
    title, worst = max(rows, key=lambda row: abs(row[1]["difference"][0]))
    difference, low, high = worst["difference"]
    holding = sum(_holds_zero(cell) for _, cell in rows)
    claim["difference"] = difference
    claim["ci"] = [low, high]
    claim["where"] = f"{title}, {worst['by']} {worst['value']}"
    claim["cells"] = len(rows)
    claim["holding"] = holding
    if check.most is not None:
        claim["holds"] = abs(difference) <= check.most
    elif check.least is not None:
        claim["holds"] = holding / len(rows) >= check.least


def _chosen(figures: DetectabilityFigures, wanted: RecallCells) -> list[CellFacts]:
    cells = list(figures["cells"])
    if wanted.by == "confidence":
        rows = figures["confidences"]
        cells = [cast("CellFacts", {**c, "by": "confidence", "value": f"{c['confidence']:g}"}) for c in rows]
    return [
        c
        for c in compared_cells(cells, wanted.least_real)
        if wanted.by in (None, c["by"]) and wanted.value in (None, c["value"])
    ]
