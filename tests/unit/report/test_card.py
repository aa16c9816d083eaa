"""Dataset cards: front matter that the hub accepts, counts equal to run.json, no invented sources."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import yaml

from infrablend import api
from infrablend.core.dataset import Dataset
from infrablend.formats.published.sources import PAPER_BIBTEX, SOURCES
from infrablend.report.card import Card, card_text, dataset_card, find_provenance, is_own, write_card
from tests.samples import SAMPLES

HUB_KEYS = {
    "pretty_name", "license", "license_name", "license_link", "task_categories", "tags", "size_categories", "configs",
}  # fmt: skip
HUB_LICENCES = {"cc-by-4.0", "mit", "apache-2.0", "cdla-permissive-1.0", "cc0-1.0", "other", "unknown"}
HUB_TASKS = {"object-detection", "image-segmentation"}
HUB_SIZES = {"n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M", "n>10M"}


def front_matter(text: str) -> dict:
    """Return the front matter, after checking it against the hub's rules."""
    assert text.startswith("---\n")
    found = yaml.safe_load(text.split("---\n")[1])
    assert set(found) <= HUB_KEYS
    assert found["license"] in HUB_LICENCES
    assert ("license_name" in found) == ("license_link" in found) == (found["license"] == "other")
    assert set(found["task_categories"]) <= HUB_TASKS
    assert set(found["size_categories"]) <= HUB_SIZES
    assert all(isinstance(t, str) for t in found["tags"])
    assert isinstance(found["pretty_name"], str)
    assert re.fullmatch(r"[a-z0-9.-]+", found.get("license_name", "none"))
    for config in found.get("configs", []):
        assert config["config_name"] == "default"
        assert all(set(f) == {"split", "path"} for f in config["data_files"])
        assert {f["split"] for f in config["data_files"]} <= {"train", "validation", "test"}
    return found


def table(text: str) -> dict[str, dict[str, str]]:
    """The counts: row -> column -> text."""
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    head, _, *rows = ([c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines)
    return {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}


def bare(root: Path, name: str = "folder") -> Card:
    """The card of a dataset without images."""
    return dataset_card(find_provenance(Dataset(root, name, (), ())), (), (), changes=["converted"], to="coco")


@pytest.fixture
def data(tmp_path, write_tiny_hit_uav) -> Path:
    return write_tiny_hit_uav(tmp_path / "data" / "hit")


def generate(data: Path, out: Path, **options):
    options = {
        "execution": api.Execution(renderer="flat", in_process=True),
        "settings": ["output.image=png"],
        **options,
    }
    return api.generate("hit-uav-drone", data, out, **options)


@pytest.fixture(scope="module")
def drones(tmp_path_factory, write_tiny_hit_uav) -> Path:
    """A run that no test changes."""
    folder = tmp_path_factory.mktemp("drones")
    generate(write_tiny_hit_uav(folder / "data"), folder / "run", settings=["output.image=png", "name=with-drones"])
    return folder / "run"


def card(run: Path) -> str:
    return (run / "README.md").read_text("utf-8")


def test_a_run_gets_a_card_whose_counts_are_those_of_its_record(data, tmp_path):
    run = tmp_path / "run"
    generate(data, run, settings=["output.image=png", "output.originals=true"])
    text, record = card(run), json.loads((run / "run.json").read_text())
    found = front_matter(text)
    assert found["license"] == "cc-by-4.0"
    assert found["task_categories"] == ["object-detection", "image-segmentation"]
    counts, rows = record["counts"], table(text)
    for split, n in counts["images_per_split"].items():
        assert int(rows["pictures"][split]) == n
        for name, row in rows.items():
            if name != "pictures":
                name = name.removesuffix(" (regions to ignore)")
                assert int(row[split]) == counts["labels_per_split"][split].get(name, 0)
    assert int(rows["pictures"]["all"]) == counts["images"] == 12
    assert {n: int(r["inserted"]) for n, r in rows.items() if r["inserted"] not in {"", "0"}} == counts[
        "labels_inserted"
    ]
    assert sum(int(r["all"]) for n, r in rows.items() if n != "pictures") == sum(counts["labels"].values())
    assert "DontCare (regions to ignore)" in rows
    assert f"{counts['images']} pictures were made from 4 backgrounds; they contain 8 rendered objects" in text
    for format_name in record["formats"]:
        assert f"* `{format_name}`: " in text
    for path in (f["path"] for c in found["configs"] for f in c["data_files"]):
        assert any(run.glob(path.replace("**", "*.png")))
    assert [f["split"] for f in found["configs"][0]["data_files"]] == ["train", "validation", "test"]
    assert PAPER_BIBTEX in text
    assert "10.1038/s41597-023-02066-6" in text
    assert "525 of its 579" in text
    assert "Identified as hit-uav by the layout of its files" in text
    assert "seed: 0" in text


def test_every_loss_has_a_description(drones):
    losses = json.loads((drones / "run.json").read_text())["losses"]
    text = card(drones)
    assert losses
    for key, n in losses.items():
        line = next(line for line in text.splitlines() if line.startswith(f"* `{key.split('.')[0]}`"))
        assert f"{n} x " in line
        assert key.split(".")[-1] not in line  # words, not codes


def test_the_card_says_nothing_of_machine_or_time_and_repeats(data, tmp_path):
    generate(data, tmp_path / "a")
    shutil.copytree(data, tmp_path / "elsewhere")
    generate(tmp_path / "elsewhere", tmp_path / "b" / "c", settings=["output.image=png"])
    for name in ("README.md", "SOURCE.json"):
        first = (tmp_path / "a" / name).read_bytes()
        assert first == (tmp_path / "b" / "c" / name).read_bytes()
        assert str(tmp_path).encode() not in first
        assert not re.search(rb"20[0-9]{2}-[0-9]{2}-[0-9]{2}", first)


def test_user_models_folder_is_not_recorded(data, tmp_path):
    from infrablend.config.loading import load_recipe
    from infrablend.pipeline.datasets.origin import recipe_yaml
    from infrablend.pipeline.plans.planning import make_plan

    plan = make_plan(load_recipe("hit-uav-drone"), api.read_dataset(data), 0)
    own = plan.recipe.objects[0].model_copy(update={"model": str(tmp_path / "secret" / "kite.yaml")})
    changed = plan.recipe.model_copy(update={"objects": (own,)})
    object.__setattr__(plan, "recipe", changed)
    text = recipe_yaml(plan.recipe)
    assert "kite.yaml" in text
    assert "secret" not in text


def test_the_recipe_of_a_card_has_one_order_however_it_was_read():
    from infrablend.config.loading import load_recipe
    from infrablend.config.modes import recipe_from_json
    from infrablend.pipeline.datasets.origin import recipe_yaml

    recipe = load_recipe("hit-uav-people", ["labels.loosen_px={Person: 3.5, Adult: 2}"])
    recorded = recipe_from_json(json.dumps(json.loads(recipe.model_dump_json()), sort_keys=True))
    assert recipe_yaml(recorded) == recipe_yaml(recipe)
    assert recipe_yaml(recipe).index("Adult") < recipe_yaml(recipe).index("Person: 3.5")


def test_edited_card_is_kept_when_labels_are_written_again(data, tmp_path):
    run = tmp_path / "run"
    generate(data, run)
    original = card(run)
    assert is_own(run / "README.md")
    (run / "README.md").write_text(original.replace("# hit-uav-drone", "# My drones"))
    assert not is_own(run / "README.md")
    (run / "report.html").unlink()
    report = generate(data, run, existing="resume")
    assert "# My drones" in card(run)
    assert [p.code for p in report.problems if p.where == "README.md"] == ["card-kept"]
    (run / "README.md").unlink()
    generate(data, run, existing="resume")
    assert card(run) == original
    generate(data, run, existing="overwrite", limit=1)
    assert int(table(card(run))["pictures"]["all"]) == 2


@pytest.mark.parametrize(
    ("text", "licence"),
    [
        ("Attribution 4.0 International\n\n====\n", "cc-by-4.0"),
        ("MIT License\n\nCopyright (c) 2022 A", "mit"),
        (f"{' ' * 33}Apache License\n{' ' * 27}Version 2.0, January 2004", "apache-2.0"),
        ("Community Data License Agreement \u2013 Permissive \u2013 Version 1.0\n", "cdla-permissive-1.0"),
        ("Creative Commons CC0 1.0 Universal", "cc0-1.0"),
        ("Ask me first.", "other"),
    ],
)  # fmt: skip
def test_a_licence_file_beside_pictures_of_unknown_source(tmp_path, text, licence):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "LICENSE").write_text(text, "utf-8")
    source = find_provenance(Dataset(folder, "folder", (), ()))
    assert (source.title, source.licence.id) == ("", licence)
    made = bare(folder, "folder")
    written = card_text(made)
    assert front_matter(written)["license"] == licence
    assert "The source of the pictures is not known" in written
    write_card(tmp_path, made)
    assert (tmp_path / "LICENSE-source.txt").read_text("utf-8") == text


def test_contradicting_licence_is_reported(data):
    (data / "LICENSE").write_text("MIT License\n")
    source = find_provenance(api.read_dataset(data))
    assert source.licence.id == "mit"
    assert "says MIT License, but the dataset's page says CC BY 4.0" in source.licence_note
    (data / "LICENSE").write_text("All rights reserved")
    source = find_provenance(api.read_dataset(data))
    assert source.licence.id == "cc-by-4.0"
    assert "another text" in source.licence_note


@pytest.mark.parametrize("known", SOURCES, ids=lambda s: s.name)
def test_known_sources(tmp_path, known):
    made = card_text(bare(tmp_path, known.name))
    assert front_matter(made)["license"] == known.licence.id
    assert known.title in made
    assert known.citation in made
    assert known.attribution in made
    for limit in known.limits:
        assert limit in made
    assert ("Licence: unknown." in made) == (known.name in ("wit-uas", "drone-vehicle"))


def test_own_output_is_not_taken_for_the_original(tmp_path):
    ours = Dataset(
        tmp_path, "hit-uav", (), (), extra={"info": {"description": "HIT-UAV layout, written by InfraBlend"}}
    )
    assert find_provenance(ours).title == ""
    real = Dataset(tmp_path, "hit-uav", (), (), extra={"info": {"description": "PegasusDrone"}})
    assert find_provenance(real).how == "Identified by its annotation files."
    (tmp_path / "world.json").write_text("{}")
    world = find_provenance(ours)
    assert world.own
    assert "choose one" in card_text(dataset_card(find_provenance(ours), (), (), changes=["c"], to="coco"))


def test_a_run_on_a_run_keeps_its_origin_and_its_changes_and_names_both_recipes(data, tmp_path):
    (data / "LICENSE").write_text("Attribution 4.0 International\n")
    generate(data, tmp_path / "first", settings=["output.image=png", "name=one"])
    generate(tmp_path / "first" / "native", tmp_path / "second", settings=["output.image=png", "name=two"])
    api.convert(tmp_path / "second" / "coco", tmp_path / "third", "coco")
    for name in ("second", "third"):
        assert re.findall(r"by the recipe `(\w+)`", card(tmp_path / name)) == ["one", "two"]
    text = card(tmp_path / "second")
    assert front_matter(text)["license"] == "cc-by-4.0"
    assert "Earlier changes to the source" in text
    assert "8 pictures were made from 4 backgrounds" in text
    assert "16 pictures were made from 8 backgrounds" in text
    assert (tmp_path / "second" / "LICENSE-source.txt").read_text() == "Attribution 4.0 International\n"
    assert len(json.loads((tmp_path / "second" / "SOURCE.json").read_text())["changes"]) > 3


@pytest.mark.parametrize("folder", ["coco", "native", "yolo"])
def test_a_converted_run_names_its_inserted_objects(drones, tmp_path, folder):
    api.convert(drones / folder, tmp_path / "voc", "voc")
    api.convert(tmp_path / "voc", tmp_path / "coco", "coco")
    api.split(tmp_path / "coco", tmp_path / "split", api.SplitRule(by="gap", gap=1, shares=(0.5, 0.25, 0.25)))
    original = card(drones)
    limits = original.partition("## Known limits")[2].partition("<!--")[0]
    recipe = re.findall(r"^```yaml\n.*?^```", original, re.MULTILINE | re.DOTALL)
    assert len(recipe) == 1 and "Inserted objects are rendered" in limits
    for name in ("voc", "coco", "split"):
        text = card(tmp_path / name)
        assert "synthetic" in front_matter(text)["tags"], name
        assert "with rendered objects in its pictures" in text
        assert "no object was inserted" not in text
        assert "by the recipe `with-drones` with seed 0, 8 labels (8 drone)" in text
        assert recipe[0] in text
        assert PAPER_BIBTEX in text
        for limit in limits.strip().splitlines():
            assert limit in text, name


def test_the_card_counts_the_labels_that_are_marked_as_inserted(drones, tmp_path):
    for name in ("coco", "images"):
        shutil.copytree(drones / name, tmp_path / "alone" / name)
    for source in (drones / "coco", tmp_path / "alone" / "coco"):  # the mark alone is enough
        api.convert(source, tmp_path / "again", "yolo", overwrite=True)
        text = card(tmp_path / "again")
        assert "synthetic" in front_matter(text)["tags"]
        assert table(text)["drone"]["inserted"] == "8"
        assert "Inserted objects are rendered" in text
    assert "recipe `" not in text


def labels_of_inserts(folder):
    """Return the inserts that a `SOURCE.json` lists: recipe, seed and number of labels by category."""
    told = json.loads((folder / "SOURCE.json").read_text())["inserts"]
    return [(one["recipe"], one["seed"], one["labels"]) for one in told]


@pytest.mark.parametrize("folder", ["coco", "yolo"])  # yolo does not mark inserted objects
@pytest.mark.parametrize(
    ("change", "labels"),
    [
        ({}, {"drone": 8}),
        ({"selection": api.Selection(images=2)}, {"drone": 2}),
        ({"classes": api.ClassChanges(drop=("drone",))}, {}),
        ({"classes": api.ClassChanges(rename={"drone": "uav"})}, {"uav": 8}),
        ({"classes": api.ClassChanges(rename={"drone": "uav"}), "selection": api.Selection(images=3)}, {"uav": 3}),
    ],
    ids=["all", "subset", "dropped", "renamed", "renamed-subset"],
)
def test_inserts_count_the_labels_that_are_written(drones, tmp_path, folder, change, labels):
    api.convert(drones / folder, tmp_path / "again", "coco", **change)
    assert labels_of_inserts(tmp_path / "again") == [("with-drones", 0, labels)]


@pytest.mark.parametrize("folder", ["coco", "yolo"])
def test_the_labels_of_two_runs_are_told_apart_by_class(data, tmp_path, folder):
    generate(data, tmp_path / "first")
    second = {"name": "two", "objects.0.category": "uav", "output.image": "png"}
    generate(tmp_path / "first" / folder, tmp_path / "second", settings=second, limit=3)
    # Each background is used twice.
    assert labels_of_inserts(tmp_path / "second") == [("hit-uav-drone", 0, {"drone": 6} if folder == "coco" else {}),
                                                      ("two", 0, {"uav": 6})]  # fmt: skip
    api.convert(tmp_path / "second" / "coco", tmp_path / "part", "coco", selection=api.Selection(images=1))
    first = {"drone": 1} if folder == "coco" else {}
    assert labels_of_inserts(tmp_path / "part") == [("hit-uav-drone", 0, first), ("two", 0, {"uav": 1})]


def test_a_source_file_by_hand(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    told = {
        "title": "Our flights\n# not a heading", "page": "https://example.org",
        "licence": {"id": "CC-BY-SA-4.0", "name": "CC BY-SA 4.0", "url": "https://example.org/l"},
        "attribution": "Us", "citation": "@misc{us}\n```\n# no", "archives": {"all": {"commit": "a" * 40}},
    }  # fmt: skip
    (folder / "SOURCE.json").write_text(json.dumps(told))
    source = find_provenance(Dataset(folder, "folder", (), ()))
    assert source.licence.id == "cc-by-sa-4.0"
    assert source.title == "Our flights # not a heading"
    assert "```" not in source.citation
    assert "a" * 40 in source.how
    told["licence"] = {"id": "our-own-licence", "url": "https://example.org/l"}
    (folder / "SOURCE.json").write_text(json.dumps(told))
    written = card_text(bare(folder, "folder"))
    assert front_matter(written)["license"] == "other"
    assert front_matter(written)["license_name"] == "our-own-licence"


@pytest.mark.parametrize(
    "text",
    [None, "[", "[]", "{}", '{"licence": "mit"}', '{"licence": {"id": 3}, "title": [1], "changes": [2]}', "null"],
)
def test_an_unknown_source_must_be_filled_in_and_broken_source_files_are_harmless(tmp_path, text):
    if text is not None:
        (tmp_path / "SOURCE.json").write_text(text)
    made = card_text(bare(tmp_path, "folder"))
    assert front_matter(made)["license"] == "unknown"
    assert "Before you publish, find out the licence" in made


def test_on_real_hit_uav(real_data, tmp_path):
    generate(real_data / "hit-uav", tmp_path / "run", limit=3)
    text = card(tmp_path / "run")
    assert "Identified by its annotation files." in text
    assert "The licence's text is in `LICENSE-source.txt`" in text
    assert (tmp_path / "run" / "LICENSE-source.txt").read_bytes() == (real_data / "hit-uav" / "LICENSE").read_bytes()
    assert front_matter(text)["license"] == "cc-by-4.0"


def test_converted_and_split_datasets_have_cards(data, tmp_path):
    (data / "LICENSE").write_text("Attribution 4.0 International\n")
    api.convert(
        data, tmp_path / "coco", "coco", classes=api.ClassChanges(drop=["Bicycle"], rename={"OtherVehicle": "Truck"})
    )
    text = card(tmp_path / "coco")
    assert front_matter(text)["license"] == "cc-by-4.0"
    rows = table(text)
    assert (rows["pictures"]["all"], rows["Truck"]["test"], "Bicycle" in rows) == ("4", "1", False)
    assert "Classes were renamed: OtherVehicle to Truck." in text
    assert "1 labels of dropped classes (Bicycle 1) were left out." in text
    assert PAPER_BIBTEX not in text  # nothing was inserted
    assert "no object was inserted" in text
    assert "synthetic" not in front_matter(text)["tags"]
    assert len(api.read_dataset(tmp_path / "coco").images) == 4
    api.split(data, tmp_path / "split", api.SplitRule(by="gap", gap=1, shares=(0.5, 0.25, 0.25)))
    text = card(tmp_path / "split")
    assert "other splits" in text
    assert int(table(text)["pictures"]["all"]) == 4
    assert len(api.read_dataset(tmp_path / "split").images) == 4
    api.convert(data, tmp_path / "coco", "yolo", overwrite=True)
    assert "* `yolo`: " in card(tmp_path / "coco")


def test_the_card_of_a_conversion_lists_its_files_and_claims_masks_only_if_the_format_has_them(tmp_path):
    coco = SAMPLES["coco"](tmp_path / "data")
    for to, files in {
        "coco": ["annotations/", "images/", "convert.json"],
        "yolo-obb": ["images/", "labels/", "data.yaml", "convert.json"],
        "yolo-seg": ["images/", "labels/", "data.yaml", "convert.json"],
        "masks": ["images/", "masks/", "categories.json", "convert.json"],
        "hit-uav": ["normal_json/", "rotate_json/", "convert.json"],
    }.items():
        api.convert(coco, tmp_path / to, to)
        text = card(tmp_path / to)
        tree = text.partition("## Files")[2].split("```")[1].splitlines()[1:]
        assert [line.split()[0] for line in tree] == [*files, "SOURCE.json"], to
        assert all((tmp_path / to / line.split()[0]).exists() for line in tree)
        tasks = front_matter(text)["task_categories"]
        assert ("image-segmentation" in tasks) == (to in ("coco", "yolo-seg", "masks")), to
    api.split(coco, tmp_path / "split", api.SplitRule(by="gap", gap=1, shares=(0.5, 0.25, 0.25)))
    assert all(f"\n{name} " in card(tmp_path / "split") for name in ("annotations/", "images/", "split.json"))
