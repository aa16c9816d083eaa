"""Copies unchanged backgrounds into the output dataset."""

from __future__ import annotations

from infrablend.annotation.merge import merge
from infrablend.config.recipe import Recipe
from infrablend.core.files import write_bytes, write_json
from infrablend.formats.images import load_background, output_suffix, save_image
from infrablend.pipeline.backgrounds import background_facts
from infrablend.pipeline.folder import RunFolder
from infrablend.pipeline.frame_settings import FrameDone, FrameSettings, merge_settings
from infrablend.pipeline.plan import PlannedFrame
from infrablend.pipeline.record import FrameRecord, sha256_of


def copy_original(frame: PlannedFrame, recipe: Recipe, settings: FrameSettings) -> FrameDone:
    """Write a background's image and record; the image is a byte-for-byte copy unless the recipe asks for PNG."""
    source, folder = frame.background, RunFolder(settings.out)
    background = load_background(source.path, source.size_wh)
    kind = recipe.output.image
    relative = frame.image_path(recipe.output.group_by, output_suffix(source.path, kind))
    target = folder.image(relative)
    if kind == "png" and source.path.suffix.lower() != ".png":
        save_image(target, background.pixels, background, kind)
    else:
        write_bytes(target, source.path.read_bytes())
    merged = merge(source.instances, (), merge_settings(recipe))
    record = FrameRecord(
        frame_id=frame.frame_id,
        image=relative,
        image_sha256=sha256_of(target),
        background=background_facts(source, background.size_wh, settings.data_root),
        scene=None,
        mapping=None,
        kept=merged.kept,
        inserted=(),
        removed=tuple(r.to_json() for r in merged.removed),
        warnings=tuple(p.to_json() for p in background.problems),
    )
    write_json(folder.record(frame.frame_id), record.to_json())
    return FrameDone(0, 0, {})
