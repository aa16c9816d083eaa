"""Plots of benchmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

mpl.use("Agg")

from matplotlib import pyplot

WAYS = {"naive": "the paper's way", "defaults": "Blender's defaults", "program": "this program"}
COLOURS = {"naive": "#8a8a8a", "defaults": "#c9a227", "program": "#1f6f8b"}


def draw_bench(
    report: Mapping[str, Any], errors: Mapping[str, NDArray[np.float32]], rss_mb: Sequence[float], path: Path
) -> None:
    """Draw four panels: CPU time per frame, distribution of the error, box fit, memory."""
    figure, ((time, error), (boxes, memory)) = pyplot.subplots(2, 2, figsize=(11, 7.5), layout="constrained")
    keys = {"naive": "naive_cpu_s_per_frame", "defaults": "defaults_cpu_s_per_frame", "program": "cpu_s_per_frame"}
    names = list(keys)
    seconds = [report[keys[n]] for n in names]
    bars = time.bar([WAYS[n] for n in names], seconds, color=[COLOURS[n] for n in names])
    time.bar_label(bars, [f"{s:.3g} s" for s in seconds])
    time.set_yscale("log")
    time.set_ylim(min(seconds) / 3, max(seconds) * 3)
    time.set_title(f"CPU seconds per frame: {report['speedup']:.0f} times less")

    for name, values in errors.items():
        if len(values):
            share = np.geomspace(max(1e-4, 1 / len(values)), 1, 300)
            error.plot(np.quantile(values, 1 - share), share, color=COLOURS[name], label=WAYS[name])
    error.axvline(4, color="k", lw=0.8, ls=":")
    error.axhline(0.01, color="k", lw=0.8, ls=":")
    error.set(yscale="log", xlim=(0, 8), ylim=(1e-4, 1), xlabel="error, grey levels")
    error.set_title("share of object pixels with a larger error (dotted: the limit)")
    error.legend()

    labels = list(report["boxes"])
    at = np.arange(len(labels))
    boxes.bar(at - 0.2, [report["boxes"][k]["mean"] for k in labels], 0.4, color=COLOURS["program"], label="mean")
    boxes.bar(at + 0.2, [report["boxes"][k]["p5"] for k in labels], 0.4, color="#a9cdd8", label="5th percentile")
    boxes.set_xticks(at, [k.replace("_", ", ") for k in labels])
    boxes.set_ylim(0.8, 1)
    boxes.axhline(0.95, color="k", lw=0.8, ls=":")
    boxes.axhline(0.90, color="k", lw=0.8, ls=":")
    boxes.set_title("IoU of label boxes with a silhouette at 16 times the resolution")
    boxes.legend(loc="lower left")

    memory.plot(rss_mb, color=COLOURS["program"])
    memory.set(ylim=(0, max([1024, *rss_mb]) * 1.05), xlabel="frame", ylabel="MiB")
    memory.axhline(1024, color="k", lw=0.8, ls=":")
    memory.set_title(f"memory of one worker: {report['rss_slope_mb_per_100_frames']:+.2f} MiB per 100 frames")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def draw_scale(results: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw CPU time per frame and largest memory of each step against the number of frames, see `scale.py`."""
    figure, (time, memory) = pyplot.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    steps = dict.fromkeys(k for r in results for k, v in r.items() if isinstance(v, Mapping))
    for step in steps:
        having = sorted((r for r in results if step in r), key=lambda r: int(r["frames"]))
        frames = [r["frames"] for r in having]
        time.plot(frames, [r[step]["cpu_ms_per_frame"] for r in having], "o-", ms=4, label=step)
        memory.plot(frames, [r[step]["peak_mb"] for r in having], "o-", ms=4, label=step)
    time.axhline(1, color="k", lw=0.8, ls=":")
    time.set(xscale="log", yscale="log", xlabel="frames", ylabel="ms")
    time.set_title("CPU per frame (dotted: the aim for the finish)")
    memory.set(xscale="log", xlabel="frames", ylabel="MiB", ylim=(0, None))
    memory.set_title("largest memory of a process")
    memory.legend(loc="upper left", bbox_to_anchor=(1, 1))
    figure.savefig(path, dpi=100)
    pyplot.close(figure)
