"""Plans a run: its frames, their backgrounds and categories, and the images left out, with reasons."""

from __future__ import annotations

import hashlib
import json
import math
import shlex
import statistics
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.annotation.classes import ignored_turned_objects, rename_classes, unknown_classes
from infrablend.assets.model import ObjectModel
from infrablend.assets.user_model import description_digest, is_description
from infrablend.config.agc import FixedAgc
from infrablend.config.recipe import (
    NOT_IN_KEY,
    FixedPitch,
    MetricCamera,
    MetricObject,
    MetricSections,
    RadiometricMatching,
    RandomPitch,
    Recipe,
    Sensor,
    SkyEnvironment,
)
from infrablend.core.dataset import Category, Dataset, ImageRecord
from infrablend.core.file_names import distinct_names, fit_name
from infrablend.core.files import sha256_of_json
from infrablend.core.format_table import NATIVE
from infrablend.core.rng import stream
from infrablend.core.strict_model import Strict
from infrablend.errors import DatasetError, InfraBlendError, Problem, RecipeError
from infrablend.formats.detection import DATASET_INSIDE
from infrablend.formats.flight import FOR_ALL, was_extracted
from infrablend.formats.temperatures import EXTRACT_AGAIN, IMPLAUSIBLE, from_radiometric_files, implausible_scales
from infrablend.formats.writing import WriteSettings, unwritable
from infrablend.pipeline.backgrounds import is_ground
from infrablend.pipeline.frame_selection import ALL_FRAMES, FrameSelection, find_frames, similar
from infrablend.pipeline.models import ready_model
from infrablend.pipeline.shard import Shard
from infrablend.sampling.scene import FrameKey, mean_objects, require_parts
from infrablend.thermal.sky import sun_position, time_of

# For estimates only. Measured with Cycles on the CPU and one worker: 4 frames took 6.4 CPU seconds, 24 took 11.8.
# Workers start in parallel, so their number does not change the time until the first frame.
START_S = 5.5
TYPICAL_FRAME_CPU_S = 0.26
# Processor time of each object beyond the first: people 0.29 s, cars 0.5 s.
TYPICAL_OBJECT_CPU_S = 0.3
TYPICAL_LATTICE_FRAME_CPU_S = 0.06  # the artistic look without Cycles
READ_PICTURE_S = 0.01
WRITE_LABELS_S = 0.003  # per frame and format, by one process
LEVELS_SAMPLE = 64
LENS_REPLACED = "lens-replaced"
"""Code of the warning about a lens of the recipe that replaces others in the files."""
PITCH_REPLACED = "pitch-replaced"
"""Code of the warning about a pitch of the recipe that replaces others in the files."""
LEFT_OUT = frozenset(
    ("no-pitch", "no-altitude", "no-field-of-view", "above-horizon", "no-temperature-scale", "image-visible")
)
"""Codes of the problems that leave a picture out of the run, one per picture."""
# Fields of objects in metric placement that only models of one kind use.
_OF_STANDING = ("group", "align", "z_m")
_OF_FLYING = ("range_m",)
# A stated field of view that differs by a larger share from the files' is reported.
_LENS_TOLERANCE = 0.15
# Clear of the horizon, where day and night are a matter of opinion.
_SUN_IS_UP_RAD = math.radians(6)
# A stated pitch that differs by more from the files' is reported.
_PITCH_TOLERANCE_DEG = 15.0
# Bytes of records, logs, reports and labels: per frame, and per inserted object.
_BYTES_PER_FRAME = 6_000
_BYTES_PER_OBJECT = 10_000


@dataclass(frozen=True, eq=False)
class PlannedFrame:
    """One frame of the run: a background with inserted objects, or the unchanged background.

    Attributes:
        background: Background with classes renamed as the recipe asks.
        configuration: Number k of the configuration, from 0; None for the unchanged background.
        as_read: Background with the source's own class names. Camera height, grey levels and free places are
            derived from these, so that renaming classes does not change the picture.
        name: Stem of the image file: `<background>_c<k>`, or the background's id for the unchanged background; with a
            number appended where another frame of the split has that name.
    """

    background: ImageRecord
    configuration: int | None
    as_read: ImageRecord
    name: str

    @property
    def frame_id(self) -> str:
        """`<split>/<name>`: unique in the run."""
        return f"{self.background.split}/{self.name}"

    def key(self, size_wh: tuple[int, int]) -> FrameKey:
        """Return the key of the frame's random streams."""
        assert self.configuration is not None
        b = self.background
        when = b.time_of_day, b.sequence, b.captured
        return FrameKey(
            b.id, b.split, self.configuration, size_wh, b.pitch_deg, *when, b.radiometry, b.hfov_deg, b.altitude_m,
            b.roll_deg,
        )  # fmt: skip

    def image_path(self, group_by: Sequence[str], suffix: str) -> str:
        """Return the path below `images/`: split, requested groups, file name."""
        b = self.background
        groups = {
            "pitch": "pitch_unknown" if b.pitch_deg is None else f"pitch_{b.pitch_deg:g}",
            "altitude": "altitude_unknown" if b.altitude_m is None else f"altitude_{b.altitude_m:g}",
            "day_night": b.time_of_day or "time_unknown",
        }
        return "/".join([b.split, *(groups[g] for g in group_by), self.name + suffix])


@dataclass(frozen=True, eq=False)
class RunPlan:
    """All decisions made before the first frame.

    Attributes:
        recipe: Validated recipe.
        seed: Seed of the run.
        dataset: Backgrounds, restricted to the requested splits and limit.
        models: Models by the names used in the recipe.
        categories: Categories of the source, then the new ones, with their ids.
        new_categories: Names of the categories that the recipe adds.
        frames: Frames, ordered by split, background and configuration.
        problems: Left-out items with reasons, and warnings.
        key: Values or digests, by field, that must match for a run to be resumed.
        ignored: Original names of the categories that mark ignore regions.
        sample: Pictures from which to measure the grey levels of the dataset. They are spread over all pictures read,
            so that a run with a limit gives the same frames as a full run.
        request: How the backgrounds were read and frames were chosen, for the run record.
        levels: Range of grey levels of the dataset, if it has been measured already.
        shard: Shard that `frames` belongs to; None for a whole run.
        run: Identity of the run, in the records of its frames: a digest of recipe and seed. Shards and parts of a run
            have that of the whole.
    """

    recipe: Recipe
    seed: int
    dataset: Dataset
    models: Mapping[str, ObjectModel]
    categories: tuple[Category, ...]
    new_categories: tuple[str, ...]
    frames: tuple[PlannedFrame, ...]
    problems: tuple[Problem, ...]
    key: Mapping[str, Any]
    ignored: tuple[str, ...] = ()
    sample: tuple[ImageRecord, ...] = ()
    request: Mapping[str, Any] = field(default_factory=dict)
    levels: tuple[float, float] | None = None
    shard: Shard | None = None
    run: str = ""

    @property
    def needs_levels(self) -> bool:
        """True if the recipe needs the range of grey levels of the whole dataset."""
        r = self.recipe
        return r.appearance.mode == "physical" or r.sensor.profile != "off" or r.placement.mode == "metric"

    @property
    def _frame_cpu_s(self) -> float:
        lattice = self.recipe.appearance.mode == "artistic" and not self.recipe.samples
        frame_s = TYPICAL_LATTICE_FRAME_CPU_S if lattice else TYPICAL_FRAME_CPU_S
        return frame_s + TYPICAL_OBJECT_CPU_S * max(self._objects_per_frame - 1, 0)

    @cached_property
    def _objects_per_frame(self) -> float:
        """Mean number of objects in frames that are not unchanged pictures, from about 200 of them."""
        changed = [f for f in self.frames if f.configuration is not None]
        some = changed[:: max(1, len(changed) // 200)]
        return sum(mean_objects(self.recipe, f.key((1, 1))) for f in some) / max(len(some), 1)

    def estimate(
        self, workers: int, shards: int | None = None, price_per_core_hour: float | None = None
    ) -> dict[str, Any]:
        """Estimate frames, disk space, time and cost of the run on idle machines.

        Args:
            workers: Worker processes, for each shard if there are any.
            shards: Number of shards that the run is divided into; None for an undivided run.
            price_per_core_hour: Price, in any currency; None gives no cost.
        """
        sizes = [f.background.path.stat().st_size for f in self.frames[:: max(1, len(self.frames) // 200)]]
        factor = 4.0 if self.recipe.output.image == "png" else 1.0
        per_frame = (statistics.fmean(sizes) if sizes else 0.0) * factor + _BYTES_PER_FRAME
        objects = self._objects_per_frame * sum(f.configuration is not None for f in self.frames)
        frames, formats = len(self.frames), max(1, len(self.recipe.output.formats))
        start_s = START_S + READ_PICTURE_S * (len(self.sample) if self.needs_levels else 0)
        workers = max(workers, 1)
        labels_s = frames * WRITE_LABELS_S * formats
        render_s = start_s + frames * self._frame_cpu_s / workers
        core_hours = (workers * START_S * (shards or 1) + frames * self._frame_cpu_s + labels_s) / 3600
        return {
            "backgrounds": len(self.dataset.images),
            "frames": len(self.frames),
            "frames_per_split": _count(f.background.split for f in self.frames),
            "disk_bytes": round(per_frame * frames + _BYTES_PER_OBJECT * objects),
            "about_s": round(render_s + labels_s),
            "workers": workers,
            "core_hours": round(core_hours, 3),
            **({} if price_per_core_hour is None else {"cost": round(core_hours * price_per_core_hour, 2)}),
            **({} if shards is None else self._of_shards(shards, workers, start_s, labels_s)),
            "left_out": _count(p.code for p in self.problems if p.severity == "error"),
        }

    def _of_shards(self, shards: int, workers: int, start_s: float, merge_s: float) -> dict[str, Any]:
        """Return what a plan in shards estimates instead: times of one shard and of merging, not of the whole run."""
        most = -(-len(self.frames) // shards)
        return {
            "about_s": None,
            "shards": shards,
            "frames_per_shard": most,
            "about_per_shard_s": round(start_s + most * self._frame_cpu_s / workers),
            "about_merge_s": round(merge_s),
        }


def make_plan(
    recipe: Recipe,
    dataset: Dataset,
    seed: int,
    *,
    splits: Sequence[str] | None = None,
    selection: FrameSelection = ALL_FRAMES,
    recipe_warnings: Sequence[Problem] = (),
) -> RunPlan:
    """Return the plan of a run.

    Args:
        recipe: Recipe of the run.
        dataset: Backgrounds of the requested splits.
        seed: Seed of the run.
        splits: Requested splits, for error messages only.
        selection: Frames to produce.
        recipe_warnings: Warnings from reading the recipe.

    Raises:
        ArgumentError: The selection names a frame that does not exist.
        DatasetError: No background is left.
        RecipeError: A model does not have an option of the recipe, or the dataset lacks a category that it names.
        ModelError: A model does not exist, or lacks a part that the recipe names.
    """
    models = {o.model: ready_model(o.model) for o in recipe.objects}
    require_parts(recipe, models)
    _require_options(recipe, models)
    _require_classes(recipe, "labels.rename", recipe.labels.rename, dataset)
    ignored = tuple(c.name for c in dataset.categories if c.ignore)
    renamed = rename_classes(dataset, recipe.labels.rename)
    turned = ignored_turned_objects(dataset, recipe.labels.rename)
    as_read = {id(new): old for old, new in zip(dataset.images, renamed.images, strict=True)}
    dataset = renamed
    _require_classes(recipe, "labels.keep_categories", recipe.labels.keep_categories or (), dataset)
    names = frame_names(dataset.images, recipe.output.originals, recipe.configurations)
    images, chosen = selection.backgrounds(dataset.images, seed), None
    if selection.frames is not None:
        chosen = find_frames(selection.frames, dataset.images, names)
        of_chosen = {image for image, _ in chosen}
        images = [image for image in images if id(image) in of_chosen]
    remarks = dataset.problems
    if whole := [p for p in remarks if p.code == DATASET_INSIDE]:
        # Their labels would be lost, and their objects become unlabelled background.
        raise DatasetError(f"{dataset.root}: a folder of datasets, not of one dataset", whole)
    if isinstance(recipe.matching, RadiometricMatching) and any(p.code == IMPLAUSIBLE for p in remarks):
        # The recipe may know better than the files that the pictures show the sky.
        if implausible := implausible_scales(dataset, lambda image: is_ground(image, recipe)):
            refused = [replace(p, severity="error") for p in implausible]
            raise DatasetError(f"{dataset.root}: temperatures that no scene has", refused)
        remarks = tuple(p for p in remarks if p.code != IMPLAUSIBLE)
    problems = [*recipe_warnings, *_without_effect(recipe, models), *remarks, *turned]
    usable = []
    stands = all(model.stands for model in models.values())
    others = _Telemetry.of(dataset)
    for image in images:
        if not is_text(image.path.name) or not is_text(image.id):
            problems.append(
                Problem(
                    as_text(f"{image.split}/{image.path.name}"),
                    "name-not-utf8",
                    "a file name that is not UTF-8",
                    "a name that labels in JSON can hold",
                    "rename the file",
                )
            )
        elif image.extra.get("modality") == "visible":
            problems.append(
                Problem(
                    _place(image),
                    "image-visible",
                    "a picture of visible light",
                    "a thermal picture as background",
                    "use its labels only (infrablend convert), or use another dataset",
                )
            )
        elif unknown := _telemetry_missing(recipe, image, others) or (
            _above_horizon(recipe, image) if stands else None
        ):
            problems.append(unknown)
        elif (isinstance(recipe.matching, RadiometricMatching) or isinstance(recipe.output.agc, FixedAgc)) and (
            image.radiometry is None or not image.radiometry.scale
        ):
            problems.append(_scale_missing(image, recipe, dataset))
        else:
            usable.append(image)
    if not usable:
        raise DatasetError(
            f"{dataset.root}: no usable background in {len(images)} image(s)"
            + (f" of split {', '.join(splits)}" if splits else ""),
            problems,
        )
    if recipe.labels.mode == "merged" and not any(image.instances for image in usable):
        found = "no labels in any image, so objects in the backgrounds stay unlabelled"
        todo = "check --data, or set labels.mode to new if the data has no labels"
        problems.append(Problem(dataset.root.name, "no-labels", found, "labels to merge with", todo, "warning"))
    problems += _other_lens(recipe, usable) + _other_pitch(recipe, usable) + _sun_unused(recipe, usable)
    _require_ids(recipe, usable)
    categories = list(dataset.categories)
    new = []
    for o in recipe.objects:
        name = o.category or models[o.model].category
        if name not in {c.name for c in categories}:
            new.append(name)
            categories.append(Category(max((c.id for c in categories), default=-1) + 1, name))
    _require_loosened(recipe, {o.category or models[o.model].category for o in recipe.objects})
    problems += _unknown_by_hand(recipe, dataset.images)
    frames = [
        PlannedFrame(image, k, as_read[id(image)], names[id(image), k])
        for image in usable
        for k in _configurations(recipe.output.originals, recipe.configurations)
        if chosen is None or (id(image), k) in chosen
    ]
    trimmed = replace(dataset, images=tuple(usable))
    key = {
        "version": __version__,
        "recipe": json.loads(recipe.model_dump_json(exclude={"output": NOT_IN_KEY})),
        "seed": seed,
        "backgrounds": fingerprint(trimmed),
    }
    if chosen is not None:
        key["frames"] = sorted(frame.frame_id for frame in frames)
    if own := {o.model: description_digest(Path(o.model)) for o in recipe.objects if is_description(o.model)}:
        key["models"] = own
    return RunPlan(
        recipe,
        seed,
        trimmed,
        models,
        tuple(categories),
        tuple(new),
        tuple(frames),
        tuple(problems),
        key,
        ignored,
        dataset.images[:: max(1, len(dataset.images) // LEVELS_SAMPLE)][:LEVELS_SAMPLE],
        run=_identity(key),
    )


def _identity(key: Mapping[str, Any]) -> str:
    deciding = {**key["recipe"], "description": None}
    return sha256_of_json([deciding, key["seed"]])[:16]


def _configurations(originals: bool, count: int) -> list[int | None]:
    """Return the configurations of a background in the order of its frames; None is the unchanged background."""
    return [*([None] if originals else []), *range(count)]


def frame_names(images: Sequence[ImageRecord], originals: bool, count: int) -> dict[tuple[int, int | None], str]:
    """Return the name of every frame by `id(image)` and configuration; names are unique in each split.

    Backgrounds whose ids look like names of frames (`a` and `a_c0`, when earlier output is used as input), or differ in
    case alone, would otherwise share files. Unchanged backgrounds keep their name, and of other equal names the first
    frame keeps it. The names depend on all backgrounds of the split, so that `--limit` does not change them.
    """
    names: dict[tuple[int, int | None], str] = {}
    for split in dict.fromkeys(i.split for i in images):
        of_split = [i for i in images if i.split == split]
        frames = [(i, k) for k in _configurations(originals, 0) for i in of_split]
        frames += [(i, k) for i in of_split for k in range(count)]
        found = distinct_names([fit_name(i.id) if k is None else f"{fit_name(i.id)}_c{k}" for i, k in frames])
        names |= {(id(i), k): name for (i, k), name in zip(frames, found, strict=True)}
    return names


def is_text(name: str) -> bool:
    """Return False for a file name with bytes that are not UTF-8 (Python keeps them as lone surrogates)."""
    return name == as_text(name)


def as_text(name: str) -> str:
    """Return the name with bytes that are not UTF-8 written as escapes such as `\\udcff`."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


def _require_options(recipe: Recipe, models: Mapping[str, ObjectModel]) -> None:
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


def _without_effect(recipe: Recipe, models: Mapping[str, ObjectModel]) -> list[Problem]:
    """Return a warning for each setting that differs from its default and has no effect with these models and modes."""
    found = []
    for i, o in enumerate(recipe.objects):
        if not isinstance(o, MetricObject):
            continue
        stands = models[o.model].stands
        why = f"{o.model} {'stands on the ground' if stands else 'flies'}"
        expected = "a model that flies" if stands else "a model that stands on the ground"
        unused = _OF_FLYING if stands else _OF_STANDING
        found += [(f"objects.{i}.{name}", why, expected) for name in unused if _is_set(o, name)]
    s = recipe.sensor
    if recipe.appearance.mode == "artistic" and isinstance(s, Sensor) and _is_set(s, "headroom"):
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


def _place(image: ImageRecord) -> str:
    """Return the split and name of a picture: several splits may have a picture of one name."""
    return f"{image.split}/{image.name}"


def _telemetry_missing(recipe: Recipe, image: ImageRecord, others: _Telemetry) -> Problem | None:
    """Return a problem if the recipe needs the camera's pitch, height or field of view and it is unknown, or None."""
    pitch = recipe.camera.pitch == "metadata" and image.pitch_deg is None
    height = isinstance(recipe, MetricSections) and recipe.camera.altitude == "metadata" and image.altitude_m is None
    # A picture from a card names its camera, and a table where its height comes from. The recipe's lens is another
    # camera's: it would give a wrong scale.
    own = others.extracted or "camera" in image.extra or "altitude_from" in image.extra
    metric = isinstance(recipe, MetricSections) and recipe.camera.field_of_view == "metadata"
    lens = metric and own and image.hfov_deg is None
    if not pitch and not height and not lens:
        return None
    found = ["unknown camera pitch"] * pitch + ["unknown camera height, which metric placement needs"] * height
    found += ["unknown field of view of " + str(image.extra.get("camera", "the video's camera"))] * lens
    wanted = ["a pitch"] * pitch + ["an altitude"] * height + ["a field of view (hfov_deg)"] * lens
    fields = ["camera.pitch to {fixed_deg: ...}"] * pitch + ["camera.altitude to {fixed_m: ...}"] * height
    fields += ["camera.field_of_view to recipe, with the camera's own camera.focal_length_mm"] * lens
    some = any(
        known for missing, known in ((pitch, others.pitch), (height, others.height), (lens, others.lens)) if missing
    )
    return Problem(
        _place(image),
        "no-pitch" if pitch else "no-altitude" if height else "no-field-of-view",
        " and ".join(found),
        f"{' and '.join(wanted)} in the file name, the annotation or a metadata table",
        f"give a table (metadata.csv, docs/how_to/own_images.md), or set {' and '.join(fields)}{FOR_ALL * some}",
    )


@dataclass(frozen=True)
class _Telemetry:
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
    def of(cls, dataset: Dataset) -> _Telemetry:
        names = ("pitch_deg", "altitude_m", "hfov_deg")
        known = (any(getattr(i, name) is not None for i in dataset.images) for name in names)
        return cls(was_extracted(dataset), *known)


def _other_lens(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning if the recipe's lens replaces fields of view in the files that differ from it."""
    c = recipe.camera
    if not isinstance(c, MetricCamera) or c.field_of_view != "recipe":
        return []
    stated = 2 * math.degrees(math.atan(c.sensor_width_mm / 2 / c.focal_length_mm))
    other = [i.hfov_deg for i in images if i.hfov_deg is not None and abs(stated / i.hfov_deg - 1) > _LENS_TOLERANCE]
    if not other:
        return []
    span = f"{min(other):.1f}" if max(other) - min(other) < 0.1 else f"{min(other):.1f} to {max(other):.1f}"
    found = f"{stated:.1f} degrees across for all pictures, but the files of {len(other)} picture(s) state {span}"
    todo = (
        "set camera.field_of_view to metadata, or state no lens, unless another lens is wanted or the files are wrong"
    )
    return [Problem("camera.focal_length_mm", LENS_REPLACED, found, "the lens of the camera", todo, "warning")]


def _other_pitch(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning if the recipe's pitch replaces pitches in the files that differ from it."""
    if not isinstance(recipe.camera, MetricCamera):  # paper's ablations replace it on purpose
        return []
    match recipe.camera.pitch:
        case FixedPitch(fixed_deg=stated):
            low = high = stated
        case RandomPitch(random_deg=(low, high)):
            pass
        case _:
            return []
    low, high = low - _PITCH_TOLERANCE_DEG, high + _PITCH_TOLERANCE_DEG
    other = [i.pitch_deg for i in images if i.pitch_deg is not None and not low <= i.pitch_deg <= high]
    if not other:
        return []
    found = (
        f"a stated pitch, but the files of {len(other)} picture(s) state {min(other):.0f} to {max(other):.0f} degrees"
    )
    todo = "set camera.pitch to metadata, unless another view of the objects is wanted or the files are wrong"
    return [Problem("camera.pitch", PITCH_REPLACED, found, "the pitch of each picture", todo, "warning")]


def _sun_unused(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning if pictures that are not stated to be by day were taken with the sun in the sky."""
    if not isinstance(recipe.environment, SkyEnvironment) or recipe.environment.place is None:
        return []
    place, count = recipe.environment.place, 0
    for image in images:
        when = None if image.time_of_day == "day" else time_of(image.captured)
        if when is not None:
            _, elevation = sun_position(when, place.latitude_deg, place.longitude_deg)
            count += elevation > _SUN_IS_UP_RAD
    if not count:
        return []
    found = f"the sun is above the horizon in {count} picture(s) not stated to be by day, and is not used there"
    todo = "state time_of_day as day in the pictures' metadata, or check capture times, time zone and place"
    return [Problem("environment.place", "sun-above-horizon", found, "pictures by night", todo, "warning")]


def _scale_missing(image: ImageRecord, recipe: Recipe, dataset: Dataset) -> Problem:
    """Return the problem of a picture whose temperatures are needed and whose scale is unknown."""
    needed = "matching.mode radiometric" if isinstance(recipe.matching, RadiometricMatching) else "output.agc fixed"
    if "camera" in image.extra and any(p.code == "image-radiometric" for p in dataset.problems):
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
    if not isinstance(recipe, MetricSections) or recipe.camera.pitch != "metadata" or image.hfov_deg is None:
        return None
    w, h = image.size_wh or recipe.camera.size_px
    half_deg = math.degrees(math.atan(math.tan(math.radians(image.hfov_deg) / 2) * h / w))
    if image.pitch_deg is None or image.pitch_deg + half_deg > 0:
        return None
    return Problem(
        _place(image),
        "above-horizon",
        f"a camera pitch of {image.pitch_deg:g} degrees, so the whole picture is above the horizon",
        "ground in view, for metric placement on the ground",
        "leave the picture out, or correct its pitch in a metadata table",
    )


def _require_classes(recipe: Recipe, field: str, names: Collection[str], dataset: Dataset) -> None:
    unknown = unknown_classes(dataset, names)
    if unknown:
        known = ", ".join(c.name for c in dataset.categories) or "it has none"
        found, expected = f"found {', '.join(unknown)}", f"categories of the dataset ({known})"
        problem = Problem(field, "recipe-value", found, expected)
        raise RecipeError(f"recipe {recipe.name}: does not fit {dataset.root}", [problem])


def _unknown_by_hand(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning per frame that the recipe places objects in and that these backgrounds do not have."""
    if not recipe.frames:
        return []
    known = [f"{i.split}/{i.id}_c{k}" for i in images for k in range(recipe.configurations)]
    found = "no frame of this dataset has this id"
    return [
        Problem(f"frames.{name}", "frame-unknown", found, f"an id such as {similar(name, known)}", severity="warning")
        for name in sorted(recipe.frames.keys() - set(known))
    ]


def _require_loosened(recipe: Recipe, inserted: Collection[str]) -> None:
    """Check that `labels.loosen` and `labels.loosen_px` list classes of inserted objects; no other boxes change."""
    expected = f"classes of the inserted objects ({', '.join(sorted(inserted))})"
    faults = []
    for name, given in (("labels.loosen", recipe.labels.loosen), ("labels.loosen_px", recipe.labels.loosen_px)):
        unknown = [] if isinstance(given, float) else sorted(set(given) - set(inserted))
        if unknown:
            faults.append(Problem(name, "recipe-value", f"found {', '.join(unknown)}", expected))
    if faults:
        raise RecipeError(f"recipe {recipe.name}: no such inserted class", faults)


def _require_ids(recipe: Recipe, images: Sequence[ImageRecord]) -> None:
    """Check that the source's ids can be kept, before the first frame rather than after the last."""
    settings = WriteSettings(ids=recipe.output.ids)
    problems = []
    if settings.ids == "source" and (recipe.configurations > 1 or recipe.output.originals):
        found = f"source with {recipe.configurations} configuration(s){' and originals' * recipe.output.originals}"
        todo = "set output.ids to new, or configurations to 1 and output.originals to false"
        problems.append(Problem("output.ids", "recipe-value", found, "one frame per background", todo))
    for name in recipe.output.formats:
        problem = None if name == NATIVE else unwritable(name, images, settings)
        if problem is not None:
            problems.append(replace(problem, where=f"output.ids ({name})"))
    if problems:
        raise RecipeError(f"recipe {recipe.name}: the source's ids cannot be kept", problems)


def fingerprint(dataset: Dataset) -> str:
    """Return a digest of the images and labels of a dataset. Pixels are excluded: each frame's record covers those."""
    digest = hashlib.sha256()
    for c in dataset.categories:
        digest.update(f"{c.id}\x1f{c.name}\x1e".encode())
    for image in dataset.images:
        facts = (image.id, image.split, image.pitch_deg, image.altitude_m, image.time_of_day, image.size_wh)
        digest.update(repr(facts if image.hfov_deg is None else (*facts, image.hfov_deg)).encode())
        if image.roll_deg:
            digest.update(repr(("roll", image.roll_deg)).encode())
        # The sun follows sequence and time, temperatures the scale, and the camera's height where its altitude is from.
        more = (image.sequence, image.captured, image.radiometry, image.extra.get("altitude_from"))
        if any(v is not None for v in more):
            digest.update(repr(more).encode())
        for i in image.instances:
            digest.update(i.category.encode() + i.box_xyxy.tobytes())
            if i.corners_xy is not None:
                digest.update(i.corners_xy.tobytes())
    return digest.hexdigest()


def _count(values: Any) -> dict[str, int]:
    counts: dict[str, int] = {}
    for v in values:
        counts[v] = counts.get(v, 0) + 1
    return counts
