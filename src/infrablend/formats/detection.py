"""The table of formats, and the two functions that use it: which format is a folder, and read it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from infrablend.core.dataset import Dataset
from infrablend.errors import DatasetError, Problem, UnknownFormatError
from infrablend.formats.base import Match, few
from infrablend.formats.pictures import check_link


@dataclass(frozen=True)
class Format:
    """One format: its name, the module with `detect`, `read` and perhaps `write`, and what it is in a line."""

    name: str
    module: str
    writes: bool
    summary: str

    def load(self, function: str) -> Callable[..., Any]:
        """A function of the format's module."""
        found: Callable[..., Any] = getattr(import_module(self.module), function)
        return found

    def attribute(self, name: str, otherwise: Any) -> Any:
        """A constant of the format's module, or `otherwise`."""
        return getattr(import_module(self.module), name, otherwise)


FORMATS: tuple[Format, ...] = (
    Format("hit-uav", "infrablend.formats.hit_uav", True, "HIT-UAV in any of its four annotation forms"),
    Format("masks", "infrablend.formats.masks", True, "instance masks as 16-bit PNG with tables, of InfraBlend's own"),
    Format("birdsai", "infrablend.formats.birdsai", True, "BIRDSAI: a CSV of tracks for each sequence, or bare frames"),
    Format("wisard", "infrablend.formats.wisard", False, "WiSARD: clips with YOLO text beside the frames"),
    Format("wit-uas", "infrablend.formats.wit_uas", False, "WIT-UAS: runs with .label files beside the frames"),
    Format("dut-anti-uav", "infrablend.formats.dut_anti_uav", False, "DUT-Anti-UAV: drones in visible light, VOC"),
    Format("dota", "infrablend.formats.dota", True, "DOTA text files: four corners in pixels"),
    Format("monet", "infrablend.formats.monet", True, "MONET: COCO JSON with the drone's telemetry in it"),
    Format("coco", "infrablend.formats.coco", True, "COCO JSON, one file per split"),
    Format("yolo", "infrablend.formats.yolo", True, "YOLO with a data.yaml: detect, OBB or seg"),
    Format("voc", "infrablend.formats.voc", True, "Pascal VOC: an XML file for each picture"),
    Format("folder", "infrablend.formats.folder", False, "a plain folder of pictures, labels optional"),
)
"""In the order of detection: the most particular first."""


@dataclass(frozen=True)
class Detection:
    """The format found (None if none fits), and what each format said about the folder, in order."""

    format: str | None
    matches: tuple[Match, ...]

    @property
    def reasons(self) -> dict[str, str]:
        """Reason by format: why it fits, or why it does not."""
        return {m.format: m.reason for m in self.matches}


def find_format(name: str) -> Format:
    """The format of that name.

    Raises:
        UnknownFormatError: There is none.
    """
    for f in FORMATS:
        if f.name == name:
            return f
    raise UnknownFormatError(f"format {name!r}: expected one of {', '.join(f.name for f in FORMATS)}")


def detect(root: Path) -> Detection:
    """Ask every format whether the folder is its own; the first that says yes is taken."""
    matches = tuple(f.load("detect")(root) for f in FORMATS)
    return Detection(next((m.format for m in matches if m.ok), None), matches)


def read(
    root: Path,
    *,
    format: str | None = None,
    form: str | None = None,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    options: Mapping[str, str] | None = None,
) -> Dataset:
    """Read a folder as a background data set, whatever its format.

    Args:
        root: The folder.
        format: A name in `FORMATS`; None detects it.
        form: HIT-UAV only: read this annotation form alone.
        splits: The splits wanted; None reads all.
        metadata: Table of pitch and altitude, for formats whose files do not hold them (not HIT-UAV).
        options: Further options of the format's reader, as text; those it has are its module's `OPTIONS`.

    Raises:
        UnknownFormatError: No format fits; `problems` gives each one's reason.
        DatasetError: The folder cannot be read, or an option does not belong to its format.
    """
    if not root.is_dir():
        problem = Problem(str(root), "folder-missing", "no such folder", "a data set's folder", "check the path")
        raise DatasetError("no dataset to read", [problem])
    if format is None:
        found = detect(root)
        if found.format is None:
            problems = [Problem(m.format, "not-this-format", m.reason) for m in found.matches]
            raise UnknownFormatError(f"{root}: no format fits", problems)
        format = found.format
    chosen = find_format(format)
    given: dict[str, Any] = dict(options or {})
    if form is not None:
        given["form"] = form
    known: Mapping[str, str] = chosen.attribute("OPTIONS", {})
    problems = [
        Problem(f"option {name}", "option-unknown", f"{name}={value}", _options_text(chosen.name, known))
        for name, value in sorted(given.items())
        if name not in known
    ]
    if metadata is not None and not chosen.attribute("TAKES_TABLE", True):
        says = f"{chosen.name} says pitch and altitude itself"
        problems.append(Problem(metadata.name, "table-unused", says, "no table", "leave it out"))
    if problems:
        raise DatasetError(f"{root}: the format is {chosen.name}, which does not take what was given", problems)
    reader = chosen.load("read")
    if metadata is not None:
        given["metadata"] = metadata.resolve()  # the user's own file: it may be a link to anywhere
    return _without_links(reader(root, splits=splits, **given))


def _without_links(dataset: Dataset) -> Dataset:
    """The dataset without pictures that are links out of their folders: they would carry foreign files into results."""
    problems, kept = list(dataset.problems), []
    for image in dataset.images:
        problem = None
        if image.path.is_symlink():
            problem = check_link(image.path, image.path.parent, f"{image.split}/{image.name}")
        if problem is None:
            kept.append(image)
        else:
            problems.append(problem)
    if len(kept) == len(dataset.images):
        return dataset
    if not kept:
        raise DatasetError(f"{dataset.root}: every picture is a link out of its folder", few(problems))
    return replace(dataset, images=tuple(kept), problems=tuple(problems))


def _options_text(name: str, known: Mapping[str, str]) -> str:
    if not known:
        return f"no option: {name} has none"
    return "one of " + "; ".join(f"{k} ({what})" for k, what in known.items())
