"""From an experiment's file and the user's datasets to the graph of its stages."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.assets.user_model import description_digest, is_description
from infrablend.config.loading import read_recipe
from infrablend.config.recipe import NOT_IN_KEY, Recipe
from infrablend.core.dataset import SPLITS, Split
from infrablend.core.validation_messages import did_you_mean
from infrablend.core.workspace import WORLD_FILE
from infrablend.detection.truth import class_key
from infrablend.errors import DatasetError, InfraBlendError, Problem
from infrablend.lab.experiments.definition import (
    Convert,
    Detectability,
    Evaluation,
    Experiment,
    Generate,
    Merge,
    Paste,
    Resplit,
    Source,
    Training,
)
from infrablend.lab.experiments.experiment_request import ExperimentRequest, Scale
from infrablend.lab.experiments.stage import Stage, dataset_facts, read_dataset, stage_keys
from infrablend.lab.training.presets import Preset
from infrablend.lab.training.start_weights import AUTO, identify
from infrablend.lab.training.train_request import choose_preset
from infrablend.pipeline.datasets.content import content_digest
from infrablend.pipeline.flights.detectability_request import DEFAULT_DETECTABILITY
from infrablend.pipeline.plans.scenes import about_scenes
from infrablend.pipeline.storage.fetch import require_source

BOOTSTRAP: Mapping[Scale, int] = {"smoke": 100, "small": 1000, "medium": 1000, "paper": 1000}
"""Number of bootstrap draws at each scale."""
OTHER_SCALES = "at other scales only"
EXPERIMENTS_PAGE = "docs/how_to/experiments.md"
STAND_IN_IMAGES = 24


@dataclass(frozen=True)
class StageGraph:
    """The stages of an experiment at one scale.

    Attributes:
        stages: Stages in an order in which each comes after those it needs.
        keys: Key of each stage, by id.
        left_out: Reason why a source, dataset, training, evaluation, detectability or comparison has no stage, by name.
        given: Folders given by the user, by source.
        stand_ins: Sources replaced by a virtual world.
    """

    stages: tuple[Stage, ...]
    keys: Mapping[str, str]
    left_out: Mapping[str, str]
    given: Mapping[str, Path]
    stand_ins: tuple[str, ...] = ()

    @property
    def by_id(self) -> dict[str, Stage]:
        """Stages by id."""
        return {s.id: s for s in self.stages}

    def select(self, only: Sequence[str], finished: Collection[str] = ()) -> set[str]:
        """Return the ids of the stages that `only` names (by kind, name or id) and of all that these need.

        The stages that a `finished` one was made from are not included.

        Raises:
            DatasetError: A word names no stage.
        """
        by_id = self.by_id
        if not only:
            return set(by_id)
        words = {w for s in self.stages for w in (s.kind, s.name, s.id)}
        unknown = [w for w in only if w not in words]
        if unknown:
            raise unknown_stage("--only", unknown, by_id, words)
        chosen: set[str] = set()
        queue = [s.id for s in self.stages if any(w in (s.kind, s.name, s.id) for w in only)]
        while queue:
            if (one := queue.pop()) not in chosen:
                chosen.add(one)
                queue += [] if one in finished else by_id[one].needs.values()
        return chosen


def unknown_stage(option: str, unknown: Sequence[str], ids: Iterable[str], words: Iterable[str]) -> DatasetError:
    """Return the error for words that name no stage, with the closest stage as a suggestion."""
    todo = did_you_mean(unknown[0], words)
    problem = Problem(option, "stage-unknown", ", ".join(unknown), f"some of {', '.join(ids)}", todo)
    return DatasetError("no such stage", [problem])


def build_graph(experiment: Experiment, given: Mapping[str, Path], request: ExperimentRequest) -> StageGraph:
    """Return the stages of an experiment at the request's scale; reads the given datasets.

    Raises:
        DatasetError: A dataset cannot be read or lacks a class or split.
        RecipeError: A recipe is wrong.
    """
    builder = _Builder(experiment, given, request)
    for name, source in experiment.sources.items():
        builder.add_source(name, source)
    for name in _parents_first(experiment):
        builder.add_data(name)
    for name, training in experiment.trainings.items():
        builder.add_training(name, training)
    for name, evaluation in experiment.evaluations.items():
        builder.add_evaluation(name, evaluation)
    for name, detectability in experiment.detectabilities.items():
        builder.add_detectability(name, detectability)
    for name in experiment.comparisons:
        builder.add_comparison(name)
    if builder.problems:
        raise DatasetError(f"experiment {experiment.name}: cannot be run on these data", builder.problems)
    stages = _without_unused_sources(experiment, list(builder.stages.values()))
    return StageGraph(stages, stage_keys(stages), builder.left_out, given, tuple(builder.stand_ins))


def _without_unused_sources(experiment: Experiment, stages: Sequence[Stage]) -> tuple[Stage, ...]:
    counted = {d for f in experiment.facts for d in f.data}
    used = set()
    for s in reversed(stages):
        if s.kind not in ("source", "world") or s.id in used or s.name in counted:
            used |= {s.id, *s.needs.values()}
    return tuple(s for s in stages if s.id in used)


def _parents_first(experiment: Experiment) -> list[str]:
    """Return the names of data items, each after those it is made from; refuse those made from each other."""
    order: list[str] = []
    rest = list(experiment.data)
    while rest:
        ready = [n for n in rest if not set(experiment.inputs_of(n).values()) & set(rest)]
        if not ready:
            problem = Problem("data", "experiment-value", f"{', '.join(rest)} are made from each other in a circle")
            raise DatasetError(f"experiment {experiment.name}: data that need each other", [problem])
        order += ready
        rest = [n for n in rest if n not in ready]
    return order


class _Builder:
    def __init__(self, experiment: Experiment, given: Mapping[str, Path], request: ExperimentRequest) -> None:
        self.experiment = experiment
        self.given = given
        self.request = request
        self.stages: dict[str, Stage] = {}
        self.left_out: dict[str, str] = {}
        self.problems: list[Problem] = []
        self.stand_ins: list[str] = []
        self.made_by: dict[str, str] = {}  # id of the stage that makes a source or data item

    def add(self, stage: Stage) -> None:
        self.stages[stage.id] = stage

    def add_source(self, name: str, source: Source) -> None:
        path = self.given.get(name)
        if path is not None:
            self._add_given(name, source, path)
        elif source.stand_in is not None:
            self._add_stand_in(name, source)
        else:
            self.left_out[name] = f"no folder of {source.title} was given; {where_to_get(source)}"
            return
        self.made_by[name] = f"source:{name}"

    def _add_stand_in(self, name: str, source: Source) -> None:
        limits = _at_scale(source.limits, self.request)
        count = source.stand_in_images.get(self.request.scale, STAND_IN_IMAGES)
        inputs: dict[str, object] = {
            "layout": source.stand_in,
            "images": count,
            "seed": self.request.seed,
            "version": __version__,
        }
        inputs |= {"classes": list(source.classes)} if source.stand_in == "sky" else {}
        images = {"train": round(0.7 * count), "val": round(0.1 * count), "test": count - round(0.8 * count)}
        self.add(Stage("world", name, inputs, {}, source, images))
        needs = {"of": f"world:{name}"}
        self.add(Stage("source", name, {"limits": limits}, needs, source, _limited(images, limits)))
        self.stand_ins.append(name)

    def _add_given(self, name: str, source: Source, path: Path) -> None:
        limits = _at_scale(source.limits, self.request)
        virtual = (path / WORLD_FILE).is_file()
        options = {} if virtual else dict(source.options)
        if virtual:
            self.stand_ins.append(name)
        dataset = read_dataset(path, options=options)
        facts = dataset_facts(dataset)
        labelled = {class_key(c) for of_split in facts["labels"].values() for c in of_split}
        missing = [c for c in source.classes if class_key(c) not in labelled]
        if missing:
            found = f"no label of {', '.join(missing)}; it has {', '.join(facts['classes']) or 'no class'}"
            self.problems.append(Problem(str(path), "class-missing", found, f"labels of {', '.join(missing)}"))
        needed = self.experiment.splits_used(name)
        empty = [s for s in needed if not facts["images"].get(s)]
        if empty:
            found = f"no image in {', '.join(empty)}"
            expected = f"images in {', '.join(needed)}"
            self.problems.append(Problem(str(path), "split-empty", found, expected, "see `infrablend split`"))
        inputs = {"content": content_digest(dataset), "options": options, "limits": limits}
        self.add(Stage("source", name, inputs, {}, source, _limited(facts["images"], limits), path))

    def skips(self, name: str, needs: Sequence[str]) -> bool:
        """Return whether an entry has no stage: it belongs to other scales, or something it needs is left out."""
        if not self.experiment.at(name, self.request.scale):
            self.left_out[name] = OTHER_SCALES
            return True
        for need in needs:
            if need in self.left_out:
                self.left_out.setdefault(name, self.left_out[need])
                return True
        return False

    def add_data(self, name: str) -> None:
        spec = self.experiment.data[name]
        parents = self.experiment.inputs_of(name)
        if self.skips(name, list(parents.values())):
            return
        needs = {role: self.made_by[i] for role, i in parents.items()}
        images = {role: self.stages[i].images for role, i in needs.items()}
        inputs, made = _DATA_INPUTS[spec.kind](spec, images, self.request)
        self.add(Stage(spec.kind, name, inputs, needs, spec, made))
        self.made_by[name] = f"{spec.kind}:{name}"

    def add_training(self, name: str, spec: Training) -> None:
        if self.skips(name, [spec.data]):
            return
        of_scale = self.experiment.settings.get(self.request.scale, {})
        # Given weights bring their own network, so they are not for a training that states another one.
        takes_given = spec.weights == AUTO and "model" not in spec.settings
        weights = self.request.weights if takes_given else spec.weights
        spec = spec.model_copy(update={"settings": {**of_scale, **spec.settings}, "weights": weights})
        start, digest = identify(spec.weights)
        inputs = {
            "preset": preset_inputs(preset_of(self.request, spec)),
            "scale": self.request.scale,
            "seed": self.request.seed + spec.reseed,
            "task": spec.task,
            "classes": spec.classes,
            "weights": start,
        }
        if digest is not None:  # training them anew must train what starts from them, wherever they lie
            inputs["weights_sha256"] = digest
        images = self.stages[self.made_by[spec.data]].images
        used = {s: images[s] for s in ("train", "val") if s in images}
        self.add(Stage("train", name, inputs, {"data": self.made_by[spec.data]}, spec, used))

    def add_evaluation(self, name: str, spec: Evaluation) -> None:
        training = self.experiment.trainings[spec.training]
        if self.skips(name, [spec.training, spec.data, training.data]):
            return
        inputs: dict[str, object] = {
            "split": spec.split,
            "classes": spec.classes,
            "group": spec.group,
            "bootstrap": BOOTSTRAP[self.request.scale],
            "seed": self.request.seed,
        }
        if spec.list_first is not None:
            inputs |= {"list_first": spec.list_first, "list_iou": spec.list_iou}
        if spec.by_body:
            inputs["by_body"] = True
        needs = {"training": f"train:{spec.training}", "data": self.made_by[spec.data]}
        images = self.stages[self.made_by[spec.data]].images
        used = {str(s): n for s, n in images.items() if s == spec.split}
        self.add(Stage("evaluate", name, inputs, needs, spec, used))

    def add_detectability(self, name: str, spec: Detectability) -> None:
        training = self.experiment.trainings[spec.training]
        if self.skips(name, [spec.training, spec.data, training.data]):
            return
        inputs = {
            **_recipe_inputs(read_recipe(spec.recipe, spec.settings).recipe, self.request),
            "split": spec.split,
            "category": spec.category,
            "group": spec.group,
            "until": spec.until.get(self.request.scale, DEFAULT_DETECTABILITY.until),
        }
        needs = {"training": f"train:{spec.training}", "data": self.made_by[spec.data]}
        images = self.stages[self.made_by[spec.data]].images
        used = {str(s): n for s, n in images.items() if s == spec.split}
        self.add(Stage("detectability", name, inputs, needs, spec, used))

    def add_comparison(self, name: str) -> None:
        spec = self.experiment.comparisons[name]
        if self.skips(name, [*spec.a, *spec.b]):
            return
        first = self.experiment.evaluations[spec.a[0]]
        for e in (*spec.a[1:], *spec.b):
            other = self.experiment.evaluations[e]
            if (other.data, other.split, other.group) != (first.data, first.split, first.group):
                found = f"{spec.a[0]} is on {first.data} {first.split}, {e} on {other.data} {other.split}"
                self.problems.append(Problem(f"comparisons.{name}", "experiment-value", found, "the same images"))
        inputs = {"bootstrap": BOOTSTRAP[self.request.scale], "seed": self.request.seed}
        # Roles are a, a1, a2, ... and b, b1, b2, ...
        needs = {
            f"{side}{k or ''}": f"evaluate:{e}" for side, of in (("a", spec.a), ("b", spec.b)) for k, e in enumerate(of)
        }
        images = self.stages[f"evaluate:{spec.a[0]}"].images
        self.add(Stage("compare", name, inputs, needs, spec, images))


def _at_scale(limits: Mapping[Scale, Mapping[Split, int]], request: ExperimentRequest) -> dict[str, int]:
    return {str(s): n for s, n in limits.get(request.scale, {}).items()}


def _limited(images: Mapping[str, int], limits: Mapping[str, int]) -> dict[str, int]:
    return {s: min(n, limits.get(s, n)) for s, n in images.items()}


ImagesByRole = Mapping[str, Mapping[str, int]]
"""About how many images per split the items have that a data item is made from, by role."""
DataInputs = tuple[Mapping[str, Any], dict[str, int]]
"""Inputs of a data stage, and about how many images it makes per split."""


def _run_inputs(spec: Generate, images: ImagesByRole, request: ExperimentRequest) -> DataInputs:
    recipe = read_recipe(spec.recipe, spec.settings).recipe
    made = {s: images["of"][s] for s in spec.splits if s in images["of"]}
    times = about_scenes(recipe, made.get("train") or sum(made.values())) + int(recipe.output.originals)
    inputs = {**_recipe_inputs(recipe, request), "splits": list(spec.splits)}
    return inputs, {s: n * times for s, n in made.items()}


def _recipe_inputs(recipe: Recipe, request: ExperimentRequest) -> dict[str, object]:
    """Return what decides the objects that a recipe inserts."""
    own = {o.model: description_digest(Path(o.model)) for o in recipe.objects if is_description(o.model)}
    return {
        "recipe": deciding_fields(recipe),
        "models": sorted(own.values()),  # the user's own models count by their content
        "version": __version__,
        "seed": request.seed,
        "renderer": request.renderer,
    }


def _convert_inputs(spec: Convert, images: ImagesByRole, request: ExperimentRequest) -> DataInputs:
    inputs = spec.model_dump(mode="json", exclude={"kind", "of", "match", "images"}, exclude_defaults=True)
    limits = _at_scale(spec.images, request)
    inputs = {**inputs, "splits": list(spec.splits), "seed": request.seed} | ({"images": limits} if limits else {})
    like = images.get("match", images["of"])  # a part that matches another item has as many images as that item
    return inputs, _limited({s: like[s] for s in spec.splits if s in like}, limits)


def _split_inputs(spec: Resplit, images: ImagesByRole, request: ExperimentRequest) -> DataInputs:
    inputs: dict[str, object] = {"by": spec.by, "gap": spec.gap, "shares": list(spec.shares), "seed": request.seed}
    inputs |= {"test": list(spec.test)} if spec.test else {}
    total = sum(images["of"].values())
    shares = sum(spec.shares)
    return inputs, {s: round(total * k / shares) for s, k in zip(SPLITS, spec.shares, strict=True)}


def _merge_inputs(spec: Merge, images: ImagesByRole, request: ExperimentRequest) -> DataInputs:
    parts = []
    made = Counter[str]()
    for part, of_part in zip(spec.parts, images.values(), strict=True):
        limits = _at_scale(part.images, request)
        moved = {} if part.into is None else {"into": part.into}
        parts.append({"name": part.of, "splits": list(part.splits), "images": limits, **moved})
        for split, n in _limited({s: of_part[s] for s in part.splits if s in of_part}, limits).items():
            made[part.into or split] += n
    return {"parts": parts, "seed": request.seed + spec.reseed}, dict(made)


def _paste_inputs(spec: Paste, images: ImagesByRole, request: ExperimentRequest) -> DataInputs:
    inputs = {"category": spec.category, "split": spec.split, "seed": request.seed, "version": __version__}
    return inputs, dict(images["like"])


_DATA_INPUTS: Mapping[str, Callable[[Any, ImagesByRole, ExperimentRequest], DataInputs]] = {
    "generate": _run_inputs,
    "convert": _convert_inputs,
    "split": _split_inputs,
    "merge": _merge_inputs,
    "paste": _paste_inputs,
}


def preset_of(request: ExperimentRequest, spec: Training) -> Preset:
    """Return the preset of a training: the scale's, with the experiment's settings, then the user's."""
    return choose_preset(request.scale, {**spec.settings, **request.training})


def preset_inputs(preset: Preset) -> dict[str, object]:
    """Return everything of a preset that decides a training, as plain JSON."""
    return {k: v for k, v in asdict(preset).items() if k != "summary"}


def deciding_fields(recipe: Recipe) -> dict[str, object]:
    """Return the fields that decide frames and labels, defaults left out.

    Because defaults are left out, a field that a later version adds does not invalidate finished stages.
    """
    left_out: Any = {"description": True, "name": True, "output": NOT_IN_KEY}
    found: dict[str, object] = json.loads(recipe.model_dump_json(exclude=left_out, exclude_defaults=True))
    return {k: v for k, v in found.items() if v != {}}


def where_to_get(source: Source) -> str:
    """Return one line on how to obtain a source."""
    try:
        return f"see {require_source(source.format).page}"
    except InfraBlendError:
        return EXPERIMENTS_PAGE
