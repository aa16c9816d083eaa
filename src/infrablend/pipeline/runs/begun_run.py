"""How a run begins: in an empty folder, or with what an earlier call left there, checked against the plan.

Frames belong to one run only if the keys of both runs are equal.
"""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from infrablend.core.ledger import LEDGER, DoneFrame, Ledger
from infrablend.core.run_folder import EXCLUDED, RunFolder
from infrablend.core.run_record import RunRecord
from infrablend.core.typed_command import COMMAND, command_facts
from infrablend.core.workspace import Workspace
from infrablend.errors import OtherSettingsError
from infrablend.formats.pictures.images import output_suffix
from infrablend.pipeline.plans.backgrounds import dataset_levels, recorded_levels
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.runs.exports import lost_exports, require_nothing_added
from infrablend.pipeline.runs.record import RunState, recorded_versions

log = logging.getLogger(__name__)

Choose = Callable[[Mapping[str, str]], Mapping[str, str]]
"""Returns the frames to leave out from now on, each with its reason, from those that are left out now."""


@dataclass(frozen=True)
class Choice:
    """Change of the frames that are left out of a finished run.

    Attributes:
        choose: Called while no other process can change them.
        purge: Whether to delete the pictures of all frames that are left out then.
    """

    choose: Choose
    purge: bool = False


@dataclass(frozen=True, eq=False)
class EarlierRun:
    """What an earlier call left of a run, and what is to do now.

    Attributes:
        plan: Plan of the run, with its identity and levels as they were recorded.
        record: Its record.
        done: Frames that have a picture, by id.
        excluded: Frames that are left out from now on, each with its reason.
        todo: Frames to make: without a picture, or of a background that has changed.
        is_same: Whether nothing is to do but to return the report of the earlier call.
    """

    plan: RunPlan
    record: RunRecord
    done: Mapping[str, DoneFrame]
    excluded: Mapping[str, str]
    todo: Sequence[PlannedFrame]
    is_same: bool


@dataclass(frozen=True, eq=False)
class BegunRun:
    """A run whose ledger is open; it is written by this process alone.

    Attributes:
        plan: Plan of the frames that are not left out.
        folder: Its folder, until it is complete a workspace.
        ledger: Its ledger.
        header: What its record says before its first frame.
        todo: Frames to make.
        state: Counts, updated with each frame.
        is_new: Whether this call began it.
    """

    plan: RunPlan
    folder: RunFolder
    ledger: Ledger
    header: RunRecord
    todo: Sequence[PlannedFrame]
    state: RunState
    is_new: bool

    @property
    def finished_frames(self) -> list[PlannedFrame]:
        """Frames with a picture, in the order of the plan."""
        return [f for f in self.plan.frames if f.frame_id not in self.state.unfinished]


def find_earlier(space: Workspace, plan: RunPlan, execution: Execution, choice: Choice | None) -> EarlierRun | None:
    """Return what an earlier call left of a run in an open workspace; None if there is nothing.

    Raises:
        OtherSettingsError: It is of another recipe, data or seed, or of another renderer.
        OutputError: Its labels have to be written again, which would delete files that somebody put beside them.
    """
    folder = RunFolder(space.folder)
    if not (folder.root / LEDGER).is_file():
        return None
    with Ledger.open(folder.root) as ledger:
        record = ledger.read_run()
        _require_same_run(record, plan, space.out, execution)
        plan = replace(plan, run=str(record["run"]), levels=recorded_levels(record.get("levels")))
        done = ledger.done()
        before = ledger.excluded()
        excluded = dict(before if choice is None else choice.choose(before))
        todo = _remaining(plan, folder, ledger, done, excluded)
        exported = list(plan.recipe.output.formats) == record["formats"] and not lost_exports(folder, ledger)
    is_same = False
    if space.state == "complete":
        chosen = excluded != before or (choice is not None and choice.purge)
        is_same = not todo and not chosen and (exported or plan.shard is not None)
        if todo:
            named = ", ".join(f.frame_id for f in todo[:3])
            log.warning("%d frames were missing, damaged or failed, and are made again: %s", len(todo), named)
        if not is_same:
            require_nothing_added(folder, plan)
    return EarlierRun(plan, record, done, excluded, todo, is_same)


def begin_run(space: Workspace, plan: RunPlan, header: RunRecord) -> BegunRun:
    """Begin a run in an empty workspace; `header` is what its record says before its first frame."""
    header = {**header, **_command({}, choosing=False)}
    ledger = Ledger.create(space.folder, header)
    return BegunRun(plan, RunFolder(space.folder), ledger, header, plan.frames, RunState(), is_new=True)


def go_on(space: Workspace, earlier: EarlierRun, header: RunRecord, choice: Choice | None) -> BegunRun:
    """Open the ledger of an earlier call again, with the frames that are left out from now on put aside."""
    space.reopen()
    folder = RunFolder(space.folder)
    header = {**header, **_command(earlier.record, choice is not None)}
    ledger = Ledger.open(folder.root, write=True)
    with contextlib.ExitStack() as unusable:
        unusable.callback(ledger.close)
        ledger.write_run({**earlier.record, **header})
        ledger.exclude(earlier.excluded)
        _place_excluded(folder, earlier.done, earlier.excluded, purge=choice is not None and choice.purge)
        unusable.pop_all()
    frames = tuple(f for f in earlier.plan.frames if f.frame_id not in earlier.excluded)
    again = {f.frame_id for f in earlier.todo}
    kept = [earlier.done[f.frame_id] for f in frames if f.frame_id not in again]
    state = RunState(
        excluded=len(earlier.plan.frames) - len(frames),
        resumed=len(kept),
        inserted=sum(frame.inserted for frame in kept),
    )
    return BegunRun(replace(earlier.plan, frames=frames), folder, ledger, header, earlier.todo, state, is_new=False)


def with_levels(plan: RunPlan) -> RunPlan:
    """Return a plan with the range of grey levels of the dataset, measured now if the recipe needs it.

    Raises:
        DatasetError: It cannot be measured.
    """
    if plan.levels is None and plan.needs_levels:
        return replace(plan, levels=dataset_levels(plan))
    return plan


def _command(previous: RunRecord, choosing: bool) -> RunRecord:
    """Return the command line for the record of an unfinished run; a choice of frames keeps that of the run."""
    facts = {} if choosing else command_facts()
    if facts:
        return {"command": facts[COMMAND]}
    return {"command": previous["command"]} if "command" in previous else {}


def _remaining(
    plan: RunPlan, folder: RunFolder, ledger: Ledger, done: Mapping[str, DoneFrame], excluded: Mapping[str, str]
) -> list[PlannedFrame]:
    """Return the frames to make: those without a picture of the recorded size, or whose background has changed."""
    known = ledger.backgrounds()
    unchanged = dict[str, bool]()
    output = plan.recipe.output
    todo = []
    for frame in plan.frames:
        if frame.frame_id in excluded:
            continue
        row = done.get(frame.frame_id)
        name = frame.background_id
        image = frame.image_path(output.group_by, output_suffix(frame.background.path, output.image))
        if row is None or row.image != image or not folder.has_picture(row):
            todo.append(frame)
            continue
        if name not in unchanged:
            unchanged[name] = name in known and known[name].is_still(frame.background.path)
        if not unchanged[name]:
            log.warning("%s: the background has changed since the frame was made; making it again", frame.frame_id)
            todo.append(frame)
    return todo


def _place_excluded(
    folder: RunFolder, done: Mapping[str, DoneFrame], excluded: Mapping[str, str], *, purge: bool
) -> None:
    """Move the pictures of excluded frames to `excluded/`, and those of other frames back."""
    if not excluded and not (folder.root / EXCLUDED).is_dir():
        return
    for frame_id, frame in done.items():
        here = folder.image(frame.image)
        aside = folder.excluded(frame.image)
        left_out = frame_id in excluded
        source, target = (here, aside) if left_out else (aside, here)
        if source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            source.replace(target)
        if left_out and purge:
            aside.unlink(missing_ok=True)
    root = folder.root / EXCLUDED
    for path in sorted((root, *root.rglob("*")), reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def _require_same_run(previous: RunRecord, plan: RunPlan, out: Path, execution: Execution) -> None:
    """Refuse to resume if frames would differ; warn if they might."""
    machine = previous["machine"]
    renderer = execution.renderer
    device = execution.device
    if machine["renderer"] != renderer:
        raise OtherSettingsError(f"{out}: was rendered with {machine['renderer']}, not {renderer}; use another --out")
    if machine["device"] != device:
        was = machine["device"]
        log.warning(
            "%s: started with --device %s, resumed with %s; devices may differ by one grey level", out, was, device
        )
    versions = previous["packages"]
    installed = recorded_versions(execution)
    for name in sorted(n for n in installed if versions.get(n, installed[n]) != installed[n]):
        log.warning("%s: started with %s %s, resumed with %s", out, name, versions[name], installed[name])
    require_same_key(previous, plan, out)


_BACKGROUNDS = "backgrounds"
_SHOWN = 3


def differences(
    earlier: Mapping[str, object],
    key: Mapping[str, object],
    asked_earlier: Mapping[str, object] | None = None,
    asked: Mapping[str, object] | None = None,
) -> list[str]:
    """Return a text per field in which the key of a run differs from an earlier one; empty if they are equal.

    Args:
        earlier: Key of the earlier run (`RunPlan.key`).
        key: Key of the run.
        asked_earlier: How the earlier run read its backgrounds and chose frames (`RunPlan.request`), which
            explains other backgrounds; None if it is not known.
        asked: The same of the run.
    """
    was, now = _comparable(earlier), _comparable(key)
    texts = []
    asked_texts = _asked_differences(asked_earlier, asked)
    for k in sorted(k for k in now if was.get(k) != now[k]):
        if k == _BACKGROUNDS:  # digests, which nobody can compare by eye
            texts += asked_texts or ["the backgrounds, their labels or their metadata have changed"]
        elif isinstance(now[k], Mapping):
            fields = _differing_fields(was.get(k, {}), now[k], k)
            texts += [f"{name} was {a!r}, is {b!r}" for name, a, b in fields]
        else:
            texts.append(f"{k} was {_short(was.get(k))}, is {_short(now[k])}")
    return list(dict.fromkeys(texts))


def require_same_key(previous: Mapping[str, Any], plan: RunPlan, out: Path | str) -> None:
    """Check that the record of an earlier run, or of a shard, is of the run that is planned.

    Raises:
        OtherSettingsError: It is of another run; the message lists the differences.
    """
    if texts := differences(previous.get("key", {}), plan.key, previous.get("request"), plan.request):
        raise OtherSettingsError(
            f"{out}: cannot be resumed because this is a different run: {'; '.join(texts)}. "
            "Use the same recipe, data, seed, splits and choice of frames, or --overwrite, or another --out."
        )


def _asked_differences(earlier: Mapping[str, object] | None, asked: Mapping[str, object] | None) -> list[str]:
    if earlier is None or asked is None:
        return []
    return [
        f"{path.rpartition('.')[2]} was {_short(was)}, is {_short(now)}"
        for name in ("reading", "selection")
        for path, was, now in _differing_fields(_plain(earlier.get(name, {})), _plain(asked.get(name, {})), name)
    ]


def _plain(values: Any) -> Any:
    return json.loads(json.dumps(values, default=str))


def _short(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, list) and len(value) > _SHOWN:
        return f"{len(value)} ({', '.join(map(str, value[:_SHOWN]))}, ...)"
    return ", ".join(map(str, value)) if isinstance(value, list) else repr(value)


def _comparable(key: Mapping[str, object]) -> dict[str, object]:
    comparable = dict(key)
    recipe = key.get("recipe")
    if isinstance(recipe, Mapping):
        comparable["recipe"] = {k: v for k, v in recipe.items() if k != "description"}
    return comparable


def _differing_fields(was: Any, now: Any, path: str) -> Iterator[tuple[str, Any, Any]]:
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for k in sorted({*was, *now}):
            yield from _differing_fields(was.get(k), now.get(k), f"{path}.{k}")
    elif was != now:
        yield path, was, now
