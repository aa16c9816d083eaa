"""The frame around every page: title, navigation, theme; and errors in words."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from nicegui import app, ui
from nicegui.events import KeyEventArguments
from starlette.requests import Request

from infrablend.errors import InfraBlendError, format_problems
from infrablend.studio.open_studio import Session
from infrablend.studio.opened_run import RunFrames

THEME_COOKIE = "infrablend_theme"
_LOOK_S = 0.25
_STYLE = Path(__file__).with_name("studio.css")


def share_style() -> None:
    """Add the style to every page."""
    app.colors(primary="#0b63c5", secondary="#566070", positive="#1c7c3c", negative="#b3261e")
    ui.add_css(_STYLE, shared=True)


def pages_of(session: Session) -> dict[str, str]:
    """Return the names of the pages that have something to show, by path."""
    found: dict[str, str] = {}
    if session.run is not None:
        found["/review"] = "Review"
        if session.run.has_sequences:
            found["/sequences"] = "Sequences"
        found |= {"/losses": "Lost labels", "/results": "Results"}
    if session.detections is not None:
        found["/found"] = "Detections"
    if session.run is not None or session.request.data is not None:
        found["/tune"] = "Tune"
    if session.comparison is not None:
        found["/compare"] = "Compare"
    return found


def frame_address(path: str, frame_id: str, **query: str) -> str:
    """Return the address of a frame on a page."""
    return f"{path}?" + urlencode({**query, "frame": frame_id}, safe="/")


@contextlib.contextmanager
def page_frame(session: Session, request: Request, path: str, title: str) -> Iterator[None]:
    """Build the frame of a page; the block builds its content, and its `InfraBlendError` is shown in words."""
    theme = request.cookies.get(THEME_COOKIE)
    dark = ui.dark_mode({"dark": True, "light": False}.get(theme or ""))
    ui.page_title(f"{title} - {session.title} - InfraBlend studio")
    ui.query("html").props("lang=en")
    with ui.element("header").classes("studio-bar"):
        ui.html("<h1>InfraBlend studio</h1>", sanitize=False)
        with ui.element("nav").props('aria-label="Pages"'):
            for target, name in pages_of(session).items():
                link = ui.link(name, target)
                if target == path:
                    link.props("aria-current=page")
        ui.label(session.title).classes("faint")
        ui.space()

        def switch() -> None:
            dark.value = not dark.value if dark.value is not None else True
            word = "dark" if dark.value else "light"
            ui.run_javascript(f"document.cookie='{THEME_COOKIE}={word}; path=/; max-age=31536000; SameSite=Strict'")

        ui.button("Light or dark", on_click=switch).props("flat dense no-caps")
    with ui.element("div").classes("studio-page"):  # Quasar's page is the main landmark
        try:
            yield
        except InfraBlendError as error:
            show_error(error)


def when_read(run: RunFrames, build: Callable[[], None]) -> None:
    """Build a part of a page once the run's records are read; until then, the page shows how many are.

    Nothing waits: the server answers other requests meanwhile.
    """
    if run.reading.is_complete:
        build()
        return
    place = ui.column().classes("w-full gap-2")
    with place:
        progress = ui.label().props("role=status").classes("faint")

    def look() -> None:
        reading = run.reading
        progress.set_text(f"{reading.count} of {len(reading.ids)} records read")
        if reading.is_complete:
            timer.cancel()
            place.clear()
            with place:
                build()

    timer = ui.timer(_LOOK_S, look)


def show_error(error: InfraBlendError) -> None:
    """Show what is wrong, and what to do."""
    ui.label(error_text(error)).classes("studio-error").props("role=alert")


def error_text(error: InfraBlendError) -> str:
    """Return an error with its problems, a line each."""
    return "\n".join([error.message, *format_problems(error.problems)])


def tell(error: InfraBlendError) -> None:
    """Show an error as a notification that stays until it is closed."""
    ui.notify(error_text(error), type="negative", multi_line=True, timeout=0, close_button="Close")


def show_heading(level: int, text: str) -> None:
    """Show a heading; the text is escaped."""
    with ui.element(f"h{level}"):
        ui.label(text)


def show_table(head: Sequence[str], rows: Iterable[Sequence[str | tuple[str, str]]], classes: str = "plain") -> None:
    """Show a table that scrolls sideways on its own; a cell is a text, or a text and the address that it links to.

    If the first column has no name, its cells name the rows.
    """
    with ui.element("div").classes("scroll-x").props("tabindex=0"), ui.element("table").classes(classes):
        with ui.element("thead"), ui.element("tr"):
            for name in head:
                with ui.element("th" if name else "td").props("scope=col" if name else ""):
                    ui.label(name)
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    for k, cell in enumerate(row):
                        names_row = not k and not head[0]
                        with ui.element("th" if names_row else "td").props("scope=row" if names_row else ""):
                            if isinstance(cell, str):
                                ui.label(cell)
                            else:
                                ui.link(*cell)


def show_choice(
    title: str, options: Mapping[str, str] | Sequence[str], value: str, on_choice: Callable[[str], None], *,
    classes: str = "", dense: bool = True,
) -> Any:  # fmt: skip
    """Show a list to choose from, and return it; `dense` brings the options closer together."""
    made = ui.select(options, label=title, value=value, on_change=lambda e: on_choice(e.value))
    return made.props(f'dense outlined aria-label="{title}"' + (" options-dense" if dense else "")).classes(classes)


def is_pressed(event: KeyEventArguments) -> bool:
    """Return whether a key goes down, without others that give it another meaning."""
    held = event.modifiers
    return bool(event.action.keydown and not (held.ctrl or held.meta or held.alt))


def key_button(text: str, on_click: Any, key: str) -> None:
    """Show a button that names the key that does the same."""
    # Without a focus of its own, so that keys go on to work after a click.
    with ui.button(on_click=on_click).props("no-caps dense outline").classes("px-2"):
        ui.label(text)
        ui.html(f"<kbd>{key}</kbd>", sanitize=False).classes("ml-2")


def show_picture(source: str, alt: str, caption: str) -> None:
    """Show a picture with a caption; it is loaded when it comes into sight."""
    with ui.element("figure"):
        shown = ui.element("img").props("loading=lazy")
        shown.props["alt"], shown.props["src"] = alt, source
        with ui.element("figcaption").classes("faint"):
            ui.label(caption)
