"""Excludes frames from a finished run and includes them again; labels, splits, card and counts follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.file_names import real_path
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import OnProgress
from infrablend.core.workspace import partial_of
from infrablend.errors import ArgumentError, OtherSettingsError, OutputError, Problem
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.selection import similar
from infrablend.pipeline.runs.begun_run import Choice
from infrablend.pipeline.runs.record import RecordedRun
from infrablend.pipeline.runs.review_file import read_verdicts
from infrablend.pipeline.runs.run import run_plan

BY_HAND = "by hand"


@dataclass(frozen=True)
class ExclusionRequest:
    """Change of the frames of a run.

    Attributes:
        exclude: Frames to leave out, by id; or backgrounds, for all of their frames.
        include: Frames to take back.
        include_all: Take back all frames.
        review: Review with accepted and rejected frames, to take back and leave out.
        reason: Reason for the excluded frames, kept in the ledger.
        purge: Delete the files of all excluded frames.
    """

    exclude: Sequence[str] = ()
    include: Sequence[str] = ()
    include_all: bool = False
    review: Path | None = None
    reason: str = BY_HAND
    purge: bool = False


@dataclass(frozen=True)
class ChoiceReport:
    """Frames of a run after a change.

    Attributes:
        out: Folder of the run.
        excluded: Excluded frames, each with its reason.
        changed: Number of frames that were left out or taken back by this call.
        purged_files: Number of deleted pictures.
        counts: Counts of the run, as in `run.json`.
        problems: Problems of data, frames and labels, if the labels were written again.
        ok: Whether no background was skipped and no frame failed, if the labels were written again.
    """

    out: Path
    excluded: Mapping[str, str]
    changed: int
    purged_files: int
    counts: Mapping[str, Any]
    problems: tuple[Problem, ...] = ()
    ok: bool = True

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "out": str(self.out),
            "excluded": dict(self.excluded),
            "changed": self.changed,
            "purged_files": self.purged_files,
            "counts": dict(self.counts),
            "problems": [p.to_json() for p in self.problems],
        }


def choose_frames(
    run: Path, choice: ExclusionRequest, data: Path | None = None, on_progress: OnProgress | None = None
) -> ChoiceReport:
    """Exclude and include frames of a finished run, and write its labels, card and record again.

    Frames that were purged are rendered again when they are taken back.

    Args:
        run: Folder of the run.
        choice: Frames to exclude and include.
        data: Folder of the backgrounds if they have moved.
        on_progress: Called after each frame that is rendered again.

    Raises:
        ArgumentError: A frame does not exist, or none would be left.
        OutputError: The folder is not a finished run, or another process writes to it.
        OtherSettingsError: The backgrounds have changed.
    """
    # An earlier change that was interrupted left its workspace.
    folder = _folder_of(run)
    record = folder.read_run()
    if "shard" in record:
        raise OutputError(f"{run}: one shard of a run; expected a whole run. Merge the shards first (infrablend merge)")
    if "counts" not in record:
        raise OutputError(f"{run}: an unfinished run; expected a finished one. Finish it: its command with --resume")
    recorded = RecordedRun.from_record(record, folder.run_file)
    plan = recorded.plan(data)
    before: Mapping[str, str] = {}
    after: Mapping[str, str] = {}

    def choose(now: Mapping[str, str]) -> Mapping[str, str]:
        nonlocal before, after
        before, after = now, _changed(now, choice, plan, run)
        _require_backgrounds(plan, _folder_of(run), after)  # it may have got its name since
        return after

    flat = recorded.renderer == "flat"
    execution = Execution(recorded.workers, device=recorded.device, renderer=recorded.renderer, in_process=flat)
    aside = _count_aside(folder)
    try:
        report = run_plan(plan, run, execution, "resume", on_progress, Choice(choose, choice.purge))
    except OtherSettingsError as error:
        raise OtherSettingsError(
            f"{run}: its backgrounds are read differently now, so labels cannot be written again; nothing was "
            f"changed. Restore them, or give their folder with --data. Details: {error.message}"
        ) from error
    changed = before.keys() ^ after.keys()
    purged = aside + len(after.keys() - before.keys()) - _count_aside(RunFolder(run)) if choice.purge else 0
    return ChoiceReport(run, after, len(changed), purged, report.counts, report.problems, report.ok)


def _folder_of(run: Path) -> RunFolder:
    return RunFolder(run if run.is_dir() else partial_of(run))


def _count_aside(folder: RunFolder) -> int:
    return sum(path.is_file() for path in folder.excluded("").rglob("*"))


def read_review(path: Path, run: Path) -> tuple[dict[str, str], set[str]]:
    """Return the rejected frames of a review, each with its reason, and the accepted ones.

    Args:
        path: The review; a file of the run may not be a link, any other may.
        run: Folder of the run.

    Raises:
        OutputError: The file cannot be read.
    """
    verdicts = read_verdicts(path if path.parent == run else real_path(path))
    rejected = {k: v.reason or "review" for k, v in verdicts.items() if v.word == "reject"}
    return rejected, {k for k, v in verdicts.items() if v.word == "accept"}


def _require_backgrounds(plan: RunPlan, folder: RunFolder, excluded: Mapping[str, str]) -> None:
    """Check that the finished frames that stay need not be rendered again: a choice of frames changes no picture.

    Raises:
        OtherSettingsError: Their backgrounds were changed or removed.
    """
    with folder.ledger() as ledger:
        known = ledger.backgrounds()
        done = ledger.done()
    kept = [f for f in plan.frames if f.frame_id in done and f.frame_id not in excluded]
    paths = {f.background_id: f.background.path for f in kept if f.background_id in known}
    other = {b for b, path in paths.items() if not known[b].is_still(path)}
    changed = [
        Problem(str(f.background.path), "background-changed", f"not the one that {f.frame_id} was made of")
        for f in kept
        if f.background_id in other
    ]
    if changed:
        raise OtherSettingsError(
            f"{len(changed)} frames would have to be rendered again on other backgrounds; nothing was changed. Restore "
            "the backgrounds, or render these frames again first: the command of the run with --resume",
            changed,
        )


def _changed(before: Mapping[str, str], choice: ExclusionRequest, plan: RunPlan, run: Path) -> dict[str, str]:
    rejected, accepted = ({}, set()) if choice.review is None else read_review(choice.review, run)
    of_background: dict[str, list[str]] = {}
    for frame in plan.frames:
        for name in (frame.background_id, frame.background.id):
            of_background.setdefault(name, []).append(frame.frame_id)
    # A frame may have the name of a background: `train/a_c0`, made of `train/a`, beside a background `a_c0`.
    frames = {frame.frame_id: [frame.frame_id] for frame in plan.frames}
    ids = {**of_background, **frames}
    wanted = [*choice.exclude, *choice.include, *rejected, *accepted]
    reviewed = {*rejected, *accepted}  # verdicts are on frames
    unknown = [name for name in wanted if name not in (frames if name in reviewed else ids)]
    if unknown:
        problems = [
            Problem(name, "frame-unknown", "no frame of the run has this id", f"an id such as {similar(name, ids)}")
            for name in unknown
        ]
        raise ArgumentError(f"{len(unknown)} of {len(wanted)} frames do not exist", problems)
    after = {} if choice.include_all else dict(before)
    for name in {*choice.include, *accepted}:
        for frame_id in ids[name]:
            after.pop(frame_id, None)
    for name, reason in {**rejected, **dict.fromkeys(choice.exclude, choice.reason)}.items():
        for frame_id in ids[name]:
            after[frame_id] = after.get(frame_id, reason)
    if len(after) >= len(plan.frames):
        raise ArgumentError("all frames of the run would be excluded; expected at least one to stay. Delete the run")
    return after
