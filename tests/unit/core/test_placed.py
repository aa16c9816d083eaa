"""Sunlight on meshes: the side towards the sun is warm, and bodies shade themselves."""

import math

import numpy as np
import pytest

from infrablend.assets.shapes import box, ellipsoid
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.mesh import make_mesh
from infrablend.core.render import GROUND_ALBEDO, PlacedObject, sun_direction, surface_irradiance
from infrablend.core.scene import ObjectSpec, PartState, Sun

SUN = Sun(azimuth_rad=math.radians(30), elevation_rad=math.radians(40), direct_w_m2=800.0, diffuse_w_m2=90.0)


def mesh_of(*solids, smooth=False):
    return make_mesh([(name, s.vertices, s.triangles, smooth) for name, s in solids])


def irradiance(mesh, sun=SUN, yaw=0.0):
    world = object_to_world(mesh.vertices_m, (3.0, 1.0, 0.0), yaw, 1.0)
    faces = world[mesh.triangles]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    everything = np.ones(len(mesh.triangles), np.bool_)
    return surface_irradiance(mesh, world, sun, everything).reshape(-1, 3).mean(axis=1), normals


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_sphere_is_warm_towards_the_sun_wherever_it_turns(yaw):
    mesh = mesh_of(("ball", ellipsoid((0.5, 0.5, 0.5), 48, 24)), smooth=True)
    found, normals = irradiance(mesh, yaw=yaw)
    cos = normals @ sun_direction(SUN)
    level = SUN.direct_w_m2 * math.sin(SUN.elevation_rad) + SUN.diffuse_w_m2
    around = SUN.diffuse_w_m2 * (1 + normals[:, 2]) / 2 + GROUND_ALBEDO * level * (1 - normals[:, 2]) / 2
    lit, dark = cos > 0.1, cos < -0.1
    assert found[lit] == pytest.approx((SUN.direct_w_m2 * cos + around)[lit], abs=45)
    assert found[dark] == pytest.approx(around[dark], abs=10)


def test_the_faces_of_a_box():
    mesh = mesh_of(("box", box((1.0, 1.0, 1.0), 0.0)))
    found, normals = irradiance(mesh, Sun(0.0, math.radians(30), 800.0, 0.0))
    ground = GROUND_ALBEDO * 400
    for normal, expected in (((1, 0, 0), 800 * math.cos(math.radians(30)) + ground / 2), ((0, 0, 1), 400.0),
                             ((-1, 0, 0), ground / 2), ((0, 1, 0), ground / 2)):  # fmt: skip
        face = normals @ np.array(normal) > 0.99
        assert found[face] == pytest.approx(expected, rel=0.02), normal


def test_a_body_shades_itself():
    """A plate above a box keeps a high sun off the box's top."""
    lower, plate = box((1.0, 1.0, 0.4), 0.0), box((2.0, 2.0, 0.05), 0.0)
    plate = type(plate)(plate.vertices + np.array([0, 0, 1.0]), plate.triangles)
    mesh = mesh_of(("lower", lower), ("plate", plate))
    found, normals = irradiance(mesh, Sun(0.0, math.radians(85), 800.0, 0.0))
    top = normals[:, 2] > 0.99
    of = np.array([mesh.part_names[k] for k in mesh.part_of_triangle])
    assert found[top & (of == "lower")].max() < 20
    assert found[top & (of == "plate")].min() > 780


def test_an_object_is_warmed_by_its_parts_response():
    mesh = mesh_of(("coat", ellipsoid((0.3, 0.3, 0.8))), ("hat", ellipsoid((0.2, 0.2, 0.2))), smooth=True)
    parts = {"coat": PartState(290.0, 0.95, sun_k=30.0), "hat": PartState(290.0, 0.95)}
    spec = ObjectSpec("m", "c", {}, parts, (0.0, 0.0, 0.0), 0.0)
    camera = CameraSpec(10.0, 0.5, 0.0, 50.0, 36.0, (64, 64))
    lit, night = (PlacedObject(spec, mesh, camera, sun) for sun in (SUN, None))
    assert not night.sun_rise_k.any()
    rise = lit.sun_rise_k.reshape(-1, 3)
    hat = np.array(mesh.part_names)[mesh.part_of_triangle] == "hat"
    assert not rise[hat].any() and rise[~hat].max() == pytest.approx(30 * 0.8, rel=0.15)
    low, high = lit.part_sun_range_k["coat"]
    assert 0 < low < lit.part_sun_rise_k["coat"] < high
