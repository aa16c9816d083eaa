"""Scripts for schedulers: every argument arrives as it was given, whatever is in it."""

import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from infrablend import api
from infrablend.errors import ArgumentError, MissingDependencyError, OutputError
from infrablend.pipeline.runs import sharded as sharded_run
from infrablend.pipeline.submission.slurm import quoted
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.unit.pipeline.test_run import dataset

__all__ = ["dataset"]

HOSTILE = (
    "", " ", "a b", "a\nb", "\n#SBATCH --array=0-9", "'", '"', "\\", "\\n'", "$(touch x)", "${HOME}", "$$", "$$(X)",
    "`touch x`", "!!", "*", "~", "-x", "--", "a;b", "a&b|c>d", "\x1b[31m", "\t\r", "ä😀", "{a,b}", "# no comment",
    "$'x'", "MERGE", "\u202e",
)  # fmt: skip
NOT_UTF_8 = os.fsdecode(b"a\xff\nb")


@pytest.fixture
def program(tmp_path):
    """Return a program that writes its arguments to `said.json` in the current folder."""
    return script(
        tmp_path / "bin dir" / "infra'blend",
        f"#!{sys.executable}\nimport json, sys\njson.dump(sys.argv[1:], open('said.json', 'w'))\n",
    )


def script(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def submission(*words: str, **more: Any) -> api.Submission:
    given: dict[str, Any] = {"shards": 7, "out": Path("s h"), "into": Path("in\nto")} | more
    return api.Submission(words, **given)


def bash(text: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    path = folder / "job.sh"
    path.write_bytes(os.fsencode(text))
    words = ["bash", str(path)]
    return subprocess.run(words, cwd=folder, env=os.environ | environment, capture_output=True, text=True, timeout=30)


def said(folder: Path) -> list[str]:
    found = json.loads((folder / "said.json").read_text())
    assert isinstance(found, list)
    return found


# -- SLURM


def test_words_arrive_in_a_shard_as_they_were_given(tmp_path, program):
    words = [*HOSTILE, NOT_UTF_8]
    text = api.submission_text(submission(*words, program=(str(program),)), "slurm")
    ended = bash(text, tmp_path, SLURM_ARRAY_TASK_ID="3")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert said(tmp_path) == ["--quiet", "generate", *words, "--resume", "--shard", "3/7"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bin dir", "job.sh", "said.json"]


def test_task_0_merges(tmp_path, program):
    text = api.submission_text(submission(program=(str(program),)), "slurm")
    assert bash(text, tmp_path, SLURM_ARRAY_TASK_ID="0").returncode == 0
    assert said(tmp_path) == ["--quiet", "merge", "--resume", "--", "s h", "in\nto"]


def fake_sbatch(folder: Path, answer: str = "12;here", code: int = 0) -> str:
    """Put a client on a search path that adds its arguments to `asked`; return the path."""
    script(folder / "fake" / "sbatch", f'#!/bin/sh\necho "$@" >> asked\necho "{answer}"\nexit {code}\n')
    return f"{folder / 'fake'}:{os.environ['PATH']}"


def test_the_script_submits_itself_and_the_merge_after_it(tmp_path):
    text = api.submission_text(submission(name="night-1"), "slurm")
    ended = bash(text, tmp_path, PATH=fake_sbatch(tmp_path))
    assert ended.stdout == "shards: job 12, merge: job 12\n"
    first, second = (tmp_path / "asked").read_text().splitlines()
    assert first == f"--parsable {tmp_path}/job.sh"
    assert "--array=0 --job-name=night-1-merge" in second and "--dependency=afterany:12 " in second
    ended = bash(text, tmp_path, PATH=fake_sbatch(tmp_path, "no", 3))
    assert ended.returncode == 3 and len((tmp_path / "asked").read_text().splitlines()) == 3


def test_options_of_the_array(tmp_path):
    job = submission(parallel=3, cores=4, memory_gib=9, minutes=30, partition="gpu_2", account="a.b")
    lines = api.submission_text(job, "slurm").splitlines()
    options = [line.removeprefix("#SBATCH ") for line in lines if line.startswith("#SBATCH")]
    assert {
        "--array=1-7%3", "--cpus-per-task=4", "--mem=9G", "--time=30", "--requeue", "--signal=B:USR1@120",
        "--partition=gpu_2", "--account=a.b",
    } <= set(options)  # fmt: skip
    assert "#SBATCH --array=1-7\n" in api.submission_text(submission(), "slurm")
    # sbatch stops reading options at the first command.
    assert lines.index("set -u") > max(n for n, line in enumerate(lines) if line.startswith("#SBATCH"))


@pytest.mark.parametrize("words", [(), HOSTILE])
def test_the_script_is_good_bash(tmp_path, words):
    path = tmp_path / "job.sh"
    path.write_text(api.submission_text(submission(*words), "slurm"))
    assert subprocess.run(["bash", "-n", str(path)], check=False).returncode == 0
    if shellcheck := shutil.which("shellcheck"):
        found = subprocess.run([shellcheck, "-S", "warning", str(path)], capture_output=True, text=True, check=False)
        assert found.stdout == ""


def test_words_are_one_printable_line():
    text = quoted([*HOSTILE, NOT_UTF_8])
    assert text.isprintable()


@pytest.mark.parametrize(
    ("number", "code", "restarts", "queued_again"),
    [
        (signal.SIGUSR1, 130, "0", True),
        (signal.SIGUSR1, 130, "100", False),
        (signal.SIGUSR1, 0, "0", False),
        (signal.SIGUSR1, 1, "0", False),
        (signal.SIGTERM, 130, "0", False),
    ],
)
def test_signals_stop_the_worker_and_the_end_of_the_time_continues_it(tmp_path, number, code, restarts, queued_again):
    """The worker takes a moment to stop, as a frame that is being rendered does."""
    worker = script(
        tmp_path / "worker",
        f"#!/bin/bash\ntrap 'sleep 0.5; echo stopped > stopped; exit {code}' TERM\necho > started\n"
        "while :; do sleep 0.05; done\n",
    )
    script(tmp_path / "fake" / "scontrol", '#!/bin/sh\necho "$@" > queued\n')
    path = tmp_path / "job.sh"
    path.write_text(api.submission_text(submission(program=(str(worker),)), "slurm"))
    environment = {
        "PATH": f"{tmp_path / 'fake'}:{os.environ['PATH']}", "SLURM_ARRAY_TASK_ID": "2", "SLURM_ARRAY_JOB_ID": "41",
        "SLURM_RESTART_COUNT": restarts,
    }  # fmt: skip
    with subprocess.Popen(["bash", str(path)], cwd=tmp_path, env=os.environ | environment) as job:
        for _ in range(500):
            if (tmp_path / "started").exists():
                break
            time.sleep(0.02)
        job.send_signal(number)
        assert job.wait(timeout=20) == code
    assert (tmp_path / "stopped").exists()
    queued = (tmp_path / "queued").read_text() if (tmp_path / "queued").exists() else ""
    assert queued == ("requeue 41_2\n" if queued_again else "")


# -- Kubernetes


ON_VOLUME: dict[str, Any] = {
    "image": "registry.example/infrablend:1.0@sha256:ab",
    "volumes": (api.Volume("data", "/data"), api.Volume("out", "/out")),
    "out": Path("/out/s h"),
    "into": Path("/out/$(X)"),
}

CONTAINER: dict[str, Any] = {
    "name": str, "image": str, "command": [str],
    "resources": {"requests": {"cpu": str, "memory": str}, "limits": {"cpu": str, "memory": str}},
    "volumeMounts": [{"name": str, "mountPath": str}],
}  # fmt: skip
JOB: dict[str, Any] = {
    "apiVersion": str, "kind": str, "metadata": {"name": str},
    "spec": {
        "completionMode": str, "completions": int, "parallelism": int, "backoffLimit": int, "backoffLimitPerIndex": int,
        "maxFailedIndexes": int, "activeDeadlineSeconds": int,
        "podFailurePolicy": {
            "rules": [
                {
                    "action": str, "onPodConditions": [{"type": str}],
                    "onExitCodes": {"operator": str, "values": [int]},
                }
            ]
        },
        "template": {
            "spec": {
                "restartPolicy": str, "terminationGracePeriodSeconds": int, "containers": [CONTAINER],
                "initContainers": [CONTAINER],
                "volumes": [
                    {
                        "name": str, "persistentVolumeClaim": {"claimName": str},
                        "emptyDir": {"medium": str, "sizeLimit": str},
                    }
                ],
            }
        },
    },
}  # fmt: skip
"""Fields of a Job of batch/v1 that are used, with their types."""


def check_fields(value: Any, known: Any, where: str = "") -> None:
    if isinstance(known, dict):
        assert isinstance(value, dict), where
        assert value.keys() <= known.keys(), where
        for key, inner in value.items():
            check_fields(inner, known[key], f"{where}.{key}")
    elif isinstance(known, list):
        assert isinstance(value, list) and value, where
        for inner in value:
            check_fields(inner, known[0], where)
    else:
        assert type(value) is known, where


def manifests(*words: str, **more: Any) -> list[dict[str, Any]]:
    return list(yaml.safe_load_all(api.submission_text(submission(*words, **(ON_VOLUME | more)), "kubernetes")))


def test_the_manifest_has_known_fields():
    shards, merge = manifests(*HOSTILE, parallel=3, cores=4, memory_gib=9)
    for job in (shards, merge):
        check_fields(job, JOB)
        assert (job["apiVersion"], job["kind"]) == ("batch/v1", "Job")
        spec = job["spec"]["template"]["spec"]
        assert spec["restartPolicy"] == "Never"  # podFailurePolicy and backoffLimitPerIndex require it
        volumes = [v["name"] for v in spec["volumes"]]
        assert len(set(volumes)) == len(volumes) == 3
        for container in (*spec["containers"], *spec.get("initContainers", ())):
            assert [m["name"] for m in container["volumeMounts"]] == volumes
    spec = shards["spec"]
    assert (spec["completionMode"], spec["completions"], spec["parallelism"]) == ("Indexed", 7, 3)
    # A job cannot have both: backoffLimitPerIndex needs the index, and only an Indexed job has one.
    assert "backoffLimitPerIndex" not in merge["spec"] and "completionMode" not in merge["spec"]
    assert spec["template"]["spec"]["containers"][0]["resources"]["limits"] == {"cpu": "4", "memory": "9Gi"}
    assert manifests(parallel=50)[0]["spec"]["parallelism"] == 7


def expanded(words: list[str], variables: dict[str, str]) -> list[str]:
    """Return the command that Kubernetes starts: `$$` is `$`, and $(NAME) of a known variable is its value."""
    found = []
    for word in words:
        text, rest = "", word
        while rest:
            name = rest[2:].partition(")")[0]
            if rest.startswith("$$"):
                text, rest = text + "$", rest[2:]
            elif rest.startswith("$(") and name in variables:
                text, rest = text + variables[name], rest[len(name) + 3 :]
            else:
                text, rest = text + rest[0], rest[1:]
        found.append(text)
    return found


def test_words_arrive_in_a_pod_as_they_were_given(tmp_path, program):
    shards, merge = manifests(*HOSTILE, program=(str(program),))
    variables = {"JOB_COMPLETION_INDEX": "2", "X": "gone", "HOME": "gone"}

    def start(job: dict[str, Any], kind: str) -> list[str]:
        words = expanded(job["spec"]["template"]["spec"][kind][0]["command"], variables)
        subprocess.run(words, cwd=tmp_path, env=os.environ | variables, check=True)
        return said(tmp_path)

    assert start(shards, "containers") == ["--quiet", "generate", *HOSTILE, "--resume", "--shard", "3/7"]
    assert start(merge, "initContainers") == ["--quiet", "status", "--wait", "--", "/out/s h"]
    assert start(merge, "containers") == ["--quiet", "merge", "--resume", "--", "/out/s h", "/out/$(X)"]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"image": None}, "found no image"),
        ({"volumes": ()}, "found no volume"),
        ({"volumes": (api.Volume("a", "/out"), api.Volume("b", "/out"))}, "two on the same path"),
        ({"out": Path("shards")}, "shards: is on none of the volumes"),
        ({"into": Path("/outside")}, "/outside: is on none"),
        ({"into": Path("/out/../etc")}, "is on none"),
        ({"paths": (Path("/data/in"), Path("recipe.yaml"))}, "recipe.yaml: is on none"),
        ({"words": (NOT_UTF_8,)}, "is not UTF-8"),
    ],
)
def test_what_pods_cannot_see_is_refused(changed, says):
    given = ON_VOLUME | changed
    with pytest.raises(ArgumentError, match=says):
        api.submission_text(submission(*given.pop("words", ()), **given), "kubernetes")


# -- both


@pytest.mark.parametrize(
    "changed",
    [
        {"shards": 0}, {"shards": -1}, {"shards": 100_001}, {"cores": 0}, {"memory_gib": 0}, {"minutes": 2},
        {"parallel": 0}, {"parallel": -1}, {"name": ""}, {"name": "a\n#SBATCH -N 9"}, {"name": "A"}, {"name": "-a"},
        {"name": "a" * 41}, {"partition": "a b"}, {"partition": ""}, {"account": "$(x)"}, {"account": "a\n"},
        {"image": "a b"}, {"image": ""},
    ],
)  # fmt: skip
def test_values_out_of_range_are_refused(changed):
    with pytest.raises(ArgumentError, match="expected"):
        submission(**changed)


@pytest.mark.parametrize("text", ["", "a", "a:", "a:b", ":/b", "a b:/c", "a:/", "a:/b:c", "a:/b/../c", "A:/b"])
def test_volumes_are_a_claim_and_a_path(text):
    with pytest.raises(ArgumentError, match="expected"):
        api.Volume.parse(text)


WORDS = ("submit", "--shards", 3, "--into", "/out/all", "--image", "i", "--volume", "v:/out")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("r", "--data", "/out/d"), "Missing option '--out'"),
        (("r", "--data", "/out/d", "--out", "/out/o", "--shard", "1/2"), "--shard: the jobs set it"),
        (("r", "--data", "/out/d", "--out", "/out/o", "--resume"), "--resume: the jobs set it"),
        (("r", "--data", "/out/d", "--out", "/out/o", "--typo"), "No such option: --typo"),
        (("r", "--data", "/out/d", "--out", "/out/o", "--price", "1"), "--price"),
        (("r", "--data", "/out/d", "--out", "/out/o", "--limit", "2", "--sample", "2"), "limit and sample exclude"),
        (("--data", "/out/d", "--out", "/out/o", "--", "-r"), "a second time"),
    ],
)
def test_wrong_words_are_refused_before_anything_is_submitted(words, says):
    ended = run(*WORDS, "--to", "slurm", "--print", "--", *words)
    assert ended.exit_code == 2
    assert says in ended.output


def test_the_command_line_prints_both(tmp_path):
    words = ("--", "hit-uav-drone", "--data", "/out/d", "--out", "/out/o", "--set", "a=b c")
    text = done(*WORDS, "--to", "slurm", "--print", *words).output
    assert "--set 'a=b c' --workers 8 --resume" in text and "#SBATCH --array=1-3\n" in text
    text = done(*WORDS, "--to", "slurm", "--cores", 2, "--print", *words, "--workers", 5).output
    assert "--workers 5 --resume" in text and "--workers 2" not in text
    shards, _ = yaml.safe_load_all(done(*WORDS, "--to", "kubernetes", "--print", *words).output)
    assert shards["spec"]["template"]["spec"]["containers"][0]["command"][4] == "infrablend"
    ended = run(*WORDS, "--to", "kubernetes", "--print", "--", "./r.yaml", *words[2:])
    assert ended.exit_code == 2 and "r.yaml: is on none of the volumes (/out)" in ended.output


def test_jobs_are_handed_to_the_client(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", fake_sbatch(tmp_path))
    assert api.submit(submission(), "slurm") == "shards: job 12, merge: job 12"
    monkeypatch.setenv("PATH", fake_sbatch(tmp_path, "sbatch: error: no", 1))
    with pytest.raises(OutputError, match="sbatch refused the jobs"):
        api.submit(submission(), "slurm")
    script(tmp_path / "fake" / "kubectl", '#!/bin/sh\ncat "$3"\n')
    assert yaml.safe_load_all(api.submit(submission(**ON_VOLUME), "kubernetes"))
    assert list(yaml.safe_load_all(api.submit(submission(**ON_VOLUME), "kubernetes"))) == manifests()
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingDependencyError, match="kubectl is not installed"):
        api.submit(submission(**ON_VOLUME), "kubernetes")


def test_status_waits_for_the_shards(dataset, tmp_path, monkeypatch):
    render_flat(monkeypatch)
    out = tmp_path / "shards"
    todo = ["1/2", "2/2"]

    def work(_: float) -> None:
        shard = todo.pop(0)
        done("generate", "hit-uav-drone", "--data", dataset, "--out", out, "--to", "yolo", "--shard", shard)

    monkeypatch.setattr(sharded_run.time, "sleep", work)
    assert [s.state for s in api.status(out, wait=True)] == ["done", "done"]
    assert todo == []
    assert done("status", "--wait", out).exit_code == 0


def test_jobs_with_runs_in_object_storage():
    words = ("r", "--data", "s3://b/d", "--out", "s3://b/run")
    given = {"out": Path("s3://b/run"), "paths": (Path("s3://b/d"), Path("s3://b/run"))}
    assert "-- s3://b/run " in api.submission_text(submission(*words, **given), "slurm")
    shards, merge = manifests(*words, **given)
    assert shards["spec"]["template"]["spec"]["containers"][0]["command"][-2:] == ["s3://b/run", "--resume"]
    assert "s3://b/run" in merge["spec"]["template"]["spec"]["containers"][0]["command"]
    assert merge["spec"]["template"]["spec"]["initContainers"][0]["command"][-1] == "s3://b/run"
    with pytest.raises(ArgumentError, match="into: found an address"):
        submission(*words, **{**given, "into": Path("s3://b/full")})
