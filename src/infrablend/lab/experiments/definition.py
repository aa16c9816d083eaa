"""The file of an experiment: datasets, trainings, evaluations, detectabilities, comparisons, tables and claims.

The YAML file also contains the paper's figures that ours are compared with. Each kind of data is a class here (its
fields in the file) and a maker in `pipeline/experiments` (how it is made).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, model_validator

from infrablend.config.loading import parse_mapping, read_text, whole_path
from infrablend.config.recipe import LooseFactor, LoosePx
from infrablend.config.sensor_profile import PROFILE_SUFFIXES
from infrablend.core.dataset import SPLITS, Split
from infrablend.core.file_names import real_path
from infrablend.core.strict_model import Strict
from infrablend.core.validation_messages import read_model
from infrablend.errors import RecipeError
from infrablend.lab.experiments.experiment_request import EXPERIMENTS, NAME_PATTERN, SCALES, Scale
from infrablend.pipeline.flights.detectability_figures import LEAST_COMPARED

_PATH_FIELD = re.compile(r"objects\.\d+\.model|sensor\.profile", re.ASCII)

Metric = Literal[
    "p", "r", "map10", "map50", "map50_95", "as_one50", "as_one50_95", "found", "named", "false_alarms",
    "hota", "mota", "idf1",
]  # fmt: skip
METRICS: tuple[Metric, ...] = get_args(Metric)
"""Figures of the row of a class; `as_one50` and `as_one50_95` are of all classes, so only of the row `all`."""

Name = Annotated[str, Field(pattern=NAME_PATTERN)]


def _names(given: Any) -> Any:
    """Accept a single name in place of a list."""
    return (given,) if isinstance(given, str) else tuple(given) if isinstance(given, list) else given


Names = Annotated[tuple[Name, ...], BeforeValidator(_names), Field(min_length=1)]
Limits = dict[Split, Annotated[int, Field(ge=1)]]
Seeds = Annotated[int, Field(ge=1, le=1000)]
HalfWidth = Annotated[float, Field(gt=0, le=0.5)]


class Source(Strict):
    """A dataset that the user gives with `--data DIR` or `--data NAME=DIR`."""

    format: str = Field(min_length=1)
    """Format, by which the folders given with `--data` are recognised."""
    title: str = Field(min_length=1)
    """Name on the page."""
    optional: bool = False
    """Whether the experiment also runs without it; the page then lists what is left out."""
    classes: tuple[str, ...] = ()
    """Classes that must have labels in it; they also tell sources of one format apart."""
    options: dict[str, str] = Field(default_factory=dict)
    """Options of its reader; not used for a virtual world."""
    stand_in: Literal["hit-uav", "monet", "sky"] | None = None
    """Layout of the virtual world that is made if no folder is given; `sky` shows `classes` in front of the sky."""
    stand_in_images: dict[Scale, Annotated[int, Field(ge=3)]] = Field(default_factory=dict)
    """Number of images of that virtual world at each scale."""
    limits: dict[Scale, Limits] = Field(default_factory=dict)
    """Maximum number of images per split at each scale, evenly spread and showing every class; all by default."""
    paper_images: Limits = Field(default_factory=dict)
    """Images per split in the paper."""


class Generate(Strict):
    """Objects inserted into another data item by a recipe."""

    kind: Literal["generate"]
    of: Name
    """Source or data item that provides the backgrounds."""
    recipe: str = Field(min_length=1)
    """Name of a shipped recipe, or a YAML file; its path is relative to this file."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Recipe fields to change; paths of models and of a sensor profile are relative to this file."""
    splits: tuple[Split, ...] = SPLITS
    """Splits to make."""


class Convert(Strict):
    """A part of another data item, with classes renamed or dropped; see `infrablend convert`."""

    kind: Literal["convert"]
    of: Name
    """Source or data item to take the part from."""
    rename: dict[str, str] = Field(default_factory=dict)
    """New class names by old ones; classes that the data do not have are ignored."""
    drop: tuple[str, ...] = ()
    """Classes to drop, by their new names."""
    only: str | None = None
    """Only class to keep, instead of `drop`."""
    with_class: str | None = None
    """Use only images that show this class."""
    without: tuple[str, ...] = ()
    """Use only images that show none of these classes; classes that the data do not have are ignored."""
    like: str | None = None
    """Draw images to match time of day, altitude, pitch and grey level of those that show this class."""
    images: dict[Scale, Limits] = Field(default_factory=dict)
    """Maximum number of images per split at each scale, drawn at random or as with `like`; all by default."""
    loosen: LooseFactor = 1.0
    """Enlarge the boxes of inserted objects by this factor, to match hand-drawn boxes."""
    loosen_px: LoosePx = 0.0
    """Move each side of the boxes of inserted objects outwards by this distance, px, after `loosen`."""
    match: Name | None = None
    """Data item whose numbers of images and of `with_class` objects per split this part matches."""
    clips: bool = False
    """Whether the clip that the names of images tell is the sequence of those that state none."""
    splits: tuple[Split, ...] = SPLITS
    """Splits to make."""

    @model_validator(mode="after")
    def _fits(self) -> Convert:
        if self.match is not None and self.with_class is None:
            raise ValueError("match needs with_class, the class of the objects to count")
        if self.only is not None and self.drop:
            raise ValueError("only and drop exclude each other; give one of them")
        return self


class Resplit(Strict):
    """New splits that keep related images in one split."""

    kind: Literal["split"]
    of: Name
    """Source or data item to split."""
    by: Literal["sequence", "date", "gap"]
    """Images that stay in one split: those of a sequence, of a date, or of a run of frame numbers."""
    gap: int | None = Field(None, ge=1)
    """For `by: gap`: largest step between frame numbers within a run."""
    shares: tuple[float, float, float] = (0.7, 0.1, 0.2)
    """Shares of train, val and test."""
    test: tuple[str, ...] = ()
    """Sequences, dates or runs that are test; the others become train and val."""


class Part(Strict):
    """A part of a merged dataset."""

    of: Name
    """Source or data item to take the images from."""
    splits: tuple[Split, ...] = SPLITS
    """Splits to take images from."""
    into: Split | None = None
    """Split to put them in; they keep their own by default."""
    images: dict[Scale, Limits] = Field(default_factory=dict)
    """Maximum number of images per split at each scale, drawn at random; a smaller draw is part of a larger one."""


class Merge(Strict):
    """The images of several data items in one dataset; classes of the same name are one class."""

    kind: Literal["merge"]
    parts: tuple[Part, ...] = Field(min_length=1)
    """Parts to put together."""
    redraw: bool = False
    """Whether each seed of a training that uses it, or what is made from it, draws other images."""
    reseed: int = Field(0, ge=0)
    """Number added to the run's seed, to draw other images."""


class Paste(Strict):
    """Cut-outs of real objects pasted over backgrounds, in place of the objects that a `generate` item inserted.

    Every frame of that item gets as many objects as it shows there, at the same positions where the cut-outs fit, and
    elsewhere in the sky where not.
    """

    kind: Literal["paste"]
    of: Name
    """Source or data item with the real objects."""
    category: str = Field(min_length=1)
    """Class of the objects to cut out."""
    split: Split = "train"
    """Split to cut them out of."""
    like: Name
    """Item of kind `generate` whose backgrounds, numbers of objects and positions are used."""


Data = Annotated[Generate | Convert | Resplit | Merge | Paste, Field(discriminator="kind")]


class Training(Strict):
    """A detector to train."""

    data: Name
    """Source or data item with the splits train and val."""
    classes: tuple[str, ...] | None = None
    """Classes to train on; all by default."""
    task: Literal["detect", "obb", "segment"] = "detect"
    """Kind of labels it predicts."""
    weights: str = "auto"
    """Start weights: `auto`, `scratch`, the name of published weights, or a file."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Settings to use instead of those of the scale's preset."""
    seeds: Seeds | dict[Scale, Seeds] = 1
    """Number of trainings with other start weights and another order of images, or that number by scale; 1 by default.

    Three seeds of `NAME` are the trainings `NAME`, `NAME-1` and `NAME-2`, and its evaluations are repeated likewise.
    """
    reseed: int = Field(0, ge=0)
    """Number added to the run's seed."""
    paper_images: int | None = Field(None, ge=1)
    """Training images in the paper."""

    def seeds_at(self, scale: Scale) -> int:
        """Return the number of seeds at a scale."""
        return self.seeds if isinstance(self.seeds, int) else self.seeds.get(scale, 1)


def seed_names(name: str, count: int) -> tuple[str, ...]:
    """Return the names of the seeds of a training, evaluation or data item: `NAME`, `NAME-1`, `NAME-2`, ..."""
    return (name, *(f"{name}-{k}" for k in range(1, count)))


class Evaluation(Strict):
    """A detector evaluated on a split."""

    training: Name
    """Training that provides the weights."""
    data: Name
    """Source or data item to evaluate on."""
    split: Split = "test"
    """Split to evaluate on."""
    classes: tuple[str, ...] | Literal["joint"] | None = None
    """Classes to evaluate; `joint` for those that both detector and images have; all by default."""
    group: Literal["image", "sequence"] = "image"
    """Unit that the bootstrap draws."""
    list_first: int | None = Field(None, ge=1)
    """List every object on the page, found or missed among this many detections with the highest scores; for tests with
    few objects."""
    list_iou: float = Field(0.3, gt=0, le=1)
    """Least overlap with an object to be listed as found."""
    by_body: bool = False
    """Give AP by the size of what the pictures show of the objects, too."""
    tracks: bool = False
    """Run a tracker over the detections, and compare with the labelled tracks."""


class Detectability(Strict):
    """How likely a detector finds a recipe's objects in the images of a split, beside how many real ones it finds.

    See `infrablend detectability`, which has the same settings.
    """

    training: Name
    """Training that provides the weights."""
    data: Name
    """Source or data item that provides the images."""
    recipe: str = Field(min_length=1)
    """Name of a shipped recipe, or a YAML file; its path is relative to this file."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Recipe fields to change; paths of models and of a sensor profile are relative to this file."""
    split: Split = "test"
    """Split of the images."""
    category: str | None = None
    """Class to look for; that of the recipe's first object by default."""
    group: Literal["image", "sequence", "date", "gap"] = "image"
    """Images whose results depend on each other."""
    until: dict[Scale, HalfWidth] = Field(default_factory=dict)
    """Largest half of the interval of the share found, at each scale; 0.03 by default."""
    title: str = ""
    """Name on the page; that of the entry by default."""


class Comparison(Strict):
    """The paired difference a - b of two evaluations on the same images and classes."""

    a: Names
    """Evaluation with all its seeds, or several whose detectors differ only in the seed; their mean is compared."""
    b: Names
    """Evaluation, or several, to subtract. Both sides have as many seeds as the evaluation with the fewest."""
    seeds: Seeds | None = None
    """Largest number of seeds to compare; all by default."""
    title: str = ""
    """Name on the page; `a - b` by default."""


class Figures(Strict):
    """Figures in the paper."""

    images: int | None = None
    """Number of images with the class."""
    instances: int | None = None
    """Number of objects."""
    p: float | None = None
    """Precision."""
    r: float | None = None
    """Recall."""
    map50: float | None = None
    """AP at IoU 0.5."""
    map50_95: float | None = None
    """AP over IoU 0.5 to 0.95."""


class Row(Strict):
    """A row of a table."""

    title: str = Field(min_length=1)
    """Text of the first cell."""
    evaluation: Names | None = None
    """Evaluations that give the figures, with all their seeds: means of several are shown. The table's by default."""
    category: str = "all"
    """Class, or `all`."""
    paper: Figures = Figures()
    """Figures in the paper."""


class Table(Strict):
    """A table of the page."""

    title: str = Field(min_length=1)
    """Heading."""
    evaluation: Name | None = None
    """Evaluation, with its first seed, of all rows that name none. Its remaining classes follow as rows without figures
    of the paper."""
    note: str = ""
    """Text below the table."""
    columns: tuple[Metric, ...] = ("p", "r", "map50", "map50_95")
    """Figures to show."""
    rows: tuple[Row, ...] = Field(min_length=1)
    """Rows."""


class FactsRow(Strict):
    """A row of the table of datasets."""

    title: str = Field(min_length=1)
    """Name of the dataset."""
    data: tuple[Name, ...] = Field(min_length=1)
    """Sources and data items that make up the dataset."""
    images: int | None = None
    """Number of images in the paper."""
    classes: int | None = None
    """Number of classes in the paper."""
    labels: tuple[Literal["AABB", "OBB", "Masks"], ...] = ()
    """Kinds of labels in the paper."""


class RecallCells(Strict):
    """Conditions, such as ranges of sizes, in which the predicted recall is compared with the actual one."""

    of: Names
    """Detectabilities, with all their seeds."""
    by: Literal["confidence", "size", "time"] | None = None
    """Kind of condition, or all objects at each confidence; conditions of every kind by default."""
    value: str | None = None
    """Only condition of that kind to look at, such as `night`."""
    least_real: int = Field(LEAST_COMPARED, ge=1)
    """Least number of real objects."""


class Check(Strict):
    """A claim, decided by an interval, a ratio, or predicted and actual recall."""

    text: str = Field(min_length=1)
    """Claim on the page."""
    comparison: Name | None = None
    """Comparison that decides."""
    ratio: tuple[Names, Names] | None = None
    """Two evaluations whose ratio decides, instead of a comparison; the means of several are compared."""
    recall: RecallCells | None = None
    """Differences of predicted and actual recall that decide, instead of a comparison."""
    category: str = "all"
    """Class, or `all`; not for `recall`."""
    metric: Metric = "map50_95"
    """Metric; not for `recall`."""
    time: Literal["night", "day"] | None = None
    """For a ratio: only objects in images of this time of day."""
    expect: Literal["below", "above", "within", "not_below", "at_least", "at_most", "report"]
    """Whole interval below or above 0, 0 within it, not entirely below 0; ratio, or share of the intervals of `recall`
    that hold 0, of at least `least`; every difference of `recall` at most `most`; or no verdict."""
    least: float | None = None
    """Smallest ratio or share for `at_least`."""
    most: float | None = Field(None, gt=0)
    """Largest difference for `at_most`, up or down."""
    scales: tuple[Scale, ...] = SCALES
    """Scales at which the claim is checked."""

    @model_validator(mode="after")
    def _whole(self) -> Check:
        no_comparison = self.comparison is None
        no_ratio = self.ratio is None
        no_recall = self.recall is None
        at_least = self.expect == "at_least"
        at_most = self.expect == "at_most"
        of_interval = self.expect in ("below", "above", "within", "not_below")
        for wrong, why in (
            (no_comparison + no_ratio + no_recall != 2, "a check needs one of comparison, ratio and recall"),
            (at_least != (self.least is not None), "expect: at_least and least need each other"),
            (at_most != (self.most is not None), "expect: at_most and most need each other"),
            (of_interval and no_comparison, f"expect: {self.expect} needs a comparison"),
            (self.time is not None and no_ratio, "time needs a ratio"),
            (at_least and no_ratio and no_recall, "expect: at_least needs a ratio or recall"),
            (at_most and no_recall, "expect: at_most needs recall"),
        ):
            if wrong:
                raise ValueError(why)
        return self


class Experiment(Strict):
    """The content of an experiment's file."""

    name: str = Field(pattern=NAME_PATTERN)
    """Name of the experiment and of its page."""
    title: str = Field(min_length=1)
    """Heading of the page."""
    description: str = Field(min_length=1)
    """Question it answers."""
    about: str = ""
    """Background that readers of the page need."""
    sources: dict[Name, Source] = Field(min_length=1)
    """Datasets that the user gives, by name."""
    data: dict[Name, Data] = Field(default_factory=dict)
    """Data items made from them, by name."""
    scales: tuple[Scale, ...] = ("smoke", "small", "paper")
    """Scales at which it can be run."""
    settings: dict[Scale, dict[str, Any]] = Field(default_factory=dict)
    """Settings of all trainings at each scale, instead of those of the scale's preset."""
    trainings: dict[Name, Training] = Field(default_factory=dict)
    """Detectors to train, by name."""
    evaluations: dict[Name, Evaluation] = Field(default_factory=dict)
    """Evaluations of them, by name."""
    detectabilities: dict[Name, Detectability] = Field(default_factory=dict)
    """How likely they find inserted objects, by name."""
    comparisons: dict[Name, Comparison] = Field(default_factory=dict)
    """Paired differences, by name."""
    tables: tuple[Table, ...] = ()
    """Tables of the page."""
    facts: tuple[FactsRow, ...] = ()
    """Rows of the table of datasets."""
    strata: str = "all"
    """Class shown in the tables by size, pitch, altitude and time."""
    checks: tuple[Check, ...] = ()
    """Claims that the page decides."""
    only_at: dict[Name, tuple[Scale, ...]] = Field(default_factory=dict)
    """Scales of data items, trainings, evaluations, detectabilities and comparisons that do not belong to every scale,
    by name."""

    @model_validator(mode="after")
    def _names_exist(self) -> Experiment:
        wrong = sorted(set(self._unknown_names()))
        if wrong:
            raise ValueError("; ".join(wrong))
        return self

    def _unknown_names(self) -> Iterator[str]:
        both = sorted(set(self.sources) & set(self.data))
        yield from (f"{n} is both in sources and in data" for n in both)
        items = {*self.sources, *self.data}
        repeated = {
            "data": self.seeds_of_data(),
            "trainings": self.seeds_of_trainings(),
            "evaluations": self.seeds_of_evaluations(),
            "detectabilities": self.seeds_of_detectabilities(),
        }
        for kind, names_of in repeated.items():
            twice = [(n, one) for n, names in names_of.items() for one in names[1:] if one in names_of]
            yield from (f"{kind}.{n}: its seeds include {one}, which the file has as well" for n, one in twice)
        trainings, evaluations, detectabilities = (
            {one for names in repeated[kind].values() for one in names}
            for kind in ("trainings", "evaluations", "detectabilities")
        )
        for n, d in self.data.items():
            if isinstance(d, Paste) and not isinstance(self.data.get(d.like), Generate):
                yield f"data.{n}.like: {d.like} is no data item of kind generate"
        known = {
            "source or data": items,
            "training": trainings,
            "evaluation": evaluations,
            "detectability": detectabilities,
            "comparison": {*self.comparisons},
            "stage": {*self.data, *trainings, *evaluations, *detectabilities, *self.comparisons},
        }
        yield from (f"{place}: no {kind} {name}" for place, kind, name in self._references() if name not in known[kind])

    def _references(self) -> Iterator[tuple[str, str, str]]:
        """Yield place, kind and name of every reference in the file."""
        data = "source or data"
        evaluation = "evaluation"
        for n in self.data:
            yield from ((f"data.{n}", data, i) for i in self.inputs_of(n).values())
        yield from ((f"trainings.{n}.data", data, t.data) for n, t in self.trainings.items())
        for kind, entries in (("evaluations", self.evaluations), ("detectabilities", self.detectabilities)):
            for n, e in entries.items():
                yield f"{kind}.{n}.training", "training", e.training
                yield f"{kind}.{n}.data", data, e.data
        for n, c in self.comparisons.items():
            yield from ((f"comparisons.{n}", evaluation, of) for of in (*c.a, *c.b))
        for k, table in enumerate(self.tables):
            for row in table.rows:
                names = row.evaluation or (str(table.evaluation),)
                yield from ((f"tables.{k}: {row.title}", evaluation, of) for of in names)
        for k, f in enumerate(self.facts):
            yield from ((f"facts.{k}.data", data, d) for d in f.data)
        for k, check in enumerate(self.checks):
            if check.comparison is not None:
                yield f"checks.{k}.comparison", "comparison", check.comparison
            yield from ((f"checks.{k}.ratio", evaluation, e) for side in check.ratio or () for e in side)
            if check.recall is not None:
                yield from ((f"checks.{k}.recall", "detectability", d) for d in check.recall.of)
        yield from (("only_at", "stage", n) for n in self.only_at)

    def seeds_of_trainings(self, scales: Sequence[Scale] = SCALES) -> dict[str, tuple[str, ...]]:
        """Return the names of all seeds of each training, at any of these scales."""
        return {n: seed_names(n, max(t.seeds_at(s) for s in scales)) for n, t in self.trainings.items()}

    def seeds_of_evaluations(self) -> dict[str, tuple[str, ...]]:
        """Return the names of each evaluation of all seeds of its training."""
        return self._of_all_seeds(self.evaluations)

    def seeds_of_detectabilities(self) -> dict[str, tuple[str, ...]]:
        """Return the names of each detectability of all seeds of its training."""
        return self._of_all_seeds(self.detectabilities)

    def _of_all_seeds(
        self, entries: Mapping[str, Evaluation] | Mapping[str, Detectability]
    ) -> dict[str, tuple[str, ...]]:
        seeds = self.seeds_of_trainings()
        return {n: seed_names(n, len(seeds.get(e.training, (n,)))) for n, e in entries.items()}

    def seeds_of_data(self, scales: Sequence[Scale] = SCALES) -> dict[str, tuple[str, ...]]:
        """Return the names of all draws of each data item, at any of these scales.

        What is redrawn, and what is made from it, is drawn once per seed of the trainings that use it in the end. What
        is split is not: evaluations use the first draw, whose test images would be among the train images of others.
        """
        seeds = self.seeds_of_trainings(scales)
        redrawn = {n for n, d in self.data.items() if isinstance(d, Merge) and d.redraw}
        draws = dict.fromkeys((*self.sources, *self.data), 1)
        for n, training in self.trainings.items():
            if training.data in draws and any(self.at(n, s) for s in scales):
                draws[training.data] = max(draws[training.data], len(seeds[n]))
        for _ in self.data:  # each round reaches one item further along a chain
            for n, item in self.data.items():
                made_from = [i for i in self.inputs_of(n).values() if i in draws]
                draws |= {i: max(draws[i], draws[n]) for i in made_from}
                if redrawn & set(made_from) and not isinstance(item, Resplit):
                    redrawn.add(n)
        return {n: seed_names(n, draws[n] if n in redrawn else 1) for n in self.data}

    def inputs_of(self, name: str) -> dict[str, str]:
        """Return the names of the sources and items that a data item is made from, by role."""
        data = self.data[name]
        match data:
            case Merge():
                return {f"part{k}": part.of for k, part in enumerate(data.parts)}
            case Paste():
                like = self.data.get(data.like)
                return {"of": data.of, "like": data.like} | ({"onto": like.of} if isinstance(like, Generate) else {})
            case Convert(match=str(match)):
                return {"of": data.of, "match": match}
        return {"of": data.of}

    def splits_used(self, name: str) -> list[Split]:
        """Return the splits of a source or data item that data, trainings, evaluations or detectabilities use."""
        found: set[Split] = set()
        for d in self.data.values():
            match d:
                case Merge():
                    found |= {s for part in d.parts if part.of == name for s in part.splits}
                case Paste() if d.of == name:
                    found.add(d.split)
                case Generate() | Convert() if d.of == name:
                    found |= set(d.splits)
        found |= {s for t in self.trainings.values() if t.data == name for s in SPLITS if s != "test"}
        found |= {e.split for e in self.evaluations.values() if e.data == name}
        found |= {d.split for d in self.detectabilities.values() if d.data == name}
        return [s for s in SPLITS if s in found]

    def at(self, name: str, scale: Scale) -> bool:
        """Return whether the entry of that name belongs to the scale."""
        return scale in self.only_at.get(name, SCALES)


def list_experiments() -> list[str]:
    """Return the names of the shipped experiments, sorted."""
    return EXPERIMENTS.names


def load_experiment(experiment: str | Path) -> Experiment:
    """Return the experiment of a shipped name or of a YAML file.

    Raises:
        RecipeError: The file cannot be read, or is wrong; lists every unknown key and bad value.
    """
    text, folder = read_text(EXPERIMENTS, experiment)
    return parse_experiment(text, str(experiment), folder)


def parse_experiment(text: str, where: str, folder: Path | None = None) -> Experiment:
    """Return the experiment in a YAML text, as `load_experiment`; paths in it are relative to `folder`."""
    data = parse_mapping(text, f"experiment {where}", "docs/how_to/experiments.md")
    sections = [of for kind in ("data", "detectabilities") if isinstance(of := data.get(kind), Mapping)]
    for item in (one for of in sections for one in of.values()):
        recipe = item.get("recipe") if isinstance(item, dict) else None
        if folder is not None and isinstance(recipe, str) and recipe.lower().endswith((".yaml", ".yml")):
            item["recipe"] = str(real_path(folder / recipe))
        settings = item.get("settings") if isinstance(item, dict) else None
        if folder is not None and isinstance(settings, dict):
            paths = {k: v for k, v in settings.items() if isinstance(v, str) and _PATH_FIELD.fullmatch(str(k))}
            settings |= {k: whole_path(folder, v) for k, v in paths.items() if v.lower().endswith(PROFILE_SUFFIXES)}
    found = read_model(Experiment, data, where, "experiment", "see docs/how_to/experiments.md for all fields")
    if isinstance(found, Experiment):
        return found
    raise RecipeError(f"experiment {where}: {len(found)} field(s) are wrong", found)
