"""Experiments use the shipped recipes as they are: what works in an experiment is what a user gets."""

from __future__ import annotations

import pytest

from infrablend.config.loading import list_recipes
from infrablend.lab.experiments.definition import Generate, list_experiments, load_experiment

NOT_ABOUT_LOOKS = {"labels.mode", "configurations"}
"""Settings of a whole pipeline that change no object's look and no box."""
WHOLE = {
    "datasets": ("aligned", "aligned-test", "deer", "deer-test"),
    "detectability": ("people-frames", "cars-frames", "inserted-drones"),
    "find-lying": ("all-poses-inserted",),
    "hit-uav": ("aligned", "aligned-test"),
    "hit-uav-drone": ("aligned", "aligned-test"),
    "leak-free": ("aligned", "aligned-by-date"),
    "leave-a-camera-out": ("inserted", "any-camera", "own"),
    "leave-a-camera-out-ground": ("people-frames", "cars-frames"),
    "mix": ("inserted",),
    "mix-ground": (
        "people-10",
        "people-40",
        "people-160",
        "cars-10",
        "cars-40",
        "cars-160",
        "people-empty",
        "inserted",
    ),
    "monet-deer": ("deer", "deer-test"),
    "pitch-alignment": ("aligned", "aligned-test", "fixed", "random"),
    "track-drone": ("tracks-4", "tracks-7", "tracks-18", "tracks-40"),
    "transfer-car": ("inserted",),
    "transfer-car-by-date": ("inserted",),
    "transfer-deer": ("over-hit-uav", "over-wisard"),
    "transfer-drone": ("inserted", "any-camera"),
    "transfer-person": ("inserted",),
    "visible-vs-thermal": ("aligned", "aligned-test"),
}
"""The whole-pipeline arms of each experiment, by the names of their data."""
_POSES = {
    *(f"objects.{n}.count" for n in range(3)),
    *(f"objects.{n}.options.pose" for n in range(2)),
    "objects.0.options.seat",
}
ABOUT = {
    "find-lying": {
        "upright-inserted": {"objects.0.options.pose", "objects.1.options.pose", "objects.1.options.variant"},
        "standing": _POSES,
        "sitting": _POSES,
        "lying": _POSES,
    },
    "track-drone": {f"frames-{n}": {"objects.0.motion"} for n in (4, 7, 18, 40)},
    "transfer-car": {
        "anywhere-inserted": {"placement.where", "objects.0.align"},
        "flat-inserted": {"overlay.flat", "sensor.profile"},
        "no-sensor-inserted": {"sensor.profile"},
        "artistic-inserted": {"appearance.mode"},
        "paper-placement-inserted": {"placement.mode", "camera.distance_m", "objects.0.x_m", "objects.0.y_m"},
        "cut-and-paste-inserted": {"placement.mode", "camera.pitch", "camera.distance_m", "objects.0.x_m",
                                   "objects.0.y_m", "appearance.mode", "sensor.profile"},
    },
    "transfer-drone": {
        "alone": {"objects.1.count", "objects.2.count", "objects.3.count"},
        "flat": {"overlay.flat", "sensor.profile"},
        "no-sensor": {"sensor.profile"},
        "artistic": {"appearance.mode"},
        "picture-map": {"matching.local_share"},
        "cut-and-paste": {"placement.mode", "camera.pitch", "camera.distance_m", "objects.0.x_m", "objects.0.y_m",
                          "appearance.mode", "sensor.profile"},
    },
    "transfer-person": {
        "anywhere-inserted": {"placement.where"},
        "flat-inserted": {"overlay.flat", "sensor.profile"},
        "no-sensor-inserted": {"sensor.profile"},
        "artistic-inserted": {"appearance.mode"},
        "paper-placement-inserted": {"placement.mode", "camera.distance_m", "objects.0.x_m", "objects.0.y_m"},
    },
}  # fmt: skip
"""What each other arm is about: the recipe fields that it may change."""


def test_every_arm_of_every_experiment_is_listed_once() -> None:
    arms = {name: {n for n, d in load_experiment(name).data.items() if isinstance(d, Generate)}
            for name in list_experiments()}  # fmt: skip
    listed = {name: [*whole, *ABOUT.get(name, {})] for name, whole in WHOLE.items()}
    assert {name: sorted(of) for name, of in listed.items()} == {name: sorted(of) for name, of in arms.items() if of}


@pytest.mark.parametrize("name", WHOLE)
def test_arms_change_only_what_they_are_about(name: str) -> None:
    data = load_experiment(name).data
    about = ABOUT.get(name, {})
    changed = {}
    for arm in (*WHOLE[name], *about):
        spec = data[arm]
        assert isinstance(spec, Generate) and spec.recipe in list_recipes()
        if more := set(spec.settings) - about.get(arm, set()) - NOT_ABOUT_LOOKS:
            changed[arm] = sorted(more)
    assert changed == {}
