"""Takes unchanged backgrounds into the output dataset."""

from __future__ import annotations

import hashlib

from infrablend.annotation.merge import merge
from infrablend.config.recipe import Recipe
from infrablend.core.frame_record import FrameRecord
from infrablend.formats.images import encode_image, output_suffix
from infrablend.pipeline.backgrounds import background_facts
from infrablend.pipeline.composed import ComposedFrame
from infrablend.pipeline.frame_settings import FrameSettings, merge_settings
from infrablend.pipeline.plan import PlannedFrame


def unchanged_original(frame: PlannedFrame, recipe: Recipe, settings: FrameSettings) -> ComposedFrame:
    """Return a background as a frame; the image is a byte-for-byte copy unless the recipe asks for PNG."""
    source = frame.background
    background = settings.extensions.load(source)
    kind = recipe.output.image
    relative = frame.image_path(recipe.output.group_by, output_suffix(source.path, kind))
    if settings.extensions.backgrounds is not None or (kind == "png" and source.path.suffix.lower() != ".png"):
        image_bytes = encode_image(background.pixels, background, kind)
    else:
        image_bytes = source.path.read_bytes()
    merged = merge(source.instances, (), merge_settings(recipe))
    record = FrameRecord(
        frame_id=frame.frame_id,
        image=relative,
        image_sha256=hashlib.sha256(image_bytes).hexdigest(),
        background=background_facts(source, background, settings.data_root),
        scene=None,
        mapping=None,
        kept=merged.kept,
        inserted=(),
        removed=tuple(r.to_json() for r in merged.removed),
        warnings=tuple(p.to_json() for p in background.problems),
        run=settings.run,
    )
    return ComposedFrame(record, image_bytes, {})
