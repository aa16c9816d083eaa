"""Compares finished output of InfraBlend with the sizes and digests that were recorded when it was written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from infrablend.core.file_names import real_path
from infrablend.core.files import read_object
from infrablend.core.finished import CONVERT_FILE, FRAMES_FILE, SPLIT_FILE, TEMPERATURES_FILE, is_finished
from infrablend.core.manifest import JOURNAL, REPLACED, Manifest
from infrablend.core.run_layout import EXCLUDED_FILE, IMAGES, RUN_FILE, SCENES, SHARDS_FILE, ShardFiles
from infrablend.errors import OutputError, Problem, Severity
from infrablend.pipeline.excluded import require_choice
from infrablend.pipeline.folder import FILES, RUN, RunFolder, is_edited
from infrablend.pipeline.record import RecordError, load_record
from infrablend.pipeline.shard_damage import damage_of
from infrablend.report.card import CARD_FILE

CHANGED, GONE = "file-changed", "file-gone"
_DATASETS = (CONVERT_FILE, SPLIT_FILE, FRAMES_FILE, TEMPERATURES_FILE)


def changes_since_written(folder: Path, *, digests: bool = True) -> list[Problem]:
    """Return a problem per file that was changed or removed since InfraBlend wrote it; none for other folders.

    Args:
        folder: Folder of a run, conversion, split or extraction, or a folder inside it; then only files of that folder,
            and the pictures of the run, are compared.
        digests: Whether to read the pictures of a run; otherwise only their existence is checked.
    """
    inside = real_path(folder)
    if (inside / SHARDS_FILE).is_file():
        return list(_of_shards(inside, digests))
    for root in (inside, *inside.parents):
        part = inside.relative_to(root).parts[:1]
        wanted = {*part, IMAGES, SCENES} if part else None
        if (run := _finished(root / RUN_FILE)) is not None:
            return [p for p in _of_run(root, run, digests) if wanted is None or p.where.split("/")[0] in wanted]
        for name in _DATASETS:
            record = _finished(root / name)
            if record is not None:
                problems = _of_dataset(root, record.get("written"))
                return [p for p in problems if wanted is None or p.where.split("/")[0] in wanted]
    return []


def _finished(file: Path) -> Mapping[str, Any] | None:
    record = read_object(file) if file.is_file() else None
    return record if record is not None and "infrablend" in record and is_finished(record) else None


def _of_run(root: Path, run: Mapping[str, Any], digests: bool) -> Iterator[Problem]:
    folder = RunFolder(root)
    manifest = folder.manifest().read()
    todo = "repeat the command of the run with --resume: it restores the file and keeps a changed one in log/replaced"
    if is_edited(run):
        yield Problem(RUN_FILE, CHANGED, "changed after InfraBlend wrote it", "the record as written", todo)
    if isinstance(run.get(FILES), int) and (listed := len(folder.listed(manifest))) < run[FILES]:
        found = f"lists {listed} files; {RUN_FILE} counts {run[FILES]}"
        yield Problem("log/files.jsonl", GONE, found, "the list as the run wrote it", todo)
    try:
        require_choice(run, folder)
    except OutputError as error:
        yield Problem(EXCLUDED_FILE, CHANGED, error.message, "", "")
    counted = (run.get("counts") or {}).get("frames") if isinstance(run.get("counts"), Mapping) else None
    records = folder.records()
    if isinstance(counted, int) and len(records) < counted:
        found = f"{len(records)} records; {RUN_FILE} counts {counted} frames"
        yield Problem(SCENES, GONE, found, "a record per frame", todo)
    framed = set()  # these files have records of their own
    for path in records:
        name = path.relative_to(root).as_posix()
        framed.add(name)
        try:
            record = load_record(path)
        except RecordError as error:
            yield Problem(name, CHANGED, str(error), "the record as the run wrote it", todo)
            continue
        image = f"{IMAGES}/{record.image}"
        framed.add(image)
        if not record.is_of(run.get(RUN)):
            yield Problem(name, CHANGED, "a frame of another run", "the record as the run wrote it", todo)
        if not (root / image).is_file():
            yield _gone(image, todo)
        elif digests and manifest.digest(image) != record.image_sha256:
            yield Problem(image, CHANGED, "changed after InfraBlend wrote it", "the picture of its labels", todo)
    advice = f"{todo}. To edit labels, convert the run and edit the conversion"
    yield from _differences(manifest, (n for n in manifest.paths if n not in framed), advice)


def _of_shards(root: Path, digests: bool) -> Iterator[Problem]:
    for marker in sorted(root.glob("shard-*-of-*.json")):
        record = read_object(marker) or {}
        todo = "repeat the command of the shard with --resume, which makes it again"
        if is_edited(record):
            yield Problem(marker.name, CHANGED, "changed after InfraBlend wrote it", "the record as written", todo)
        if (found := damage_of(ShardFiles(root, marker.stem), record, digests=digests)) is not None:
            yield Problem(marker.stem, CHANGED, found, "the shard as written", todo)


def _of_dataset(root: Path, written: Any) -> Iterator[Problem]:
    manifest = Manifest(root, root / JOURNAL, root / REPLACED).add_all(written)
    todo = "nothing, if you edited it; --overwrite writes the dataset again and keeps the changed file in replaced"
    yield from _differences(manifest, manifest.paths, todo, "warning")


def _differences(
    manifest: Manifest, names: Iterable[str], todo: str, severity: Severity = "error"
) -> Iterator[Problem]:
    for name in names:
        if name == CARD_FILE or not manifest.has_content(name):
            continue  # the last line of the card invites edits; a file without content was only begun
        if not (manifest.root / name).exists():
            yield _gone(name, todo)
        elif not manifest.is_own(name):
            # Texts for readers decide nothing; labels and pictures do.
            level: Severity = severity if "/" in name else "warning"
            yield Problem(name, CHANGED, "changed after InfraBlend wrote it", "the file as written", todo, level)


def _gone(name: str, todo: str) -> Problem:
    return Problem(name, GONE, "removed after InfraBlend wrote it", "the file as written", todo)
