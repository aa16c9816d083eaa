"""Checks of a recipe against its models and a dataset: what cannot be made, and settings without the wanted effect."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from infrablend.annotation.classes import unknown_classes
from infrablend.assets.model import ObjectModel
from infrablend.config.recipe import IN_AIR, ON_GROUND, MetricObject, Object, Recipe
from infrablend.core.camera import fov_of_width
from infrablend.core.dataset import Dataset, ImageRecord, differ_in_form
from infrablend.core.format_table import NATIVE
from infrablend.core.rng import stream
from infrablend.core.strict_model import Strict
from infrablend.errors import DatasetError, InfraBlendError, Problem, RecipeError
from infrablend.formats.cameras.flight_headers import FLIGHT_MISSING
from infrablend.formats.dataset_folder import DATASET_INSIDE
from infrablend.formats.pictures.place_masks import find_mask
from infrablend.formats.pictures.temperature_scale import IMPLAUSIBLE, implausible_scales
from infrablend.formats.read_write import WriteSettings
from infrablend.formats.writing import unwritable
from infrablend.pipeline.plans.backgrounds import is_ground
from infrablend.pipeline.plans.selection import similar

LENS_REPLACED = "lens-replaced"
"""Code of the warning about a lens of the recipe that replaces others in the files."""
PITCH_REPLACED = "pitch-replaced"
"""Code of the warning about a pitch of the recipe that replaces others in the files."""
HEIGHT_REPLACED = "height-replaced"
"""Code of the warning about a height of the recipe that replaces others in the files."""
# Lenses of thermal cameras for drones are narrower than this.
_WIDE_DEG = 75.0
# Their sensors are smaller than film, which is so wide.
_FILM_MM = 36.0
# A stated field of view that differs by a larger share from the files' is reported.
_LENS_TOLERANCE = 0.15
# A stated pitch that differs by more from the files' is reported.
_PITCH_TOLERANCE_DEG = 15.0
# A stated height that differs by a larger share from the files' is reported.
_HEIGHT_TOLERANCE = 0.25


def require_options(recipe: Recipe, models: Mapping[str, ObjectModel]) -> None:
    """Try each object's options once: an invalid one would otherwise fail every frame."""
    problems = []
    for i, o in enumerate(recipe.objects):
        try:
            models[o.model].sample(stream(0, "options"), o.options)
        except (InfraBlendError, ValueError, TypeError) as error:
            message = error.message if isinstance(error, InfraBlendError) else str(error)
            problems.append(Problem(f"objects.{i}.options", "recipe-value", message))
    if problems:
        raise RecipeError(f"recipe {recipe.name}: options that its models do not accept", problems)


def require_movable(recipe: Recipe, models: Mapping[str, ObjectModel]) -> None:
    """Check that each kind of movement is one of its model: on the ground or in the air.

    Raises:
        RecipeError: Some are not; the message names them.
    """
    problems = []
    kinds: tuple[Object, ...] = recipe.objects
    for n, kind in enumerate(kinds):
        motion = kind.motion
        possible = ON_GROUND if models[kind.model].stands else IN_AIR
        if motion is not None and motion.kind not in possible:
            where = "stands on the ground" if models[kind.model].stands else "flies"
            found = f"found {motion.kind}, but {kind.model} {where}"
            expected = ", ".join(possible)
            problems.append(Problem(f"objects.{n}.motion.kind", "recipe-value", found, expected))
    if problems:
        raise RecipeError(f"recipe {recipe.name}: movements that its models do not have", problems)


def without_effect(recipe: Recipe, models: Mapping[str, ObjectModel]) -> list[Problem]:
    """Return a warning for each setting that differs from its default and has no effect with these models and modes."""
    found = []
    for i, o in enumerate(recipe.objects):
        stands = models[o.model].stands
        why = f"{o.model} {'stands on the ground' if stands else 'flies'}"
        expected = "a model that flies" if stands else "a model that stands on the ground"
        unused = o.only_flying if stands else o.only_standing
        found += [(f"objects.{i}.{name}", why, expected) for name in unused if _is_set(o, name)]
        if not stands and isinstance(o, MetricObject) and o.size_px is not None and _is_set(o, "range_m"):
            found.append((f"objects.{i}.range_m", "size_px decides the distance", "size_px: null, to use range_m"))
    if recipe.sensor.headroom and not recipe.matching.uses_headroom:
        found.append(("sensor.headroom", "appearance.mode is artistic", "appearance.mode physical"))
    return [
        Problem(
            where,
            "no-effect",
            f"a setting without effect: {why}",
            expected,
            f"remove {where.rpartition('.')[2]}",
            "warning",
        )
        for where, why, expected in found
    ]


def _is_set(section: Strict, name: str) -> bool:
    """Return whether a field has another value than its default; recipes of the studio state every field."""
    return bool(getattr(section, name) != type(section).model_fields[name].default)


def dataset_remarks(recipe: Recipe, dataset: Dataset) -> tuple[Problem, ...]:
    """Return the problems of reading a dataset, for a run of this recipe.

    Raises:
        DatasetError: It is a folder of datasets, or its temperatures are needed and no scene has them.
    """
    # What the recipe needs of flight data is asked for picture by picture (`left_out`).
    remarks = tuple(p for p in dataset.problems if p.code != FLIGHT_MISSING)
    if whole := [p for p in remarks if p.code == DATASET_INSIDE]:
        # Their labels would be lost, and their objects become unlabelled background.
        raise DatasetError(f"{dataset.root}: a folder of datasets, not of one dataset", whole)
    if not recipe.matching.needs_temperatures or not any(p.code == IMPLAUSIBLE for p in remarks):
        return remarks
    # The recipe may know better than the files that the pictures show the sky.
    if implausible := implausible_scales(dataset, lambda image: is_ground(image, recipe)):
        refused = [replace(p, severity="error") for p in implausible]
        raise DatasetError(f"{dataset.root}: temperatures that no scene has", refused)
    return tuple(p for p in remarks if p.code != IMPLAUSIBLE)


def data_warnings(recipe: Recipe, images: Sequence[ImageRecord], root: Path) -> list[Problem]:
    """Return warnings about pictures of a dataset (at `root`) that a recipe uses in another way than they suggest."""
    found = []
    if recipe.labels.merges and not any(image.instances for image in images):
        what = "no labels in any image, so objects in the backgrounds stay unlabelled"
        todo = "check --data, or set labels.mode to new if the data has no labels"
        found.append(Problem(root.name, "no-labels", what, "labels to merge with", todo, "warning"))
    return [
        *found,
        *_wide_lens(recipe, images),
        *_other_lens(recipe, images),
        *_other_pitch(recipe, images),
        *_other_height(recipe, images),
    ]


def without_mask(recipe: Recipe, images: Sequence[ImageRecord], known: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning if some pictures have no mask of where objects may stand.

    Raises:
        RecipeError: No picture of the dataset, `known`, has one.
    """
    where = recipe.placement.surfaces
    if where is None or where.masks is None:
        return []
    folder = Path(where.masks)
    field = "placement.where.masks"
    missing = [i for i in images if find_mask(folder, i) is None]
    expected = f"{missing[0].split}/{missing[0].id}.png or {missing[0].id}.png in {folder}" if missing else ""
    if missing and not any(find_mask(folder, i) for i in known):
        found = "no mask of any picture" if folder.is_dir() else "no such folder"
        raise RecipeError(f"recipe {recipe.name}: {field}", [Problem(field, "masks-missing", found, expected)])
    if not missing:
        return []
    found = f"no mask for {len(missing)} of {len(images)} pictures, where objects stand on any ground that suits them"
    return [Problem(field, "masks-missing", found, expected, "draw them, all 255 for no restriction", "warning")]


def require_pitch_of_pixels(recipe: Recipe, images: Sequence[ImageRecord]) -> None:
    """Check that a pixel pitch is that of these pictures: times another width, it gives another field of view.

    Raises:
        RecipeError: Pictures are of another width than the recipe's.
    """
    c = recipe.camera
    widths = sorted({i.size_wh for i in images if i.size_wh is not None and i.size_wh[0] != c.size_px[0]})
    if c.pixel_pitch_um is None or not widths or not c.is_real:
        return
    w, h = widths[0]
    found = f"{c.pixel_pitch_um:g} um for pictures {c.size_px[0]} px wide (camera.size_px), but pictures are {w}x{h}"
    todo = f"set camera.size_px=[{w}, {h}] if each of their pixels is one of the detector; if the camera enlarges its "
    todo += "pictures, set camera.sensor_width_mm, the pitch times the detector's columns, instead"
    problem = Problem("camera.pixel_pitch_um", "pitch-other-size", found, "pictures of that width", todo)
    raise RecipeError(f"recipe {recipe.name}: a pixel pitch that does not fit the pictures", [problem])


def _wide_lens(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning about the lens of a small camera taken for that of a film camera."""
    c = recipe.camera
    across = fov_of_width(c.sensor_width_mm, c.focal_length_mm)
    used = any(not c.needs_lens or i.capture.hfov_deg is None for i in images)
    if not c.is_real or not used or across < _WIDE_DEG or c.sensor_width_mm != _FILM_MM:
        return []
    found = f"{c.focal_length_mm:g} mm on a sensor {_FILM_MM:g} mm wide: {across:.0f} degrees across"
    todo = "set camera.pixel_pitch_um, too, if this focal length is printed on the lens; or set camera.model instead"
    return [Problem("camera.focal_length_mm", "lens-wide", found, "a lens of thermal cameras", todo, "warning")]


def _other_lens(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    c = recipe.camera
    if not c.is_real or c.needs_lens:
        return []
    stated = fov_of_width(c.sensor_width_mm, c.focal_length_mm)
    other = [
        i.capture.hfov_deg
        for i in images
        if i.capture.hfov_deg is not None and abs(stated / i.capture.hfov_deg - 1) > _LENS_TOLERANCE
    ]
    if not other:
        return []
    span = f"{min(other):.1f}" if max(other) - min(other) < 0.1 else f"{min(other):.1f} to {max(other):.1f}"
    found = f"{stated:.1f} degrees across for all pictures, but the files of {len(other)} picture(s) state {span}"
    todo = (
        "set camera.field_of_view to metadata, or state no lens, unless another lens is wanted or the files are wrong"
    )
    return [Problem("camera.focal_length_mm", LENS_REPLACED, found, "the lens of the camera", todo, "warning")]


def _other_pitch(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    stated = recipe.camera.stated_pitch_deg
    if stated is None or not recipe.camera.is_real:  # paper's ablations replace it on purpose
        return []
    low, high = stated[0] - _PITCH_TOLERANCE_DEG, stated[1] + _PITCH_TOLERANCE_DEG
    other = [
        i.capture.pitch_deg
        for i in images
        if i.capture.pitch_deg is not None and not low <= i.capture.pitch_deg <= high
    ]
    if not other:
        return []
    found = (
        f"a stated pitch, but the files of {len(other)} picture(s) state {min(other):.0f} to {max(other):.0f} degrees"
    )
    todo = "set camera.pitch to metadata, unless another view of the objects is wanted or the files are wrong"
    return [Problem("camera.pitch", PITCH_REPLACED, found, "the pitch of each picture", todo, "warning")]


def _other_height(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    stated = recipe.camera.stated_height_m
    if stated is None:
        return []
    low, high = stated[0] * (1 - _HEIGHT_TOLERANCE), stated[1] * (1 + _HEIGHT_TOLERANCE)
    known = [i.capture.altitude_m for i in images]
    other = [height for height in known if height is not None and not low <= height <= high]
    if not other:
        return []
    span = f"{stated[0]:g}" if stated[0] == stated[1] else f"{stated[0]:g} to {stated[1]:g}"
    found = f"{span} m for all pictures, but the files of {len(other)} picture(s) state "
    found += f"{min(other):.0f} to {max(other):.0f} m"
    todo = "set camera.altitude to metadata, unless another size of the objects is wanted or the files are wrong"
    return [Problem("camera.altitude", HEIGHT_REPLACED, found, "the height of each picture", todo, "warning")]


def require_classes(recipe: Recipe, field: str, names: Collection[str], dataset: Dataset) -> None:
    """Check that a field of the recipe names classes of the dataset."""
    unknown = unknown_classes(dataset, names)
    if unknown:
        known = ", ".join(c.name for c in dataset.categories) or "it has none"
        found = f"found {', '.join(unknown)}"
        expected = f"categories of the dataset ({known})"
        problem = Problem(field, "recipe-value", found, expected)
        raise RecipeError(f"recipe {recipe.name}: does not fit {dataset.root}", [problem])


def require_distinct_classes(recipe: Recipe, inserted: Sequence[str], dataset: Dataset) -> None:
    """Check that no class of inserted objects is one of the dataset in another spelling: it would be a second class.

    Args:
        recipe: Recipe that may allow it.
        inserted: Class of each entry of the recipe's `objects`.
        dataset: Dataset with its classes renamed as the recipe asks.

    Raises:
        RecipeError: The name of a class differs in case or number alone from one of the dataset, or from another
            inserted one that the dataset does not have.
    """
    known = [c.name for c in dataset.categories]
    if recipe.labels.similar_names == "keep":
        return
    problems = []
    for n, name in enumerate(inserted):
        similar = next((k for k in known if differ_in_form(name, k)), None)
        if similar is not None and name not in known:
            joined = f"objects.{n}.category={similar}"
            renamed = f"labels.rename={{{similar}: {name}}}"
            found = f"the class {name!r} beside {similar!r} of the dataset: two classes for one kind of object"
            todo = f"set {joined} to insert into the dataset's class, or {renamed} to rename that; or set "
            todo += "labels.similar_names=keep for two classes"
            problems.append(Problem(f"objects.{n}.category", "class-similar", found, "one name for each kind", todo))
    for n, name in enumerate(inserted):
        similar = next((k for k in inserted[:n] if differ_in_form(name, k)), None)
        if similar is not None and not {name, similar} & {*known}:
            found = f"the class {name!r} beside {similar!r} of another entry"
            todo = f"set objects.{n}.category={similar}, or labels.similar_names=keep for two classes"
            problems.append(Problem(f"objects.{n}.category", "class-similar", found, "one name for each kind", todo))
    if problems:
        raise RecipeError(f"recipe {recipe.name}: does not fit {dataset.root}", problems)


def unknown_by_hand(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning per frame that the recipe places objects in and that these backgrounds do not have."""
    if not recipe.frames:
        return []
    known = [f"{i.split}/{i.id}_c{k}" for i in images for k in range(recipe.scenes)]
    found = "no frame of this dataset has this id"
    return [
        Problem(f"frames.{name}", "frame-unknown", found, f"an id such as {similar(name, known)}", severity="warning")
        for name in sorted(recipe.frames.keys() - set(known))
    ]


def require_loosened(recipe: Recipe, inserted: Collection[str]) -> None:
    """Check that `labels.loosen` and `labels.loosen_px` list classes of inserted objects; no other boxes change."""
    expected = f"classes of the inserted objects ({', '.join(sorted(inserted))})"
    faults = [
        Problem(name, "recipe-value", f"found {', '.join(unknown)}", expected)
        for name, given in (("labels.loosen", recipe.labels.loosen), ("labels.loosen_px", recipe.labels.loosen_px))
        if isinstance(given, Mapping) and (unknown := sorted(set(given) - set(inserted)))
    ]
    if faults:
        raise RecipeError(f"recipe {recipe.name}: no such inserted class", faults)


def require_ids(recipe: Recipe, images: Sequence[ImageRecord]) -> None:
    """Check that the source's ids can be kept, before the first frame rather than after the last."""
    settings = WriteSettings(ids=recipe.output.ids)
    problems = []
    if settings.ids == "source" and (recipe.scenes > 1 or recipe.output.originals):
        found = f"source with {recipe.scenes} configuration(s)"
        if recipe.output.originals:
            found += " and originals"
        todo = "set output.ids to new, or configurations to 1 and output.originals to false"
        problems.append(Problem("output.ids", "recipe-value", found, "one frame per background", todo))
    for name in recipe.output.formats:
        problem = None if name == NATIVE else unwritable(name, images, settings)
        if problem is not None:
            problems.append(replace(problem, where=f"output.ids ({name})"))
    if problems:
        raise RecipeError(f"recipe {recipe.name}: the source's ids cannot be kept", problems)
