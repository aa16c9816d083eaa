"""Comparing a run's inserted objects with the real ones of its dataset, in four steps.

survey: measure every real and every inserted object in the saved pictures
pair:   real and inserted ones of like size
redo:   for the pairs alone, controls from the real ones, and the inserts again with parts of the sensor chain off
judge:  classifiers, medians, distances
"""

from __future__ import annotations

import io
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from infrablend.annotation.classes import rename_classes
from infrablend.assets.catalogue import load_model
from infrablend.compositing.mapping import GreyImage, GreyMapping
from infrablend.compositing.sensor import Sensor
from infrablend.config.modes import recipe_from_json
from infrablend.core.cores import take_core
from infrablend.core.dataset import SPLITS, Dataset, ImageRecord, Instance
from infrablend.core.files import write_bytes, write_json, write_text
from infrablend.core.render import Renderer, RenderResult
from infrablend.core.rng import stream
from infrablend.core.tasks import Executor, OnProgress, Progress, Task, WorkerSpec
from infrablend.errors import DatasetError
from infrablend.execution.process_pool import PoolSettings, ProcessPool
from infrablend.execution.serial import Serial
from infrablend.formats.images import Background, encode_image, load_background
from infrablend.pipeline.folder import RunFolder
from infrablend.pipeline.frame import make_renderer, paint
from infrablend.pipeline.models import ready_model
from infrablend.pipeline.record import FrameRecord, read_record
from infrablend.pipeline.rerender import recipe_json
from infrablend.realism.classify import require_sklearn
from infrablend.realism.controls import paste_controls
from infrablend.realism.features import Labels, Measured, eight_bit, measure, unfit
from infrablend.realism.matching import pair_by_size
from infrablend.realism.verdict import ClassVerdict, contrast_ratio, judge_class, judge_control, validity
from infrablend.report.realism import CropSheet, html_report, sheets_of
from infrablend.sampling.scene import SampledScene, build_meshes

Time = Literal["night", "day", "all"]
STEPS = ("chain_off", "psf", "halo", "noise", "codec")
"""The sensor chain, a step more each time; `codec` is the whole of it."""

JUDGED_BY = "Person"
WORKER = "infrablend.pipeline.realism:make_worker"
_EIGHT_BIT = (16.0, 235.0)


@dataclass(frozen=True)
class Settings:
    """What every worker needs.

    Attributes:
        run: Folder of the run.
        recipe_json: Its recipe.
        categories: Classes to measure.
        levels: Of the dataset, for 16-bit pictures.
        renderer: Name in `pipeline.frame.RENDERERS`.
        device: Where Cycles computes.
        pin_cores: Keep each worker on a core of its own.
    """

    run: Path
    recipe_json: str
    categories: tuple[str, ...]
    levels: tuple[float, float]
    renderer: str
    device: str
    pin_cores: bool = True


@dataclass(frozen=True, eq=False)
class Job:
    """One picture to look at; what is done with it depends on what is given.

    Attributes:
        background: The dataset's image.
        record: Frame of the run on it; None for the dataset's own picture.
        redo: Numbers of the objects to make controls of (without a record), or to render again (with one); None for
            measuring all there are.
    """

    background: ImageRecord
    record: FrameRecord | None = None
    redo: tuple[int, ...] | None = None


@dataclass(eq=False)
class Found:
    """Objects by population (`real`, `inserted`, `floor`, `hard_paste`, a step of the chain); what was left out."""

    objects: dict[str, list[Measured]] = field(default_factory=dict)
    left_out: dict[str, Counter[str]] = field(default_factory=dict)
    unreadable: list[str] = field(default_factory=list)

    def add(self, population: str, measured: Measured) -> None:
        """Keep an object."""
        self.objects.setdefault(population, []).append(measured)

    def skip(self, population: str, category: str, reason: str) -> None:
        """Count an object that is not measured."""
        self.left_out.setdefault(f"{population}/{category}", Counter())[reason] += 1

    def take(self, other: Found) -> None:
        """Add what another picture gave."""
        for population, objects in other.objects.items():
            self.objects.setdefault(population, []).extend(objects)
        for key, reasons in other.left_out.items():
            self.left_out.setdefault(key, Counter()).update(reasons)
        self.unreadable += other.unreadable

    def keep_twins(self) -> None:
        """Leave inserts out whose picture shows no real object of their class: nothing there says how one looks."""
        beside = {(m.category, m.group) for m in self.objects.get("real", [])}
        inserted = self.objects.get("inserted", [])
        self.objects["inserted"] = [m for m in inserted if (m.category, m.group) in beside]
        for m in inserted:
            if (m.category, m.group) not in beside:
                self.skip("inserted", m.category, "none_beside")

    def of(self, population: str, category: str) -> list[Measured]:
        """Sorted by key, so that the order of finishing does not matter."""
        return sorted((m for m in self.objects.get(population, []) if m.category == category), key=lambda m: m.key)


@dataclass(frozen=True, eq=False)
class _Shown:
    """A renderer that has its result already."""

    result: RenderResult

    def render(self, scene: Any, meshes: Any) -> RenderResult:
        return self.result

    def close(self) -> None:
        """Nothing to release."""


class Worker:
    """Measures pictures; one per worker process."""

    def __init__(self, settings: Settings) -> None:
        """Nothing heavy: the renderer starts with the first frame that is made again."""
        if settings.pin_cores:
            take_core()
        self._settings = settings
        self._recipe = recipe_from_json(settings.recipe_json)
        self._renderer: Renderer | None = None

    def __call__(self, task: Task) -> Found:
        """Do the `Job` in the task's payload."""
        job: Job = task.payload
        if job.record is not None:
            return self._frame(job, job.record) if job.redo is None else self._again(job, job.record, job.redo)
        return self._original(job) if job.redo is None else self._controls(job, job.redo)

    def close(self) -> None:
        """Release the renderer, if there is one."""
        if self._renderer is not None:
            self._renderer.close()

    def _original(self, job: Job) -> Found:
        source = job.background
        wanted = [(n, i) for n, i in enumerate(source.instances) if i.category in self._settings.categories]
        try:
            pixels = load_background(source.path, source.size_wh).pixels
        except DatasetError as error:  # `generate` has left it out, too
            return Found(unreadable=[error.message])
        return self._survey("real", pixels, source.instances, wanted, image_key(source), source)

    def _frame(self, job: Job, record: FrameRecord) -> Found:
        pixels = load_background(RunFolder(self._settings.run).image(record.image)).pixels
        labels = [job.background.instances[k] for k in record.kept] + list(record.inserted)
        wanted = [(n, i) for n, i in enumerate(record.inserted) if i.category in self._settings.categories]
        return self._survey("inserted", pixels, labels, wanted, record.frame_id, job.background)

    def _survey(
        self,
        population: str,
        pixels: GreyImage,
        labels: Sequence[Instance],
        wanted: Sequence[tuple[int, Instance]],
        key: str,
        source: ImageRecord,
    ) -> Found:
        found = Found()
        picture = eight_bit(pixels, self._settings.levels)
        where = Labels(picture.shape, labels)
        for number, instance in wanted:
            reason = unfit(instance, where)
            if reason:
                found.skip(population, instance.category, reason)
                continue
            found.add(
                population,
                measure(
                    picture,
                    instance,
                    where.free,
                    key=f"{key}#{number}",
                    group=image_key(source),
                    altitude_m=source.altitude_m,
                ),
            )
        return found

    def _controls(self, job: Job, numbers: Sequence[int]) -> Found:
        source, found = job.background, Found()
        background = load_background(source.path, source.size_wh)
        picture = eight_bit(background.pixels, self._settings.levels)
        chosen = [(n, source.instances[n]) for n in numbers]
        key = image_key(source)
        real, flat, placed, free = paste_controls(picture, Labels(picture.shape, source.instances), chosen, key)
        for n, i in chosen:
            if n not in placed:
                found.skip("floor", i.category, "no_place")
        kind = self._recipe.output.image
        for population, made in (("floor", real), ("hard_paste", flat)):
            saved = eight_bit(
                _saved(_levels(made, background, self._settings.levels), background, kind), self._settings.levels
            )
            for n, i in sorted(placed.items()):
                found.add(
                    population, measure(saved, i, free, key=f"{key}#{n}", group=key, altitude_m=source.altitude_m)
                )
        return found

    def _again(self, job: Job, record: FrameRecord, numbers: Sequence[int]) -> Found:
        """The frame once more, with a step more of the sensor chain each time; rendered once."""
        found = Found()
        fitted = record.facts.get("sensor")
        assert fitted is not None and record.scene is not None and record.mapping is not None
        background = load_background(job.background.path, job.background.size_wh)
        models = {o.model: load_model(o.model) for o in record.scene.objects}
        sampled = SampledScene(record.scene, build_meshes(record.scene, models))
        if self._renderer is None:
            self._renderer = make_renderer(self._settings.renderer, self._settings.device)
        rendered = _Shown(self._renderer.render(sampled.spec, sampled.meshes))
        mapping, overlay = GreyMapping.from_json(record.mapping), self._recipe.overlay
        labels = [job.background.instances[k] for k in record.kept] + list(record.inserted)
        where = Labels(background.pixels.shape, labels)
        for step, sensor in chain_steps(Sensor.from_json(fitted)).items():
            # The motion tail belongs to the optics.
            shown = replace(sampled, spec=replace(record.scene, motion_px=(0.0, 0.0))) if step == STEPS[0] else sampled
            made = paint(shown, background, rendered, mapping, overlay, sensor).pixels
            picture = eight_bit(_saved(made, background, self._recipe.output.image), self._settings.levels)
            for n in numbers:
                found.add(
                    step,
                    measure(
                        picture,
                        record.inserted[n],
                        where.free,
                        key=f"{record.frame_id}#{n}",
                        group=image_key(job.background),
                        altitude_m=job.background.altitude_m,
                    ),
                )
        return found


def make_worker(settings: Settings) -> Worker:
    """Worker factory, named by `execution` through its dotted name."""
    return Worker(settings)


def chain_steps(sensor: Sensor) -> dict[str, Sensor]:
    """The chain by steps; the range limits come with the halo, whose overshoot they cut."""
    off = replace(
        sensor,
        blur_sigma_px=None,
        defocus_sigma_px=0.0,
        halo_gain=0.0,
        noise_grey=0.0,
        limits=None,
        codec_quality=None,
    )
    psf = replace(off, blur_sigma_px=sensor.blur_sigma_px, defocus_sigma_px=sensor.defocus_sigma_px)
    halo = replace(psf, halo_gain=sensor.halo_gain, limits=sensor.limits)
    noise = replace(halo, noise_grey=sensor.noise_grey)
    return dict(zip(STEPS, (off, psf, halo, noise, sensor), strict=True))


def image_key(image: ImageRecord) -> str:
    """`<split>/<id>`: unique in the dataset."""
    return f"{image.split}/{image.id}"


def _levels(picture: Any, like: Background, levels: tuple[float, float]) -> GreyImage:
    """8-bit levels back in the file's own."""
    if like.pixels.dtype == np.uint8:
        return np.asarray(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    low, high = levels
    own = (picture.astype(np.float64) - 16) * (high - low) / 219 + low
    return np.asarray(np.clip(np.rint(own), 0, 65535).astype(np.uint16))


def _saved(pixels: GreyImage, like: Background, kind: Any) -> GreyImage:
    """The pixels after saving and reading."""
    with Image.open(io.BytesIO(encode_image(pixels, like, kind))) as picture:
        saved = np.array(picture)
    grey = saved if saved.ndim == 2 else saved[..., 0]
    return np.asarray(grey, np.uint8) if like.pixels.dtype == np.uint8 else np.asarray(grey, np.uint16)


@dataclass(frozen=True, eq=False)
class Material:
    """All that was measured: what the judging needs.

    Attributes:
        categories: Classes compared.
        found: All objects, the surveyed and the redone.
        pairs: (real, inserted) by class.
        controlled: Real objects by class that controls were made of: those of the pairs, and people in any case, as the
            method's validity is judged by theirs.
        sensor: False if the run was made without a sensor chain, so that there are no steps.
    """

    categories: tuple[str, ...]
    found: Found
    pairs: Mapping[str, Sequence[tuple[Measured, Measured]]]
    controlled: Mapping[str, Sequence[Measured]]
    sensor: bool


def gather(
    run: Path,
    dataset: Dataset,
    *,
    categories: Sequence[str] | None = None,
    time_of_day: Time = "all",
    most_pairs: int = 1000,
    workers: int = 1,
    in_process: bool = False,
    on_progress: OnProgress | None = None,
) -> Material:
    """Survey, pair and redo.

    Args:
        run: Folder of a finished run.
        dataset: What it was made from, with all splits that the run has frames of.
        categories: Classes; by default all that are both inserted and annotated.
        time_of_day: Only images of that time.
        most_pairs: Of each class; what bounds the time.
        workers: Processes.
        in_process: No processes at all; for tests.
        on_progress: Called after each picture.

    Raises:
        OutputError: `run` is no run.
        DatasetError: The frames' backgrounds are not in the dataset, or nothing is to be compared.
    """
    folder = RunFolder(run)
    about = folder.read_run()
    recipe = recipe_from_json(recipe_json(about))
    for o in recipe.objects:
        ready_model(o.model)
    dataset = rename_classes(dataset, recipe.labels.rename)
    records = _records(run, time_of_day)
    images = {image_key(i): i for i in dataset.images if time_of_day in ("all", i.time_of_day)}
    lost = sorted({_background_key(r) for r in records} - set(images))
    if lost:
        raise DatasetError(
            f"{dataset.root}: does not hold {len(lost)} of the backgrounds that {run} was made from, e.g. {lost[0]}; "
            "expected the dataset of that run. Give it with --against"
        )
    chosen = _categories(run, dataset, records, categories)
    splits = {r.frame_id.split("/")[0] for r in records}
    originals = [i for k, i in images.items() if i.split in splits]
    named = {c.name for c in dataset.categories}
    measured = chosen if JUDGED_BY not in named or JUDGED_BY in chosen else (*chosen, JUDGED_BY)
    settings = Settings(
        run,
        recipe.model_dump_json(),
        measured,
        _run_levels(records),
        about["machine"]["renderer"],
        about["machine"]["device"],
        not in_process,
    )
    surveyed = [Job(i) for i in originals if any(o.category in measured for o in i.instances)]
    surveyed += [Job(images[_background_key(r)], r) for r in records if any(o.category in chosen for o in r.inserted)]
    clock = _Clock(on_progress, len(surveyed))
    found = Found()
    for part in _run(settings, surveyed, workers, in_process, clock):
        found.take(part)
    found.keep_twins()
    pairs = {c: pair_by_size(found.of("real", c), found.of("inserted", c), most_pairs) for c in chosen}
    sensor = any(r.facts.get("sensor") for r in records)
    controlled = {c: [real for real, _ in pairs[c]] for c in chosen}
    if measured != chosen:
        controlled[JUDGED_BY] = _some([m for m in found.of("real", JUDGED_BY) if not m.flaw], most_pairs)
    redo = _redo(controlled, pairs, images, {r.frame_id: r for r in records}, sensor)
    clock.total += len(redo)
    for part in _run(settings, redo, workers, in_process, clock):
        found.take(part)
    return Material(chosen, found, pairs, controlled, sensor)


def _background_key(record: FrameRecord) -> str:
    return f"{record.frame_id.split('/')[0]}/{record.background['id']}"


def _records(run: Path, time_of_day: Time) -> list[FrameRecord]:
    inserted = []
    for split in SPLITS:
        for path in sorted((run / "scenes" / split).glob("*.json")):
            record = read_record(path)
            if record is None:
                raise DatasetError(f"{path}: is no frame record that can be read. Run `generate --resume`.")
            if record.inserted:
                inserted.append(record)
    found = [r for r in inserted if time_of_day in ("all", r.background["time_of_day"])]
    if not inserted:
        raise DatasetError(f"{run}: no frame with an inserted object; there is nothing to compare")
    if not found:
        times = Counter(r.background["time_of_day"] or "unknown" for r in inserted)
        raise DatasetError(
            f"{run}: no frame by {time_of_day} has an inserted object; those that have are "
            f"{', '.join(f'{t} {n}' for t, n in sorted(times.items()))}. Leave --time away, or generate on more "
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
            f"{run}: inserted are {', '.join(sorted(inserted))}, annotated in {dataset.root} are "
            f"{', '.join(sorted(real)) or 'none'}: no class is both. Give the inserted object the class of its real "
            "twins (--set objects.0.category=Person)"
        )
    return tuple(both)


def _run_levels(records: Sequence[FrameRecord]) -> tuple[float, float]:
    """The dataset's levels as the run measured them; of no account for 8-bit pictures."""
    for r in records:
        levels = r.facts.get("matching", {}).get("levels") or (r.facts.get("sensor") or {}).get("limits")
        if levels:
            return float(levels[0]), float(levels[1])
    return _EIGHT_BIT


def _some(objects: Sequence[Measured], most: int) -> list[Measured]:
    order = stream(0, "some").permutation(len(objects))[:most]
    return [objects[int(k)] for k in sorted(order)]


def _redo(
    controlled: Mapping[str, Sequence[Measured]],
    pairs: Mapping[str, Sequence[tuple[Measured, Measured]]],
    images: Mapping[str, ImageRecord],
    records: Mapping[str, FrameRecord],
    sensor: bool,
) -> list[Job]:
    reals: dict[str, list[int]] = {}
    frames: dict[str, list[int]] = {}
    keys = [(m.key, reals) for of_class in controlled.values() for m in of_class]
    keys += [(inserted.key, frames) for of_class in pairs.values() for _, inserted in of_class]
    for key, into in keys:
        name, _, number = key.rpartition("#")
        into.setdefault(name, []).append(int(number))
    jobs = [Job(images[k], None, tuple(sorted(n))) for k, n in sorted(reals.items())]
    if sensor:
        jobs += [
            Job(images[_background_key(records[k])], records[k], tuple(sorted(n)))
            for k, n in sorted(frames.items())
            if records[k].facts.get("sensor")
        ]
    return jobs


class _Clock:
    def __init__(self, tell: OnProgress | None, total: int) -> None:
        self.total = total
        self._tell, self._done, self._start = tell, 0, time.monotonic()

    def tick(self) -> None:
        self._done += 1
        if self._tell is not None:
            rate = self._done / max(time.monotonic() - self._start, 1e-9)
            self._tell(Progress(self._done, self.total, rate, (self.total - self._done) / rate))


def _run(settings: Settings, jobs: Sequence[Job], workers: int, in_process: bool, clock: _Clock) -> Iterator[Found]:
    if not jobs:
        return
    spec = WorkerSpec(WORKER, settings)
    executor: Executor = Serial(spec) if in_process else ProcessPool(spec, PoolSettings(workers=max(1, workers)))
    tasks = [Task(j.record.frame_id if j.record else image_key(j.background), j) for j in jobs]
    for result in executor.run(tasks):
        if result.failure is not None:
            raise result.failure.to_exception()
        clock.tick()
        yield result.value


@dataclass(frozen=True)
class RealismReport:
    """What a comparison found and where it is written.

    Attributes:
        out: Folder with `realism.json`, `realism.html` and the sheets of crops.
        facts: The content of `realism.json`.
    """

    out: Path
    facts: Mapping[str, Any]

    @property
    def valid(self) -> bool:
        """True if the figures of every class count."""
        return all(c["valid"] for c in self.facts["classes"].values())

    def to_json(self) -> dict[str, Any]:
        """The content of `realism.json`, and the folder."""
        return {**self.facts, "out": str(self.out)}


def compare(
    run: Path,
    dataset: Dataset,
    out: Path,
    *,
    categories: Sequence[str] | None = None,
    time_of_day: Time = "all",
    most_pairs: int = 1000,
    workers: int = 1,
    in_process: bool = False,
    on_progress: OnProgress | None = None,
) -> RealismReport:
    """Gather, judge and write; see `gather` for the arguments.

    Raises:
        MissingDependencyError: scikit-learn is not installed.
        OutputError, DatasetError: See `gather`.
    """
    require_sklearn()
    material = gather(
        run,
        dataset,
        categories=categories,
        time_of_day=time_of_day,
        most_pairs=most_pairs,
        workers=workers,
        in_process=in_process,
        on_progress=on_progress,
    )
    found = material.found
    verdicts = [
        judge_class(
            c,
            found.of("real", c),
            found.of("inserted", c),
            material.pairs[c],
            {name: found.of(name, c) for name in ("floor", "hard_paste", *(STEPS if material.sensor else ()))},
        )
        for c in material.categories
    ]
    people = _people(material, verdicts)
    by_name = {v.category: v.facts for v in verdicts}
    for v in verdicts:
        v.facts.update(validity(v.facts, people["floor_logistic"]))
        for population in ("real", "inserted", "floor"):
            v.facts.setdefault("left_out", {})[population] = dict(
                sorted(found.left_out.get(f"{population}/{v.category}", Counter()).items())
            )
    facts: dict[str, Any] = {
        "version": 1,
        "time_of_day": time_of_day,
        "most_pairs": most_pairs,
        "run": {"seed": RunFolder(run).read_run()["seed"], "recipe": RunFolder(run).read_run()["recipe"]["name"]},
        "unreadable": sorted(found.unreadable),
        "person_floor": people,
        "classes": by_name,
        "ablation": {v.category: v.ablation for v in verdicts},
    }
    if "Car" in by_name and "Person" in by_name:
        facts["car_to_person_contrast"] = contrast_ratio(by_name["Car"], by_name["Person"])
    write_json(out / "realism.json", facts)
    sheets: list[CropSheet] = [s for v in verdicts for s in sheets_of(v)]
    for sheet in sheets:
        write_bytes(out / f"{sheet.name}.png", sheet.png)
    write_text(out / "realism.html", html_report(facts, verdicts, sheets))
    return RealismReport(out, facts)


def _people(material: Material, verdicts: Sequence[ClassVerdict]) -> dict[str, Any]:
    """The floor of people, by which the method itself is judged, also where none were inserted."""
    for v in verdicts:
        if v.category == JUDGED_BY:
            return {k: v.facts[k] for k in ("floor_n", "floor_logistic", "floor_boosting", "floor_ci")}
    real = material.controlled.get(JUDGED_BY, ())
    return judge_control("floor", real, material.found.of("floor", JUDGED_BY))
