"""A user's own 3D model: a small YAML that gives each part of a 3D file its temperature.

    name: fox
    category: fox
    file: fox.glb            # beside the YAML; .glb .gltf .obj .fbx .usd .usda .usdc .usdz .blend
    origin: feet             # feet: middle of the ground below; centre: middle of the box; file: as in the file
    heading: +X              # where its nose points once it is upright (Z up)
    up: Z                    # the axis that points up; by default Y in glTF and OBJ, Z elsewhere
    length_m: 0.7            # its longest side; or scale: 0.01
    parts:
      body: {match: ["Fox_Body*"], delta_t_k: [4, 10], kind: fur}
      eyes: {match: ["eye_*"], delta_t_k: 20, emissivity: 0.98}
      base: {match: ["Plinth"], delta_t_k: 0, emissivity: 0.95, label: false}

`match` patterns are compared with the names of the file's objects and materials. Reading the file needs Blender and
happens once, in a process of its own (`infrablend.pipeline.plans.models`); the geometry is cached by the content of the
file and of those it refers to.
"""

from __future__ import annotations

import fnmatch
import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, field_validator
from pydantic_core import PydanticKnownError

from infrablend.assets.model import MATERIALS, ObjectModel, Params, PartRange, part_role
from infrablend.assets.model_files import ModelFiles, find_model_files, is_regular_file
from infrablend.core.file_names import leaves_folder
from infrablend.core.files import LINK_OUT, LinkOutError, cache_folder, read_regular
from infrablend.core.mesh import FloatArray, Mesh
from infrablend.core.strict_model import Strict, range_of
from infrablend.core.validation_messages import read_model
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import ModelError, Problem

# Files with Y up, which Blender turns, and which do not record that reliably: many tools write glTF with Z up.
Y_UP = (".glb", ".gltf", ".obj")
Axis = Literal["X", "Y", "Z", "-X", "-Y", "-Z"]
"""Axis of a file."""
# Axis that points up -> columns and signs of the vertices once Z points up: turns, not mirror images.
_TURNS: Mapping[Axis, tuple[list[int], tuple[float, float, float]]] = {
    "X": ([2, 1, 0], (-1.0, 1.0, 1.0)),
    "-X": ([2, 1, 0], (1.0, 1.0, -1.0)),
    "Y": ([0, 2, 1], (1.0, -1.0, 1.0)),
    "-Y": ([0, 2, 1], (1.0, 1.0, -1.0)),
    "Z": ([0, 1, 2], (1.0, 1.0, 1.0)),
    "-Z": ([0, 1, 2], (1.0, -1.0, -1.0)),
}
SUFFIXES = (".glb", ".gltf", ".obj", ".fbx", ".usd", ".usda", ".usdc", ".usdz", ".blend")


def _known_kind(value: str) -> str:
    if value not in MATERIALS:
        raise ValueError("one of " + ", ".join(sorted(MATERIALS)))
    return value


def _axis(value: Any) -> Any:
    return value.upper().removeprefix("+") if isinstance(value, str) else value


class UserPart(Strict):
    """Thermal role of all objects and materials with a matching name."""

    match: tuple[str, ...] = Field(min_length=1)
    delta_t_k: range_of(-100, 1000)  # type: ignore[valid-type]
    kind: Annotated[str, AfterValidator(_known_kind)] | None = None
    emissivity: range_of(0, 1) | None = None  # type: ignore[valid-type]
    label: bool = True
    ior: float | None = Field(None, ge=1, le=5)
    opacity: float = Field(1.0, gt=0, le=1)

    @field_validator("emissivity")
    @classmethod
    def _given_or_known(cls, value: Any, info: ValidationInfo) -> Any:
        if value is None and info.data.get("kind", "a wrong one") is None:
            raise PydanticKnownError("missing")
        return value

    @field_validator("opacity")
    @classmethod
    def _translucent_is_not_labelled(cls, value: float, info: ValidationInfo) -> float:
        if value < 1 and info.data.get("label", False):
            raise ValueError(
                "1, or an opacity below 1 together with label: false: labels do not count translucent parts"
            )
        return value

    def role(self, what: str) -> PartRange:
        """Return the ranges from which each frame draws."""
        if self.kind is not None:
            return part_role(
                self.kind,
                self.delta_t_k,
                what,
                emissivity=self.emissivity,
                ior=self.ior,
                label=self.label,
                opacity=self.opacity,
            )
        assert self.emissivity is not None
        ior = 1.5 if self.ior is None else self.ior
        return PartRange(self.delta_t_k, self.emissivity, self.label, what, ior, opacity=self.opacity)


class UserModel(Strict):
    """Fields of the YAML."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    category: str = Field(min_length=1)
    file: str = Field(min_length=1)
    description: str = ""
    origin: Literal["feet", "centre", "file"] = "file"
    heading: Literal["+X", "-X", "+Y", "-Y"] = "+X"
    up: Annotated[Axis | None, BeforeValidator(_axis)] = None
    length_m: float | None = Field(None, gt=0, le=1e5)
    scale: float = Field(1.0, gt=0, le=1e6)
    parts: dict[str, UserPart] = Field(default_factory=dict)
    air_temperature_c: float = Field(20.0, ge=-90, le=70)


@dataclass(frozen=True)
class GroupFacts:
    """One named piece of an imported file: the faces of an object that share a material.

    Attributes:
        object, material: Names in the file; the material may be empty.
        temperature_c, emissivity, ior, roughness, metal: Values of the InfraredEffect node; None without one.
    """

    object: str
    material: str
    temperature_c: float | None = None
    emissivity: float | None = None
    ior: float | None = None
    roughness: float | None = None
    metal: float | None = None


@dataclass(frozen=True)
class ImportJob:
    """An import of a 3D file by Blender, in a process of its own.

    Attributes:
        files: The 3D file and those that it refers to.
        shown: Name of the 3D file in messages.
        target: File to write, see `write_geometry`.
        memory_bytes, cpu_seconds: Limits of the process.
    """

    files: ModelFiles
    shown: str
    target: Path
    memory_bytes: int
    cpu_seconds: int


def read_description(path: Path) -> tuple[UserModel, Path]:
    """Return the content of a YAML description and the path of its 3D file.

    Raises:
        ModelError: The YAML is invalid; the error lists every wrong field.
    """
    try:
        data = read_yaml(read_regular(path).decode("utf-8"))
    except LinkOutError as error:
        raise ModelError(f"model {path}: cannot be read: {error}") from error
    except (OSError, ValueError) as error:
        raise ModelError(
            f"model {path}: cannot be read ({error}); expected a YAML file (docs/how_to/own_model.md)"
        ) from error
    if not isinstance(data, dict):
        raise ModelError(f"model {path}: found {type(data).__name__}, expected a mapping of fields")
    described = read_model(UserModel, data, path.name, "model", "see docs/how_to/own_model.md for all fields")
    if isinstance(described, list):
        raise ModelError(f"model {path}: {len(described)} field(s) are invalid", described)
    file = path.parent / described.file
    if file.suffix.lower() not in SUFFIXES:
        raise ModelError(f"model {path}: file {described.file!r} has an unknown type; expected {' '.join(SUFFIXES)}")
    if not is_regular_file(file):
        raise ModelError(f"model {path}: file {described.file!r} does not exist; expected the 3D model beside the YAML")
    if leaves_folder(file):
        raise ModelError(f"model {path}: file {described.file!r} is {LINK_OUT}")
    return described, Path(os.path.realpath(file))


def is_description(model: str) -> bool:
    """Return whether the model of a recipe is the path of a YAML description, not a name."""
    return model.lower().endswith((".yaml", ".yml"))


def description_digest(path: Path) -> str:
    """Return a digest of a user's model: its YAML, its 3D file, and every file that this refers to."""
    _, file = read_description(path)
    return hashlib.sha256(read_regular(path) + find_model_files(file).digest.encode()).hexdigest()


def geometry_file(file: Path) -> Path:
    """Return the cache path of the imported geometry of a 3D file.

    Raises:
        ModelError: The 3D file cannot be read, or refers to files that it may not use.
    """
    return geometry_path(find_model_files(file))


def geometry_path(files: ModelFiles) -> Path:
    """Return the cache path of the imported geometry of a 3D model; its name depends on the content of all files."""
    return cache_folder() / "models" / f"{files.digest}.npz"


def read_geometry(cached: Path, where: str) -> tuple[list[GroupFacts], dict[str, NDArray[Any]]]:
    """Return the named pieces of an imported file and its arrays: vertices, triangles, their pieces and smoothness.

    Raises:
        ModelError: The cached file is damaged; the message starts with `where`.
    """
    try:
        with np.load(cached, allow_pickle=False) as data:
            groups = [GroupFacts(**g) for g in json.loads(str(data["groups"]))]
            arrays = {k: data[k] for k in ("vertices_m", "triangles", "group_of_triangle", "smooth")}
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ModelError(
            f"model {where}: the imported geometry in {cached} is damaged ({error}); remove that file and run again"
        ) from error
    return groups, arrays


def write_geometry(path: Path, groups: list[GroupFacts], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write what `read_geometry` reads."""
    content: dict[str, Any] = {"groups": np.array(json.dumps([asdict(g) for g in groups])), **arrays}
    with path.open("wb") as stream:
        np.savez(stream, **content)


def load_user_model(path: Path) -> ObjectModel:
    """Return the model that a YAML describes; its geometry must have been imported.

    Raises:
        ModelError: The description is invalid, the geometry has not been imported, or a piece of the file has no part.
    """
    described, file = read_description(path)
    cached = geometry_file(file)
    if not cached.is_file():
        raise ModelError(f"model {path}: {file.name} has not been imported yet", [])
    groups, mesh_data = read_geometry(cached, str(path))
    part_of_group, parts = assign_parts(described, groups, str(path))
    mesh = _mesh(described, mesh_data, part_of_group, str(path))
    digest = cached.stem

    def sample(rng: np.random.Generator, options: Params) -> Params:
        if options:
            raise ModelError(
                f"model {path}: found option {sorted(options)[0]!r}; expected none: user models have none. Remove "
                "it, or add --set objects.N.options={} where a shipped recipe states it"
            )
        return {"sha256": digest}

    def build(params: Params) -> Mesh:
        if params.get("sha256") != digest:
            raise ModelError(
                f"model {path}: {file.name} is not the file that the scene was planned with, or another version of "
                f"InfraBlend imported it (digest {digest[:12]}..., expected {str(params.get('sha256'))[:12]}...)"
            )
        return mesh

    origin = {"feet": "middle of the ground below it", "centre": "middle of its box", "file": "as in the file"}
    return ObjectModel(
        name=described.name,
        category=described.category,
        description=described.description or f"user's model {file.name}",
        origin=origin[described.origin],
        stands=described.origin == "feet",
        parts=parts,
        sample=sample,
        build=build,
    )


def assign_parts(described: UserModel, groups: list[GroupFacts], where: str) -> tuple[list[str], dict[str, PartRange]]:
    """Return the name of the part of each piece of the file, and the thermal role of every part.

    A piece belongs to the first part with a pattern that matches its object's name, else its material's name, else to
    its own InfraredEffect material.

    Raises:
        ModelError: Pieces without a part, parts without a piece, or a part and an InfraredEffect material of the same
            name; the error lists all of them.
    """
    roles = {name: p.role(f"from {where}") for name, p in described.parts.items()}
    names = []
    used = set()
    missing = []
    problems: list[Problem] = []
    for g in groups:
        # The name of an object is more specific than that of a material, which it may share with others.
        found = next(
            (
                name
                for own in (g.object, g.material)
                for name, part in described.parts.items()
                if own and any(fnmatch.fnmatchcase(own, pattern) for pattern in part.match)
            ),
            None,
        )
        if found is None and g.temperature_c is not None and g.emissivity is not None:
            found = g.material
            if found in described.parts:
                problems.append(
                    Problem(
                        f"{where}: parts.{found}",
                        "model-part-name",
                        f"object {g.object!r} matches no part, and its InfraredEffect material {found!r} has the same "
                        "name as this part",
                        "different names",
                        f"add a pattern for {g.object!r} to the part if it belongs there, or rename the part or the "
                        "material",
                    )
                )
                names.append("")
                continue
            delta = g.temperature_c - described.air_temperature_c
            roles[found] = PartRange(
                (delta, delta),
                (g.emissivity, g.emissivity),
                what="InfraredEffect material",
                ior=g.ior or 1.5,
                roughness=0.1 if g.roughness is None else g.roughness,
                metal=(g.metal or 0) > 0.5,
            )
        if found is None:
            missing.append(g)
        else:
            used.add(found)
        names.append(found or "")
    problems += [
        Problem(
            where,
            "model-piece",
            f"object {g.object!r}, material {g.material!r}: matches no part",
            "a pattern in parts",
        )
        for g in missing
    ]
    every = sorted({n for g in groups for n in (g.object, g.material) if n})
    problems += [
        Problem(
            f"{where}: parts.{n}",
            "model-part",
            f"no piece matches {list(described.parts[n].match)}",
            f"a pattern for one of {every} that no earlier part matches",
        )
        for n in described.parts
        if n not in used
    ]
    if problems:
        raise ModelError(f"model {where}: the parts do not match the file", problems)
    return names, {n: roles[n] for n in roles if n in used}


def up_of(file: Path) -> str:
    """Return the axis that points up in a 3D file that keeps to the rules of its format."""
    return "Y" if file.suffix.lower() in Y_UP else "Z"


def in_file(vertices: FloatArray, file: Path) -> FloatArray:
    """Return (n, 3) vertices as Blender imports them from a file, with Z up, along the axes of the file."""
    return vertices[:, [0, 2, 1]] * (1.0, 1.0, -1.0) if file.suffix.lower() in Y_UP else vertices


def upright(vertices: FloatArray, up: Axis) -> FloatArray:
    """Return (n, 3) vertices turned so that an axis, such as `Y` or `-X`, points along Z."""
    order, signs = _TURNS[up]
    return vertices[:, order] * signs


def _mesh(described: UserModel, data: Mapping[str, object], part_of_group: list[str], where: str) -> Mesh:
    order = sorted(set(part_of_group))
    group_part = np.array([order.index(n) for n in part_of_group], np.int32)
    part_of_triangle = group_part[np.asarray(data["group_of_triangle"], np.int64)]
    # Files differ in whether materials share vertices (.blend, OBJ) or not (glTF). Values are averaged at shared ones,
    # so each part gets its own. Vertices of no triangle are not seen: they must not decide size and origin.
    corners = np.asarray(data["triangles"], np.int64) * len(order) + part_of_triangle[:, None]
    kept, triangles = np.unique(corners, return_inverse=True)
    vertices: FloatArray = np.asarray(data["vertices_m"], np.float64)[kept // len(order)]
    if described.up is not None:
        vertices = upright(in_file(vertices, Path(described.file)), described.up)
    turn = {"+X": (1, 0), "-X": (-1, 0), "+Y": (0, -1), "-Y": (0, 1)}[described.heading]
    c, s = turn
    vertices = vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], np.float64)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    factor = described.scale
    size = float((high - low).max())
    if not size > 0 or not np.isfinite(size):
        raise ModelError(f"model {where}: the surface in the file has size {size:g}; expected one larger than a point")
    if described.length_m is not None:
        factor = described.length_m / size
    if described.origin == "centre":
        vertices = vertices - (low + high) / 2
    elif described.origin == "feet":
        vertices = vertices - np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return Mesh(
        np.ascontiguousarray(vertices * factor),
        triangles.reshape(-1, 3).astype(np.int32),
        part_of_triangle,
        tuple(order),
        np.asarray(data["smooth"], np.bool_),
    )
