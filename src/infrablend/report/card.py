"""Dataset cards: the README.md of a generated dataset, in the form that the Hugging Face hub reads.

The same dataset gives the same bytes: a card contains no date and no local path. An edited card is never overwritten.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from infrablend import __version__
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord
from infrablend.core.file_names import real_path
from infrablend.core.files import read_regular, write_bytes, write_json, write_text
from infrablend.core.format_table import FIELDS, NATIVE, find_writer
from infrablend.core.workspace import SOURCE_FILE, WORLD_FILE
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import read_json
from infrablend.formats.labels import shards
from infrablend.formats.losses import LOSSES
from infrablend.formats.pictures.listing import PICTURE_SUFFIXES
from infrablend.formats.published.sources import (
    APACHE_2,
    CC0_1,
    CC_BY_4,
    CDLA_PERMISSIVE_1,
    MIT,
    PAPER_BIBTEX,
    UNKNOWN,
    Licence,
    find_source,
)
from infrablend.report.page import Table, bullets

CARD_FILE = "README.md"
LICENCE_COPY = "LICENSE-source.txt"

_LICENCE_NAMES = ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "LICENCE.txt", "LICENCE.md")
_LICENCE_BYTES = 1_000_000
_LICENCE_TEXT = "licence_text"  # in the records of packed shards
_LICENCE_TEXTS: tuple[tuple[str, Licence], ...] = (
    (r"\A\W*(Creative Commons )?Attribution 4\.0 International\b", CC_BY_4),
    (r"\A\W*(The )?MIT License\b", MIT),
    (r"\A\W*Apache License\s+Version 2\.0", APACHE_2),
    (r"\A\W*Community Data License Agreement\s*\W\s*Permissive\s*\W\s*(Version )?1\.0", CDLA_PERMISSIVE_1),
    (r"\A\W*(Creative Commons )?CC0 1\.0 Universal", CC0_1),
)
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))
_OWN = "<!-- Written by InfraBlend. Edit as you like: it is then left alone. {digest} -->"
# Licences for data that the hub knows; others are `other`, with their name and address.
_HUB_LICENCES = frozenset(
    {
        *(f"cc-by{more}-{v}" for more in ("", "-sa", "-nc", "-nd", "-nc-sa", "-nc-nd") for v in ("3.0", "4.0")),
        *("cc0-1.0", "mit", "apache-2.0", "bsd-2-clause", "bsd-3-clause", "gpl-3.0", "odbl", "odc-by", "pddl"),
        *("cdla-permissive-1.0", "cdla-permissive-2.0", "cdla-sharing-1.0", "unlicense", "unknown", "other"),
    }
)
# Entries of written datasets that their files' suffixes do not describe.
_CONTENTS = {
    "ImageSets/": "pictures of each split",
    "masks/": "labels",
    "data.yaml": "classes and splits",
    "labelmap.txt": "classes",
    "categories.json": "classes",
    "species.csv": "classes",
    "names.csv": "original names of the pictures",
    "targets.csv": "objects of the folders",
    "metadata.csv": "pitch, altitude and time of day",
}
_TEXT_CHARACTERS = 4000  # at most, per field of SOURCE.json
INSERT_LIMITS = (
    "Inserted objects are rendered: scores on them show how well a detector finds such renders. Test on real pictures "
    "of that class before you conclude more.",
    "Several pictures may show the same background. They are all in the background's split; keep them together if you "
    "split the dataset again.",
)


@dataclass(frozen=True)
class Inserts:
    """Rendered objects that one run inserted into a dataset.

    Every dataset made from that run carries this on: its pictures still show the objects.

    Attributes:
        recipe: Name of the recipe.
        seed: Seed of the run, or None if it is not known.
        settings: YAML of the settings that the recipe changes, or empty.
        labels: Number of labels of these objects in the dataset, by category; without a category whose number is not
            known because the dataset's format does not mark them.
        limits: Known limits of the inserted objects, a sentence each.
    """

    recipe: str
    seed: int | None = None
    settings: str = ""
    labels: Mapping[str, int] = field(default_factory=dict)
    limits: tuple[str, ...] = ()


# Labels that are marked as inserted, without any record of the run.
_MARKED_ONLY = Inserts("", limits=INSERT_LIMITS)


@dataclass(frozen=True)
class Provenance:
    """Origin of the pictures.

    Attributes:
        name: Name of the source dataset in InfraBlend's table, or empty.
        title: Title that its authors use; empty if it is not known.
        page: Web address of the dataset, or empty.
        licence: Licence of the source; `UNKNOWN` if none is stated.
        licence_note: Remark about the licence, or empty.
        attribution: Authors to name, or empty.
        citation: BibTeX entry, or empty.
        how: Sentence on how the origin is known.
        licence_text: Content of the licence file beside the data, if any.
        changes: Earlier changes, a sentence each, if the source was itself generated.
        limits: Known limits of the source, a sentence each.
        own: True for pictures that the user made, whose licence is the user's to choose.
        inserts: Rendered objects that earlier runs inserted, first run first.
    """

    name: str = ""
    title: str = ""
    page: str = ""
    licence: Licence = UNKNOWN
    licence_note: str = ""
    attribution: str = ""
    citation: str = ""
    how: str = ""
    licence_text: bytes | None = None
    changes: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    own: bool = False
    inserts: tuple[Inserts, ...] = ()


@dataclass(frozen=True)
class Card:
    """Content of a dataset card.

    Attributes:
        name: Name of the dataset.
        summary: Description in a sentence or two.
        source: Origin of the pictures.
        changes: Changes to pictures and labels, a sentence each.
        categories: Categories in the order of their ids.
        images_per_split: Number of pictures per split.
        labels_per_split: Number of labels per split and category.
        inserted: Number of labels that are marked as inserted, by category.
        formats: Names of the formats that were written.
        losses: Number of items that a format could not hold, by `<format>.<kind>`.
        layout: Paths in the folder, each with a description.
        images: Folder with the pictures, one subfolder per split, `.` for the dataset's own; empty if there is none.
        made: Facts about the run, (name, value).
        inserts: Rendered objects in the pictures, of this run and of earlier ones.
        masks: True if some labels have masks.
        limits: Known limits beside those of the source and of the inserted objects, a sentence each.
        failures: What is known to be wrong with some of the pictures or labels, a sentence each.
        load: Path for `datasets.load_dataset("imagefolder", data_dir=...)`; empty if it does not load as one.
    """

    name: str
    summary: str
    source: Provenance
    changes: tuple[str, ...]
    categories: tuple[Category, ...]
    images_per_split: Mapping[str, int]
    labels_per_split: Mapping[str, Mapping[str, int]]
    inserted: Mapping[str, int] = field(default_factory=dict)
    formats: tuple[str, ...] = ()
    losses: Mapping[str, int] = field(default_factory=dict)
    layout: tuple[tuple[str, str], ...] = ()
    images: str = "images"
    made: tuple[tuple[str, str], ...] = ()
    inserts: tuple[Inserts, ...] = ()
    masks: bool = False
    failures: tuple[str, ...] = ()
    load: str = ""


# -- where the pictures came from ------------------------------------------------------------------------------------


def find_provenance(dataset: Dataset) -> Provenance:
    """Return a dataset's origin, as far as `SOURCE.json`, a licence file, its own files or its layout show it."""
    stated = _stated_provenance(dataset)
    if not stated.inserts and any(i.inserted for image in dataset.images for i in image.instances):
        stated = replace(stated, inserts=(_MARKED_ONLY,))
    root = dataset.root.parent if dataset.root.is_file() else dataset.root  # one video
    if (found := _licence_file(root)) is None:
        return stated
    (name, data), note = found, stated.licence_note
    text = data.decode("utf-8", "replace")
    licence = next((known for pattern, known in _LICENCE_TEXTS if re.search(pattern, text, re.IGNORECASE)), None)
    if licence is None and stated.licence == UNKNOWN:
        licence = Licence("other", "that of the source", LICENCE_COPY)
    elif licence is None:
        licence = stated.licence
        note = f"{note} The data folder contains a {name} with another text: see {LICENCE_COPY}.".strip()
    elif stated.licence == UNKNOWN:
        note = ""
    elif stated.licence != licence:
        note = (
            f"The {name} beside the data says {licence.name}, but the dataset's page says {stated.licence.name}: "
            "ask its authors."
        )
    return replace(stated, licence=licence, licence_text=data, licence_note=note)


def _licence_file(root: Path) -> tuple[str, bytes] | None:
    for name in (*_LICENCE_NAMES, LICENCE_COPY, f"../{LICENCE_COPY}"):
        path = real_path(root) / name
        with contextlib.suppress(OSError):
            if path.is_file() and path.stat().st_size <= _LICENCE_BYTES:
                return name, path.read_bytes()
    return None


def _stated_provenance(dataset: Dataset) -> Provenance:
    root = real_path(dataset.root)
    for folder in (root, root.parent):  # the data may be a folder of a download or of a run, such as RUN/native
        with contextlib.suppress(DatasetError):
            if (found := _provenance_of(read_json(folder / SOURCE_FILE), f"its `{SOURCE_FILE}`")) is not None:
                return found
    if dataset.format == shards.NAME:
        facts = json.loads(dataset.extra.get(shards.SOURCE, "null"))
        if (found := _provenance_of(facts, "its shards")) is not None:
            text = facts.get(_LICENCE_TEXT)
            return replace(found, licence_text=text.encode() if isinstance(text, str) else None)
    if (root / WORLD_FILE).is_file():
        return Provenance(
            title="A virtual thermal world",
            how="Rendered by `infrablend world`; it contains no picture from another source.",
            own=True,
        )
    info = dataset.extra.get("info")
    described = str(info.get("description", "")) if isinstance(info, Mapping) else ""
    source = None if "InfraBlend" in described else find_source(dataset.format)
    if source is None:
        return Provenance(how="Neither the files nor their layout show where the pictures come from.")
    how = f"Identified as {source.name} by the layout of its files. Correct this if they come from elsewhere."
    if source.name == "hit-uav" and described == "PegasusDrone":
        how = "Identified by its annotation files."
    return Provenance(
        source.name,
        source.title,
        source.page,
        source.licence,
        source.licence_note,
        source.attribution,
        source.citation,
        how,
        limits=source.limits,
    )


def _provenance_of(data: Any, stated_by: str) -> Provenance | None:
    """Return what the content of a `SOURCE.json` states, or None if it is not one.

    `infrablend fetch`, runs and conversions write such files; they may also be written by hand.
    """
    licence = data.get("licence") if isinstance(data, dict) else None
    if not isinstance(licence, dict):
        return None
    known = find_source(_text(data, "name"))
    archives = data["archives"].values() if isinstance(data.get("archives"), dict) else ()
    commits = [_text(a, "commit") for a in archives if isinstance(a, dict)]
    commit = next((f", commit {c}" for c in commits if re.fullmatch(r"[0-9a-f]{40}", c)), "")
    return Provenance(
        _text(data, "name"),
        _text(data, "title") or _text(data, "name"),
        _text(data, "page"),
        _licence_of(licence),
        _text(data, "licence_note"),
        _text(data, "attribution"),
        _text(data, "citation", lines=True),
        f"According to {stated_by}{commit}.",
        changes=_texts(data.get("changes")),
        limits=known.limits if known else (),
        own=data.get("own") is True,
        inserts=tuple(_inserts_of(entry) for entry in _listed(data.get("inserts"), dict)),
    )


def _inserts_of(entry: Mapping[str, object]) -> Inserts:
    labels = entry.get("labels")
    seed = entry.get("seed")
    return Inserts(
        _text(entry, "recipe"),
        seed if type(seed) is int else None,
        _text(entry, "settings", lines=True),
        {k: n for k, n in labels.items() if type(n) is int} if isinstance(labels, dict) else {},
        _texts(entry.get("limits")),
    )


def _licence_of(stated: Mapping[str, object]) -> Licence:
    identifier = _text(stated, "id")
    name = _text(stated, "name")
    if not identifier and not name:
        return UNKNOWN
    known = identifier.lower() if identifier.lower() in _HUB_LICENCES else "other"
    return Licence(known, name or identifier, _text(stated, "url"))


def _listed(value: object, kind: type) -> list[Any]:
    return [v for v in value if isinstance(v, kind)] if isinstance(value, list) else []


def _texts(value: object) -> tuple[str, ...]:
    return tuple(" ".join(text.split()) for text in _listed(value, str))


def _text(data: Mapping[str, object], key: str, *, lines: bool = False) -> str:
    value = data.get(key)
    if not isinstance(value, str):
        return ""
    value = value[:_TEXT_CHARACTERS]
    return value.replace("```", "").strip() if lines else " ".join(value.split())


# -- the text --------------------------------------------------------------------------------------------------------


def card_text(card: Card) -> str:
    """Return the card: front matter and Markdown."""
    limits = dict.fromkeys((*(x for one in card.inserts for x in one.limits), *card.source.limits))
    head = f"---\n{yaml.safe_dump(_front_matter(card), sort_keys=False, allow_unicode=True, width=1000)}---"
    parts = [
        f"# {card.name}",
        card.summary,
        "## Intended use",
        bullets(_uses(card)),
        "## Source and licence",
        *_source(card),
        "## What was changed",
        bullets(card.changes),
        "## Classes and counts",
        _table(card),
        "Some formats hold less: the next section lists their losses.",
        "## Files",
        _tree(card),
        *_formats(card),
        *_loading(card),
        "## How it was made",
        bullets(f"{what}: {value}" for what, value in (*card.made, ("InfraBlend", __version__))),
        *_recipes(card.inserts),
        "## How to cite",
        *_citations(card),
        *(["## Known limits", bullets(limits)] if limits else []),
        *(["## Known failures", bullets(card.failures)] if card.failures else []),
    ]
    text = "\n\n".join([head, *(_without_markup(p) for p in parts if p)]) + "\n"
    return f"{text}\n{_OWN.format(digest=_digest(text))}\n"


_CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)
_LINK_ELSEWHERE = re.compile(r"\]\((?!https?://|[\w./-]*\))")


def _without_markup(text: str) -> str:
    """Return Markdown without HTML and without links that are neither to the web nor to a file of the dataset.

    Names and provenance come from files of others; a class `<script>` must not become part of a page.
    """
    parts = _CODE.split(text)
    parts[::2] = [_LINK_ELSEWHERE.sub(r"]\\(", re.sub(r"<(?!https?://)", "&lt;", p)) for p in parts[::2]]
    return "".join(parts)


def _recipes(inserts: Sequence[Inserts]) -> list[str]:
    texts = []
    for one in (i for i in inserts if i.recipe):
        seed = "" if one.seed is None else f" with seed {one.seed}"
        counts = ", ".join(f"{n} {name}" for name, n in one.labels.items())
        labels = f", {sum(one.labels.values())} labels ({counts})" if counts else ""
        texts.append(f"Objects were inserted by the recipe `{one.recipe}`{seed}{labels}.")
        if one.settings:
            texts[-1] += " The settings that it changes; all others have their default values:"
            texts.append(f"```yaml\n{one.settings.strip()}\n```")
    return texts


def _uses(card: Card) -> tuple[str, ...]:
    tasks = "boxes and masks" if card.masks else "boxes"
    return (
        f"Train and compare detectors of small objects in thermal aerial pictures; labels are {tasks}.",
        *(("Not for stating how well a detector finds real objects of the inserted classes.",) if card.inserts else ()),
        "Not for identifying people, and not for decisions about people without a person who checks them.",
    )


def _loading(card: Card) -> list[str]:
    if not card.load:
        return []
    code = f'from datasets import load_dataset\n\ndata = load_dataset("imagefolder", data_dir="{card.load}")'
    return [f"With Hugging Face's `datasets`, from this folder:\n\n```python\n{code}\n```"]


def _front_matter(card: Card) -> dict[str, object]:
    images = sum(card.images_per_split.values())
    licence = card.source.licence
    named = {}
    if licence.id == "other":
        name = re.sub(r"[^a-z0-9.]+", "-", licence.name.lower()).strip("-") or "other"
        named = {"license_name": name, "license_link": licence.url or LICENCE_COPY}
    return {
        "pretty_name": card.name,
        "license": licence.id,
        **named,
        "task_categories": ["object-detection", *(["image-segmentation"] if card.masks else [])],
        "tags": ["thermal", "infrared", "aerial", "uav", *(["synthetic"] if card.inserts else []), "infrablend"],
        "size_categories": [next((name for most, name in _SIZES if images < most), "n>10M")],
        **_configs(card),
    }


def _configs(card: Card) -> dict[str, object]:
    """Return the hub's viewer settings: each picture once, not again from every format."""
    splits = [s for s in SPLITS if card.images_per_split.get(s)]
    if not card.images or not splits:
        return {}
    base = "" if card.images == "." else f"{card.images}/"
    files = [{"split": {"val": "validation"}.get(s, s), "path": f"{base}{s}/**"} for s in splits]
    return {"configs": [{"config_name": "default", "data_files": files}]}


def _source(card: Card) -> list[str]:
    s = card.source
    if s.title:
        head = f"The pictures come from **{s.title}**" + (f" (<{s.page}>)" if s.page else "") + "."
    else:
        head = "**The source of the pictures is not known.**"
    texts = [" ".join(t for t in (head, f"By {s.attribution}." if s.attribution else "", s.how) if t)]
    if s.own and s.licence == UNKNOWN:
        texts.append("**Licence: not chosen yet.** The pictures are yours: choose one and enter it as `license` above.")
    elif s.licence.id == UNKNOWN.id:
        texts.append(
            " ".join(t for t in ("**Licence: unknown.**", s.licence_note) if t)
            + " Before you publish, find out the licence and complete this section and `license` above, or put a "
            f"`{SOURCE_FILE}` or a LICENSE file into the data folder and generate the dataset again."
        )
    else:
        link = f"[{s.licence.name}]({s.licence.url})" if s.licence.url else s.licence.name
        texts.append(
            f"Licence of the source: {link}. {s.licence_note}".strip()
            + " This dataset is distributed under the same licence; the changes are listed below."
            + (f" The licence's text is in `{LICENCE_COPY}`." if s.licence_text is not None else "")
        )
    if s.changes:
        texts.append("Earlier changes to the source:\n\n" + bullets(s.changes))
    return texts


def _table(card: Card) -> str:
    """Return the counts: a row for the images and each class, a column for each split, the sum and the inserted."""
    splits = [s for s in SPLITS if s in card.images_per_split]
    head = ["", *splits, "all", *(["inserted"] if card.inserted else [])]
    rows = [["pictures", *(str(card.images_per_split[s]) for s in splits), str(sum(card.images_per_split.values()))]]
    labels = card.labels_per_split
    for c in card.categories:
        counts = [labels.get(s, {}).get(c.name, 0) for s in splits]
        name = " ".join(c.name.split()) + (" (regions to ignore)" if c.ignore else "")
        rows.append([name, *map(str, counts), str(sum(counts))])
        if card.inserted:
            rows[-1].append(str(card.inserted.get(c.name, 0)))
    if card.inserted:
        rows[0].append("")
    return Table(head, rows).markdown(["---", *["---:"] * (len(head) - 1)])


def _tree(card: Card) -> str:
    copies = [(LICENCE_COPY, "the licence of the source")] if card.source.licence_text is not None else []
    rows = [*card.layout, (SOURCE_FILE, "origin of the pictures, for programs"), *copies]
    return "```text\n" + "\n".join(f"{path:<23} {what}" for path, what in rows) + "\n```"


def _formats(card: Card) -> list[str]:
    """Return a line per format: what it is, what it cannot hold, and what was lost here."""
    lines = []
    for name in card.formats:
        lost = {tuple(k.split(".")[1:]): n for k, n in sorted(card.losses.items()) if k.split(".")[0] == name and n}
        counted = "; ".join(
            f"{n} x {LOSSES.get(kind, kind)}" + "".join(f" ({form})" for form in forms)
            for (*forms, kind), n in lost.items()
        )
        if name == NATIVE:
            text = "the source's own format"
        else:
            writer = find_writer(name)
            lacks = ", ".join(words for key, (words, _) in FIELDS.items() if key in writer.lacks)
            text = writer.title + (f"; it cannot hold {lacks}" if lacks else "")
        lines.append(f"`{name}`: {text}." + (f" Here: {counted}." if counted else " Nothing was lost."))
    return [bullets(lines)] if lines else []


def _citations(card: Card) -> list[str]:
    texts = []
    if card.inserts:
        texts += ["The method that inserted the objects:", f"```bibtex\n{PAPER_BIBTEX}\n```"]
    if card.source.citation:
        texts += ["The dataset that the pictures come from:", f"```bibtex\n{card.source.citation}\n```"]
    elif not card.source.own:
        texts.append("Cite the dataset that the pictures come from as its authors ask.")
    return texts


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


# -- files -----------------------------------------------------------------------------------------------------------


def is_own(path: Path) -> bool:
    """Return True for a card that nobody has edited since InfraBlend wrote it."""
    try:
        text = read_regular(path).decode("utf-8").replace("\r\n", "\n")
    except (OSError, ValueError):
        return False
    body, mark, _ = text.rpartition("\n" + _OWN.partition("{digest}")[0])
    return bool(mark) and text == f"{body}\n{_OWN.format(digest=_digest(body))}\n"


def write_card(folder: Path, card: Card) -> list[Problem]:
    """Write `README.md`, `SOURCE.json` and a copy of the source's licence into a dataset's folder.

    Returns:
        A warning if the folder has a README.md that InfraBlend did not write or that was edited: it is kept.

    Raises:
        OutputError: A file cannot be written.
    """
    problems = []
    path = folder / CARD_FILE
    if path.exists() and not is_own(path):
        found = "an edited card, so no new one was written"
        todo = "delete it to get a new one"
        problems.append(Problem(CARD_FILE, "card-kept", found, "", todo, "warning"))
    else:
        write_text(path, card_text(card))
    s = card.source
    if s.licence_text is not None:
        write_bytes(folder / LICENCE_COPY, s.licence_text)
    # Datasets made from this one find their origin here.
    told = replace(s, changes=(*s.changes, *card.changes), inserts=card.inserts)
    write_json(folder / SOURCE_FILE, _source_facts(told), indent=2)
    return problems


def shard_source(source: Provenance, inserts: Inserts) -> dict[str, object]:
    """Return the origin of the pictures of a packed shard for its record, which is its only file besides the data."""
    facts = _source_facts(replace(source, inserts=(*source.inserts, inserts)))
    text = source.licence_text
    return facts if text is None else {**facts, _LICENCE_TEXT: text.decode("utf-8", "replace")}


def _source_facts(source: Provenance) -> dict[str, object]:
    """Return the content of a `SOURCE.json`, as plain JSON values."""
    return {k: v for k, v in asdict(source).items() if k not in ("how", "licence_text", "limits")}


def dataset_card(
    origin: Provenance,
    images: Sequence[ImageRecord],
    categories: Sequence[Category],
    *,
    changes: Sequence[str],
    to: str,
    losses: Mapping[str, int] | None = None,
    layout: Sequence[tuple[str, str]] = (),
) -> Card:
    """Return the card of a dataset that was converted or split.

    Objects that an earlier run inserted stay in its pictures: the card names them, with their recipe and its limits.

    Args:
        origin: Origin of the pictures.
        images: Images that were written.
        categories: Their categories.
        changes: Changes, a sentence each.
        to: Name of the format written.
        losses: Number of items that the format could not hold, by kind.
        layout: Paths in the folder, each with a description; see `written_layout`.
    """
    per_split = Counter(str(i.split) for i in images)
    labels: dict[str, Counter[str]] = {s: Counter() for s in per_split}
    for image in images:
        labels[image.split].update(i.category for i in image.instances)
    short = origin.title.partition(":")[0] or "A dataset"
    holds_masks = "masks" not in find_writer(to).lacks
    what = "with rendered objects in its pictures" if origin.inserts else "no object was inserted"
    return Card(
        f"{short} as {to}",
        f"{origin.title or 'A dataset'}, converted to `{to}`; {what}.",
        origin,
        tuple(changes),
        tuple(categories),
        dict(per_split),
        labels,
        inserted=Counter(i.category for image in images for i in image.instances if i.inserted),
        formats=(to,),
        losses={f"{to}.{kind}": n for kind, n in (losses or {}).items()},
        layout=tuple(layout),
        images="" if to != "huggingface" else ".",
        inserts=origin.inserts,
        masks=holds_masks and any(i.mask is not None for image in images for i in image.instances),
        load="." if to == "huggingface" else "",
    )


def written_layout(folder: Path, files: Iterable[Path], record: str) -> tuple[tuple[str, str], ...]:
    """Return the entries of a dataset's folder, each with a description: folders, files, and the record.

    Args:
        folder: Folder of the dataset.
        files: Files that the writer of its format wrote in it.
        record: Name of the file that records how it was made.
    """
    below: dict[str, list[Path]] = {}
    for path in files:
        inside = path.relative_to(folder)
        below.setdefault(inside.parts[0] + ("/" if len(inside.parts) > 1 else ""), []).append(inside)
    names = sorted(below, key=lambda name: (not name.endswith("/"), name))
    return (*((name, _CONTENTS.get(name) or _content(below[name])) for name in names), (record, "how it was made"))


def _content(files: Sequence[Path]) -> str:
    pictures = [f.name.lower().endswith(PICTURE_SUFFIXES) for f in files]
    return "pictures" if all(pictures) else "pictures and labels" if any(pictures) else "labels"
