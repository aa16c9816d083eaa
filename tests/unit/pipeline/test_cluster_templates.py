"""The templates for SLURM and Kubernetes in docs/how_to/cluster.md: they parse, and every argument arrives as given."""

import json
import os
import re
import shutil
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from infrablend.cli.app import build_app

PAGE = Path(__file__).parents[3] / "docs" / "how_to" / "cluster.md"
HOSTILE = (
    "", " ", "a b", "a\nb", "\n#SBATCH --array=0-9", "'", '"', "\\", "\\n'", "$(touch x)", "${HOME}", "$$", "$$(X)",
    "`touch x`", "!!", "*", "~", "-x", "--", "a;b", "a&b|c>d", "\x1b[31m", "\t\r", "ä😀", "{a,b}", "# no comment",
    "$'x'", "MERGE", "\u202e",
)  # fmt: skip
NOT_UTF_8 = os.fsdecode(b"a\xff\nb")
TASK = {"SLURM_ARRAY_TASK_ID": "3", "SLURM_ARRAY_TASK_MAX": "7", "SLURM_CPUS_PER_TASK": "4", "SLURM_ARRAY_JOB_ID": "41"}


def block(language: str, begin: str) -> str:
    """Return the fenced block of the page that begins with a text."""
    blocks = re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    (found,) = (b for b in blocks if b.startswith(begin))
    return found


@pytest.fixture
def array(tmp_path):
    """Return the template of the SLURM array as a file."""
    return script(tmp_path / "shards.sh", block("bash", "#!/bin/bash\n"))


def manifests() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the jobs of the Kubernetes template: the shards, and the merge."""
    shards, merge = yaml.safe_load_all(block("yaml", "apiVersion"))
    return shards, merge


def script(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


@pytest.fixture
def environment(tmp_path):
    """Return variables of a task, whose `infrablend` writes its arguments to `said.json` in the current folder."""
    script(
        tmp_path / "bin dir" / "infrablend",
        f"#!{sys.executable}\nimport json, sys\njson.dump(sys.argv[1:], open('said.json', 'w'))\n",
    )
    return os.environ | TASK | {"PATH": f"{tmp_path / 'bin dir'}:{os.environ['PATH']}"}


def said(folder: Path) -> list[str]:
    found = json.loads((folder / "said.json").read_text())
    assert isinstance(found, list)
    return found


def require_known_options(words: list[str]) -> None:
    """Check that a command of InfraBlend takes these words."""
    root: Any = typer.main.get_command(build_app())
    assert words[0] == "--quiet"
    assert root.commands[words[1]].make_context(words[1], words[2:]).args == []


# -- SLURM


def test_words_arrive_in_a_shard_as_they_were_given(tmp_path, array, environment):
    words = [*HOSTILE, NOT_UTF_8]
    ended = subprocess.run(
        ["bash", str(array), *words], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=30
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    ours = ["--quiet", "generate", "--resume", "--workers", "4", "--shard", "3/7"]
    assert said(tmp_path) == [*ours, *words]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bin dir", "said.json", "shards.sh"]
    require_known_options([*ours, "hit-uav-drone", "--data", "HIT-UAV", "--out", "shards"])


def test_options_of_the_array(array):
    lines = array.read_text().splitlines()
    options = [line.removeprefix("#SBATCH ") for line in lines if line.startswith("#SBATCH")]
    known = {
        "job-name", "array", "cpus-per-task", "mem", "time", "requeue", "signal", "open-mode", "output", "partition",
        "account",
    }  # fmt: skip
    assert {o.removeprefix("--").partition("=")[0] for o in options} <= known
    assert {"--array=1-100%20", "--requeue", "--signal=B:USR1@120", "--open-mode=append"} <= set(options)
    # sbatch stops reading options at the first command.
    assert lines.index("set -u") > max(n for n, line in enumerate(lines) if line.startswith("#SBATCH"))


def test_the_array_and_the_merge_are_submitted(tmp_path, environment):
    script(tmp_path / "bin dir" / "sbatch", '#!/bin/sh\necho "$@" >> asked\necho 12\n')
    text = block("bash", "shards=$(sbatch")
    subprocess.run(["bash", "-euc", text], cwd=tmp_path, env=environment, check=True, timeout=30)
    first, second = (tmp_path / "asked").read_text().splitlines()
    assert first == "--parsable shards.sh hit-uav-drone --data HIT-UAV --out shards"
    options, _, merge = second.partition(" --wrap ")
    assert "--dependency=afterany:12 " in options
    require_known_options(merge.split()[1:])


def test_the_script_is_good_bash(array):
    assert subprocess.run(["bash", "-n", str(array)], check=False).returncode == 0
    if shellcheck := shutil.which("shellcheck"):
        found = subprocess.run([shellcheck, "-S", "warning", str(array)], capture_output=True, text=True, check=False)
        assert found.stdout == ""


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
def test_signals_stop_the_worker_and_the_end_of_the_time_continues_it(
    tmp_path, array, environment, number, code, restarts, queued_again
):
    """The worker takes a moment to stop, as a frame that is being rendered does."""
    script(
        tmp_path / "bin dir" / "infrablend",
        f"#!/bin/bash\ntrap 'sleep 0.5; echo stopped > stopped; exit {code}' TERM\necho > started\n"
        "while :; do sleep 0.05; done\n",
    )
    script(tmp_path / "bin dir" / "scontrol", '#!/bin/sh\necho "$@" > queued\n')
    environment["SLURM_RESTART_COUNT"] = restarts
    with subprocess.Popen(["bash", str(array)], cwd=tmp_path, env=environment) as job:
        for _ in range(500):
            if (tmp_path / "started").exists():
                break
            time.sleep(0.02)
        job.send_signal(number)
        assert job.wait(timeout=20) == code
    assert (tmp_path / "stopped").exists()
    queued = (tmp_path / "queued").read_text() if (tmp_path / "queued").exists() else ""
    assert queued == ("requeue 41_3\n" if queued_again else "")


# -- Kubernetes


CONTAINER: dict[str, Any] = {
    "name": str, "image": str, "command": [str], "args": [str],
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


def test_the_manifest_has_known_fields():
    shards, merge = manifests()
    for job in (shards, merge):
        check_fields(job, JOB)
        assert (job["apiVersion"], job["kind"]) == ("batch/v1", "Job")
        spec = job["spec"]["template"]["spec"]
        assert spec["restartPolicy"] == "Never"  # podFailurePolicy and backoffLimitPerIndex require it
        volumes = [v["name"] for v in spec["volumes"]]
        assert len(set(volumes)) == len(volumes) == 2
        for container in spec["containers"]:
            assert [m["name"] for m in container["volumeMounts"]] == volumes
            assert container["resources"]["limits"] == container["resources"]["requests"]
    spec = shards["spec"]
    assert (spec["completionMode"], spec["parallelism"]) == ("Indexed", 20)
    # A job cannot have both: backoffLimitPerIndex needs the index, and only an Indexed job has one.
    assert "backoffLimitPerIndex" not in merge["spec"] and "completionMode" not in merge["spec"]


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


def test_words_arrive_in_a_pod_as_they_were_given(tmp_path, environment):
    shards, merge = manifests()
    variables = {"JOB_COMPLETION_INDEX": "2", "HOME": "gone"}

    def start(job: dict[str, Any], kind: str, more: tuple[str, ...] = ()) -> list[str]:
        container = job["spec"]["template"]["spec"][kind][0]
        given = [*container["command"], *(more or container.get("args", []))]
        words = [*expanded(container["command"], variables), *given[len(container["command"]) :]]
        subprocess.run(words, cwd=tmp_path, env=environment | variables, check=True)
        return said(tmp_path)

    count = shards["spec"]["completions"]
    ours = ["--quiet", "generate", "--resume", "--workers", "16", "--shard", f"3/{count}"]
    assert start(shards, "containers", HOSTILE) == [*ours, *HOSTILE]
    found = start(shards, "containers")
    assert found == [*ours, "hit-uav-drone", "--data", "/data/HIT-UAV", "--out", "/data/shards"]
    require_known_options(found)
    for kind, expected in (
        ("initContainers", ["--quiet", "status", "--wait", "/data/shards"]),
        ("containers", ["--quiet", "merge", "--resume", "/data/shards", "/data/runs/full"]),
    ):
        assert start(merge, kind) == expected
        require_known_options(expected)


def test_paths_of_pods_are_on_the_volume():
    for job in manifests():
        spec = job["spec"]["template"]["spec"]
        (place,) = (m["mountPath"] for m in spec["containers"][0]["volumeMounts"] if m["name"] == "data")
        words = [*spec["containers"][0]["command"], *spec["containers"][0].get("args", [])]
        assert all(w.startswith(f"{place}/") for w in words if w.startswith("/") and w != "/bin/sh")
