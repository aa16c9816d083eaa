import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from infrablend.pipeline.studies import doctor
from infrablend.pipeline.studies.doctor import Blender, Machine, Trainer, assess
from infrablend.rendering.engine.system_libraries import DEBIAN_PACKAGES, install_command, missing_packages

GOOD = Machine(
    system="Linux",
    architecture="x86_64",
    python=(3, 11, 7),
    blenders=(Blender("bpy in this Python", "4.5.15", {"CUDA": (), "OPTIX": ("A GPU",)}),),
    missing_packages=(),
    cores=2.0,
    memory_bytes=8 * 1024**3,
    free_bytes={"/out": 50 * 1024**3},
    temp_folder="/tmp",
    free_temp_bytes=50 * 1024**3,
    free_shm_bytes=1024**3,
    trainer=Trainer(),
    cache_folder="/cache",
    cache_bytes=1024,
)


def verdict(machine: Machine, name: str) -> doctor.Check:
    return next(c for c in assess(machine).checks if c.name == name)


def test_suitable_machine_gets_no_advice() -> None:
    diagnosis = assess(GOOD)
    assert diagnosis.ok
    assert [c for c in diagnosis.checks if c.status != "ok" or c.todo] == []
    assert verdict(GOOD, "Cycles devices").found == "cpu; optix: A GPU"
    assert json.loads(json.dumps(diagnosis.to_json()))["ok"] is True


@pytest.mark.parametrize(
    ("change", "name", "status", "words"),
    [
        ({"python": (3, 14, 0)}, "Python", "warning", "use Python 3.11 to 3.13"),
        ({"system": "Darwin", "free_shm_bytes": None}, "system", "warning", "only Linux"),
        ({"missing_packages": ("libsm6", "libxt6")}, "system libraries", "warning", "libsm6 libxt6"),
        ({"blenders": ()}, "Blender", "warning", "infrablend blender install"),
        ({"blenders": (Blender("bpy", trouble="no libSM.so.6"),)}, "Blender", "error", "INFRABLEND_BLENDER"),
        ({"memory_bytes": 1024**3}, "memory", "warning", "--workers 1"),
        ({"free_bytes": {"/out": 1024**3}}, "disk", "warning", "--plan"),
        ({"free_bytes": {"/out": 1024}}, "disk", "error", "free some space"),
        ({"free_bytes": {"/out": None}}, "disk", "error", "choose another folder"),
        ({"free_temp_bytes": None}, "temporary folder", "error", "permissions"),
        ({"free_shm_bytes": 1024}, "shared memory", "warning", "--shm-size"),
    ],
)
def test_each_problem_has_a_remedy(change: dict, name: str, status: str, words: str) -> None:
    machine = replace(GOOD, **change)
    check = verdict(machine, name)
    assert check.status == status
    assert words in check.todo
    assert assess(machine).ok == (status != "error")


def test_missing_libraries_stop_a_run_where_blender_does_not_start() -> None:
    machine = replace(GOOD, missing_packages=("libsm6",), blenders=(Blender("bpy", trouble="it ended"),))
    assert verdict(machine, "system libraries").status == "error"


def test_blenders_that_are_not_used_are_listed() -> None:
    others = (Blender("blender on the path", trouble="3.4 cannot be used"), Blender("environment", "4.2.1"))
    found = [c for c in assess(replace(GOOD, blenders=(*GOOD.blenders, *others))).checks if c.name == "other Blender"]
    assert [c.found for c in found] == [
        "blender on the path: 3.4 cannot be used; not used",
        "4.2.1, environment; not used",
    ]


def test_missing_packages_are_debian_names_of_what_does_not_load() -> None:
    assert missing_packages(lambda soname: True, "linux") == ()
    assert missing_packages(lambda soname: soname not in {"libXt.so.6", "libGL.so.1"}, "linux") == ("libgl1", "libxt6")
    assert missing_packages(lambda soname: False, "linux") == tuple(sorted(DEBIAN_PACKAGES))
    assert missing_packages(lambda soname: False, "darwin") == ()
    assert install_command(("libgl1", "libxt6")).endswith(" libgl1 libxt6")


@pytest.mark.blender
def test_this_machine_is_surveyed(tmp_path: Path) -> None:
    machine = doctor.survey(tmp_path / "not" / "there")
    assert machine.python == sys.version_info[:3]
    assert machine.blenders[0].version is not None
    assert machine.free_bytes[str(tmp_path / "not" / "there")] > 0
    assert set(machine.blenders[0].devices) >= {"CUDA", "OPTIX"}


NOT_INSTALLED = 'not installed: make train, or pip install "infrablend[train]"'


@pytest.mark.parametrize(
    ("trainer", "status", "torch", "ultralytics"),
    [
        (Trainer(), "ok", NOT_INSTALLED, NOT_INSTALLED),
        (Trainer("2.9.0", "8.4.1"), "ok", "2.9.0, no CUDA device", "8.4.1"),
        (Trainer("2.9.0", "8.4.1", ("An H100",)), "ok", "2.9.0, CUDA devices: An H100", "8.4.1"),
        (Trainer("2.9.0", trouble="no answer within 60 s"), "warning", "no answer within 60 s", NOT_INSTALLED),
    ],
)
def test_versions_of_torch_and_ultralytics_are_reported(
    trainer: Trainer, status: str, torch: str, ultralytics: str
) -> None:
    machine = replace(GOOD, trainer=trainer)
    assert verdict(machine, "torch").status == status and torch in verdict(machine, "torch").found
    assert (verdict(machine, "Ultralytics").status, verdict(machine, "Ultralytics").found) == ("ok", ultralytics)
    assert assess(machine).ok


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ('print(\'{"devices": ["A GPU"]}\')', Trainer("1.2", "1.2", ("A GPU",))),
        ("raise ImportError('libcuda')", Trainer("1.2", "1.2", trouble="ImportError: libcuda")),
        ("import time; time.sleep(60)", Trainer("1.2", "1.2", trouble="no answer within 5 s")),
    ],
)
def test_torch_is_asked_in_a_process_of_its_own(code: str, found: Trainer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_ASK_TORCH", code)
    monkeypatch.setattr(doctor, "installed_version", lambda package: "1.2")
    assert doctor._ask_trainer(5.0) == found


def test_a_large_cache_is_named_with_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path))
    (tmp_path / "pictures/a").mkdir(parents=True)
    (tmp_path / "pictures/a/1.png").write_bytes(b"x" * 1000)
    (tmp_path / "2.npz").write_bytes(b"x" * 24)
    assert doctor._bytes_in(tmp_path) == 1024
    assert doctor._bytes_in(tmp_path / "none") == 0
    small = replace(GOOD, cache_folder=str(tmp_path), cache_bytes=1024)
    (check,) = [c for c in doctor.assess(small).checks if c.name == "cache"]
    assert (check.status, check.todo) == ("ok", "") and str(tmp_path) in check.found
    large = replace(small, cache_bytes=11 * 1024**3)
    (check,) = [c for c in doctor.assess(large).checks if c.name == "cache"]
    assert check.status == "warning" and "11.0 GiB" in check.found and "delete" in check.todo
