"""Guesses of what the pieces of a 3D file are, from the names of its objects and materials."""

from __future__ import annotations

from fnmatch import fnmatchcase

import pytest

from infrablend.assets.model import MATERIALS
from infrablend.assets.part_roles import ROLES, guess_roles, patterns
from infrablend.assets.user_model import GroupFacts, UserPart


def guess(*names: tuple[str, str], category: str | None = None, **chosen: str) -> tuple[str | None, ...]:
    return guess_roles([GroupFacts(*n) for n in names], category, chosen).roles


def test_every_role_is_a_valid_part() -> None:
    for name, role in ROLES.items():
        assert role.kind in MATERIALS
        part = UserPart(match=(name,), delta_t_k=role.delta_t_k, kind=role.kind, label=role.label, opacity=role.opacity)
        assert part.role("").delta_t_k == role.delta_t_k


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("Motor_FL", "motor"),
        ("frontMotor.001", "motor"),
        ("props_2", "propeller"),
        ("LiPo battery", "battery"),
        ("carbonArm", "arm"),
        ("Fibreglass_boom", "arm"),
        ("windshield", "glass"),
        ("tires_rear", "tyre"),
        ("Fur_brown", "fur"),
        ("eyeL", "eye"),
        ("antler.R", "horn"),
        ("Object_17", None),
        ("FlightController", None),  # not a light
        ("entire", None),  # not a tire
    ],
)
def test_words_of_a_name(name: str, role: str | None) -> None:
    assert guess((name, "")) == guess(("Cube", name)) == (role,)


def test_a_general_word_depends_on_the_family() -> None:
    assert guess(("Body", ""), category="drone") == ("shell",)
    assert guess(("Body", ""), category="roe deer") == ("fur",)
    assert guess(("Body", ""), category="Pickup truck") == ("paint",)
    assert guess(("Body", ""), category="person") == ("cloth",)
    assert guess(("Body", "")) == guess(("Body", ""), category="thing") == (None,)
    # Without a category, the other pieces tell the family.
    assert guess(("Body", ""), ("Rotor", ""), ("arm", "")) == ("shell", "propeller", "arm")
    assert guess(("leg", ""), ("Hull", ""), category="uav") == ("landing_gear", "shell")


@pytest.mark.parametrize(
    ("category", "name", "role"),
    [
        ("car", "Wheel_Disc_FL", "tyre"),
        ("car", "BrakeDisc_FL", None),
        ("car", "Boot", "paint"),
        ("car", "Wing_L", "paint"),
        ("car", "Skin", None),
        ("car", "Horn", None),
        ("car", "Motor", "motor"),
        ("drone", "Nose_Cone", "shell"),
        ("drone", "Blurred_Disc", "propeller_disc"),
        ("fixed-wing aircraft", "Wheels", "tyre"),
        ("bird", "Wing_L", "feathers"),
        ("person", "Skin", "skin"),
        ("person", "Ear_L", "skin"),
        ("deer", "Nose", "muzzle"),
        ("deer", "Horn", "horn"),
        ("person", "Boots", "shoe"),
        ("thing", "Horn", "horn"),  # the class tells no family
        (None, "BrakeDisc", "propeller_disc"),
    ],
)
def test_a_class_rules_out_parts_of_something_else(category: str | None, name: str, role: str | None) -> None:
    assert guess((name, ""), category=category) == guess(("Cube", name), category=category) == (role,)
    # What the user says counts in any family.
    assert guess((name, ""), category=category, **{name: "horn"}) == ("horn",)


def test_objects_decide_before_materials_and_the_user_before_both() -> None:
    assert guess(("Motor", "Plastic"), ("Car", "Glass"), ("Body", "Glass"), category="car") == (
        "motor",
        "glass",
        "glass",
    )
    assert guess(("Motor", "Plastic"), ("Lid", "Gold"), Motor="metal", Gold="bare_metal") == ("metal", "bare_metal")


def test_patterns_assign_every_piece_its_role() -> None:
    groups = [
        GroupFacts("Motor.001", "Black"),
        GroupFacts("Motor.002", "Black"),
        GroupFacts("Car", "Paint"),
        GroupFacts("Car", "Glass"),
        GroupFacts("Wheel", "Black"),
        GroupFacts("Odd[1]*", "Black"),
    ]
    roles = ["motor", "motor", "paint", "glass", "tyre", "metal"]
    found = patterns(groups, roles)
    assert found["motor"] == ["Motor*"]
    assert (found["paint"], found["glass"]) == (["Paint"], ["Glass"])
    for group, role in zip(groups, roles, strict=True):
        own = next(
            r
            for name in (group.object, group.material)
            for r, match in found.items()
            if any(fnmatchcase(name, m) for m in match)
        )
        assert own == role
    # A common start is not a pattern if another piece shares it.
    groups = [GroupFacts("Part1", ""), GroupFacts("Part2", ""), GroupFacts("Part3", "")]
    assert patterns(groups, ["motor", "motor", "arm"]) == {"motor": ["Part1", "Part2"], "arm": ["Part3"]}
