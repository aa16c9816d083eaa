"""Fetch a public dataset into a folder: download, check, unpack, and record the source.

Work in progress is kept in `DST/.fetch`; finished entries are moved to their place one by one. Repeating the command
resumes where the previous call stopped.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from infrablend import __version__
from infrablend.core.arguments import require_names
from infrablend.core.file_names import can_exist, leaves, real_path
from infrablend.core.files import output_error, require_still_there, sha256_of, write_json
from infrablend.core.finished import DOWNLOAD_FOLDER, PLACED
from infrablend.core.json_records import is_list
from infrablend.core.output import OutputFolder
from infrablend.errors import DatasetError, Interrupted, OutputError, Problem
from infrablend.fetching.download import RetryPolicy, download, require_url
from infrablend.fetching.unpack import Limits, require_room, unpack, without_wrapper
from infrablend.formats.annotation_files import read_json
from infrablend.formats.detection import detect
from infrablend.formats.sources import SOURCES, Archive, Source, find_source

SOURCE_FILE = "SOURCE.json"


@dataclass(frozen=True)
class FetchProgress:
    """Progress of a step: bytes of a download or files of an archive; `total` is None if unknown."""

    step: Literal["download", "unpack"]
    file: str
    done: int
    total: int | None


OnFetch = Callable[[FetchProgress], None]


@dataclass(frozen=True)
class FetchReport:
    """Result of a call of `fetch`.

    Attributes:
        out: Folder of the dataset.
        name: Name of the dataset.
        fetched: Parts fetched by this call.
        present: Parts that existed before.
        files: Number of files unpacked by this call.
        size_bytes: Total size of these files.
        problems: Warnings on differences from what others report about the dataset.
    """

    out: Path
    name: str
    fetched: tuple[str, ...]
    present: tuple[str, ...]
    files: int = 0
    size_bytes: int = 0
    problems: tuple[Problem, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            **{k: getattr(self, k) for k in ("name", "files", "size_bytes")},
            "out": str(self.out),
            "fetched": list(self.fetched),
            "present": list(self.present),
            "problems": [p.to_json() for p in self.problems],
        }


@dataclass(frozen=True)
class _Order:
    """What to fetch and how."""

    source: Source
    out: Path
    url: str | None
    sha256: str | None
    archive: Path | None
    keep_archive: bool
    limits: Limits | None
    patience: RetryPolicy | None
    on_progress: OnFetch

    @property
    def work(self) -> Path:
        return self.out / DOWNLOAD_FOLDER

    @property
    def own_file(self) -> bool:
        """Whether the user gave the file or its address; it may then differ from the known one."""
        return self.url is not None or self.archive is not None

    def file_name(self, a: Archive) -> str:
        """Return the name of a part's file: the user's own, or that of the published one."""
        return a.file if self.archive is None else self.archive.name


def require_source(name: str) -> Source:
    """Return the dataset of that name.

    Raises:
        DatasetError: There is none.
    """
    source = find_source(name)
    if source is None:
        raise DatasetError(f"dataset {name!r}: expected one of {', '.join(s.name for s in SOURCES)}")
    return source


def fetch_instructions(source: Source) -> str:
    """Return readable text on how to get a dataset: licence, address and command."""
    parts = [a.part for a in source.archives]
    lines = [source.title, f"Page: {source.page}", *licence_lines(source)]
    if all(a.url for a in source.archives):
        lines.append(f"Fetched by: infrablend fetch {source.name} DST")
    else:
        of_part = " --part " + "|".join(parts) if len(parts) > 1 else ""
        lines += [
            "It cannot be downloaded automatically.",
            source.by_hand,
            f"Then: infrablend fetch {source.name} DST{of_part} --archive FILE.zip (or unpack it yourself), "
            "and infrablend check DST",
        ]
    return "\n".join(lines)


def licence_lines(source: Source) -> list[str]:
    """Return the licence and remarks about it."""
    licence = source.licence
    lines = [f"Licence: {licence.name}" + (f", {licence.url}" if licence.url else "")]
    return lines + ([source.licence_note] if source.licence_note else [])


@dataclass(frozen=True)
class FetchRequest:
    """What to fetch of a dataset, and from where.

    Attributes:
        parts: Parts to fetch; None for all.
        url: Address to download the file from instead of the published one.
        sha256: SHA-256 that the file must have.
        archive: File downloaded by hand, to unpack instead of downloading one; a text becomes a path.
        keep_archive: Whether to keep the archive in the output folder.

    Raises:
        ArgumentError: `parts` is no list of names.
    """

    parts: Sequence[str] | None = None
    url: str | None = None
    sha256: str | None = None
    archive: Path | None = None
    keep_archive: bool = False

    def __post_init__(self) -> None:
        require_names("parts", self.parts)
        if self.archive is not None:
            object.__setattr__(self, "archive", Path(self.archive))


FETCH_ALL = FetchRequest()
"""The default: every part, from its published address."""


def fetch(
    name: str,
    out: Path,
    request: FetchRequest = FETCH_ALL,
    *,
    limits: Limits | None = None,
    patience: RetryPolicy | None = None,
    on_progress: OnFetch | None = None,
) -> FetchReport:
    """Fetch a dataset into `out`; see `infrablend.api.fetch`.

    Raises:
        DatasetError: The dataset or a part does not exist or cannot be downloaded by a program, or the archive is
            damaged, hostile, or of another dataset.
        FetchError: The network failed.
        OutputError: The folder cannot be used, or the disk is full.
        Interrupted: The user pressed Ctrl-C; the same call continues the download.
    """
    url, sha256, archive = request.url, request.sha256, request.archive
    source = require_source(name)
    wanted = _wanted(source, request.parts, single=bool(url or sha256 or archive))
    if url is not None and archive is not None:
        raise DatasetError("--url and --archive exclude each other; give one of them")
    if url is not None:
        require_url(url)
    if archive is not None and not archive.is_file():
        raise DatasetError(f"--archive {archive}: no such file")
    if sha256 is not None and not re.fullmatch(r"[0-9a-fA-F]{64}", sha256):
        raise DatasetError(f"--sha256 {sha256}: expected 64 hexadecimal digits")
    show = on_progress or (lambda progress: None)
    order = _Order(source, out, url, sha256, archive, request.keep_archive, limits, patience, show)
    if not order.own_file and any(not a.url for a in wanted):
        raise DatasetError(f"{name}: nothing was fetched\n{fetch_instructions(source)}")
    new = not out.exists()
    try:
        with _output(out).claimed() as require_claim:
            known = _require_own(order, wanted)
            todo = [a for a in wanted if _ready(order, a).exists() or not _is_placed(order, known.get(a.part))]
            for a in (a for a in wanted if a not in todo):
                _sweep(order, a)  # left by a call that was killed just before it finished
            done = [_fetch_part(order, a, known.get(a.part), require_claim) for a in todo]
    except KeyboardInterrupt as stop:
        raise Interrupted("interrupted; downloaded data is kept. Repeat the command to resume.") from stop
    finally:
        with contextlib.suppress(OSError):  # remove the folders only if they are empty
            order.work.rmdir()
            if new:
                out.rmdir()
    if todo and order.own_file and (remark := _not_read_as(source, out)) is not None:
        done[-1][1].append(remark)
    if done:  # after the last change, because a folder may be removed at any moment
        placed = [place for *_, places in done for place in places]
        require_still_there([out / SOURCE_FILE, *placed])
    return FetchReport(
        out,
        name,
        tuple(a.part for a in todo),
        tuple(a.part for a in wanted if a not in todo),
        sum(facts["files"] for facts, *_ in done),
        sum(facts["unpacked_bytes"] for facts, *_ in done),
        tuple(p for _, problems, _ in done for p in problems),
    )


def _wanted(source: Source, parts: Sequence[str] | None, *, single: bool) -> list[Archive]:
    names = [a.part for a in source.archives]
    unknown = sorted(set(parts or ()) - set(names))
    if unknown:
        raise DatasetError(f"{source.name}: no part {', '.join(unknown)}; expected some of {', '.join(names)}")
    wanted = [a for a in source.archives if (a.wanted if parts is None else a.part in parts)]
    if single and len(wanted) > 1:
        raise DatasetError(f"{source.name}: several files; name the one this is with --part: {', '.join(names)}")
    return wanted


def _require_own(order: _Order, wanted: Sequence[Archive]) -> dict[str, Any]:
    """Return the parts that are already present; refuse a folder that contains anything but this dataset."""
    record = order.out / SOURCE_FILE
    names = {p.name for p in sorted(order.out.iterdir())}
    known: dict[str, Any] = {}
    if SOURCE_FILE in names:
        data = _record(record)
        if data.get("name") != order.source.name:
            raise OutputError(
                f"{order.out}: holds {data.get('name') or 'something else'} (says its {SOURCE_FILE}), not "
                f"{order.source.name}; give another folder"
            )
        known = data["archives"]
    elif names - {DOWNLOAD_FOLDER} and DOWNLOAD_FOLDER not in names:
        _output(order.out).require_empty()
    for a in wanted:
        ready = _ready(order, a).exists()
        taken = (order.out / a.into).exists() if a.into else bool(names - {DOWNLOAD_FOLDER, SOURCE_FILE})
        if a.part not in known and taken and not ready:
            where = order.out / a.into
            raise OutputError(f"{where}: exists and was not written by `fetch`; move it away or give another folder")
    return known


def _output(out: Path) -> OutputFolder:
    return OutputFolder(out, "download", SOURCE_FILE)


def _is_placed(order: _Order, facts: Any) -> bool:
    """Return whether a part was fetched, and nothing of it has been removed since."""
    return facts is not None and all((order.out / name).exists() for name in _places(facts))


def _places(facts: Any) -> list[str]:
    """Return the files and folders of a part as its record lists them; those of earlier versions list none."""
    found = facts.get("places") if isinstance(facts, dict) else None
    return (
        [n for n in found if isinstance(n, str) and can_exist(n) and not leaves(n)] if isinstance(found, list) else []
    )


def _ready(order: _Order, a: Archive) -> Path:
    """Return the file that exists while a checked and unpacked part is being moved to its place."""
    return order.work / f"{a.part}{PLACED}"


def _record(path: Path) -> dict[str, Any]:
    data = read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("archives"), dict):
        raise OutputError(f"{path}: not written by `infrablend fetch`; give another folder")
    return data


def _fetch_part(
    order: _Order, a: Archive, known: Any, require_claim: Callable[[], None]
) -> tuple[dict[str, Any], list[Problem], list[Path]]:
    """Fetch, check, unpack and place one archive; return its facts, the warnings and where it is.

    Args:
        order: What to fetch.
        a: The archive.
        known: Its facts of an earlier call, if something of it was removed since; what is left stays as it is.
        require_claim: Checks that the folder is still the one that this call began with.
    """
    ready = _ready(order, a)
    stage = order.work / f"{a.part}.unpacked"
    try:
        order.work.mkdir(exist_ok=True)
    except OSError as error:
        raise output_error(order.work, error) from error
    if ready.exists():  # an earlier call was stopped while it was moving files
        kept = read_json(ready)
        facts, problems = kept["facts"], [Problem(**p) for p in kept["problems"]]
        content = stage / kept["content"]
    else:
        shutil.rmtree(stage, ignore_errors=True)
        file, served = _archive_file(order, a)
        try:
            problems = _check_file(order, a, file, digest := _digest(file))
            unpacked = unpack(
                file,
                stage,
                order.limits,
                lambda n, of: order.on_progress(FetchProgress("unpack", order.file_name(a), n, of)),
            )
            require_claim()
            if sum(len(names) for *_, names in os.walk(stage)) != unpacked.files:
                raise OutputError(f"{stage}: files were removed while they were unpacked; repeat the command")
            content = without_wrapper(stage)
            problems += _check_content(order, a, content, unpacked.commit)
        except DatasetError as error:
            shutil.rmtree(stage, ignore_errors=True)
            if order.archive is None:
                _forget(file)
                todo = "The file was deleted; repeat the command to download it again."
                raise type(error)(f"{error.message}. {todo}", error.problems) from error
            raise
        facts = {
            **served,
            "file": file.name,
            "size_bytes": file.stat().st_size,
            "sha256": digest,
            "files": unpacked.files,
            "unpacked_bytes": unpacked.size_bytes,
            "commit": unpacked.commit,
            "differs": [str(p) for p in problems],
            # Provenance; this file need not be reproducible.
            "fetched": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        }
        try:
            facts["places"] = sorted((Path(a.into) / entry.name).as_posix() for entry in content.iterdir())
        except OSError as error:
            raise output_error(content, error) from error
        # Records the folder, because the entries that remain after some were moved may look like a wrapper.
        inside = content.relative_to(stage).as_posix()
        write_json(ready, {"facts": facts, "problems": [p.to_json() for p in problems], "content": inside})
    left = {order.out / name for name in _places(known)}
    _place(content, order.out / a.into, left)
    _write_source(order, a, facts)
    packed = order.work / a.file
    if order.keep_archive and packed.exists():
        packed.replace(order.out / a.file)
    ready.unlink(missing_ok=True)
    _sweep(order, a)
    return facts, problems, [order.out / name for name in _places(facts)]


def _archive_file(order: _Order, a: Archive) -> tuple[Path, dict[str, Any]]:
    """Return the complete local archive and the facts that the server reported about it."""
    if order.archive is not None:
        return order.archive, {"url": None}
    file = order.work / a.file
    served_file = order.work / f"{a.file}.served.json"
    if file.exists() and served_file.exists():
        served: dict[str, Any] = read_json(served_file)
        if served.get("asked") == (order.url or a.url):
            return file, {k: v for k, v in served.items() if k != "asked"}
        file.unlink()
    part = order.work / f"{a.file}.part"
    url = order.url or a.url
    served = download(
        url,
        part,
        size_bytes=None if order.own_file else a.size_bytes or a.unpacked_bytes or None,
        room=lambda missing: require_room(order.out, missing + a.unpacked_bytes),
        on_bytes=lambda n, of: order.on_progress(FetchProgress("download", a.file, n, of)),
        patience=order.patience,
    )
    write_json(served_file, {**served, "asked": url})
    part.replace(file)
    return file, served


def _forget(file: Path) -> None:
    """Delete a downloaded file and the files that describe it."""
    for end in ("", ".part", ".part.json", ".served.json"):
        file.with_name(file.name + end).unlink(missing_ok=True)


def _sweep(order: _Order, a: Archive) -> None:
    """Delete the leftover work files of a part that is in its place."""
    shutil.rmtree(order.work / f"{a.part}.unpacked", ignore_errors=True)
    _forget(order.work / a.file)


def _digest(file: Path) -> str:
    try:
        return sha256_of(real_path(file))
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read ({error.strerror or error})") from error


def _check_file(order: _Order, a: Archive, file: Path, digest: str) -> list[Problem]:
    """Check size and checksum, and return the differences that are not errors as warnings.

    Raises:
        DatasetError: The checksum differs from the user's, or from one that we verified ourselves.
    """
    size = file.stat().st_size
    problems = []
    wanted = (order.sha256 or "").lower() or a.sha256
    if wanted and digest != wanted:
        problems.append(
            Problem(file.name, "checksum", f"sha256 {digest}", wanted, "download it again or ask its authors")
        )
        if order.sha256 or (a.checked and not order.own_file):
            raise DatasetError(f"{file.name}: not the expected file", problems)
    if a.size_bytes is not None and size != a.size_bytes and not order.sha256:
        problems.append(Problem(file.name, "size", f"{size} bytes", f"{a.size_bytes} bytes"))
    return [_as_warning(p) for p in problems]


def _check_content(order: _Order, a: Archive, content: Path, commit: str | None) -> list[Problem]:
    """Check that the archive contains the dataset, by the numbers of files and annotations and the commit.

    GitHub's archives have no permanent checksum; this check replaces it.

    Raises:
        DatasetError: The content differs from numbers that we verified ourselves; lists all differences.
    """
    problems = []
    for reserved in (DOWNLOAD_FOLDER, SOURCE_FILE):
        if not a.into and (content / reserved).exists():
            raise DatasetError(
                f"{order.file_name(a)}: contains {reserved}, a name that `fetch` needs; unpack it by hand"
            )
    if commit is not None and a.commit is not None and commit != a.commit:
        problems.append(Problem(a.file, "commit", f"made from commit {commit}", a.commit))
    for pattern, wanted in a.counts.items():
        found = sum(1 for _ in content.glob(pattern))
        if found != wanted:
            problems.append(Problem(pattern, "content-files", f"{found} file(s)", str(wanted)))
    for name, lists in a.lists.items():
        path = content / name
        try:
            data = read_json(path)
        except DatasetError as error:
            problems.append(Problem(name, "content-json", f"cannot be read ({error.problems[0].found})", "JSON"))
            continue
        for key, wanted in lists.items():
            value = data.get(key) if isinstance(data, Mapping) else None
            found_text = f"{len(value)} items in {key!r}" if is_list(value) else f"no list {key!r}"
            if not is_list(value) or len(value) != wanted:
                problems.append(Problem(name, "content-json", found_text, str(wanted)))
    if order.own_file and not a.into and (remark := _not_read_as(order.source, content)) is not None:
        todo = "give the archive of this dataset, or use the files without `fetch`: their licence is another"
        fault = Problem(order.file_name(a), remark.code, remark.found, remark.expected, todo)
        raise DatasetError(f"{order.file_name(a)}: not {order.source.name}", [fault])
    if problems and a.checked and not order.own_file:
        raise DatasetError(f"{order.file_name(a)}: does not contain the known files of {order.source.name}", problems)
    return [_as_warning(p) for p in problems]


def _not_read_as(source: Source, root: Path) -> Problem | None:
    """Return a warning if a folder is not read as the dataset; None if it is."""
    try:
        found = detect(root)
    except OSError as error:  # the folder was removed meanwhile
        if isinstance(error, OutputError):
            raise
        raise output_error(root, error) from error
    match = next((m for m in found.matches if m.format == source.name), None)
    if match is None or match.ok:
        return None
    text = match.reason + (f"; it is read as {found.format}" if found.format else "")
    todo = "check that the archive is of this dataset: SOURCE.json names its licence"
    return Problem(root.name, "not-this-format", text, f"the files of {source.name}", todo, "warning")


def _as_warning(p: Problem) -> Problem:
    return Problem(p.where, p.code, p.found, p.expected, p.todo, "warning")


def _place(content: Path, target: Path, left: Collection[Path]) -> None:
    """Move every entry of `content` into `target` without overwriting anything.

    Those that are `left` of an earlier call stay as they are.
    """
    try:
        target.mkdir(parents=True, exist_ok=True)
        for entry in sorted(os.scandir(content), key=lambda e: e.name):
            place = target / entry.name
            if place in left and place.exists():
                continue
            if place.exists() or place.is_symlink():
                raise OutputError(f"{place}: already exists; move it away and repeat the command")
            Path(entry).rename(place)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise output_error(target, error) from error


def _write_source(order: _Order, a: Archive, facts: Mapping[str, Any]) -> None:
    """Write `SOURCE.json`: the origin of the data, for readers and for the cards of derived datasets."""
    source, path = order.source, order.out / SOURCE_FILE
    archives = _record(path)["archives"] if path.exists() else {}
    write_json(
        path,
        {
            "name": source.name,
            "title": source.title,
            "page": source.page,
            "licence": asdict(source.licence),
            "licence_note": source.licence_note,
            "attribution": source.attribution,
            "citation": source.citation,
            "archives": {**archives, a.part: dict(facts)},
            "infrablend": __version__,
        },
        indent=2,
    )


@dataclass(frozen=True)
class SourceEntry:
    """A public dataset that InfraBlend knows.

    Attributes:
        name: Name to give to `fetch`.
        title: Full title.
        page: Address of its page.
        licence: Name of its licence.
        licence_note: Remark on the licence.
        parts: Parts that can be fetched separately.
        fetched: Whether `fetch` can download it; otherwise it has to be downloaded by hand.
    """

    name: str
    title: str
    page: str
    licence: str
    licence_note: str
    parts: tuple[str, ...]
    fetched: bool


def list_sources() -> list[SourceEntry]:
    """Return all known public datasets."""
    return [
        SourceEntry(
            s.name, s.title, s.page, s.licence.name, s.licence_note, tuple(a.part for a in s.archives),
            all(a.url for a in s.archives),
        )
        for s in SOURCES
    ]  # fmt: skip
