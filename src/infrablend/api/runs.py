"""Runs: insert objects into a dataset, look at the result; frames in memory, without a run folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from infrablend.core.addresses import require_folder, require_known
from infrablend.core.arguments import require_whole
from infrablend.core.tasks import OnProgress
from infrablend.core.workspace import Existing
from infrablend.errors import ArgumentError, InfraBlendError
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.compose.extensions import NO_EXTENSIONS, BackgroundSource, Extensions
from infrablend.pipeline.compose.memory_frames import Frames, FramesRequest
from infrablend.pipeline.compose.trial import Trial, TrialRequest, Trials
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION, ONE_WORKER, Execution, RunRequest, Settings
from infrablend.pipeline.plans.selection import ALL_FRAMES, FrameSelection
from infrablend.pipeline.plans.shard import ShardRequest
from infrablend.pipeline.runs.choose import BY_HAND, ChoiceReport, ExclusionRequest, choose_frames
from infrablend.pipeline.runs.generate import describe_run, run_request
from infrablend.pipeline.runs.merge import merge_shards
from infrablend.pipeline.runs.rerender import rerender_frame, show_frame
from infrablend.pipeline.runs.run import RunReport
from infrablend.pipeline.runs.sharded import Layout, ShardState, opened_run

if TYPE_CHECKING:
    from infrablend.report.preview import Draw


@dataclass(frozen=True)
class PlanReport:
    """Frames, disk space and time of a run that has not been started."""

    facts: Mapping[str, Any]

    @property
    def ok(self) -> bool:
        """False if the run would insert no object; `warnings` in the facts say why."""
        return not self.facts.get("inserts_nothing")

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return dict(self.facts)


def generate(  # noqa: PLR0913 - callers name these; a value object for some of them would break their calls
    recipe: str | Path,
    data: str | Path,
    out: str | Path,
    *,
    limit: int | None = None,
    selection: FrameSelection = ALL_FRAMES,
    seed: int = 0,
    settings: Settings = (),
    reading: Reading = READ_ALL,
    execution: Execution = DEFAULT_EXECUTION,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> RunReport:
    """Insert rendered objects into a dataset and write the enlarged dataset with merged labels.

    >>> flat = Execution(renderer="flat", in_process=True)
    >>> report = generate("hit-uav-drone", "hit-uav", "runs/first", limit=2, execution=flat)
    >>> report.ok, report.counts["frames"]
    (True, 4)

    The arguments are the fields of `RunRequest`; `limit` is short for `selection=FrameSelection(limit=...)`.
    """
    chosen = selection if limit is None else replace(selection, limit=limit)
    request = RunRequest(recipe, Path(data), Path(out), chosen, seed, settings, reading, execution, existing)
    return run_request(request, on_progress)


def generate_shard(request: RunRequest, on_progress: OnProgress | None = None) -> RunReport:
    """Render one shard, such as `RunRequest(..., shard=ShardRequest(2, 7))`, into a folder of its own; see `merge`."""
    if request.shard is None:
        raise ArgumentError("generate_shard: found no shard in the request, expected one such as ShardRequest(2, 7)")
    return run_request(request, on_progress)


def merge(
    sources: Sequence[str | Path],
    out: str | Path,
    *,
    data: str | Path | None = None,
    partial: bool = False,
    layout: Layout = "files",
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> RunReport:
    """Write one run from finished shards, with the bytes of an undivided run.

    `partial` merges the finished shards only. The layout is `files`, or `shards` for one packed shard (needs
    `infrablend[shards]`). `data` is the folder of the backgrounds, if it has moved.
    """
    for source in sources:
        require_known("sources", source)
    require_folder("out", out)
    if data is not None:
        require_known("data", data)
    folder = None if data is None else Path(data)
    return merge_shards(
        sources, Path(out), folder, partial=partial, layout=layout, existing=existing, on_progress=on_progress
    )


def status(out: str | Path, *, wait: bool = False) -> list[ShardState]:
    """Return the state of every shard in a folder that `generate_shard` writes.

    `wait` waits until every shard is done or failed; the folder may be missing until the first shard starts.
    """
    require_known("out", out)
    with opened_run(Path(out)) as run:
        return run.wait() if wait else run.states()


def plan(  # noqa: PLR0913 - as in `generate`
    recipe: str | Path,
    data: str | Path,
    out: str | Path | None = None,
    *,
    limit: int | None = None,
    selection: FrameSelection = ALL_FRAMES,
    seed: int = 0,
    settings: Settings = (),
    reading: Reading = READ_ALL,
    execution: Execution = DEFAULT_EXECUTION,
    existing: Existing = "refuse",
    shard: ShardRequest | None = None,
    price_per_core_hour: float | None = None,
) -> PlanReport:
    """Return what `generate` with the same arguments would write, without writing it.

    With `shard`, times are those of one shard and of merging. `price_per_core_hour`, in any currency, adds the cost.

    >>> plan("hit-uav-drone", "hit-uav").facts["frames"]
    8
    """
    folder = None if out is None else Path(out)
    chosen = selection if limit is None else replace(selection, limit=limit)
    request = RunRequest(recipe, Path(data), folder, chosen, seed, settings, reading, execution, existing, shard)
    return PlanReport(describe_run(request, price_per_core_hour))


def rerender(
    run: str | Path,
    frame_id: str,
    out: str | Path | None = None,
    *,
    data: str | Path | None = None,
    overwrite: bool = False,
) -> Path:
    """Render the frame `<split>/<background>_c<k>` of a run again, with the same bytes; return the picture's path.

    By default the picture goes to the current folder. `data` is the folder of the backgrounds, if it has moved.
    """
    folder = None if data is None else Path(data)
    return rerender_frame(Path(run), frame_id, None if out is None else Path(out), folder, overwrite=overwrite)


def show(run: str | Path, frame_id: str) -> dict[str, object]:
    """Return the record of a frame of a run as JSON values: scene, labels and decisions; or why it failed."""
    return show_frame(Path(run), frame_id)


def exclude(
    run: str | Path,
    frames: Sequence[str] = (),
    *,
    review: str | Path | None = None,
    reason: str = BY_HAND,
    purge: bool = False,
    data: str | Path | None = None,
    on_progress: OnProgress | None = None,
) -> ChoiceReport:
    """Leave frames of a finished run out of its labels, splits, card and counts; their pictures move to `run/excluded`.

    `frames` are ids of frames (`test/a_c0`), or of backgrounds for all of their frames; `data` is the folder of the
    backgrounds, if it has moved. `ExclusionRequest` explains the other arguments.
    """
    choice = ExclusionRequest(
        tuple(frames), review=None if review is None else Path(review), reason=reason, purge=purge
    )
    return choose_frames(Path(run), choice, None if data is None else Path(data), on_progress)


def include(
    run: str | Path,
    frames: Sequence[str] = (),
    *,
    every: bool = False,
    data: str | Path | None = None,
    on_progress: OnProgress | None = None,
) -> ChoiceReport:
    """Take excluded frames back, `every` one of them or those with these ids; purged ones are rendered again."""
    choice = ExclusionRequest(include=tuple(frames), include_all=every)
    return choose_frames(Path(run), choice, None if data is None else Path(data), on_progress)


def report(run: str | Path) -> Path:
    """Write the report of a finished run again, `run/report.html`, and return its path; `generate` writes it, too."""
    from infrablend.pipeline.runs.record import report_run

    return report_run(Path(run))


def preview(
    run: str | Path, out: str | Path, count: int = 12, draw: Sequence[Draw] = ("boxes", "obb", "masks")
) -> Path:
    """Write a contact sheet of a run with its labels drawn and inserted objects enlarged; return its path."""
    from infrablend.report.preview import preview_run

    return preview_run(Path(run), Path(out), count, draw)


def preview_ground(run: str | Path, out: str | Path, count: int = 6, reading: Reading = READ_ALL) -> Path:
    """Write frames of a metric run with the ground grid and people of 1.7 m, to check the scale; return the path.

    In place of a run, a dataset whose pictures state pitch, height and lens is shown; `reading` says how to read it.
    """
    from infrablend.formats import dataset_folder
    from infrablend.report.ground_preview import data_ground_sheet, ground_sheet, is_data

    require_whole("count", count, 1)
    if not is_data(Path(run)):
        return ground_sheet(Path(run), Path(out), count)
    return data_ground_sheet(dataset_folder.read(Path(run), reading), Path(out), count)


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
