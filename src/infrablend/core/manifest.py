"""Manifest of an output folder: the files that InfraBlend wrote there, with their sizes and digests.

The manifest is a file of JSON lines that grows while files are written, so that it is right whenever a process is
killed: a line with the path before a file is begun, one with path, size and SHA-256 before it gets its name. Only
files that are in the manifest and unchanged are deleted or replaced; others are kept, and changed ones are moved aside.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import IO, Any

from infrablend.core.file_names import can_exist
from infrablend.core.files import observed_by, open_regular, output_error, part_path, sha256_of, write_text
from infrablend.core.log_file import part_from_links
from infrablend.errors import OutputError, Problem

REPLACED = "replaced"
"""Folder for files that somebody changed after InfraBlend wrote them and that a later call had to write again."""

JOURNAL = ".files.jsonl"
"""Usual name of the file of a manifest."""

_LONGEST_LINE_BYTES = 1 << 16  # a path of 4,096 bytes, each written as an escape, and its digest

_DIGEST = re.compile("[0-9a-f]{64}")

Content = tuple[int, str]
"""Size in bytes and SHA-256 of a file."""


class Manifest:
    """Files that InfraBlend wrote to one folder.

    Attributes:
        root: The folder; paths are relative to it, with `/`.
        moved: Files that were moved aside since the manifest was opened, by their new paths.
    """

    def __init__(
        self, root: Path, file: Path, aside: Path, ignored: Iterable[str] = (), recorded: Iterable[str] = ()
    ) -> None:
        """Open a manifest without reading it.

        Args:
            root: The folder.
            file: File of the manifest.
            aside: Folder for changed files.
            ignored: First parts of paths that are not recorded, e.g. because each file there has a record of its own.
            recorded: Paths that are recorded all the same.
        """
        self.root = root.absolute()
        self._file = file.absolute()
        self._aside = aside.absolute()
        self._ignored = {*ignored, self._file.relative_to(self.root).as_posix()}
        self._recorded = {*recorded}
        self._contents: dict[str, set[Content]] = {}
        self._digests: dict[tuple[int, int, int, int], str] = {}
        self._written: set[str] = set()
        self._stream: IO[str] | None = None
        self.moved: dict[str, str] = {}

    @property
    def exists(self) -> bool:
        """True if there is a file of the manifest."""
        return self._file.is_file()

    @property
    def paths(self) -> list[str]:
        """Paths that were written or begun, sorted."""
        return sorted(self._contents)

    @property
    def written(self) -> list[str]:
        """Paths that this process has written, sorted."""
        return sorted(self._written)

    def read(self) -> Manifest:
        """Add what the file of the manifest contains; lines that were cut off by a kill, or damaged, are left out."""
        with contextlib.suppress(OSError), open_regular(self._file) as stream:
            while line := stream.readline(_LONGEST_LINE_BYTES):
                with contextlib.suppress(ValueError, TypeError, LookupError, RecursionError):
                    self._add(json.loads(line.decode("utf-8", "replace")))
        return self

    def add_all(self, files: Any) -> Manifest:
        """Add files from a record, as `to_json` returns them; anything else is left out."""
        for path, content in files.items() if isinstance(files, Mapping) else ():
            with contextlib.suppress(ValueError, TypeError):
                size, digest = content
                self._add({"path": path, "size": size, "sha256": digest})
        return self

    def to_json(self) -> dict[str, list[Any]]:
        """Return size and digest of each file that is there and unchanged, by path."""
        found = ((path, self._content(self.root / path)) for path in self.paths if self.is_own(path))
        return {path: list(content) for path, content in found if content is not None}

    def has_content(self, name: str) -> bool:
        """Return whether size and digest of a file are known; otherwise it was only begun."""
        return bool(self._contents.get(name))

    def digest(self, name: str) -> str | None:
        """Return the SHA-256 of a file as it is now; None if it is no regular file."""
        content = self._content(self.root / name)
        return None if content is None else content[1]

    def missing(self) -> list[Path]:
        """Return the files that this process wrote and that are no longer there, sorted."""
        return [self.root / name for name in sorted(self._written) if not (self.root / name).is_file()]

    def lost(self) -> list[str]:
        """Return the paths whose files are gone, no files, or of another size than recorded, sorted."""
        return [name for name in self.paths if not self._has_size(name)]

    def _has_size(self, name: str) -> bool:
        try:
            status = (self.root / name).lstat()
        except OSError:
            return False
        sizes = {size for size, _ in self._contents[name]}
        return stat.S_ISREG(status.st_mode) and (not sizes or status.st_size in sizes)

    def _add(self, entry: Mapping[str, Any]) -> None:
        """Add an entry, unless it is one that is never written."""
        path = entry["path"]
        if not isinstance(path, str) or not _is_inside(path):
            return
        if not can_exist(self.root / path) or not can_exist(part_path(self.root / path)):
            return
        if "sha256" not in entry:
            self._contents.setdefault(path, set())
        elif _is_content(size := entry["size"], digest := entry["sha256"]):
            self._contents.setdefault(path, set()).add((size, digest))

    def add_present(self, name: str, sha256: str | None = None) -> bool:
        """Add a file that is there, if it has this SHA-256 or none is given; return whether it was added."""
        content = self._content(self.root / name)
        if content is None or not _is_inside(name) or sha256 not in (None, content[1]):
            return False
        self._contents.setdefault(name, set()).add(content)
        return True

    @contextlib.contextmanager
    def recording(self) -> Iterator[None]:
        """Record every file that this process writes to the folder within the block."""
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._require_plain_file()
            part_from_links(self._file)
            _end_line(self._file)
            self._stream = self._file.open("a", encoding="utf-8")
        except OSError as error:
            raise output_error(self._file, error) from error
        try:
            with observed_by(self):
                yield
        finally:
            with contextlib.suppress(OSError):  # a full disk; reported by the write that failed
                self._stream.close()
            self._stream = None

    def _require_plain_file(self) -> None:
        """Refuse a link or anything else in place of the manifest: lines would be added to a file elsewhere.

        Raises:
            OutputError: It is not a file.
        """
        if os.path.lexists(self._file) and (self._file.is_symlink() or not self._file.is_file()):
            found, expected = "a link, pipe or folder", "a file"
            problem = Problem(str(self._file), "log-not-a-file", found, expected, "remove it and repeat the command")
            raise OutputError(f"{self.root}: the manifest cannot be written", [problem])

    def begin(self, paths: Iterable[str]) -> None:
        """Record paths that other processes are going to write, unless the manifest has them already."""
        for path in paths:
            if path not in self._contents:
                self._contents[path] = set()
                self._write({"path": path})
        self._flush()

    def before_write(self, path: Path) -> None:
        """Record that a file is begun."""
        name = self._name(path)
        if name is not None and not self._contents.get(name):
            self._contents.setdefault(name, set())
            self._write({"path": name})
            self._flush()

    def before_rename(self, path: Path, temporary: Path) -> None:
        """Record a finished file; a file of its name that is not InfraBlend's, or was changed, is moved aside."""
        name = self._name(path)
        if name is None:
            return
        self._written.add(name)
        content = self._content(temporary)
        if content is None:  # the writer reports it
            return
        if os.path.lexists(path) and not self.is_own(name) and self._content(path) != content:
            self.keep_aside(name)
        if content not in self._contents.setdefault(name, set()):
            self._contents[name].add(content)
            self._write({"path": name, "size": content[0], "sha256": content[1]})
            self._flush()

    def _name(self, path: Path) -> str | None:
        """Return the path of a file relative to the folder; None if it is not recorded."""
        try:
            relative = path.absolute().relative_to(self.root)
        except ValueError:
            return None
        name = relative.as_posix()
        ignored = name in self._ignored or relative.parts[0] in self._ignored
        return None if ignored and name not in self._recorded else name

    def _write(self, entry: Mapping[str, Any]) -> None:
        if self._stream is not None:
            try:
                self._stream.write(json.dumps(entry, sort_keys=True) + "\n")
            except OSError as error:
                raise output_error(self._file, error) from error

    def _flush(self) -> None:
        if self._stream is not None:
            try:
                self._stream.flush()
            except OSError as error:
                raise output_error(self._file, error) from error

    def _content(self, path: Path) -> Content | None:
        """Return size and digest of a regular file; None for anything else."""
        try:
            status = path.lstat()
            if not stat.S_ISREG(status.st_mode):
                return None
            key = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
            if status.st_nlink < 2:
                return status.st_size, sha256_of(path)
            if key not in self._digests:  # pictures linked into several folders are read once
                self._digests[key] = sha256_of(path)
            return status.st_size, self._digests[key]
        except OSError:
            return None

    def is_own(self, name: str) -> bool:
        """Return whether InfraBlend wrote the file of this name and nobody has changed it."""
        path = self.root / name
        inside = (parent for parent in path.parents if parent != self.root and self.root in parent.parents)
        if name not in self._contents or any(parent.is_symlink() for parent in inside):
            return False
        content = self._content(path)
        return content is not None and content in self._contents[name]

    def move_aside(self, name: str) -> str:
        """Move a file or link to the folder for replaced files, and return its new path.

        Raises:
            OutputError: It cannot be moved, or is in a linked folder.
        """
        target = self._new_place_aside(name)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            (self.root / name).rename(target)
        except OSError as error:
            raise output_error(target, error) from error
        new = target.relative_to(self.root).as_posix()
        self.moved[new] = name
        return new

    def keep_aside(self, name: str) -> None:
        """Put a file that is about to be replaced aside, so that one of its name is there at every moment."""
        source, target = self.root / name, self._new_place_aside(name)
        with contextlib.suppress(OSError):
            if stat.S_ISREG(source.lstat().st_mode):
                target.parent.mkdir(parents=True, exist_ok=True)
                os.link(source, target)
                self.moved[target.relative_to(self.root).as_posix()] = name
                return
        self.move_aside(name)

    def _new_place_aside(self, name: str) -> Path:
        """Return a free path in the folder for replaced files."""
        if self._through_link(name):
            raise OutputError(
                f"{self.root / name}: exists in a linked folder, and InfraBlend did not write it, or it was changed; "
                "nothing was touched. Move it away, or give another folder."
            )
        target = self._aside / name
        number = 1
        while os.path.lexists(target):
            number += 1
            target = self._aside / f"{name}.{number}"
        return target

    def drop_equal(self) -> None:
        """Delete files that were moved aside if what was written in their place is the same."""
        for new, name in list(self.moved.items()):
            content = self._content(self.root / new)
            if content is not None and content == self._content(self.root / name):
                (self.root / new).unlink()
                remove_empty(self.root, [new])
                del self.moved[new]

    def problems(self) -> list[Problem]:
        """Return a warning per file that was moved aside."""
        return [
            Problem(
                name,
                "file-changed",
                "changed after InfraBlend wrote it, or not written by InfraBlend",
                "",
                f"written again; the changed file is now {new}",
                "warning",
            )
            for new, name in sorted(self.moved.items(), key=lambda item: item[1])
        ]

    def remove_own(self, keep: Iterable[str] = ()) -> list[str]:
        """Delete the files that InfraBlend wrote and nobody changed, and folders that this leaves empty.

        Args:
            keep: Paths to leave as they are.

        Returns:
            Paths of the manifest that are kept because their files were changed.

        Raises:
            OutputError: A file cannot be deleted.
        """
        kept, left_alone = [], {*keep}
        for name in self.paths:
            path = self.root / name
            if name in left_alone:
                continue
            try:
                if self.is_own(name):
                    path.unlink()
                elif os.path.lexists(path):
                    kept.append(name)
                if not part_path(path).is_symlink() and part_path(path).is_file() and not self._through_link(name):
                    part_path(path).unlink()
            except OSError as error:
                raise output_error(path, error) from error
        remove_empty(self.root, self.paths)
        return kept

    def _through_link(self, name: str) -> bool:
        return any((self.root / parent).is_symlink() for parent in PurePosixPath(name).parents)

    def remove_parts(self) -> None:
        """Delete temporary files that a killed process left."""
        for name in self.paths:
            part = part_path(self.root / name)
            if not part.is_symlink() and part.is_file() and not self._through_link(name):
                with contextlib.suppress(OSError):
                    part.unlink()

    def forget_missing(self) -> None:
        """Forget the files that are no longer there, and write the file of the manifest again without them."""
        self._contents = {n: c for n, c in self._contents.items() if os.path.lexists(self.root / n)}
        lines = []
        for name in self.paths:
            contents = sorted(self._contents[name])
            lines += [json.dumps({"path": name, "size": n, "sha256": d}, sort_keys=True) for n, d in contents]
            lines += [] if contents else [json.dumps({"path": name})]
        write_text(self._file, "".join(f"{line}\n" for line in lines))
        if self._stream is not None:  # which would go on in the file that was replaced
            self._stream.close()
            try:
                self._stream = self._file.open("a", encoding="utf-8")
            except OSError as error:
                raise output_error(self._file, error) from error

    def reset(self) -> None:
        """Forget all entries and empty the file of the manifest."""
        self._contents.clear()
        write_text(self._file, "")

    def delete_own(self, name: str) -> None:
        """Delete one file, if InfraBlend wrote it and nobody has changed it."""
        if self.is_own(name):
            try:
                (self.root / name).unlink()
            except OSError as error:
                raise output_error(self.root / name, error) from error

    def remove_unwritten(self, places: Iterable[str]) -> None:
        """Delete what earlier calls wrote to these folders and files and this process did not write again."""
        wanted = {*places}
        names = [n for n in self.paths if {n, n.split("/")[0]} & wanted and n not in self._written]
        for name in names:
            self.delete_own(name)
        remove_empty(self.root, names)

    def delete(self) -> None:
        """Delete the file of the manifest."""
        self._file.unlink(missing_ok=True)


def remove_empty(root: Path, names: Iterable[str]) -> None:
    """Delete the folders of these files, relative to `root`, that are empty."""
    folders = {parent for name in names for parent in PurePosixPath(name).parents if str(parent) != "."}
    for folder in sorted(folders, key=lambda f: -len(f.parts)):
        path = root / folder
        if path.is_dir() and not path.is_symlink():
            with contextlib.suppress(OSError):  # not empty
                path.rmdir()


def files_below(root: Path, folders: Iterable[str]) -> list[str]:
    """Return all files and links below these folders of `root`, sorted; links are not followed."""
    found = []
    for folder in folders:
        for directory, subfolders, files in os.walk(root / folder):
            links = [name for name in subfolders if (Path(directory) / name).is_symlink()]
            found += [(Path(directory) / name).relative_to(root).as_posix() for name in (*files, *links)]
    return sorted(found)


def _is_inside(path: str) -> bool:
    parts = PurePosixPath(path).parts
    return bool(parts) and not path.startswith("/") and ".." not in parts and "\0" not in path


def _is_content(size: object, digest: object) -> bool:
    return type(size) is int and size >= 0 and isinstance(digest, str) and _DIGEST.fullmatch(digest) is not None


def _end_line(file: Path) -> None:
    """End the last line of a file if a kill cut it off."""
    if file.is_file() and file.stat().st_size:
        with file.open("rb+") as stream:
            stream.seek(-1, os.SEEK_END)
            if stream.read(1) != b"\n":
                stream.write(b"\n")
