"""Take things away from a running command: disk, folder, rights, time, and the output folder for itself."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.attack import plain_user
from tests.attack.child import UNDISTURBED, Disturbance, Outcome, fork_command
from tests.attack.findings import Finding
from tests.attack.kills import Judge, Reference, make_reference
from tests.attack.scenarios import SCENARIOS
from tests.attack.trees import contents, differences, remove_output

ATTACKED = ("generate", "convert", "split", "evaluate", "fetch --archive", "experiment", "inspect --out", "preview")
NOBODY = 65534


def _full(event: str, path: Path) -> None:
    """Let this write and all further ones fail as on a full disk."""
    if event in ("open", "os.mkdir", "os.link"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def _broken(event: str, path: Path) -> None:
    raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))


def _set_clock_back() -> None:
    """Let all clocks of the wall run two years ago; a monotonic clock stays one."""
    real, real_ns = time.time, time.time_ns
    time.time = lambda: real() - 6e7  # type: ignore[assignment]
    time.time_ns = lambda: real_ns() - 60_000_000 * 10**9  # type: ignore[assignment]


def _as_nobody() -> None:
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)


@contextlib.contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[None]:
    """Mount a small file system at a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    options = f"size={kilobytes}k,nr_inodes=400"
    mounted = not subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "none", folder], capture_output=True
    ).returncode
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", folder], check=True)


def _call(reference: Reference, disturbance: Disturbance, *options: str) -> Outcome:
    words = [*reference.scenario.words(reference.lab), *options]
    return fork_command(words, reference.lab, reference.lab / "out", disturbance, flat=reference.scenario.flat)


def _finish(reference: Reference, judge: Judge, number: int) -> None:
    """Finish what a disturbed command left, as its error recommends, and compare it with an undisturbed one."""
    scenario, out = reference.scenario, reference.lab / "out"
    options = scenario.finishes[number % len(scenario.finishes)]
    ended = _call(reference, UNDISTURBED)
    if ended.code == 2 and options:
        ended = _call(reference, UNDISTURBED, *options)
    judge.ended("finishing", ended)
    if ended.code:
        judge.found("unexpected error", f"cannot be finished: exit {ended.code}: {ended.output[-900:]}")
    files = contents(out, scenario.left_out, scenario.trained)
    if not ended.code and files != reference.files:
        judge.found("silent loss", f"finished with other bytes: {differences(files, reference.files)}")
    if not ended.code:
        judge.finished(out)
    judge.unchanged_around()


def _judge_success(reference: Reference, judge: Judge, outcome: Outcome) -> None:
    """Complain if a disturbed command claims success although its output is not whole."""
    files = contents(reference.lab / "out", reference.scenario.left_out, reference.scenario.trained)
    if outcome.code == 0 and files != reference.files:
        judge.found("silent loss", f"exit 0 with other bytes: {differences(files, reference.files)}")


def _disk_full(reference: Reference, number: int, choose: random.Random) -> list[Finding]:
    """Fail one write, or all of them from a size on."""
    out = reference.lab / "out"
    act = (_full, _broken)[number % 2]
    at = choose.randrange(max(1, reference.writes))
    judge = Judge("disk full", f"{reference.scenario.name}: {act.__name__} at write {at}", reference)
    remove_output(out)
    ended = _call(reference, Disturbance(at, act))
    judge.ended("the command", ended)
    _judge_success(reference, judge, ended)
    _finish(reference, judge, number)
    return judge.findings


def _small_disk(reference: Reference, number: int, choose: random.Random) -> list[Finding]:
    out = reference.lab / "out"
    size = choose.choice((0, 4, 8, 16, 24, 32, 48, 64, 96, 128))
    judge = Judge("small disk", f"{reference.scenario.name}: file system of {size + 4} KiB", reference)
    with small_disk(out, size + 4):
        ended = _call(reference, UNDISTURBED)
        judge.ended("the command", ended)
        _judge_success(reference, judge, ended)
        if ended.code not in (0, 1, 3):
            judge.found("unexpected error", f"a full disk ends with {ended.code}, not 3: {ended.output[-600:]}")
        subprocess.run(["mount", "-o", "remount,size=64m,nr_inodes=9999", out], check=True)
        _finish(reference, judge, number)
    remove_output(out)
    return judge.findings


def _folder_removed(reference: Reference, number: int, choose: random.Random) -> list[Finding]:
    folders = ["", *sorted({k.partition("/")[0] for k in reference.files if "/" in k})]
    return remove_folder(reference, choose.choice(folders), choose.randrange(max(1, reference.writes)), number)


def remove_folder(reference: Reference, folder: str, at: int, number: int = 0) -> list[Finding]:
    """Remove a folder of the output, or all of it, before a write of the command."""
    out = reference.lab / "out"
    judge = Judge("folder removed", f"{reference.scenario.name}: {folder or 'all'} at write {at}", reference)
    remove_output(out)
    ended = _call(reference, Disturbance(at, lambda event, path: remove_output(out, folder)))
    judge.ended("the command", ended)
    _judge_success(reference, judge, ended)
    _finish(reference, judge, number)
    return judge.findings


def _read_only(reference: Reference, number: int, choose: random.Random) -> list[Finding]:
    """Let another user write to a folder that belongs to root, and to one of its own."""
    out, own = reference.lab / "out", reference.lab / "own"
    allowed = number % 2 == 0
    judge = Judge("other user", f"{reference.scenario.name}: {'own' if allowed else 'read-only'} folder", reference)
    remove_output(out)
    shutil.rmtree(own, ignore_errors=True)
    for folder in (out, own, own / "tmp"):
        folder.mkdir()
    for folder in (own, own / "tmp", *([out] if allowed else [])):
        os.chown(folder, NOBODY, NOBODY)
    ended = _call(reference, Disturbance(before=_as_nobody))
    judge.ended("the command", ended)
    if allowed:
        if ended.code:
            judge.found("unexpected error", f"exit {ended.code}: {ended.output[-900:]}")
        _judge_success(reference, judge, ended)
    elif ended.code not in (2, 3) or any(out.iterdir()):
        judge.found("unexpected error", f"exit {ended.code} in a read-only folder: {ended.output[-900:]}")
    shutil.rmtree(own, ignore_errors=True)
    if not allowed:
        _finish(reference, judge, number)
    judge.unchanged_around()
    return judge.findings


def _clock(reference: Reference, number: int, choose: random.Random) -> list[Finding]:
    """Interrupt a command, set the clock back two years, and finish it."""
    out = reference.lab / "out"
    at = choose.randrange(max(1, reference.writes))
    judge = Judge("clock set back", f"{reference.scenario.name}: at write {at}", reference)
    remove_output(out)
    ended = _call(reference, Disturbance(at, lambda event, path: _set_clock_back()))
    judge.ended("the command", ended)
    _judge_success(reference, judge, ended)
    if ended.code:
        judge.found("unexpected error", f"exit {ended.code}: {ended.output[-900:]}")
    judge.unchanged_around()
    return judge.findings


def _second_process(reference: Reference, number: int, choose: random.Random) -> list[Finding]:
    """Start the same command again, with every option, at a write of the first."""
    out, lab = reference.lab / "out", reference.lab
    at = choose.randrange(max(1, reference.writes))
    options = reference.scenario.finishes[number % len(reference.scenario.finishes)] if number % 3 else ()
    judge = Judge("second process", f"{reference.scenario.name}: {options} at write {at}", reference)
    second = lab / "own" / "second"
    remove_output(out)
    shutil.rmtree(lab / "own", ignore_errors=True)

    def start(event: str, path: Path) -> None:
        (second).mkdir(parents=True, exist_ok=True)
        words = [*reference.scenario.words(lab), *options]
        ended = fork_command(words, second, out, flat=reference.scenario.flat, allowed=[lab / "own"])
        (second / "code").write_text(f"{ended.code} {ended.output[-500:]}")

    ended = _call(reference, Disturbance(at, start))
    judge.ended("the first", ended)
    _judge_success(reference, judge, ended)
    said = (second / "code").read_text() if (second / "code").is_file() else "2"
    if said.split()[0] not in ("0", "1", "2", "3", "130"):
        judge.found("unexpected error", f"the second: {said}")
    if ended.code:
        _finish(reference, judge, number)
    judge.unchanged_around()
    return judge.findings


@dataclass(frozen=True)
class Attack:
    """One way to take something away.

    Attributes:
        name: Name in the table.
        once: Disturbs a command once; takes the reference, the number of the attempt and random choices.
        needs_root: Whether only root can do it.
    """

    name: str
    once: Callable[[Reference, int, random.Random], list[Finding]]
    needs_root: bool = False


ATTACKS = (
    Attack("disk full", _disk_full),
    Attack("small disk", _small_disk, needs_root=True),
    Attack("folder removed", _folder_removed),
    Attack("other user", _read_only, needs_root=True),
    Attack("clock set back", _clock),
    Attack("second process", _second_process),
)


def run(root: Path, number: int, seed: int, part: tuple[int, int]) -> Iterator[tuple[str, list[Finding]]]:
    """Yield the kind and the findings of each attack; the arguments are those of `kills.run`."""
    root.mkdir(parents=True, exist_ok=True)
    for folder in root.parents[:3]:  # another user has to reach the labs
        if folder.stat().st_uid == os.geteuid() and not folder.stat().st_mode & 0o1000:
            folder.chmod(0o755)
    if part[0] == 0:
        yield from plain_user.run(root)
    attacks = [a for a in ATTACKS if not (a.needs_root and os.geteuid())]
    for n, name in enumerate(ATTACKED):
        reference = make_reference(SCENARIOS[name], root)
        choose = random.Random(f"{seed}-{n}")
        for k in range(max(1, number // len(ATTACKED))):
            attack = attacks[k % len(attacks)]
            if k % part[1] == part[0]:
                yield attack.name, attack.once(reference, k // len(attacks), choose)
