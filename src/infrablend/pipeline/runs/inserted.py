"""Counts what a run inserted of what its recipe asked for, and says where that is nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from infrablend.config.recipe import Recipe
from infrablend.core.frame_row import FrameRow
from infrablend.core.run_record import DrawStatistics
from infrablend.errors import Problem
from infrablend.report.run.run_warnings import absent_warnings

NOTHING_INSERTED = "nothing-inserted"
"""Code of the problem of a run, or of an entry of `objects`, that asked for objects and got none."""


def count_objects(recipe: Recipe, rows: Iterable[FrameRow]) -> dict[str, Any]:
    """Return the counts of objects by entry of the recipe, and of those left out or without a label by reason.

    Frames with objects placed by hand ask for nothing: their places are not checked.
    """
    asked = Counter[int]()
    inserted = Counter[int]()
    absent = Counter[str]()
    dropped = Counter[str]()
    for row in rows:
        if row.scene is None:
            continue
        inserted.update(i.kind for i in row.inserts if i.kind is not None)
        absent.update(row.absent)
        dropped.update(row.drops)
        if row.id not in recipe.frames:
            asked.update(row.scene.draws.wanted_by_kind)
    by_kind = {f"objects.{k}": {"asked": asked[k], "inserted": inserted[k]} for k in sorted(asked | inserted)}
    found = {"objects_by_kind": by_kind, "objects_left_out": dict(sorted(absent.items()))}
    return {
        **{name: counts for name, counts in found.items() if counts},
        "objects_without_label": dict(sorted(dropped.items())),
    }


def nothing_inserted(recipe: Recipe, counts: Mapping[str, Any], draws: DrawStatistics | None = None) -> list[Problem]:
    """Return what a run was asked for and has not inserted at all: any object, or any of an entry of `objects`.

    Args:
        recipe: Recipe of the run.
        counts: Its counts, with those of `count_objects`.
        draws: Statistics of its draws, for the next step; unknown for runs in packed shards.
    """
    by_kind: Mapping[str, Mapping[str, int]] = counts.get("objects_by_kind", {})
    missing = {where: n["asked"] for where, n in by_kind.items() if n["asked"] and not n["inserted"]}
    if not missing:
        return []
    left_out = counts.get("objects_left_out", {})
    reasons = Counter(left_out) + Counter(counts.get("objects_without_label", {}))
    why = ", ".join(f"{reason} {n}" for reason, n in reasons.most_common()) or "for a reason that was not recorded"
    total = sum(n["asked"] for n in by_kind.values())
    remedies = absent_warnings(draws or {"wanted": total, "absent": left_out, "rejected": {}})
    todo = "; or ".join(dict.fromkeys(p.todo for p in remedies))
    todo = (
        todo or "look at a few frames (infrablend try, infrablend preview), and check where the recipe places objects"
    )
    if not any(n["inserted"] for n in by_kind.values()):
        found = f"none of the {total} objects that the recipe asks for was inserted: {why}"
        return [Problem("objects", NOTHING_INSERTED, found, "objects in the pictures", todo)]
    return [
        Problem(
            where,
            NOTHING_INSERTED,
            f"none of the {n} objects of the model {recipe.objects[int(where.rpartition('.')[2])].model} was inserted; "
            f"left out of all kinds: {why}",
            "some of each kind",
            todo,
        )
        for where, n in missing.items()
    ]


def nothing_first(problems: Iterable[Problem]) -> list[Problem]:
    """Return the problems in their order, after those about a run without objects: nobody needs such a run."""
    return sorted(problems, key=lambda p: p.code != NOTHING_INSERTED)
