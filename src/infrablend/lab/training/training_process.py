"""Process that trains: start it, follow its events, record its end."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from infrablend.core.file_names import real_path
from infrablend.core.files import output_error, write_json
from infrablend.core.tasks import OnProgress, Progress
from infrablend.detection.training_folder import DATA, JOB, LOG, RECORD
from infrablend.errors import DatasetError, InfraBlendError, Interrupted, RenderError
from infrablend.lab.training import trainer
from infrablend.lab.training.presets import Preset
from infrablend.pipeline.execution.interrupt import Interruption

log = logging.getLogger(__name__)


def run_trainer(
    out: Path, record: dict[str, Any], preset: Preset, device: str, on_progress: OnProgress | None
) -> dict[str, Any]:
    """Run the training process from the start or its last checkpoint, and return the finished record."""
    prepared = record["prepared"]
    epochs, shown = preset.epochs_for(prepared["images"])
    job = trainer.Job(
        data=str(real_path(out / DATA / "data.yaml")), out=str(real_path(out)), task=record["task"],
        model=record["start"]["model"], device=device, epochs=epochs, batch=preset.batch,
        image_size=preset.image_size, tile=preset.tile, patience=preset.patience, seed=record["seed"],
        images=prepared["images"], labels=prepared["labels"], shown=shown, arguments=dict(preset.arguments),
        val_images=prepared.get("images_val", 0) if preset.patience else 0,
        val_labels=prepared.get("labels_val", 0) if preset.patience else 0, agc=record.get("agc"),
    )  # fmt: skip
    write_json(out / JOB, asdict(job))
    record |= {"epochs": epochs, "device": device}
    write_json(out / RECORD, record, durable=True)
    began = time.monotonic()
    last: dict[str, dict[str, Any]] = {}
    before = list(record["sessions"])

    def note_session(end: str) -> None:
        session = {"seconds": round(time.monotonic() - began, 1), "end": end,
                   "epoch": int(last.get("epoch", {}).get("epoch", 0))}  # fmt: skip
        if "damaged" in last:
            session["restarted"] = last["damaged"]["message"]
        record["sessions"] = [*before, session]

    def take(event: dict[str, Any]) -> None:
        last[event["event"]] = event
        if event["event"] == "damaged":
            log.warning("%s: %s", out, event["message"])
        if event["event"] == "epoch":  # the record must count this session even if it is killed
            note_session("killed")
            write_json(out / RECORD, record, durable=True)
        if event["event"] == "step" and on_progress is not None:
            seconds = max(time.monotonic() - began, 1e-6)
            done, total = int(event["images"]), epochs * shown
            first = last.setdefault("first", {"images": done, "at": seconds})
            pace = (done - first["images"]) / max(seconds - first["at"], 1e-6)
            eta = (total - done) / pace if pace > 0 else None
            on_progress(Progress(done, total, pace, eta, {"epoch": event["epoch"]}))

    command = [sys.executable, "-W", "ignore", "-m", trainer.__name__, str(os.getpid()), str(out / JOB)]
    code, stopped = watch(command, out / LOG, take)
    # After the event `end` the weights are complete, and a stop has no effect.
    done = "end" in last and (code == 0 or stopped)
    note_session("end" if done else "stopped" if stopped else "failed")
    if done:
        end = last["end"]
        record |= {k: end[k] for k in ("precision", "threads", "versions", "batch")}
        record |= {
            "epochs_done": end["epochs"],
            "passes": end["epochs"] * shown,
            "seconds": round(sum(s["seconds"] for s in record["sessions"]), 1),
            "losses": end["losses"],
            "gate": end["gate"],
        }
        if end["batch"] != preset.batch:
            why = "memory was short" if end["short_of_memory"] else f"there are {prepared['images']} images"
            record["note"] = f"batch {end['batch']} rather than {preset.batch}: {why}"
    write_json(out / RECORD, record, durable=True)
    if stopped and not done:
        raise _stopped(record["sessions"], epochs)
    if not done:
        raise _failure(out, code, last.get("error"), preset)
    return record


def _stopped(sessions: list[dict[str, Any]], epochs: int) -> Interrupted:
    reached = 0  # each session continued the one before or started again
    for s in sessions:
        reached = max(0 if "restarted" in s else reached, s["epoch"])
    at = f"after epoch {reached} of {epochs}"
    then = "continues"
    if not reached:
        at = f"before the end of the first of {epochs} epochs"
        then = "starts it again"
    return Interrupted(f"Stopped {at}; the same command with --resume {then}.")


def watch(command: list[str], log: Path, take: Callable[[dict[str, Any]], None]) -> tuple[int, bool]:
    """Run the process and pass on its events; return its exit code and whether a stop was requested."""
    with Interruption() as interruption:
        try:
            with log.open("ab") as errors:
                process = subprocess.Popen(
                    command, stdout=subprocess.PIPE, stderr=errors, text=True, start_new_session=True
                )
        except OSError as error:
            raise output_error(log, error) from error
        assert process.stdout is not None

        def end_it() -> None:
            while process.poll() is None:
                if interruption.requested:
                    process.terminate()
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
                        take(event)
                code = process.wait()
            except BaseException:
                process.kill()
                raise
        return code, interruption.requested


def _failure(out: Path, code: int, event: Mapping[str, Any] | None, preset: Preset) -> InfraBlendError:
    if event is not None and event["code"] == "labels-dropped":
        return DatasetError(f"{out}: the trainer would drop labels: {event['message']}")
    if code == -9 or (event is not None and event["code"] == "out-of-memory"):
        return RenderError(
            f"{out}: memory ran out with a batch of {preset.batch}; give --set batch={max(preset.batch // 2, 1)} "
            "and --overwrite"
        )
    text = event["message"] if event is not None else f"the process ended with code {code}"
    return RenderError(f"{out}: the trainer failed: {text}. See {out / LOG}; --resume tries again")
