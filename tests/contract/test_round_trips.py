"""Round trips of every writer: equal to 1e-6 px in what the format holds, and a counted loss for the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from tests.samples import picture

from infrablend.config.recipe import Output
from infrablend.core.boxes import box_of_points, corners_of_box, corners_of_cxcywha
from infrablend.core.capture import FACTS, Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.format_table import FIELDS, NATIVE, WRITERS, Writer, find_format, written_names
from infrablend.core.format_table import FORMATS as TABLE
from infrablend.core.rle_masks import Mask
from infrablend.core.temperature import Radiometry, TemperatureScale
from infrablend.formats import dataset_folder, writing
from infrablend.formats.labels import yolo
from infrablend.formats.losses import LOSSES
from infrablend.formats.pictures.listing import read_size
from infrablend.formats.read_write import Reading, WriteSettings
from infrablend.formats.writing import load_writer

pytestmark = pytest.mark.thinned

ATOL_PX = 1e-6
SIZE_WH = (64, 48)
CATEGORIES = (Category(0, "Person"), Category(3, "small car"), Category(4, "DontCare", "", True))
every_writer = pytest.mark.parametrize("writer", WRITERS, ids=lambda w: w.name)


def mask(x0: int, y0: int, x1: int, y1: int) -> Mask:
    pixels = np.zeros((SIZE_WH[1], SIZE_WH[0]), np.bool_)
    pixels[y0:y1, x0:x1] = True
    return Mask.from_array(pixels)


TURNED = corners_of_cxcywha(np.array([20.5, 18.25, 12.0, 6.0, 0.4]))
PLAIN = Instance("Person", np.array([10.0, 20.0, 18.0, 25.0]))
# One object for each thing that a format may be unable to hold, with nothing else to lose.
WITH: dict[str, Instance | dict[str, object]] = {
    "boxes": replace(PLAIN, box_xyxy=np.array([15.0, 14.0, 26.0, 22.0]), corners_xy=TURNED),
    "obb": replace(PLAIN, box_xyxy=box_of_points(TURNED), corners_xy=TURNED),
    "masks": replace(PLAIN, mask=mask(10, 20, 18, 25)),
    "ignore": replace(PLAIN, category="DontCare"),
    "tracks": replace(PLAIN, track_id=7),
    "visibility": replace(PLAIN, visibility=0.5),
    "occlusion": replace(
        PLAIN,
        extra={"occluded": True, "amodal_box": [8.0, 20.0, 18.0, 26.0], "visible_box": [10.0, 20.0, 18.0, 25.0]},
    ),
    "truncated": replace(PLAIN, truncated=True),
    "difficult": replace(PLAIN, difficult=True),
    "fractions": replace(PLAIN, box_xyxy=np.array([10.25, 20.5, 18.125, 25.75])),
    "telemetry": {"pitch_deg": 37.5, "altitude_m": 61.25, "time_of_day": "night"},
    "sequence": {"sequence": "flight_01", "captured": "2021-01-31T08:30:00"},
    "temperature": {"radiometry": Radiometry(TemperatureScale(0.04))},
}


def image_with(folder: Path, instance: Instance, name: str = "a.png", **facts: object) -> ImageRecord:
    path = picture(folder / name, 1)
    return ImageRecord(path.stem, path, "train", SIZE_WH, (instance,), Capture(**facts), file_name=name)  # type: ignore[arg-type]


def round_trip(
    writer: Writer,
    images: list[ImageRecord],
    out: Path,
    categories: tuple[Category, ...] = CATEGORIES,
    **choice: object,
) -> tuple[Dataset, dict[str, int]]:
    """The images written and read again, without an error, and the losses by kind (forms together)."""
    settings = WriteSettings(**choice)  # type: ignore[arg-type]
    written = writing.write(writer.name, out, images, categories, settings=settings)
    assert set(written.files) == {p for p in out.rglob("*") if p.is_file()}
    # MONET is recognised by its telemetry, which some samples lack, and which is required unless waived.
    options = {"empty": "keep", "pitch_sign": "-1"} if writer.name == "monet" else {}
    again = dataset_folder.read(out, Reading(format="monet" if options else None, options=options))
    if writer.name == "yolo-seg":
        again = yolo.read(out, task="seg")  # a polygon of four corners may be either
    assert again.format == writer.reader
    assert [str(p) for p in again.problems if p.severity == "error"] == []
    losses: dict[str, int] = {}
    forms = len(writer.fixed.get("forms", (1,)))
    for kind in {key.rpartition(".")[2] for key in written.losses}:
        counts = [n for key, n in written.losses.items() if key.rpartition(".")[2] == kind]
        # HIT-UAV's two forms complement each other.
        if kind in written.losses or len(counts) == forms or kind == "fraction_truncated":
            losses[kind] = max(counts)
    assert set(losses) <= set(LOSSES) and all(n > 0 for n in written.losses.values())
    return again, losses


def held(field: str, given: ImageRecord, found: ImageRecord) -> bool:
    """Return whether the field that `WITH[field]` adds was read back."""
    if field == "telemetry":
        facts = (found.capture.pitch_deg, found.capture.altitude_m, found.capture.time_of_day)
        return facts == (given.capture.pitch_deg, given.capture.altitude_m, given.capture.time_of_day)
    if field == "temperature":
        scales = [None if i.capture.radiometry is None else i.capture.radiometry.scale for i in (found, given)]
        return scales[0] == scales[1]
    if field == "sequence":
        return (found.capture.sequence, found.capture.captured) == (given.capture.sequence, given.capture.captured)
    a = given.instances[0]
    if not found.instances:
        return False
    b = found.instances[0]
    checks: dict[str, Callable[[], bool]] = {
        "boxes": lambda: np.allclose(a.box_xyxy, b.box_xyxy, rtol=0, atol=ATOL_PX),
        "obb": lambda: b.corners_xy is not None and same_rectangle(a.corners_xy, b.corners_xy) <= ATOL_PX,
        "masks": lambda: a.mask == b.mask,
        "ignore": lambda: b.category == "DontCare",
        "tracks": lambda: str(b.track_id) == str(a.track_id),
        "visibility": lambda: a.visibility == b.visibility,
        "occlusion": lambda: all(b.extra.get(k) == v for k, v in a.extra.items()),
        "truncated": lambda: b.truncated is True,
        "difficult": lambda: b.difficult is True,
        "fractions": lambda: np.allclose(a.box_xyxy, b.box_xyxy, rtol=0, atol=ATOL_PX),
    }
    return bool(checks[field]())


def same_rectangle(a: object, b: object) -> float:
    """Largest distance in px of two oriented boxes' corners; a box may be counted from the opposite corner."""
    return min(float(np.abs(np.roll(np.asarray(a), k, axis=0) - np.asarray(b)).max()) for k in (0, 2))


@every_writer
@pytest.mark.parametrize("field", sorted(WITH))
def test_declared_losses_occur(writer: Writer, field: str, tmp_path: Path) -> None:
    extra = WITH[field]
    image = image_with(tmp_path, extra) if isinstance(extra, Instance) else image_with(tmp_path, PLAIN, **extra)
    # Objects without a mask are left out of yolo-seg unless their box is asked for.
    again, losses = round_trip(writer, [image], tmp_path / "out", without_mask="obb")
    loss = FIELDS[field][1]
    if field in writer.lacks:
        assert losses.get(loss) == 1, losses
    else:
        assert loss not in losses
        assert held(field, image, again.images[0]), again.images[0]


# Without the origin, a height that the aircraft measured would be multiplied by the factor for published tables.
FACT = {
    "pitch_deg": 37.5,
    "altitude_m": 61.25,
    "time_of_day": "night",
    "hfov_deg": 33.0,
    "roll_deg": -7.5,
    "altitude_from": "laser",
    "sequence": "flight 1",
    "captured": "2021-01-31T08:30:00+01:00",
    "frame": 12,
    "time_s": 0.48,
    "camera": "DJI M3T",
    "latitude_deg": -1.4585,
    "longitude_deg": -48.4468,
    "yaw_deg": 61.3,
    "flight_yaw_deg": 55.0,
}


@every_writer
@pytest.mark.parametrize("fact", sorted(FACTS))
def test_every_fact_of_a_picture_is_kept_or_counted(writer: Writer, fact: str, tmp_path: Path) -> None:
    image = image_with(tmp_path, PLAIN, **{"pitch_deg": 60.0, "altitude_m": 50.0, fact: FACT[fact]})
    again, losses = round_trip(writer, [image], tmp_path / "out", without_mask="obb")
    kept = getattr(again.images[0].capture, fact) == FACT[fact]
    assert kept == (fact in writer.facts)
    assert kept or losses[FIELDS[FACTS[fact].field][1]] == 1


@pytest.mark.parametrize("writer", [w for w in WRITERS if w.table], ids=lambda w: w.name)
def test_dates_that_a_table_cannot_hold_are_counted(writer: Writer, tmp_path: Path) -> None:
    facts = {"pitch_deg": 60.0, "sequence": "one", "captured": "some day"}
    again, losses = round_trip(writer, [image_with(tmp_path, PLAIN, **facts)], tmp_path / "out", without_mask="obb")
    assert (again.images[0].capture.sequence, again.images[0].capture.captured, losses["sequence_dropped"]) == (
        "one",
        None,
        1,
    )


REAL = {
    "hit-uav": (("hit-uav",), 290, 2460),
    "wisard": (("wisard",), 35, 97),
}


@every_writer
@pytest.mark.parametrize("name", sorted(REAL))
def test_real_labels_come_back(writer: Writer, name: str, real_data: Path, tmp_path: Path) -> None:
    folder, images_there, objects_there = REAL[name]
    source = dataset_folder.read(real_data.joinpath(*folder), Reading(splits=["val"] if name == "hit-uav" else None))
    given = [i if i.size_wh else replace(i, size_wh=read_size(i.path, i.name)[0]) for i in source.images]
    counted = (len(given), sum(len(i.instances) for i in given))
    assert counted == (images_there, objects_there)
    settings = {"dont_care": "keep", "without_mask": "obb"}
    again, losses = round_trip(writer, given, tmp_path / "out", source.categories, **settings)
    of_file = {i.path.read_bytes(): i for i in again.images}
    assert len(of_file) == images_there
    worst = 0.0
    for before in given:
        after = of_file[before.path.read_bytes()]
        assert (after.split, after.size_wh) == (before.split, before.size_wh)
        assert len(after.instances) == len(before.instances)
        for a, b in zip(before.instances, after.instances, strict=True):
            assert b.category == a.category
            worst = max(worst, apart_px(writer, a, b, before.size_wh or (0, 0)))
            for field, attribute in (("difficult", "difficult"), ("truncated", "truncated")):
                if field not in writer.lacks and getattr(a, attribute) is not None:
                    assert getattr(b, attribute) == getattr(a, attribute)
        if "telemetry" not in writer.lacks:
            assert held("telemetry", before, after)
    assert worst <= (0.02 if writer.name == "yolo-seg" else ATOL_PX)
    undeclared = {k for k, n in losses.items() if n} - {FIELDS[f][1] for f in writer.lacks}
    assert undeclared <= {
        "obb_from_box",
        "corners_clamped",
        "mask_from_obb",
        "name_changed",
        "mask_absent",
        "box_clipped",
        "class_unfit",
        "track_made",
        "track_renumbered",
        "visibility_made",
        "sequence_made",
        "frame_renumbered",
        "unlabelled_unsaid",
        "empty_unsaid",
    }


def apart_px(writer: Writer, a: Instance, b: Instance, size_wh: tuple[int, int]) -> float:
    """Return the largest deviation of the geometry after a round trip, px."""
    frame = np.array([*size_wh, *size_wh], np.float64)
    turned = a.corners_xy if a.corners_xy is not None else corners_of_box(a.box_xyxy)
    apart = 0.0
    if "obb" not in writer.lacks and a.corners_xy is not None:
        assert b.corners_xy is not None
        wanted = np.clip(turned, 0, frame[:2]) if writer.reader == "yolo" else turned
        apart = same_rectangle(wanted, b.corners_xy)
    if "boxes" in writer.lacks:
        if writer.name == "yolo-seg":
            return 0.0
        bounds = np.clip(box_of_points(turned), 0, frame)
        return max(apart, float(np.abs(bounds - b.box_xyxy).max()))
    wanted = np.trunc(a.box_xyxy) if "fractions" in writer.lacks else a.box_xyxy
    return max(apart, float(np.abs(wanted - b.box_xyxy).max()))


def test_the_upright_box_of_every_oriented_one_is_hit_uavs_own(real_data: Path) -> None:
    """Corners' bounds, truncated toward zero, are HIT-UAV's integers for each of its shared annotations."""
    oriented = dataset_folder.read(real_data / "hit-uav", Reading(form="rotate_json"))
    upright = dataset_folder.read(real_data / "hit-uav", Reading(form="normal_json"))
    compared = 0
    for a, b in zip(oriented.images, upright.images, strict=True):
        for x, y in zip(a.instances, b.instances, strict=True):
            assert x.corners_xy is not None and x.source_id == y.source_id and x.category == y.category
            assert np.trunc(box_of_points(x.corners_xy)).tolist() == y.box_xyxy.tolist()
            compared += 1
    assert compared == 15977


def test_the_recipe_knows_every_writer() -> None:
    wanted = [*written_names(), NATIVE]
    assert sorted(Output(formats=tuple(wanted)).formats) == sorted(wanted)
    assert Output().formats == ("yolo", "yolo-obb", "yolo-seg", "coco", "native")


def test_every_row_of_the_table_has_its_module_and_its_page() -> None:
    """A page that no row names is as much an error as a row without a page."""
    pages = {f.name for f in (Path(__file__).parents[2] / "docs" / "formats").glob("*.md")}
    assert {f.page for f in TABLE} | {w.page for w in WRITERS} == pages
    for f in TABLE:
        module = import_module(f.module)
        assert f.name == module.NAME
        assert callable(module.read) and callable(module.detect)
        assert bool(f.writers) == hasattr(module, "write")
        assert not f.written_as or find_format(f.written_as).writers
    assert len({f.name for f in TABLE}) == len(TABLE) and len({w.name for w in WRITERS}) == len(WRITERS)


@every_writer
def test_losses_declared_by_writers_are_known(writer: Writer) -> None:
    assert writer.lacks <= set(FIELDS)
    assert {kind for _, kind in FIELDS.values()} <= set(LOSSES)
    assert callable(load_writer(writer))
    assert writer in find_format(writer.reader).writers


@every_writer
def test_the_order_of_the_records_does_not_matter(writer: Writer, tmp_path: Path) -> None:
    images = [image_with(tmp_path, PLAIN, f"{k}.png") for k in range(3)]
    trees = []
    # The third time over what is there.
    for out, records in ((tmp_path / "a", images), (tmp_path / "b", images[::-1]), (tmp_path / "a", images)):
        round_trip(writer, records, out, without_mask="obb")
        trees.append({p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file()})
    assert trees[0] == trees[1] == trees[2]
