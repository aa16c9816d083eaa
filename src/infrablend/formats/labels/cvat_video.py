"""CVAT's XML for videos, "CVAT for video 1.1": a `track` per object, with a shape for each frame that shows it.

    <split>/<sequence>/annotations.xml    <split>/<sequence>/images/frame_000000.png

Frames count from 0. In a shape, `outside` 1 says that the object is not to be seen from that frame on, `keyframe` 1
that a person drew it; CVAT lists the frames between key frames, too. Pictures of a task made from a video have the
number of their frame in their names; those of one made from pictures are counted in the order of their names.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from xml.sax.saxutils import quoteattr

from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord, Instance, Split
from infrablend.formats.pictures.listing import list_pictures
from infrablend.formats.records import Findings
from infrablend.formats.sequence_writing import Frames, Place, Tracks
from infrablend.formats.values import plain_id, to_int

FILE = "annotations.xml"
PICTURES = "images"
_FRAME = re.compile(r"frame_(\d{1,9})", re.ASCII)

ReadShape = Callable[[Findings, Any, str, tuple[int, int] | None], Instance | None]
"""Reads a shape of CVAT in a picture of some size; None, with a problem, if that is impossible."""
WriteShape = Callable[[Instance, str], str]
"""Returns the element of an object's box with further attributes."""


# -- reading ---------------------------------------------------------------------------------------------------


def is_video(top: Any) -> bool:
    """Return whether a file is of a video task, not of pictures."""
    if top.find("image") is not None:
        return False
    return top.find("track") is not None or (top.findtext("meta//mode") or "").strip() == "interpolation"


def read_video(
    found: Findings,
    top: Any,
    path: Path,
    split: Split,
    places: Iterable[Path],
    shapes: Sequence[str],
    read_shape: ReadShape,
) -> list[ImageRecord]:
    """Read the frames of a task and the objects in them; frames without a shape show no object.

    Args:
        found: Problems and counts.
        top: Root element of the file.
        path: The file.
        split: Its split.
        places: Folders that may hold the frames; the first with pictures counts.
        shapes: Kinds of shapes that are read.
        read_shape: Reader of a shape, whose element has the label of its track.
    """
    where = found.place(path)
    pictures = next((p for place in places if (p := list_pictures(place, is_labelled=lambda _: True))), {})
    if not pictures:
        expected = f"pictures in {PICTURES}/"
        todo = "export with pictures, or extract the frames of the video there"
        found.add(where, "image-missing", "no picture of a frame", expected, todo)
        return []
    if len({t.get("task_id") for t in top.iter("track")}) > 1:
        text = "tracks of several tasks, whose frames cannot be told apart; left out"
        todo = "export each task"
        found.add(where, "annotation-layout", text, "one task per file", todo)
        return []
    frames = _frames(top, list(pictures.values()))
    of_frame = _shapes(found, top, where, frames, shapes)
    name = (top.findtext("meta/task/name") or "").strip()
    sequence = path.parent.name if path.parent != found.root else name or path.stem
    records: list[ImageRecord] = []
    for position, (number, picture) in enumerate(frames.items()):
        size_wh = found.size(picture, found.place(picture))
        if size_wh is None:
            continue
        instances = []
        for here, shape, track in of_frame[number]:
            instance = read_shape(found, shape, here, size_wh)
            if instance is not None:
                own = plain_id(track if instance.track_id is None else instance.track_id)
                instances.append(replace(instance, track_id=own))
        named = _FRAME.fullmatch(picture.stem)
        capture = Capture(sequence=sequence, frame=int(named[1]) if named else position)
        base = f"{sequence}/{picture.name}"
        records.append(ImageRecord("", picture, split, size_wh, tuple(instances), capture, file_name=base))
    return records


def _frames(top: Any, pictures: Sequence[Path]) -> dict[int, Path]:
    """Return the pictures by the numbers that shapes give their frames.

    These are the numbers in names such as `frame_000025.png`, unless the task has as many frames as there are pictures,
    counted one by one.
    """
    named = {int(m[1]): p for p in pictures if (m := _FRAME.fullmatch(p.stem))}
    last = to_int(top.findtext("meta//stop_frame"))
    if len(named) < len(pictures) or last == len(pictures) - 1:
        return dict(enumerate(pictures))
    return dict(sorted(named.items()))


def _shapes(
    found: Findings, top: Any, where: str, frames: Mapping[int, Path], shapes: Sequence[str]
) -> dict[int, list[tuple[str, Any, str]]]:
    """Return place, element and track of the shapes of each frame, without those of objects that are outside."""
    of_frame: dict[int, list[tuple[str, Any, str]]] = defaultdict(list)
    lost = gaps = 0
    for n, track in enumerate(top.iter("track")):
        number = track.get("id") or str(n)
        label = track.get("label") or ""
        here = f"{where}: track {number}"
        before: int | None = None
        seen: set[int] = set()
        for k, shape in enumerate(track):
            frame = to_int(shape.get("frame"))
            if frame is None or frame < 0:
                found.add(
                    f"{here}: {shape.tag} {k}", "row-malformed", f"frame {shape.get('frame')!r}", "a frame from 0"
                )
                continue
            outside = shape.get("outside") == "1"
            gaps += 0 if before is None else sum(f in frames for f in range(before + 1, min(frame, before + 10**6)))
            before = None if outside else frame
            if outside:
                continue
            if frame in seen:
                text = f"a second shape in frame {frame}; both are kept"
                found.warn(here, "track-twice", text, "each object once per frame", "remove one of them")
            seen.add(frame)
            if frame not in frames:
                lost += 1
            elif shape.tag not in shapes:
                found.leave_out(str(shape.tag), here)
            else:
                shape.set("label", label)
                of_frame[frame].append((f"{here}: frame {frame}", shape, number))
    if lost:
        text = f"{lost} shape(s) left out because their frame has no picture"
        found.warn(where, "row-without-picture", text, "a picture per frame, numbered from 0", "restore the pictures")
    if gaps:
        text = f"{gaps} frame(s) between shapes of a track without one of their own: no object is read in them"
        todo = "let CVAT export the task again: it lists the frames between key frames"
        found.warn(where, "track-gaps", text, "a shape in each frame until one that is outside", todo)
    return of_frame


# -- writing ---------------------------------------------------------------------------------------------------


def path_of(image: ImageRecord, place: Place) -> str:
    """Return the path of a picture below the dataset's folder."""
    return f"{place.folder}/{PICTURES}/frame_{place.number:06d}{PurePosixPath(image.name).suffix}"


def tracks_of(images: Frames, write_shape: WriteShape, losses: Counter[str]) -> Iterator[str]:
    """Yield the elements of the tracks of one sequence: first those that are made for single objects, then the others.

    Frames are positions in the sequence, as in a task that CVAT makes from its pictures. Where an object is gone, a
    shape is outside: CVAT would otherwise keep it to the end.
    """
    tracks = Tracks(images, 0)
    places: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for frame, image in enumerate(images):
        for k, (o, (number, key)) in enumerate(zip(image.instances, tracks.of(image, losses), strict=True)):
            if key is None:
                yield from _track(number, [(frame, replace(o, track_id=None))], len(images), write_shape)
            else:
                places[number].append((frame, k))
    for number, listed in sorted(places.items()):
        yield from _track(number, ((n, images[n].instances[k]) for n, k in listed), len(images), write_shape)


def _track(number: int, shapes: Iterable[tuple[int, Instance]], length: int, write_shape: WriteShape) -> Iterator[str]:
    """Yield the element of one track from its frames, in order."""
    last: tuple[int, Instance] | None = None
    for frame, o in shapes:
        if last is None:
            yield f'  <track id="{number}" label={quoteattr(o.category)} source="manual">\n'
        elif frame > last[0] + 1:
            yield _shape(last[0] + 1, 1, last[1], write_shape)
        yield _shape(frame, 0, o, write_shape)
        last = frame, o
    if last is not None and last[0] + 1 < length:
        yield _shape(last[0] + 1, 1, last[1], write_shape)
    yield "  </track>\n"


def _shape(frame: int, outside: int, o: Instance, write_shape: WriteShape) -> str:
    said = f'frame="{frame}" keyframe="1" outside="{outside}"'
    return f"    {write_shape(o, said)}\n"
