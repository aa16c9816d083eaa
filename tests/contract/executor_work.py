"""Work for executors under test, which worker processes import by its dotted name."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from infrablend.errors import MissingDependencyError, Problem, RenderError


def square(settings):
    """Payload n -> settings['plus'] + n²."""
    return lambda task: settings["plus"] + task.payload**2


def obey(settings):
    """Perform the action of the payload: (verb, argument)."""
    return Obedient()


class Obedient:
    def __call__(self, task):
        verb, argument = task.payload
        return getattr(self, verb)(argument)

    def give(self, value):
        return value

    def sleep(self, seconds):
        time.sleep(seconds)
        return seconds

    def wait_for_release(self, folder_and_number):
        """Announce the start of the task, then wait until the caller creates the file `release`."""
        folder, number = folder_and_number
        Path(folder, f"begun-{number}").touch()
        while not Path(folder, "release").exists():
            time.sleep(0.01)

    def fail(self, text):
        raise ZeroDivisionError(text)

    def fail_ours(self, text):
        raise RenderError(text, [Problem("frame 7", "no-light", "all black", "some light", "look at the lamp")])

    def exit_python(self, code):
        sys.exit(code)

    def unpicklable(self, _):
        return lambda: None

    def die(self, code):
        os._exit(code)

    def killed(self, _):
        os.kill(os.getpid(), signal.SIGKILL)

    def die_once(self, flag):
        """Crash the first time, work the second: `flag` is a path that remembers."""
        if not Path(flag).exists():
            Path(flag).touch()
            os._exit(9)
        return "second try"

    def hang_once(self, flag):
        if not Path(flag).exists():
            Path(flag).touch()
            time.sleep(600)
        return "second try"

    def shout(self, text):
        """As Blender does: past Python's stdout."""
        os.write(1, f"{text}\n".encode())

    def last_words(self, text):
        os.write(2, f"{text}\n".encode())
        os._exit(3)

    def pid(self, _):
        return os.getpid()

    def environment(self, _):
        import cv2

        return os.environ["OMP_NUM_THREADS"], cv2.getNumThreads()

    def bulk(self, size):
        return bytes(size)

    def subprocess(self, pid_file):
        Path(pid_file).write_text(str(subprocess.Popen(["sleep", "600"]).pid))
        time.sleep(600)

    def leave_file_and_die(self, _):
        with tempfile.NamedTemporaryFile(delete=False) as f:
            f.write(b"x")
        sys.stdout.write(f"left {f.name}\n")
        os._exit(1)

    def close(self):
        pass


def _count(path):
    with Path(path).open("a") as f:
        f.write("x")


def raises(settings):
    _count(settings)
    raise MissingDependencyError("bpy is not installed. Install it.", [Problem("here", "no-bpy", "nothing")])


def raises_builtin(settings):
    raise KeyError("no such device")


def dies(settings):
    _count(settings)
    os._exit(11)


not_a_function = 3
