"""Plots of a fitted sensor profile: measurements of the pictures beside those of the fitted chain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.fitting import LAGS, Fit, SurveySummary
from infrablend.compositing.measure import EDGE_PX
from infrablend.report.charts import BLUE, FAINT, INK, LIGHT, ORANGE, curves, legend, panels, plot_text, png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOUND = INK
FITTED = ORANGE
_TOP_SIGMA_PX = 3.0


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
    figure, axes = panels(2, 3, (13, 7.6))
    p = fit.profile
    figure.suptitle(
        f"Sensor profile {plot_text(p.name)}: {p.measured['pictures']} pictures, {len(fit.found.sigmas_px)} edges"
    )
    if reference is not None:
        other = f"{against}'s chain"
        curves(axes[0], EDGE_PX, {other: reference.edge}, color=BLUE, ls="--")
        _correlations(axes[2], reference, other, BLUE, "--")
    _edge(axes[0], fit)
    _sigmas(axes[1], fit)
    _grain(axes[2], fit)
    _levels(axes[3], fit, histogram)
    _blocks(axes[4], fit)
    _codec(axes[5], fit)
    for ax in axes:
        legend(ax, loc="upper left" if ax is axes[0] else "best")
    return png_bytes(figure)


def _edge(ax: Axes, fit: Fit) -> None:
    p = fit.profile
    for level in (0, 1):
        ax.axhline(level, color=FAINT, lw=0.7)
    curves(ax, EDGE_PX, {"pictures, sharp edges": fit.found.edge}, color=FOUND, lw=2.2)
    curves(ax, EDGE_PX, {"fitted chain": fit.chain.edge}, color=FITTED)
    ax.set(
        title=f"Edge: psf {p.psf_sigma_px:.2f} px, halo {p.halo_gain:.2f} at {p.halo_radius_px:.1f} px",
        xlabel="across the edge, px",
        ylabel="share of the step",
        xlim=(-8, 8),
    )


def _sigmas(ax: Axes, fit: Fit) -> None:
    bins = np.arange(0, _TOP_SIGMA_PX + 0.051, 0.05).tolist()
    ax.hist(np.minimum(fit.found.sigmas_px, _TOP_SIGMA_PX), bins=bins, color=LIGHT)
    low, high = fit.profile.edge_bounds_px
    ax.axvspan(low, high, color=FITTED, alpha=0.15, lw=0, label="allowed for a single picture")
    ax.axvline(fit.found.sigma_px, color=FOUND, lw=1.8, label=f"20th percentile, {fit.found.sigma_px:.2f} px")
    ax.axvline(fit.chain.sigma_px, color=FITTED, lw=1.4, ls="--", label=f"fitted chain, {fit.chain.sigma_px:.2f} px")
    ax.set(
        title="Sharpness of all clean edges",
        xlabel="sigma, px (last bar: 3 and more)",
        ylabel="edges",
        xlim=(0, _TOP_SIGMA_PX),
    )


def _grain(ax: Axes, fit: Fit) -> None:
    ax.axhline(0, color=FAINT, lw=0.7)
    _correlations(ax, fit.found, "pictures", FOUND)
    _correlations(ax, fit.chain, "fitted chain", FITTED)
    ax.set(
        title="Grain of flat areas", xlabel="distance, px", ylabel="correlation", xticks=[0, *LAGS], ylim=(-0.1, 1.03)
    )


def _correlations(ax: Axes, measured: SurveySummary, name: str, colour: str, style: str = "-") -> None:
    if measured.correlations is not None:
        label = f"{name}: {measured.noise_grey:.2f} levels"
        curves(ax, [0, *LAGS], {label: [1, *measured.correlations]}, color=colour, ls=style, marker="o", ms=5)


def _levels(ax: Axes, fit: Fit, histogram: NDArray[np.int64]) -> None:
    first, end = 0, len(histogram)
    if end > 256:  # 16 bit: drawn over the range in use
        used = np.flatnonzero(histogram)
        first, end = int(used[0]), int(used[-1]) + 1
    group = max(1, (end - first - 1) // 256)
    counts = np.add.reduceat(histogram[first:end], np.arange(0, end - first, group))
    x = first + group * np.arange(len(counts))
    ax.fill_between(x, counts / histogram.sum(), step="mid", color=LIGHT)
    for level, what in zip(fit.profile.measured["levels"], ("darkest", "brightest"), strict=True):
        ax.axvline(level, color=FITTED, lw=1.4, label=f"{what}: {level:g}")
    ax.set(title="Levels", xlabel="level", ylabel="share of pixels", yscale="log", xlim=(x[0], x[-1]))


def _blocks(ax: Axes, fit: Fit) -> None:
    if fit.found.steps is None:
        ax.set(title="Steps in the codec's grid: the pictures are too small")
        return
    ax.bar(np.arange(8), fit.found.steps - 1, color=[FITTED, *[LIGHT] * 7], bottom=1, width=0.8)
    ax.axhline(1, color=FAINT, lw=0.7)
    reach = max(float(np.abs(fit.found.steps - 1).max()) * 1.3, 0.05)
    ax.set(
        title=f"Steps between neighbours: blockiness {fit.found.blockiness:.3f}",
        xlabel="position in the 8 px grid (0: between two blocks)",
        ylabel="relative to their mean",
        ylim=(1 - reach, 1 + reach),
    )


def _codec(ax: Axes, fit: Fit) -> None:
    q = fit.profile.codec_quality
    if not fit.codec or fit.found.blockiness is None:
        ax.set(title="Codec: not visible in these pictures")
        return
    qualities, blockiness = zip(*fit.codec, strict=True)
    curves(ax, qualities, {"shifted half a block, saved as JPEG": blockiness}, color=FOUND, marker="o", ms=4)
    ax.axhline(fit.found.blockiness, color=FITTED, lw=1.4, label=f"unchanged: {fit.found.blockiness:.3f}")
    if q is not None:
        ax.axvline(q, color=FITTED, lw=1.0, ls=":")
    ax.set(
        title="Codec: only that of the files" if q is None else f"Codec: as JPEG of quality {q}",
        xlabel="JPEG quality (100: none)",
        ylabel="blockiness",
    )
