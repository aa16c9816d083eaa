"""MAT files: the workspace of objects is what scipy reads, and damage gives a named error."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.formats.published.halmstad import object_workspace
from tests.videos import write_ground_truth

BOXES = [(1.0, 2.0, 30.0, 40.0), None, (5.5, 6.5, 7.0, 8.0)]


def variable(name: bytes, content: bytes) -> bytes:
    """Return a variable of bytes; names of one to four bytes are in the tag, as MATLAB writes them."""

    def element(kind: int, payload: bytes) -> bytes:
        return struct.pack("<II", kind, len(payload)) + payload + bytes(-len(payload) % 8)

    short = struct.pack("<HH4s", 1, len(name), name) if 0 < len(name) <= 4 else element(1, name)
    shape = element(5, struct.pack("<ii", 1, len(content)))
    return element(14, element(6, struct.pack("<II", 9, 0)) + shape + short + element(2, content))


def mat_file(*variables: bytes, compressed: bool) -> bytes:
    head = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<HH", 0x0100, 0x4D49)
    if compressed:
        packed = [zlib.compress(v) for v in variables]
        return head + b"".join(struct.pack("<II", 15, len(p)) + p for p in packed)
    return head + b"".join(variables)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("name", [b"abc", b"gTruth"])
def test_workspace_is_what_scipy_reads(compressed: bool, name: bytes) -> None:
    loadmat = pytest.importorskip("scipy.io").loadmat
    workspace = bytes(range(1, 78))
    data = mat_file(variable(name, b"123"), variable(b"", workspace), compressed=compressed)
    assert object_workspace(data) == workspace == loadmat(io.BytesIO(data))["__function_workspace__"].tobytes()


def test_boxes_of_a_file_are_decoded(tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcos_decoder")
    data = write_ground_truth(tmp_path / "a.mat", BOXES).read_bytes()
    assert decoder.extract_bboxes(object_workspace(data)) == BOXES


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "level 5"),
        (b"MATLAB 7.3".ljust(200), "level 5"),
        (mat_file(variable(b"a", b"1"), compressed=False), "no variable"),
        (mat_file(variable(b"", b"1"), compressed=False)[:-4], "bytes where"),
        (mat_file(compressed=False) + struct.pack("<II", 15, 8) + bytes(8), "compression"),
        (mat_file(compressed=False) + struct.pack("<II", 9, 8) + bytes(8), "type 9"),
    ],
)
def test_damaged_files_are_named(data: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        object_workspace(data)


@given(st.data())
def test_any_damage_gives_a_value_error_or_a_result(data: st.DataObject) -> None:
    whole = bytearray(mat_file(variable(b"a", b"12"), variable(b"", bytes(40)), compressed=data.draw(st.booleans())))
    for _ in range(data.draw(st.integers(0, 6))):
        whole[data.draw(st.integers(116, len(whole) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(ValueError):
        object_workspace(bytes(whole[: data.draw(st.integers(0, len(whole)))]))
