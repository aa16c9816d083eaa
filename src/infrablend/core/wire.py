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
from collections.abc import Mapping
from typing import Any

import numpy as np

PROTOCOL = 1
"""Version of the messages; both sides must have the same."""

_LENGTH = struct.Struct("!Q")
_MOST_TEXT = 1 << 28


class Wire:
    """One end of the connection. The other end may close it at any time."""

    def __init__(self, end: socket.socket) -> None:
        """Send and receive on a connected stream socket, which belongs to this object from now on."""
        self._socket = end

    def send(self, message: Mapping[str, Any]) -> None:
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

    def receive(self, limit_s: float | None = None) -> dict[str, Any]:
        """Return the next message.

        Raises:
            EOFError: The other end is closed.
            TimeoutError: Nothing came within the limit.
        """
        self._socket.settimeout(limit_s)
        arrays: list[np.ndarray[Any, Any]] = []

        def made(value: dict[str, Any]) -> Any:
            if value.keys() != {"array", "shape"}:
                return value
            arrays.append(np.empty(value["shape"], np.dtype(value["array"])))
            return arrays[-1]

        (length,) = _LENGTH.unpack(self._fill(bytearray(_LENGTH.size)))
        if length > _MOST_TEXT:
            raise EOFError(f"a message of {length} bytes")
        message: dict[str, Any] = json.loads(bytes(self._fill(bytearray(length))), object_hook=made)
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
