"""Camera quad, hexacopter, racer, fixed wing and the mixed model: sound meshes, honoured options, named errors."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from infrablend.assets import camera_quad, drones, fixed_wing, hexacopter, racer
from infrablend.assets.params import Choice, Number
from infrablend.assets.rotors import DISC_RINGS, OUTSIDE_ORIGIN_BOX
from infrablend.core.rng import stream
from infrablend.errors import ModelError
from tests.meshes import areas, vertices_of

SHAPES = (camera_quad, hexacopter, racer, fixed_wing)
NAMES = [module.MODEL.name for module in SHAPES]
each_shape = pytest.mark.parametrize("module", SHAPES, ids=NAMES)


def drawn(module: ModuleType, k: int, **options: object) -> dict[str, object]:
    return module.MODEL.sample(stream(7, module.MODEL.name, k), options)  # type: ignore[no-any-return]


@each_shape
@pytest.mark.parametrize("k", range(12))
def test_drawn_mesh_is_sound_and_centred(module: ModuleType, k: int) -> None:
    params = drawn(module, k)
    mesh, size = module.MODEL.build(params), float(params["size_m"])  # type: ignore[arg-type]
    assert 2_000 <= len(mesh.triangles) <= 14_000
    assert set(mesh.part_names) <= set(module.MODEL.roles(params)) <= set(module.PARTS)
    assert (np.bincount(mesh.part_of_triangle, minlength=len(mesh.part_names)) > 0).all()
    assert areas(mesh).min() > 1e-8 * size**2
    box = vertices_of(mesh, *(set(mesh.part_names) - OUTSIDE_ORIGIN_BOX))
    assert box.min(axis=0) + box.max(axis=0) == pytest.approx([0, 0, 0], abs=1e-9)
    assert (mesh.size_m < 2.0 * size).all()


def test_size_is_the_motor_diagonal_or_the_wingspan() -> None:
    every = (
        (hexacopter, 6, "layout", ("x", "plus")),
        (racer, 4, "layout", ("x", "stretched", "wide")),
        (camera_quad, 4, "form", ("round", "slim", "flat")),
    )
    for module, count, option, values in every:
        for value in values:
            params = drawn(module, 1, **{option: value}, size_m=0.5, lean_deg=0)
            if "arm_rise_deg" in params:
                params["arm_rise_deg"] = 0.0
            stators = np.split(vertices_of(module.MODEL.build(params), "winding"), count)
            xy = np.array([(s.min(axis=0) + s.max(axis=0))[:2] / 2 for s in stators])
            for a, b in zip(xy[: count // 2], xy[count // 2 :], strict=True):
                assert np.linalg.norm(a - b) == pytest.approx(0.5, rel=1e-6)
    for layout in ("tail", "boom", "flying-wing"):
        params = drawn(fixed_wing, 2, layout=layout, size_m=1.6, bank_deg=0, climb_deg=0)
        assert np.ptp(vertices_of(fixed_wing.MODEL.build(params), "wing")[:, 1]) == pytest.approx(1.6, rel=1e-6)


@pytest.mark.parametrize("module", SHAPES[:3], ids=NAMES[:3])
def test_propellers_clear_one_another(module: ModuleType) -> None:
    for k in range(30):
        rotors = module._rotors(drawn(module, k))
        gaps = np.linalg.norm(rotors.xy - np.roll(rotors.xy, -1, axis=0), axis=1)
        assert 0.1 < rotors.propeller.radius < gaps.min() / 2


def test_lean_lowers_the_nose_and_bank_lowers_the_right_wing() -> None:
    for module in SHAPES[:3]:
        level, leaning = (module.MODEL.build(drawn(module, 3, lean_deg=a)) for a in (0, 30))
        front = [vertices_of(m, "winding") for m in (level, leaning)]
        slope = [np.polyfit(v[:, 0], v[:, 2], 1)[0] for v in front]
        assert slope[1] < slope[0] - 0.3
    banked = fixed_wing.MODEL.build(drawn(fixed_wing, 3, bank_deg=30, climb_deg=0))
    wing = vertices_of(banked, "wing")
    assert wing[wing[:, 1].argmin(), 2] < wing[wing[:, 1].argmax(), 2]
    climbing = fixed_wing.MODEL.build(drawn(fixed_wing, 3, bank_deg=0, climb_deg=20, layout="tail"))
    assert vertices_of(climbing, "motor")[:, 2].mean() > vertices_of(climbing, "tail")[:, 2].mean()
    assert (
        vertices_of(climbing, "motor")[:, 0].mean() > vertices_of(climbing, "tail")[:, 0].mean() + 0.5
    )  # +X is the heading


@each_shape
def test_spinning_propellers_are_discs_that_labels_do_not_count(module: ModuleType) -> None:
    for k in range(4):
        params = drawn(module, k)
        still, spinning = (module.MODEL.build({**params, "propellers": state}) for state in ("still", "spinning"))
        roles = module.MODEL.roles({**params, "propellers": "spinning"})
        assert not set(module.MODEL.roles(params)) & set(DISC_RINGS)
        assert set(spinning.part_names) == set(still.part_names) | set(DISC_RINGS)
        assert np.array_equal(vertices_of(still, "motor"), vertices_of(spinning, "motor"))
        assert [roles[n].opacity for n in DISC_RINGS] == sorted((roles[n].opacity for n in DISC_RINGS), reverse=True)
        assert not any(roles[n].label or module.MODEL.parts[n].label for n in DISC_RINGS)
        # The discs cover the circle that the blades sweep.
        disc, blades = vertices_of(spinning, *DISC_RINGS), vertices_of(still, "propeller")
        tolerance = 0.05 * float(params["size_m"])  # type: ignore[arg-type]
        assert (disc.max(axis=0) > blades.max(axis=0) - tolerance).all()
        assert (disc.min(axis=0) < blades.min(axis=0) + tolerance).all()


@each_shape
def test_draws_are_in_range_varied_and_fixed_by_options(module: ModuleType) -> None:
    draws = [drawn(module, k) for k in range(300)]
    for name, dial in module.DIALS.table.items():
        values: list[Any] = [d[name] for d in draws]
        if isinstance(dial, Number):
            assert dial.drawn[0] <= min(values) and max(values) <= dial.drawn[1]
            assert np.ptp(values) > 0.9 * (dial.drawn[1] - dial.drawn[0])
        else:
            assert isinstance(dial, Choice)
            assert set(values) == {v for v, odds in zip(dial.values, dial.odds, strict=True) if odds}
    free, fixed = drawn(module, 9), drawn(module, 9, size_m=[0.3, 0.31], blades=3)
    assert 0.3 <= fixed["size_m"] <= 0.31  # type: ignore[operator]
    assert {**free, "size_m": fixed["size_m"], "blades": 3} == fixed
    assert set(module.MODEL.options) == set(free)


@each_shape
def test_bad_options_and_parameters_are_named(module: ModuleType) -> None:
    name = module.MODEL.name
    with pytest.raises(ModelError, match=rf"{name} model, option size: found 1; expected options size_m"):
        drawn(module, 0, size=1)
    with pytest.raises(ModelError, match=r"option size_m: found -1; expected a number from"):
        drawn(module, 0, size_m=-1)
    with pytest.raises(ModelError, match=r"option blades: found 'many'; expected one of 2, 3"):
        drawn(module, 0, blades="many")
    params = drawn(module, 0)
    with pytest.raises(ModelError, match="parameter blades: found 4; expected one of 2, 3"):
        module.MODEL.build({**params, "blades": 4})
    with pytest.raises(ModelError, match="parameter size_m: is missing"):
        module.MODEL.build({k: v for k, v in params.items() if k != "size_m"})


@each_shape
def test_parts_have_sane_thermal_roles(module: ModuleType) -> None:
    for role in module.PARTS.values():
        assert -3 <= role.delta_t_k[0] <= role.delta_t_k[1] <= 75
        assert 0.8 <= role.emissivity[0] <= role.emissivity[1] <= 1
        assert role.what
    means = {n: sum(r.delta_t_k) / 2 for n, r in module.PARTS.items()}
    assert min(means["motor"], means["winding"]) > max(means["propeller"], means["antenna"], means["lens"])


def test_mixed_model_draws_every_shape_as_its_own_model_does() -> None:
    draws = [drones.MODEL.sample(stream(k, "mixed"), {}) for k in range(300)]
    shares = {name: np.mean([d["shape"] == name for d in draws]) for name in drones.SHAPES}
    for name, shape in drones.SHAPES.items():
        assert shares[name] == pytest.approx(shape.odds, abs=0.08)
        params = next(d for d in draws if d["shape"] == name)
        own = {k: v for k, v in params.items() if k != "shape"}
        tilted = name in ("folding-quad", "quad", "large-quad")
        if tilted:
            own = {k: v for k, v in own.items() if k not in drones.TILT_DEG}
        level = drones.MODEL.build({**params, "lean_deg": 0.0, "bank_deg": 0.0} if tilted else params)
        assert level.vertices_m.tobytes() == shape.model.build(own).vertices_m.tobytes()
        assert drones.MODEL.roles(params) == shape.model.roles(own)
        assert set(drones.MODEL.roles(params)) <= set(drones.MODEL.parts)
    assert sum(s.odds for s in drones.SHAPES.values()) == pytest.approx(1)
    sizes = {n: [d["size_m"] for d in draws if d["shape"] == n] for n in drones.SHAPES}
    assert max(sizes["folding-quad"]) <= 0.42 <= min(sizes["quad"]) and min(sizes["large-quad"]) >= 0.85


def test_mixed_model_tilts_the_level_quadrotors() -> None:
    params = drones.MODEL.sample(stream(1, "tilt"), {"shape": "folding-quad"})
    assert -4 <= params["lean_deg"] <= 18 and -10 <= params["bank_deg"] <= 10
    level, leaning, banked = (
        vertices_of(drones.MODEL.build({**params, "lean_deg": lean, "bank_deg": bank}), "winding")
        for lean, bank in ((0.0, 0.0), (20.0, 0.0), (0.0, 20.0))
    )
    assert np.ptp(level[:, 2]) < 0.02 < np.ptp(leaning[:, 2])
    assert leaning[leaning[:, 0].argmax(), 2] < leaning[leaning[:, 0].argmin(), 2]  # nose down
    assert banked[banked[:, 1].argmin(), 2] < banked[banked[:, 1].argmax(), 2]  # right side down
    with pytest.raises(
        ModelError, match="drones model, parameter lean_deg: found 60; expected a number from -45 to 45"
    ):
        drones.MODEL.build({**params, "lean_deg": 60})
    with pytest.raises(ModelError, match="parameter bank_deg: is missing"):
        drones.MODEL.build({k: v for k, v in params.items() if k != "bank_deg"})


def test_mixed_model_takes_a_shape_a_size_and_the_state_of_the_propellers() -> None:
    rng = stream(0, "options")
    assert {drones.MODEL.sample(rng, {"shape": "racer"})["shape"] for _ in range(10)} == {"racer"}
    found = [drones.MODEL.sample(rng, {"shape": ["quad", "fixed-wing"], "propellers": "spinning"}) for _ in range(30)]
    assert {d["shape"] for d in found} == {"quad", "fixed-wing"}
    assert {d["propellers"] for d in found} == {"spinning"}
    assert drones.MODEL.sample(rng, {"shape": "quad", "size_m": 0.5})["size_m"] == 0.5
    with pytest.raises(ModelError, match="drones model, option shape: found 'kite'; expected one of folding-quad"):
        drones.MODEL.sample(rng, {"shape": "kite"})
    with pytest.raises(ModelError, match="option layout: found 'x'; expected options shape, size_m, propellers"):
        drones.MODEL.sample(rng, {"layout": "x"})
    with pytest.raises(ModelError, match="parameter shape: is missing"):
        drones.MODEL.build({})
