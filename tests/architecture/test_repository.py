"""Rules of the tree: no registry addresses, no machine's paths, locked requirements, nothing large."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LARGEST_BYTES = 2 * 1024**2

# Written apart, so that this file does not name what it bans.
BANNED = {
    "a package registry": re.compile(
        "|".join(["pypi" + r"\.org", "pythonhosted" + r"\.org", "download" + r"\.pytorch", "anaconda" + r"\.org"])
        + "|--(?:extra-)?"
        + "index-url[ =]|--"
        + "find-links[ =]"
    ),
    "a machine's path": re.compile(
        "/(?:" + "|".join(["work/(?:main|shared)", "root/", "home/[a-z]+/", "Users/[a-z]+/"]) + ")"
    ),
}


def tracked_files() -> list[Path]:
    """What git tracks; without git (an unpacked archive) there is nothing to check."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode()
    return [ROOT / name for name in sorted(listing.split("\0")) if name and (ROOT / name).is_file()]


def banned_in(text: str) -> list[str]:
    """Return `line: name` for everything banned in a text."""
    return [
        f"line {i}: {what}: {found.group()}"
        for i, line in enumerate(text.splitlines(), 1)
        for what, pattern in BANNED.items()
        if (found := pattern.search(line))
    ]


def test_no_committed_file_names_a_registry_or_a_machine() -> None:
    offenders = {
        str(path.relative_to(ROOT)): found
        for path in tracked_files()
        if (found := banned_in(path.read_bytes().decode("utf-8", "ignore")))
    }
    assert offenders == {}


@pytest.mark.parametrize(
    "text",
    ["https://pypi" + ".org/simple", "pip install --" + "index-url x", "see /" + "work/main/x", "/" + "home/ann/data"],
)
def test_ban_detects_forbidden_calls(text: str) -> None:
    assert banned_in(text)


def test_no_committed_file_is_large() -> None:
    large = [str(p.relative_to(ROOT)) for p in tracked_files() if p.stat().st_size > LARGEST_BYTES]
    assert large == []


def test_there_is_no_lock_file_with_addresses() -> None:
    assert not [p for p in tracked_files() if p.name in {"uv.lock", "poetry.lock", "Pipfile.lock"}]


BLENDER_REQUIREMENTS = ROOT / "src" / "infrablend" / "blender" / "requirements.txt"
LOCKED = [*sorted((ROOT / "requirements").glob("*.txt")), BLENDER_REQUIREMENTS]


@pytest.mark.parametrize("path", LOCKED, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_every_locked_requirement_is_pinned_and_hashed(path: Path) -> None:
    joined = path.read_text("utf-8").replace("\\\n", " ")
    requirements = [line for line in joined.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    assert requirements
    for line in requirements:
        assert re.match(r"[A-Za-z0-9._-]+==\S+", line), line
        assert "--hash=sha256:" in line, line


def test_the_lock_covers_every_dependency_of_the_project() -> None:
    import tomllib

    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wanted = (
        pyproject["project"]["dependencies"]
        + pyproject["dependency-groups"]["dev"]
        + pyproject["build-system"]["requires"]
    )
    locked = set(
        re.findall(r"^([A-Za-z0-9._-]+)==", (ROOT / "requirements" / "project.txt").read_text("utf-8"), re.MULTILINE)
    )
    names = {re.split(r"[<>=!~\[; ]", w)[0].lower().replace("_", "-").replace(".", "-") for w in wanted}
    assert names <= locked, "run `make lock`"


def test_the_environment_of_blender_has_what_the_extra_names() -> None:
    import tomllib

    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wanted = (ROOT / "requirements" / "blender.in").read_text("utf-8").splitlines()
    assert [w for w in wanted if not w.startswith("#")] == pyproject["project"]["optional-dependencies"]["blender"]
    locked = BLENDER_REQUIREMENTS.read_text("utf-8")
    assert re.search(r"^bpy==4\.5\.", locked, re.MULTILINE) and re.search(r"^numpy==1\.26\.", locked, re.MULTILINE)


SCRIPTS = [*sorted((ROOT / "scripts").glob("*.sh")), ROOT / ".ci" / "run"]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.name)
def test_scripts_are_executable_and_parse(script: Path) -> None:
    assert script.stat().st_mode & 0o111
    subprocess.run(["bash", "-n", script], check=True)


def test_every_make_target_is_explained() -> None:
    done = subprocess.run(["make", "-s", "help"], cwd=ROOT, capture_output=True, text=True, check=True)
    for target in ("setup", "demo", "test", "check", "bench", "lock", "clean"):
        assert f"make {target} " in done.stdout


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.blender
def test_the_demo_ends_with_the_path_of_its_picture_alone() -> None:
    done = subprocess.run(
        [ROOT / "scripts" / "demo.sh"],
        cwd=ROOT,
        env={**os.environ, "DEMO_IMAGES": "2", "DEMO_NAME": "demo-test"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == "build/demo-test/contact_sheet.png"
    assert (ROOT / "build" / "demo-test" / "contact_sheet.png").read_bytes().startswith(b"\x89PNG")


def test_actions_are_pinned_by_hash_and_name_their_version() -> None:
    """The tag of an action can be moved to other code, its hash cannot; Dependabot renews both."""
    used = {
        (line.strip(), path.name)
        for path in (ROOT / ".github" / "workflows").glob("*.yml")
        for line in re.findall(r"uses: (.+)", path.read_text("utf-8"))
    }
    assert len(used) > 5
    pinned = [re.fullmatch(r"([\w-]+/[\w-]+)@([0-9a-f]{40}) # (v\d+\.\d+\.\d+)", line) for line, _ in used]
    assert None not in pinned, used
    names = {m[1] for m in pinned if m}
    assert len({m.groups() for m in pinned if m}) == len(names), "an action in two versions"


def test_the_changelog_has_the_headings_that_tools_read() -> None:
    from infrablend import __version__

    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    versions = [re.fullmatch(r"\[(\d+\.\d+\.\d+)\] - \d{4}-\d{2}-\d{2}", h) for h in headings if h != "[Unreleased]"]
    assert headings[0] == "[Unreleased]" and all(versions)
    found = [v[1] for v in versions if v]
    assert found[0] == __version__
    assert found == sorted(found, key=lambda v: tuple(map(int, v.split("."))), reverse=True)
