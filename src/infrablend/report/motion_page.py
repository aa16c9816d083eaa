"""The page of a sequence: how its camera moves, how certain that is, and how its levels change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from infrablend.imaging.camera_path import Moment
from infrablend.report.charts import COLOURS, curves, legend, panels, png_bytes
from infrablend.report.page import render_page

_STATES = ("followed", "first", "frozen", "bridged", "lost", "cut")
_LABELS = ("middle of the picture,\npx from the span's first", "px", "level of what had\n128 at first", "", "")


def motion_page(
    facts: Mapping[str, object], size_wh: tuple[int, int], frames: Sequence[int], moments: Sequence[Moment]
) -> str:
    """Return the HTML page of a sequence; the same facts give the same bytes.

    Args:
        facts: Content of the sequence's JSON.
        size_wh: Size of the pictures, px.
        frames: Numbers of the frames, ascending.
        moments: What is known of the camera in each of them.
    """
    plot = _plot(size_wh, np.array(frames), moments)
    return render_page("motion", title=f"Camera of {facts['sequence']}", facts=facts, plot=plot)


def _plot(size_wh: tuple[int, int], frames: NDArray[np.int64], moments: Sequence[Moment]) -> bytes:
    known = np.array([m.known for m in moments])
    middle = np.array([size_wh[0] / 2, size_wh[1] / 2, 1.0])
    there = np.array([m.to_first for m in moments]) @ middle
    moved = np.where(known[:, None], there[:, :2] / there[:, 2:] - middle[:2], np.nan)
    mid = [m.gain * 128 + m.offset for m in moments]
    figure, axes = panels(5, 1, (11, 10), sharex=True, height_ratios=(2, 1.4, 1.4, 1.4, 0.4))
    curves(axes[0], frames, {"to the right": moved[:, 0], "down": moved[:, 1]})
    certain = {"error at a corner": [m.error_px for m in moments], "median residual": [m.residual_px for m in moments]}
    curves(axes[1], frames, {name: np.where(known, of, np.nan) for name, of in certain.items()})
    axes[2].plot(frames, np.where(known, mid, np.nan), color=COLOURS[0])
    seen = {"corners that fit": [m.fitting for m in moments], "sharpness": [m.sharpness**0.5 for m in moments]}
    curves(axes[3], frames, seen)
    for state, colour in zip(_STATES, COLOURS, strict=False):
        here = frames[[m.state == state for m in moments]]
        axes[4].vlines(here, 0, 1, color=colour, lw=1.2, label=state if here.size else "")
    axes[4].set(yticks=[], xlabel="frame")
    for ax, label in zip(axes, _LABELS, strict=True):
        ax.set_ylabel(label)
    for ax in axes[:4]:
        legend(ax)
    legend(axes[4], ncols=6, loc="upper center", bbox_to_anchor=(0.5, -0.9))
    return png_bytes(figure)
