"""Writes an output folder in a workspace beside it, and gives it its name when it is complete.

    OUT/                 complete, or not there
    .OUT.partial/        the workspace: being written, or left by a command that was interrupted
    .OUT.replaced/       the folder that --overwrite replaces, until it is deleted
    .OUT.partial.lock    locked by the process that writes, and removed by it

So what stands under the name that the user gave is complete, and nothing unfinished is read by mistake. Where OUT
cannot be renamed (a mount point, the working folder, a parent that may not be written), `.partial` and `.replaced` are
inside OUT, and the finished parts are moved out of `.partial` one by one, the record last.

Every command that writes a folder goes through `workspace`, so that the same rules and messages apply to all of them:

* A folder that is new or empty is always accepted.
* A folder with something in it is only replaced if the user asked for it (`overwrite`), if it has the record of this
  command, and if nothing was added to it since.
* One process at a time writes a folder.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from infrablend import __version__
from infrablend.core.addresses import require_folder
from infrablend.core.file_names import real_path
from infrablend.core.files import output_error, read_object, write_json
from infrablend.core.operating_system import hold, is_held
from infrablend.core.typed_command import command_facts, recorded_command
from infrablend.errors import BusyError, OutputError

log = logging.getLogger(__name__)

Existing = Literal["refuse", "resume", "overwrite"]
"""What to do with an output folder that already has results: refuse it, finish them, or replace them."""

CONTENTS = "contents"
"""Field of a record with the names at the top of its folder and the number of files below it."""

# Names of records, by which readers know the folders of other commands.
CONVERT_FILE = "convert.json"
SPLIT_FILE = "split.json"
WORLD_FILE = "world.json"
SOURCE_FILE = "SOURCE.json"
FRAMES_FILE = "frames.json"
TEMPERATURES_FILE = "temperatures.json"
PLACES_FILE = "places.json"
MOTION_FILE = "motion.json"
DETECT_FILE = "detect.json"

NOTE = ".workspace.json"
"""Note in a workspace: what it is for, and the command that finishes it."""
_OWN = frozenset({NOTE, ".partial", ".partial.lock", ".replaced"})
_SHOWN = 4


@dataclass
class Workspace:
    """An output folder while a command writes it.

    Attributes:
        out: The folder that the user gave, with links followed.
        folder: Where to write now, and to read what an earlier call left.
        noun: Name of what the command writes, such as `run`, for messages.
        record: File name of the record that the finished folder has, a JSON object.
        state: What was found: `new` (nothing), `started` (the workspace of an interrupted call), or `complete` (a
            finished folder, which `folder` names until `reopen`).
        derived: Names at the top of the finished folder that other commands may add, and `overwrite` may delete.
    """

    out: Path
    folder: Path
    noun: str
    record: str
    state: Literal["new", "started", "complete"]
    derived: frozenset[str] = frozenset()

    @property
    def partial(self) -> Path:
        """Folder to write in, whether it is there or not."""
        return partial_of(self.out)

    def finish(self, facts: Mapping[str, object]) -> None:
        """Write the record with these facts, the last file; the folder gets its name at the end of the `with` block."""
        (self.folder / self.record).unlink(missing_ok=True)
        left_out = {*_OWN, *self.foreign}
        names = sorted({*(p.name for p in self.folder.iterdir()), self.record} - left_out)
        contents = {"names": names, "files": _count_files(self.folder, left_out) + 1}
        data = {"infrablend": __version__, **facts, CONTENTS: contents}
        write_json(self.folder / self.record, data, indent=2, durable=True)

    def reopen(self) -> None:
        """Make a workspace of a finished folder again, in order to change it; its record has to be written again."""
        if self.state != "complete":
            return
        own = (read_object(self.out / self.record) or {}).get(CONTENTS, {}).get("names", ())
        foreign = sorted({p.name for p in self.out.iterdir()} - {*own, *_OWN})
        with _reported(self.out):
            if self.partial.parent == self.out:
                _move_entries(self.out, self.partial, first=self.record)
            else:
                self.partial.rmdir()
                self.out.rename(self.partial)
        self.folder = self.partial
        self.state = "started"
        _write_note(self.folder, self.noun, foreign=foreign)
        (self.folder / self.record).unlink()

    @property
    def foreign(self) -> frozenset[str]:
        """Names at the top of a reopened folder that others put there, such as a review: they are left alone."""
        return frozenset((read_object(self.partial / NOTE) or {}).get("foreign", ()))

    def clear(self, keep: Iterable[str]) -> None:
        """Delete what is in the workspace but for these names and foreign ones."""
        names = {p.name for p in sorted(self.folder.iterdir())} - {*keep, *self.foreign, NOTE}
        with _reported(self.folder):
            for name in sorted(names):
                path = self.folder / name
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink()

    def discard(self) -> None:
        """Delete the workspace: nothing of this call is worth keeping."""
        shutil.rmtree(self.partial, ignore_errors=True)

    def _is_finished(self) -> bool:
        """Return whether the workspace has its record, which is written last."""
        return CONTENTS in (read_object(self.partial / self.record) or {})

    def _publish(self) -> None:
        """Give the folder its name; after a kill, the next call goes on from here."""
        out = self.out
        partial = self.partial
        replaced = _replaced_of(self.out)
        replaces = bool((read_object(partial / NOTE) or {}).get("replaces"))
        with _reported(out):
            if partial.parent == out:
                if replaces:
                    replaced.mkdir(exist_ok=True)
                    _move_entries(out, replaced, first=self.record)
                    _write_note(partial, self.noun)
                _move_entries(partial, out, last=self.record)
                (partial / NOTE).unlink(missing_ok=True)
                partial.rmdir()
            else:
                if out.is_dir() and replaces:
                    out.rename(replaced)
                elif out.is_dir():
                    out.rmdir()  # an empty folder; one with files has appeared meanwhile, and is not touched
                partial.rename(out)
                (out / NOTE).unlink(missing_ok=True)
        shutil.rmtree(replaced, ignore_errors=True)


@contextlib.contextmanager
def workspace(
    out: Path,
    noun: str,
    record: str,
    existing: Existing = "refuse",
    *,
    keep: bool = False,
    derived: Collection[str] = (),
) -> Iterator[Workspace]:
    """Yield the workspace of an output folder, locked for this process.

    After `Workspace.finish`, the folder gets its name at the end of the block. If the block fails, or ends without
    `finish`, the workspace is deleted, or kept for `resume`, and what stood under the name stays as it was.

    Args:
        out: Folder to write.
        noun: Name of what the command writes, for messages.
        record: File name of its record.
        existing: What to do with what is there; `resume` only with `keep`.
        keep: Whether a later call can finish what this one leaves.
        derived: Names at the top of the finished folder that other commands may add, and `overwrite` may delete.

    Raises:
        ArgumentError: `out` is an address of object storage.
        BusyError: Another process writes the folder.
        OutputError: The folder has something that may not be replaced, or it cannot be written.
    """
    require_existing(existing)
    require_folder("out", out)
    root = real_path(out)
    if os.path.lexists(root) and not root.is_dir():
        found = "a link that leads nowhere" if root.is_symlink() else "a file"
        raise OutputError(f"{out}: is {found}; expected a folder, or a name that does not exist yet")
    partial = partial_of(root)
    with _locked(partial, noun):
        space = Workspace(root, partial, noun, record, "new", frozenset(derived))
        if space._is_finished():  # killed while it got its name
            space._publish()
            partial.mkdir()
        with _reported(root):
            (root / NOTE).unlink(missing_ok=True)  # left by a kill right after the folder got its name
        if (_replaced_of(root) / record).exists():
            shutil.rmtree(_replaced_of(root), ignore_errors=True)
        try:
            _open(space, existing, keep)
            log.info("%s: written in %s until it is complete", out, partial)
            yield space
            if space._is_finished():
                space._publish()
        finally:
            left = {p.name for p in sorted(partial.iterdir())} if partial.is_dir() else set()
            foreign = left and NOTE not in left
            if not left - {NOTE} or not (foreign or keep or space._is_finished()):
                space.discard()


def replacing(overwrite: bool) -> Existing:
    """Return what to do with earlier output for commands that cannot resume."""
    return "overwrite" if overwrite else "refuse"


def require_existing(existing: Existing) -> None:
    """Check that a value is one of `Existing`; an `OutputError` if not."""
    if existing not in get_args(Existing):
        raise OutputError(f"existing: found {existing!r}, expected refuse, resume or overwrite")


def partial_of(out: Path) -> Path:
    """Return the workspace of an output folder: a sibling, or a folder in it where it cannot be renamed."""
    root = real_path(out)
    inside = root / ".partial"
    if root.is_dir():
        here = real_path(Path())
        fixed = os.path.ismount(root) or root == here or root in here.parents
        if fixed or inside.is_dir() or not os.access(root.parent, os.W_OK):
            return inside
    return root.with_name(f".{root.name}.partial")


def unfinished(out: Path) -> str | None:
    """Return where an unfinished output folder is and how to finish it, for messages; None if there is none."""
    partial = partial_of(out)
    note = read_object(partial / NOTE)
    if note is None:
        return None
    command = recorded_command(note, out) or "repeat its command"
    return f"an unfinished {note.get('noun', 'folder')} is in {partial}; finish it, or make it again: {command}"


def is_being_written(out: Path) -> bool:
    """Return whether a process is writing an output folder, as far as its file system has locks."""
    return is_held(_lock_of(partial_of(out)))


def _require_own(space: Workspace, *, replaced: bool) -> None:
    """Check that the folder has the record of this command and, if it is replaced, nothing that others put there."""
    root = space.out
    noun = space.noun
    found = read_object(root / space.record) or {}
    contents = found.get(CONTENTS)
    if "infrablend" not in found or not isinstance(contents, Mapping):
        raise OutputError(
            f"{root}: not empty and not a {noun} of InfraBlend (no {space.record} that it wrote); nothing was touched. "
            "Give another folder."
        )
    if not replaced:
        return
    left_out = {*_OWN, *space.derived}
    # Anybody may have edited the record: what it does not say plainly was not written.
    listed = contents.get("names")
    number = contents.get("files")
    names = {str(name) for name in listed} if isinstance(listed, list) else set()
    foreign = sorted({p.name for p in root.iterdir()} - names - left_out)
    count = _count_files(root, left_out)
    written = number if isinstance(number, int) else 0
    if foreign or count > written:
        what = _listed(foreign) if foreign else f"{count} files, where the {noun} had {written}"
        raise OutputError(
            f"{root}: contains files that are not part of the {noun} ({what}); nothing was touched. Move them "
            "elsewhere, or give another folder."
        )


def _open(space: Workspace, existing: Existing, keep: bool) -> None:
    root = space.out
    partial = space.partial
    entries = sorted({p.name for p in root.iterdir()} - _OWN) if root.is_dir() else []
    left = sorted(p.name for p in partial.iterdir())
    started = (partial / NOTE).is_file()
    if left and not started:
        raise OutputError(f"{partial}: expected the workspace of InfraBlend, found {_listed(left)}. Move it away.")
    if existing == "refuse" and (entries or (started and keep)):
        raise _refused(space, entries, keep)
    if existing == "resume" and started:
        space.state = "started"
        return
    if entries:
        _require_own(space, replaced=existing == "overwrite")
    if existing == "resume" and entries:
        space.folder = root
        space.state = "complete"
        return
    space.clear(keep=())
    _write_note(partial, space.noun, replaces=bool(entries))


def _refused(space: Workspace, entries: list[str], keep: bool) -> OutputError:
    found = f"not empty (found {_listed(entries)})" if entries else f"an unfinished {space.noun} is in {space.partial}"
    ways = ['--resume (existing="resume" in Python) to finish an interrupted one'] if keep else []
    argument = 'existing="overwrite"' if keep else "overwrite=True"
    ways.append(f"--overwrite ({argument} in Python) to replace an earlier {space.noun}")
    return OutputError(
        f"{space.out}: {found}; expected an empty or new folder. Use {', '.join(ways)}, or give another folder."
    )


def _lock_of(partial: Path) -> Path:
    return partial.with_name(partial.name + ".lock")


@contextlib.contextmanager
def _locked(partial: Path, noun: str) -> Iterator[None]:
    """Make a workspace, and lock it until the end of the block."""
    with contextlib.ExitStack() as lock:
        try:
            partial.parent.mkdir(parents=True, exist_ok=True)
            lock.enter_context(hold(_lock_of(partial)))
            partial.mkdir(exist_ok=True)
        except BlockingIOError as error:
            raise BusyError(
                f"{partial}: another process is writing this {noun}; wait for it to end, or give another folder"
            ) from error
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(f"{partial}: cannot be written ({reason}); expected a folder you may write to") from error
        yield


@contextlib.contextmanager
def _reported(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise output_error(path, error) from error


def _move_entries(source: Path, target: Path, *, first: str = "", last: str = "") -> None:
    """Move what is in a folder to another one; the record comes first or last: it marks what is complete."""
    names = {p.name for p in sorted(source.iterdir())} - _OWN
    for name in sorted(names, key=lambda name: (name != first, name == last, name)):
        (source / name).rename(target / name)


def _replaced_of(root: Path) -> Path:
    partial = partial_of(root)
    return partial.with_name(f"{partial.name.removesuffix('partial')}replaced")


def _write_note(folder: Path, noun: str, *, replaces: bool = False, foreign: Sequence[str] = ()) -> None:
    note = {"noun": noun, "replaces": replaces, "foreign": list(foreign), **command_facts()}
    with _reported(folder):  # in place: a temporary file would be left by a kill
        (folder / NOTE).write_text(json.dumps(note), "utf-8")


def _count_files(root: Path, left_out: Collection[str] = _OWN) -> int:
    """Return the number of files below a folder, without those of a workspace in it, or of other names at its top."""
    count = 0
    for folder, subfolders, names in os.walk(root):
        if folder == str(root):
            subfolders[:] = sorted({*subfolders} - {*left_out})
            names = sorted({*names} - {*left_out})
        count += len(names)
    return count


def _listed(names: list[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (" ..." if len(names) > _SHOWN else "")
