"""Warnings about a run as a whole, and counts of what it inserted of what its recipe asked for, from rows of frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from infrablend.compositing.gain import Doubt
from infrablend.config.recipe import Recipe
from infrablend.core.frame_row import FrameRow
from infrablend.core.run_record import DrawStatistics
from infrablend.errors import Problem

_HEIGHT = "height-at-limit"
_SUN = "sun-below-horizon"


def in_words(reasons: Mapping[str, int], words: Mapping[str, str] | None = None) -> str:
    """Return reasons in words, each with its number and its name in the records; without `words`, those of `WHY`."""
    words = WHY if words is None else words
    return ", ".join(f"{name} {n}" + (f" ({words[name]})" if name in words else "") for name, n in reasons.items())


def frame_warnings(rows: Iterable[FrameRow]) -> list[Problem]:
    """Return the warnings about backgrounds, merged into one per kind."""
    seen: dict[str, dict[str, Problem]] = {}
    for row in rows:
        for w in row.warnings:
            seen.setdefault(w.code, {}).setdefault(w.where, w)
    warnings = []
    for _, by_place in sorted(seen.items()):
        first = min(by_place)
        where = first if len(by_place) == 1 else f"{first} and {len(by_place) - 1} more"
        warnings.append(replace(by_place[first], where=where, severity="warning"))
    return warnings


class _Reason(NamedTuple):
    """What is said about objects that are left out for one reason, if they are at least a share of those wanted."""

    code: str
    where: str
    found: str
    expected: str
    todo: str
    least_share: float = 0.0


_OTHER_GROUND = (
    "leave it so if few pictures show ground that suits them; or set placement.where.surfaces or masks, or "
    "placement.where=anywhere"
)
# Reasons with a remedy of their own; all others are a matter of placement.
_REASONS: Mapping[str, _Reason] = {
    "no_horizon": _Reason(
        "no-horizon",
        "camera.pitch",
        "no horizon is known, found in the picture or stated",
        "a pitch in the metadata, a picture that shows where sky and ground meet, or a stated range",
        "set camera.pitch.else_deg for such pictures, or camera.pitch={fixed_deg: ...}",
    ),
    "no_ground": _Reason(
        "no-ground",
        "placement.where",
        "the picture shows no ground that suits them",
        "pictures with such ground (`infrablend places map` shows what is found)",
        _OTHER_GROUND,
        0.05,
    ),
    "noise": _Reason(
        "noise-only",
        "placement.max_noise_grey",
        "the picture is little but noise",
        "pictures with less noise than placement.max_noise_grey",
        "nothing, if these pictures may stay without inserted objects; or raise placement.max_noise_grey",
    ),
    "untrusted": _Reason(
        "untrusted-left-out",
        "matching.on_untrusted",
        "the gain of the picture is not trusted, and matching.on_untrusted is skip",
        "gains without doubts",
        "see the other warnings about matching for the cause, or set matching.on_untrusted to use or prior",
    ),
    "low_contrast": _Reason(
        "low-contrast",
        "placement.min_contrast",
        "nobody could see them in the finished picture, here or where they were moved to",
        "at most a fifth left out for this",
        "check temperatures, environment and matching.gain_prior_grey_per_k, or lower placement.min_contrast",
        0.2,
    ),
    "too_hidden": _Reason(
        "too-hidden",
        "occlusion.visible",
        "the background hides too much of them",
        "at most a fifth left out for this",
        "widen occlusion.visible, or lower placement.min_visibility or occlusion.share",
        0.2,
    ),
}
WHY: Mapping[str, str] = {
    "no_place": "no place was found where it fits",
    "no_ground": "no ground in this background suits it",
    "no_horizon": "no horizon was found in this background",
    "behind_camera": "its place is behind the camera",
    "min_visibility": "too little of it would be visible",
    "too_hidden": "structures of the background hide too much of it",
    "low_contrast": "its contrast with the background is too low",
}
"""Why an object was left out, in words; other reasons are in words already."""
_REFUSED: Mapping[str, str] = {
    "unfit_ground": "the ground there does not suit it: a car needs a road, for example",
    "no_ground": "there is no ground",
    "beyond_ground": "it would be below the ground",
    "too_small": "it would be too small",
    "overlap": "another object is there",
}
_LEAST_ABSENT = 0.5
_LOOKS_DOWN = (
    "at these distances (objects.N.range_m or size_px) and the recipe's height of the camera, objects would be below "
    "the ground: use a recipe for cameras that look down, or correct pitch and height"
)

_TOO_SMALL = (
    "the largest of those that are too small would have {px:.3g} px, less than placement.size_px: check that, and the "
    "camera's height and field of view, which --plan shows. A focal length printed on a lens needs "
    "camera.pixel_pitch_um beside it, or camera.model instead of it; alone it is that of a sensor "
    "camera.sensor_width_mm (36) wide"
)


def absent_warnings(draws: DrawStatistics) -> list[Problem]:
    """Return a warning per reason why objects were not inserted, with its own remedy.

    Missing places are a warning if at least half of the requested objects have none.
    """
    absent = dict(draws.get("absent", {}))
    wanted = draws.get("wanted", 0)
    problems = []
    for name, reason in _REASONS.items():
        count = absent.pop(name, 0)
        if count and count > reason.least_share * wanted:
            found = f"{count} of {wanted} objects were not inserted: {reason.found}"
            problems.append(Problem(reason.where, reason.code, found, reason.expected, reason.todo, "warning"))
    missing = sum(absent.values())
    if missing and missing >= _LEAST_ABSENT * wanted:
        most = sorted(draws["rejected"].items(), key=lambda r: (-r[1], r[0]))[:3]
        found = f"{missing} of {wanted} objects were not inserted: {in_words(absent)}"
        found += f"; places refused: {in_words(dict(most), _REFUSED)}" if most else ""
        todo = (
            "check the camera's pitch, height and lens, and placement.size_px; `draws` in run.json counts every reason"
        )
        if most and most[0][0] == "beyond_ground":
            todo = _LOOKS_DOWN
        elif most and most[0][0] == "unfit_ground":
            todo = _OTHER_GROUND
        elif "too_small_px" in draws and any(reason == "too_small" for reason, _ in most):
            todo = _TOO_SMALL.format(px=draws["too_small_px"])
        problems.append(Problem("placement", "objects-absent", found, "most objects inserted", todo, "warning"))
    return problems


def air_warnings(rows: Iterable[FrameRow]) -> list[Problem]:
    """Return a warning if radiometric frames have a drawn temperature of the air."""
    drawn = sum(row.air_drawn for row in rows)
    if not drawn:
        return []
    found = f"the temperature of the air is not stated for {drawn} frame(s), and was drawn"
    expected = "that of the flight, which the temperatures of all objects are relative to"
    todo = "set environment.air_temperature_c to one number"
    return [Problem("environment.air_temperature_c", "air-drawn", found, expected, todo, "warning")]


_TRUST = "set matching.on_untrusted to prior or skip for such frames"
_DOUBTS: Mapping[Doubt, tuple[str, str, str, str]] = {
    "gain_at_bound": (
        "gain-at-limit",
        "the estimated gain is at a limit",
        "a gain within matching.gain_grey_per_k",
        "check matching.polarity and the weather, or set matching.gain_grey_per_k for this camera; or " + _TRUST,
    ),
    "gain_negative": (
        "gain-negative",
        "the estimated gain is negative: annotated objects that should be warm are dark",
        "warm objects that are bright",
        "check matching.polarity, time of day and matching.clothing_above_air_k; or " + _TRUST,
    ),
    "anchors_contradict": (
        "anchors-contradict",
        "annotated objects of known temperature imply different gains",
        "gains that agree within their uncertainty",
        "check class names and time of day; or " + _TRUST,
    ),
    "anchors_off": (
        "anchors-off",
        "annotated objects of known temperature are all brighter or darker than the weather allows",
        "levels within 2.5 standard deviations of those expected from weather and gain",
        "check matching.polarity, environment.ground_above_air_night_k and matching.clothing_above_air_k; or " + _TRUST,
    ),
    "no_anchor": (
        "no-anchor",
        "the gain is drawn from the prior, because nothing of known temperature is in sight, or only clipped objects, "
        "which give a lower bound",
        "annotated people or cars by night, or a skyline; by day the sun warms people and cars too unevenly",
        "check matching.gain_prior_grey_per_k, which decides the contrast of these inserts",
    ),
}


def track_warnings(rows: Sequence[FrameRow]) -> list[Problem]:
    """Return a warning each if labels of tracks are of objects that nobody can see in their frame, or only smeared."""
    tracked = [(i, 0.0 if row.scene is None else row.scene.motion_px) for row in rows for i in row.inserts if i.track]
    found = {
        "track-faint": (
            sum(row.faint for row in rows),
            "fainter in their frame than the least contrast",
            "the label stays, as its track goes on; see `faint` in the records, or warm the objects (delta_t_k)",
        ),
        "track-smeared": (
            sum(insert.size_px < tail_px for insert, tail_px in tracked),
            "blurred by motion over more than their size",
            "check time_s of the frames, from which speeds follow; or leave out frames of a fast camera",
        ),
    }
    return [
        Problem(
            "tracks",
            code,
            f"{n} of {len(tracked)} labels of tracks are of objects {what}",
            "objects that can be seen",
            todo,
            "warning",
        )
        for code, (n, what, todo) in found.items()
        if n
    ]


def limit_warnings(rows: Iterable[FrameRow]) -> list[Problem]:
    """Return a warning per estimate that is not to be trusted in at least a fifth of its frames.

    The estimates are the height of the camera (metric placement) and the gain (physical look). A sun that is below the
    horizon by day is a warning wherever it occurs.
    """
    heights = 0
    gains = 0
    counts: Counter[str] = Counter()
    for row in rows:
        heights += row.scene is not None and row.scene.at_limit is not None
        gains += row.estimates_gain
        counts.update(doubt_codes(row))
    problems = []
    if heights and 5 * counts[_HEIGHT] >= heights:
        found = (
            "the corrected height of the camera is as far from the stated one as is allowed in "
            f"{counts[_HEIGHT]} of {heights} frames with annotated objects of known size"
        )
        todo = "check lens, altitude and class names; infrablend preview --ground shows whether the scale is right"
        problems.append(Problem("camera", _HEIGHT, found, "a height between the limits", todo, "warning"))
    if counts[_SUN]:
        found = f"capture time and environment.place have the sun below the horizon in {counts[_SUN]} frames by day"
        todo = "check the time zone of the capture times, time_of_day and environment.place; the sun was drawn instead"
        problems.append(Problem("environment.place", _SUN, found, "a sun above the horizon by day", todo, "warning"))
    for code, what, expected, todo in _DOUBTS.values():
        if gains and 5 * counts[code] >= gains:
            found = f"{what} (in {counts[code]} of {gains} frames)"
            problems.append(Problem("matching", code, found, expected, todo, "warning"))
    return problems


def hiding_warnings(counts: Mapping[str, Any]) -> list[Problem]:
    """Return a warning if backgrounds show too little to hide half of the objects that were to be partly hidden."""
    n = counts.get("partly_hidden", {})
    if not n or 2 * n["hidden"] >= n["wanted"]:
        return []
    found = f"{n['wanted'] - n['hidden']} of {n['wanted']} objects that were to be partly hidden are in front"
    todo = "widen occlusion.visible, or use backgrounds with branches, masts or fences"
    return [Problem("occlusion", "nothing-in-front", found, "structures that can hide them", todo, "warning")]


def horizon_warnings(counts: Mapping[str, Any]) -> list[Problem]:
    """Return a warning if a recipe that looks for the horizon found none in at least half of its frames."""
    found = Counter(counts.get("pitch_from", {}))
    if not found["recipe"] or 2 * found["recipe"] < found.total():
        return []
    text = f"no horizon in {found['recipe']} of {found.total()} frames: taken to show the sky alone, or to look level"
    todo = "look at a few (infrablend preview); for cameras that look down, set camera.pitch to their own pitch"
    return [Problem("camera.pitch", "horizon-absent", text, "pictures with a horizon, or of the sky", todo, "warning")]


def doubt_codes(row: FrameRow) -> set[str]:
    """Return the codes of the doubts about a frame's estimates, one per kind."""
    codes = {code for kind, (code, *_) in _DOUBTS.items() if kind in row.doubts}
    if row.scene is not None and row.scene.at_limit:
        codes.add(_HEIGHT)
    weather = None if row.scene is None else row.scene.weather
    if weather is not None and weather.sun is not None and weather.sun.source == "contradicted":
        codes.add(_SUN)
    return codes


def warning_codes(row: FrameRow) -> set[str]:
    """Return the codes of the warnings about a run that a frame contributes to, whether or not the run has them."""
    codes = {w.code for w in row.warnings}
    codes |= {_REASONS[reason].code if reason in _REASONS else "objects-absent" for reason in row.absent}
    if row.air_drawn:
        codes.add("air-drawn")
    if not all(row.hidden):
        codes.add("nothing-in-front")
    return codes | doubt_codes(row)


NOTHING_INSERTED = "nothing-inserted"
"""Code of the problem of a run, or of an entry of `objects`, that asked for objects and got none."""


def count_objects(recipe: Recipe, rows: Iterable[FrameRow]) -> dict[str, Any]:
    """Return the counts of objects by entry of the recipe, and of those left out or without a label by reason.

    Frames with objects placed by hand ask for nothing: their places are not checked.
    """
    asked = Counter[int]()
    inserted = Counter[int]()
    absent = Counter[str]()
    dropped = Counter[str]()
    for row in rows:
        if row.scene is None:
            continue
        inserted.update(i.kind for i in row.inserts if i.kind is not None)
        absent.update(row.absent)
        dropped.update(row.drops)
        if row.id not in recipe.frames:
            asked.update(row.scene.draws.wanted_by_kind)
    by_kind = {f"objects.{k}": {"asked": asked[k], "inserted": inserted[k]} for k in sorted(asked | inserted)}
    found = {"objects_by_kind": by_kind, "objects_left_out": dict(sorted(absent.items()))}
    return {
        **{name: counts for name, counts in found.items() if counts},
        "objects_without_label": dict(sorted(dropped.items())),
    }


def nothing_inserted(recipe: Recipe, counts: Mapping[str, Any], draws: DrawStatistics | None = None) -> list[Problem]:
    """Return what a run was asked for and has not inserted at all: any object, or any of an entry of `objects`.

    Args:
        recipe: Recipe of the run.
        counts: Its counts, with those of `count_objects`.
        draws: Statistics of its draws, for the next step; unknown for runs in packed shards.
    """
    by_kind: Mapping[str, Mapping[str, int]] = counts.get("objects_by_kind", {})
    missing = {where: n["asked"] for where, n in by_kind.items() if n["asked"] and not n["inserted"]}
    if not missing:
        return []
    left_out = counts.get("objects_left_out", {})
    reasons = Counter(left_out) + Counter(counts.get("objects_without_label", {}))
    why = in_words(dict(reasons.most_common())) or "for a reason that was not recorded"
    total = sum(n["asked"] for n in by_kind.values())
    remedies = absent_warnings(draws or {"wanted": total, "absent": left_out, "rejected": {}})
    todo = "; or ".join(dict.fromkeys(p.todo for p in remedies))
    todo = (
        todo or "look at a few frames (infrablend try, infrablend preview), and check where the recipe places objects"
    )
    if not any(n["inserted"] for n in by_kind.values()):
        found = f"none of the {total} objects that the recipe asks for was inserted: {why}"
        return [Problem("objects", NOTHING_INSERTED, found, "objects in the pictures", todo)]
    return [
        Problem(
            where,
            NOTHING_INSERTED,
            f"none of the {n} objects of the model {recipe.objects[int(where.rpartition('.')[2])].model} was inserted; "
            f"left out of all kinds: {why}",
            "some of each kind",
            todo,
        )
        for where, n in missing.items()
    ]


def few_inserted(recipe: Recipe, counts: Mapping[str, Any], draws: DrawStatistics | None) -> list[Problem]:
    """Return a warning per entry of `objects`, of several, of which some are inserted, but at most half.

    See `nothing_inserted` for the arguments.
    """
    by_kind: Mapping[str, Mapping[str, int]] = counts.get("objects_by_kind", {})
    refused = dict(Counter((draws or {}).get("rejected", {})).most_common(2))
    why = f"left out of all kinds: {in_words(counts.get('objects_left_out', {}))}"
    why += f"; places refused: {in_words(refused, _REFUSED)}" if refused else ""
    todo = _OTHER_GROUND if "unfit_ground" in refused else "check placement and the camera"
    problems = []
    for where, n in by_kind.items() if len(by_kind) > 1 else ():
        if 0 < n["inserted"] <= _LEAST_ABSENT * n["asked"]:
            kind = recipe.objects[int(where.rpartition(".")[2])]
            found = (
                f"{n['asked'] - n['inserted']} of {n['asked']} {kind.category or kind.model} were not inserted; {why}"
            )
            problems.append(Problem(where, "objects-absent", found, "most objects inserted", todo, "warning"))
    return problems


def nothing_first(problems: Iterable[Problem]) -> list[Problem]:
    """Return the problems in their order, after those about a run without objects: nobody needs such a run."""
    return sorted(problems, key=lambda p: p.code != NOTHING_INSERTED)
