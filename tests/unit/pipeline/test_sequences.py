"""Objects that move through sequences: tracks, frozen pictures, cuts, levels, and the same bytes in any order."""

import json
import math
import re
from itertools import pairwise
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.run_folder import RunFolder
from infrablend.errors import ArgumentError, DatasetError, OutputError, RecipeError
from infrablend.imaging.paint_out import Shown
from infrablend.pipeline.compose.looks import Earlier, PhysicalLook
from infrablend.pipeline.compose.sequence_objects import Sequences
from tests.unit.imaging.test_sequence import frame, path, scene

STATED = ["camera.pitch={fixed_deg: 60}", "camera.altitude={fixed_m: 40}", "camera.roll_deg=[0, 0]"]
MOVING = ["objects.0.motion={kind: walk}", "objects.0.count=3", "placement.where=anywhere", "output.image=png"]
SETTINGS = [*STATED, *MOVING, "placement.max_relief_grey=0", "placement.min_contrast=off"]
FROZEN, CUT, LOST = 5, 12, 15


@pytest.fixture(autouse=True, scope="module")
def own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("INFRABLEND_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setenv("INFRABLEND_LOG", str(tmp_path_factory.mktemp("log") / "log.txt"))
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Return a clip of a camera that pans: frozen in one frame, then another scene, in the end an empty sky."""
    folder = tmp_path_factory.mktemp("data")
    pictures = [frame(scene(), at, seed=k)[0].grey for k, at in enumerate(path(CUT, (4.0, 0.5)))]
    pictures[FROZEN] = pictures[FROZEN - 1]
    pictures += [frame(scene(5), at, seed=40 + k)[0].grey for k, at in enumerate(path(LOST - CUT, (4.0, 0.5)))]
    pictures += [np.full_like(pictures[0], 100)] * 2
    for k, grey in enumerate(pictures):
        cv2.imwrite(str(folder / f"clip_{k:03}.png"), grey)
    return folder


def generate(data, out, *, settings=(), **kwargs):
    kwargs = {"execution": api.Execution(renderer="flat", in_process=True)} | kwargs
    return api.generate("deer-above", data, out, settings=[*SETTINGS, *settings], **kwargs)


@pytest.fixture(scope="module")
def made(data, tmp_path_factory):
    """Return a run with the default settings, and its report."""
    out = tmp_path_factory.mktemp("made") / "run"
    return out, generate(data, out)


def labels(out):
    """Return the boxes of the tracks in each picture, by name."""
    coco = json.loads((out / "coco" / "train.json").read_text())
    found = {i["file_name"]: {} for i in coco["images"]}
    names = {i["id"]: i["file_name"] for i in coco["images"]}
    for a in coco["annotations"]:
        found[names[a["image_id"]]][a["track_id"]] = a["bbox"]
    return dict(sorted(found.items()))


def test_each_object_is_one_track_in_its_span_and_none_is_in_what_is_not_known(made):
    out, report = made
    frames = list(labels(out).values())
    assert len(frames) == 17 and report.counts["images"] == 17
    assert frames[0]
    first = {t for f in frames[:CUT] for t in f}
    second = {t for f in frames[CUT:LOST] for t in f}
    assert second and not first & second
    assert frames[LOST] == frames[LOST + 1] == {}
    assert report.counts["frames_without_object_because"]["camera_lost"] == 2
    codes = {p.code for p in report.problems}
    assert {"motion-cut", "motion-lost", "frame-rate"} <= codes


def test_a_box_goes_with_the_background_and_hardly_changes_its_size(data, tmp_path):
    generate(data, tmp_path / "run", settings=["objects.0.motion={kind: still}"])
    frames = list(labels(tmp_path / "run").values())
    for a, b in pairwise(frames[:FROZEN]):
        for track in a.keys() & b.keys():
            (x0, y0, w0, h0), (x1, y1, w1, h1) = a[track], b[track]
            if min(x0, y0, x1, y1) > 0 and x0 + w0 < 320 and x1 + w1 < 320 and y0 + h0 < 256 and y1 + h1 < 256:
                assert x1 + w1 / 2 - x0 - w0 / 2 == pytest.approx(-4.0, abs=0.3)
                assert (w1 / w0, h1 / h0) == (pytest.approx(1, abs=0.02), pytest.approx(1, abs=0.02))


def test_a_frozen_picture_freezes_what_is_inserted(data, tmp_path):
    generate(data, tmp_path / "run", settings=["objects.0.motion={kind: run}"])
    frames = labels(tmp_path / "run")
    before, frozen, after = (frames[f"clip_{n:06d}.png"] for n in (FROZEN - 1, FROZEN, FROZEN + 1))
    assert before == frozen != after
    pictures = [cv2.imread(str(tmp_path / "run" / "images" / "train" / f"clip_{n:06d}.png"), -1) for n in (4, 5)]
    np.testing.assert_array_equal(*pictures)


def test_frames_alone_are_those_of_the_whole_run_and_workers_do_not_matter(data, made, tmp_path):
    run, _ = made
    chosen = ["train/clip_000008", "train/clip_000003", "train/clip_000013"]
    generate(data, tmp_path / "some", selection=api.FrameSelection(frames=chosen))
    two = api.Execution(renderer="flat", workers=2)
    generate(data, tmp_path / "two", execution=two)
    pictures = sorted(p.relative_to(run) for p in (run / "images").rglob("*.png"))
    assert len(pictures) == 17
    for name in pictures:
        assert (tmp_path / "two" / name).read_bytes() == (run / name).read_bytes()
    for name in chosen:
        picture = f"images/{name}.png"
        assert (tmp_path / "some" / picture).read_bytes() == (run / picture).read_bytes()
    for name in ("tracks/train/clip/gt/gt.txt", "video/train/clip.mp4"):
        assert (tmp_path / "two" / name).read_bytes() == (run / name).read_bytes()


def test_a_frame_is_also_named_by_its_background_and_configuration_as_the_studio_does(data, made, tmp_path):
    run, _ = made
    generate(data, tmp_path / "one", selection=api.FrameSelection(frames=["train/clip_007_c0"]))
    (picture,) = (tmp_path / "one/images").rglob("*.png")
    assert picture.read_bytes() == (run / "images/train/clip_000007.png").read_bytes()


def test_a_frame_is_rendered_again_from_its_record(made, tmp_path):
    run, _ = made
    name = "train/clip_000007"
    api.rerender(run, name, tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (run / "images" / f"{name}.png").read_bytes()


def test_tracks_go_to_motchallenge_and_come_back(made):
    run, _ = made
    card = (run / "README.md").read_text()
    assert all(f"{folder}/<split>/" in card and (run / folder).is_dir() for folder in ("tracks", "video"))
    lines = (run / "tracks" / "train" / "clip" / "gt" / "gt.txt").read_text().splitlines()
    boxes = labels(run)
    assert len(lines) == sum(len(f) for f in boxes.values())
    for line in lines:
        number, track, *box = line.split(",")[:6]
        np.testing.assert_allclose(
            np.array(box, float) - (1, 1, 0, 0), boxes[f"clip_{int(number) - 1:06d}.png"][int(track)], atol=1e-3
        )


def test_two_configurations_are_two_sequences(data, tmp_path):
    generate(data, tmp_path / "run", settings=["configurations=2"])
    tracks = sorted(p.name for p in (tmp_path / "run" / "tracks" / "train").iterdir())
    assert tracks == ["clip_c0", "clip_c1"]
    assert len(labels(tmp_path / "run")) == 34


def test_a_movement_that_a_model_does_not_have_and_data_without_sequences_are_refused(data, tmp_path):
    with pytest.raises(RecipeError) as error:
        generate(data, tmp_path / "run", settings=["objects.0.motion={kind: hover}"])
    assert "still, walk, graze, run, drive" in str(error.value)
    (tmp_path / "one").mkdir()
    cv2.imwrite(str(tmp_path / "one" / "a.png"), cv2.imread(str(next(data.iterdir())), -1))
    with pytest.raises(DatasetError, match="no picture has a sequence"):
        generate(tmp_path / "one", tmp_path / "run")


def test_the_report_has_a_strip_per_track_and_the_preview_moves(made, tmp_path):
    run, _ = made
    page = (run / "report.html").read_text()
    assert 'id="tracks"' in page and re.search(r"deer clip c0 \d, 12 frames", page)
    for suffix in (".webp", ".gif"):
        out = tmp_path / f"moves{suffix}"
        for count in (4, 5):  # the second replaces the first
            api.preview(run, out, count=count)
        with Image.open(out) as picture:
            assert (picture.n_frames, picture.size) == (5, (320, 256))
        Image.new("L", (8, 8)).save(out)
        with pytest.raises(OutputError, match="not a contact sheet of InfraBlend"):
            api.preview(run, out)


STILL = ["objects.0.motion={kind: still}", "objects.1.count=0", "objects.2.count=0", "placement.size_px=[3, 400]"]


def clip(folder, pictures, name="clip"):
    """Write numbered pictures; texts are the bytes of a file that is none."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, picture in enumerate(pictures):
        if isinstance(picture, bytes):
            (folder / f"{name}_{k:03}.png").write_bytes(picture)
        else:
            cv2.imwrite(str(folder / f"{name}_{k:03}.png"), picture)
    return folder


def panned(count, seed=0, step=(4.0, 0.5), **kwargs):
    return [frame(scene(seed), at, seed=k, **kwargs)[0].grey for k, at in enumerate(path(count, step))]


def test_a_picture_that_cannot_be_read_costs_its_own_frame_only(tmp_path):
    pictures = panned(6)
    pictures[3] = cv2.imencode(".png", pictures[3])[1].tobytes()[:3000]
    report = generate(clip(tmp_path / "data", pictures), tmp_path / "run", settings=STILL)
    assert (report.counts["images"], report.counts["skipped_backgrounds"]) == (5, 1)
    codes = {p.code: p for p in report.problems}
    assert {"image-truncated", "frames-lost"} <= codes.keys() and "such as 3" in codes["frames-lost"].found
    assert all(labels(tmp_path / "run").values())


def test_two_sizes_in_one_sequence_are_two_spans(tmp_path):
    flat = np.full((200, 280), 100, np.uint8)  # lost between the two
    pictures = [*panned(3), flat, *(p[:200, :280].copy() for p in panned(3, seed=4))]
    report = generate(clip(tmp_path / "data", pictures), tmp_path / "run", settings=STILL)
    sizes = next(p for p in report.problems if p.code == "image-size" and p.where == "sequence clip")
    assert "320x256, 280x200 px" in sizes.found
    frames = list(labels(tmp_path / "run").values())
    assert frames[0] and frames[4] and not frames[3] and not frames[0].keys() & frames[4].keys()


def test_sequences_of_one_name_in_two_splits_are_two(tmp_path):
    for k, split in enumerate(("train", "val")):
        clip(tmp_path / "data" / split, panned(4, seed=k))
    rows = "".join(f"{split}/clip_{k:03}.png,clip,{k}\n" for split in ("train", "val") for k in range(4))
    (tmp_path / "data" / "metadata.csv").write_text("file,sequence,frame\n" + rows)
    generate(tmp_path / "data", tmp_path / "run", settings=STILL)
    for split in ("train", "val"):
        assert (tmp_path / "run" / "tracks" / split / "clip" / "gt" / "gt.txt").read_text()


def test_a_sequence_without_objects_says_why_and_its_run_is_clean(tmp_path):
    data = clip(tmp_path / "data", panned(4))
    report = generate(data, tmp_path / "run", settings=[*STILL, "objects.0.count=0"])
    assert report.counts["frames_without_object_because"] == {"recipe": 4}
    assert api.check(tmp_path / "run").ok()


def test_counts_are_those_of_the_frames_and_not_of_the_first_anchor(tmp_path):
    settings = [*STILL, "objects.0.count=1"]
    data = clip(tmp_path / "data", panned(8, step=(45.0, 0.5)))
    report = generate(data, tmp_path / "run", settings=settings)
    inserted = sum(len(f) for f in labels(tmp_path / "run").values())
    left_out = sum(report.counts.get("objects_left_out", {}).values())
    assert report.counts["objects_by_kind"] == {"objects.0": {"asked": inserted + left_out, "inserted": inserted}}
    empty = sum(not f for f in labels(tmp_path / "run").values())
    assert report.counts["frames_without_object_because"].get("out_of_view", 0) == empty


def test_a_palette_is_said_and_not_a_lost_camera(tmp_path):
    data = clip(tmp_path / "data", [cv2.applyColorMap(p, cv2.COLORMAP_JET) for p in panned(4)])
    report = generate(data, tmp_path / "run", settings=STILL)
    assert {p.code for p in report.problems if p.severity == "error"} >= {"image-colour-mapped"}
    assert report.counts["skipped_backgrounds"] == 4 and not report.counts["frames_without_object_because"]


def test_levels_of_16_bits_follow_the_gain_of_the_camera(tmp_path):
    eight = [*panned(3), *panned(6, gain=0.6, offset=44)[3:]]
    data = clip(tmp_path / "data", [3000 + 40 * p.astype(np.uint16) for p in eight])
    generate(data, tmp_path / "run", settings=[*STILL, "sensor.profile=off"])
    brighter = []
    for k, name in enumerate(sorted(labels(tmp_path / "run"))):
        picture, before = (
            cv2.imread(str(p), -1).astype(int)
            for p in (tmp_path / "run" / "images" / "train" / name, data / f"clip_{k:03}.png")
        )
        brighter.append(float((picture - before)[picture != before].mean()))
    assert np.mean(brighter[3:]) / np.mean(brighter[:3]) == pytest.approx(0.6, abs=0.1)


def test_a_camera_that_the_recipe_draws_is_that_of_the_whole_sequence(tmp_path):
    settings = [*STILL, "sensor.randomise={gain: [0.4, 1.6], noise_grey: [1, 2]}"]
    data = clip(tmp_path / "data", panned(4))
    generate(data, tmp_path / "run", settings=settings)
    cameras = [r.facts["camera"] for r in RunFolder(tmp_path / "run").records()]
    assert len({c["gain"] for c in cameras}) == 1 and len({c["noise_seed"] for c in cameras}) == 4
    assert len({c["stripes_seed"] for c in cameras}) == 1


def test_a_source_of_backgrounds_has_no_sequences():
    class Source:
        def dataset(self):
            raise AssertionError

        def load(self, image):
            raise AssertionError

    with pytest.raises(ArgumentError, match="files of whole sequences"):
        api.frames("deer-above", Source(), settings=SETTINGS, execution=api.Execution(renderer="flat", in_process=True))


def test_what_text_hides_has_no_label_in_that_frame(tmp_path, monkeypatch):
    data = clip(tmp_path / "data", panned(4))
    generate(data, tmp_path / "plain", settings=STILL)
    boxes = next(iter(labels(tmp_path / "plain").values()))
    (track, (x, y, w, h)), *others = sorted(boxes.items())
    text = np.zeros((256, 320), bool)
    text[int(y) - 3 : int(y + h) + 4, max(int(x) - 3, 0) : int(x + w) + 4] = True
    monkeypatch.setattr(Sequences, "_written", lambda self, name: text)
    monkeypatch.setattr(Shown, "thin", property(lambda self: text))
    report = generate(data, tmp_path / "run", settings=STILL)
    found = labels(tmp_path / "run")["clip_000000.png"]
    assert track not in found and found == dict(others)
    assert report.counts["objects_without_label"]["behind_text"] >= 1


def test_tracks_are_numbered_after_those_of_the_data_even_if_these_are_texts(tmp_path):
    data = clip(tmp_path / "data", panned(4))
    images = [
        {"id": k + 1, "file_name": f"clip_{k:03}.png", "width": 320, "height": 256, "sequence": "clip", "frame_id": k}
        for k in range(4)
    ]
    for ids, first in ((["1", "7"], 8), ([-5], 2)):
        boxes = [(i, t) for i in images for t in ids]
        annotations = [
            {
                "id": n + 1,
                "image_id": i["id"],
                "category_id": 1,
                "bbox": [8 + 30 * ids.index(t), 8, 9, 9],
                "track_id": t,
            }
            for n, (i, t) in enumerate(boxes)
        ]
        coco = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "deer"}]}
        (data / "annotations.json").write_text(json.dumps(coco))
        generate(data, tmp_path / f"run{first}", settings=STILL)
        tracks = {t for f in labels(tmp_path / f"run{first}").values() for t in f}
        assert tracks > {*ids} and min(tracks - {*ids}) == first


def test_a_run_is_read_as_coco_and_not_as_its_tracks(made):
    run, _ = made
    found = api.inspect(run)
    assert (found.format, sum(found.sequences.values())) == ("coco", 17)
    assert api.check(run).ok()


def test_frames_without_pitch_are_left_out_and_no_anchors(tmp_path):
    data = clip(tmp_path / "data", panned(5))
    rows = "".join(f"clip_{k:03}.png,60,40\n" for k in (1, 2, 4))
    (data / "metadata.csv").write_text("file,pitch_deg,altitude_m\n" + rows)
    moving = ["objects.0.motion={kind: still}", "placement.where=anywhere", "placement.size_px=[2, 400]"]
    out, flat = tmp_path / "run", api.Execution(renderer="flat", in_process=True)
    report = api.generate("hit-uav-people", data, out, settings=[*moving, "objects.0.count=3"], execution=flat)
    assert [p.where for p in report.problems if p.code == "no-pitch"] == ["train/clip_000.png", "train/clip_003.png"]
    assert report.counts["failed_frames"] == 0 and all(labels(out).values()) and len(labels(out)) == 3


def test_a_run_without_labels_of_pictures_is_not_read_as_its_tracks_either(tmp_path):
    data = clip(tmp_path / "data", panned(4))
    generate(data, tmp_path / "run", settings=[*STILL, "output.formats=[]"])
    assert (tmp_path / "run" / "tracks" / "train" / "clip" / "gt" / "gt.txt").is_file()
    assert sum(n["images"] for n in api.inspect(tmp_path / "run").splits.values()) == 4


@pytest.mark.parametrize("polarity", ["white-hot", "black-hot"])
def test_gain_and_offset_are_those_of_the_picture_that_is_matched(polarity):
    """Black-hot pictures are matched turned to white-hot; gain and offset are those of the levels in the file."""
    low, high, gain, offset = 10.0, 240.0, 0.6, 44.0
    look = SimpleNamespace(_matching=SimpleNamespace(polarity=polarity), _settings=SimpleNamespace(levels=(low, high)))
    through = SimpleNamespace(through=lambda g, o: (g, o))
    g, o = PhysicalLook._settled(look, Earlier(SimpleNamespace(settled=through), gain, offset))
    turned = (lambda level: low + high - level) if polarity == "black-hot" else (lambda level: level)
    for level in (30.0, 200.0):
        assert g * turned(level) + o == pytest.approx(turned(gain * level + offset))


@pytest.mark.parametrize(
    ("column", "seconds", "smeared"), [("captured", 2.5, None), ("time_s", 1 / 60, True), (None, 0.0, False)]
)
def test_blur_follows_from_the_times_of_the_data(tmp_path, column, seconds, smeared):
    """As far as objects are long: an assumed rate blurs no object over more than itself, a stated one is doubted."""
    data = clip(tmp_path / "data", panned(4, step=(45.0, 0.5)))
    if column is not None:
        times = [k * seconds for k in range(4)]
        if column == "captured":
            times = [f"2024-05-01T06:30:{10 + t:06.3f}" for t in times]
        rows = "".join(f"clip_{k:03}.png,clip,{k},{t}\n" for k, t in enumerate(times))
        (data / "metadata.csv").write_text(f"file,sequence,frame,{column}\n{rows}")
    report = generate(data, tmp_path / "run", settings=[*STILL, "objects.0.count=2", "camera.altitude={fixed_m: 42}"])
    codes = {p.code for p in report.problems}
    assert any("are assumed" in p.found or "is stated" in p.found for p in report.problems) == (column is None)
    shown = [api.show(tmp_path / "run", f"train/clip_{k:06}")["scene"] for k in range(4)]
    tails = [math.hypot(*scene["motion_px"]) for scene in shown if scene["objects"]]
    assert tails
    if smeared is None:
        assert 0 < max(tails) < 0.5 and "track-smeared" not in codes
    else:
        assert (max(tails) > 10) == smeared == ("track-smeared" in codes)
