"""Contact sheets, and reading run folders for them."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend.core.dataset import Instance
from infrablend.core.frame_row import FrameRecord
from infrablend.core.ledger import DoneFrame, Ledger
from infrablend.core.rle_masks import Mask
from infrablend.core.scene import Appearance, CameraSpec, SceneSpec, View
from infrablend.errors import ArgumentError, InfraBlendError, OutputError
from infrablend.report.preview import (
    FILL,
    INSERTED,
    INSET_WH,
    PreviewFrame,
    contact_sheet,
    draw_labels,
    inset_window,
    load_frames,
    preview_run,
)
from tests.fuzzing import with_size

SIZE_WH = (160, 120)


def rectangle_mask(x0, y0, x1, y1, size_wh=SIZE_WH):
    mask = np.zeros(size_wh[::-1], np.bool_)
    mask[y0:y1, x0:x1] = True
    return Mask.from_array(mask)


def make_instance(x0=40, y0=30, x1=70, y1=50, size_wh=SIZE_WH, **changes):
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], np.float64)
    instance = Instance(
        "drone",
        np.array([x0, y0, x1, y1], np.float64),
        corners,
        rectangle_mask(x0, y0, x1, y1, size_wh),
        1.0,
        inserted=True,
    )
    return replace(instance, **changes)


def grey(value=100, size_wh=SIZE_WH):
    return np.full((*size_wh[::-1], 3), value, np.uint8)


def pixels_of(path):
    with Image.open(path) as image:
        return np.asarray(image)


def frame(*instances, title="test/a_c0   pitch 60°"):
    return PreviewFrame(title, grey()[:, :, 0], instances)


# ---- drawing


def test_mask_is_filled_lightly_inside_and_nothing_changes_outside():
    drawn = draw_labels(grey(), [make_instance()], ["masks"], names=False)
    expected = np.round((1 - FILL) * 100 + FILL * np.array(INSERTED["masks"]))
    np.testing.assert_array_equal(drawn[40, 55], expected)  # inside
    np.testing.assert_array_equal(drawn[30, 40], INSERTED["masks"])  # on the outline
    changed = (drawn != 100).any(axis=2)
    rows, columns = np.nonzero(changed)
    assert (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) == (40, 30, 70, 50)


@pytest.mark.parametrize("scale", [1, 4])
def test_box_lies_on_the_pixel_edges_it_names(scale):
    """Half-open box 40..70: its left line straddles the edge between columns 39 and 40, in every enlargement."""
    canvas = np.repeat(np.repeat(grey(), scale, 0), scale, 1)
    drawn = draw_labels(canvas, [make_instance(mask=None)], ["boxes"], scale, names=False)
    row = np.abs(drawn[40 * scale].astype(int) - 100).sum(axis=1)
    (where,) = np.nonzero(row > 100)  # antialiasing leaves a trace one pixel further
    assert set(where) == {40 * scale - 1, 40 * scale, 70 * scale - 1, 70 * scale}


def test_origin_moves_the_labels():
    whole = draw_labels(grey(), [make_instance()], names=False)
    part = draw_labels(grey()[20:, 30:], [make_instance()], origin_xy=(30, 20), names=False)
    np.testing.assert_array_equal(part, whole[20:, 30:])


def test_only_what_is_asked_for_is_drawn():
    square = np.array([[55, 10], [85, 40], [55, 70], [25, 40]], np.float64)
    instance = make_instance(corners_xy=square)

    def at(drawn, row, column):
        return not np.array_equal(drawn[row, column], [100, 100, 100])

    boxes, obb, masks = (draw_labels(grey(), [instance], [d], names=False) for d in ("boxes", "obb", "masks"))
    for drawn, on_box, on_obb, in_mask in ((boxes, 1, 0, 0), (obb, 0, 1, 0), (masks, 0, 0, 1)):
        assert at(drawn, 29, 60) == on_box  # above the top edge's middle: the half outside of the line
        assert at(drawn, 15, 60) == on_obb
        assert at(drawn, 40, 55) == in_mask


def test_originals_are_muted_and_below_inserted_ones():
    original = make_instance(30, 30, 60, 50, inserted=False, category="Car")
    inserted = make_instance()
    colours = {i.inserted: draw_labels(grey(0), [i], ["boxes"], names=False).max() for i in (original, inserted)}
    assert colours[False] < 0.7 * colours[True]
    both = draw_labels(grey(0), [inserted, original], names=False)
    np.testing.assert_array_equal(both, draw_labels(grey(0), [original, inserted], names=False))
    # Where the original's right side crosses the new mask's outline, the outline is whole.
    np.testing.assert_array_equal(both[49, 45], draw_labels(grey(0), [inserted], names=False)[49, 45])


def test_names_stay_inside_the_picture():
    corner = make_instance(0, 0, 8, 6)
    other = make_instance(150, 112, 160, 120)
    drawn = draw_labels(grey(), [corner, other])
    assert drawn.shape == grey().shape
    plain = draw_labels(grey(), [corner, other], names=False)
    changed = (drawn != plain).any(axis=2)
    assert changed[:40, :60].any()
    assert changed[80:, 100:].any()


def test_the_picture_given_is_left_alone():
    picture = grey()
    draw_labels(picture, [make_instance()])
    np.testing.assert_array_equal(picture, grey())


def test_boxes_far_outside_are_harmless():
    drawn = draw_labels(grey(), [make_instance(mask=None, box_xyxy=np.array([-1e9, -1e9, 1e9, 1e9]))], names=False)
    assert drawn.shape == grey().shape


# ---- insets


@pytest.mark.parametrize(("side", "zoom"), [(10, 4), (60, 4), (80, 3), (100, 2), (400, 2)])
def test_inset_zoom(side, zoom):
    size_wh = (640, 512)
    instance = make_instance(100, 90, 100 + side, 90 + side // 2, size_wh)
    (x0, y0, x1, y1), found = inset_window(instance, size_wh)
    assert found == zoom
    assert (x1 - x0) * zoom <= INSET_WH[0]
    assert (y1 - y0) * zoom <= INSET_WH[1]
    assert 0 <= x0 < x1 <= 640
    assert 0 <= y0 < y1 <= 512
    if side < 150:
        assert x0 <= 100
        assert y0 <= 90
        assert x1 >= 100 + side
        assert y1 >= 90 + side // 2
    else:  # the top of its edge is in sight
        assert y0 < 90 < y1


def test_inset_at_the_corner_and_in_a_frame_smaller_than_it():
    (x0, y0, x1, y1), _ = inset_window(make_instance(0, 0, 5, 5), SIZE_WH)
    assert (x0, y0) == (0, 0)
    tiny = make_instance(10, 10, 20, 20, (32, 24))
    (x0, y0, x1, y1), zoom = inset_window(tiny, (32, 24))
    assert (x0, y0, x1, y1, zoom) == (0, 0, 32, 24, 4)


def test_sheet_shows_the_object_enlarged_by_nearest_neighbour(tmp_path):
    pixels = np.random.default_rng(3).integers(0, 255, SIZE_WH[::-1]).astype(np.uint8)
    instance = make_instance()
    out = contact_sheet([PreviewFrame("t", pixels, (instance,))], tmp_path / "s.png")
    sheet = pixels_of(out)[:, :, 0]
    (x0, y0, x1, y1), zoom = inset_window(instance, SIZE_WH)
    large = np.kron(pixels[y0:y1, x0:x1], np.ones((zoom, zoom), np.uint8))
    h, w = large.shape
    row = np.nonzero((sheet[:, 6 : 6 + 8] == large[0, :8]).all(axis=1))[0]
    assert any(np.array_equal(sheet[r : r + h, 6 : 6 + w], large) for r in row)


# ---- sheets


def test_a_sheet_replaces_an_earlier_sheet_and_no_other_file(tmp_path):
    out = contact_sheet([frame(make_instance())], tmp_path / "a.png")
    again = contact_sheet([frame()], out)
    assert again == out
    Image.fromarray(grey()).save(out)
    own = out.read_bytes()
    with pytest.raises(OutputError, match="not a contact sheet of InfraBlend"):
        contact_sheet([frame()], out)
    assert out.read_bytes() == own


def test_sheet_is_the_same_bytes_twice(tmp_path):
    frames = [frame(make_instance(), make_instance(5, 5, 20, 20, inserted=False)), frame()]
    a, b = contact_sheet(frames, tmp_path / "a.png"), contact_sheet(frames, tmp_path / "b.png")
    assert a.read_bytes() == b.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]


@pytest.mark.parametrize(("count", "across"), [(1, 1), (3, 2), (5, 3), (13, 4)])
def test_columns(tmp_path, count, across):
    blank = PreviewFrame("t", grey()[:, :, 0], ())
    path = contact_sheet([blank] * count, tmp_path / "s.png")
    assert pixels_of(path).shape[1] == across * (160 + 12)


def test_many_inserted_objects_are_not_all_enlarged(tmp_path):
    three = [make_instance(10 + 30 * k, 10, 30 + 30 * k, 20) for k in range(3)]
    few = len(pixels_of(contact_sheet([frame(*three)], tmp_path / "few.png")))
    many = len(pixels_of(contact_sheet([frame(*three, *three)], tmp_path / "many.png")))
    assert 0 < many - few < 40  # one line of text instead of three more pairs


def test_16_bit_and_colour_frames(tmp_path):
    deep = (np.arange(160 * 120).reshape(120, 160) * 3 + 20_000).astype(np.uint16)
    sheet = contact_sheet([PreviewFrame("deep", deep, ()), PreviewFrame("rgb", grey(), ())], tmp_path / "s.png")
    left = pixels_of(sheet)[-120:-10, 10:160]
    assert left.max() == 255
    assert left.min() < 30


def test_a_sheet_that_cannot_be_written_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        contact_sheet([frame()], tmp_path / "file" / "s.png")


# ---- run folders


@pytest.fixture
def run(tmp_path):
    """A run of three test frames; the last has no inserted object; b's picture is in a group folder."""
    root = tmp_path / "run"
    names = ["a_c0.png", "p60/b_c0.png", "c_c0.png"]
    images, annotations = [], []
    for n, name in enumerate(names):
        path = root / "images" / "test" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((120, 160), 50 + n, np.uint8))
        images.append({"id": n + 1, "file_name": name, "width": 160, "height": 120})
        car = {"id": 10 * n, "image_id": n + 1, "category_id": 1, "bbox": [1, 2, 10, 11]}
        annotations.append({**car, "segmentation": [[1, 2, 11, 2, 11, 13, 1, 13]], "segmentation_from": "box"})
        if n < 2:
            drone = {
                "id": 10 * n + 1, "image_id": n + 1, "category_id": 5, "bbox": [40.5, 30, 30, 20.25], "inserted": True,
                "segmentation": rectangle_mask(40, 30, 70, 50).to_coco(), "obb": [40, 30, 70, 30, 70, 50, 40, 50],
                "visibility": 0.75,
            }  # fmt: skip
            annotations.append(drone)
    categories = [{"id": 1, "name": "Car"}, {"id": 5, "name": "drone"}]
    (root / "coco").mkdir()
    (root / "coco" / "test.json").write_text(
        json.dumps({"images": images[::-1], "annotations": annotations, "categories": categories})
    )
    write_ledger(root, view=None)
    return root


def write_ledger(run, view):
    """Write the ledger of the run; its one scene looks straight ahead."""
    background = {"pitch_deg": 60.0, "altitude_m": 80.0, "time_of_day": "night"}
    camera = CameraSpec(10.0, 0.0, 0.0, 0.0, 0.4, (160, 120))
    scene = SceneSpec("test/a_c0", "a", "test", 0, camera, (), 290.0, Appearance(), 0, 0, view=view)
    record = FrameRecord("test/a_c0", "test/a_c0.png", "", background, scene, None, (), (make_instance(),))
    with Ledger.create(run, {}) as ledger:
        ledger.add(record.frame_id, DoneFrame(record.image, 1, "", 1), record.to_text())


def test_load_frames(run):
    first, second = load_frames(run)
    assert first.title == "test/a_c0   pitch 0°   altitude 80 m   night"  # the pitch used, not the metadata's
    assert second.title == "test/b_c0"
    assert (first.pixels == 50).all()
    assert (second.pixels == 51).all()
    assert first.pixels.shape == (120, 160)
    car, drone = first.instances
    assert (car.category, car.inserted, car.mask, car.corners_xy) == ("Car", False, None, None)
    np.testing.assert_array_equal(car.box_xyxy, [1, 2, 11, 13])
    assert (drone.category, drone.inserted, drone.visibility) == ("drone", True, 0.75)
    np.testing.assert_array_equal(drone.box_xyxy, [40.5, 30, 70.5, 50.25])
    np.testing.assert_array_equal(drone.corners_xy, [[40, 30], [70, 30], [70, 50], [40, 50]])
    assert drone.mask == rectangle_mask(40, 30, 70, 50)


def test_the_title_shows_the_height_of_the_camera_that_was_used(run):
    write_ledger(run, View(60.0, 60.04, 0.0, {}, 0.1))
    assert load_frames(run)[0].title == "test/a_c0   pitch 0°   altitude 60 m   night"


def test_polygons_and_plain_run_lengths_are_masks_too(run):
    path = run / "coco" / "test.json"
    document = json.loads(path.read_text())
    drone = next(a for a in document["annotations"] if a["id"] == 1)
    for form in ([[40, 30, 70, 30, 70, 50, 40, 50]], {"size": [120, 160], "counts": [5, 7, 120 * 160 - 12]}):
        drone["segmentation"] = form
        path.write_text(json.dumps(document))
        mask = load_frames(run)[0].instances[1].mask
        assert mask.area_px == (600 if isinstance(form, list) else 7)


def test_count_spreads_over_the_run(run):
    assert [f.title[:9] for f in load_frames(run, 1)] == ["test/b_c0"]
    assert len(load_frames(run, 2)) == 2
    assert len(load_frames(run, 99)) == 2


def test_run_without_coco_is_shown_from_its_records(run):
    (run / "coco" / "test.json").unlink()
    (only,) = load_frames(run)
    assert only.title.startswith("test/a_c0   pitch 0°")
    assert [i.category for i in only.instances] == ["drone"]
    assert only.instances[0].equals(make_instance())


def test_preview_run_writes_a_picture(run):
    path = preview_run(run, run / "preview.png", count=2, draw=("boxes",))
    with Image.open(path) as sheet:
        assert sheet.format == "PNG"
        assert sheet.size[0] > 2 * 160
    with pytest.raises(ArgumentError, match="'polygons'"):
        preview_run(run, run / "preview.png", draw=["polygons"])


def claim_size(picture: Path) -> None:
    """Claim more pixels than memory holds."""
    picture.write_bytes(with_size(picture.read_bytes(), 30_000, 30_000))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda run: (run / "images/test/a_c0.png").unlink(), r"a_c0\.png: not a readable picture"),
        (lambda run: (run / "images/test/a_c0.png").write_bytes(b"x"), r"a_c0\.png: not a readable picture"),
        (lambda run: claim_size(run / "images/test/a_c0.png"), r"a_c0\.png: not a readable picture"),
        (lambda run: (run / "coco/test.json").write_text("{"), r"test\.json: not a COCO file .*JSONDecodeError"),
        (lambda run: (run / "coco/test.json").write_text('{"images": []}'), r"not a COCO file .*KeyError"),
        (lambda run: (run / "coco").rename(run / "cocoa") and (run / "run.sqlite").unlink(), "folder of a run"),
    ],
)
def test_damaged_runs_are_clear_errors(run, damage, words):
    damage(run)
    with pytest.raises(InfraBlendError, match=words):
        load_frames(run)
