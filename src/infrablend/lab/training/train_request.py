"""What a training is asked to do, and the preset that follows from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from infrablend.config.agc import DEFAULT_AGC, Agc
from infrablend.core.arguments import require_names
from infrablend.core.dataset import Dataset
from infrablend.detection.detections import Task
from infrablend.errors import OutputError, Problem
from infrablend.lab.training import start_weights
from infrablend.lab.training.presets import PRESETS, Backend, Preset, PresetName
from infrablend.lab.training.yolox_settings import as_yolox

PRESET_FIELDS = ("model", "image_size", "batch", "epochs", "passes", "patience", "tile", "tiles")
_LEAST = {"image_size": 1, "batch": 1}
_STRIDE_PX = 32  # sides of tiles are multiples of the network's stride
_LEAST_TILE_PX = 64  # smaller ones show too little of what is around an object
_DOWN_DEG = 10  # cameras on a mast or a slope look down less, and see the horizon
# With the preset's 0.2, a detector of inserted cars overlooks small ones: AP50 of real cars 0.44, with 0.5 0.54. People
# have 0.64 and 0.63 (docs/explanation/transfer.md).
_SCALE_FROM_ABOVE = 0.5


@dataclass(frozen=True)
class TrainRequest:
    """How to train a detector.

    Attributes:
        preset: paper: YOLOv8s as in the paper, for a GPU; medium: whole pictures, two cores, hours; small: two cores,
            minutes; smoke: a few steps.
        settings: Field of the preset (passes, epochs, batch ...) or argument of the library.
        task: Boxes, oriented boxes or masks.
        weights: Starting point; auto: the preset's published weights, or scratch if they cannot be downloaded.
        device: auto, cpu, mps, cuda, or one GPU: cuda:1 or 1.
        seed: Seed of weights, order, augmentation and tiles.
        classes: Only these classes [default: all].
        agc: Automatic gain control for 16-bit pictures, e.g. {mode: fixed, low_c: 0, high_c: 40} [default:
            linear].
        export: Also write weights.onnx, with names, size of tiles and AGC in its metadata; a finished training is
            only exported.
        backend: ultralytics (AGPL-3.0), or yolox (Apache-2.0), which trains detectors of boxes from scratch and always
            writes weights.onnx, its result.

    Raises:
        ArgumentError: `classes` is no list of names.
    """

    preset: PresetName = "small"
    settings: Mapping[str, Any] = field(default_factory=dict)
    task: Task = "detect"
    weights: str = start_weights.AUTO
    device: str = "auto"
    seed: int = 0
    classes: Sequence[str] | None = None
    agc: Agc = DEFAULT_AGC
    export: Literal["onnx"] | None = None
    backend: Backend = "ultralytics"

    def __post_init__(self) -> None:
        require_names("classes", self.classes)

    def chosen_preset(self) -> Preset:
        """Return the preset with `settings` applied; see `choose_preset`."""
        return choose_preset(self.preset, self.settings, self.backend)

    def fitted_to(self, dataset: Dataset) -> TrainRequest:
        """Return the request with the size of tiles and the range of scales that suit the pictures to train on.

        Tiles are no larger than the median of the pictures' shorter sides. Larger tiles would have a grey border in
        every picture, always of the same width, which other programs do not add when they show pictures to the
        detector.

        Tiles of pictures that look down on the ground are scaled by 0.5 to 1.5: flights at a few heights show objects
        of a few sizes, and other flights others. A size or scale that the request states stays.
        """
        preset = self.chosen_preset()
        images = [i for i in dataset.images if i.split == "train"]
        sides = sorted(min(i.size_wh) for i in images if i.size_wh is not None)
        side = sides[len(sides) // 2] // _STRIDE_PX * _STRIDE_PX if sides else 0
        fitting: dict[str, Any] = {}
        if _LEAST_TILE_PX <= side < preset.tile and not {"tile", "image_size"} & self.settings.keys():
            fitting |= {"tile": side, "image_size": side}
        down = sum((i.capture.pitch_deg or 0) >= _DOWN_DEG for i in images)
        if preset.tile and 2 * down > len(images):
            fitting["scale"] = _SCALE_FROM_ABOVE
        return replace(self, settings={**fitting, **self.settings})


DEFAULT_TRAINING: TrainRequest = TrainRequest()


def choose_preset(name: str, settings: Mapping[str, object], backend: Backend = "ultralytics") -> Preset:
    """Return the preset with these fields and arguments of the library changed.

    Raises:
        OutputError: There is no such preset, or a value is of the wrong kind.
    """
    if name not in PRESETS:
        raise OutputError(f"--preset {name}: no such preset; expected one of {', '.join(PRESETS)}")
    preset = PRESETS[name] if backend == "ultralytics" else as_yolox(PRESETS[name])
    fields: dict[str, Any] = {k: v for k, v in settings.items() if k in PRESET_FIELDS}
    arguments = {k: v for k, v in settings.items() if k not in PRESET_FIELDS}
    problems = [
        Problem(
            f"--set {k}", "setting-malformed", repr(v),
            "a name" if k == "model" else f"a whole number from {_LEAST.get(k, 0)} up",
        )
        for k, v in fields.items()
        if not (isinstance(v, str) and v if k == "model" else type(v) is int and v >= _LEAST.get(k, 0))
    ]  # fmt: skip
    if problems:
        raise OutputError("settings of the training", problems)
    if fields.get("epochs"):
        fields.setdefault("passes", 0)
    elif fields.get("passes"):
        fields.setdefault("epochs", 0)
    chosen = replace(preset, **fields, arguments={**preset.arguments, **arguments})
    if not (chosen.epochs or chosen.passes):
        where = " ".join(f"--set {k}" for k in ("epochs", "passes") if k in settings)
        problem = Problem(where, "setting-malformed", "neither epochs nor passes", "one of them from 1 up")
        raise OutputError("settings of the training", [problem])
    return chosen
