"""The record of a finished frame: scene, labels and label decisions, as JSON in the ledger of its run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from infrablend.core.dataset import Instance
from infrablend.core.rle_masks import Mask
from infrablend.core.scene import SceneSpec
from infrablend.errors import Problem


@dataclass(frozen=True)
class Remains:
    """What is still visible of a label of the background that inserted objects cover in part.

    Attributes:
        visibility: Visible share.
        mask: Visible pixels; None if unknown.
    """

    visibility: float | None
    mask: Mask | None = None

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"visibility": self.visibility, **({} if self.mask is None else {"mask": self.mask.to_coco()})}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Remains:
        """Return what `to_json` wrote."""
        mask = data.get("mask")
        return cls(data["visibility"], None if mask is None else Mask.from_coco(mask, tuple(mask["size"])))


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """Everything that is known of a finished frame but its pixels.

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
            background: `matching`, and `sensor` and `camera`, which were applied to the picture.
        warnings: Problems that did not stop the frame.
        covered: Visible remains of kept labels that inserted objects partly cover, by index.
        run: Identity of the run, see `RunPlan.run`.
    """

    frame_id: str
    image: str
    image_sha256: str
    background: Mapping[str, Any]
    scene: SceneSpec | None
    mapping: Mapping[str, object] | None
    kept: tuple[int, ...]
    inserted: tuple[Instance, ...]
    removed: tuple[Mapping[str, object], ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[Problem, ...] = ()
    covered: Mapping[int, Remains] = field(default_factory=dict)
    run: str = ""

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "run": self.run,
            "frame_id": self.frame_id,
            "image": self.image,
            "image_sha256": self.image_sha256,
            "background": dict(self.background),
            "scene": None if self.scene is None else self.scene.to_json(),
            "mapping": None if self.mapping is None else dict(self.mapping),
            "kept": list(self.kept),
            **({"covered": {str(n): c.to_json() for n, c in self.covered.items()}} if self.covered else {}),
            "inserted": [i.to_json() for i in self.inserted],
            "removed": [dict(r) for r in self.removed],
            "facts": dict(self.facts),
            "warnings": [w.to_json() for w in self.warnings],
        }

    def to_text(self) -> str:
        """Return the record as JSON; equal records give equal texts."""
        return json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"), allow_nan=False)

    def originals(self, background: Sequence[Instance]) -> tuple[Instance, ...]:
        """Return the kept labels of the background, restricted to their visible parts."""
        found = []
        for n in self.kept:
            seen = self.covered.get(n)
            if seen is None:
                found.append(background[n])
                continue
            mask = background[n].mask if seen.mask is None else seen.mask
            found.append(replace(background[n], visibility=seen.visibility, mask=mask))
        return tuple(found)

    @classmethod
    def from_text(cls, text: str | bytes) -> FrameRecord:
        """Return the record that `to_text` returned.

        Raises:
            LookupError, TypeError, ValueError, AttributeError: The text is damaged.
        """
        return cls.from_json(json.loads(text))

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> FrameRecord:
        """Return the record from JSON values written by `to_json`; the errors are those of `from_text`."""
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
            warnings=tuple(Problem(**w) for w in data["warnings"]),
            covered={int(n): Remains.from_json(c) for n, c in data.get("covered", {}).items()},
            run=data["run"],
        )
