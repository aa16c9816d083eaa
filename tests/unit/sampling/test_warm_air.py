"""Bodies in warm air: skin has a limit, clothes and coats follow it; cool or unknown air changes nothing."""

from __future__ import annotations

import pytest

from infrablend.core.render import PlacedObject
from infrablend.sampling.scene_sampler import COOL_AIR_K, in_warm_air
from infrablend.thermal.radiometry import ZERO_C_K
from tests.unit.sampling.test_daytime import scene

SKIN = ("face", "nose", "ear", "neck", "hand")


def objects(model: str, time: str, air: str, *settings: str) -> list[PlacedObject]:
    fields = (f"environment.air_temperature_c={air}", *settings)
    return [o for seed in range(6) for o in scene(model, time, *fields, seed=seed).objects]


def hottest_c(model: str, time: str, air: str, parts: tuple[str, ...], *settings: str) -> float:
    """Return the temperature of the hottest of some parts, where the sun shines on it, too."""
    found = []
    for o in objects(model, time, air, *settings):
        rise_k = o.sun_rise_k.reshape(-1, 3).max(axis=1)
        for n, name in enumerate(o.mesh.part_names):
            if name in parts:
                lit = rise_k[o.mesh.part_of_triangle == n].max(initial=0.0)
                found.append(o.spec.parts[name].temperature_k + lit - ZERO_C_K)
    return max(found)


@pytest.mark.parametrize("time", ["night", "day", "dusk"])
@pytest.mark.parametrize("air", ["13", "25", "[24, 27]", "34", "42"])
def test_skin_is_never_warmer_than_36_degrees(time: str, air: str) -> None:
    for clothing in ("winter", "light"):
        options = f"objects.0.options={{clothing: {clothing}}}"
        assert hottest_c("person", time, air, SKIN, options) <= 36.0 + 1e-6
    assert hottest_c("deer", time, air, ("nose",)) <= 38.0 + 1e-6


def test_drawn_air_is_no_excuse_where_levels_are_temperatures() -> None:
    assert hottest_c("person", "day", "[14, 26]", SKIN) > 36.5
    assert hottest_c("person", "day", "[14, 26]", SKIN, "matching.mode=radiometric") <= 36.0 + 1e-6


def test_clothes_and_coats_in_the_shade_stay_below_the_skin() -> None:
    parts = ("jacket", "trousers", "hat", "leg", "hair")
    assert hottest_c("person", "night", "25", parts, "objects.0.options={clothing: light}") < 34
    assert hottest_c("deer", "night", "25", ("belly", "ear", "back")) < 32


def test_cool_air_and_air_of_a_season_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def states() -> list[object]:
        return [
            [o.spec.parts for o in objects("person", time, air)]
            for time in ("night", "day")
            for air in ("11", "[5, 25]")
        ]

    as_it_is = states()
    monkeypatch.setattr("infrablend.sampling.scene_sampler.in_warm_air", None)
    assert states() == as_it_is


def test_what_a_recipe_states_stays() -> None:
    stated = "objects.0.parts={face: {delta_t_k: [30, 30]}}"
    for o in objects("person", "night", "25", stated):
        assert o.spec.parts["face"].temperature_k == pytest.approx(ZERO_C_K + 55)


def test_the_excess_shrinks_evenly_and_cold_parts_stay_cold() -> None:
    limit = ZERO_C_K + 36
    assert in_warm_air((-2.0, 24.0), COOL_AIR_K, limit) == (-2.0, 24.0)
    assert in_warm_air((-2.0, 24.0), COOL_AIR_K + 12, limit) == pytest.approx((-2.0, 12.0))
    assert in_warm_air((-2.0, 24.0), ZERO_C_K + 40, limit) == (-2.0, 0.0)
