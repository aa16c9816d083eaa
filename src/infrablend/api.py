"""The Python interface: everything the command line does, as functions.

    from infrablend import api

    report = api.generate("hit-uav-drone", data="hit-uav", out="runs/first", limit=10)
    print(report.counts)
    api.preview("runs/first", "runs/first/preview.png")

Options that belong together are one value, documented in its class: `Reading` (how to read a dataset), `Execution` (how
to compute frames), `TrainRequest`, `EvaluationSettings`, `FetchRequest`, `ExperimentRequest`. Every function raises the
errors of `infrablend.errors`. The examples run in the tests on a dataset of four pictures, without Blender.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from infrablend.assets import catalogue
from infrablend.assets.model import ObjectModel
from infrablend.config import loading
from infrablend.core.dataset import Dataset
from infrablend.core.output import Existing, require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.fetching import fetch as fetching
from infrablend.fetching.fetch import FETCH_ALL, FetchReport, FetchRequest, OnFetch, SourceEntry
from infrablend.formats import detection
from infrablend.formats.reading import READ_ALL, Reading
from infrablend.formats.writing import WriteSettings
from infrablend.pipeline import world
from infrablend.pipeline.compare_objects import ComparisonRequest, RealismReport, Time, compare
from infrablend.pipeline.convert import KEEP_CLASSES, ClassChanges, ConvertReport, convert_dataset
from infrablend.pipeline.evaluation_settings import DEFAULT_SETTINGS, EvaluationSettings
from infrablend.pipeline.experiments.request import ExperimentRequest
from infrablend.pipeline.generate import describe_run, generate_run
from infrablend.pipeline.models import ready_model, run_once
from infrablend.pipeline.request import DEFAULT_EXECUTION, Execution, RunRequest, Settings
from infrablend.pipeline.rerender import rerender_frame
from infrablend.pipeline.run import RunReport
from infrablend.pipeline.select import SELECT_ALL, Selection
from infrablend.pipeline.split import SplitReport, SplitRule, split_dataset
from infrablend.pipeline.train import TrainReport, train_dataset
from infrablend.pipeline.training.plan import TrainPlan, plan_training
from infrablend.training.request import DEFAULT_TRAINING, TrainRequest
from infrablend.world.dataset import WorldRequest

if TYPE_CHECKING:
    from infrablend.evaluation.comparison import EvaluationComparison
    from infrablend.pipeline.evaluate import EvaluationReport
    from infrablend.pipeline.experiments.plan import ExperimentPlan
    from infrablend.pipeline.experiments.run import ExperimentReport, OnStage
    from infrablend.pipeline.profile import ProfileReport
    from infrablend.report.checking import CheckReport
    from infrablend.report.doctor import Diagnosis
    from infrablend.report.inspection import Inspection
    from infrablend.report.preview import Draw

__all__ = [
    "ClassChanges", "ConvertReport", "EvaluationSettings", "Execution", "ExperimentRequest", "FetchReport",
    "FetchRequest", "PlanReport", "Reading", "RealismReport", "RunReport", "Selection",
    "SourceEntry", "SplitReport", "SplitRule", "TrainPlan", "TrainReport", "TrainRequest", "WriteSettings", "check",
    "compare_evaluations", "convert", "describe_model", "describe_source", "diagnose", "evaluate",
    "experiment", "fetch", "generate",
    "inspect", "list_experiments", "list_models", "list_recipes", "list_sources", "make_world", "plan",
    "plan_experiment", "plan_train", "preview", "preview_ground", "profile", "read_dataset", "realism", "rerender",
    "show_model", "show_recipe", "split", "train", "write_infrared_effect",
]  # fmt: skip


@dataclass(frozen=True)
class PlanReport:
    """Frames, disk space and time of a run that has not been started."""

    facts: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return dict(self.facts)


def generate(
    recipe: str | Path, data: str | Path, out: str | Path, *, limit: int | None = None, seed: int = 0,
    settings: Settings = (), reading: Reading = READ_ALL, execution: Execution = DEFAULT_EXECUTION,
    existing: Existing = "refuse", on_progress: OnProgress | None = None,
) -> RunReport:  # fmt: skip
    """Insert rendered objects into a dataset and write the enlarged dataset with merged labels.

    The other arguments are described in `infrablend.pipeline.request.RunRequest`.

    >>> flat = Execution(renderer="flat", in_process=True)
    >>> report = generate("hit-uav-drone", "hit-uav", "runs/first", limit=2, execution=flat)
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
    """
    request = RunRequest(recipe, Path(data), Path(out), limit, seed, settings, reading, execution, existing)
    return generate_run(request, on_progress)


def plan(
    recipe: str | Path, data: str | Path, out: str | Path | None = None, *, limit: int | None = None, seed: int = 0,
    settings: Settings = (), reading: Reading = READ_ALL, execution: Execution = DEFAULT_EXECUTION,
) -> PlanReport:  # fmt: skip
    """Return what `generate` with the same arguments would write, without writing it.

    >>> plan("hit-uav-drone", "hit-uav").facts["frames"]
    8
    """
    request = RunRequest(recipe, Path(data), _path(out), limit, seed, settings, reading, execution)
    return PlanReport(describe_run(request))


def rerender(run: str | Path, frame_id: str, out: str | Path | None = None, *, data: str | Path | None = None) -> Path:
    """Render the frame `<split>/<background>_c<k>` of a run again, with the same bytes; return the picture's path.

    By default the picture goes to the current folder. `data` is the folder of the backgrounds, if it has moved.
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

    `out` is the folder for `inspect.png` and `inspect.json`; None writes nothing. `decode` also decodes every picture
    for bit depth, channels, grey levels and broken files.
    """
    from infrablend.pipeline.examine import inspect_folder

    return inspect_folder(Path(data), _path(out), reading=reading, decode=decode)


def check(
    data: str | Path, *, reading: Reading = READ_ALL, decode: bool = True, on_progress: OnProgress | None = None
) -> CheckReport:
    """Return every problem of the labels and pictures of a dataset; without `decode`, only picture headers are read.

    >>> check("hit-uav").ok(strict=False)
    True
    """
    from infrablend.pipeline.examine import check_folder

    return check_folder(Path(data), reading=reading, decode=decode, on_progress=on_progress)


def convert(
    source: str | Path, out: str | Path, to: str, *, reading: Reading = READ_ALL, classes: ClassChanges = KEEP_CLASSES,
    selection: Selection = SELECT_ALL, loosen: float = 1.0, writing: WriteSettings | None = None,
    overwrite: bool = False,
) -> ConvertReport:  # fmt: skip
    """Write a dataset in another format. Pictures are hard links, or copies where links are impossible.

    `to` is a format such as yolo, yolo-obb, yolo-seg or coco, or `native` for the format of the source. `loosen`
    enlarges the axis-aligned boxes of inserted objects by a factor from 1 to 2, to match hand-drawn boxes.

    >>> people = ClassChanges(only="Person")
    >>> convert("hit-uav", "converted", "coco", classes=people).format
    'coco'
    """
    dataset = read_dataset(source, reading)
    return convert_dataset(
        dataset, to, Path(out), classes=classes, selection=selection, loosen=loosen, settings=writing,
        overwrite=overwrite,
    )  # fmt: skip


def split(
    data: str | Path, out: str | Path, rule: SplitRule, *, to: str = "native", lists: bool = False,
    reading: Reading = READ_ALL,
) -> SplitReport:  # fmt: skip
    """Write a dataset with new splits that do not share neighbouring frames, e.g. with `SplitRule("sequence")`.

    `to` is the format to write, as in `convert`. `lists` writes only three lists of pictures and `split.json`.
    """
    return split_dataset(read_dataset(data, reading), Path(out), rule, to=to, lists=lists)


def profile(
    data: str | Path, out: str | Path, *, count: int = 64, time: str | None = None, name: str | None = None,
    against: str | None = None, reading: Reading = READ_ALL, on_progress: OnProgress | None = None,
) -> ProfileReport:  # fmt: skip
    """Fit a sensor profile to pictures; write `profile.json`, which recipes take as `sensor.profile`, and a plot.

    Args:
        data: Folder of pictures or of a dataset. Annotated objects are not measured.
        out: Folder to write.
        count: Number of pictures to read, evenly spread.
        time: `day` or `night`: use only pictures taken then.
        name: Name of the profile; the name of the folder by default.
        against: Shipped profile to compare with.
        reading: How to read `data`.
        on_progress: Called after each picture.
    """
    from infrablend.pipeline.profile import pictures_taken_by, profile_dataset

    dataset = read_dataset(data, reading)
    dataset = dataset if time is None else pictures_taken_by(dataset, time)
    return profile_dataset(dataset, Path(out), count=count, name=name, against=against, on_progress=on_progress)


def realism(
    run: str | Path, against: str | Path, out: str | Path | None = None, *, categories: Sequence[str] | None = None,
    time_of_day: Time = "all", pairs: int = 1000, reading: Reading = READ_ALL,
    execution: Execution = DEFAULT_EXECUTION, on_progress: OnProgress | None = None,
) -> RealismReport:  # fmt: skip
    """Compare the inserted objects of a run with real objects of the same class; needs `infrablend[realism]`.

    Args:
        run: Folder of a finished run that inserted objects of a class that also exists for real.
        against: Dataset that the run was made from.
        out: Folder for `realism.json`, `realism.html` and the sheets; `realism` in the run folder by default.
        categories: Classes to compare; by default all that are both inserted and annotated.
        time_of_day: Only pictures of that time.
        pairs: Largest number of pairs per class.
        reading: How to read `against`.
        execution: Worker processes; `in_process` only for runs made with the flat renderer.
        on_progress: Called after each picture.
    """
    folder = Path(run)
    request = ComparisonRequest(categories, time_of_day, pairs, execution.worker_count(), execution.in_process)
    return compare(folder, read_dataset(against, reading), _path(out) or folder / "realism", request, on_progress)


def train(
    dataset: str | Path, out: str | Path, request: TrainRequest = DEFAULT_TRAINING, *, reading: Reading = READ_ALL,
    existing: Existing = "refuse", on_progress: OnProgress | None = None,
) -> TrainReport:  # fmt: skip
    """Train a detector with Ultralytics; write `weights.pt` and `train.json`. Needs `infrablend[train]`.

    `dataset` has any readable format; a run of `generate` is one. `existing` decides what happens to an earlier
    training in `out`: `refuse`, `resume` or `overwrite`.
    """
    require_apart(Path(dataset), Path(out))
    found = read_dataset(dataset, reading)
    return train_dataset(found, Path(out), request, existing=existing, on_progress=on_progress)


def plan_train(
    dataset: str | Path, request: TrainRequest = DEFAULT_TRAINING, *, reading: Reading = READ_ALL,
    out: str | Path | None = None, existing: Existing = "refuse",
) -> TrainPlan:  # fmt: skip
    """Return images, epochs, time and disk space of `train`; whatever `train` would refuse is refused here too.

    >>> plan_train("hit-uav", TrainRequest(preset="smoke", device="cpu", classes=["Car"])).images
    2
    """
    return plan_training(read_dataset(dataset, reading), request, out=_path(out), existing=existing)


def evaluate(
    weights: str | Path, dataset: str | Path, out: str | Path, settings: EvaluationSettings = DEFAULT_SETTINGS, *,
    device: str = "auto", reading: Reading = READ_ALL, against: str | Path | None = None, overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> EvaluationReport:  # fmt: skip
    """Evaluate a detector on a split: tables, strata, intervals and plots; docs/how_to/evaluate.md explains them.

    Args:
        weights: Ultralytics weights (.pt) or the folder of a finished `train`, which need `infrablend[train]`; or
            `predictions.json` or the folder of an earlier evaluation, which need neither torch nor Ultralytics.
        dataset: Folder of the dataset.
        out: Folder to write.
        settings: Split, task, classes, image size, intervals.
        device: auto, cpu, cuda, cuda:1 or mps.
        reading: How to read `dataset`.
        against: Folder of another evaluation on the same images and labels, to compare with.
        overwrite: Replace an earlier evaluation in `out`.
        on_progress: Called after every few pictures.
    """
    from infrablend.pipeline.evaluate import evaluate_detector

    require_apart(Path(dataset), Path(out))
    return evaluate_detector(
        Path(weights), read_dataset(dataset, reading), Path(out), settings, device=device, against=_path(against),
        overwrite=overwrite, on_image=paced(on_progress),
    )  # fmt: skip


def compare_evaluations(
    ours: str | Path | Sequence[str | Path], theirs: str | Path | Sequence[str | Path], *,
    classes: Sequence[str] | None = None, bootstrap: int = 1000, seed: int = 0,
) -> EvaluationComparison:  # fmt: skip
    """Return the difference of mAP50 and mAP50-95 of two evaluations on the same images, by class, with its interval.

    Either side may be several folders, of detectors that differ only in their training seed: their means are compared,
    and the interval includes the variation between seeds. By default all classes are compared that both evaluated.
    """
    from infrablend.evaluation import comparison

    first, second = ([Path(s)] if isinstance(s, str | Path) else [Path(p) for p in s] for s in (ours, theirs))
    facts = comparison.compare_evaluations(first, second, classes=classes, bootstrap=bootstrap, seed=seed)
    return comparison.EvaluationComparison(**facts)


def fetch(
    name: str, out: str | Path, request: FetchRequest = FETCH_ALL, *, on_progress: OnFetch | None = None
) -> FetchReport:
    """Download a public dataset, check and unpack it, and record its source and licence in `out/SOURCE.json`.

    `list_sources` lists the names. Calling it again continues an interrupted download.
    """
    return fetching.fetch(name, Path(out), request, on_progress=on_progress)


def list_sources() -> list[SourceEntry]:
    """Return the public datasets that `fetch` knows, with page, licence and parts.

    >>> "hit-uav" in [source.name for source in list_sources()]
    True
    """
    return fetching.list_sources()


def describe_source(name: str, *, licence_only: bool = False) -> str:
    """Return the source, licence and download steps of a public dataset."""
    source = fetching.require_source(name)
    return (
        "\n".join([source.title, *fetching.licence_lines(source)])
        if licence_only
        else fetching.fetch_instructions(source)
    )


def make_world(
    out: str | Path, count: int, seed: int = 0, *, layout: Literal["hit-uav", "monet"] = "hit-uav",
    workers: int | None = None, on_progress: OnProgress | None = None,
) -> Path:  # fmt: skip
    """Render a background dataset of a virtual thermal world, with exact labels and without any download.

    The layout is that of HIT-UAV (640x512, a town) or MONET (800x600, airfields and dirt roads, telemetry in the JSON,
    some of it lost). It always renders on the CPU.
    """
    world.make_world(Path(out), WorldRequest(count, seed, layout), Execution(workers).worker_count(), on_progress)
    return Path(out)


def list_models() -> dict[str, str]:
    """Return the shipped models and their descriptions."""
    return {name: catalogue.load_model(name).description for name in catalogue.list_models()}


def describe_model(name: str) -> ObjectModel:
    """Return a model, shipped or your own .yaml: description, options, and the temperatures of its parts.

    >>> describe_model("drone").options["layout"]
    'one of x, h, plus, deadcat, or a list of several'
    """
    return ready_model(name)


def show_model(name: str, out: str | Path, seed: int = 0, options: Mapping[str, Any] | None = None) -> Path:
    """Render a model from below, level and above onto one sheet, a PNG; return its path.

    The options are those of a recipe (`objects.N.options`).
    """
    ready_model(name)
    payload = (name, str(out), seed, dict(options or {}))
    return Path(run_once("infrablend.blender.turntable:make_turntable", payload, f"show {name}"))


def list_recipes() -> dict[str, str]:
    """Return the shipped recipes and their descriptions."""
    return {name: loading.load_recipe(name).description for name in loading.list_recipes()}


def show_recipe(name: str) -> str:
    """Return the YAML text of a shipped recipe."""
    return loading.recipe_text(name)


def write_infrared_effect(path: str | Path) -> Path:
    """Write the InfraredEffect node group as a .blend file to append from; return its path."""
    return Path(run_once("infrablend.blender.node_group_file:make_node_group_writer", str(path), "infrared-effect"))


def diagnose() -> Diagnosis:
    """Check whether this machine can run InfraBlend: Python, Blender, libraries, devices, disk."""
    from infrablend.report.doctor import diagnose as survey

    return survey()


def list_experiments() -> dict[str, str]:
    """Return the names of the shipped experiments and the question each one answers."""
    from infrablend.config import experiment as experiments

    return {name: experiments.load_experiment(name).description for name in experiments.list_experiments()}


def experiment(
    request: ExperimentRequest, *, on_stage: OnStage | None = None, on_progress: OnProgress | None = None
) -> ExperimentReport:
    """Run an experiment: generate, train, evaluate, compare, and write the page, as far as the run gets.

    The same request continues an interrupted run, and experiments share equal stages. `on_stage` is called with a
    stage's id, what happened (`found`, `started`, `done`, `adopted`), its number, and the number of stages.
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
