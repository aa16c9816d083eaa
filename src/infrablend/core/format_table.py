"""The table of dataset formats: names, titles, capabilities, and the places of code and documentation.

Recipes, the command line, readers, writers, the reference page and the tests take the formats from here. To add a
format, write its file in a room of `infrablend.formats`, add one row to `FORMATS`, add a sample to `tests/samples.py`
with its tests, and describe it in `docs/formats/<page>.md`.

Only names and facts are here, no code of any format; `formats.base.FormatModule`, which loads modules, lists what they
may offer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

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
        of: Name of the format that it is a variant of, if any.
        own_page: Name of its page in `docs/formats`; that of the reader by default.
    """

    name: str
    title: str
    lacks: frozenset[str] = frozenset()
    fixed: Mapping[str, object] = field(default_factory=dict)
    takes: frozenset[str] = frozenset()
    layout: Layout = "nested"
    table: str = ""
    trains: LabelTask | None = None
    of: str = ""
    own_page: str = ""
    facts: frozenset[str] = frozenset(FACTS)
    derived: Mapping[str, frozenset[str]] = field(default_factory=dict)
    misread: tuple[str, ...] = ()

    @property
    def reader(self) -> str:
        """Name of the format that reads the result back; the row in which this writer stands."""
        return self.of or self.name

    @property
    def page(self) -> str:
        """Name of the page in `docs/formats`."""
        return self.own_page or f"{self.reader}.md"


@dataclass(frozen=True)
class Format:
    """One dataset format that can be read.

    Attributes:
        name: Name in `--format`, in reports and in run records.
        title: One line that describes the format.
        writers: Ways to write it; none if it is only read.
        any_camera: Whether it holds pictures of any camera, whose headers may state facts about the flight.
        written_as: Name of the format that `native` writes instead, for formats that are only read but share the
            labels of another, or hold too little of what a run inserts.
        room: Package below `infrablend.formats` that contains its module: `labels`, `published` or `pictures`.
    """

    name: str
    title: str
    writers: tuple[Writer, ...] = ()
    written_as: str = ""
    any_camera: bool = False
    room: Literal["labels", "published", "pictures"] = "labels"

    @property
    def module(self) -> str:
        """Dotted path of the module or package with `detect`, `read` and, if there are writers, `write`."""
        return f"infrablend.formats.{self.room}.{self.name.replace('-', '_')}"

    @property
    def page(self) -> str:
        """Name of the page in `docs/formats`."""
        return f"{self.name}.md"


def _set(names: str) -> frozenset[str]:
    return frozenset(names.split())


_PICTURES = _set("pictures")
# Facts of a picture that names in HIT-UAV's grammar contain, too.
_VIEW = _set("pitch_deg altitude_m time_of_day")
# HIT-UAV's reader derives the flight from the date.
_BY_DATE = {"date": _set("sequence captured")}
_YOLO_TABLE = "images/{split}/{name}"


def _yolo(name: str, title: str, holds: str, task: str, trains: LabelTask) -> Writer:
    # YOLO's readers, Ultralytics' among them, put `labels` in place of the last `images` of a picture's path, and ours
    # takes no pictures from `labels`.
    return Writer(
        name,
        title,
        frozenset(FIELDS) - {holds, "fractions", "telemetry", "sequence"},
        {"task": task},
        _set("dont_care without_mask"),
        "stems",
        _YOLO_TABLE,
        trains,
        "yolo",
        f"{name}.md",
        misread=("images", "labels"),
    )


FORMATS: tuple[Format, ...] = (
    Format("hit-uav", "HIT-UAV in any of its four annotation forms", room="published", writers=(
        Writer(
            "hit-uav", "HIT-UAV's normal_json and rotate_json",
            _set("masks tracks visibility occlusion truncated fractions sequence temperature"),
            {"forms": ("normal_json", "rotate_json")}, _set("ids extra pictures"), "unique", facts=_VIEW,
            derived=_BY_DATE,
        ),
        Writer(
            "hit-uav-xml", "HIT-UAV's normal_xml (VOC) and rotate_xml (roLabelImg)",
            _set("masks tracks visibility occlusion fractions telemetry sequence temperature"),
            {"forms": ("normal_xml", "rotate_xml")}, _PICTURES, "shared", of="hit-uav", facts=frozenset(),
            derived=_BY_DATE,
        ),
    )),
    Format("shards", "a run in shards: tars in WebDataset form (`output.layout`)"),
    Format("masks", "InfraBlend's own instance masks: 16-bit PNG files with tables", any_camera=True, writers=(
        Writer(
            "masks", "a 16-bit PNG of instance numbers per picture, and a table", _set("temperature"), takes=_PICTURES,
            layout="stems",
        ),
    )),
    Format("huggingface", "Hugging Face's imagefolder with `metadata.jsonl`", (
        Writer("huggingface", "Hugging Face's imagefolder with `metadata.jsonl`", takes=_PICTURES),
    )),
    Format("cvat", "CVAT's own XML, `CVAT for images 1.1` or `CVAT for video 1.1`", (
        Writer(
            "cvat", "CVAT's own XML, `CVAT for images 1.1`: rotated boxes, masks, attributes",
            _set("boxes occlusion temperature"), takes=_PICTURES, table=_YOLO_TABLE,
        ),
        Writer(
            "cvat-video", "CVAT's own XML, `CVAT for video 1.1`: a track per object, a file per sequence",
            _set("boxes masks occlusion temperature"), {"video": True}, _PICTURES, of="cvat",
        ),
    )),
    Format("label-studio", "Label Studio: tasks with rectangles, brushes, polygons", (
        Writer(
            "label-studio", "Label Studio: tasks with rotated rectangles and brush masks",
            _set("boxes occlusion temperature"), takes=_PICTURES, table=_YOLO_TABLE,
        ),
    )),
    Format("birdsai", "BIRDSAI: one CSV of tracks per sequence, or bare frames", room="published", writers=(
        Writer(
            "birdsai", "BIRDSAI: one CSV of tracks per sequence",
            _set("obb masks ignore visibility occlusion truncated difficult inserted temperature"),
            takes=_set("dont_care pictures"), facts=_VIEW | {"sequence", "captured", "frame", "time_s"},
        ),
    )),
    Format("mot", "MOTChallenge: one text of tracks per sequence of frames", (
        Writer(
            "mot", "MOTChallenge: one text of tracks per sequence of frames",
            _set("obb masks occlusion truncated difficult inserted temperature"), takes=_PICTURES,
        ),
    )),
    Format("wisard", "WiSARD: clips with YOLO text beside the frames", room="published", written_as="yolo"),
    Format("wit-uas", "WIT-UAS: runs with `.label` files beside the frames", room="published"),
    Format("dut-anti-uav", "DUT-Anti-UAV: drones in visible light, VOC labels", room="published", written_as="voc"),
    Format(
        "anti-uav", "Anti-UAV300, 410, 600: drones against the sky, a JSON or text per sequence",
        room="published", written_as="coco",
        writers=(
            Writer(
                "anti-uav", "Anti-UAV's JSON: a folder of numbered pictures per target, with `exist` and `gt_rect`",
                _set("obb masks ignore occlusion truncated difficult inserted temperature"),
                takes=_set("dont_care pictures"),
            ),
        ),
    ),
    Format(
        "halmstad", "Halmstad: thermal clips of drones, birds, aircraft; MATLAB labels",
        room="published", written_as="coco",
    ),
    Format(
        "drone-vehicle", "DroneVehicle: thermal and visible pairs, oriented boxes",
        room="published", written_as="dota",
    ),
    Format(
        "visdrone", "VisDrone: people and vehicles in visible light, in pictures or as tracks",
        room="published", written_as="coco",
    ),
    Format(
        "bambi", "BAMBI: wildlife from straight above, per flight: JSON, tracks or YOLO",
        room="published", written_as="coco",
    ),
    Format("dota", "DOTA text files: four corners in pixels", any_camera=True, writers=(
        Writer(
            "dota", "DOTA text files: four corners in pixels",
            _set("boxes masks tracks visibility occlusion truncated inserted temperature"), takes=_PICTURES,
            layout="flat", table="{split}/images/{name}",
        ),
    )),
    Format("monet", "MONET: COCO JSON that contains the drone's telemetry", room="published", writers=(
        Writer(
            "monet", "MONET's layout: one COCO JSON per sequence, with telemetry", _set("temperature"),
            takes=_set("ids extra pictures"),
        ),
    )),
    Format("coco", "COCO JSON, one file per split", any_camera=True, writers=(
        Writer("coco", "COCO JSON per split, masks as run lengths", takes=_set("ids pictures")),
        Writer(
            "coco-tools", "COCO JSON for annotation tools: category ids from 1, no outline without a mask",
            fixed={"without_mask": "omit", "from_one": True}, takes=_set("ids pictures"), of="coco",
        ),
        Writer(
            "rf-detr", "COCO JSON beside the pictures, a folder per split, for RF-DETR and Roboflow",
            fixed={"without_mask": "omit", "from_one": True, "beside": True}, takes=_set("ids pictures"), of="coco",
            layout="flat",
        ),
    )),
    Format("yolo", "Ultralytics YOLO with a `data.yaml`: detect, OBB or segment", any_camera=True, writers=(
        _yolo("yolo", "Ultralytics YOLO, axis-aligned boxes", "boxes", "detect", "detect"),
        _yolo("yolo-obb", "Ultralytics YOLO, oriented boxes", "obb", "obb", "obb"),
        _yolo("yolo-seg", "Ultralytics YOLO, one polygon per object", "masks", "seg", "segment"),
    )),
    Format("voc", "Pascal VOC: one XML file per picture", any_camera=True, writers=(
        Writer(
            "voc", "Pascal VOC: one XML file per picture",
            _set("obb masks tracks visibility occlusion temperature"), takes=_PICTURES, layout="shared",
            table="JPEGImages/{name}",
        ),
    )),
    Format("labelme", "labelme: one JSON of shapes per picture", written_as="coco", any_camera=True),
    Format("folder", "a plain folder of pictures, with or without labels", any_camera=True),
    Format("videos", "videos without labels: one file, or a folder of clips", room="pictures"),
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
    """Return the format of that name; an `UnknownFormatError` if there is none."""
    if found := next((f for f in FORMATS if f.name == name), None):
        return found
    raise UnknownFormatError(f"format {name!r}: expected one of {', '.join(f.name for f in FORMATS)}")


def find_writer(name: str) -> Writer:
    """Return the writer of that name; an `UnknownFormatError` if there is none."""
    if found := next((w for w in WRITERS if w.name == name), None):
        return found
    expected = ", ".join((*written_names(), NATIVE))
    raise UnknownFormatError(
        f"format {name!r} cannot be written: expected one of {expected}. For any other format write coco, which "
        "Datumaro and CVAT convert"
    )


def writer_for_task(task: str) -> Writer:
    """Return the writer of the format on which a detector for `task` (see `LabelTask`) is trained."""
    return next(w for w in WRITERS if w.trains == task)
