"""Scenes at dusk and dawn, and under closed clouds."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.config.recipe import SkyEnvironment
from infrablend.core.capture import Capture
from infrablend.core.render import PlacedScene
from infrablend.core.scene import SceneSpec
from infrablend.errors import RecipeError
from infrablend.sampling.scene_sampler import sample_scene
from infrablend.sampling.site import FrameKey, Site
from infrablend.sampling.weather import used_time
from tests.recipes import load_anywhere

SITE = Site(np.full((512, 640), 120, np.uint8), altitude_m=60.0)
MODELS = {n: load_model(n) for n in ("person", "car", "deer", "drones", "bird", "airplane", "helicopter")}
RECIPES = {"person": "hit-uav-person", "car": "hit-uav-car", "deer": "monet-deer-physical", "drones": "drone-sky"}
AIR = "environment.air_temperature_c=10"
KUNMING = {"latitude_deg": 25.0, "longitude_deg": 102.7}


def scene(model: str, time: Any, *overrides: str, seed: int = 3, **facts: Any) -> PlacedScene:
    capture = Capture(pitch_deg=60.0, time_of_day=time, **facts)
    recipe = load_anywhere(RECIPES[model], [AIR, *overrides])
    return sample_scene(FrameKey("f", "train", 0, (640, 512), capture), recipe, MODELS, seed, SITE)


def mean(model: str, time: str, part: str, *overrides: str, sun: bool = True) -> float:
    """Return the mean temperature of a part above the air, with its rise by the sun or without, kelvin."""
    found = []
    for seed in range(25):
        for placed in scene(model, time, *overrides, seed=seed).objects:
            if part in placed.spec.parts:
                rise = placed.part_sun_range_k.get(part, (0.0, 0.0))
                found.append(placed.spec.parts[part].temperature_k - 283.15 + sum(rise) / 2 * sun)
    return float(np.mean(found))


def test_ground_is_warmest_by_day_and_coldest_at_dawn() -> None:
    def ground(time: str, *overrides: str) -> float:
        weathers = [scene("person", time, *overrides, seed=k).spec.weather for k in range(30)]
        return float(np.mean([w.ground_k - w.air_k for w in weathers if w is not None]))

    by_time = [ground(t) for t in ("day", "dusk", "night", "dawn")]
    assert by_time == sorted(by_time, reverse=True) and by_time[0] > by_time[1] + 2
    for time in ("day", "dusk", "night"):
        clear, overcast = (ground(time, f"environment.overcast_share={share}") for share in (0, 1))
        assert abs(overcast) == pytest.approx(0.3 * abs(clear))


def test_parts_of_a_car_cool_from_day_to_dawn() -> None:
    state = ["objects.0.options={state: [parked_cold]}"]
    by_day = ["objects.0.options={state: [day_sun]}"]
    for part in ("tyre", "roof"):
        day = mean("car", "day", part, *by_day)
        dusk, night, dawn = (mean("car", t, part, *state, sun=False) for t in ("dusk", "night", "dawn"))
        assert day > dusk > night > dawn - 0.1 and (part == "roof" or night > dawn)
    assert mean("car", "dawn", "roof", *state) < mean("car", "night", "roof", *state) + 3  # in a weak sun


def test_a_driven_car_is_hot_at_any_time() -> None:
    for time in ("night", "dusk", "dawn"):
        assert mean("car", time, "tyre", "objects.0.options={state: [driven]}") > 6


@pytest.mark.parametrize("model", ["person", "deer"])
def test_a_low_sun_warms_one_side_weakly(model: str) -> None:
    rises = {}
    for time in ("day", "dusk", "dawn"):
        objects = [o for seed in range(12) for o in scene(model, time, seed=seed).objects]
        rises[time] = max(float(o.sun_rise_k.max()) for o in objects)
    assert 0 < rises["dusk"] < 0.7 * rises["day"] and rises["dawn"] < 0.7 * rises["day"]
    coldest = [s.spec.weather.sun for s in (scene(model, "dusk", seed=k) for k in range(20)) if s.spec.weather]
    assert {s is not None and s.elevation_rad < 0 for s in coldest} == {True, False}
    assert all(s is not None and -6 <= math.degrees(s.elevation_rad) <= 8 for s in coldest)


def test_dusk_is_between_night_and_day_where_the_sun_does_not_reach() -> None:
    for model in ("person", "deer"):
        (night, dusk, dawn, day) = (
            scene(model, t).objects[0].spec.parts for t in ("night", "dusk", "dawn", "day")
        )  # fmt: skip
        for part in night:
            ends = sorted((night[part].temperature_k, day[part].temperature_k))
            assert ends[0] - 1e-9 <= dusk[part].temperature_k <= ends[1] + 1e-9
            assert dawn[part].temperature_k == night[part].temperature_k


def test_under_closed_clouds_there_are_no_rays_and_no_shadows() -> None:
    by_day = ["objects.0.options={state: [day_sun]}", "environment.overcast_share=1"]
    for seed in range(4):
        found = scene("car", "day", *by_day, seed=seed)
        weather = found.spec.weather
        assert weather is not None and weather.overcast and weather.sun is not None
        assert weather.sun.direct_w_m2 == 0 < weather.sun.diffuse_w_m2
        assert found.objects and not any("ground_shadow" in o.spec.parts for o in found.objects)
        clear = scene("car", "day", by_day[0], "environment.clear_share=1", seed=seed)
        assert any("ground_shadow" in o.spec.parts for o in clear.objects)


def test_under_closed_clouds_nothing_is_much_colder_than_the_air() -> None:
    parked = "objects.0.options={state: [parked_cold]}"
    clear, overcast = (mean("car", "night", "roof", parked, f"environment.overcast_share={k}") for k in (0, 1))
    assert clear < -4 and -1.1 < overcast < -0.4
    # What a recipe states counts as it is.
    stated = "objects.0.parts.roof.delta_t_k=-6"
    assert mean("car", "night", "roof", parked, stated, "environment.overcast_share=1") == pytest.approx(-6)


def test_ground_under_a_body_is_as_warm_under_closed_clouds() -> None:
    lying = "objects.0.options={pose: lying, warm_ground: 1}"
    clear, overcast = (mean("deer", "night", "bed", lying, f"environment.overcast_share={k}") for k in (0, 1))
    assert clear == overcast > 1
    sheltered = "objects.0.options={state: [parked_cold], sheltered: true}"
    clear, overcast = (
        mean("car", "night", "ground_near", sheltered, f"environment.overcast_share={k}") for k in (0, 1)
    )
    assert 0 < overcast < 0.2 * clear


def test_tyres_are_hardly_warm_at_dusk_if_the_day_was_overcast() -> None:
    parked = "objects.0.options={state: [parked_cold]}"
    clear, overcast = (
        mean("car", "dusk", "tyre", parked, f"environment.overcast_share={k}", sun=False) for k in (0, 1)
    )
    assert clear > overcast + 2 > 2


def test_people_keep_their_heat_under_closed_clouds() -> None:
    """By day in the shade of a clear sky, clothes keep half of it at most."""
    night, overcast, clear = (
        mean("person", t, "jacket", f"environment.overcast_share={k}", "environment.clear_share=1", sun=False)
        for t, k in (("night", 0), ("day", 1), ("day", 0))
    )
    assert overcast == pytest.approx(night) and clear < 0.5 * night


def test_drones_keep_their_own_heat() -> None:
    night, dusk = (scene("drones", t).spec.objects for t in ("night", "dusk"))
    assert [o.parts for o in night] == [o.parts for o in dusk]


def test_a_car_at_dusk_throws_a_faint_shadow_while_the_sun_is_up() -> None:
    shadows = set()
    for seed, time in itertools.product(range(12), ("dusk", "dawn")):
        found = scene("car", time, "objects.0.options={state: [parked_cold]}", seed=seed)
        assert found.spec.weather is not None and found.spec.weather.sun is not None
        up = found.spec.weather.sun.direct_w_m2 > 0
        for o in found.spec.objects:
            if "ground_shadow" in o.parts:
                assert up and found.spec.ambient_k - o.parts["ground_shadow"].temperature_k < 2
                shadows.add(o.params["time_of_day"])
        again = SceneSpec.from_json(found.spec.to_json())
        assert again == found.spec
    assert shadows == {"dusk"}


def environment(**changes: Any) -> SkyEnvironment:
    sky = load_anywhere("hit-uav-person", []).environment.sky
    assert sky is not None
    return sky.model_validate({**sky.model_dump(), **changes})


@pytest.mark.parametrize(
    ("stated", "captured", "own", "expected", "source"),
    [
        (None, None, "night", "night", None),
        (None, "2021-01-16", "day", "day", None),  # a date alone
        (None, "2021-01-16T18:20:00", "day", "day", None),  # no time zone
        (None, "2021-01-16T18:20:00+08:00", "day", "dusk", "sun"),
        (None, "2021-01-16T18:20:00+08:00", "night", "dusk", "sun"),
        (None, "2021-01-16T08:20:00+08:00", None, "dawn", "sun"),
        (None, "2021-01-16T13:00:00+08:00", None, "day", "sun"),
        (None, "2021-01-16T13:00:00+08:00", "night", "night", None),  # contradicted: see the run's warnings
        (None, "2021-01-16T01:00:00+08:00", "day", "day", None),
        ("dusk", "2021-01-16T13:00:00+08:00", "day", "dusk", "recipe"),
        ("dusk", None, None, "dusk", "recipe"),
    ],
)
def test_where_the_time_of_day_comes_from(
    stated: Any, captured: str | None, own: Any, expected: str, source: str | None
) -> None:
    found = used_time(Capture(time_of_day=own, captured=captured), environment(place=KUNMING, time_of_day=stated))
    assert (found.time_of_day, found.time_from) == (expected, source)


def test_the_elevation_of_a_low_sun_is_that_of_the_capture() -> None:
    place = f"environment.place={{latitude_deg: {KUNMING['latitude_deg']}, longitude_deg: {KUNMING['longitude_deg']}}}"
    when = "2021-01-16T18:20:00+08:00"
    for time, source in (("dusk", "computed"), ("dawn", "computed"), ("day", "computed")):
        weather = scene("person", time, place, captured=when).spec.weather
        assert weather is not None and weather.sun is not None
        assert weather.sun.source == source and math.degrees(weather.sun.elevation_rad) == pytest.approx(4, abs=1.5)
    # A stated dusk at noon is no contradiction: the recipe asks for another sun.
    capture = Capture(60.0, time_of_day="dusk", captured="2021-01-16T13:00:00+08:00", time_from="recipe")
    recipe = load_anywhere("hit-uav-person", [place])
    weather = sample_scene(FrameKey("f", "train", 0, (640, 512), capture), recipe, MODELS, 3, SITE).spec.weather
    assert weather is not None and weather.sun is not None and weather.sun.source == "drawn"
    assert weather.sun.elevation_rad <= math.radians(8)


def test_bad_places_and_times_are_refused() -> None:
    for override in (
        "environment.place={latitude_deg: 91, longitude_deg: 0}",
        "environment.place={latitude_deg: 0, longitude_deg: 181}",
        "environment.time_of_day=evening",
        "environment.overcast_share=1.5",
    ):
        with pytest.raises(RecipeError, match="environment"):
            load_anywhere("hit-uav-person", [override])


def test_frames_by_day_and_night_ignore_what_is_new() -> None:
    """Without `overcast_share`, the draws of clouds are those of earlier versions: never a closed cover."""
    covers = [
        scene("person", t, "environment.clear_share=0", seed=k).spec.weather for t in ("day", "night") for k in range(9)
    ]
    assert all(w is not None and 0 < w.cloud < 1 for w in covers)
    assert replace(Capture(), time_from="sun") != Capture() and "time_from" not in repr(Capture())
