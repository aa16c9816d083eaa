"""Turns a 3D file into a model: guesses its parts, lists what only the user can know, writes the description."""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

import numpy as np

from infrablend.assets.part_roles import ROLES, Guess, guess_roles, patterns
from infrablend.assets.user_model import SUFFIXES, Axis, GroupFacts, geometry_file, read_geometry, up_of
from infrablend.core.arguments import require_choice
from infrablend.core.file_names import real_path
from infrablend.core.files import write_text
from infrablend.errors import ModelError, Problem
from infrablend.pipeline.plans.models import import_geometry, ready_model

log = logging.getLogger(__name__)

# A side that is longer by a larger share tells how a model lies.
_CLEARLY = 1.2


@dataclass(frozen=True)
class ModelAnswers:
    """What the user says about a 3D file.

    Attributes:
        category: Class of its labels, e.g. drone.
        size_m: Length of its longest side.
        parts: Role of an object or a material of the file, e.g. Mesh1=motor; repeatable.
        up: Axis that points up in the file [default: Y in glTF and OBJ, else Z].
    """

    category: str | None = None
    size_m: float | None = None
    parts: Mapping[str, str] = field(default_factory=dict)
    up: Axis | None = None

    def __post_init__(self) -> None:
        if self.up is not None:
            object.__setattr__(self, "up", str(self.up).upper())
            require_choice("up", self.up, get_args(Axis))


@dataclass(frozen=True)
class ModelSurvey:
    """What is known about a 3D file, and what is not.

    Attributes:
        file: The file.
        guess: Role of each of its pieces.
        groups: Its pieces.
        file_size: Extent (x, y, z) in the units of the file, upright.
        answers: The user's answers so far.
    """

    file: Path
    guess: Guess
    groups: tuple[GroupFacts, ...]
    file_size: tuple[float, float, float]
    answers: ModelAnswers

    @property
    def unknown_parts(self) -> list[str]:
        """Names of the pieces without a role: of the object, or of the material if the object has other roles too."""
        # By an InfraredEffect node in its material.
        described = [g.temperature_c is not None and g.emissivity is not None for g in self.groups]
        names: list[str] = []
        for g, role, own in zip(self.groups, self.guess.roles, described, strict=True):
            if role is None and not own:
                others = {r for h, r in zip(self.groups, self.guess.roles, strict=True) if h.object == g.object}
                name = g.material if len(others) > 1 and g.material else g.object
                if name not in names:
                    names.append(name)
        return names

    @property
    def doubts(self) -> list[Problem]:
        """A warning if the model seems to lie on its side, by its size; none where the user says what is up."""
        if self.answers.up is not None:
            return []
        up = up_of(self.file).lower()
        sides = dict(zip("xzy" if up == "y" else "xyz", self.file_size, strict=True))
        height = sides.pop(up)
        (short, width), (long, length) = sorted(sides.items(), key=lambda side: side[1])
        flies = "feathers" in self.guess.roles or "bird" in (self.answers.category or "").lower()
        axis = ""
        if self.guess.family == "person" and length > _CLEARLY * height:
            axis = long
            expected = "people who are taller than wide"
        elif self.guess.family == "animal" and width > _CLEARLY * height and not flies:
            axis = short
            expected = "animals that are taller than wide"
        elif self.guess.family in ("car", "drone") and height > _CLEARLY * length:
            axis = short
            expected = f"a {self.guess.family} that is longer than high"
        if not axis:
            return []
        found = f"it seems to lie on its side: {height:.3g} high (axis {up}), {length:.3g} long and {width:.3g} wide"
        todo = f"look at the sheet; give --up {axis}, or --up -{axis} if it is then upside down, and remove the "
        todo += f"description if there is one, or write up: {axis.upper()} into it"
        return [Problem(str(self.file), "model-on-its-side", found, expected, todo, "warning")]

    @property
    def missing(self) -> list[Problem]:
        """Everything that is still to be answered."""
        where = str(self.file)
        found = []
        if not self.answers.category:
            found.append(Problem(where, "model-category", "no class for its labels", "--category NAME, such as drone"))
        if self.answers.size_m is None:
            size = " x ".join(f"{s:.3g}" for s in self.file_size)
            lacking = f"no size (the file has {size} units)"
            found.append(Problem(where, "model-size", lacking, "--size-m METRES, the length of the longest side"))
        roles = ", ".join(ROLES)
        for name in self.unknown_parts:
            lacking = f"piece {name!r} has a name that says nothing known"
            found.append(Problem(where, "model-part", lacking, f"--part {name}=ROLE with a role of {roles}"))
        return found


def survey_model(file: Path, answers: ModelAnswers) -> ModelSurvey:
    """Read a 3D file and guess the roles of its pieces.

    Raises:
        ModelError: The file cannot be read, or an answer does not fit it.
    """
    if file.suffix.lower() not in SUFFIXES:
        raise ModelError(f"model file {file}: unknown type; expected one of {' '.join(SUFFIXES)}")
    import_geometry(file)
    groups, data = read_geometry(geometry_file(file), str(file))
    names = {name for g in groups for name in (g.object, g.material) if name}
    wrong = [
        Problem(
            str(file),
            "model-part",
            f"--part {name}={role}: no object or material has this name",
            f"one of {', '.join(sorted(names))}",
        )
        for name, role in answers.parts.items()
        if name not in names
    ] + [
        Problem(str(file), "model-role", f"--part {name}={role}: unknown role", f"one of {', '.join(ROLES)}")
        for name, role in answers.parts.items()
        if role not in ROLES
    ]
    if answers.size_m is not None and not 0 < answers.size_m <= 1e5:
        wrong.append(Problem(str(file), "model-size", f"--size-m {answers.size_m:g}", "a number above 0 and up to 1e5"))
    if wrong:
        raise ModelError(f"model file {file}: {len(wrong)} answer(s) do not fit", wrong)
    used = np.unique(data["triangles"])
    extent = np.ptp(np.asarray(data["vertices_m"], np.float64)[used], axis=0)
    size = (float(extent[0]), float(extent[1]), float(extent[2]))
    return ModelSurvey(file, guess_roles(groups, answers.category, answers.parts), tuple(groups), size, answers)


def add_model(file: Path, out: Path | None, answers: ModelAnswers) -> Path:
    """Write the description of a 3D file and return its path.

    Args:
        file: The 3D file; it stays where it is.
        out: Folder of the description; by default that of the file.
        answers: What the user says about the file.

    Raises:
        ModelError: Something is still unknown (the error lists all of it), or the description exists already.
    """
    survey = survey_model(file, answers)
    if missing := survey.missing:
        found = [*missing, *survey.doubts]
        raise ModelError(f"model file {file}: {len(missing)} thing(s) that its names do not say", found)
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", file.stem).strip("._-") or "model"
    target = (out or file.parent) / f"{name}.yaml"
    if target.exists():
        raise ModelError(
            f"model description {target}: exists already; expected a new file. Remove it, or choose another --out"
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    write_text(target, description(survey, name, os.path.relpath(real_path(file), real_path(target.parent))))
    try:
        ready_model(str(target))
    except ModelError:
        target.unlink(missing_ok=True)  # or the corrected command would be refused
        raise
    for doubt in survey.doubts:
        log.warning("%s", doubt)
    return target


def description(survey: ModelSurvey, name: str, file: str) -> str:
    """Return the YAML of a surveyed file; texts are quoted as in JSON, which YAML 1.2 contains."""
    family = survey.guess.family
    answers = survey.answers
    known = [(g, r) for g, r in zip(survey.groups, survey.guess.roles, strict=True) if r is not None]
    # The front of a glTF is +Z by its standard, which Blender turns to -Y.
    standard = survey.file.suffix.lower() in (".glb", ".gltf") and answers.up in (None, "Y")
    heading = "-Y" if standard else "+X"
    lines = [
        "# Written by `infrablend models add`: check the sheet, and correct what is wrong (docs/how_to/own_model.md).",
        f"name: {json.dumps(name)}",
        f"category: {json.dumps(answers.category, ensure_ascii=False)}",
        f"file: {json.dumps(file, ensure_ascii=False)}",
        f"origin: {'centre' if family == 'drone' else 'feet'}",
        *([] if answers.up is None else [f'up: "{answers.up}"  # axis of the file that points up']),
        f'heading: "{heading}"  # direction of its front, once upright',
        f"length_m: {answers.size_m!r}",
    ]
    if known:
        lines.append("parts:")
    for role, names in patterns([g for g, _ in known], [r for _, r in known]).items():
        entry = ROLES[role]
        fields = [
            f"match: {json.dumps(names, ensure_ascii=False)}",
            f"delta_t_k: [{entry.delta_t_k[0]:g}, {entry.delta_t_k[1]:g}]",
            f"kind: {entry.kind}",
        ]
        fields += [] if entry.label else ["label: false"]
        fields += [] if entry.opacity == 1 else [f"opacity: {entry.opacity:g}"]
        lines.append(f"  {role}: {{{', '.join(fields)}}}")
    return "\n".join(lines) + "\n"
