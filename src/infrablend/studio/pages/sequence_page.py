"""The sequences of a run: one is played, with its tracks and a timeline."""

from __future__ import annotations

from nicegui import ui
from nicegui.element import Element

from infrablend.errors import DatasetError
from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.pages.layout import frame_address, show_choice, show_error


class SequencePlayer(Element, component="components/sequence_player.js"):  # type: ignore[call-arg]
    """A player that reads its sequence from `source`, and begins at the frame at position `start`."""

    def __init__(self, source: str, start: int) -> None:
        super().__init__()
        self._props["source"] = source
        self._props["start"] = start


def show_sequence(run: OpenedRun, frame_id: str) -> None:
    """Show the sequence of a frame, or the first one if the id is empty."""
    ids = run.reading.ids
    sequences = run.sequences
    number = ids.index(frame_id) if frame_id in ids else None
    chosen = next((k for k, s in enumerate(sequences) if number in s.frames or not frame_id), None)
    if chosen is None:
        where = frame_id or str(run.layout.root)
        show_error(DatasetError(f"{where}: no such frame in a sequence of the run; expected one. Choose it on Review"))
        return
    shown = sequences[chosen]
    with ui.element("div").classes("studio-row"):
        show_choice(
            "Sequence",
            {ids[s.frames[0]]: s.name for s in sequences},
            ids[shown.frames[0]],
            lambda first: ui.navigate.to(frame_address("/sequences", first)),
            classes="min-w-40",
        )
        inserted = sum(track.inserted for track in shown.tracks)
        ui.label(f"{len(shown.frames)} frames; tracks: {inserted} inserted, {len(shown.tracks) - inserted} original")
    SequencePlayer(f"/run/sequences/{chosen}", 0 if number is None else shown.frames.index(number))
