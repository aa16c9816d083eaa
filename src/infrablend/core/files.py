"""Writes files atomically, with clear errors where a file cannot be written; per-user folders; files of the package.

Per-user folders are outside of any project, for downloads, imported geometry and the log. They follow the platform's
rules (on Linux `$XDG_CACHE_HOME`, else `~/.cache`, and `$XDG_STATE_HOME`, else `~/.local/state`).
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import re
import shutil
import stat
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from importlib.resources.abc import Traversable
from io import BufferedReader
from pathlib import Path
from typing import Any

import platformdirs

from infrablend.core.addresses import require_folder
from infrablend.core.file_names import MAX_NAME_BYTES, leaves_folder
from infrablend.core.operating_system import READ_FLAGS, flush_file
from infrablend.errors import OutputError, Problem

# Errors of os.link where hard links are not supported or not allowed; any other error is real.
_NO_LINK = {errno.EXDEV, errno.EPERM, errno.EACCES, errno.EMLINK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}


NAME_TOO_LONG = "name-too-long"

LFS_POINTER = b"version https://git-lfs"
"""Start of the small text that Git leaves in place of a file that is stored with Git LFS."""
LFS_FOUND = "a pointer of Git LFS in place of the file"
LFS_TODO = "run `git lfs pull` in its repository"

_MARK = 10  # digits of the digest in a temporary name


def part_path(path: Path) -> Path:
    """Return the temporary path of a file while it is being written: hidden, in the same folder.

    The path keeps the suffix, which some writers require. It is always the same, so the next write replaces what a
    killed process left behind. A digest of the name is part of it, so that no file of somebody else is taken for that.
    Where the name would be too long for a file system, the digest alone is the stem.
    """
    digest = hashlib.sha256(os.fsencode(path.name)).hexdigest()
    name = f".{path.stem}.{digest[:_MARK]}.part{path.suffix}"
    if len(os.fsencode(name)) > MAX_NAME_BYTES:
        name = f".{digest}.part{path.suffix}"
    return path.with_name(name)


def sha256_of(path: Path, folder: Path | None = None) -> str:
    """Return the hexadecimal SHA-256 of a file; the arguments and errors are those of `open_regular`."""
    with open_regular(path, folder) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def sha256_of_json(value: Any) -> str:
    """Return the hexadecimal SHA-256 of a JSON value, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def output_error(path: Path, error: OSError) -> OutputError:
    """Return the `OutputError` for a failed write of `path`."""
    if error.errno == errno.ENAMETOOLONG:
        todo = "rename the source's picture, or give a shorter folder"
        long = Problem(str(path), NAME_TOO_LONG, f"a name of {len(path.name)} characters", "a shorter name", todo)
        return OutputError(f"cannot write {path}: the name is too long for the file system", [long])
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    todo = "free some space and run again with --resume" if full else "check the folder and its permissions"
    reason = error.strerror or str(error)
    problem = Problem(
        str(path), "disk-full" if full else "not-writable", reason, "a writable folder with free space", todo
    )
    return OutputError(f"cannot write {path}: {reason}", [problem])


def existing_part(folder: Path) -> Path:
    """Return a folder, or the nearest one above it that exists."""
    return next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())


def has_size(path: Path, size: int) -> bool:
    """Return whether there is a file with this number of bytes."""
    try:
        return path.lstat().st_size == size
    except OSError:
        return False


def free_bytes(folder: Path) -> int:
    """Return the free disk space where a folder is, or will be."""
    return shutil.disk_usage(existing_part(folder)).free


def require_free_space(
    folder: Path, need_bytes: float, what: str, todo: str = "free some space, or choose a folder on another disk"
) -> None:
    """Raise OutputError if the disk of a folder has less free space than `what` needs."""
    if (free := free_bytes(folder)) < need_bytes:
        found = f"{free / 1e9:.2f} GB free"
        expected = f"at least {need_bytes / 1e9:.2f} GB"
        problem = Problem(str(folder), "disk-full", found, expected, todo)
        raise OutputError(f"{folder}: not enough disk space for {what}", [problem])


@contextlib.contextmanager
def replace_atomically(path: Path, *, beside: Path | None = None, durable: bool = False) -> Iterator[Path]:
    """Yield a temporary path; rename it to `path` when the block succeeds, remove it when the block fails.

    Args:
        path: File to write; its folder is created.
        beside: Temporary path in the same folder to use instead, if several processes may write the same file.
        durable: Flush to disk, so that the file survives a power cut. Costs milliseconds per file: too slow for
            thousands of label files.

    Raises:
        ArgumentError: The path is an address of object storage.
        OutputError: The folder cannot be written or the disk is full; `path` is then unchanged.
    """
    require_folder("out", path.parent)
    temporary = beside or part_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # An own leftover, or a link that writing would follow, or a pipe that it would wait for.
        temporary.unlink(missing_ok=True)
        yield temporary
        if durable:
            flush_file(temporary)
        temporary.replace(path)
        if durable:
            flush_file(path.parent)
    except BaseException as error:
        if not isinstance(error, FileExistsError):  # made by somebody else in this moment
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and not isinstance(error, OutputError):
            raise output_error(path, error) from error
        raise


def require_still_there(paths: Iterable[Path]) -> None:
    """Check that files and folders which a command wrote are still there at its end; an `OutputError` if not."""
    gone = [str(p) for p in paths if not p.exists()]
    if gone:
        expected = "the file that was written before"
        problems = [Problem(p, "output-removed", "no file", expected, "repeat the command") for p in gone]
        raise OutputError("output was removed while the command was running", problems)


def write_bytes(path: Path, data: bytes, *, durable: bool = False) -> Path:
    """Write `data` to `path` atomically; see `replace_atomically`."""
    with replace_atomically(path, durable=durable) as temporary, temporary.open("xb") as stream:
        stream.write(data)
    return path


def write_text(path: Path, text: str, *, durable: bool = False) -> Path:
    """Write UTF-8 text with LF line ends atomically; lone surrogates, which UTF-8 cannot hold, become escapes."""
    return write_bytes(path, text.encode("utf-8", "backslashreplace"), durable=durable)


def write_chunks(path: Path, chunks: Iterable[str]) -> Path:
    """Write text that comes in pieces atomically, like `write_text`; one piece is in memory at a time."""
    with replace_atomically(path) as temporary, temporary.open("xb") as stream:
        for chunk in chunks:
            stream.write(chunk.encode("utf-8", "backslashreplace"))
    return path


DAMAGED = (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError)
"""What reading fields of a record raises if the file or a field is missing, damaged or of another type."""


class NotRegularError(OSError):
    """A pipe or device where a regular file is expected."""


LINK_OUT = "a link out of its folder; expected a file inside it. Copy the file there"
"""What was found, what is expected and what to do; for messages that name the file."""


class LinkOutError(OSError):
    """A link out of the folder that owns the file."""

    def __str__(self) -> str:
        """Return what was found, what was expected and what to do; the caller names the file."""
        return str(self.strerror)


LARGEST_READ_BYTES = 1 << 30
"""Size of the largest file that is read at once; a sparse file of any size can be made in no time."""


@contextlib.contextmanager
def open_regular(path: Path, folder: Path | None = None) -> Iterator[BufferedReader]:
    """Open a file of a run, a conversion, an experiment or a model for reading: the only way to read one.

    Anybody may have edited the folder that it is in: a pipe would never end, nor would a link to `/dev/zero`, and a
    link out of the folder would bring in what nobody meant to give. A file that the user names may be a link to
    anywhere: give its `real_path`.

    Args:
        path: The file.
        folder: Folder that owns the file, within which it may be a link; by default the one that it is in.

    Raises:
        LinkOutError: It is a link out of the folder.
        NotRegularError: It is no regular file.
        OSError: It is missing or cannot be read.
    """
    if leaves_folder(path, folder):
        raise LinkOutError(errno.EPERM, LINK_OUT, str(path))
    handle = os.open(path, READ_FLAGS)
    with os.fdopen(handle, "rb") as stream:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise NotRegularError(errno.EINVAL, "not a regular file", str(path))
        yield stream


def read_regular(path: Path, folder: Path | None = None) -> bytes:
    """Return the content of a regular file; the arguments and errors are those of `open_regular`.

    Raises:
        OSError: Also if the file is larger than `LARGEST_READ_BYTES`; what may be larger is read in parts.
    """
    with open_regular(path, folder) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > LARGEST_READ_BYTES:
            raise OSError(errno.EFBIG, f"{size / 2**30:.1f} GiB; expected at most 1 GiB", str(path))
        return stream.read()


def or_lfs_pointer(problem: Problem, path: Path) -> Problem:
    """Return the problem of a file that cannot be read; it says so if a pointer of Git LFS is in its place."""
    with contextlib.suppress(OSError), open_regular(path) as stream:
        if stream.read(len(LFS_POINTER)) == LFS_POINTER:
            return replace(problem, found=LFS_FOUND, todo=LFS_TODO)
    return problem


def load_json(path: Path) -> Any:
    """Return the JSON value in a file.

    Raises:
        OSError: The file is missing, cannot be read, is no regular file, or is a link out of its folder.
        ValueError: It is not JSON, nested too deeply, or has a number that is not finite, which we never write.
    """
    data = read_regular(path)
    try:
        return json.loads(
            data.decode("utf-8"), parse_constant=_not_finite, parse_float=_finite if _LONG_NUMBER.search(data) else None
        )
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


# Only numbers with such an exponent, or as many digits, can be too large: looking at each number takes long.
_LONG_NUMBER = re.compile(rb"[eE]\+?\d{3}|\d{300}")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _not_finite(text)


def _not_finite(text: str) -> float:
    raise ValueError(f"{text[:40]}, which is not a finite number")


def read_object(path: Path) -> dict[str, Any] | None:
    """Return the JSON object in a file; None if it is missing, damaged or anything else."""
    try:
        data = load_json(path)
    except (OSError, ValueError):
        return None
    return data if isinstance(data, dict) else None


def finite(value: Any, losses: Counter[str]) -> Any:
    """Return the value with non-finite numbers, which JSON cannot hold, replaced by null and counted."""
    if isinstance(value, dict):
        return {k: finite(v, losses) for k, v in value.items()}
    if isinstance(value, list):
        return [finite(v, losses) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        losses["not_finite_dropped"] += 1
        return None
    return value


def write_json(path: Path, data: Any, *, indent: int | None = 1, durable: bool = False) -> Path:
    """Write `data` as JSON with sorted keys atomically; the same data gives the same bytes."""
    text = json.dumps(data, sort_keys=True, indent=indent, ensure_ascii=False, allow_nan=False)
    return write_text(path, text + "\n", durable=durable)


def link_or_copy(source: Path, target: Path) -> Path:
    """Make `target` a hard link to `source`, or a copy where links are impossible; atomic, creates folders."""
    try:
        real = Path(os.path.realpath(source))
        # Renaming one hard link over another of the same file does nothing, so handle this case first.
        if target.exists() and not target.is_symlink() and target.samefile(real):
            return target
    except OSError as error:
        raise output_error(target, error) from error
    with replace_atomically(target) as temporary:
        try:
            os.link(real, temporary)
        except OSError as error:
            if error.errno not in _NO_LINK:
                raise
            with real.open("rb") as stream, temporary.open("xb") as new:
                shutil.copyfileobj(stream, new, 1 << 20)
    return target


NAME = "infrablend"


def cache_folder() -> Path:
    """Return the folder for what can be downloaded or computed again: `$INFRABLEND_CACHE`, else the platform's."""
    own = os.environ.get("INFRABLEND_CACHE")
    return Path(own) if own else platformdirs.user_cache_path(NAME, appauthor=False)


def weights_folder() -> Path:
    """Return the folder for published weights of detectors."""
    return cache_folder() / "weights"


def state_folder() -> Path:
    """Return the folder for logs, which survive a restart but need no backup."""
    return platformdirs.user_state_path(NAME, appauthor=False)


@dataclass(frozen=True)
class ShippedFiles:
    """The YAML files of one kind.

    Attributes:
        noun: What one of them is called, such as `recipe`.
        folder: Their folder below the package.
    """

    noun: str
    folder: str

    @cached_property
    def names(self) -> list[str]:
        """Names without the suffix, sorted."""
        return sorted(p.name.removesuffix(".yaml") for p in self._folder.iterdir() if p.name.endswith(".yaml"))

    def text(self, name: str) -> str:
        """Return the text of one of them."""
        return (self._folder / f"{name}.yaml").read_text("utf-8")

    @property
    def _folder(self) -> Traversable:
        return resources.files("infrablend") / self.folder


RECIPES = ShippedFiles("recipe", "config/recipes")
