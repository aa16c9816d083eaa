"""Writes the report of a run, `report.html`, from the records that the run wrote anyway."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.files import write_bytes
from infrablend.core.frame_record import FrameRecord
from infrablend.core.run_folder import IMAGES, RunFolder
from infrablend.core.typed_command import run_command
from infrablend.errors import Problem
from infrablend.pipeline.datasets.origin import recipe_yaml
from infrablend.pipeline.runs.recorded import recorded_recipe
from infrablend.pipeline.runs.warnings import warning_codes
from infrablend.report.run.run_facts import Box, FrameFacts, InsertFacts, RemovedLabel, RunFacts
from infrablend.report.run.run_page import run_page


def report_run(run: Path) -> Path:
    """Write the report of a finished run again, and return its path.

    Raises:
        OutputError: The folder is not a finished run, or cannot be written.
    """
    folder = RunFolder(run)
    with folder.ledger() as ledger:
        return write_report(folder, ledger.read_run(), ledger.records(), ledger.excluded())


def write_report(
    layout: RunFolder, record: Mapping[str, Any], frames: Iterable[FrameRecord], excluded: Mapping[str, str]
) -> Path:
    """Write the report of a run and return its path; one of the records of `frames` is in memory at a time."""
    facts = sorted((_frame_facts(r) for r in frames), key=lambda f: f.frame_id)
    page = run_page(_run_facts(layout.root, record, facts, excluded))
    # Names from the data may hold what UTF-8 cannot.
    return write_bytes(layout.report_file, page.encode("utf-8", "replace"))


def _run_facts(
    root: Path, record: Mapping[str, Any], frames: list[FrameFacts], excluded: Mapping[str, str]
) -> RunFacts:
    recipe = dict(record["recipe"])
    data = record.get("data", {})
    return RunFacts(
        root=root,
        recipe=str(recipe.get("name", "")),
        description=str(recipe.get("description") or ""),
        settings=recipe_yaml(recorded_recipe(record)),
        command=shlex.join(run_command(record, "recipe.yaml", "DATA", "RUN")),  # of no machine
        version=str(record["infrablend"]),
        made=(
            ("backgrounds", f"{data.get('backgrounds', 0)} pictures, format {data.get('format', 'unknown')}"),
            ("seed", str(record.get("seed", ""))),
            ("label formats", ", ".join(record.get("formats", ()))),
        ),
        counts=record.get("counts", {}),
        problems=[Problem(**p) for p in record.get("problems", ())],
        excluded=excluded,
        timing=record.get("timing", {}),
        machine=record.get("machine", {}),
        frames=frames,
    )


def _frame_facts(record: FrameRecord) -> FrameFacts:
    background = record.background
    scene = record.scene
    pitch = background.get("pitch_deg") if scene is None else round(math.degrees(scene.camera.pitch_rad), 6)
    width, height = background["size_wh"]
    dropped = [str(d["reason"]) for d in record.facts.get("drops", ())]
    if scene is not None:
        dropped += [reason for reason, n in scene.draws.get("absent", {}).items() for _ in range(int(n))]
    view = None if scene is None else scene.view
    # The height that the picture was made with, if its camera is the real one.
    altitude = background.get("altitude_m") if view is None else round(view.stated_height_m, 1)
    path = str(background.get("path", ""))
    split = record.frame_id.partition("/")[0]
    names = {str(background.get("id", "")), path, Path(path).name, f"{split}/{Path(path).name}"}
    return FrameFacts(
        frame_id=record.frame_id,
        image=f"{IMAGES}/{record.image}",
        size_wh=(int(width), int(height)),
        background=frozenset(n for n in names if n),
        time_of_day=background.get("time_of_day"),
        time_from=background.get("time_from"),
        pitch_deg=None if pitch is None else float(pitch),
        altitude_m=altitude,
        inserts=_insert_facts(record),
        removed=tuple(
            RemovedLabel(
                str(r["category"]),
                str(r["reason"]),
                float(r["covered_share"]),
                bool(r.get("inserted")),
                _box(r["box_xyxy"]) if "box_xyxy" in r else None,
            )
            for r in record.removed
        ),
        dropped=tuple(sorted(dropped)),
        warnings=frozenset(warning_codes(record)),
    )


def _box(values: Iterable[Any]) -> Box:
    x0, y0, x1, y1 = (float(v) for v in values)
    return x0, y0, x1, y1


def _insert_facts(record: FrameRecord) -> tuple[InsertFacts, ...]:
    place = () if record.scene is None else (record.background.get("sequence"), record.scene.configuration)
    measured = {c.get("object"): c for c in record.facts.get("contrast", ())}
    found = []
    for i in record.inserted:
        number = i.extra.get("object")
        distance = None
        change = None
        if record.scene is not None and isinstance(number, int) and number < len(record.scene.objects):
            away = np.asarray(record.scene.objects[number].position_m) - record.scene.camera.position_m
            distance = float(np.linalg.norm(away))
        if (c := measured.get(number)) is not None:
            change = min(float(c["changed"]), float(c.get("change", c["changed"])))
        signed = i.extra.get("contrast_grey")
        found.append(
            InsertFacts(i.category, _box(i.box_xyxy), distance, change,
                        None if signed is None else float(signed), i.visibility,
                        "" if i.track_id is None else "{} c{} {}".format(*place, i.track_id))
        )  # fmt: skip
    return tuple(found)
