"""Dataset cards: the README.md of a dataset that was made here, as the Hugging Face hub reads it.

The same dataset gives the same bytes: no date, no path of a machine. A card that somebody has edited is left alone.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from infrablend import __version__
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord
from infrablend.core.files import write_bytes, write_json, write_text
from infrablend.core.format_table import FIELDS, NATIVE, find_writer
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import LOSSES, read_json
from infrablend.formats.sources import (
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
from infrablend.report.figures import markdown_table

CARD_FILE = "README.md"
SOURCE_FILE = "SOURCE.json"
LICENCE_COPY = "LICENSE-source.txt"
WORLD_FILE = "world.json"  # that `infrablend world` writes

_LICENCE_NAMES = ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "LICENCE.txt", "LICENCE.md")
_LICENCE_BYTES = 1_000_000
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
_TEXT_CHARACTERS = 4000  # of a field of SOURCE.json


@dataclass(frozen=True)
class Provenance:
    """Where the pictures came from.

    Attributes:
        name: Of the source dataset in InfraBlend's table, or empty.
        title: As its authors write it; empty if it is not known.
        page: Its address, or empty.
        licence: `UNKNOWN` if nobody says.
        licence_note: What to know about it.
        attribution: Whom to name, or empty.
        citation: BibTeX, or empty.
        how: How this is known, a sentence.
        licence_text: The licence file that lies beside the data, if any.
        changes: What was done to it before, if it is itself a made dataset.
        limits: What users of the source must know.
        own: True for pictures that the user made, so that there is nobody to ask.
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


@dataclass(frozen=True)
class Card:
    """All that a card says.

    Attributes:
        name: Of the dataset.
        summary: What it is, in a sentence or two.
        source: Where its pictures came from.
        changes: What was done to them, a sentence each.
        categories: In the order of their ids.
        images_per_split: Pictures.
        labels_per_split: Split -> category -> labels.
        inserted: Category -> labels of inserted objects.
        formats: Formats that were written, by their writers' names.
        losses: What they could not hold, `<format>.<kind>` -> count.
        layout: (path, what) of the folder.
        images: Folder of the pictures, one folder per split in it; empty if there is none such.
        made: How it was made, (what, value).
        recipe: The recipe as YAML, or empty.
        masks: True if some labels have masks.
        limits: What users must know.
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
    recipe: str = ""
    masks: bool = False
    limits: tuple[str, ...] = ()


# -- where the pictures came from ------------------------------------------------------------------------------------


def find_provenance(dataset: Dataset) -> Provenance:
    """What is known of a dataset's source: from `SOURCE.json`, a licence file, its own files, or its layout."""
    text = _licence_file(dataset.root)
    told = _told(dataset)
    if text is None:
        return told
    name, data = text
    read = data.decode("utf-8", "replace")
    licence = next((known for pattern, known in _LICENCE_TEXTS if re.search(pattern, read, re.IGNORECASE)), None)
    if licence is None and told.licence != UNKNOWN:
        note = f"{told.licence_note} The data folder holds a {name} of another text: see {LICENCE_COPY}.".strip()
        return replace(told, licence_text=data, licence_note=note)
    if licence is None:
        own = Licence("other", "that of the source", LICENCE_COPY)
        return replace(told, licence=own, licence_text=data)
    if told.licence in {UNKNOWN, licence}:
        note = told.licence_note if told.licence == licence else ""
        return replace(told, licence=licence, licence_text=data, licence_note=note)
    note = f"The {name} beside the data says {licence.name}, the dataset's page {told.licence.name}: ask its authors."
    return replace(told, licence=licence, licence_text=data, licence_note=note)


def _licence_file(root: Path) -> tuple[str, bytes] | None:
    for name in (*_LICENCE_NAMES, LICENCE_COPY, f"../{LICENCE_COPY}"):
        path = root.resolve() / name
        try:
            if path.is_file() and path.stat().st_size <= _LICENCE_BYTES:
                return name, path.read_bytes()
        except OSError:
            continue
    return None


def _told(dataset: Dataset) -> Provenance:
    root = dataset.root.resolve()
    for folder in (root, root.parent):  # the data may be a folder of what was fetched or made, e.g. RUN/native
        if (found := read_source(folder / SOURCE_FILE)) is not None:
            return found
    if (root / WORLD_FILE).is_file():
        return Provenance(
            title="A virtual thermal world",
            how="Rendered by `infrablend world`; no picture of anybody else is in it.",
            own=True,
        )
    info = dataset.extra.get("info")
    described = str(info.get("description", "")) if isinstance(info, Mapping) else ""
    source = None if "InfraBlend" in described else find_source(dataset.format)
    if source is None:
        return Provenance(how="Neither the files nor their layout say where the pictures come from.")
    how = f"Taken to be {source.name} because its files are laid out so. Correct this if they come from elsewhere."
    if source.name == "hit-uav" and described == "PegasusDrone":
        how = "Known by its annotation files."
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


def read_source(path: Path) -> Provenance | None:
    """What a `SOURCE.json` says, of `infrablend fetch`, of a run, or written by hand; None if it is none."""
    if not path.is_file():
        return None
    try:
        data = read_json(path)
    except DatasetError:
        return None
    licence = data.get("licence") if isinstance(data, dict) else None
    if not isinstance(data, dict) or not isinstance(licence, dict):
        return None
    known = find_source(_text(data, "name"))
    changes = data.get("changes")
    return Provenance(
        _text(data, "name"),
        _text(data, "title") or _text(data, "name"),
        _text(data, "page"),
        _licence(_text(licence, "id"), _text(licence, "name"), _text(licence, "url")),
        _text(data, "licence_note"),
        _text(data, "attribution"),
        _text(data, "citation", lines=True),
        f"As its `{SOURCE_FILE}` says" + (f", commit {commit}." if (commit := _commit(data)) else "."),
        changes=tuple(" ".join(c.split()) for c in changes if isinstance(c, str)) if isinstance(changes, list) else (),
        limits=known.limits if known else (),
        own=data.get("own") is True,
    )


def _licence(identifier: str, name: str, url: str) -> Licence:
    if not identifier and not name:
        return UNKNOWN
    if identifier.lower() in _HUB_LICENCES:
        return Licence(identifier.lower(), name or identifier, url)
    return Licence("other", name or identifier, url)


def _text(data: Mapping[str, Any], key: str, *, lines: bool = False) -> str:
    value = data.get(key)
    if not isinstance(value, str):
        return ""
    value = value[:_TEXT_CHARACTERS]
    return value.replace("```", "").strip() if lines else " ".join(value.split())


def _commit(data: Mapping[str, Any]) -> str:
    archives = data.get("archives")
    found = [_text(a, "commit") for a in archives.values() if isinstance(a, dict)] if isinstance(archives, dict) else []
    return next((c for c in found if re.fullmatch(r"[0-9a-f]{40}", c)), "")


# -- the text --------------------------------------------------------------------------------------------------------


def card_text(card: Card) -> str:
    """The card: front matter and Markdown."""
    parts = [
        f"---\n{yaml.safe_dump(front_matter(card), sort_keys=False, allow_unicode=True, width=1000)}---",
        f"# {card.name}",
        card.summary,
        "## Source and licence",
        *_source(card),
        "## What was changed",
        _bullets(card.changes),
        "## Classes and counts",
        _table(card),
        "Before what single formats leave out; see the next section.",
        "## Files",
        _tree(card),
        *_formats(card),
        "## How it was made",
        "\n".join(f"* {what}: {value}" for what, value in (*card.made, ("InfraBlend", __version__))),
        *(["The recipe's own settings; all else is as this version has it by default:"] if card.recipe else []),
        *([f"```yaml\n{card.recipe.strip()}\n```"] if card.recipe else []),
        "## How to cite",
        *_citations(card),
        *(["## Known limits", _bullets(limits)] if (limits := (*card.limits, *card.source.limits)) else []),
    ]
    text = "\n\n".join(p for p in parts if p) + "\n"
    return f"{text}\n{_OWN.format(digest=_digest(text))}\n"


def front_matter(card: Card) -> dict[str, Any]:
    """What stands above the text, in the hub's terms."""
    images = sum(card.images_per_split.values())
    licence = card.source.licence
    return {
        "pretty_name": card.name,
        "license": licence.id,
        **(
            {"license_name": _slug(licence.name), "license_link": licence.url or LICENCE_COPY}
            if licence.id == "other"
            else {}
        ),
        "task_categories": ["object-detection", *(["image-segmentation"] if card.masks else [])],
        "tags": ["thermal", "infrared", "aerial", "uav", *(["synthetic"] if card.inserted else []), "infrablend"],
        "size_categories": [next((name for most, name in _SIZES if images < most), "n>10M")],
        **_configs(card),
    }


def _slug(name: str) -> str:
    return re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-") or "other"


def _configs(card: Card) -> dict[str, Any]:
    """The hub's viewer shall take each picture once, not again from every format."""
    splits = [s for s in SPLITS if card.images_per_split.get(s)]
    if not card.images or not splits:
        return {}
    files = [{"split": {"val": "validation"}.get(s, s), "path": f"{card.images}/{s}/**"} for s in splits]
    return {"configs": [{"config_name": "default", "data_files": files}]}


def _source(card: Card) -> list[str]:
    s = card.source
    if s.title:
        head = f"The pictures come from **{s.title}**" + (f" (<{s.page}>)" if s.page else "") + "."
    else:
        head = "**The source of the pictures is not known here.**"
    texts = [" ".join(t for t in (head, f"By {s.attribution}." if s.attribution else "", s.how) if t)]
    if s.own and s.licence == UNKNOWN:
        texts.append("**Licence: not chosen yet.** The pictures are yours: choose one, and fill in `license` above.")
    elif s.licence.id == UNKNOWN.id:
        texts.append(
            " ".join(t for t in ("**Licence: unknown.**", s.licence_note) if t)
            + " Before you publish, find it out and fill in this section and `license` above, or put a "
            f"`{SOURCE_FILE}` or a LICENSE file into the data folder and make the dataset again."
        )
    else:
        link = f"[{s.licence.name}]({s.licence.url})" if s.licence.url else s.licence.name
        texts.append(
            f"Licence of the source: {link}. {s.licence_note}".strip()
            + " This dataset is passed on under the same licence; what was changed is listed below."
            + (f" The licence's text is in `{LICENCE_COPY}`." if s.licence_text is not None else "")
        )
    if s.changes:
        texts.append("The source had itself been changed before:\n\n" + _bullets(s.changes))
    return texts


def _bullets(items: Sequence[str]) -> str:
    return "\n".join(f"* {i}" for i in items)


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
    return markdown_table(head, rows, ["---", *["---:"] * (len(head) - 1)])


def _tree(card: Card) -> str:
    copies = [(LICENCE_COPY, "the licence of the source")] if card.source.licence_text is not None else []
    rows = [*card.layout, (SOURCE_FILE, "where the pictures come from, for programs"), *copies]
    return "```text\n" + "\n".join(f"{path:<23} {what}" for path, what in rows) + "\n```"


def _formats(card: Card) -> list[str]:
    """What each format is, cannot hold, and has lost here."""
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
        lines.append(f"`{name}`: {text}." + (f" Here: {counted}." if counted else " Nothing was lost here."))
    return [_bullets(lines)] if lines else []


def _citations(card: Card) -> list[str]:
    texts = []
    if card.inserted:
        texts += ["The method that inserted the objects:", f"```bibtex\n{PAPER_BIBTEX}\n```"]
    if card.source.citation:
        texts += ["The dataset the pictures come from:", f"```bibtex\n{card.source.citation}\n```"]
    elif not card.source.own:
        texts.append("Cite the dataset the pictures come from as its authors ask.")
    return texts


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


# -- files -----------------------------------------------------------------------------------------------------------


def is_own(path: Path) -> bool:
    """True for a card that is as InfraBlend wrote it."""
    try:
        text = path.read_text("utf-8")
    except (OSError, ValueError):
        return False
    body, mark, _ = text.rpartition("\n" + _OWN.partition("{digest}")[0])
    return bool(mark) and text == f"{body}\n{_OWN.format(digest=_digest(body))}\n"


def write_card(folder: Path, card: Card) -> list[Problem]:
    """Write `README.md`, `SOURCE.json` and a copy of the source's licence into a dataset's folder.

    Returns:
        A warning if there is a README.md that somebody has written or edited: it is left alone.

    Raises:
        OutputError: The disk.
    """
    problems = []
    path = folder / CARD_FILE
    if path.exists() and not is_own(path):
        found, todo = "was edited, so no new card was written", "delete it to get a new one"
        problems.append(Problem(CARD_FILE, "card-kept", found, "", todo, "warning"))
    else:
        write_text(path, card_text(card))
    s = card.source
    if s.licence_text is not None:
        write_bytes(folder / LICENCE_COPY, s.licence_text)
    # What is made from this dataset finds its origin here.
    licence = {"id": s.licence.id, "name": s.licence.name, "url": s.licence.url}
    facts: dict[str, Any] = {"title": s.title, "page": s.page, "licence": licence, "licence_note": s.licence_note}
    facts |= {"attribution": s.attribution, "citation": s.citation, "changes": [*s.changes, *card.changes]}
    facts |= {"name": s.name, "own": s.own}
    write_json(folder / SOURCE_FILE, facts, indent=2)
    return problems


def dataset_card(
    source: Dataset,
    images: Sequence[ImageRecord],
    categories: Sequence[Category],
    *,
    changes: Sequence[str],
    to: str = "",
    losses: Mapping[str, int] | None = None,
) -> Card:
    """The card of a dataset that was read and written anew without new objects: converted, split.

    Args:
        source: As read.
        images: What was written.
        categories: Their classes.
        changes: What was done, a sentence each.
        to: The writer's name.
        losses: What that format could not hold, by kind.
    """
    per_split = Counter(str(i.split) for i in images)
    labels: dict[str, Counter[str]] = {s: Counter() for s in per_split}
    for image in images:
        labels[image.split].update(i.category for i in image.instances)
    origin = find_provenance(source)
    short = origin.title.partition(":")[0] or "A dataset"
    return Card(
        f"{short} as {to}" if to else short,
        f"{origin.title or 'A dataset'}, written anew; no object was added.",
        origin,
        tuple(changes),
        tuple(categories),
        dict(per_split),
        labels,
        formats=(to,) if to else (),
        losses={f"{to}.{kind}": n for kind, n in (losses or {}).items()},
        images="",
        masks=any(i.mask is not None for image in images for i in image.instances),
    )
