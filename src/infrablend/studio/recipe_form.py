"""What a browser changes of a recipe: its fields as a form, made from its schema, and inserts moved by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypedDict

import numpy as np

from infrablend.config.modes import CHOICES, Modes, fields_of, modes_of, sections_of
from infrablend.config.recipe import Recipe
from infrablend.core.scene import ObjectSpec, SceneSpec
from infrablend.core.yaml_text import read_yaml

Kind = Literal["switch", "choice", "number", "whole", "range", "text", "counts", "yaml", "model", "options", "parts"]

SECTIONS = ("objects", "placement", "camera", "environment", "appearance", "matching", "sensor", "overlay", "occlusion",
            "render", "labels")  # fmt: skip
"""Sections that change a picture or its labels, in the order of the form."""

_OF_MODELS: Mapping[str, Kind] = {"model": "model", "options": "options", "parts": "parts"}
_UNITS = {
    "deg": "\u00b0", "m": "m", "mm": "mm", "k": "K", "c": "\u00b0C", "px": "px", "grey": "grey levels",
    "grey_per_k": "grey levels per K",
}  # fmt: skip


@dataclass(frozen=True)
class FormField:
    """A field of the form.

    Attributes:
        key: Dotted key, such as `objects.0.range_m`.
        kind: Kind of input.
        help: Help text, as in the reference.
        unit: Unit; may be empty.
        low: Least value.
        high: Largest value.
        choices: Values to choose from; with None, nothing is a value, too.
    """

    key: str
    title: str
    kind: Kind
    value: Any
    help: str = ""
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str | None, ...] = ()

    def read(self, given: Any) -> Any:
        """Return what a browser sent as a value for the recipe; `ValueError` for text that is not YAML."""
        if self.kind == "yaml":
            return read_yaml(str(given)) if str(given).strip() else None
        if self.kind == "text":
            return str(given or "").strip() or None
        if self.kind == "range":
            return [float(v) for v in given]
        if self.kind == "whole":
            return int(given)
        return float(given) if self.kind == "number" else given

    @property
    def shown(self) -> Any:
        """The value as the input shows it."""
        return self.value if self.kind != "yaml" else "" if self.value is None else json.dumps(self.value)


def form_of(recipe: Recipe) -> dict[str, list[FormField]]:
    """Return the fields of a recipe by section, each item of `objects` as one; fields of other modes are left out."""
    data = recipe.model_dump(mode="json")
    classes = sections_of(modes_of(data))
    found = {}
    for section in SECTIONS:
        schema = classes[section].model_json_schema()
        items = enumerate(data["objects"]) if section == "objects" else [(None, data[section])]
        for number, values in items:
            name = section if number is None else f"{section}.{number}"
            found[name] = [
                _field(f"{name}.{key}", key, about, values[key])
                for key, about in schema["properties"].items()
                if key in values
            ]
    return found


def fitting(settings: Mapping[str, object], modes: Modes) -> dict[str, object]:
    """Return the settings whose fields exist in these modes."""
    known = fields_of(modes)

    def fits(key: str) -> bool:
        section, *rest = key.split(".")
        return (section, next((s for s in rest if not s.isdecimal()), "")) in known

    return {key: value for key, value in settings.items() if key != "frames" and fits(key)}


def input_of(where: str, keys: Container[str]) -> str | None:
    """Return the key of the field that a problem is in: the nearest one above it; None if there is none."""
    while where and where not in keys:
        where = where.rpartition(".")[0]
    return where or None


Point = dict[str, Any]
"""A point of a path by hand, as in the recipe: `x_px`, `y_px`, `time_s`, and `range_m` where it is stated."""


class PlacedObjects(TypedDict):
    """What a recipe's field `frames` says of one frame: places of objects by their numbers, empty where drawn."""

    objects: Sequence[Mapping[str, float]]


class FieldSchema(TypedDict, total=False):
    """JSON schema of a field, as far as its input follows from it."""

    description: str
    type: str
    enum: Sequence[str]
    anyOf: Sequence[FieldSchema]
    prefixItems: Sequence[FieldSchema]
    minimum: float
    exclusiveMinimum: float
    maximum: float
    exclusiveMaximum: float


def path_of(motion: Any) -> list[Point]:
    """Return the path in an object's `motion` as the recipe has it; empty if it has none in the picture."""
    points = motion.get("path") if isinstance(motion, Mapping) else None
    if not isinstance(points, list) or not all(isinstance(p, Mapping) and _is_in_picture(p) for p in points):
        return []
    return [dict(p) for p in points]


def _is_in_picture(point: Mapping[str, object]) -> bool:
    return all(isinstance(point.get(k), int | float) for k in ("time_s", "x_px", "y_px"))


def with_path(motion: Any, points: Sequence[Point]) -> dict[str, Any] | None:
    """Return an object's `motion` with this path, its points in the order of their times; None for no motion left."""
    rest = {k: v for k, v in motion.items() if k != "path"} if isinstance(motion, Mapping) else {}
    path = sorted(({k: v for k, v in p.items() if v is not None} for p in points), key=lambda p: float(p["time_s"]))
    return {**rest, **({"path": path} if path else {})} or None


def with_point(points: Sequence[Point], x_px: float, y_px: float) -> list[Point]:
    """Return a path with one more point, a second after the last one, at its distance."""
    last = points[-1] if points else {"time_s": -1.0}
    range_m = {"range_m": last["range_m"]} if last.get("range_m") is not None else {}
    return [*points, {"time_s": last["time_s"] + 1.0, "x_px": round(x_px, 1), "y_px": round(y_px, 1), **range_m}]


def _field(key: str, name: str, about: FieldSchema, value: Any) -> FormField:
    help_text = " ".join(str(about.get("description", "")).split())
    title = name.replace("_", " ")
    end = max((e for e in _UNITS if name.endswith(f"_{e}")), key=len, default="")
    if end:
        title = title.removesuffix(" " + end.replace("_", " "))
    kind, low, high, choices = _kind(key, about, value)
    return FormField(key, title, kind, value, help_text, _UNITS.get(end, ""), low, high, choices)


def _kind(key: str, about: FieldSchema, value: Any) -> tuple[Kind, float | None, float | None, tuple[str | None, ...]]:
    section, _, last = key.partition(".")
    if section == "objects" and (own := _OF_MODELS.get(last.partition(".")[2])) is not None:
        return own, None, None, ()
    if key in CHOICES:
        return "choice", None, None, CHOICES[key]
    if "anyOf" in about:
        return _kind_of_several(key, about["anyOf"], value)
    kind = about.get("type")
    if kind == "boolean":
        return "switch", None, None, ()
    if "enum" in about:
        return "choice", None, None, tuple(about["enum"])
    if kind in ("number", "integer"):
        return "whole" if kind == "integer" else "number", *_limits(about), ()
    items = about.get("prefixItems", ())
    if len(items) == 2 and all(item.get("type") == "number" for item in items):
        return "range", *_limits(items[0]), ()
    return "yaml", None, None, ()


def _kind_of_several(
    key: str, options: Sequence[FieldSchema], value: Any
) -> tuple[Kind, float | None, float | None, tuple[str | None, ...]]:
    """Return the input of a field that takes values of several types, by the value that the recipe has."""
    kinds = {option.get("type"): option for option in options}
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if set(kinds) == {"string", "null"} and "enum" in kinds["string"]:
        return "choice", None, None, (*kinds["string"]["enum"], None)
    if set(kinds) == {"string", "null"}:
        return "text", None, None, ()
    if is_number and (found := kinds.get("number") or kinds.get("integer")):
        return _kind(key, found, value)
    if isinstance(value, list) and "array" in kinds:
        return _kind(key, kinds["array"], value)
    if isinstance(value, Mapping) and {"values", "weights"} <= set(value) and not value.get("by_flight"):
        return "counts", None, None, ()
    return "yaml", None, None, ()


def _limits(about: FieldSchema) -> tuple[float | None, float | None]:
    return about.get("minimum", about.get("exclusiveMinimum")), about.get("maximum", about.get("exclusiveMaximum"))


@dataclass(frozen=True)
class Move:
    """A move of one insert: right, down, counter-clockwise seen from above, and a factor on its distance."""

    dx_px: float = 0.0
    dy_px: float = 0.0
    turn_deg: float = 0.0
    away: float = 1.0


def origin_px(scene: SceneSpec, number: int) -> tuple[float, float]:
    """Return where the origin of an object is in the picture."""
    ((x, y),), _ = scene.camera.project(np.array([scene.objects[number].position_m]))
    return float(x), float(y)


def moved(
    frames: Mapping[str, PlacedObjects], scene: SceneSpec, number: int, move: Move, *, stands: bool
) -> dict[str, PlacedObjects]:
    """Return the recipe's field `frames` with one object of a scene, which has a number, moved from where it is shown.

    The distance of an object that `stands` on real ground follows from its place.
    """
    o: ObjectSpec = scene.objects[number]
    x, y = origin_px(scene, number)
    turned = math.degrees(o.yaw_rad) + move.turn_deg
    entry = {"x_px": round(x + move.dx_px, 2), "y_px": round(y + move.dy_px, 2),
             "yaw_deg": round((turned + 180) % 360 - 180, 2)}  # fmt: skip
    if not stands:
        away = float(np.linalg.norm(np.asarray(o.position_m) - scene.camera.position_m))
        entry["range_m"] = round(away * move.away, 3)
    return with_place(frames, scene.frame_id, o.number, entry)


def released(frames: Mapping[str, PlacedObjects], scene: SceneSpec, number: int) -> dict[str, PlacedObjects]:
    """Return the recipe's field `frames` with one object of a scene as drawn again."""
    return with_place(frames, scene.frame_id, scene.objects[number].number, {})


def with_place(
    frames: Mapping[str, PlacedObjects], frame_id: str, number: int | None, entry: Mapping[str, float]
) -> dict[str, PlacedObjects]:
    """Return the recipe's field `frames` with this place of an object, by its number among the drawn ones."""
    assert number is not None, "only objects of single pictures are placed by hand"
    entries = list(frames[frame_id]["objects"]) if frames.get(frame_id) else []
    entries += [{}] * (number + 1 - len(entries))
    entries[number] = entry
    while entries and not entries[-1]:
        entries.pop()
    rest = {k: v for k, v in frames.items() if k != frame_id}
    return {**rest, frame_id: {"objects": entries}} if entries else rest
