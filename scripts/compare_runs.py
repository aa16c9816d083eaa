#!/usr/bin/env python
"""Compares the pictures and labels of every recipe and dataset with those that another commit makes, byte by byte.

    INFRABLEND_REAL_DATA=DIR .venv/bin/python scripts/compare_runs.py 66cd77d
    ... compare_runs.py 66cd77d --recipe hit-uav-cars --sample 40

Runs of every shipped recipe: over HIT-UAV's val split, Halmstad's val backgrounds (`drone-sky*`), the clips of Anti-UAV
(`drone-video`), and the virtual world in MONET's layout (`monet-*`) or as a flight (`people-video`, `deer-video`).
Conversions of every real dataset. All of them are written in every label format.
What the commit makes is kept in build/compare, with a checkout and its environment. Exits with 1 if a file differs, is
missing or is new, and says by how much the labels of runs differ.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from infrablend.core.dataset import Instance
from infrablend.core.run_folder import RunFolder

ROOT = Path(__file__).resolve().parents[1]
WORK = ROOT / "build" / "compare"
CONVERTED = {
    "hit-uav": ("hit-uav", "--split", "val"),
    "wisard": ("wisard",),
    "bambi": ("bambi/thermal",),
    "halmstad-drones": ("halmstad/drones",),
    "camel": ("camel",),
    "anti-uav-clips": ("anti-uav-clips", "--read", "every=50"),
}
"""Datasets to convert: folder below that of the real data, and options of `convert`."""
WORLDS = {"monet": "12", "flight": "8"}
"""Layouts of the virtual world, with the number of pictures."""


def run(tree: Path, *arguments: str) -> str:
    """Run the command line of a checkout and return its output."""
    environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
    # From a neutral folder: recipes and paths in the working folder must not matter.
    command = [str(tree / ".venv/bin/python"), "-m", "infrablend", *arguments]
    done = subprocess.run(command, env=environment, cwd=WORK, capture_output=True, text=True, check=False)
    # 1 is also the answer to pictures left out, as one without pitch in the virtual world; what was made is compared.
    if done.returncode > 1:
        sys.exit(f"{' '.join(arguments)}: exit code {done.returncode} in {tree}\n{done.stdout}{done.stderr}")
    return done.stdout


def checkout(commit: str) -> Path:
    """Return a checkout of a commit with the environment that it needs, below build."""
    name = subprocess.check_output(["git", "rev-parse", "--short", commit], cwd=ROOT, text=True).strip()
    tree = WORK / f"tree-{name}"
    if not tree.is_dir():
        subprocess.run(["git", "worktree", "prune"], cwd=ROOT, check=True)
        subprocess.run(["git", "worktree", "add", "--detach", "--quiet", str(tree), name], cwd=ROOT, check=True)
    subprocess.run(["make", "-s", "-C", tree, "setup"], check=True)
    return tree


def backgrounds(recipe: str, real: Path) -> list[str]:
    """Return the options of `generate` that read the backgrounds for a recipe."""
    if recipe.startswith("monet"):
        return ["--data", str(WORK / "monet")]
    if recipe == "drone-video":
        return ["--data", str(real / "anti-uav-clips"), "--read", "every=25"]
    if recipe.endswith("-video"):
        return ["--data", str(WORK / "flight")]
    if recipe.startswith("drone-sky"):
        return ["--data", str(real / "halmstad" / "backgrounds"), "--split", "val"]
    return ["--data", str(real / "hit-uav"), "--split", "val"]


def formats(tree: Path) -> str:
    """Return the names of all label formats that a checkout writes."""
    code = "from infrablend.core.format_table import written_names; print(','.join([*written_names(), 'native']))"
    environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
    return subprocess.check_output([str(tree / ".venv/bin/python"), "-c", code], env=environment, text=True).strip()


def files(folder: Path) -> dict[str, Path]:
    """Return the pictures and label files of a run, by path."""
    tops = [p for p in sorted(folder.iterdir()) if p.is_dir() and p.name not in ("scenes", "log", "excluded")]
    found = [p for top in tops for p in sorted(top.rglob("*")) if p.is_file()]
    return {p.relative_to(folder).as_posix(): p for p in found if p.name != "convert.json"}


def differences(was: dict[str, Path], now: dict[str, Path]) -> list[str]:
    """Return a line per file that differs, is missing or is new."""
    found = [f"missing  {name}" for name in sorted(was.keys() - now.keys())]
    found += [f"new      {name}" for name in sorted(now.keys() - was.keys())]
    both = sorted(was.keys() & now.keys())
    return found + [f"differs  {name}" for name in both if was[name].read_bytes() != now[name].read_bytes()]


def inserted(run: Path) -> dict[tuple[str, object], Instance]:
    """Return the labels of a run's inserted objects by frame and number; also of runs with one file per scene."""
    if (run / "scenes").is_dir():
        texts = [json.loads(p.read_text("utf-8")) for p in sorted((run / "scenes").rglob("*.json"))]
        found = [(t["frame_id"], Instance.from_json(i)) for t in texts for i in t["inserted"]]
    else:
        found = [(r.frame_id, i) for r in RunFolder(run).records() for i in r.inserted]
    return {(frame, i.extra["object"]): i for frame, i in found}


def label_differences(was: Path, now: Path) -> str:
    """Return by how much the labels of the objects that both runs have differ, at most."""
    before, after = inserted(was), inserted(now)
    pairs = [(before[key], after[key]) for key in sorted(before.keys() & after.keys(), key=str)]
    box = [float(np.abs(a.box_xyxy - b.box_xyxy).max()) for a, b in pairs]
    seen = [abs((a.visibility or 0.0) - (b.visibility or 0.0)) for a, b in pairs]
    masks = [(a.mask.to_array(), b.mask.to_array()) for a, b in pairs if a.mask is not None and b.mask is not None]
    pixels, area = [int((a != b).sum()) for a, b in masks], sum(int(a.sum()) for a, _ in masks)
    return (
        f"{len(pairs)} objects in both, {len(before.keys() ^ after.keys())} in one; boxes differ by up to "
        f"{max(box, default=0):.4f} px, {sum(v > 0.01 for v in box)} of them by more than 0.01; visibility by up to "
        f"{max(seen, default=0):.4f}; masks by {sum(pixels)} of {area} pixels, one by {max(pixels, default=0)}"
    )


def compare(title: str, was: Path, now: Path) -> bool:
    """Print how two folders differ, and return whether they are equal."""
    before = files(was)
    after = files(now)
    found = differences(before, after)
    print(f"{title:28} {len(after):5} files {'equal' if not found else f'{len(found)} DIFFER'}", flush=True)
    for line in found[:20]:
        print(f"    {line}")
    if found and (was / "run.json").is_file():
        print(f"    {label_differences(was, now)}", flush=True)
    return bool(before) and not found


def make(tree: Path, out: Path, command: str, *arguments: str) -> None:
    """Have a command of a checkout write a folder."""
    run(tree, command, *arguments, *([str(out)] if command == "convert" else ["--out", str(out)]))


def kept_of(tree: Path, kept: Path, *command: str) -> Path:
    """Return what a command of the other commit writes, made unless an earlier call has made it."""
    if not kept.is_dir():
        partial = kept.with_name(f"unfinished-{kept.name}")
        shutil.rmtree(partial, ignore_errors=True)
        kept.parent.mkdir(parents=True, exist_ok=True)
        make(tree, partial, *command)
        partial.rename(kept)
    return kept


def main() -> None:
    """Compare, and print a line per recipe, and per dataset and format."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit", help="commit to compare with")
    parser.add_argument("--recipe", action="append", help="only this recipe and no dataset; may be repeated")
    parser.add_argument("--sample", type=int, default=10, help="backgrounds per recipe [10]")
    parser.add_argument("--prepare", action="store_true", help="only make what the commit makes")
    asked = parser.parse_args()
    if "INFRABLEND_REAL_DATA" not in os.environ:
        sys.exit("INFRABLEND_REAL_DATA: not set; expected the folder with hit-uav/ and halmstad/")
    real = Path(os.environ["INFRABLEND_REAL_DATA"]).resolve()
    WORK.mkdir(parents=True, exist_ok=True)
    base = checkout(asked.commit)
    for layout, count in WORLDS.items():
        kept_of(base, WORK / layout, "world", "--layout", layout, "--count", count)
    every = formats(base)
    commands = {}
    for recipe in asked.recipe or sorted(p.stem for p in (base / "src" / "infrablend").rglob("recipes/*.yaml")):
        sample = ["--sample", str(asked.sample), "--to", every]
        commands[recipe] = ["generate", recipe, *backgrounds(recipe, real), *sample]
    for name, (folder, *options) in CONVERTED.items() if not asked.recipe else ():
        for written in every.removesuffix(",native").split(","):  # some have no writer of their own
            commands[f"{name} as {written}"] = ["convert", str(real / folder), "--to", written, *options]
    unequal = 0
    for title, command in commands.items():
        kept = kept_of(base, WORK / f"{base.name}-{asked.sample}" / title.replace(" ", "-"), *command)
        if asked.prepare:
            continue
        made = WORK / f"this-{os.getpid()}"
        make(ROOT, made, *command)
        unequal += not compare(title, kept, made)
        shutil.rmtree(made)
    sys.exit(bool(unequal))


if __name__ == "__main__":
    main()
