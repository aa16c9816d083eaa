"""The physical recipes in the pipeline without Blender: bad backgrounds, 16 bit, run records."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.compositing.gain import SharePrior
from infrablend.config.loading import load_recipe
from infrablend.config.recipe import LocalMatching
from infrablend.errors import DatasetError, MissingDependencyError, RecipeError
from infrablend.pipeline.compose.looks import local_settings
from infrablend.pipeline.plans.run_request import RunRequest
from infrablend.pipeline.runs.generate import plan_request
from tests.command_line import done, run
from tests.recipes import ANYWHERE
from tests.run_files import records

RECORDS = ("1_80_60_0_00001", "1_80_60_0_00002", "1_80_60_0_00003")


def scenery(seed: int) -> np.ndarray:
    """Smooth ground from 60 to 180 with a little grain."""
    rng = np.random.default_rng(seed)
    coarse = cv2.GaussianBlur(rng.normal(0, 1, (512, 640)), (0, 0), 60)
    return np.clip(120 + 40 * coarse / coarse.std() + rng.normal(0, 1.5, (512, 640)), 16, 235).astype(np.uint8)


def folder(root: Path, pictures: dict[str, Image.Image]) -> Path:
    root.mkdir()
    rows = ["file,pitch_deg,altitude_m,time_of_day"]
    for name, picture in pictures.items():
        picture.save(root / name)
        rows.append(f"{name},60,80,night")
    (root / "metadata.csv").write_text("\n".join(rows) + "\n")
    return root


def write_yolo(root: Path, stem: str, pixels: np.ndarray, lines: list[str]) -> None:
    for kind in ("images", "labels"):
        (root / kind / "train").mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(root / "images" / "train" / f"{stem}.png")
    (root / "labels" / "train" / f"{stem}.txt").write_text("\n".join(lines) + "\n")


def generate(data: Path, out: Path, recipe: str = "hit-uav-drone-physical", settings=(), limit: int | None = None):
    pairs = ["output.image=png", "configurations=1", *settings]
    how = api.Execution(renderer="flat", in_process=True)
    return api.generate(recipe, data, out, settings=pairs, execution=how, limit=limit)


@pytest.mark.parametrize("recipe", ["hit-uav-drone-physical", "monet-deer-physical"])
def test_the_shipped_recipes_run_and_say_what_they_did(tmp_path, recipe):
    data = folder(tmp_path / "data", {f"{n}.png": Image.fromarray(scenery(k)) for k, n in enumerate(RECORDS)})
    report = generate(data, tmp_path / "run", recipe)
    assert report.counts["frames_without_object"] == 0
    for r in records(tmp_path / "run"):
        assert r.scene.view.camera_height_m == pytest.approx(1.15 * 80)
        (gain,) = r.facts["matching"]["gain"].values()
        assert gain["bounds"][0] <= gain["grey_per_k"] <= gain["bounds"][1] <= 16
        assert r.facts["sensor"]["profile"] in ("hit-uav", "monet")
        drawn = np.array(Image.open(tmp_path / "run" / "images" / r.image))
        before = np.array(Image.open(data / r.background["path"]))
        changed = np.argwhere(drawn != before)[:, ::-1]
        assert len(changed)
        # Nothing but the object, its halo and the 8 px blocks these touch.
        x0, y0, x1, y1 = r.inserted[0].box_xyxy
        low, high = changed.min(axis=0), changed.max(axis=0)
        assert (low >= np.array([x0, y0]) - 24).all() and (high <= np.array([x1, y1]) + 24).all()


def test_objects_behind_the_virtual_camera_are_counted(tmp_path):
    """The look of what is behind the camera failed on a position that is no number."""
    data = folder(tmp_path / "data", {f"{RECORDS[0]}.png": Image.fromarray(scenery(0))})
    settings = [
        "placement={mode: paper, on_miss: keep, min_contrast: off}",
        "camera={pitch: {fixed_deg: 30}, distance_m: 2}",
        "objects=[{model: person, x_m: 0, y_m: -30}, {model: person, x_m: 0, y_m: 0, z_m: -1}]",
    ]
    report = generate(data, tmp_path / "run", settings=settings)
    assert report.counts["objects_left_out"] == {"behind_camera": 1}
    assert report.counts["objects_by_kind"]["objects.1"] == {"asked": 1, "inserted": 1}


def test_labels_of_crowds_are_counted_apart(tmp_path):
    """COCO holds them and YOLO leaves them out, so the number of labels alone hides the difference."""
    data = folder(tmp_path / "data", {f"{RECORDS[0]}.png": Image.fromarray(scenery(0))})
    rows = [
        {"id": n, "image_id": 1, "category_id": category, "bbox": [40 * n, 400, 20, 20], "iscrowd": int(n > 1)}
        for n, category in enumerate([1, 1, 1, 2], 1)
    ]
    top = {
        "images": [{"id": 1, "file_name": f"{RECORDS[0]}.png", "width": 640, "height": 512}],
        "annotations": rows,
        "categories": [{"id": 1, "name": "deer"}, {"id": 2, "name": "DontCare"}],
    }
    (data / "train.json").write_text(json.dumps(top))
    counts = generate(data, tmp_path / "run", settings=["output.formats=[coco, yolo]"]).counts
    assert counts["labels"]["deer"] == 3 and counts["labels_of_crowds"] == {"deer": 2}


def test_the_contrast_before_the_gate_includes_objects_that_were_never_rendered(tmp_path):
    """Objects that are expected to be faint are moved before the first render, and were missing from the quantiles."""
    data = folder(tmp_path / "data", {f"{RECORDS[0]}.png": Image.fromarray(scenery(0))})
    settings = ["placement.min_contrast={change_grey: 110}", "placement.max_relief_grey=0", "objects.0.count=6"]
    report = generate(data, tmp_path / "run", "hit-uav-person", settings)
    (record,) = records(tmp_path / "run")
    first = record.facts["contrast_first"]
    assert len(first) == 6
    early = [c for c in first if c.get("expected")]
    assert early and all(c["changed"] < 110 for c in early)
    assert "before placement.min_contrast" in report.counts["contrast_grey"]


def test_limits_of_16_bit_pictures_are_8_bit_levels(tmp_path):
    """In the artistic look no range of levels is measured; the contrast was then in counts."""
    grey = scenery(0)
    contrasts = {}
    for name, pixels in (("8", grey), ("16", grey.astype(np.uint16) * 50 + 7000)):
        data = folder(tmp_path / f"data{name}", {f"{RECORDS[0]}.png": Image.fromarray(pixels)})
        generate(data, tmp_path / f"run{name}", "hit-uav-drone", ["sensor.profile=off"])
        (record,) = records(tmp_path / f"run{name}")
        (measured,) = record.facts["contrast"]
        contrasts[name] = measured["changed"]
    assert contrasts["16"] == pytest.approx(contrasts["8"], rel=0.4)


def test_colour_maps_and_flat_pictures_are_skipped_and_named(tmp_path):
    grey = scenery(0)
    palette = Image.fromarray(cv2.applyColorMap(grey, cv2.COLORMAP_INFERNO)[..., ::-1].copy())
    pictures = {
        "a_good.png": Image.fromarray(grey),
        "b_colour.png": palette,
        "c_flat.png": Image.fromarray(np.full((512, 640), 90, np.uint8)),
        # A palette of greys is grey.
        "d_palette.png": Image.fromarray(grey).convert("P"),
    }
    report = generate(folder(tmp_path / "data", pictures), tmp_path / "run")
    found = {p.where: p.code for p in report.problems if p.severity == "error"}
    assert found == {"b_colour.png": "image-colour-mapped", "c_flat.png": "image-no-contrast"}
    assert report.counts["frames"] == 2
    assert not report.ok


def test_sixteen_bit_stays_sixteen_bit_and_linear(tmp_path):
    wide = {f"{n}.png": Image.fromarray((scenery(k).astype(np.uint16) - 16) * 20 + 7000) for k, n in enumerate(RECORDS)}
    data = folder(tmp_path / "data", wide)
    generate(data, tmp_path / "run")
    for r in records(tmp_path / "run"):
        drawn, before = (
            np.array(Image.open(p)) for p in (tmp_path / "run/images" / r.image, data / r.background["path"])
        )
        assert drawn.dtype == np.uint16 or drawn.dtype == np.int32
        assert before.min() - 50 <= drawn.min() and drawn.max() <= before.max() + 2500
        unit = (r.facts["matching"]["levels"][1] - r.facts["matching"]["levels"][0]) / 220
        slope = (r.mapping["bright"] - r.mapping["dark"]) * 0.72 / unit  # levels per kelvin at some 10 C
        (gain,) = r.facts["matching"]["gain"].values()
        assert slope == pytest.approx(gain["grey_per_k"], rel=0.2)
        assert r.facts["sensor"]["codec_quality"] is None


def test_background_without_altitude_is_skipped_and_named(tmp_path):
    data = folder(tmp_path / "data", {"a.png": Image.fromarray(scenery(0)), "b.png": Image.fromarray(scenery(1))})
    (data / "metadata.csv").write_text("file,pitch_deg,altitude_m\na.png,60,80\nb.png,60,\n")
    report = generate(data, tmp_path / "run")
    assert [(p.where, p.code) for p in report.problems if p.severity == "error"] == [("train/b.png", "no-altitude")]
    fixed = generate(data, tmp_path / "fixed", settings=["camera.altitude={fixed_m: 50}"])
    assert fixed.counts["frames"] == 2


def test_the_ground_is_drawn_with_people_and_a_legend(tmp_path):
    data = folder(tmp_path / "data", {"a.png": Image.fromarray(scenery(0))})
    generate(data, tmp_path / "run")
    sheet = np.asarray(Image.open(api.preview_ground(tmp_path / "run", tmp_path / "ground.png"))).astype(int)
    assert sheet.shape[1] >= 2 * 640
    r, g, b = np.moveaxis(sheet, 2, 0)
    yellow, pink = (r > b + 80) & (g > b + 50), (r > g + 80) & (b > g + 40)
    assert yellow[:26].any() and pink[:26].any()  # the legend, 26 px
    assert yellow[52:].sum() > 5 * 2 * 2 * 6  # five people, at 92 m more than 6 px high, drawn twice as large
    assert not pink[52:].any()  # no cars where none are labelled


def test_realism_says_which_times_of_day_there_are(tmp_path):
    pytest.importorskip("sklearn")
    data = folder(tmp_path / "data", {"a.png": Image.fromarray(scenery(0)), "b.png": Image.fromarray(scenery(1))})
    generate(data, tmp_path / "run")
    with pytest.raises(DatasetError, match=r"no frame taken by day .* frames with one: night 2"):
        api.realism(tmp_path / "run", data, time_of_day="day")


def test_invisible_objects_are_counted_but_not_inserted(tmp_path):
    data = folder(tmp_path / "data", {"a.png": Image.fromarray(scenery(0))})
    report = generate(data, tmp_path / "run", settings=["placement.min_contrast={change_grey: 255}"])
    assert report.counts["frames_without_object"] == 1
    assert report.counts["frames_without_object_because"] == {"low_contrast": 1}
    # What was estimated for the object is recorded and counted all the same.
    (record,) = records(tmp_path / "run")
    assert record.facts["matching"]["gain"] and report.counts["frames_in_doubt"] == {"no-anchor": 1}
    (found,) = [p for p in report.problems if p.code == "low-contrast"]
    assert "placement.min_contrast" in str(found) and found.found.startswith("1 of 1 objects were not inserted")
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["draws"]["absent"] == record["counts"]["objects_left_out"] == {"low_contrast": 1}


def test_other_class_names_change_no_picture(tmp_path):
    # Cars and people tell the camera's height and the grey levels by what they are, not by what they shall be called.
    data = tmp_path / "data"
    for k, name in enumerate(RECORDS):
        write_yolo(data, name, scenery(k), ["0 0.5 0.5 0.03 0.05", "1 0.25 0.3 0.08 0.1", "2 0.8 0.8 0.1 0.1"])
    (data / "data.yaml").write_text("train: images/train\nval: images/train\nnames: [Person, Car, DontCare]\n")
    generate(data, tmp_path / "plain")
    generate(data, tmp_path / "renamed", settings=["labels.rename={Person: human, Car: human, DontCare: human}"])
    plain, renamed = records(tmp_path / "plain"), records(tmp_path / "renamed")
    assert len(plain) == len(RECORDS)
    assert all(set(r.scene.view.anchors) == {"person", "car"} for r in plain)
    assert [(r.scene, r.mapping, r.image_sha256) for r in plain] == [
        (r.scene, r.mapping, r.image_sha256) for r in renamed
    ]


@pytest.mark.parametrize(
    ("inserted", "known", "similar"),
    [
        ("person", ["car", "Person"], "Person"),
        ("Person", ["persons"], "persons"),
        ("People", ["person"], "person"),
        ("Bus", ["BUSES"], "BUSES"),
        ("bodies", ["body"], "body"),
        ("person", ["Person", "person"], None),
        ("deer", ["red deer"], None),
        ("car", ["cart"], None),
    ],
)
def test_a_class_in_another_spelling_than_the_datasets_is_refused(tmp_path, inserted, known, similar):
    data = tmp_path / "data"
    write_yolo(data, "a", scenery(0), ["0 0.5 0.5 0.1 0.1"])
    (data / "data.yaml").write_text(f"train: images/train\nnames: [{', '.join(known)}]\n")
    settings = {"objects.0.category": inserted, "camera.pitch": {"fixed_deg": 45}, "output.formats": ["yolo"]}

    def make_plan(**more):
        return plan_request(RunRequest("hit-uav-drone", data, settings={**settings, **more}))

    if similar is None:
        assert inserted in [c.name for c in make_plan().categories]
        return
    with pytest.raises(RecipeError) as caught:
        make_plan()
    (problem,) = caught.value.problems
    assert problem.where == "objects.0.category" and f"{inserted!r} beside {similar!r}" in problem.found
    assert (
        f"objects.0.category={similar} " in problem.todo and f"labels.rename={{{similar}: {inserted}}} " in problem.todo
    )
    assert make_plan(**{"objects.0.category": similar}).new_categories == ()
    renamed = make_plan(**{"labels.rename": {similar: inserted}})
    assert renamed.new_categories == () and similar not in {c.name for c in renamed.categories}
    assert make_plan(**{"labels.similar_names": "keep"}).new_categories == (inserted,)


def test_run_without_a_place_for_objects_reports_it(tmp_path):
    data = folder(tmp_path / "data", {f"{RECORDS[0]}.png": Image.fromarray(scenery(0))})
    settings = ["objects=[{model: person}]", "camera.pitch={fixed_deg: -20}"]
    report = generate(data, tmp_path / "run", settings=settings)
    (found,) = [p for p in report.problems if p.code == "objects-absent"]
    why = "no_place 1 (no place was found where it fits); places refused: no_ground 200 (there is no ground)"
    assert found.found == f"1 of 1 objects were not inserted: {why}"
    assert not [p for p in generate(data, tmp_path / "good").problems if p.code == "objects-absent"]


def test_levels_of_8_and_of_16_bits_are_not_mixed(tmp_path):
    deep = (scenery(1).astype(np.uint16) - 16) * 20 + 7000
    pictures = {f"{RECORDS[0]}.png": Image.fromarray(scenery(0)), f"{RECORDS[1]}.png": Image.fromarray(deep)}
    data = folder(tmp_path / "data", pictures)
    with pytest.raises(DatasetError, match="8 and of 16 bits, whose levels have no common range"):
        generate(data, tmp_path / "run")


def test_levels_are_the_datasets_whatever_the_limit(tmp_path):
    wide = {f"{n}.png": Image.fromarray(scenery(k) // (1 + k)) for k, n in enumerate(RECORDS)}
    data = folder(tmp_path / "data", wide)
    for name, limit in (("all", None), ("one", 1)):
        generate(data, tmp_path / name, limit=limit)
    runs = [json.loads((tmp_path / n / "run.json").read_text()) for n in ("all", "one")]
    assert runs[0]["levels"] == runs[1]["levels"]
    first = f"images/train/{RECORDS[0]}_c0.png"
    assert (tmp_path / "all" / first).read_bytes() == (tmp_path / "one" / first).read_bytes()


def test_the_expected_gain_may_differ_by_day(tmp_path):
    """No annotated object: the gain is the expectation, give or take next to nothing."""
    data = folder(tmp_path / "data", {f"{n}.png": Image.fromarray(scenery(k)) for k, n in enumerate(RECORDS)})
    table = data / "metadata.csv"
    table.write_text(table.read_text().replace(f"{RECORDS[0]}.png,60,80,night", f"{RECORDS[0]}.png,60,80,day"))
    priors = ["matching.gain_prior_grey_per_k=12", "matching.gain_prior_spread=0.001"]
    for name, settings, by_day in (
        ("a", ["matching.gain_prior_day_grey_per_k=null"], 12),
        ("b", ["matching.gain_prior_day_grey_per_k=6"], 6),
    ):
        generate(data, tmp_path / name, "hit-uav-person", [*priors, *settings])
        found = {r.background["id"]: next(iter(r.facts["matching"]["gain"].values())) for r in records(tmp_path / name)}
        assert [found[i]["grey_per_k"] for i in RECORDS] == pytest.approx([by_day, 12, 12], rel=0.01)


def test_the_local_share_and_its_neighbourhood_are_those_of_the_recipe():
    cars = load_recipe("hit-uav-cars", ["matching.local_reach=0.7"]).matching
    assert isinstance(cars, LocalMatching)
    for time_of_day, share in (("night", cars.local_share), ("day", cars.local_share_day), (None, cars.local_share)):
        assert local_settings(cars, time_of_day).local_share == SharePrior(share, cars.local_share_spread, 0.7)
    assert cars.local_share != cars.local_share_day


@pytest.mark.parametrize("recipe", ["hit-uav-people", "hit-uav-cars"])
def test_the_controls_show_the_same_scenes_with_the_same_labels(tmp_path, recipe):
    data = folder(tmp_path / "data", {f"{n}.png": Image.fromarray(scenery(k)) for k, n in enumerate(RECORDS[:1])})
    off = "sensor.profile=off"
    looks = {"whole": [], "no-sensor": [off], "flat": [off, "overlay.flat=true"]}
    looks["artistic"] = ["appearance.mode=artistic"]
    for name, settings in looks.items():
        # The contrast of the finished picture depends on the look, so a limit would leave out different objects.
        generate(
            data, tmp_path / name, recipe, [ANYWHERE, "objects.0.count=3", "placement.min_contrast=off", *settings]
        )
    found = {name: records(tmp_path / name) for name in looks}
    for name in ("no-sensor", "flat", "artistic"):
        for a, b in zip(found["whole"], found[name], strict=True):
            assert len(a.inserted) == len(b.inserted) > 0
            assert all(x.equals(y) for x, y in zip(a.inserted, b.inserted, strict=True))
            assert a.image_sha256 != b.image_sha256
    flat = found["flat"][0]
    shown = np.array(Image.open(tmp_path / "flat" / "images" / flat.image))
    before = np.array(Image.open(data / flat.background["path"]))
    assert len(np.unique(shown[shown != before])) <= len(flat.inserted)


@pytest.mark.parametrize(("options", "rows"), [(["--count", "8"], 4), (["--count", "1"], 1), ([], 3)])
def test_the_ground_preview_shows_as_many_frames_as_asked(tmp_path, options, rows):
    data = folder(tmp_path / "data", {f"{n}.png": Image.fromarray(scenery(n)[:256, :320]) for n in range(8)})
    generate(data, tmp_path / "run")
    sheet = tmp_path / "sheet.png"
    done("preview", tmp_path / "run", "--ground", "--out", sheet, *options)
    # Each cell shows a frame of 256 rows, twice enlarged.
    with Image.open(sheet) as picture:
        assert picture.height // (2 * 256) == rows


def test_the_ground_preview_compares_only_real_labels(tmp_path):
    """Inserted people have the size that the camera gives them: compared with people, they would prove any scale."""
    from infrablend.core.dataset import Instance
    from infrablend.report.ground_preview import draw_ground

    data = folder(tmp_path / "data", {f"{RECORDS[0]}.png": Image.fromarray(scenery(0))})
    generate(data, tmp_path / "run", "monet-deer-physical")
    (record,) = records(tmp_path / "run")
    plain = np.repeat(scenery(0)[..., None], 3, axis=2)
    scene = record.scene
    real = Instance("person", np.array([300.0, 300, 312, 330]))
    without, only_inserted, with_real = (
        draw_ground(plain, labels, scene.camera, scene.view.ground_z_m)[0]
        for labels in ([], list(record.inserted), [real])
    )
    assert record.inserted and (without == only_inserted).all() and (without != with_real).any()


def test_the_ground_of_a_dataset_is_drawn_before_any_run(tmp_path, monkeypatch):
    data = folder(tmp_path / "data", {"a.png": Image.fromarray(scenery(0)), "b.png": Image.fromarray(scenery(1))})
    monkeypatch.chdir(tmp_path)
    refused = run("preview", data, "--ground")
    output = " ".join(refused.output.split())
    assert refused.exit_code and "hfov_deg" in output and "--metadata FILE" in output
    (tmp_path / "facts.csv").write_text("file,pitch_deg,altitude_m,hfov_deg\na.png,60,80,40\nb.png,60,80,\n")
    said = done("preview", data, "--ground", "--metadata", tmp_path / "facts.csv")
    assert said.output.strip() == "ground.png" and not (data / "ground.png").exists()
    with Image.open(tmp_path / "ground.png") as sheet:
        assert sheet.height // (2 * 512) == 1 and sheet.width < 4 * 640  # one picture states all three


@pytest.mark.parametrize(("width", "rows"), [(200, 4), (320, 2), (640, 1), (2560, 1)])
def test_the_legend_of_the_ground_preview_is_not_cut(width, rows):
    from infrablend.report.ground_preview import LEGEND
    from infrablend.report.preview import TITLE_PX, legend, strip

    shown = legend(width, LEGEND)
    assert shown.shape == (rows * TITLE_PX, width, 3)
    for text, colour in LEGEND.items():
        whole = strip(2560, TITLE_PX, text, 14, colour)
        assert (shown == colour).all(axis=2).sum() == (whole == colour).all(axis=2).sum() > 0


def sky_folder(root: Path, count: int = 4) -> Path:
    root.mkdir()
    for n in range(count):
        rng = np.random.default_rng(n)
        levels = np.where(np.arange(256)[:, None] < 170 + 10 * n, 97, 210) + rng.normal(0, 1.5, (256, 320))
        Image.fromarray(np.clip(levels, 0, 255).round().astype(np.uint8)).save(root / f"{n}.png")
    return root


def test_drones_against_the_sky_are_bright_and_their_contrast_is_recorded(tmp_path):
    alone = ["objects.0.count=1", *(f"objects.{n}.count=0" for n in (1, 2, 3))]
    report = generate(sky_folder(tmp_path / "data"), tmp_path / "run", "drone-sky-halmstad", alone)
    assert report.counts["in_front_of"] == {"sky": 4}
    assert report.ok
    found = records(tmp_path / "run")
    assert sum(len(r.inserted) for r in found) == 4
    for r in found:
        assert r.facts["matching"]["behind"] == ["sky"]
        (measured,) = r.facts["contrast"]
        assert measured["changed"] >= 17 and measured["change"] >= 17
        assert measured["high"] > measured["ring"] + 17
        assert r.inserted[0].extra["changed_grey"] == measured["changed"]
    coco = json.loads((tmp_path / "run" / "coco" / "train.json").read_text())
    assert all(a["changed_grey"] >= 17 and a["scr"] > 1.6 for a in coco["annotations"])
    assert set(report.counts["contrast_grey"]) == {"labelled", "before placement.min_contrast"}


def test_what_is_taken_for_drones_joins_the_classes_of_the_dataset(tmp_path):
    data, labels = sky_folder(tmp_path / "data", 8), tmp_path / "data" / "annotations.json"
    images = [{"id": n, "file_name": f"{n}.png", "width": 320, "height": 256} for n in range(8)]
    known = [{"id": 5, "name": "bird"}, {"id": 7, "name": "drone"}]
    boxes = [
        {"id": n, "image_id": n, "category_id": 5, "bbox": [9, 9, 6, 5], "area": 30, "iscrowd": 0} for n in range(8)
    ]
    labels.write_text(json.dumps({"images": images, "categories": known, "annotations": boxes}))
    report = generate(data, tmp_path / "run", "drone-sky-halmstad")
    assert report.ok
    coco = json.loads((tmp_path / "run" / "coco" / "train.json").read_text())
    names = {c["id"]: c["name"] for c in coco["categories"]}
    assert sorted(names.values()) == ["airplane", "bird", "drone", "helicopter"]
    inserted = [names[a["category_id"]] for a in coco["annotations"] if a["inserted"]]
    assert set(inserted) == set(names.values()) and len(inserted) < 4 * 8
    assert {names[a["category_id"]] for a in coco["annotations"] if not a["inserted"]} == {"bird"}


def test_every_label_of_a_physical_recipe_is_seen(tmp_path):
    data = folder(tmp_path / "data", {f"{n}.png": Image.fromarray(scenery(k)) for k, n in enumerate(RECORDS)})
    for recipe in ("hit-uav-drone-physical", "hit-uav-people", "hit-uav-cars", "monet-deer-physical"):
        generate(data, tmp_path / recipe, recipe)
        measured = [c for r in records(tmp_path / recipe) for c in r.facts.get("contrast", ())]
        assert all(c["changed"] >= 3 for c in measured)
        assert all(c["change"] >= 3 for c in measured if "change" in c)


def test_untrusted_gains_leave_the_background_empty_if_the_recipe_says_so(tmp_path):
    data = tmp_path / "data"
    for n in range(2):
        pixels = scenery(n)
        lines = []
        for k in range(6):
            x, y = 60 + 90 * k, 200
            pixels[y : y + 24, x : x + 14] = 20  # people colder than the ground: black-hot, or no people
            lines.append(f"0 {(x + 7) / 640} {(y + 12) / 512} {14 / 640} {24 / 512}")
        write_yolo(data, f"{n}", pixels, lines)
    (data / "data.yaml").write_text("path: .\ntrain: images/train\nval: images/train\nnames: [Person]\n")
    fixed = ["camera.pitch={fixed_deg: 60}", "camera.altitude={fixed_m: 80}", "matching.on_untrusted=skip"]
    report = generate(data, tmp_path / "run", settings=fixed)
    assert report.counts["frames_without_object_because"] == {"untrusted": 2}
    found = generate(data, tmp_path / "used", settings=fixed[:2])
    assert {"gain-at-limit"} <= {p.code for p in found.problems}


def test_doubtful_heights_leave_the_background_empty_if_the_recipe_says_so(tmp_path):
    """People three times as large as at the stated height: the correction of the height ends at its limit."""
    data = tmp_path / "data"
    rows = ["file,pitch_deg,altitude_m,time_of_day"]
    for n, (wide, high) in enumerate(((12, 21), (36, 63))):
        rows.append(f"{n}.png,60,80,night")
        pixels = scenery(n)
        lines = []
        for k in range(8):
            x, y = 40 + 72 * k, 240
            level = int(pixels[y : y + high, x : x + wide].mean())
            pixels[y : y + high, x : x + wide] = min(level + 45, 225)  # warm, and nothing strange but the size
            lines.append(f"0 {(x + wide / 2) / 640} {(y + high / 2) / 512} {wide / 640} {high / 512}")
        write_yolo(data, f"{n}", pixels, lines)
    (data / "data.yaml").write_text("path: .\ntrain: images/train\nval: images/train\nnames: [Person]\n")
    (data / "metadata.csv").write_text("\n".join(rows) + "\n")
    generate(data, tmp_path / "used")
    usual, large = records(tmp_path / "used")
    assert (usual.scene.view.at_limit, large.scene.view.at_limit) == (False, True)
    generate(data, tmp_path / "skipped", settings=["matching.on_untrusted=skip"])
    usual, large = records(tmp_path / "skipped")
    assert len(usual.inserted) == 1 and not large.inserted
    assert large.scene.draws["absent"] == {"untrusted": 1}


# -- without Blender


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("objects.0.parts.shell.emissivity=[0.2, 0.9]", r"objects\.0\.parts\.shell\.emissivity below 0\.5"),
        ("render.quality=paper", r"render\.quality asks for 640 samples"),
        ("render.samples=16", r"render\.samples asks for 16 samples"),
    ],
)
def test_what_needs_blender_is_named_before_a_frame_is_made(tmp_path, monkeypatch, setting, reason):
    monkeypatch.setenv("INFRABLEND_BLENDER", "none")
    data = folder(tmp_path / "data", {f"{RECORDS[0]}.png": Image.fromarray(scenery(0))})
    how = api.Execution(in_process=True)
    with pytest.raises(MissingDependencyError, match=reason + ".*switched off"):
        api.generate("hit-uav-drone-physical", data, tmp_path / "run", settings=[setting], execution=how)
    assert not (tmp_path / "run").exists()


def test_a_frame_that_needs_blender_ends_the_run_which_can_be_resumed(tmp_path, monkeypatch):
    monkeypatch.setenv("INFRABLEND_BLENDER", "none")
    data = folder(tmp_path / "data", {f"{n}.png": Image.fromarray(scenery(k)) for k, n in enumerate(RECORDS)})
    how, drawn = api.Execution(in_process=True), []

    def first_frame_only(scene) -> bool:
        drawn.append(scene.spec.frame_id)
        return len(drawn) == 1

    with monkeypatch.context() as patch:
        patch.setattr("infrablend.rendering.engine.renderer.needs_no_tracing", first_frame_only)
        with pytest.raises(MissingDependencyError, match="switched off"):
            api.generate("hit-uav-drone-physical", data, tmp_path / "run", execution=how)
    assert not (tmp_path / "run").exists() and len(drawn) == 2
    api.generate("hit-uav-drone-physical", data, tmp_path / "run", execution=how, existing="resume")
    assert len(records(tmp_path / "run")) == 6 and not drawn[2:]
