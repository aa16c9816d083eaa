"""Where objects stand: surfaces that suit them, under their whole footprint, along the road, by masks and labels."""

import math

import numpy as np
import pytest

from infrablend.config.loading import load_recipe
from infrablend.core.camera import object_to_world
from infrablend.core.dataset import Instance
from infrablend.core.surface_kinds import SURFACES
from infrablend.errors import RecipeError
from infrablend.imaging.surfaces import SurfaceMap
from infrablend.sampling import labelled_ground
from infrablend.sampling.labelled_ground import ANY_TIME, ClassGround, kinds_around, learn_ground, with_labels
from infrablend.sampling.site import Site
from tests.unit.sampling.test_metric import FLAT, key, lined, off_deg, sampler_of

WH = (640, 512)
BY_HAND = ["placement.max_relief_grey=0", "objects.0.count=6", "placement.min_inside=0.9"]


def surfaces(kinds):
    """Return the map of an (h, w) array of names of kinds, sure of each."""
    shares = np.zeros((len(SURFACES), *kinds.shape), np.uint8)
    for k, kind in enumerate(SURFACES):
        shares[k][kinds == kind] = 255
    return SurfaceMap(shares, WH)


def halves(left, right):
    kinds = np.full((128, 160), left, dtype="U10")
    kinds[:, 80:] = right
    return surfaces(kinds)


def strip(yaw_deg, half_px=70):
    """Return a road of this direction through the middle of lawns, seen from above."""
    y, x = np.mgrid[2:512:4, 2:640:4]
    a = math.radians(yaw_deg)
    across = -(x - 320) * math.sin(a) - (y - 256) * math.cos(a)
    kinds = np.full((128, 160), "grass", dtype="U10")
    kinds[np.abs(across) < half_px] = "road"
    return surfaces(kinds)


def site_of(found, pixels=FLAT, **facts):
    site = Site(pixels, (), frozenset(), 80.0, **facts)
    site.__dict__["surfaces"] = found  # instead of what the model finds
    return site


def drawn(recipe, found, pixels=FLAT, scenes=8, **facts):
    sampler = sampler_of(recipe)
    return [sampler.sample(key(n, 90.0), site_of(found, pixels, **facts)).spec for n in range(scenes)]


def places_px(scenes):
    """Return the (n, 2) positions in the picture of the origins of all objects."""
    found = [s.camera.project(np.array([o.position_m]))[0][0] for s in scenes for o in s.objects]
    return np.array(found).reshape(-1, 2)


@pytest.mark.parametrize(("recipe", "left", "right"), [
    ("hit-uav-car", "road", "grass"), ("monet-deer-physical", "grass", "road"), ("hit-uav-person", "path", "water"),
    ("hit-uav-car", "road", "tree"), ("hit-uav-person", "grass", "structure"), ("hit-uav-car", "road", "margin"),
])  # fmt: skip
def test_objects_stand_on_their_surfaces_alone(recipe, left, right):
    fields = [*BY_HAND, "camera.altitude={fixed_m: 80}", "camera.focal_length_mm=115", "placement.size_px=[1, 500]"]
    scenes = drawn(load_recipe(recipe, fields), halves(left, right))
    xy = places_px(scenes)
    assert len(xy) >= 40 and xy[:, 0].max() < 320
    assert xy[:, 0].min() < 100 and np.ptp(xy[:, 1]) > 350  # anywhere on it


def test_the_whole_footprint_of_a_car_is_on_the_road():
    recipe = load_recipe("hit-uav-car", [*BY_HAND, "objects.0.align={share: 0}"])
    road, outside = strip(25, half_px=45), []
    for scene in drawn(recipe, road, scenes=12):
        for o in scene.objects:
            corners = np.array([(x, y, 0.0) for x in (-2.2, 2.2) for y in (-0.85, 0.85)])
            xy, _ = scene.camera.project(object_to_world(corners, o.position_m, o.yaw_rad))
            inside = (xy >= 0).all(axis=1) & (xy < WH).all(axis=1)
            cells = (xy[inside] / 4).astype(int)
            outside.append(float((road.kinds()[::4, ::4][cells[:, 1], cells[:, 0]] != SURFACES.index("road")).mean()))
    # Of four corners at most one, cut by the edge of a cell.
    assert len(outside) > 25 and np.mean(outside) < 0.09 and max(outside) <= 0.25


@pytest.mark.parametrize("yaw", [0, 35, 110])
def test_cars_stand_along_the_road_that_they_are_on(yaw):
    recipe = load_recipe("hit-uav-car", [*BY_HAND, "objects.0.align={share: 1, along: road, spread_deg: 2}"])
    scenes = drawn(recipe, strip(yaw), lined(yaw))
    off = np.concatenate([off_deg(s, yaw, 180) for s in scenes if s.objects])
    assert len(off) > 30 and np.quantile(off, 0.95) < 9


def test_roads_of_two_directions_in_one_picture_have_cars_of_two_directions():
    pixels = np.full((512, 640), 100, np.uint8)
    kinds = np.full((128, 160), "grass", dtype="U10")
    kinds[90:120, :] = "road"
    kinds[:80, 20:50] = "road"
    pixels[360:480, :] = 160
    pixels[:320, 80:200] = 160
    recipe = load_recipe("hit-uav-car", [*BY_HAND, "objects.0.align={share: 1, along: road, spread_deg: 1}"])
    scenes = drawn(recipe, surfaces(kinds), pixels, scenes=10)
    for scene in scenes:
        for o in scene.objects:
            ((_, v),) = scene.camera.project(np.array([o.position_m]))[0]
            expected = 0.0 if v > 350 else 90.0
            off = abs((math.degrees(o.yaw_rad) - expected + 90) % 180 - 90)
            assert off < 10, (v, o.yaw_rad)
    assert sum(len(s.objects) for s in scenes) > 25


def test_affinities_are_densities():
    fields = [*BY_HAND, "placement.where.surfaces={road: 1, grass: 0.25}", "objects.0.count=4"]
    xy = places_px(drawn(load_recipe("hit-uav-car", fields), halves("road", "grass"), scenes=60))
    share = (xy[:, 0] > 320).mean()
    # A fifth of them; 5 standard deviations of so many draws.
    assert len(xy) > 180 and abs(share - 0.2) < 5 * math.sqrt(0.16 / len(xy))


def test_unsure_surfaces_hold_no_objects():
    shares = np.zeros((len(SURFACES), 128, 160), np.uint8)
    shares[SURFACES.index("road")], shares[SURFACES.index("tree")] = 110, 145
    shares[SURFACES.index("road"), :, :80], shares[SURFACES.index("tree"), :, :80] = 145, 110
    xy = places_px(drawn(load_recipe("hit-uav-car", BY_HAND), SurfaceMap(shares, WH)))
    assert len(xy) > 30 and xy[:, 0].max() < 320


def test_a_picture_without_such_ground_has_no_object_and_says_so():
    scenes = drawn(load_recipe("hit-uav-car", BY_HAND), halves("tree", "water"), scenes=2)
    assert not any(s.objects for s in scenes)
    assert [s.draws["absent"] for s in scenes] == [{"no_ground": 6}] * 2
    anywhere = load_recipe("hit-uav-car", [*BY_HAND, "placement.where=anywhere"])
    assert all(s.objects for s in drawn(anywhere, halves("tree", "water"), scenes=2))


@pytest.mark.parametrize("where", ["placement.where=anywhere", "placement.where.surfaces={grass: 1}"])
def test_people_in_water_are_in_water_whatever_the_recipe_says_of_others(where):
    options = "objects.0.options={pose: {standing: 1, lying: 1}, water: waist}"
    recipe = load_recipe("hit-uav-person", [*BY_HAND, where, options, "camera.altitude={fixed_m: 80}"])
    found = drawn(recipe, halves("grass", "water"), scenes=12)
    in_water = {o.position_m[:2]: "water" in o.params for s in found for o in s.objects}
    xy = places_px(found)
    wet = np.array(list(in_water.values()))
    assert wet.sum() > 10 and (~wet).sum() > 10
    assert xy[wet, 0].min() > 320
    if "grass" in where:
        assert xy[~wet, 0].max() < 320
    # Without water, those are left out, and counted.
    dry = drawn(recipe, halves("grass", "grass"), scenes=12)
    assert not any("water" in o.params for s in dry for o in s.objects)
    assert sum(s.draws["absent"].get("no_ground", 0) for s in dry) > 10


def test_nobody_stands_dry_beside_people_in_water():
    """With `anywhere`, nothing but the group would lead the others into the water."""
    water = np.full((128, 160), "grass", dtype="U10")
    water[44:84, 60:100] = "water"  # 160 px, 8 % of the picture
    group = "objects.0.group={share: 1, apart_m: [0.6, 2], max_overlap: 0.5}"
    options = "objects.0.options={pose: standing, water: {waist: 1, none: 1}}"
    settings = [*BY_HAND, "placement.where=anywhere", group, options, "camera.altitude={fixed_m: 80}"]
    found = drawn(load_recipe("hit-uav-person", settings), surfaces(water), scenes=20)
    wet = np.array(["water" in o.params for s in found for o in s.objects])
    xy = places_px(found)
    inside = (np.abs(xy - (320, 256)) < 80).all(axis=1)
    assert wet.sum() > 20 and inside[wet].all()
    assert inside[~wet].mean() < 0.16


def test_people_in_water_have_no_ground_in_the_placement_of_the_paper():
    options = ["objects.0.model=person", "objects.0.options={pose: standing, water: knees}", "objects.0.count=2"]
    (scene,) = drawn(load_recipe("hit-uav-drone", options), halves("water", "water"), scenes=1)
    assert not scene.objects
    assert scene.draws["absent"] == {"no_ground": 2} and scene.left_out == {0: "no_ground", 1: "no_ground"}


def test_neighbours_stand_on_suitable_ground_as_well():
    group = "objects.0.group={share: 1, apart_m: [2.5, 6], in_row: true, max_overlap: 0.4}"
    xy = places_px(drawn(load_recipe("hit-uav-car", [*BY_HAND, group]), halves("grass", "road")))
    assert len(xy) > 30 and xy[:, 0].min() > 320


def test_drones_fly_over_anything():
    recipe = load_recipe("hit-uav-drone-physical", ["camera.altitude={fixed_m: 80}"])
    scenes = drawn(recipe, halves("tree", "water"), scenes=6)
    assert sum(len(s.objects) for s in scenes) >= 5


def test_a_mask_restricts_places():
    allowed = np.zeros((512, 640), np.bool_)
    allowed[:256] = True
    recipe = load_recipe("hit-uav-car", BY_HAND)
    xy = places_px(drawn(recipe, halves("road", "tree"), allowed=allowed))
    assert len(xy) > 30 and xy[:, 0].max() < 320 and xy[:, 1].max() < 256


@pytest.mark.parametrize("value", ["{surfaces: {lava: 1}}", "{surfaces: {road: 2}}", "nowhere", "{learned: maybe}"])
def test_what_no_placement_is_refused(value):
    with pytest.raises(RecipeError, match=r"placement\.where"):
        load_recipe("hit-uav-car", [f"placement.where={value}"])


# ---- The dataset's own labels


def test_labels_change_the_affinity_of_their_class_alone():
    ground = {"Car": {ANY_TIME: ClassGround(99, {}, {}, {"road": 2.0, "path": 0.5}),
                      "night": ClassGround(50, {}, {}, {"road": 0.5, "path": 1.0})}}  # fmt: skip
    own = {"road": 1.0, "path": 0.4, "grass": 0.1}
    assert with_labels(own, ground, "Car", "day") == pytest.approx({"road": 1.0, "path": 0.1, "grass": 0.05})
    assert with_labels(own, ground, "Car", "night") == pytest.approx({"road": 1.0, "path": 0.8, "grass": 0.2})
    assert with_labels(own, ground, "car", None) == own and with_labels(own, {}, "Car", None) == own


def labelled(count, x):
    boxes = [np.array([x, 40.0 + 12 * k, x + 30, 48.0 + 12 * k]) for k in range(count)]
    return [Instance("Car", box) for box in boxes]


def test_what_is_around_labels_is_learned_from_outside_their_boxes(monkeypatch):
    monkeypatch.setattr(labelled_ground, "find_surfaces", lambda pixels: halves("path", "grass"))
    pictures = [(FLAT, labelled(35, 100), "day"), (FLAT, [], "night")]
    found = learn_ground(pictures)["Car"]
    assert set(found) == {ANY_TIME, "day"} and found["day"].objects == 35
    assert found["day"].around["path"] == 1 and found["day"].around["grass"] == 0
    assert found["day"].anywhere["path"] == pytest.approx(0.5, abs=0.1)
    # 35 objects and a prior of 20 as anywhere.
    assert found["day"].factors["path"] == pytest.approx((35 + 20 * 0.45) / (55 * 0.45), abs=0.1)
    assert found["day"].factors["grass"] == pytest.approx(20 / 55, abs=0.05)


def test_few_labels_teach_nothing(monkeypatch):
    monkeypatch.setattr(labelled_ground, "find_surfaces", lambda pixels: halves("path", "grass"))
    assert learn_ground([(FLAT, labelled(29, 100), None)]) == {}
    assert learn_ground([(FLAT, labelled(35, 100), None)], {"Person"}) == {}
    covered = [Instance("Car", np.array([0.0, 0, 640, 512]))] * 40
    assert learn_ground([(FLAT, covered, None)]) == {}


def test_the_surface_around_a_box_is_that_of_its_side_without_what_other_boxes_cover(monkeypatch):
    monkeypatch.setattr("infrablend.sampling.labelled_ground.find_surfaces", lambda _: halves("grass", "path"))
    pixels = np.zeros((512, 640), np.uint8)
    boxes = np.array([[100, 200, 120, 240], [500, 200, 520, 240], [290, 200, 350, 240], [311, 180, 400, 300]], float)
    assert kinds_around(pixels, boxes) == ["grass", "path", "grass", "path"]
    assert kinds_around(pixels, np.array([[0.0, 0, 640, 512]])) == [None]
