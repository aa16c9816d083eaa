"""The command line: arguments passed to the API (a stand-in here), messages, exit codes."""

import errno
import inspect
import io
import json
import os
import signal
import subprocess
import sys
import time
import types
from pathlib import Path

import pytest
from rich.console import Console

import infrablend
from infrablend import api as real_api
from infrablend import errors
from infrablend.assets.catalogue import load_model
from infrablend.cli import main
from infrablend.cli.call_state import LOG_SIZE_BYTES, Session
from infrablend.cli.exits import exit_code
from infrablend.cli.output import LineProgress, facts, human_bytes, progress_line, shown_progress, table
from infrablend.core.tasks import Progress
from infrablend.errors import Problem
from infrablend.formats.read_write import Reading
from infrablend.lab.world.world_frames import Survey
from infrablend.pipeline.plans.add_model import ModelAnswers
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.selection import FrameSelection
from infrablend.pipeline.runs.run import RunReport
from infrablend.pipeline.studies.doctor import Check, Diagnosis
from infrablend.report.figures import human_seconds


class Plan:
    ok = True

    def to_json(self):
        return {"frames": 3738, "disk_bytes": 3 * 2**30, "estimated_s": 400.0, "formats": ["coco", "yolo"]}


class FakeApi:
    """Takes the place of the functions of the API and records calls; `answers[name]` is returned, raised, or called.

    A call that does not fit the real function is an error.
    """

    def __init__(self, monkeypatch):
        self.calls = {}
        self.answers = {"plan": Plan(), "list_models": {}, "list_recipes": {}}
        for name in real_api.__all__:
            if name[0].islower():
                monkeypatch.setattr(real_api, name, self._stand_in(name, getattr(real_api, name)))

    def _stand_in(self, name, real):
        def call(*args, **kwargs):
            inspect.signature(real).bind(*args, **kwargs)
            self.calls[name] = (args, kwargs)
            answer = self.answers.get(name, Path("made") / name)
            if isinstance(answer, BaseException):
                raise answer
            return answer(*args, **kwargs) if inspect.isfunction(answer) else answer

        return call


@pytest.fixture
def api(monkeypatch):
    fake = FakeApi(monkeypatch)
    fake.answers["describe_model"] = load_model("drone")
    fake.answers["generate"] = RunReport(Path("runs/a"), {"inserted": 8, "skipped": 0})
    return fake


@pytest.fixture(autouse=True)
def log_path(monkeypatch, tmp_path):
    path = tmp_path / "state" / "log.txt"
    monkeypatch.setenv("INFRABLEND_LOG", str(path))
    monkeypatch.setenv("NO_COLOR", "1")
    return path


GENERATE = ["generate", "hit-uav-drone", "--data", "in", "--out", "runs/a"]


def test_generate_passes_its_options_on(api, capsys):
    options = "--limit 5 --split test,train --seed 0 --workers 2 --device cpu --to coco,yolo-obb"
    options += " --format hit-uav --form rotate_json"
    sets = ["--set", "output.image=png", "--set", "camera.pitch={fixed_deg: 0}"]
    assert main([*GENERATE, *options.split(), *sets, "--resume"]) == 0
    args, kwargs = api.calls["generate"]
    assert args == ("hit-uav-drone", Path("in"), Path("runs/a"))
    assert callable(kwargs.pop("on_progress"))
    assert kwargs == {
        "selection": FrameSelection(limit=5),
        "seed": 0,
        "settings": ["output.image=png", "camera.pitch={fixed_deg: 0}", "output.formats=[coco, yolo-obb]"],
        "reading": Reading(("test", "train"), "hit-uav", "rotate_json"),
        "execution": Execution(2, "cpu"),
        "existing": "resume",
    }
    assert type(kwargs["execution"].device) is str
    assert capsys.readouterr().out.splitlines() == ["inserted  8", "skipped   0", "runs/a"]


def test_generate_defaults(api):
    assert main(GENERATE) == 0
    kwargs = api.calls["generate"][1]
    del kwargs["on_progress"]
    assert kwargs == {"selection": FrameSelection(), "seed": 0, "settings": [], "existing": "refuse",
                      "reading": Reading(), "execution": Execution()}  # fmt: skip


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (["--resume", "--overwrite"], "exclude each other"),
        (["--split", "trian"], "trian: no such split; choose from train,val,test"),
        (["--to", "coco,,yolo"], "empty item"),
        (["--format", "coco,yolo"], "--to lists the formats to write"),
        (["--device", "gpu"], "'gpu' is not one of"),
        (["--limit", "0"], "--limit"),
        (["--no-such"], "No such option"),
    ],
)
def test_wrong_usage_is_code_2_and_calls_nothing(api, capsys, extra, words):
    assert main([*GENERATE, *extra]) == 2
    out, err = capsys.readouterr()
    assert words in " ".join(err.split())
    assert out == ""
    assert api.calls == {}


def test_plan_writes_nothing(api, capsys):
    assert main([*GENERATE, "--plan"]) == 0
    assert list(api.calls) == ["plan"]
    shown = {"frames": "3738", "disk": "3.0 GiB", "estimated": "6 min 40 s", "formats": "coco, yolo"}
    assert capsys.readouterr().out == f"{table(shown)}\n"
    main([*GENERATE, "--plan", "--json"])
    assert json.loads(capsys.readouterr().out)["frames"] == 3738


def test_plan_shows_its_warnings(api, capsys, monkeypatch):
    given = {**Plan().to_json(), "warnings": [f"objects.{n}.group: no effect" for n in range(7)]}
    monkeypatch.setattr(Plan, "to_json", lambda plan: dict(given))
    assert main([*GENERATE, "--plan"]) == 0
    out, err = capsys.readouterr()
    assert "warnings" not in out and err.startswith("7 warning(s):\n  - objects.0.group: no effect\n")
    assert "... and 2 more, all with --json" in err
    main([*GENERATE, "--plan", "--json"])
    assert json.loads(capsys.readouterr().out)["warnings"] == given["warnings"]


def test_skipped_items_are_named_and_give_exit_code_1(api, capsys):
    problems = [Problem(f"bg{i}.jpg", "image-truncated", "only 9 bytes") for i in range(23)]
    problems.append(Problem("bg99.jpg", "size", "a warning", severity="warning"))
    api.answers["generate"] = RunReport(Path("runs/a"), {"inserted": 1, "skipped_backgrounds": 23}, tuple(problems))
    assert main([*GENERATE, "--json"]) == 1
    out, err = capsys.readouterr()
    assert json.loads(out)["counts"] == {"inserted": 1, "skipped_backgrounds": 23}
    assert "23 problem(s)" in err
    assert "  - bg0.jpg, bg1.jpg, bg2.jpg and 20 more: only 9 bytes\n  each by name in " in err
    assert "1 warning(s)" in err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (errors.RecipeError("bad"), 2),
        (errors.UnknownFormatError("bad"), 2),
        (errors.ModelError("bad"), 2),
        (errors.OutputError("bad"), 2),
        (errors.RenderError("bad"), 3),
        (errors.WorkerDiedError("bad"), 3),
        (errors.MissingDependencyError("bad"), 3),
        (errors.Interrupted("bad"), 130),
        (KeyboardInterrupt(), 130),
        (ZeroDivisionError("bad"), 70),
    ],
)
def test_exit_codes(api, capsys, error, code):
    api.answers["generate"] = error
    assert main(GENERATE) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    assert err.strip()


def test_full_disk_is_the_environment():
    error = errors.OutputError("no room")
    error.__cause__ = OSError(28, "No space left on device")
    assert exit_code(error) == 3


def test_every_error_of_ours_has_a_code():
    for kind in vars(errors).values():
        if isinstance(kind, type) and issubclass(kind, errors.InfraBlendError):
            assert exit_code(kind("x")) in {2, 3, 130}


def test_first_20_problems_are_shown_and_all_are_logged(api, capsys, log_path):
    problems = [Problem(f"recipe: field{i:02}", "range", f"{i + 2} is too big", "at most 1") for i in range(27)]
    api.answers["generate"] = errors.RecipeError("The recipe has 27 bad fields.", problems)
    assert main(GENERATE) == 2
    err = capsys.readouterr().err
    assert err.startswith(
        "Error: The recipe has 27 bad fields.\n  - recipe: field00: 2 is too big; expected at most 1\n"
    )
    assert "field19" in err
    assert "field20" not in err
    assert f"... and 7 more; all of them in {log_path}" in err
    assert "field26" in log_path.read_text()


def test_the_same_problem_in_many_places_is_one_line_on_screen_and_each_in_the_log(api, capsys, log_path):
    problems = [Problem(f"{i:02}.jpg", "no-pitch", "no camera pitch known", "a pitch") for i in range(35)]
    api.answers["generate"] = errors.DatasetError("no usable background", [*problems, Problem("a.csv", "c", "odd")])
    assert main(GENERATE) == 2
    err = capsys.readouterr().err
    assert "  - 00.jpg, 01.jpg, 02.jpg and 32 more: no camera pitch known; expected a pitch\n  - a.csv: odd\n" in err
    assert f"  each by name in {log_path}" in err
    assert "34.jpg: no camera pitch known" in log_path.read_text()
    assert errors.format_problems(problems[:3]) == [str(p) for p in problems[:3]]


def test_errors_as_json(api, capsys):
    api.answers["generate"] = errors.RecipeError("bad", [Problem("w", "c", "f")])
    assert main([*GENERATE, "--json"]) == 2
    told = json.loads(capsys.readouterr().out)
    assert (told["error"], told["message"], told["exit_code"]) == ("RecipeError", "bad", 2)
    assert told["problems"][0]["code"] == "c"


def test_internal_error_shows_one_line_and_logs_the_traceback(api, capsys, log_path):
    api.answers["generate"] = lambda *a, **k: 1 // 0
    assert main(GENERATE) == 70
    err = capsys.readouterr().err
    assert "ZeroDivisionError" in err
    assert str(log_path) in err
    assert len(err.splitlines()) <= 3
    assert "Traceback" in log_path.read_text()


def test_sigterm_ends_as_ctrl_c_does_and_the_handler_goes(api):
    before = signal.getsignal(signal.SIGTERM)
    api.answers["generate"] = lambda *a, **k: os.kill(os.getpid(), signal.SIGTERM)
    assert main(GENERATE) == 130
    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_errors_in_place_of_a_stop_are_no_bugs(api, capsys, log_path, number):
    def masked(*a, **k):
        try:
            os.kill(os.getpid(), number)
            time.sleep(10)  # the signal ends it
        except KeyboardInterrupt:  # as compiled code does
            raise ValueError("invalid box") from None

    # Ctrl-C is ignored where the tests run in the background of a shell.
    inherited = signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    before = signal.getsignal(number)
    api.answers["generate"] = masked
    try:
        assert main(GENERATE) == 130
    finally:
        kept = signal.signal(number, inherited)
    assert kept == before
    assert "bug" not in capsys.readouterr().err
    assert "invalid box" in log_path.read_text()
    api.answers["generate"] = lambda *a, **k: 1 // 0
    assert main(GENERATE) == 70  # the next command of the process was not stopped


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (OSError(errno.EIO, "Input/output error", "out/run.json"), 3, "cannot write out/run.json"),
        *(
            (OSError(n, os.strerror(n), "data/train"), 2, f"data/train: cannot be used ({os.strerror(n)})")
            for n in (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG)
        ),
        (PermissionError(errno.EPERM, "Operation not permitted"), 70, "bug"),  # it names no path
    ],
)
def test_disks_that_fail_and_paths_that_are_refused_are_no_bugs(api, capsys, log_path, error, code, words):
    api.answers["generate"] = error
    assert main(GENERATE) == code
    err = capsys.readouterr().err
    assert words in err and ("bug" in err) == (code == 70)
    assert "Traceback" in log_path.read_text()


def test_settings_of_an_experiment_that_are_not_yaml_are_named(capsys):
    assert main(["experiment", "pitch-alignment", "--plan", "--set", "passes=[1"]) == 2
    err = capsys.readouterr().err
    assert "--set" in err and "passes=[1" in err and "bug" not in err


def test_warnings_of_the_run_reach_stderr_not_stdout(api, capsys):
    import logging

    def noisy(*a, **k):
        logging.getLogger("infrablend.pipeline").warning("worker 3 was replaced [yes]")
        logging.getLogger("infrablend.pipeline").info("too much detail")
        return RunReport(Path("runs/a"), {})

    api.answers["generate"] = noisy
    handlers_before = list(logging.getLogger().handlers)
    assert main(GENERATE) == 0
    out, err = capsys.readouterr()
    assert err == "WARNING: worker 3 was replaced [yes]\n"
    assert out.strip() == "runs/a"
    main(["-v", *GENERATE])
    assert "too much detail" in capsys.readouterr().err
    assert logging.getLogger().handlers == handlers_before


@pytest.mark.parametrize(
    ("argv", "name", "args"),
    [
        (["preview", "r"], "preview", (Path("r"), Path("r/preview.png"), 12, ("boxes", "obb", "masks"))),
        (["preview", "r", "--obb", "--count=3", "--out=p.png"], "preview", (Path("r"), Path("p.png"), 3, ("obb",))),
        (["rerender", "r", "test/a_c1"], "rerender", (Path("r"), "test/a_c1", None)),
        (["models", "show", "my/deer.yaml"], "show_model", ("my/deer.yaml", Path("deer.png"))),
        (["asset", "infrared-effect", "--out", "x.blend"], "write_infrared_effect", (Path("x.blend"),)),
    ],
)
def test_small_commands_print_the_path_they_made(api, capsys, argv, name, args):
    assert main(argv) == 0
    assert api.calls[name][0] == args
    assert capsys.readouterr().out == f"made/{name}\n"


def test_models_show_takes_options_of_the_model(api, capsys):
    words = ["--option", "pose=standing", "--option", "shoulder_height_m=[0.7, 0.8]"]
    assert main(["models", "show", "boar", *words]) == 0
    assert api.calls["show_model"][1] == {"options": {"pose": "standing", "shoulder_height_m": [0.7, 0.8]}}
    assert main(["models", "show", "boar", "--option", "pose"]) == 2
    assert "write KEY=VALUE" in capsys.readouterr().err


def test_models_add_passes_the_answers_and_asks_on_a_terminal(api, capsys, monkeypatch):
    api.answers["add_model"] = Path("o/q.yaml")
    api.answers["show_model"] = Path("o/q.png")
    argv = ["models", "add", "q.glb", "--out", "o", "--part", "A=motor"]
    assert main([*argv, "--category", "drone", "--size-m", "0.4"]) == 0
    assert capsys.readouterr().out == "o/q.yaml\no/q.png\n"
    args, _ = api.calls["add_model"]
    assert args == (Path("q.glb"), ModelAnswers("drone", 0.4, {"A": "motor"}), Path("o"))
    assert api.calls["show_model"][0] == ("o/q.yaml", Path("o/q.png"))
    assert main([*argv, "--up", "-z"]) == 0
    assert api.calls["add_model"][0][1] == ModelAnswers(parts={"A": "motor"}, up="-z")

    api.answers["survey_model"] = types.SimpleNamespace(file_size=(4.0, 2.0, 1.0), unknown_parts=["B"])
    typed = iter(["drone", 0.3, "sponge", "wood"])
    monkeypatch.setattr("typer.prompt", lambda *_, **__: next(typed))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    assert main(argv) == 0
    assert api.calls["add_model"][0][1] == ModelAnswers("drone", 0.3, {"A": "motor", "B": "wood"})


def test_lists(api, capsys):
    api.answers["list_models"] = {"deer": "A deer.", "drone": "A quadrotor."}
    api.answers["show_recipe"] = "name: x\n"
    assert main(["models", "list"]) == 0
    assert capsys.readouterr().out == "deer   A deer.\ndrone  A quadrotor.\n"
    assert main(["recipes", "show", "x"]) == 0
    assert capsys.readouterr().out == "name: x\n"
    assert main(["recipes", "list"]) == 0 and "list_recipes" in api.calls


def test_world(api, capsys):
    assert main(["world", "--out", "w", "--count", "4", "--seed", "7"]) == 0
    args, kwargs = api.calls["make_world"]
    assert args == (Path("w"), 4, 7)
    assert callable(kwargs.pop("on_progress"))
    assert kwargs == {"layout": "hit-uav", "survey": None, "engine": "blender", "workers": None, "overwrite": False}
    assert main(["world", "--out", "w", "--layout", "monet", "--engine", "lattice"]) == 0
    assert api.calls["make_world"][1]["layout"] == "monet"
    assert api.calls["make_world"][1]["engine"] == "lattice"
    survey = ["--layout", "flight", "--overlap", "0.7", "--yaw-error", "10", "--walking"]
    assert main(["world", "--out", "w", *survey]) == 0
    assert api.calls["make_world"][1]["survey"] == Survey(0.7, 10.0, walking=True)
    assert main(["world", "--out", "w", "--walking"]) == 2
    assert "--overlap 0.7" in capsys.readouterr().err


def test_asset_wants_a_blend_file(api, capsys):
    assert main(["asset", "infrared-effect", "--out", "x.png"]) == 2
    assert ".blend" in capsys.readouterr().err


def test_doctor(api, capsys):
    api.answers["diagnose"] = Diagnosis(
        (Check("bpy", "ok", "4.5.15"), Check("libX11", "error", "missing", "apt-get install libx11-6"))
    )
    assert main(["doctor"]) == 3
    out = capsys.readouterr().out
    assert "error    libX11  missing" in out
    assert "-> libX11: apt-get install libx11-6" in out
    assert main(["doctor", "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["checks"][0]["found"] == "4.5.15"


def test_version_and_help(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"infrablend {infrablend.__version__}\n"
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(c in out for c in ("generate", "preview", "rerender", "models", "recipes", "world", "doctor", "asset"))
    assert "130" in out


def test_help_imports_no_heavy_package():
    """`--version` and `--help` must not wait for numpy or Blender."""
    code = (
        "import sys; from infrablend.cli import main; main(['--help']); "
        "sys.exit(sorted({'numpy', 'bpy', 'cv2', 'PIL', 'pydantic'} & set(sys.modules)).__repr__().strip('[]') or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shell_completion_is_offered(shell):
    done = subprocess.run(
        [sys.executable, "-m", "infrablend"],
        env=os.environ
        | {"_INFRABLEND_COMPLETE": f"source_{shell}", "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and "_INFRABLEND_COMPLETE" in done.stdout, done.stderr


def test_python_m_infrablend():
    done = subprocess.run([sys.executable, "-m", "infrablend", "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"infrablend {infrablend.__version__}\n")


# ---- the log file


def test_log_option_and_unusable_log(api, capsys, tmp_path, monkeypatch):
    assert main(["--log", str(tmp_path / "own.log"), *GENERATE]) == 0
    assert "infrablend" in (tmp_path / "own.log").read_text()
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["--log", str(blocked / "x.log"), *GENERATE]) == 0
    assert list(tmp_path.glob("infrablend-*.log"))


def test_long_log_is_rotated(api, log_path):
    log_path.parent.mkdir()
    log_path.write_bytes(b"2026-01-01 " + b"x" * LOG_SIZE_BYTES)
    main(GENERATE)
    assert log_path.stat().st_size < 10_000
    assert log_path.with_name("log.txt.1").stat().st_size > LOG_SIZE_BYTES


# ---- progress


def test_progress_line():
    line = progress_line(Progress(120, 3738, 9.8, 369.2, {"inserted": 118, "skipped": 2, "failed": 0}))
    assert line == "120/3738 frames, 9.8 frames/s, 6 min 09 s to go, inserted 118, skipped 2, failed 0"
    assert progress_line(Progress(0, 5)) == "0/5 frames"
    assert progress_line(Progress(2, 5, 0.5), "objects") == "2/5 objects, 30.0 objects/min"
    assert progress_line(Progress.since(time.monotonic(), 1, 5, {"inserted": 1})) == "1/5 frames, inserted 1"
    assert Progress.since(time.monotonic() - 2, 10, 30).frames_per_s == pytest.approx(5, rel=0.5)
    assert progress_line(Progress(2, 5, 0.07, 43.0)) == "2/5 frames, 4.2 frames/min, 43.0 s to go"


def test_lines_come_every_few_seconds_and_at_the_end_once():
    now = 100.0
    lines = []
    show = LineProgress(lines.append, clock=lambda: now)
    for done in range(1, 31):
        now += 0.5
        show(Progress(done, 30))
    show(Progress(30, 30))
    assert [line.split()[0] for line in lines] == ["1/30", "11/30", "21/30", "30/30"]


def test_live_bar_on_a_terminal():
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=120, color_system=None)
    with shown_progress(Session(console, None), "generating") as show:
        show(Progress(3, 10, 2.5, 2.8, {"inserted": 3, "skipped": 1}))
    text = screen.getvalue()
    for part in ("generating", "3/10", "2.5 frames/s", "2.8 s to go", "inserted 3", "skipped 1"):
        assert part in text


def test_quiet_shows_nothing(api):
    main(["-q", *GENERATE])
    assert api.calls["generate"][1]["on_progress"] is None


# ---- texts


def test_readable_units():
    assert [human_bytes(n) for n in (0, 1023, 1536, 5 * 2**40)] == ["0 B", "1023 B", "1.5 KiB", "5.0 TiB"]
    assert [human_seconds(s) for s in (0.04, 59.94, 185, 7800)] == ["0.0 s", "59.9 s", "3 min 05 s", "2 h 10 min"]


def test_facts_read_units_from_names():
    given = {"a_b": 1, "free_bytes": 2048, "took_s": 3.0, "none": None, "empty": {}, "zero": 0, "on": True}
    shown = {"a b": "1", "free": "2.0 KiB", "took": "3.0 s", "zero": "0", "on": "yes"}
    assert facts(given | {"m": {"x": 1, "y": 2}}) == shown | {"m": "x 1, y 2"}
    per_split = {"test": {"Car": 4, "Person": 2}, "train": {"Car": 7}, "val": {}}
    assert facts({"labels_per_split": per_split}) == {
        "labels per split": "test: Car 4, Person 2; train: Car 7; val: none"
    }
    assert facts({"frames_per_s": 9.5, "rows": [{}] * 3}) == {"frames per s": "9.5", "rows": "3"}


def test_a_model_is_described_by_its_options_and_parts(capsys):
    assert main(["models", "describe", "drone"]) == 0
    shown = capsys.readouterr().out
    assert any(line.split()[:3] == ["layout", "one", "of"] for line in shown.splitlines())
    for part in ("motor", "battery"):
        assert any(line.startswith(part + " ") and " K, " in line for line in shown.splitlines())
