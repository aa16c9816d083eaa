"""Comparison of a run's inserted objects with the real ones of its dataset, in four steps.

survey:  measure every real and every inserted object in the saved pictures
pair:    choose pairs of real and inserted objects of similar size
redo:    for the pairs alone, make controls from the real objects, and render the inserted ones again with parts of
         the sensor chain switched off
compare: classifiers, medians, distances
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from infrablend.annotation.classes import rename_classes
from infrablend.annotation.measured_looseness import looseness, looseness_against
from infrablend.compositing.mapping import measure_levels
from infrablend.core.arguments import require_choice, require_names, require_whole
from infrablend.core.dataset import SPLITS, Dataset, ImageRecord, KnownClass, known_class, named_as
from infrablend.core.file_names import distinct_names, file_name, real_path
from infrablend.core.files import write_bytes, write_text
from infrablend.core.frame_row import FrameRecord
from infrablend.core.rng import stream
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import Executor, OnProgress, Task, WorkerSpec, paced
from infrablend.core.workspace import workspace
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background
from infrablend.formats.pictures.temperature_scale import is_deep
from infrablend.lab.pages.realism_report import CropSheet, html_report, sheets_of
from infrablend.lab.realism.class_comparison import (
    ClassComparison,
    compare_class,
    compare_contrasts,
    compare_floor,
    contrast_ratio,
    pair_by_size,
    validity,
)
from infrablend.lab.realism.classify import require_sklearn
from infrablend.lab.realism.controls import SENSOR_STEPS
from infrablend.lab.realism.features import Measured
from infrablend.lab.realism.measure_objects import Measurements, MeasuringSettings, PictureJob, image_key
from infrablend.lab.realism.realism_record import ComparedRun, FloorScores, RealismRecord
from infrablend.pipeline.execution.process_pool import PoolSettings, ProcessPool
from infrablend.pipeline.execution.serial import Serial
from infrablend.pipeline.plans.models import ready_model
from infrablend.pipeline.plans.planning import LEVELS_SAMPLE
from infrablend.pipeline.runs.record import RecordedRun

Time = Literal["night", "day", "all"]

# The class whose real control decides whether the method's figures are valid.
_REFERENCE: KnownClass = "person"
RECORD = "realism.json"
WORKER = "infrablend.lab.realism.measure_objects:ObjectMeasurer"
_EIGHT_BIT = (16.0, 235.0)


@dataclass(frozen=True)
class ComparisonRequest:
    """What to compare, and with how many processes.

    Attributes:
        categories: Classes to compare; by default all that are both inserted and annotated.
        time_of_day: Time of day of the images to use.
        most_pairs: Largest number of pairs per class; this bounds the time.
        workers: Number of processes.
        in_process: Whether to use no processes at all; for tests.
        real: Dataset of the real objects; None if they are in the pictures that the run was made from.
        steps: Whether to render the inserted objects again with each step of the sensor chain.

    Raises:
        ArgumentError: A value is not one of these.
    """

    categories: Sequence[str] | None = None
    time_of_day: Time = "all"
    most_pairs: int = 1000
    workers: int = 1
    in_process: bool = False
    real: Dataset | None = None
    steps: bool = True

    def __post_init__(self) -> None:
        require_names("categories", self.categories)
        require_choice("time_of_day", self.time_of_day, get_args(Time))
        require_whole("pairs", self.most_pairs, 1)


@dataclass(frozen=True, eq=False)
class Material:
    """Everything that was measured for a comparison.

    Attributes:
        categories: Classes to compare.
        found: All measured objects, from the survey and from the redone pictures.
        pairs: (real, inserted) pairs by class.
        controlled: Real objects by class that controls were made of: those of the pairs, and always people, whose
            controls decide whether the method is valid.
        sensor: Whether the run has a sensor chain, so that there are steps to compare.
    """

    categories: tuple[str, ...]
    found: Measurements
    pairs: Mapping[str, Sequence[tuple[Measured, Measured]]]
    controlled: Mapping[str, Sequence[Measured]]
    sensor: bool


def measure_populations(
    run: Path, dataset: Dataset, request: ComparisonRequest, on_progress: OnProgress | None = None
) -> Material:
    """Survey a finished run and the dataset that it was made from, with all its splits; pair and redo objects.

    Raises:
        OutputError: `run` is not a run.
        DatasetError: The run is unfinished, the frames' backgrounds are not in the dataset, or there is nothing to
            compare.
    """
    folder = RunFolder(run)
    recorded = RecordedRun.read(folder)
    recipe = recorded.recipe
    for o in recipe.objects:
        ready_model(o.model)
    dataset = rename_classes(dataset, recipe.labels.rename)
    real = dataset if request.real is None else request.real
    records = _records(run, request.time_of_day)
    backgrounds = {image_key(i): i for i in dataset.images if request.time_of_day in ("all", i.capture.time_of_day)}
    lost = sorted({_background_key(r) for r in records} - set(backgrounds))
    if lost:
        raise DatasetError(
            f"{dataset.root}: {len(lost)} of the backgrounds of {run} are missing, e.g. {lost[0]}; "
            "expected the dataset that the run was made from. Give it with --against, and a dataset of other pictures "
            "whose real objects are to be compared with --real"
        )
    _require_like_levels(backgrounds, real)
    chosen = _categories(run, real, records, request.categories)
    splits = set(SPLITS) if request.real else {r.frame_id.split("/")[0] for r in records}
    originals = {
        image_key(i): i
        for i in real.images
        if i.split in splits and request.time_of_day in ("all", i.capture.time_of_day)
    }
    people = named_as(_REFERENCE, (c.name for c in real.categories))
    measured = chosen if people is None or people in chosen else (*chosen, people)
    settings = MeasuringSettings(
        run,
        recipe.model_dump_json(),
        measured,
        _run_levels(records, list(backgrounds.values())),
        recorded.renderer,
        recorded.device,
        not request.in_process,
    )
    surveyed = [PictureJob(i) for i in originals.values() if any(o.category in measured for o in i.instances)]
    surveyed += [
        PictureJob(backgrounds[_background_key(r)], r) for r in records if any(o.category in chosen for o in r.inserted)
    ]
    found = Measurements()
    report = paced(on_progress)
    _run(found, settings, surveyed, request, report)
    if request.real is None:
        found.drop_without_real_object()
    pairs = {c: pair_by_size(found.of("real", c), found.of("inserted", c), request.most_pairs) for c in chosen}
    sensor = request.steps and any(r.facts.get("sensor") for r in records)
    controlled = {c: [real for real, _ in pairs[c]] for c in chosen}
    if people is not None and people not in chosen:
        usable = [m for m in found.of("real", people) if not m.flaw]
        some = stream(0, "some").permutation(len(usable))[: request.most_pairs]
        controlled[people] = [usable[int(k)] for k in sorted(some)]
    numbers = _numbers_by_picture(m.key for of_class in controlled.values() for m in of_class)
    redo = [PictureJob(originals[k], None, n) for k, n in numbers.items()]
    if sensor:
        by_id = {r.frame_id: r for r in records if r.facts.get("sensor")}
        numbers = _numbers_by_picture(inserted.key for of_class in pairs.values() for _, inserted in of_class)
        redo += [
            PictureJob(backgrounds[_background_key(by_id[k])], by_id[k], n) for k, n in numbers.items() if k in by_id
        ]
    _run(found, settings, redo, request, report, len(surveyed))
    return Material(chosen, found, pairs, controlled, sensor)


def _background_key(record: FrameRecord) -> str:
    return f"{record.frame_id.split('/')[0]}/{record.background['id']}"


def _records(run: Path, time_of_day: Time) -> list[FrameRecord]:
    inserted = [r for r in RunFolder(run).records() if r.inserted]
    inserted.sort(key=lambda r: (SPLITS.index(r.frame_id.split("/")[0]), r.frame_id))
    found = [r for r in inserted if time_of_day in ("all", r.background.get("time_of_day"))]
    if not inserted:
        raise DatasetError(f"{run}: no frame has an inserted object; there is nothing to compare")
    if not found:
        times = Counter(r.background.get("time_of_day") or "unknown" for r in inserted)
        raise DatasetError(
            f"{run}: no frame taken by {time_of_day} has an inserted object; frames with one: "
            f"{', '.join(f'{t} {n}' for t, n in sorted(times.items()))}. Omit --time, or generate on more "
            "backgrounds (--limit takes the first in sorted order)."
        )
    return found


def _categories(
    run: Path, dataset: Dataset, records: Sequence[FrameRecord], wanted: Sequence[str] | None
) -> tuple[str, ...]:
    inserted = {i.category for r in records for i in r.inserted}
    real = {i.category for image in dataset.images for i in image.instances}
    both = sorted(inserted & real)
    if wanted is not None:
        missing = sorted(set(wanted) - set(both))
        if missing:
            raise DatasetError(
                f"{run}: {', '.join(missing)}: expected classes that are both inserted ({', '.join(sorted(inserted))}) "
                f"and annotated in {dataset.root} ({', '.join(sorted(real)) or 'nothing'})"
            )
        return tuple(dict.fromkeys(wanted))
    if not both:
        raise DatasetError(
            f"{run}: no class is both inserted ({', '.join(sorted(inserted))}) and annotated in {dataset.root} "
            f"({', '.join(sorted(real)) or 'none'}). Give the inserted object the class of its real "
            "counterparts (--set objects.0.category=Person), or name another dataset that shows real ones (--real)"
        )
    return tuple(both)


def _run_levels(records: Sequence[FrameRecord], backgrounds: Sequence[ImageRecord]) -> tuple[float, float]:
    """Return the dataset's levels as the run measured them, or those of backgrounds with temperatures.

    8-bit pictures do not need them.
    """
    for r in records:
        levels = r.facts.get("matching", {}).get("levels") or (r.facts.get("sensor") or {}).get("limits")
        if levels:
            return float(levels[0]), float(levels[1])
    sample = backgrounds[:: max(1, len(backgrounds) // LEVELS_SAMPLE)][:LEVELS_SAMPLE]
    pictures = [load_background(i.path, i.size_wh).pixels for i in sample if is_deep(i)]
    return measure_levels(pictures) if pictures else _EIGHT_BIT


def _require_like_levels(backgrounds: Mapping[str, ImageRecord], real: Dataset) -> None:
    """Refuse real objects in pictures of another depth or scale, whose levels mean something else.

    Raises:
        DatasetError: One side has 8-bit pictures, and the other 16-bit ones; or the levels of 16-bit pictures have
            another scale of temperatures.
    """
    first = next((i for i in real.images if i.instances), None)
    if first is None or not backgrounds:
        return
    background = next(iter(backgrounds.values()))
    inserted = is_deep(background)
    scales = [i.capture.scale for i in (first, background)]
    if inserted != is_deep(first):
        code = "image-depth"
        expected = "pictures of the same depth"
        found = f"{8 + 8 * is_deep(first)}-bit pictures, and {8 + 8 * inserted}-bit ones in the run"
        todo = "compare a run on 8-bit pictures, or give real objects in 16-bit pictures with --real"
    elif scales[0] != scales[1] and not background.path.is_relative_to(real.root):
        code = "image-scale"
        expected = "levels of the same scale"
        found = f"levels with the scale {scales[0]}, and with {scales[1]} in the run"
        todo = "give pictures of the same unit with --real"
    else:
        return
    problem = Problem(real.root.name, code, found, expected, todo)
    raise DatasetError(f"{real.root}: levels that cannot be compared", [problem])


def _numbers_by_picture(keys: Iterable[str]) -> dict[str, tuple[int, ...]]:
    """Return the sorted numbers of the objects in each picture, from keys `<picture>#<number>`."""
    found: dict[str, list[int]] = {}
    for key in keys:
        name, _, number = key.rpartition("#")
        found.setdefault(name, []).append(int(number))
    return {name: tuple(sorted(numbers)) for name, numbers in sorted(found.items())}


def _run(
    found: Measurements,
    settings: MeasuringSettings,
    jobs: Sequence[PictureJob],
    request: ComparisonRequest,
    report: Callable[[int, int], None] | None,
    before: int = 0,
) -> None:
    """Add what is measured in pictures to `found`; `before` is the number of pictures that were reported earlier."""
    if not jobs:
        return
    spec = WorkerSpec(WORKER, settings)
    executor: Executor = (
        Serial(spec) if request.in_process else ProcessPool(spec, PoolSettings(workers=max(1, request.workers)))
    )
    tasks = [Task(j.record.frame_id if j.record else image_key(j.background), j) for j in jobs]
    for done, result in enumerate(executor.run(tasks), before + 1):
        if result.failure is not None:
            raise result.failure.to_exception()
        found.extend(result.value)
        if report is not None:
            report(done, before + len(jobs))


@dataclass(frozen=True)
class RealismReport:
    """The result of a comparison.

    Attributes:
        out: Folder of `realism.json`, `realism.html` and the sheets of crops.
        facts: Content of `realism.json`.
    """

    out: Path
    facts: RealismRecord

    @property
    def valid(self) -> bool:
        """Whether the figures of every class are valid."""
        return all(c["valid"] for c in self.facts["classes"].values())

    def to_json(self) -> dict[str, object]:
        """Return the content of `realism.json`, and the folder."""
        return {**self.facts, "out": str(self.out)}


def compare(
    run: Path,
    dataset: Dataset,
    out: Path,
    request: ComparisonRequest | None = None,
    on_progress: OnProgress | None = None,
) -> RealismReport:
    """Compare the inserted objects of a run with real ones and write the report; arguments as `measure_populations`.

    An earlier comparison in `out` is replaced.

    Raises:
        MissingDependencyError: scikit-learn is not installed.
        OutputError: See `measure_populations`; or `out` cannot be written, or has anything else in it.
        DatasetError: See `measure_populations`.
    """
    request = request if request is not None else ComparisonRequest()
    require_sklearn()
    with workspace(out, "comparison", RECORD, "overwrite") as space:
        material = measure_populations(run, dataset, request, on_progress)
        comparisons, people = _compare_classes(material)
        facts: RealismRecord = {
            "version": 1,
            "time_of_day": request.time_of_day,
            "most_pairs": request.most_pairs,
            "run": _run_facts(run, dataset, request),
            "unreadable": sorted(material.found.unreadable),
            "person_floor": people,
            "classes": {v.category: v.facts for v in comparisons},
            "ablation": {v.category: v.ablation for v in comparisons},
        }
        cars, persons = (named_as(known, facts["classes"]) for known in ("car", "person"))
        if cars is not None and persons is not None:
            facts["car_to_person_contrast"] = contrast_ratio(facts["classes"][cars], facts["classes"][persons])
        names = distinct_names([file_name(v.category.lower()) for v in comparisons])
        sheets: list[CropSheet] = [s for v, name in zip(comparisons, names, strict=True) for s in sheets_of(v, name)]
        for sheet in sheets:
            write_bytes(space.folder / f"{sheet.name}.png", sheet.png)
        write_text(space.folder / "realism.html", html_report(facts, comparisons, sheets))
        space.finish(facts)
    return RealismReport(out, facts)


def _compare_classes(material: Material) -> tuple[list[ClassComparison], FloorScores]:
    found = material.found
    redone = ("floor", "hard_paste", *(SENSOR_STEPS if material.sensor else ()))
    comparisons = [
        compare_class(
            c,
            found.of("real", c),
            found.of("inserted", c),
            material.pairs[c],
            {name: found.of(name, c) for name in redone},
        )
        for c in material.categories
    ]
    people = _people(material, comparisons)
    for v in comparisons:
        real = found.contrasts_of("real", v.category)
        valid = validity(v.facts["n"], v.facts["hard_paste_logistic"], people["floor_logistic"])
        v.facts["valid"] = valid["valid"]
        v.facts["invalid_because"] = valid["invalid_because"]
        v.facts["contrast"] = compare_contrasts(real, found.contrasts_of("inserted", v.category))
        if written := found.contrasts_of("as_written", v.category):
            v.facts["contrast_as_written"] = compare_contrasts(real, written)
        drawn, exact = (found.extents_of(population, v.category) for population in ("real", "inserted"))
        v.facts["box_looseness"] = {
            "real": looseness(drawn),
            "inserted": looseness(exact),
            "real_against_inserted": looseness_against(drawn, exact),
        }
        v.facts["left_out"] = {
            population: dict(sorted(found.left_out[f"{population}/{v.category}"].items()))
            for population in ("real", "inserted", "floor")
        }
    return comparisons, people


def _run_facts(run: Path, dataset: Dataset, request: ComparisonRequest) -> ComparedRun:
    about = RunFolder(run).read_run()
    real = dataset if request.real is None else request.real
    with RunFolder(run).ledger() as ledger:
        frames = ledger.frame_ids()
    splits = [s for s in SPLITS if any(f.startswith(f"{s}/") for f in frames)]
    return {
        "seed": about["seed"],
        "recipe": about["recipe"]["name"],
        "frames": len(frames),
        "backgrounds": real_path(dataset.root).name,
        "splits": splits,
        "real": real_path(real.root).name,
        "real_splits": splits if request.real is None else [s for s in SPLITS if s in {i.split for i in real.images}],
    }


def _people(material: Material, comparisons: Sequence[ClassComparison]) -> FloorScores:
    """Return the real control of people, which decides on the method's validity, even where none were inserted."""
    for v in comparisons:
        if known_class(v.category) == _REFERENCE:
            return {
                "floor_n": v.facts["floor_n"],
                "floor_logistic": v.facts["floor_logistic"],
                "floor_boosting": v.facts["floor_boosting"],
                "floor_ci": v.facts["floor_ci"],
            }
    people = named_as(_REFERENCE, material.controlled)
    if people is None:
        return compare_floor((), ())
    return compare_floor(material.controlled[people], material.found.of("floor", people))
