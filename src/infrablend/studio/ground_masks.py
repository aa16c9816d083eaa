"""Places in a background being tuned: its surfaces, where objects may stand, and a mask painted by hand."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.assets.catalogue import load_model
from infrablend.config.recipe import Recipe
from infrablend.core.file_names import is_inside, real_path
from infrablend.core.rng import stream
from infrablend.errors import OutputError, RecipeError
from infrablend.formats.pictures.images import load_background
from infrablend.formats.pictures.place_masks import read_mask, write_mask
from infrablend.report.preview import Colour, Rgb, to_rgb
from infrablend.report.surface_sheet import COLOURS
from infrablend.sampling.placement import PlacementRequest
from infrablend.sampling.site import Site
from infrablend.sampling.suitable_ground import suitable_ground
from infrablend.studio.page_pictures import darkened, with_surfaces
from infrablend.studio.tuning import Tuned

Legend = dict[str, Colour | None]
_LEAST_SHARE = 0.0005
_INDIVIDUALS = 30  # drawn of a kind, to find what ground they need


def show_surfaces(tuned: Tuned, ignored: Collection[str]) -> tuple[Rgb, Legend]:
    """Return a frame's picture under the surfaces of its background, dark where a mask lets nothing stand; the legend.

    Raises:
        DatasetError: The background or its mask cannot be read.
    """
    site = _site(tuned, ignored)
    rgb = with_surfaces(to_rgb(tuned.trial.frame.pixels), site.surfaces)
    if site.allowed is not None:
        rgb = darkened(rgb, site.allowed.astype(np.float32))
    shares = sorted(site.surfaces.shares_of_kinds().items(), key=lambda item: -item[1])
    return rgb, {f"{kind} {100 * share:.1f} %": COLOURS[kind] for kind, share in shares if share >= _LEAST_SHARE}


def show_places(tuned: Tuned, ignored: Collection[str]) -> tuple[Rgb, Legend]:
    """Return a frame's picture, dark where no object of the recipe stands, brightest where most do; the legend.

    Raises:
        DatasetError: The background or its mask cannot be read.
    """
    rgb = to_rgb(tuned.trial.frame.pixels)
    suits = _suits(tuned.recipe, _site(tuned, ignored))
    if not suits:
        return rgb, {"This recipe asks for no surface.": None}
    legend: Legend = {f"Bright where {name} may stand: {100 * (s > 0).mean():.0f} %": None for name, s in suits.items()}
    best = np.max([*suits.values()], axis=0)
    return darkened(rgb, np.where(best > 0, (1 + best / max(best.max(), 1e-6)) / 2, 0)), legend


def paint(tuned: Tuned, data: Path, line: Sequence[Sequence[float]], pen_px: int, *, allowed: bool) -> Path:
    """Paint the mask of a frame's background along a line, or all over without one; return the folder of the masks.

    It is the recipe's, or `<data>.places`.

    Raises:
        RecipeError: The recipe does not look at surfaces.
        OutputError: The mask cannot be written, or would be in the dataset.
        DatasetError: The mask cannot be read.
    """
    where = tuned.recipe.placement.surfaces
    image = tuned.background
    if where is None:
        raise RecipeError("objects stand anywhere in this recipe; expected placement.mode metric with placement.where")
    folder = Path(where.masks or f"{real_path(data)}.places")
    if is_inside(folder, data):
        raise OutputError(f"{folder}: is in the dataset; expected placement.where.masks outside it")
    h, w = tuned.trial.frame.pixels.shape
    known = read_mask(folder, image, (w, h)) if line else np.full((h, w), allowed)
    mask = np.ones((h, w), np.uint8) if known is None else known.astype(np.uint8)
    if line:
        points = np.rint(np.clip(line, -w - h, w + h)).astype(np.int32)
        cv2.polylines(mask, [points], False, int(allowed), pen_px)
    write_mask(folder, image, mask > 0)
    return folder


def _site(tuned: Tuned, ignored: Collection[str]) -> Site:
    """Return the background of a frame as placement sees it."""
    image = tuned.background
    where = tuned.recipe.placement.surfaces
    background = load_background(image.path, image.size_wh)
    folder = None if where is None else where.masks
    return Site(
        background.pixels,
        image.instances,
        frozenset(ignored),
        time_of_day=image.capture.time_of_day,
        labelled_ground=tuned.trial.labelled_ground,
        allowed=None if folder is None else read_mask(Path(folder), image, background.size_wh),
    )


def _suits(recipe: Recipe, site: Site) -> dict[str, NDArray[np.float32]]:
    """Return how well each cell of a background suits the standing objects of a recipe, by class."""
    found = dict[str, NDArray[np.float32]]()
    for kind in recipe.objects:
        model = load_model(kind.model)
        drawn = [model.sample(stream(0, f"options/{n}"), kind.options) for n in range(_INDIVIDUALS)]
        # One of those that need ground of their own, such as people in water, and one of the others.
        each = {tuple(model.needed_ground(p) or ()): p for p in drawn}.values()
        items = [PlacementRequest(kind, model, params, model.build(params), 1.0) for params in each]
        grounds = [g for i in items if (g := suitable_ground(recipe.placement.surfaces, site, i)) is not None]
        if len(grounds) == len(items):
            name = kind.category or model.category
            found[name] = np.max([*(g.suits for g in grounds), found.get(name, grounds[0].suits)], axis=0)
    return found
