"""Reads a user's 3D file into plain triangles, in a process of its own with limits of memory and time.

Scripts, drivers and handlers in a .blend are not executed: Blender starts from factory settings with automatic
execution off. Lights and cameras are not read.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras import image_utils

from infrablend.blender.materials import GROUP_NAME
from infrablend.blender.physical import GROUP_NAME as PHYSICAL_NAME
from infrablend.core.wire import ModelFileMessage
from infrablend.errors import ModelError

# With more triangles, labels take seconds per frame.
MAX_TRIANGLES = 2_000_000
# Instances without any triangle take time, too.
MAX_INSTANCES = 1_000_000


class _TooLargeError(Exception):
    """More than an import may need."""


_Piece = tuple[Any, Any, Any, Any, str, list[Any]]


def _import_usd(file: str) -> Any:
    return bpy.ops.wm.usd_import(
        filepath=file,
        import_cameras=False,
        import_lights=False,
        import_volumes=False,
        create_world_material=False,
        import_usd_preview=False,  # only the names of materials are used
        import_textures_mode="IMPORT_NONE",
    )


def _import_fbx(file: str) -> Any:
    # An FBX usually names pictures on its author's machine, which would be looked for here.
    image_utils.load_image = lambda path, *_, **__: bpy.data.images.new(Path(str(path)).name or "picture", 1, 1)
    return bpy.ops.import_scene.fbx(filepath=file, use_image_search=False)


_IMPORTERS: dict[str, Callable[[str], Any]] = {
    ".glb": lambda f: bpy.ops.import_scene.gltf(filepath=f),
    ".gltf": lambda f: bpy.ops.import_scene.gltf(filepath=f),
    ".obj": lambda f: bpy.ops.wm.obj_import(filepath=f),
    ".fbx": _import_fbx,
    ".usd": _import_usd,
    ".usda": _import_usd,
    ".usdc": _import_usd,
    ".usdz": _import_usd,
    ".blend": lambda f: bpy.ops.wm.open_mainfile(filepath=f, load_ui=False, use_scripts=False),
}


def read_file(job: ModelFileMessage) -> dict[str, object]:
    """Read a 3D file: triangles in world coordinates, Z up, metres, and named pieces.

    The limits of memory and time hold for this process from now on.

    Returns:
        `arrays`: `vertices_m`, `triangles`, `group_of_triangle`, `smooth`. `groups`: a dict per piece, with the name of
        its object and material, and the values of the InfraredEffect node. Instead of both, `too_large`: what exceeds a
        limit, or `libraries`: linked files that are not known, each with what was found.

    Raises:
        ModelError: Blender cannot read the file, or it contains no surface.
    """
    file = Path(job["file"])
    shown = job["shown"]
    if sys.platform != "win32":
        for what, most in ((resource.RLIMIT_DATA, job["memory_bytes"]), (resource.RLIMIT_CPU, job["cpu_seconds"])):
            resource.setrlimit(what, (most, resource.getrlimit(what)[1]))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    try:
        _IMPORTERS[file.suffix.lower()](str(file))
    except MemoryError:
        return {"too_large": "more memory than an import may use"}
    except Exception as error:  # the importers are Python add-ons: KeyError, struct.error and many more
        raise ModelError(
            f"model file {shown}: Blender cannot read it ({_reason(error)}); expected a valid {file.suffix} file"
        ) from error
    if file.suffix.lower() == ".blend":  # the FBX importer, in contrast, sets what is hidden for the viewport only
        libraries = _other_libraries(job["known"])
        if libraries:
            return {"libraries": libraries}
        _show_as_rendered()
    try:
        pieces = list(_pieces())
    except _TooLargeError as error:
        return {"too_large": str(error)}
    if not pieces:
        raise ModelError(f"model file {shown}: no surface found; expected at least one visible mesh object")
    if not all(np.isfinite(v).all() for v, *_ in pieces):
        raise ModelError(
            f"model file {shown}: vertices that are not finite numbers; expected a valid {file.suffix} file"
        )
    return _joined(pieces)


def _joined(pieces: Sequence[_Piece]) -> dict[str, object]:
    """Return the arrays and the named groups of all pieces."""
    vertices = []
    triangles = []
    groups = []
    smooth = []
    facts: list[dict[str, object]] = []
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
    arrays = {
        "vertices_m": np.concatenate(vertices),
        "triangles": np.concatenate(triangles).astype(np.int32),
        "group_of_triangle": np.concatenate(groups).astype(np.int32),
        "smooth": np.concatenate(smooth),
    }
    return {"arrays": arrays, "groups": facts}


def _other_libraries(known: Sequence[str]) -> list[tuple[str, str]]:
    """Return the libraries of a .blend that are missing or not among the known files, each with what was found."""
    problems = []
    for library in bpy.data.libraries:
        path = Path(bpy.path.abspath(library.filepath)).resolve()
        if library.packed_file is None and str(path) not in known:
            problems.append((library.filepath, "named by an absolute path" if path.is_file() else "missing"))
    return problems


def _reason(error: Exception) -> str:
    """Return the last line of an importer's error: operators put a whole traceback into their message."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return next((line for line in reversed(lines) if not line.startswith(("Location:", "File "))), type(error).__name__)


def _show_as_rendered() -> None:
    """Set what the viewport shows to what a render of the scene shows: pieces are read as the viewport shows them."""
    layer = bpy.context.view_layer
    scene = bpy.context.scene
    for thing in layer.objects:
        thing.hide_set(False)
    waiting = [layer.layer_collection]
    while waiting:
        here = waiting.pop()
        here.hide_viewport = False
        waiting += here.children
    for collection in bpy.data.collections:
        collection.hide_viewport = collection.hide_render
    # Not only the scene's own objects: a collection that is instanced contains others.
    for thing in bpy.data.objects:
        thing.hide_viewport = thing.hide_render
        thing.show_instancer_for_viewport = thing.show_instancer_for_render
        for modifier in thing.modifiers:
            modifier.show_viewport = modifier.show_render
    scene.render.simplify_subdivision = scene.render.simplify_subdivision_render


def _pieces() -> Iterator[_Piece]:
    """Yield the evaluated triangles of everything that is visible in a render of the scene.

    Raises:
        _TooLargeError: There are too many.
    """
    for thing in bpy.data.objects:
        for modifier in thing.modifiers:
            # Labels need the mesh that a render shows, not the coarser viewport mesh.
            if modifier.type in {"SUBSURF", "MULTIRES"}:
                modifier.levels = modifier.render_levels
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    total = 0
    for number, instance in enumerate(depsgraph.object_instances):
        if number >= MAX_INSTANCES:
            raise _TooLargeError(f"more than {MAX_INSTANCES:,} instances")
        thing = instance.object
        if thing.hide_render or thing.type not in {"MESH", "CURVE", "SURFACE", "META", "FONT"}:
            continue
        if not instance.is_instance and _is_copied_by_parent(thing):
            continue
        mesh = thing.to_mesh()
        if mesh is None:
            continue
        # Corners minus two per polygon; counted before Blender computes the triangles.
        total += len(mesh.loops) - 2 * len(mesh.polygons)
        if total > MAX_TRIANGLES:
            raise _TooLargeError(f"more than {MAX_TRIANGLES:,} triangles")
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
            # Copies that an object makes, such as scattered rocks, belong to it. An instance of a collection shows
            # other objects, whose own names say what they are.
            maker = instance.parent if instance.is_instance else None
            name = thing.name if maker is None or maker.instance_type == "COLLECTION" else maker.name
            materials = [slot.material for slot in thing.material_slots]
            yield world, corners, smooth[polygon], material[polygon], name, materials
        thing.to_mesh_clear()


def _is_copied_by_parent(thing: Any) -> bool:
    """Return whether a parent copies the object to its vertices or faces: a render shows the copies, not the object."""
    parent = thing.parent
    while parent is not None:
        if parent.instance_type in {"VERTS", "FACES"}:
            return True
        parent = parent.parent
    return False


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
