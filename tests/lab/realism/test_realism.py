"""Realism measures on synthetic pictures: a known disc, the controls and the classifiers."""

import builtins
import functools
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.compositing.object_contrast import eight_bit
from infrablend.compositing.sensor import Sensor, grain
from infrablend.core.boxes import pixel_box
from infrablend.core.dataset import SEEN_BOX, Instance
from infrablend.core.rng import stream
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import Task
from infrablend.errors import DatasetError, MissingDependencyError, OutputError
from infrablend.lab.realism import class_comparison, classify, controls, features, nets
from infrablend.lab.realism.class_comparison import (
    CALIPER_OCTAVES,
    compare_class,
    dct_features,
    mmd,
    pair_by_size,
    standardised,
    validity,
)
from infrablend.lab.realism.compare_objects import ComparisonRequest, measure_populations
from infrablend.lab.realism.controls import SENSOR_STEPS, sensor_steps
from infrablend.lab.realism.features import FEATURES, MEASURES, Labels, measure, reason_not_measured
from infrablend.lab.realism.measure_objects import MeasuringSettings, ObjectMeasurer, PictureJob

BOX = np.array([52.0, 52.0, 76.0, 76.0])
HERE = api.Execution(in_process=True)


def instance(box=BOX, category="Person", **more) -> Instance:
    return Instance(category, np.asarray(box, np.float64), **more)


def disc(ground=100.0, level=200.0, sigma=0.9, radius=10.0, shape=(128, 128)) -> np.ndarray:
    """A disc around (64, 64), blurred; exact by 8 x 8 samples a pixel."""
    y, x = ((np.arange(n * 8) + 0.5) / 8 - 64 for n in shape)
    inside = (np.hypot(*np.meshgrid(x, y)) <= radius).reshape(shape[0], 8, shape[1], 8).mean(axis=(1, 3))
    soft = cv2.GaussianBlur(inside, (0, 0), sigma) if sigma else inside
    return (ground + (level - ground) * soft).astype(np.float32)


def measured(picture, box=BOX, key="a#0", group="a", category="Person"):
    labels = Labels(picture.shape, [instance(box)])
    return measure(picture, instance(box, category), labels.free, key=key, group=group)


def values(m) -> dict[str, float]:
    return {**dict(zip(FEATURES, m.features, strict=True)), **dict(zip(MEASURES, m.measures, strict=True))}


def test_features_of_a_known_disc():
    v = values(measured(disc()))
    assert v["max"] == pytest.approx(200, abs=0.1)
    assert v["p95_minus_ring"] == pytest.approx(100, abs=1)
    assert v["centre_minus_ring"] == pytest.approx(100, abs=0.1)
    # A Gaussian edge: slope 1 / (sigma sqrt(2 pi)), read over two pixels; width 2.563 sigma, the pixel included.
    seen = np.hypot(0.9, np.sqrt(1 / 12))
    assert v["gradient_max"] == pytest.approx(1 / (np.hypot(seen, 0.6) * np.sqrt(2 * np.pi)), rel=0.08)
    assert v["edge_width_px"] == pytest.approx(2.563 * seen, rel=0.1)
    assert v["overshoot"] == pytest.approx(0, abs=0.01)
    assert v["dark_ring"] == pytest.approx(0, abs=0.01)
    assert v["highpass_outside"] == pytest.approx(0, abs=0.01)
    assert v["share_231"] == v["share_236"] == 0
    assert v["height_px"] == v["width_px"] == 24


def test_a_halo_shows_as_dark_ring_and_undershoot():
    picture = disc()
    sharp = picture + 0.6 * (picture - cv2.GaussianBlur(picture, (0, 0), 1.6))
    v = values(measured(sharp))
    assert 0.03 < v["dark_ring"] < 0.25
    assert 0.03 < v["overshoot"] < 0.25
    assert v["gradient_max"] > values(measured(picture))["gradient_max"]


def test_a_dark_object_is_measured_like_a_bright_one():
    bright, dark = values(measured(disc(100, 160))), values(measured(disc(160, 100)))
    for name in ("gradient_max", "gradient_p90", "laplacian_max", "dark_ring", "edge_width_px", "std"):
        assert dark[name] == pytest.approx(bright[name], abs=1e-3), name
    assert dark["centre_minus_ring"] == pytest.approx(-bright["centre_minus_ring"], abs=1e-3)
    assert dark["max"] == pytest.approx(128, abs=3)  # the edge's darker half is all that counts


def test_levels_count_as_shares_of_the_interior():
    v = values(measured(disc(100, 240, sigma=0.0)))
    assert v["share_231"] == v["share_236"] == 1
    assert v["share_above_245"] == 0
    assert values(measured(disc(100, 250, sigma=0.0)))["share_above_245"] == pytest.approx(np.pi * 100 / 576, abs=0.06)


def test_grain_is_the_same_inside_and_outside():
    picture = disc(100, 160, radius=22) + grain((128, 128), 2.0, 1.05, 7).astype(np.float32)
    v = values(measured(picture, np.array([40.0, 40.0, 88.0, 88.0])))
    assert 0.7 < v["noise_ratio"] < 1.3
    quiet = disc(100, 160, radius=22)
    quiet = np.where(quiet > 130, quiet, picture)
    assert values(measured(quiet, np.array([40.0, 40.0, 88.0, 88.0])))["noise_ratio"] < 0.3


def test_unmeasurable_objects_have_a_flaw():
    flat = np.full((128, 128), 100, np.float32)
    assert measured(flat).flaw == "no_contrast"
    assert np.isnan(measured(flat).features).all()
    assert measured(flat).measures[0] == 0
    thin = flat.copy()
    thin[52:76, 64] = 200
    assert measured(thin, np.array([62.0, 52.0, 67.0, 76.0])).flaw == "thin"


def test_objects_that_cannot_be_measured():
    labels = Labels((128, 128), [instance(), instance([60, 60, 80, 80]), instance([2, 40, 20, 60])])
    assert reason_not_measured(instance(), labels) == "overlapping"
    assert reason_not_measured(instance([2, 40, 20, 60]), labels) == "truncated"
    assert reason_not_measured(instance([30, 90, 36, 97]), labels) == "small"
    assert reason_not_measured(instance([30, 90, 46, 107], truncated=True), labels) == "truncated"
    assert reason_not_measured(instance([30, 90, 46, 107]), labels) is None
    touching = Labels((128, 128), [instance([10, 10, 30, 30]), instance([29, 10, 49, 30])])
    assert reason_not_measured(instance([10, 10, 30, 30]), touching) is None


def test_sixteen_bit_pictures_are_brought_to_eight_bit_levels():
    deep = np.array([[7000, 9190]], np.uint16)
    np.testing.assert_allclose(eight_bit(deep, (7000.0, 9190.0)), [[16, 235]], atol=1e-3)


def test_patches_keep_the_grid_or_are_scaled_down():
    picture = disc()
    assert (measured(picture).patch == np.rint(picture[40:88, 40:88])).all()
    large = measured(picture, np.array([4.0, 4.0, 124.0, 124.0]))
    assert large.patch.shape == (48, 48)
    at_the_edge = features.patch(picture, np.array([0.0, 0.0, 20.0, 20.0]))
    assert (at_the_edge == np.rint(picture[:48, :48])).all()
    assert features.patch(picture[:40], BOX).shape == (48, 48)


# ---- controls


def scene(seed: int, count: int = 4, shape=(256, 320)) -> tuple[np.ndarray, list[Instance]]:
    """A textured ground with warm ellipses, as one camera would show it."""
    rng = stream(seed, "scene")
    y, x = np.mgrid[: shape[0], : shape[1]]
    ground = 100 + 12 * np.sin(x / 40 + seed) + 10 * np.cos(y / 50 + 2 * seed)
    alpha, labels = np.zeros(shape), []
    for k in range(count):
        cx, cy = 40 + 75 * k + rng.uniform(-6, 6), 60 + rng.uniform(0, 130)
        a, b = rng.uniform(5, 8), rng.uniform(8, 12)
        alpha += ((x + 0.5 - cx) / a) ** 2 + ((y + 0.5 - cy) / b) ** 2 <= 1
        labels.append(instance([cx - a - 1, cy - b - 1, cx + a + 1, cy + b + 1]))
    warm = 180 + 12 * cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 2) * 4 + rng.uniform(-15, 15)
    picture = cv2.GaussianBlur(ground * (1 - alpha) + warm * alpha, (0, 0), 0.9)
    picture = picture + 0.6 * (picture - cv2.GaussianBlur(picture, (0, 0), 1.6))
    picture = np.minimum(picture, 235) + grain(shape, 1.6, 1.05, 100 + seed)
    return np.clip(np.rint(picture), 0, 255).astype(np.float32), labels


def both_controls(count: int):
    real, pasted, flat = [], [], []
    for seed in range(count):
        picture, labels = scene(seed)
        where = Labels(picture.shape, labels)
        chosen = [(n, i) for n, i in enumerate(labels) if reason_not_measured(i, where) is None]
        made = controls.paste_controls(picture, where, chosen, str(seed))
        soft, hard, free = made.real, made.flat, made.free
        for n, i in made.labels.items():
            key, group = f"{seed}#{n}", str(seed)
            real.append(measure(picture, labels[n], where.free, key=key, group=group))
            pasted.append(measure(np.rint(soft), i, free, key=key, group=group))
            flat.append(measure(np.rint(hard), i, free, key=key, group=group))
    return real, pasted, flat


def test_the_controls_bound_the_classifier():
    real, pasted, flat = both_controls(30)
    assert len(real) > 80
    ok = [(r, p, f) for r, p, f in zip(real, pasted, flat, strict=True) if not (r.flaw or p.flaw or f.flaw)]
    assert len(ok) > 0.9 * len(real)
    real, pasted, flat = (list(column) for column in zip(*ok, strict=True))
    for kind in ("logistic", "boosting"):
        assert classify.score(real, flat, kind).auc > 0.99
        assert classify.score(real, pasted, kind).auc < 0.8


def test_a_paste_touches_its_place_and_nothing_else():
    picture, labels = scene(3)
    where = Labels(picture.shape, labels)
    pasted = controls.paste_controls(picture, where, [(0, labels[0])], "x")
    soft, hard, free = pasted.real, pasted.flat, pasted.free
    (new,) = pasted.labels.values()
    x0, y0, x1, y1 = pixel_box(new.box_xyxy, picture.shape)
    np.testing.assert_allclose(new.box_xyxy[2:] - new.box_xyxy[:2], labels[0].box_xyxy[2:] - labels[0].box_xyxy[:2])
    assert not free[y0:y1, x0:x1].any()
    assert where.free[y0:y1, x0:x1].all()
    for made in (soft, hard):
        changed = np.argwhere(made != picture)
        assert len(changed)
        assert (changed.min(axis=0) >= [y0 - 8, x0 - 8]).all()
        assert (changed.max(axis=0) < [y1 + 8, x1 + 8]).all()
    assert len(np.unique(hard[hard != picture])) == 1
    assert controls.paste_controls(picture, where, [(0, labels[0])], "x").labels[0].equals(new)


def test_no_place_is_found_where_all_is_taken():
    picture, labels = scene(1)
    nothing = np.ones(picture.shape, np.bool_)
    assert controls.free_place(picture, labels[0], 100.0, nothing, nothing, stream(0, "t")) is None
    huge = instance([1, 1, 300, 250])
    assert controls.free_place(picture, huge, 100.0, nothing, ~nothing, stream(0, "t")) is None


# ---- classifiers, pairs, distances


def made_up(count: int, shift: float, seed: int, groups: int = 50):
    """Objects with random features; `shift` moves one of them by so many deviations."""
    rng = stream(seed, "made up")
    picture = disc()
    base = measured(picture)
    found = []
    for k in range(count):
        x = rng.standard_normal(len(FEATURES))
        x[3] += shift
        patch = np.clip(base.patch + 20 * shift + rng.normal(0, 5, (48, 48)), 0, 255).astype(np.uint8)
        height = float(rng.uniform(10, 40))
        m = measured(picture, np.array([52.0, 52.0, 76.0, 52.0 + height]), f"{seed}-{k % groups}#{k}", f"g{k % groups}")
        found.append(features.Measured(**{**vars(m), "features": x, "flaw": "", "patch": patch}))
    return found


def test_equal_distributions_cannot_be_told_apart_and_shifted_ones_can():
    same = [classify.score(made_up(200, 0, k), made_up(200, 0, 10 + k), "logistic") for k in range(5)]
    assert abs(np.mean([s.auc for s in same]) - 0.5) < 0.06
    assert all(s.interval[0] < s.auc < s.interval[1] for s in same)
    apart = classify.score(made_up(200, 0, 1), made_up(200, 4, 2), "boosting")
    assert apart.auc > 0.98
    assert len(apart.predictions) == 400


def test_the_area_under_the_curve_is_scikit_learns():
    from sklearn.metrics import roc_auc_score

    rng = stream(0, "auc")
    y, p, w = rng.integers(0, 2, 200), np.round(rng.normal(0, 1, 200), 1), rng.integers(0, 4, 200).astype(float)
    assert classify.auc(y, p) == pytest.approx(roc_auc_score(y, p))
    assert classify.auc(y, p, w) == pytest.approx(roc_auc_score(y, p, sample_weight=w))


def test_objects_of_one_background_stay_in_one_fold():
    """A feature that names the background tells nothing: each model meets backgrounds it has not seen."""
    rng = stream(0, "folds")
    n, groups = 400, np.repeat(np.arange(20), 20)
    y = np.tile([0, 1], n // 2)
    secret = rng.standard_normal(20)[groups] * np.where(y == 1, 1, -1)
    p = classify.out_of_fold(np.stack([secret, secret**2], axis=1), y, groups, "boosting")
    assert abs(classify.auc(y, p) - 0.5) < 0.15


def test_pairs_are_of_like_size_and_unique():
    real, inserted = made_up(200, 0, 1), made_up(80, 0, 2)
    pairs = pair_by_size(real, inserted, 60)
    assert len(pairs) == 60
    assert len({r.key for r, _ in pairs}) == len({i.key for _, i in pairs}) == 60
    assert all(abs(np.log2(r.height_px / i.height_px)) <= CALIPER_OCTAVES for r, i in pairs)
    assert [i.key for _, i in pair_by_size(real[::-1], inserted[::-1], 60)] == [i.key for _, i in pairs]


def test_distance_is_zero_for_equals_and_grows_with_the_shift():
    a, b, c = (made_up(250, s, k) for k, s in enumerate((0, 0, 2)))
    like = dct_features(a)
    x, y, z = (standardised(dct_features(m), like) for m in (a, b, c))
    (mean, deviation), (apart, _) = mmd(x, y), mmd(x, z)
    assert abs(mean) < 3 * deviation
    assert apart > 10 * abs(mean)


def test_skipped_networks_report_the_reason(monkeypatch):
    monkeypatch.setattr(nets.importlib.util, "find_spec", lambda name: None)
    assert nets.missing("torch") == "torch is not installed"
    assert nets.no_inception(2000) == "torch and torchvision are not installed"
    assert nets.no_inception(900) == "900 crops; 1000 are needed"


def test_network_separates_shifted_crops_but_not_equal_ones(monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setattr(nets, "BATCH", 16)
    real, other = made_up(40, 0, 1), made_up(40, 2, 2)
    told = nets.score_crops(real, other, epochs=8)
    assert told.auc > 0.95
    assert (nets.score_crops(real, other, epochs=8).predictions == told.predictions).all()
    assert abs(nets.score_crops(real, made_up(40, 0, 2), epochs=2).auc - 0.5) < 0.25


def test_kid_uses_the_weights_in_torchs_cache(monkeypatch, tmp_path):
    torch = pytest.importorskip("torch")
    try:
        from torchvision import models
    except (ImportError, RuntimeError) as error:  # built for another torch
        assert "torchvision" in nets.no_inception(1000)
        pytest.skip(f"torchvision does not import: {error}")
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    assert "not in torch's cache" in nets.no_inception(1000)
    (tmp_path / "checkpoints").mkdir()
    torch.manual_seed(0)
    net = models.inception_v3(weights=None, init_weights=False, aux_logits=True)
    torch.save(net.state_dict(), tmp_path / "checkpoints" / nets.WEIGHTS)
    assert nets.no_inception(1000) is None
    found = nets.inception_features(made_up(2, 0, 1))
    assert found.shape == (2, 2048)
    assert np.isfinite(found).all()


def test_figures_are_valid_only_with_plausible_controls():
    assert validity(600, 0.999, 0.74) == {"valid": True, "invalid_because": []}
    bad = validity(40, 0.9, None)
    assert not bad["valid"]
    assert len(bad["invalid_because"]) == 3
    assert validity(600, 0.999, 0.65)["invalid_because"] == [
        "the AUC of people's real control is 0.650; expected 0.70 to 0.80"
    ]


@pytest.fixture
def short_training(monkeypatch):
    """Train the small network for two epochs instead of twelve, where its score does not matter."""
    monkeypatch.setattr(class_comparison, "score_crops", functools.partial(nets.score_crops, epochs=2))


def test_a_comparison_ranks_the_separating_features(short_training):
    real, inserted = made_up(120, 0, 1), made_up(120, 1.5, 2)
    v = compare_class("Person", real, inserted, list(zip(real, inserted, strict=True)), {"floor": real})
    assert v.facts["separating_features"][0]["feature"] == "std"
    assert v.facts["separating_features"][0]["inserted_is"] == "larger"
    assert v.facts["auc_logistic"] > 0.75
    assert v.facts["floor_logistic"] == 0.5  # the same objects, so nothing to tell
    assert v.facts["hard_paste_logistic"] is None
    json.dumps(v.facts, allow_nan=False)


def test_the_chain_comes_back_step_by_step():
    whole = Sensor("hit-uav", 0.8, 0.6, 1.6, 1.5, 1.05, 3, (16.0, 235.0), 68, 0.7, 9, 5, 80.0, 0.4)
    steps = sensor_steps(whole)
    assert tuple(steps) == SENSOR_STEPS
    assert steps["codec"] == whole
    off = steps["chain_off"]
    assert (off.blur_sigma_px, off.halo_gain, off.noise_grey, off.limits, off.codec_quality) == (None, 0, 0, None, None)
    assert off.defocus_sigma_px == 0
    assert (steps["psf"].blur_sigma_px, steps["psf"].defocus_sigma_px, steps["psf"].halo_gain) == (0.8, 0.4, 0)
    assert (steps["noise"].noise_grey, steps["noise"].codec_quality) == (1.5, None)


def test_missing_scikit_learn_error_names_the_install_command(monkeypatch, tmp_path):
    real_import = builtins.__import__

    def refuse(name, *rest, **more):
        if name.partition(".")[0] == "sklearn":
            raise ImportError(name)
        return real_import(name, *rest, **more)

    monkeypatch.setattr(classify.importlib, "import_module", refuse)
    with pytest.raises(MissingDependencyError, match=r'pip install "infrablend\[realism\]"'):
        classify.require_sklearn()


# ---- from end to end


@pytest.fixture(scope="module")
def crowd(tmp_path_factory):
    """Twelve night pictures with four annotated blobs each, and a run that inserts people into them."""
    root = tmp_path_factory.mktemp("crowd")
    data = root / "data" / "normal_json"
    for split in ("train", "val", "test"):
        (data / split).mkdir(parents=True)
        images, labels = [], []
        for k in range(12 if split == "train" else 1):
            picture, objects = scene(k, 8, (512, 640))
            name = f"1_60_60_0_{k:05}.jpg" if split == "train" else f"1_60_60_0_9{k:04}{split}.jpg"
            Image.fromarray(picture.astype(np.uint8)).save(data / split / name, quality=95)
            images.append({"filename": name, "height": 512, "width": 640, "id": k, "date_captured": "20210116"})
            for n, o in enumerate(objects):
                x0, y0, x1, y1 = (round(float(v)) for v in o.box_xyxy)
                label = {"image_id": k, "category_id": 0, "id": 100 * k + n, "area": (x1 - x0) * (y1 - y0)}
                outline = [[x0, y0, x1, y0, x1, y1, x0, y1]]
                labels.append({**label, "segmentation": outline, "bbox": [x0, y0, x1 - x0, y1 - y0]})
        document = {"info": {}, "licenses": [], "images": images, "annotation": labels}
        names = ["Person", "Car", "Bicycle", "OtherVehicle", "DontCare"]
        document["categories"] = [{"id": i, "name": n, "supercategory": n} for i, n in enumerate(names)]
        (data / "annotations").mkdir(exist_ok=True)
        (data / "annotations" / f"{split}.json").write_text(json.dumps(document))
    person = {"model": "person", "category": "Person", "count": 3, "x_m": [-14, 14], "y_m": [-12, 12]}
    settings = {
        "name": "twins",
        "objects": [person],
        "configurations": 1,
        "appearance.mode": "physical",
        "sensor.profile": "hit-uav",
        "camera.focal_length_mm": 35.0,
        "camera.sensor_width_mm": 10.88,
        "camera.distance_m": [90, 130],
        "placement.min_contrast": "off",  # the flat renderer shows people fainter than they are
        "output.group_by": ["pitch", "day_night"],
        "labels.loosen_px": 2,
    }
    run = root / "run"
    flat, reading = api.Execution(renderer="flat", in_process=True), api.Reading(splits=["train"])
    api.generate("hit-uav-drone", data.parent, run, reading=reading, settings=settings, execution=flat)
    return run, data.parent


def test_boxes_drawn_around_what_is_visible_are_measured_as_such(crowd):
    """Objects whose box did not change were left out, and exact boxes were compared with visible extents."""
    run, data = crowd
    record = next(r for r in RunFolder(run).records() if len(r.inserted) > 1)
    first, *others = record.inserted
    x0, y0, x1, y1 = first.box_xyxy
    seen = replace(first, extra={**first.extra, SEEN_BOX: [x0, y0, (x1 - x0) / 2, y1 - y0]})
    record = replace(record, inserted=(seen, *others))
    (source,) = [i for i in api.read_dataset(data).images if i.id == record.background["id"] and i.split == "train"]
    recipe = json.dumps({**record_recipe(run), "labels": {**record_recipe(run)["labels"], "fit": "visible"}})

    def measured(recipe_json):
        settings = MeasuringSettings(run, recipe_json, ("Person",), (0.0, 255.0), "flat", "CPU", pin_cores=False)
        return ObjectMeasurer(settings)(Task("frame", PictureJob(source, record)))

    exact, fitted = measured(json.dumps(record_recipe(run))), measured(recipe)
    assert len(fitted.contrasts["as_written"]) >= len(fitted.contrasts["inserted"]) > 1
    widths = [[e.box_wh[0] for e in m.extents["inserted"]] for m in (exact, fitted)]
    assert len(widths[0]) == len(record.inserted)
    assert widths[1] == pytest.approx([widths[0][0] / 2, *widths[0][1:]])
    # The extent of what is visible is not cut at the smaller box.
    assert fitted.extents["inserted"][0].extent_wh == pytest.approx(exact.extents["inserted"][0].extent_wh, rel=0.25)


def record_recipe(run):
    return json.loads((run / "run.json").read_text())["recipe"]


def test_a_run_is_compared(crowd, tmp_path, short_training):
    run, data = crowd
    seen = []
    report = api.realism(run, data, tmp_path / "a", execution=HERE, on_progress=seen.append)
    facts = json.loads((tmp_path / "a" / "realism.json").read_text())
    person = facts["classes"]["Person"]
    assert person["n"] >= 20
    assert not person["valid"]
    assert "pairs of real and inserted objects" in person["invalid_because"][0]
    assert not report.valid
    # The whole chain, made again from the record, is the picture that was saved.
    assert facts["ablation"]["Person"]["codec"]["medians"] == person["medians"]["inserted"]
    assert set(facts["ablation"]["Person"]) == set(SENSOR_STEPS)
    assert facts["ablation"]["Person"]["chain_off"]["medians"] != person["medians"]["inserted"]
    assert person["hard_paste_logistic"] > 0.95
    assert seen[-1].done == seen[-1].total
    assert person["contrast"]["night"]["real"]["n"] >= 60
    assert person["contrast"]["night"]["inserted"]["n"] >= 20
    assert person["contrast"]["night"]["checks"]["change_p1"]["real"] > 20
    exact, written = (person[key]["night"]["inserted"] for key in ("contrast", "contrast_as_written"))
    assert written["n"] >= 20  # of wider boxes, a smaller part is the object
    assert abs(written["signed"]["p50"]) < abs(exact["signed"]["p50"])
    # 1 px wider than ellipses of 10 to 24.
    assert person["box_looseness"]["real"]["factor"] == pytest.approx(1.12, abs=0.1)
    text = api.realism_page(report, tmp_path / "page").read_text()
    assert "| person by night |" in text and "### In boxes as written" in text
    page = (tmp_path / "a" / "realism.html").read_text()
    assert "labels.loosen_px" in page
    assert "http" not in page
    assert page.count("data:image/png") == 4
    sheets = {f"person_{which}.png" for which in ("most_obvious", "least_obvious", "random")}
    assert {p.name for p in (tmp_path / "a").iterdir()} == {"realism.json", "realism.html", *sheets}
    before = {p.name: p.read_bytes() for p in (tmp_path / "a").iterdir()}
    (tmp_path / "a" / "mine.png").write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"mine\.png"):
        api.realism(run, data, tmp_path / "a", execution=HERE)
    (tmp_path / "a" / "mine.png").unlink()
    api.realism(run, data, tmp_path / "a", execution=HERE)
    assert {p.name: p.read_bytes() for p in (tmp_path / "a").iterdir()} == before


def test_real_objects_of_another_dataset_are_compared(crowd, tmp_path):
    """The backgrounds have no people of their own here; the other dataset has them in all of its splits."""
    run, data = crowd
    real = api.read_dataset(data)
    hidden = [
        replace(i, instances=tuple(replace(o, category="Bicycle") for o in i.instances))
        for i in real.images
        if i.split == "train"
    ]
    backgrounds = replace(real, images=tuple(hidden))
    nowhere = ComparisonRequest(in_process=True, steps=False)
    with pytest.raises(DatasetError, match="or name another dataset that shows real ones"):
        measure_populations(run, backgrounds, nowhere)
    material = measure_populations(run, backgrounds, replace(nowhere, real=real))
    assert len({m.group for m in material.found.of("real", "Person")}) == 14
    assert len(material.pairs["Person"]) >= 20
    assert "none_beside" not in material.found.left_out.get("inserted/Person", {})
    assert not material.sensor
    assert set(material.found.objects) == {"real", "inserted", "floor", "hard_paste"}


def test_incomparable_runs_are_refused(crowd, tmp_path):
    run, data = crowd
    with pytest.raises(DatasetError, match=r"Car: expected classes that are both inserted \(Person\) and annotated"):
        api.realism(run, data, tmp_path, categories=["Car"], execution=HERE)
    with pytest.raises(DatasetError, match="no frame taken by day has an inserted object"):
        api.realism(run, data, tmp_path, time_of_day="day", execution=HERE)


def test_a_run_of_other_backgrounds_is_refused(crowd, tmp_path, write_tiny_hit_uav):
    run, _ = crowd
    with pytest.raises(DatasetError, match=r"12 of the backgrounds of .* are missing"):
        api.realism(run, write_tiny_hit_uav(tmp_path / "tiny"), tmp_path / "out", execution=HERE)
