"""A detector from a dataset: labels checked, tiles cut, the trainer run apart, everything recorded."""

from __future__ import annotations

import dataclasses
import json
import platform
import shutil
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from PIL import Image

from infrablend import __version__
from infrablend.annotation.classes import drop_classes
from infrablend.core.cores import available_cores
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.files import claimed_folder, output_error, write_json
from infrablend.core.tasks import OnProgress, Progress
from infrablend.errors import DatasetError, InfraBlendError, Interrupted, OutputError, Problem, RenderError
from infrablend.execution.interrupt import Interruption
from infrablend.formats import writing
from infrablend.formats.pictures import read_size
from infrablend.training import presets, tiles, trainer, weights
from infrablend.training.presets import PRESETS, Preset

RECORD = "train.json"
LOG = "train.log"
DATA = "data"
# Labels that would be missing in what is trained on: nobody who trains wants that.
_FATAL_LOSSES = ("box_outside", "without_mask_omitted", "class_unfit")
_PRESET_FIELDS = ("model", "image_size", "batch", "epochs", "passes", "patience", "tile", "tiles")


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
    """What a training would do: `images` (pictures or tiles) per epoch, `epochs`, `seconds`, `disk_bytes`."""

    images: int
    labels: int
    epochs: int
    seconds: float
    disk_bytes: int


def choose_preset(name: str, settings: Mapping[str, Any]) -> Preset:
    """The preset with single fields and Ultralytics' arguments set otherwise.

    Raises:
        OutputError: No such preset, or a field with a value of the wrong kind.
    """
    if name not in PRESETS:
        raise OutputError(f"--preset {name}: no such preset; expected one of {', '.join(PRESETS)}")
    preset = PRESETS[name]
    fields = {k: v for k, v in settings.items() if k in _PRESET_FIELDS}
    arguments = {k: v for k, v in settings.items() if k not in _PRESET_FIELDS}
    problems = [
        Problem(f"--set {k}", "setting-malformed", repr(v), "a name" if k == "model" else "a whole number from 0 up")
        for k, v in fields.items()
        if not (isinstance(v, str) if k == "model" else type(v) is int and v >= 0)
    ]
    if problems:
        raise OutputError("settings of the training", problems)
    if fields.get("epochs"):
        fields.setdefault("passes", 0)
    elif fields.get("passes"):
        fields.setdefault("epochs", 0)
    return replace(preset, **fields, arguments={**preset.arguments, **arguments})


def plan_training(
    dataset: Dataset, preset: Preset, *, task: str, classes: Sequence[str] | None, gpu: bool
) -> TrainPlan:
    """What `train_dataset` would do, without doing it."""
    wanted, _ = _wanted(dataset, preset, task, classes)
    train = [i for i in wanted.images if i.split == "train"]
    if preset.tile:
        found = tiles.plan_tiles(train, preset.tile, seed=0, most=preset.tiles)
        images, size = len(found), len(found) * preset.tile**2
    else:
        images, size = len(train), sum(i.path.stat().st_size for i in train if i.path.is_file())
    labels = sum(len(i.instances) for i in train)
    seconds = presets.estimate_seconds(preset, images, gpu=gpu, cores=available_cores())
    # Checkpoint, weights and Ultralytics' own two files.
    return TrainPlan(images, labels, preset.epochs_for(images)[0], seconds, size + 120_000_000)


def train_dataset(
    dataset: Dataset,
    out: Path,
    *,
    preset: Preset,
    task: str = "detect",
    start: str = weights.AUTO,
    device: str = "auto",
    seed: int = 0,
    classes: Sequence[str] | None = None,
    resume: bool = False,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> TrainReport:
    """Train a detector and leave `weights.pt` and `train.json` in `out`.

    Args:
        dataset: With a train split; with a val split too where the preset stops early.
        out: New or empty, or of an earlier call with `resume` or `overwrite`.
        preset: How, see `choose_preset`.
        task: detect, obb or segment.
        start: See `weights.find_start`.
        device: `auto`, `cpu`, `cuda`, or a number of a GPU.
        seed: Of weights, order, augmentation and tiles.
        classes: Only these; others are left out and counted.
        resume: Go on from the last checkpoint; a finished training is left as it is.
        overwrite: Delete an earlier training in `out` first.
        on_progress: Told the images passed.

    Raises:
        MissingDependencyError: Ultralytics or torch is not installed.
        DatasetError: The dataset cannot be trained on: splits, classes, labels that would be lost.
        OutputError: The folder, the disk, or a setting.
        RenderError: The trainer failed; its log says why.
        Interrupted: Stopped; `resume` goes on.
    """
    weights.require_ultralytics()
    chosen = _device(device)
    wanted, left_out = _wanted(dataset, preset, task, classes)
    with claimed_folder(out, "another training is at work here; wait for it, or give another folder"):
        record = _begin(out, resume, overwrite)
        asked = {
            "preset": preset.name, "task": task, "seed": seed, "settings": dataclasses.asdict(preset),
            "classes": [c.name for c in wanted.categories], "data": str(dataset.root.resolve()), "start_asked": start,
        }  # fmt: skip
        if record is not None:
            _require_same(out, record, asked)
            if record["status"] == "complete" and (out / trainer.WEIGHTS).is_file():
                return TrainReport(out, out / trainer.WEIGHTS, record)
        if record is None or record.get("prepared") is None:
            _require_space(out, wanted, preset)
            record = {
                "infrablend": __version__, "status": "running", **asked, "left_out": left_out, "sessions": [],
                "machine": _machine(chosen), "start": dataclasses.asdict(weights.find_start(start, preset, task)),
            }  # fmt: skip
            write_json(out / RECORD, record)
            record["prepared"] = _prepare(wanted, out, preset, task, seed)
            write_json(out / RECORD, record)
        return _run(out, record, preset, task, chosen, seed, on_progress)


def _wanted(
    dataset: Dataset, preset: Preset, task: str, classes: Sequence[str] | None
) -> tuple[Dataset, dict[str, int]]:
    """The dataset as it is trained on, and how many labels of which classes are left out. Everything wrong at once."""
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
    for split in ("train", "val") if preset.patience else ("train",):
        if not splits[split]:
            why = "the preset stops when val gets no better" if split == "val" else "nothing to train on"
            todo = "infrablend split makes splits"
            problems.append(Problem(f"split {split}", "split-empty", "no pictures", why, todo))
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
    if any(p.severity == "error" for p in problems):
        raise DatasetError(f"{dataset.root}: cannot be trained on", problems)
    return _sized(wanted), dict(sorted(left_out.items()))


def _sized(dataset: Dataset) -> Dataset:
    """Train and val, with sizes as the pictures have them; unreadable and 16-bit pictures are refused, all at once."""
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


def _device(wanted: str) -> str:
    """`cpu` or a GPU's number, as Ultralytics names them."""
    if wanted == "cpu":
        return "cpu"
    import torch

    if torch.cuda.is_available():
        return "0" if wanted in ("auto", "cuda") else wanted
    if wanted == "auto":
        return "cpu"
    raise OutputError(
        f"--device {wanted}: torch {torch.__version__} finds no GPU; expected one, or --device cpu. "
        "infrablend doctor says what is there"
    )


def _begin(out: Path, resume: bool, overwrite: bool) -> dict[str, Any] | None:
    """The record of an earlier call to go on with, or None for an empty folder."""
    path = out / RECORD
    entries = sorted(p.name for p in out.iterdir())
    if not entries:
        return None
    try:
        record: dict[str, Any] | None = json.loads(path.read_text("utf-8"))
        ours = isinstance(record, dict) and "infrablend" in record and "status" in record
    except (OSError, ValueError):
        ours, record = False, None
    if not ours:
        raise OutputError(f"{out}: not empty (found {', '.join(entries[:4])}) and no training; give another folder")
    if resume:
        return record
    if not overwrite:
        raise OutputError(
            f"{out}: holds a training ({record['status'] if record else '?'}). "
            "--resume goes on with it, --overwrite replaces it, or give another folder."
        )
    for name in (DATA, "tiles", "run", "ultralytics"):
        shutil.rmtree(out / name, ignore_errors=True)
    for name in (trainer.CHECKPOINT, trainer.WEIGHTS, "job.json", LOG, RECORD):
        (out / name).unlink(missing_ok=True)
    return None


def _require_same(out: Path, record: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    plain = json.loads(json.dumps(asked))
    other = [k for k in plain if record.get(k) != plain[k]]
    if other:
        problems = [Problem(k, "resume-other", str(plain[k]), str(record.get(k)) + " as begun") for k in other]
        raise OutputError(f"{out}: was begun otherwise; give the same, or another folder", problems)


def _require_space(out: Path, dataset: Dataset, preset: Preset) -> None:
    need = plan_training(dataset, preset, task="detect", classes=None, gpu=False).disk_bytes * 1.5
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
            most = preset.tiles if split == "train" else min(preset.tiles or 256, 256)
            records, found = tiles.write_tiles(tiles.plan_tiles(part, preset.tile, seed=seed, most=most), out / "tiles")
            cut += records
            counts["tiles" if split == "train" else "tiles_val"] = {"tiles": len(records), **found}
        images = cut
    if not any(i.split == "val" for i in images):
        # The trainer wants a val split; with fixed passes nothing depends on it.
        images += [replace(i, split="val") for i in images[:8]]
        counts["val"] = "the first pictures of train: there is no val split, and nothing depends on it"
    categories = [replace(c, id=n) for n, c in enumerate(dataset.categories)]
    written = writing.write(presets.FORMAT[task], out / DATA, images, categories)
    shutil.rmtree(out / "tiles", ignore_errors=True)
    fatal = {k: n for k, n in written.losses.items() if k.rpartition(".")[2] in _FATAL_LOSSES}
    if fatal:
        problems = [Problem(presets.FORMAT[task], k, f"{n} labels would be lost", "none",
                            "infrablend check says where") for k, n in fatal.items()]  # fmt: skip
        raise DatasetError(f"{dataset.root}: labels that the trainer would not see", problems)
    labels = sum(len(p.read_text("utf-8").splitlines()) for p in (out / DATA / "labels" / "train").rglob("*.txt"))
    return {
        **counts,
        "images": sum(i.split == "train" for i in images),
        "labels": labels,
        "losses": dict(written.losses),
    }


def _run(
    out: Path, record: dict[str, Any], preset: Preset, task: str, device: str, seed: int, on_progress: OnProgress | None
) -> TrainReport:
    """The process that trains, from here or from its last checkpoint."""
    prepared = record["prepared"]
    epochs, shown = preset.epochs_for(prepared["images"])
    job = trainer.Job(
        data=str((out / DATA / "data.yaml").resolve()), out=str(out.resolve()), task=task,
        model=record["start"]["model"], device=device, epochs=epochs, batch=preset.batch,
        image_size=preset.image_size, patience=preset.patience, seed=seed, images=prepared["images"],
        labels=prepared["labels"], shown=shown, arguments=dict(preset.arguments),
    )  # fmt: skip
    job.write(out / "job.json")
    record |= {"status": "running", "epochs": epochs, "device": device}
    write_json(out / RECORD, record)
    began, cpu = time.monotonic(), 0.0
    last: dict[str, dict[str, Any]] = {}

    def take(event: dict[str, Any]) -> None:
        last[event["event"]] = event
        if event["event"] == "step" and on_progress is not None:
            seconds = max(time.monotonic() - began, 1e-6)
            done, total = int(event["images"]), epochs * shown
            first = last.setdefault("first", {"images": done, "at": seconds})
            pace = (done - first["images"]) / max(seconds - first["at"], 1e-6)
            eta = (total - done) / pace if pace > 0 else None
            on_progress(Progress(done, total, pace, eta, {"epoch": event["epoch"]}))

    code, stopped = _watch(
        [sys.executable, "-W", "ignore", "-m", trainer.__name__, str(out / "job.json")], out / LOG, take
    )
    cpu = time.monotonic() - began
    session = {"seconds": round(cpu, 1), "end": "stopped" if stopped else "end" if code == 0 else "failed",
               "epoch": int(last.get("epoch", {}).get("epoch", 0))}  # fmt: skip
    record["sessions"] = [*record["sessions"], session]
    done = "end" in last and code == 0
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
            record["note"] = f"batch reduced from {preset.batch} to {end['batch']}: memory was short"
    write_json(out / RECORD, record)
    if stopped:
        raise Interrupted(
            f"Stopped after epoch {session['epoch']} of {epochs}; the same command with --resume goes on."
        )
    if not done:
        raise _failure(out, code, last.get("error"), preset)
    for name in (DATA, "run", "ultralytics"):  # the tiles alone are more than all the rest
        shutil.rmtree(out / name, ignore_errors=True)
    (out / trainer.CHECKPOINT).unlink(missing_ok=True)
    return TrainReport(out, out / trainer.WEIGHTS, record)


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
    """What went wrong, for people."""
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
    name = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    found: dict[str, Any] = {"processor": name, "cores": available_cores(), "system": platform.system()}
    if device != "cpu":
        import torch

        found["gpu"] = torch.cuda.get_device_name(int(device.split(",")[0]))
    return found
