"""Users' models to break: a description in YAML for each of several 3D files, some with files beside them."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path

from tests.models_3d import glb, write_gltf

_DESCRIPTION = "name: a\ncategory: a\nfile: {}\nparts: {{all: {{match: ['*'], delta_t_k: 1, emissivity: 0.9}}}}\n"
_OBJ = "mtllib thing.mtl\no Body\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl Warm\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
_USD = """#usda 1.0
(subLayers = [@part.usda@])
def Mesh "Body" {
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
}
"""
# Names that a mutation puts in place of one of a file beside the model.
_NAMES = ("../canary/run.json", "..", ".", "/etc/passwd", "//../a", "C:\\a", "file:///etc/passwd", "\\\\a\\b", "a\0b",
          "%2e%2e/a", "/dev/zero", "a" * 5000, "", "@", "`'a'`", "é")  # fmt: skip


def write_models(lab: Path) -> None:
    """Write intact models to `in/models`, each in a folder of its own."""
    for name, write in _WRITERS.items():
        folder = lab / "in" / "models" / name.partition(".")[2] / "model"
        folder.mkdir(parents=True)
        write(folder)
        (folder / "thing.yaml").write_text(_DESCRIPTION.format(json.dumps(name)))


def _write_glb(folder: Path) -> None:
    write_gltf(folder, 1.0)
    (folder / "thing.glb").write_bytes(glb((folder / "thing.gltf").read_bytes()))


def _write_obj(folder: Path) -> None:
    (folder / "thing.obj").write_text(_OBJ)
    (folder / "thing.mtl").write_text("newmtl Warm\n")


def _write_usda(folder: Path) -> None:
    (folder / "thing.usda").write_text(_USD)
    (folder / "part.usda").write_text('#usda 1.0\ndef "Other" {}\n')


_OF_FIXED_LENGTH = (".blend", ".glb")
_WRITERS: dict[str, Callable[[Path], object]] = {
    "thing.gltf": lambda folder: write_gltf(folder, 1.0),
    "thing.glb": _write_glb,
    "thing.obj": _write_obj,
    "thing.usda": _write_usda,
    "thing.blend": lambda folder: (folder / "thing.blend").write_bytes(b"BLENDER-v405" + b"//part.usda\0"),
}


def choose_model(lab: Path, choose: random.Random) -> Path:
    """Move one of the models to `in/chosen`, with one of its references replaced now and then; return its folder."""
    chosen = choose.choice(sorted((lab / "in" / "models").iterdir()))
    target = lab / "in" / "chosen"
    shutil.move(chosen / "model", target)
    files = [p for p in sorted(target.iterdir()) if p.suffix not in (".yaml", ".bin")]
    if choose.random() < 0.5:
        file, new = choose.choice(files), choose.choice(_NAMES).encode()
        data = file.read_bytes()
        for old in (b"thing.bin", b"thing.mtl", b"part.usda"):
            fits = file.suffix not in _OF_FIXED_LENGTH
            data = data.replace(old, new if fits else new[: len(old)].ljust(len(old)))
        file.write_bytes(data)
    return target
