"""Maps over a tuned frame, and masks painted by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from infrablend.config.loading import load_recipe
from infrablend.errors import DatasetError, OutputError, RecipeError
from infrablend.pipeline.compose.trial import TrialRequest
from infrablend.pipeline.plans.run_request import Execution
from infrablend.report.preview import to_rgb
from infrablend.report.surface_sheet import COLOURS
from infrablend.studio.ground_masks import _suits, paint, show_places, show_surfaces
from infrablend.studio.tuning import Tuned, Tuning
from tests.unit.sampling.test_suitable_ground import halves, site_of

PAPER, METRIC = "hit-uav-drone", "hit-uav-person"
MASKS = "placement.where.masks"


@pytest.fixture
def tuning(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> Iterator[Tuning]:
    data = write_tiny_hit_uav(tmp_path / "data")
    made = Tuning(TrialRequest(METRIC, data, seed=3, execution=Execution(renderer="flat", in_process=True)))
    yield made
    made.close()


def tuned_with(tuning: Tuning, recipe: str = METRIC, **settings: object) -> Tuned:
    return tuning.compose(recipe, {key.replace("__", "."): v for key, v in settings.items()}, tuning.backgrounds[-1])


@pytest.mark.parametrize("recipe", [PAPER, METRIC])
def test_surfaces_are_shown_for_any_recipe(tuning: Tuning, recipe: str) -> None:
    tuned = tuned_with(tuning, recipe)
    rgb, legend = show_surfaces(tuned, tuning.ignored)
    plain = to_rgb(tuned.trial.frame.pixels)
    assert rgb.shape == plain.shape and (rgb != plain).any()
    assert sum(float(text.split()[-2]) for text in legend) == pytest.approx(100, abs=1)
    assert all(COLOURS[text.split()[0]] == colour for text, colour in legend.items())  # type: ignore[index]
    assert (tuned.picture(boxes=False, base=rgb) == rgb).all()


def test_places_are_bright_where_objects_may_stand(tuning: Tuning) -> None:
    tuned = tuned_with(tuning, placement__where__surfaces={"road": 1})
    rgb, legend = show_places(tuned, tuning.ignored)
    assert (rgb <= to_rgb(tuned.trial.frame.pixels)).all()
    (text,) = legend
    assert text.startswith("Bright where Person may stand: ")
    for recipe, settings in ((PAPER, {}), (METRIC, {"placement__where": "anywhere"})):
        assert [*show_places(tuned_with(tuning, recipe, **settings), tuning.ignored)[1]] == [
            "This recipe asks for no surface."
        ]


def test_people_in_water_and_others_of_a_kind_have_their_places() -> None:
    def shares(*settings: str) -> list[float]:
        recipe = load_recipe(METRIC, [f"objects.0.options={{pose: standing, water: {settings[0]}}}", *settings[1:]])
        return [float((s > 0).mean()) for s in _suits(recipe, site_of(halves("grass", "water"))).values()]

    on_grass = "placement.where.surfaces={grass: 1}"
    assert shares("none", on_grass) == shares("waist", on_grass) == shares("waist", "placement.where=anywhere") == [0.5]
    assert shares("{none: 1, waist: 1}", on_grass) == [1.0]
    assert shares("{none: 1, waist: 1}", "placement.where=anywhere") == []


def test_a_painted_mask_is_beside_the_dataset_and_used_by_the_next_frame(tuning: Tuning) -> None:
    tuned = tuned_with(tuning)
    before = sorted(tuning.data.rglob("*"))
    folder = paint(tuned, tuning.data, [(10, 20), (40, 20)], 8, allowed=False)
    image = tuned.background
    path = folder / image.split / f"{image.id}.png"
    assert (folder, sorted(tuning.data.rglob("*"))) == (tuning.data.with_name("data.places"), before)
    mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert mask.dtype == np.uint8 and mask.shape == tuned.trial.frame.pixels.shape
    assert set(np.unique(mask)) == {0, 255}
    assert not mask[17:24, 10:41].any() and mask[26:].all() and mask[:14].all()

    with_mask = tuned_with(tuning, placement__where__masks=str(folder))
    shown, plain = (show_surfaces(t, tuning.ignored)[0] for t in (with_mask, tuned))
    assert (shown[20, 10:41] < plain[20, 10:41]).all()
    assert shown[40].mean() > 0.9 * plain[40].mean()  # the person moved, and the codec with it
    paint(with_mask, tuning.data, [(25, 20), (25, 20)], 64, allowed=True)
    assert cv2.imread(str(path), cv2.IMREAD_UNCHANGED).all()
    paint(with_mask, tuning.data, (), 8, allowed=False)
    assert not cv2.imread(str(path), cv2.IMREAD_UNCHANGED).any()
    assert tuned_with(tuning, placement__where__masks=str(folder)).trial.frame.inserted == ()
    # Backgrounds that nobody has painted are not restricted.
    other = tuning.compose(METRIC, {MASKS: str(folder)}, tuning.backgrounds[0])
    assert other.background is tuning.backgrounds[0]
    with pytest.raises(RecipeError) as error:
        tuned_with(tuning, placement__where__masks=str(tuning.data.with_name("none")))
    assert [p.code for p in error.value.problems] == ["masks-missing"]


def test_what_cannot_be_painted_is_named(tuning: Tuning, tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match="anywhere"):
        paint(tuned_with(tuning, PAPER), tuning.data, (), 8, allowed=False)
    tuned = tuned_with(tuning)
    (tmp_path / "data.places").write_text("a file in the place of the folder")
    with pytest.raises(OutputError, match=r"data\.places"):
        paint(tuned, tuning.data, (), 8, allowed=False)
    image = tuned.background
    inside = tuning.data / "masks"
    for folder in (inside, tmp_path / "mine"):
        (folder / image.split).mkdir(parents=True)
        (folder / image.split / f"{image.id}.png").write_bytes(cv2.imencode(".png", np.full((4, 4), 255, np.uint8))[1])
    where = tuned.recipe.placement.where.model_copy(update={"masks": str(inside)})  # type: ignore[union-attr]
    placement = tuned.recipe.placement.model_copy(update={"where": where})
    wrong = Tuned(tuned.recipe.model_copy(update={"placement": placement}), tuned.trial, image)
    with pytest.raises(OutputError, match="in the dataset"):
        paint(wrong, tuning.data, (), 8, allowed=False)
    mine = where.model_copy(update={"masks": str(tmp_path / "mine")})
    placement = tuned.recipe.placement.model_copy(update={"where": mine})
    wrong = Tuned(tuned.recipe.model_copy(update={"placement": placement}), tuned.trial, image)
    with pytest.raises(DatasetError, match="4x4"):
        paint(wrong, tuning.data, [(1, 1)], 8, allowed=False)
