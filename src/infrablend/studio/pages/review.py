"""The review of a run: a grid of its frames, one frame at a time by keyboard, and the labels that were lost."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, get_args
from urllib.parse import urlencode

from nicegui import ui
from nicegui.element import Element
from nicegui.events import KeyEventArguments

from infrablend.core.capture import TimeOfDay
from infrablend.core.frame_row import FrameRow, RemovedLabel
from infrablend.errors import DatasetError, InfraBlendError
from infrablend.pipeline.runs.review_file import Verdict
from infrablend.studio.frame_index import SORTS, View
from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.pages.layout import (
    error_text,
    frame_address,
    is_pressed,
    key_button,
    show_choice,
    show_table,
    tell,
    when_read,
)
from infrablend.studio.verdicts import REASONS

_WORDS = {"accept": "accepted", "reject": "rejected"}
_LIMITS = {"size_px": "Size, px", "visibility": "Visible share", "contrast": "Contrast, grey levels"}
_MOST_CROPS = 6
_LOSSES = {
    "covered": "covered completely by inserted objects",
    "category": "its class is not kept (labels.keep_categories)",
    "labels": "left out by the choice of labels.mode",
}
_MOST_LOSSES = 500


class FrameGrid(Element, component="components/frame_grid.js"):  # type: ignore[call-arg]
    """The grid of frames; it reads its rows from `source`."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self._props["source"] = source

    def show(self, source: str) -> None:
        """Show other rows."""
        self._props["source"] = source
        self.update()

    def set_address(self, address: str, *, new: bool) -> None:
        """Set the address of the page, as a new entry in the browser's history or in place of the current one."""
        self.run_method("address", address, new)


class ReviewPage:
    """The review in one browser tab."""

    def __init__(self, run: OpenedRun, query: Mapping[str, str]) -> None:
        """Build the page; `query` has the view, and `frame` the id of a frame to open."""
        self._run = run
        self._view = View.from_query(query)
        self._order: list[int] = []
        self._number: int | None = None
        self._shown: FrameRow | None = None
        self._labels = {"boxes": True, "originals": False}
        self._switches: dict[str, ui.switch] = {}
        self._advance = True
        self._list = ui.column().classes("w-full gap-2")
        with self._list:
            when_read(self._run, self._build_filters)
            self._counted = ui.label().props("role=status")
            self._count_frames()
            self._grid = FrameGrid(self._source())
            self._grid.on("open", lambda e: self._go_to(int(e.args["n"]), new=True))
            self._grid.on("moved", lambda e: self._follow(str(e.args["frame"])))
        self._detail = ui.column().classes("w-full gap-2")
        self._detail.set_visibility(False)
        ui.keyboard(self._key, ignore=["input", "select", "textarea"])
        if frame := query.get("frame"):
            self._follow(frame)

    # ---- the list

    def _build_filters(self) -> None:
        view = self._view
        classes = sorted({name for row in self._run.rows for name in row.classes})
        with ui.element("div").classes("studio-row"):
            sorts = {k: v for k, v in SORTS.items() if k != "disagreement" or self._run.evaluation is not None}
            self._select("Sort by", sorts, view.sort, "sort")
            ui.switch("Largest first", value=view.descending, on_change=lambda e: self._change(descending=e.value))
            options = {"": "Any class", **{name: name for name in classes}, "none": "No inserts"}
            self._select("Class", options, view.category, "category")
            times = {"": "Any time", **{t: t.capitalize() for t in (*get_args(TimeOfDay), "unknown")}}
            self._select("Time of day", times, view.time_of_day, "time_of_day")
            verdicts = {"": "Any verdict", "open": "Open", "accept": "Accepted", "reject": "Rejected"}
            self._select("Verdict", verdicts, view.verdict, "verdict")
            ui.switch("With warnings", value=view.warned, on_change=lambda e: self._change(warned=e.value))
            text = ui.input("Name contains", value=view.text, on_change=lambda e: self._change(text=e.value or ""))
            text.props("dense outlined debounce=250").classes("w-40")
            limits = {name: ends for name, *ends in view.limits}
            with (
                ui.expansion("Limits", value=bool(limits)).props("dense"),
                ui.element("div").classes("studio-row"),
            ):
                for name, title in _LIMITS.items():
                    for end, word in enumerate(("least", "most")):
                        box = ui.number(f"{title}, {word}", value=limits.get(name, (None, None))[end])
                        box.on_value_change(lambda e, n=name, k=end: self._limit(n, k, e.value))
                        box.props("dense outlined debounce=250").classes("w-44")

    def _select(self, title: str, options: Mapping[str, str], value: str, field: str) -> None:
        value = value if value in options else next(iter(options))
        show_choice(title, options, value, lambda v: self._change(**{field: v}), classes="min-w-32")

    def _limit(self, name: str, end: int, value: float | None) -> None:
        limits = {n: [low, high] for n, low, high in self._view.limits}
        limits.setdefault(name, [None, None])[end] = value
        self._change(limits=tuple((n, low, high) for n, (low, high) in limits.items() if (low, high) != (None, None)))

    def _change(self, **fields: Any) -> None:
        self._view = replace(self._view, **fields)
        self._grid.show(self._source())
        self._grid.set_address(self._address(), new=False)
        self._count_frames()

    def _source(self) -> str:
        return "/run/rows?" + urlencode(self._view.to_query())

    def _address(self) -> str:
        query = self._view.to_query()
        if self._number is not None and self._shown is not None:
            return frame_address("/review", self._shown.id, **query)
        return "/review?" + urlencode(query)

    def _count_frames(self) -> None:
        review = self._run.review
        reading = self._run.reading
        rows = reading.wait() if reading.is_complete else reading.names
        self._order = self._view.apply(rows, review.words, self._run.disagreement)
        counts = review.counts()
        self._counted.set_text(
            f"{len(self._order)} of {len(rows)} frames shown; {counts['accept']} accepted, {counts['reject']} rejected"
        )

    # ---- one frame

    def _go_to(self, number: int, *, new: bool = False) -> None:
        """Show a frame under its address, as a new entry in the browser's history if it was opened from the list."""
        self._show(number)
        if self._number == number:
            self._grid.set_address(self._address(), new=new)

    def _follow(self, frame_id: str) -> None:
        """Show what the address of the page names: a frame, or the list if there is no id."""
        ids = self._run.reading.ids
        if not frame_id:
            self._show_list()
        elif frame_id in ids:
            self._show(ids.index(frame_id))
        else:
            tell(DatasetError(f"{frame_id}: no such frame; the run has {len(ids)}, such as {', '.join(ids[:1])}"))

    def _show(self, number: int) -> None:
        try:
            row = self._run.row(number)
        except InfraBlendError as error:
            tell(error)
            return
        self._number = number
        self._shown = row
        self._list.set_visibility(False)
        self._detail.set_visibility(True)
        self._detail.clear()
        with self._detail:
            self._build_frame(number, row)

    def _build_frame(self, number: int, row: FrameRow) -> None:
        at = self._order.index(number) if number in self._order else None
        with ui.element("div").classes("studio-row"):
            key_button("All frames", self._back, "Esc")
            key_button("Previous", partial(self._step, -1), "\u2190")
            key_button("Next", partial(self._step, 1), "\u2192")
            if self._run.has_sequences:
                key_button("Play", self._play, "P")
            ui.label("" if at is None else f"{at + 1} of {len(self._order)}").classes("faint")
            for name, title, key in (("boxes", "Boxes", "B"), ("originals", "Original objects", "O")):
                self._switches[name] = ui.switch(title, value=self._labels[name]).tooltip(key)
                self._switches[name].bind_value_to(self._labels, name).on_value_change(self._redraw)
            ui.switch("Next after a verdict", value=self._advance).bind_value_to(self, "_advance")
        with ui.element("div").classes("frame-view"):
            with ui.element("div"):
                self._picture = ui.element("img").classes("picture")
                self._picture.props["alt"] = f"Frame {row.id}"
                self._picture.on("error", lambda: self._explain(number))
                self._problem = ui.label().classes("studio-error").props("role=alert")
                self._problem.set_visibility(False)
                self._set_picture(number, row)
            with ui.element("section").props('aria-label="Frame"').classes("studio-card"):
                self._build_verdict(number, row)
                self._build_facts(row)
        if at is not None:  # fetched ahead: the next picture then shows at once
            for near in self._order[at + 1 : at + 3]:
                with contextlib.suppress(InfraBlendError):  # the run has changed; the frame itself reports it
                    address = self._picture_address(near, self._run.row(near))
                    ui.element("link").props("rel=prefetch as=image").props["href"] = address

    def _build_verdict(self, number: int, row: FrameRow) -> None:
        ui.html("<h2>Verdict</h2>", sanitize=False)
        verdict = self._run.review.of(row.id)
        word = "none yet" if verdict is None else _WORDS[verdict.word]
        reason = f": {verdict.reason}" if verdict and verdict.reason else ""
        shown = ui.label(word + reason).classes("verdict").props("role=status")
        shown.props["data-verdict"] = "" if verdict is None else verdict.word
        shown.props["data-frame"] = row.id
        with ui.element("div").classes("studio-row"):
            key_button("Accept", partial(self._decide, Verdict("accept")), "A")
            key_button("Reject", partial(self._decide, Verdict("reject")), "R")
            key_button("Undo", self._undo, "U")
        ui.html("<h3>Reject because it is</h3>", sanitize=False)
        with ui.element("div").classes("studio-row"):
            for k, text in enumerate(REASONS, 1):
                key_button(text, partial(self._decide, Verdict("reject", text)), str(k))
        own = ui.input("Another reason").props("dense outlined").classes("w-full mt-2")
        own.on("keydown.enter", lambda: self._decide(Verdict("reject", (own.value or "").strip())))

    def _build_facts(self, row: FrameRow) -> None:
        seen = self._run.disagreement.get(row.image)
        facts = {
            "Name": row.id,
            "Inserts": ", ".join(row.classes) + (f" ({len(row.inserts)})" if row.inserts else "none"),
            "Smallest": _with_unit(row.size_px, "px"),
            "Visible": None if row.visibility is None else f"{100 * row.visibility:.0f} %",
            "Contrast": _with_unit(row.contrast, "grey levels"),
            "Pitch": _with_unit(row.pitch_deg, "\u00b0"),
            "Height": _with_unit(row.altitude_m, "m"),
            "Time": row.time_of_day,
            "Lost labels": str(len(row.removed)) if row.removed else None,
            "Detector": None if seen is None else f"{seen.missed} missed, {seen.false} false",
        }
        ui.html("<h3>Frame</h3>", sanitize=False)
        with ui.element("dl").classes("facts"):
            for name, value in facts.items():
                if value:
                    with ui.element("dt"):
                        ui.label(name)
                    with ui.element("dd"):
                        ui.label(value)
        for text in row.remarks:
            ui.label(text).classes("warn")
        if row.inserts:
            ui.html("<h3>Enlarged</h3>", sanitize=False)
            with ui.element("div").classes("crops"):
                for k in range(min(len(row.inserts), _MOST_CROPS)):
                    crop = ui.element("img")
                    crop.props["alt"] = f"Insert {k + 1}, enlarged"
                    crop.props["src"] = f"/run/crop/{self._number}/{k}.png?d={row.digest[:12]}"

    def _picture_address(self, number: int, row: FrameRow) -> str:
        labels = {name: int(on) for name, on in self._labels.items()}
        return f"/run/picture/{number}.png?" + urlencode({"d": row.digest[:12], **labels})

    def _explain(self, number: int) -> None:
        """Show in words why the picture of a frame cannot be shown."""
        try:
            self._run.picture(number, **self._labels)
        except InfraBlendError as error:
            self._problem.set_text(error_text(error))
            self._problem.set_visibility(True)
            self._picture.set_visibility(False)

    def _set_picture(self, number: int, row: FrameRow) -> None:
        self._problem.set_visibility(False)
        self._picture.set_visibility(True)
        self._picture.props["src"] = self._picture_address(number, row)
        self._picture.update()

    def _redraw(self) -> None:
        if self._number is not None:
            self._set_picture(self._number, self._run.row(self._number))

    def _toggle(self, name: str) -> None:
        self._switches[name].value = not self._labels[name]

    def _back(self) -> None:
        self._show_list()
        self._grid.run_method("leave", self._address())

    def _show_list(self) -> None:
        number = self._number
        self._number = None
        if number is None:
            return
        self._detail.clear()
        self._detail.set_visibility(False)
        self._list.set_visibility(True)
        self._count_frames()
        self._grid.run_method("load")
        self._grid.run_method("reveal", number)

    def _step(self, by: int) -> None:
        if self._number is None:
            return
        if self._number not in self._order:
            self._back()
            return
        at = self._order.index(self._number) + by
        if 0 <= at < len(self._order):
            self._go_to(self._order[at])

    def _play(self) -> None:
        if self._run.has_sequences and self._shown is not None:
            ui.navigate.to(frame_address("/sequences", self._shown.id))

    def _decide(self, verdict: Verdict) -> None:
        if self._number is None:
            return
        try:
            self._run.review.decide(self._frame_shown(self._number), verdict)
        except InfraBlendError as error:
            tell(error)
            return
        last = self._order[-1:] == [self._number]
        if self._advance and not last:
            self._step(1)
        else:
            self._go_to(self._number)
        ui.notify(f"{_WORDS[verdict.word]}{': ' + verdict.reason if verdict.reason else ''}", timeout=900)

    def _frame_shown(self, number: int) -> str:
        """Return the id of the frame that the page shows.

        Raises:
            DatasetError: Another command has changed the run since: a verdict would be on another picture.
        """
        row = self._run.row(number)
        if self._shown is None or (row.id, row.digest) != (self._shown.id, self._shown.digest):
            raise DatasetError("the frames of the run have changed since this page was opened. Reload the page")
        return row.id

    def _undo(self) -> None:
        try:
            frame_id = self._run.review.undo()
        except InfraBlendError as error:
            tell(error)
            return
        if frame_id is None:
            ui.notify("Nothing to undo")
            return
        ids = self._run.reading.ids
        if frame_id in ids:
            self._go_to(ids.index(frame_id))
        ui.notify(f"Undone: {frame_id}", timeout=900)

    def _key(self, event: KeyEventArguments) -> None:
        if not is_pressed(event) or self._number is None:
            return
        actions: dict[str, Callable[[], None]] = {
            "a": partial(self._decide, Verdict("accept")),
            "r": partial(self._decide, Verdict("reject")),
            "u": self._undo,
            "b": partial(self._toggle, "boxes"),
            "o": partial(self._toggle, "originals"),
            "p": self._play,
            "arrowright": partial(self._step, 1),
            "arrowleft": partial(self._step, -1),
            "escape": self._back,
            **{str(k): partial(self._decide, Verdict("reject", text)) for k, text in enumerate(REASONS, 1)},
        }
        if (action := actions.get(event.key.name.lower())) is not None:
            action()


def _with_unit(value: float | None, unit: str) -> str | None:
    return None if value is None else f"{value:.1f} {unit}".replace(".0 ", " ")


def show_losses(run: OpenedRun) -> None:
    """Show the original objects that lost their labels, each with the reason and a link to its frame."""
    found = [(row.id, loss) for row in run.rows for loss in row.removed]
    ui.html("<h2>Original labels that the run removed</h2>", sanitize=False)
    if not found:
        ui.label("No original object lost its label.")
        return
    counts = Counter(loss.reason for _, loss in found)
    for reason, count in counts.most_common():
        ui.label(f"{count} {_LOSSES.get(reason, reason)}")
    show_table(("Frame", "Class", "Reason", "Covered"), [_loss_cells(*one) for one in found[:_MOST_LOSSES]])
    if len(found) > _MOST_LOSSES:
        ui.label(f"and {len(found) - _MOST_LOSSES} more; run.json and the records of the frames have all").classes(
            "faint"
        )


def _loss_cells(frame_id: str, loss: RemovedLabel) -> list[str | tuple[str, str]]:
    link = (frame_id, frame_address("/review", frame_id))
    return [link, loss.category, _LOSSES.get(loss.reason, loss.reason), f"{100 * loss.covered_share:.0f} %"]
