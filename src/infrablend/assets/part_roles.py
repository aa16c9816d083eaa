"""Guesses the thermal role of the pieces of a user's 3D file from the names of its objects and materials.

A name says what a piece is (`Motor_FL`, `windshield`, `fur`) more often than not, because people name what they model.
Specific words of an object's name decide first, then those of its material's name; general words (`body`, `hull`) come
last, and mean fur on an animal, paint on a car, plastic on a drone and cloth on a person. Where the class of the labels
tells what the model is, words do not mean parts of something else: the disc of a car's brake is no propeller. What no
word matches is for the user to say.
"""

from __future__ import annotations

import glob
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from infrablend.assets.user_model import GroupFacts


@dataclass(frozen=True)
class Role:
    """Typical temperature and surface of one kind of part.

    Attributes:
        delta_t_k: (low, high) surface minus air temperature.
        kind: Material of `materials.MATERIALS`.
        words: Words of names that mean this role.
        family: Family that the role tells, empty for several.
        label: Whether boxes and masks count the part.
        opacity: Share of the light from behind that the part blocks; labels ignore a part below 1.
        also: Other families with such parts.
    """

    delta_t_k: tuple[float, float]
    kind: str
    words: tuple[str, ...] = ()
    family: str = ""
    label: bool = True
    opacity: float = 1.0
    also: tuple[str, ...] = ()

    def fits(self, family: str) -> bool:
        """Return whether a model of a family, empty if unknown, can have such a part; roles of no family fit all."""
        own = {self.family, *self.also} - {""}
        return not family or not own or family in own


# Temperatures as in the shipped models: drone, car, deer and person; see docs/explanation/models.md.
ROLES: Mapping[str, Role] = {
    "motor": Role((10, 40), "black_anodised", ("motor", "stator", "winding", "nacelle"), "drone", also=("car",)),
    "battery": Role(
        (8, 20), "plastic", ("battery", "batteries", "batt", "lipo", "accu", "akku"), "drone", also=("car",)
    ),
    "electronics": Role(
        (15, 40), "circuit_board", ("esc", "pcb", "mainboard", "electronic", "circuit", "vtx"), "drone"
    ),
    "propeller": Role((0, 4), "plastic", ("prop", "propeller", "rotor", "blade"), "drone"),
    "propeller_disc": Role((0, 3), "plastic", ("propdisc", "rotordisc", "disc", "disk"), "drone", False, 0.1),
    "arm": Role(
        (0, 3), "cfrp", ("carbon", "cfrp", "fiberglass", "fibreglass", "boom", "strut"), "drone", also=("car",)
    ),
    "landing_gear": Role((0, 1), "plastic", ("landing", "skid", "gear", "undercarriage"), "drone"),
    "camera": Role((10, 25), "plastic", ("camera", "gimbal", "payload"), "drone"),
    "lens": Role((4, 12), "lens", ("lens", "sensor")),
    "antenna": Role((0, 3), "plastic", ("antenna", "gps", "gnss", "mast", "pitot")),
    "wing": Role((-1.5, 2), "plastic", ("wing", "aileron", "elevator", "rudder", "stabilizer", "stabiliser"), "drone"),
    "shell": Role((2, 8), "plastic", ("canopy", "shell", "fuselage", "plastic")),
    "vent": Role((8, 25), "cavity", ("vent", "grille", "grill", "outlet")),
    "glass": Role((-3, 2), "glass", ("glass", "window", "windshield", "windscreen"), "car", also=("drone",)),
    "lamp": Role((-2, 3), "glass", ("headlight", "taillight", "lamp", "lights"), "car", also=("drone",)),
    "tyre": Role((0, 4), "rubber", ("tyre", "tire", "rubber", "wheel", "wheels"), "car", also=("drone",)),
    "rim": Role((0, 5), "lacquered_metal", ("rim", "rims", "hubcap"), "car", also=("drone",)),
    "paint": Role(
        (-5, 0),
        "car_paint",
        ("paint", "carpaint", "bonnet", "bumper", "door", "fender", "chassis"),
        "car",
        also=("drone",),
    ),
    "exhaust": Role((2, 60), "oxidised_steel", ("exhaust", "tailpipe", "muffler"), "car", also=("drone",)),
    "fur": Role((5, 9), "fur", ("fur", "pelt", "hide", "wool", "mane"), "animal"),
    "feathers": Role((3, 7), "fur", ("feather", "plumage"), "animal"),
    "eye": Role((11, 18), "eye", ("eye", "eyes", "eyeball", "cornea", "pupil", "iris")),
    "ear": Role((3, 10), "fur", ("ear", "ears"), "animal"),
    "muzzle": Role((8, 14), "skin", ("muzzle", "nose", "snout", "nostril"), "animal"),
    "horn": Role(
        (0, 2),
        "antler",
        ("hoof", "hooves", "horn", "antler", "claw", "tusk", "beak", "teeth", "tooth"),
        also=("animal", "person"),
    ),
    "skin": Role(
        (8, 16),
        "skin",
        ("skin", "face", "hand", "hands", "finger", "lips", "tongue"),
        also=("animal", "person"),
    ),
    "hair": Role((3, 9), "hair", ("hair", "beard", "eyebrow", "eyelash")),
    "cloth": Role(
        (2, 8),
        "cloth",
        ("cloth", "fabric", "shirt", "jacket", "trouser", "pants", "jeans", "dress", "textile"),
        "person",
    ),
    "shoe": Role((0, 4), "leather", ("shoe", "boot", "leather"), "person"),
    "metal": Role((0, 5), "lacquered_metal", ("metal", "steel", "iron", "screw", "bolt")),
    "bare_metal": Role((0, 5), "bare_aluminium", ("aluminium", "aluminum", "chrome")),
    "wood": Role((0, 3), "wood", ("wood", "timber")),
    "base": Role((0, 0), "soil", ("plinth", "pedestal", "ground", "floor"), "", False),
}
_BODY = ("body", "hull", "torso", "trunk", "main", "frame", "cover", "housing", "case", "head")
# Family -> (general words, role) in the order in which they are tried.
_GENERAL: Mapping[str, tuple[tuple[tuple[str, ...], str], ...]] = {
    "drone": (
        (("leg", "foot", "feet"), "landing_gear"),
        (("arm",), "arm"),
        (("tail",), "wing"),
        (_BODY, "shell"),
        (("nose",), "shell"),
    ),
    "car": ((_BODY, "paint"), (("roof", "hood", "boot", "wing", "tail", "trim"), "paint")),
    "animal": (
        (_BODY, "fur"),
        (("wing",), "feathers"),
        (("leg", "foot", "feet", "paw", "neck", "tail", "coat", "belly", "back"), "fur"),
    ),
    "person": (
        (("head", "neck", "ear", "nose"), "skin"),
        (_BODY, "cloth"),
        (("arm", "leg", "coat", "hat", "cap"), "cloth"),
    ),
}
_CATEGORIES: Mapping[str, tuple[str, ...]] = {
    "drone": ("drone", "uav", "uas", "copter", "quad", "plane", "aircraft", "racer"),
    "car": ("car", "van", "truck", "lorry", "bus", "vehicle", "pickup", "suv", "tank"),
    "person": ("person", "people", "human", "pedestrian", "man", "woman", "child"),
    "animal": (
        "animal", "deer", "boar", "fox", "wolf", "dog", "cat", "cow", "cattle", "horse", "sheep", "goat", "pig", "bear",
        "hare", "rabbit", "badger", "lynx", "bird", "elephant", "zebra", "lion", "giraffe", "moose", "elk",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Guess:
    """Roles of the pieces of a file.

    Attributes:
        roles: Role of each piece; None if it is not known.
        family: `drone`, `car`, `animal`, `person`, or empty.
    """

    roles: tuple[str | None, ...]
    family: str


def guess_roles(groups: Sequence[GroupFacts], category: str | None, chosen: Mapping[str, str]) -> Guess:
    """Guess the role of every piece of a file.

    The class of the labels may tell the family; `chosen` has roles by the name of an object or a material.
    """
    told = next((family for family, words in _CATEGORIES.items() if _matches(category or "", words)), "")
    known = [(entry.words, role) for role, entry in ROLES.items() if entry.fits(told)]
    specific = [chosen.get(g.object) or chosen.get(g.material) or _role_of(g, known) for g in groups]
    families = Counter(ROLES[r].family for r in specific if r is not None and ROLES[r].family)
    family = told or next((family for family, _ in families.most_common(1)), "")
    general = _GENERAL.get(family, ())
    roles = tuple(role or _role_of(g, general) for g, role in zip(groups, specific, strict=True))
    return Guess(roles, family)


def patterns(groups: Sequence[GroupFacts], roles: Sequence[str]) -> dict[str, list[str]]:
    """Return patterns for the names of the pieces of each role, in the sense of a model description.

    Objects of one role are named themselves; where the materials of an object differ in role, the materials are named.
    """
    of_object: dict[str, set[str]] = {}
    for group, role in zip(groups, roles, strict=True):
        of_object.setdefault(group.object, set()).add(role)
    names: dict[str, list[str]] = {}
    for group, role in zip(groups, roles, strict=True):
        name = group.object if len(of_object[group.object]) == 1 or not group.material else group.material
        if name not in names.setdefault(role, []):
            names[role].append(name)
    every = {name for g in groups for name in (g.object, g.material) if name}
    return {role: _shortened(own, every) for role, own in names.items()}


def _shortened(own: Sequence[str], every: set[str]) -> list[str]:
    """Return exact patterns, or one with `*` for names that differ in a trailing number only."""
    found: list[str] = []
    for name in own:
        base = re.sub(r"[ ._-]?\d+$", "", name)
        alike = {n for n in every if n.startswith(base)} if base else set()
        pattern = glob.escape(base) + "*" if len(alike) > 1 and alike <= set(own) else glob.escape(name)
        if pattern not in found:
            found.append(pattern)
    return found


def _role_of(group: GroupFacts, table: Sequence[tuple[Sequence[str], str]]) -> str | None:
    """Return the role of the first words that the name of the object has, else of those of the material's name."""
    found = (role for name in (group.object, group.material) for words, role in table if _matches(name, words))
    return next(found, None)


def _matches(name: str, words: Sequence[str]) -> bool:
    """Return whether a name contains one of the words: as a word of its own, or within one if it is long."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    parts = {p.lower() for p in re.findall(r"[A-Za-z]+", spaced)}
    whole = "".join(re.findall(r"[a-z]+", name.lower()))
    return any(w in parts or f"{w}s" in parts or (len(w) >= 5 and w in whole) for w in words)
