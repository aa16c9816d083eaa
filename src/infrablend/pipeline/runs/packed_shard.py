"""Finished shards as three files: a tar, a table and a record, which is their marker and appears last.

As for any shard, the frames are made in a workspace named after the shard; they are then packed.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from infrablend.annotation.looseness import Looseness
from infrablend.core.files import flush, read_object, read_regular, replace_atomically, sha256_of, write_json
from infrablend.core.frame_record import FrameRecord
from infrablend.core.frame_row import FrameRow
from infrablend.core.ledger import Ledger
from infrablend.core.run_folder import RunFolder, ShardFiles
from infrablend.core.tasks import Failure, OnProgress
from infrablend.core.workspace import Existing, Workspace
from infrablend.errors import OutputError
from infrablend.formats.labels.shard_tar import LABEL, SCENE, TarWriter, key_of, label_text
from infrablend.formats.labels.shards import SOURCE
from infrablend.pipeline.compose.composed import labelled_image
from infrablend.pipeline.datasets.origin import run_inserts
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.runs.key import require_same_key
from infrablend.pipeline.runs.run import RunReport, run_plan
from infrablend.pipeline.runs.shard_table import TableWriter, require_pyarrow
from infrablend.report.card import find_provenance, shard_source

log = logging.getLogger(__name__)

ARCHIVE = "archive"
"""Field of the record of a packed shard with sizes and digests of its tar and its table."""
UNFINISHED = "unfinished"
"""Field of the record of a packed shard with the reason of each frame without a picture."""

PackedFrames = Iterable[tuple[PlannedFrame, str, bytes]]
"""Frames with their records, see `FrameRecord.to_text`, and picture files."""


def run_packed(
    plan: RunPlan,
    files: ShardFiles,
    execution: Execution,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> RunReport:
    """Render the frames of a shard, and pack them; `resume` leaves a shard that is whole as it is.

    Raises:
        MissingDependencyError: pyarrow is not installed.
        OutputError, OtherSettingsError, Interrupted, RenderError: See `run_plan`.
    """
    if (whole := find_whole(plan, files, existing)) is not None:
        return whole
    counts: Mapping[str, Any] = {}

    def pack_up(space: Workspace, record: Mapping[str, Any]) -> None:
        nonlocal counts
        packed = ShardFiles(space.folder, files.name)
        with Ledger.open(space.folder) as ledger:
            frames = _frames_of(plan, RunFolder(space.folder), ledger)
            counts = pack(plan, frames, packed, record, ledger.failures())
        publish(packed, files)
        space.discard()

    report = run_plan(plan, files.folder / files.name, execution, existing, on_progress, finish=pack_up)
    return replace(report, out=files.folder, record_file=files.marker, counts=counts)


def find_whole(plan: RunPlan, files: ShardFiles, existing: Existing) -> RunReport | None:
    """Return the report of a packed shard that need not be made; None if it has to be.

    Raises:
        MissingDependencyError: pyarrow is not installed.
        OutputError: There is one, and `existing` forbids to replace it.
        OtherSettingsError: The shard to resume is of another run.
    """
    require_pyarrow()
    if not os.path.lexists(files.marker) or existing == "overwrite":
        return None
    if existing == "refuse":
        raise OutputError(
            f"{files.marker}: exists already; expected no such shard. Use --resume to make it only if it is not whole, "
            "or --overwrite to replace it."
        )
    record = read_object(files.marker) or {}
    if plan.shard is not None and record.get("shard") != str(plan.shard):
        found: str | None = f"it is the record of shard {record.get('shard')}, expected {plan.shard}"
    elif (found := damage_of(files, record)) is None:
        require_same_key(record, plan, files.marker)
        if record["counts"]["frames"] == len(plan.frames):
            return RunReport.of_record(record, files.folder, files.marker)
        found = "some of its frames failed"
    log.warning("%s: %s; the shard is made again", files.marker, found)
    return None


def _frames_of(plan: RunPlan, folder: RunFolder, ledger: Ledger) -> Iterator[tuple[PlannedFrame, str, bytes]]:
    done = ledger.done()
    for frame in plan.frames:
        if (row := done.get(frame.frame_id)) is None:
            continue  # failed; the record of the shard has the reason
        picture = read_regular(folder.image(row.image), folder.root)
        if _sha256(picture) != row.sha256:
            raise OutputError(
                f"frame {frame.frame_id}: its picture was changed while the shard was packed; repeat the command with "
                "--resume"
            )
        yield frame, ledger.record_text(frame.frame_id), picture


def pack(
    plan: RunPlan, frames: PackedFrames, files: ShardFiles, record: Mapping[str, Any], failures: Mapping[str, Failure]
) -> Mapping[str, Any]:
    """Write tar, table and record of these frames, one in memory at a time; return the counts.

    Args:
        plan: Plan of the shard.
        frames: Its finished frames, in the order of the plan.
        files: Files to write.
        record: Record of the run, whose counts are completed.
        failures: Why the other frames have no picture.
    """
    ids = {c.name: c.id for c in plan.categories}
    loosened = 0
    looseness = Looseness.of_labels(plan.recipe.labels)
    with replace_atomically(files.tar, durable=True) as tar_part, replace_atomically(files.table) as table_part:
        with tar_part.open("wb") as stream, TarWriter(stream) as tar, TableWriter(table_part, ids) as table:
            for frame, text, picture in frames:
                known = FrameRecord.from_text(text)
                image, count = labelled_image(frame, known, Path(known.image), looseness)
                loosened += count
                key = key_of(frame.frame_id)
                label = label_text(frame.frame_id, image, ids)
                # As people read it in a tar.
                scene = (json.dumps(json.loads(text), sort_keys=True, indent=1, ensure_ascii=False) + "\n").encode()
                offset = tar.add(key, Path(known.image).suffix[1:], picture)
                tar.add(key, LABEL, label)
                tar.add(key, SCENE, scene)
                facts = {"label_sha256": _sha256(label), "scene_sha256": _sha256(scene)}
                table.add(
                    FrameRow.of(known), image, key, {**facts, "image_offset": offset, "image_bytes": len(picture)}
                )
        flush(table_part)
    counts = {**record["counts"], **looseness.counted(loosened)}
    groups = {c.name: c.supercategory for c in plan.categories}  # for readers, who have no other file with them
    marker = {
        **record,
        "counts": counts,
        # Labels of inserted objects are counted when shards are read: there may be more of the same run.
        SOURCE: shard_source(find_provenance(plan.dataset), run_inserts(plan.recipe, plan.seed, {})),
        ARCHIVE: {"tar": _facts(files.tar), "table": _facts(files.table)},
        UNFINISHED: {frame: failure.to_json() for frame, failure in sorted(failures.items())},
        "categories": [{**c, "supercategory": groups[c["name"]]} for c in record["categories"]],
    }
    write_json(files.marker, marker, indent=2, durable=True)
    return counts


def publish(packed: ShardFiles, target: ShardFiles) -> None:
    """Move the files of a packed shard to where others see them: the marker last, and that of earlier ones first."""
    target.marker.unlink(missing_ok=True)
    for source, place in ((packed.tar, target.tar), (packed.table, target.table)):
        source.replace(place)
    flush(target.folder)
    packed.marker.replace(target.marker)
    flush(target.folder)


def damage_of(files: ShardFiles, record: Mapping[str, Any], *, digests: bool = True) -> str | None:
    """Return what is wrong with the tar or the table of a finished shard; None if both are as they were written.

    Args:
        files: Files of the shard.
        record: Its record.
        digests: Whether to read the files; otherwise only their sizes are compared.
    """
    for path, name in ((files.tar, "tar"), (files.table, "table")):
        try:
            facts = record[ARCHIVE][name]
            if not path.is_file():
                return f"{path.name} is missing"
            if (size := path.stat().st_size) != facts["bytes"]:
                return f"{path.name} has {size} bytes, expected {facts['bytes']}"
            if digests and sha256_of(path, files.folder) != facts["sha256"]:
                return f"{path.name} was changed after it was written"
        except OSError as error:
            return f"{path.name} cannot be read ({error.strerror or error})"
        except (LookupError, TypeError):
            return f"{files.marker.name} is damaged: no facts about the {name}"
    return None


def _facts(path: Path) -> dict[str, Any]:
    return {"bytes": path.stat().st_size, "sha256": sha256_of(path)}


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
