"""Parts that models call closed are: every edge belongs to two triangles in opposite directions, outside in front."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from infrablend.assets.catalogue import list_models, load_model
from infrablend.core.rng import stream


@pytest.mark.parametrize("name", list_models())
def test_closed_parts_are_closed_and_face_outward(name: str) -> None:
    model = load_model(name)
    for number in range(6):
        mesh = model.build(model.sample(stream(3, "closed", name, number), {}))
        chosen = np.array([n in mesh.closed_parts for n in mesh.part_names])[mesh.part_of_triangle]
        assert chosen.any()
        # Vertices at sharp edges exist twice.
        _, same = np.unique(mesh.vertices_m + 0.0, axis=0, return_inverse=True)
        triangles = same.reshape(-1)[mesh.triangles[chosen]].astype(np.int64)
        a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
        edge = a != b
        size = int(triangles.max()) + 1
        assert np.array_equal(np.sort((a * size + b)[edge]), np.sort((b * size + a)[edge]))
        count, solid = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(size, size)), directed=False)
        p = mesh.vertices_m[mesh.triangles[chosen]]
        volume = np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2]))
        used = np.unique(solid[triangles[:, 0]])
        assert (np.bincount(solid[triangles[:, 0]], volume, count)[used] > 0).all()
