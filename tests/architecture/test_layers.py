"""Import rules: layers, and everything but infrablend.blender works without Blender."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "infrablend"

# A finder that comes first and refuses Blender's modules, then an import of every module of the package.
IMPORT_ALL = """
import importlib, importlib.util, pkgutil, sys
class NoBlender:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"bpy", "bmesh", "mathutils", "bpy_extras", "_cycles"}:
            raise ModuleNotFoundError(f"{name} is blocked", name=name)
sys.meta_path.insert(0, NoBlender())
import infrablend
skipped = ["infrablend.blender"]
if importlib.util.find_spec("nicegui") is None:  # an extra
    skipped.append("infrablend.studio.pages")
names = ["infrablend"]
def walk(package):
    for found in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if found.name in skipped or found.name.endswith("__main__"):
            continue
        module = importlib.import_module(found.name)
        names.append(found.name)
        if found.ispkg:
            walk(module)
walk(infrablend)
print(len(names), *sorted(names))
"""


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)


def test_everything_but_the_blender_package_imports_without_bpy() -> None:
    done = run_python(IMPORT_ALL)
    assert done.returncode == 0, done.stderr
    imported = set(done.stdout.split()[1:])
    files = {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
        for path in PACKAGE.rglob("*.py")
        if "blender" not in path.relative_to(PACKAGE).parts and path.name != "__main__.py"
    }
    if find_spec("nicegui") is None:
        files = {name for name in files if not name.startswith("infrablend.studio.pages")}
    assert imported == files


SERVED = {"infrablend.errors", "infrablend.core.wire", "infrablend.thermal.radiometry"}
"""Modules outside `infrablend.blender` that the render server imports; they need NumPy and the standard library."""


def test_the_render_server_needs_little() -> None:
    files = {name: PACKAGE.parent.joinpath(*name.split(".")).with_suffix(".py") for name in SERVED}
    files |= {f"infrablend.blender.{path.stem}": path for path in sorted((PACKAGE / "blender").glob("*.py"))}
    outside, own = set(), set()
    for path in files.values():
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                module = str(node.module)
                names = [f"{module}.{a.name}" if module == "infrablend.blender" else module for a in node.names]
            own |= {n for n in names if n.startswith("infrablend")}
            outside |= {n.partition(".")[0] for n in names if not n.startswith("infrablend")}
    assert own <= files.keys()
    assert outside - sys.stdlib_module_names == {"bpy", "bpy_extras", "mathutils", "numpy"}


def test_import_blocker_works() -> None:
    blocker, _, _ = IMPORT_ALL.partition("import infrablend\n")
    done = run_python(blocker + "import bpy")
    assert done.returncode != 0
    assert "bpy is blocked" in done.stderr


def test_the_import_contracts_hold() -> None:
    done = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


def test_programs_beside_the_package_import_names_that_exist() -> None:
    import importlib

    missing = []
    programs = [p for folder in ("bench", "scripts", "examples") for p in sorted((ROOT / folder).rglob("*.py"))]
    assert programs
    for path in programs:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            # Blender's part is imported by the tests in tests/blender alone.
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("infrablend"):
                continue
            if "blender" in (node.module or "").split("."):
                continue
            for name in node.names:
                try:
                    module = importlib.import_module(node.module or "")
                    if not hasattr(module, name.name):
                        importlib.import_module(f"{node.module}.{name.name}")
                except ImportError as error:
                    missing.append(f"{path.relative_to(ROOT)}:{node.lineno}: {error}")
    assert missing == []


def test_picture_files_are_opened_in_one_place() -> None:
    """`open_picture` refuses pipes, which would wait for ever; buffers may be opened anywhere."""
    opened = {
        path.relative_to(PACKAGE).as_posix()
        for path in sorted(PACKAGE.rglob("*.py"))
        for line in path.read_text("utf-8").splitlines()
        if "Image.open(" in line and not re.search(r"Image\.open\((io\.BytesIO|buffer|file\))", line)
    }
    assert opened == {"formats/pictures/listing.py"}


def test_no_two_modules_share_a_file_name() -> None:
    names = Counter(path.name for path in PACKAGE.rglob("*.py") if path.name != "__init__.py")
    assert [name for name, times in names.items() if times > 1] == []


def test_nothing_outside_the_lab_imports_it() -> None:
    outside = [path for path in PACKAGE.rglob("*.py") if "lab" not in path.relative_to(PACKAGE).parts[:1]]
    imported = {
        path.relative_to(PACKAGE).as_posix()
        for path in outside
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("infrablend.lab")
    }
    assert imported == set()


# Modules that not every system has, folders of Linux, and functions of `os` and `signal` that Windows does not have.
_OF_ONE_SYSTEM = re.compile(
    r"^\s*(import|from) (fcntl|resource|pwd|grp|msvcrt|termios|winreg)\b|/proc/|/dev/shm"
    r"|\bos\.(getuid|geteuid|killpg|fork|setsid|pread|pwrite|statvfs|set_blocking|sched_\w+|O_DIRECTORY|O_NONBLOCK)\b"
    r"|\bpass_fds\b|\bsignal\.(SIGKILL|SIGHUP|SIGUSR1|SIGUSR2|SIGALRM|alarm)\b",
    re.MULTILINE,
)


def test_what_differs_between_systems_is_in_one_module() -> None:
    """Blender's side runs on Linux alone: its process gets a socket by its number, and the cores of its caller."""
    allowed = {"core/operating_system.py", "rendering/engine/process.py"}
    found = [
        f"{path.relative_to(PACKAGE).as_posix()}: {match[0].strip()}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for match in _OF_ONE_SYSTEM.finditer(path.read_text("utf-8"))
        if path.relative_to(PACKAGE).as_posix() not in allowed and path.relative_to(PACKAGE).parts[0] != "blender"
    ]
    assert found == []
