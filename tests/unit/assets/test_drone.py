"""The quadrotor: a valid mesh, parameters with their documented meaning, options honoured or refused."""

import itertools

import numpy as np
import pytest

from infrablend.assets import drone
from infrablend.assets.drone import CHOICES, MODEL, NOMINAL
from infrablend.assets.rotors import DISC_RINGS, OUTSIDE_ORIGIN_BOX
from infrablend.core.mesh import Mesh
from infrablend.core.rng import stream
from tests.meshes import areas, vertices_of

DRAWS = [MODEL.sample(stream(7, "drone", k), {}) for k in range(24)]


def measured_motors_m(mesh: Mesh) -> np.ndarray:
    """Return the (4, 2) centres of the stators in the mesh."""
    xy = vertices_of(mesh, "winding")[:, :2]
    return np.array([(c.min(axis=0) + c.max(axis=0)) / 2 for c in np.split(xy, 4)])


@pytest.mark.parametrize("k", range(len(DRAWS)))
def test_drawn_drone_is_sound(k: int) -> None:
    params = DRAWS[k]
    mesh = MODEL.build(params)
    assert 4_000 <= len(mesh.triangles) <= 13_000
    assert set(mesh.part_names) <= set(MODEL.parts)
    counts = np.bincount(mesh.part_of_triangle, minlength=len(mesh.part_names))
    assert (counts > 0).all()

    assert areas(mesh).min() > 1e-8 * params["size_m"] ** 2

    v = vertices_of(mesh, *(set(mesh.part_names) - OUTSIDE_ORIGIN_BOX))
    assert v.min(axis=0) + v.max(axis=0) == pytest.approx([0, 0, 0], abs=1e-9)
    assert (mesh.size_m < 2.0 * params["size_m"]).all()
    assert mesh.size_m[2] > 0.15 * params["size_m"]


@pytest.mark.parametrize(
    ("layout", "body", "arm"), list(itertools.product(CHOICES["layout"], CHOICES["body"], CHOICES["arm"]))
)
def test_every_combination_builds_with_the_diagonal_asked_for(layout: str, body: str, arm: str) -> None:
    for n, (legs, batteries) in enumerate(itertools.product(CHOICES["legs"], CHOICES["batteries"])):
        mesh = MODEL.build(
            {
                **NOMINAL,
                "size_m": 0.3 + 0.1 * n,
                "layout": layout,
                "body": body,
                "arm": arm,
                "legs": legs,
                "batteries": batteries,
                "antennas": n % 3,
                "mast": n % 2 == 0,
                "camera": n % 2 == 1,
                "blades": 2 + n % 2,
                "arm_spread": n / 5,
            }
        )
        motors = measured_motors_m(mesh)
        for a, b in ((0, 2), (1, 3)):
            assert np.linalg.norm(motors[a] - motors[b]) == pytest.approx(0.3 + 0.1 * n, rel=0.01)
        # Left and right alike, heading along +X.
        assert motors[:, 1].sum() == pytest.approx(0, abs=1e-6)
        assert {"battery", "motor", "arm", "propeller", "leg"} <= set(mesh.part_names)
        assert ("gimbal" in mesh.part_names) == (n % 2 == 1)


def test_propellers_clear_one_another_and_the_body() -> None:
    for params in DRAWS:
        plan = drone._plan(params)
        gaps = np.linalg.norm(plan.motors_xy[:, None] - plan.motors_xy[None], axis=2)[~np.eye(4, dtype=bool)]
        assert 0.12 < plan.propeller_radius < gaps.min() / 2
        beyond = np.maximum(np.abs(plan.motors_xy) - (plan.half_length, plan.half_width), 0)
        assert (np.linalg.norm(beyond, axis=1) > plan.propeller_radius).all()


def test_motor_positions_are_those_of_the_mesh() -> None:
    for params in DRAWS[:6]:
        wanted = params["size_m"] * drone._motor_plan(params)
        found = measured_motors_m(MODEL.build(params))
        offset = (found - wanted).mean(axis=0)
        assert found == pytest.approx(wanted + offset, abs=1e-6)


def test_a_propeller_turns_by_its_angle() -> None:
    def blades(angle: float) -> np.ndarray:
        mesh = MODEL.build({**NOMINAL, "propeller_angle_deg": [angle, 0.0, 0.0, 0.0]})
        v = vertices_of(mesh, "propeller")
        centre = measured_motors_m(mesh)[0]
        reach = np.linalg.norm(v[:, :2] - centre, axis=1) / NOMINAL["size_m"]
        # Of this motor's propeller, without its hub, which is round.
        return v[(reach > 0.05) & (reach < 0.33)] - np.array([*centre, 0.0])

    at_0, at_90 = blades(0.0), blades(90.0)
    assert np.ptp(at_0[:, 0]) > 3 * np.ptp(at_0[:, 1])
    assert at_90 == pytest.approx(at_0[:, [1, 0, 2]] * (-1, 1, 1), abs=1e-9)


def test_size_scales_and_nothing_else() -> None:
    small, large = (MODEL.build({**NOMINAL, "size_m": s}) for s in (0.4, 0.8))
    assert large.vertices_m == pytest.approx(2 * small.vertices_m, rel=1e-12)


def test_sizes_are_drawn_log_uniformly() -> None:
    draws = [MODEL.sample(stream(3, "many", k), {}) for k in range(400)]
    # Log-uniform: half of the sizes lie below the geometric mean.
    below = np.mean([d["size_m"] < np.sqrt(0.3 * 0.9) for d in draws])
    assert below == pytest.approx(0.5, abs=0.08)


def test_options_are_honoured_and_leave_other_draws_alone() -> None:
    options = {"size_m": [0.5, 0.6], "layout": "h", "body": ["plate", "shell"], "propeller_angle_deg": [1, 2, 3, 4]}
    for k in range(30):
        drawn = MODEL.sample(stream(k, "o"), options)
        assert 0.5 <= drawn["size_m"] <= 0.6
        assert drawn["layout"] == "h" and drawn["body"] in ("plate", "shell")
        assert drawn["propeller_angle_deg"] == [1.0, 2.0, 3.0, 4.0]
    free, fixed = (MODEL.sample(stream(1, "o"), o) for o in ({}, {"layout": "plus", "arm_rise": 0.5}))
    assert fixed["layout"] == "plus" and fixed["arm_rise"] == 0.5
    assert {**free, "layout": "plus", "arm_rise": 0.5} == fixed
    assert MODEL.sample(stream(1, "o"), {"size_m": 0.45, "propeller_angle_deg": 30})["size_m"] == 0.45
    assert MODEL.sample(stream(1, "o"), {"propeller_angle_deg": 30})["propeller_angle_deg"] == [30.0] * 4


def test_parts_have_sane_thermal_roles() -> None:
    for role in MODEL.parts.values():
        assert role.delta_t_k[0] <= role.delta_t_k[1] <= 60
        assert 0.8 <= role.emissivity[0] <= role.emissivity[1] <= 1
        assert role.what
    hot, cold = ("battery", "motor", "winding", "esc"), ("frame", "arm", "propeller", "leg")
    assert min(MODEL.parts[h].delta_t_k[0] for h in hot) > max(MODEL.parts[c].delta_t_k[1] for c in cold)
    assert all(role in {p for d in DRAWS for p in MODEL.build(d).part_names} for role in MODEL.roles(NOMINAL))


def test_spinning_propellers_are_discs_that_labels_do_not_count() -> None:
    assert not set(MODEL.roles(NOMINAL)) & set(DISC_RINGS)
    for k, drawn in enumerate(DRAWS):
        still, spinning = MODEL.build(drawn), MODEL.build({**drawn, "propellers": "spinning"})
        roles = MODEL.roles({**drawn, "propellers": "spinning"})
        assert set(spinning.part_names) == set(still.part_names) | set(DISC_RINGS), k
        # What is not a blade is where it was; hubs are still there.
        for name in still.part_names:
            a, b = (
                m.vertices_m[m.triangles[m.part_of_triangle == m.part_names.index(name)]] for m in (still, spinning)
            )
            if name == "propeller":
                assert 0 < len(b) < len(a)
            else:
                assert np.array_equal(a, b)
        areas, opacities = [], []
        for name in DISC_RINGS:
            assert not roles[name].label and not MODEL.parts[name].label
            corners = spinning.vertices_m[
                spinning.triangles[spinning.part_of_triangle == spinning.part_names.index(name)]
            ]
            cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            assert (cross[:, 2] > 0).all()  # faces up
            areas.append(float(np.linalg.norm(cross, axis=1).sum() / 2))
            opacities.append(roles[name].opacity)
        # Blades cover more of the circle near the hub; on the whole 5 to 15 %.
        assert opacities == sorted(opacities, reverse=True)
        assert 0.05 < np.average(opacities, weights=areas) < 0.15
        # As much as the blades themselves do, seen from above.
        blades = still.vertices_m[still.triangles[still.part_of_triangle == still.part_names.index("propeller")]]
        normals = np.cross(blades[:, 1] - blades[:, 0], blades[:, 2] - blades[:, 0])[:, 2] / 2
        assert float(np.dot(opacities, areas)) == pytest.approx(float(normals[normals > 0].sum()), rel=0.35)


def test_propellers_are_an_option_that_changes_nothing_else() -> None:
    free = MODEL.sample(stream(4, "o"), {})
    assert free["propellers"] == "still"
    assert MODEL.sample(stream(4, "o"), {"propellers": "spinning"}) == {**free, "propellers": "spinning"}
    both = {MODEL.sample(stream(k, "o"), {"propellers": ["still", "spinning"]})["propellers"] for k in range(20)}
    assert both == {"still", "spinning"}


def test_draws_and_meshes_of_the_paper_s_recipes_stay() -> None:
    """The recipes of the paper must give the same pixels and labels with every version."""
    found = []
    for k in range(3):
        params = MODEL.sample(stream(k, "guard"), {"propellers": ["still", "spinning"]})
        mesh = MODEL.build(params)
        shape = [params[n] for n in ("layout", "body", "arm", "propellers")]
        found.append((*shape, params["size_m"], len(mesh.triangles), float((mesh.vertices_m**2).sum())))
    assert [f[:4] for f in found] == [
        ("h", "plate", "tube", "still"),
        ("deadcat", "plate", "bar", "spinning"),
        ("plus", "plate", "tube", "spinning"),
    ]
    assert [f[4] for f in found] == pytest.approx(
        [0.5387719817693879, 0.658057893595442, 0.6024189955809626], rel=1e-12
    )
    assert [f[5] for f in found] == [11320, 9208, 10456]
    assert [f[6] for f in found] == pytest.approx([497.1308858193878, 623.683277996057, 513.4431032237067], rel=1e-9)
