"""Every exception InfraBlend raises on purpose.

InfraBlendError
 ├─ RecipeError (ValueError)          a recipe that is incomplete or wrong
 ├─ ArgumentError (ValueError)        an argument of the Python interface that is invalid
 ├─ DatasetError (ValueError)         a dataset that cannot be read at all
 │   └─ UnknownFormatError            no reader recognises the folder
 ├─ ModelError (ValueError)           an object model that cannot be found or used
 ├─ OutputError (OSError)             the output folder cannot be used, or the disk is full
 │   ├─ BusyError                     another process is writing the folder
 │   └─ OtherSettingsError            what is to be resumed was started with other settings
 ├─ FetchError (OSError)              a download failed: the network, the server, its certificate
 ├─ StorageError (OSError)            object storage cannot be used: the network, rights, or what it has stored
 ├─ RenderError (RuntimeError)        Blender failed on a frame
 │   └─ WorkerDiedError               a worker process crashed or hung
 ├─ MissingDependencyError (ImportError)   a library or system package is missing
 └─ Interrupted (RuntimeError)        the user stopped the run; finished work is kept

Each message names the place, what was found, what was expected and what to do; the same four parts are attributes.
Trouble with a single item (one bad image, one bad label) is not an exception but a `Problem`; problems are collected
and reported together.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

Severity = Literal["error", "warning"]


@dataclass(frozen=True, order=True)
class Problem:
    """One fault: its place, what was found, what was expected, and what to do.

    `code` is short and stable (`image-truncated`, `box-outside`); reports count problems by code. `where` names the
    file, and the line or field if known.
    """

    where: str
    code: str
    found: str
    expected: str = ""
    todo: str = ""
    severity: Severity = "error"

    def __str__(self) -> str:
        text = f"{self.where}: {self.found}"
        if self.expected:
            text += f"; expected {self.expected}"
        if self.todo:
            text += f". {_as_sentence(self.todo)}"
        return text

    def to_json(self) -> dict[str, str]:
        """Return the problem as a plain dict."""
        return asdict(self)


_PROSE = re.compile(r"(?!(?:infrablend|pip|apt-get)\b)[a-z]+(?:-[a-z]+)*(?=[ ,;:]|$)")
"""A first word that is plain prose: no command, option (`--x`), field (`a.b`, `a_b`) or setting (`a=b`)."""


def _as_sentence(text: str) -> str:
    """Return the text with a capital first letter, unless it starts with something that the user has to type."""
    return text[:1].upper() + text[1:] if _PROSE.match(text) else text


SHOWN_ALIKE = 3


def format_problems(problems: Iterable[Problem]) -> list[str]:
    """Return one line per problem; more than three of the same kind share a line that names three places."""
    alike: dict[Problem, list[Problem]] = {}
    for p in problems:
        alike.setdefault(replace(p, where=""), []).append(p)
    lines = []
    for same in alike.values():
        if len(same) <= SHOWN_ALIKE:
            lines += [str(p) for p in same]
        else:
            places = ", ".join(p.where for p in same[:SHOWN_ALIKE])
            lines.append(str(replace(same[0], where=f"{places} and {len(same) - SHOWN_ALIKE} more")))
    return lines


class InfraBlendError(Exception):
    """Base of all errors raised on purpose, with a readable `message` and all `problems` that were found."""

    def __init__(self, message: str, problems: Iterable[Problem] = ()) -> None:
        self.message = message
        self.problems = tuple(problems)
        super().__init__(message, self.problems)

    def __str__(self) -> str:
        if not self.problems:
            return self.message
        return "\n".join([self.message, *(f"  - {line}" for line in format_problems(self.problems))])

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors are passed between processes: keep them picklable whatever a subclass adds.
        return (type(self), (self.message, self.problems))


class RecipeError(InfraBlendError, ValueError):
    """A recipe that is incomplete or wrong; `problems` names every bad field."""


class ArgumentError(InfraBlendError, ValueError):
    """An argument of the Python interface that is invalid."""


class DatasetError(InfraBlendError, ValueError):
    """A dataset that cannot be read at all."""


class UnknownFormatError(DatasetError):
    """No reader recognises the folder; `problems` says what is in it."""


class ModelError(InfraBlendError, ValueError):
    """An object model that cannot be found, read or used."""


class OutputError(InfraBlendError, OSError):
    """The output folder cannot be used, or writing failed."""


class BusyError(OutputError):
    """Another process is writing the output folder."""


class OtherSettingsError(OutputError):
    """The output folder holds a result that was started with other settings, so it cannot be resumed."""


class StorageError(InfraBlendError, OSError):
    """Object storage cannot be reached, read or written, or does not have what was written to it."""


class FetchError(InfraBlendError, OSError):
    """A download failed: the network, the server or its certificate."""


class RenderError(InfraBlendError, RuntimeError):
    """Blender failed on a frame."""


class WorkerDiedError(RenderError):
    """A worker process crashed or hung, repeatedly, on the same frame."""


class MissingDependencyError(InfraBlendError, ImportError):
    """A library or system package is missing; the message says what to install."""


class Interrupted(InfraBlendError, RuntimeError):  # noqa: N818 - not an error of anybody's
    """The user stopped the run; finished frames are kept, and `--resume` continues."""
