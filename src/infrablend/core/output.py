"""Output folders of commands: claiming, resuming, overwriting and locking them.

Every command that writes a folder goes through `OutputFolder`, so that the same rules and
messages apply to all of them:

* A folder that is new or empty is always accepted.
* A non-empty folder is accepted only if the command's own record is there and the user asked to resume or
  to overwrite.
* Only names that the command wrote are deleted or replaced. Nothing is deleted through a symbolic link.
* One process at a time writes to a folder.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from infrablend.core.addresses import require_folder
from infrablend.core.file_names import real_path
from infrablend.core.files import output_error, read_object
from infrablend.errors import OutputError, Problem

log = logging.getLogger(__name__)

Existing = Literal["refuse", "resume", "overwrite"]
"""What to do with an output folder that already has results: refuse it, finish them, or replace them."""

_SHOWN = 4
_PROBE = ".writable"
_LOCK_ATTEMPTS = 3
_LOCK_PAUSE_S = 0.05


def require_existing(existing: Existing) -> None:
    """Check that a value is one of `Existing`.

    Raises:
        OutputError: It is not.
    """
    if existing not in get_args(Existing):
        raise OutputError(f"existing: found {existing!r}, expected refuse, resume or overwrite")


@dataclass(frozen=True)
class OutputFolder:
    """The output folder of a command.

    Attributes:
        root: Path of the folder.
        noun: Name of what the command writes, such as `run` or `conversion`, for messages.
        record: File name of the record that marks the folder as the command's own; empty if there is none.
        can_resume: True if the command can finish what an interrupted call left.
        can_overwrite: True if the command can replace what an earlier call wrote.

    Raises:
        ArgumentError: The folder is an address of object storage.
    """

    root: Path
    noun: str
    record: str = ""
    can_resume: bool = False
    can_overwrite: bool = False

    def __post_init__(self) -> None:
        require_folder("out", self.root)

    @contextlib.contextmanager
    def claimed(self) -> Iterator[Callable[[], None]]:
        """Create the folder and lock it; the lock is released when the block or the process ends.

        Yields:
            Function that raises an OutputError if the folder is now another one: what was locked has been moved away or
            removed, and another command may write to the new one. At the end of the block it is called, too.

        Raises:
            OutputError: Another process is writing to the folder, or it cannot be created.
        """
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            # The lock is on the folder itself and leaves no file behind.
            handle = os.open(self.root, os.O_RDONLY | os.O_DIRECTORY)
        except FileExistsError as error:
            raise self._not_a_folder() from error
        except (OSError, ValueError) as error:
            raise self._not_writable(error) from error
        try:
            try:
                _lock(handle)
            except BlockingIOError as error:
                raise OutputError(
                    f"{self.root}: another process is writing this {self.noun}; "
                    "wait for it to end, or give another folder"
                ) from error
            except OSError as error:  # file systems without locks
                log.warning("%s: cannot be locked (%s); do not let two commands write to it", self.root, error)

            def require_claim() -> None:
                self._require_same(handle)

            yield require_claim
            require_claim()
        finally:
            os.close(handle)

    def _require_same(self, handle: int) -> None:
        try:
            same = os.path.samestat(os.fstat(handle), self.root.stat())
        except OSError:  # a folder that is gone is noticed by what writes to it
            return
        if not same:
            raise OutputError(
                f"{self.root}: was moved or removed, and made again, while this {self.noun} was written; expected the "
                "folder to stay. Repeat the command with another folder, or when nothing else uses this one"
            )

    def is_claimed(self) -> bool:
        """Return whether a process is writing to the folder, as far as its file system has locks."""
        try:
            handle = os.open(self.root, os.O_RDONLY | os.O_DIRECTORY)
        except OSError:
            return False
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        finally:
            os.close(handle)
        return False

    def entries(self, *, ignore: Iterable[str] = ()) -> list[str]:
        """Return the names in the folder, sorted; empty if it does not exist.

        Raises:
            OutputError: It is a file, or a folder that may not be written.
        """
        if not self.root.exists() and not self.root.is_symlink():
            return []
        if not self.root.is_dir():
            raise self._not_a_folder()
        if not os.access(self.root, os.R_OK | os.W_OK | os.X_OK):
            raise OutputError(f"{self.root}: cannot be written; expected a folder you may write to")
        left_out = {*ignore, _PROBE}
        return sorted(p.name for p in self.root.iterdir() if p.name not in left_out)

    def require_empty(self, *, existing: Existing = "refuse", ignore: Iterable[str] = ()) -> list[str]:
        """Check that the folder is empty, unless the user asked to resume or overwrite; return its entries.

        Raises:
            OutputError: It is not empty and `existing` is `refuse`.
        """
        require_existing(existing)
        entries = self.entries(ignore=ignore)
        if entries and existing == "refuse":
            options = ['Use --resume (existing="resume" in Python) to finish an interrupted one'] * self.can_resume
            verb = "" if options else "Use "
            argument = 'existing="overwrite"' if self.can_resume else "overwrite=True"
            overwrite = f"{verb}--overwrite ({argument} in Python) to replace an earlier {self.noun}"
            options += [overwrite] * self.can_overwrite
            options += ["or give another folder" if options else "Give another folder"]
            raise OutputError(
                f"{self.root}: not empty (found {self._listed(entries)}); expected an empty or new folder. "
                f"{', '.join(options)}."
            )
        return entries

    def refuse_not_ours(self, why: str = "") -> OutputError:
        """Return the error for a folder whose contents the command did not write."""
        reason = why or (f"no {self.record}" if self.record else "")
        return OutputError(
            f"{self.root}: not empty and not a {self.noun} of InfraBlend{f' ({reason})' if reason else ''}; "
            "nothing was touched. Give another folder."
        )

    def require_only(self, own: Iterable[str], entries: Sequence[str]) -> None:
        """Check that the folder contains nothing but the names in `own`.

        Raises:
            OutputError: It contains something else; the message names it.
        """
        known = set(own)
        foreign = [e for e in entries if e not in known]
        if foreign:
            raise OutputError(
                f"{self.root}: contains files that are not part of the {self.noun} ({self._listed(foreign)}); "
                "nothing was touched. Move them elsewhere, or give another folder."
            )

    def read_record(self) -> Mapping[str, Any] | None:
        """Return the record, or None if there is none that is a JSON object."""
        return read_object(self.root / self.record)

    def remove(self, names: Iterable[str]) -> None:
        """Delete these names, in this order: files, links (not their targets), and folders with all that is in them.

        Raises:
            OutputError: A name leads out of the folder, or an entry cannot be deleted.
        """
        for name in names:
            if name in ("", ".", "..") or "/" in name or "\\" in name:
                raise self.refuse_not_ours(f"{name!r} is not a name in the folder")
            path = self.root / name
            try:
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink(missing_ok=True)
            except OSError as error:
                raise output_error(self.root, error) from error

    def make_writable(self) -> None:
        """Create the folder and check that files can be written to it.

        Raises:
            OutputError: The folder cannot be created or written to.
        """
        probe = self.root / _PROBE
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            probe.write_bytes(b"")
            probe.unlink()
        except OSError as error:
            raise self._not_writable(error) from error

    def _listed(self, names: Sequence[str]) -> str:
        return ", ".join(names[:_SHOWN]) + (" ..." if len(names) > _SHOWN else "")

    def _not_a_folder(self) -> OutputError:
        found = "a link that leads nowhere" if self.root.is_symlink() and not self.root.exists() else "a file"
        return OutputError(f"{self.root}: is {found}; expected a folder, or a name that does not exist yet")

    def _not_writable(self, error: Exception) -> OutputError:
        reason = getattr(error, "strerror", None) or error
        return OutputError(f"{self.root}: cannot be written ({reason}); expected a folder you may write to")


def _lock(handle: int) -> None:
    """Lock a folder.

    Raises:
        BlockingIOError: Another process holds the lock, and not just for a moment, as `is_claimed` does.
    """
    for _ in range(_LOCK_ATTEMPTS - 1):
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        time.sleep(_LOCK_PAUSE_S)
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def require_replaceable(path: Path, noun: str, *, ours: bool) -> None:
    """Check that a command may write this file: it does not exist, or an earlier call of the command wrote it.

    Args:
        path: File to write.
        noun: Name of what the command writes, for the message.
        ours: Whether the file, if it exists, carries the command's mark.

    Raises:
        OutputError: The path is a folder, or a file that the command did not write.
    """
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; expected the name of a file")
    if not ours and (path.exists() or path.is_symlink()):
        raise OutputError(
            f"{path}: exists and is not a {noun} of InfraBlend; nothing was touched. Give another file or folder."
        )


def require_no_foreign(foreign: Sequence[Path], out: Path, what: str, expected: str, option: str) -> None:
    """Refuse to replace files in a folder which InfraBlend did not write.

    Args:
        foreign: Such files, in the place of what the command writes.
        out: The folder.
        what: What the command writes, for the message.
        expected: What a file in its place may be.
        option: Option that names the folder.

    Raises:
        OutputError: There are some; the problems name them.
    """
    if foreign:
        todo = f"move it away, or give another folder with {option}"
        raise OutputError(
            f"{out}: files in the place of {what} were not written by InfraBlend",
            [Problem(str(p), "file-foreign", "another file", expected, todo) for p in foreign],
        )


def require_apart(data: Path, out: Path) -> None:
    """Check that a command does not write into the data it reads.

    Raises:
        OutputError: `out` is the data folder, contains it, or is inside it.
    """
    a, b = real_path(data), real_path(out)
    if a == b or b in a.parents:
        raise OutputError(f"--out {out}: is or contains the data folder {data}; choose a separate folder")
    if a in b.parents:
        raise OutputError(
            f"--out {out}: is inside the data folder {data}, which is never written to (and a later run would "
            "use its images as backgrounds); choose a folder outside it"
        )
