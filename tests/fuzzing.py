"""Ways to damage datasets, and a watch for access to files outside them; see test_readers_fuzz.py.

`scripts/fuzz_readers.py` uses the same for hours, outside CI.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import resource
import shutil
import signal
import struct
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.dataset import SPLITS, Dataset
from infrablend.core.files import cache_folder
from infrablend.errors import InfraBlendError
from infrablend.formats import dataset_folder
from infrablend.formats.pictures import derived
from infrablend.formats.read_write import Reading
from infrablend.report.checking import check_dataset, unreadable
from infrablend.report.inspection import inspect_dataset

SECRET = "secret"
Choice = random.Random

WEIRD_JSON: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 2**31, 2**63, 10**400, -1e308, 1e308, 1e-320, 0.5, float("nan"), float("inf"),
    "", "x", "0", "-7", "nan", "1e999", "../../secret/secret.jpg", "/etc/passwd", "a\0b", "\ud800", "..\\..\\x.jpg",
    [], {}, [[]], {"": {}}, [None] * 4, [0] * 8, [1e9] * 8, [float("nan")] * 4, ["a"] * 4, "A" * 5000,
    {"size": [48, 64], "counts": "~~~~"}, {"size": [10**9, 10**9], "counts": "01"},
    {"size": [48, 64], "counts": [9] * 3},
)  # fmt: skip
WEIRD_WORDS = (
    "nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "1e9", "99999999999999999999", "0x10", "1_0", "", "abc", "\0",
    "../../secret/secret.jpg", "/etc/passwd", "..", "&bomb;", "<a>", "]]>", "\u0663", "1e-320", "0.5.5", "ä\u202e",
)  # fmt: skip
WEIRD_NAMES = (
    ".hidden", "a b.txt", "a\nb.jpg", "..\\x.jpg", "%2e%2e", "con.json", "é\u0301.png", "x" * 200 + ".jpg",
    "train.json", "a.JPG", "classes.txt", "data.yaml", "metadata.csv", "metadata.json",
    "no_suffix", "\udc80.txt", "-rf.xml",
)  # fmt: skip


# -- breaking --------------------------------------------------------------------------------------------------


def mutate(root: Path, outside: Path, choose: Choice) -> str:
    """Break one thing below `root`, with links to files in `outside`; return a description."""
    kind = choose.choice(MUTATIONS)
    try:
        return f"{kind.__name__.strip('_')}: {kind(root, outside, choose)}"
    except (OSError, ValueError, IndexError, UnicodeError, RecursionError) as error:  # it is broken too much already
        return f"{kind.__name__.strip('_')}: no more ({error})"


def _files(root: Path, *suffixes: str) -> list[Path]:
    found = (Path(base) / n for base, _, names in os.walk(root) for n in names)
    return sorted(p for p in found if p.is_file() and not p.is_symlink() and (not suffixes or p.suffix in suffixes))


def _folders(root: Path) -> list[Path]:
    return sorted(Path(base) / d for base, names, _ in os.walk(root) for d in names)


def _flip(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root))
    data = bytearray(path.read_bytes())
    for _ in range(choose.randint(1, 20)):
        data[choose.randrange(len(data))] = choose.randrange(256)
    path.write_bytes(data)
    return path.name


def _cut(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root))
    data = path.read_bytes()
    path.write_bytes(data[: choose.choice((0, 1, choose.randrange(len(data) + 1)))])
    return path.name


def _insert(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root))
    data = path.read_bytes()
    at = choose.randrange(len(data) + 1)
    piece = choose.choice(
        (b"\xff\xfe", b"\0" * 9, b"\xef\xbb\xbf", data[: choose.randint(0, 80)], choose.randbytes(30))
    )
    path.write_bytes(data[:at] + piece + data[at:])
    return path.name


def _delete(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root) + _folders(root))
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
    return path.name


def _rename(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root) + _folders(root))
    name = choose.choice((*WEIRD_NAMES, choose.choice(_files(root)).name))
    path.rename(path.with_name(name))
    return f"{path.name} -> {name!r}"


def _link(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root))
    secret = outside / f"{SECRET}{path.suffix}"
    targets = [secret, os.path.relpath(secret, path.parent), path.parent, path, Path("/dev/zero"), Path("nowhere")]
    target = choose.choice(targets)
    path.unlink()
    path.symlink_to(target)
    return f"{path.name} -> {target}"


def _loop(root: Path, outside: Path, choose: Choice) -> str:
    folder = choose.choice([root, *_folders(root)])
    # A folder may be a link to elsewhere (people keep pictures on other disks): only loops are made here.
    targets = (".", str(root), "." if folder == root else "..")
    (folder / choose.choice(("loop", "train", "images"))).symlink_to(choose.choice(targets))
    return folder.name


def _other_kind(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root))
    path.unlink()
    if choose.random() < 0.5:
        path.mkdir()
    else:
        os.mkfifo(path)
    return path.name


def _json_value(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root, ".json"))
    top = json.loads(path.read_text("utf-8"))
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, inner in pairs:
            places.append((value, key))
            walk(inner)

    walk(top)
    holder, key = choose.choice(places)
    what = choose.randrange(4)
    if what == 0:
        del holder[key]
    elif what == 1 and isinstance(holder, list):
        holder.insert(key, holder[key])
    elif what == 2 and isinstance(holder, dict):
        holder[choose.choice(list(holder))] = holder[key]
    else:
        holder[key] = choose.choice(WEIRD_JSON)
    text = json.dumps(top)
    if choose.random() < 0.05:
        text = text.replace(":", ": " + "[" * 900, 1) + "]" * 900
    path.write_text(text, "utf-8")
    return f"{path.name}: {key}"


def _word(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root, ".txt", ".csv", ".xml", ".yaml", ".json"))
    text = path.read_text("utf-8")
    words = list(re.finditer(r"[\w.+-]+", text))
    word = choose.choice(words)
    path.write_text(text[: word.start()] + choose.choice(WEIRD_WORDS) + text[word.end() :], "utf-8")
    return f"{path.name}: {word[0]}"


def _line(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root, ".txt", ".csv", ".xml", ".yaml"))
    lines = path.read_text("utf-8").splitlines(keepends=True)
    n = choose.randrange(len(lines))
    lines[n : n + 1] = choose.choice(([], [lines[n]] * 2, [lines[n].strip()], [lines[n], choose.choice(lines)]))
    path.write_text("".join(lines), "utf-8")
    return path.name


def _bomb(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root, ".xml", ".yaml", ".json"))
    text = path.read_text("utf-8")
    if path.suffix == ".xml":
        secret = (outside / f"{SECRET}.xml").as_uri()
        inside = (
            f'<!ENTITY bomb SYSTEM "{secret}">'
            if choose.random() < 0.5
            else '<!ENTITY a "aaaa"><!ENTITY bomb "&a;&a;">'
        )
        text = f"<!DOCTYPE annotation [{inside}]>" + text.replace("</filename>", "&bomb;</filename>")
    elif path.suffix == ".yaml":
        text += "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
            f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
        )
        text = re.sub(r"names:.*?\n(?=a0)", "", text, flags=re.DOTALL) + "names: *a11\n"
    else:
        text = '{"x":' * 100_000
    path.write_text(text, "utf-8")
    return path.name


def _giant(root: Path, outside: Path, choose: Choice) -> str:
    path = choose.choice(_files(root, ".jpg", ".png"))
    path.write_bytes(with_size(path.read_bytes(), 30_000, 30_000))
    return path.name


def with_size(data: bytes, width: int, height: int) -> bytes:
    """A JPEG's or PNG's bytes whose header claims another size."""
    if data.startswith(b"\x89PNG"):
        import zlib

        header = b"IHDR" + struct.pack(">II", width, height) + data[24:29]
        return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]
    at = data.index(b"\xff\xc0")
    return data[: at + 5] + struct.pack(">HH", height, width) + data[at + 9 :]


MUTATIONS: tuple[Callable[[Path, Path, Choice], str], ...] = (
    _flip, _flip, _cut, _insert, _delete, _rename, _link, _loop, _other_kind, _json_value, _json_value, _json_value,
    _word, _word, _word, _line, _bomb, _giant,
)  # fmt: skip


def make_outside(folder: Path) -> Path:
    """Files that no reader may open: one for every suffix."""
    folder.mkdir(parents=True, exist_ok=True)
    for suffix in (".jpg", ".png", ".bmp", ".tif", ".json", ".txt", ".csv", ".xml", ".yaml", ""):
        (folder / f"{SECRET}{suffix}").write_text("0 0.5 0.5 0.1 0.1\n")
    return folder


# -- watching --------------------------------------------------------------------------------------------------


@dataclass
class _Watch:
    """What the audit hook looks for while it is on; the hook itself can never be removed."""

    forbidden: str = ""
    dataset: str = ""
    seen: list[str] = field(default_factory=list)


_watch = _Watch()
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGING = {"os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate", "os.chmod"}
_LOOKING = {"open", "os.listdir", "os.scandir"}


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _watch.forbidden or (event not in _LOOKING and event not in _CHANGING):
        return
    path = arguments[0]
    if isinstance(path, int) or path is None:
        return
    forbidden, dataset, _watch.forbidden = _watch.forbidden, _watch.dataset, ""  # realpath must not call us again
    try:
        real = os.path.realpath(os.fsdecode(path))
        changes = event in _CHANGING or (event == "open" and bool((arguments[2] or 0) & _WRITING))
        if real.startswith((forbidden, "/etc/passwd", "/dev/zero")) or (changes and real.startswith(dataset)):
            _watch.seen.append(f"{event} {path!r}")
    except (OSError, ValueError):
        pass
    finally:
        _watch.forbidden = forbidden


sys.addaudithook(_hook)


@contextlib.contextmanager
def bounded_memory(size_bytes: int = 2 << 30) -> Iterator[None]:
    """While entered, this process may take so much more memory; beyond, it gets a MemoryError and not the machine."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


class TooSlow(BaseException):
    """Reading took too long; no `except Exception` may swallow it."""


@contextlib.contextmanager
def watched(dataset: Path, outside: Path, seconds: int = 60) -> Iterator[list[str]]:
    """While entered: every file of `outside` opened and every change below `dataset` goes into the list."""

    def late(*_: object) -> None:
        raise TooSlow(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    _watch.seen = []
    _watch.dataset, _watch.forbidden = os.path.realpath(dataset), os.path.realpath(outside)
    try:
        yield _watch.seen
    finally:
        _watch.forbidden = ""
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def exercise(root: Path, name: str) -> None:
    """Detect, read (as detected, and as the format `name`), check and inspect; only our own errors may come out.

    Raises:
        AssertionError: What was read is not what a `Dataset` promises.
    """
    for format in (None, name):
        try:
            dataset = dataset_folder.read(root, Reading(format=format))
        except InfraBlendError as error:
            json.dumps([p.to_json() for p in error.problems])
            str(error).encode("utf-8", "backslashreplace")
            json.dumps(unreadable(root, error).to_json() if hasattr(error, "problems") else "")  # type: ignore[arg-type]
            continue
        assert_sound(dataset, root)
        for decode in (False, True):
            json.dumps(check_dataset(dataset, decode=decode).to_json())
        json.dumps(inspect_dataset(dataset, "fuzzed", decode=True).to_json(), default=str)


def assert_sound(dataset: Dataset, root: Path) -> None:
    """Check the properties that every reader guarantees."""
    real = os.path.realpath(root)
    made = os.path.realpath(cache_folder() / derived.FOLDER)
    names = {c.name for c in dataset.categories}
    assert len({i.id for i in dataset.images}) == len(dataset.images)
    assert list(dataset.images) == sorted(dataset.images, key=lambda i: (SPLITS.index(i.split), i.id))
    for image in dataset.images:
        assert os.path.realpath(image.path).startswith((real, made)), image.path
        assert ".." not in Path(image.name).parts and not Path(image.name).is_absolute()
        assert image.capture.pitch_deg is None or -90 <= image.capture.pitch_deg <= 90
        assert image.capture.time_of_day in (None, "day", "night")
        for o in image.instances:
            x0, y0, x1, y1 = o.box_xyxy
            assert np.isfinite(o.box_xyxy).all() and x0 < x1 and y0 < y1, o
            assert o.corners_xy is None or np.isfinite(o.corners_xy).all(), o
            assert o.category in names, o
            assert o.visibility is None or 0 <= o.visibility <= 1, o
            if image.size_wh is not None:
                assert x0 >= 0 and y0 >= 0 and x1 <= image.size_wh[0] and y1 <= image.size_wh[1], o
            if o.mask is not None and image.size_wh is not None:
                assert o.mask.to_array().shape == (image.size_wh[1], image.size_wh[0])
