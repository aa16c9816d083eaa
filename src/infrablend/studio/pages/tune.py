"""Tuning a recipe: a background, the recipe's fields, and the picture, redrawn after every change."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, get_args
from urllib.parse import parse_qsl, urlencode

from nicegui import run, ui
from nicegui.events import GenericEventArguments

from infrablend.config.loading import list_recipes
from infrablend.config.modes import CHOICES, modes_of
from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import ImageRecord
from infrablend.errors import InfraBlendError, Problem
from infrablend.report.preview import Rgb
from infrablend.studio.ground_masks import Legend, paint, show_places, show_surfaces
from infrablend.studio.page_pictures import to_png
from infrablend.studio.pages.generation_panel import show_generation
from infrablend.studio.pages.layout import error_text, show_choice, show_picture, tell
from infrablend.studio.pages.object_inputs import Input, show_counts, show_ends, show_models, show_options, show_parts
from infrablend.studio.pages.path_editor import Mark, PathEditor, Stage
from infrablend.studio.pages.routes import Pictures
from infrablend.studio.recipe_form import (
    FormField,
    Move,
    fitting,
    form_of,
    input_of,
    moved,
    origin_px,
    released,
    with_place,
)
from infrablend.studio.tuning import Tuned, Tuning

_KEPT = 48
_MOST_CROPS = 3
_SLIDER_SPAN = 400.0
_OPEN = ("objects.0",)
_MAPS = {"surfaces": show_surfaces, "stand": show_places}
_PENS_PX = ("8", "24", "64")

_numbers = itertools.count()


def _address(pictures: Pictures, rgb: Rgb) -> str:
    number = next(_numbers)
    pictures[number] = to_png(rgb)
    while len(pictures) > _KEPT:
        pictures.popitem(last=False)
    return f"/tune/picture/{number}.png"


class TunePage:
    """The tuning in one browser tab."""

    def __init__(self, tuning: Tuning, pictures: Pictures, address: Mapping[str, str]) -> None:
        """Build the page with the recipe as it is, on the background of an address, and ask for the first picture."""
        self._tuning = tuning
        self._pictures = pictures
        self._recipe = tuning.recipe
        self._settings: dict[str, Any] = {}
        self._background: ImageRecord = tuning.backgrounds[0]
        self._configuration = 0
        self._go_to(address)
        self._filter = {"time": "", "text": "", "pitch": ""}
        self._tuned: Tuned | None = None
        self._wanted = 0
        self._busy = False
        self._unread: dict[str, str] = {}
        self._problems: tuple[Problem, ...] = ()
        self._inputs: dict[str, Input] = {}
        with ui.element("div").classes("tune-view"):
            with ui.element("section").props('aria-label="Backgrounds"').classes("studio-card tune-backgrounds"):
                self._build_backgrounds()
            with ui.element("section").props('aria-label="Picture"').classes("tune-picture"):
                self._build_picture()
            with ui.element("section").props('aria-label="Recipe"').classes("studio-card tune-form"):
                self._build_recipe()
        ui.on("tune-address", self._walked)
        ui.run_javascript("window.addEventListener('popstate', () => emitEvent('tune-address', location.search))")
        ui.timer(0.05, self._redraw, once=True)

    # ---- address

    def _go_to(self, address: Mapping[str, str]) -> None:
        """Take background and configuration from the query of an address; the first ones by default."""
        name = address.get("background")
        configuration = address.get("configuration", "0")
        number = 0 if name is None else self._tuning.number_of(name)
        if number is None:
            ui.notify(f"{name}: no such background in this dataset; the first one is shown", type="warning")
        self._background = self._tuning.backgrounds[number or 0]
        self._configuration = int(configuration) if configuration.isdecimal() and len(configuration) < 7 else 0

    def _walked(self, event: GenericEventArguments) -> None:
        """Show what the address names that the browser has gone back or forward to."""
        self._go_to(dict(parse_qsl(str(event.args).lstrip("?"))))
        self._select_row()
        self._request()

    def _note_address(self) -> None:
        query = {"background": f"{self._background.split}/{self._background.id}", "configuration": self._configuration}
        ui.navigate.history.push(f"/tune?{urlencode(query, safe='/')}")

    # ---- backgrounds

    def _build_backgrounds(self) -> None:
        images = self._tuning.backgrounds
        ui.html("<h2>Backgrounds</h2>", sanitize=False)
        with ui.element("div").classes("studio-row"):
            text = ui.input("Search").props("dense outlined debounce=200").classes("w-full")
            text.on_value_change(lambda e: self._filter_by(text=e.value or ""))
            times = {"": "Any time", **{t: t.capitalize() for t in get_args(TimeOfDay)}}
            show_choice("Time of day", times, "", lambda v: self._filter_by(time=v), dense=False)
            pitches = sorted({i.capture.pitch_deg for i in images if i.capture.pitch_deg is not None})
            options = {"": "Any pitch", **{f"{p:g}": f"{p:g}\u00b0" for p in pitches}}
            show_choice("Pitch", options, "", lambda v: self._filter_by(pitch=v), dense=False)
        names = {"id": "Name", "pitch": "Pitch", "height": "Height", "time": "Time"}
        columns = [{"name": k, "label": v, "field": k, "sortable": True} for k, v in names.items()]
        columns[0] |= {"align": "left"}
        self._table = ui.table(columns=columns, rows=self._rows(), row_key="n", selection="single")
        # The boxes of Quasar have no names.
        self._table.add_slot("header-selection", '<span class="unseen">Chosen</span>')
        self._table.add_slot(
            "body-selection", '<q-checkbox v-model="props.selected" :aria-label="props.row.id" dense />'
        )
        self._table.add_slot(
            "body-cell-id",
            '<q-td :props="props"><img loading="lazy" alt="" :src="`/tune/background/${props.row.n}.jpg`" />'
            "{{ props.value }}</q-td>",
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
            and chosen["pitch"] in ("", "" if i.capture.pitch_deg is None else f"{i.capture.pitch_deg:g}")
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
        self._note_address()
        self._select_row()
        self._request()

    def _configure(self, number: Any) -> None:
        if number is None or int(number) == self._configuration:
            return
        self._configuration = int(number)
        self._note_address()
        self._request()

    def _select_row(self) -> None:
        self._table.selected = [r for r in self._table.rows if self._tuning.backgrounds[r["n"]] is self._background]
        self._table.update()

    # ---- picture

    def _build_picture(self) -> None:
        with ui.element("div").classes("studio-row"):
            self._boxes = ui.switch("Boxes", value=True, on_change=self._show_picture)
            self._ground = ui.switch("Ground and people of 1.7 m", on_change=self._show_picture)
            maps = {"": "None", "surfaces": "Surfaces", "stand": "Where objects may stand"}
            self._map = show_choice("Map", maps, "", lambda _: self._show_picture())
            self._path = PathEditor(self._inputs, self._frame_wh)
            self._configurations = ui.number("Configuration", value=self._configuration, min=0, precision=0)
            self._configurations.props("dense outlined debounce=300").classes("tune-number")
            self._configurations.on_value_change(lambda e: self._configure(e.value))
            self._state = ui.label("Starting the renderer...").classes("faint").props("role=status")
        with ui.element("div").classes("studio-row").bind_visibility_from(self._map, "value", backward=bool):
            self._legend = ui.element("div").classes("studio-row tune-legend").props("role=status")
            brushes = {"": "Off", "forbid": "Not allowed", "allow": "Allowed"}
            self._brush = show_choice("Brush", brushes, "", lambda _: self._show_picture(), classes="min-w-24")
            pens = {px: f"{px} px" for px in _PENS_PX}
            self._pen = show_choice("Pen", pens, _PENS_PX[1], lambda _: self._show_picture())
            self._all = ui.button("Fill", on_click=lambda: self._paint(())).props("no-caps outline dense")
        self._image = Stage("The frame with the recipe as it is in the form")
        self._image.on("place", self._placed)
        self._image.on("adjust", self._adjusted)
        self._image.on("paint", lambda e: self._paint(e.args["line"]))
        self._path.show_points(self._image)
        self._error = ui.label().classes("studio-error").props("role=alert")
        self._error.set_visibility(False)
        self._facts = ui.element("div").classes("tune-facts")

    def _frame_wh(self) -> tuple[int, int]:
        """Return the size of the picture, px."""
        if self._tuned is None:
            return 640, 512
        height, width = self._tuned.trial.frame.pixels.shape[:2]
        return width, height

    def _show_picture(self) -> None:
        if self._tuned is None:
            return
        tuned = self._tuned
        self._ground.set_enabled(tuned.has_ground)
        base, legend = self._mapped(tuned)
        rgb = tuned.picture(boxes=bool(self._boxes.value), ground=bool(self._ground.value), base=base)
        can_paint = tuned.recipe.placement.surfaces is not None
        pen_px = int(self._pen.value) if can_paint and self._map.value and self._brush.value else 0
        self._brush.set_visibility(can_paint)
        self._pen.set_visibility(pen_px > 0)
        self._all.set_visibility(pen_px > 0)
        self._image.show(_address(self._pictures, rgb), self._marks(), self._frame_wh(), pen_px)
        self._legend.clear()
        with self._legend:
            for text, colour in legend.items():
                shown = ui.label(text)
                if colour is not None:
                    shown.style(f"border-left: 14px solid rgb{colour}")

    def _mapped(self, tuned: Tuned) -> tuple[Rgb | None, Legend]:
        """Return the picture with the chosen map over it, and its legend; None for the picture alone."""
        try:
            return _MAPS[self._map.value](tuned, self._tuning.ignored) if self._map.value else (None, {})
        except InfraBlendError as error:
            tell(error)
            return None, {}

    def _paint(self, line: Sequence[Sequence[float]]) -> None:
        """Paint the mask along a line, or all over without one, and have the recipe use it."""
        tuned = self._tuned
        field = self._inputs.get("placement.where")
        rules = None if tuned is None else tuned.recipe.placement.surfaces
        if tuned is None or rules is None or field is None:
            return
        try:
            folder = paint(tuned, self._tuning.data, line, int(self._pen.value), allowed=self._brush.value != "forbid")
            field.shown[0].value = json.dumps(rules.model_dump(mode="json") | {"masks": str(folder)})
            self._tuned = replace(tuned, recipe=self._tuning.read(self._recipe, self._settings))
        except InfraBlendError as error:
            tell(error)
        self._show_picture()
        self._request()

    def _marks(self) -> list[Mark]:
        """Return the handles."""
        frame = None if self._tuned is None else self._tuned.trial.frame
        if frame is None or frame.scene is None:
            return []
        found: list[Mark] = []
        for label in sorted(frame.inserted, key=lambda i: int(i.extra.get("object", 0))):
            number = int(label.extra.get("object", 0))
            box = [round(float(v), 1) for v in label.box_xyxy]
            found.append({"n": number, "name": label.category, "box": box, "origin": origin_px(frame.scene, number)})
        return found

    def _placed(self, event: GenericEventArguments) -> None:
        given, (x, y) = event.args, self._marks()[int(event.args["k"])]["origin"]
        self._move(given, Move(float(given["x"]) - x, float(given["y"]) - y))

    def _adjusted(self, event: GenericEventArguments) -> None:
        given = event.args
        move = None
        if not given.get("release"):
            move = Move(*(float(given[k]) for k in ("dx", "dy", "turn", "away")))
        self._move(given, move)

    def _move(self, given: Mapping[str, Any], move: Move | None) -> None:
        """Move the insert that an event names, or have its place drawn again."""
        tuned = self._tuned
        frames = self._settings.get("frames", {})
        if tuned is None or tuned.trial.frame.scene is None:
            return
        scene = tuned.trial.frame.scene
        number = self._marks()[int(given["k"])]["n"]
        if move is None:
            frames = released(frames, scene, number)
        else:
            frames = moved(frames, scene, number, move, stands=tuned.stands(number))
        self._settings = {**self._settings, "frames": frames}
        self._request()

    def _show_facts(self, tuned: Tuned, real: list[Rgb | None]) -> None:
        self._facts.clear()
        with self._facts:
            for number, lines in enumerate(tuned.facts()):
                with ui.element("div").classes("studio-card"):
                    if number < _MOST_CROPS:
                        with ui.element("div").classes("crops"):
                            inserted = _address(self._pictures, tuned.crop(number))
                            found = real[number]
                            show_picture(inserted, f"Insert {number + 1}, enlarged", "inserted")
                            if found is None:
                                ui.label("This dataset has no real object of the class.").classes("faint")
                            else:
                                alt = f"Real object most like insert {number + 1} in size"
                                show_picture(_address(self._pictures, found), alt, "real")
                    for line in lines:
                        ui.label(line)
            for number, line in tuned.left_out().items():
                with ui.element("div").classes("studio-card studio-row"):
                    ui.label(line)
                    if not tuned.recipe.in_sequences:
                        ui.button("Place it by hand", on_click=partial(self._place, number)).props(
                            f'no-caps outline dense aria-label="Place object {number + 1} by hand"'
                        )
            for line in tuned.remarks():
                ui.label(line)

    def _place(self, number: int) -> None:
        """Place an object that was left out below the middle of the picture, from where it can be moved."""
        assert self._tuned is not None
        frame = self._tuned.trial.frame
        height, width = frame.pixels.shape[:2]
        entry = {"x_px": width / 2, "y_px": 0.75 * height}
        self._settings["frames"] = with_place(self._settings.get("frames", {}), frame.id, number, entry)
        self._request()

    # ---- recipe

    def _build_recipe(self) -> None:
        ui.html("<h2>Recipe</h2>", sanitize=False)
        names = {name: name for name in list_recipes()}
        if self._tuning.recipe not in names:
            own = self._tuning.name
            names = {self._tuning.recipe: f"{own} (as opened)" if own in names else own, **names}
        show_choice("Start from", names, self._recipe, self._start_from, dense=False)
        self._form = ui.element("div")
        self._fill_form()
        ui.html("<h3>Save</h3>", sanitize=False)
        self._file = ui.input("File", value=f"{self._tuning.name}-tuned.yaml").props("dense outlined").classes("w-full")
        ui.label(f"Names without a folder are in {Path.cwd()}").classes("faint tune-help tune-path")
        ui.button("Save recipe", on_click=self._save).props("no-caps outline")
        self._saved = ui.label().classes("tune-command").props("role=status")
        show_generation(self._tuning, self._save)

    def _fill_form(self) -> None:
        try:
            form = form_of(self._tuning.read(self._recipe, self._settings))
        except InfraBlendError as error:
            self._show_error(error)
            return
        self._form.clear()
        self._inputs.clear()
        self._unread.clear()
        with self._form:
            for section, fields in form.items():
                with ui.expansion(section.replace(".", " "), value=section in _OPEN) as part:
                    part.props("dense").classes("w-full")
                    for field in fields:
                        self._build_field(field, part)

        kinds = [key.split(".")[1] for key in self._inputs if key.startswith("objects.") and key.endswith(".motion")]
        self._path.offer(kinds)

    def _build_field(self, field: FormField, part: Any) -> None:
        title = f"{field.title}, {field.unit}" if field.unit else field.title
        with ui.element("div").classes("tune-field"):
            if field.kind == "model":
                self._inputs[field.key] = Input((part,), show_models(title, field.value, self._change_model(field.key)))
            elif field.kind in ("options", "parts"):
                show = show_options if field.kind == "options" else show_parts
                model = str(self._inputs[field.key.rpartition(".")[0] + ".model"].shown[0].value)
                self._inputs |= show(field, model, part, self._unread, lambda value: self._set(field, value))
            elif field.kind == "counts":
                self._inputs[field.key] = Input((part,), show_counts(title, field.value, partial(self._set, field)))
            elif field.kind == "range":
                change = partial(self._set, field)
                ends = show_ends(title, field.value, change, field.low, field.high, joined=lambda *ends: list(ends))
                self._inputs[field.key] = Input((part,), ends)
            else:
                made = self._build_input(field, title).classes("w-full")
                self._inputs[field.key] = Input((part,), (made,))
                made.on_value_change(lambda e: self._set(field, e.value))
            if field.help:
                ui.label(field.help).classes("faint tune-help")

    @staticmethod
    def _build_input(field: FormField, title: str) -> Any:
        if field.kind == "switch":
            return ui.switch(title, value=field.value)
        if field.kind == "choice":
            words = [w for w in dict.fromkeys([*field.choices, field.value]) if w is not None]
            made = ui.select(words, value=field.value, label=title, clearable=None in field.choices)
            return made.props(f'dense outlined aria-label="{title}"')
        if field.kind in ("text", "yaml"):
            return ui.input(title, value=field.shown).props("dense outlined debounce=500")
        made = ui.number(title, value=field.value, min=field.low, max=field.high).props("dense outlined debounce=150")
        if field.low is not None and field.high is not None and field.high - field.low <= _SLIDER_SPAN:
            step = 1 if field.kind == "whole" else (field.high - field.low) / 100
            slider = ui.slider(min=field.low, max=field.high, step=step, value=field.value)
            slider.props(f'aria-label="{title}"').bind_value(made, "value")
        return made

    def _set(self, field: FormField, given: Any) -> None:
        try:
            value = field.read(given)
        except (ValueError, TypeError) as error:
            self._unread[field.key] = str(error) if field.kind == "yaml" else "expected a number"
            self._mark()
            return
        self._unread.pop(field.key, None)
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

    def _change_model(self, key: str) -> Callable[[str], None]:
        """Return what changes the model of an object: the options and the parts of another mean nothing to it."""

        def change(name: str) -> None:
            of = key.rpartition(".")[0]
            self._settings |= {key: name, f"{of}.options": {}, f"{of}.parts": {}}
            self._fill_form()
            self._request()

        return change

    def _start_from(self, name: str) -> None:
        self._recipe = name
        self._settings = {}
        self._fill_form()
        self._request()

    async def _save(self) -> Path | None:
        """Save the recipe under the name in its field, and show its whole path; None if it cannot be saved."""
        if self._tuned is None:
            self._saved.set_text("There is no picture yet.")
            return None
        if self._unread:
            self._saved.set_text("Not saved: correct the marked fields first.")
            return None
        try:
            recipe = self._tuning.read(self._recipe, self._settings)
            name = Path(self._file.value or "")
            saved: tuple[Path, str] = await run.io_bound(self._tuning.save, recipe, name, self._tuned.trial.frame.id)
        except InfraBlendError as error:
            self._saved.set_text(error_text(error))
            return None
        self._file.value = str(saved[0])
        self._saved.set_text(f"Saved as {saved[0]}\nThis frame from the shell: {saved[1]}")
        return saved[0]

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
        compose = partial(
            self._tuning.compose, self._recipe, dict(self._settings), self._background, self._configuration
        )
        try:
            tuned = await run.io_bound(compose)
        except InfraBlendError as error:
            self._show_error(error)
            return
        self._tuned = tuned
        self._error.set_visibility(False)
        self._image.classes(remove="stale")
        self._problems = ()
        self._mark()
        self._configurations.set_visibility(tuned.trial.scenes > 1)
        self._configurations.max = tuned.trial.scenes - 1
        self._configurations.value = self._configuration
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
        self._problems = error.problems
        self._mark()

    def _mark(self) -> None:
        """Mark every wrong field in its place, in a part of the form that is then open, with what is wrong."""
        words: dict[str, list[str]] = {key: [text] for key, text in self._unread.items()}
        for problem in self._problems:
            key = input_of(problem.where, self._inputs)
            if key is not None and key not in self._unread:
                below = problem.where.removeprefix(key).lstrip(".")
                expected = f"; expected {problem.expected}" if problem.expected else ""
                where = f"{below}: " if below else ""
                words.setdefault(key, []).append(where + problem.found + expected)
        for key, made in self._inputs.items():
            text = "; ".join(words.get(key, ()))
            if text == made.marked:
                continue
            made.marked = text
            for part in made.parts if text else ():
                part.value = True
            for shown in made.shown:
                shown.props["error"], shown.props["error-message"] = bool(text), text
                shown.update()
