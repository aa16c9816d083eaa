"""Composes JSON text piece by piece, so that a long list in it never has to be in memory as a whole."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from infrablend.core.files import finite

COMPACT = (",", ":")
SPACED = (", ", ": ")
"""Separators of items and of keys: without blanks, and those that `json.dumps` uses unless told otherwise."""


@dataclass(frozen=True)
class Streamed:
    """List whose items are composed one at a time.

    Attributes:
        items: The items, iterated once.
    """

    items: Iterable[Any]


def json_chunks(
    value: Any, losses: Counter[str] | None, *, separators: tuple[str, str] = COMPACT, sort_keys: bool = True
) -> Iterator[str]:
    """Yield the text that `json.dumps` would return, in pieces of one item of a streamed list each.

    Args:
        value: JSON values, with `Streamed` lists at the top or as values of a top-level object.
        losses: Counts non-finite numbers, which are written as null, see `finite`; None refuses them.
        separators: Separators of items and of keys.
        sort_keys: Whether to sort the keys of objects; otherwise they keep their order.

    Raises:
        ValueError: A number is not finite, and `losses` is None.
    """

    def text(part: Any) -> str:
        try:
            return json.dumps(part, sort_keys=sort_keys, allow_nan=False, separators=separators)
        except ValueError:
            if losses is None:
                raise
        return json.dumps(finite(part, losses), sort_keys=sort_keys, allow_nan=False, separators=separators)

    if isinstance(value, Streamed):
        yield "["
        for n, item in enumerate(value.items):
            yield (separators[0] if n else "") + text(item)
        yield "]"
    elif isinstance(value, Mapping):
        yield "{"
        for n, key in enumerate(sorted(value) if sort_keys else value):
            yield (separators[0] if n else "") + json.dumps(key) + separators[1]
            if isinstance(value[key], Streamed):
                yield from json_chunks(value[key], losses, separators=separators, sort_keys=sort_keys)
            else:
                yield text(value[key])
        yield "}"
    else:
        yield text(value)
