"""Copies unchanged backgrounds into the output dataset."""

from __future__ import annotations

import hashlib

from infrablend.annotation.merge import merge
from infrablend.config.recipe import Recipe
from infrablend.core.files import write_bytes
from infrablend.formats.images import encode_image, load_background, output_suffix
from infrablend.pipeline.backgrounds import background_facts
from infrablend.pipeline.folder import RunFolder
from infrablend.pipeline.frame_settings import FrameDone, FrameSettings, merge_settings
from infrablend.pipeline.plan import PlannedFrame
from infrablend.pipeline.record import FrameRecord, write_record


def copy_original(frame: PlannedFrame, recipe: Recipe, settings: FrameSettings) -> FrameDone:
    """Write a background's image and record; the image is a byte-for-byte copy unless the recipe asks for PNG."""
    source, folder = frame.background, RunFolder(settings.out)
    background = load_background(source.path, source.size_wh)
    kind = recipe.output.image
    relative = frame.image_path(recipe.output.group_by, output_suffix(source.path, kind))
    if kind == "png" and source.path.suffix.lower() != ".png":
        image_bytes = encode_image(background.pixels, background, kind)
    else:
        image_bytes = source.path.read_bytes()
    merged = merge(source.instances, (), merge_settings(recipe))
    record = FrameRecord(
        frame_id=frame.frame_id,
        image=relative,
        image_sha256=hashlib.sha256(image_bytes).hexdigest(),
        background=background_facts(source, background.size_wh, settings.data_root),
        scene=None,
        mapping=None,
        kept=merged.kept,
        inserted=(),
        removed=tuple(r.to_json() for r in merged.removed),
        warnings=tuple(p.to_json() for p in background.problems),
    )
    write_record(folder.record(frame.frame_id), record)
    write_bytes(folder.image(relative), image_bytes)
    return FrameDone(0, 0, {})
