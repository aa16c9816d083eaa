"""The files that a 3D model consists of: their digest, their copies, and files that are damaged."""

import contextlib
import gzip
import time
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.assets import model_files
from infrablend.assets.model_files import find_model_files
from infrablend.assets.model_files.blend import empty_unneeded_paths, read_blend
from infrablend.assets.model_files.reference import UnreadableFileError
from infrablend.assets.model_files.usd import _lz4_block
from infrablend.errors import ModelError
from tests.hostile_models import blend, crate, gltf, usdz


def digest(file: Path) -> str:
    return find_model_files(file).digest


def test_every_file_that_decides_the_shape_is_part_of_the_digest(tmp_path):
    folder = tmp_path
    (folder / "sub").mkdir()
    (folder / "a.gltf").write_bytes(gltf("sub/a%20b.bin"))
    (folder / "b.obj").write_text("mtllib sub/c.mtl\n")
    (folder / "c.usda").write_text("#usda 1.0\n# a @comment@\n(subLayers = [@sub/d.usdc@])\n")
    (folder / "d.blend").write_bytes(blend(("Library", 1, {"filepath": "//sub\\e.blend"})))
    beside = {
        "a.gltf": ("sub/a b.bin", b"1234"),
        "b.obj": ("sub/c.mtl", b"newmtl a\nmap_Kd tex.png\n"),
        "c.usda": (
            "sub/d.usdc",
            crate(b"a text that is long enough", b"/a/path/of/the/scene.png-not", b"https://x.org/a.png"),
        ),
        "d.blend": ("sub/e.blend", blend(("Image", 1, {"filepath": "/elsewhere/a.png", "source": 1}))),
    }
    for name, (other, content) in beside.items():
        (folder / other).write_bytes(content)
        files = find_model_files(folder / name)
        assert list(files.digests) == [name, other]
        before = files.digest
        (folder / other).write_bytes(content + b" ")
        assert digest(folder / name) != before
        (folder / other).write_bytes(content)
        assert digest(folder / name) == before
    (folder / "b.mtl").write_text("newmtl a\n")  # Blender reads it although no line names it
    assert list(find_model_files(folder / "b.obj").digests) == ["b.obj", "b.mtl", "sub/c.mtl"]


def test_digest_of_a_single_file_is_that_of_its_content_and_the_importer(tmp_path, monkeypatch):
    """So a model that another version of the importer has cached is imported again."""
    first, renamed = tmp_path / "a.fbx", tmp_path / "b.fbx"
    for file in (first, renamed):
        file.write_bytes(b"fbx")
    before = digest(first)
    assert digest(renamed) == before
    monkeypatch.setattr(model_files, "IMPORTER_VERSION", model_files.IMPORTER_VERSION + 1)
    assert digest(first) != before


def test_copied_blend_has_no_path_that_the_import_does_not_need(tmp_path):
    folder = tmp_path
    (folder / "b.blend").write_bytes(blend())
    blocks = (
        ("Image", 1, {"filepath": "/elsewhere/a.png", "source": 1}),
        ("PointCache", 3, {"path": "/elsewhere/points"}),
        ("Library", 2, {"filepath": "//b.blend"}),
    )
    (folder / "a.blend").write_bytes(gzip.compress(blend(*blocks)))
    copy = find_model_files(folder / "a.blend").copy_to(tmp_path / "copy")
    assert b"/elsewhere" not in copy.read_bytes() and b"//b.blend" in copy.read_bytes()
    assert sorted(p.name for p in copy.parent.iterdir()) == ["a.blend", "b.blend"]
    assert read_blend(copy.read_bytes()).layouts == read_blend(blend(*blocks)).layouts


PARTS = st.sampled_from(["..", ".", "a", "b c", "", "~", "%2e%2e", "é"])
HEADS = st.sampled_from([b"", b"BLENDER-v405", b"BLENDER17-01v0500", b"\x1f\x8b", b"\x28\xb5\x2f\xfd"])


@given(st.lists(PARTS, min_size=1, max_size=6), st.booleans())
def test_no_path_of_a_gltf_leaves_the_folder(tmp_path_factory, parts, back):
    """Whatever a reference looks like, every file of a model is below its folder."""
    folder = tmp_path_factory.mktemp("m") / "a" / "b"
    (folder / "a").mkdir(parents=True)
    for place in (folder, folder.parent, folder / "a"):
        (place / "b c").write_bytes(b"x")
    (folder / "m.gltf").write_bytes(gltf(("\\" if back else "/").join(parts)))
    try:
        files = find_model_files(folder / "m.gltf")
    except ModelError:
        return
    for name in files.digests:
        assert (folder / name).resolve().is_relative_to(folder.resolve())


@given(st.binary(max_size=200), HEADS)
def test_a_damaged_blend_gives_one_kind_of_error(data, head):
    for content in (head + data, blend(("Library", 1, {"filepath": "x"}))[:-200] + data):
        with contextlib.suppress(UnreadableFileError):
            empty_unneeded_paths(read_blend(content))


@given(st.binary(max_size=300))
def test_lz4_never_returns_more_than_it_may(data):
    with contextlib.suppress(ValueError, IndexError):
        assert len(_lz4_block(memoryview(data), 100)) <= 100


def test_usd_packages_contain_what_they_name(tmp_path):
    file = tmp_path / "a.usdz"
    usdz(file, "../other/part.usda")
    assert list(find_model_files(file).digests) == ["a.usdz"]
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("a.usda", "#usda 1.0\n" * 1000)
    with pytest.raises(ModelError, match="compressed"):
        find_model_files(file)


@pytest.mark.parametrize(
    "text", [b'"""\\"' * 10**5, b"\\'" * 10**6, b"@@@\\@@@" * 10**5, b'\\"' * 10**6, b"@" * 10**5, b"@a" * 10**6]
)
def test_unclosed_texts_in_usd_cost_no_second_look(tmp_path, text):
    """Reading text that was made to be slow takes a second, not hours."""
    (tmp_path / "a.usda").write_bytes(b"#usda 1.0\n" + text)
    started = time.process_time()
    with contextlib.suppress(ModelError):
        find_model_files(tmp_path / "a.usda")
    assert time.process_time() - started < 10


def test_a_reference_of_any_length_is_named_in_short(tmp_path):
    (tmp_path / "a.gltf").write_bytes(gltf("/" + 10**6 * "a"))
    with pytest.raises(ModelError) as caught:
        find_model_files(tmp_path / "a.gltf")
    assert len(str(caught.value)) < 1000
    (tmp_path / "a.gltf").write_bytes(gltf(10**6 * "a"))
    assert list(find_model_files(tmp_path / "a.gltf").digests) == ["a.gltf"]
