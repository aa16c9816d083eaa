"""A recipe being tuned: what to tune, settings over it, one frame at a time from a warm renderer, saved as YAML.

A run is made by `infrablend generate` in a process of its own, as the shell would start it.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from ruamel.yaml import YAML

from infrablend import __version__
from infrablend.assets.catalogue import list_models, load_model
from infrablend.config.loading import read_recipe
from infrablend.config.recipe import Recipe
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.file_names import real_path
from infrablend.core.files import read_regular, write_text
from infrablend.core.operating_system import IN_BACKGROUND, ask_to_stop, describe_exit
from infrablend.core.typed_command import reading_words
from infrablend.errors import ArgumentError, DatasetError, OutputError, RecipeError
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import READ_ALL
from infrablend.pipeline.compose.trial import Trial, TrialRequest, Trials, gain_words, how_visible
from infrablend.pipeline.plans.planning import reading_for
from infrablend.pipeline.runs.record import RecordedRun
from infrablend.rendering.engine.turntable import draw_model
from infrablend.report.ground_preview import draw_ground
from infrablend.report.preview import Rgb, decode_picture, draw_labels, to_rgb
from infrablend.report.run_warnings import WHY
from infrablend.studio.object_form import model_problems
from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.page_pictures import cached_picture, cached_thumbnail, enlarged, with_originals
from infrablend.studio.studio_request import StudioRequest
from infrablend.thermal.radiometry import ZERO_C_K

_CROP_PX = 240
FIRST_RECIPE = "hit-uav-drone-physical"
"""Recipe to tune where neither a recipe nor a run is given."""


@dataclass(frozen=True)
class Tuned:
    """A frame of the recipe with its settings.

    Attributes:
        recipe: The recipe with the settings applied.
        trial: The frame.
        background: The background, as it was read.
    """

    recipe: Recipe
    trial: Trial
    background: ImageRecord

    @property
    def has_ground(self) -> bool:
        """Whether the frame's camera is above real ground."""
        scene = self.trial.frame.scene
        return scene is not None and scene.view is not None

    def picture(self, *, boxes: bool, ground: bool = False, base: Rgb | None = None) -> Rgb:
        """Return the picture, or `base`, with boxes, or with the ground and people of 1.7 m on it, twice as large."""
        frame = self.trial.frame
        if ground and frame.scene is not None and (view := frame.scene.view) is not None:
            plain = to_rgb(frame.pixels) if base is None else base
            return draw_ground(plain, frame.labels, frame.scene.camera, view.ground_z_m)[0]
        return self.labelled(inserts=boxes, originals=boxes, base=base)

    def labelled(self, *, inserts: bool, originals: bool, base: Rgb | None = None) -> Rgb:
        """Return the picture, or `base`, with boxes of its inserts, and with dashed ones of its original objects."""
        frame = self.trial.frame
        rgb = to_rgb(frame.pixels) if base is None else base
        if originals:
            rgb = with_originals(rgb, [i.box_xyxy.tolist() for i in frame.labels if not i.inserted])
        return draw_labels(rgb, frame.inserted, ("boxes",)) if inserts else rgb

    def crop(self, number: int) -> Rgb:
        """Return an insert, enlarged."""
        return _crop(to_rgb(self.trial.frame.pixels), self.trial.frame.inserted[number])

    def stands(self, number: int) -> bool:
        """Return whether an object of the scene stands on real ground."""
        scene = self.trial.frame.scene
        return self.has_ground and scene is not None and load_model(scene.objects[number].model).stands

    def facts(self) -> list[list[str]]:
        """Return lines about each insert, in words: size, visibility, contrast, temperatures."""
        frame = self.trial.frame
        found = []
        for label in frame.inserted:
            width, height = label.box_xyxy[2:] - label.box_xyxy[:2]
            lines = [f"{label.category}, {width:.0f} x {height:.0f} px", *how_visible(label)]
            number = label.extra.get("object")
            if frame.scene is not None and isinstance(number, int) and number < len(frame.scene.objects):
                parts = frame.scene.objects[number].parts
                air = frame.scene.ambient_k
                lines.append(
                    f"air {air - ZERO_C_K:.1f} \u00b0C; above air: "
                    + ", ".join(f"{name.replace('_', ' ')} {p.temperature_k - air:+.1f} K" for name, p in parts.items())
                )
            found.append(lines)
        return found

    def left_out(self) -> dict[int, str]:
        """Return which objects of the frame are not in its picture, and why, in words, by their numbers."""
        scene = self.trial.frame.scene
        if scene is None:
            return {}
        counts = scene.draws.get("wanted_by_kind", {})
        objects = self.recipe.objects
        names = [
            kind.category or load_model(kind.model).category
            for k, kind in enumerate(objects)
            for _ in range(counts.get(str(k), 0))
        ]
        rejected = sorted(scene.draws.get("rejected", {}).items(), key=lambda item: (-item[1], item[0]))[:2]
        most = " and ".join(f"{count} {why.replace('_', ' ')}" for why, count in rejected)
        found = {}
        for number, reason in sorted(scene.left_out.items()):
            name = f", {names[number]}" if number < len(names) else ""
            why = WHY.get(reason, reason.replace("_", " "))
            if reason == "no_place" and most:
                why += f" (of the frame's {scene.draws['attempts']} draws, {most})"
            found[number] = f"Object {number + 1}{name}, was left out: {why}."
        return found

    def remarks(self) -> list[str]:
        """Return what the picture rests on, in words: gain, absent objects, lost labels, warnings."""
        record = self.trial.frame.record
        found = gain_words(record.facts.get("matching") or {})
        absent = {} if record.scene is None else record.scene.draws.get("absent", {})
        if record.scene is None or not record.scene.left_out:  # otherwise, `left_out` names them
            found += [f"{count} not inserted: {str(why).replace('_', ' ')}" for why, count in sorted(absent.items())]
        if record.removed:
            found.append(f"{len(record.removed)} original label(s) removed")
        return [*found, *(str(p) for p in self.trial.problems)]


class Tuning:
    """Backgrounds and a warm renderer, shared by all pages.

    Attributes:
        recipe: Name or path of the recipe at the start.
        name: Its own name.
        data: Folder of the backgrounds.
        seed: Seed of the frames.
        backgrounds: All backgrounds, in the order of the dataset.
        ignored: Names of the categories that mark ignore regions.
        generation: The run that was started last; None if none was.
    """

    def __init__(self, request: TrialRequest) -> None:
        """Start the renderer and read the backgrounds.

        Raises:
            InfraBlendError: The recipe or the data cannot be used.
        """
        self.recipe, self.data, self.seed = str(request.recipe), Path(request.data), request.seed
        self._reading = request.reading
        self._lock, self._drawing = threading.Lock(), threading.Lock()
        self._saved: set[Path] = set()
        self.generation: Generation | None = None
        self._trials = Trials(request)
        try:
            start = read_recipe(request.recipe).recipe
            self.name = start.name
            dataset = dataset_folder.read(request.data, reading_for(start, request.reading, request.data))
            self.backgrounds: tuple[ImageRecord, ...] = dataset.images
            self.ignored = frozenset(c.name for c in dataset.categories if c.ignore)
        except BaseException:
            self._trials.close()
            raise

    def background(self, number: int) -> ImageRecord:
        """Return a background by its number.

        Raises:
            DatasetError: There is no such background.
        """
        if not 0 <= number < len(self.backgrounds):
            raise DatasetError(f"background {number}: no such picture; the dataset has {len(self.backgrounds)}")
        return self.backgrounds[number]

    def read(self, recipe: str, settings: Mapping[str, object]) -> Recipe:
        """Return a recipe with settings.

        Raises:
            RecipeError: With every wrong field.
        """
        made = read_recipe(recipe, settings).recipe
        if problems := model_problems(made):
            raise RecipeError(f"recipe {made.name}: {len(problems)} field(s) are wrong", problems)
        return made

    def model_picture(self, name: str) -> bytes:
        """Return a picture of a shipped model as a JPEG, drawn once and then taken from the user's cache folder.

        Raises:
            DatasetError: No such model is shipped.
            InfraBlendError: It cannot be drawn.
        """
        if name not in list_models():
            raise DatasetError(f"model {name!r}: no such model; expected one of {', '.join(list_models())}")
        with self._drawing:
            return cached_picture("models", f"{__version__} {name}", lambda: draw_model(name))

    def number_of(self, name: str) -> int | None:
        """Return the number of the background `<split>/<id>`; None if there is none."""
        return next((n for n, i in enumerate(self.backgrounds) if f"{i.split}/{i.id}" == name), None)

    def thumbnail(self, number: int) -> bytes:
        """Return a small JPEG of a background, from the user's cache folder if its file has not changed.

        Raises:
            DatasetError: There is no such background, or it cannot be read.
        """
        path = real_path(self.background(number).path)
        return cached_thumbnail(path, lambda: decode_picture(path, "a background"))

    def compose(
        self, recipe: str, settings: Mapping[str, object], background: ImageRecord, configuration: int = 0
    ) -> Tuned:
        """Return a frame of a background.

        Raises:
            InfraBlendError: The recipe or the background cannot be used.
        """
        with self._lock:
            checked = self.read(recipe, settings)
            frame = f"{background.split}/{background.id}_c{configuration}"
            trial = self._trials.again(recipe=recipe, settings=dict(settings), frame=frame)
            return Tuned(checked, trial, background)

    def nearest_real(self, label: Instance, time_of_day: str | None) -> Rgb | None:
        """Return the annotated object of the same class that is most like an insert in size, enlarged.

        Objects at the same time of day come first. None if the dataset has no object of the class.
        """
        size = _size(label)
        best: tuple[tuple[bool, float], ImageRecord, Instance] | None = None
        for image in self.backgrounds:
            for other in image.instances:
                if other.category != label.category or other.truncated:
                    continue
                rank = (image.capture.time_of_day != time_of_day, abs(math.log(_size(other) / size)))
                if best is None or rank < best[0]:
                    best = rank, image, other
        if best is None:
            return None
        return _crop(to_rgb(decode_picture(real_path(best[1].path), "a background")), best[2])

    def save(self, recipe: Recipe, path: Path, frame_id: str) -> tuple[Path, str]:
        """Write a recipe as YAML; return its whole path, and the command that gives the frame from the shell.

        Raises:
            ArgumentError: The name does not end in .yaml.
            OutputError: The file exists, is not the same and was not saved here, or cannot be written.
        """
        if path.suffix.lower() not in (".yaml", ".yml"):
            raise ArgumentError(f"{path}: expected the name of a file that ends in .yaml")
        path = path.resolve()
        text = _to_yaml(recipe)
        # The same recipe is what a run of an earlier studio is resumed with.
        if path.exists() and path not in self._saved and not _has_text(path, text):
            raise OutputError(f"{path}: exists already, and was not saved by this studio; give another name")
        write_text(path, text)
        self._saved.add(path)
        return path, shlex.join(["infrablend", "try", str(path), *self._words(), "--frame", frame_id])

    def generate(self, recipe: Path, out: Path, *, limit: int | None, resume: bool) -> Generation:
        """Start the run of a saved recipe on all backgrounds, or of the first `limit` ones.

        Raises:
            ArgumentError: One is being made.
        """
        if self.generation is not None and self.generation.is_running:
            raise ArgumentError(f"{self.generation.out}: is being made; stop it first, or wait for its end")
        words = ["generate", str(recipe), *self._words(), "--out", str(out)]
        words += [] if limit is None else ["--limit", str(limit)]
        self.generation = Generation([*words, *(["--resume"] if resume else [])], out)
        return self.generation

    def _words(self) -> list[str]:
        """Return the options that name the backgrounds, how to read them, and the seed."""
        reading = asdict(self._reading)
        if self._reading.metadata is not None:
            reading["metadata"] = Path(self._reading.metadata).resolve()
        return ["--data", str(self.data.resolve()), "--seed", str(self.seed), *reading_words(reading)]

    def close(self) -> None:
        """End the renderer, and stop the run that is being made."""
        if self.generation is not None:
            self.generation.close()
        self._trials.close()


def _has_text(path: Path, text: str) -> bool:
    try:
        return read_regular(path) == text.encode()
    except OSError:
        return False


def _size(label: Instance) -> float:
    return max(1e-3, float(max(label.box_xyxy[2:] - label.box_xyxy[:2])))


def _crop(rgb: Rgb, label: Instance) -> Rgb:
    zoom = max(1, min(8, round(_CROP_PX / (2 * _size(label)))))
    return enlarged(rgb, label.box_xyxy.tolist(), zoom)


def tuning_request(request: StudioRequest, run: OpenedRun | None) -> TrialRequest:
    """Return what to tune: without a recipe of the user's the run's own, with its seed, on its backgrounds.

    Backgrounds that the user gave are read as the run read its own, unless the user says how.

    Raises:
        OutputError: The record of the run is damaged, or its recipe cannot be written to the cache folder.
        DatasetError: The backgrounds are not where they were.
    """
    if run is None or (request.recipe is not None and request.data is not None):
        assert request.data is not None
        recipe = request.recipe or FIRST_RECIPE
        return TrialRequest(
            recipe, request.data, seed=request.seed, reading=request.reading, execution=request.execution
        )
    recorded = RecordedRun.from_record(run.record, run.layout.run_file)
    data = request.data or recorded.data
    if not data.is_dir():
        raise DatasetError(
            f"{data}: no such folder; expected the backgrounds of this run. Its frames can be reviewed without "
            f"them; to tune, start with `infrablend studio --run {run.layout.root} --data DIR`, where they are now"
        )
    return TrialRequest(
        request.recipe or _recipe_file(recorded.recipe, run),
        data,
        seed=request.seed or recorded.seed,
        reading=recorded.reading if request.reading == READ_ALL else request.reading,
        execution=replace(request.execution, renderer=recorded.renderer),
    )


def _recipe_file(recipe: Recipe, run: OpenedRun) -> Path:
    """Write the recipe of the run to the user's cache folder: the form reads recipes from files."""
    return write_text(run.thumbnails.folder / f"{run.layout.root.resolve().name}.yaml", _to_yaml(recipe))


def _to_yaml(recipe: Recipe) -> str:
    text = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 120
    yaml.dump(recipe.model_dump(mode="json", exclude_unset=True), text)
    return text.getvalue()


_PROGRESS = re.compile(r"(\d+)/(\d+) frames\b")
# Of the command, and of a process that was stopped before the command could see to it, or twice; the last on Windows.
_STOPPED = (130, -signal.SIGTERM, 0xC000013A)
_KEPT_LINES = 200
_CLOSE_S = 20


class Generation:
    """A run being made.

    Attributes:
        command: The command, as for the shell.
        out: Folder of the run.
        done: Finished frames, as far as it has said.
        total: All frames; 0 until it has said how many.
        progress: The last line on its progress: frames, pace, time left.
        lines: What else it has said, such as warnings; the last ones.
    """

    def __init__(self, words: Sequence[str], out: Path) -> None:
        """Start `infrablend` with these words."""
        self.command = shlex.join(["infrablend", *words])
        self.out = out
        self.done = self.total = 0
        self.progress = ""
        self.lines: list[str] = []
        # In a session of its own: Ctrl-C in the terminal ends the studio, which then stops the run.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "infrablend", *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
            **IN_BACKGROUND,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as said:
            for line in said:
                if (found := _PROGRESS.search(line)) is not None:
                    self.done, self.total = int(found[1]), int(found[2])
                    self.progress = line.strip()
                elif line.strip():
                    self.lines = [*self.lines, line.rstrip()][-_KEPT_LINES:]

    @property
    def is_running(self) -> bool:
        """Whether it goes on, or has not yet been heard to its end."""
        return self._process.poll() is None or self._reader.is_alive()

    @property
    def is_complete(self) -> bool:
        """Whether the run is there."""
        return self._process.poll() == 0

    @property
    def state(self) -> str:
        """What has become of it, in words."""
        code = self._process.poll()
        if code is None:
            return self.progress or "Starting..."
        if code == 0:
            return f"Done. Review it with: {shlex.join(['infrablend', 'studio', '--run', str(self.out)])}"
        if code in _STOPPED and not self.total:
            return "Stopped before it began."
        if code in _STOPPED:
            return f"Stopped. To go on, choose Resume, or: {self.command.removesuffix(' --resume')} --resume"
        return f"It {describe_exit(code)}."

    def stop(self) -> None:
        """Do what Ctrl-C does: finished frames are kept for `--resume`. A second time ends it at once."""
        if self._process.poll() is None:
            ask_to_stop(self._process)

    def close(self) -> None:
        """Stop it, and wait for its end."""
        for end in (self.stop, self.stop, self._process.kill):
            end()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_CLOSE_S)
                break
        self._reader.join()
