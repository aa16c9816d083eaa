"""The materials table: values that parts take from it, and invalid ones."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from infrablend.assets import deer, person
from infrablend.assets.catalogue import list_models, load_model
from infrablend.assets.model import MATERIALS, PartRange, part_role
from infrablend.assets.user_model import GroupFacts, assign_parts, read_description
from infrablend.config.loading import load_recipe
from infrablend.core.capture import Capture
from infrablend.core.rng import stream
from infrablend.core.scene import PartState, SceneSpec
from infrablend.errors import ModelError, RecipeError
from infrablend.sampling.scene_sampler import sample_scene
from infrablend.sampling.site import FrameKey
from tests.thermal_reference import fresnel_emissivity


def test_the_table_is_physical() -> None:
    for name, m in MATERIALS.items():
        assert re.fullmatch("[a-z_]+", name)
        assert 0 < m.emissivity[0] <= m.emissivity[1] < 1, name
        assert 1 <= m.ior <= 3 and 0 <= m.roughness <= 1 and m.source, name
        # Metals and rough surfaces have no dielectric rim, and only metals shine little.
        assert not (m.metal and m.ior != 1), name
        assert m.metal or m.emissivity[0] >= 0.8, name
    wanted = (
        "plastic painted car_paint glass bare_aluminium black_anodised grey_anodised galvanised_steel cfrp fur hair"
    )
    assert {*wanted.split(), "skin", "cloth", "rubber", "antler", "wood", "asphalt"} <= set(MATERIALS)


def test_the_manual_shows_the_table() -> None:
    page = (Path(__file__).parents[3] / "docs/how_to/infrared_effect.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    expected = [
        f"| `{name}` | {m.emissivity[0]:g} to {m.emissivity[1]:g} | {'metal' if m.metal else f'{m.ior:g}'} | "
        f"{m.roughness if m.metal or m.ior > 1 else ''} | {m.source} |".replace("|  |", "| |")
        for name, m in MATERIALS.items()
    ]
    assert rows == expected


@pytest.mark.parametrize(("name", "n", "k"), [("glass", 1.7, 0.8), ("cfrp", 2.0, 0.6), ("plastic", 1.5, 0.02)])
def test_smooth_materials_follow_their_complex_index(name: str, n: float, k: float) -> None:
    """The shader knows emissivity straight on and a real index; the true surface absorbs."""
    m = MATERIALS[name]
    angles = np.radians([0, 40, 60, 70, 75])
    straight_on = float(fresnel_emissivity(n, k, 0.0))
    assert m.emissivity[0] - 0.005 <= straight_on <= m.emissivity[1] + 0.011
    shader = straight_on * fresnel_emissivity(m.ior, 0.0, angles) / fresnel_emissivity(m.ior, 0.0, 0.0)
    assert np.abs(shader - fresnel_emissivity(n, k, angles)).max() < 0.03


def test_parts_take_what_they_are_not_given() -> None:
    bare = part_role("bare_aluminium", (0.0, 5.0), "mast")
    m = MATERIALS["bare_aluminium"]
    assert (bare.emissivity, bare.ior, bare.roughness, bare.metal) == (m.emissivity, 1.0, m.roughness, True)
    assert bare.kind == "bare_aluminium" and bare.what == "mast" and bare.label and bare.opacity == 1
    own = part_role("glass", (0.0, 5.0), emissivity=(0.9, 0.91), ior=1.5, label=False, opacity=0.4)
    assert (own.emissivity, own.ior, own.label, own.opacity) == ((0.9, 0.91), 1.5, False, 0.4)
    with pytest.raises(KeyError):
        part_role("unobtainium", (0.0, 1.0))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"delta_t_k": (5.0, 4.0)}, "low end must not be above"),
        ({"emissivity": (0.5, 1.1)}, "0 <= low <= high <= 1"),
        ({"emissivity": (0.9, 0.8)}, "0 <= low <= high <= 1"),
        ({"emissivity": (-0.1, 0.8)}, "0 <= low <= high <= 1"),
        ({"opacity": 0.0, "label": False}, "opacity"),
        ({"opacity": 0.5}, "below 1 with label False"),
        ({"delta_t_k": (float("nan"), 1.0)}, "delta_t_k"),
    ],
)
def test_invalid_roles_are_refused(change: dict[str, object], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        dataclasses.replace(PartRange((0.0, 1.0), (0.9, 0.95)), **change)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"temperature_k": 0.0}, "above 0 K"),
        ({"temperature_k": -3.0}, "above 0 K"),
        ({"temperature_k": float("nan")}, "above 0 K"),
        ({"emissivity": 1.2}, "from 0 to 1"),
        ({"opacity": 1.5}, "opacity"),
        ({"opacity": 0.5}, "only without label"),
    ],
)
def test_invalid_states_are_refused(change: dict[str, object], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        dataclasses.replace(PartState(300.0, 0.9), **change)


def test_every_shipped_part_has_a_material() -> None:
    for name in list_models():
        model = load_model(name)
        for k in range(3):
            params = model.sample(stream(1, "kinds", k), {})
            for part, role in model.roles(params).items():
                assert role.kind in MATERIALS, f"{name}.{part}"
                assert role.label == model.parts[part].label
            assert set(model.build(params).part_names) <= set(model.roles(params))


def frame(time_of_day: str | None) -> FrameKey:
    return FrameKey("f", "train", 0, (640, 512), Capture(pitch_deg=60.0, time_of_day=time_of_day))  # type: ignore[arg-type]


def recipe(model: str, *overrides: str, look: str = "physical"):
    settings = [f"appearance.mode={look}", *overrides]
    return load_recipe("hit-uav-drone", [f"objects.0.model={model}", "placement.on_miss=keep", *settings])


@pytest.mark.parametrize("model", ["car", "person", "deer"])
def test_models_receive_the_time_of_day_of_their_frame(model: str) -> None:
    models = {model: load_model(model)}

    def spec(when: str | None, *overrides: str, look: str = "physical") -> SceneSpec:
        return sample_scene(frame(when), recipe(model, *overrides, look=look), models, 3).spec

    (night,), (day,), (unknown,) = (spec(w).objects for w in ("night", "day", None))
    if model == "car":
        assert night.params["state"] in ("parked_cold", "driven") and day.params["state"].startswith("day_")
    else:
        assert (night.params["time_of_day"], day.params["time_of_day"]) == ("night", "day")
        # The same individual: by day the sun warms it.
        assert {**night.params, "time_of_day": 0} == {**day.params, "time_of_day": 0}
        assert max(p.sun_k for p in day.parts.values()) > 10
        assert not any(p.sun_k for p in night.parts.values())
        if model == "deer":  # its coat keeps the excess of the night where the sun does not reach it
            assert all(day.parts[n].temperature_k == night.parts[n].temperature_k for n in night.parts)
        assert unknown == night
        (placed,) = sample_scene(frame("day"), recipe(model), models, 3).objects
        assert placed.sun_rise_k.max() >= {"person": 3, "deer": 5}[model]
    # A recipe's own word counts, and the artistic look stays as the paper tuned it.
    (fixed,) = spec("day", "objects.0.options={time_of_day: night}").objects
    assert fixed == night
    (tuned_day,), (tuned_night,) = (spec(w, look="artistic").objects for w in ("day", "night"))
    assert tuned_day == tuned_night
    with pytest.raises(ModelError, match="time_of_day"):
        models[model].sample(stream(0), {"time_of_day": "noon"})


def test_sunlit_clothes_and_coats() -> None:
    for model, low, high in ((person, *person.SUN_K), (deer, *deer.SUN_K)):
        day = model.parts_for({"time_of_day": "day"})
        for part, role in model.parts_for({}).items():
            a, b = (day[part].delta_t_k[i] - role.delta_t_k[i] for i in (0, 1))
            assert 0 <= a <= low + 1e-9 and a <= b <= high + 1e-9, part
    day = person.parts_for({"time_of_day": "day"})
    assert day["jacket"].delta_t_k == (2.0 + 3.0, 7.0 + 12.0)
    assert all(day[part].delta_t_k == person.PARTS[part].delta_t_k for part in ("face", "seat"))
    coat = deer.parts_for({"time_of_day": "day"})
    assert coat["back"].delta_t_k == (5.0 + 5.0, 8.0 + 20.0) and coat["eye"] == deer.PARTS["eye"]


def test_scenes_are_read_back_from_their_values() -> None:
    models = {"drone": load_model("drone")}
    spec = sample_scene(frame("night"), recipe("drone"), models, 0).spec
    assert SceneSpec.from_json(spec.to_json()) == spec


def test_a_recipes_spinning_propellers_reach_the_scene() -> None:
    spec = sample_scene(
        frame(None), recipe("drone", "objects.0.options={propellers: spinning}"), {"drone": load_model("drone")}, 0
    ).spec
    (drone,) = spec.objects
    discs = {n: p for n, p in drone.parts.items() if n.startswith("prop_disc")}
    assert len(discs) == 4 and all(p.opacity < 0.4 and not p.label for p in discs.values())
    assert drone.parts["propeller"].label and drone.parts["motor"].label


# ---- a user's model


def described(tmp_path, parts: str):
    (tmp_path / "fox.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    path = tmp_path / "fox.yaml"
    path.write_text(f"name: fox\ncategory: fox\nfile: fox.obj\nparts:\n  body: {{match: [Body], {parts}}}\n")
    return read_description(path)[0]


def test_a_users_part_may_name_its_material(tmp_path) -> None:
    _, roles = assign_parts(described(tmp_path, "delta_t_k: 3, kind: bare_aluminium"), [GroupFacts("Body", "")], "fox")
    assert roles["body"] == part_role("bare_aluminium", (3.0, 3.0), "from fox")
    _, roles = assign_parts(
        described(tmp_path, "delta_t_k: 3, kind: glass, emissivity: 0.9, ior: 1.5, label: false, opacity: 0.4"),
        [GroupFacts("Body", "")],
        "fox",
    )
    assert roles["body"] == part_role(
        "glass", (3.0, 3.0), "from fox", emissivity=(0.9, 0.9), ior=1.5, label=False, opacity=0.4
    )
    _, roles = assign_parts(described(tmp_path, "delta_t_k: 3, emissivity: 0.9"), [GroupFacts("Body", "")], "fox")
    assert roles["body"] == PartRange((3.0, 3.0), (0.9, 0.9), what="from fox", ior=1.5)


def test_a_material_made_by_hand_keeps_its_surface(tmp_path) -> None:
    facts = GroupFacts("Can", "Bare", 30.0, 0.1, 1.0, 0.2, 1.0)
    _, roles = assign_parts(described(tmp_path, "delta_t_k: 3, kind: fur"), [GroupFacts("Body", ""), facts], "fox")
    assert roles["Bare"].delta_t_k == (10.0, 10.0)
    assert (roles["Bare"].metal, roles["Bare"].roughness, roles["Bare"].ior) == (True, 0.2, 1.0)


@pytest.mark.parametrize(
    ("parts", "field", "expected"),
    [
        ("delta_t_k: 3, kind: fur_coat", "kind", "one of .*antler, asphalt.*wood"),
        ("delta_t_k: 3", "emissivity", "expected a value"),
        ("delta_t_k: 3, emissivity: 1.2", "emissivity", "less than or equal to 1"),
        ("delta_t_k: 3, emissivity: [-0.1, 0.5]", "emissivity", "greater than or equal to 0"),
        ("delta_t_k: 3, emissivity: [0.9, 0.8]", "emissivity", "low end is not above"),
        ("delta_t_k: [5, 4], kind: fur", "delta_t_k", "low end is not above"),
        ("delta_t_k: -290, kind: fur", "delta_t_k", "greater than or equal to -100"),
        ("delta_t_k: 4000, kind: fur", "delta_t_k", "less than or equal to 1000"),
        ("delta_t_k: .nan, kind: fur", "delta_t_k", "number"),
        ("delta_t_k: 3, kind: fur, opacity: 0", "opacity", "greater than 0"),
        ("delta_t_k: 3, kind: fur, opacity: 2, label: false", "opacity", "less than or equal to 1"),
        ("delta_t_k: 3, kind: fur, opacity: 0.5", "opacity", "label: false"),
    ],
)
def test_invalid_user_model_is_reported(tmp_path, parts: str, field: str, expected: str) -> None:
    with pytest.raises(ModelError, match=expected) as caught:
        described(tmp_path, parts)
    assert {p.where for p in caught.value.problems} <= {f"parts.body.{field}", f"parts.body.{field}.0"}


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("{delta_t_k: -280}", "greater than or equal to -100"),
        ("{delta_t_k: [0, 1e4]}", "less than or equal to 1000"),
        ("{delta_t_k: [5, 4]}", "low end is not above"),
        ("{emissivity: 1.01}", "less than or equal to 1"),
        ("{emissivity: [-0.2, 1]}", "greater than or equal to 0"),
        ("{emissivity: [0.9, 0.1]}", "low end is not above"),
    ],
)
def test_invalid_recipe_is_reported(override: str, expected: str) -> None:
    with pytest.raises(RecipeError, match=expected) as caught:
        load_recipe("hit-uav-drone", [f"objects.0.parts={{motor: {override}}}"])
    assert any("objects.0.parts.motor" in p.where for p in caught.value.problems)
