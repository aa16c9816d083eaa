"""The Python interface: what the command line calls, and what to import from a notebook.

from infrablend import api

report = api.generate("hit-uav-drone", data="hit-uav", out="runs/first", limit=10)
print(report.counts)
api.preview("runs/first", "runs/first/preview.png")
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from infrablend.assets import catalogue
from infrablend.config import loading
from infrablend.core.dataset import Dataset
from infrablend.core.output import require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.errors import DatasetError, OutputError
from infrablend.fetching import fetch as fetching
from infrablend.fetching.fetch import FetchReport, OnFetch
from infrablend.formats import detection
from infrablend.formats.reading import Reading
from infrablend.formats.writing import WriteSettings
from infrablend.pipeline import world
from infrablend.pipeline.convert import ConvertReport, convert_dataset
from infrablend.pipeline.experiment_inputs import (
    default_results,
    training_seconds,
)
from infrablend.pipeline.experiment_inputs import preset_facts as _preset
from infrablend.pipeline.experiment_inputs import require_training as _require_training
from infrablend.pipeline.experiment_inputs import require_training_settings as _require_settings
from infrablend.pipeline.generate import describe_run, generate_run
from infrablend.pipeline.models import ready_model, run_once
from infrablend.pipeline.realism import RealismReport, Time, compare
from infrablend.pipeline.request import Execution, RunRequest, Settings
from infrablend.pipeline.rerender import rerender_frame
from infrablend.pipeline.run import RunReport
from infrablend.pipeline.select import Selection
from infrablend.pipeline.train import (
    TrainPlan,
    TrainReport,
    choose_preset,
    plan_training,
    train_dataset,
)
from infrablend.world.dataset import WorldRequest

if TYPE_CHECKING:
    from infrablend.pipeline.evaluate import EvaluationReport
    from infrablend.pipeline.experiment import ExperimentPlan, ExperimentReport
    from infrablend.pipeline.profile import ProfileReport
    from infrablend.pipeline.split import SplitReport
    from infrablend.pipeline.stages import Setting
    from infrablend.report.checking import CheckReport
    from infrablend.report.inspection import Inspection

__all__ = [
    "ConvertReport",
    "FetchReport",
    "PlanReport",
    "RealismReport",
    "RunReport",
    "TrainPlan",
    "TrainReport",
    "check",
    "compare_evaluations",
    "convert",
    "describe_source",
    "diagnose",
    "evaluate",
    "experiment",
    "fetch",
    "generate",
    "inspect",
    "list_experiments",
    "list_models",
    "list_recipes",
    "list_sources",
    "make_world",
    "plan",
    "plan_experiment",
    "plan_train",
    "preview",
    "preview_ground",
    "profile",
    "read_dataset",
    "realism",
    "rerender",
    "show_model",
    "show_recipe",
    "split",
    "train",
    "write_infrared_effect",
]


@dataclass(frozen=True)
class PlanReport:
    """What a run would do: frames, disk, time; nothing has been done."""

    facts: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return dict(self.facts)


def generate(
    recipe: str | Path,
    data: str | Path,
    out: str | Path,
    *,
    limit: int | None = None,
    splits: Sequence[str] | None = None,
    seed: int = 0,
    workers: int | None = None,
    device: str = "auto",
    formats: Sequence[str] | None = None,
    form: str | None = None,
    metadata: str | Path | None = None,
    options: Mapping[str, str] | None = None,
    settings: Settings = (),
    resume: bool = False,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
    renderer: str = "blender",
    in_process: bool = False,
) -> RunReport:
    """Insert rendered objects into a dataset and write the enlarged dataset with merged labels.

    Args:
        recipe: A shipped recipe's name, or the path of a YAML file.
        data: Folder of the background dataset.
        out: Folder to write; must be new or empty unless `resume` or `overwrite`.
        limit: Only the first so many backgrounds in sorted order.
        splits: Some of train, val, test; all by default.
        seed: Same seed, same data, same recipe: same bytes.
        workers: Worker processes; one per processor core by default.
        device: auto, cpu, cuda, optix, hip, metal, oneapi.
        formats: Some of yolo, coco, ... (docs/reference/formats.md) and native; as the recipe says by default.
        form: Read only this form of the dataset (HIT-UAV: normal_json, rotate_json, normal_xml, rotate_xml).
        metadata: Table of pitch and altitude (CSV or JSON), for datasets that do not say it themselves.
        options: Further options of the dataset's reader, e.g. `{"pitch_sign": "-1"}` for MONET.
        settings: Recipe fields to set: `["output.image=png"]` or `{"output.image": "png"}`.
        resume: Go on with an interrupted run in `out`.
        overwrite: Delete an earlier run in `out` first.
        on_progress: Called after each frame.
        renderer: `blender`; `fake` draws flat shapes without Blender.
        in_process: Make frames in this process; only for `renderer="fake"`.

    Raises:
        RecipeError, DatasetError, ModelError, OutputError, RenderError, Interrupted: See `infrablend.errors`.
    """
    request = _run_request(
        recipe, data, out, limit, seed, formats, settings, _reading(splits, None, form, metadata, options)
    )
    if resume and overwrite:
        raise OutputError("--resume and --overwrite exclude each other: go on with the run, or begin it anew")
    request = replace(
        request,
        execution=Execution(workers, device, renderer, in_process),
        existing="resume" if resume else "overwrite" if overwrite else "refuse",
    )
    return generate_run(request, on_progress)


def plan(
    recipe: str | Path,
    data: str | Path,
    out: str | Path | None = None,
    *,
    limit: int | None = None,
    splits: Sequence[str] | None = None,
    seed: int = 0,
    workers: int | None = None,
    device: str = "auto",
    formats: Sequence[str] | None = None,
    form: str | None = None,
    metadata: str | Path | None = None,
    options: Mapping[str, str] | None = None,
    settings: Settings = (),
) -> PlanReport:
    """What `generate` with the same arguments would do: frames, disk, estimated time. Writes nothing."""
    request = _run_request(
        recipe, data, out, limit, seed, formats, settings, _reading(splits, None, form, metadata, options)
    )
    return PlanReport(describe_run(replace(request, execution=Execution(workers, device))))


def _run_request(
    recipe: str | Path,
    data: str | Path,
    out: str | Path | None,
    limit: int | None,
    seed: int,
    formats: Sequence[str] | None,
    settings: Settings,
    reading: Reading,
) -> RunRequest:
    pairs: Settings = settings
    if formats is not None:
        wanted = list(formats)
        pairs = (
            {**settings, "output.formats": wanted}
            if isinstance(settings, Mapping)
            else [*settings, f"output.formats=[{', '.join(wanted)}]"]
        )
    return RunRequest(recipe, Path(data), None if out is None else Path(out), limit, seed, pairs, reading)


def _reading(
    splits: Sequence[str] | None,
    format: str | None,
    form: str | None,
    metadata: str | Path | None,
    options: Mapping[str, str] | None,
) -> Reading:
    return Reading(splits, format, form, metadata, options or {})


def read_dataset(
    data: str | Path,
    *,
    splits: Sequence[str] | None = None,
    form: str | None = None,
    metadata: str | Path | None = None,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
) -> Dataset:
    """A background dataset in memory, its format detected.

    Args:
        data: The folder.
        splits: The splits wanted; all by default.
        form: Read only this form (HIT-UAV).
        metadata: CSV or JSON table of pitch and altitude, for datasets that do not say it themselves.
        format: Name of the format; detected by default.
        options: Further options of that format's reader, e.g. `{"pitch_sign": "-1"}`.

    Raises:
        UnknownFormatError: With the reason for each format that does not match.
        DatasetError: If it cannot be read.
    """
    return detection.read(Path(data), _reading(splits, format, form, metadata, options))


def fetch(
    name: str,
    out: str | Path,
    *,
    parts: Sequence[str] | None = None,
    url: str | None = None,
    sha256: str | None = None,
    archive: str | Path | None = None,
    keep_archive: bool = False,
    on_progress: OnFetch | None = None,
) -> FetchReport:
    """Fetch a public dataset, check and unpack it, and record its source and licence in `out/SOURCE.json`.

    The same call goes on with what an interrupted one left.

    Args:
        name: See `list_sources`.
        out: Folder to write; new, empty, or of an earlier fetch of the same dataset.
        parts: Some of its files; all by default.
        url: Where to fetch the file instead.
        sha256: What the file's SHA-256 must be.
        archive: Unpack this file, fetched by hand, instead.
        keep_archive: Leave the archive in `out` too.
        on_progress: Called while bytes arrive and files are unpacked.

    Raises:
        DatasetError: One that no program can fetch (the message says where it is), or an archive that is damaged,
            hostile or not the dataset.
        FetchError, OutputError, Interrupted: The network; the folder or the disk; Ctrl-C.
    """
    file = None if archive is None else Path(archive)
    return fetching.fetch(
        name,
        Path(out),
        parts=parts,
        url=url,
        sha256=sha256,
        archive=file,
        keep_archive=keep_archive,
        on_progress=on_progress,
    )


def list_sources() -> list[dict[str, Any]]:
    """The public datasets that `fetch` knows: name, title, page, licence, parts, whether a program can fetch them."""
    return fetching.list_sources()


def describe_source(name: str, *, licence_only: bool = False) -> str:
    """Where a public dataset is, its licence, and how to get it."""
    source = fetching.require_source(name)
    return "\n".join([source.title, *fetching.licence_lines(source)]) if licence_only else fetching.how_to_get(source)


def inspect(
    data: str | Path,
    out: str | Path | None = None,
    *,
    splits: Sequence[str] | None = None,
    form: str | None = None,
    metadata: str | Path | None = None,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
    decode: bool = False,
) -> Inspection:
    """What a dataset holds: splits, classes, sizes, coverage, sequences, leakage, problems.

    Args:
        data: The folder.
        out: Folder for `inspect.png` (charts) and `inspect.json`; nothing is written if None.
        splits: As in `read_dataset`, and so are `form`, `metadata`, `format`, `options`.
        form: See `read_dataset`.
        metadata: See `read_dataset`.
        format: See `read_dataset`.
        options: See `read_dataset`.
        decode: Decode every picture: bit depth, channels, grey levels, broken files.

    Raises:
        DatasetError: It cannot be read.
        OutputError: `out` cannot be written.
    """
    from infrablend.pipeline.examine import inspect_folder

    reading = _reading(splits, format, form, metadata, options)
    return inspect_folder(Path(data), None if out is None else Path(out), reading=reading, decode=decode)


def check(
    data: str | Path,
    *,
    splits: Sequence[str] | None = None,
    form: str | None = None,
    metadata: str | Path | None = None,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
    decode: bool = True,
    on_progress: OnProgress | None = None,
) -> CheckReport:
    """Every problem of labels and pictures at once; `report.ok(strict)` judges.

    A dataset whose reader gives up is a report, too, with errors.

    Args:
        data: The folder.
        splits: As in `read_dataset`, and so are `form`, `metadata`, `format`, `options`.
        form: See `read_dataset`.
        metadata: See `read_dataset`.
        format: See `read_dataset`.
        options: See `read_dataset`.
        decode: Decode the pictures; else only their headers are read.
        on_progress: Called after each picture.

    Raises:
        UnknownFormatError: No format fits.
        DatasetError: There is no such folder, or an option that the format does not have.
    """
    from infrablend.pipeline.examine import check_folder

    reading = _reading(splits, format, form, metadata, options)
    return check_folder(Path(data), reading=reading, decode=decode, on_progress=on_progress)


def split(
    data: str | Path,
    out: str | Path,
    *,
    by: str,
    gap: int | None = None,
    shares: Sequence[float] = (0.7, 0.1, 0.2),
    seed: int = 0,
    to: str | None = None,
    lists: bool = False,
    form: str | None = None,
    metadata: str | Path | None = None,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
) -> SplitReport:
    """Write a dataset with new splits that share no neighbours; see `infrablend.pipeline.split.split_dataset`.

    Args:
        data: The folder.
        out: Folder to write, new or empty.
        by: `sequence`, `date` or `gap`: what stays together.
        gap: For `by="gap"`: a run of frames ends where the next frame number is more than so many away; 5 if None.
        shares: Of train, val and test.
        seed: For the order in which groups are dealt out.
        to: A format to write; its own by default.
        lists: Write three lists of pictures and `split.json` alone.
        form: See `read_dataset`.
        metadata: See `read_dataset`.
        format: See `read_dataset`.
        options: See `read_dataset`.

    Raises:
        DatasetError: It cannot be read, or does not say what shall stay together.
        OutputError: `out` is not empty or cannot be written.
    """
    from infrablend.formats.groups import GROUPINGS, NEAR
    from infrablend.pipeline.split import split_dataset

    root, target = Path(data), Path(out)
    require_apart(root, target)
    kind = next((b for b in GROUPINGS if b == by), None)
    if kind is None:
        raise DatasetError(f"by: found {by!r}, expected one of {', '.join(GROUPINGS)}")
    dataset = read_dataset(root, form=form, metadata=metadata, format=format, options=options)
    return split_dataset(
        dataset, target, by=kind, gap=NEAR if gap is None else gap, shares=shares, seed=seed, to=to or "native",
        lists=lists,
    )  # fmt: skip


def convert(
    source: str | Path,
    out: str | Path,
    to: str,
    *,
    splits: Sequence[str] | None = None,
    format: str | None = None,
    form: str | None = None,
    metadata: str | Path | None = None,
    options: Mapping[str, str] | None = None,
    rename: Mapping[str, str] | None = None,
    drop: Sequence[str] = (),
    only: str | None = None,
    with_class: str | None = None,
    without: Sequence[str] = (),
    images: int | None = None,
    objects: int | None = None,
    like: str | None = None,
    seed: int = 0,
    loosen: float = 1.0,
    ids: Literal["new", "source"] = "new",
    category_ids: Literal["source", "from_one"] = "source",
    dont_care: Literal["drop", "keep"] = "drop",
    without_mask: Literal["omit", "obb"] = "omit",
    overwrite: bool = False,
) -> ConvertReport:
    """Write a dataset in another format. Pictures are hard links (copies where links are impossible).

    Args:
        source: Folder of the dataset.
        out: Folder to write; must be new or empty unless `overwrite`.
        to: The format: yolo, yolo-obb, yolo-seg, coco, ... (docs/formats/index.md), or native: the source's own.
        splits: Some of train, val, test; all by default.
        format: Format of the source; detected by default.
        form: Read only this form (HIT-UAV).
        metadata: CSV or JSON table of pitch and altitude.
        options: Further options of the source's reader.
        rename: Other names for classes; several may become one.
        drop: Classes to leave out, by the name after renaming.
        only: The one class to keep, instead of `drop`.
        with_class: Only pictures that show this class.
        without: Only pictures that show none of these classes (regions to ignore may be among them).
        images: Draw as many of the pictures.
        objects: Draw them so that they show as many objects of `with_class`, or as nearly as can be.
        like: Draw the pictures, some several times, so that times of day, heights and pitches are shared out as among
            those that show this class.
        seed: Of the draw.
        loosen: Make inserted objects' axis-aligned boxes so many times as wide and high, as annotators by hand leave
            room; counted, and said in the card. Oriented boxes and masks stay.
        ids: Image and annotation ids numbered anew, or the source's own.
        category_ids: The source's, or numbered from 1 (many tools take COCO's category 0 for background).
        dont_care: YOLO: regions to ignore are left out, or kept as a class.
        without_mask: yolo-seg: objects without mask are left out, or their oriented box is written.
        overwrite: Replace an earlier conversion in `out`.

    Raises:
        UnknownFormatError, DatasetError, OutputError: See `infrablend.errors`.
    """
    require_apart(Path(source), Path(out))
    dataset = read_dataset(source, splits=splits, form=form, metadata=metadata, format=format, options=options)
    settings = WriteSettings(ids, category_ids, dont_care, without_mask)
    return convert_dataset(
        dataset,
        to,
        Path(out),
        rename=rename,
        drop=drop,
        only=only,
        selection=Selection(with_class, tuple(without), images, objects, like, seed),
        loosen=loosen,
        settings=settings,
        overwrite=overwrite,
    )


def train(
    dataset: str | Path,
    out: str | Path,
    *,
    preset: str = "small",
    task: str = "detect",
    weights: str = "auto",
    device: str = "auto",
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    classes: Sequence[str] | None = None,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
    resume: bool = False,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> TrainReport:
    """Train a detector on a dataset, with Ultralytics (the extra `train`).

    Args:
        dataset: Folder of a dataset of any format that can be read; a run of `generate` is one.
        out: Folder for `weights.pt` and `train.json`.
        preset: `paper`, `small` or `smoke`, see `training.presets`.
        task: detect, obb or segment.
        weights: Where to start: a file, a name such as `yolov8s.pt`, `scratch`, or `auto`: the preset's own published
            weights if they can be had, else from scratch.
        device: auto, cpu, mps, cuda, or one GPU as `cuda:1` or `1`.
        seed: Of weights, order, augmentation and tiles.
        settings: Fields of the preset set otherwise (`{"passes": 4000}`), and arguments of Ultralytics.
        classes: Train on these classes only.
        format: Format of the dataset; detected by default.
        options: Of its reader.
        resume: Go on with an interrupted training.
        overwrite: Replace an earlier training in `out`.
        on_progress: Told the images passed.

    Raises:
        InfraBlendError: Of many kinds, see `pipeline.train.train_dataset`.
    """
    require_apart(Path(dataset), Path(out))
    chosen = choose_preset(preset, settings or {})
    found = read_dataset(dataset, format=format, options=options)
    return train_dataset(
        found,
        Path(out),
        preset=chosen,
        task=task,
        start=weights,
        device=device,
        seed=seed,
        classes=classes,
        resume=resume,
        overwrite=overwrite,
        on_progress=on_progress,
    )


def plan_train(
    dataset: str | Path,
    *,
    preset: str = "small",
    task: str = "detect",
    settings: Mapping[str, Any] | None = None,
    classes: Sequence[str] | None = None,
    device: str = "auto",
    seed: int = 0,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
    weights: str = "auto",
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> TrainPlan:
    """What `train` would do: images, epochs, time, disk. Nothing is written; what `train` would refuse is refused."""
    chosen = choose_preset(preset, settings or {})
    found = read_dataset(dataset, format=format, options=options)
    return plan_training(
        found, chosen, task=task, classes=classes, device=device, seed=seed, start=weights,
        out=None if out is None else Path(out), resume=resume, overwrite=overwrite,
    )  # fmt: skip


def list_models() -> dict[str, str]:
    """Names of the shipped models and what they are."""
    return {name: catalogue.load_model(name).description for name in catalogue.list_models()}


def list_recipes() -> dict[str, str]:
    """Names of the shipped recipes and what they are for."""
    return {name: loading.load_recipe(name).description for name in loading.list_recipes()}


def show_recipe(name: str) -> str:
    """YAML text of a shipped recipe."""
    return loading.recipe_text(name)


def show_model(name: str, out: str | Path, seed: int = 0) -> Path:
    """Render a model from all sides onto one sheet, a PNG."""
    ready_model(name)
    return Path(run_once("infrablend.blender.turntable:make_turntable", (name, str(out), seed), f"show {name}"))


def preview(run: str | Path, out: str | Path, count: int = 12, draw: Sequence[str] = ("boxes", "obb", "masks")) -> Path:
    """Write a contact sheet of a run: boxes, oriented boxes and masks drawn, inserted objects enlarged."""
    from infrablend.report.preview import preview_run

    return preview_run(Path(run), Path(out), count, draw)  # type: ignore[arg-type]


def preview_ground(run: str | Path, out: str | Path, count: int = 6) -> Path:
    """Draw the ground plane and people of 1.7 m over frames of a run with metric placement: is the scale right?"""
    from infrablend.report.ground import ground_sheet

    return ground_sheet(Path(run), Path(out), count)


def profile(
    data: str | Path,
    out: str | Path,
    *,
    count: int = 64,
    splits: Sequence[str] | None = None,
    time: str | None = None,
    name: str | None = None,
    against: str | None = None,
    options: Mapping[str, str] | None = None,
    on_progress: OnProgress | None = None,
) -> ProfileReport:
    """Fit a sensor profile to a folder of pictures or a dataset; writes `profile.json` and `profile.png`.

    Args:
        data: The folder; labels are not needed, annotated objects are left out of what is measured on edges and grain.
        out: Folder to write, apart from `data`. Recipes take its `profile.json` as `sensor.profile`.
        count: How many pictures to read, evenly spread.
        splits: Some of train, val, test; all by default.
        time: Only pictures of `day` or `night`.
        name: Of the profile; the folder's by default.
        against: A shipped profile to compare with.
        options: Options of the dataset's reader.
        on_progress: Called after each picture.

    Raises:
        DatasetError: No picture can be used, no contrast, or too few clean edges.
        RecipeError: No shipped profile `against`.
        OutputError: `out` cannot be written.
    """
    from infrablend.pipeline.profile import profile_dataset

    require_apart(Path(data), Path(out))
    dataset = read_dataset(data, splits=splits, options=options)
    if time is not None:
        chosen = tuple(i for i in dataset.images if i.time_of_day == time)
        if not chosen:
            raise DatasetError(f"{data}: none of {len(dataset.images)} picture(s) is known to be taken by {time}")
        dataset = replace(dataset, images=chosen)
    return profile_dataset(dataset, Path(out), count=count, name=name, against=against, on_progress=on_progress)


def rerender(run: str | Path, frame_id: str, out: str | Path | None = None, *, data: str | Path | None = None) -> Path:
    """Make one frame of a run again, alone; the same bytes as the first time."""
    return rerender_frame(Path(run), frame_id, None if out is None else Path(out), None if data is None else Path(data))


def realism(
    run: str | Path,
    against: str | Path,
    out: str | Path | None = None,
    *,
    categories: Sequence[str] | None = None,
    time_of_day: Time = "all",
    pairs: int = 1000,
    workers: int | None = None,
    options: Mapping[str, str] | None = None,
    on_progress: OnProgress | None = None,
    in_process: bool = False,
) -> RealismReport:
    """Compare a run's inserted objects with the real ones of the same class; needs the extra `infrablend[realism]`.

    Args:
        run: Folder of a finished run whose objects have the class of real ones.
        against: The dataset that it was made from.
        out: Folder for `realism.json`, `realism.html` and the sheets; `realism` in the run's folder by default.
        categories: Classes; all that are both inserted and annotated by default.
        time_of_day: Only images of that time.
        pairs: At most so many pairs of each class.
        workers: Processes; one per processor core by default.
        options: Options of the dataset's reader.
        on_progress: Called after each picture.
        in_process: Do it all in this process; only for runs made with `renderer="fake"`.

    Raises:
        MissingDependencyError: scikit-learn is not installed.
        OutputError, DatasetError, RenderError, Interrupted: See `infrablend.errors`.
    """
    folder = Path(run)
    return compare(
        folder,
        read_dataset(against, options=options),
        folder / "realism" if out is None else Path(out),
        categories=categories,
        time_of_day=time_of_day,
        most_pairs=pairs,
        workers=Execution(workers).worker_count(),
        in_process=in_process,
        on_progress=on_progress,
    )


def evaluate(
    weights: str | Path,
    dataset: str | Path,
    out: str | Path,
    *,
    split: str = "test",
    task: str | None = None,
    device: str = "auto",
    classes: Sequence[str] | None = None,
    format: str | None = None,
    form: str | None = None,
    metadata: str | Path | None = None,
    options: Mapping[str, str] | None = None,
    image_size: int = 640,
    ignore_regions: bool = True,
    bootstrap: int = 1000,
    group: str = "image",
    seed: int = 0,
    against: str | Path | None = None,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> EvaluationReport:
    """Judge a detector on a split: tables, strata, intervals, plots; weights need the extra `infrablend[train]`.

    Writes `predictions.json`, `evaluation.json`, `evaluation.html`, `matches.npz` and `plots/`; see
    docs/how_to/evaluate.md for what each figure means.

    Args:
        weights: A .pt file of Ultralytics', or the folder of a finished `train`; or the `predictions.json` (or folder)
            of an earlier evaluation, which needs neither torch nor Ultralytics.
        dataset: Folder of the dataset.
        out: Folder to write; new or empty, or an earlier evaluation with `overwrite`.
        split: train, val or test.
        task: detect, obb, segment; what the detector finds by default. `detect` judges the boxes of any.
        device: auto, cpu, cuda, cuda:1, mps.
        classes: Those of the dataset to judge, by name; all by default. A detector has to know all of them.
        format: As in `read_dataset`, and so are `form`, `metadata`, `options`.
        form: See `read_dataset`.
        metadata: See `read_dataset`.
        options: See `read_dataset`.
        image_size: The longer side the network sees, px; 0: each picture's own.
        ignore_regions: What is found in regions to ignore (DontCare) counts neither way.
        bootstrap: Draws for the intervals; 0: none.
        group: What is drawn: image, sequence, date, gap (runs of frame numbers).
        seed: Of the draws.
        against: Folder of another evaluation on the same images and labels, to compare with.
        overwrite: Replace an earlier evaluation in `out`.
        on_progress: Called after each few pictures.

    Raises:
        MissingDependencyError: Ultralytics is not installed, or the device is not there.
        ModelError, DatasetError, OutputError: See `infrablend.errors`; all that is wrong at once.
    """
    from infrablend.pipeline.evaluate import evaluate_detector

    root, target = Path(dataset), Path(out)
    require_apart(root, target)
    data = read_dataset(root, form=form, metadata=metadata, format=format, options=options)
    return evaluate_detector(
        Path(weights), data, target, split=split, task=task, device=device, classes=classes, image_size=image_size,
        ignore_regions=ignore_regions, bootstrap=bootstrap, group=group, seed=seed,
        against=None if against is None else Path(against), overwrite=overwrite, on_image=paced(on_progress),
    )  # fmt: skip


def compare_evaluations(
    ours: str | Path | Sequence[str | Path],
    theirs: str | Path | Sequence[str | Path],
    *,
    classes: Sequence[str] | None = None,
    bootstrap: int = 1000,
    seed: int = 0,
) -> dict[str, Any]:
    """Two evaluations on the same images, by class: the difference of mAP50 and mAP50-95 with its interval.

    Args:
        ours: Folder that `evaluate` wrote; or several, of detectors trained alike but for the seed: their mean is
            compared, and the interval holds what another seed would change.
        theirs: Another one, or several, on the same images and labels.
        classes: Those to compare; all that both judged by default.
        bootstrap: Draws of the images (or groups, as `ours` was made with), the same for both.
        seed: Of the draws.

    Raises:
        DatasetError: One is no finished evaluation, or images, labels, split, task, groups or treatment of
            regions differ.
    """
    from infrablend.pipeline import evaluate as judging

    first, second = ([Path(s)] if isinstance(s, str | Path) else [Path(p) for p in s] for s in (ours, theirs))
    return judging.compare_evaluations(first, second, classes=classes, bootstrap=bootstrap, seed=seed)


def make_world(
    out: str | Path,
    count: int,
    seed: int = 0,
    *,
    layout: Literal["hit-uav", "monet"] = "hit-uav",
    workers: int | None = None,
    on_progress: OnProgress | None = None,
) -> Path:
    """Render a background dataset of a virtual thermal world, with exact labels and without any download.

    `layout` is that of HIT-UAV (640x512, a town) or MONET (800x600, airfields and dirt roads, telemetry in the JSON,
    some of it lost). It always renders on the CPU.
    """
    world.make_world(Path(out), WorldRequest(count, seed, layout), Execution(workers).worker_count(), on_progress)
    return Path(out)


def write_infrared_effect(path: str | Path) -> Path:
    """Write the InfraredEffect node group as a .blend to append from."""
    return Path(run_once("infrablend.blender.jobs:make_asset_writer", str(path), "infrared-effect"))


def diagnose() -> Any:
    """What this machine has and lacks: Python, Blender, libraries, devices, disk."""
    from infrablend.report.doctor import diagnose as survey

    return survey()


def list_experiments() -> dict[str, str]:
    """Names of the shipped experiments and what they ask."""
    from infrablend.config import experiment as experiments

    return {name: experiments.load_experiment(name).description for name in experiments.list_experiments()}


def experiment(
    name: str | Path,
    data: str | Path | Sequence[str | Path] = (),
    work: str | Path = "experiments",
    out: str | Path | None = None,
    *,
    scale: str = "small",
    seed: int = 0,
    device: str = "auto",
    training: Mapping[str, Any] | None = None,
    only: Sequence[str] = (),
    adopt: Mapping[str, str | Path] | None = None,
    workers: int | None = None,
    renderer: str = "blender",
    on_stage: Callable[[str, str, int, int], None] | None = None,
    on_progress: OnProgress | None = None,
) -> ExperimentReport:
    """Run an experiment: data, trainings, evaluations, comparisons, page. The same call goes on after any interruption.

    Stages lie in `work` by the digest of what decides them: experiments share those that are the same, and a finished
    experiment makes nothing anew.

    Args:
        name: Of a shipped experiment, or the path of a YAML file.
        data: Folders of the datasets that it needs, told apart by their formats.
        work: Folder of the stages.
        out: Folder of the page, its JSON and plots; `default_results` by default.
        scale: `paper`, `small` or `smoke`.
        seed: Of scenes, splits and trainings.
        device: Of the trainer: auto, cpu, cuda:0, ...
        training: Settings of every training over those of the scale's preset, as in `train`.
        only: Kinds (`generate`), names or ids (`train:fixed`) of stages: these, and what they need.
        adopt: Folders of trainings, runs and datasets made by `train`, `generate` and `convert`, by id of the stage to
            take them for (`train:fixed`). Trainings and runs are checked; how datasets were made cannot be.
        workers: Rendering processes; one per processor core by default.
        renderer: `blender`; `fake` draws flat shapes, for tests.
        on_stage: Told of each stage: id; `there`, `begins` or `done`; its number; how many.
        on_progress: Given to the stages.

    Raises:
        RecipeError, DatasetError, OutputError, MissingDependencyError, RenderError, Interrupted: See
            `infrablend.errors`. The page is written as far as it goes.
    """
    from infrablend.pipeline import experiment as experiments

    loaded, graph, setting = _experiment(
        name, data, work, scale, seed, device, training, workers, renderer, on_progress
    )
    target = _results_folder(graph.given.values(), setting, out)
    folders = {i: Path(folder) for i, folder in (adopt or {}).items()}
    return experiments.run_experiment(loaded, graph, setting, target, only=only, adopt=folders, on_stage=on_stage)


def plan_experiment(
    name: str | Path,
    data: str | Path | Sequence[str | Path] = (),
    work: str | Path = "experiments",
    out: str | Path | None = None,
    *,
    scale: str = "small",
    seed: int = 0,
    device: str = "auto",
    training: Mapping[str, Any] | None = None,
    only: Sequence[str] = (),
    adopt: Mapping[str, str | Path] | None = None,
    renderer: str = "blender",
) -> ExperimentPlan:
    """What `experiment` with the same arguments would do: stages, images, passes, disk, time. Writes nothing."""
    from infrablend.pipeline import experiment as experiments

    loaded, graph, setting = _experiment(name, data, work, scale, seed, device, training, None, renderer, None)
    _results_folder(graph.given.values(), setting, out)
    folders = {i: Path(folder) for i, folder in (adopt or {}).items()}
    return experiments.plan_experiment(loaded, graph, setting, only=only, adopt=folders)


def _results_folder(data: Iterable[Path], setting: Setting, out: str | Path | None) -> Path:
    """Where the page goes, apart from the data."""
    target = default_results(setting.work, setting.scale) if out is None else Path(out)
    for folder in data:
        require_apart(folder, target)
    return target


def _experiment(
    name: str | Path,
    data: str | Path | Sequence[str | Path],
    work: str | Path,
    scale: str,
    seed: int,
    device: str,
    training: Mapping[str, Any] | None,
    workers: int | None,
    renderer: str,
    on_progress: OnProgress | None,
) -> tuple[Any, Any, Any]:
    """The experiment, its stages, and how they are made."""
    from infrablend.config.experiment import SCALES, load_experiment
    from infrablend.pipeline import experiment as experiments
    from infrablend.pipeline.stages import Setting, Tools

    loaded = load_experiment(name)
    known = next((s for s in SCALES if s == scale), None)
    if known is None:
        raise DatasetError(f"scale: found {scale!r}, expected one of {', '.join(SCALES)}")
    folders = [Path(data)] if isinstance(data, str | Path) else [Path(d) for d in data]
    for folder in folders:
        require_apart(folder, Path(work))
    given = experiments.assign(loaded, folders)
    tools = Tools(
        read_dataset, generate, split, make_world, train, evaluate, compare_evaluations, _preset, training_seconds,
        _require_training, _require_settings,
    )  # fmt: skip
    setting = Setting(Path(work), known, seed, device, tools, dict(training or {}), renderer, workers, on_progress)
    return loaded, experiments.build(loaded, given, setting), setting
