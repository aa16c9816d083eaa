"""Bird, airplane and helicopter: sizes by kind, wings that flap, attitudes, hot engines, rotors that labels ignore."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from infrablend.assets import airplane, bird, helicopter
from infrablend.assets.rotors import DISC_RINGS, OUTSIDE_ORIGIN_BOX
from infrablend.core.rng import stream
from infrablend.errors import ModelError
from tests.meshes import areas, vertices_of

FLYERS = (airplane, bird, helicopter)
each = pytest.mark.parametrize("module", FLYERS, ids=[m.MODEL.name for m in FLYERS])


def drawn(module: ModuleType, k: int, **options: object) -> dict[str, Any]:
    return module.MODEL.sample(stream(7, module.MODEL.name, k), options)  # type: ignore[no-any-return]


@each
def test_drawn_mesh_is_sound_centred_and_of_its_size(module: ModuleType) -> None:
    for k in range(24):
        params = drawn(module, k)
        mesh, size = module.MODEL.build(params), params["size_m"]
        assert 1_000 <= len(mesh.triangles) <= 9_000
        assert set(mesh.part_names) <= set(module.MODEL.roles(params)) <= set(module.PARTS)
        assert areas(mesh).min() > 1e-9 * size**2
        box = vertices_of(mesh, *(set(mesh.part_names) - OUTSIDE_ORIGIN_BOX - set(DISC_RINGS)))
        assert box.min(axis=0) + box.max(axis=0) == pytest.approx([0, 0, 0], abs=1e-9 * size)
        assert 0.5 * size < mesh.size_m.max() < 1.5 * size


@each
def test_size_follows_the_kind_unless_stated(module: ModuleType) -> None:
    dial = module.DIALS.table["size_m"]
    draws = [drawn(module, k) for k in range(200)]
    assert {d["kind"] for d in draws} == set(dial.ranges)
    for d in draws:
        low, high = dial.ranges[d["kind"]]
        assert dial.drawn[0] <= low <= d["size_m"] <= high <= dial.drawn[1]
    assert drawn(module, 3, size_m=9.0 if module is not bird else 0.2)["size_m"] == (0.2 if module is bird else 9.0)
    assert module.MODEL.options["size_m"].endswith("by kind")
    with pytest.raises(ModelError, match="option kind: found 'kite'; expected one of"):
        drawn(module, 0, kind="kite")


def test_span_of_stretched_wings_is_the_size() -> None:
    for kind in ("gull", "raptor"):
        params = drawn(bird, 1, kind=kind, flight="soaring", bank_deg=0, climb_deg=0, size_m=1.2)
        assert 1.15 < np.ptp(vertices_of(bird.MODEL.build(params), "wing")[:, 1]) <= 1.2
    params = drawn(airplane, 1, kind="airliner", bank_deg=0, climb_deg=0, size_m=34)
    assert np.ptp(vertices_of(airplane.MODEL.build(params), "wing")[:, 1]) == pytest.approx(34, rel=0.04)
    params = drawn(helicopter, 1, propellers="spinning", bank_deg=0, lean_deg=0, size_m=10, tail="shrouded")
    disc = vertices_of(helicopter.MODEL.build(params), *DISC_RINGS)
    assert np.ptp(disc[:, :2], axis=0) == pytest.approx([10, 10], rel=1e-6)


def test_wings_go_up_and_down_with_the_phase_and_fold_in_the_upstroke() -> None:
    def tips(phase: float) -> tuple[float, float]:
        level = {"kind": "gull", "flight": "flapping", "flap_deg": 40, "bank_deg": 0, "climb_deg": 0, "size_m": 1}
        mesh = bird.MODEL.build(drawn(bird, 2, phase_deg=phase, **level))
        wing, body = vertices_of(mesh, "wing"), vertices_of(mesh, "body")
        tip = wing[wing[:, 1].argmax()]
        return float(tip[2] - body[:, 2].mean()), float(tip[1])

    assert tips(0)[0] > 0.15
    assert tips(180)[0] < -0.1
    assert tips(270)[1] < tips(90)[1] < 0.5


def test_climb_raises_the_nose_lean_lowers_it_and_bank_lowers_the_right_side() -> None:
    for module, front, side in ((bird, "bill", "wing"), (airplane, "window", "wing")):
        options: dict[str, Any] = {"flight": "soaring"} if module is bird else {}
        climbing = module.MODEL.build(drawn(module, 3, climb_deg=30, bank_deg=0, **options))
        nose, tail = vertices_of(climbing, front).mean(axis=0), vertices_of(climbing, "tail").mean(axis=0)
        assert nose[2] > tail[2] and nose[0] > tail[0]  # +X is the heading
        wing = vertices_of(module.MODEL.build(drawn(module, 3, bank_deg=30, climb_deg=0, **options)), side)
        assert wing[wing[:, 1].argmin(), 2] < wing[wing[:, 1].argmax(), 2]
    leaning = helicopter.MODEL.build(drawn(helicopter, 3, lean_deg=20, bank_deg=0))
    assert vertices_of(leaning, "window")[:, 2].mean() < vertices_of(leaning, "fin")[:, 2].mean()


def test_spinning_rotors_are_discs_that_labels_do_not_count() -> None:
    params = drawn(helicopter, 4, tail="rotor")
    still, spinning = (helicopter.MODEL.build({**params, "propellers": p}) for p in ("still", "spinning"))
    roles = helicopter.MODEL.roles({**params, "propellers": "spinning"})
    assert not set(still.part_names) & set(DISC_RINGS)
    assert set(spinning.part_names) == (set(still.part_names) - {"propeller"}) | set(DISC_RINGS)
    assert not any(roles[name].label for name in DISC_RINGS)
    assert max(roles[name].opacity for name in DISC_RINGS) < 0.3
    for kind in ("propeller", "business-jet"):
        light = drawn(airplane, 4, kind=kind)
        assert (set(DISC_RINGS) <= set(airplane.MODEL.build(light).part_names)) == (kind == "propeller")


@each
def test_engines_are_the_hottest_and_plumage_insulates(module: ModuleType) -> None:
    means = {name: sum(role.delta_t_k) / 2 for name, role in module.PARTS.items()}
    assert all(role.what for role in module.PARTS.values())
    if module is bird:  # in the order that Ward et al. measured on starlings
        assert means["leg"] > means["head"] > means["underwing"] > means["body"] > means["wing"] > means["tail"] > 0
    else:
        engine = "nacelle" if module is airplane else "engine"
        assert means["exhaust"] > means[engine] > max(v for k, v in means.items() if k not in ("exhaust", engine))
