"""Packed shards: the frames of a shard as a tar and a table, with a record that has the sizes and digests of both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from infrablend.annotation.looseness import Looseness
from infrablend.core.files import flush, read_regular, replace_atomically, sha256_of, write_json
from infrablend.core.frame_record import FrameRecord
from infrablend.core.frame_row import FrameRow
from infrablend.core.ledger import Ledger
from infrablend.core.run_folder import RunFolder, ShardFiles
from infrablend.errors import OutputError
from infrablend.formats.labels.shard_tar import LABEL, SCENE, TarWriter, key_of, label_text
from infrablend.formats.labels.shards import SOURCE
from infrablend.pipeline.compose.composed import labelled_image
from infrablend.pipeline.datasets.origin import run_inserts
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.runs.shard_table import TableWriter
from infrablend.report.card import find_provenance, shard_source

ARCHIVE = "archive"
"""Field of the record of a packed shard with sizes and digests of its tar and its table."""
UNFINISHED = "unfinished"
"""Field of the record of a packed shard with the reason of each frame without a picture."""


def pack(
    plan: RunPlan, folder: RunFolder, ledger: Ledger, files: ShardFiles, record: Mapping[str, Any]
) -> Mapping[str, object]:
    """Write tar, table and record of a shard, one frame in memory at a time; return the counts.

    Args:
        plan: Plan of the shard.
        folder: Folder with its pictures.
        ledger: Ledger with its frames, finished and failed.
        files: Files to write.
        record: Record of the run, whose counts are completed.

    Raises:
        OutputError: A picture was changed, or the files cannot be written.
    """
    ids = {c.name: c.id for c in plan.categories}
    loosened = 0
    looseness = Looseness.of_labels(plan.recipe.labels)
    with replace_atomically(files.tar, durable=True) as tar_part, replace_atomically(files.table) as table_part:
        with tar_part.open("wb") as stream, TarWriter(stream) as tar, TableWriter(table_part, ids) as table:
            for frame, text, picture in _frames_of(plan, folder, ledger):
                known = FrameRecord.from_text(text)
                image, count = labelled_image(frame, known, Path(known.image), looseness)
                loosened += count
                key = key_of(frame.frame_id)
                label = label_text(frame.frame_id, image, ids)
                # As people read it in a tar.
                values = json.loads(text)
                scene = (json.dumps(values, sort_keys=True, indent=1, ensure_ascii=False) + "\n").encode()
                offset = tar.add(key, Path(known.image).suffix[1:], picture)
                tar.add(key, LABEL, label)
                tar.add(key, SCENE, scene)
                facts = {"label_sha256": _sha256(label), "scene_sha256": _sha256(scene)}
                place: dict[str, int | str] = {**facts, "image_offset": offset, "image_bytes": len(picture)}
                table.add(FrameRow.from_json(values), image, key, place)
        flush(table_part)
    counts = {**record["counts"], **looseness.counted(loosened)}
    groups = {c.name: c.supercategory for c in plan.categories}  # for readers, who have no other file with them
    marker = {
        **record,
        "counts": counts,
        # Labels of inserted objects are counted when shards are read: there may be more of the same run.
        SOURCE: shard_source(find_provenance(plan.dataset), run_inserts(plan.recipe, plan.seed, {})),
        ARCHIVE: {"tar": _facts(files.tar), "table": _facts(files.table)},
        UNFINISHED: {frame: failure.to_json() for frame, failure in sorted(ledger.failures().items())},
        "categories": [{**c, "supercategory": groups[c["name"]]} for c in record["categories"]],
    }
    write_json(files.marker, marker, indent=2, durable=True)
    return counts


def _frames_of(plan: RunPlan, folder: RunFolder, ledger: Ledger) -> Iterator[tuple[PlannedFrame, str, bytes]]:
    """Yield the finished frames in the order of the plan, with their records and pictures."""
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


def damage_of(
    files: ShardFiles, record: Mapping[str, Any], *, digests: bool = True, sizes: Mapping[str, int] | None = None
) -> str | None:
    """Return what is wrong with the tar or the table of a finished shard; None if both are as they were written.

    Args:
        files: Files of the shard.
        record: Its record.
        digests: Whether to read the files; otherwise only their sizes are compared.
        sizes: Bytes of the files by name, if they are elsewhere.
    """
    for path, name in ((files.tar, "tar"), (files.table, "table")):
        try:
            facts = record[ARCHIVE][name]
            there = path.is_file() if sizes is None else path.name in sizes
            if not there:
                return f"{path.name} is missing"
            size = path.stat().st_size if sizes is None else sizes[path.name]
            if size != facts["bytes"]:
                return f"{path.name} has {size} bytes, expected {facts['bytes']}"
            if digests and sha256_of(path, files.folder) != facts["sha256"]:
                return f"{path.name} was changed after it was written"
        except OSError as error:
            return f"{path.name} cannot be read ({error.strerror or error})"
        except (LookupError, TypeError):
            return f"{files.marker.name} is damaged: no facts about the {name}"
    return None


def _facts(path: Path) -> dict[str, int | str]:
    return {"bytes": path.stat().st_size, "sha256": sha256_of(path)}


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
