"""Runs in shards, from the command line: the merged run has the bytes of an undivided one, and faults are named."""

import json
import os
import shlex
import shutil
from pathlib import Path

import pytest

from infrablend import api
from infrablend.core import spool
from infrablend.core.ledger import Ledger
from infrablend.core.workspace import workspace
from infrablend.errors import ArgumentError
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.shard import Shard, ShardRequest
from infrablend.pipeline.runs import sharded as sharded_run
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.unit.pipeline.test_run import dataset, hashes

__all__ = ["dataset"]

# Levels of the whole data set, loose boxes, originals and an odd number of frames: 4 backgrounds, 3 frames each.
FIELDS = ("output.originals=true", "sensor.profile=hit-uav", "sensor.noise=1", "labels.loosen=1.2")


@pytest.fixture(autouse=True)
def flat(monkeypatch):
    render_flat(monkeypatch)


def command(data: Path, out: Path, *words: object) -> tuple[object, ...]:
    fields = [word for field in FIELDS for word in ("--set", field)]
    return "generate", "hit-uav-drone", "--data", data, "--out", out, "--to", "yolo,coco", *fields, *words


def make_shards(data: Path, out: Path, count: int, *words: object, only: range | None = None) -> None:
    for number in only or range(1, count + 1):
        done(*command(data, out, "--shard", f"{number}/{count}", *words))


def test_shards_partition_the_frames():
    frames = list(range(10))
    for count in (1, 3, 7, 13):
        shards = [list(Shard(n, count).part_of(frames)) for n in range(1, count + 1)]
        assert [n for shard in shards for n in shard] == frames
        assert max(map(len, shards)) - min(map(len, shards)) <= 1
    assert ShardRequest(2, size=4).of(10) == [Shard(2, 3)]
    with pytest.raises(ArgumentError, match="from 1 to 3"):
        ShardRequest(4, size=4).of(10)


def test_merged_shards_have_the_bytes_of_one_run(dataset, tmp_path, monkeypatch):
    done(*command(dataset, tmp_path / "whole"))
    expected = hashes(tmp_path / "whole")
    assert json.loads((tmp_path / "whole/run.json").read_text())["levels"]
    for count in (1, 3, 7):
        # Two "machines" with a folder each, in any order.
        out = [tmp_path / f"a{count}", tmp_path / f"b{count}"]
        for number in reversed(range(1, count + 1)):
            done(*command(dataset, out[number % 2], "--shard", f"{number}/{count}"))
        used = [folder for folder in out if folder.exists()]
        done("merge", *used, tmp_path / f"merged{count}")
        assert hashes(tmp_path / f"merged{count}") == expected
        for folder in used:
            shutil.rmtree(folder)  # the merged run does not need them
    assert hashes(tmp_path / "merged7") == expected
    # Records and labels that do not fit into memory.
    monkeypatch.setattr(spool, "IN_MEMORY", 2)
    done(*command(dataset, tmp_path / "stored"))
    assert hashes(tmp_path / "stored") == expected
    done("check", tmp_path / "merged7")


def test_levels_are_those_of_the_plan(dataset, tmp_path):
    make_shards(dataset, tmp_path / "out", 3, only=range(1, 2))
    shared = json.loads((tmp_path / "out/shards.json").read_text())
    shared["levels"] = [20.0, 200.0]
    (tmp_path / "out/shards.json").write_text(json.dumps(shared))
    make_shards(dataset, tmp_path / "out", 3, only=range(2, 3))
    record = json.loads((tmp_path / "out/shard-00002-of-00003/run.json").read_text())
    assert record["levels"] == [20.0, 200.0]
    assert record["shard"] == "2/3"


def test_status_and_unfinished_shards(dataset, tmp_path):
    out = tmp_path / "out"
    make_shards(dataset, out, 3, only=range(1, 3))
    with workspace(out / "shard-00002-of-00003", "shard", "run.json", "resume", keep=True) as space:
        space.reopen()  # as a kill leaves it
    with workspace(out / "shard-00001-of-00003", "shard", "run.json", "resume", keep=True):
        ended = run("status", out, "--json")
    assert ended.exit_code == 1
    assert [s["state"] for s in json.loads(ended.stdout)["shards"]] == ["running", "stopped", "missing"]
    commands = [s.get("command", "") for s in json.loads(ended.stdout)["shards"]]
    assert not commands[0] and commands[2] in run("status", out).stdout.splitlines()[-1]
    ended = run("merge", out, tmp_path / "merged")
    assert ended.exit_code == 2
    assert commands[1] in ended.output and commands[2] in ended.output
    assert "shard 2/3: stopped" in ended.output
    assert "shard 3/3: missing" in ended.output
    assert not (tmp_path / "merged").exists()

    # The finished part is the run of its frames.
    done("merge", "--partial", out, tmp_path / "part")
    with Ledger.open(out / "shard-00001-of-00003") as ledger:
        frames = ",".join(ledger.frame_ids())
    done(*command(dataset, tmp_path / "chosen", "--frames", frames))
    assert hashes(tmp_path / "part") == hashes(tmp_path / "chosen")

    for words in commands[1:]:
        done(*shlex.split(words)[1:])
    assert run("status", out).exit_code == 0
    done("merge", out, tmp_path / "merged")


def test_shard_with_folders_as_texts(dataset, tmp_path):
    flat = Execution(renderer="flat", in_process=True)
    out = str(tmp_path / "out")
    request = api.RunRequest("hit-uav-drone", str(dataset), out, execution=flat, shard=ShardRequest(1, 3))  # type: ignore[arg-type]
    report = api.generate_shard(request)
    assert report.counts["frames"] and (tmp_path / "out" / "shard-00001-of-00003").is_dir()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--shard", "0/3"), "expected a whole number from 1"),
        (("--shard", "4/3"), "from 1 to 3"),
        (("--shard", "2"), "number of shards"),
        (("--shard", "a/b"), "write I/N"),
        (("--shard", "2/3", "--shard-size", "4"), "give one of them"),
        (("--shard", "99", "--shard-size", "4"), "from 1 to 3"),
        (("--shard-size", "4"), "needs --shard"),
    ],
)
def test_numbers_out_of_range(dataset, tmp_path, words, said):
    ended = run(*command(dataset, tmp_path / "out", *words))
    assert ended.exit_code == 2
    assert said in " ".join(ended.output.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def test_shards_of_other_runs(dataset, tmp_path):
    out = tmp_path / "out"
    make_shards(dataset, out, 2)
    ended = run(*command(dataset, out, "--shard", "2/2", "--seed", "5", "--resume"))
    assert ended.exit_code == 2
    assert "seed was 0, is 5" in ended.output
    ended = run(*command(dataset, out, "--shard", "2/3"))
    assert "shards was 2, is 3" in ended.output
    done(*command(dataset, tmp_path / "other", "--shard", "1/2", "--seed", "5"))
    ended = run("merge", out, tmp_path / "other", tmp_path / "merged")
    assert ended.exit_code == 2
    assert "seed was 0, is 5" in ended.output
    # A shard that was copied over another one, and one that is there twice.
    shutil.copytree(out, tmp_path / "twice")
    assert "expected it once" in run("merge", out, tmp_path / "twice", tmp_path / "merged").output
    shutil.rmtree(tmp_path / "twice/shard-00002-of-00002")
    shutil.copytree(out / "shard-00001-of-00002", tmp_path / "twice/shard-00002-of-00002")
    assert "found shard 1/2 of a run" in run("merge", tmp_path / "twice", tmp_path / "merged").output
    assert not (tmp_path / "merged").exists()


def test_a_damaged_plan_is_named(dataset, tmp_path):
    out = tmp_path / "out"
    make_shards(dataset, out, 2)
    file = out / "shards.json"
    plan = json.loads(file.read_text())
    for change in ({"shards": 10**20}, {"shards": 0}, {"frames": -1}, {"shards": float("inf")}, {"key": 1}):
        file.write_text(json.dumps(plan | change))
        for words in (("status", out), ("merge", out, tmp_path / "merged")):
            ended = run(*words)
            assert ended.exit_code == 2, (change, ended.output)
            assert "shards.json: damaged" in ended.output.replace("\n", "")


def test_truncated_shards_are_repaired(dataset, tmp_path):
    out = tmp_path / "out"
    make_shards(dataset, out, 2)
    done("merge", out, tmp_path / "before")
    picture = sorted((out / "shard-00002-of-00002/images").rglob("*.jpg"))[0]
    data = picture.read_bytes()
    picture.unlink()  # which is linked into the merged run
    picture.write_bytes(data[:100])
    ended = run("merge", out, tmp_path / "merged")
    assert ended.exit_code == 2
    assert "shards are truncated" in ended.output
    assert not (tmp_path / "merged").exists()
    make_shards(dataset, out, 2, "--resume", only=range(2, 3))
    done("merge", out, tmp_path / "merged")
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "before")


def test_failures_and_skipped_backgrounds_are_merged(dataset, tmp_path):
    broken = dataset / "normal_json/train/1_80_90_0_00002.jpg"
    broken.write_bytes(broken.read_bytes()[:3000])
    whole = run(*command(dataset, tmp_path / "whole"))
    assert whole.exit_code == 1
    for number in (1, 2, 3):
        run(*command(dataset, tmp_path / "out", "--shard", f"{number}/3"))
    assert run("merge", tmp_path / "out", tmp_path / "merged").exit_code == 1
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")


def test_interrupted_merge_is_finished(dataset, tmp_path, monkeypatch):
    from infrablend.errors import OutputError
    from infrablend.pipeline.runs import shard_source

    out, links = tmp_path / "out", []
    make_shards(dataset, out, 2)

    def fail_late(source, target):
        links.append(target)
        if len(links) > 9:
            raise OutputError("the disk is full")
        return os.link(source, target) if target.parent.mkdir(parents=True, exist_ok=True) is None else None

    with monkeypatch.context() as patch:
        patch.setattr(shard_source, "link_or_copy", fail_late)
        assert run("merge", out, tmp_path / "merged").exit_code != 0
    assert run("check", tmp_path / "merged").exit_code == 2
    done("merge", out, tmp_path / "merged", "--resume")
    done(*command(dataset, tmp_path / "whole"))
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")


def test_shards_are_no_dataset(dataset, tmp_path):
    make_shards(dataset, tmp_path / "out", 2, only=range(1, 2))
    for folder in (tmp_path / "out", tmp_path / "out/shard-00001-of-00002"):
        ended = run("check", folder)
        assert ended.exit_code == 2
        assert "infrablend merge" in ended.output
    assert "Merge the shards first" in run("exclude", tmp_path / "out/shard-00001-of-00002", "x").output
    assert "not a run of InfraBlend" in run(*command(dataset, tmp_path / "out", "--resume")).output
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign/notes.txt").write_text("mine")
    assert "nothing was touched" in run(*command(dataset, tmp_path / "foreign", "--shard", "1/2")).output
    assert "shards.json" in run("status", tmp_path / "foreign").output


def test_status_waits_for_the_shards(dataset, tmp_path, monkeypatch):
    out = tmp_path / "shards"
    todo = ["1/2", "2/2"]

    def work(_: float) -> None:
        shard = todo.pop(0)
        done("generate", "hit-uav-drone", "--data", dataset, "--out", out, "--to", "yolo", "--shard", shard)

    monkeypatch.setattr(sharded_run.time, "sleep", work)
    assert [s.state for s in api.status(out, wait=True)] == ["done", "done"]
    assert todo == []
    assert done("status", "--wait", out).exit_code == 0
