"""Run one command of the command line in a process of its own that can be killed, disturbed, limited and watched.

The process is forked from the caller, which has imported everything already, so an attempt costs milliseconds. An audit
hook sees each file that the command opens for writing, renames, links or deletes: it kills or disturbs the process at
the n-th of them, and notes those outside the folders that the command may write to.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer.main

from infrablend.cli import app, main
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.pipeline.plans.run_request import Execution
from tests.flat_renderer import flat_defaults

KILLED = -signal.SIGKILL
TIMED_OUT = -1000
TIME_LIMIT_S = 150
CPU_LIMIT_S = 60
MEMORY_BYTES = 3 << 30

_CREATES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
# Events of the audit hook, with the arguments that are paths and those that are descriptors of their folders.
_CHANGES: dict[str, tuple[tuple[int, int | None], ...]] = {
    "os.rename": ((0, 2), (1, 3)),
    "os.link": ((1, 3),),
    "os.symlink": ((1, 2),),
    "os.remove": ((0, 1),),
    "os.rmdir": ((0, 1),),
    "os.mkdir": ((0, 2),),
    "os.truncate": ((0, None),),
    "os.chmod": ((0, 2),),
}

_MODULES = "modules"

Act = Callable[[str, Path], None]
"""Disturbance: called with the event and the path just before the chosen write."""


@dataclass(frozen=True)
class Outcome:
    """End of one or several commands.

    Attributes:
        code: Exit code, of several the worst; negative for a signal, `TIMED_OUT` if it took too long.
        output: Text on stderr, and on stdout.
        log: Lines of the log file.
        outside: Writes outside the allowed folders.
        writes: Number of writes below the watched folder.
        seconds: Wall-clock time.
    """

    code: int
    results: str
    output: str
    log: str
    outside: tuple[str, ...]
    writes: int
    seconds: float

    @property
    def named(self) -> bool:
        """True if the command succeeded, or ended with an error that InfraBlend raises on purpose."""
        return self.code in (0, 1, 2, 3, 130)


@dataclass(frozen=True)
class Disturbance:
    """What happens to a command.

    Attributes:
        at: Number of the write, from 0, before which `act` is called; None for never.
        act: What happens there.
        after_s: Time after which a signal is sent; None for never.
        signal: The signal.
        before: Called in the process before the command starts.
    """

    at: int | None = None
    act: Act | None = None
    after_s: float | None = None
    signal: int = signal.SIGKILL
    before: Callable[[], None] | None = None


UNDISTURBED = Disturbance()


def render_flat() -> None:
    """Compute frames in this process with the flat renderer, which the command line does not offer."""
    setattr(Execution.__init__, "__defaults__", flat_defaults())  # noqa: B010 - no attribute that type checkers know
    check = ExperimentRequest.__post_init__

    def choose_flat(self: ExperimentRequest) -> None:
        object.__setattr__(self, "renderer", "flat")
        check(self)

    ExperimentRequest.__post_init__ = choose_flat  # type: ignore[method-assign]


def kill(event: str, path: Path) -> None:
    """Kill the process, without any clean-up."""
    os.kill(os.getpid(), signal.SIGKILL)


def kill_torn(event: str, path: Path) -> None:
    """Kill the process with the file that is about to be renamed half written."""
    with contextlib.suppress(OSError):
        if event == "os.rename" and path.is_file() and path.stat().st_nlink == 1:
            os.truncate(path, path.stat().st_size // 2)
    kill(event, path)


class Watch:
    """The audit hook's view of one command."""

    def __init__(
        self,
        watched: Path,
        allowed: Sequence[Path],
        forbidden: Sequence[Path],
        disturbance: Disturbance,
        report: Path,
    ) -> None:
        self._watched = os.path.realpath(watched)
        self._forbidden = tuple(os.path.realpath(p) for p in forbidden)
        self._allowed = tuple(os.path.realpath(p) for p in allowed)
        self._disturbance = disturbance
        self._report = os.open(report, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._pid = os.getpid()
        self._busy = False
        self.writes = 0

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Count, disturb or report a write; called by the interpreter for every event."""
        if self._busy or (event != "open" and event not in _CHANGES) or os.getpid() != self._pid:
            return
        self._busy = True
        try:
            paths = self._paths(event, arguments)
            if event == "open" and isinstance(arguments[0], (str, bytes, os.PathLike)):
                real = os.path.realpath(os.fsdecode(arguments[0]))
                if any(_is_below(real, f) for f in self._forbidden):
                    os.write(self._report, os.fsencode(f"read {real!r}\n"))
        except ValueError:  # a path with a zero byte, which the call will refuse
            return
        finally:
            self._busy = False
        for n, path in enumerate(paths):
            if _is_below(path, self._watched):
                if n == 0 or event != "os.rename":
                    self._count(event, path)
            elif not any(_is_below(path, a) for a in self._allowed):
                os.write(self._report, os.fsencode(f"{event} {path!r}\n"))

    def _count(self, event: str, path: str) -> None:
        number, self.writes = self.writes, self.writes + 1
        if number == self._disturbance.at and self._disturbance.act is not None:
            self._busy = True
            try:
                self._disturbance.act(event, Path(path))
            finally:
                self._busy = False

    @staticmethod
    def _paths(event: str, arguments: tuple[Any, ...]) -> list[str]:
        """Return the paths that an event changes, with links in their folders followed."""
        if event == "open":
            name, mode, flags = arguments
            changes = bool((flags or 0) & _CREATES) or (isinstance(mode, str) and any(c in mode for c in "wax+"))
            found = [(name, None)] if changes and not isinstance(name, int) else []
        else:
            pairs = [(arguments[k], d) for k, d in _CHANGES[event] if not isinstance(arguments[k], int)]
            found = [(name, None if d is None else arguments[d]) for name, d in pairs]
        paths = []
        for name, folder in found:
            text = os.fsdecode(name)
            if isinstance(folder, int) and folder >= 0 and not text.startswith("/"):
                text = f"{Path(f'/proc/self/fd/{folder}').readlink()}/{text}"
            parent, _, last = os.path.abspath(text).rpartition("/")  # noqa: PTH100
            # A file that is written through a link is the target; one that is deleted or renamed is the link.
            full = f"{os.path.realpath(parent or '/')}/{last}"
            paths.append(os.path.realpath(full) if event == "open" else full)
        return paths


def _is_below(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder + "/")


def keep_commands() -> None:
    """Build the tree of commands once for all forked processes, which takes longer than most commands."""
    commands = typer.main.get_command(app.build_app())
    app.build_app = lambda: commands  # type: ignore[assignment,return-value]


def fork_command(
    words: Sequence[object],
    lab: Path,
    watched: Path,
    disturbance: Disturbance = UNDISTURBED,
    allowed: Sequence[Path] = (),
    flat: bool = True,
    limit_s: float = TIME_LIMIT_S,
) -> Outcome:
    """Run `infrablend WORDS` in a forked process and return how it ended.

    Args:
        words: Arguments; or the arguments of several commands, as lists.
        lab: Folder for the log, the temporary folder and what the process prints.
        watched: Folder whose writes are counted and disturbed; the command may write there.
        disturbance: What happens to the process.
        allowed: Further folders that the command may write to.
        flat: Render in this process with the flat renderer, which the command line does not offer.
        limit_s: Time limit.
    """
    own = lab / "own"
    (own / "tmp").mkdir(parents=True, exist_ok=True)
    files = {name: own / name for name in ("results", "output", "log", "outside", "writes")}
    for path in files.values():
        path.unlink(missing_ok=True)
    sys.stdout.flush()
    sys.stderr.flush()
    started = time.monotonic()
    child = os.fork()
    if not child:
        code = 99
        try:
            code = _be_child(words, own, files, watched, disturbance, allowed, flat)
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
        finally:
            os._exit(code)
    code = _wait(child, disturbance, limit_s)
    texts = {n: p.read_text("utf-8", errors="replace") if p.is_file() else "" for n, p in files.items()}
    outside = tuple(texts["outside"].splitlines())
    writes = int(texts["writes"] or 0)
    return Outcome(code, texts["results"], texts["output"], texts["log"], outside, writes, time.monotonic() - started)


def _rank(code: int) -> int:
    """Return the order of an exit code: success, errors with a name, anything else."""
    return (0, 1, 2, 3, 130).index(code) if code in (0, 1, 2, 3, 130) else 1000


def import_what_it_imported(lab: Path) -> None:
    """Import what the last undisturbed command in a lab imported, so that processes forked from now on need not."""
    path = lab / "own" / _MODULES
    for name in path.read_text().split("\n") if path.is_file() else ():
        if name not in sys.modules and name != "__main__":
            with contextlib.suppress(Exception), contextlib.redirect_stdout(sys.stderr):
                importlib.import_module(name)


def _be_child(
    words: Sequence[object],
    own: Path,
    files: dict[str, Path],
    watched: Path,
    disturbance: Disturbance,
    allowed: Sequence[Path],
    flat: bool,
) -> int:
    os.setsid()
    stops = {signal.SIGINT, signal.SIGTERM}
    signal.pthread_sigmask(signal.SIG_BLOCK, stops)  # they are for the command, not for what prepares it
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
    handles = (os.open(os.devnull, os.O_RDONLY), os.open(files["results"], flags), os.open(files["output"], flags))
    for target, source in enumerate(handles):
        os.dup2(source, target)
    sys.stdout = os.fdopen(1, "w", errors="backslashreplace", closefd=False)
    sys.stderr = os.fdopen(2, "w", errors="backslashreplace", closefd=False)
    for name, value in {
        "INFRABLEND_LOG": files["log"],
        "TMPDIR": own / "tmp",
        "XDG_CACHE_HOME": own / "cache",
        "XDG_STATE_HOME": own / "state",
        "MPLCONFIGDIR": own / "cache",
    }.items():
        os.environ[name] = str(value)
    import tempfile

    tempfile.tempdir = None
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, resource.RLIM_INFINITY))
    if flat:
        render_flat()
    if disturbance.before is not None:
        disturbance.before()
    kept = (watched, own, Path("/dev"), Path("/proc/self"), *allowed)
    watch = Watch(watched, kept, (own.parent / "canary",), disturbance, files["outside"])
    sys.addaudithook(watch)
    several = words if words and isinstance(words[0], list) else [words]
    code = 0
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, stops)
    except KeyboardInterrupt:
        return 130
    for one in several:
        ended = main([str(w) for w in one])  # type: ignore[attr-defined]
        code = ended if _rank(ended) > _rank(code) else code
        sys.stdout.flush()
        sys.stderr.flush()
    signal.pthread_sigmask(signal.SIG_BLOCK, stops)
    files["writes"].write_text(str(watch.writes))
    (own / _MODULES).write_text("\n".join(sys.modules))
    return code


def _wait(child: int, disturbance: Disturbance, limit_s: float) -> int:
    """Wait for the process, send it its signal, and kill it and its children at the time limit."""
    descriptor = os.pidfd_open(child)
    try:
        waits = select.poll()
        waits.register(descriptor, select.POLLIN)
        ended = False
        if disturbance.after_s is not None:
            ended = bool(waits.poll(1000 * disturbance.after_s))
            if not ended:
                os.kill(child, disturbance.signal)
        late = not ended and not waits.poll(1000 * limit_s)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    finally:
        os.close(descriptor)
    return TIMED_OUT if late or code == -signal.SIGXCPU else code
