"""Lists of frames that a number or a bar of the report leads to.

A list has an anchor; the page's style hides all other frames when the anchor is the target of a link, so that the page
works without scripts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Filter:
    """A list of frames.

    Attributes:
        name: Anchor, and class of its frames in the page.
        title: What the frames have in common.
        frames: Numbers of the frames, ascending.
    """

    name: str
    title: str
    frames: tuple[int, ...]


class Filters:
    """All lists of frames of a page."""

    def __init__(self) -> None:
        """Start without any list."""
        self.all: list[Filter] = []

    def add(self, title: str, frames: Iterable[int]) -> str:
        """Add a list of frames and return the link to it; empty without frames."""
        found = tuple(sorted(set(frames)))
        if not found:
            return ""
        name = f"f{len(self.all)}"
        self.all.append(Filter(name, title, found))
        return f"#{name}"

    def classes(self, count: int) -> list[list[str]]:
        """Return for each of `count` frames the names of its lists."""
        found: list[list[str]] = [[] for _ in range(count)]
        for one in self.all:
            for k in one.frames:
                found[k].append(one.name)
        return found
