"""Writes the dataset card of a run from its plan and counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from infrablend.annotation.looseness import Looseness, loosened_text
from infrablend.annotation.merge_labels import RemovalReason
from infrablend.core.dataset import ImageRecord
from infrablend.core.ledger import LEDGER
from infrablend.core.run_folder import EIGHT_BIT, IMAGES, RUN_FILE, TRACKS, VIDEO
from infrablend.errors import Problem
from infrablend.formats.pictures.temperature_scale import describe_scales
from infrablend.pipeline.datasets.origin import invalid_texts, origin_of, renamed_texts, run_inserts
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.scenes import scenes_fact
from infrablend.report.card import Card

REMOVAL_TEXTS: Mapping[RemovalReason, str] = {
    "covered": "original labels were removed because inserted objects cover them; `run.json` lists them",
    "category": "original labels were left out because the recipe does not keep their class",
    "labels": "labels were left out because the recipe asks for only the new or only the original ones",
}


def run_card(
    plan: RunPlan,
    counts: Mapping[str, Any],
    losses: Mapping[str, int],
    images: Sequence[ImageRecord],
    warnings: Sequence[Problem] = (),
) -> Card:
    """Return the card of a finished run, with counts and losses as in its record, and warnings as known failures."""
    recipe = plan.recipe
    classes = ", ".join(dict.fromkeys(o.category or plan.models[o.model].category for o in recipe.objects))
    source = origin_of(plan.dataset, images, recipe.labels.rename, counts["labels_inserted"])
    short = source.title.partition(":")[0] or "a thermal aerial dataset"
    return Card(
        name=recipe.name,
        summary=f"Thermal aerial pictures of {short} with rendered objects ({classes}) and "
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
            *scenes_fact(plan.request),
            ("seed", str(plan.seed)),
            *((name, counts[name]) for name in ("weather",) if name in counts),
            ("all settings, versions and counts", f"`{RUN_FILE}`; `infrablend rerender` renders a single frame again"),
        ),
        inserts=(*source.inserts, run_inserts(recipe, plan.seed, counts["labels_inserted"])),
        masks=any(i.mask is not None for image in images for i in image.instances),
        failures=tuple(f"{' '.join(p.found.split())} (`{p.code}`)." for p in warnings if p.severity == "warning"),
        load=IMAGES,
    )


def _changes(plan: RunPlan, counts: Mapping[str, Any]) -> list[str]:
    """Return the changes to the backgrounds and their labels, with counts."""
    output = plan.recipe.output
    labels = plan.recipe.labels
    originals = sum(f.configuration is None for f in plan.frames)
    inserted = ", ".join(f"{n} {name}" for name, n in counts["labels_inserted"].items())
    total = sum(counts["labels_inserted"].values())
    texts = [
        f"{counts['images']} pictures were made from {len(plan.dataset.images)} backgrounds; they contain {total} "
        f"rendered objects with labels{f' ({inserted})' if inserted else ''}."
    ]
    if originals:
        texts.append("The pictures include the unchanged backgrounds as well as those with inserted objects.")
    if empty := counts["frames_without_object"]:
        texts.append(f"{empty} pictures show no labelled inserted object.")
    if counts["images"] < len(plan.frames):
        texts.append(f"{len(plan.frames) - counts['images']} planned pictures failed; `run.json` gives the reasons.")
    if output.image == "png":
        texts.append("Pictures are lossless PNG files: outside the objects and their blur every pixel keeps its value.")
    else:
        texts.append(
            "Pictures with objects were decoded and encoded again in the source's own file type; JPEG with the "
            "source's own tables, which may change grey levels slightly everywhere."
        )
    for scale, n in describe_scales(plan.dataset).items():
        texts.append(f"Levels of 16-bit pictures of {n} backgrounds are temperatures, or counts: {scale}.")
    if plan.recipe.matching.needs_temperatures:
        texts.append(
            "Objects were inserted by their apparent temperatures at the sensor, in the backgrounds' own unit, without "
            "gain or clipping."
        )
    if output.agc is not None:
        texts.append(f"`{EIGHT_BIT}/` has the same dataset in 8-bit pictures: {output.agc.describe()}.")
    texts += [f"{n} {REMOVAL_TEXTS.get(reason, reason)}." for reason, n in counts["labels_removed"].items()]
    if covered := counts.get("labels_partly_covered"):
        texts.append(f"{covered} original labels are partly covered by inserted objects and kept.")
    if unlabelled := sum(counts["objects_without_label"].values()):
        texts.append(f"{unlabelled} inserted objects have no label because they are too small or hidden: `run.json`.")
    if loosened := counts.get("boxes_loosened"):
        texts.append(loosened_text(loosened, Looseness.of_labels(labels)))
    texts += [plan.boxes] if plan.boxes else []
    texts += renamed_texts(labels.rename) + invalid_texts(plan.problems, RUN_FILE)
    if excluded := plan.dataset.notes.get("excluded"):
        found = ", ".join(f"{name} ({e['images']} pictures, {e['why']})" for name, e in excluded.items())
        texts.append(f"Sequences of the source that were left out: {found}.")
    return texts


def _layout(plan: RunPlan) -> tuple[tuple[str, str], ...]:
    groups = "".join(f"<{g}>/" for g in plan.recipe.output.group_by)
    rows = [(f"{IMAGES}/<split>/{groups}", "pictures"), (f"{IMAGES}/<split>/metadata.jsonl", "labels beside them")]
    rows += [(f"{name}/", "labels") for name in plan.recipe.output.formats]
    if plan.recipe.output.agc is not None:
        rows.append((f"{EIGHT_BIT}/", "the same dataset with 8-bit pictures: `images/`, and labels per format"))
    if plan.recipe.in_sequences:
        rows.append((f"{TRACKS}/<split>/", "tracks of each sequence, as MOTChallenge and TrackEval have them"))
        rows.append((f"{VIDEO}/<split>/", "each sequence as a video, to look at; not lossless"))
    return (
        *rows,
        (LEDGER, "scene and labels of each picture; `infrablend show` prints them"),
        (RUN_FILE, "record of the run"),
    )
