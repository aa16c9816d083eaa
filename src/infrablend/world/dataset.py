"""Writes the virtual world as a background dataset: HIT-UAV, MONET, temperatures or camera files, and `world.json`."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

from infrablend.core.arguments import require_choice
from infrablend.core.dataset import ImageRecord, Split
from infrablend.core.files import link_or_copy
from infrablend.core.workspace import WORLD_FILE, replacing, workspace
from infrablend.formats import coco, hit_uav, monet
from infrablend.formats.losses import Written
from infrablend.formats.rjpeg.writing import MAKERS
from infrablend.world.frame_files import FinishedFrame
from infrablend.world.frames import (
    ALTITUDES_M,
    MONET_ALTITUDES_M,
    MONET_CATEGORIES,
    PITCHES_DEG,
    SPLIT_SHARES,
    FrameFacts,
    plan_flight,
    plan_frames,
    plan_sequences,
)

Layout = Literal["hit-uav", "monet", "radiometric", "dji", "flir"]
# Renders the given frames, writes their images below the given folder, and yields them in any order.
FrameSource = Callable[[Sequence[FrameFacts], Path], Iterable[FinishedFrame]]

_PICTURES = ".frames"
_TOP = {"info": {"description": "InfraBlend virtual thermal world in HIT-UAV layout"}, "licenses": []}
_RADIOMETRIC_INFO = {"description": "InfraBlend virtual thermal world, temperatures"}
_MONET_TOP = {"info": {"description": "InfraBlend virtual thermal world in MONET layout"}, "licenses": []}


@dataclass(frozen=True)
class WorldRequest:
    """The frames that a virtual dataset contains.

    Attributes:
        count: Number of frames.
        seed: Seed of everything random.
        layout: `hit-uav`: 640x512 JPEG of a town. `monet`: 800x600 PNG of airfields and dirt roads, persons and
            vehicles with axis-aligned boxes, telemetry in the JSON; two sequences and single frames have lost theirs.
            `radiometric`: the frames of `hit-uav` as 16-bit TIFF in centikelvin, with COCO labels that state the scale,
            the air and the camera.
            `dji`, `flir`: the radiometric JPEG files of one flight as they come off the card, without labels.
        splits: Share of the frames in each split; MONET's sequences have splits of their own.
        pitches_deg: Camera depression angles to cover; 90 looks straight down.
        altitudes_m: Camera heights to cover; the defaults of the layout if None.

    Raises:
        ArgumentError: There is no such layout.
    """

    count: int
    seed: int = 0
    layout: Layout = "hit-uav"
    splits: Mapping[Split, float] | None = None
    pitches_deg: Sequence[int] = PITCHES_DEG
    altitudes_m: Sequence[int] | None = None

    def __post_init__(self) -> None:
        require_choice("layout", self.layout, get_args(Layout))

    def frames(self) -> tuple[FrameFacts, ...]:
        """Return the facts of all frames; frame k does not depend on how many follow.

        Raises:
            RecipeError: A value is out of range; the error lists all of them.
        """
        if self.layout == "monet":
            altitudes = self.altitudes_m or MONET_ALTITUDES_M
            return plan_sequences(self.count, self.seed, self.pitches_deg, altitudes)
        altitudes = self.altitudes_m or ALTITUDES_M
        if self.layout in MAKERS:
            return plan_flight(self.count, self.seed, self.layout, self.pitches_deg, altitudes)
        frames = plan_frames(self.count, self.seed, self.splits or SPLIT_SHARES, self.pitches_deg, altitudes)
        return tuple(replace(f, radiometric=True) for f in frames) if self.layout == "radiometric" else frames


@dataclass(frozen=True)
class WorldReport:
    """Summary of a written virtual dataset.

    Attributes:
        out: Folder of the dataset.
        frames: Number of images per split.
        labels: Number of labels per class.
        dropped: Number of objects without a label per reason (`hidden`, `small`, `outside`).
        losses: Facts that the format cannot hold, see `formats.losses.LOSSES`.
    """

    out: Path
    frames: Mapping[str, int]
    labels: Mapping[str, int]
    dropped: Mapping[str, int]
    losses: Mapping[str, int]


def write_world(
    out: Path,
    request: WorldRequest,
    source: FrameSource,
    progress: Callable[[int, int], None] | None = None,
    *,
    overwrite: bool = False,
) -> WorldReport:
    """Write a background dataset of the virtual world; the same request gives the same bytes.

    `world.json` lists the camera, the place and every object of each frame.

    Args:
        out: Folder to write.
        request: Frames of the dataset.
        source: Renders the frames.
        progress: Called with (finished frames, all frames) after each frame.
        overwrite: Replace an earlier world in `out`.

    Raises:
        RecipeError: A value of `request` is out of range.
        OutputError: `out` has something that may not be replaced, or cannot be written.
        RenderError: Blender failed.
    """
    frames = request.frames()
    finished: dict[int, FinishedFrame] = {}

    with workspace(Path(out), "virtual world", WORLD_FILE, replacing(overwrite)) as space:
        pictures = space.folder / _PICTURES
        for one in source(frames, pictures):
            finished[one.number] = one
            if progress is not None:
                progress(len(finished), len(frames))
        ordered = [finished[f.number] for f in frames]
        written = _write(space.folder, request, [one.image for one in ordered])
        shutil.rmtree(pictures)  # the dataset has links to them
        space.finish({"seed": request.seed, "frames": [one.facts for one in ordered]})
    labels_of = Counter(i.category for one in ordered for i in one.image.instances)
    dropped: Counter[str] = Counter()
    for one in ordered:
        dropped.update(one.dropped)
    return WorldReport(
        Path(out),
        dict(Counter(one.image.split for one in ordered)),
        dict(sorted(labels_of.items())),
        dict(sorted(dropped.items())),
        dict(written.losses),
    )


def _write(out: Path, request: WorldRequest, images: Sequence[ImageRecord]) -> Written:
    """Write the dataset in its layout; return the files, and what the format lost."""
    if request.layout == "monet":
        return monet.write(out, images, MONET_CATEGORIES, extra=_MONET_TOP)
    if request.layout in MAKERS:
        return Written(tuple(link_or_copy(i.path, out / i.path.name) for i in images))
    if request.layout == "radiometric":
        return coco.write(out, images, hit_uav.CATEGORIES, info=_RADIOMETRIC_INFO, pictures=True)
    return hit_uav.write(out, images, hit_uav.CATEGORIES, forms=("normal_json", "rotate_json"), extra=_TOP)
