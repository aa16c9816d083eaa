"""The path of a moving object, drawn over the picture, with the times and distances of its points."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, TypedDict

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from infrablend.core.yaml_text import read_yaml
from infrablend.studio.pages.layout import show_choice
from infrablend.studio.pages.object_inputs import Input
from infrablend.studio.recipe_form import Point, path_of, with_path, with_point


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


class PathEditor:
    """The path of one kind of object, as the field `motion` of the form has it."""

    def __init__(self, inputs: Mapping[str, Input], size_wh: Callable[[], tuple[int, int]]) -> None:
        """Show the choice of the object whose path is drawn.

        Args:
            inputs: Inputs of the form by their field.
            size_wh: Returns the size of the picture, px.
        """
        self._inputs = inputs
        self._size_wh = size_wh
        self._choice = show_choice("Path", {"": "None"}, "", lambda _: self._show(), classes="min-w-24")

    def show_points(self, stage: Stage) -> None:
        """Show the points below the picture in which they are drawn."""
        self._stage = stage
        stage.on("add", lambda e: self._set(with_point(self._read(), float(e.args["x"]), float(e.args["y"]))))
        stage.on("point", self._change)
        self._points = ui.element("div").classes("studio-card tune-points")

    def offer(self, kinds: Iterable[str]) -> None:
        """Offer the kinds of objects that may have a path."""
        names = {k: f"objects {k}" for k in kinds}
        chosen = self._choice.value if self._choice.value in names else ""
        self._choice.set_options({"": "None", **names}, value=chosen)
        self._choice.set_visibility(bool(names))
        self._show()

    def _read(self) -> list[Point]:
        return path_of(self._motion())

    def _motion(self) -> Any:
        """Return the motion in the form of the object whose path is drawn; None for none, and for what is no YAML."""
        made = self._inputs.get(f"objects.{self._choice.value}.motion")
        try:
            return None if made is None else read_yaml(made.shown[0].value or "")
        except ValueError:
            return None

    def _set(self, points: Sequence[Point], *, again: bool = True) -> None:
        motion = with_path(self._motion(), points)
        self._inputs[f"objects.{self._choice.value}.motion"].shown[0].value = (
            "" if motion is None else json.dumps(motion)
        )
        if again:
            self._show()

    def _change(self, event: GenericEventArguments) -> None:
        """Move or delete the point that an event names."""
        points = self._read()
        given = event.args
        number = int(given["k"])
        if number >= len(points):
            return
        if given.get("remove"):
            del points[number]
        else:
            points[number] |= {"x_px": round(float(given["x"]), 1), "y_px": round(float(given["y"]), 1)}
        self._set(points)

    def _show(self) -> None:
        """Show the path in the picture, and times and distances of its points below it."""
        drawn = self._choice.value != ""
        points = self._read()
        self._points.set_visibility(drawn)
        self._stage.draw([[p["x_px"], p["y_px"]] for p in points] if drawn else None)
        self._points.clear()
        if not drawn:
            return
        motion = self._motion()
        with self._points:
            if not points and isinstance(motion, dict) and motion.get("path"):
                ui.label("This path is not in the picture: change it in the field motion.")
                self._stage.draw(None)
                return
            ui.label(
                "Click in the first picture of the sequence to add points; drag them, or focus one and use the arrow "
                "keys and Delete."
            )
            for number, point in enumerate(points):
                with ui.element("div").classes("studio-row"):
                    for key, name in (("time_s", "time, s"), ("range_m", "distance, m")):
                        box = ui.number(f"point {number + 1}, {name}", value=point.get(key), min=0)
                        box.props("dense outlined debounce=400").classes("tune-end")
                        box.on_value_change(lambda e, n=number, k=key: self._set_number(n, k, e.value))
            width, height = self._size_wh()
            add = partial(with_point, points, width / 2, height / 2)
            ui.button("Add a point in the middle", on_click=lambda: self._set(add())).props("no-caps outline dense")

    def _set_number(self, number: int, key: str, value: float | None) -> None:
        points = self._read()
        if number < len(points) and (value is not None or key == "range_m"):
            points[number] |= {key: value}
            # The inputs stay while one is typed in, unless the order of the points changes.
            in_order = all(a["time_s"] < b["time_s"] for a, b in itertools.pairwise(points))
            self._set(points, again=not in_order)
