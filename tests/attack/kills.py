"""Kill commands at every write and at random moments; what is left must be refused, and finish with equal bytes."""

from __future__ import annotations

import random
import shutil
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from infrablend.core.workspace import NOTE
from tests.attack.child import (
    TIMED_OUT,
    UNDISTURBED,
    Disturbance,
    Outcome,
    fork_command,
    import_what_it_imported,
    kill,
    kill_torn,
)
from tests.attack.findings import Finding
from tests.attack.scenarios import PLACE, SCENARIOS, Scenario, new_lab, output
from tests.attack.trees import contents, differences, snapshot


@dataclass
class Reference:
    """Undisturbed call of a scenario.

    Attributes:
        scenario: The scenario.
        lab: Folder of the attacks.
        files: Digests of its output.
        start: Digests of what is copied to the output first.
        around: Snapshot of everything else.
        writes: Number of writes.
        seconds: Time that it took.
    """

    scenario: Scenario
    lab: Path
    files: dict[str, str]
    start: dict[str, str]
    around: dict[str, tuple[object, ...]]
    writes: int
    seconds: float


def make_reference(scenario: Scenario, root: Path) -> Reference:
    """Run a scenario undisturbed.

    Raises:
        RuntimeError: It fails.
    """
    lab = new_lab(root / scenario.name.replace(" ", "-").replace(",", ""), scenario.prepare)
    around = snapshot(lab, PLACE, "own")
    scenario.begin(lab)
    ended = _call(scenario, lab, UNDISTURBED)
    if ended.code:
        raise RuntimeError(f"{scenario.name}: exit {ended.code} without any disturbance\n{ended.output}\n{ended.log}")
    if ended.outside:
        raise RuntimeError(f"{scenario.name}: writes outside: {ended.outside}")
    import_what_it_imported(lab)
    for reader in scenario.readers:
        words = reader(output(lab), lab / "own" / "other")
        shutil.rmtree(lab / "own" / "other", ignore_errors=True)
        read = fork_command(words, lab, lab / "own" / "other", flat=scenario.flat)
        if read.code:
            raise RuntimeError(f"{scenario.name}: {words} of finished output: exit {read.code}\n{read.output}")
    files, start = (
        contents(folder, scenario.left_out, scenario.trained) if folder.is_dir() else {}
        for folder in (output(lab), lab / (scenario.start or "none"))
    )
    return Reference(scenario, lab, files, start, around, ended.writes, ended.seconds)


def _call(scenario: Scenario, lab: Path, disturbance: Disturbance, options: tuple[str, ...] = ()) -> Outcome:
    words = [*scenario.words(lab), *options]
    return fork_command(words, lab, lab / PLACE, disturbance, flat=scenario.flat)


def disturbances(reference: Reference, number: int, choose: random.Random) -> Iterator[tuple[str, Disturbance]]:
    """Yield kills with their descriptions: at every write, as far as the number allows, and at random moments."""
    places = [(n, act) for n in range(reference.writes) for act in (kill, kill_torn)]
    at_writes = places if len(places) <= number - number // 4 else choose.sample(places, number - number // 4)
    for n, act in sorted(at_writes, key=lambda place: place[0]):
        yield f"{act.__name__} at write {n}", Disturbance(n, act)
    for k in range(max(number - len(at_writes), number // 4)):
        seconds = choose.uniform(0, 1.1) * reference.seconds
        number_of_signal = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)[k % 4]
        name = signal.Signals(number_of_signal).name
        yield f"{name} after {seconds:.3f} s", Disturbance(after_s=seconds, signal=number_of_signal)


def attack(reference: Reference, case: str, disturbance: Disturbance, number: int) -> list[Finding]:
    """Disturb the command once, and check what is left and how it is finished."""
    scenario, lab, out = reference.scenario, reference.lab, output(reference.lab)
    scenario.begin(lab)
    judge = Judge(f"kill {scenario.name}", case, reference)
    ended = _call(scenario, lab, disturbance)
    judge.ended("the command", ended, killed=True)
    left = contents(out, scenario.left_out, scenario.trained)
    left.pop(NOTE, None)  # the folder is complete, and the next call deletes the note
    for k in sorted(
        {number % len(scenario.readers), (number // 2) % len(scenario.readers)} if scenario.readers else ()
    ):
        reader = scenario.readers[k]
        other = lab / "own" / "other"
        shutil.rmtree(other, ignore_errors=True)
        read = fork_command(reader(out, other), lab, other, flat=scenario.flat)
        judge.ended(f"reader {k}", read)
        if read.code in (0, 1) and left not in (reference.files, reference.start) and left:
            differing = differences(left, reference.files)
            judge.found("silent loss", f"{reader(out, other)[1]} accepts unfinished output: {differing}")
    judge.unchanged_around()
    options = scenario.finishes[number % len(scenario.finishes)]
    again = _call(scenario, lab, UNDISTURBED)
    judge.ended("the same command", again)
    if again.code and options:
        if again.code != 2 or not any(o in again.output for o in options):
            judge.found("unexpected error", f"the same command does not name {options}: {again.output[-600:]}")
        again = _call(scenario, lab, UNDISTURBED, options)
        judge.ended(f"with {options}", again)
    if again.code:
        judge.found("unexpected error", f"cannot be finished: exit {again.code}: {again.output[-900:]}")
    files = contents(out, scenario.left_out, scenario.trained)
    if not again.code and files != reference.files:
        judge.found("silent loss", f"finished with other bytes: {differences(files, reference.files)}")
    judge.unchanged_around()
    return judge.findings


class Judge:
    """Collects what goes wrong in one attack."""

    def __init__(self, kind: str, case: str, reference: Reference) -> None:
        self.findings: list[Finding] = []
        self._kind = kind
        self._case = case
        self._reference = reference

    def found(self, fault: str, detail: str) -> None:
        """Add a finding."""
        self.findings.append(Finding(self._kind, self._case, fault, detail))  # type: ignore[arg-type]

    def ended(self, which: str, outcome: Outcome, killed: bool = False) -> None:
        """Judge the end of a command; `killed` if a signal may have ended it."""
        if outcome.code == TIMED_OUT:
            self.found("hang", f"{which} did not end: {outcome.output[-500:]}")
        elif not outcome.named and not (killed and outcome.code in (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT)):
            self.found(
                "unexpected error", f"{which}: exit {outcome.code}: {outcome.output[-800:]}\n{outcome.log[-3000:]}"
            )
        if outcome.outside:
            self.found("file outside", f"{which}: {'; '.join(outcome.outside[:5])}")

    def unchanged_around(self) -> None:
        """Check that nothing but the output has changed."""
        around = snapshot(self._reference.lab, PLACE, "own")
        if around != self._reference.around:
            self.found("file outside", f"changed: {differences(around, self._reference.around)}")


def run(root: Path, number: int, seed: int, part: tuple[int, int]) -> Iterator[tuple[str, list[Finding]]]:
    """Yield the kind and the findings of each attack.

    Args:
        root: Folder for the labs.
        number: Number of kills.
        seed: Seed of the random choices.
        part: This process's number, and the number of processes.
    """
    for n, scenario in enumerate(SCENARIOS.values()):
        reference = make_reference(scenario, root)
        each = max(1, round(number * scenario.share / sum(s.share for s in SCENARIOS.values())))
        choose = random.Random(f"{seed}-{n}")
        for k, (case, disturbance) in enumerate(disturbances(reference, each, choose)):
            if k % part[1] == part[0]:
                yield f"kill {scenario.name}", attack(reference, case, disturbance, k)
