"""Every error can be pickled without loss, and is also the builtin error that a caller would expect."""

from __future__ import annotations

import importlib
import inspect
import pickle
import pkgutil

import pytest

import infrablend
from infrablend import errors
from infrablend.errors import InfraBlendError, Problem

# Blender's part, and pages that need the extra NiceGUI; neither defines an error.
NOT_IMPORTED = ("infrablend.blender", "infrablend.studio.pages")
PROBLEMS = (Problem("a.json:3", "box-outside", "a box at -4", "boxes inside the frame", "mend the file"),)


def all_error_classes() -> list[type[InfraBlendError]]:
    """Return all subclasses after importing the package, except its Blender part."""
    for found in pkgutil.walk_packages(infrablend.__path__, "infrablend."):
        if not found.name.startswith(NOT_IMPORTED) and not found.name.endswith("__main__"):
            importlib.import_module(found.name)
    classes, queue = [], [InfraBlendError]
    while queue:
        cls = queue.pop()
        classes.append(cls)
        queue += cls.__subclasses__()
    return sorted(set(classes), key=lambda c: (c.__module__, c.__qualname__))


def test_errors_pickle() -> None:
    for cls in all_error_classes():
        error = cls("nothing works", PROBLEMS)
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is cls
        assert again.problems == PROBLEMS
        assert str(again) == str(error)
        assert "a.json:3: a box at -4; expected boxes inside the frame. Mend the file" in str(again)


def test_the_tree_at_the_top_of_errors_is_the_tree() -> None:
    drawn = errors.__doc__ or ""
    for name, cls in inspect.getmembers(errors, inspect.isclass):
        if issubclass(cls, InfraBlendError):
            assert name in drawn, f"draw {name} in the docstring of errors.py"


@pytest.mark.parametrize(
    ("todo", "shown"),
    [
        ("mend the file", "Mend the file"),
        ("remove it, or set x", "Remove it, or set x"),
        ("re-encode the picture", "Re-encode the picture"),
        ("infrablend split makes splits", "infrablend split makes splits"),
        ("--read unlabelled=drop leaves them out", "--read unlabelled=drop leaves them out"),
        ("noise=keep", "noise=keep"),
        ("appearance.mode decides it", "appearance.mode decides it"),
        ("frame_offset=1", "frame_offset=1"),
    ],
)
def test_a_remedy_starts_with_a_capital_unless_it_starts_with_something_to_type(todo: str, shown: str) -> None:
    assert str(Problem("a.json", "code", "found", "expected", todo)) == f"a.json: found; expected expected. {shown}"
