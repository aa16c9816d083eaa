"""Tar of a shard in WebDataset form: picture, labels and scene of a frame follow each other and share a key.

    test/a_c0.jpg    test/a_c0.json    test/a_c0.scene.json

Headers are constant, so that equal frames give equal bytes.
"""

from __future__ import annotations

import contextlib
import json
import tarfile
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, ImageRecord, Instance
from infrablend.core.file_names import join_inside
from infrablend.core.files import LARGEST_READ_BYTES, finite, open_regular
from infrablend.core.temperature import Radiometry, TemperatureScale
from infrablend.errors import DatasetError, Problem

LABEL = "json"
SCENE = "scene.json"
_BLOCK = 512
# Facts that labels of every version have, if only as null.
_ALWAYS = ("pitch_deg", "altitude_m", "hfov_deg", "roll_deg", "time_of_day", "sequence", "captured")


def key_of(frame_id: str) -> str:
    """Return the key of a frame: its id, with `.` in its name as `%2E`, because keys end at the first dot of a name."""
    folder, slash, name = frame_id.rpartition("/")
    return folder + slash + name.replace("%", "%25").replace(".", "%2E")


# -- labels ----------------------------------------------------------------------------------------------------


def label_text(frame_id: str, image: ImageRecord, ids: Mapping[str, int]) -> bytes:
    """Return the labels and metadata of a frame as JSON; `ids` has the number of each category."""
    assert image.size_wh is not None
    label = {
        "frame_id": frame_id,
        "split": image.split,
        "file_name": image.name,
        "width": image.size_wh[0],
        "height": image.size_wh[1],
        **dict.fromkeys(_ALWAYS),
        **image.capture.to_json(),
        "radiometry": None if image.capture.radiometry is None else asdict(image.capture.radiometry),
        "objects": [{**i.to_json(), "category_id": ids[i.category]} for i in image.instances],
    }
    text = json.dumps(finite(label, Counter()), sort_keys=True, separators=(",", ":"), allow_nan=False, default=str)
    return text.encode() + b"\n"


def image_of(label: Mapping[str, Any], folder: Path) -> ImageRecord:
    """Return the image that `label_text` described, its picture at `<split>/<file name>` in this folder.

    Raises:
        LookupError, TypeError, ValueError, AttributeError: The label is damaged.
    """
    if not label.keys() >= set(_ALWAYS) or label["split"] not in SPLITS:
        raise ValueError(f"split {label['split']!r}, or no {', '.join(_ALWAYS)}")
    objects = [{k: v for k, v in o.items() if k != "category_id"} for o in label["objects"]]
    radiometry = label["radiometry"]
    if radiometry is not None:
        scale = radiometry["scale"]
        radiometry = Radiometry(**{**radiometry, "scale": None if scale is None else TemperatureScale.from_json(scale)})
    return ImageRecord(
        id="",
        path=join_inside(folder, f"{label['split']}/{label['file_name']}"),
        split=label["split"],
        size_wh=(int(label["width"]), int(label["height"])),
        instances=tuple(Instance.from_json(o) for o in objects),
        capture=replace(Capture.from_json(label), radiometry=radiometry),
        file_name=str(label["file_name"]),
    )


# -- writing ---------------------------------------------------------------------------------------------------


class TarWriter:
    """Writes the tar of a shard to a stream; close it, or use it in a `with` statement."""

    def __init__(self, stream: BinaryIO) -> None:
        """Start the tar."""
        self._tar = tarfile.open(fileobj=stream, mode="w|", format=tarfile.PAX_FORMAT)  # noqa: SIM115 - closed below

    def __enter__(self) -> TarWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is None:
            self._tar.close()
            return
        with contextlib.suppress(OSError):  # nobody keeps it, but a tar left open writes when it is collected
            self._tar.close()

    def add(self, key: str, suffix: str, data: bytes) -> int:
        """Append a file and return the offset of its content."""
        info = tarfile.TarInfo(f"{key}.{suffix}")  # time, owner and group are 0, and their names empty
        info.size = len(data)
        info.mode = 0o644
        self._tar.addfile(info, BytesIO(data))
        self._tar.members.clear()  # type: ignore[attr-defined]  # the list of all files would grow with the tar
        return int(self._tar.offset) - _padded(len(data))


def _padded(size: int) -> int:
    return -(-size // _BLOCK) * _BLOCK


# -- reading ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PackedFrame:
    """Files of one frame.

    Attributes:
        key: Key of the frame, see `key_of`.
        image: Picture file.
        label: Labels, see `label_text`.
        scene: Record of the frame, as `infrablend show` prints it.
    """

    key: str
    image: bytes
    label: bytes
    scene: bytes


def packed_frames(path: Path) -> Iterator[PackedFrame]:
    """Yield the frames of a shard, reading its tar once from start to end.

    Raises:
        DatasetError: The tar is missing, truncated or damaged.
    """
    try:
        with open_regular(path) as stream, tarfile.open(fileobj=stream, mode="r|") as tar:
            group: dict[str, bytes] = {}
            while (info := tar.next()) is not None:
                tar.members.clear()  # type: ignore[attr-defined]  # as in `TarWriter`
                folder, slash, name = info.name.rpartition("/")
                stem, _, suffix = name.partition(".")
                if not info.isreg() or info.size > LARGEST_READ_BYTES or suffix in group:
                    raise ValueError(f"{info.name!r} is no file of a frame")
                content = tar.extractfile(info)
                assert content is not None
                group[suffix] = content.read()
                key = folder + slash + stem
                if len(group) == 3:
                    yield _frame(key, group)
                    group = {}
            if group:
                raise ValueError("the last frame is not complete")
    except (OSError, ValueError, LookupError, tarfile.TarError) as error:
        problem = Problem(str(path), "shard-truncated", str(error), "a whole tar", "make the shard again with --resume")
        raise DatasetError(f"{path}: cannot be read", [problem]) from error


def _frame(key: str, group: dict[str, bytes]) -> PackedFrame:
    label = group.pop(LABEL)
    scene = group.pop(SCENE)
    (image,) = group.values()
    return PackedFrame(key, image, label, scene)
