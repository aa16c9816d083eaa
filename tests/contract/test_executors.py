"""The contract of every executor, and the failures that the process pool must survive."""

import contextlib
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import Interrupted, MissingDependencyError, RenderError, WorkerDiedError
from infrablend.pipeline.execution import PoolSettings, ProcessPool, RayPool, RaySettings, Serial, WarmPool

OBEY = WorkerSpec("executor_work:obey")
# Far above what any machine needs: an upper bound on a wait, never a measurement.
WAIT_S = 300
# Longer than a test may take: a task that sleeps so long was ended from outside if the test comes to an end.
FOREVER_S = 3600


def pool(worker=OBEY, **settings):
    return ProcessPool(worker, PoolSettings(**settings))


@pytest.fixture(scope="module")
def started_ray():
    """A Ray on this machine, so that not every test has to start one."""
    ray = pytest.importorskip(
        "ray", reason="NEEDS RAY: `make ray` installs it; the executor for Ray is not tested without"
    )
    ray.init(
        num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False, object_store_memory=10**8
    )
    yield
    ray.shutdown()


@pytest.fixture(params=["serial", "pool-1", "pool-2", "ray-1", "ray-2"])
def make(request):
    """A function WorkerSpec -> executor."""
    if request.param == "serial":
        return Serial
    if request.param.startswith("ray"):
        request.getfixturevalue("started_ray")
        return lambda worker: RayPool(worker, RaySettings(workers=int(request.param[-1])))
    return lambda worker: pool(worker, workers=int(request.param[-1]))


@pytest.fixture(params=["pool", pytest.param("ray", marks=pytest.mark.slow)])
def lossy(request):
    """A function of worker and settings -> executor with workers that may be lost."""
    if request.param == "pool":
        return pool
    request.getfixturevalue("started_ray")
    return lambda worker=OBEY, **settings: RayPool(worker, RaySettings(**{"workers": 1, **settings}))


def orders(*orders):
    return [Task(f"t{i}", order) for i, order in enumerate(orders)]


def workers_left():
    """Processes that executors have left, without those of a Ray that stays."""
    left = []
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):  # a zombie has ended, too
            words = " ".join(child.cmdline())
            if "RayWorker" in words or not re.search(r"\bray\b|gcs_server|raylet", words):
                left.append(child)
    return left


def assert_no_children():
    deadline = time.monotonic() + WAIT_S
    while (left := workers_left()) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not left


def is_running(pid):
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


# ---- every executor


def test_same_values_whatever_the_executor(make):
    tasks = [Task(f"k{i:02}", i) for i in range(12)]
    results = list(make(WorkerSpec("executor_work:square", {"plus": 100})).run(tasks))
    assert {r.key: r.value for r in results} == {f"k{i:02}": 100 + i * i for i in range(12)}
    assert len(results) == 12
    assert all(r.ok and r.attempts == 1 and r.rss_bytes > 2**20 for r in results)


def test_no_tasks_no_results(make):
    assert list(make(OBEY).run([])) == []


def test_failed_task_is_a_result_and_other_tasks_continue(make):
    tasks = orders(
        ("fail", "by zero"),
        ("give", 1),
        ("fail_ours", "dark"),
        ("give", None),
        ("exit_python", 4),
        ("give", 2),
    )
    by_key = {r.key: r for r in make(OBEY).run(tasks)}
    assert [by_key[k].value for k in ("t1", "t3", "t5")] == [1, None, 2]
    assert by_key["t3"].ok
    failure = by_key["t0"].failure
    assert (failure.kind, failure.error, failure.message) == ("error", "ZeroDivisionError", "by zero")
    assert "in fail" in failure.traceback
    assert str(failure.to_exception()) == "ZeroDivisionError: by zero"
    ours = by_key["t2"].failure.to_exception()
    assert type(ours) is RenderError
    assert ours.message == "dark"
    assert ours.problems[0].code == "no-light"
    assert by_key["t4"].failure.error == "SystemExit"
    assert all(pickle.loads(pickle.dumps(r)) == r for r in by_key.values())


def test_factory_that_raises_is_one_clear_error(make, tmp_path):
    counter = tmp_path / "starts"
    with pytest.raises(MissingDependencyError, match="bpy is not installed") as caught:
        list(make(WorkerSpec("executor_work:raises", str(counter))).run(orders(*[("give", 1)] * 9)))
    assert caught.value.problems[0].code == "no-bpy"
    assert len(counter.read_text()) <= 2  # at most once per worker: no loop
    assert_no_children()


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        ("executor_work:raises_builtin", r"could not start: KeyError: 'no such device'"),
        ("executor_work:absent", r"could not start: ValueError: .*has no function absent"),
        ("executor_work:not_a_function", r"has no function not_a_function"),
        ("no_such_module:make", r"No module named 'no_such_module'"),
        ("nonsense", r"expected 'module:function'"),
    ],
)
@pytest.mark.parametrize("make", [Serial, pool])
def test_factory_that_cannot_be_used(make, factory, message):
    with pytest.raises(RenderError, match=message):
        list(make(WorkerSpec(factory)).run(orders(("give", 1))))


def test_tasks_are_read_as_needed(make):
    read = []

    def tasks():
        for i in range(40):
            read.append(i)
            yield Task(str(i), ("give", i))

    results = make(OBEY).run(tasks())
    next(results)
    assert len(read) <= 6  # two per worker, and the one that was just asked for
    results.close()
    assert_no_children()


def test_error_in_the_source_of_tasks_ends_the_run(make):
    def tasks():
        yield Task("a", ("give", 1))
        raise OSError("the list broke off")

    with pytest.raises(OSError, match="broke off"):
        list(make(OBEY).run(tasks()))
    assert_no_children()


def test_output_of_c_code_does_not_reach_stdout(make, capfd, request):
    if "serial" in request.node.name:
        pytest.skip("a serial run shares the process's output")
    results = list(make(OBEY).run(orders(("shout", "Fra:1 Mem:12M"))))
    assert results[0].ok
    assert capfd.readouterr().out == ""


# ---- pools of workers


def test_crashed_worker_is_replaced_and_its_task_retried(lossy, tmp_path, capfd):
    flag = str(tmp_path / "flag")
    results = lossy(retries=1).run(orders(("die_once", flag), ("give", 1), ("give", 2)))
    found = {r.key: (r.value, r.attempts) for r in results}
    assert found == {"t0": ("second try", 2), "t1": (1, 1), "t2": (2, 1)}
    assert capfd.readouterr().out == ""


def test_many_short_tasks_with_crashes_are_each_done_once(make, request, tmp_path):
    if "serial" in request.node.name:
        pytest.skip("a crash ends a serial run")
    done = [("give", n) for n in range(90)]
    done[40], done[70] = ("die", 5), ("die_once", str(tmp_path / "flag"))
    results = list(make(OBEY).run(orders(*done)))
    by_key = {r.key: r for r in results}
    assert len(results) == len(by_key) == 90
    assert [k for k, r in by_key.items() if r.failure is not None] == ["t40"]
    assert (by_key["t40"].failure.kind, by_key["t40"].attempts) == ("crash", 3)
    assert by_key.pop("t70").value == "second try"
    assert all(by_key[f"t{n}"].value == n for n in range(90) if n not in (40, 70))


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (("die", 5), "ended with exit code 5"),
        (("killed", None), r"ended by signal 9 SIGKILL \(often: out of memory\)"),
    ],
)
def test_always_crashing_task_fails_after_its_retries(lossy, order, words):
    results = {r.key: r for r in lossy(workers=2, retries=1).run(orders(("give", 0), order, ("give", 2)))}
    assert results["t0"].value == 0
    assert results["t2"].value == 2
    failure = results["t1"].failure
    assert failure.kind == "crash"
    assert results["t1"].attempts == 2
    said = words if lossy is pool else "lost on attempt 2 of 2"
    with pytest.raises(WorkerDiedError, match=f"t1: its worker (was )?{said}"):
        raise failure.to_exception()


def test_failure_quotes_the_last_output_which_is_also_logged(tmp_path):
    log = tmp_path / "run.log"
    log.write_text("before\n")
    tasks = orders(("shout", "Saved: x.exr"), ("last_words", "Segfault in cycles"))
    results = {r.key: r for r in pool(retries=0, log_path=log).run(tasks)}
    assert results["t1"].failure.traceback.splitlines()[-1] == "Segfault in cycles"
    assert log.read_text().splitlines() == [
        "before",
        "worker 0: Saved: x.exr",
        "worker 0: Segfault in cycles",
    ]


def test_hung_worker_is_killed_and_its_task_retried(lossy, tmp_path):
    tasks = orders(("hang_once", str(tmp_path / "flag")), ("give", 1))
    results = {r.key: r for r in lossy(task_timeout_s=1.0).run(tasks)}
    assert (results["t0"].value, results["t0"].attempts, results["t1"].value) == ("second try", 2, 1)
    results = {r.key: r for r in lossy(task_timeout_s=0.5, retries=0).run(orders(("sleep", FOREVER_S), ("give", 1)))}
    assert results["t0"].failure.kind == "timeout" and "took longer than 0.5 s" in results["t0"].failure.message


def test_slow_consumer_is_no_hang():
    """While the consumer is busy with one result, another stays unread for longer than the time limit."""
    tasks = orders(*[("sleep", 0.05)] * 8)
    results = []
    for r in pool(workers=2, task_timeout_s=0.3, retries=0).run(tasks):
        time.sleep(0.4)
        results.append(r)
    assert [r.failure for r in results] == [None] * 8


def test_workers_are_recycled_by_count_and_memory(lossy):
    pids = [r.value for r in lossy(tasks_per_worker=3).run(orders(*[("pid", None)] * 7))]
    assert len(pids) == 7
    # A worker of the process pool finishes what already waited in its inbox, so it may serve one more.
    assert 2 <= len(set(pids)) <= 3
    assert max(pids.count(p) for p in pids) <= 4
    pids = [r.value for r in lossy(rss_ceiling_bytes=1).run(orders(*[("pid", None)] * 30))]
    assert len(pids) == 30
    assert len(set(pids)) == 2


def test_crash_at_the_start_is_one_clear_error(lossy, tmp_path):
    counter = tmp_path / "starts"
    said = "exit code 11" if lossy is pool else ""
    with pytest.raises(WorkerDiedError, match=f"3 in a row ended before their first task.*{said}"):
        list(lossy(WorkerSpec("executor_work:dies", str(counter)), retries=2).run(orders(("give", 1))))
    assert len(counter.read_text()) == 3
    assert_no_children()


def test_libraries_in_workers_have_one_thread(lossy):
    assert next(iter(lossy().run(orders(("environment", None))))).value == ("1", 1)


# ---- the process pool


def test_works_on_both_workers_at_once():
    results = list(pool(workers=2).run(orders(*[("sleep", 0.15)] * 6)))
    assert {r.worker for r in results} == {0, 1}


def test_result_that_does_not_pickle_is_a_failure():
    results = {r.key: r for r in pool().run(orders(("unpicklable", None), ("give", 1)))}
    assert "pickle" in results["t0"].failure.message
    assert results["t1"].value == 1


def test_large_tasks_and_results_do_not_block_each_other():
    big = bytes(3_000_000)
    results = list(pool(workers=2).run(orders(*[("give", big)] * 6)))
    assert all(r.value == big for r in results)


def test_temporary_files_of_dead_workers_are_removed():
    (result,) = pool(retries=0).run(orders(("leave_file_and_die", None)))
    word, name = result.failure.traceback.splitlines()[-1].split()
    assert word == "left"
    assert "/infrablend-workers-" in name
    assert not Path(name).exists()


def test_no_more_workers_than_tasks():
    list(pool(workers=8).run(orders(("give", 1))))
    results = list(pool(workers=8).run(orders(("sleep", 0.1), ("sleep", 0.1))))
    assert {r.worker for r in results} <= {0, 1}


def test_closing_ends_workers_and_what_they_started(tmp_path):
    pid_file = tmp_path / "pid"
    results = pool(workers=2).run(orders(("give", 1), ("subprocess", str(pid_file)), ("sleep", 600)))
    assert next(results).value == 1
    while not (pid_file.exists() and pid_file.read_text()):
        time.sleep(0.02)
    results.close()
    assert_no_children()
    deadline = time.monotonic() + WAIT_S
    while is_running(int(pid_file.read_text())) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not is_running(int(pid_file.read_text()))


def test_works_outside_the_main_thread():
    values = []
    thread = threading.Thread(target=lambda: values.extend(r.value for r in pool().run(orders(("give", 5)))))
    thread.start()
    thread.join(60)
    assert values == [5]


# ---- interruption: in a program of its own, since it is about signals

PROGRAM = """
import sys
from pathlib import Path
from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import Interrupted
from infrablend.pipeline.execution import PoolSettings, ProcessPool, Serial, process_pool
kind, folder, grace_s = sys.argv[1], sys.argv[2], float(sys.argv[3])

class Run(process_pool._Run):
    def _finish_running_tasks(self):
        super()._finish_running_tasks()
        Path(folder, "winding-down").touch()

process_pool._Run = Run
tasks = [Task("quick", ("give", "quick"))] + [Task(f"t{i}", ("wait_for_release", (folder, i))) for i in range(20)]
worker = WorkerSpec("executor_work:obey")
settings = PoolSettings(workers=2, grace_s=grace_s, retries=0, task_timeout_s=None)
run = Serial(worker) if kind == "serial" else ProcessPool(worker, settings)
try:
    for r in run.run(tasks):
        print(r.key, '' if r.ok else 'FAILED', flush=True)
except Interrupted as e:
    print("INTERRUPTED", e.message, flush=True)
    sys.exit(7)
"""


def wait_for(condition):
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture
def program(tmp_path):
    """Start PROGRAM and wait until all its workers run a task that lasts until `release`; kill leftovers."""
    running = []

    def start(kind, grace_s):
        p = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, kind, str(tmp_path), str(grace_s)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        running.append(p)
        assert p.stdout.readline() == "quick \n"
        at_work = 1 if kind == "serial" else 2
        wait_for(lambda: len(list(tmp_path.glob("begun-*"))) >= at_work)
        return p, psutil.Process(p.pid).children()

    yield start
    for p in running:
        p.kill()
        p.wait()
        p.stdout.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("kind", ["serial", "pool"])
def test_first_signal_lets_running_tasks_finish(program, tmp_path, kind, number):
    p, workers = program(kind, FOREVER_S)
    p.send_signal(number)
    if kind == "pool":
        wait_for((tmp_path / "winding-down").exists)
    (tmp_path / "release").touch()
    out, _ = p.communicate(timeout=WAIT_S)
    assert p.returncode == 7
    *finished, last = out.splitlines()
    assert last.startswith("INTERRUPTED")
    assert "--resume" in last
    # Only tasks that had started finish; in the pool, perhaps also those that were already in a worker's inbox.
    assert len(finished) in {"serial": [1], "pool": [2, 3, 4]}[kind]
    assert "FAILED" not in out  # what was dropped has not failed
    assert not psutil.wait_procs(workers, timeout=WAIT_S)[1]


def test_first_signal_gives_up_on_long_tasks(program):
    """The tasks are never released, so the program ends only because it gives up on them."""
    p, workers = program("pool", 0.5)
    p.send_signal(signal.SIGINT)
    out, _ = p.communicate(timeout=WAIT_S)
    assert p.returncode == 7
    assert out.startswith("INTERRUPTED")
    assert not psutil.wait_procs(workers, timeout=WAIT_S)[1]


def test_second_signal_ends_at_once(program, tmp_path):
    """Neither do the tasks end nor the time that the first signal leaves them."""
    p, workers = program("pool", FOREVER_S)
    p.send_signal(signal.SIGINT)
    wait_for((tmp_path / "winding-down").exists)
    p.send_signal(signal.SIGINT)
    p.communicate(timeout=WAIT_S)
    assert p.returncode != 7
    assert not psutil.wait_procs(workers, timeout=WAIT_S)[1]


def test_signal_to_the_whole_group_reaches_only_the_parent(program):
    """A Ctrl-C in a terminal goes to all processes of the foreground group."""
    _, workers = program("pool", 0.5)
    assert workers
    assert {os.getpgid(w.pid) for w in workers}.isdisjoint({os.getpgid(0)})


def test_workers_die_with_their_parent(program):
    p, workers = program("pool", FOREVER_S)
    assert len(workers) == 2
    p.kill()
    assert not psutil.wait_procs(workers, timeout=WAIT_S)[1]


def test_handlers_are_put_back():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    for run in (Serial(OBEY), pool()):
        list(run.run(orders(("give", 1))))
        assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_interruption_from_within_raises_interrupted():
    with pytest.raises(Interrupted):
        for _ in Serial(OBEY).run(orders(("give", 1), ("give", 2))):
            os.kill(os.getpid(), signal.SIGINT)


def test_bad_settings_are_refused():
    with pytest.raises(ValueError, match="workers 0"):
        PoolSettings(workers=0)


# ---- the warm pool


@pytest.fixture
def warm():
    opened = WarmPool(OBEY, PoolSettings(workers=2, retries=1))
    yield opened
    opened.close()
    assert_no_children()


def test_a_warm_pool_keeps_its_workers_between_calls(warm):
    warm.start(1)
    pids = [r.value for _ in range(4) for r in warm.run(orders(("pid", None)))]
    assert len(pids) == 4
    assert len(set(pids)) == 1


def test_calls_of_a_warm_pool_may_overlap(warm):
    seen = []
    for outer in warm.run(orders(*[("give", f"outer {k}") for k in range(6)])):
        (inner,) = warm.run(orders(("give", f"inner of {outer.value}")))
        seen += [outer.value, inner.value]
    assert sorted(seen) == sorted([f"outer {k}" for k in range(6)] + [f"inner of outer {k}" for k in range(6)])


def test_what_an_unfinished_call_leaves_is_dropped(warm, tmp_path):
    left = warm.run(orders(("give", 1), ("die_once", str(tmp_path / "flag")), *[("give", 9)] * 10))
    assert next(left).value in (1, 9)  # whichever worker is ready first
    left.close()
    assert [r.value for r in warm.run(orders(("give", 2), ("give", 3)))] in ([2, 3], [3, 2])


def test_a_warm_pool_replaces_a_worker_that_died(warm, tmp_path):
    flag = str(tmp_path / "flag")
    assert [(r.value, r.attempts) for r in warm.run(orders(("die_once", flag)))] == [("second try", 2)]
    (result,) = warm.run(orders(("die", 5)))
    assert result.failure.kind == "crash"
    assert [r.value for r in warm.run(orders(("give", 4)))] == [4]
