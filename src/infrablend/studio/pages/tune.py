"""Tuning a recipe: a background, the recipe's fields, and the picture, redrawn after every change."""

from __future__ import annotations

import itertools
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import run, ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from infrablend.config.loading import list_recipes
from infrablend.config.modes import CHOICES, modes_of
from infrablend.core.dataset import ImageRecord
from infrablend.errors import InfraBlendError
from infrablend.studio.pages.layout import error_text, show_picture
from infrablend.studio.pages.routes import Pictures
from infrablend.studio.pictures import Rgb, to_png
from infrablend.studio.recipe_form import FormField, Move, can_move, fitting, form_of, moved, origin_px, released
from infrablend.studio.tuning import Tuned, Tuning

_KEPT = 48
_MOST_CROPS = 3
_SLIDER_SPAN = 400.0
_OPEN = ("objects.0",)

_numbers = itertools.count()


def _address(pictures: Pictures, rgb: Rgb) -> str:
    number = next(_numbers)
    pictures[number] = to_png(rgb)
    while len(pictures) > _KEPT:
        pictures.popitem(last=False)
    return f"/tune/picture/{number}.png"


class Stage(Element, component="components/stage.js"):  # type: ignore[call-arg]
    """The picture, with a handle on each insert."""

    def __init__(self, alt: str) -> None:
        """Show no picture yet."""
        super().__init__()
        self._props.update(source="", alt=alt, marks=[], size=[1, 1])

    def show(self, source: str, marks: list[dict[str, Any]], size_wh: tuple[int, int]) -> None:
        """Show a picture of a frame of this size."""
        self._props.update(source=source, marks=marks, size=list(size_wh))
        self.update()


class TunePage:
    """The tuning in one browser tab."""

    def __init__(self, tuning: Tuning, pictures: Pictures) -> None:
        """Begin with the recipe as it is, on the first background."""
        self._tuning, self._pictures = tuning, pictures
        self._recipe = tuning.recipe
        self._settings: dict[str, Any] = {}
        self._background: ImageRecord = tuning.backgrounds[0]
        self._filter = {"time": "", "text": "", "pitch": ""}
        self._boxes = True
        self._tuned: Tuned | None = None
        self._wanted = 0
        self._busy = False
        self._wrong: dict[str, Any] = {}
        self._inputs: dict[str, Any] = {}

    def build(self) -> None:
        """Build the page, and ask for the first picture."""
        with ui.element("div").classes("tune-view"):
            with ui.element("section").props('aria-label="Backgrounds"').classes("studio-card tune-backgrounds"):
                self._build_backgrounds()
            with ui.element("section").props('aria-label="Picture"').classes("tune-picture"):
                self._build_picture()
            with ui.element("section").props('aria-label="Recipe"').classes("studio-card tune-form"):
                self._build_recipe()
        ui.timer(0.05, self._redraw, once=True)

    # ---- backgrounds

    def _build_backgrounds(self) -> None:
        images = self._tuning.backgrounds
        ui.html("<h2>Backgrounds</h2>", sanitize=False)
        with ui.element("div").classes("studio-row"):
            text = ui.input("Search").props("dense outlined debounce=200").classes("w-full")
            text.on_value_change(lambda e: self._filter_by(text=e.value or ""))
            times = {"": "Any time", "day": "Day", "night": "Night"}
            chosen = ui.select(times, value="", label="Time of day").props('dense outlined aria-label="Time of day"')
            chosen.on_value_change(lambda e: self._filter_by(time=e.value))
            pitches = sorted({i.capture.pitch_deg for i in images if i.capture.pitch_deg is not None})
            options = {"": "Any pitch", **{f"{p:g}": f"{p:g}\u00b0" for p in pitches}}
            pitch = ui.select(options, value="", label="Pitch").props('dense outlined aria-label="Pitch"')
            pitch.on_value_change(lambda e: self._filter_by(pitch=e.value))
        columns = [
            {"name": "id", "label": "Name", "field": "id", "align": "left", "sortable": True},
            {"name": "pitch", "label": "Pitch", "field": "pitch", "sortable": True},
            {"name": "height", "label": "Height", "field": "height", "sortable": True},
            {"name": "time", "label": "Time", "field": "time", "sortable": True},
        ]
        self._table = ui.table(columns=columns, rows=self._rows(), row_key="n", selection="single")
        # The boxes of Quasar have no names.
        self._table.add_slot("header-selection", '<span class="unseen">Chosen</span>')
        self._table.add_slot(
            "body-selection", '<q-checkbox v-model="props.selected" :aria-label="props.row.id" dense />'
        )
        self._table.props('virtual-scroll dense flat hide-bottom :rows-per-page-options="[0]"').classes("tune-list")
        self._table.on("rowClick", lambda e: self._choose(int(e.args[1]["n"])), [[], ["n"], None])
        self._table.on_select(lambda e: self._choose(int(e.selection[0]["n"])) if e.selection else None)
        self._select_row()

    def _rows(self) -> list[dict[str, Any]]:
        chosen = self._filter
        return [
            {
                "n": n,
                "id": f"{i.split}/{i.id}",
                "pitch": i.capture.pitch_deg,
                "height": i.capture.altitude_m,
                "time": i.capture.time_of_day or "",
            }
            for n, i in enumerate(self._tuning.backgrounds)
            if chosen["text"].lower() in f"{i.split}/{i.id}".lower()
            and chosen["time"] in ("", i.capture.time_of_day)
            and (
                not chosen["pitch"]
                or (i.capture.pitch_deg is not None and f"{i.capture.pitch_deg:g}" == chosen["pitch"])
            )
        ]

    def _filter_by(self, **change: str) -> None:
        self._filter.update(change)
        self._table.rows = self._rows()
        self._table.update()

    def _choose(self, number: int) -> None:
        background = self._tuning.backgrounds[number]
        if background is self._background:
            return
        self._background = background
        self._select_row()
        self._request()

    def _select_row(self) -> None:
        self._table.selected = [r for r in self._table.rows if self._tuning.backgrounds[r["n"]] is self._background]
        self._table.update()

    # ---- picture

    def _build_picture(self) -> None:
        with ui.element("div").classes("studio-row"):
            boxes = ui.switch("Boxes", value=True)
            boxes.on_value_change(lambda e: self._show_boxes(e.value))
            self._ground_switch = ui.switch("Ground and people of 1.7 m", value=False)
            self._ground_switch.on_value_change(lambda _: self._show_picture())
            self._state = ui.label("Starting the renderer...").classes("faint").props("role=status")
        self._image = Stage("The frame with the recipe as it is in the form")
        self._image.on("place", self._placed)
        self._image.on("adjust", self._adjusted)
        self._error = ui.label().classes("studio-error").props("role=alert")
        self._error.set_visibility(False)
        self._facts = ui.element("div").classes("tune-facts")

    def _show_boxes(self, on: bool) -> None:
        self._boxes = on
        self._show_picture()

    def _show_picture(self) -> None:
        if self._tuned is None:
            return
        tuned, ground = self._tuned, bool(self._ground_switch.value)
        self._ground_switch.set_enabled(tuned.has_ground)
        source = _address(self._pictures, tuned.picture(boxes=self._boxes, ground=ground))
        height, width = tuned.trial.frame.pixels.shape[:2]
        self._image.show(source, self._marks(tuned), (width, height))

    @staticmethod
    def _marks(tuned: Tuned) -> list[dict[str, Any]]:
        """Return the handles: none where objects were left out, since the rest then have other numbers."""
        scene = tuned.trial.frame.scene
        if scene is None or not can_move(scene):
            return []
        found = []
        for label in sorted(tuned.trial.frame.inserted, key=lambda i: int(i.extra.get("object", 0))):
            number = int(label.extra.get("object", 0))
            box = [round(float(v), 1) for v in label.box_xyxy]
            found.append({"n": number, "name": label.category, "box": box, "origin": origin_px(scene, number)})
        return found

    def _placed(self, event: GenericEventArguments) -> None:
        if self._tuned is None:
            return
        mark = self._marks(self._tuned)[int(event.args["k"])]
        x, y = mark["origin"]
        self._move(mark["n"], Move(float(event.args["x"]) - x, float(event.args["y"]) - y))

    def _adjusted(self, event: GenericEventArguments) -> None:
        if self._tuned is None or self._tuned.trial.frame.scene is None:
            return
        given = event.args
        number = self._marks(self._tuned)[int(given["k"])]["n"]
        if given.get("release"):
            self._place_by_hand(released(self._settings.get("frames", {}), self._tuned.trial.frame.scene, number))
            return
        self._move(number, Move(float(given["dx"]), float(given["dy"]), float(given["turn"]), float(given["away"])))

    def _move(self, number: int, move: Move) -> None:
        tuned = self._tuned
        if tuned is None or tuned.trial.frame.scene is None:
            return
        frames, stands = self._settings.get("frames", {}), tuned.stands(number)
        self._place_by_hand(moved(frames, tuned.trial.frame.scene, number, move, stands=stands))

    def _place_by_hand(self, frames: dict[str, Any]) -> None:
        self._settings = {**self._settings, "frames": frames}
        self._request()

    def _show_facts(self, tuned: Tuned, real: list[Rgb | None]) -> None:
        self._facts.clear()
        with self._facts:
            for number, lines in enumerate(tuned.facts()):
                with ui.element("div").classes("studio-card"):
                    if number < _MOST_CROPS:
                        with ui.element("div").classes("crops"):
                            self._show_crop(tuned.crop(number), f"Insert {number + 1}, enlarged", "inserted")
                            found = real[number]
                            if found is None:
                                ui.label("This dataset has no real object of the class.").classes("faint")
                            else:
                                self._show_crop(found, f"Real object most like insert {number + 1} in size", "real")
                    for line in lines:
                        ui.label(line)
            for line in tuned.remarks():
                ui.label(line)

    def _show_crop(self, rgb: Rgb, alt: str, caption: str) -> None:
        show_picture(_address(self._pictures, rgb), alt, caption)

    # ---- recipe

    def _build_recipe(self) -> None:
        ui.html("<h2>Recipe</h2>", sanitize=False)
        names = [*list_recipes()]
        if self._tuning.recipe not in names:
            names.insert(0, self._tuning.recipe)
        chosen = ui.select(names, value=self._recipe, label="Start from").props(
            'dense outlined aria-label="Start from"'
        )
        chosen.on_value_change(lambda e: self._start_from(e.value))
        self._form = ui.element("div")
        self._fill_form()
        ui.html("<h3>Save</h3>", sanitize=False)
        own = Path(self._tuning.recipe).stem + "-tuned.yaml"
        path = ui.input("File", value=own).props("dense outlined").classes("w-full")
        ui.button("Save recipe", on_click=lambda: self._save(path.value or "")).props("no-caps outline")
        self._saved = ui.label().classes("tune-command").props("role=status")

    def _fill_form(self) -> None:
        try:
            form = form_of(self._tuning.read(self._recipe, self._settings))
        except InfraBlendError as error:
            self._show_error(error)
            return
        self._form.clear()
        self._inputs.clear()
        with self._form:
            for section, fields in form.items():
                with ui.expansion(section.replace(".", " "), value=section in _OPEN).props("dense").classes("w-full"):
                    for field in fields:
                        self._build_field(field)

    def _build_field(self, field: FormField) -> None:
        title = f"{field.title}, {field.unit}" if field.unit else field.title
        with ui.element("div").classes("tune-field"):
            if field.kind == "switch":
                made: Any = ui.switch(title, value=field.value)
            elif field.kind == "choice":
                words = list(dict.fromkeys([*field.choices, field.value]))
                made = ui.select(words, value=field.value, label=title).props(f'dense outlined aria-label="{title}"')
            elif field.kind == "range":
                self._build_range(field, title)
                return
            elif field.kind == "yaml":
                made = ui.input(title, value=field.shown).props("dense outlined debounce=500")
            else:
                made = ui.number(title, value=field.value, min=field.low, max=field.high)
                made.props("dense outlined debounce=150")
                if field.low is not None and field.high is not None and field.high - field.low <= _SLIDER_SPAN:
                    step = 1 if field.kind == "whole" else (field.high - field.low) / 100
                    slider = ui.slider(min=field.low, max=field.high, step=step, value=field.value)
                    slider.props(f'aria-label="{title}"').bind_value(made, "value")
            made.classes("w-full")
            self._inputs[field.key] = made
            made.on_value_change(lambda e: self._set(field, e.value))
            if field.help:
                ui.label(field.help).classes("faint tune-help")

    def _build_range(self, field: FormField, title: str) -> None:
        values = list(field.value)
        with ui.element("div").classes("studio-row"):
            for end, word in enumerate(("from", "to")):
                box = ui.number(f"{title}, {word}", value=values[end], min=field.low, max=field.high)
                box.props("dense outlined debounce=150").classes("tune-end")
                self._inputs.setdefault(field.key, box)

                def change(value: Any, end: int = end) -> None:
                    values[end] = value
                    self._set(field, list(values))

                box.on_value_change(lambda e, c=change: c(e.value))
        if field.help:
            ui.label(field.help).classes("faint tune-help")

    def _set(self, field: FormField, given: Any) -> None:
        try:
            value = field.read(given)
        except (ValueError, TypeError) as error:
            self._mark({field.key: str(error)})
            return
        if field.key in CHOICES:
            self._change_mode(field.key, value)
        else:
            self._settings[field.key] = value
        self._request()

    def _change_mode(self, key: str, word: str) -> None:
        """Change a mode: settings that mean nothing in it go, and the form is made again."""
        settings = {**self._settings, key: word}
        try:
            data = self._tuning.read(self._recipe, {k: v for k, v in settings.items() if k in CHOICES})
        except InfraBlendError as error:
            self._show_error(error)
            return
        self._settings = fitting(settings, modes_of(data.model_dump(mode="json")))
        self._fill_form()

    def _start_from(self, name: str) -> None:
        self._recipe, self._settings = name, {}
        self._fill_form()
        self._request()

    async def _save(self, name: str) -> None:
        if self._tuned is None:
            self._saved.set_text("There is no picture yet.")
            return
        try:
            recipe = self._tuning.read(self._recipe, self._settings)
            frame = self._tuned.trial.frame.id
            command = await run.io_bound(self._tuning.save, recipe, Path(name), frame)
        except InfraBlendError as error:
            self._saved.set_text(error_text(error))
            return
        self._saved.set_text(f"Saved. This frame from the shell: {command}")

    # ---- drawing

    def _request(self) -> None:
        """Ask for a picture; while one is being made, only the last request counts."""
        self._wanted += 1
        if not self._busy:
            ui.timer(0.001, self._redraw, once=True)

    async def _redraw(self) -> None:
        if self._busy:
            return
        self._busy = True
        try:
            done = -1
            while done != self._wanted:
                done = self._wanted
                await self._redraw_once()
        finally:
            self._busy = False

    async def _redraw_once(self) -> None:
        compose = partial(self._tuning.compose, self._recipe, dict(self._settings), self._background)
        try:
            tuned = await run.io_bound(compose)
        except InfraBlendError as error:
            self._show_error(error)
            return
        self._tuned = tuned
        self._error.set_visibility(False)
        self._image.classes(remove="stale")
        self._mark({})
        self._show_picture()
        self._state.set_text(f"{tuned.trial.frame.id}, {tuned.trial.seconds:.2f} s")
        inserted = tuned.trial.frame.inserted[:_MOST_CROPS]
        time_of_day = self._background.capture.time_of_day
        real = [await run.io_bound(self._tuning.nearest_real, label, time_of_day) for label in inserted]
        self._show_facts(tuned, real)

    def _show_error(self, error: InfraBlendError) -> None:
        """Show what is wrong: in the fields where it is in a field, and below the last picture."""
        self._error.set_text(error_text(error))
        self._error.set_visibility(True)
        self._image.classes(add="stale")
        self._state.set_text("The picture is that of the last valid recipe.")
        self._mark({p.where: str(p.found) for p in error.problems})

    def _mark(self, wrong: dict[str, str]) -> None:
        for key, shown in self._inputs.items():
            text = next((t for where, t in wrong.items() if where == key or where.startswith(f"{key}.")), None)
            before = self._wrong.get(key)
            if text == before:
                continue
            self._wrong[key] = text
            if text is None:
                shown.props(remove="error error-message")
            else:
                shown.props["error"], shown.props["error-message"] = True, text
            shown.update()
