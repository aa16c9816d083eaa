"""Ways to damage radiometric JPEG files; `scripts/fuzz_flights.py` uses the same ten thousand times, outside CI."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from infrablend.errors import DatasetError
from infrablend.formats.cameras.header_facts import read_facts
from infrablend.formats.cameras.jpeg_segments import read_header
from infrablend.formats.cameras.raw_temperatures import read_temperatures
from infrablend.formats.pictures.images import load_background
from tests.fuzzing import TooSlow, bounded_memory, watched, with_size

Choice = random.Random
GIB = 1 << 30
SECONDS = 20
_EXTREMES = (0, 1, 2, 0x7F, 0x80, 0xFF)


def _header_bytes(data: bytes) -> int:
    """Return the length of the header: most damage to the picture behind it is invisible here."""
    at = data.find(b"\xff\xda")
    return at if at > 0 else len(data)


def _flip(data: bytes, choose: Choice) -> bytes:
    changed, end = bytearray(data), _header_bytes(data)
    for _ in range(choose.randint(1, 20)):
        changed[choose.randrange(end)] = choose.randrange(256)
    return bytes(changed)


def _extreme(data: bytes, choose: Choice) -> bytes:
    """Overwrite a number of 1 to 8 bytes near a signature with an extreme value."""
    marks = [
        b"FLIR\0",
        b"FFF\0",
        b"Exif\0\0",
        b"http://ns.adobe.com",
        b"\xff\xe3",
        b"\xff\xe1",
        b"\xff\xc0",
        b"\x89PNG",
    ]
    places = [at for m in marks if (at := data.find(m)) >= 0]
    at = min(len(data) - 8, choose.choice(places or [0]) + choose.randrange(120))
    size = choose.choice((1, 2, 4, 8))
    return data[:at] + bytes([choose.choice(_EXTREMES)] * size) + data[at + size :]


def _cut(data: bytes, choose: Choice) -> bytes:
    return data[: choose.choice((0, 1, 2, choose.randrange(_header_bytes(data)), choose.randrange(len(data))))]


def _insert(data: bytes, choose: Choice) -> bytes:
    at = choose.randrange(_header_bytes(data))
    piece = choose.choice(
        (b"\xff", b"\0" * 9, data[: choose.randint(0, 80)], choose.randbytes(30), b"\xff\xe1\xff\xff")
    )
    return data[:at] + piece + data[at:]


def _drop(data: bytes, choose: Choice) -> bytes:
    at = choose.randrange(_header_bytes(data))
    return data[:at] + data[at + choose.randint(1, 5000) :]


def _repeat(data: bytes, choose: Choice) -> bytes:
    at, size = choose.randrange(_header_bytes(data)), choose.randint(1, 70_000)
    return data[:at] + data[at : at + size] * 2 + data[at + size :]


def _swap(data: bytes, choose: Choice) -> bytes:
    one, two = sorted(choose.sample(range(_header_bytes(data)), 2))
    size = choose.randint(1, 64)
    return data[:one] + data[two : two + size] + data[one + size : two] + data[one : one + size] + data[two + size :]


def _giant(data: bytes, choose: Choice) -> bytes:
    try:
        return with_size(data, *choose.choice(((65_535, 65_535), (30_000, 30_000), (1, 65_535), (0, 0))))
    except ValueError:  # the frame header is gone already
        return data


def _word(data: bytes, choose: Choice) -> bytes:
    """Replace a value in the XMP packet."""
    start, end = data.find(b"<x:xmpmeta"), data.find(b"</x:xmpmeta>")
    if not 0 <= start < end:
        return data
    values = (b"nan", b"inf", b"-1e999", b"9" * 400, b"", b"&x;", b"\xff\xfe", b"<a>", b"+" * 9, b"\xd9\xa3", b"-90.0")
    quotes = [k for k in range(start, end) if data[k : k + 1] == b'"']
    at = choose.choice(quotes) + 1 if quotes else start
    return data[:at] + choose.choice(values) + data[at + choose.randint(0, 6) :]


def _doctype(data: bytes, choose: Choice) -> bytes:
    bomb = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
    outside = b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
    text = choose.choice((bomb, outside))
    start = data.find(b"<x:xmpmeta")
    return data[:start] + text + data[start + len(text) :] if start > 0 else data


MUTATIONS: tuple[Callable[[bytes, Choice], bytes], ...] = (
    _flip, _flip, _extreme, _extreme, _cut, _insert, _drop, _repeat, _swap, _giant, _word, _word, _doctype,
)  # fmt: skip


def damage(data: bytes, seed: int) -> tuple[bytes, str]:
    """Return the bytes of a file after one to four mutations, and their names."""
    choose = random.Random(seed)
    names = []
    for _ in range(choose.randint(1, 4)):
        kind = choose.choice(MUTATIONS)
        if len(data) > 16:
            data = kind(data, choose)
        names.append(kind.__name__.strip("_"))
    return data, ", ".join(names)


def exercise(path: Path, outside: Path, outcomes: Counter[str]) -> None:
    """Read header, facts, temperatures and picture of a damaged file; count what came out.

    Raises:
        Exception: Anything but a `DatasetError` with named problems; TooSlow after 20 s; MemoryError above 1 GiB.
    """
    with bounded_memory(GIB), watched(path.parent, outside, SECONDS) as seen:
        for name, read in (
            ("header", read_header), ("facts", read_facts), ("layer", read_temperatures), ("picture", load_background),
        ):  # fmt: skip
            try:
                result = read(path)
                if name == "layer":
                    _ = result.apparent_k  # type: ignore[attr-defined]
                codes = sorted({p.code for p in getattr(result, "problems", ())})
                outcomes[f"{name}: {', '.join(codes) or 'read'}"] += 1
            except DatasetError as error:
                assert error.problems and all(p.code and p.found for p in error.problems), error
                outcomes[f"{name}: {error.problems[0].code}"] += 1
    assert not seen, seen


__all__ = ["SECONDS", "TooSlow", "damage", "exercise"]
