"""Reads a user's 3D file into plain triangles, in a separate process that ends afterwards.

A .blend may contain scripts. They are never executed: Blender starts from factory settings with automatic execution
off, and the process holds no secrets.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import bpy
import numpy as np

from infrablend.blender.materials import GROUP_NAME
from infrablend.blender.physical import GROUP_NAME as PHYSICAL_NAME
from infrablend.core.files import replace_atomically
from infrablend.core.tasks import Task
from infrablend.errors import ModelError

# With more triangles, labels take seconds per frame.
MAX_TRIANGLES = 2_000_000

_IMPORTERS: dict[str, Callable[[str], Any]] = {
    ".glb": lambda f: bpy.ops.import_scene.gltf(filepath=f),
    ".gltf": lambda f: bpy.ops.import_scene.gltf(filepath=f),
    ".obj": lambda f: bpy.ops.wm.obj_import(filepath=f),
    ".fbx": lambda f: bpy.ops.import_scene.fbx(filepath=f),
    ".usd": lambda f: bpy.ops.wm.usd_import(filepath=f),
    ".usda": lambda f: bpy.ops.wm.usd_import(filepath=f),
    ".usdc": lambda f: bpy.ops.wm.usd_import(filepath=f),
    ".usdz": lambda f: bpy.ops.wm.usd_import(filepath=f),
}


def make_importer(_settings: Any) -> Callable[[Task], str]:
    """Create a worker; the payload of its tasks is (3D file, .npz to write)."""

    def run(task: Task) -> str:
        file, target = task.payload
        import_file(Path(file), Path(target))
        return str(target)

    return run


def import_file(file: Path, target: Path) -> None:
    """Read a 3D file and write its triangles (world coordinates, Z up, metres) and named pieces to `target`.

    Raises:
        ModelError: Blender cannot read the file, or it contains no surface.
    """
    _require_inside(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    try:
        if file.suffix.lower() == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False, use_scripts=False)
        else:
            _IMPORTERS[file.suffix.lower()](str(file))
    except Exception as error:  # the importers are Python add-ons: KeyError, struct.error and many more
        raise ModelError(
            f"model file {file}: Blender cannot read it ({_reason(error)}); expected a valid {file.suffix} file"
        ) from error
    pieces = _pieces()
    if not pieces:
        raise ModelError(f"model file {file}: no surface found; expected at least one visible mesh object")
    count = sum(len(corners) for _, corners, *_ in pieces)
    if count > MAX_TRIANGLES:
        raise ModelError(
            f"model file {file}: {count:,} triangles; expected at most {MAX_TRIANGLES:,}. About ten thousand "
            "are enough for an object of a few hundred pixels: reduce it in Blender (Decimate modifier)"
        )
    if not all(np.isfinite(v).all() for v, *_ in pieces):
        raise ModelError(
            f"model file {file}: vertices that are not finite numbers; expected a valid {file.suffix} file"
        )
    vertices, triangles, groups, smooth = [], [], [], []
    facts: list[dict[str, Any]] = []
    index: dict[tuple[str, str], int] = {}
    offset = 0
    for v, t, t_smooth, t_material, object_name, materials in pieces:
        for number in np.unique(t_material):
            material = materials[number] if number < len(materials) else None
            key = (object_name, material.name if material else "")
            if key not in index:
                index[key] = len(facts)
                facts.append({"object": key[0], "material": key[1], **_infrared(material)})
        of_material = np.array([index.get((object_name, m.name if m else ""), -1) for m in (materials or [None])])
        vertices.append(v)
        triangles.append(t + offset)
        groups.append(of_material[np.minimum(t_material, len(of_material) - 1)])
        smooth.append(t_smooth)
        offset += len(v)
    beside = target.with_name(f".{target.stem}.{os.getpid()}.part")
    with replace_atomically(target, beside=beside) as temporary, temporary.open("wb") as stream:
        np.savez(
            stream,
            vertices_m=np.concatenate(vertices),
            triangles=np.concatenate(triangles).astype(np.int32),
            group_of_triangle=np.concatenate(groups).astype(np.int32),
            smooth=np.concatenate(smooth),
            groups=np.array(json.dumps(facts)),
        )


def _reason(error: Exception) -> str:
    """Return the last line of an importer's error: operators put a whole traceback into their message."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return next((line for line in reversed(lines) if not line.startswith(("Location:", "File "))), type(error).__name__)


def _require_inside(file: Path) -> None:
    """Refuse a glTF that refers to files outside its folder.

    Raises:
        ModelError: A reference leaves the folder of the file, or the file is not glTF.
    """
    if file.suffix.lower() != ".gltf":
        return
    try:
        content = json.loads(file.read_text("utf-8"))
        references = [i["uri"] for k in ("buffers", "images") for i in content.get(k, ()) if "uri" in i]
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ModelError(f"model file {file}: not glTF ({error}); expected a valid .gltf file") from error
    folder = file.parent.resolve()
    for uri in references:
        if isinstance(uri, str) and uri.startswith("data:"):
            continue
        named = unquote(str(uri))
        if "\0" in named or "://" in named or folder not in (folder / named).resolve().parents:
            raise ModelError(
                f"model file {file}: refers to {named!r} outside its folder; expected files beside it. "
                "Save it as .glb, which contains everything"
            )


def _pieces() -> list[tuple[Any, Any, Any, Any, str, list[Any]]]:
    """Return the evaluated triangles of everything that is visible in a render of the scene."""
    scene = bpy.context.scene
    for thing in scene.objects:
        for modifier in thing.modifiers:
            # Labels need the mesh that a render shows, not the coarser viewport mesh.
            if modifier.type in {"SUBSURF", "MULTIRES"}:
                modifier.levels = modifier.render_levels
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    found = []
    for instance in depsgraph.object_instances:
        thing = instance.object
        if thing.hide_render or thing.type not in {"MESH", "CURVE", "SURFACE", "META", "FONT"}:
            continue
        mesh = thing.to_mesh()
        if mesh is None:
            continue
        mesh.calc_loop_triangles()
        count = len(mesh.loop_triangles)
        if count:
            v = np.empty(3 * len(mesh.vertices), np.float32)
            mesh.vertices.foreach_get("co", v)
            t = np.empty(3 * count, np.int32)
            mesh.loop_triangles.foreach_get("vertices", t)
            polygon = np.empty(count, np.int32)
            mesh.loop_triangles.foreach_get("polygon_index", polygon)
            smooth = np.empty(len(mesh.polygons), np.bool_)
            mesh.polygons.foreach_get("use_smooth", smooth)
            material = np.empty(len(mesh.polygons), np.int32)
            mesh.polygons.foreach_get("material_index", material)
            matrix = np.array(instance.matrix_world, np.float64)
            world = v.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
            corners = t.reshape(-1, 3)
            if np.linalg.det(matrix[:3, :3]) < 0:
                corners = corners[:, ::-1]
            name = instance.parent.name if instance.is_instance and instance.parent else thing.name
            materials = [slot.material for slot in thing.material_slots]
            found.append((world, corners, smooth[polygon], material[polygon], name, materials))
        thing.to_mesh_clear()
    return found


def _infrared(material: Any) -> dict[str, float | None]:
    """Return the values of a material's InfraredEffect node (of either look), None without one."""
    wanted = {"temperature_c": "Temperature", "emissivity": "Emissivity", "ior": "IOR"}
    wanted |= {"roughness": "Roughness", "metal": "Metal"}
    names = (GROUP_NAME, PHYSICAL_NAME)
    for node in material.node_tree.nodes if material is not None and material.node_tree is not None else ():
        if node.type == "GROUP" and node.node_tree and node.node_tree.name.split(".")[0] in names:
            value = {s.name: s.default_value for s in node.inputs}
            return {fact: float(value[socket]) if socket in value else None for fact, socket in wanted.items()}
    return dict.fromkeys(wanted)
