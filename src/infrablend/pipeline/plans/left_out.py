"""Pictures that a run leaves out, each with its reason."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from infrablend.config.recipe import Recipe
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.file_names import as_text, is_text
from infrablend.errors import Problem
from infrablend.formats.cameras.flight_headers import FOR_ALL, was_extracted
from infrablend.formats.pictures.images import COLOUR_REMEDY, COLOURS, IN_COLOUR, some_in_colour
from infrablend.formats.pictures.temperature_scale import EXTRACT_AGAIN, from_radiometric_files

LEFT_OUT = frozenset(
    ("no-pitch", "no-altitude", "no-field-of-view", "above-horizon", "no-temperature-scale", "image-visible")
)
"""Codes of the problems that leave a picture out of the run, one per picture."""


def usable_images(
    recipe: Recipe, dataset: Dataset, images: Sequence[ImageRecord], stands: bool
) -> tuple[list[ImageRecord], list[Problem]]:
    """Return those of the chosen pictures of a dataset that a run can use, and a problem for each of the others.

    `stands` says whether all models of the recipe stand on the ground.
    """
    usable = []
    problems = []
    others = Telemetry.of(dataset)
    for image in images:
        problem = _unreadable(image) or telemetry_missing(recipe, image, others)
        if stands:
            problem = problem or _above_horizon(recipe, image)
        problem = problem or _scale_missing(image, recipe, dataset)
        if problem is None:
            usable.append(image)
        else:
            problems.append(problem)
    return usable, problems


def all_in_colour(images: Sequence[ImageRecord]) -> list[Problem]:
    """Return the reason that comes first where no picture can be used: those that are looked at are all in colour.

    Few visible pictures state pitch and height, so these are missing, too; but stating them would not help.
    """
    unmarked = [image for image in images if image.extra.get("modality") != "visible"]
    looked_at = some_in_colour([image.path for image in unmarked])
    if not looked_at or not all(looked_at.values()):
        return []
    names = ", ".join(_place(image) for image in unmarked if image.path in looked_at)
    found = f"{COLOURS}, as {names}"
    return [Problem("pictures", IN_COLOUR, found, "thermal pictures in grey", COLOUR_REMEDY)]


def _unreadable(image: ImageRecord) -> Problem | None:
    if not is_text(image.path.name) or not is_text(image.id):
        return Problem(
            as_text(f"{image.split}/{image.path.name}"),
            "name-not-utf8",
            "a file name that is not UTF-8",
            "a name that labels in JSON can hold",
            "rename the file",
        )
    if image.extra.get("modality") == "visible":
        return Problem(
            _place(image),
            "image-visible",
            "a picture of visible light",
            "a thermal picture as background",
            "use its labels only (infrablend convert), or use another dataset",
        )
    return None


def _place(image: ImageRecord) -> str:
    """Return the split and name of a picture: several splits may have a picture of one name."""
    return f"{image.split}/{image.name}"


def telemetry_missing(recipe: Recipe, image: ImageRecord, others: Telemetry) -> Problem | None:
    """Return a problem if the recipe needs the camera's pitch, height or field of view and it is unknown, or None."""
    pitch = recipe.camera.pitch == "metadata" and image.capture.pitch_deg is None
    height = recipe.camera.needs_height and image.capture.altitude_m is None
    # A picture from a card names its camera, and a table where its height comes from. The recipe's lens is another
    # camera's: it would give a wrong scale.
    own = others.extracted or image.capture.camera is not None or image.capture.altitude_from is not None
    lens = recipe.camera.needs_lens and own and image.capture.hfov_deg is None
    lacking: list[_Lacking] = []
    if pitch:
        settings = "camera.pitch to {fixed_deg: ...}"
        lacking.append(_Lacking("no-pitch", "camera pitch", "a pitch", settings, others.pitch))
    if height:
        found = "camera height, which metric placement needs"
        settings = "camera.altitude to {fixed_m: ...}"
        lacking.append(_Lacking("no-altitude", found, "an altitude", settings, others.height))
    if lens:
        found = "field of view of " + (image.capture.camera or "the video's camera")
        found += " (the lens from the recipe is another camera's)"
        settings = "camera.field_of_view to recipe, with the camera's own camera.model or camera.focal_length_mm"
        lacking.append(_Lacking("no-field-of-view", found, "a field of view (hfov_deg)", settings, others.lens))
    if not lacking:
        return None
    expected = f"{' and '.join(o.expected for o in lacking)} in the file name, the annotation or a metadata table"
    todo = "give a table (metadata.csv, docs/how_to/own_images.md), or set "
    todo += " and ".join(o.settings for o in lacking)
    if any(o.others_have_it for o in lacking):
        todo += FOR_ALL
    found = " and ".join(f"unknown {o.found}" for o in lacking)
    return Problem(_place(image), lacking[0].code, found, expected, todo)


@dataclass(frozen=True)
class _Lacking:
    """What a recipe needs to know about a picture's camera, and is not known, in the words of a problem."""

    code: str
    found: str
    expected: str
    settings: str
    others_have_it: bool


@dataclass(frozen=True)
class Telemetry:
    """What is known about the cameras of a dataset.

    Attributes:
        extracted: Whether the pictures come out of a video or a radiometric camera's files.
        pitch: Whether any picture has a pitch.
        height: Whether any has a height.
        lens: Whether any has a field of view.
    """

    extracted: bool
    pitch: bool
    height: bool
    lens: bool

    @classmethod
    def of(cls, dataset: Dataset) -> Telemetry:
        """Return what is known in any picture of a dataset."""
        names = ("pitch_deg", "altitude_m", "hfov_deg")
        known = (any(getattr(i.capture, name) is not None for i in dataset.images) for name in names)
        return cls(was_extracted(dataset), *known)


def _scale_missing(image: ImageRecord, recipe: Recipe, dataset: Dataset) -> Problem | None:
    agc = recipe.output.agc
    if not recipe.matching.needs_temperatures and (agc is None or not agc.needs_scale):
        return None
    if image.capture.radiometry is not None and image.capture.scale:
        return None
    needed = "matching.mode radiometric" if recipe.matching.needs_temperatures else "output.agc fixed"
    if image.capture.camera is not None and any(p.code == "image-radiometric" for p in dataset.problems):
        layers = f"{dataset.root.resolve().name}_k"
        return Problem(
            _place(image),
            "no-temperature-scale",
            f"only the grey levels of a camera's own file are read, and {needed} needs temperatures",
            "the radiometric layers as a dataset of 16-bit pictures",
            f"run infrablend temperatures {shlex.quote(str(dataset.root))} --out {shlex.quote(layers)} (counts of DJI "
            f"also need a scale, such as --slope and --offset), then generate with --data {shlex.quote(layers)}",
        )
    return Problem(
        _place(image),
        "no-temperature-scale",
        f"no temperature scale, which {needed} needs",
        "a 16-bit picture with a scale, stated by the user or by the dataset's own files",
        EXTRACT_AGAIN
        if from_radiometric_files(dataset)
        else "set data.unit to centikelvin or decikelvin, or data.unit, data.slope and data.offset; do not guess them",
    )


def _above_horizon(recipe: Recipe, image: ImageRecord) -> Problem | None:
    """Return a problem if no part of the ground is in view, as far as pitch and field of view are known."""
    if not recipe.camera.is_real or recipe.camera.pitch != "metadata" or image.capture.hfov_deg is None:
        return None
    w, h = image.size_wh or recipe.camera.size_px
    half_deg = math.degrees(math.atan(math.tan(math.radians(image.capture.hfov_deg) / 2) * h / w))
    if image.capture.pitch_deg is None or image.capture.pitch_deg + half_deg > 0:
        return None
    return Problem(
        _place(image),
        "above-horizon",
        f"a camera pitch of {image.capture.pitch_deg:g} degrees, so the whole picture is above the horizon",
        "ground in view, for metric placement on the ground",
        "leave the picture out, or correct its pitch in a metadata table",
    )
