"""How a run differs from the paper: data, renderer, trainings, boxes and scale, one line each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from infrablend.annotation.looseness import looseness_text
from infrablend.core.dataset import SPLITS
from infrablend.report.results.text import duration


def list_differences(facts: Mapping[str, Any]) -> list[str]:
    """Return the differences from the paper, one line each."""
    return [*_sources(facts), *_trainings(facts), *_boxes(facts), *_scale(facts)]


def _sources(facts: Mapping[str, Any]) -> Iterator[str]:
    for s in facts["sources"].values():
        paper, ours, whole = s["paper_images"], s["images"], s["whole"]
        if s["stand_in"]:
            yield f"**{s['title']} was not given: a rendered virtual world stands in for it** ({_per_split(ours)})."
            continue
        line = f"{s['title']}: {_per_split(ours)}"
        if ours != whole:
            line += f", a part of the {sum(whole.values()):,} images that were given"
        if paper and paper != ours:
            line += f"; paper {_per_split(paper)}"
        yield line + (", as in the paper." if paper and paper == ours else ".")
    if facts["renderer"] != "blender":
        yield f"Objects are drawn by the renderer `{facts['renderer']}` as flat shapes: this is a test run."


def _trainings(facts: Mapping[str, Any]) -> Iterator[str]:
    alike: dict[str, list[str]] = {}
    for name, t in facts["trainings"].items():
        alike.setdefault(_training(t), []).append(name)
    for text, names in alike.items():
        yield f"Detector {', '.join(names)}: {text}"
    starts = {n: (t.get("start") or {}).get("kind") for n, t in facts["trainings"].items()}
    if len(set(starts.values())) > 1:
        which = ", ".join(f"{n} {kind}" for n, kind in sorted(starts.items()))
        yield f"**The detectors started from different weights, so their differences mean little**: {which}."


def _boxes(facts: Mapping[str, Any]) -> Iterator[str]:
    loosened: dict[str, int] = {}
    for s in facts["stages"]:
        # A later step that only hands the boxes on does not repeat how they were changed.
        if s.get("boxes_loosened") and (text := looseness_text(s)):
            loosened[text] = loosened.get(text, 0) + s["boxes_loosened"]
    for text, n in sorted(loosened.items()):
        yield (
            f"The training boxes of {n:,} inserted objects are {text}, to match the boxes drawn by the "
            "source's annotators; masks and images are unchanged."
        )


def _scale(facts: Mapping[str, Any]) -> Iterator[str]:
    if not facts["trainings"]:
        return
    yield (
        "Paper: YOLOv8s, learning rate 0.002, batch 64, 640 px, at most 1000 epochs, patience 100; optimizer and "
        "start weights are not stated."
    )
    if facts["scale"] == "smoke":
        yield "Scale `smoke`: a few training steps, to test that everything runs; the detectors' figures mean nothing."
    elif facts["scale"] != "paper":
        yield f"Scale `{facts['scale']}`: compare these figures with each other, not with the paper's."


def _training(record: Mapping[str, Any]) -> str:
    """Return a training in one line: images, network, length, start and time."""
    settings, prepared, start = record.get("settings") or {}, record.get("prepared") or {}, record["start"]
    parts = []
    if pictures := prepared.get("pictures"):
        of_paper = f" (paper: {record['paper_images']:,} for training)" if record.get("paper_images") else ""
        parts.append(f"images {_per_split(pictures)}{of_paper}")
    if settings.get("model"):
        parts.append(settings["model"])
    if settings.get("tile"):
        count = (prepared.get("tiles") or {}).get("tiles")
        parts.append(f"{'' if count is None else f'{count:,} '}tiles of {settings['tile']} px at native resolution")
    if settings.get("image_size"):
        parts.append(f"{settings['image_size']} px")
    if record.get("batch"):
        parts.append(f"batch {record['batch']}")
    if record.get("passes"):
        parts.append(f"{record['passes']:,} images shown in {record.get('epochs_done', '?')} epochs")
    if record.get("seed"):
        parts.append(f"seed {record['seed']}")
    if start:
        parts.append("from scratch" if start.get("kind") == "scratch" else f"from {start.get('model')}")
        parts[-1] += f" ({start['why']})" if start.get("why") else ""
    parts += [str(record[k]) for k in ("precision", "note") if record.get(k)]
    if record.get("seconds"):
        parts.append(f"trained in {duration(record['seconds'])}")
    if record.get("adopted"):
        parts.append("trained by a separate command and adopted: settings, seed, image and label counts match")
    return "; ".join(parts) + "."


def _per_split(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{s} {counts[s]:,}" for s in SPLITS if s in counts)
