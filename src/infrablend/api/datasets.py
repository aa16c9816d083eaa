"""Datasets: fetch, read, examine, convert and split them; extract frames; fit a sensor profile."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.annotation.looseness import Looseness
from infrablend.core.dataset import Dataset
from infrablend.core.tasks import OnProgress
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import READ_ALL, Reading, WriteSettings
from infrablend.pipeline.datasets.convert import ConvertReport, convert_dataset
from infrablend.pipeline.datasets.requests import KEEP_CLASSES, SELECT_ALL, ClassChanges, Selection, SplitRule
from infrablend.pipeline.datasets.split import SplitReport, split_dataset
from infrablend.pipeline.storage import fetch as fetching
from infrablend.pipeline.storage.fetch import FETCH_ALL, FetchReport, FetchRequest, OnFetch

if TYPE_CHECKING:
    from infrablend.pipeline.extraction.camera_motion import MotionReport
    from infrablend.pipeline.extraction.clips import FlightFacts, FrameChoice
    from infrablend.pipeline.extraction.count_scale import CountScale
    from infrablend.pipeline.extraction.temperature_pictures import TemperaturesReport
    from infrablend.pipeline.extraction.video_frames import FramesReport
    from infrablend.pipeline.studies.estimate_camera import CameraReport, CameraSettings
    from infrablend.pipeline.studies.profile import ProfileReport
    from infrablend.pipeline.studies.surface_maps import LearnedReport, PlacesReport
    from infrablend.report.checking import CheckReport
    from infrablend.report.inspection import Inspection


def fetch(
    name: str, out: str | Path, request: FetchRequest = FETCH_ALL, *, on_progress: OnFetch | None = None
) -> FetchReport:
    """Download a public dataset, check and unpack it, and record its source and licence in `out/SOURCE.json`.

    `list_sources` lists the names. Calling it again with other parts adds them to `out`.
    """
    return fetching.fetch(name, Path(out), request, on_progress=on_progress)


def describe_source(name: str, *, licence_only: bool = False) -> str:
    """Return the source, licence and download steps of a public dataset."""
    source = fetching.require_source(name)
    if licence_only:
        return "\n".join([source.title, *fetching.licence_lines(source)])
    return fetching.fetch_instructions(source)


def read_dataset(data: str | Path, reading: Reading = READ_ALL) -> Dataset:
    """Read a dataset of any supported format into memory.

    >>> dataset = read_dataset("hit-uav", Reading(splits=("train",)))
    >>> dataset.format, len(dataset.images)
    ('hit-uav', 2)

    Raises:
        UnknownFormatError: No format fits, as there is no picture to read.
        DatasetError: The folder cannot be read.
    """
    return dataset_folder.read(Path(data), reading)


def inspect(
    data: str | Path, out: str | Path | None = None, *, reading: Reading = READ_ALL, decode: bool = False
) -> Inspection:
    """Return splits, classes, sizes, coverage, sequences, leakage and problems of a dataset.

    `out` is the folder for `inspect.png` and `inspect.json`; None writes nothing. `decode` also decodes every picture
    for bit depth, channels, grey levels and broken files.
    """
    from infrablend.pipeline.studies.examine import inspect_folder

    return inspect_folder(Path(data), None if out is None else Path(out), reading=reading, decode=decode)


def check(
    data: str | Path, *, reading: Reading = READ_ALL, decode: bool = True, on_progress: OnProgress | None = None
) -> CheckReport:
    """Return every problem of the labels and pictures of a dataset; without `decode`, only picture headers are read.

    >>> check("hit-uav").ok(strict=False)
    True
    """
    from infrablend.pipeline.studies.examine import check_folder

    return check_folder(Path(data), reading=reading, decode=decode, on_progress=on_progress)


def convert(
    source: str | Path,
    out: str | Path,
    to: str,
    *,
    reading: Reading = READ_ALL,
    classes: ClassChanges = KEEP_CLASSES,
    selection: Selection = SELECT_ALL,
    loosen: float = 1.0,
    loosen_px: float = 0.0,
    writing: WriteSettings | None = None,
    overwrite: bool = False,
) -> ConvertReport:
    """Write a dataset in another format. Pictures are hard links, or copies where links are impossible.

    `to` is a format such as yolo, yolo-obb, yolo-seg or coco, or `native` for the format of the source. `loosen`
    enlarges the boxes of inserted objects by a factor from 1 to 2, to match hand-drawn boxes, and `loosen_px` moves
    each of their sides outwards by 0 to 32 px.

    Of detections, the folder of `detect`, those that were accepted in the studio become labels.

    >>> people = ClassChanges(only="Person")
    >>> convert("hit-uav", "converted", "coco", classes=people).format
    'coco'
    """
    from infrablend.pipeline.flights.reviewed_detections import accepted_objects, is_detections

    folder = Path(source)
    dataset = accepted_objects(folder) if is_detections(folder) else read_dataset(folder, reading)
    return convert_dataset(
        dataset,
        to,
        Path(out),
        classes=classes,
        selection=selection,
        looseness=Looseness(loosen, loosen_px),
        settings=writing,
        overwrite=overwrite,
    )


def split(
    data: str | Path,
    out: str | Path,
    rule: SplitRule,
    *,
    to: str = "native",
    lists: bool = False,
    reading: Reading = READ_ALL,
    overwrite: bool = False,
) -> SplitReport:
    """Write a dataset with new splits that do not share neighbouring frames, e.g. with `SplitRule("sequence")`.

    `to` is the format to write, as in `convert`. `lists` writes only three lists of pictures and `split.json`.
    """
    return split_dataset(read_dataset(data, reading), Path(out), rule, to=to, lists=lists, overwrite=overwrite)


def extract_frames(
    videos: Sequence[str | Path],
    out: str | Path,
    choice: FrameChoice,
    flight: FlightFacts | None = None,
    *,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> FramesReport:
    """Write frames of videos as PNG files and `metadata.csv`: a background dataset with a sequence per video.

    `choice` is, for example, `FrameChoice("2s")`. Pitch, height and time come from the DJI subtitles beside each video,
    or from the log that `flight` names.
    """
    from infrablend.pipeline.extraction import video_frames

    paths = [Path(v) for v in videos]
    return video_frames.extract_frames(paths, Path(out), choice, flight, overwrite=overwrite, on_progress=on_progress)


def extract_temperatures(
    data: str | Path,
    out: str | Path,
    scale: CountScale | None = None,
    *,
    reading: Reading = READ_ALL,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> TemperaturesReport:
    """Write the radiometric layers of DJI and FLIR pictures as 16-bit PNG, in a COCO dataset that states their scale.

    FLIR's become apparent temperatures in centikelvin. DJI's stay counts; `scale` says what these mean, if known.
    """
    from infrablend.pipeline.extraction import count_scale, temperature_pictures

    dataset = read_dataset(data, reading)
    return temperature_pictures.extract_temperatures(
        dataset, Path(out), scale or count_scale.NO_SCALE, overwrite=overwrite, on_progress=on_progress
    )


def profile(
    data: str | Path,
    out: str | Path,
    *,
    count: int = 64,
    time: str | None = None,
    name: str | None = None,
    against: str | None = None,
    rendered: str | Path | None = None,
    reading: Reading = READ_ALL,
    on_progress: OnProgress | None = None,
) -> ProfileReport:
    """Fit a sensor profile to pictures; write `profile.json`, which recipes take as `sensor.profile`, and a plot.

    `count` pictures, evenly spread, of the time `day` or `night` if one is given, are fitted. Annotated objects only
    count for local share and looseness of boxes; their boxes are compared with the exact ones of the run `rendered`.
    `against` is a shipped profile to compare with.
    """
    from infrablend.pipeline.studies.profile import pictures_taken_by, profile_dataset

    dataset = read_dataset(data, reading)
    dataset = dataset if time is None else pictures_taken_by(dataset, time)
    inserts = None if rendered is None else read_dataset(rendered)
    return profile_dataset(
        dataset, Path(out), count=count, name=name, against=against, rendered=inserts, on_progress=on_progress
    )


def estimate_camera(
    data: str | Path,
    out: str | Path | None = None,
    settings: CameraSettings | None = None,
    *,
    reading: Reading = READ_ALL,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> CameraReport:
    """Estimate pitch, roll, height and lens of each sequence's camera, from labelled people, cars and bicycles.

    `out` is the table to write, for `Reading(metadata=...)`, with a picture of the ground beside it; None writes
    nothing. Without sequences, pictures that state the same pitch and height have one camera.
    """
    from infrablend.pipeline.studies import estimate_camera as estimating

    return estimating.estimate_camera(
        read_dataset(data, reading),
        None if out is None else Path(out),
        settings or estimating.AS_STATED,
        overwrite=overwrite,
        on_progress=on_progress,
    )


def map_places(
    data: str | Path,
    out: str | Path,
    *,
    reading: Reading = READ_ALL,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> PlacesReport:
    """Write where objects can stand and drive in each picture (`<split>/<id>.stand.png`, `.drive.png`), and a sheet.

    The shipped model has learnt surfaces from the virtual world alone; annotated objects are taken from the labels.
    """
    from infrablend.pipeline.studies import surface_maps

    return surface_maps.map_places(read_dataset(data, reading), Path(out), overwrite=overwrite, on_progress=on_progress)


def find_motion(
    data: str | Path,
    out: str | Path,
    *,
    reading: Reading = READ_ALL,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> MotionReport:
    """Write how the camera moves through each sequence (`NAME.json`, and `NAME.html` with plots).

    Every frame is related to the first of its span by the background; labelled objects, text and reticle are left out.
    All frames of videos are read, unless the reading states a step.
    """
    from infrablend.formats.dataset_folder import with_every_frame
    from infrablend.pipeline.extraction import camera_motion
    from infrablend.pipeline.storage.store import local_folder

    every = with_every_frame(reading, local_folder(data))
    return camera_motion.write_motion(
        read_dataset(data, every), Path(out), overwrite=overwrite, on_progress=on_progress
    )


def learn_places(
    data: str | Path, *, count: int = 200, reading: Reading = READ_ALL, on_progress: OnProgress | None = None
) -> LearnedReport:
    """Find on which kinds of ground a dataset's labelled objects are, in `count` pictures with labels.

    Recipes that insert objects of these classes use the same by themselves, see `placement.where.learned`.
    """
    from infrablend.pipeline.studies import surface_maps

    return surface_maps.learn_places(read_dataset(data, reading), count, on_progress=on_progress)
