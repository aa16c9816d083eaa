"""Classes to evaluate, and the detector's classes that match them."""

from __future__ import annotations

from collections.abc import Sequence

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.errors import Problem
from infrablend.evaluation.truth import match_classes


def evaluated_classes(
    dataset: Dataset,
    images: Sequence[ImageRecord],
    wanted: Sequence[str] | None,
    detector: Sequence[str] | None,
    problems: list[Problem],
) -> dict[str, tuple[int, ...]]:
    """Return the indices of the matching detector classes for each evaluated class; append to `problems`."""
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
        problems.append(Problem(dataset.root.name, "no-classes", "no class to evaluate", "labelled classes"))
    if detector is None:
        return dict.fromkeys(names, ())
    mapping = match_classes(detector, names)
    lacking = [n for n, of in mapping.items() if not of and (n in there or wanted is not None)]
    if lacking:
        both = [n for n in names if mapping[n]]
        todo = f"evaluate the common classes with --classes {','.join(both)}" if both else "give other weights"
        found_text = f"the detector has no class {', '.join(lacking)} (it has {_listed(detector)})"
        problems.append(Problem("classes", "class-absent", found_text, "every class that is evaluated", todo))
    for k, name in enumerate(detector):
        rivals = [n for n, of in mapping.items() if k in of]
        kept = [n for n in rivals if n in there] or rivals[:1]
        for n in [n for n in rivals if n not in kept]:  # a class that has objects keeps the detections
            mapping[n] = ()
            found_text = f"{n}: has no objects and shares the detector's class {name} with {kept[0]}: not evaluated"
            problems.append(Problem("labels", "class-left-out", found_text, severity="warning"))
        if len(kept) > 1:
            found_text = f"{' and '.join(kept)} share the detector's class {name}"
            pairs = " ".join(f"--rename {n}={kept[0]}" for n in kept[1:])
            todo = f"merge them with `infrablend convert {pairs}`, or choose one with --classes {kept[0]}"
            problems.append(Problem("classes", "class-shared", found_text, "a detector class for each", todo))
    others = [n for k, n in enumerate(detector) if not any(k in of for of in mapping.values())]
    if others:
        which = "this class" if len(others) == 1 else "these classes"
        found_text = f"{_listed(others)}: detections of {which} are left out"
        problems.append(Problem("detector", "class-left-out", found_text, severity="warning"))
    if wanted is not None and len(names) < len(own):
        left = ", ".join(n for n in own if n not in names)
        problems.append(Problem("labels", "class-left-out", f"{left}: not evaluated", severity="warning"))
    return {n: of for n, of in mapping.items() if of}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
