"""Plots of a fitted sensor profile: measurements of the pictures beside those of the fitted chain."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from infrablend.compositing.fitting import LAGS, Fit, SurveySummary
from infrablend.compositing.measure import EDGE_PX
from infrablend.report.figures import plot_text, png_bytes

# Distinct for colour-blind readers too.
FOUND = "#1b1b1b"
FITTED = "#d55e00"
OTHER = "#0072b2"
FAINT = "#9a9a9a"


def draw_profile(
    fit: Fit,
    histogram: NDArray[np.int64],
    against: str | None = None,
    reference: SurveySummary | None = None,
) -> bytes:
    """Return all plots of a fit as one PNG.

    Args:
        fit: What to draw.
        histogram: How often each level occurs.
        against: Name of another profile, and `reference` what its chain's pictures show.
        reference: See `against`.
    """
    figure = Figure(figsize=(13, 7.6), dpi=100, layout="constrained")
    axes: Any = figure.subplots(2, 3)
    p = fit.profile
    figure.suptitle(
        f"Sensor profile {plot_text(p.name)}: {p.measured['pictures']} pictures, {len(fit.found.sigmas_px)} edges"
    )
    others = [] if reference is None else [(against, reference)]
    _edge(axes[0, 0], fit, others)
    _sigmas(axes[0, 1], fit)
    _grain(axes[0, 2], fit, others)
    _levels(axes[1, 0], fit, histogram)
    _blocks(axes[1, 1], fit)
    _codec(axes[1, 2], fit)
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
        if ax.get_legend_handles_labels()[1]:
            ax.legend(frameon=False, fontsize=9, loc="upper left" if ax is axes[0, 0] else "best")
    return png_bytes(figure)


def _edge(ax: Any, fit: Fit, others: list[tuple[Any, SurveySummary]]) -> None:
    p = fit.profile
    ax.axhline(0, color=FAINT, lw=0.7)
    ax.axhline(1, color=FAINT, lw=0.7)
    for name, r in others:
        ax.plot(EDGE_PX, r.edge, color=OTHER, lw=1.4, ls="--", label=f"{plot_text(name)}'s chain")
    ax.plot(EDGE_PX, fit.found.edge, color=FOUND, lw=2.2, label="pictures, sharp edges")
    ax.plot(EDGE_PX, fit.chain.edge, color=FITTED, lw=1.6, label="fitted chain")
    ax.set(
        title=f"Edge: psf {p.psf_sigma_px:.2f} px, halo {p.halo_gain:.2f} at {p.halo_radius_px:.1f} px",
        xlabel="across the edge, px",
        ylabel="share of the step",
        xlim=(-8, 8),
    )


def _sigmas(ax: Any, fit: Fit) -> None:
    top = 3.0
    ax.hist(np.minimum(fit.found.sigmas_px, top), bins=np.arange(0, top + 0.051, 0.05), color="#c9c9c9")
    low, high = fit.profile.edge_bounds_px
    ax.axvspan(low, high, color=FITTED, alpha=0.15, lw=0, label="allowed for a single picture")
    ax.axvline(fit.found.sigma_px, color=FOUND, lw=1.8, label=f"20th percentile, {fit.found.sigma_px:.2f} px")
    ax.axvline(fit.chain.sigma_px, color=FITTED, lw=1.4, ls="--", label=f"fitted chain, {fit.chain.sigma_px:.2f} px")
    ax.set(
        title="Sharpness of all clean edges", xlabel="sigma, px (last bar: 3 and more)", ylabel="edges", xlim=(0, top)
    )


def _grain(ax: Any, fit: Fit, others: list[tuple[Any, SurveySummary]]) -> None:
    ax.axhline(0, color=FAINT, lw=0.7)
    for name, r in others:
        if r.correlations is not None:
            ax.plot(
                [0, *LAGS],
                [1, *r.correlations],
                color=OTHER,
                ls="--",
                marker="o",
                ms=4,
                label=f"{plot_text(name)}'s chain",
            )
    for r, colour, name in ((fit.found, FOUND, "pictures"), (fit.chain, FITTED, "fitted chain")):
        if r.correlations is not None:
            label = f"{name}: {r.noise_grey:.2f} levels"
            ax.plot([0, *LAGS], [1, *r.correlations], color=colour, marker="o", ms=5, lw=1.8, label=label)
    ax.set(
        title="Grain of flat areas", xlabel="distance, px", ylabel="correlation", xticks=[0, *LAGS], ylim=(-0.1, 1.03)
    )


def _levels(ax: Any, fit: Fit, histogram: NDArray[np.int64]) -> None:
    share = histogram / histogram.sum()
    low, high = fit.profile.measured["levels"]
    group = max(1, len(share) // 256)
    if group > 1:  # 16 bit: drawn over the range in use
        first, last = np.flatnonzero(histogram)[[0, -1]]
        group = max(1, int(last - first) // 256)
        share = np.add.reduceat(share[first : last + 1], np.arange(0, last + 1 - first, group))
        x = first + group * np.arange(len(share))
    else:
        x = np.arange(len(share))
    ax.fill_between(x, share, step="mid", color="#c9c9c9")
    for level, what in ((low, "darkest"), (high, "brightest")):
        ax.axvline(level, color=FITTED, lw=1.4, label=f"{what}: {level:g}")
    ax.set(title="Levels", xlabel="level", ylabel="share of pixels", yscale="log", xlim=(x[0], x[-1]))


def _blocks(ax: Any, fit: Fit) -> None:
    if fit.found.steps is None:
        ax.set(title="Steps in the codec's grid: the pictures are too small")
        return
    ax.bar(np.arange(8), fit.found.steps - 1, color=[FITTED, *["#c9c9c9"] * 7], bottom=1, width=0.8)
    ax.axhline(1, color=FAINT, lw=0.7)
    reach = max(float(np.abs(fit.found.steps - 1).max()) * 1.3, 0.05)
    ax.set(
        title=f"Steps between neighbours: blockiness {fit.found.blockiness:.3f}",
        xlabel="position in the 8 px grid (0: between two blocks)",
        ylabel="relative to their mean",
        ylim=(1 - reach, 1 + reach),
    )


def _codec(ax: Any, fit: Fit) -> None:
    q = fit.profile.codec_quality
    if not fit.codec or fit.found.blockiness is None:
        ax.set(title="Codec: not visible in these pictures")
        return
    ax.plot(*zip(*fit.codec, strict=True), color=FOUND, marker="o", ms=4, label="shifted half a block, saved as JPEG")
    ax.axhline(fit.found.blockiness, color=FITTED, lw=1.4, label=f"unchanged: {fit.found.blockiness:.3f}")
    if q is not None:
        ax.axvline(q, color=FITTED, lw=1.0, ls=":")
    ax.set(
        title="Codec: only that of the files" if q is None else f"Codec: as JPEG of quality {q}",
        xlabel="JPEG quality (100: none)",
        ylabel="blockiness",
    )
