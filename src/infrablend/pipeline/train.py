"""A detector from a dataset: labels checked, tiles cut, the trainer run apart, everything recorded."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
import shutil
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from PIL import Image

from infrablend import __version__
from infrablend.annotation.classes import drop_classes
from infrablend.core.cores import available_cores
from infrablend.core.dataset import Dataset, ImageRecord, Split
from infrablend.core.files import output_error, part_path, write_json
from infrablend.core.format_table import writer_for_task
from infrablend.core.machine import describe_machine
from infrablend.core.output import Existing, OutputFolder
from infrablend.core.tasks import OnProgress, Progress
from infrablend.errors import DatasetError, InfraBlendError, Interrupted, OutputError, Problem, RenderError
from infrablend.execution.interrupt import Interruption
from infrablend.formats import writing
from infrablend.formats.pictures import read_size
from infrablend.pipeline.content import content_digest
from infrablend.training import environment, presets, tiles, trainer, weights
from infrablend.training.presets import PRESETS, Preset
from infrablend.training.request import PRESET_FIELDS, TrainRequest

RECORD = "train.json"
LOG = "train.log"
JOB = "job.json"
DATA = "data"
_NEW = Path(trainer.CHECKPOINT).with_suffix(".new").name
# Labels that would be missing in what is trained on: nobody who trains wants that.
_FATAL_LOSSES = ("box_outside", "without_mask_omitted", "class_unfit")
# Rejected labels and pictures that an error names; it says how many there are.
_REJECTED_SHOWN = 20

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainReport:
    """What a training gave.

    Attributes:
        out: Its folder.
        weights: The final weights.
        record: What `train.json` says.
    """

    out: Path
    weights: Path
    record: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {"out": str(self.out), "weights": str(self.weights), **self.record}


@dataclass(frozen=True)
class TrainPlan:
    """What a training would do.

    Attributes:
        images: Pictures, or tiles cut from them, that are trained on.
        labels: Labels of the train split.
        epochs: At most so many.
        shown: Images shown in an epoch.
        tiled: Whether `images` are tiles.
        device: As Ultralytics names it.
        seconds: About so long.
        disk_bytes: About so much at once.
    """

    images: int
    labels: int
    epochs: int
    shown: int
    tiled: bool
    device: str
    seconds: float
    disk_bytes: int


def plan_training(
    dataset: Dataset, request: TrainRequest, *, out: Path | None = None, existing: Existing = "refuse"
) -> TrainPlan:
    """Return what `train_dataset` would do, without doing it; whatever it would refuse is refused here too.

    Two checks are left to the training: arguments of Ultralytics where that is not installed, and whether published
    weights can be downloaded.
    """
    preset = request.chosen_preset()
    device = _device(request.device, planning=True)
    require_settings(preset)
    weights.require_known(request.weights)
    if out is not None and out.is_dir():
        _earlier(out, existing)
    wanted, _ = _wanted(dataset, preset, request.task, request.classes)
    return _plan(wanted, preset, device, request.seed)


def _plan(wanted: Dataset, preset: Preset, device: str, seed: int) -> TrainPlan:
    parts = {s: [i for i in wanted.images if i.split == s] for s in ("train", "val")}
    if preset.tile:
        cut = {s: tiles.plan_tiles(p, preset.tile, seed=seed, most=_most(preset, s)) for s, p in parts.items()}
        images, size = len(cut["train"]), sum(len(c) for c in cut.values()) * preset.tile**2
    else:
        images, size = len(parts["train"]), sum(i.path.stat().st_size for i in wanted.images if i.path.is_file())
    labels = sum(len(i.instances) for i in parts["train"])
    epochs, shown = preset.epochs_for(images)
    return TrainPlan(
        images=images, labels=labels, epochs=epochs, shown=shown, tiled=preset.tile > 0, device=device,
        seconds=presets.estimate_seconds(preset, images, gpu=device != "cpu", cores=available_cores()),
        disk_bytes=round(size + presets.weights_bytes(preset)),
    )  # fmt: skip


def _most(preset: Preset, split: str) -> int:
    """At most so many tiles of a split; 0: all."""
    return preset.tiles if split == "train" else min(preset.tiles or 256, 256)


def train_dataset(
    dataset: Dataset,
    out: Path,
    request: TrainRequest,
    *,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> TrainReport:
    """Train a detector, and leave `weights.pt` and `train.json` in `out`.

    Args:
        dataset: Dataset with a train split, and with a val split where the preset stops early.
        out: Folder to write.
        request: How to train.
        existing: What to do if `out` already contains a training: `refuse`; `resume` from the last checkpoint, which
            leaves a finished training as it is and refuses other labels or pictures; or `overwrite`.
        on_progress: Called with the number of images shown so far.

    Raises:
        MissingDependencyError: Ultralytics or torch is not installed, or too old.
        DatasetError: The dataset is not fit for training: splits, classes, or labels that would be lost.
        OutputError: The folder, the disk or a setting is not fit for use.
        RenderError: The trainer failed; its log gives the reason.
        Interrupted: The user stopped the training; `resume` continues it.
    """
    preset, task = request.chosen_preset(), request.task
    weights.require_ultralytics()
    device = _device(request.device)
    _require_arguments(preset)
    wanted, left_out = _wanted(dataset, preset, task, request.classes)
    with _output(out).claimed():
        record = _begin(out, existing)
        asked = {
            "preset": preset.name, "task": task, "seed": request.seed, "settings": dataclasses.asdict(preset),
            "classes": [c.name for c in wanted.categories], "data": str(dataset.root.resolve()),
            "start_asked": request.weights, "content": _content(wanted, task),
        }  # fmt: skip
        if record is not None:
            _require_same(out, record, asked)
            if record["status"] == "complete" and (out / trainer.WEIGHTS).is_file():
                return TrainReport(out, out / trainer.WEIGHTS, record)
        if record is None or record.get("prepared") is None:
            _require_space(out, _plan(wanted, preset, device, request.seed))
            start = weights.find_start(request.weights, preset, task)
            record = {
                "infrablend": __version__, "status": "running", **asked, "left_out": left_out, "sessions": [],
                "machine": _machine(device), "start": dataclasses.asdict(start),
            }  # fmt: skip
            write_json(out / RECORD, record, durable=True)
            record["prepared"] = _prepare(wanted, out, preset, task, request.seed)
            write_json(out / RECORD, record, durable=True)
        return _run(out, record, preset, task, device, request.seed, on_progress)


def _wanted(
    dataset: Dataset, preset: Preset, task: str, classes: Sequence[str] | None
) -> tuple[Dataset, dict[str, int]]:
    """Return the dataset to train on and the labels left out by class; report all faults at once."""
    problems: list[Problem] = []
    if task not in presets.TASKS:
        raise OutputError(f"--task {task}: no such task; expected one of {', '.join(presets.TASKS)}")
    known = [c.name for c in dataset.categories if not c.ignore]
    unknown = [c for c in classes or () if c not in known]
    if unknown:
        expected = f"classes of the dataset ({', '.join(known) or 'it has none'})"
        problems.append(Problem("--classes", "category-unknown", ", ".join(unknown), expected))
    keep = [c for c in known if classes is None or c in classes]
    dropped = [c.name for c in dataset.categories if c.name not in keep]
    left_out = Counter(o.category for i in dataset.images for o in i.instances if o.category in dropped)
    wanted = drop_classes(dataset, dropped)
    if not keep and not unknown:
        problems.append(Problem(str(dataset.root), "category-none", "no class", "at least one", "label something"))
    splits = Counter(i.split for i in wanted.images)
    why: dict[Split, str] = {"train": "nothing to train on", "val": "the preset stops when val gets no better"}
    if not preset.patience:
        why["val"] = "some, to watch the training by; nothing else depends on them"
    for split in why:
        if not splits[split]:
            problem = Problem(
                f"split {split}", "split-empty", "no pictures", why[split], "infrablend split makes splits"
            )
            needed = split == "train" or preset.patience
            problems.append(problem if needed else replace(problem, severity="warning"))
    found = Counter(o.category for i in wanted.images if i.split == "train" for o in i.instances)
    for name in keep:
        if splits["train"] and not found[name]:
            problem = Problem(f"class {name}", "class-empty", "no object in split train", "at least one",
                              "leave the class out: --classes with the others")  # fmt: skip
            problems.append(replace(problem, severity="warning") if preset.name == "smoke" else problem)
    if task == "obb":
        bare = Counter(o.category for i in wanted.images for o in i.instances if o.corners_xy is None)
        problems += [Problem(f"class {k}", "obb-missing", f"{n} objects without oriented box", "one for each",
                             "train --task detect") for k, n in bare.items()]  # fmt: skip
    if task == "segment":
        bare = Counter(o.category for i in wanted.images for o in i.instances if o.mask is None)
        problems += [Problem(f"class {k}", "mask-missing", f"{n} objects without mask", "one for each",
                             "train --task detect, or only classes with masks: --classes")
                     for k, n in bare.items()]  # fmt: skip
    rejected = [p for p in dataset.problems if p.severity == "error"]
    if rejected or any(p.severity == "error" for p in problems):
        message = f"{dataset.root}: cannot be trained on"
        if rejected:
            shown = f"; here are the first {_REJECTED_SHOWN}" if len(rejected) > _REJECTED_SHOWN else ""
            message += (
                f". {len(rejected)} labels or pictures could not be read and would be missing{shown}; infrablend check "
                f"{dataset.root} lists them: correct them, or infrablend convert {dataset.root} clean --to coco leaves "
                "them out and counts them; then train on clean"
            )
        wrong = [p for p in problems if p.severity == "error"]
        raise DatasetError(message, [*wrong, *rejected[:_REJECTED_SHOWN]])
    for p in problems:
        log.warning("%s", p)
    return _checked(wanted), dict(sorted(left_out.items()))


def _checked(dataset: Dataset) -> Dataset:
    """Return train and val with the sizes in the pictures' headers.

    Raises:
        DatasetError: Pictures that cannot be read, have 16 bits, or have another size than annotated: all of them.
    """
    images, problems = [], []
    for image in dataset.images:
        if image.split == "test":
            continue
        size_wh, problem = read_size(image.path, image.id)
        problems += [problem] if problem is not None else []
        if size_wh is None:
            continue
        if image.size_wh not in (None, size_wh):
            expected = f"{image.size_wh} as annotated"
            problems.append(Problem(image.id, "image-size", f"{size_wh} px", expected, "correct the annotation"))
        with Image.open(image.path) as picture:
            if picture.mode.startswith(("I", "F")):
                todo = "map them to 8 bits first: the trainer would halve their contrast away unasked"
                problems.append(Problem(image.id, "image-depth", f"mode {picture.mode}", "8-bit pictures", todo))
        images.append(replace(image, size_wh=size_wh))
    if problems:
        raise DatasetError(f"{dataset.root}: cannot be trained on", problems)
    return replace(dataset, images=tuple(images))


def _device(wanted: str, *, planning: bool = False) -> str:
    """`cpu`, `mps` or a GPU's number, as Ultralytics names them; for a plan without torch, `auto` is the processor."""
    number = wanted.removeprefix("cuda:")
    if "," in wanted:
        raise OutputError(f"--device {wanted}: several GPUs; expected one, such as {number.partition(',')[0]}")
    if wanted not in ("auto", "cpu", "cuda", "mps") and not (number.isascii() and number.isdigit()):
        raise OutputError(f"--device {wanted}: no such device; expected auto, cpu, mps, cuda, or a GPU such as cuda:1")
    if wanted == "cpu" or (planning and wanted == "auto" and find_spec("torch") is None):
        return "cpu"
    if planning:
        weights.require_ultralytics()
    import torch

    if wanted == "mps":
        if torch.backends.mps.is_available():
            return "mps"
        raise OutputError(f"--device mps: torch {torch.__version__} does not have it here; expected --device cpu")
    there = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if wanted == "auto":
        return "0" if there else "cpu"
    index = 0 if wanted == "cuda" else int(number)
    if index < there:
        return str(index)
    found = f"finds {there} GPU{'s' * (there > 1)}, numbered from 0" if there else "finds no GPU"
    raise OutputError(
        f"--device {wanted}: torch {torch.__version__} {found}; expected one that is there, or --device cpu. "
        "infrablend doctor says what is there"
    )


def require_settings(preset: Preset) -> None:
    """Raise OutputError for what the trainer would refuse of a preset; where Ultralytics is there to be asked."""
    if not weights.missing_packages():
        _require_arguments(preset)


def _require_arguments(preset: Preset) -> None:
    """Ultralytics' arguments that somebody set, judged by it before anything is made (not the presets': it is slow)."""
    own = PRESETS[preset.name].arguments if preset.name in PRESETS else {}
    given = {k: v for k, v in preset.arguments.items() if k not in own or own[k] != v}
    wrong = environment.wrong_arguments(given) if given else ""
    if wrong:
        where = " ".join(f"--set {k}" for k in given)
        raise OutputError(
            "settings of the training",
            [Problem(where, "setting-malformed", wrong, f"fields ({', '.join(PRESET_FIELDS)}) or Ultralytics' own")],
        )


def _content(wanted: Dataset, task: str) -> str:
    """Digest of the labels and pictures that are trained on, wherever they lie."""
    found = content_digest(wanted)
    if task != "segment":
        return found
    masks = [o.mask.to_coco() for i in wanted.images for o in i.instances if o.mask is not None]
    return hashlib.sha256(json.dumps([found, masks], sort_keys=True).encode()).hexdigest()


def _begin(out: Path, existing: Existing) -> dict[str, Any] | None:
    """Return the record of the earlier call to continue, or None after emptying the folder."""
    record, damaged = _earlier(out, existing)
    if record is not None and existing == "resume":
        return record
    if damaged:
        log.warning("%s: cannot be read; the training starts again", out / RECORD)
    if record is not None or damaged:
        _output(out).remove(
            [DATA, "tiles", "run", "ultralytics", trainer.CHECKPOINT, trainer.DAMAGED, _NEW, trainer.WEIGHTS, JOB, LOG,
             RECORD]
        )  # fmt: skip
    return None


def _output(out: Path) -> OutputFolder:
    return OutputFolder(out, "training", RECORD, can_resume=True, can_overwrite=True)


def _earlier(out: Path, existing: Existing) -> tuple[dict[str, Any] | None, bool]:
    """Return an earlier call's record and whether it is damaged; refuse both without `resume` or `overwrite`."""
    path = out / RECORD
    entries = _output(out).entries(ignore=[part_path(path).name])
    if not entries:
        return None, False
    try:
        record: dict[str, Any] | None = json.loads(path.read_text("utf-8"))
        ours = isinstance(record, dict) and "infrablend" in record and "status" in record
    except (OSError, ValueError):
        ours, record = False, None
    damaged = not ours and RECORD in entries and JOB in entries
    if not ours and not damaged:
        raise _output(out).refuse_not_ours()
    if existing == "refuse":
        what = f"{RECORD} cannot be read" if damaged else record["status"] if record else "?"
        raise OutputError(
            f"{out}: contains a training ({what}). Use --resume to {'start it again' if damaged else 'continue it'}, "
            "--overwrite to replace it, or give another folder."
        )
    return (None, True) if damaged else (record, False)


def _require_same(out: Path, record: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    plain, record = _flat(json.loads(json.dumps(asked))), _flat(record)
    # What is trained on counts, not where it lies; records of earlier versions know only that.
    plain.pop("data" if "content" in record else "content")
    # A setting that one side alone has differs, too.
    more = [k for k in record if k.startswith("settings.") and k not in plain]
    other = [k for k in [*plain, *more] if record.get(k) != plain.get(k)]
    if other:
        problems = [
            Problem(asked["data"], "resume-other",
                    "other labels or pictures", f"those it was begun with, then in {record.get('data')}")
            if k == "content"
            else Problem(k, "resume-other", str(plain.get(k)), f"{record.get(k)} as begun")
            for k in other
        ]  # fmt: skip
        raise OutputError(f"{out}: was begun otherwise; give the same, or another folder", problems)


def _flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record with its settings side by side: `settings.passes`, `settings.arguments.lr0`."""
    flat = dict(record)
    settings = dict(flat.pop("settings", {}))
    settings |= {f"arguments.{k}": v for k, v in settings.pop("arguments", {}).items()}
    return flat | {f"settings.{k}": v for k, v in settings.items()}


def _require_space(out: Path, plan: TrainPlan) -> None:
    need = plan.disk_bytes * 1.2
    free = shutil.disk_usage(out).free
    if free < need:
        found = f"{free / 1e6:.0f} MB free"
        problem = Problem(str(out), "disk-full", found, f"{need / 1e6:.0f} MB", "free some, or give a folder elsewhere")
        raise OutputError(f"{out}: not enough room for the training", [problem])


def _prepare(dataset: Dataset, out: Path, preset: Preset, task: str, seed: int) -> dict[str, Any]:
    """Write what the trainer reads into `out/data`; say what it is."""
    shutil.rmtree(out / DATA, ignore_errors=True)
    images = [i for i in dataset.images if i.split in ("train", "val")]
    counts: dict[str, Any] = {
        "pictures": dict(Counter(i.split for i in images)),
        "objects": {s: dict(sorted(Counter(o.category for i in images if i.split == s for o in i.instances).items()))
                    for s in ("train", "val")},
    }  # fmt: skip
    if preset.tile:
        cut: list[ImageRecord] = []
        for split in ("train", "val"):
            part = [i for i in images if i.split == split]
            planned = tiles.plan_tiles(part, preset.tile, seed=seed, most=_most(preset, split))
            records, found = tiles.write_tiles(planned, out / "tiles")
            cut += records
            counts["tiles" if split == "train" else "tiles_val"] = {"tiles": len(records), **found}
        images = cut
    if not any(i.split == "val" for i in images):
        # The trainer wants a val split; with fixed passes nothing depends on it.
        images += [replace(i, split="val") for i in images[:8]]
        counts["val"] = "the first pictures of train: there is no val split, and nothing depends on it"
    categories = [replace(c, id=n) for n, c in enumerate(dataset.categories)]
    name = writer_for_task(task).name
    written = writing.write(name, out / DATA, images, categories)
    shutil.rmtree(out / "tiles", ignore_errors=True)
    fatal = {k: n for k, n in written.losses.items() if k.rpartition(".")[2] in _FATAL_LOSSES}
    if fatal:
        problems = [Problem(name, k, f"{n} labels would be lost", "none",
                            "infrablend check says where") for k, n in fatal.items()]  # fmt: skip
        raise DatasetError(f"{dataset.root}: labels that the trainer would not see", problems)
    labels = {s: sum(len(p.read_text("utf-8").splitlines()) for p in (out / DATA / "labels" / s).rglob("*.txt"))
              for s in ("train", "val")}  # fmt: skip
    return {
        **counts,
        "images": sum(i.split == "train" for i in images),
        "labels": labels["train"],
        "images_val": sum(i.split == "val" for i in images),
        "labels_val": labels["val"],
        "losses": dict(written.losses),
    }


def _run(
    out: Path, record: dict[str, Any], preset: Preset, task: str, device: str, seed: int, on_progress: OnProgress | None
) -> TrainReport:
    """Run the process that trains, from the start or from its last checkpoint."""
    prepared = record["prepared"]
    epochs, shown = preset.epochs_for(prepared["images"])
    job = trainer.Job(
        data=str((out / DATA / "data.yaml").resolve()), out=str(out.resolve()), task=task,
        model=record["start"]["model"], device=device, epochs=epochs, batch=preset.batch,
        image_size=preset.image_size, tile=preset.tile, patience=preset.patience, seed=seed, images=prepared["images"],
        labels=prepared["labels"], shown=shown, arguments=dict(preset.arguments),
        val_images=prepared.get("images_val", 0) if preset.patience else 0,
        val_labels=prepared.get("labels_val", 0) if preset.patience else 0,
    )  # fmt: skip
    job.write(out / JOB)
    record |= {"status": "running", "epochs": epochs, "device": device}
    write_json(out / RECORD, record, durable=True)
    began = time.monotonic()
    last: dict[str, dict[str, Any]] = {}

    def take(event: dict[str, Any]) -> None:
        last[event["event"]] = event
        if event["event"] == "damaged":
            log.warning("%s: %s", out, event["message"])
        if event["event"] == "step" and on_progress is not None:
            seconds = max(time.monotonic() - began, 1e-6)
            done, total = int(event["images"]), epochs * shown
            first = last.setdefault("first", {"images": done, "at": seconds})
            pace = (done - first["images"]) / max(seconds - first["at"], 1e-6)
            eta = (total - done) / pace if pace > 0 else None
            on_progress(Progress(done, total, pace, eta, {"epoch": event["epoch"]}))

    code, stopped = _watch([sys.executable, "-W", "ignore", "-m", trainer.__name__, str(out / JOB)], out / LOG, take)
    # Once it has said so, the weights lie there: a stop that comes later stops nothing.
    done = "end" in last and (code == 0 or stopped)
    session: dict[str, Any] = {"seconds": round(time.monotonic() - began, 1),
                               "end": "end" if done else "stopped" if stopped else "failed",
                               "epoch": int(last.get("epoch", {}).get("epoch", 0))}  # fmt: skip
    if "damaged" in last:
        session["begun_anew"] = last["damaged"]["message"]
    record["sessions"] = [*record["sessions"], session]
    record["status"] = "complete" if done else "interrupted" if stopped else "failed"
    if done:
        end = last["end"]
        record |= {k: end[k] for k in ("precision", "threads", "versions", "batch")}
        record |= {
            "epochs_done": end["epochs"],
            "passes": end["epochs"] * shown,
            "seconds": round(sum(s["seconds"] for s in record["sessions"]), 1),
            "losses": last.get("epoch", {}).get("losses", {}),
            "gate": {k: v for k, v in last["gate"].items() if k != "event"} if "gate" in last else record.get("gate"),
        }
        if end["batch"] != preset.batch:
            why = "memory was short" if end["short_of_memory"] else f"there are {prepared['images']} images"
            record["note"] = f"batch {end['batch']} rather than {preset.batch}: {why}"
    write_json(out / RECORD, record, durable=True)
    if stopped and not done:
        reached = _reached(record["sessions"])
        if reached:
            raise Interrupted(f"Stopped after epoch {reached} of {epochs}; the same command with --resume goes on.")
        raise Interrupted(
            f"Stopped before the first of {epochs} epochs had ended; the same command with --resume begins it again."
        )
    if not done:
        raise _failure(out, code, last.get("error"), preset)
    for name in (DATA, "run", "ultralytics"):  # the tiles alone are more than all the rest
        shutil.rmtree(out / name, ignore_errors=True)
    for name in (trainer.CHECKPOINT, _NEW):
        (out / name).unlink(missing_ok=True)
    return TrainReport(out, out / trainer.WEIGHTS, record)


def _reached(sessions: Sequence[Mapping[str, Any]]) -> int:
    """Return the last epoch that ended, over sessions that continued each other or started again."""
    reached = 0
    for s in sessions:
        reached = max(0 if "begun_anew" in s else reached, s["epoch"])
    return reached


def _watch(command: list[str], log: Path, take: Callable[[dict[str, Any]], None]) -> tuple[int, bool]:
    """Run the process, hand on its events; its exit code, and whether somebody asked to stop."""
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


def _failure(out: Path, code: int, said: Mapping[str, Any] | None, preset: Preset) -> InfraBlendError:
    """Return the error of a failed training."""
    if said is not None and said["code"] == "labels-dropped":
        return DatasetError(f"{out}: the trainer would drop labels: {said['message']}")
    if code == -9 or (said is not None and said["code"] == "out-of-memory"):
        return RenderError(
            f"{out}: memory ran out with a batch of {preset.batch}; give --set batch={max(preset.batch // 2, 1)} "
            "and --overwrite"
        )
    text = said["message"] if said is not None else f"the process ended with code {code}"
    return RenderError(f"{out}: the trainer failed: {text}. {out / LOG} has all it said; --resume tries again")


def _machine(device: str) -> dict[str, Any]:
    found: dict[str, Any] = {k: describe_machine()[k] for k in ("processor", "cores", "system")}
    if device != "cpu":
        import torch

        found["gpu"] = torch.cuda.get_device_name(int(device)) if device.isdigit() else device
    return found
