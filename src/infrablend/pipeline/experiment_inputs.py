"""What an experiment needs to know beside its stages: where its page goes, and what its trainings ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from infrablend.core.cores import available_cores
from infrablend.core.dataset import Dataset
from infrablend.formats import detection
from infrablend.formats.reading import Reading
from infrablend.pipeline.generate import generate_run
from infrablend.pipeline.request import Execution, RunRequest
from infrablend.pipeline.run import RunReport
from infrablend.pipeline.split import SplitReport, SplitRule, split_dataset
from infrablend.pipeline.train import choose_preset, require_settings


def default_results(work: Path, scale: str) -> Path:
    """Where pages go: `docs/results` of the checkout one stands in, else `results`; smoke ones into the work folder."""
    if scale == "smoke":
        return work / "results"
    here = Path.cwd()
    in_checkout = (here / "pyproject.toml").is_file() and (here / "src" / "infrablend").is_dir()
    return here / "docs" / "results" if in_checkout else here / "results"


def preset_facts(scale: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return everything that decides a training, as plain JSON."""
    return {k: v for k, v in asdict(choose_preset(scale, settings)).items() if k != "summary"}


def training_seconds(scale: str, settings: Mapping[str, Any], images: int, gpu: bool) -> float:
    """Estimate how long a training on so many images takes."""
    from infrablend.training.presets import estimate_seconds, tiles_expected

    preset = choose_preset(scale, settings)
    shown = tiles_expected(images, 5 * images) if preset.tile else images
    shown = min(shown, preset.tiles) if preset.tiles else shown
    return estimate_seconds(preset, shown, gpu=gpu, cores=available_cores())


def require_training(device: str) -> None:
    """Check that Ultralytics and the device are there, before anything is made."""
    from infrablend.training.weights import require_ultralytics

    require_ultralytics()
    from infrablend.training.predict import pick_device

    pick_device(device)


def require_training_settings(scale: str, settings: Mapping[str, Any]) -> None:
    """Check the settings of a training; without Ultralytics only our own fields can be checked."""
    require_settings(choose_preset(scale, settings))


def read_dataset(
    data: Path, *, splits: Sequence[str] | None = None, options: Mapping[str, str] | None = None
) -> Dataset:
    """Read a dataset in the words of a stage."""
    return detection.read(data, Reading(splits=splits, options=options or {}))


def generate(recipe: str | Path, data: Path, out: Path, **said: Any) -> RunReport:
    """Run the generator in the words of a stage."""
    request = RunRequest(
        recipe,
        data,
        out,
        seed=said["seed"],
        settings={**said["settings"], "output.formats": said["formats"]},
        reading=Reading(splits=said["splits"], options=said["options"] or {}),
        execution=Execution(said["workers"], renderer=said["renderer"], in_process=said["in_process"]),
        existing="resume" if said["resume"] else "refuse",
    )
    return generate_run(request, said["on_progress"])


def split(data: Path, out: Path, **said: Any) -> SplitReport:
    """Write new splits in the words of a stage."""
    dataset = read_dataset(data, options=said["options"])
    return split_dataset(dataset, out, SplitRule(said["by"], said["gap"], said["shares"], said["seed"]), to=said["to"])
