"""Read a HIT-UAV folder: every form, united by file stem."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from infrablend.core.dataset import SPLITS, Dataset
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import leave_out
from infrablend.formats.base import check_splits, shorten, sort_images
from infrablend.formats.picture_facts import facts_from_name
from infrablend.formats.pictures.listing import PictureFolder
from infrablend.formats.published.hit_uav.form_records import FORMS, NAME, Form, FormData, detect, find_forms
from infrablend.formats.published.hit_uav.label_forms import read_json_form, read_xml_form
from infrablend.formats.published.hit_uav.unite import unite, unite_categories

# Days of the published flights.
_DATES = (
    "20201217", "20210114", "20210115", "20210116", "20210118", "20210119", "20210120", "20210121", "20210123",
)  # fmt: skip
# On a basketball court, checked one by one. The preceding frames label the same players Person.
_PEOPLE_CALLED_CAR = (4053, 4054, 4057, 4062, 4063, 4064, 4073, 4077)


def read(root: Path, *, splits: Iterable[str] | None = None, form: Form | None = None) -> Dataset:
    """Read every form in a HIT-UAV folder, or one of them, and unite them by file stem.

    Axis-aligned boxes come unchanged from normal_json (else normal_xml, else from the oriented box); oriented boxes
    from rotate_json (else rotate_xml); truncated, difficult and pose from any form that contains them. Disagreements
    between forms are reported as warnings and counted in `notes["disagreements"]`.

    Raises:
        DatasetError: There is no form, the requested one is missing, or nothing can be read.
    """
    wanted = check_splits(splits)
    forms = find_forms(root)
    if not forms:
        raise DatasetError(f"{root}: no HIT-UAV folder", [Problem(str(root), "no-form", detect(root).reason)])
    if form is not None:
        if form not in FORMS:
            problem = Problem("form", "option-value", f"{form!r}", f"one of {', '.join(FORMS)}")
            raise DatasetError(f"{root}: no such form", [problem])
        if form not in forms:
            found = f"the forms {', '.join(forms)}"
            expected = f"the form {form}"
            raise DatasetError(
                f"{root}: form {form} is missing",
                [Problem(str(root), "no-form", found, expected, "leave out --form")],
            )
        leave_out(path for other in forms if other != form for path in sorted(forms[other].rglob("*")))
        forms = {form: forms[form]}

    data = [
        read_json_form(root, f, folder, wanted) if f.endswith("_json") else read_xml_form(root, f, folder, wanted)
        for f, folder in forms.items()
    ]
    problems = [p for d in data for p in d.problems]
    if not any(d.pictures for d in data):
        raise DatasetError(f"{root}: nothing to read in the splits {', '.join(wanted)}", shorten(problems))
    borrowed = _borrow_pictures(root, forms, data)
    united = unite(root, data)
    notes = united.notes(data)
    notes |= {"pictures_borrowed": borrowed} if borrowed else {}
    problems += united.problems
    if not united.images:
        raise DatasetError(f"{root}: none of the annotated pictures exists", shorten(problems))
    for split in wanted if splits is not None else ():
        if not any(i.split == split for i in united.images):
            problems.append(Problem(str(root), "split-missing", f"no picture of split {split}", severity="warning"))
    extra: dict[str, object] = {}
    for d in reversed(data):
        extra.update(d.extra)
    images = sort_images(united.images)
    return Dataset(root, NAME, unite_categories(data), images, tuple(problems), notes, extra)


def _borrow_pictures(root: Path, forms: Mapping[Form, Path], data: Sequence[FormData]) -> dict[str, int]:
    """Find missing pictures in the other forms' folders, which contain the same pictures in HIT-UAV.

    Returns:
        The number of pictures taken from each folder.
    """
    have = {s for d in data for s, p in d.pictures.items() if p.path is not None}
    missing = [p for d in data for s, p in d.pictures.items() if s not in have]
    if not missing:
        return {}
    home = root if root not in forms.values() else root.parent
    known = (f for f in FORMS if f in forms or root not in forms.values() or root.name in FORMS)
    count: Counter[str] = Counter()
    for form in known:
        for part in (*SPLITS, "JPEGImages"):
            folder = home / form / part
            if not missing or not folder.is_dir():
                continue
            listing = PictureFolder.scan(folder)
            for p in missing:
                if part in (p.split, "JPEGImages"):
                    name, path, fault = listing.find(p.name, p.where)
                    if path is not None and fault is None:
                        p.name = name
                        p.path = path
                        count[f"{form}/{part}"] += 1
            missing = [p for p in missing if p.path is None]
    return dict(sorted(count.items()))


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
