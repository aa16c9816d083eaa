"""What the executor for Ray adds to the contract: a Ray of its own, lost machines, and refused clusters."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import OutputError
from infrablend.pipeline.execution import RayPool, RaySettings

pytest.importorskip("ray", reason="NEEDS RAY: `make ray` installs it; the executor for Ray is not tested without it")
pytestmark = pytest.mark.slow
OBEY = WorkerSpec("executor_work:obey")
WAIT_S = 300


def orders(*orders):
    return [Task(f"t{i}", order) for i, order in enumerate(orders)]


def pool(worker=OBEY, **settings):
    return RayPool(worker, RaySettings(**{"workers": 1, **settings}))


def children():
    return {p.pid for p in psutil.Process().children(recursive=True)}


@pytest.fixture
def no_ray(monkeypatch):
    """No Ray is running, so that each run starts its own."""
    import ray

    ray.shutdown()
    monkeypatch.delenv("RAY_ADDRESS", raising=False)


PROGRAM = """
import sys
from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import Interrupted
from infrablend.pipeline.execution import RayPool, RaySettings
folder, grace_s = sys.argv[1], float(sys.argv[2])
tasks = [Task("quick", ("give", "quick"))] + [Task(f"t{i}", ("wait_for_release", (folder, i))) for i in range(20)]
try:
    for r in RayPool(WorkerSpec("executor_work:obey"), RaySettings(workers=2, grace_s=grace_s, retries=0)).run(tasks):
        print(r.key, "" if r.ok else "FAILED", flush=True)
except Interrupted as e:
    print("INTERRUPTED", e.message, flush=True)
    sys.exit(7)
"""


@pytest.mark.parametrize("finishes", [True, False])
def test_a_ray_of_its_own_ends_with_the_run_also_after_ctrl_c(no_ray, tmp_path, finishes):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", PROGRAM, str(tmp_path), str(WAIT_S if finishes else 0.5)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as program:
        assert program.stdout.readline() == "quick \n"
        deadline = time.monotonic() + WAIT_S
        while len(list(tmp_path.glob("begun-*"))) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        started = psutil.Process(program.pid).children(recursive=True)
        assert started
        program.send_signal(signal.SIGINT)
        if finishes:
            (tmp_path / "release").touch()
        out, _ = program.communicate(timeout=WAIT_S)
    *finished, last = out.splitlines()
    assert program.returncode == 7 and last.startswith("INTERRUPTED") and "--resume" in last and "FAILED" not in out
    assert len(finished) in ((2, 3, 4) if finishes else (0,))
    assert not psutil.wait_procs(started, timeout=WAIT_S)[1]


@pytest.mark.timeout(120)
def test_a_cluster_that_is_not_there_is_named(no_ray):
    with pytest.raises(OutputError, match=r"Ray at 127\.0\.0\.1:1: [\s\S]*Check --address and RAY_ADDRESS"):
        list(pool(address="127.0.0.1:1").run(orders(("give", 1))))


def test_no_tasks_start_no_ray(no_ray):
    before = children()
    assert list(pool().run([])) == [] and children() == before


def test_a_run_on_a_cluster_that_loses_a_worker_and_a_machine_has_the_bytes_of_one_process(no_ray):
    command = [sys.executable, "scripts/ray_check.py", "--frames", "48", "--rounds", "1"]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=WAIT_S, check=False)
    assert done.returncode == 0 and "same bytes" in done.stdout, done.stdout + done.stderr
