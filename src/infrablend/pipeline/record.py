"""Reads and writes frame records: scene, labels and label decisions of a finished frame, one JSON file per frame."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from infrablend.annotation.merge import MergedLabels
from infrablend.core.dataset import Instance
from infrablend.core.file_names import leaves
from infrablend.core.files import LinkOutError, load_json, write_json
from infrablend.core.masks import Mask
from infrablend.core.scene import SceneSpec
from infrablend.pipeline.frame_fields import FrameFields
from infrablend.pipeline.run_fields import damage

VERSION = 1
DIGEST = "record_sha256"


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """Content of `scenes/<split>/<frame>.json`.

    Attributes:
        frame_id: Id of the frame, `<split>/<name>`.
        image: Path of the image below `images/`.
        image_sha256: SHA-256 of the image file.
        background: Facts about the background: id, path relative to the data folder, SHA-256, size, pitch, altitude,
            time of day.
        scene: Description of the scene; None for an unchanged original.
        mapping: Grey-level mapping (`dark`, `bright`, optionally `limits`); None for an unchanged original.
        kept: Indices of the background's labels that were kept, in order.
        inserted: Labels of the inserted objects.
        removed: Labels that were removed, each with the reason.
        facts: Special cases of labelling (see `annotation.labels.LabelReport`), and values estimated from the
            background: `matching`, and `sensor`, which was applied to the picture.
        warnings: Problems that did not stop the frame.
        covered: Visible remains of kept labels that inserted objects partly cover, by index: `visibility`, and `mask`
            where known.
        run: Identity of the run (`RunPlan.run`), so that frames of another one are noticed; empty in records of earlier
            versions.
    """

    frame_id: str
    image: str
    image_sha256: str
    background: Mapping[str, Any]
    scene: SceneSpec | None
    mapping: Mapping[str, Any] | None
    kept: tuple[int, ...]
    inserted: tuple[Instance, ...]
    removed: tuple[Mapping[str, Any], ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[Mapping[str, Any], ...] = ()
    covered: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    run: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "version": VERSION,
            **({"run": self.run} if self.run else {}),
            "frame_id": self.frame_id,
            "image": self.image,
            "image_sha256": self.image_sha256,
            "background": dict(self.background),
            "scene": None if self.scene is None else self.scene.to_json(),
            "mapping": None if self.mapping is None else dict(self.mapping),
            "kept": list(self.kept),
            **({"covered": {str(n): dict(c) for n, c in self.covered.items()}} if self.covered else {}),
            "inserted": [i.to_json() for i in self.inserted],
            "removed": [dict(r) for r in self.removed],
            "facts": dict(self.facts),
            "warnings": [dict(w) for w in self.warnings],
        }

    def is_of(self, run: str | None) -> bool:
        """Return whether the record may be of a run with this identity; records of earlier versions name none."""
        return self.run == "" or self.run == run

    def originals(self, background: Sequence[Instance]) -> tuple[Instance, ...]:
        """Return the kept labels of the background, restricted to their visible parts."""
        found = []
        for n in self.kept:
            seen = self.covered.get(n)
            if seen is None:
                found.append(background[n])
                continue
            mask = background[n].mask
            if "mask" in seen:
                height, width = seen["mask"]["size"]
                mask = Mask.from_coco(seen["mask"], (height, width))
            found.append(replace(background[n], visibility=seen["visibility"], mask=mask))
        return tuple(found)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> FrameRecord:
        """Return the record from JSON values written by `to_json`."""
        if data.get("version") != VERSION:
            raise ValueError(f"record version {data.get('version')!r}, expected {VERSION}")
        # The background's path may lead out of the data folder: that of `RUN/coco` is in `RUN/images`.
        if leaves(data["image"]):
            raise ValueError("a path that leads out of its folder")
        if (found := damage(data, FrameFields)) is not None:
            raise ValueError(found)
        kept = data["kept"]
        if not all(type(n) is int and n >= 0 for n in kept) or len(set(kept)) != len(kept):
            raise ValueError(f"kept: found {kept!r}, expected indices")
        return cls(
            frame_id=data["frame_id"],
            image=data["image"],
            image_sha256=data["image_sha256"],
            background=data["background"],
            scene=None if data["scene"] is None else SceneSpec.from_json(data["scene"]),
            mapping=data["mapping"],
            kept=tuple(data["kept"]),
            inserted=tuple(Instance.from_json(i) for i in data["inserted"]),
            removed=tuple(data["removed"]),
            facts=data["facts"],
            warnings=tuple(data["warnings"]),
            covered={int(n): c for n, c in data.get("covered", {}).items()},
            run=str(data.get("run", "")),
        )


def covered_facts(merged: MergedLabels) -> dict[int, dict[str, Any]]:
    """Return `FrameRecord.covered` for merged labels."""
    return {
        n: {"visibility": i.visibility, **({} if i.mask is None else {"mask": i.mask.to_coco()})}
        for n, i in merged.partly_covered.items()
    }


class RecordError(ValueError):
    """A frame record that cannot be used."""


def write_record(path: Path, record: FrameRecord) -> None:
    """Write a record with the digest of its content, so that a later edit is noticed."""
    content = json.loads(json.dumps(record.to_json(), allow_nan=False))
    write_json(path, {**content, DIGEST: _digest(content)})


def load_record(path: Path) -> FrameRecord:
    """Read a record and verify its digest; records of earlier versions have none.

    Raises:
        RecordError: The record is missing, damaged, or was edited.
    """
    try:
        return _verified(load_json(path))
    except RecordError:
        raise
    except LinkOutError as error:
        raise RecordError(str(error)) from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        raise RecordError(f"damaged: {type(error).__name__}: {error}") from error


def parse_record(text: bytes) -> FrameRecord:
    """Return the record with this content; see `load_record`.

    Raises:
        RecordError: The record is damaged, or was edited.
    """
    try:
        return _verified(json.loads(text))
    except RecordError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        raise RecordError(f"damaged: {type(error).__name__}: {error}") from error


def _verified(data: Any) -> FrameRecord:
    if not isinstance(data, dict):
        raise RecordError("damaged: not a JSON object")
    digest = data.pop(DIGEST, None)
    if digest is None and data.get("run"):  # versions that name the run write a digest, too
        raise RecordError(f"edited: it has no {DIGEST}")
    if digest is not None and digest != _digest(data):
        raise RecordError("edited: its digest does not match")
    return FrameRecord.from_json(data)


def read_record(path: Path) -> FrameRecord | None:
    """Read a record; return None if it is missing, damaged or edited: the frame then has to be rendered again."""
    try:
        return load_record(path)
    except RecordError:
        return None


def _digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of JSON values, whatever their layout in the file."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
