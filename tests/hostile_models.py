"""Writers of small 3D files that refer to other files, for tests of what an import may reach."""

import json
import struct
import zipfile
from pathlib import Path

import numpy as np


def gltf(uri: str, where: str = "buffers") -> bytes:
    return json.dumps({"asset": {"version": "2.0"}, where: [{"uri": uri, "byteLength": 4}]}).encode()


def glb(text: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text


def crate(*texts: bytes) -> bytes:
    """Return a USD crate that has only a table of texts, compressed with LZ4 as literals."""
    plain = b"".join(t + b"\0" for t in texts)
    extra = len(plain) - 15
    assert extra >= 0
    packed = b"\0\xf0" + b"\xff" * (extra // 255) + bytes([extra % 255]) + plain
    tokens = struct.pack("<QQQ", len(texts), len(plain), len(packed)) + packed
    toc = struct.pack("<Q16sqq", 1, b"TOKENS", 88 + 40, len(tokens))
    return b"PXR-USDC" + bytes([0, 8, 0]) + bytes(5) + struct.pack("<q", 88) + bytes(64) + toc + tokens


def usdz(path: Path, reference: str) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as package:
        package.writestr("parts/main.usda", f'#usda 1.0\ndef Xform "a" (references = @{reference}@) {{}}\n')


STRUCTS = {
    "ID": [("char", "name[66]")],
    "Library": [("ID", "id"), ("char", "filepath[1024]"), ("void", "*packedfile")],
    "MeshCacheModifierData": [("char", "filepath[1024]")],
    "CacheFile": [("char", "filepath[1024]")],
    "PointCache": [("char", "path[1024]")],
    "Image": [("ID", "id"), ("char", "filepath[1024]"), ("void", "*packedfile"), ("short", "source")],
    "Tex": [("ID", "id"), ("short", "type"), ("Image", "*ima")],
    "DisplaceModifierData": [("Tex", "*texture")],
}
SIZES = {"char": 1, "short": 2, "void": 0}


def _size(kind: str, name: str) -> int:
    items = int(name.split("[")[1][:-1]) if "[" in name else 1
    own = SIZES[kind] if kind in SIZES else sum(_size(*field) for field in STRUCTS[kind])
    return 8 if name.startswith("*") else own * items


def blend(*blocks: tuple[str, int, dict[str, str | int]]) -> bytes:
    """Return a .blend with blocks of (structure, address, values)."""
    types = [*SIZES, *STRUCTS]
    names = sorted({n for fields in STRUCTS.values() for _, n in fields})
    texts = [b"SDNANAME" + struct.pack("<I", len(names)), *(n.encode() + b"\0" for n in names)]
    out = b"".join(texts)
    out += bytes(-len(out) % 4) + b"TYPE" + struct.pack("<I", len(types)) + b"".join(t.encode() + b"\0" for t in types)
    lengths = [SIZES[t] if t in SIZES else _size(t, "") for t in types]
    out += bytes(-len(out) % 4) + b"TLEN" + struct.pack(f"<{len(types)}H", *lengths)
    out += bytes(-len(out) % 4) + b"STRC" + struct.pack("<I", len(STRUCTS))
    for struct_name, fields in STRUCTS.items():
        out += struct.pack("<HH", types.index(struct_name), len(fields))
        out += b"".join(struct.pack("<HH", types.index(k), names.index(n)) for k, n in fields)
    data = b"BLENDER-v405"
    for name, address, values in blocks:
        content = b""
        for kind, field in STRUCTS[name]:
            value, size = values.get(field.strip("*").split("[")[0], 0), _size(kind, field)
            content += value.encode().ljust(size, b"\0") if isinstance(value, str) else value.to_bytes(size, "little")
        data += struct.pack("<4sIQII", b"DATA", len(content), address, list(STRUCTS).index(name), 1) + content
    data += struct.pack("<4sIQII", b"DNA1", len(out), 0, 0, 1) + out
    return data + struct.pack("<4sIQII", b"ENDB", 0, 0, 0, 0)


def write_gltf(folder: Path, size: float, uri: str = "thing.bin") -> None:
    """Write a tetrahedron whose size is in the buffer beside the .gltf alone."""
    corners = size * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float32)
    triangles = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], np.uint16)
    (folder / "thing.bin").write_bytes(corners.tobytes() + triangles.tobytes())
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "Body", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"uri": uri, "byteLength": corners.nbytes + triangles.nbytes}],
        "bufferViews": [
            {"buffer": 0, "byteLength": corners.nbytes},
            {"buffer": 0, "byteOffset": corners.nbytes, "byteLength": triangles.nbytes},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
    }
    (folder / "thing.gltf").write_text(json.dumps(content))
