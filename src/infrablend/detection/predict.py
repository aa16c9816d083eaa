"""Detections of a trained detector on whole images, as in Ultralytics' own validation.

Ultralytics' prediction calls keep one class per box; its validation, whose figures papers report, keeps every class
above the confidence. Therefore the network is called here directly, followed by Ultralytics' suppression.
"""

from __future__ import annotations

import hashlib
import logging
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.config.agc import Agc
from infrablend.core.boxes import box_of_points, corners_of_cxcywha
from infrablend.core.dataset import ImageRecord
from infrablend.core.rle_masks import Mask
from infrablend.detection.detections import MAX_DETECTIONS, TASKS, Detections, Predictions, Task, detections
from infrablend.detection.scale import Scale, training_agc, training_scale
from infrablend.detection.truth import image_key
from infrablend.detection.ultralytics_environment import has_fast_bfloat16, quiet_ultralytics, require_ultralytics
from infrablend.errors import DatasetError, MissingDependencyError, ModelError, Problem
from infrablend.formats.pictures.images import load_background
from infrablend.formats.pictures.listing import open_picture, read_size
from infrablend.formats.pictures.temperature_scale import is_deep

CONFIDENCE = 0.001
IOU = 0.7  # of two detections of a class that overlap more, the one with the lower score is dropped
Precision = Literal["auto", "float32", "bfloat16"]
_TODO = "give weights.pt of a finished `infrablend train`, or best.pt or last.pt of an Ultralytics training"
_SMALLER = "take a smaller --image-size or --device cpu"
_GREY = 114  # padding, as in Ultralytics

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Detector:
    """Loaded detector.

    Attributes:
        network: Network in evaluation mode, on its device.
        task: Output of the network: boxes, oriented boxes or masks.
        classes: Names of its classes, in its order.
        channels: Number of channels of its input.
        stride: Sides of its input are multiples of this, px.
        scale: Scale of its training.
        facts: Name and SHA-256 of the file, device, versions.
        agc: Automatic gain control for 16-bit pictures, as in its training; None takes their high byte.
    """

    network: Any
    task: Task
    classes: tuple[str, ...]
    channels: int
    stride: int
    scale: Scale
    facts: dict[str, object]
    agc: Agc | None = None

    def __call__(self, x: Any) -> Any:
        """Return the network's output for (b, c, h, w) pictures in [0, 1]."""
        import torch

        if self.facts["precision"] == "float32":
            return self.network(x)
        with torch.autocast(x.device.type, dtype=torch.bfloat16):
            return self.network(x)


def pick_device(wanted: str) -> str:
    """Return torch's name of a device: cpu, cuda, cuda:1, mps; `auto` is the first GPU, else the processor.

    Raises:
        MissingDependencyError: There is no such device.
    """
    require_ultralytics()
    import torch

    cuda = torch.cuda.is_available()
    mps = torch.backends.mps.is_available()
    if wanted == "auto":
        return "cuda:0" if cuda else "cpu"
    try:
        device = torch.device(f"cuda:{wanted}" if wanted.isdigit() else wanted)
    except RuntimeError as error:
        raise MissingDependencyError(f"device {wanted!r}: no such device; expected auto, cpu, cuda or mps") from error
    there = {"cpu": True, "cuda": cuda and (device.index or 0) < torch.cuda.device_count(), "mps": mps}
    if not there.get(device.type, False):
        built = "torch was built without CUDA" if torch.version.cuda is None else "torch sees no such GPU"
        why = built if device.type == "cuda" else "torch does not have it here"
        raise MissingDependencyError(
            f"device {wanted!r} was asked for, but {why}; check the driver and `python -m torch.utils.collect_env`, or "
            "take --device cpu"
        )
    return str(device)


def load_detector(weights: Path, device: str = "auto", precision: Precision = "auto") -> Detector:
    """Return the detector in a file of weights (.pt).

    With `bfloat16`, the layers before the head run in bfloat16, which is several times faster on processors with AMX;
    the head, which computes the boxes, always runs in 32 bits. `auto` uses it on such processors, else 32 bits.

    The file is a Python pickle: loading it runs code from the file, so only load files that you trust.

    Raises:
        MissingDependencyError: Ultralytics is not installed, or there is no such device.
        ModelError: The file is missing or contains no detector that Ultralytics can load.
    """
    require_ultralytics()
    chosen = pick_device(device)

    def refuse(found: str, expected: str = "a .pt file that Ultralytics' training wrote") -> ModelError:
        problem = Problem(str(weights), "weights", found, expected, _TODO)
        return ModelError(f"{weights}: no weights that can be used", [problem])

    # Ultralytics would try to download a name that is not a file.
    if not weights.is_file():
        raise refuse("no such file" if not weights.exists() else "not a file")
    # It would treat files of other types as exported models or as network descriptions.
    if weights.suffix.lower() != ".pt":
        raise refuse(f"a {weights.suffix} file" if weights.suffix else "a file without .pt")
    with quiet_ultralytics():
        import torch
        import ultralytics

        try:
            data = weights.read_bytes()
            model = ultralytics.YOLO(str(weights))
            network = model.model
            network = network.float().fuse(verbose=False).eval().to(chosen, memory_format=_layout(chosen))
            if precision == "auto":
                fast = chosen == "cpu" and has_fast_bfloat16(torch)
                precision = "bfloat16" if fast else "float32"
            if precision == "bfloat16":
                _head_in_32_bits(network.model[-1])
        except OSError as error:
            raise refuse(f"cannot be read: {error.strerror or error}") from error
        except Exception as error:  # unpickling can raise anything
            log.debug("%s", weights, exc_info=True)
            raise refuse("a file that cannot be loaded: damaged or from another tool") from error
    task = next((t for t in TASKS if t == model.task), None)
    if task is None:
        raise refuse(f"a network for {model.task}", "one that detects boxes, oriented boxes or masks")
    names = network.names
    checkpoint = model.ckpt if isinstance(model.ckpt, Mapping) else {}
    agc = training_agc(weights, checkpoint)
    return Detector(
        network,
        task,
        tuple(str(names[k]) for k in sorted(names)),
        int(getattr(network, "yaml", {}).get("channels", 3)),
        max(int(network.stride.max()), 32),
        training_scale(weights, checkpoint),
        {
            "weights": weights.name,
            "weights_sha256": hashlib.sha256(data).hexdigest(),
            "device": chosen,
            "precision": precision,
            "torch": str(torch.__version__),
            "ultralytics": str(ultralytics.__version__),
            **({} if agc is None else {"agc": agc.model_dump()}),
        },
        agc,
    )


def _layout(device: str) -> Any:
    """Return the memory layout of a network on a device: the one of Ultralytics' validation, for equal results.

    With the channels innermost, convolutions are also faster on a processor.
    """
    import torch

    return torch.channels_last if device == "cpu" else torch.contiguous_format


def _head_in_32_bits(head: Any) -> None:
    import torch

    forward = head.forward

    def wide(maps: Any) -> Any:
        with torch.autocast(maps[0].device.type, enabled=False):
            return forward([m.float() for m in maps])

    head.forward = wide


def predict(
    detector: Detector,
    images: Sequence[ImageRecord],
    *,
    image_size: int | None = None,
    batch: int | None = None,
    on_image: Callable[[int, int], None] | None = None,
    fit: Fit | None = None,
) -> Predictions:
    """Return the detections on whole images.

    Args:
        detector: Detector from `load_detector`.
        images: Records of the pictures. 16-bit pictures go through the automatic gain control of the detector's
            training; without one they are read by their high byte, as Ultralytics does.
        image_size: Longer side of the pictures for the network, px; 0 keeps their own size; by default the scale of the
            detector's training.
        batch: Pictures per batch; by default 16 on a GPU, else 4.
        on_image: Called with the number of finished and of all pictures.
        fit: Prepares pictures for the network; `fit_picture` by default. Detections are in px of what it was made of.

    Raises:
        DatasetError: Pictures cannot be read; `problems` lists all of them. Detection stops at the first one.
        ModelError: Memory is too small for a single picture.
    """
    scale = detector.scale if image_size is None else Scale(image_size, "requested")
    at_once = batch or (4 if detector.facts["device"] == "cpu" else 16)
    found: dict[str, Detections] = {}
    sizes: dict[str, tuple[int, int]] = {}
    problems: list[Problem] = []
    with quiet_ultralytics():
        for group in _batches(images, detector, scale.image_size, at_once, problems, fit or fit_picture):
            ours = _run(detector, group)
            for (image, picture), its in zip(group, ours, strict=True):
                found[image_key(image)] = its
                sizes[image_key(image)] = picture.size_wh
            if on_image is not None:
                on_image(len(found) + len(problems), len(images))
    if problems:
        raise DatasetError(f"{len(problems)} of {len(images)} pictures cannot be used", problems)
    facts = detector.facts | {
        "image_size": scale.image_size,
        "image_size_from": scale.origin,
        "confidence": CONFIDENCE,
        "iou": IOU,
        "max_detections": MAX_DETECTIONS,
    }
    return Predictions(detector.task, detector.classes, found, sizes, facts)


def check_pictures(images: Sequence[ImageRecord]) -> list[Problem]:
    """Return problems of pictures that headers and checksums show, without decoding them."""
    from ultralytics.utils.patches import imread

    problems = []
    for image in images:
        size, problem = read_size(image.path, image_key(image))
        problem = problem or _file_damage(image)
        if problem is not None:  # OpenCV reads some that others do not, and it is what counts
            problems += [] if imread(str(image.path), cv2.IMREAD_COLOR) is not None else [problem]
        elif size is not None and image.size_wh is not None and sorted(size) != sorted(image.size_wh):
            # The sides may be swapped: decoding applies the file's orientation tag.
            problems.append(_size_mismatch(image, size))
    return problems


def _file_damage(image: ImageRecord) -> Problem | None:
    """Return a problem if the file is truncated or has wrong checksums, as far as its format shows without decoding."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with open_picture(image.path) as picture:
                picture.verify()
    except Exception as error:  # PIL's decoders can raise anything on broken files
        found = f"unreadable picture ({error or type(error).__name__})"
        return Problem(image_key(image), "image-unreadable", found, "a complete picture", "replace or remove the file")
    return None


def _size_mismatch(image: ImageRecord, size_wh: tuple[int, int]) -> Problem:
    assert image.size_wh is not None
    found = "{}x{} px".format(*size_wh)
    expected = "{}x{} px as annotated".format(*image.size_wh)
    return Problem(image_key(image), "image-size", found, expected)


@dataclass(frozen=True, eq=False)
class FittedPicture:
    """Picture prepared for the network: (h, w, c) uint8 pixels, original size, scale, and padding left and on top."""

    pixels: NDArray[np.uint8]
    size_wh: tuple[int, int]
    scale_xy: tuple[float, float]
    pad_xy: tuple[int, int]


Fit = Callable[[NDArray[np.uint8], int, int], FittedPicture]
"""Prepares the pixels of a picture, given the image size and the stride, as `fit_picture` does."""
_Group = list[tuple[ImageRecord, FittedPicture]]


def _batches(
    images: Sequence[ImageRecord], detector: Detector, image_size: int, at_once: int, problems: list[Problem], fit: Fit
) -> Iterator[_Group]:
    group: _Group = []
    for image in images:
        picture = _read(image, detector, image_size, problems, fit)
        if picture is None or problems:  # the detections will not be used, but all problems are to be listed
            continue
        if group and (len(group) >= at_once or group[0][1].pixels.shape != picture.pixels.shape):
            yield group
            group = []
        group.append((image, picture))
    if group and not problems:
        yield group


def _read(
    image: ImageRecord, detector: Detector, image_size: int, problems: list[Problem], fit: Fit
) -> FittedPicture | None:
    from ultralytics.utils.patches import imread

    flags = cv2.IMREAD_GRAYSCALE if detector.channels == 1 else cv2.IMREAD_COLOR
    try:
        pixels = _by_agc(image, detector) if is_deep(image) else None
    except (DatasetError, ValueError) as error:
        problems.append(Problem(image_key(image), "image-agc", str(error), "a picture that the AGC can map"))
        return None
    pixels = imread(str(image.path), flags) if pixels is None else pixels
    if pixels is None:
        problems.append(Problem(image_key(image), "image-unreadable", "unreadable picture", "a complete picture"))
        return None
    pixels = pixels if pixels.ndim == 3 else pixels[..., None]
    if not detector.scale.image_size and pixels.shape[2] == 3 and (pixels != pixels[..., :1]).any():
        # Tiles are cut from pictures in grey, so a detector trained on tiles has never seen colour.
        pixels = np.repeat(load_background(image.path).pixels[..., None], 3, axis=2)
    if detector.channels not in (1, 3):
        found = f"weights for pictures of {detector.channels} channels"
        problems.append(Problem(image_key(image), "channels", found, "weights for 1 or 3"))
        return None
    height, width = pixels.shape[:2]
    if image.size_wh is not None and image.size_wh != (width, height):
        problems.append(_size_mismatch(image, (width, height)))
        return None
    return fit(pixels, image_size, detector.stride)


def _by_agc(image: ImageRecord, detector: Detector) -> NDArray[np.uint8] | None:
    """Return a 16-bit picture after the detector's automatic gain control; None for a detector without one."""
    if detector.agc is None:
        return None
    scale = image.capture.scale
    levels = detector.agc.apply(np.asarray(load_background(image.path).pixels, np.uint16), scale)
    return levels if detector.channels == 1 else np.repeat(levels[..., None], 3, axis=2)


def fit_picture(pixels: NDArray[np.uint8], image_size: int, stride: int) -> FittedPicture:
    """Scale to a longer side of `image_size` (0: not at all) and pad with grey on all sides, as in validation.

    Each side becomes the multiple of the stride that leaves at least half a stride of padding.
    """
    height, width = pixels.shape[:2]
    size = image_size or max(height, width)
    scale = size / max(height, width)
    w, h = min(math.ceil(width * scale), size), min(math.ceil(height * scale), size)
    if (w, h) != (width, height):
        pixels = cv2.resize(pixels, (w, h), interpolation=cv2.INTER_LINEAR).reshape(h, w, -1)
    full_w, full_h = fitted_size((w, h), stride)
    left = round((full_w - w) / 2 - 0.1)
    top = round((full_h - h) / 2 - 0.1)
    padded = np.full((full_h, full_w, pixels.shape[2]), _GREY, np.uint8)
    padded[top : top + h, left : left + w] = pixels
    return FittedPicture(padded, (width, height), (w / width, h / height), (left, top))


def fitted_size(size_wh: tuple[int, int], stride: int) -> tuple[int, int]:
    """Return the size of a picture with the padding of `fit_picture`, px."""
    width, height = (math.ceil(side / stride + 0.5) * stride for side in size_wh)
    return width, height


def _run(detector: Detector, group: _Group) -> list[Detections]:
    import torch

    try:
        return _forward(detector, [p for _, p in group])
    except (torch.OutOfMemoryError, MemoryError) as error:
        if len(group) == 1:
            raise ModelError(f"{group[0][0].name}: memory does not hold one picture; {_SMALLER}") from error
        middle = len(group) // 2
        return [*_run(detector, group[:middle]), *_run(detector, group[middle:])]


def predict_levels(
    detector: Detector, levels: NDArray[np.uint8], image_size: int, confidence: float = CONFIDENCE
) -> Detections:
    """Return the detections in one picture of (h, w) grey levels, as `predict` does in files.

    Args:
        detector: Detector from `load_detector`.
        levels: The picture.
        image_size: Longer side of the picture for the network, px; 0 keeps its own size.
        confidence: Lowest score.

    Raises:
        ModelError: Memory does not hold the picture.
    """
    channels = np.repeat(levels[..., None], detector.channels, axis=2)
    with quiet_ultralytics():
        import torch

        try:
            return _forward(detector, [fit_picture(channels, image_size, detector.stride)], confidence)[0]
        except (torch.OutOfMemoryError, MemoryError) as error:
            size = "{1}x{0}".format(*levels.shape)
            raise ModelError(f"memory does not hold a picture of {size} px; {_SMALLER}") from error


def _forward(detector: Detector, pictures: Sequence[FittedPicture], confidence: float = CONFIDENCE) -> list[Detections]:
    import torch
    from ultralytics.utils import nms

    stacked = np.stack([p.pixels[..., ::-1].transpose(2, 0, 1) for p in pictures])
    with torch.inference_mode():
        x = torch.from_numpy(np.ascontiguousarray(stacked)).to(detector.facts["device"]).float() / 255
        said = detector(x)
        prototypes = None
        if detector.task == "segment":
            prototypes = said[0][1] if isinstance(said[0], tuple) else said[1]
            said = said[0]
        kept = nms.non_max_suppression(
            said,
            confidence,
            IOU,
            nc=0 if detector.task == "detect" else len(detector.classes),
            multi_label=True,
            max_det=MAX_DETECTIONS,
            max_time_img=3600.0,  # results must not depend on speed
            rotated=detector.task == "obb",
            end2end=bool(getattr(detector.network, "end2end", False)),
        )
        return [
            _scaled(rows, picture, detector.task, None if prototypes is None else prototypes[k])
            for k, (rows, picture) in enumerate(zip(kept, pictures, strict=True))
        ]


def _scaled(rows: Any, picture: FittedPicture, task: Task, prototypes: Any) -> Detections:
    """Return Ultralytics' rows (box, score, class, further values) as detections in pixels of the stored picture."""
    masks = None
    if task == "segment":
        rows, masks = _masks(rows, picture, prototypes)
    values = rows.cpu().numpy().astype(np.float64)
    pad = np.array(picture.pad_xy, np.float64)
    scale = np.array(picture.scale_xy, np.float64)
    size = np.array(picture.size_wh, np.float64)
    if task == "obb":
        corners = (corners_of_cxcywha(np.concatenate([values[:, :4], values[:, 6:7]], axis=1)) - pad) / scale
        boxes = np.array([box_of_points(c) for c in corners]).reshape(-1, 4)
        return detections(boxes, values[:, 4], values[:, 5], corners)
    boxes = ((values[:, :4].reshape(-1, 2, 2) - pad) / scale).clip(0, size).reshape(-1, 4)
    return detections(boxes, values[:, 4], values[:, 5], None, masks)


def _masks(rows: Any, picture: FittedPicture, prototypes: Any) -> tuple[Any, list[Mask]]:
    """Return the rows that have a mask, and their masks in the stored picture instead of the padded one."""
    from ultralytics.utils import ops

    height, width = picture.pixels.shape[:2]
    left, top = picture.pad_xy
    w, h = picture.size_wh
    made = []
    kept = []
    inner_w, inner_h = round(w * picture.scale_xy[0]), round(h * picture.scale_xy[1])
    for start in range(0, len(rows), 32):  # 300 masks of a large picture at once fill the memory
        part = rows[start : start + 32]
        stack = ops.process_mask_native(prototypes, part[:, 6:], part[:, :4], (height, width)).cpu().numpy()
        for k, padded in enumerate(stack):
            mask = np.ascontiguousarray(padded[top : top + inner_h, left : left + inner_w]).astype(np.uint8)
            if mask.shape != (h, w):
                mask = cv2.resize(mask, (w, h), interpolation=cv2.INTER_NEAREST)
            if mask.any():
                made.append(Mask.from_array(mask.astype(np.bool_)))
                kept.append(start + k)
    return rows[kept], made
