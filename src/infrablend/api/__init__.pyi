"""The names that `infrablend.api` offers, by the module that defines them."""

from infrablend.api.datasets import (
    check as check,
    convert as convert,
    describe_source as describe_source,
    estimate_camera as estimate_camera,
    extract_frames as extract_frames,
    extract_temperatures as extract_temperatures,
    fetch as fetch,
    find_motion as find_motion,
    inspect as inspect,
    learn_places as learn_places,
    map_places as map_places,
    profile as profile,
    read_dataset as read_dataset,
    split as split,
)
from infrablend.api.flights import (
    detect as detect,
    detectability as detectability,
    plan_detectability as plan_detectability,
)
from infrablend.lab.interface import (
    compare_evaluations as compare_evaluations,
    evaluate as evaluate,
    experiment as experiment,
    list_experiments as list_experiments,
    make_world as make_world,
    plan_experiment as plan_experiment,
    plan_train as plan_train,
    realism as realism,
    realism_page as realism_page,
    train as train,
)
from infrablend.api.runs import frames as frames, try_recipe as try_recipe, watch_recipe as watch_recipe
from infrablend.api.runs import (
    PlanReport as PlanReport,
    exclude as exclude,
    generate as generate,
    generate_shard as generate_shard,
    include as include,
    merge as merge,
    plan as plan,
    preview as preview,
    preview_ground as preview_ground,
    report as report,
    rerender as rerender,
    show as show,
    status as status,
)
from infrablend.api.shipped import (
    add_model as add_model,
    describe_model as describe_model,
    list_models as list_models,
    list_recipes as list_recipes,
    show_model as show_model,
    show_recipe as show_recipe,
    survey_model as survey_model,
    write_infrared_effect as write_infrared_effect,
)
from infrablend.rendering.engine.install import install_blender as install_blender
from infrablend.pipeline.storage.fetch import (
    FetchReport as FetchReport,
    FetchRequest as FetchRequest,
    SourceEntry as SourceEntry,
    list_sources as list_sources,
)
from infrablend.formats.cameras.log_alignment import Clock as Clock
from infrablend.formats.read_write import Reading as Reading
from infrablend.formats.read_write import WriteSettings as WriteSettings
from infrablend.pipeline.plans.add_model import ModelAnswers as ModelAnswers, ModelSurvey as ModelSurvey
from infrablend.pipeline.runs.choose import ChoiceReport as ChoiceReport
from infrablend.lab.realism.compare_objects import RealismReport as RealismReport
from infrablend.pipeline.datasets.convert import ConvertReport as ConvertReport
from infrablend.pipeline.studies.camera_sources import CameraEstimate as CameraEstimate
from infrablend.pipeline.studies.estimate_camera import CameraReport as CameraReport, CameraSettings as CameraSettings
from infrablend.pipeline.extraction.count_scale import CountScale as CountScale, Spot as Spot
from infrablend.detection.detectability_record import AlarmFacts as AlarmFacts
from infrablend.pipeline.flights.detectability import (
    DetectabilityPlan as DetectabilityPlan,
    DetectabilityReport as DetectabilityReport,
)
from infrablend.pipeline.flights.detectability_request import (
    DetectabilityRequest as DetectabilityRequest,
    DetectabilitySettings as DetectabilitySettings,
)
from infrablend.pipeline.datasets.requests import (
    ClassChanges as ClassChanges,
    Selection as Selection,
    SplitRule as SplitRule,
)
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings as EvaluationSettings
from infrablend.lab.experiments.experiment_request import ExperimentRequest as ExperimentRequest
from infrablend.pipeline.compose.extensions import (
    BackgroundSource as BackgroundSource,
    Extensions as Extensions,
    Look as Look,
    LookRequest as LookRequest,
    SceneRequest as SceneRequest,
    SceneSampler as SceneSampler,
)
from infrablend.pipeline.flights.detect import DetectReport as DetectReport
from infrablend.pipeline.flights.detect_request import DetectRequest as DetectRequest
from infrablend.core.ground_position import PoseErrors as PoseErrors
from infrablend.pipeline.flights.place_settings import PlaceSettings as PlaceSettings
from infrablend.pipeline.extraction.clips import FrameChoice as FrameChoice
from infrablend.pipeline.extraction.clips import FlightFacts as FlightFacts
from infrablend.pipeline.plans.selection import FrameSelection as FrameSelection
from infrablend.pipeline.compose.memory_frames import Frame as Frame, Frames as Frames, FramesRequest as FramesRequest
from infrablend.pipeline.plans.run_request import Execution as Execution, RunRequest as RunRequest
from infrablend.pipeline.runs.run import RunReport as RunReport
from infrablend.pipeline.plans.shard import ShardRequest as ShardRequest
from infrablend.pipeline.runs.sharded import ShardState as ShardState
from infrablend.pipeline.datasets.split import SplitReport as SplitReport
from infrablend.lab.training.train import TrainReport as TrainReport
from infrablend.lab.training.train import TrainPlan as TrainPlan
from infrablend.pipeline.compose.trial import Trial as Trial
from infrablend.pipeline.studies.doctor import diagnose as diagnose
from infrablend.lab.training.train_request import TrainRequest as TrainRequest

__all__: list[str]
