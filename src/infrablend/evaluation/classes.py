"""The classes to judge, and which of the detector's classes stand for each of them."""

from __future__ import annotations

from collections.abc import Sequence

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.errors import Problem
from infrablend.evaluation.truth import match_classes


def judged_classes(
    dataset: Dataset,
    images: Sequence[ImageRecord],
    wanted: Sequence[str] | None,
    detector: Sequence[str] | None,
    problems: list[Problem],
) -> dict[str, tuple[int, ...]]:
    """Return the numbers of the detector's classes by name of the judged class; problems are appended."""
    own = [c.name for c in dataset.categories if not c.ignore]
    there = {i.category for image in images for i in image.instances}
    names = own
    if wanted is not None:
        found = match_classes(own, wanted)
        for name, of in found.items():
            if not of:
                problems.append(Problem("classes", "class-unknown", f"{name!r}", f"some of {', '.join(own)}"))
        names = [n for k, n in enumerate(own) if any(k in of for of in found.values())]
    if not names:
        problems.append(Problem(dataset.root.name, "no-classes", "no class to judge", "labelled classes"))
    if detector is None:
        return dict.fromkeys(names, ())
    mapping = match_classes(detector, names)
    lacking = [n for n, of in mapping.items() if not of and (n in there or wanted is not None)]
    if lacking:
        both = [n for n in names if mapping[n]]
        todo = f"judge the classes that both have with --classes {','.join(both)}" if both else "give other weights"
        found_text = f"the detector has no class {', '.join(lacking)} (it has {_listed(detector)})"
        problems.append(Problem("classes", "class-absent", found_text, "every class that is judged", todo))
    for k, name in enumerate(detector):
        rivals = [n for n, of in mapping.items() if k in of]
        judged = [n for n in rivals if n in there] or rivals[:1]
        for n in [n for n in rivals if n not in judged]:  # it takes no findings from a class that has objects
            mapping[n] = ()
            found_text = f"{n}: no objects, and found as the detector's {name}, as {judged[0]} is: not judged"
            problems.append(Problem("labels", "class-left-out", found_text, severity="warning"))
        if len(judged) > 1:
            found_text = f"{' and '.join(judged)} are both found as the detector's {name}"
            pairs = " ".join(f"--rename {n}={judged[0]}" for n in judged[1:])
            todo = f"make them one class with `infrablend convert {pairs}`, or choose with --classes {judged[0]}"
            problems.append(Problem("classes", "class-shared", found_text, "a class of its own for each", todo))
    others = [n for k, n in enumerate(detector) if not any(k in of for of in mapping.values())]
    if others:
        which = "this class" if len(others) == 1 else "these classes"
        found_text = f"{_listed(others)}: findings of {which} are left out"
        problems.append(Problem("detector", "class-left-out", found_text, severity="warning"))
    if wanted is not None and len(names) < len(own):
        left = ", ".join(n for n in own if n not in names)
        problems.append(Problem("labels", "class-left-out", f"{left}: not judged", severity="warning"))
    return {n: of for n, of in mapping.items() if of}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
