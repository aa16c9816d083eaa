"""Writers of small 3D files, for tests of users' models."""

import json
import struct
from pathlib import Path

import numpy as np


def gltf(uri: str) -> bytes:
    """Return a glTF that refers to one buffer and has no surface."""
    return json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 4}]}).encode()


def glb(text: bytes) -> bytes:
    """Return the binary form of a glTF, without a buffer of its own."""
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text


def write_gltf(folder: Path, size: float) -> None:
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
        "buffers": [{"uri": "thing.bin", "byteLength": corners.nbytes + triangles.nbytes}],
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
