"""User models: every file type, parts by name, damaged files, scripts that must not run."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from infrablend import api
from infrablend.assets.catalogue import load_model
from infrablend.assets.user_model import description_digest, geometry_file, read_geometry
from infrablend.errors import ModelError
from infrablend.pipeline.plans import models
from infrablend.pipeline.plans.models import import_geometry, ready_model
from tests.blender.in_blender import run_script
from tests.meshes import signed_volume
from tests.models_3d import write_gltf

MAKE = """
import os, sys
import bpy
from infrablend.blender.materials import infrared_effect_group
out = sys.argv[1]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 0.5))
a = bpy.context.object
a.name = a.data.name = "Body"
bpy.ops.mesh.primitive_uv_sphere_add(radius=0.3, location=(0.7, 0, 1))
b = bpy.context.object
b.name = b.data.name = "Head"
b.modifiers.new("more", "SUBSURF").render_levels = 2
m = bpy.data.materials.new("Warm")
m.use_nodes = True
n = m.node_tree.nodes.new("ShaderNodeGroup")
n.node_tree = infrared_effect_group()
n.inputs["Temperature"].default_value = 35
n.inputs["Emissivity"].default_value = 0.75
a.data.materials.append(m)
b.data.materials.append(m)
bpy.ops.wm.obj_export(filepath=out + "/thing.obj")
bpy.ops.export_scene.gltf(filepath=out + "/thing.glb")
bpy.ops.export_scene.fbx(filepath=out + "/thing.fbx")
bpy.ops.wm.usd_export(filepath=out + "/thing.usdc")
t = bpy.data.texts.new("evil.py")
t.write(f"open({out + '/EVIL'!r}, 'w').write('x')")
t.use_module = True
d = a.driver_add("location", 0).driver
d.type = "SCRIPTED"
d.expression = f"len(str(open({out + '/EVIL2'!r}, 'w')))"
bpy.ops.wm.save_as_mainfile(filepath=out + "/thing.blend")
os._exit(0)
"""
RENDERED = """
import os, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
def collection(name):
    c = bpy.data.collections.new(name)
    scene.collection.children.link(c)
    return c
def cube(name, target=scene.collection, at=0.0):
    bpy.ops.mesh.primitive_cube_add(size=1, location=(at, 0, 0))
    o = bpy.context.object
    o.name = o.data.name = name
    for c in list(o.users_collection):
        c.objects.unlink(o)
    target.objects.link(o)
    return o
eye, monitor, unrendered = (collection(n) for n in ("eye", "monitor", "unrendered"))
cube("InEye", eye)
cube("InMonitor", monitor)
cube("InUnrendered", unrendered)
cube("Eye")
cube("Monitor").hide_viewport = True
cube("Unrendered").hide_render = True
shown, hidden = cube("ShownModifier"), cube("HiddenModifier")
for o in (shown, hidden):
    m = o.modifiers.new("array", "ARRAY")
    m.count = 3
    m.show_render = o is shown
    m.show_viewport = o is not shown
cutter = cube("Cutter", at=0.5)
cutter.hide_render = True
cut = cube("Cut").modifiers.new("cut", "BOOLEAN")
cut.operation, cut.object = "DIFFERENCE", cutter
inside = bpy.data.collections.new("inside")
motor = cube("Motor", inside)
m = motor.modifiers.new("more", "SUBSURF")
m.subdivision_type, m.levels, m.render_levels = "SIMPLE", 0, 1
for k in range(2):
    e = bpy.data.objects.new(f"Instance {k}", None)
    e.instance_type, e.instance_collection = "COLLECTION", inside
    e.location.y = 2 * k
    scene.collection.objects.link(e)
plane = cube("Rocks")
plane.instance_type = "VERTS"
plane.show_instancer_for_viewport, plane.show_instancer_for_render = True, False
cube("Rock").parent = plane
monitor.hide_viewport = True
unrendered.hide_render = True
bpy.context.view_layer.update()
bpy.context.view_layer.layer_collection.children["eye"].hide_viewport = True
bpy.data.objects["Eye"].hide_set(True)
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
os._exit(0)
"""
LINKED = """
import os, sys
import bpy
out = sys.argv[1]
for folder in ("library", "model"):
    os.mkdir(out + "/" + folder)
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_cube_add()
bpy.ops.wm.save_as_mainfile(filepath=out + "/library/part.blend")
bpy.ops.wm.read_factory_settings(use_empty=True)
with bpy.data.libraries.load(out + "/library/part.blend", link=True) as (there, here):
    here.objects = there.objects
bpy.context.scene.collection.objects.link(here.objects[0])
bpy.ops.wm.save_as_mainfile(filepath=out + "/linked.blend", compress=True)
bpy.data.libraries[0].filepath = out + "/library/part.blend"
bpy.ops.wm.save_as_mainfile(filepath=out + "/absolute.blend", relative_remap=False)
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_uv_sphere_add()
for k in range(5):
    m = bpy.context.object.modifiers.new(str(k), "ARRAY")
    m.show_viewport = False
    m.count = 40
bpy.ops.wm.save_as_mainfile(filepath=out + "/nested.blend")
os._exit(0)
"""
PARTS = """
parts:
  body: {match: [Body*], delta_t_k: [4, 8], emissivity: 0.97, ior: 1.0}
  head: {match: [Head*], delta_t_k: 15, emissivity: 0.98, label: false}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    run_script(MAKE, folder)
    return folder


@pytest.fixture(scope="module")
def linked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("linked")
    run_script(LINKED, folder)
    return folder


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))


def built(model):
    return model.build(model.sample(np.random.default_rng(0), {}))


def describe(files, tmp_path, suffix, extra=PARTS, file=None):
    path = tmp_path / "thing.yaml"
    path.write_text(f"name: thing\ncategory: thing\nfile: {file or files / f'thing.{suffix}'}\norigin: feet\n{extra}")
    return str(path)


@pytest.mark.parametrize("suffix", ["obj", "glb", "fbx", "usdc", "blend"])
def test_every_file_type_gives_the_same_shape(files, tmp_path, suffix):
    model = ready_model(describe(files, tmp_path, suffix))
    mesh = built(model)
    assert set(mesh.part_names) == {"body", "head"}
    assert mesh.size_m == pytest.approx([1.5, 1.0, 1.3], abs=0.03)
    assert mesh.vertices_m[:, 2].min() == pytest.approx(0, abs=1e-9)
    assert model.parts["head"].label is False
    assert model.parts["body"].delta_t_k == (4, 8)


def test_scripts_in_a_blend_are_not_executed(files, tmp_path):
    ready_model(describe(files, tmp_path, "blend"))
    assert not (files / "EVIL").exists()
    assert not (files / "EVIL2").exists()


def test_infrared_effect_materials_need_no_parts(files, tmp_path):
    model = ready_model(describe(files, tmp_path, "blend", "air_temperature_c: 15"))
    assert model.parts["Warm"].delta_t_k == pytest.approx((20, 20))
    assert model.parts["Warm"].emissivity == pytest.approx((0.75, 0.75))


def test_subdivision_is_that_of_the_render(files, tmp_path):
    mesh = built(ready_model(describe(files, tmp_path, "blend")))
    head = mesh.part_of_triangle == mesh.part_names.index("head")
    assert head.sum() > 10_000  # 960 triangles before two levels of subdivision


def test_a_blend_is_read_as_a_render_shows_it(tmp_path):
    """What is hidden, which modifiers act, and the names of objects in instances of a collection."""
    blend = tmp_path / "rendered.blend"
    run_script(RENDERED, blend)
    import_geometry(blend)
    groups, arrays = read_geometry(geometry_file(blend), "here")
    triangles = dict(zip([g.object for g in groups], np.bincount(arrays["group_of_triangle"]).tolist(), strict=True))
    assert triangles.pop("Cut") == 12
    assert triangles == {
        "InEye": 12, "InMonitor": 12, "Eye": 12, "Monitor": 12, "ShownModifier": 36, "HiddenModifier": 12,
        "Motor": 2 * 48, "Rocks": 8 * 12,
    }  # fmt: skip


def test_heading_and_length(files, tmp_path):
    mesh = built(ready_model(describe(files, tmp_path, "obj", PARTS + "heading: '-X'\nlength_m: 3.0\n")))
    assert mesh.size_m.max() == pytest.approx(3.0)
    head = mesh.part_of_triangle == mesh.part_names.index("head")
    assert mesh.vertices_m[mesh.triangles[head]].reshape(-1, 3)[:, 0].mean() < 0


def test_an_obj_that_stands_on_z(files, tmp_path):
    """The same shape saved with Z up is upright if its YAML has `up: Z`."""
    text = (files / "thing.obj").read_text().splitlines()
    turned = tmp_path / "z_up.obj"

    def turn(line: str) -> str:
        if not line.startswith(("v ", "vn ")):
            return line
        kind, x, y, z = line.split()[:4]
        return f"{kind} {x} {-float(z)} {y}"

    turned.write_text("\n".join(turn(line) for line in text if not line.startswith("mtllib")))
    sizes = []
    for file, extra in ((files / "thing.obj", PARTS), (turned, PARTS + "up: Z\n")):
        sizes.append(built(ready_model(describe(files, tmp_path, "", extra, file=file))).size_m)
    assert sizes[0] == pytest.approx(sizes[1], abs=1e-5)
    as_read, stated, turned_x = (
        built(ready_model(describe(files, tmp_path, "fbx", PARTS + up))).size_m for up in ("", "up: Z\n", "up: X\n")
    )
    assert as_read == pytest.approx(stated) and turned_x == pytest.approx(as_read[[2, 1, 0]])


def z_up_glb(path):
    """Write a GLB as tools do that ignore its Y-up convention: a column 2 m high along Z in a node that is moved."""
    corners = np.array([(x, y, z) for x in (0, 0.5) for y in (0, 1) for z in (0, 2)], np.float32)
    triangles = np.array(
        [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
         (1, 5, 7), (1, 7, 3)],
        np.uint16,
    )  # fmt: skip
    binary = corners.tobytes() + triangles.tobytes()
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "Body", "mesh": 0, "translation": [1, 2, 3]}],
        "meshes": [{"name": "Body", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": corners.nbytes},
            {"buffer": 0, "byteOffset": corners.nbytes, "byteLength": triangles.nbytes},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", "min": [0, 0, 0], "max": [0.5, 1, 2]},
            {"bufferView": 1, "componentType": 5123, "count": triangles.size, "type": "SCALAR"},
        ],
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
    path.write_bytes(head + text + struct.pack("<II", len(binary), 0x004E4942) + binary)


@pytest.mark.parametrize(("up", "size_m"), [("", (0.5, 2, 1)), ("up: y\n", (0.5, 2, 1)), ("up: z\n", (0.5, 1, 2))])
def test_a_gltf_with_z_up(tmp_path, up, size_m):
    """A GLB that another tool saved with Z up is upright if its YAML has `up: Z`."""
    z_up_glb(tmp_path / "z_up.glb")
    parts = "parts: {body: {match: [Body], delta_t_k: 1, emissivity: 0.9}}\n"
    mesh = built(ready_model(describe(None, tmp_path, "", parts + up, file=tmp_path / "z_up.glb")))
    assert mesh.size_m == pytest.approx(size_m, abs=1e-6)
    assert signed_volume(mesh.vertices_m, mesh.triangles) == pytest.approx(1.0, abs=1e-6)  # turned, not mirrored


@pytest.mark.parametrize(
    ("extra", "match"),
    [
        ("parts: {body: {match: [Body*], delta_t_k: 1, emissivity: 1.0}}", "'Head'"),
        (PARTS + "  tail: {match: [Tail], delta_t_k: 1, emissivity: 1.0}", r"parts\.tail"),
        (PARTS + "colour: red", "colour"),
        ("parts: {body: {match: ['*'], delta_t_k: [8, 4], emissivity: 1.5}}", "delta_t_k"),
    ],
)
def test_invalid_model_descriptions(files, tmp_path, extra, match):
    with pytest.raises(ModelError, match=match):
        ready_model(describe(files, tmp_path, "obj", extra))


def test_unreadable_files(files, tmp_path):
    bad = tmp_path / "bad.glb"
    bad.write_bytes(b"this is no model")
    with pytest.raises(ModelError, match=r"bad\.glb"):
        ready_model(describe(files, tmp_path, "", file=bad))
    bad = tmp_path / "bad.blend"
    bad.write_bytes((files / "thing.blend").read_bytes()[:400])
    with pytest.raises(ModelError, match=r"bad\.blend"):
        ready_model(describe(files, tmp_path, "", file=bad))
    with pytest.raises(ModelError, match="does not exist"):
        ready_model(describe(files, tmp_path, "", file=tmp_path / "none.obj"))
    with pytest.raises(ModelError, match="has an unknown type"):
        ready_model(describe(files, tmp_path, "", file=tmp_path / "x.stl"))
    with pytest.raises(ModelError, match="no such model"):
        load_model("dron")
    with pytest.raises(ModelError, match="cannot be read"):
        load_model(str(tmp_path / "none.yaml"))


def test_a_glb_is_added_by_the_names_of_its_objects(files, tmp_path):
    """`models add` on a real file: Blender reads it, the description it writes is a model."""
    survey = api.survey_model(files / "thing.glb", api.ModelAnswers("fox"))
    assert dict(zip([g.object for g in survey.groups], survey.guess.roles, strict=True)) == {
        "Body": "fur",
        "Head": "fur",
    }
    assert survey.file_size == pytest.approx((1.5, 1.0, 1.3), abs=0.03)
    answers = api.ModelAnswers("fox", 0.7, {"Head": "muzzle"})
    mesh = built(ready_model(str(api.add_model(files / "thing.glb", answers, tmp_path))))
    assert set(mesh.part_names) == {"fur", "muzzle"}
    assert mesh.size_m.max() == pytest.approx(0.7)
    assert mesh.vertices_m[:, 2].min() == pytest.approx(0, abs=1e-9)


def test_a_changed_buffer_is_another_model(tmp_path):
    """The cache once knew only the .gltf, not the .bin beside it."""
    description = describe(None, tmp_path, "", "parts: {all: {match: ['*'], delta_t_k: 1, emissivity: 0.9}}\n",
                           file=tmp_path / "thing.gltf")  # fmt: skip
    sizes, digests = [], set()
    for size in (0.5, 2.0):
        write_gltf(tmp_path, size)
        sizes.append(built(ready_model(description)).size_m.max())
        digests.add(description_digest(Path(description)))
    assert sizes == pytest.approx([0.5, 2.0])
    assert len(digests) == 2


def test_linked_libraries_are_part_of_the_model(linked, tmp_path):
    import_geometry(linked / "linked.blend")
    library = linked / "library" / "part.blend"
    content = library.read_bytes()
    library.write_bytes(content + b" ")
    import_geometry(linked / "linked.blend")
    assert len(list((tmp_path / "cache" / "models").iterdir())) == 2
    with pytest.raises(ModelError, match=r"part\.blend', which is named by an absolute path"):
        import_geometry(linked / "absolute.blend")
    library.unlink()
    with pytest.raises(ModelError, match=r"'//library/part\.blend', which is missing"):
        import_geometry(linked / "linked.blend")
    library.write_bytes(content)


def test_imports_end_at_limits_of_memory_and_time(linked, monkeypatch):
    """Five nested array modifiers of 40 once took 10 GB and five minutes."""
    monkeypatch.setattr(models, "IMPORT_MEMORY_BYTES", 2**30)
    with pytest.raises(ModelError, match=r"nested\.blend: Blender crashed on it or needed more than 1 GB of memory"):
        import_geometry(linked / "nested.blend")
    monkeypatch.setattr(models, "IMPORT_SECONDS", 0.05)
    with pytest.raises(ModelError, match=r"import took more than 0\.05 s"):
        import_geometry(linked / "nested.blend")
    monkeypatch.undo()
    monkeypatch.setattr(models, "IMPORT_CPU_SECONDS", 1)
    with pytest.raises(ModelError, match="import took more than 1 s of processor time"):
        import_geometry(linked / "nested.blend")
