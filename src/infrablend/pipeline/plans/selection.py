"""Chooses the frames of a run: first backgrounds, a sample of them, a number of pictures, or frames by their ids."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from infrablend.core.arguments import require_names, require_whole
from infrablend.errors import ArgumentError, Problem

if TYPE_CHECKING:
    from infrablend.core.dataset import ImageRecord

_SHOWN = 3


@dataclass(frozen=True)
class FrameSelection:
    """Frames that a run produces; at most one of the fields is set. The frames are the same as in a full run.

    Attributes:
        limit: Use only the first N backgrounds in sorted order.
        sample: Use only N backgrounds, spread over the dataset and drawn with --seed.
        frames: Render only these frames: ids such as test/a_c0, or ids of backgrounds.
        pictures: Write exactly N pictures, spread over the backgrounds; replaces the recipe's `configurations`.

    Raises:
        ArgumentError: A value is not one of these, or several are set.
    """

    limit: int | None = None
    sample: int | None = None
    frames: Sequence[str] | None = None
    pictures: int | None = None

    def __post_init__(self) -> None:
        given = [name for name in ("limit", "sample", "frames", "pictures") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ArgumentError(f"{' and '.join(given)} exclude each other; give one of them")
        for name in ("limit", "sample", "pictures"):
            if getattr(self, name) is not None:
                require_whole(name, getattr(self, name), 1)
        if self.frames is not None:
            require_names("frames", self.frames)
            if not self.frames:
                raise ArgumentError("frames: found an empty list, expected at least one id of a frame or background")
            object.__setattr__(self, "frames", tuple(dict.fromkeys(self.frames)))

    def backgrounds(self, images: Sequence[ImageRecord], seed: int) -> Sequence[ImageRecord]:
        """Return the backgrounds that `limit` or `sample` leaves, in their order."""
        if self.limit is not None:
            return images[: self.limit]
        return images if self.sample is None else _sample(images, self.sample, seed)

    def share_out(self, images: Sequence[ImageRecord], originals: bool, seed: int) -> set[tuple[int, int | None]]:
        """Return the frames of `pictures`, by `id(image)` and configuration (None: the unchanged background).

        As many backgrounds as possible are used, and the numbers of their pictures differ by one at most.

        Args:
            images: Usable backgrounds.
            originals: Whether the unchanged backgrounds are among the pictures.
            seed: Seed of the choice of backgrounds, or of those with one more picture than others.

        Raises:
            ArgumentError: A background would have more configurations than a recipe may have.
        """
        from infrablend.config.recipe import MAX_CONFIGURATIONS

        count = self.pictures or 0
        used = _sample(images, max(1, count // 2 if originals else count), seed)
        each, more = divmod(count, len(used))
        if each + bool(more) - originals > MAX_CONFIGURATIONS:
            raise ArgumentError(
                f"pictures: found {count}, expected at most {MAX_CONFIGURATIONS} for each of {len(used)} usable "
                "background(s). Use a smaller number, or more backgrounds"
            )
        with_more = {id(image) for image in _sample(used, more, seed)}
        of_one: list[int | None] = [0, *([None] if originals else []), *range(1, each + 1)]
        return {(id(i), k) for i in used for k in of_one[: each + (id(i) in with_more)]}


def _sample(images: Sequence[ImageRecord], size: int, seed: int) -> Sequence[ImageRecord]:
    """Draw a number of images, at most all of them: one from each of equal parts, so that no sequence is left out."""
    if size >= len(images):
        return images
    from infrablend.core.rng import stream

    shares = stream(seed, "backgrounds", size).random(size)
    ends = [k * len(images) // max(size, 1) for k in range(size + 1)]
    parts = zip(ends, ends[1:], shares.tolist(), strict=False)  # which share no picture
    return [images[low + int(share * (high - low))] for low, high, share in parts]


ALL_FRAMES = FrameSelection()


def similar(name: str, known: Collection[str]) -> str:
    """Return the known names that are most similar to one, or the first ones, joined by commas."""
    return ", ".join(difflib.get_close_matches(name, known, _SHOWN, 0.5) or sorted(known)[:_SHOWN])


Names = Mapping[tuple[int, int | None], str]
"""Name of each frame by `id(image)` and configuration, see `planning.frame_names`."""


def find_frames(wanted: Sequence[str], images: Sequence[ImageRecord], names: Names) -> set[tuple[int, int | None]]:
    """Return the keys in `names` of the frames with these ids, or of these backgrounds.

    A frame is also found by its background and configuration (`<split>/<id>_c0`), whatever the recipe names it.

    Raises:
        ArgumentError: There is no such frame or background; `problems` names each of them, with similar ones.
    """
    known: dict[str, list[tuple[int, int | None]]] = {}
    backgrounds: dict[str, list[tuple[int, int | None]]] = {}
    of_image = {id(image): image for image in images}
    for key, name in names.items():
        image = of_image[key[0]]
        known.setdefault(f"{image.split}/{name}", []).append(key)
        aliases = [f"{image.split}/{image.id}", image.id]
        aliases += [] if key[1] is None else [f"{image.split}/{image.id}_c{key[1]}"]
        for background in aliases:
            backgrounds.setdefault(background, []).append(key)
    found: set[tuple[int, int | None]] = set()
    problems = []
    for frame in wanted:
        keys = known.get(frame) or backgrounds.get(frame)
        if keys:
            found.update(keys)
            continue
        expected = f"the id of a frame or a background, such as {similar(frame, [*known, *backgrounds])}"
        problems.append(Problem(frame, "frame-unknown", "no frame or background has this id", expected))
    if problems:
        raise ArgumentError(f"{len(problems)} of {len(wanted)} frames do not exist", problems)
    return found
