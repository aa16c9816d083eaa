"""Fields of partly hidden objects in `Instance.extra`: the flag `occluded`, the whole and the visible box."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from infrablend.core.dataset import Instance
from infrablend.formats.values import to_floats

BOXES = ("amodal_box", "visible_box")
"""Boxes as if nothing were in front, and around the visible part: left, top, right, bottom in pixels."""


def loses_occlusion(instance: Instance, *, flag: bool = True) -> bool:
    """Return whether a format without these fields loses some; with `flag`, it has no flag `occluded` either."""
    return any(k in instance.extra for k in BOXES) or (flag and instance.extra.get("occluded") is True)


def occlusion_fields(instance: Instance) -> dict[str, Any]:
    """Return the fields that a label has."""
    return {k: instance.extra[k] for k in ("occluded", *BOXES) if k in instance.extra}


def read_occlusion(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields among untrusted ones; boxes other than four finite numbers are left out."""
    found: dict[str, Any] = {"occluded": fields["occluded"]} if isinstance(fields.get("occluded"), bool) else {}
    for name in BOXES:
        box = to_floats(fields.get(name), 4)
        if box is not None and all(map(math.isfinite, box)):
            found[name] = list(box)
    return found
