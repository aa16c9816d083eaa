"""Run the command line as an ordinary user: no rights of root, a folder with spaces and umlauts, the locale C."""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import infrablend
from tests.attack.findings import Finding
from tests.attack.scenarios import generate_words
from tests.attack.trees import contents, differences
from tests.clips import write_clips, write_detections

KIND = "plain user"
NOBODY = 65534
TIME_LIMIT_S = 900
# The folder, that of the data, and parts of file names and classes, which decide what is drawn for a frame.
_STRANGE = ("Wärmebilder Müritz 2", "Füchse & Höfe", "Füchs chen")
_PLAIN = ("plain", "data", "Füchs chen")
_OUTPUTS = ("run", "voc", "split", "evaluation")


def run(root: Path) -> Iterator[tuple[str, list[Finding]]]:
    """Yield the kind and the findings of each command; only root can become another user.

    The output has to be that of the same commands on the same data in a folder with a plain name and a usual locale.
    """
    labs = {}
    for names, locale in ((_PLAIN, "C.UTF-8"), (_STRANGE, "C")):
        lab = labs[names] = root / names[0]
        _prepare(lab, names)
        for words in _commands(lab, names):
            yield KIND, _call(lab, words, locale)
    for output in _OUTPUTS:
        ours, theirs = (_pictures_and_labels(lab / output) for lab in labs.values())
        same = ours == theirs and ours
        detail = f"other output than in a plain folder: {differences(ours, theirs)}"
        yield KIND, [] if same else [Finding(KIND, output, "silent loss", detail)]


def _prepare(lab: Path, names: tuple[str, str, str]) -> None:
    """Write labelled pictures with strange names, which belong to the other user."""
    shutil.rmtree(lab, ignore_errors=True)
    write_clips(lab)
    write_detections(lab)
    data = lab / "in" / "data"
    for path in sorted(data.rglob("clip*")):
        path.rename(path.with_name(path.name.replace("clip", names[2])))
    (data / "data.yaml").write_text((data / "data.yaml").read_text().replace("hare", f"{names[2]} 2"), "utf-8")
    data.rename(lab / "in" / names[1])
    predictions = lab / "in" / "predictions.json"
    text = predictions.read_text("utf-8").replace("clip", names[2]).replace("hare", f"{names[2]} 2")
    predictions.write_text(text, "utf-8")
    for path in (lab, lab / "in"):
        if not os.geteuid():
            os.chown(path, NOBODY, NOBODY)


def _commands(lab: Path, names: tuple[str, str, str]) -> list[list[object]]:
    data = lab / "in" / names[1]
    generate = [data if str(w).endswith("in/data") else w for w in generate_words(lab, lab / "run", "--limit", "2")]
    return [
        ["inspect", data],
        ["check", data],
        generate,
        ["check", lab / "run" / "yolo"],
        ["convert", data, lab / "voc", "--to", "voc"],
        ["check", lab / "voc"],
        ["split", data, lab / "split", "--by", "gap", "--gap", "3"],
        ["evaluate", lab / "in" / "predictions.json", data, "--out", lab / "evaluation", "--bootstrap", "20"],
    ]


def _call(lab: Path, words: list[object], locale: str) -> list[Finding]:
    """Run one command as another user; it must succeed."""
    case = f"{words[0]} in {lab.name}, LC_ALL={locale}"
    sources = str(Path(infrablend.__file__).parent.parent)
    environment = {
        "PATH": os.environ["PATH"], "HOME": str(lab), "LC_ALL": locale, "PYTHONPATH": sources, "OMP_NUM_THREADS": "1",
        "TMPDIR": str(lab / "in"),
    }  # fmt: skip
    command = [*_other_user(), sys.executable, "-m", "infrablend", "-q", *map(str, words[words[0] == "-q" :])]
    try:
        ended = subprocess.run(
            command, env=environment, cwd=lab, capture_output=True, timeout=TIME_LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return [Finding(KIND, case, "hang", f"no end after {TIME_LIMIT_S} s")]
    said = (ended.stdout + ended.stderr).decode("utf-8", "replace")
    if ended.returncode or "Traceback" in said:
        return [Finding(KIND, case, "unexpected error", f"exit {ended.returncode}: {said[-900:]}")]
    return []


# Shows Python where another user can reach it, in a view of the file system that ends with the command:
# SCREEN COUNT FOLDER... COMMAND... covers SCREEN, the folder that is closed to others, by one with only these folders.
_SHOW = """
set -e
screen=$1 count=$2
shift 2
place=$(mktemp -d)
mount -t tmpfs none "$place"
for n in $(seq "$count"); do
    mkdir "$place/$n"
    mount --bind "$1" "$place/$n"
    set -- "$@" "$1"
    shift
done
# The folders are now behind the command; bring them back to the front.
for n in $(seq $(($# - count))); do set -- "$@" "$1"; shift; done
mount -t tmpfs -o mode=755 none "$screen"
for n in $(seq "$count"); do
    mkdir -p "$1"
    mount --bind "$place/$n" "$1"
    shift
done

exec "$@"
"""


@functools.cache
def _other_user() -> tuple[str, ...]:
    """Return the command that runs another as nobody, who has none of root's rights."""
    if os.geteuid():
        return ()
    user = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
    needed = [os.path.realpath(p) for p in (sys.base_prefix, sys.prefix, Path(infrablend.__file__).parent)]
    closed = [p for folder in needed for p in Path(folder).parents if p != Path("/") and not p.stat().st_mode & 0o001]
    if not closed:
        return user
    screen = str(min(closed, key=lambda p: len(p.parts)))
    below = [p for p in needed if p.startswith(f"{screen}/")]
    show = ("unshare", "-m", "--propagation", "private", "sh", "-c", _SHOW, "sh", screen, str(len(below)), *below)
    return (*show, *user)


def _pictures_and_labels(folder: Path) -> dict[str, str]:
    found = contents(folder, ("run.json", "README.md"))
    wanted = (".png", ".jpg", ".txt", ".npz")
    return {k: v for k, v in found.items() if k.endswith(wanted) and "plots" not in k}
