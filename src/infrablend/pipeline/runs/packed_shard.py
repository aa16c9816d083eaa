"""Packed shards: the frames of a shard as a tar and a table, with a record that has the sizes and digests of both.

The table has a row per frame with its labels, draws and digests, in Parquet; it needs the extra `shards`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from infrablend.annotation.looseness import Looseness
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.files import read_regular, replace_atomically, sha256_of, write_json
from infrablend.core.frame_row import FrameRecord, FrameRow, SceneRow
from infrablend.core.ledger import Ledger
from infrablend.core.operating_system import flush_file
from infrablend.core.run_folder import RunFolder, ShardFiles
from infrablend.errors import MissingDependencyError, OutputError
from infrablend.formats.labels.shard_tar import LABEL, SCENE, TarWriter, key_of, label_text
from infrablend.formats.labels.shards import SOURCE
from infrablend.pipeline.compose.composed import labelled_image
from infrablend.pipeline.datasets.origin import run_inserts
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.report.card import find_provenance, shard_source

_ROWS = 1000


def require_pyarrow() -> None:
    """Raise MissingDependencyError with the command to run if pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        raise MissingDependencyError(
            "pyarrow not installed, which output.layout: shards needs for its tables; install with\n"
            '  pip install "infrablend[shards]"\n(in a checkout: make setup)'
        )


@cache
def _schema() -> Any:
    """Return the columns, which are the same for every shard of every run, whatever it contains."""
    import pyarrow as pa

    text = pa.string()
    number = pa.float64()
    whole = pa.int64()
    yes = pa.bool_()
    counts = pa.list_(pa.struct([("reason", text), ("count", whole)]))
    draws = pa.struct(
        [("wanted", whole), ("attempts", whole), ("first_distance_m", number), ("distance_m", number)]
        + [("absent", counts), ("rejected", counts)]
    )
    objects = pa.struct(
        [("category", text), ("category_id", whole), ("inserted", yes), ("box_xyxy", pa.list_(number))]
        + [("corners_xy", pa.list_(number)), ("mask", text), ("visibility", number), ("truncated", yes)]
        + [("occluded", yes)]
    )
    return pa.schema(
        [("key", text), ("frame_id", text), ("split", text), ("image", text), ("width", whole), ("height", whole)]
        + [("background", text), ("configuration", whole), ("pitch_deg", number), ("altitude_m", number)]
        + [("time_of_day", text), ("objects", pa.list_(objects)), ("removed", counts), ("draws", draws)]
        + [("background_sha256", text), ("image_sha256", text), ("label_sha256", text), ("scene_sha256", text)]
        + [("image_offset", whole), ("image_bytes", whole)]
    )


class TableWriter:
    """Writes the table of a shard, a group of rows at a time; close it, or use it in a `with` statement."""

    def __init__(self, path: Path, ids: Mapping[str, int]) -> None:
        """Start a table; `ids` has the number of each category."""
        import pyarrow.parquet as pq

        self._ids = ids
        self._rows: list[object] = []
        # The compression is stated, because another default would give other bytes.
        self._writer = pq.ParquetWriter(path, _schema(), compression="zstd", version="2.6")

    def __enter__(self) -> TableWriter:
        return self

    def __exit__(self, kind: object, error: object, at: object) -> None:
        if kind is None:
            self._write()
        self._writer.close()

    def add(self, frame: FrameRow, image: ImageRecord, key: str, files: Mapping[str, int | str]) -> None:
        """Add a frame: its row, its labels, its key in the tar, and the columns about its files."""
        width, height = image.size_wh or (None, None)
        row = {
            "key": key,
            "frame_id": frame.id,
            "split": image.split,
            "image": frame.image,
            "width": width,
            "height": height,
            "background": frame.background,
            "configuration": None if frame.scene is None else frame.scene.configuration,
            "pitch_deg": image.capture.pitch_deg,
            "altitude_m": image.capture.altitude_m,
            "time_of_day": image.capture.time_of_day,
            "objects": [self._object(i) for i in image.instances],
            "removed": _counts(Counter(label.reason for label in frame.removed)),
            "draws": None if frame.scene is None else _draws(frame.scene),
            "background_sha256": frame.background_digest,
            "image_sha256": frame.digest,
            **files,
        }
        self._rows.append(_fitting(row))
        if len(self._rows) == _ROWS:
            self._write()

    def _object(self, instance: Instance) -> dict[str, object]:
        corners = instance.corners_xy
        mask = instance.mask
        return {
            "category": instance.category,
            "category_id": self._ids[instance.category],
            "inserted": instance.inserted,
            "box_xyxy": instance.box_xyxy.tolist(),
            "corners_xy": None if corners is None else corners.reshape(-1).tolist(),
            "mask": None if mask is None else mask.counts,
            "visibility": instance.visibility,
            "truncated": instance.truncated,
            "occluded": bool(instance.extra["occluded"]) if "occluded" in instance.extra else None,
        }

    def _write(self) -> None:
        import pyarrow as pa

        if self._rows:
            self._writer.write_table(pa.Table.from_pylist(self._rows, _schema()))
            self._rows = []


def _draws(scene: SceneRow) -> dict[str, object]:
    return {
        "wanted": scene.draws.wanted,
        "attempts": scene.draws.attempts,
        "first_distance_m": scene.draws.first_distance_m,
        "distance_m": scene.distance_m,
        "absent": _counts(scene.draws.absent),
        "rejected": _counts(scene.draws.rejected),
    }


def _counts(reasons: Mapping[str, int]) -> list[dict[str, str | int]]:
    return [{"reason": reason, "count": count} for reason, count in sorted(reasons.items())]


def _fitting(value: Any) -> Any:
    """Return values without what the table cannot hold: parts of a character in texts, and numbers that are none."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode("utf-8")
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {k: _fitting(v) for k, v in value.items()}
    return [_fitting(v) for v in value] if isinstance(value, list) else value


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
        flush_file(table_part)
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
