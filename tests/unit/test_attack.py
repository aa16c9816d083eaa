"""The attacks of scripts/attack.py in small numbers, and that they notice what they are for."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import pytest

from infrablend.core import workspace
from infrablend.core.file_names import real_path
from tests.attack import broken_inputs, kills, surroundings
from tests.attack.child import Disturbance, fork_command, kill
from tests.attack.findings import Finding, Tally
from tests.attack.scenarios import SCENARIOS, Scenario, new_lab
from tests.fuzzing import make_outside
from tests.samples import SAMPLES

pytestmark = pytest.mark.long


def small(name: str) -> Scenario:
    """Return a scenario with one reader that needs no torch."""
    return replace(SCENARIOS[name], readers=SCENARIOS[name].readers[:1])


def few(reference: kills.Reference, number: int) -> list[Finding]:
    places = list(kills.disturbances(reference, number, random.Random(1)))
    return [f for k, (case, what) in enumerate(places) for f in kills.attack(reference, case, what, k)]


def test_killed_split_is_finished_with_equal_bytes(tmp_path: Path) -> None:
    assert few(kills.make_reference(small("split"), tmp_path), 3) == []


def test_output_that_is_accepted_unfinished_and_not_finished_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = kills.make_reference(small("convert"), tmp_path)
    # A workspace in place of the folder: what is killed is then taken for finished, and cannot be replaced.
    monkeypatch.setattr(workspace, "partial_of", lambda out: real_path(out))
    kill_at = [Disturbance(reference.writes - n, kill) for n in range(6, 10)]
    found = [f for disturbance in kill_at for f in kills.attack(reference, "", disturbance, 0)]
    assert "silent loss" in {f.fault for f in found}, found


def test_broken_inputs_give_results_or_named_errors(tmp_path: Path) -> None:
    for kind in [k for k in broken_inputs.INPUTS if k.name in ("dataset coco", "archive")]:
        lab, intact = tmp_path / kind.name / "lab", tmp_path / kind.name / "intact"
        new_lab(lab, kind.make)
        before = broken_inputs.comparable(lab)
        lab.rename(intact)
        for k in range(2):
            assert broken_inputs.attack(kind, intact, lab, before, f"test-{k}") == []


@pytest.mark.parametrize("attack", surroundings.ATTACKS, ids=lambda attack: attack.name)
def test_surroundings_do_no_harm(attack: surroundings.Attack, tmp_path: Path) -> None:
    if attack.needs_root:
        pytest.skip("only root can mount file systems and become another user")
    reference = kills.make_reference(small("convert"), tmp_path)
    assert attack.once(reference, 1, random.Random(0)) == []


def test_reads_and_writes_outside_are_noticed(tmp_path: Path) -> None:
    make_outside(tmp_path / "canary")
    data = SAMPLES["folder:plain"](tmp_path / "in")
    (data / "metadata.json").unlink()
    words = ["-q", "inspect", data, "--metadata", tmp_path / "canary" / "secret.csv", "--out", tmp_path / "elsewhere"]
    ended = fork_command(words, tmp_path, tmp_path / "out")
    assert any("read" in line and "secret.csv" in line for line in ended.outside)
    ended = fork_command(["-q", "inspect", data, "--out", tmp_path / "elsewhere"], tmp_path, tmp_path / "out")
    assert ended.code == 0 and any("elsewhere" in line for line in ended.outside)


def test_table_counts_by_kind() -> None:
    tally = Tally()
    tally.add("kill a", [])
    tally.add("kill a", [Finding("kill a", "at write 3", "hang", "")])
    other = Tally()
    other.add("broken b", [Finding("broken b", "", "silent loss", ""), Finding("broken b", "", "file outside", "")])
    tally.merge(other)
    assert tally.rows() == [("kill a", 2, 0, 0, 1, 0), ("broken b", 1, 1, 0, 0, 1), ("all", 3, 1, 0, 1, 1)]
    assert tally.table().splitlines()[-1] == "| all | 3 | 1 | 0 | 1 | 1 |"
