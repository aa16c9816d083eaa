"""Fetch a public dataset into a folder: download, check, unpack, and record the source.

A call that fails leaves the folder as it was. A later call adds parts to those that are there.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal, TypedDict, cast

from infrablend.core.arguments import require_names
from infrablend.core.file_names import real_path
from infrablend.core.files import read_object, require_still_there, sha256_of
from infrablend.core.json_records import is_list
from infrablend.core.workspace import SOURCE_FILE, workspace
from infrablend.errors import DatasetError, OutputError, Problem
from infrablend.formats.annotation_files import read_json
from infrablend.formats.dataset_folder import detect
from infrablend.formats.published.sources import SOURCES, Archive, Source, find_source
from infrablend.pipeline.storage.archive import download, require_url, unpack, without_wrapper

_WORK = ".fetch"


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

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            **{k: getattr(self, k) for k in ("name", "files", "size_bytes")},
            "out": str(self.out),
            "fetched": list(self.fetched),
            "present": list(self.present),
            "problems": [p.to_json() for p in self.problems],
        }


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

    @property
    def own_file(self) -> bool:
        """Whether the user gave the file or its address; it may then differ from the published one."""
        return self.url is not None or self.archive is not None


FETCH_ALL: FetchRequest = FetchRequest()
"""The default: every part, from its published address."""


def fetch(
    name: str, out: Path, request: FetchRequest = FETCH_ALL, *, on_progress: OnFetch | None = None
) -> FetchReport:
    """Fetch a dataset into `out`; see `infrablend.api.fetch`.

    Raises:
        DatasetError: The dataset or a part does not exist or cannot be downloaded by a program, or the archive is
            damaged, unsafe, or of another dataset.
        FetchError: The network failed.
        OutputError: The folder cannot be used, or the disk is full.
    """
    source = require_source(name)
    wanted = _wanted(source, request)
    if not request.own_file and any(not a.url for a in wanted):
        raise DatasetError(f"{name}: nothing was fetched\n{fetch_instructions(source)}")
    done: dict[str, _Part] = {}
    if _missing(source, out, wanted):
        with workspace(out, "download", SOURCE_FILE, "overwrite") as space:
            known = _known(source, out)
            if space.out.is_dir():  # the parts that are there already
                _link_tree(space.out, space.folder)
            work = space.folder / _WORK
            work.mkdir()
            for a in _missing(source, out, wanted):  # again: a killed call may have been finished meanwhile
                done[a.part] = _fetch_part(source, a, request, space.folder, work, on_progress)
            shutil.rmtree(work)
            if done and request.own_file and (remark := _not_read_as(source, space.folder)) is not None:
                if not wanted[0].into:
                    raise DatasetError(f"{done[wanted[0].part].facts['file']}: not {name}", [remark])
                done[wanted[0].part].problems.append(replace(remark, severity="warning"))
            facts = {**known, **{part: one.facts for part, one in done.items()}}
            require_still_there([space.folder / place for one in done.values() for place in one.facts["places"]])
            names = ("name", "title", "page", "licence_note", "attribution", "citation")
            origin = {name: getattr(source, name) for name in names}
            space.finish({**origin, "licence": asdict(source.licence), "archives": facts})
        require_still_there([out / SOURCE_FILE])
    return FetchReport(
        out,
        name,
        tuple(done),
        tuple(a.part for a in wanted if a.part not in done),
        sum(part.facts["files"] for part in done.values()),
        sum(part.facts["unpacked_bytes"] for part in done.values()),
        tuple(p for part in done.values() for p in part.problems),
    )


def _wanted(source: Source, request: FetchRequest) -> list[Archive]:
    """Return the archives that a request asks for.

    Raises:
        DatasetError, FetchError: The request contradicts itself, or names what does not exist.
    """
    names = [a.part for a in source.archives]
    if unknown := sorted(set(request.parts or ()) - set(names)):
        raise DatasetError(f"{source.name}: no part {', '.join(unknown)}; expected some of {', '.join(names)}")
    wanted = [a for a in source.archives if (a.wanted if request.parts is None else a.part in request.parts)]
    if len(wanted) > 1 and (request.own_file or request.sha256):
        raise DatasetError(f"{source.name}: several files; name the one this is with --part: {', '.join(names)}")
    if request.url is not None and request.archive is not None:
        raise DatasetError("--url and --archive exclude each other; give one of them")
    if request.url is not None:
        require_url(request.url)
    if request.archive is not None and not request.archive.is_file():
        raise DatasetError(f"--archive {request.archive}: no such file")
    if request.sha256 is not None and not re.fullmatch(r"[0-9a-fA-F]{64}", request.sha256):
        raise DatasetError(f"--sha256 {request.sha256}: expected 64 hexadecimal digits")
    return wanted


def _known(source: Source, out: Path) -> dict[str, _PartFacts]:
    """Return the facts of the parts that an earlier call fetched to `out`, by part.

    Raises:
        OutputError: The folder has another dataset.
    """
    record = read_object(out / SOURCE_FILE)
    if record is None:
        return {}
    if record.get("name") != source.name or not isinstance(record.get("archives"), dict):
        raise OutputError(
            f"{out}: holds {record.get('name') or 'something else'} (says its {SOURCE_FILE}), not {source.name}; give "
            "another folder"
        )
    return {part: cast(_PartFacts, facts) for part, facts in record["archives"].items() if isinstance(facts, dict)}


def _missing(source: Source, out: Path, wanted: Sequence[Archive]) -> list[Archive]:
    known = _known(source, out)
    return [
        a
        for a in wanted
        if a.part not in known or not all((out / place).exists() for place in known[a.part].get("places", ()))
    ]


def _link_tree(source: Path, target: Path) -> None:
    def link(file: str, copy: str) -> None:
        try:
            os.link(file, copy)
        except OSError:
            shutil.copy2(file, copy)

    own = {SOURCE_FILE, ".partial", ".partial.lock", ".replaced"}
    try:
        shutil.copytree(
            source,
            target,
            copy_function=link,
            dirs_exist_ok=True,
            ignore=lambda folder, _names: own if Path(folder) == source else (),
        )
    except (OSError, shutil.Error) as error:
        raise OutputError(f"{target}: cannot be written ({error}); expected a folder with free space") from error


class _PartFacts(TypedDict):
    """Provenance of a part, as plain JSON values; `places` are its files and folders at the top of the output."""

    url: str | None
    file: str
    size_bytes: int
    sha256: str
    files: int
    unpacked_bytes: int
    commit: str | None
    differs: list[str]
    fetched: str
    places: list[str]


@dataclass(frozen=True)
class _Part:
    facts: _PartFacts
    problems: list[Problem]


def _fetch_part(
    source: Source, a: Archive, request: FetchRequest, root: Path, work: Path, on_progress: OnFetch | None
) -> _Part:
    file = request.archive or work / a.file

    def show(step: Literal["download", "unpack"]) -> Callable[[int, int | None], None]:
        def report(done: int, total: int | None) -> None:
            if on_progress is not None:
                on_progress(FetchProgress(step, file.name, done, total))

        return report

    url = None
    if request.archive is None:
        url = download(request.url or a.url, file, a.unpacked_bytes, show("download"))
    digest = sha256_of(real_path(file))
    problems = _check_file(request, a, file, digest)
    unpacked = unpack(file, work / a.part, show("unpack"))
    content = without_wrapper(work / a.part)
    problems += _check_content(source, a, request, file.name, content, unpacked.commit)
    facts: _PartFacts = {
        "url": url,
        "file": file.name,
        "size_bytes": file.stat().st_size,
        "sha256": digest,
        "files": unpacked.files,
        "unpacked_bytes": unpacked.size_bytes,
        "commit": unpacked.commit,
        "differs": [str(p) for p in problems],
        # Provenance; this file need not be reproducible.
        "fetched": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "places": sorted((Path(a.into) / entry.name).as_posix() for entry in content.iterdir()),
    }
    target = root / a.into
    target.mkdir(parents=True, exist_ok=True)
    for entry in sorted(content.iterdir()):
        if os.path.lexists(target / entry.name):
            where = Path(a.into) / entry.name
            raise OutputError(f"{where}: exists already in the folder; move it away and repeat the command")
        entry.rename(target / entry.name)
    if request.keep_archive and request.archive is None:
        file.rename(root / a.file)
    return _Part(facts, problems)


def _check_file(request: FetchRequest, a: Archive, file: Path, digest: str) -> list[Problem]:
    """Check size and checksum, and return the differences that are not errors as warnings.

    Raises:
        DatasetError: The checksum differs from the user's, or from one that we verified ourselves.
    """
    size = file.stat().st_size
    problems = []
    wanted = (request.sha256 or "").lower() or a.sha256
    if wanted and digest != wanted:
        problems.append(
            Problem(file.name, "checksum", f"sha256 {digest}", wanted, "download it again or ask its authors")
        )
        if request.sha256 or (a.checked and not request.own_file):
            raise DatasetError(f"{file.name}: not the expected file", problems)
    if a.size_bytes is not None and size != a.size_bytes and not request.sha256:
        problems.append(Problem(file.name, "size", f"{size} bytes", f"{a.size_bytes} bytes"))
    return [replace(p, severity="warning") for p in problems]


def _check_content(
    source: Source, a: Archive, request: FetchRequest, file: str, content: Path, commit: str | None
) -> list[Problem]:
    """Check that the archive contains the dataset, by the numbers of files and annotations and the commit.

    GitHub's archives have no permanent checksum; this check replaces it.

    Raises:
        DatasetError: The content differs from numbers that we verified ourselves; lists all differences.
    """
    problems = []
    if not a.into and (content / SOURCE_FILE).exists():
        raise DatasetError(f"{file}: contains {SOURCE_FILE}, a name that `fetch` needs; unpack it by hand")
    if commit is not None and a.commit is not None and commit != a.commit:
        problems.append(Problem(a.file, "commit", f"made from commit {commit}", a.commit))
    for pattern, wanted in a.counts.items():
        found = sum(1 for _ in content.glob(pattern))
        if found != wanted:
            problems.append(Problem(pattern, "content-files", f"{found} file(s)", str(wanted)))
    for name, lists in a.lists.items():
        try:
            data = read_json(content / name)
        except DatasetError as error:
            problems.append(Problem(name, "content-json", f"cannot be read ({error.problems[0].found})", "JSON"))
            continue
        for key, wanted in lists.items():
            value = data.get(key) if isinstance(data, Mapping) else None
            if not is_list(value) or len(value) != wanted:
                found_text = f"{len(value)} items in {key!r}" if is_list(value) else f"no list {key!r}"
                problems.append(Problem(name, "content-json", found_text, str(wanted)))
    if problems and a.checked and not request.own_file:
        raise DatasetError(f"{file}: does not contain the known files of {source.name}", problems)
    return [replace(p, severity="warning") for p in problems]


def _not_read_as(source: Source, root: Path) -> Problem | None:
    found = detect(root)
    match = next((m for m in found.matches if m.format == source.name), None)
    if match is None or match.ok:
        return None
    text = match.reason + (f"; it is read as {found.format}" if found.format else "")
    todo = "give the archive of this dataset, or use the files without `fetch`: their licence is another"
    return Problem(source.name, "not-this-format", text, f"the files of {source.name}", todo)


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
            s.name,
            s.title,
            s.page,
            s.licence.name,
            s.licence_note,
            tuple(a.part for a in s.archives),
            all(a.url for a in s.archives),
        )
        for s in SOURCES
    ]
