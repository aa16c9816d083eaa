"""The commands that are attacked, each with tiny inputs, what finishes it, and what reads its output.

Every attack has a folder of its own, the lab: inputs in `in`, `canary`, and `place`, in which the output `out` and its
workspace are. Nothing but `place` may change.
"""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.attack.child import Outcome, fork_command
from tests.clips import write_clips, write_detections
from tests.fuzzing import make_outside
from tests.samples import SAMPLES, picture

Words = list[object]

PLACE = "place"
"""Folder of a lab that a command may change."""

_CAMERA = ("--set", "camera.pitch={fixed_deg: 60}", "--set", "camera.size_px=[64, 48]")


@dataclass(frozen=True)
class Scenario:
    """One command.

    Attributes:
        name: Name in the table.
        prepare: Writes the inputs to the lab.
        words: Arguments of the command.
        finishes: Options that finish or replace what an interrupted command left; empty words if the same command does.
        readers: Commands that must refuse unfinished output; they write to a given folder.
        flat: Whether frames are computed with the flat renderer in the process of the command.
        left_out: Beginnings of paths in the output that may differ between equal calls.
        trained: Whether the output depends on weights that the command trains.
        share: Share of the kills.
        start: Folder of the lab that is copied to the output first, for commands that change one; empty for none.
    """

    name: str
    prepare: Callable[[Path], None]
    words: Callable[[Path], Words]
    finishes: tuple[tuple[str, ...], ...]
    readers: tuple[Callable[[Path, Path], Words], ...] = ()
    flat: bool = True
    left_out: tuple[str, ...] = ("workers.log", "train.log")
    trained: bool = False
    share: float = 0.1
    start: str = ""

    def begin(self, lab: Path) -> None:
        """Remove the output of an earlier attack, and copy what the command changes."""
        empty_place(lab)
        if self.start:
            shutil.copytree(lab / self.start, output(lab))


def output(lab: Path) -> Path:
    """Return the output folder of the command in a lab."""
    return lab / PLACE / "out"


def empty_place(lab: Path) -> None:
    """Remove the output of an earlier attack and its workspace."""
    shutil.rmtree(lab / PLACE, ignore_errors=True)
    (lab / PLACE).mkdir()


def new_lab(root: Path, prepare: Callable[[Path], object]) -> Path:
    """Empty a folder and write inputs to it."""
    shutil.rmtree(root, ignore_errors=True)
    (root / "canary" / "inner").mkdir(parents=True)
    make_outside(root / "canary")
    for name in ("mine.txt", "run.json", "inner/a.jpg"):
        (root / "canary" / name).write_text("mine")
    empty_place(root)
    prepare(root)
    return root


def done(lab: Path, *words: object, flat: bool = True) -> Outcome:
    """Run a command that prepares an input; it must succeed."""
    ended = fork_command(words, lab, lab / "in", flat=flat, allowed=[lab / PLACE])
    if ended.code:
        raise RuntimeError(f"{words}: exit {ended.code}\n{ended.output}")
    return ended


# -- inputs


def _coco(lab: Path) -> None:
    SAMPLES["coco"](lab / "in" / "data")


def _run(lab: Path) -> None:
    _coco(lab)
    done(lab, *generate_words(lab, lab / "in" / "run"))


PACKED = ("--set", "output.layout=shards")


def write_shards(lab: Path, *words: object) -> None:
    """Write both shards of a run to `in/shards`."""
    _coco(lab)
    for number in (1, 2):
        done(lab, *generate_words(lab, lab / "in" / "shards", "--shard", f"{number}/2", *words))


def _pictures(lab: Path) -> None:
    """Write pictures that are large enough to measure a camera in."""
    for k in range(4):
        picture(lab / "in" / "data" / f"a{k}.png", k, (160, 128))


def _archive(lab: Path) -> None:
    """Write an archive in the layout of HIT-UAV's."""
    SAMPLES["hit-uav:json"](lab / "in" / "made")
    with zipfile.ZipFile(lab / "in" / "data.zip", "w") as archive:
        for path in sorted((lab / "in" / "made").rglob("*")):
            archive.write(path, path.relative_to(lab / "in" / "made"))


def _hit_uav(lab: Path) -> None:
    SAMPLES["hit-uav:json"](lab / "in" / "data")


def _experiment(lab: Path) -> None:
    write_clips(lab)
    (lab / "in" / "small.yaml").write_text(EXPERIMENT)


EXPERIMENT = """\
name: small
title: Small
description: Does one training end as it should?
sources:
  clips: {format: yolo, title: Clips}
trainings:
  one: {data: clips, paper_images: 8}
evaluations:
  one: {training: one, data: clips}
tables:
  - title: One
    evaluation: one
    rows:
      - {title: All, category: all}
"""


# -- commands


def generate_words(lab: Path, out: Path, *options: object) -> Words:
    """Return the command that inserts drones into the sample with labels."""
    data = ["--data", lab / "in" / "data", "--out", out, "--to", "yolo,coco,voc"]
    return ["-q", "generate", "hit-uav-drone", *data, *_CAMERA, "--workers", "2", *options]


def _check(out: Path, other: Path) -> Words:
    return ["-q", "check", out]


def _inspect(out: Path, other: Path) -> Words:
    return ["-q", "inspect", out]


def _convert(out: Path, other: Path) -> Words:
    return ["-q", "convert", out, other, "--to", "coco"]


def _train(out: Path, other: Path) -> Words:
    return ["-q", "train", out, "--plan", "--preset", "smoke", "--out", other]


def _of(part: str, reader: Callable[[Path, Path], Words]) -> Callable[[Path, Path], Words]:
    return lambda out, other: reader(out / part, other)


def _evaluate(out: Path, other: Path) -> Words:
    return ["-q", "evaluate", out, out.parents[1] / "in" / "data", "--out", other, "--bootstrap", "0"]


READ_DATASET = (_check, _convert, _inspect, _train)
READ_RUN = (_of("yolo", _check), _of("coco", _convert), _of("voc", _train), _of("images", _inspect))
RESUME, OVERWRITE, SAME = ("--resume",), ("--overwrite",), ()

SCENARIOS: dict[str, Scenario] = {
    s.name: s
    for s in (
        Scenario("generate", _coco, lambda lab: generate_words(lab, output(lab)), (RESUME, OVERWRITE), READ_RUN),
        Scenario(
            "generate, workers",
            _coco,
            lambda lab: generate_words(lab, output(lab), "--set", "configurations=3"),
            (RESUME, OVERWRITE),
            READ_RUN,
            flat=False,
            share=0.03,
        ),
        Scenario(
            "generate --shard",
            _coco,
            lambda lab: generate_words(lab, output(lab), "--shard", "1/2"),
            (RESUME, OVERWRITE),
            share=0.06,
        ),
        Scenario(
            "generate --shard, packed",
            _coco,
            lambda lab: generate_words(lab, output(lab), "--shard", "1/2", *PACKED),
            (RESUME, OVERWRITE),
            share=0.06,
        ),
        Scenario(
            "merge",
            write_shards,
            lambda lab: ["-q", "merge", lab / "in" / "shards", output(lab)],
            (RESUME, OVERWRITE),
            READ_RUN,
            share=0.06,
        ),
        Scenario(
            "exclude",
            _run,
            lambda lab: ["-q", "exclude", output(lab), "train/0_60_30_0_00001_c0"],
            (SAME,),
            READ_RUN,
            share=0.06,
            start="in/run",
        ),
        Scenario("report", _run, lambda lab: ["-q", "report", output(lab)], (SAME,), share=0.02, start="in/run"),
        Scenario(
            "convert",
            _coco,
            lambda lab: ["-q", "convert", lab / "in" / "data", output(lab), "--to", "voc"],
            (OVERWRITE,),
            READ_DATASET,
        ),
        Scenario(
            "split",
            write_clips,
            lambda lab: ["-q", "split", lab / "in" / "data", output(lab), "--by", "gap", "--gap", "3"],
            (OVERWRITE,),
            READ_DATASET,
        ),
        Scenario(
            "inspect --out", _coco, lambda lab: ["-q", "inspect", lab / "in" / "data", "--out", output(lab)], (SAME,)
        ),
        Scenario(
            "preview",
            _run,
            lambda lab: ["-q", "preview", lab / "in" / "run", "--out", output(lab) / "sheet.png"],
            (SAME,),
        ),
        Scenario(
            "evaluate",
            write_detections,
            lambda lab: [
                "-q", "evaluate", lab / "in" / "predictions.json", lab / "in" / "data", "--out", output(lab),
                "--bootstrap", "20",
            ],
            (OVERWRITE,),
        ),
        Scenario(
            "profile", _pictures, lambda lab: ["-q", "profile", lab / "in" / "data", "--out", output(lab)], (SAME,)
        ),
        Scenario(
            "fetch --archive",
            _archive,
            lambda lab: ["-q", "fetch", "hit-uav", output(lab), "--archive", lab / "in" / "data.zip"],
            (SAME,),
            READ_DATASET,
        ),
        Scenario(
            "experiment",
            _hit_uav,
            lambda lab: [
                "-q", "experiment", "datasets", "--scale", "smoke", "--data", lab / "in" / "data",
                "--work", output(lab) / "work", "--results", output(lab) / "results",
            ],
            (SAME,),
        ),
        Scenario(
            "experiment with training",
            _experiment,
            lambda lab: [
                "-q", "experiment", lab / "in" / "small.yaml", "--scale", "smoke", "--data", lab / "in" / "data",
                "--work", output(lab) / "work", "--results", output(lab) / "results",
            ],
            (SAME,),
            share=0.02, trained=True,
        ),
        Scenario(
            "train",
            write_clips,
            lambda lab: [
                "-q", "train", lab / "in" / "data", "--out", output(lab), "--preset", "smoke", "--weights", "scratch",
            ],
            (RESUME, OVERWRITE),
            (_evaluate,),
            share=0.03,
            trained=True,
        ),
    )
}  # fmt: skip
