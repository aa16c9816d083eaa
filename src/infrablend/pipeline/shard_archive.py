"""Finished shards as three files: a tar, a table and a record, which is their marker and appears last.

While a shard is made, everything is in a folder of its name beside them: `run/`, and then the three files.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from infrablend.annotation.looseness import Looseness
from infrablend.core.files import (
    flush,
    output_error,
    read_regular,
    replace_atomically,
    sha256_of,
    write_bytes,
    write_json,
)
from infrablend.core.finished import COMPLETE
from infrablend.core.output import Existing, OutputFolder
from infrablend.core.run_layout import ShardFiles
from infrablend.core.tasks import OnProgress
from infrablend.errors import OutputError, Problem
from infrablend.formats.shard_tar import LABEL, SCENE, TarWriter, key_of, label_text, packed_frames
from infrablend.formats.shards import SOURCE
from infrablend.pipeline.folder import ARCHIVE, RunFolder, read_run_file, sealed
from infrablend.pipeline.labelled import labelled_image
from infrablend.pipeline.origin import run_inserts
from infrablend.pipeline.plan import RunPlan
from infrablend.pipeline.record import RecordError, load_record, parse_record
from infrablend.pipeline.request import Execution
from infrablend.pipeline.run import FrameSource, RunReport, require_same_key, run_plan
from infrablend.pipeline.shard_damage import damage_of, number_damage
from infrablend.pipeline.shard_table import TableWriter, require_pyarrow
from infrablend.report.card import find_provenance, shard_source

log = logging.getLogger(__name__)

_RUN, _PACKED_RUN = "run", "packed-run"


def unfinished_run(files: ShardFiles) -> RunFolder:
    """Return the folder with the frames of a shard that is being made."""
    return RunFolder(files.folder / files.name / _RUN, "shard")


def run_archived(
    plan: RunPlan,
    files: ShardFiles,
    execution: Execution,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
    source: FrameSource | None = None,
) -> RunReport:
    """Render the frames of a shard, and pack them.

    Args:
        plan: Plan of the shard.
        files: Files to write.
        execution: Workers, device and renderer.
        existing: What to do if the shard has been started; `resume` leaves a shard that is whole as it is.
        on_progress: Called after each frame.
        source: Where to take finished frames from; None renders them.

    Raises:
        MissingDependencyError: pyarrow is not installed.
        OutputError, OtherSettingsError, Interrupted, RenderError: See `run_plan`.
    """
    with made_beside(plan, files, existing) as (packed, found):
        if found is not None and existing == "resume":
            if found.get("counts", {}).get("frames") == len(plan.frames):
                discard_run(files)
                return finished_report(files, found)
            if not os.path.lexists(unfinished_run(files).root):
                _unpack(files, found)
        report = run_plan(plan, unfinished_run(files).root, execution, existing, on_progress, source=source)
        counts = _pack(plan, unfinished_run(files), packed, report.counts["frames"])
        publish(packed, files)
        discard_run(files)
    return replace(report, out=files.folder, record_file=files.marker, counts=counts)


@contextlib.contextmanager
def made_beside(
    plan: RunPlan, files: ShardFiles, existing: Existing
) -> Iterator[tuple[ShardFiles, Mapping[str, Any] | None]]:
    """Lock out other jobs while a shard is made, and remove what is left when it is finished.

    Yields:
        Where to put its files, from which `publish` takes them, and the record of a shard that is whole already.

    Raises:
        MissingDependencyError: pyarrow is not installed.
        OutputError: Another job makes this shard; or `existing` or its origin forbid to replace what is there.
        OtherSettingsError: The shard to resume is of another run.
    """
    require_pyarrow()
    work = OutputFolder(files.folder / files.name, "shard")
    with work.claimed():
        try:
            packed = ShardFiles(work.root, files.name)
            shutil.rmtree(work.root / _PACKED_RUN, ignore_errors=True)
            if packed.marker.exists() and existing != "refuse":  # a kill while the files were moved
                publish(packed, files)
            found = _finished(plan, files, existing)
            if found is not None and existing == "resume":
                require_same_key(found, plan, files.marker)
            yield packed, found
        finally:
            with contextlib.suppress(OSError):  # not empty: to be resumed
                work.root.rmdir()


def discard_run(files: ShardFiles) -> None:
    """Delete the frames of a packed shard; after a kill, none of them are taken for a run that can be continued."""
    run = unfinished_run(files).root
    with contextlib.suppress(OSError):
        if run.is_dir():
            shutil.rmtree(run.rename(run.with_name(_PACKED_RUN)), ignore_errors=True)


def publish(packed: ShardFiles, target: ShardFiles) -> None:
    """Move the files of a packed shard to where others see them: the marker last, and that of earlier ones first.

    After a kill it can be called again, as long as the packed marker is there.

    Raises:
        OutputError: They cannot be moved.
    """
    try:
        if not os.path.lexists(packed.marker):
            raise OutputError(f"{packed.marker}: missing; expected the record of a packed shard")
        target.marker.unlink(missing_ok=True)
        for source, place in ((packed.tar, target.tar), (packed.table, target.table)):
            if os.path.lexists(source):
                source.replace(place)
        flush(target.folder)
        packed.marker.replace(target.marker)
        flush(target.folder)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise output_error(target.marker, error) from error


def _finished(plan: RunPlan, files: ShardFiles, existing: Existing) -> Mapping[str, Any] | None:
    """Return the record of a shard that is whole; None if it has to be made.

    Raises:
        OutputError: There is something at its place, and `existing` or its origin forbid to replace it.
    """
    there = [p for p in (files.marker, files.tar, files.table) if os.path.lexists(p)]
    if not there:
        return None
    if existing == "refuse":
        raise OutputError(
            f"{there[0]}: exists already; expected no such shard. Use --resume to make it only if it is not whole, or "
            "--overwrite to replace it."
        )
    if files.marker not in there:
        raise OutputError(
            f"{there[0]}: exists without {files.marker.name}, which marks a shard as finished, so nothing shows that "
            "InfraBlend wrote it; nothing was touched. Move it elsewhere, and repeat the command."
        )
    if existing == "overwrite":
        return None
    try:
        record = read_run_file(files.marker)
        found = number_damage(record, plan.shard) or damage_of(files, record)
    except OutputError as error:
        found = error.message
    if found is None:
        return record
    log.warning("%s: %s; the shard is made again", files.marker, found)
    return None


def finished_report(files: ShardFiles, record: Mapping[str, Any]) -> RunReport:
    """Return the report of a shard that is whole, from its record."""
    problems = tuple(Problem(**p) for p in record.get("problems", ()))
    return RunReport(files.folder, COMPLETE, record["counts"], problems, record_file=files.marker)


def _unpack(files: ShardFiles, record: Mapping[str, Any]) -> None:
    """Put the frames of a finished shard where a run continues with those that failed."""
    folder = unfinished_run(files)
    # The record comes first: after a kill, a run continues with what is there.
    folder.write_run({**{k: v for k, v in record.items() if k != ARCHIVE}, "status": "running"})
    for frame in packed_frames(files.tar):
        known = parse_record(frame.scene)
        write_bytes(folder.record(known.frame_id), frame.scene)
        write_bytes(folder.image(known.image), frame.image)


def _pack(plan: RunPlan, folder: RunFolder, files: ShardFiles, expected: int) -> dict[str, Any]:
    """Write tar, table and marker of the frames in the folder, one frame in memory at a time; return the counts."""
    ids = {c.name: c.id for c in plan.categories}
    packed, loosened, looseness = 0, 0, Looseness.of_labels(plan.recipe.labels)
    with replace_atomically(files.tar, durable=True) as tar_part, replace_atomically(files.table) as table_part:
        with tar_part.open("wb") as stream, TarWriter(stream) as tar, TableWriter(table_part, ids) as table:
            for frame in plan.frames:
                if not os.path.lexists(folder.record(frame.frame_id)):
                    continue  # failed; the record of the shard has the reason
                try:
                    record = load_record(folder.record(frame.frame_id))
                    picture = read_regular(folder.image(record.image), folder.root)
                except (RecordError, OSError, ValueError) as error:
                    raise _changed(frame.frame_id, str(error)) from error
                if _sha256(picture) != record.image_sha256:
                    raise _changed(frame.frame_id, "its picture was changed")
                image, count = labelled_image(frame, record, folder.image(record.image), looseness)
                loosened += count
                key, label = key_of(frame.frame_id), label_text(frame.frame_id, image, ids)
                scene = read_regular(folder.record(frame.frame_id), folder.root)
                offset = tar.add(key, Path(record.image).suffix[1:], picture)
                tar.add(key, LABEL, label)
                tar.add(key, SCENE, scene)
                facts = {"label_sha256": _sha256(label), "scene_sha256": _sha256(scene)}
                table.add(record, image, key, {**facts, "image_offset": offset, "image_bytes": len(picture)})
                packed += 1
        flush(table_part)
        if packed != expected:
            raise OutputError(f"{folder.root}: found {packed} frames, expected {expected}. Repeat with --resume")
    run = folder.read_run()
    counts = {**run["counts"], **looseness.counted(loosened)}
    write_marker(plan, files, {**run, "counts": counts})
    return counts


def write_marker(plan: RunPlan, files: ShardFiles, record: Mapping[str, Any]) -> None:
    """Write the record of a shard whose tar and table have been written."""
    groups = {c.name: c.supercategory for c in plan.categories}  # for readers, who have no other file with them
    # Labels of inserted objects are counted when shards are read: there may be more of the same run.
    source = shard_source(find_provenance(plan.dataset), run_inserts(plan.recipe, plan.seed, {}))
    run = {
        **record,
        SOURCE: source,
        ARCHIVE: {"tar": _facts(files.tar), "table": _facts(files.table)},
        "categories": [{**c, "supercategory": groups[c["name"]]} for c in record["categories"]],
    }
    write_json(files.marker, sealed(run), indent=2, durable=True)


def _facts(path: Path) -> dict[str, Any]:
    return {"bytes": path.stat().st_size, "sha256": sha256_of(path)}


def _changed(frame_id: str, what: str) -> OutputError:
    return OutputError(f"frame {frame_id}: {what} while the shard was packed; repeat the command with --resume")


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
