"""`infrablend motion` on small sequences of pictures: what is written, what is said, and that a repeated run agrees."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from infrablend.cli import main
from infrablend.core.capture import UNKNOWN, Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.errors import DatasetError
from infrablend.pipeline.extraction.camera_motion import write_motion
from infrablend.pipeline.plans.sequence_motion import find_motion, sequences_of
from tests.unit.imaging.test_sequence import frame, path, scene

PAN_PX = 7 * 6.3


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))


def dataset(folder, pictures=None, boxes=()):
    """Return a dataset with one sequence, by default of a camera that pans."""
    folder.mkdir(exist_ok=True)
    if pictures is None:
        pictures = [frame(scene(), at, seed=k)[0].grey for k, at in enumerate(path(8))]
    images = []
    for k, grey in enumerate(pictures):
        file = folder / f"clip_{k:03}.png"
        cv2.imwrite(str(file), grey)
        objects = tuple(Instance("drone", np.array(box, float)) for box in boxes)
        capture = Capture(sequence="clip", frame=k)
        images.append(ImageRecord(file.stem, file, "train", grey.shape[::-1], objects, capture))
    return Dataset(folder, "folder", (Category(0, "drone"),), tuple(images), ())


def motion(data):
    return find_motion("clip", sequences_of(data)["clip"])


def test_a_sequence_gets_a_json_and_a_page_and_the_second_run_is_the_same(tmp_path):
    data = dataset(tmp_path / "data")
    report = write_motion(data, tmp_path / "out")
    assert report.ok and report.sequences == {"clip": {"first": 1, "followed": 7}} and not report.problems
    facts = json.loads((tmp_path / "out" / "clip.json").read_text())
    assert [f["frame"] for f in facts["frames"]] == list(range(8)) and facts["spans"][0]["frames"] == 8
    assert facts["frames"][-1]["to_first"][2] == pytest.approx(PAN_PX, abs=1)
    write_motion(data, tmp_path / "again")  # from the cache
    for name in ("clip.json", "clip.html"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


def test_pixels_and_labels_decide_what_the_cache_returns(tmp_path):
    kept = tmp_path / "cache" / "motion"
    for boxes, files in (((), 1), ((), 1), ([(20, 20, 60, 60)], 2)):
        motion(dataset(tmp_path / "data", boxes=boxes))
        assert len(list(kept.iterdir())) == files


def test_labelled_objects_are_no_background(tmp_path):
    """A labelled object that fills half of the picture and stays in view does not hold the background back."""
    thing = frame(scene(7), (300, 300))[0].grey[:, :150]
    pictures = [frame(scene(), at, seed=k)[0].grey for k, at in enumerate(path(8))]
    for grey in pictures:
        grey[:, :150] = thing
    found = motion(dataset(tmp_path / "data", pictures, [(0, 0, 150, 256)]))
    assert found.moments[-1].to_first[0, 2] == pytest.approx(PAN_PX, abs=1)


def test_sixteen_bits_are_followed_too(tmp_path):
    pictures = [frame(scene(), at, seed=k)[0].grey.astype(np.uint16) * 3 + 29000 for k, at in enumerate(path(8))]
    found = motion(dataset(tmp_path / "data", pictures))
    assert found.moments[-1].to_first[0, 2] == pytest.approx(PAN_PX, abs=1)


def test_jumps_of_the_levels_are_listed(tmp_path):
    pictures = [frame(scene(), at, offset=40 * (k >= 5), seed=k)[0].grey for k, at in enumerate(path(10))]
    assert motion(dataset(tmp_path / "data", pictures)).level_jumps() == [5]


def test_plain_sky_is_an_error_and_nothing_is_invented(tmp_path):
    sky = [np.full((256, 320), 80 + 6 * k, np.uint8) for k in range(8)]
    report = write_motion(dataset(tmp_path / "data", sky), tmp_path / "out")
    assert not report.ok and report.problems[0].code == "no-motion"
    assert report.sequences == {"clip": {"lost": 8}}


def test_pictures_without_sequence_are_refused_and_repeated_numbers_named(tmp_path):
    data = dataset(tmp_path / "data")
    bare = replace(data, images=tuple(replace(i, capture=UNKNOWN) for i in data.images))
    with pytest.raises(DatasetError, match="no picture has a sequence and a frame number"):
        sequences_of(bare)
    with pytest.raises(DatasetError, match="repeated frames"):
        sequences_of(replace(data, images=(*data.images, data.images[3])))


def test_the_command_refuses_pictures_without_sequences(tmp_path, capsys):
    (tmp_path / "none").mkdir()
    cv2.imwrite(str(tmp_path / "none" / "roof.png"), frame(scene(), (300, 300))[0].grey)
    assert main(["motion", str(tmp_path / "none"), "--out", str(tmp_path / "o")]) == 2
    assert "sequence and a frame number" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
