"""Tables of a comparison's contrasts, for its HTML report and for the page of results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from infrablend.realism.contrasts import QUANTILES
from infrablend.report.figures import compact, interval

Contrasts = Mapping[str, Mapping[str, Any]]
"""What `realism.contrasts.compare_contrasts` returns: time of day to real, inserted, checks."""

QUANTILE_HEAD = ["", "objects", *(f"{q} %" for q in QUANTILES), "SCR, 1 %", "5 %", "median"]
CHECK_HEAD = ["", "real", "inserted", "found", "required", "holds"]
_CHECKS = {
    "slope_high": "slope of the 95 % quantile",
    "slope_middle": "slope of the middle",
    "change_p1": "largest change, 1 % quantile",
    "change_p5": "largest change, 5 % quantile",
    "signed_p25": "contrast, lower quartile",
    "signed_p50": "contrast, median",
    "signed_p75": "contrast, upper quartile",
}
_QUANTITIES = {
    "signed": "contrast",
    "change": "largest change",
    "ground_level": "ground, level above the picture's median",
    "ground_clutter": "ground, standard deviation",
}
AS_WRITTEN = (
    "Contrast is measured in a box: a wider one shows less of it, one around what is visible more. Where a run draws "
    "the boxes of inserted objects as people do (`labels.fit`, `labels.loosen`, `labels.loosen_px`), this is the "
    "contrast in those. The number of objects that are large enough to be measured changes, too."
)
LOOSENESS_HEAD = ["", "real", "boxes", "inserted", "boxes", "real against inserted", "boxes"]
SLOPE_HEAD = ["", "95 % quantile", "95 % interval", "objects", "middle", "95 % interval", "objects"]


def slope_rows(contrasts: Contrasts, prefix: str = "") -> list[list[str]]:
    """Return one row of slopes per time of day and population; none where no image has enough objects."""
    rows = []
    for time, sides in contrasts.items():
        for side in ("real", "inserted"):
            slopes = [sides[side]["slope"][level] for level in ("high", "middle")]
            if any(slopes):
                rows.append([_label(prefix, side, time), *(cell for s in slopes for cell in _slope_cells(s))])
    return rows


def quantile_rows(contrasts: Contrasts, prefix: str = "") -> list[list[str]]:
    """Return rows of quantiles per time of day and population: of contrast, and of the ground around the objects."""
    rows = []
    for time, sides in contrasts.items():
        for key, name in _QUANTITIES.items():
            if key not in sides["real"]:
                continue  # pages of earlier versions
            for side in ("real", "inserted"):
                found = sides[side]
                scr = [compact(found["scr"].get(f"p{q}")) for q in (1, 5, 50)] if key == "change" else [""] * 3
                quantiles = [_whole(found[key].get(f"p{q}")) for q in QUANTILES]
                rows.append([f"{_label(prefix, side, time)}: {name}", f"{found['n']:,}", *quantiles, *scr])
    return rows


def check_rows(contrasts: Contrasts, prefix: str = "") -> list[list[str]]:
    """Return one row per check: the figures, what is required, and whether it holds."""
    rows = []
    for time, sides in contrasts.items():
        for name, check in sides["checks"].items():
            found = compact(check["found"])
            if "ci" in check:
                found = f"{check['found']:+.3f} ({interval(check['ci'], signed=True)})"
            cells = [compact(check["real"]), compact(check["inserted"]), found, _required(name, check["limit"])]
            rows.append([f"{_label(prefix, time=time)}: {_CHECKS[name]}", *cells, verdict(check["holds"])])
    return rows


def looseness_cells(boxes: Mapping[str, Any]) -> list[str]:
    """Return the factors of real and inserted boxes, and of real against inserted ones, each with its number."""
    cells = []
    for key in ("real", "inserted", "real_against_inserted"):
        found = boxes[key]
        factor = "-" if found is None else f"{found['factor']:.2f} ({found['ci'][0]:.2f} to {found['ci'][1]:.2f})"
        if found is not None and "margin_px" in found:  # pages hold figures of earlier versions
            factor += f", {found['margin_px']:.1f} px"
        cells += [factor, "-" if found is None else f"{found['n']:,}"]
    return cells


def verdict(holds: bool | None) -> str:
    """Return `yes`, `no`, or `-` where there are too few objects for a verdict."""
    return {True: "yes", False: "no", None: "-"}[holds]


def _label(prefix: str, side: str = "", time: str = "") -> str:
    words = [prefix, side, "" if time == "unknown" else f"by {time}"]
    return " ".join(w for w in words if w).strip() or "all"


def _slope_cells(slope: Mapping[str, Any] | None) -> list[str]:
    if slope is None:
        return ["-", "-", "0"]
    return [f"{slope['slope']:.2f}", f"{slope['ci'][0]:.2f} to {slope['ci'][1]:.2f}", f"{slope['objects']:,}"]


def _required(name: str, limit: float | Sequence[float]) -> str:
    if name.startswith("slope"):
        return f"difference within {limit}"
    if isinstance(limit, Sequence):
        return f"ratio {limit[0]} to {limit[1]}"
    return f"ratio of at least {limit}"


def _whole(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"
