"""Blender's process in every way to start it: same pictures, and clear words when it is old, silent or dies."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.blender.conftest import box_mesh, scene, thing

from infrablend.core.operating_system import CHILD_BYTES
from infrablend.core.render import PlacedScene, RenderResult, place
from infrablend.errors import MissingDependencyError, WorkerDiedError
from infrablend.rendering.engine import programs
from infrablend.rendering.engine.process import BlenderProcess, blender_process
from infrablend.rendering.engine.programs import OFF, VARIABLE, Program, blender_version, candidates, find_blender
from infrablend.rendering.engine.renderer import ATTEMPTS, BlenderRenderer

# A program that takes Blender's options, as far as they are used, and runs the code in the Python of its first line.
PROGRAM = """#!{python}
import sys
if "--version" in sys.argv:
    print("Blender {version}")
    sys.exit()
assert sys.argv[1:3] == ["--background", "--factory-startup"]
code = sys.argv[sys.argv.index("--python-expr") + 1]
{how}
"""
RUN = "exec(code)"
OLD = """
package, server = code.split("\\n")
exec(package)
import socket
from infrablend.core.wire import Wire
wire = Wire(socket.socket(fileno=int(server.rpartition("(")[2].strip(")"))))
wire.send({"protocol": 1, "blender": "3.4.1", "python": "3.10", "numpy": "1.22"})
wire.receive()
"""
SILENT = "print('libGL.so.1: cannot open shared object file'); sys.exit(4)"


def write_program(folder: Path, how: str, name: str = "blender", python: str | Path = sys.executable) -> Path:
    path = folder / name
    version = "3.4.1" if "3.4.1" in how else "4.3.2"
    path.write_text(PROGRAM.format(python=python, how=how, version=version))
    path.chmod(0o755)
    return path


def physical_scene() -> PlacedScene:
    return place(scene([thing(0.1, ior=1.5, emissivity=0.9)], samples=4), [box_mesh()])


@pytest.fixture(scope="module")
def python() -> Path:
    """The Python of the Blender that is found."""
    found = find_blender()
    if not found.is_python:
        pytest.skip("NEEDS a Python with bpy: make setup")
    return found.path


@pytest.fixture(scope="module")
def expected(python: Path) -> RenderResult:
    renderer = BlenderRenderer(blender=str(python))
    try:
        return renderer.render(physical_scene())
    finally:
        renderer.close()


@pytest.fixture
def renderer(python: Path) -> Iterator[BlenderRenderer]:
    made = BlenderRenderer(blender=str(python))
    yield made
    made.close()


@pytest.mark.blender
@pytest.mark.parametrize("way", ["named", "variable", "program"])
def test_every_way_gives_the_same_bytes(
    way: str, python: Path, expected: RenderResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = None
    if way == "named":
        wanted = str(python)
    elif way == "variable":
        monkeypatch.setenv(VARIABLE, str(python))
    else:
        wanted = str(write_program(tmp_path, RUN, python=python))
    renderer = BlenderRenderer(blender=wanted)
    try:
        found = renderer.render(physical_scene())
    finally:
        renderer.close()
    for name in ("radiance", "alpha", "coverage"):
        assert getattr(found, name).tobytes() == getattr(expected, name).tobytes()
    assert found.offset_xy == expected.offset_xy


@pytest.mark.blender
def test_a_killed_blender_is_replaced(renderer: BlenderRenderer, expected: RenderResult) -> None:
    others = len(CHILD_BYTES)
    for _ in range(2):
        found = renderer.render(physical_scene())
        assert found.radiance.tobytes() == expected.radiance.tobytes()
        assert renderer._process is not None
        os.kill(renderer._process._process.pid, signal.SIGKILL)
    assert len(CHILD_BYTES) == others + 1
    renderer.close()
    assert len(CHILD_BYTES) == others


@pytest.mark.blender
def test_a_frame_that_kills_blender_fails_with_its_last_words(
    renderer: BlenderRenderer, python: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deadly = """
exec(code.split("\\n")[0])
from infrablend.blender import server
def die(jobs, job):
    import os
    print("these are my last words", flush=True)
    os.abort()
server.Jobs.render = die
exec(code.split("\\n")[1])
"""
    other = BlenderRenderer(blender=str(write_program(tmp_path, deadly, python=python)))
    with pytest.raises(WorkerDiedError) as caught:
        other.render(physical_scene())
    other.close()
    for words in (f"attempt {ATTEMPTS} of {ATTEMPTS}", "signal 6 SIGABRT", "these are my last words"):
        assert words in caught.value.message
    assert renderer.render(physical_scene()).alpha.any()


@pytest.mark.blender
def test_an_error_within_a_job_leaves_the_server_running(python: Path) -> None:
    with blender_process(Program(python, "a test")) as process:
        with pytest.raises(Exception, match="no_such_job"):
            process.ask("no_such_job")
        assert "CUDA" in process.ask("devices")


@pytest.mark.parametrize(
    ("how", "words"),
    [
        (OLD, ["Blender 3.4", "4.2 to 4.5 can", "infrablend blender install"]),
        ('print("Blender 3.4.1"); sys.exit(3)', ["Blender 3.4.1", "4.2 to 4.5 can"]),
        (SILENT, ["does not start", "exit code 4", "libGL.so.1", "infrablend doctor"]),
    ],
)
def test_a_blender_that_cannot_be_used_says_why(how: str, words: list[str], tmp_path: Path) -> None:
    renderer = BlenderRenderer(blender=str(write_program(tmp_path, how)))
    for _ in range(2):  # the same for the next scene
        with pytest.raises(MissingDependencyError) as caught:
            renderer.render(physical_scene())
    renderer.close()
    assert [w for w in words if w not in caught.value.message] == []


def test_a_blender_without_a_sign_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("infrablend.rendering.engine.process._START_S", 0.5)
    monkeypatch.setattr("infrablend.rendering.engine.process._END_S", 0.1)
    process = BlenderProcess(Program(write_program(tmp_path, "import time; time.sleep(60)"), "a test"))
    with pytest.raises(MissingDependencyError, match=r"gave no sign within 0\.5 s"):
        process.greet()


def test_ways_are_tried_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setattr(programs.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert list(candidates()) == []
    with pytest.raises(MissingDependencyError, match="infrablend blender install"):
        find_blender()
    program = write_program(tmp_path, SILENT)
    assert [p.path for p in candidates()] == [program]
    assert blender_version() == "4.3.2"
    for environment in (tmp_path / "cache" / "blender", tmp_path / "venv-blender"):
        environment.mkdir(parents=True)
        marker = programs.marker_of(environment)
        marker.touch()  # still being installed
        assert environment not in [p.path.parent.parent for p in candidates()]
        marker.write_text("Blender 4.5.0\n")
        assert find_blender().path.parent.parent == environment
    monkeypatch.setenv(VARIABLE, str(program))
    assert [p.path for p in candidates()] == [program]
    monkeypatch.setenv(VARIABLE, OFF)
    assert blender_version() is None
    with pytest.raises(MissingDependencyError, match="switched off"):
        find_blender()
    with pytest.raises(MissingDependencyError, match="no/such is no program"):
        find_blender("no/such")
