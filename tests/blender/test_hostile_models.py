"""Users' models from the command line to the geometry: stale files, large and slow models, linked libraries."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from infrablend.assets import model_files
from infrablend.assets.model_files.blend import read_blend
from infrablend.cli import main
from infrablend.core.landlock import landlock_version
from infrablend.pipeline import models
from tests.flat_renderer import render_flat
from tests.hostile_models import write_gltf

SETTINGS = ("--set", "camera.pitch={fixed_deg: 60}", "--set", "camera.size_px=[64, 48]")
RECIPE = """
name: things
configurations: 1
camera: {distance_m: 8, pitch: {fixed_deg: 60}, size_px: [64, 48]}
objects: [{model: thing.yaml}]
"""
DESCRIPTION = """
name: thing
category: thing
file: thing.gltf
parts: {all: {match: ['*'], delta_t_k: 10, emissivity: 0.9}}
"""
MAKE = """
import os, sys
import bpy
out = sys.argv[1]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_cube_add()
bpy.ops.wm.save_as_mainfile(filepath=out + "/library/part.blend")
bpy.ops.wm.read_factory_settings(use_empty=True)
with bpy.data.libraries.load(out + "/library/part.blend", link=True) as (there, here):
    here.objects = there.objects
bpy.context.scene.collection.objects.link(here.objects[0])
bpy.ops.wm.save_as_mainfile(filepath=out + "/linked.blend", compress=True)
os.mkdir(out + "/model")
bpy.ops.wm.save_as_mainfile(filepath=out + "/model/outside.blend")
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_uv_sphere_add()
for k in range(5):
    bpy.context.object.modifiers.new(str(k), "ARRAY").count = 1
bpy.ops.wm.save_as_mainfile(filepath=out + "/nested.blend")
os._exit(0)
"""


@pytest.fixture(autouse=True)
def surroundings(monkeypatch, tmp_path):
    """Render with the flat renderer in this process; give each test its own cache and log."""
    render_flat(monkeypatch)
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blends")
    (folder / "library").mkdir()
    (folder / "make.py").write_text(MAKE)
    command = [sys.executable, str(folder / "make.py"), str(folder)]
    subprocess.run(command, check=True, timeout=300, capture_output=True)
    set_array_counts(folder / "nested.blend", 40)
    return folder


def set_array_counts(file, count):
    """Set the count of all array modifiers, which Blender would evaluate at once."""
    blend = read_blend(file.read_bytes())
    data = bytearray(blend.data)
    wanted = {k for k, (name, *_) in enumerate(blend.layouts) if name == "ArrayModifierData"}
    for _, at, (_, _, fields) in blend.structures(wanted):
        (place,) = (at + f.offset for f in fields if f.name == "count" and not f.inside)
        data[place : place + 4] = count.to_bytes(4, "little")
    file.write_bytes(data)


def describe(file):
    path = file.with_suffix(".yaml")
    path.write_text(DESCRIPTION.replace("thing.gltf", file.name))
    return path


def show(file):
    path = describe(file)
    return main(["models", "show", str(path), "--out", str(path.with_suffix(".png"))])


def test_a_changed_buffer_changes_the_shape_and_ends_a_resume(tmp_path, capsys):
    """The cache and the key of a run once knew only the .gltf, not the .bin beside it."""
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "thing.yaml").write_text(DESCRIPTION)
    (folder / "recipe.yaml").write_text(RECIPE)
    (tmp_path / "data").mkdir()
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    Image.fromarray((60 + x + y).astype(np.uint8)).save(tmp_path / "data" / "a.png")

    def generate(*options):
        command = ["generate", str(folder / "recipe.yaml"), "--data", str(tmp_path / "data"), "--out"]
        return main([*command, str(tmp_path / "run"), "--to", "coco", *options])

    def area():
        (labels,) = (tmp_path / "run" / "coco").glob("*.json")
        return sum(a["bbox"][2] * a["bbox"][3] for a in json.loads(labels.read_text())["annotations"])

    write_gltf(folder, 0.5)
    assert generate() == 0
    small = area()
    assert small > 0
    assert generate("--resume") == 0
    before = (folder / "thing.gltf").read_bytes()
    write_gltf(folder, 2.0)
    assert (folder / "thing.gltf").read_bytes() == before
    capsys.readouterr()
    assert generate("--resume") != 0
    assert "this is a different run: models" in " ".join(capsys.readouterr().err.split())
    assert generate("--overwrite") == 0
    assert area() > 4 * small


# The memory limit is for the time of this test. Another process runs it: the children of this one have been larger.
SHOW_WITH_LESS_MEMORY = """
import resource, sys
from dataclasses import replace
from infrablend.cli import main
from infrablend.pipeline import models
models.IMPORT_LIMITS = replace(models.IMPORT_LIMITS, memory_bytes=600 * 2**20)
code = main(["models", "show", sys.argv[1], "--out", sys.argv[2]])
print("KiB", resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(code)
"""


def test_nested_arrays_end_early(files):
    """Five nested array modifiers of 40 once took 10 GB and five minutes."""
    path = describe(files / "nested.blend")
    words = [sys.executable, "-c", SHOW_WITH_LESS_MEMORY, str(path), str(path.with_suffix(".png"))]
    process = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert process.returncode == 2
    assert "too large (more than 0.59 GB of memory)" in " ".join(process.stderr.split())
    assert 0 < int(process.stdout.rpartition("KiB")[2]) < 1_000_000


def test_slow_imports_end(files, monkeypatch, capsys):
    monkeypatch.setattr(models, "IMPORT_LIMITS", replace(models.IMPORT_LIMITS, seconds=0.1))
    assert show(files / "linked.blend") == 2
    assert "import took more than 0.1 s" in " ".join(capsys.readouterr().err.split())


def test_linked_libraries_are_read_from_the_folder_alone(files, tmp_path, monkeypatch, capsys):
    assert show(files / "model" / "outside.blend") == 2
    text = " ".join(capsys.readouterr().err.split())
    assert "linked library '../library/part.blend', which is outside of its folder" in text
    models.import_geometry(files / "linked.blend")
    (first,) = (tmp_path / "cache" / "models").iterdir()
    library = files / "library" / "part.blend"
    library.write_bytes(library.read_bytes() + b" ")
    models.import_geometry(files / "linked.blend")
    assert len(list((tmp_path / "cache" / "models").iterdir())) == 2
    assert first.is_file()


def test_blender_cannot_read_what_the_check_of_references_misses(tmp_path, monkeypatch, capsys):
    """The confined process is the second line of defence: here without the first one."""
    if not landlock_version():
        pytest.skip("NEEDS LANDLOCK: Linux 5.13 or newer")
    monkeypatch.setattr(model_files, "_references", lambda _name, _data: [])
    folder = tmp_path / "model"
    folder.mkdir()
    write_gltf(folder, 1.0, str(folder / "thing.bin"))
    assert show(folder / "thing.gltf") == 2
    assert "Missing resource" in " ".join(capsys.readouterr().err.split())
