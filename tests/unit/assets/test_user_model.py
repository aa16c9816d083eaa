"""User models from imported geometry to the mesh, without Blender."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.assets.user_model import GroupFacts, geometry_file, load_user_model, read_description, write_geometry
from infrablend.core.mesh import Mesh
from infrablend.errors import ModelError

# A roof: two triangles that share an edge, each a piece of its own, and a third, apart from them.
CORNERS = np.array([[0.0, 0, 0], [2, 0, 0], [1, 1, 1], [1, -1, 1], [0, 0, 4], [1, 0, 4], [0, 1, 4]])
FACES = np.array([[0, 1, 2], [1, 0, 3], [4, 5, 6]], np.int32)
GROUPS = [GroupFacts("Roof", "Tin"), GroupFacts("Roof", "Glass"), GroupFacts("Vane", "Iron", 30.0, 0.9)]
PARTS = """
  tin: {match: [Tin], delta_t_k: 10, emissivity: 0.9}
  glass: {match: [Glass], delta_t_k: 0, emissivity: 0.9}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    return tmp_path


def described(folder: Path, parts: str, corners: Sequence[Sequence[float]] = (), extra: str = "") -> Path:
    """Write a description and its imported geometry; `corners` are vertices beyond those of the triangles."""
    file = folder / "house.glb"
    file.write_text("{}")
    cached = geometry_file(file)
    cached.parent.mkdir(parents=True, exist_ok=True)
    vertices = np.concatenate([CORNERS, np.reshape(corners, (-1, 3))])
    arrays = {
        "vertices_m": vertices,
        "triangles": FACES,
        "group_of_triangle": np.arange(3, dtype=np.int32),
        "smooth": np.ones(3, bool),
    }
    write_geometry(cached, GROUPS, arrays)
    path = folder / "house.yaml"
    path.write_text(f"name: house\ncategory: house\nfile: house.glb\n{extra}parts:{parts}")
    return path


def mesh_of(path: Path) -> Mesh:
    model = load_user_model(path)
    return model.build(model.sample(np.random.default_rng(0), {}))


@pytest.mark.parametrize("origin", ["feet", "centre", "file"])
def test_vertices_of_no_triangle_decide_neither_size_nor_origin(folder: Path, origin: str) -> None:
    extra = f"origin: {origin}\nlength_m: 3.0\n"
    expected = mesh_of(described(folder, PARTS, extra=extra))
    found = mesh_of(described(folder, PARTS, [(500.0, -30, -20)], extra))
    assert found.size_m.max() == pytest.approx(3.0)
    assert np.array_equal(found.vertices_m, expected.vertices_m)
    assert np.array_equal(found.triangles, expected.triangles)


def test_parts_share_no_vertices(folder: Path) -> None:
    """So temperatures are sharp between parts, whichever way the file stores its vertices."""
    mesh = mesh_of(described(folder, PARTS))
    assert np.array_equal(mesh.vertices_m[mesh.triangles], CORNERS[FACES])
    assert [mesh.part_names[n] for n in mesh.part_of_triangle] == ["tin", "glass", "Iron"]
    assert len(np.unique(mesh.triangles)) == len(mesh.vertices_m) == 9
    # Within a part, shared vertices stay shared: their normals are smooth.
    one = mesh_of(described(folder, "\n  all: {match: [Roof, Vane], delta_t_k: 0, emissivity: 0.9}\n"))
    assert np.array_equal(one.triangles, FACES)


def test_a_material_with_a_node_does_not_replace_a_part_of_its_name(folder: Path) -> None:
    parts = PARTS.replace("  glass: {match: [Glass]", "  Iron: {match: [Glass]")
    with pytest.raises(ModelError, match="do not match") as caught:
        load_user_model(described(folder, parts))
    (problem,) = caught.value.problems
    assert problem.where.endswith("parts.Iron")
    for text in ("'Vane'", "'Iron'", "rename the part or the material"):
        assert text in str(problem)
    # The same material belongs to the part if a pattern says so.
    model = load_user_model(described(folder, parts.replace("[Glass]", "[Glass, Vane]")))
    assert set(model.parts) == {"tin", "Iron"}


DESCRIPTION = "name: a\ncategory: a\nfile: {}\nparts: {{all: {{match: ['*'], delta_t_k: 1, emissivity: 0.9}}}}\n"


@pytest.mark.parametrize("name", ["loop.obj", "pipe.obj", "a\0b.obj", "a" * 5000 + ".obj", "none.obj", "folder.obj"])
def test_a_3d_file_must_be_a_regular_file(tmp_path: Path, name: str) -> None:
    (tmp_path / "loop.obj").symlink_to("loop.obj")
    (tmp_path / "folder.obj").mkdir()
    os.mkfifo(tmp_path / "pipe.obj")
    (tmp_path / "thing.yaml").write_text(DESCRIPTION.format(json.dumps(name)))
    with pytest.raises(ModelError, match="does not exist"):
        read_description(tmp_path / "thing.yaml")


@pytest.mark.parametrize("instead", ["pipe", "endless", "folder"])
def test_a_description_must_be_a_regular_file(tmp_path: Path, instead: str) -> None:
    path = tmp_path / "thing.yaml"
    if instead == "pipe":
        os.mkfifo(path)
    elif instead == "endless":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    with pytest.raises(ModelError, match=r"thing\.yaml: cannot be read"):
        read_description(path)


@pytest.mark.parametrize("name", ["thing.yaml", "a.obj"])
def test_a_link_out_of_the_folder_of_the_model_is_refused(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "a.obj").write_text("v 0 0 0\n")
    (folder / "thing.yaml").write_text(DESCRIPTION.format("a.obj"))
    (folder / name).rename(tmp_path / name)
    (folder / name).symlink_to(tmp_path / name)
    with pytest.raises(ModelError, match="a link out of its folder; expected a file inside it"):
        read_description(folder / "thing.yaml")


@pytest.mark.parametrize("file", ["my drone.obj", "a.glb"])
def test_a_3d_file_as_a_model_is_refused_with_the_command_that_describes_it(file: str) -> None:
    command = f"infrablend models add {shlex.quote(file)} --category NAME"
    with pytest.raises(ModelError, match=re.escape(command)):
        load_model(file)
