"""What `infrablend.api` offers of the lab: train, evaluate, experiments, realism, and the virtual world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.api.datasets import read_dataset
from infrablend.core.dataset import Dataset
from infrablend.core.file_names import real_path
from infrablend.core.output_checks import require_apart
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import Existing
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.lab.evaluation.evaluation_settings import DEFAULT_SETTINGS, EvaluationSettings
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.training.train import TrainPlan, TrainReport, plan_training, train_dataset
from infrablend.lab.training.train_request import DEFAULT_TRAINING, TrainRequest
from infrablend.lab.world import world_dataset
from infrablend.lab.world.world_dataset import WorldRequest
from infrablend.lab.world.world_frames import Engine, Layout, Survey
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION, Execution
from infrablend.pipeline.runs.record import RecordedRun

if TYPE_CHECKING:
    from infrablend.lab.evaluation.evaluate import EvaluationReport
    from infrablend.lab.evaluation.evaluation_comparison import EvaluationComparison
    from infrablend.lab.experiments.experiment_forecast import ExperimentPlan
    from infrablend.lab.experiments.run_experiment import ExperimentReport, OnStage
    from infrablend.lab.realism.compare_objects import RealismReport, Time


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
    folder = None if out is None else Path(out)
    return plan_training(read_dataset(dataset, reading), request, out=folder, existing=existing)


def evaluate(
    weights: str | Path, dataset: str | Path, out: str | Path, settings: EvaluationSettings = DEFAULT_SETTINGS, *,
    device: str = "auto", reading: Reading = READ_ALL, against: str | Path | None = None, overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> EvaluationReport:  # fmt: skip
    """Evaluate a detector on a split: tables, strata, intervals and plots; docs/how_to/evaluate.md explains them.

    `weights` are Ultralytics weights (.pt) or the folder of a finished `train`, which need `infrablend[train]`; or
    `predictions.json` or the folder of an earlier evaluation, which need neither torch nor Ultralytics. `against` is
    the folder of another evaluation on the same images and labels. For tracks, all frames of videos are read unless
    the reading states a step.
    """
    from infrablend.formats.dataset_folder import with_every_frame
    from infrablend.lab.evaluation.evaluate import evaluate_detector
    from infrablend.pipeline.storage.store import local_folder

    require_apart(Path(dataset), Path(out))
    if settings.tracks:
        reading = with_every_frame(reading, local_folder(dataset))
    return evaluate_detector(
        Path(weights), read_dataset(dataset, reading), Path(out), settings, device=device,
        against=None if against is None else Path(against), overwrite=overwrite, on_image=paced(on_progress),
    )  # fmt: skip


def compare_evaluations(
    ours: str | Path | Sequence[str | Path], theirs: str | Path | Sequence[str | Path], *,
    classes: Sequence[str] | None = None, bootstrap: int = 1000, seed: int = 0,
) -> EvaluationComparison:  # fmt: skip
    """Return the difference of mAP50 and mAP50-95 of two evaluations on the same images, by class, with its interval.

    Either side may be several folders, of detectors that differ only in their training seed: their means are compared,
    and the interval includes the variation between seeds. By default all classes are compared that both evaluated.
    """
    from infrablend.lab.evaluation import evaluation_comparison

    first, second = ([Path(s)] if isinstance(s, str | Path) else [Path(p) for p in s] for s in (ours, theirs))
    facts = evaluation_comparison.compare_evaluations(first, second, classes=classes, bootstrap=bootstrap, seed=seed)
    return evaluation_comparison.EvaluationComparison(**facts)


def list_experiments() -> dict[str, str]:
    """Return the names of the shipped experiments and the question each one answers."""
    from infrablend.lab.experiments import definition as experiments

    return {name: experiments.load_experiment(name).description for name in experiments.list_experiments()}


def experiment(
    request: ExperimentRequest, *, on_stage: OnStage | None = None, on_progress: OnProgress | None = None
) -> ExperimentReport:
    """Run an experiment: generate, train, evaluate, compare, and write the page, as far as the run gets.

    The same request continues an interrupted run, and experiments share equal stages. `on_stage` is called with a
    stage's id, what happened (`found`, `started`, `done`, `adopted`), its number, and the number of stages.
    """
    from infrablend.lab.experiments.prepare import prepare_experiment
    from infrablend.lab.experiments.run_experiment import run_experiment

    return run_experiment(prepare_experiment(request), on_stage=on_stage, on_progress=on_progress)


def plan_experiment(request: ExperimentRequest) -> ExperimentPlan:
    """Return stages, images, time and disk space of an experiment, without writing anything."""
    from infrablend.lab.experiments.experiment_forecast import plan_experiment as plan_stages
    from infrablend.lab.experiments.prepare import prepare_experiment

    return plan_stages(prepare_experiment(request))


def realism(  # noqa: PLR0913 - callers name these
    run: str | Path, against: str | Path, out: str | Path | None = None, *, categories: Sequence[str] | None = None,
    time_of_day: Time = "all", pairs: int = 1000, real: Dataset | None = None, steps: bool = True,
    reading: Reading = READ_ALL, execution: Execution = DEFAULT_EXECUTION, on_progress: OnProgress | None = None,
) -> RealismReport:  # fmt: skip
    """Compare the inserted objects of a run with real objects of the same class; needs `infrablend[realism]`.

    `against` is the dataset that the run was made from; it is read as the run read it, with every split, unless
    `reading` says otherwise. `out` is `RUN-realism`, beside the run, by default, and `real` another dataset of the real
    objects, as from `read_dataset`. `ComparisonRequest` explains the other arguments.
    """
    from infrablend.lab.realism.compare_objects import ComparisonRequest, compare

    beside = real_path(Path(run))
    folder = beside.with_name(f"{beside.name}-realism") if out is None else Path(out)
    request = ComparisonRequest(
        categories, time_of_day, pairs, execution.worker_count(), execution.in_process, real, steps
    )
    if reading == READ_ALL:
        reading = replace(RecordedRun.read(RunFolder(Path(run))).reading, splits=None)
    return compare(Path(run), read_dataset(against, reading), folder, request, on_progress)


def realism_page(report: RealismReport, out: str | Path) -> Path:
    """Add the figures of a comparison to the page of results `realism.md` in a folder; return the path of the page.

    Classes and times of day that the page has from other comparisons are kept. The folder is created if it is missing.
    """
    from infrablend.lab.pages.realism_page import add_to_page

    return add_to_page(report.facts, Path(out))


def make_world(
    out: str | Path, count: int, seed: int = 0, *, layout: Layout = "hit-uav", survey: Survey | None = None,
    engine: Engine = "blender", workers: int | None = None, overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> Path:  # fmt: skip
    """Render a background dataset of a virtual thermal world, with exact labels and without any download.

    The layout is that of HIT-UAV (640x512, a town) or MONET (800x600, airfields and dirt roads, telemetry in the JSON,
    some of it lost), the town in 16-bit centikelvin (`radiometric`), a flight in radiometric JPEG files (`dji`,
    `flir`), or one over a single scene (`flight`): a smooth course, or the strips of a `survey`. It always renders on
    the CPU: in Blender, or with the engine `lattice` without it, in other pixels.
    """
    request = WorldRequest(count, seed, layout, survey, engine)
    world_dataset.make_world(Path(out), request, Execution(workers).worker_count(), on_progress, overwrite=overwrite)
    return Path(out)
