"""One training in a separate process, so that a crash, lack of memory or a stop does not affect the caller.

    python -m infrablend.lab.training.trainer PARENT_PID JOB.json

writes one JSON object per line to standard output: `step` (progress), `epoch` (losses), `damaged` (an unreadable
checkpoint was moved away), `end`, or `error` with a code and a message.
Ultralytics' own output goes to standard error.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from infrablend.core.files import load_json, replace_atomically
from infrablend.core.operating_system import die_with_parent, watch_parent
from infrablend.detection.scale import CHECKPOINT, MARK, NEW_CHECKPOINT, RUN, ULTRALYTICS, WEIGHTS
from infrablend.detection.ultralytics_environment import configure_ultralytics, has_fast_bfloat16
from infrablend.lab.training.presets import cpu_threads
from infrablend.lab.training.training_job import (
    REACHED,
    IncompleteDataError,
    Job,
    Reached,
    Say,
    ShuffledPasses,
    last_checkpoint,
    read_checkpoint,
    require_all,
    reseed,
)


def trainer_with_passes(base: Any, job: Job, begun: int) -> Any:
    """Return a trainer class that takes its training data in `ShuffledPasses` from epoch `begun` on."""

    class Trainer(base):  # type: ignore[misc]
        turns: ShuffledPasses | None = None

        def get_dataloader(self, *args: Any, mode: str = "train", **kwargs: Any) -> Any:
            loader = super().get_dataloader(*args, mode=mode, **kwargs)
            if mode == "train" and job.shown != job.images:
                self.turns = ShuffledPasses(len(loader.dataset), job.shown, job.seed, begun)
                loader.batch_sampler.sampler.sampler = self.turns
                object.__setattr__(loader, "sampler", self.turns)  # torch's own __setattr__ forbids it
                if hasattr(loader, "reset"):
                    loader.reset()  # it may have begun to load in the default order
            return loader

        def _close_dataloader_mosaic(self) -> None:
            super()._close_dataloader_mosaic()
            if self.turns is not None:
                # Ultralytics then resets the loader, when workers may have fetched the first batches of the epoch.
                self.turns.epoch = self.epoch

    return Trainer


def main(arguments: list[str]) -> int:
    """Train and return 0 for success or 1 for failure, as reported by the last line on standard output."""
    parent_pid, job_file = arguments
    # A trainer that outlived a killed command would write into the folder of the next one.
    die_with_parent(int(parent_pid))
    watch_parent(int(parent_pid))
    job = Job(**load_json(Path(job_file)))
    out = sys.stdout

    def say(event: str, **facts: Any) -> None:
        out.write(json.dumps({"event": event, **facts}) + "\n")
        out.flush()

    with contextlib.redirect_stdout(sys.stderr):
        try:
            _trainer_of(job)(job, say)
        except IncompleteDataError as error:
            say("error", code="labels-dropped", message=str(error))
            return 1
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            code = "out-of-memory" if "out of memory" in text.lower() or "can't allocate memory" in text else "failed"
            import traceback

            traceback.print_exc()
            say("error", code=code, message=text)
            return 1
    return 0


def _trainer_of(job: Job) -> Callable[[Job, Say], None]:
    if job.backend == "ultralytics":
        return _train
    from infrablend.lab.training.yolox_trainer import train_yolox

    return train_yolox


class _Progress:
    """Callbacks of Ultralytics' trainer: they check the loaded data, fix the seeds, and report and keep progress."""

    def __init__(self, job: Job, checkpoint: Path, say: Any) -> None:
        self._job = job
        self._checkpoint = checkpoint
        self._say = say
        self._steps = 0
        self._next_s = 0.0
        self._loaded: dict[str, int] = {}

    def gate(self, t: Any) -> None:
        """Refuse to train on other images and labels than those that were prepared."""
        val = _loaded(t.test_loader) if self._job.val_images else (0, 0)
        self._loaded = require_all(self._job, len(t.train_loader.sampler), _loaded(t.train_loader), val)

    def reseed(self, t: Any) -> None:
        """Seed all generators by the job and the epoch."""
        self._steps = 0
        seed = reseed(self._job, t.epoch)
        if getattr(t.train_loader, "generator", None) is not None:
            t.train_loader.generator.manual_seed(seed)

    def step(self, t: Any) -> None:
        """Report the images shown, once a second."""
        self._steps += 1
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + 1.0
            shown = self._job.shown
            # The batch of the loader, which is smaller if there are fewer images.
            done = t.epoch * shown + min(self._steps * t.train_loader.batch_size, shown)
            self._say("step", epoch=t.epoch + 1, epochs=t.epochs, images=min(done, t.epochs * shown),
                      losses=_rounded(t.tloss, 4))  # fmt: skip

    def saved(self, t: Any) -> None:
        """Write the checkpoint, with the progress in it, and report the epoch."""
        import torch

        job = self._job
        losses = _rounded(t.tloss, 5)
        batch = t.train_loader.batch_size
        reached = Reached(t.epoch + 1, bool(t.stop), dict(self._loaded), losses, batch, t.batch_size != job.batch)
        beside = self._checkpoint.with_name(NEW_CHECKPOINT)
        with replace_atomically(self._checkpoint, beside=beside, durable=True) as temporary:
            state_of_epoch = torch.load(t.last, map_location="cpu", weights_only=False)
            torch.save({**state_of_epoch, REACHED: asdict(reached)}, temporary)
        self._say("epoch", epoch=t.epoch + 1, epochs=t.epochs, batch=batch, losses=losses,
                  metrics=_rounded(t.metrics, 5) if job.patience else {})  # fmt: skip


def _rounded(values: Any, digits: int) -> dict[str, float]:
    return {k: round(float(v), digits) for k, v in (values or {}).items()}


def _train(job: Job, say: Any) -> None:
    out = Path(job.out)
    configure_ultralytics(out / ULTRALYTICS)
    import torch

    threads = torch.get_num_threads()
    if "OMP_NUM_THREADS" not in os.environ:  # which Ultralytics sets to 1 if it is not
        threads = min(threads, cpu_threads())
    import ultralytics
    from ultralytics.data import utils as data_utils
    from ultralytics.models import yolo
    from ultralytics.utils import torch_utils

    torch_utils.NUM_THREADS = threads  # by itself, Ultralytics leaves one core unused: on two cores it trains on one
    torch.use_deterministic_algorithms = functools.partial(_use_deterministic_algorithms, torch)
    data_utils.check_font = lambda font: None  # would download one for plots, of which there are none
    ultralytics.settings["raytune"] = False  # would import Ray, for a second
    base = {"detect": yolo.detect.DetectionTrainer, "obb": yolo.obb.OBBTrainer,
            "segment": yolo.segment.SegmentationTrainer}[job.task]  # fmt: skip
    on_cpu = job.device == "cpu"
    checkpoint = out / CHECKPOINT
    begun = last_checkpoint(checkpoint, torch, say)

    class Trainer(trainer_with_passes(base, job, begun.epochs)):  # type: ignore[misc]
        """Ultralytics' trainer, with the memory layout that suits convolutions on a processor."""

        def set_model_attributes(self) -> None:
            super().set_model_attributes()
            if on_cpu:
                self.model: Any = self.model.to(memory_format=torch.channels_last)

        def final_eval(self) -> None:
            # It validates the best epoch, which counts only if it was to decide when to stop.
            if job.patience:
                super().final_eval()

    trainer = Trainer(overrides=_overrides(job, out, checkpoint if begun.epochs else None))
    progress = _Progress(job, checkpoint, say)
    trainer.add_callback("on_pretrain_routine_end", progress.gate)
    trainer.add_callback("on_train_epoch_start", progress.reseed)
    trainer.add_callback("on_train_batch_end", progress.step)
    trainer.add_callback("on_model_save", progress.saved)
    precision = "float32"
    with contextlib.ExitStack() as stack:
        if on_cpu and has_fast_bfloat16(torch):
            precision = "bfloat16"
            stack.enter_context(_bfloat16_forward(torch))
        if not begun.ended and begun.epochs < job.epochs:
            trainer.train()
    best = out / RUN / "weights" / "best.pt"
    _write_weights(job, best if job.patience and best.is_file() else checkpoint, out / WEIGHTS)
    reached = read_checkpoint(checkpoint, torch)
    say("end", epochs=reached.epochs, gate=reached.gate, losses=reached.losses,
        batch=reached.batch or min(job.batch, job.images), short_of_memory=reached.short_of_memory,
        precision="amp" if not on_cpu else precision, threads=torch.get_num_threads(),
        versions={"ultralytics": ultralytics.__version__, "torch": torch.__version__})  # fmt: skip


def _write_weights(job: Job, checkpoint: Path, weights: Path) -> None:
    """Write the weights of a checkpoint, with the scale at which the detector has to see pictures."""
    import torch
    from ultralytics.utils import torch_utils

    updates = {
        MARK: {"tile": job.tile, "image_size": job.image_size} | ({} if job.agc is None else {"agc": job.agc}),
        REACHED: None,
    }
    if job.picture_px:
        # Ultralytics' own commands scale pictures to this size unless they are given another; that of tiles would
        # make objects smaller than they were in training.
        arguments = torch.load(checkpoint, map_location="cpu", weights_only=False)["train_args"]
        updates["train_args"] = {**arguments, "imgsz": job.picture_px}
    with replace_atomically(weights) as temporary:
        torch_utils.strip_optimizer(checkpoint, temporary, updates=updates)


def _overrides(job: Job, out: Path, resumed: Path | None) -> dict[str, object]:
    overrides: dict[str, object] = {
        "mode": "train", "task": job.task, "model": job.model, "data": job.data, "epochs": job.epochs,
        "batch": job.batch, "imgsz": job.image_size, "device": job.device, "patience": job.patience or 10**6,
        "seed": job.seed, "val": job.patience > 0, "plots": False, "project": str(out), "name": RUN,
        "exist_ok": True, "verbose": False, "save_dir": str(out / RUN), **job.arguments,
    }  # fmt: skip
    if job.model.endswith(".yaml"):
        overrides["pretrained"] = False
    if resumed is not None:
        overrides["resume"] = str(resumed)
    return overrides


def _use_deterministic_algorithms(torch: Any, mode: bool, *, warn_only: bool = False) -> None:
    """Do what torch's function of this name does, except for its compiler, whose import takes as long as torch's."""
    torch.set_deterministic_debug_mode("default" if not mode else "warn" if warn_only else "error")


def _loaded(loader: Any) -> tuple[int, int]:
    found = loader.dataset.labels
    return len(found), sum(len(label["cls"]) for label in found)


@contextlib.contextmanager
def _bfloat16_forward(torch: Any) -> Iterator[None]:
    """Return a context in which networks in training compute in bfloat16 and return float32.

    The loss stays in float32: bfloat16 has eight significant bits, in which anchors from 39.5 strides are not exact,
    and boxes of 10 px would move.
    """
    from ultralytics.nn.tasks import BaseModel

    original = BaseModel._predict_once

    def floats(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: floats(v) for k, v in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(floats(v) for v in value)
        return value.float() if torch.is_tensor(value) and value.dtype == torch.bfloat16 else value

    def predict_once(self: Any, x: Any, *args: Any, **kwargs: Any) -> Any:
        if not self.training:
            return original(self, x, *args, **kwargs)
        with torch.autocast("cpu", torch.bfloat16):
            found = original(self, x.contiguous(memory_format=torch.channels_last), *args, **kwargs)
        return floats(found)

    BaseModel._predict_once = predict_once
    try:
        yield
    finally:
        BaseModel._predict_once = original


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
