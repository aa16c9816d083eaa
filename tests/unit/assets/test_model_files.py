"""The files that a 3D model consists of: their digest, and files that are missing or damaged."""

import gzip
import os
from pathlib import Path

import pytest
import zstandard

from infrablend.assets import model_files
from infrablend.assets.model_files import find_model_files
from infrablend.errors import ModelError
from tests.models_3d import glb, gltf

BLEND = b"BLENDER-v405" + bytes(40) + b"//sub\\e.blend\0" + bytes(40)
CRATE = b"PXR-USDC" + bytes(100)
# Each 3D file with the file beside it that decides its shape.
REFERRING = {
    "a.gltf": (gltf("sub/a%20b.bin"), "sub/a b.bin"),
    "b.glb": (glb(gltf("sub/b.bin")), "sub/b.bin"),
    "c.obj": (b"v 0 0 0\n mtllib sub/a c.mtl\r\n", "sub/a c.mtl"),
    "d.obj": (b"v 0 0 0\n", "d.mtl"),  # Blender reads it although no line names it
    "e.usda": (b'#usda 1.0\n# a @comment@ "\n(doc = "@"\nsubLayers = [@sub/e.usdc[x]@])\n', "sub/e.usdc"),
    "f.usd": (b"#usda 1.0\n(payload = @@@sub/f@.usda:SDF_FORMAT_ARGS:a=b@@@)\n", "sub/f@.usda"),
    "g.usdc": (CRATE, "sub/g.usd"),
    "h.blend": (BLEND, "sub/e.blend"),
    "i.blend": (zstandard.compress(BLEND), "sub/e.blend"),
    "j.blend": (gzip.compress(BLEND, mtime=0), "sub/e.blend"),
}


@pytest.mark.parametrize("name", REFERRING)
def test_every_file_that_decides_the_shape_is_part_of_the_digest(tmp_path: Path, name: str) -> None:
    content, other = REFERRING[name]
    (tmp_path / name).write_bytes(content)
    (tmp_path / "sub").mkdir()
    beside = {".usdc": CRATE, ".usda": b"#usda 1.0\n", ".usd": CRATE, ".blend": b"BLENDER"}
    data = beside.get(Path(other).suffix, b"newmtl a\nmap_Kd tex.png\n")
    (tmp_path / other).write_bytes(data)
    (tmp_path / "tex.png").write_bytes(b"a texture, which decides nothing")
    files = find_model_files(tmp_path / name)
    assert files.paths == [tmp_path / name, tmp_path / other]
    (tmp_path / other).write_bytes(data + b" ")
    assert find_model_files(tmp_path / name).digest != files.digest
    (tmp_path / other).write_bytes(data)
    assert find_model_files(tmp_path / name) == files


def test_files_that_are_referred_to_refer_to_others(tmp_path: Path) -> None:
    for k in range(3):
        (tmp_path / f"{k}.usda").write_text(f"#usda 1.0\n(subLayers = [@{(k + 1) % 3}.usda@, @none.usda@])\n")
    assert list(find_model_files(tmp_path / "1.usda").digests) == ["1.usda", "0.usda", "2.usda"]


def test_digest_of_a_single_file_is_that_of_its_content_and_the_importer(tmp_path, monkeypatch):
    """So a model that another version of the importer has cached is imported again."""
    first, renamed = tmp_path / "a.fbx", tmp_path / "b.fbx"
    for file in (first, renamed):
        file.write_bytes(b"fbx")
    before = find_model_files(first).digest
    assert find_model_files(renamed).digest == before
    monkeypatch.setattr(model_files, "IMPORTER_VERSION", model_files.IMPORTER_VERSION + 1)
    assert find_model_files(first).digest != before


@pytest.mark.parametrize("uri", ["none.bin", "https://example.org/a.bin", 10**6 * "a"])
def test_a_missing_buffer_is_named_in_short(tmp_path: Path, uri: str) -> None:
    (tmp_path / "a.gltf").write_bytes(gltf(uri))
    with pytest.raises(ModelError, match=r"a\.gltf: cannot find 1 of the files it refers to") as caught:
        find_model_files(tmp_path / "a.gltf")
    assert os.path.normpath(uri)[:300] in str(caught.value) and "which is missing" in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.gltf", b"[]", "not glTF"),
        ("a.gltf", b"\xff", "not glTF"),
        ("a.glb", b"glTF", "not glTF"),
        ("a.glb", glb(gltf("a.bin"))[:30], "cut off"),
        ("a.usd", b"nothing of the kind", "neither a USD text"),
        ("a.blend", b"nothing of the kind", "not a .blend"),
        ("a.blend", gzip.compress(BLEND, mtime=0)[:40], "Compressed file ended"),
        ("a.blend", zstandard.compress(BLEND)[:9] + b"xxx", "not a .blend"),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, name: str, content: bytes, reason: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ModelError, match=rf"{name}: .*{reason}.*; expected a valid {name[1:]} file"):
        find_model_files(tmp_path / name)


@pytest.mark.parametrize("kind", ["pipe", "folder", "link"])
def test_what_a_model_refers_to_must_be_a_regular_file(tmp_path: Path, kind: str) -> None:
    """A pipe as material library once made the import hang."""
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "a.obj").write_text("mtllib a b.mtl\nv 0 0 0\n")
    library = folder / "a b.mtl"
    if kind == "pipe":
        os.mkfifo(library)
    elif kind == "folder":
        library.mkdir()
    else:
        (tmp_path / "other.mtl").write_text("newmtl a\n")
        library.symlink_to(tmp_path / "other.mtl")
    expected = {"pipe": "a b.mtl is no regular file", "folder": "a b.mtl", "link": "a link out of its folder"}
    with pytest.raises(ModelError, match=expected[kind]):
        find_model_files(folder / "a.obj")


def test_large_files_are_refused_before_they_are_read(tmp_path: Path) -> None:
    with (tmp_path / "a.obj").open("wb") as stream:
        stream.truncate(3 * 2**30)
    with pytest.raises(ModelError, match="too large"):
        find_model_files(tmp_path / "a.obj")
