"""Process that trains: start it, follow its events, record its end."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import cast

from infrablend.core.file_names import real_path
from infrablend.core.files import output_error, write_json
from infrablend.core.operating_system import IN_BACKGROUND, ask_to_stop, kill_tree
from infrablend.core.tasks import OnProgress, Progress
from infrablend.detection.scale import DATA, JOB, LOG, RECORD
from infrablend.errors import DatasetError, InfraBlendError, Interrupted, RenderError
from infrablend.lab.training import trainer
from infrablend.lab.training.presets import Preset
from infrablend.lab.training.training_job import Job
from infrablend.lab.training.training_record import SessionFacts, TrainerEvent, TrainingRecord
from infrablend.pipeline.execution.interrupt import Interruption

log = logging.getLogger(__name__)


class _Session:
    """One sitting of a training: it follows the events of the process and keeps the record up to date."""

    def __init__(self, out: Path, record: TrainingRecord, images: int, on_progress: OnProgress | None) -> None:
        self._out = out
        self._record = record
        self._images = images
        self._on_progress = on_progress
        self._earlier = list(record["sessions"])
        self._began = time.monotonic()
        self._epoch = 0
        self._damage: str | None = None
        self._first_step: tuple[int, float] | None = None
        self.end: TrainerEvent | None = None
        self.error: TrainerEvent | None = None

    def take(self, event: TrainerEvent) -> None:
        """Note what the process says."""
        match event["event"]:
            case "damaged":
                self._damage = event["message"]
                log.warning("%s: %s", self._out, event["message"])
            case "epoch":
                self._epoch = int(event["epoch"])
                self.note("killed")  # the record must count this session even if it is killed
                write_json(self._out / RECORD, self._record, durable=True)
            case "step":
                self._report(event)
            case "error":
                self.error = event
            case "end":
                self.end = event

    def note(self, end: str) -> None:
        """Put this session into the record."""
        session: SessionFacts = {
            "seconds": round(time.monotonic() - self._began, 1),
            "end": end,
            "epoch": self._epoch,
        }
        if self._damage is not None:
            session["restarted"] = self._damage
        self._record["sessions"] = [*self._earlier, session]

    def _report(self, event: TrainerEvent) -> None:
        if self._on_progress is None:
            return
        seconds = max(time.monotonic() - self._began, 1e-6)
        done = int(event["images"])
        if self._first_step is None:
            self._first_step = (done, seconds)
        first_done, first_s = self._first_step
        pace = (done - first_done) / max(seconds - first_s, 1e-6)
        eta = (self._images - done) / pace if pace > 0 else None
        self._on_progress(Progress(done, self._images, pace, eta, {"epoch": event["epoch"]}))


def run_trainer(
    out: Path, record: TrainingRecord, preset: Preset, device: str, on_progress: OnProgress | None
) -> TrainingRecord:
    """Run the training process from the start or its last checkpoint, and return the finished record."""
    epochs, shown = preset.epochs_for(record["prepared"]["images"])
    write_json(out / JOB, asdict(_job(out, record, preset, device)))
    record["epochs"] = epochs
    record["device"] = device
    write_json(out / RECORD, record, durable=True)
    session = _Session(out, record, epochs * shown, on_progress)
    command = [sys.executable, "-W", "ignore", "-m", trainer.__name__, str(os.getpid()), str(out / JOB)]
    code, stopped = watch(command, out / LOG, session.take)
    # After the event `end` the weights are complete, and a stop has no effect.
    done = session.end is not None and (code == 0 or stopped)
    session.note("end" if done else "stopped" if stopped else "failed")
    if session.end is not None and done:
        _note_end(record, session.end, preset, shown)
    write_json(out / RECORD, record, durable=True)
    if stopped and not done:
        raise _stopped(record["sessions"], epochs)
    if not done:
        raise _failure(out, code, session.error, preset)
    return record


def _job(out: Path, record: TrainingRecord, preset: Preset, device: str) -> Job:
    prepared = record["prepared"]
    epochs, shown = preset.epochs_for(prepared["images"])
    start = record["start"]
    backend = record.get("backend", "ultralytics")
    return Job(
        data=str(real_path(out / DATA / "data.yaml")), out=str(real_path(out)), task=record["task"],
        model=start["model"], device=device, epochs=epochs, batch=preset.batch,
        image_size=preset.image_size, tile=preset.tile, patience=preset.patience, seed=record["seed"],
        picture_px=prepared.get("picture_px", 0),
        images=prepared["images"], labels=prepared["labels"], shown=shown, arguments=dict(preset.arguments),
        val_images=prepared.get("images_val", 0) if preset.patience else 0,
        val_labels=prepared.get("labels_val", 0) if preset.patience else 0, agc=record.get("agc"),
        backend=backend, classes=record["classes"], network=preset.model,
    )  # fmt: skip


def _note_end(record: TrainingRecord, end: TrainerEvent, preset: Preset, shown: int) -> None:
    """Put what a finished training has done into its record."""
    record["precision"] = end["precision"]
    record["threads"] = end["threads"]
    record["versions"] = end["versions"]
    record["batch"] = end["batch"]
    record["epochs_done"] = end["epochs"]
    record["passes"] = end["epochs"] * shown
    record["seconds"] = round(sum(s["seconds"] for s in record["sessions"]), 1)
    record["losses"] = end["losses"]
    record["gate"] = end["gate"]
    if end["batch"] != preset.batch:
        why = "memory was short" if end["short_of_memory"] else f"there are {record['prepared']['images']} images"
        record["note"] = f"batch {end['batch']} rather than {preset.batch}: {why}"


def _stopped(sessions: Sequence[SessionFacts], epochs: int) -> Interrupted:
    reached = 0  # each session continued the one before or started again
    for s in sessions:
        reached = max(0 if "restarted" in s else reached, s["epoch"])
    at = f"after epoch {reached} of {epochs}"
    then = "continues"
    if not reached:
        at = f"before the end of the first of {epochs} epochs"
        then = "starts it again"
    return Interrupted(f"Stopped {at}; the same command with --resume {then}.")


def watch(command: list[str], log: Path, take: Callable[[TrainerEvent], None]) -> tuple[int, bool]:
    """Run the process and pass on its events; return its exit code and whether a stop was requested."""
    with Interruption() as interruption:
        try:
            with log.open("ab") as errors:
                process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, **IN_BACKGROUND)
        except OSError as error:
            raise output_error(log, error) from error
        assert process.stdout is not None

        def end_it() -> None:
            while process.poll() is None:
                if interruption.requested:
                    ask_to_stop(process)
                    return
                time.sleep(0.2)

        threading.Thread(target=end_it, daemon=True).start()
        with process:
            try:
                for line in process.stdout:
                    try:
                        event = json.loads(line)
                    except ValueError:
                        continue
                    if isinstance(event, dict) and "event" in event:
                        take(cast("TrainerEvent", event))
                code = process.wait()
            except BaseException:
                kill_tree(process)
                raise
        return code, interruption.requested


def _failure(out: Path, code: int, event: TrainerEvent | None, preset: Preset) -> InfraBlendError:
    if event is not None and event["code"] == "labels-dropped":
        return DatasetError(f"{out}: the trainer would drop labels: {event['message']}")
    if code == -9 or (event is not None and event["code"] == "out-of-memory"):
        return RenderError(
            f"{out}: memory ran out with a batch of {preset.batch}; give --set batch={max(preset.batch // 2, 1)} "
            "and --overwrite"
        )
    text = event["message"] if event is not None else f"the process ended with code {code}"
    return RenderError(f"{out}: the trainer failed: {text}. See {out / LOG}; --resume tries again")
