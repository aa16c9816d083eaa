"""Frames without a run folder: try a recipe on one frame, and frames as arrays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from infrablend.errors import InfraBlendError
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.compose.extensions import NO_EXTENSIONS, BackgroundSource, Extensions
from infrablend.pipeline.compose.memory_frames import Frames, FramesRequest
from infrablend.pipeline.compose.trial import Trial, TrialRequest, Trials
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION, ONE_WORKER, Execution, Settings
from infrablend.pipeline.plans.selection import ALL_FRAMES, FrameSelection


def frames(
    recipe: str | Path,
    data: str | Path | BackgroundSource,
    *,
    selection: FrameSelection = ALL_FRAMES,
    seed: int = 0,
    settings: Settings = (),
    reading: Reading = READ_ALL,
    execution: Execution = DEFAULT_EXECUTION,
    extensions: Extensions = NO_EXTENSIONS,
) -> Frames:
    """Return the frames of a run as arrays with labels, composed on warm workers when they are asked for.

    >>> flat = Execution(renderer="flat", in_process=True)
    >>> with frames("hit-uav-drone", "hit-uav", execution=flat) as found:
    ...     first = next(iter(found))
    ...     again = found["train/0_60_30_0_00001_c0"]
    >>> first.id, first.pixels.shape, [i.category for i in first.inserted]
    ('train/0_60_30_0_00001_c0', (512, 640), ['drone'])
    >>> bool((first.pixels == again.pixels).all())
    True

    The arguments are the fields of `FramesRequest`. Pixels and labels are those of a run of `generate`.
    """
    source = Path(data) if isinstance(data, str | Path) else data
    return Frames(FramesRequest(recipe, source, selection, seed, settings, reading, execution, extensions))


def try_recipe(
    recipe: str | Path,
    data: str | Path,
    frame: str | None = None,
    *,
    seed: int = 0,
    settings: Settings = (),
    reading: Reading = READ_ALL,
    execution: Execution = ONE_WORKER,
) -> Trial:
    """Return one frame of a recipe without a run folder; `write` of the result saves it with its boxes, enlarged.

    >>> flat = Execution(renderer="flat", in_process=True)
    >>> trial = try_recipe("hit-uav-drone", "hit-uav", "test/0_130_90_0_00004_c1", execution=flat)
    >>> trial.frame.id, trial.write("try.png").name
    ('test/0_130_90_0_00004_c1', 'try.png')

    The arguments are the fields of `TrialRequest`.
    """
    with Trials(TrialRequest(recipe, Path(data), frame, seed, settings, reading, execution)) as trials:
        return trials.compose()


def watch_recipe(
    recipe: str | Path,
    data: str | Path,
    frame: str | None = None,
    *,
    seed: int = 0,
    settings: Settings = (),
    reading: Reading = READ_ALL,
    execution: Execution = ONE_WORKER,
) -> Iterator[Trial | InfraBlendError]:
    """Yield one frame as in `try_recipe`, and again whenever recipe, models or data change, without end.

    An error, such as an invalid recipe, is yielded instead of a frame.
    """
    with Trials(TrialRequest(recipe, Path(data), frame, seed, settings, reading, execution)) as trials:
        yield from trials.watch()
