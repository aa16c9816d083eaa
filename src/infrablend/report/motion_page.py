"""The page of a sequence: how its camera moves, how certain that is, and how its levels change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from infrablend.report.figures import png_bytes
from infrablend.report.page import render_page

_COLOURS = {"followed": "#1b7f3b", "first": "#1b1b1b", "frozen": "#0072b2", "bridged": "#e69f00", "lost": "#b00020",
            "cut": "#9a009a"}  # fmt: skip


def motion_page(facts: Mapping[str, Any]) -> str:
    """Return the HTML page of a sequence from its JSON; the same facts give the same bytes."""
    return render_page("motion", title=f"Camera of {facts['sequence']}", facts=facts, plot=_plot(facts))


def _plot(facts: Mapping[str, Any]) -> bytes:
    frames = facts["frames"]
    number = np.array([f["frame"] for f in frames])
    known = np.array([f["span"] >= 0 for f in frames])
    width, height = facts["size_wh"]
    middle = np.array([width / 2, height / 2, 1.0])
    at = np.array([_there(np.reshape(f["to_first"], (3, 3)), middle) for f in frames])
    at[~known] = np.nan
    figure = Figure(figsize=(11, 10), dpi=100, layout="constrained")
    axes: Any = figure.subplots(5, 1, sharex=True, height_ratios=(2, 1.4, 1.4, 1.4, 0.4))
    axes[0].plot(number, at[:, 0] - middle[0], color="#0072b2", lw=1, label="to the right")
    axes[0].plot(number, at[:, 1] - middle[1], color="#d55e00", lw=1, label="down")
    axes[0].set_ylabel("middle of the picture,\npx from the span's first")
    axes[0].legend(frameon=False)
    for key, label in (("error_px", "error at a corner"), ("residual_px", "median residual")):
        axes[1].plot(number, np.where(known, [f[key] for f in frames], np.nan), lw=1, label=label)
    axes[1].set_ylabel("px")
    axes[1].legend(frameon=False)
    mid = np.where(known, [f["gain"] * 128 + f["offset"] for f in frames], np.nan)
    axes[2].plot(number, mid, color="#1b1b1b", lw=1)
    axes[2].set_ylabel("level of what had\n128 at first")
    axes[3].plot(number, [f["fitting"] for f in frames], lw=1, label="corners that fit")
    axes[3].plot(number, [f["sharpness"] ** 0.5 for f in frames], lw=1, label="sharpness")
    axes[3].legend(frameon=False)
    for state, colour in _COLOURS.items():
        here = number[[f["state"] == state for f in frames]]
        axes[4].vlines(here, 0, 1, color=colour, lw=1.2, label=state if here.size else None)
    axes[4].set_yticks([])
    axes[4].set_xlabel("frame")
    axes[4].legend(frameon=False, ncols=6, loc="upper center", bbox_to_anchor=(0.5, -0.9), fontsize=9)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    return png_bytes(figure)


def _there(matrix: Any, point: Any) -> Any:
    found = matrix @ point
    return found[:2] / found[2]
