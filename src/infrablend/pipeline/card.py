"""The dataset card of a run: what its plan and its counts say, put into words."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from infrablend.annotation.merge import RemovalReason
from infrablend.assets.user_model import is_description
from infrablend.core.dataset import ImageRecord
from infrablend.pipeline.folder import RUN_FILE
from infrablend.pipeline.plan import RunPlan
from infrablend.report.card import Card, find_provenance

_REMOVED: Mapping[RemovalReason, str] = {
    "covered": "original labels were removed because inserted objects cover them; `run.json` lists them",
    "category": "original labels were left out because the recipe does not keep their class",
    "dont_care": "regions to ignore were left out",
    "labels": "labels were left out because the recipe asked for new or for original labels alone",
}
_LIMITS = (
    "Inserted objects are rendered: scores on them say how well a detector finds such renders, and more only after a "
    "test on real pictures of that class.",
    "Several frames may show the same background. They are in the background's split; keep them together if you split "
    "anew.",
)
_PLACED = {
    "paper": "Inserted objects were placed by a virtual camera, not in a measured scene: they may lie before, above or "
    "on anything.",
    "metric": "Inserted objects were placed over a flat ground, with height and lens of the camera as the recipe and "
    "the metadata say: what stands may stand where no such thing can be, and nothing of the picture hides any of them.",
}
_NOT_RADIOMETRIC = (
    "The look of inserted objects is hand-tuned (the paper's artistic shader): their grey levels are no temperatures."
)


def run_card(
    plan: RunPlan, counts: Mapping[str, Any], losses: Mapping[str, int], images: Sequence[ImageRecord]
) -> Card:
    """The card of a finished run; `counts` and `losses` are those of its record, `images` what was written."""
    recipe = plan.recipe
    classes = ", ".join(dict.fromkeys(o.category or plan.models[o.model].category for o in recipe.objects))
    source = find_provenance(plan.dataset)
    short = source.title.partition(":")[0] or "a thermal aerial dataset"
    limits = [*_LIMITS, _PLACED[recipe.placement.mode]]
    if recipe.appearance.mode == "artistic":
        limits.append(_NOT_RADIOMETRIC)
    if recipe.camera.pitch != "metadata":
        limits.append("Inserted objects were not seen from each picture's own camera pitch: the recipe set another.")
    return Card(
        name=recipe.name,
        summary=f"Thermal aerial pictures of {short} with rendered objects in them ({classes}) and "
        + {"merged": "their labels, merged with the original ones.", "new": "their labels alone."}.get(
            recipe.labels.mode, "the original labels alone."
        ),
        source=source,
        changes=tuple(_changes(plan, counts)),
        categories=plan.categories,
        images_per_split=counts["images_per_split"],
        labels_per_split=counts["labels_per_split"],
        inserted=counts["labels_inserted"],
        formats=tuple(recipe.output.formats),
        losses=losses,
        layout=_layout(plan),
        made=(
            ("recipe", f"`{recipe.name}`" + (f", {recipe.description}" if recipe.description else "")),
            ("seed", str(plan.seed)),
            ("all settings, versions and counts", f"`{RUN_FILE}`; one frame again: `infrablend rerender`"),
        ),
        recipe=_recipe_yaml(plan),
        masks=any(i.mask is not None for image in images for i in image.instances),
        limits=tuple(limits),
    )


def _changes(plan: RunPlan, counts: Mapping[str, Any]) -> list[str]:
    """What was done to the backgrounds and their labels, counted."""
    output, labels = plan.recipe.output, plan.recipe.labels
    originals = sum(f.configuration is None for f in plan.frames)
    inserted = ", ".join(f"{n} {name}" for name, n in counts["labels_inserted"].items())
    total = sum(counts["labels_inserted"].values())
    texts = [
        f"{counts['images']} pictures were made from {len(plan.dataset.images)} backgrounds; {total} rendered objects "
        f"with labels are in them{f' ({inserted})' if inserted else ''}."
    ]
    if originals:
        texts.append("The unchanged backgrounds are among the pictures, beside those with objects.")
    if empty := counts["frames_without_object"]:
        texts.append(f"{empty} pictures show no labelled inserted object.")
    if counts["images"] < len(plan.frames):
        texts.append(f"{len(plan.frames) - counts['images']} planned pictures could not be made; `run.json` says why.")
    if output.image == "png":
        texts.append("Pictures are PNG, lossless: outside the objects' reach every pixel keeps its value.")
    else:
        texts.append(
            "Pictures with objects were decoded and encoded again in the source's own file type; JPEG with the "
            "source's own tables, which may change grey levels a little everywhere."
        )
    texts += [f"{n} {_REMOVED.get(reason, reason)}." for reason, n in counts["labels_removed"].items()]
    if covered := counts.get("labels_partly_covered"):
        texts.append(f"{covered} original labels are partly covered by inserted objects and kept.")
    if unlabelled := sum(counts["objects_without_label"].values()):
        texts.append(f"{unlabelled} inserted objects have no label: too small or hidden, see `run.json`.")
    if labels.rename:
        texts.append("Classes were renamed: " + ", ".join(f"{a} to {b}" for a, b in labels.rename.items()) + ".")
    left_out = Counter(p.code for p in plan.problems if p.severity == "error")
    if left_out:
        found = ", ".join(f"{n} x {code}" for code, n in sorted(left_out.items()))
        texts.append(f"Left out of the source because something was wrong with it: {found}; `run.json` lists all.")
    if excluded := plan.dataset.notes.get("excluded"):
        found = ", ".join(f"{name} ({e['images']} pictures, {e['why']})" for name, e in excluded.items())
        texts.append(f"Sequences of the source left out: {found}.")
    return texts


def _layout(plan: RunPlan) -> tuple[tuple[str, str], ...]:
    groups = "".join(f"<{g}>/" for g in plan.recipe.output.group_by)
    rows = [(f"images/<split>/{groups}", "pictures")]
    rows += [(f"{name}/", "labels") for name in plan.recipe.output.formats]
    return (*rows, ("scenes/<split>/", "one JSON per picture: its scene and labels"), (RUN_FILE, "record of the run"))


def _recipe_yaml(plan: RunPlan) -> str:
    """What the recipe sets; of an own model its file name only, since its folder is this machine's."""
    data = json.loads(plan.recipe.model_dump_json(exclude_defaults=True))
    for o in data["objects"]:
        if is_description(o["model"]):
            o["model"] = Path(o["model"]).name
    text: str = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    return text
