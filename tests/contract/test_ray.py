"""What the executor for Ray adds to the contract: a Ray of its own, lost workers and machines, and refused clusters."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import OutputError, WorkerDiedError
from infrablend.execution import RayPool, RaySettings

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


@pytest.fixture(scope="module")
def ray_here():
    import ray

    ray.init(
        "local",
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        configure_logging=False,
        object_store_memory=10**8,
    )
    yield ray
    ray.shutdown()


def test_a_lost_worker_is_replaced_and_its_task_retried(ray_here, tmp_path, capfd):
    tasks = orders(("die_once", str(tmp_path / "flag")), ("give", 1), ("give", 2))
    results = {r.key: (r.value, r.attempts) for r in pool(retries=1).run(tasks)}
    assert results == {"t0": ("second try", 2), "t1": (1, 1), "t2": (2, 1)}
    assert capfd.readouterr().out == ""


def test_a_task_that_always_loses_its_worker_fails(ray_here):
    results = {r.key: r for r in pool(workers=2, retries=1).run(orders(("give", 0), ("killed", None), ("give", 2)))}
    assert (results["t0"].value, results["t2"].value) == (0, 2)
    assert (results["t1"].failure.kind, results["t1"].attempts) == ("crash", 2)
    with pytest.raises(WorkerDiedError, match="t1: its worker was lost on attempt 2 of 2"):
        raise results["t1"].failure.to_exception()


def test_a_hung_worker_is_killed_and_its_task_retried(ray_here, tmp_path):
    tasks = orders(("hang_once", str(tmp_path / "flag")), ("give", 1))
    results = {r.key: r for r in pool(task_timeout_s=1.0).run(tasks)}
    assert (results["t0"].value, results["t0"].attempts, results["t1"].value) == ("second try", 2, 1)
    failed = list(pool(task_timeout_s=0.5, retries=0).run(orders(("sleep", 3600))))
    assert failed[0].failure.kind == "timeout" and "took longer than 0.5 s" in failed[0].failure.message


def test_workers_are_replaced_by_count_and_memory(ray_here):
    pids = [r.value for r in pool(tasks_per_worker=3).run(orders(*[("pid", None)] * 7))]
    assert len(pids) == 7 and 2 <= len(set(pids)) <= 3
    pids = [r.value for r in pool(rss_ceiling_bytes=1).run(orders(*[("pid", None)] * 30))]
    assert len(pids) == 30 and len(set(pids)) == 2


def test_crashes_at_the_start_are_one_clear_error(ray_here, tmp_path):
    counter = tmp_path / "starts"
    with pytest.raises(WorkerDiedError, match="3 in a row ended before their first task"):
        list(pool(WorkerSpec("executor_work:dies", str(counter)), retries=2).run(orders(("give", 1))))
    assert len(counter.read_text()) == 3


def test_libraries_in_workers_have_one_thread(ray_here):
    assert next(iter(pool().run(orders(("environment", None))))).value == ("1", 1)


PROGRAM = """
import sys
from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import Interrupted
from infrablend.execution import RayPool, RaySettings
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
