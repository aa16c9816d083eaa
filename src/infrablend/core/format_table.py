"""The table of dataset formats: names, titles, capabilities, and the places of code and documentation.

Recipes, the command line, readers, writers, the reference page and the tests take the formats from here. To add a
format, write its file in `infrablend.formats`, add one row to `FORMATS`, add a sample to `tests/samples.py` with its
tests, and describe it in `docs/formats/<page>.md`.

Only names and facts are here, no code of any format: modules are given as dotted paths and loaded by
`formats.base.FormatModule`, which lists what a module may offer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from infrablend.core.capture import FACTS
from infrablend.errors import UnknownFormatError

NATIVE = "native"
"""Written in place of a format's name: the format of the input."""

Layout = Literal["nested", "stems", "unique", "flat", "shared"]
LabelTask = Literal["detect", "obb", "segment"]

FIELDS: Mapping[str, tuple[str, str]] = {
    "boxes": ("axis-aligned boxes beside oriented ones", "box_dropped"),
    "obb": ("oriented boxes", "obb_dropped"),
    "masks": ("masks", "mask_dropped"),
    "ignore": ("regions to ignore", "ignore_dropped"),
    "tracks": ("track ids", "tracks_dropped"),
    "visibility": ("visible share", "visibility_dropped"),
    "occlusion": ("flag `occluded`, whole and visible box", "occlusion_dropped"),
    "truncated": ("flag `truncated`", "truncated_dropped"),
    "difficult": ("flag `difficult`", "difficult_dropped"),
    "fractions": ("fractions of a pixel", "fraction_truncated"),
    "telemetry": ("pitch, altitude, time of day", "telemetry_dropped"),
    "sequence": ("sequence, date", "sequence_dropped"),
    "temperature": ("temperature scale of 16-bit pictures", "temperature_dropped"),
    "inserted": ("mark of inserted objects", "inserted_dropped"),
}
"""What a format may be unable to hold: in words, and the loss (a key of `formats.losses.LOSSES`) that counts it."""


@dataclass(frozen=True)
class Writer:
    """One way to write a format.

    Attributes:
        name: Name in `--to` and `output.formats`.
        reader: Name of the format that reads the result back; the row in which this writer stands.
        title: One line that describes what is written.
        lacks: What cannot be held: keys of `FIELDS`.
        facts: Facts of a picture that can be held, by the names of `Capture`.
        derived: Facts that the reader derives from a field of `ImageRecord.extra` that is kept, by the field's name.
        misread: Folders in the names of pictures that make readers of the format look elsewhere.
        fixed: Arguments of the module's `write` that select this variant.
        takes: Fields of `WriteSettings` that the function accepts, and `extra` (the source's own top-level fields).
        layout: Where pictures may be. `nested`: they keep their folders and names; `stems`: the same, but no two
            pictures of a split may differ in the suffix alone; `unique`: the same over all splits; `flat`: no folders
            below a split; `shared`: one folder for all splits.
        table: Path of a picture in `metadata.csv`, for formats whose reader takes such a table; empty for the others.
        trains: Task for which Ultralytics trains on this format, if any.
        page: Name of the page in `docs/formats`.
    """

    name: str
    reader: str
    title: str
    lacks: frozenset[str]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    takes: frozenset[str] = frozenset()
    layout: Layout = "nested"
    table: str = ""
    trains: LabelTask | None = None
    own_page: str = ""
    facts: frozenset[str] = frozenset(FACTS)
    derived: Mapping[str, frozenset[str]] = field(default_factory=dict)
    misread: tuple[str, ...] = ()

    @property
    def page(self) -> str:
        """Name of the page in `docs/formats`."""
        return self.own_page or f"{self.reader}.md"


@dataclass(frozen=True)
class Format:
    """One dataset format that can be read.

    Attributes:
        name: Name in `--format`, in reports and in run records.
        module: Dotted path of the module or package with `detect`, `read` and, if there are writers, `write`.
        title: One line that describes the format.
        writers: Ways to write it; none if it is only read.
        any_camera: Whether it holds pictures of any camera, whose headers may state facts about the flight.
        written_as: Name of the format that `native` writes instead, for formats that are only read but share the
            labels of another.
    """

    name: str
    module: str
    title: str
    writers: tuple[Writer, ...] = ()
    written_as: str = ""
    any_camera: bool = False

    @property
    def page(self) -> str:
        """Name of the page in `docs/formats`."""
        return f"{self.name}.md"


_ALL_BUT_BOXES = frozenset(FIELDS) - {"boxes", "fractions", "telemetry", "sequence"}
# Facts of a picture that names in HIT-UAV's grammar contain, too.
_VIEW = frozenset({"pitch_deg", "altitude_m", "time_of_day"})
# HIT-UAV's reader derives the flight from the date.
_BY_DATE = {"date": frozenset({"sequence", "captured"})}
# YOLO's readers, Ultralytics' among them, put `labels` in place of the last `images` of a picture's path, and ours
# takes no pictures from `labels`.
_MISREAD = ("images", "labels")
_YOLO_TAKES = frozenset({"dont_care", "without_mask"})
_YOLO_TABLE = "images/{split}/{name}"

FORMATS: tuple[Format, ...] = (
    Format(
        "hit-uav", "infrablend.formats.hit_uav", "HIT-UAV in any of its four annotation forms",
        (
            Writer(
                "hit-uav", "hit-uav", "HIT-UAV's normal_json and rotate_json",
                lacks=frozenset({
                    "masks", "tracks", "visibility", "occlusion", "truncated", "fractions", "sequence", "temperature",
                }),
                fixed={"forms": ("normal_json", "rotate_json")}, takes=frozenset({"ids", "extra", "pictures"}),
                layout="unique", facts=_VIEW, derived=_BY_DATE,
            ),
            Writer(
                "hit-uav-xml", "hit-uav", "HIT-UAV's normal_xml (VOC) and rotate_xml (roLabelImg)",
                lacks=frozenset({
                    "masks", "tracks", "visibility", "occlusion", "fractions", "telemetry", "sequence", "temperature",
                }),
                fixed={"forms": ("normal_xml", "rotate_xml")}, takes=frozenset({"pictures"}), layout="shared",
                facts=frozenset(), derived=_BY_DATE,
            ),
        ),
    ),
    Format("shards", "infrablend.formats.shards", "a run in shards: tars in WebDataset form (`output.layout`)"),
    Format(
        "masks", "infrablend.formats.masks", "InfraBlend's own instance masks: 16-bit PNG files with tables",
        (
            Writer(
                "masks", "masks", "a 16-bit PNG of instance numbers per picture, and a table",
                lacks=frozenset({"temperature"}), takes=frozenset({"pictures"}), layout="stems",
            ),
        ),
        any_camera=True,
    ),
    Format(
        "huggingface", "infrablend.formats.huggingface", "Hugging Face's imagefolder with `metadata.jsonl`",
        (
            Writer(
                "huggingface", "huggingface", "Hugging Face's imagefolder with `metadata.jsonl`",
                lacks=frozenset(), takes=frozenset({"pictures"}),
            ),
        ),
    ),
    Format(
        "cvat", "infrablend.formats.cvat", "CVAT's own XML, `CVAT for images 1.1`",
        (
            Writer(
                "cvat", "cvat", "CVAT's own XML, `CVAT for images 1.1`: rotated boxes, masks, attributes",
                lacks=frozenset({"boxes", "occlusion", "temperature"}), takes=frozenset({"pictures"}),
                table=_YOLO_TABLE,
            ),
        ),
    ),
    Format(
        "label-studio", "infrablend.formats.label_studio", "Label Studio: tasks with rectangles, brushes, polygons",
        (
            Writer(
                "label-studio", "label-studio", "Label Studio: tasks with rotated rectangles and brush masks",
                lacks=frozenset({"boxes", "occlusion", "temperature"}), takes=frozenset({"pictures"}),
                table=_YOLO_TABLE,
            ),
        ),
    ),
    Format(
        "birdsai", "infrablend.formats.birdsai", "BIRDSAI: one CSV of tracks per sequence, or bare frames",
        (
            Writer(
                "birdsai", "birdsai", "BIRDSAI: one CSV of tracks per sequence",
                lacks=frozenset(
                    {
                        "obb", "masks", "ignore", "visibility", "occlusion", "truncated", "difficult", "inserted",
                        "temperature",
                    }
                ),
                takes=frozenset({"dont_care", "pictures"}), facts=_VIEW | {"sequence", "captured", "frame"},
            ),
        ),
    ),
    Format(
        "wisard", "infrablend.formats.wisard", "WiSARD: clips with YOLO text beside the frames", written_as="yolo"
    ),
    Format("wit-uas", "infrablend.formats.wit_uas", "WIT-UAS: runs with `.label` files beside the frames"),
    Format(
        "dut-anti-uav", "infrablend.formats.dut_anti_uav", "DUT-Anti-UAV: drones in visible light, VOC labels",
        written_as="voc",
    ),
    Format(
        "anti-uav", "infrablend.formats.anti_uav", "Anti-UAV300, 410, 600: drones against the sky, a JSON per sequence",
        written_as="coco",
    ),
    Format(
        "halmstad", "infrablend.formats.halmstad", "Halmstad: thermal clips of drones, birds, aircraft; MATLAB labels",
        written_as="coco",
    ),
    Format(
        "drone-vehicle", "infrablend.formats.drone_vehicle", "DroneVehicle: thermal and visible pairs, oriented boxes",
        written_as="dota",
    ),
    Format(
        "bambi", "infrablend.formats.bambi", "BAMBI: wildlife from straight above, per flight: JSON, tracks or YOLO",
        written_as="coco",
    ),
    Format(
        "dota", "infrablend.formats.dota", "DOTA text files: four corners in pixels",
        (
            Writer(
                "dota", "dota", "DOTA text files: four corners in pixels",
                lacks=frozenset(
                    {
                        "boxes", "masks", "tracks", "visibility", "occlusion", "truncated", "inserted", "temperature",
                    }
                ),
                takes=frozenset({"pictures"}), layout="flat", table="{split}/images/{name}",
            ),
        ),
        any_camera=True,
    ),
    Format(
        "monet", "infrablend.formats.monet", "MONET: COCO JSON that contains the drone's telemetry",
        (
            Writer(
                "monet", "monet", "MONET's layout: one COCO JSON per sequence, with telemetry",
                lacks=frozenset({"temperature"}), takes=frozenset({"ids", "extra", "pictures"}),
            ),
        ),
    ),
    Format(
        "coco", "infrablend.formats.coco", "COCO JSON, one file per split",
        (
            Writer(
                "coco", "coco", "COCO JSON per split, masks as run lengths",
                lacks=frozenset(), takes=frozenset({"ids", "pictures"}),
            ),
            Writer(
                "coco-tools", "coco", "COCO JSON for annotation tools: category ids from 1, no outline without a mask",
                lacks=frozenset(), fixed={"without_mask": "omit", "from_one": True},
                takes=frozenset({"ids", "pictures"}),
            ),
        ),
        any_camera=True,
    ),
    Format(
        "yolo", "infrablend.formats.yolo", "Ultralytics YOLO with a `data.yaml`: detect, OBB or segment",
        (
            Writer(
                "yolo", "yolo", "Ultralytics YOLO, axis-aligned boxes", _ALL_BUT_BOXES,
                {"task": "detect"}, _YOLO_TAKES, "stems", _YOLO_TABLE, "detect", misread=_MISREAD,
            ),
            Writer(
                "yolo-obb", "yolo", "Ultralytics YOLO, oriented boxes", (_ALL_BUT_BOXES | {"boxes"}) - {"obb"},
                {"task": "obb"}, _YOLO_TAKES, "stems", _YOLO_TABLE, "obb", "yolo-obb.md", misread=_MISREAD,
            ),
            Writer(
                "yolo-seg", "yolo", "Ultralytics YOLO, one polygon per object",
                (_ALL_BUT_BOXES | {"boxes"}) - {"masks"},
                {"task": "seg"}, _YOLO_TAKES, "stems", _YOLO_TABLE, "segment", "yolo-seg.md", misread=_MISREAD,
            ),
        ),
        any_camera=True,
    ),
    Format(
        "voc", "infrablend.formats.voc", "Pascal VOC: one XML file per picture",
        (
            Writer(
                "voc", "voc", "Pascal VOC: one XML file per picture",
                lacks=frozenset({"obb", "masks", "tracks", "visibility", "occlusion", "temperature"}),
                takes=frozenset({"pictures"}), layout="shared", table="JPEGImages/{name}",
            ),
        ),
        any_camera=True,
    ),
    Format(
        "folder", "infrablend.formats.folder", "a plain folder of pictures, with or without labels", any_camera=True
    ),
)  # fmt: skip
"""All formats, in the order in which detection tries them: the most specific first."""

WRITERS: tuple[Writer, ...] = tuple(w for f in FORMATS for w in f.writers)
"""All writers, in the order of the table."""

if TYPE_CHECKING:
    WrittenName = str
else:  # pydantic checks a recipe against the names, and the reference page lists them
    WrittenName = Literal[(*(w.name for w in WRITERS), NATIVE)]


def written_names() -> tuple[str, ...]:
    """Return the names of the formats that can be written, without `native`."""
    return tuple(w.name for w in WRITERS)


def find_format(name: str) -> Format:
    """Return the format of that name.

    Raises:
        UnknownFormatError: There is none.
    """
    for f in FORMATS:
        if f.name == name:
            return f
    raise UnknownFormatError(f"format {name!r}: expected one of {', '.join(f.name for f in FORMATS)}")


def find_writer(name: str) -> Writer:
    """Return the writer of that name.

    Raises:
        UnknownFormatError: There is none.
    """
    for w in WRITERS:
        if w.name == name:
            return w
    expected = ", ".join((*written_names(), NATIVE))
    raise UnknownFormatError(f"format {name!r} cannot be written: expected one of {expected}")


def writer_for_task(task: str) -> Writer:
    """Return the writer of the format on which a detector for `task` (see `LabelTask`) is trained."""
    return next(w for w in WRITERS if w.trains == task)
