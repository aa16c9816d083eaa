"""Keeps the command line of this call in the records of unfinished folders, so that messages can repeat it."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from infrablend.core.addresses import address_of

COMMAND = "command"
"""Field of a record with the command that wrote it."""

# How a command finishes or replaces what a call of it left. Other commands are not recorded: they write no folder that
# can be finished, or, as `fetch`, might have secrets in an address.
_FLAGS: Mapping[str, str] = {
    "convert": "--overwrite",
    "exclude": "",
    "experiment": "",
    "frames": "--overwrite",
    "generate": "--resume",
    "include": "",
    "merge": "--resume",
    "split": "--overwrite",
    "temperatures": "--overwrite",
    "train": "--resume",
    "world": "",
}
# Flags that decide nothing about the result.
_LEFT_OUT = {"--resume", "--overwrite", "--json", "--plan"}
_typed: ContextVar[tuple[str, ...]] = ContextVar("typed", default=())


@contextlib.contextmanager
def typed_command() -> Iterator[None]:
    """Forget the command line at the end of the block."""
    token = _typed.set(())
    try:
        yield
    finally:
        _typed.reset(token)


def set_typed_command(words: Sequence[str]) -> None:
    """Set the command line: the name of the command and its arguments, without the name of the program."""
    _typed.set(tuple(words))


def command_facts() -> dict[str, dict[str, object]]:
    """Return the part of a record that holds the command line of this call; empty if there is none, as in Python."""
    words = [w for w in _typed.get() if w not in _LEFT_OUT]
    if not words or words[0] not in _FLAGS:
        return {}
    try:
        folder = str(Path.cwd())
        "\n".join([folder, *words]).encode()
    except (OSError, UnicodeEncodeError):  # a folder that was removed, or names that JSON cannot hold
        return {}
    return {COMMAND: {"words": words, "folder": folder}}


def recorded_command(record: Mapping[str, object] | None, root: Path, shard: str | None = None) -> str | None:
    """Return the command that finishes a folder, ready for a shell; None if its record does not hold one.

    Args:
        record: Record of the folder.
        root: What `--out` names, a folder or an address: it may have moved.
        shard: Shard to make instead of the recorded one.
    """
    found = (record or {}).get(COMMAND)
    words = found.get("words") if isinstance(found, Mapping) else None
    folder = found.get("folder") if isinstance(found, Mapping) else None
    if not isinstance(words, list) or not isinstance(folder, str) or not all(isinstance(w, str) for w in words):
        return None
    if not words or words[0] not in _FLAGS:
        return None
    away = not _is_same(Path(folder), Path())
    changed = _with_value(words, "--out", lambda value: _where(Path(folder), value, root, away))
    if shard is not None:
        changed = _with_value(changed, "--shard", lambda value: shard if "/" in value else shard.partition("/")[0])
    flag = [_FLAGS[words[0]]] if _FLAGS[words[0]] else []
    line = shlex.join(["infrablend", *changed, *flag])
    return f"cd {shlex.quote(folder)} && {line}" if away else line


def run_command(record: Mapping[str, Any], recipe: str, data: str, out: str) -> list[str]:
    """Return the words of the command that makes a run with this record, with these names in place of its own."""
    words = ["infrablend", "generate", recipe, "--data", data, "--out", out, "--seed", str(record.get("seed", 0))]
    request = record.get("request") or {}
    reading = request.get("reading", {})
    selection = request.get("selection", {})
    words += reading_words(reading, folders=False)
    words += [w for name in ("limit", "sample") if name in selection for w in (f"--{name}", str(selection[name]))]
    if frames := selection.get("frames"):
        words += ["--frames", ",".join(frames)]
    return words


def reading_words(reading: Mapping[str, Any], *, folders: bool = True) -> list[str]:
    """Return the options that read a dataset like this.

    Args:
        reading: Fields of a `Reading`; those that are missing or empty give no option.
        folders: Whether to name the folder of a table, too.
    """
    words = []
    if splits := reading.get("splits"):
        words += ["--split", ",".join(splits)]
    words += [w for name in ("format", "form") if reading.get(name) for w in (f"--{name}", str(reading[name]))]
    if metadata := reading.get("metadata"):
        words += ["--metadata", str(metadata) if folders else Path(metadata).name]
    return words + [w for name, text in reading.get("options", {}).items() for w in ("--read", f"{name}={text}")]


def _where(folder: Path, value: str, root: Path, away: bool) -> str:
    """Return the value of `--out`, or the place where the folder is now; an address stays if it is now in a folder."""
    if (address := address_of(root)) is not None:
        return address
    if address_of(value) is not None:
        return value
    if _is_same(folder / value, root):
        return value
    return str(root.absolute() if away else root)


def _is_same(a: Path, b: Path) -> bool:
    try:
        return a.samefile(b)
    except OSError:
        return False


def _with_value(words: Sequence[str], option: str, change: Any) -> list[str]:
    """Return the words with the value of an option replaced: `--out X` or `--out=X`."""
    found = list(words)
    for k, word in enumerate(found):
        if word == option and k + 1 < len(found):
            found[k + 1] = change(found[k + 1])
        elif word.startswith(f"{option}="):
            found[k] = f"{option}={change(word.removeprefix(f'{option}='))}"
    return found
