"""Reads the properties of XMP packets: attributes and elements, standard and extended XMP.

`defusedxml` parses them, with document types forbidden altogether: XMP has none, and without them there are neither
entity bombs nor external entities. It is the parser that the VOC reader uses already.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from infrablend.errors import Problem
from infrablend.formats.cameras.jpeg_segments import APP1, JpegHeader, Segment

STANDARD = b"http://ns.adobe.com/xap/1.0/\0"
EXTENDED = b"http://ns.adobe.com/xmp/extension/\0"
# Cameras write a few KiB; extended XMP can hold whole pictures, which are of no use here.
MAX_BYTES = 1024 * 1024
MAX_ELEMENTS = 20_000
# What XML refuses, but readers of metadata pass over: a declaration behind the packet's header, and a bare `&`.
_DECLARATION = re.compile(rb"<\?xml\s[^>]*\?>")
_BARE = re.compile(rb"&(?!(?:amp|lt|gt|quot|apos|#\d{1,7}|#x[0-9A-Fa-f]{1,6});)")
_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_NOTE = "http://ns.adobe.com/xmp/note/"
_DESCRIPTION = f"{{{_RDF}}}Description"
_GUID_BYTES = 32

Name = tuple[str, str]
"""Namespace, always with the final slash that some programs leave out, and local name of a property."""


@dataclass(frozen=True)
class Xmp:
    """Properties of the XMP packets of one file.

    Attributes:
        values: Text of each simple property by namespace and local name; the first wins. Fields of a structure are
            called `Structure:Field`.
        problems: Faults, as warnings: the packets concerned are left out.
    """

    values: Mapping[Name, str] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()


def read_xmp(header: JpegHeader) -> Xmp:
    """Return the properties of a file's XMP packets."""
    where = header.path.name
    problems: list[Problem] = []
    values: dict[Name, str] = {}
    packets = header.find(APP1, STANDARD)
    extended = header.find(APP1, EXTENDED)
    if sum(s.length for s in packets) > MAX_BYTES:
        found = f"more than {MAX_BYTES // 1024} KiB of XMP"
        return Xmp({}, (_warning(where, "xmp-too-large", found),))
    if sum(s.length for s in extended) > MAX_BYTES:
        found = f"more than {MAX_BYTES // 1024} KiB of extended XMP"
        problems.append(_warning(where, "xmp-too-large", found))
        extended = ()
    for segment in packets:
        _add(values, header.read([segment], skip=len(STANDARD)), where, problems)
    guid = values.get((_NOTE, "HasExtendedXMP"))
    if extended and guid is not None:
        data, fault = _join(header, extended, guid)
        if fault:
            problems.append(_warning(where, "xmp-extended", fault))
        else:
            _add(values, data, where, problems)
    return Xmp(values, tuple(problems))


def _warning(where: str, code: str, found: str) -> Problem:
    return Problem(where, code, f"{found}; the packet is left out", "XMP as cameras write it", severity="warning")


def _join(header: JpegHeader, segments: Iterable[Segment], guid: str) -> tuple[bytes, str]:
    """Return the extended packet with this GUID, joined from its chunks in order, or the fault."""
    chunks: dict[int, bytes] = {}
    total = 0
    for segment in segments:
        data = header.read([segment], skip=len(EXTENDED))
        if len(data) < _GUID_BYTES + 8 or data[:_GUID_BYTES] != guid.encode("ascii", "replace"):
            continue
        total = int.from_bytes(data[_GUID_BYTES : _GUID_BYTES + 4], "big")
        chunks[int.from_bytes(data[_GUID_BYTES + 4 : _GUID_BYTES + 8], "big")] = data[_GUID_BYTES + 8 :]
    joined = bytearray()
    for offset, data in sorted(chunks.items()):
        if offset != len(joined):
            return b"", f"extended XMP with a chunk at {offset} where {len(joined)} was expected"
        joined += data
    if len(joined) != total:
        return b"", f"extended XMP of {len(joined)} bytes that says it has {total}"
    return bytes(joined), ""


def _add(values: dict[Name, str], data: bytes, where: str, problems: list[Problem]) -> None:
    # Some cameras pad the packet with zeros, and FLIR leaves one byte behind it.
    text = data.strip(b"\0 \t\r\n")
    try:
        try:
            root = fromstring(text, forbid_dtd=True)
        except ParseError:
            root = fromstring(_BARE.sub(b"&amp;", _DECLARATION.sub(b"", text)), forbid_dtd=True)
    except DefusedXmlException:
        found = "XMP with a document type or entities, which are refused"
        problems.append(_warning(where, "xmp-forbidden", found))
        return
    except (ParseError, ValueError, LookupError) as error:
        problems.append(_warning(where, "xmp-unreadable", f"XMP that is not XML ({error})"[:200]))
        return
    except RecursionError:
        problems.append(_warning(where, "xmp-unreadable", "XMP nested too deeply"))
        return
    for number, element in enumerate(root.iter(_DESCRIPTION)):
        if number >= MAX_ELEMENTS:
            problems.append(_warning(where, "xmp-too-large", f"more than {MAX_ELEMENTS} descriptions"))
            return
        for key, value in element.attrib.items():
            _put(values, key, value)
        for child in element:
            _put(values, child.tag, _text(child))
            for name, value in _fields(child):
                _put(values, f"{child.tag}:{name.rpartition('}')[2]}", value)


def _put(values: dict[Name, str], key: str, value: str | None) -> None:
    if value is not None and key.startswith("{") and not key.startswith(f"{{{_RDF}}}"):
        namespace, _, name = key[1:].partition("}")
        values.setdefault((namespace.rstrip("/") + "/", name), value.strip())


def _fields(element: Element) -> Iterator[tuple[str, str | None]]:
    """Yield name and text of each field of a structure, as attributes or elements, in a description or without one."""
    for node in (element, *element.findall(_DESCRIPTION)):
        yield from node.attrib.items()
        yield from ((field.tag, field.text) for field in node if not field.tag.startswith(f"{{{_RDF}}}"))


def _text(element: Element) -> str | None:
    """Return the text of a simple property or of the first item of a list; None for structures."""
    while len(element):
        inner = element[0]
        if not inner.tag.startswith(f"{{{_RDF}}}") or inner.tag == _DESCRIPTION:
            return None
        element = inner
    return element.text
