"""The review of detections: one at a time by keyboard, highest score first."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import app, ui
from nicegui.events import KeyEventArguments
from starlette.responses import Response

from infrablend.errors import InfraBlendError
from infrablend.pipeline.runs.review_file import Verdict
from infrablend.studio.opened_detections import OpenedDetections
from infrablend.studio.pages.layout import is_pressed, key_button, show_choice, tell
from infrablend.studio.pages.routes import KEEP, answered

_MOST_CLASSES = 9
_VERDICTS = {"": "Any verdict", "open": "Open", "accept": "Accepted", "reject": "Rejected"}


def add_routes(opened: OpenedDetections) -> None:
    """Add the routes below `/found/`."""

    @app.get("/found/picture/{number}.png")
    def picture(number: int) -> Response:
        return answered(lambda: opened.picture(number), "image/png", KEEP)

    @app.get("/found/crop/{number}.png")
    def crop(number: int) -> Response:
        return answered(lambda: opened.crop(number), "image/png", KEEP)


class DetectionsPage:
    """The review in one browser tab."""

    def __init__(self, opened: OpenedDetections) -> None:
        self._opened = opened
        self._category = ""
        self._verdict = ""
        open_ = opened.shown("", "open")
        self._number = open_[0] if open_ else 0
        with ui.element("div").classes("studio-row"):
            classes = {"": "Any class", **{name: name for name in opened.classes}}
            show_choice("Class", classes, "", partial(self._filter, "_category"), classes="min-w-32")
            show_choice("Verdict", _VERDICTS, "", partial(self._filter, "_verdict"), classes="min-w-32")
            self._counted = ui.label().props("role=status")
        self._place = ui.column().classes("w-full gap-2")
        ui.keyboard(self._key, ignore=["input", "select", "textarea"])
        self._show(self._number)

    def _filter(self, name: str, value: str) -> None:
        setattr(self, name, value)
        order = self._opened.shown(self._category, self._verdict)
        self._show(self._number if self._number in order or not order else order[0])

    def _show(self, number: int) -> None:
        self._number = number
        counts = self._opened.review.counts()
        order = self._opened.shown(self._category, self._verdict)
        self._counted.set_text(
            f"{len(order)} of {len(self._opened.stored.objects)} detections; {counts['accept']} accepted, "
            f"{counts['reject']} rejected"
        )
        self._place.clear()
        with self._place:
            self._build(number)

    def _build(self, number: int) -> None:
        found = self._opened.object(number)
        verdict = self._opened.review.of(found.id)
        with ui.element("div").classes("studio-row"):
            key_button("Previous", partial(self._step, -1), "\u2190")
            key_button("Next", partial(self._step, 1), "\u2192")
            key_button("Accept", partial(self._decide, Verdict("accept")), "A")
            key_button("Reject", partial(self._decide, Verdict("reject")), "R")
            key_button("Undo", self._undo, "U")
            for k, name in enumerate(self._opened.classes[:_MOST_CLASSES], 1):
                key_button(f"It is: {name}", partial(self._name, name), str(k))
        with ui.element("div").classes("frame-view"):
            whole = ui.element("img").classes("picture")
            whole.props["alt"], whole.props["src"] = f"Picture {found.image.name}", f"/found/picture/{number}.png"
            with ui.element("section").props('aria-label="Detection"').classes("studio-card"):
                word = "none yet" if verdict is None else f"{verdict.word} {verdict.category}".strip()
                shown = ui.label(word).classes("verdict").props("role=status")
                shown.props["data-verdict"] = "" if verdict is None else verdict.word
                shown.props["data-frame"] = found.id
                x0, y0, x1, y1 = found.box_xyxy
                ui.label(f"{found.category} {found.score:.2f}, {x1 - x0:.0f} x {y1 - y0:.0f} px")
                ui.label(found.image.name).classes("faint")
                with ui.element("div").classes("crops"):
                    crop = ui.element("img")
                    crop.props["alt"], crop.props["src"] = "Detection, enlarged", f"/found/crop/{number}.png"

    def _step(self, by: int) -> None:
        order = self._opened.shown(self._category, self._verdict)
        beyond = [n for n in order if (n - self._number) * by > 0]
        if beyond:
            self._show(min(beyond) if by > 0 else max(beyond))

    def _name(self, category: str) -> None:
        own = self._opened.object(self._number).category
        self._decide(Verdict("accept", category="" if category == own else category))

    def _decide(self, verdict: Verdict) -> None:
        try:
            self._opened.review.decide(self._opened.object(self._number).id, verdict)
        except InfraBlendError as error:
            tell(error)
            return
        number = self._number
        self._step(1)
        if self._number == number:  # the last one
            self._show(number)

    def _undo(self) -> None:
        try:
            undone = self._opened.review.undo()
        except InfraBlendError as error:
            tell(error)
            return
        number = next((n for n, o in enumerate(self._opened.stored.objects) if o.id == undone), None)
        if number is None:
            ui.notify("Nothing to undo")
        else:
            self._show(number)

    def _key(self, event: KeyEventArguments) -> None:
        if not is_pressed(event):
            return
        actions: dict[str, Callable[[], None]] = {
            "a": partial(self._decide, Verdict("accept")),
            "r": partial(self._decide, Verdict("reject")),
            "u": self._undo,
            "arrowright": partial(self._step, 1),
            "arrowleft": partial(self._step, -1),
            **{str(k): partial(self._name, n) for k, n in enumerate(self._opened.classes[:_MOST_CLASSES], 1)},
        }
        if (action := actions.get(event.key.name.lower())) is not None:
            action()
