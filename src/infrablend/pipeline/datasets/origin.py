"""Where a dataset's pictures come from: the objects that earlier runs inserted, and which of their labels remain."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from infrablend.annotation.looseness import LOOSENED, is_loosened
from infrablend.assets.user_model import is_description
from infrablend.config.modes import recipe_from_json
from infrablend.config.recipe import Recipe
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.files import load_json
from infrablend.core.run_folder import EIGHT_BIT, RUN_FILE
from infrablend.core.workspace import CONVERT_FILE, SPLIT_FILE
from infrablend.errors import Problem
from infrablend.report.card import INSERT_LIMITS, Inserts, Provenance, find_provenance

AT_MOST = f"{LOOSENED}_at_most"
"""Name of the count of changed boxes in records where only the largest possible number is known."""

_PLACED = {
    "paper": "Inserted objects were placed by a virtual camera, not in a measured scene: they may appear in front of, "
    "above or on anything.",
    "metric": "Inserted objects were placed over a flat ground, with the camera's height and lens taken from the "
    "recipe and the metadata: some stand where no such object could be, and unless the recipe sets `occlusion`, "
    "nothing in the picture hides them.",
}
_LOOKED: Mapping[str, tuple[str, ...]] = {
    "artistic": (
        "The look of inserted objects is hand-tuned (the paper's artistic shader): their grey levels do not correspond "
        "to temperatures.",
    ),
    "physical": (),
}


def origin_of(
    source: Dataset, images: Sequence[ImageRecord], rename: Mapping[str, str], new: Mapping[str, int] | None = None
) -> Provenance:
    """Return the origin of pictures written from `source`; its inserts count the labels that were written.

    Args:
        source: Dataset as read.
        images: Images written, with their labels.
        rename: New names of classes, by old name.
        new: Labels in `images` that this run inserted, by category; they belong to no earlier run.
    """
    origin = find_provenance(source)
    inserts = origin.inserts
    marked = any(o.inserted for i in source.images for o in i.instances)
    before, after = _count(source.images, marked), _count(images, marked)
    after.subtract(new or {})
    return replace(origin, inserts=_count_written(inserts, before, after, rename, marked))


def run_inserts(recipe: Recipe, seed: int, labels: Mapping[str, int]) -> Inserts:
    """Return the description of the objects that a run inserted; `labels` counts theirs by category."""
    limits = [*INSERT_LIMITS, _PLACED[recipe.placement.mode], *_LOOKED[recipe.appearance.mode]]
    if recipe.camera.pitch != "metadata":
        limits.append("Inserted objects are not seen from each picture's own camera pitch: the recipe sets another.")
    return Inserts(recipe.name, seed, recipe_yaml(recipe), dict(labels), tuple(limits))


def renamed_texts(rename: Mapping[str, str]) -> list[str]:
    """Return what a card says about renamed classes, if there are any."""
    found = ", ".join(f"{a} to {b}" for a, b in rename.items())
    return [f"Classes were renamed: {found}."] if rename else []


def invalid_texts(problems: Iterable[Problem], record: str) -> list[str]:
    """Return what a card says about invalid parts of the source, if there are any; `record` lists them."""
    left_out = Counter(p.code for p in problems if p.severity == "error")
    found = ", ".join(f"{n} x {code}" for code, n in sorted(left_out.items()))
    return [f"Invalid parts of the source were left out: {found}; `{record}` lists them."] if left_out else []


def recipe_yaml(recipe: Recipe) -> str:
    """Return the settings that differ from the defaults, as YAML; user models appear without their local folder."""
    # Mappings by name in one order, whether the recipe was read from its file or from a run's record.
    ordered = recipe_from_json(json.dumps(json.loads(recipe.model_dump_json()), sort_keys=True))
    data = json.loads(ordered.model_dump_json(exclude_defaults=True))
    for o in data["objects"]:
        if is_description(o["model"]):
            o["model"] = Path(o["model"]).name
    text: str = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    return text


def _count(images: Iterable[ImageRecord], marked: bool) -> Counter[str]:
    return Counter(o.category for i in images for o in i.instances if o.inserted or not marked)


def _count_written(
    inserts: Sequence[Inserts], before: Counter[str], after: Counter[str], rename: Mapping[str, str], marked: bool
) -> tuple[Inserts, ...]:
    """Return the inserts with the labels that were written; a class whose number cannot be known is left out.

    Args:
        inserts: Inserts as recorded for the source.
        before: Labels of the source by category: those marked as inserted, or all if the format holds no mark.
        after: The same of the labels written.
        rename: New names of classes, by old name.
        marked: True if the labels that are counted are marked as inserted.
    """
    recorded = [Counter[str]() for _ in inserts]
    for one, counts in zip(inserts, recorded, strict=True):
        for name, n in one.labels.items():
            counts[rename.get(name, name)] += n
    if marked and len(inserts) == 1:
        return (replace(inserts[0], labels=dict(sorted((+after).items()))),)
    read = Counter[str]()
    for name, n in before.items():
        read[rename.get(name, name)] += n
    written: list[dict[str, int]] = [{} for _ in inserts]
    for name in sorted({name for counts in recorded for name in counts}):
        total = sum(counts[name] for counts in recorded)
        owners = [k for k, counts in enumerate(recorded) if counts[name]]
        if len(owners) == 1 and read[name] == total and after[name] > 0:  # all labels of the class are of one run
            written[owners[0]][name] = after[name]
        elif read[name] == after[name] and read[name] >= total:  # nothing of the class was left out
            for k in owners:
                written[k][name] = recorded[k][name]
    return tuple(replace(one, labels=labels) for one, labels in zip(inserts, written, strict=True))


def loosened_before(dataset: Dataset, part: Dataset) -> dict[str, int]:
    """Return how many boxes of a part were enlarged or fitted by earlier steps, by its name in records; {} for none.

    COCO and shards mark such boxes. In other formats the record of the dataset's command has their number, but does
    not say which ones they are: any box of a part may be one, and the count is `AT_MOST`.
    """
    if count_loosened(dataset):
        name = LOOSENED
        count = count_loosened(part)
    else:
        recorded, labels = _recorded(dataset)
        whole, boxes = (sum(len(i.instances) for i in d.images) for d in (dataset, part))
        name = LOOSENED
        count = recorded
        if not boxes == labels == whole:
            # Pictures may have been drawn several times.
            copies = max(Counter(i.path for i in part.images).values(), default=1)
            name = AT_MOST
            count = min(copies * recorded, boxes)
    return {name: count} if count else {}


def count_loosened(dataset: Dataset) -> int:
    """Return how many boxes are marked as changed, and so have their exact box beside them."""
    return sum(is_loosened(i) for image in dataset.images for i in image.instances)


def _recorded(dataset: Dataset) -> tuple[int, int | None]:
    """Return the number of changed boxes in the record of the dataset's command, and that of labels if it is exact."""
    root = dataset.root
    run = root.parent.parent if root.parent.name == EIGHT_BIT else root.parent
    for record in (root / CONVERT_FILE, root / SPLIT_FILE, root / RUN_FILE, run / RUN_FILE):
        try:
            counts = load_json(record)["counts"]
            if AT_MOST in counts:
                return int(counts[AT_MOST]), None
            loosened = int(counts[LOOSENED])
            labels = counts.get("labels")
            return loosened, sum(map(int, labels.values())) if isinstance(labels, Mapping) else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
    return 0, None
