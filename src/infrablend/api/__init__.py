"""The Python interface: everything the command line does, as functions.

    from infrablend import api

    report = api.generate("hit-uav-drone", data="hit-uav", out="runs/first", limit=10)
    print(report.counts)
    api.preview("runs/first", "runs/first/preview.png")

Options that belong together are one value, documented in its class: `Reading` (how to read a dataset), `Execution` (how
to compute frames), `TrainRequest`, `EvaluationSettings`, `FetchRequest`, `ExperimentRequest`. Every function raises the
errors of `infrablend.errors`. One module per topic: `runs`, `in_memory`, `datasets`, `detectors`, `experiments`,
`shipped`. Their functions only turn arguments into paths and requests and call `infrablend.pipeline`; the CLI calls the
same functions.
The examples run in the tests on a dataset of four pictures, without Blender.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from infrablend.api.datasets import (
        check,
        convert,
        describe_source,
        extract_frames,
        extract_temperatures,
        fetch,
        inspect,
        list_sources,
        make_world,
        profile,
        read_dataset,
        split,
    )
    from infrablend.api.detectors import compare_evaluations, evaluate, plan_train, train
    from infrablend.api.experiments import experiment, list_experiments, plan_experiment
    from infrablend.api.in_memory import frames, try_recipe, watch_recipe
    from infrablend.api.runs import (
        PlanReport,
        exclude,
        generate,
        generate_shard,
        include,
        merge,
        plan,
        preview,
        preview_ground,
        realism,
        realism_page,
        report,
        rerender,
        show,
        status,
        submission_text,
        submit,
    )
    from infrablend.api.shipped import (
        add_model,
        describe_model,
        diagnose,
        list_models,
        list_recipes,
        show_model,
        show_recipe,
        survey_model,
        write_infrared_effect,
    )
    from infrablend.fetching.fetch import FetchReport, FetchRequest, SourceEntry
    from infrablend.formats.reading import Reading
    from infrablend.formats.writing import WriteSettings
    from infrablend.pipeline.add_model import ModelAnswers, ModelSurvey
    from infrablend.pipeline.choose import ChoiceReport
    from infrablend.pipeline.compare_objects import RealismReport
    from infrablend.pipeline.convert import ClassChanges, ConvertReport
    from infrablend.pipeline.evaluation_settings import EvaluationSettings
    from infrablend.pipeline.experiments.request import ExperimentRequest
    from infrablend.pipeline.extensions import (
        BackgroundSource,
        Extensions,
        Look,
        LookRequest,
        SceneRequest,
        SceneSampler,
    )
    from infrablend.pipeline.extraction.clips import FlightFacts, FrameChoice
    from infrablend.pipeline.frame_selection import FrameSelection
    from infrablend.pipeline.in_memory import Frame, Frames, FramesRequest
    from infrablend.pipeline.request import Execution, RunRequest
    from infrablend.pipeline.run import RunReport
    from infrablend.pipeline.select import Selection
    from infrablend.pipeline.shard import ShardRequest
    from infrablend.pipeline.sharded_run import ShardState
    from infrablend.pipeline.split import SplitReport, SplitRule
    from infrablend.pipeline.submission.request import Submission, Volume
    from infrablend.pipeline.train import TrainReport
    from infrablend.pipeline.training.planning import TrainPlan
    from infrablend.pipeline.trial import Trial
    from infrablend.training.request import TrainRequest

__all__ = [
    "BackgroundSource",
    "ChoiceReport",
    "ClassChanges",
    "ConvertReport",
    "EvaluationSettings",
    "Execution",
    "ExperimentRequest",
    "Extensions",
    "FetchReport",
    "FetchRequest",
    "FlightFacts",
    "Frame",
    "FrameChoice",
    "FrameSelection",
    "Frames",
    "FramesRequest",
    "Look",
    "LookRequest",
    "ModelAnswers",
    "ModelSurvey",
    "PlanReport",
    "Reading",
    "RealismReport",
    "RunReport",
    "RunRequest",
    "SceneRequest",
    "SceneSampler",
    "Selection",
    "ShardRequest",
    "ShardState",
    "SourceEntry",
    "SplitReport",
    "SplitRule",
    "Submission",
    "TrainPlan",
    "TrainReport",
    "TrainRequest",
    "Trial",
    "Volume",
    "WriteSettings",
    "add_model",
    "check",
    "compare_evaluations",
    "convert",
    "describe_model",
    "describe_source",
    "diagnose",
    "evaluate",
    "exclude",
    "experiment",
    "extract_frames",
    "extract_temperatures",
    "fetch",
    "frames",
    "generate",
    "generate_shard",
    "include",
    "inspect",
    "list_experiments",
    "list_models",
    "list_recipes",
    "list_sources",
    "make_world",
    "merge",
    "plan",
    "plan_experiment",
    "plan_train",
    "preview",
    "preview_ground",
    "profile",
    "read_dataset",
    "realism",
    "realism_page",
    "report",
    "rerender",
    "show",
    "show_model",
    "show_recipe",
    "split",
    "status",
    "submission_text",
    "submit",
    "survey_model",
    "train",
    "try_recipe",
    "watch_recipe",
    "write_infrared_effect",
]  # fmt: skip

# Names by the module that defines them. Each is imported on first use, so that one command does not load the others.
_MODULES = {
    "api.datasets": (
        "check convert describe_source extract_frames extract_temperatures fetch inspect list_sources "
        "make_world profile read_dataset split"
    ),
    "api.detectors": "compare_evaluations evaluate plan_train train",
    "api.experiments": "experiment list_experiments plan_experiment",
    "api.in_memory": "frames try_recipe watch_recipe",
    "api.runs": (
        "PlanReport exclude generate generate_shard include merge plan preview preview_ground realism realism_page "
        "report rerender show status submission_text submit"
    ),
    "api.shipped": (
        "add_model describe_model diagnose list_models list_recipes show_model show_recipe survey_model "
        "write_infrared_effect"
    ),
    "fetching.fetch": "FetchReport FetchRequest SourceEntry",
    "formats.reading": "Reading",
    "formats.writing": "WriteSettings",
    "pipeline.add_model": "ModelAnswers ModelSurvey",
    "pipeline.choose": "ChoiceReport",
    "pipeline.compare_objects": "RealismReport",
    "pipeline.convert": "ClassChanges ConvertReport",
    "pipeline.evaluation_settings": "EvaluationSettings",
    "pipeline.experiments.request": "ExperimentRequest",
    "pipeline.extensions": "BackgroundSource Extensions Look LookRequest SceneRequest SceneSampler",
    "pipeline.extraction.clips": "FlightFacts FrameChoice",
    "pipeline.frame_selection": "FrameSelection",
    "pipeline.in_memory": "Frame Frames FramesRequest",
    "pipeline.request": "Execution RunRequest",
    "pipeline.run": "RunReport",
    "pipeline.select": "Selection",
    "pipeline.shard": "ShardRequest",
    "pipeline.sharded_run": "ShardState",
    "pipeline.split": "SplitReport SplitRule",
    "pipeline.submission.request": "Submission Volume",
    "pipeline.train": "TrainReport",
    "pipeline.training.planning": "TrainPlan",
    "pipeline.trial": "Trial",
    "training.request": "TrainRequest",
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"infrablend.{_MODULE_OF[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
