"""One Blender per file of tests: those of other files expect no child process."""

from collections.abc import Iterator

import numpy as np
import pytest

from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import Mesh, make_mesh
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec
from tests.blender.in_blender import OpenRenderer


@pytest.fixture(scope="module")
def blender() -> Iterator[OpenRenderer]:
    renderer = OpenRenderer()
    yield renderer
    renderer.close()


def box_mesh(size=(1.0, 0.6, 0.4), part="body") -> Mesh:
    x, y, z = np.array(size) / 2
    v = np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (-z, z)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    t = np.array([q for a, b, c, d in quads for q in ((a, b, c), (a, c, d))], np.int32)
    return make_mesh([(part, v, t, False)])


def ball_mesh() -> Mesh:
    """A smooth sphere of 0.6 m radius."""
    n = 48
    t, p = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n, endpoint=False), indexing="ij")
    v = 0.6 * np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(2 * n), indexing="ij")
    a, b = i * 2 * n + j, i * 2 * n + (j + 1) % (2 * n)
    c, d = a + 2 * n, b + 2 * n
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    return make_mesh([("body", v, faces.astype(np.int32), True)])


def sheet(z: float, part: str, width: float = 1.6) -> tuple[str, np.ndarray, np.ndarray, bool]:
    """A level square, as `make_mesh` takes it."""
    x = width / 2
    v = np.array([[-x, -x, z], [x, -x, z], [x, x, z], [-x, x, z]])
    return part, v, np.array([[0, 1, 2], [0, 2, 3]], np.int32), False


def scene(
    objects, *, distance_m=6.0, pitch_rad=0.7, roll_rad=0.1, samples=64, seed=5, size_wh=(320, 256), **look
) -> SceneSpec:
    return SceneSpec(
        frame_id="train/t_c0",
        background_id="t",
        split="train",
        configuration=0,
        camera=CameraSpec(distance_m, pitch_rad, roll_rad, 50.0, 36.0, size_wh),
        objects=tuple(objects),
        ambient_k=285.0,
        appearance=Appearance(**{"cold_k": 275.0, "hot_k": 305.0, "surroundings_k": 275.0, "texture_k": 0.0, **look}),
        samples=samples,
        render_seed=seed,
    )


def thing(
    x=0.0, y=0.0, z=0.0, yaw=0.3, kelvin=300.0, emissivity=1.0, ior=1.0, label=True, parts=("body",), **surface
) -> ObjectSpec:
    state = PartState(kelvin, emissivity, label, ior, **surface)
    return ObjectSpec("box", "box", {}, dict.fromkeys(parts, state), (x, y, z), yaw)


def paste(result) -> tuple[np.ndarray, np.ndarray]:
    """Radiance and alpha on the whole frame."""
    w, h = result.frame_wh
    (x0, y0), (rows, columns) = result.offset_xy, result.alpha.shape
    radiance, alpha = np.zeros((h, w), np.float32), np.zeros((h, w), np.float32)
    radiance[y0 : y0 + rows, x0 : x0 + columns] = result.radiance
    alpha[y0 : y0 + rows, x0 : x0 + columns] = result.alpha
    return radiance, alpha
