"""What an experiment is: data made from the user's datasets, trainings, evaluations, comparisons, tables, conclusions.

A YAML file says it all, the paper's figures beside what they are compared with included. Every kind of data is a class
here (what the file may say of it) and an entry in `pipeline/stages.py` (how it is made).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from infrablend.core.dataset import SPLITS, Split
from infrablend.core.strict import Strict
from infrablend.core.wording import did_you_mean, field_problems
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import Problem, RecipeError

Scale = Literal["smoke", "small", "paper"]
SCALES: tuple[Scale, ...] = ("smoke", "small", "paper")
Metric = Literal["p", "r", "map50", "map50_95"]
METRICS: tuple[Metric, ...] = ("p", "r", "map50", "map50_95")

_NAME = r"^[a-z0-9][a-z0-9-]*$"
Name = Annotated[str, Field(pattern=_NAME)]


def _names(given: Any) -> Any:
    """One name needs no brackets."""
    return (given,) if isinstance(given, str) else tuple(given) if isinstance(given, list) else given


Names = Annotated[tuple[Name, ...], BeforeValidator(_names), Field(min_length=1)]
Limits = dict[Split, Annotated[int, Field(ge=1)]]


class Source(Strict):
    """A dataset that the user has: `--data DIR`."""

    format: str = Field(min_length=1)
    """Its format, by which `--data` folders are told apart."""
    title: str = Field(min_length=1)
    """Its name on the page."""
    optional: bool = False
    """Where it is absent, what depends on it is left out, and the page says so."""
    classes: tuple[str, ...] = ()
    """Classes that it must have with labels."""
    options: dict[str, str] = Field(default_factory=dict)
    """Options of its reader. A virtual world is read without them."""
    stand_in: Literal["hit-uav", "monet"] | None = None
    """The virtual world of this layout is rendered where no folder is given."""
    stand_in_images: dict[Scale, Annotated[int, Field(ge=3)]] = Field(default_factory=dict)
    """How many of its images."""
    limits: dict[Scale, Limits] = Field(default_factory=dict)
    """At most so many images of each split, evenly spread, every class among them; all by default."""
    paper_images: Limits = Field(default_factory=dict)
    """Images of each split in the paper."""


class Generate(Strict):
    """Objects inserted into another data item by a recipe."""

    kind: Literal["generate"]
    of: Name
    """What the backgrounds are: a source, or another data item."""
    recipe: str = Field(min_length=1)
    """A shipped recipe's name, or a YAML file beside this one."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Recipe fields to set."""
    splits: tuple[Split, ...] = SPLITS
    """The splits that are needed; no others are made."""


class Convert(Strict):
    """A part of another data item, its classes renamed or left out; see `infrablend convert`."""

    kind: Literal["convert"]
    of: Name
    """The data item."""
    rename: dict[str, str] = Field(default_factory=dict)
    """New names of classes."""
    drop: tuple[str, ...] = ()
    """Classes to leave out, by the new name."""
    only: str | None = None
    """The one class to keep, instead of `drop`."""
    with_class: str | None = None
    """Only images that show this class."""
    without: tuple[str, ...] = ()
    """Only images that show none of these classes; those that the data do not have are none."""
    like: str | None = None
    """Images drawn so that times of day, heights and pitches are shared out as among those that show this class."""
    images: dict[Scale, Limits] = Field(default_factory=dict)
    """At most so many images of each split, drawn at random or as `like` says; all by default."""
    loosen: float = Field(1.0, ge=1, le=2)
    """Boxes of inserted objects so many times as wide and high, as annotators by hand leave room."""
    match: Name | None = None
    """As many images, and as many objects of `with_class`, in each split as this data item has."""
    splits: tuple[Split, ...] = SPLITS
    """The splits that are needed."""

    @model_validator(mode="after")
    def _fits(self) -> Convert:
        if self.match is not None and self.with_class is None:
            raise ValueError("match goes with with_class: the objects to count")
        if self.only is not None and self.drop:
            raise ValueError("only and drop: one of the two")
        return self


class Resplit(Strict):
    """New splits that keep together what belongs together."""

    kind: Literal["split"]
    of: Name
    """The data item."""
    by: Literal["sequence", "date", "gap"]
    """What is kept together."""
    gap: int | None = Field(None, ge=1)
    """For `gap`: a run ends where the next frame is over so many away."""
    shares: tuple[float, float, float] = (0.7, 0.1, 0.2)
    """Of train, val and test."""


def made_of(data: Generate | Convert | Resplit) -> list[str]:
    """The items that one is made of."""
    match = data.match if isinstance(data, Convert) else None
    return [data.of, *([match] if match is not None else [])]


Data = Annotated[Generate | Convert | Resplit, Field(discriminator="kind")]


class Training(Strict):
    """A detector."""

    data: Name
    """Source or data item with train and val."""
    classes: tuple[str, ...] | None = None
    """Only these classes; all by default."""
    task: Literal["detect", "obb", "segment"] = "detect"
    """What it predicts."""
    weights: str = "auto"
    """What it starts from: `auto`, `scratch`, a usual name or a file."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Trainer's settings over those of the scale's preset."""
    reseed: int = Field(0, ge=0)
    """Added to the run's seed: the same once more, with other weights to start from and images in another order."""
    paper_images: int | None = Field(None, ge=1)
    """Training images in the paper."""


class Evaluation(Strict):
    """A detector's figures on images."""

    training: Name
    """Whose weights."""
    data: Name
    """Source or data item that has the split."""
    split: Split = "test"
    """The images."""
    classes: tuple[str, ...] | Literal["joint"] | None = None
    """`joint`: those that both detector and images have; all by default."""
    group: Literal["image", "sequence"] = "image"
    """What the bootstrap draws."""


class Comparison(Strict):
    """Two evaluations on the same images and classes, paired: a - b."""

    a: Names
    """An evaluation; or several, of detectors trained alike but for `reseed`: their mean."""
    b: Names
    """Another one, or several."""
    title: str = ""
    """What it says, for the page."""


class Figures(Strict):
    """What the paper prints."""

    images: int | None = None
    """Images with the class."""
    instances: int | None = None
    """Objects."""
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
    """Its first cell."""
    evaluation: Name | None = None
    """The table's by default."""
    category: str = "all"
    """The class, or `all`."""
    paper: Figures = Figures()
    """The paper's row."""


class Table(Strict):
    """A table of the page."""

    title: str = Field(min_length=1)
    """Above it."""
    evaluation: Name | None = None
    """Of all rows that name none; its further classes follow without figures of the paper."""
    note: str = ""
    """Below it."""
    rows: tuple[Row, ...] = Field(min_length=1)
    """Its rows."""


class FactsRow(Strict):
    """A dataset's numbers."""

    title: str = Field(min_length=1)
    """Its name."""
    data: tuple[Name, ...] = Field(min_length=1)
    """The items that it consists of."""
    images: int | None = None
    """In the paper."""
    classes: int | None = None
    """In the paper."""
    labels: tuple[Literal["AABB", "OBB", "Masks"], ...] = ()
    """In the paper."""


class Check(Strict):
    """A conclusion, computed from intervals."""

    text: str = Field(min_length=1)
    """The claim."""
    comparison: Name | None = None
    """The difference that decides."""
    ratio: tuple[Name, Name] | None = None
    """Or the ratio of two evaluations' figures."""
    category: str = "all"
    """The class."""
    metric: Metric = "map50_95"
    """The figure."""
    expect: Literal["below", "above", "within", "not_below", "at_least", "report"]
    """The whole interval below 0, above 0, 0 within it, not wholly below 0; a ratio of at least; or no verdict."""
    least: float | None = None
    """For `at_least`."""
    scales: tuple[Scale, ...] = SCALES
    """Where it is asked."""

    @model_validator(mode="after")
    def _whole(self) -> Check:
        if (self.comparison is None) == (self.ratio is None):
            raise ValueError("a check needs either comparison or ratio")
        if (self.expect == "at_least") != (self.least is not None):
            raise ValueError("expect: at_least goes with least")
        if self.expect in ("below", "above", "within", "not_below") and self.comparison is None:
            raise ValueError(f"expect: {self.expect} needs a comparison")
        if self.expect == "at_least" and self.ratio is None:
            raise ValueError("expect: at_least needs a ratio")
        return self


class Experiment(Strict):
    """A whole experiment."""

    name: str = Field(pattern=_NAME)
    """Name of its page."""
    title: str = Field(min_length=1)
    """Heading of its page."""
    description: str = Field(min_length=1)
    """What it asks."""
    about: str = ""
    """What readers of the page must know."""
    sources: dict[Name, Source] = Field(min_length=1)
    """The user's datasets."""
    data: dict[Name, Data] = Field(default_factory=dict)
    """What is made of them."""
    trainings: dict[Name, Training] = Field(default_factory=dict)
    """Detectors."""
    evaluations: dict[Name, Evaluation] = Field(default_factory=dict)
    """Their figures."""
    comparisons: dict[Name, Comparison] = Field(default_factory=dict)
    """Paired differences."""
    tables: tuple[Table, ...] = ()
    """The page's tables."""
    facts: tuple[FactsRow, ...] = ()
    """A table of datasets."""
    strata: str = "all"
    """The class that the tables by size, pitch, altitude and time are of."""
    checks: tuple[Check, ...] = ()
    """The page's conclusions."""
    only_at: dict[Name, tuple[Scale, ...]] = Field(default_factory=dict)
    """Data, trainings, evaluations and comparisons that belong to some scales alone, by name."""

    @model_validator(mode="after")
    def _names_lead_somewhere(self) -> Experiment:
        wrong = sorted(set(self._dangling()))
        if wrong:
            raise ValueError("; ".join(wrong))
        return self

    def _dangling(self) -> Iterator[str]:
        """What names something that is not there."""
        both = sorted(set(self.sources) & set(self.data))
        yield from (f"{n} is both in sources and in data" for n in both)
        items = {*self.sources, *self.data}
        for n, d in self.data.items():
            yield from (f"data.{n}: no source or data {i}" for i in made_of(d) if i not in items)
        for n, t in self.trainings.items():
            if t.data not in items:
                yield f"trainings.{n}.data: no source or data {t.data}"
        for n, e in self.evaluations.items():
            if e.training not in self.trainings:
                yield f"evaluations.{n}.training: no training {e.training}"
            if e.data not in items:
                yield f"evaluations.{n}.data: no source or data {e.data}"
        for n, c in self.comparisons.items():
            yield from (f"comparisons.{n}: no evaluation {e}" for e in (*c.a, *c.b) if e not in self.evaluations)
        for k, table in enumerate(self.tables):
            for row in table.rows:
                of = row.evaluation or table.evaluation
                if of not in self.evaluations:
                    yield f"tables.{k}: {row.title}: no evaluation {of}"
        for k, f in enumerate(self.facts):
            yield from (f"facts.{k}.data: no source or data {d}" for d in f.data if d not in items)
        for k, check in enumerate(self.checks):
            if check.comparison is not None and check.comparison not in self.comparisons:
                yield f"checks.{k}.comparison: no comparison {check.comparison}"
            yield from (f"checks.{k}.ratio: no evaluation {e}" for e in check.ratio or () if e not in self.evaluations)
        known = {*self.data, *self.trainings, *self.evaluations, *self.comparisons}
        yield from (f"only_at: no stage {n}" for n in self.only_at if n not in known)

    def at(self, name: str, scale: Scale) -> bool:
        """Whether what has that name belongs to the scale."""
        return scale in self.only_at.get(name, SCALES)


def list_experiments() -> list[str]:
    """Names of the experiments that come with InfraBlend, sorted."""
    folder = resources.files("infrablend.config") / "experiments"
    return sorted(p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml"))


def load_experiment(experiment: str | Path) -> Experiment:
    """The experiment of that shipped name, or in that YAML file.

    Raises:
        RecipeError: With every unknown key and bad value at once.
    """
    path = Path(experiment)
    folder: Path | None = None
    if path.suffix.lower() in {".yaml", ".yml"} or path.parent != Path():
        folder = path.resolve().parent
        try:
            text = path.read_text("utf-8")
        except (OSError, ValueError) as error:
            raise RecipeError(
                f"experiment {path}: cannot be read ({error}); expected a YAML text file. "
                f"Shipped experiments are {', '.join(list_experiments())}."
            ) from error
    elif str(experiment) in list_experiments():
        text = (resources.files("infrablend.config") / "experiments" / f"{experiment}.yaml").read_text("utf-8")
    else:
        raise RecipeError(
            f"experiment {str(experiment)!r}: neither a shipped experiment nor a YAML file that exists; "
            f"shipped are {', '.join(list_experiments())}. "
            f"{did_you_mean(str(experiment), list_experiments()) or 'Give one of these or the path of a .yaml file.'}"
        )
    return parse_experiment(text, str(experiment), folder)


def parse_experiment(text: str, where: str, folder: Path | None = None) -> Experiment:
    """The experiment in a YAML text; `where` names it in errors, `folder` is what paths of recipes are relative to."""
    try:
        data = read_yaml(text)
    except ValueError as error:
        raise RecipeError(
            f"experiment {where}: {error}. Correct the file; docs/how_to/experiments.md explains it."
        ) from error
    if not isinstance(data, dict):
        raise RecipeError(f"experiment {where}: found {type(data).__name__}, expected a mapping of fields")
    if folder is not None:
        _resolve_recipes(data, folder)
    problems: list[Problem] = []
    try:
        return Experiment.model_validate_json(json.dumps(data))
    except ValidationError as error:
        problems += field_problems(
            error, data, Experiment, "experiment", "see docs/how_to/experiments.md for all fields"
        )
    except (TypeError, ValueError) as error:
        problems.append(Problem(where, "experiment-value", str(error), "plain numbers, texts, lists and mappings"))
    raise RecipeError(f"experiment {where}: {len(problems)} field(s) are wrong", sorted(set(problems)))


def _resolve_recipes(data: dict[str, Any], folder: Path) -> None:
    items = data.get("data")
    for item in items.values() if isinstance(items, Mapping) else ():
        recipe = item.get("recipe") if isinstance(item, dict) else None
        if isinstance(recipe, str) and re.search(r"\.ya?ml$", recipe, re.IGNORECASE):
            item["recipe"] = str((folder / recipe).resolve())
