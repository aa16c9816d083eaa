"""3D files that refer to other files: what leaves their folder is refused on the command line, and named."""

import gzip
import json
import os

import pytest

from infrablend.cli import main
from tests.hostile_models import blend, crate, glb, gltf, usdz

DESCRIPTION = "name: a\ncategory: a\nfile: {}\nparts: {{all: {{match: ['*'], delta_t_k: 1, emissivity: 0.9}}}}\n"


@pytest.fixture(autouse=True)
def surroundings(monkeypatch, tmp_path):
    """Give each test its own cache and log, and a secret beside the folder of the model."""
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))
    (tmp_path / "model").mkdir()
    (tmp_path / "secret.txt").write_text("newmtl do-not-show-this\n")


def show(file):
    """Have the command line show a model of this file."""
    path = file.parent / "thing.yaml"
    path.write_text(DESCRIPTION.format(json.dumps(file.name)))
    return main(["models", "show", str(path), "--out", str(path.with_suffix(".png"))])


SECRET = "../secret.txt"
REFUSED = {
    "buffer.gltf": gltf(SECRET),
    "escaped.gltf": gltf("%2e%2e/secret.txt"),
    "backslash.gltf": gltf("..\\secret.txt"),
    "no-base64.gltf": gltf("data:/../../secret.txt"),
    "image.gltf": gltf(SECRET, "images"),
    "web.gltf": gltf("https://example.org/a.bin"),
    "nul.gltf": gltf("a\0b"),
    "absolute.glb": glb(gltf("/etc/passwd")),
    "image.glb": glb(gltf(SECRET, "images")),
    "nested.glb": glb(json.dumps({"extensions": {"E": {"lights": [{"uri": SECRET}]}}}).encode()),
    "text.glb": gltf(SECRET),
    "named.gltf": glb(gltf(SECRET)),
    "library.obj": b"v 0 0 0\n  mtllib ../secret.txt\n",
    "two.obj": b"mtllib a.mtl /etc/passwd\n",
    "continued.obj": b"mtllib \\\n../secret.txt\n",
    "quoted.obj": b'mtllib "../secret.txt"\r\n',
    "reference.usda": b'#usda 1.0\ndef "a" (references = @../secret.usda@</x>) {}',
    "long.usda": b'#usda 1.0\ndef "a" (payload = @@@/tmp/a@b.usda@@@) {}',
    "layer.usd": b"#usda 1.0\n(subLayers = [@./ok.usda@, @../secret.usd@:SDF_FORMAT_ARGS:a=b])",
    "inside.usda": b"#usda 1.0\n(subLayers = [@../package.usdz[a.usda]@])",
    "crate.usdc": crate(b"references", b"../secret.usdc", b"specifier"),
    "crate.usd": crate(b"subLayers and more", b"/etc/passwd"),
    "library.blend": blend(("Library", 1, {"filepath": "//../secret.blend"})),
    "cache.blend": blend(("MeshCacheModifierData", 1, {"filepath": "/tmp/secret.mdd"})),
    "alembic.blend": blend(("CacheFile", 1, {"filepath": "//../secret.abc"})),
    "points.blend": blend(("PointCache", 1, {"path": "/tmp"})),
    "windows.blend": blend(("Library", 1, {"filepath": "C:\\Users\\me\\secret.blend"})),
    "packed.blend": gzip.compress(blend(("Library", 1, {"filepath": "/a.blend"}))),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_reference_that_leaves_the_folder_is_refused_and_named(tmp_path, capsys, name):
    file = tmp_path / "model" / name
    file.write_bytes(REFUSED[name])
    assert show(file) == 2
    text = " ".join(capsys.readouterr().err.split())
    assert "outside of its folder" in text and name in text
    assert "do-not-show-this" not in text and "root:" not in text


OTHERWISE_REFUSED = {
    "clips.usda": (b'#usda 1.0\ndef "a" (clips = {string templateAssetPath = "../c.#.usd"}) {}', "value clips"),
    "clips.usdc": (crate(b"templateAssetPath"), "value clips"),
    "computed.usda": (b"#usda 1.0\n(subLayers = [@`'/etc' + '/x.usd'`@])", "computes the name"),
    "shader.usda": (b"#usda 1.0\n(subLayers = [@a.mtlx@])", "MaterialX"),
    "usd.blend": (blend(("CacheFile", 1, {"filepath": "//a.usd"})), "only Alembic caches"),
    "missing.blend": (blend(("Library", 1, {"filepath": "//none.blend"})), "which is missing"),
    "packed.blend": (blend(("Library", 1, {"filepath": "//a.blend", "packedfile": 7})), "packed library"),
    "nodes.blend": (blend(("ID", 1, {"name": "GeometryNodeImportOBJ"})), "geometry nodes read files"),
    "picture.blend": (
        blend(
            ("Image", 11, {"filepath": "//a.png", "source": 1}),
            ("Tex", 22, {"type": 8, "ima": 11}),
            ("DisplaceModifierData", 33, {"texture": 22}),
        ),
        "changes its shape",
    ),
    "big-endian.blend": (b"BLENDER-V279" + bytes(100), "big-endian"),
    "cut.blend": (blend(("ID", 1, {}))[:60], "cut off"),
    "no.blend": (b"nothing of the kind", "not a .blend"),
    "cut.glb": (glb(gltf("a.bin"))[:30], "cut off"),
    "no.usd": (b"nothing", "neither a USD text"),
    "cut.usdc": (crate(b"aaaaaaaaaaaaaaaaaaa")[:-8], "not a USD crate"),
}


@pytest.mark.parametrize("name", OTHERWISE_REFUSED)
def test_what_cannot_be_followed_is_refused(tmp_path, capsys, name):
    file = tmp_path / "model" / name
    data, reason = OTHERWISE_REFUSED[name]
    file.write_bytes(data)
    assert show(file) == 2
    assert reason in " ".join(capsys.readouterr().err.split())


def test_a_usd_package_must_contain_what_it_names(tmp_path, capsys):
    file = tmp_path / "model" / "a.usdz"
    usdz(file, "../../secret.usda")
    assert show(file) == 2
    assert "outside of its folder" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("kind", ["pipe", "folder", "link", "texture", "texture link"])
def test_a_material_library_must_be_a_regular_file_of_the_folder(tmp_path, capsys, kind):
    """A pipe as material library once made the import hang."""
    folder = tmp_path / "model"
    file, library = folder / "a.obj", folder / "a b.mtl"
    file.write_text("mtllib a b.mtl\nv 0 0 0\n")
    if kind == "pipe":
        os.mkfifo(library)
    elif kind == "folder":
        library.mkdir()
    elif kind == "link":
        library.symlink_to(tmp_path / "secret.txt")
    elif kind == "texture":
        library.write_text(f"newmtl a\nmap_Kd -s 1 1 1 -bm 0.2 {tmp_path / 'secret.txt'}\n")
    else:
        library.write_text("newmtl a\nbump tex.png\n")
        (folder / "tex.png").symlink_to("/dev/zero")
    assert show(file) == 2
    text = " ".join(capsys.readouterr().err.split())
    assert {"pipe": "no regular file", "folder": "no regular file", "texture": "secret.txt"}.get(kind, "link") in text


def test_large_files_are_refused_before_they_are_read(tmp_path, capsys):
    file = tmp_path / "model" / "a.obj"
    with file.open("wb") as stream:
        stream.truncate(3 * 2**30)
    assert show(file) == 2
    assert "too large" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["loop.obj", "pipe.obj", "a\0b.obj", "a" * 5000 + ".obj", "none.obj", "folder.obj"])
def test_a_3d_file_must_be_a_regular_file(tmp_path, capsys, name):
    folder = tmp_path / "model"
    (folder / "loop.obj").symlink_to("loop.obj")
    (folder / "folder.obj").mkdir()
    os.mkfifo(folder / "pipe.obj")
    (folder / "thing.yaml").write_text(DESCRIPTION.format(json.dumps(name)))
    assert main(["models", "show", str(folder / "thing.yaml"), "--out", str(tmp_path / "a.png")]) == 2
    assert "does not exist" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("instead", ["pipe", "endless", "folder"])
def test_a_description_must_be_a_regular_file(tmp_path, capsys, instead):
    description = tmp_path / "thing.yaml"
    if instead == "pipe":
        os.mkfifo(description)
    elif instead == "endless":
        description.symlink_to("/dev/zero")
    else:
        description.mkdir()
    assert main(["models", "show", str(description), "--out", str(tmp_path / "a.png")]) == 2
    assert "thing.yaml: cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["thing.yaml", "a.obj"])
@pytest.mark.parametrize("command", ["describe", "show"])
def test_a_link_out_of_the_folder_of_the_model_is_refused(tmp_path, capsys, name, command):
    folder = tmp_path / "model"
    (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "thing.yaml").write_text(DESCRIPTION.format("a.obj"))
    (folder / name).rename(tmp_path / name)
    (folder / name).symlink_to(tmp_path / name)
    more = ["--out", str(tmp_path / "a.png")] if command == "show" else []
    assert main(["models", command, str(folder / "thing.yaml"), *more]) == 2
    text = " ".join(capsys.readouterr().err.split())
    assert name in text and "a link out of its folder; expected a file inside it. Copy the file there" in text
