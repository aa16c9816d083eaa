"""The comparison of two runs or recipes: the frames that differ most, side by side or with a divider between them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal
from urllib.parse import urlencode

from nicegui import app, run, ui
from nicegui.element import Element
from nicegui.events import KeyEventArguments
from starlette.requests import Request
from starlette.responses import Response

from infrablend.core.frame_row import FrameRow
from infrablend.errors import InfraBlendError
from infrablend.studio.comparison import MEASURES, SORTS, Comparison, FramePair, PairView
from infrablend.studio.frame_index import value_of
from infrablend.studio.pages.layout import is_pressed, key_button, show_choice, show_error, show_table, when_read
from infrablend.studio.pages.routes import KEEP, answered

_SIDES = ("a", "b")


def add_routes(comparison: Comparison) -> None:
    """Add the routes below `/compare/`. Frames are named by number, so that no path comes from a request."""

    @app.get("/compare/pairs")
    def pairs(request: Request) -> Response:
        def answer() -> bytes:
            found = comparison.pairs()
            chosen = PairView.from_query(dict(request.query_params)).apply(found)
            return json.dumps([(n, found[n].id, change_text(found[n])) for n in chosen]).encode()

        return answered(answer, "application/json", {"cache-control": "no-store"})

    @app.get("/compare/{side}/picture/{number}.png")
    def picture(side: Literal["a", "b"], number: int, boxes: bool = False, originals: bool = False) -> Response:
        def answer() -> bytes:
            return comparison.picture(_SIDES.index(side), number, boxes=boxes, originals=originals)

        return answered(answer, "image/png", KEEP)


def change_text(pair: FramePair) -> str:
    """Return what differs between two frames, in words."""
    if pair.a is None or pair.b is None:
        return ""
    if pair.same:
        return "same picture"
    words = []
    for name, change in pair.changes.items():
        if name == "inserted":
            words.append(f"{change:+.0f} insert{'' if abs(change) == 1 else 's'}")
        elif name == "size_px":
            words.append(f"size \u00d7 {2**change:.2f}")
        elif name == "visibility":
            words.append(f"visible {100 * change:+.0f} %")
        else:
            words.append(f"contrast {change:+.0f}")
    if pair.same is None and not words:
        return "not drawn yet"
    return ", ".join(words) or "other pixels only"


class PairList(Element, component="components/pair_list.js"):  # type: ignore[call-arg]
    """The list of frames; it reads its lines from `source`."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self._props.update(source=source, chosen=-1)

    def show(self, **props: Any) -> None:
        """Show other lines, or another chosen one."""
        self._props.update(props)
        self.update()


class Wipe(Element, component="components/wipe.js"):  # type: ignore[call-arg]
    """Two pictures with a divider."""

    def __init__(self, first: str, second: str, names: tuple[str, str]) -> None:
        super().__init__()
        self._props.update(a=first, b=second, names=list(names))


class ComparePage:
    """The comparison in one browser tab."""

    def __init__(self, comparison: Comparison) -> None:
        """Build the page once all records are read.

        The frames that differ most come first; those of recipes are known once they are drawn.
        """
        self._comparison = comparison
        self._view = PairView(sort="difference" if comparison.runs else "id")
        self._shown: int | None = None
        self._wipe = True
        self._labels = {"boxes": True, "originals": False}
        self._wait_for(list(comparison.runs))

    def _wait_for(self, runs: list[Any]) -> None:
        if runs:
            when_read(runs[0], lambda: self._wait_for(runs[1:]))
        else:
            self._build()

    def _build(self) -> None:
        first, second = self._comparison.names
        pairs = self._comparison.pairs()
        ui.html("<h2>Compare</h2>", sanitize=False)
        ui.label(f"A: {first} \u00a0 B: {second}")
        ui.label(_count_text(pairs)).props("role=status")
        with ui.element("div").classes("compare-view"):
            with ui.element("section").props('aria-label="Frames"').classes("studio-card compare-frames"):
                self._build_list(pairs)
            with ui.element("section").props('aria-label="Pictures"').classes("compare-pictures"):
                self._build_switches()
                self._place = ui.element("div").classes("w-full")
        ui.keyboard(self._key, ignore=["input", "select", "textarea"])
        chosen = self._view.apply(pairs) or PairView(side="a").apply(pairs) or PairView(side="b").apply(pairs)
        if chosen:
            self._choose(chosen[0])

    def _build_list(self, pairs: list[FramePair]) -> None:
        counts = Counter("b" if p.a is None else "a" if p.b is None else "both" for p in pairs)
        sides = {
            "both": f"In both ({counts['both']})", "a": f"Only in A ({counts['a']})", "b": f"Only in B ({counts['b']})",
        }  # fmt: skip
        with ui.element("div").classes("studio-row"):
            if self._comparison.runs:
                self._select("Frames", sides, self._view.side, "side")
            self._select("Largest change first", SORTS, self._view.sort, "sort")
            text = ui.input("Name contains", on_change=lambda e: self._change(text=e.value or ""))
            text.props("dense outlined debounce=250").classes("w-full")
            ui.switch("Leave out equal pictures", on_change=lambda e: self._change(changed=e.value))
        self._list = PairList(self._source())
        self._list.on("open", lambda e: self._choose(int(e.args["n"])))

    def _select(self, title: str, options: Mapping[str, str], value: str, name: str) -> None:
        show_choice(title, options, value, lambda v: self._change(**{name: v}), classes="w-full")

    def _build_switches(self) -> None:
        with ui.element("div").classes("studio-row"):
            key_button("Previous", lambda: self._list.run_method("step", -1), "P")
            key_button("Next", lambda: self._list.run_method("step", 1), "N")
            divider = ui.switch("Divider", value=self._wipe).bind_value_to(self, "_wipe").tooltip("W")
            divider.on_value_change(self._redraw)
            for name, title in (("boxes", "Boxes"), ("originals", "Original objects")):
                shown = ui.switch(title, value=self._labels[name]).bind_value_to(self._labels, name)
                shown.on_value_change(self._redraw)

    def _source(self) -> str:
        return "/compare/pairs?" + urlencode(self._view.to_query())

    def _change(self, **fields: Any) -> None:
        self._view = replace(self._view, **fields)
        self._list.show(source=self._source())

    def _choose(self, number: int) -> None:
        self._shown = number
        self._list.show(chosen=number)
        self._redraw()

    def _redraw(self) -> None:
        ui.timer(0.001, self._show, once=True)

    async def _show(self) -> None:
        number = self._shown
        if number is None:
            return
        pair = self._comparison.pairs()[number]
        try:
            rows = await run.io_bound(self._comparison.rows, pair)
        except InfraBlendError as error:
            self._place.clear()
            with self._place:
                show_error(error)
            return
        if number != self._shown:
            return
        if pair.same is None and None not in (pair.a, pair.b):
            self._list.run_method("load")  # what differs is known now
        self._place.clear()
        with self._place:
            self._build_pictures(pair, rows)
            show_table(("", "A", "B"), [[title, *values] for title, values in _facts(rows)])

    def _build_pictures(self, pair: FramePair, rows: tuple[FrameRow | None, FrameRow | None]) -> None:
        ui.label(pair.id).classes("verdict").props("role=status")
        sources = [
            None if n is None or row is None else self._address(side, n, row)
            for side, n, row in zip(_SIDES, (pair.a, pair.b), rows, strict=True)
        ]
        first, second = sources
        if first is not None and second is not None and self._wipe:
            Wipe(first, second, self._comparison.names)
            return
        with ui.element("div").classes("compare-sides"):
            for letter, name, source in zip("AB", self._comparison.names, sources, strict=True):
                with ui.element("figure"):
                    if source is None:
                        ui.label(f"{letter} does not have this frame.").classes("frame-grid-note")
                    else:
                        picture = ui.element("img").classes("picture")
                        picture.props["alt"], picture.props["src"] = f"{pair.id} in {name}", source
                    with ui.element("figcaption").classes("faint"):
                        ui.label(f"{letter}: {name}")

    def _address(self, side: str, number: int, row: FrameRow) -> str:
        words = {"d": row.digest[:12], **{k: int(v) for k, v in self._labels.items()}}
        return f"/compare/{side}/picture/{number}.png?{urlencode(words)}"

    def _key(self, event: KeyEventArguments) -> None:
        step = {"n": 1, "p": -1}.get(event.key.name.lower())
        if step is not None and is_pressed(event):
            self._list.run_method("step", step)


def _count_text(pairs: list[FramePair]) -> str:
    both = [p for p in pairs if p.a is not None and p.b is not None]
    same = sum(bool(p.same) for p in both)
    only = [sum(p.b is None for p in pairs), sum(p.a is None for p in pairs)]
    return f"{len(both)} frames in both, {same} with equal pictures; {only[0]} only in A, {only[1]} only in B"


def _facts(rows: tuple[FrameRow | None, FrameRow | None]) -> list[tuple[str, list[str]]]:
    found = [("Frame", ["-" if row is None else row.id for row in rows])]
    for name, title in MEASURES.items():
        values = [None if row is None else value_of(row, name) for row in rows]
        found.append((title, [_value_text(name, value) for value in values]))
    found.append(("Classes", ["-" if row is None else ", ".join(row.classes) or "none" for row in rows]))
    found.append(("Warnings", ["-" if row is None else "; ".join(row.remarks) or "none" for row in rows]))
    return found


def _value_text(name: str, value: float | None) -> str:
    if value is None:
        return "-"
    if name == "visibility":
        return f"{100 * value:.0f} %"
    unit = {"size_px": " px", "contrast": " grey levels"}.get(name, "")
    return f"{value:.1f}{unit}" if unit else f"{value:.0f}"
