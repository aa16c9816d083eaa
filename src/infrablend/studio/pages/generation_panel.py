"""What starts a run of the tuned recipe from its page, and shows how far it is."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path

from nicegui import ui

from infrablend.errors import InfraBlendError
from infrablend.studio.pages.layout import tell
from infrablend.studio.tuning import Tuning


def show_generation(tuning: Tuning, save: Callable[[], Awaitable[Path | None]]) -> None:
    """Show what starts, stops and resumes a run of the recipe; one that another tab has started is shown, too.

    Args:
        tuning: The tuning, which holds the run.
        save: Saves the recipe and returns its path; None if it cannot be saved.
    """
    ui.html("<h3>Generate</h3>", sanitize=False)
    out = ui.input("Output folder", value=f"runs/{tuning.name}-tuned").props("dense outlined")
    most = ui.number("Pictures at most, empty for all", min=1, precision=0).props("dense outlined")
    resume = ui.switch("Resume a stopped run")
    for made in (out, most):
        made.classes("w-full tune-field")

    async def start() -> None:
        recipe = await save()
        if recipe is None:
            return
        try:
            limit = None if most.value is None else int(most.value)
            folder = Path(out.value or "run").absolute()
            tuning.generate(recipe, folder, limit=limit, resume=bool(resume.value))
        except InfraBlendError as error:
            tell(error)
        look()

    def stop() -> None:
        if tuning.generation is not None:
            tuning.generation.stop()

    with ui.element("div").classes("studio-row"):
        starts = ui.button("Save and generate", on_click=start).props("no-caps outline")
        stops = ui.button("Stop", on_click=stop).props("no-caps outline")
    bar = ui.linear_progress(0.0, show_value=False).props('aria-label="Finished frames" instant-feedback')
    state = ui.label().classes("tune-command").props("role=status")
    said = ui.label().classes("tune-command faint")

    def look() -> None:
        run_made = tuning.generation
        running = run_made is not None and run_made.is_running
        starts.set_enabled(not running)
        stops.set_visibility(running)
        bar.set_visibility(running)
        if run_made is not None:
            bar.value = run_made.done / max(1, run_made.total)
            state.set_text(run_made.state)
            said.set_text("\n".join(run_made.lines))

    look()
    ui.timer(0.5, look)
