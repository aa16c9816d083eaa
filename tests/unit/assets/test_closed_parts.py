"""Closed solids: what models call closed, and each piece that a model is made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from infrablend.assets import airplane, bird, camera_quad, car, drone, fixed_wing, helicopter, hexacopter, racer
from infrablend.assets.catalogue import list_models, load_model
from infrablend.core.rng import stream
from tests.meshes import check_pieces, check_surface

PIECES: dict[str, Any] = {
    "car": car._build_pieces,
    "drone": lambda p: drone._build_pieces(p).items,
    **{
        m.MODEL.name: lambda p, m=m: m.build_pieces(p).items
        for m in (airplane, bird, camera_quad, fixed_wing, helicopter, hexacopter, racer)
    },
}


@pytest.mark.parametrize("name", list_models())
def test_closed_parts_are_closed_and_face_outward(name: str) -> None:
    model = load_model(name)
    for number in range(6):
        mesh = model.build(model.sample(stream(3, "closed", name, number), {}))
        chosen = np.array([n in mesh.closed_parts for n in mesh.part_names])[mesh.part_of_triangle]
        assert chosen.any()
        check_surface(mesh, mesh.triangles[chosen])


@pytest.mark.parametrize("name", PIECES)
def test_every_piece_is_closed_and_faces_outward(name: str) -> None:
    model = load_model(name)
    options: dict[str, Any] = {"sheltered": False} if name == "car" else {}
    for k in range(12):
        params = model.sample(stream(7, name, k), options)
        found = PIECES[name](params)
        assert len(found) >= 10
        mesh = model.build(params)
        solid = [model.roles(params)[n].opacity == 1 for n in mesh.part_names]
        assert sum(len(t) for _, _, t, _ in found) == np.array(solid)[mesh.part_of_triangle].sum()
        check_pieces(found)
