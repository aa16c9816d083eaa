"""The Python interface: everything the command line does, as functions.

    from infrablend import api

    report = api.generate("hit-uav-drone", data="hit-uav", out="runs/first", limit=10)
    print(report.counts)
    api.preview("runs/first", "runs/first/preview.png")

Options that belong together are one value, documented in its class: `Reading` (how to read a dataset), `Execution` (how
to compute frames), `TrainRequest`, `EvaluationSettings`, `FetchRequest`, `ExperimentRequest`. Every function raises the
errors of `infrablend.errors`. One module per topic: `runs`, `datasets`, `detectors`, `experiments`, `shipped`. Their
functions only turn arguments into paths and requests and call `infrablend.pipeline`; the CLI calls the same functions.
The examples run in the tests on a dataset of four pictures, without Blender.
"""

from __future__ import annotations

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
from infrablend.api.runs import PlanReport, generate, plan, preview, preview_ground, realism, realism_page, rerender
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
from infrablend.pipeline.compare_objects import RealismReport
from infrablend.pipeline.convert import ClassChanges, ConvertReport
from infrablend.pipeline.evaluation_settings import EvaluationSettings
from infrablend.pipeline.experiments.request import ExperimentRequest
from infrablend.pipeline.frame_selection import FrameSelection
from infrablend.pipeline.request import Execution
from infrablend.pipeline.run import RunReport
from infrablend.pipeline.select import Selection
from infrablend.pipeline.split import SplitReport, SplitRule
from infrablend.pipeline.train import TrainReport
from infrablend.pipeline.training.plan import TrainPlan
from infrablend.training.request import TrainRequest

__all__ = [
    "ClassChanges", "ConvertReport", "EvaluationSettings", "Execution", "ExperimentRequest", "FetchReport",
    "FetchRequest", "FrameSelection", "ModelAnswers", "ModelSurvey", "PlanReport", "Reading", "RealismReport",
    "RunReport", "Selection", "SourceEntry", "SplitReport", "SplitRule", "TrainPlan", "TrainReport", "TrainRequest",
    "WriteSettings",
    "add_model", "check", "compare_evaluations", "convert", "describe_model", "describe_source", "diagnose",
    "evaluate", "experiment", "extract_frames", "extract_temperatures", "fetch", "generate",
    "inspect", "list_experiments", "list_models", "list_recipes", "list_sources", "make_world", "plan",
    "plan_experiment", "plan_train", "preview",
    "preview_ground", "profile", "read_dataset", "realism", "realism_page", "rerender", "show_model",
    "show_recipe", "split", "survey_model",
    "train", "write_infrared_effect",
]  # fmt: skip
