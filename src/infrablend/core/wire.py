"""Messages of plain values and NumPy arrays over a socket, between this program and Blender's process.

The two may run different versions of Python and NumPy, so nothing is pickled. A message is a JSON text, in which each
array is named by its type and shape, followed by the bytes of the arrays in the order of the text.

Standard library and NumPy only: Blender's Python has nothing else.
"""

from __future__ import annotations

import contextlib
import json
import socket
import struct
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

PROTOCOL = 1
"""Version of the messages; both sides must have the same."""

Message = Mapping[str, Any]
"""A message that arrived: what the other end sent, unchecked, as both ends are of one version."""


class CameraMessage(TypedDict):
    """A camera: `position_m` (3,), and `world_to_camera` (3, 3), whose third row looks ahead and second row down."""

    position_m: NDArray[np.float64]
    world_to_camera: NDArray[np.float64]
    sensor_width_mm: float
    focal_length_mm: float
    size_wh: tuple[int, int]
    clip_m: tuple[float, float]


class ObjectMessage(TypedDict):
    """An inserted object: its surface (V, 3), (T, 3), (T,), and what renders it.

    `slot` is the number of the pass for its coverage; `values` (3T,) are at the face corners, by the name of the
    attribute, and `properties` are of the object; `blender.materials.object_material` lists both.
    """

    slot: int
    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]
    smooth: NDArray[np.bool_]
    values: Mapping[str, NDArray[np.float32]]
    properties: Mapping[str, float]
    translucent: bool
    two_sided: bool


class SceneMessage(TypedDict):
    """A scene of inserted objects.

    `what` is for errors; each of `crops` is x0, y0, x1, y1 in pixels; `cycles` are settings by name; `sky` is what
    surfaces mirror, see `blender.physical.set_world`, or None in the artistic look.
    """

    what: str
    camera: CameraMessage
    crops: Sequence[tuple[int, int, int, int]]
    cycles: Mapping[str, object]
    sky: Mapping[str, float] | None
    objects: Sequence[ObjectMessage]


class ModelFileMessage(TypedDict):
    """A 3D file to read: `shown`, its name in messages; `known`, the files that its digest covers; limits."""

    file: str
    shown: str
    known: Sequence[str]
    memory_bytes: int
    cpu_seconds: int


_LENGTH = struct.Struct("!Q")
_MOST_TEXT = 1 << 28


class Wire:
    """One end of the connection. The other end may close it at any time."""

    def __init__(self, end: socket.socket) -> None:
        """Send and receive on a connected stream socket, which belongs to this object from now on."""
        self._socket = end

    def send(self, message: Mapping[str, object]) -> None:
        """Send a message: JSON values and arrays of numbers.

        Raises:
            OSError: The other end is closed.
        """
        arrays: list[np.ndarray[Any, Any]] = []

        def named(value: Any) -> Any:
            if not isinstance(value, np.ndarray):
                raise TypeError(f"a message contains {type(value).__name__}; expected JSON values and arrays")
            arrays.append(np.ascontiguousarray(value))
            return {"array": value.dtype.str, "shape": value.shape}

        text = json.dumps(message, default=named).encode()
        self._socket.sendall(_LENGTH.pack(len(text)) + text)
        for array in arrays:
            if array.size:
                self._socket.sendall(array.data.cast("B"))

    def receive(self, limit_s: float | None = None) -> Message:
        """Return the next message.

        Raises:
            EOFError: The other end is closed.
            TimeoutError: Nothing came within the limit.
        """
        self._socket.settimeout(limit_s)
        arrays: list[np.ndarray[Any, Any]] = []

        def made(value: dict[str, Any]) -> object:
            if value.keys() != {"array", "shape"}:
                return value
            arrays.append(np.empty(value["shape"], np.dtype(value["array"])))
            return arrays[-1]

        (length,) = _LENGTH.unpack(self._fill(bytearray(_LENGTH.size)))
        if length > _MOST_TEXT:
            raise EOFError(f"a message of {length} bytes")
        message: Message = json.loads(bytes(self._fill(bytearray(length))), object_hook=made)
        for array in arrays:
            if array.size:
                self._fill(array.data.cast("B"))
        return message

    def close(self) -> None:
        """Close the connection, which ends the other end's wait."""
        with contextlib.suppress(OSError):
            self._socket.close()

    def _fill(self, buffer: bytearray | memoryview) -> bytearray | memoryview:
        view = memoryview(buffer)
        done = 0
        while done < len(view):
            try:
                count = self._socket.recv_into(view[done:])
            except TimeoutError:
                raise
            except OSError as error:
                raise EOFError(str(error)) from error
            if not count:
                raise EOFError("the connection was closed")
            done += count
        return buffer
