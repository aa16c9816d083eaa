"""Measure the error of pictures against renders with 2,048 samples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scenes import Work
from variants import load_float, with_samples

from infrablend.assets.catalogue import load_model
from infrablend.compositing.mapping import GreyMapping, percentile_mapping
from infrablend.compositing.overlay import blend, make_layer
from infrablend.core.render import RenderResult
from infrablend.core.scene import SceneSpec
from infrablend.formats.pictures.images import load_background
from infrablend.sampling.scene_sampler import sample_scene

REFERENCE_SAMPLES = 2048
# The reference must not use the same samples as the measured picture.
OTHER_SEED = 0x5555_5555
LEAST_SPAN_GREY = 120.0


@dataclass(frozen=True, eq=False)
class Errors:
    """Differences in grey levels at all pixels that the reference covers, in all frames.

    Attributes:
        by_way: Absolute differences of all frames in one array, by the way of making the picture.
        span_grey: Number of levels that the object spans, per frame.
        pixels: Number of pixels per frame.
    """

    by_way: dict[str, NDArray[np.float32]]
    span_grey: list[float]
    pixels: list[int]


def measure_errors(work: Work, kept: dict[str, Path]) -> Errors:
    """Compare frames with their references: those of this program (`program`), and whole frames kept in folders.

    The final composited float pictures are compared, before quantisation and JPEG. If the object spans fewer than
    `LEAST_SPAN_GREY` levels, the grey-level mapping of the frame is stretched until it does.
    """
    from infrablend.rendering.engine.renderer import BlenderRenderer

    class Switching(BlenderRenderer):
        reference = False

        def _cycles(self, spec: SceneSpec, bounces: int) -> dict[str, Any]:
            # The scene's own seed must stay: the temperature pattern of the bodies depends on it.
            settings = super()._cycles(spec, bounces)
            return settings | {"seed": settings["seed"] ^ OTHER_SEED} if self.reference else settings

    recipe = work.recipe
    models = {o.model: load_model(o.model) for o in recipe.objects}
    renderer = Switching()
    found: dict[str, list[NDArray[np.float32]]] = {"program": [], **{name: [] for name in kept}}
    spans, counts = [], []
    for frame in work.frames:
        background = load_background(frame.background.path, frame.background.size_wh)
        scene = sample_scene(frame.key(background.size_wh), recipe, models, work.settings.seed)
        renderer.reference = True
        reference = renderer.render(with_samples(scene, REFERENCE_SAMPLES))
        renderer.reference = False
        if not reference.alpha.any():
            continue
        mapping, span = stretched(percentile_mapping(background.pixels, recipe.matching.percentiles), reference)
        spans.append(span)
        where = covered(reference)
        counts.append(int(where.sum()))

        def picture(result: RenderResult, mapping: GreyMapping = mapping, pixels: Any = background.pixels) -> Any:
            """Return the final picture of the whole frame before rounding."""
            layer = make_layer(result, mapping, recipe.overlay.softness_px)
            whole = pixels.astype(np.float64)
            (x, y), (rows, columns) = layer.offset_xy, layer.alpha.shape
            whole[y : y + rows, x : x + columns] = blend(pixels, layer)
            return whole

        truth = picture(reference)
        found["program"].append(np.abs(picture(renderer.render(scene)) - truth)[where])
        for name, folder in kept.items():
            found[name].append(np.abs(picture(load_float(folder, frame.frame_id)) - truth)[where])
    nothing = np.zeros(0, np.float32)
    return Errors({k: np.concatenate([nothing, *v]) for k, v in found.items()}, spans, counts)


def covered(result: RenderResult) -> NDArray[np.bool_]:
    """Return an (h, w) mask of the frame: True where the render covers any part of a pixel, before the optics' blur."""
    w, h = result.frame_wh
    where = np.zeros((h, w), np.bool_)
    (x, y), (rows, columns) = result.offset_xy, result.alpha.shape
    where[y : y + rows, x : x + columns] = result.alpha > 0
    return where


def stretched(mapping: GreyMapping, reference: RenderResult) -> tuple[GreyMapping, float]:
    """Widen the mapping until the object spans `LEAST_SPAN_GREY` levels; return it and the final span."""
    inside = reference.alpha > 0.5
    if not inside.any():
        inside = reference.alpha > 0
    level = reference.radiance[inside] / reference.alpha[inside]
    own = float(level.max() - level.min()) * abs(mapping.bright - mapping.dark)
    factor = max(1.0, LEAST_SPAN_GREY / max(own, 1e-6))
    wide = GreyMapping(mapping.dark, mapping.dark + (mapping.bright - mapping.dark) * factor)
    return wide, own * factor


def joined(parts: list[Errors]) -> Errors:
    """Return the errors of several shares of the frames."""
    names = parts[0].by_way
    return Errors(
        {n: np.concatenate([p.by_way[n] for p in parts]) for n in names},
        [s for p in parts for s in p.span_grey],
        [c for p in parts for c in p.pixels],
    )


def summary(differences: NDArray[np.float32]) -> dict[str, float]:
    """Return the mean, 99th percentile and maximum of the differences, grey levels."""
    if not len(differences):
        return {"mean": float("nan"), "p99": float("nan"), "max": float("nan"), "pixels": 0}
    return {
        "mean": float(differences.mean(dtype=np.float64)),
        "p99": float(np.quantile(differences, 0.99)),
        "max": float(differences.max()),
        "pixels": len(differences),
    }
