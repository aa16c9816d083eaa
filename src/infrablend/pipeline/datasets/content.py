"""A digest of everything in a dataset that a result may depend on: labels, and the bytes of every picture."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from infrablend.core.dataset import Dataset
from infrablend.core.file_names import real_path
from infrablend.core.files import sha256_of


def json_digest(value: Any) -> str:
    """Return sixteen hexadecimal digits that identify a plain JSON value."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def content_digest(dataset: Dataset) -> str:
    """Return a digest of a dataset's labels and of the bytes of every picture, wherever its folder is."""
    pictures = [(i.split, i.name, sha256_of(real_path(i.path)) if i.path.is_file() else None) for i in dataset.images]
    ignored = [c.name for c in dataset.categories if c.ignore]
    objects = [o for i in dataset.images for o in i.instances]
    masks = hashlib.sha256()
    for k, o in enumerate(objects):
        if o.mask is not None:
            masks.update(json.dumps([k, o.mask.to_coco()], sort_keys=True).encode())
    return json_digest(
        [fingerprint(dataset), pictures, ignored, [k for k, o in enumerate(objects) if o.is_crowd], masks.hexdigest()]
    )


def fingerprint(dataset: Dataset) -> str:
    """Return a digest of the images and labels of a dataset. Pixels are excluded: each frame's record covers those."""
    digest = hashlib.sha256()
    for c in dataset.categories:
        digest.update(f"{c.id}\x1f{c.name}\x1e".encode())
    for image in dataset.images:
        digest.update(repr((image.id, image.split, image.size_wh, image.capture)).encode())
        if image.capture.place is not None:  # runs begun before places were known have none
            digest.update(repr(image.capture.place).encode())
        for i in image.instances:
            digest.update(i.category.encode() + i.box_xyxy.tobytes())
            if i.corners_xy is not None:
                digest.update(i.corners_xy.tobytes())
    return digest.hexdigest()
