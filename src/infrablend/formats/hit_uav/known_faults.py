"""Known faults of the published HIT-UAV, for reports on it."""

from __future__ import annotations

from infrablend.core.dataset import Dataset
from infrablend.formats.capture import facts_from_name
from infrablend.formats.hit_uav.forms import NAME

_DATES = (
    "20201217", "20210114", "20210115", "20210116", "20210118", "20210119", "20210120", "20210121", "20210123",
)  # fmt: skip
# On a basketball court, checked one by one. The preceding frames label the same players Person.
_PEOPLE_CALLED_CAR = (4053, 4054, 4057, 4062, 4063, 4064, 4073, 4077)


def remarks(dataset: Dataset) -> tuple[str, ...]:
    """Return remarks on HIT-UAV itself; none for other data in its layout, such as the virtual world.

    The figures are for the whole published dataset: 2,898 images and 24,899 objects.
    """
    info = dataset.extra.get("info")
    authors = isinstance(info, dict) and info.get("description") == "PegasusDrone"
    if dataset.format != NAME or not (authors or any(i.extra.get("date") in _DATES for i in dataset.images)):
        return ()
    frames = {facts.frame: i for i in dataset.images if (facts := facts_from_name(i.name)) is not None}
    found: list[str] = []
    splits = {i.split for i in frames.values()}
    if {"train", "test"} <= splits:
        found.append(
            "HIT-UAV's published split is random over frames, not over scenes, so that train and test share "
            "near-identical neighbours. In the full dataset 525 of the 579 test images have a training image at most 5 "
            "frame numbers away. It remains the default; `infrablend split` makes a split without such neighbours"
        )
    wrong = [i for n in _PEOPLE_CALLED_CAR if (i := frames.get(n)) and i.name.startswith("1_130_90_0_")]
    boxes = sum(o.category == "Car" and not o.inserted for i in wrong for o in i.instances)
    if boxes:
        found.append(
            f"{boxes} boxes labelled Car in {len(wrong)} picture(s) are people on a basketball court, not all "
            f"of whom are labelled: {', '.join(i.name for i in wrong)}. They distort the sizes of Car at 130 m"
        )
    if any(o.category == "DontCare" for i in frames.values() for o in i.instances):
        found.append(
            "DontCare marks objects that cannot be separated (groups of people, rows of bicycles): regions to ignore, "
            "not objects. Published conversions treat it in at least four different ways"
        )
    found.append(
        "altitude alone does not determine the scale: pixels per metre differ by a factor of about 1.5 at the same "
        "nominal altitude. Calibrate on objects of known size"
    )
    return tuple(found)
