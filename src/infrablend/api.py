"""The Python interface: everything the command line does, as functions.

    from infrablend import api

    report = api.generate("hit-uav-drone", data="hit-uav", out="runs/first", limit=10)
    print(report.counts)
    api.preview("runs/first", "runs/first/preview.png")

Options that belong together are one value, such as `Reading` (how to read a dataset) or `Execution` (how to compute
frames). Examples below run in the tests on a dataset of four pictures, without Blender.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from infrablend.assets import catalogue
from infrablend.config import loading
from infrablend.core.dataset import Dataset
from infrablend.core.output import Existing, require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.fetching import fetch as fetching
from infrablend.fetching.fetch import FetchReport, OnFetch
from infrablend.formats import detection
from infrablend.formats.reading import READ_ALL, Reading
from infrablend.formats.writing import WriteSettings
from infrablend.pipeline import world
from infrablend.pipeline.compare_objects import ComparisonRequest, RealismReport, Time, compare
from infrablend.pipeline.convert import KEEP_CLASSES, ClassChanges, ConvertReport, convert_dataset
from infrablend.pipeline.experiments.request import ExperimentRequest
from infrablend.pipeline.generate import describe_run, generate_run
from infrablend.pipeline.models import ready_model, run_once
from infrablend.pipeline.request import DEFAULT_EXECUTION, Execution, RunRequest, Settings
from infrablend.pipeline.rerender import rerender_frame
from infrablend.pipeline.run import RunReport
from infrablend.pipeline.select import SELECT_ALL, Selection
from infrablend.pipeline.split import SplitReport, SplitRule, split_dataset
from infrablend.pipeline.train import (
    TrainPlan,
    TrainReport,
    choose_preset,
    plan_training,
    train_dataset,
)
from infrablend.world.dataset import WorldRequest

if TYPE_CHECKING:
    from infrablend.pipeline.evaluate import EvaluationReport
    from infrablend.pipeline.experiments.plan import ExperimentPlan
    from infrablend.pipeline.experiments.run import ExperimentReport, OnStage
    from infrablend.pipeline.profile import ProfileReport
    from infrablend.report.checking import CheckReport
    from infrablend.report.doctor import Diagnosis
    from infrablend.report.inspection import Inspection
    from infrablend.report.preview import Draw

__all__ = [
    "ClassChanges",
    "ConvertReport",
    "Execution",
    "ExperimentRequest",
    "FetchReport",
    "PlanReport",
    "Reading",
    "RealismReport",
    "RunReport",
    "Selection",
    "SplitReport",
    "SplitRule",
    "TrainPlan",
    "TrainReport",
    "WriteSettings",
    "check",
    "compare_evaluations",
    "convert",
    "describe_source",
    "diagnose",
    "evaluate",
    "experiment",
    "fetch",
    "generate",
    "inspect",
    "list_experiments",
    "list_models",
    "list_recipes",
    "list_sources",
    "make_world",
    "plan",
    "plan_experiment",
    "plan_train",
    "preview",
    "preview_ground",
    "profile",
    "read_dataset",
    "realism",
    "rerender",
    "show_model",
    "show_recipe",
    "split",
    "train",
    "write_infrared_effect",
]


@dataclass(frozen=True)
class PlanReport:
    """Frames, disk space and time of a run that has not been started."""

    facts: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return dict(self.facts)


def generate(
    recipe: str | Path,
    data: str | Path,
    out: str | Path,
    *,
    limit: int | None = None,
    seed: int = 0,
    settings: Settings = (),
    reading: Reading = READ_ALL,
    execution: Execution = DEFAULT_EXECUTION,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> RunReport:
    """Insert rendered objects into a dataset and write the enlarged dataset with merged labels.

    >>> fake = Execution(renderer="fake", in_process=True)
    >>> report = generate("hit-uav-drone", "hit-uav", "runs/first", limit=2, execution=fake)
    >>> report.ok, report.counts["frames"]
    (True, 4)

    Args:
        recipe: Name of a shipped recipe, or path of a YAML file.
        data: Folder of the background dataset.
        out: Folder to write.
        limit: Number of backgrounds to use, the first ones in sorted order.
        seed: The same seed, data and recipe give the same bytes.
        settings: Recipe fields to set: `["output.image=png"]` or `{"output.formats": ["yolo", "coco"]}`.
        reading: How to read `data`, e.g. `Reading(splits=("train",))`.
        execution: Workers, device and renderer, e.g. `Execution(workers=2, device="cuda")`.
        existing: What to do if `out` already contains a run: `refuse`, `resume` or `overwrite`.
        on_progress: Called after each frame.

    Raises:
        RecipeError, DatasetError, ModelError, OutputError, RenderError, Interrupted: See `infrablend.errors`.
    """
    request = RunRequest(recipe, Path(data), Path(out), limit, seed, settings, reading, execution, existing)
    return generate_run(request, on_progress)


def plan(
    recipe: str | Path,
    data: str | Path,
    out: str | Path | None = None,
    *,
    limit: int | None = None,
    seed: int = 0,
    settings: Settings = (),
    reading: Reading = READ_ALL,
    execution: Execution = DEFAULT_EXECUTION,
) -> PlanReport:
    """Return what `generate` with the same arguments would write, without writing it.

    >>> plan("hit-uav-drone", "hit-uav").facts["frames"]
    8
    """
    request = RunRequest(recipe, Path(data), _path(out), limit, seed, settings, reading, execution)
    return PlanReport(describe_run(request))


def rerender(run: str | Path, frame_id: str, out: str | Path | None = None, *, data: str | Path | None = None) -> Path:
    """Render one frame of a run again and return the path of the picture; it has the same bytes.

    Args:
        run: Folder of the run.
        frame_id: `<split>/<background>_c<k>`.
        out: File to write; the frame's own file name in the current folder by default.
        data: Folder of the backgrounds, if it has moved.
    """
    return rerender_frame(Path(run), frame_id, _path(out), _path(data))


def preview(
    run: str | Path, out: str | Path, count: int = 12, draw: Sequence[Draw] = ("boxes", "obb", "masks")
) -> Path:
    """Write a contact sheet of a run with its labels drawn and inserted objects enlarged; return its path."""
    from infrablend.report.preview import preview_run

    return preview_run(Path(run), Path(out), count, draw)


def preview_ground(run: str | Path, out: str | Path, count: int = 6) -> Path:
    """Write frames of a metric run with the ground grid and people of 1.7 m, to check the scale; return the path."""
    from infrablend.report.ground_preview import ground_sheet

    return ground_sheet(Path(run), Path(out), count)


def read_dataset(data: str | Path, reading: Reading = READ_ALL) -> Dataset:
    """Read a dataset of any supported format into memory.

    >>> dataset = read_dataset("hit-uav", Reading(splits=("train",)))
    >>> dataset.format, len(dataset.images)
    ('hit-uav', 2)

    Raises:
        UnknownFormatError: No format fits; `problems` gives the reason for each of them.
        DatasetError: The folder cannot be read.
    """
    return detection.read(Path(data), reading)


def inspect(
    data: str | Path, out: str | Path | None = None, *, reading: Reading = READ_ALL, decode: bool = False
) -> Inspection:
    """Return splits, classes, sizes, coverage, sequences, leakage and problems of a dataset.

    Args:
        data: Folder of the dataset.
        out: Folder for the charts `inspect.png` and for `inspect.json`; None writes nothing.
        reading: How to read `data`.
        decode: Also decode every picture for bit depth, channels, grey levels and broken files.
    """
    from infrablend.pipeline.examine import inspect_folder

    return inspect_folder(Path(data), _path(out), reading=reading, decode=decode)


def check(
    data: str | Path, *, reading: Reading = READ_ALL, decode: bool = True, on_progress: OnProgress | None = None
) -> CheckReport:
    """Return every problem of the labels and pictures of a dataset; `report.ok(strict)` is the verdict.

    >>> check("hit-uav").ok(strict=False)
    True

    Args:
        data: Folder of the dataset.
        reading: How to read `data`.
        decode: Decode the pictures; otherwise only their headers are read.
        on_progress: Called after each picture.
    """
    from infrablend.pipeline.examine import check_folder

    return check_folder(Path(data), reading=reading, decode=decode, on_progress=on_progress)


def convert(
    source: str | Path,
    out: str | Path,
    to: str,
    *,
    reading: Reading = READ_ALL,
    classes: ClassChanges = KEEP_CLASSES,
    selection: Selection = SELECT_ALL,
    loosen: float = 1.0,
    writing: WriteSettings | None = None,
    overwrite: bool = False,
) -> ConvertReport:
    """Write a dataset in another format. Pictures are hard links, or copies where links are impossible.

    >>> people = ClassChanges(only="Person")
    >>> convert("hit-uav", "converted", "coco", classes=people).format
    'coco'

    Args:
        source: Folder of the dataset.
        out: Folder to write.
        to: Format to write: yolo, yolo-obb, yolo-seg, coco, ..., or `native` for the format of the source.
        reading: How to read `source`.
        classes: Classes to rename, drop or keep.
        selection: Pictures to take; all by default.
        loosen: Factor by which to enlarge the axis-aligned boxes of inserted objects, from 1 to 2, to match hand-drawn
            boxes.
        writing: How to write ids, regions to ignore and objects without a mask.
        overwrite: Replace an earlier conversion in `out`.

    Raises:
        UnknownFormatError, DatasetError, OutputError: See `infrablend.errors`.
    """
    dataset = read_dataset(source, reading)
    return convert_dataset(
        dataset, to, Path(out), classes=classes, selection=selection, loosen=loosen, settings=writing,
        overwrite=overwrite,
    )  # fmt: skip


def split(
    data: str | Path,
    out: str | Path,
    rule: SplitRule,
    *,
    to: str = "native",
    lists: bool = False,
    reading: Reading = READ_ALL,
) -> SplitReport:
    """Write a dataset with new splits that do not share neighbouring frames.

    Args:
        data: Folder of the dataset.
        out: Folder to write, new or empty.
        rule: What stays together, and the share of each split, e.g. `SplitRule("sequence")`.
        to: Format to write; `native` is the format of the dataset.
        lists: Write only three lists of pictures and `split.json`.
        reading: How to read `data`.

    Raises:
        DatasetError: The dataset cannot be read, or does not contain what `rule` groups by.
        OutputError: `out` is not empty or cannot be written.
    """
    return split_dataset(read_dataset(data, reading), Path(out), rule, to=to, lists=lists)


def profile(
    data: str | Path,
    out: str | Path,
    *,
    count: int = 64,
    time: str | None = None,
    name: str | None = None,
    against: str | None = None,
    reading: Reading = READ_ALL,
    on_progress: OnProgress | None = None,
) -> ProfileReport:
    """Fit a sensor profile to pictures, and write `profile.json` and `profile.png`.

    Args:
        data: Folder of pictures or of a dataset. Annotated objects are not measured.
        out: Folder to write. Recipes take its `profile.json` as `sensor.profile`.
        count: Number of pictures to read, evenly spread.
        time: `day` or `night`: use only pictures taken then.
        name: Name of the profile; the name of the folder by default.
        against: Shipped profile to compare with.
        reading: How to read `data`.
        on_progress: Called after each picture.

    Raises:
        DatasetError: No picture can be used, there is no contrast, or there are too few clean edges.
        RecipeError: There is no shipped profile `against`.
        OutputError: `out` cannot be written.
    """
    from infrablend.pipeline.profile import profile_dataset, taken_by

    dataset = read_dataset(data, reading)
    dataset = dataset if time is None else taken_by(dataset, time)
    return profile_dataset(dataset, Path(out), count=count, name=name, against=against, on_progress=on_progress)


def realism(
    run: str | Path,
    against: str | Path,
    out: str | Path | None = None,
    *,
    categories: Sequence[str] | None = None,
    time_of_day: Time = "all",
    pairs: int = 1000,
    reading: Reading = READ_ALL,
    execution: Execution = DEFAULT_EXECUTION,
    on_progress: OnProgress | None = None,
) -> RealismReport:
    """Compare the inserted objects of a run with real objects of the same class; needs `infrablend[realism]`.

    Args:
        run: Folder of a finished run that inserted objects of a class that also exists for real.
        against: Dataset that the run was made from.
        out: Folder for `realism.json`, `realism.html` and the sheets; `realism` in the run folder by default.
        categories: Classes to compare; by default all that are both inserted and annotated.
        time_of_day: Only pictures of that time.
        pairs: Largest number of pairs per class.
        reading: How to read `against`.
        execution: Worker processes; `in_process` only for runs made with the fake renderer.
        on_progress: Called after each picture.

    Raises:
        MissingDependencyError: scikit-learn is not installed.
        OutputError, DatasetError, RenderError, Interrupted: See `infrablend.errors`.
    """
    folder = Path(run)
    request = ComparisonRequest(categories, time_of_day, pairs, execution.worker_count(), execution.in_process)
    return compare(folder, read_dataset(against, reading), _path(out) or folder / "realism", request, on_progress)


def train(
    dataset: str | Path,
    out: str | Path,
    *,
    preset: str = "small",
    task: str = "detect",
    weights: str = "auto",
    device: str = "auto",
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    classes: Sequence[str] | None = None,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
    resume: bool = False,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> TrainReport:
    """Train a detector on a dataset, with Ultralytics (the extra `train`).

    Args:
        dataset: Folder of a dataset of any format that can be read; a run of `generate` is one.
        out: Folder for `weights.pt` and `train.json`.
        preset: `paper`, `small` or `smoke`, see `training.presets`.
        task: detect, obb or segment.
        weights: Where to start: a file, a name such as `yolov8s.pt`, `scratch`, or `auto`: the preset's own published
            weights if they can be had, else from scratch.
        device: auto, cpu, mps, cuda, or one GPU as `cuda:1` or `1`.
        seed: Of weights, order, augmentation and tiles.
        settings: Fields of the preset set otherwise (`{"passes": 4000}`), and arguments of Ultralytics.
        classes: Train on these classes only.
        format: Format of the dataset; detected by default.
        options: Of its reader.
        resume: Go on with an interrupted training.
        overwrite: Replace an earlier training in `out`.
        on_progress: Told the images passed.

    Raises:
        InfraBlendError: Of many kinds, see `pipeline.train.train_dataset`.
    """
    require_apart(Path(dataset), Path(out))
    chosen = choose_preset(preset, settings or {})
    found = read_dataset(dataset, Reading(format=format, options=options or {}))
    return train_dataset(
        found,
        Path(out),
        preset=chosen,
        task=task,
        start=weights,
        device=device,
        seed=seed,
        classes=classes,
        resume=resume,
        overwrite=overwrite,
        on_progress=on_progress,
    )


def plan_train(
    dataset: str | Path,
    *,
    preset: str = "small",
    task: str = "detect",
    settings: Mapping[str, Any] | None = None,
    classes: Sequence[str] | None = None,
    device: str = "auto",
    seed: int = 0,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
    weights: str = "auto",
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> TrainPlan:
    """Return images, epochs, time and disk space of a training without starting it; refuse what `train` would."""
    chosen = choose_preset(preset, settings or {})
    found = read_dataset(dataset, Reading(format=format, options=options or {}))
    return plan_training(
        found, chosen, task=task, classes=classes, device=device, seed=seed, start=weights,
        out=None if out is None else Path(out), resume=resume, overwrite=overwrite,
    )  # fmt: skip


def evaluate(
    weights: str | Path,
    dataset: str | Path,
    out: str | Path,
    *,
    split: str = "test",
    task: str | None = None,
    device: str = "auto",
    classes: Sequence[str] | None = None,
    format: str | None = None,
    form: str | None = None,
    metadata: str | Path | None = None,
    options: Mapping[str, str] | None = None,
    image_size: int | None = None,
    ignore_regions: bool = True,
    bootstrap: int = 1000,
    group: str = "image",
    seed: int = 0,
    against: str | Path | None = None,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> EvaluationReport:
    """Judge a detector on a split: tables, strata, intervals, plots; weights need the extra `infrablend[train]`.

    Writes `predictions.json`, `evaluation.json`, `evaluation.html`, `matches.npz` and `plots/`; see
    docs/how_to/evaluate.md for what each figure means.

    Args:
        weights: A .pt file of Ultralytics', or the folder of a finished `train`; or the `predictions.json` (or folder)
            of an earlier evaluation, which needs neither torch nor Ultralytics.
        dataset: Folder of the dataset.
        out: Folder to write; new or empty, or an earlier evaluation with `overwrite`.
        split: train, val or test.
        task: detect, obb, segment; what the detector finds by default. `detect` judges the boxes of any.
        device: auto, cpu, cuda, cuda:1, mps.
        classes: Those of the dataset to judge, by name; all by default. A detector has to know all of them.
        format: As in `read_dataset`, and so are `form`, `metadata`, `options`.
        form: See `read_dataset`.
        metadata: See `read_dataset`.
        options: See `read_dataset`.
        image_size: The longer side the network sees, px; 0: each picture's own; by default the scale that the detector
            was trained at.
        ignore_regions: What is found in regions to ignore (DontCare) counts neither way.
        bootstrap: Draws for the intervals; 0: none.
        group: What is drawn: image, sequence, date, gap (runs of frame numbers).
        seed: Of the draws.
        against: Folder of another evaluation on the same images and labels, to compare with.
        overwrite: Replace an earlier evaluation in `out`.
        on_progress: Called after each few pictures.

    Raises:
        MissingDependencyError: Ultralytics is not installed, or the device is not there.
        ModelError, DatasetError, OutputError: See `infrablend.errors`; all that is wrong at once.
    """
    from infrablend.pipeline.evaluate import Judging, evaluate_detector

    root, target = Path(dataset), Path(out)
    require_apart(root, target)
    data = read_dataset(root, Reading(None, format, form, metadata, options or {}))
    judging = Judging(split, task, image_size, classes, ignore_regions, bootstrap, group, seed)
    return evaluate_detector(
        Path(weights), data, target, judging, device=device, against=None if against is None else Path(against),
        overwrite=overwrite, on_image=paced(on_progress),
    )  # fmt: skip


def compare_evaluations(
    ours: str | Path | Sequence[str | Path],
    theirs: str | Path | Sequence[str | Path],
    *,
    classes: Sequence[str] | None = None,
    bootstrap: int = 1000,
    seed: int = 0,
) -> dict[str, Any]:
    """Two evaluations on the same images, by class: the difference of mAP50 and mAP50-95 with its interval.

    Args:
        ours: Folder that `evaluate` wrote; or several, of detectors trained alike but for the seed: their mean is
            compared, and the interval holds what another seed would change.
        theirs: Another one, or several, on the same images and labels.
        classes: Those to compare; all that both judged by default.
        bootstrap: Draws of the images (or groups, as `ours` was made with), the same for both.
        seed: Of the draws.

    Raises:
        DatasetError: One is no finished evaluation, or images, labels, split, task, groups or treatment of
            regions differ.
    """
    from infrablend.evaluation import comparison

    first, second = ([Path(s)] if isinstance(s, str | Path) else [Path(p) for p in s] for s in (ours, theirs))
    return comparison.compare_evaluations(first, second, classes=classes, bootstrap=bootstrap, seed=seed)


def fetch(
    name: str,
    out: str | Path,
    *,
    parts: Sequence[str] | None = None,
    url: str | None = None,
    sha256: str | None = None,
    archive: str | Path | None = None,
    keep_archive: bool = False,
    on_progress: OnFetch | None = None,
) -> FetchReport:
    """Download a public dataset, check and unpack it, and record its source and licence in `out/SOURCE.json`.

    Calling it again continues an interrupted download.

    Args:
        name: Name of the dataset, see `list_sources`.
        out: Folder to write: new, empty, or of an earlier download of the same dataset.
        parts: Parts to fetch; all by default.
        url: Address to download the file from instead.
        sha256: SHA-256 that the file must have.
        archive: File downloaded by hand, to unpack instead.
        keep_archive: Also keep the archive in `out`.
        on_progress: Called while bytes arrive and files are unpacked.

    Raises:
        DatasetError: No program can fetch this dataset (the message says where to get it), or the archive is damaged,
            hostile, or of another dataset.
        FetchError, OutputError, Interrupted: See `infrablend.errors`.
    """
    return fetching.fetch(
        name, Path(out), parts=parts, url=url, sha256=sha256, archive=_path(archive), keep_archive=keep_archive,
        on_progress=on_progress,
    )  # fmt: skip


def list_sources() -> list[dict[str, Any]]:
    """Return the datasets that `fetch` knows: name, title, page, licence, parts, whether it can download them."""
    return fetching.list_sources()


def describe_source(name: str, *, licence_only: bool = False) -> str:
    """Return where to get a public dataset, its licence, and how."""
    source = fetching.require_source(name)
    return "\n".join([source.title, *fetching.licence_lines(source)]) if licence_only else fetching.how_to_get(source)


def make_world(
    out: str | Path,
    count: int,
    seed: int = 0,
    *,
    layout: Literal["hit-uav", "monet"] = "hit-uav",
    workers: int | None = None,
    on_progress: OnProgress | None = None,
) -> Path:
    """Render a background dataset of a virtual thermal world, with exact labels and without any download.

    `layout` is that of HIT-UAV (640x512, a town) or MONET (800x600, airfields and dirt roads, telemetry in the JSON,
    some of it lost). It always renders on the CPU.
    """
    world.make_world(Path(out), WorldRequest(count, seed, layout), Execution(workers).worker_count(), on_progress)
    return Path(out)


def list_models() -> dict[str, str]:
    """Return the shipped models and their descriptions.

    >>> "drone" in list_models()
    True
    """
    return {name: catalogue.load_model(name).description for name in catalogue.list_models()}


def show_model(name: str, out: str | Path, seed: int = 0) -> Path:
    """Render a model from all sides onto one sheet, a PNG; return its path."""
    ready_model(name)
    return Path(run_once("infrablend.blender.turntable:make_turntable", (name, str(out), seed), f"show {name}"))


def list_recipes() -> dict[str, str]:
    """Return the shipped recipes and their descriptions."""
    return {name: loading.load_recipe(name).description for name in loading.list_recipes()}


def show_recipe(name: str) -> str:
    """Return the YAML text of a shipped recipe."""
    return loading.recipe_text(name)


def write_infrared_effect(path: str | Path) -> Path:
    """Write the InfraredEffect node group as a .blend file to append from; return its path."""
    return Path(run_once("infrablend.blender.jobs:make_asset_writer", str(path), "infrared-effect"))


def diagnose() -> Diagnosis:
    """Return what this machine has and lacks: Python, Blender, libraries, devices, disk."""
    from infrablend.report.doctor import diagnose as survey

    return survey()


def list_experiments() -> dict[str, str]:
    """Return the names of the shipped experiments and the question each one answers."""
    from infrablend.config import experiment as experiments

    return {name: experiments.load_experiment(name).description for name in experiments.list_experiments()}


def experiment(
    request: ExperimentRequest, *, on_stage: OnStage | None = None, on_progress: OnProgress | None = None
) -> ExperimentReport:
    """Run an experiment: make its data, train, evaluate, compare, and write the page.

    The same request continues an interrupted run. Stages are kept by a digest of everything that decides them, so
    experiments share equal stages and a finished experiment makes nothing again.

    Args:
        request: Experiment, datasets, scale and folders.
        on_stage: Called with a stage's id, what happened (`found`, `started`, `done`, `adopted`), its number, and the
            number of stages.
        on_progress: Called by stages that report progress.

    Raises:
        RecipeError, DatasetError, OutputError, MissingDependencyError, RenderError, Interrupted: See
            `infrablend.errors`. The page is written as far as the run got.
    """
    from infrablend.pipeline.experiments.prepare import prepare_experiment
    from infrablend.pipeline.experiments.run import run_experiment

    return run_experiment(prepare_experiment(request), on_stage=on_stage, on_progress=on_progress)


def plan_experiment(request: ExperimentRequest) -> ExperimentPlan:
    """Return stages, images, time and disk space of an experiment, without writing anything."""
    from infrablend.pipeline.experiments.plan import plan_experiment as plan_stages
    from infrablend.pipeline.experiments.prepare import prepare_experiment

    return plan_stages(prepare_experiment(request))


def _path(path: str | Path | None) -> Path | None:
    return None if path is None else Path(path)
