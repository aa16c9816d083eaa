"""Table of a shard: a row per frame with its labels, draws and digests, in Parquet; needs the extra `shards`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.frame_row import FrameRow, SceneRow
from infrablend.errors import MissingDependencyError

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
