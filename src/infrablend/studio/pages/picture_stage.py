"""The picture of a frame with handles, a brush, or a path over it."""

from __future__ import annotations

from typing import TypedDict

from nicegui.element import Element


class Mark(TypedDict):
    """A handle: number and class of its insert, its box, and where its origin is, pixels."""

    n: int
    name: str
    box: list[float]
    origin: tuple[float, float]


class Stage(Element, component="components/stage.js"):  # type: ignore[call-arg]
    """The picture, with a handle on each insert, or a brush over it."""

    def __init__(self, alt: str) -> None:
        super().__init__()
        self._props.update(source="", alt=alt, marks=[], size=[1, 1], pen=0, path=None)

    def show(self, source: str, marks: list[Mark], size_wh: tuple[int, int], pen_px: int) -> None:
        """Show a picture of a frame of this size; 0 px is no brush."""
        self._props.update(source=source, marks=marks, size=list(size_wh), pen=pen_px)
        self.update()

    def draw(self, path: list[list[float]] | None) -> None:
        """Show a path whose points can be added, moved and deleted; None for none."""
        self._props["path"] = path
        self.update()
