"""`infrablend profile`: a known chain is found again, files are the same each time, bad input is named."""

import json
import math

import cv2
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from infrablend import api
from infrablend.cli.app import build_app
from infrablend.compositing.fitting import Survey, fit_profile
from infrablend.compositing.measure import block_steps, blockiness
from infrablend.compositing.overlay import Layer
from infrablend.compositing.sensor import PIXEL_BOX_VARIANCE, Sensor, apply_sensor
from infrablend.config.loading import load_recipe
from infrablend.config.sensor_profile import read_profile
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.errors import DatasetError, InfraBlendError, OutputError, RecipeError
from infrablend.formats.pictures.images import load_background
from infrablend.formats.writing import write
from infrablend.pipeline.studies import profile
from infrablend.pipeline.studies.profile import jpeg_quality
from tests.run_files import records


def scene(seed, psf=0.9, gain=0.6, radius=1.6, noise=1.7, size=1.1, codec=None, shape=(320, 384)):
    """Stripes of many directions beside a flat field, seen by a camera of a known chain."""
    rng = np.random.Generator(np.random.PCG64(seed))
    fine, (h, w) = 3, shape
    y, x = (np.mgrid[: h * fine, : w * fine].astype(np.float32) + 0.5) / fine
    turn = rng.uniform(0.05, 1.5)
    stripes = np.floor((x * math.cos(turn) + y * math.sin(turn)) / 45 + rng.random()) % 2
    stripes[:, x[0] > 0.6 * w] = 0.5
    ideal = cv2.resize(stripes.astype(np.float32), (w, h), interpolation=cv2.INTER_AREA)
    ideal = 70 + 90 * cv2.GaussianBlur(ideal, (0, 0), math.sqrt(psf**2 - PIXEL_BOX_VARIANCE))
    chain = Sensor("known", None, gain, radius, noise, size, seed, None, codec)
    return apply_sensor(np.zeros(shape, np.uint8), Layer((0, 0), ideal, np.ones(shape, np.float32)), chain)


def save(folder, pictures, **options):
    folder.mkdir(parents=True)
    for n, picture in enumerate(pictures):
        Image.fromarray(picture).save(folder / f"{n:03}.{'jpg' if options else 'png'}", **options)
    return folder


@pytest.fixture(autouse=True)
def _no_charts(request, monkeypatch):
    if "charts" not in request.fixturenames:
        monkeypatch.setattr(profile, "draw_profile", lambda *of: b"")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return save(tmp_path_factory.mktemp("data") / "known", [scene(n) for n in range(12)])


@pytest.mark.parametrize(("psf", "gain", "radius"), [(0.9, 0.6, 1.6), (1.0, 0.5, 2.4), (0.8, 0.0, 1.6)])
def test_known_sensor_chain_is_recovered(psf, gain, radius):
    survey = Survey((40.0, 200.0), 8)
    for n in range(8):
        survey.add(scene(n, psf, gain, radius), None, None)
    p = fit_profile(survey, "x").profile
    # The 20th percentile of edges that are all as sharp lies a little below them.
    assert p.psf_sigma_px == pytest.approx(psf, abs=0.12)
    assert p.halo_gain == pytest.approx(gain, abs=0.2)
    if gain:
        assert p.halo_radius_px == pytest.approx(radius, abs=0.5)
    assert p.noise_grey == pytest.approx(1.7, rel=0.15)
    assert p.noise_grain_px == pytest.approx(1.1, rel=0.12)
    assert p.codec_quality is None


def test_the_fitted_chain_shows_what_the_pictures_show(pictures, tmp_path):
    """Its own edges and grain, measured like those of pictures, agree to 1 % of a step and of a pixel."""
    report = api.profile(pictures, tmp_path / "out")
    rows = dict(report.rows)
    for what, within in (
        ("edge sigma, px", 0.05),
        ("overshoot, bright side, %", 1.5),
        ("noise, levels", 0.2),
        ("noise correlation at 1 px", 0.04),
    ):
        found, fitted = (float(v) for v in rows[what])
        assert fitted == pytest.approx(found, abs=within), what


@pytest.mark.parametrize("quality", [40, 60, 80])
def test_codec_is_detected_by_its_blocks(quality):
    survey = Survey((40.0, 200.0), 6)
    for n in range(6):
        survey.add(scene(n, noise=3.0, codec=quality), None, None)
    found = fit_profile(survey, "x").profile.codec_quality
    assert found is not None
    assert found == pytest.approx(quality, abs=12)


def test_the_files_own_jpeg_is_no_further_codec(tmp_path):
    folder = save(tmp_path / "jpeg", [scene(n) for n in range(6)], quality=90)
    report = api.profile(folder, tmp_path / "out")
    assert report.profile.codec_quality is None
    assert dict(report.rows)["JPEG quality of the files"][0] == "90"
    assert float(dict(report.rows)["blockiness"][0]) > 1.05


@pytest.mark.parametrize("quality", [10, 50, 75, 95])
def test_jpeg_quality_is_read_from_the_quantisation_table(quality, tmp_path):
    Image.fromarray(scene(1)).save(tmp_path / "a.jpg", quality=quality)
    assert jpeg_quality(load_background(tmp_path / "a.jpg")) == quality
    Image.fromarray(scene(1)).save(tmp_path / "a.png")
    assert jpeg_quality(load_background(tmp_path / "a.png")) is None


def test_blockiness_of_a_picture_without_a_codec_is_one():
    assert blockiness(block_steps(scene(1))) == pytest.approx(1, abs=0.05)
    assert block_steps(np.zeros((20, 90), np.uint8)) is None


def test_one_picture_is_enough_and_recipes_take_the_file(charts, tmp_path):
    folder = save(tmp_path / "one", [scene(3)])
    report = api.profile(folder, tmp_path / "out", name="mine")
    assert report.profile.name == "mine"
    assert read_profile(report.path) == report.profile
    assert report.plot.read_bytes().startswith(b"\x89PNG")
    assert load_recipe("hit-uav-drone", {"sensor.profile": str(report.path)}).sensor.profile == report.profile
    settings = {"camera.pitch": {"fixed_deg": 40}, "sensor.profile": str(report.path)}
    flat = api.Execution(renderer="flat", in_process=True)
    run = api.generate("hit-uav-drone", folder, tmp_path / "run", execution=flat, settings=settings)
    record = records(tmp_path / "run")[0].to_json()
    assert run.ok
    assert record["facts"]["sensor"]["profile"] == "mine"
    # The run holds the numbers: the file is not needed to make a frame again.
    report.path.unlink()
    api.rerender(tmp_path / "run", record["frame_id"], tmp_path / "again.png")


def test_the_same_pictures_give_the_same_bytes(charts, pictures, tmp_path):
    a, b = (api.profile(pictures, tmp_path / k, count=3, against="hit-uav") for k in "ab")
    assert a.path.read_bytes() == b.path.read_bytes()
    assert a.plot.read_bytes() == b.plot.read_bytes()
    assert a.profile.measured["pictures"] == 3


def test_16_bit_pictures_are_read_linearly(tmp_path):
    deep = [(scene(n).astype(np.uint16) * 60 + 5000).astype(np.uint16) for n in range(6)]
    eight = api.profile(save(tmp_path / "8", [scene(n) for n in range(6)]), tmp_path / "out8").profile
    p = api.profile(save(tmp_path / "16", deep), tmp_path / "out16").profile
    assert p.levels is None
    assert p.codec_quality is None
    assert p.measured["levels"][0] > 5000
    assert p.psf_sigma_px == pytest.approx(eight.psf_sigma_px, abs=0.05)
    # In 8-bit levels of a dataset that spans 220 of them; these span about 110.
    low, high = eight.levels
    assert p.noise_grey == pytest.approx(eight.noise_grey * 220 / (high - low), rel=0.1)


def test_annotated_objects_are_left_out(tmp_path):
    """A sharp object in soft scenes: with its label the profile is the scene's."""
    soft = [scene(n, psf=1.6, gain=0.0) for n in range(4)]
    for n, picture in enumerate(soft):
        for y in range(20, 300, 40):
            for x in range(20, 200, 40):
                picture[y : y + 24, x : x + 24] = 40 if n % 2 else 190
    plain, labelled = save(tmp_path / "plain", soft), save(tmp_path / "labelled", soft)
    (labelled / "classes.txt").write_text("car\n")
    boxes = "".join(
        f"0 {(x + 12) / 384:.6f} {(y + 12) / 320:.6f} {32 / 384:.6f} {32 / 320:.6f}\n"
        for y in range(20, 300, 40)
        for x in range(20, 200, 40)
    )
    for n in range(4):
        (labelled / f"{n:03}.txt").write_text(boxes)
    sharp = api.profile(plain, tmp_path / "a").profile.measured["edge_sigma_px"]
    report = api.profile(labelled, tmp_path / "b")
    scenes = report.profile.measured["edge_sigma_px"]
    assert sharp[1] < 0.8
    assert scenes[1] > 1.2
    # The boxes are 32 px wide around objects of 24 px.
    boxes = read_profile(report.path).measured["box_looseness"]["car"]
    assert boxes["factor"] == pytest.approx(32 / 24, abs=0.03)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda f: save(f, []), "no format fits|no picture"),
        (lambda f: save(f, [np.full((200, 200), 90, np.uint8)]), "no contrast: .* between 90 and 90"),
        (lambda f: save(f, [np.tile(np.arange(200, dtype=np.uint8), (200, 1))]), "0 clean edges in 1 picture"),
        (lambda f: save(f, [scene(1), scene(2).astype(np.uint16) * 90]), "8 and of 16 bits"),
        (lambda f: save(f, [cv2.applyColorMap(scene(1), cv2.COLORMAP_INFERNO)]), "none of 1 picture.*can be used"),
    ],
    ids=["none", "flat", "no-edges", "mixed", "palette"],
)
def test_unusable_items_are_reported(make, says, tmp_path):
    with pytest.raises(InfraBlendError, match=says) as caught:
        api.profile(make(tmp_path / "data"), tmp_path / "out")
    assert isinstance(caught.value, DatasetError)
    assert not (tmp_path / "out").exists()


def test_bad_pictures_among_good_ones_are_left_out_and_named(tmp_path):
    folder = save(tmp_path / "data", [scene(n) for n in range(4)])
    (folder / "000.png").write_bytes((folder / "000.png").read_bytes()[:3000])
    Image.fromarray(cv2.applyColorMap(scene(9), cv2.COLORMAP_JET)).save(folder / "001.png")
    report = api.profile(folder, tmp_path / "out")
    assert {p.where: p.code for p in report.problems} == {"000.png": "image-truncated", "001.png": "profile-colour"}
    assert report.profile.measured["pictures"] == 2


def test_the_command(pictures, tmp_path):
    run = CliRunner().invoke
    some = ["profile", str(pictures), "--out", str(tmp_path / "o"), "--count", "4"]
    said = run(build_app(), [*some, "--against", "monet"])
    assert said.exit_code == 0, said.output
    lines = said.stdout.splitlines()
    assert lines[0].split() == ["pictures", "fitted", "monet"]
    assert any(line.startswith("halo_gain") and line.split()[-1] == "0.60" for line in lines)
    assert lines[-2:] == [str(tmp_path / "o" / "profile.json"), str(tmp_path / "o" / "profile.png")]
    as_json = run(build_app(), [*some, "--json"])
    assert json.loads(as_json.stdout)["profile"]["name"] == "known"
    wrong = run(build_app(), [*some, "--against", "hituav"])
    assert wrong.exit_code == 2
    assert "expected one of hit-uav, monet, generic-640x512" in wrong.output
    dusk = run(build_app(), [*some, "--time", "day"])
    assert dusk.exit_code == 2
    assert "none of 12 picture(s) is known to be taken by day" in dusk.output


def test_output_must_be_outside_the_data(pictures):
    with pytest.raises(OutputError, match="inside the data folder"):
        api.profile(pictures, pictures / "out")
    with pytest.raises(RecipeError, match="no such profile"):
        api.profile(pictures, pictures.parent / "out", against="x")


def test_hit_uav_night_profile_is_reproduced(real_data, tmp_path):
    """The figures of the design's sections 4.1, 4.4, 4.5 and 3.2, with annotated objects left out here."""
    report = api.profile(
        real_data / "hit-uav", tmp_path, reading=api.Reading(splits=("train",)), time="night", against="hit-uav"
    )
    m = report.profile.measured
    assert m["pictures"] == 64
    assert 0.6 <= m["edge_sigma_px"][1] <= 0.75
    assert m["typical_overshoot"] == pytest.approx([0.09, 0.04], abs=0.03)
    assert m["noise_grey"] == pytest.approx(1.7, abs=0.2)
    assert m["noise_correlations"] == pytest.approx([0.79, 0.50, 0.27, 0.13], abs=0.05)
    assert 1.04 <= m["blockiness"] <= 1.14
    assert m["levels"] == pytest.approx([16, 235], abs=8)
    assert 0.8 <= report.profile.psf_sigma_px <= 1.2
    assert 0.3 <= report.profile.halo_gain <= 0.8
    assert 1.0 <= report.profile.noise_grain_px <= 1.3


def annotated(root, inserted, everywhere=False):
    """Write pictures with three warm squares each; the first `inserted` of one or all are inserted."""
    records = []
    for n in range(12):
        picture, labels = scene(n), []
        for k, y in enumerate((60, 150, 240)):
            picture[y : y + 14, 300:314] = 190
            box = np.array([297.0, y - 3, 317, y + 17])
            labels.append(Instance("Person", box, inserted=(everywhere or n == 0) and k < inserted))
        path = root.parent / f"{root.name}-{n:02}.png"
        Image.fromarray(picture).save(path)
        night = Capture(time_of_day="night")
        records.append(ImageRecord(path.stem, path, "train", (384, 320), tuple(labels), capture=night))
    categories = (Category(0, "Person"),)
    write("coco", root, records, categories, source=Dataset(root.parent, "coco", categories, tuple(records)))
    return root


def test_annotated_boxes_are_compared_with_those_that_loosen_starts_from(tmp_path):
    """Drawn boxes are 20 px wide; those of the run were enlarged, and are 16 px before, or 10 px with a fitted box."""
    data, run = annotated(tmp_path / "data", 0), annotated(tmp_path / "run", 3, everywhere=True)
    labels = run / "annotations" / "instances_train.json"

    def factor(boxes):
        written = json.loads(labels.read_text())
        for a in written["annotations"]:
            x, y, w, h = a["bbox"]
            a |= {name: [x + (w - size) / 2, y + (h - size) / 2, size, size] for name, size in boxes.items()}
        labels.write_text(json.dumps(written))
        report = api.profile(data, tmp_path / "out", rendered=run)
        return report.objects["box_looseness"]["Person"]["against_rendered"]["factor"]

    assert factor({"tight_bbox": 16}) == pytest.approx(20 / 16, abs=0.01)
    assert factor({"tight_bbox": 16, "seen_bbox": 10}) == pytest.approx(2, abs=0.01)


def test_a_run_that_cannot_correct_the_boxes_is_named(tmp_path):
    data, run = annotated(tmp_path / "data", 0), annotated(tmp_path / "run", 2)
    with pytest.raises(DatasetError, match=r"(?s)data: no exact boxes .*--rendered: no inserted object; expected"):
        api.profile(data, tmp_path / "out", rendered=data)
    report = api.profile(data, tmp_path / "out", rendered=run)
    (found,) = [p for p in report.problems if p.code == "too-few-rendered"]
    assert (found.severity, "Person (2 inserted)" in found.found) == ("warning", True)
    assert "too-few-rendered" not in {p.code for p in api.profile(data, tmp_path / "out").problems}
    done = CliRunner().invoke(build_app(), ["-q", "profile", str(data), "--out", str(tmp_path / "out")])
    assert "not for recipes" in done.output
