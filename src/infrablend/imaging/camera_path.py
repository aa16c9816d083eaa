"""The movement of the camera through a sequence: every frame relative to the first of its span.

Each frame is compared with the one before, which tells the movement to a few hundredths of a pixel, and with a key
frame that shows the same background, so that errors do not add up: what the key says is taken over little by little. A
new key begins where the background of the old one leaves the view. Where the camera comes back, it is compared with
the keys of before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.imaging.camera_shift import (
    LEAST_CORNERS,
    Matrix,
    Shift,
    View,
    find_levels,
    find_shift,
    match_features,
    moved,
)

State = Literal["first", "followed", "frozen", "bridged", "lost", "cut"]
"""How a frame is known: `first` of its span, after a gap too; `followed` from other frames; `frozen`: the picture of
the frame before again; `bridged` between the frames around it; `lost`: its background does not show the movement;
`cut`: it shows another scene and begins a span."""

# Largest share of what a key says that a frame takes over.
_MOST_TAKEN = 0.15
# Where they differ by more than this, px, and by more than so many errors ...
_APART_PX = 2.0
_APART_ERRORS = 5.0
# ... the key is right if it fits at least this share of the corners that the frame before fits: a flock moves alike in
# neighbouring frames only.
_AS_MANY = 0.6
# Share of a key's corners that have to be in view for frames to be compared with it ...
_IN_VIEW = 0.5
# ... and with a key of before.
_IN_VIEW_AGAIN = 0.6
# A frame is the one before again, but for its coding, if their levels differ by less than this in the mean.
_SAME_LEVELS = 0.15
# Frames at most that are bridged between two of one span; after more, one that cannot be followed begins a new span.
BRIDGE = 3
# A movement whose error at a corner of the picture is larger, px, is none.
MOST_ERROR_PX = 3.0
# Where frames state how far they are apart, they may show it by this share of their shorter side otherwise.
_MOST_OFF = 0.3
# A scene is another one if small pictures of it, so many px wide, correlate less than this.
_SMALL_PX = 32
_ALIKE = 0.5
_IDENTITY = np.eye(3)
# From OpenCV's pixels, where the middle of the first is at 0.
_HALF = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])

Expected = Callable[[int, int], tuple[float, float] | None]
"""Returns at which pixel a frame should show the middle of an earlier one, by both numbers; None if that is unknown."""


@dataclass(frozen=True, eq=False)
class Moment:
    """What is known of the camera in one frame.

    Attributes:
        span: Number of the span, from 0; -1 for a lost frame. Frames of two spans cannot be related to each other.
        state: How it is known.
        to_first: (3, 3) from pixels of this frame to those of the first of its span; the middle of the first pixel is
            at a half.
        error_px: Standard error of that at the worst corner of the picture, px.
        residual_px: Median residual of the corners it is known from, px.
        corners: Number of corners that could be followed.
        fitting: Number of those that fit.
        gain: Level of this frame per level of the first of its span.
        offset: Level of this frame where that has 0.
        sharpness: Variance of the second derivative: falls where the picture is blurred.
    """

    span: int
    state: State
    to_first: Matrix
    error_px: float = 0.0
    residual_px: float = 0.0
    corners: int = 0
    fitting: int = 0
    gain: float = 1.0
    offset: float = 0.0
    sharpness: float = 0.0

    @property
    def known(self) -> bool:
        """Whether objects can be held in place in this frame."""
        return self.span >= 0


@dataclass(frozen=True, eq=False)
class _Key:
    view: View
    moment: Moment


def _unknown(one: int, other: int) -> tuple[float, float] | None:
    return None


def follow_camera(views: Iterable[View], expected: Expected = _unknown) -> list[Moment]:
    """Return what is known of the camera in each frame of a sequence, in their order.

    Args:
        views: The pictures.
        expected: What is stated of where frames show the middle of others, for frames far from each other.
    """
    moments = _bridged(list(_moments(views, expected)))
    return [replace(m, to_first=_HALF @ m.to_first @ np.linalg.inv(_HALF)) for m in moments]


def _moments(views: Iterable[View], expected: Expected) -> Iterator[Moment]:
    keys: list[_Key] = []
    known: _Key | None = None  # last frame that is known
    before: _Key | None = None  # frame before, known or not
    spans = lost = of_known = 0
    for number, view in enumerate(views):
        # Another picture size is another camera.
        resized = any(k is not None and k.view.size_wh != view.size_wh for k in (before, known))
        found: Moment | None = None
        if before is not None and not resized and _same(before.view, view):
            found = replace(before.moment, state="frozen") if before.moment.known or lost < BRIDGE else None
        elif known is not None and not resized:
            found = _followed(keys, known, view, expected(of_known, number))
        if found is None:
            state: State = "lost"
            if len(view.corners) < LEAST_CORNERS:
                pass
            elif before is None or known is None or lost >= BRIDGE:
                state = "first"
            elif resized or not _alike(before.view, view):
                state = "cut"
            found = Moment(-1 if state == "lost" else spans, state, _IDENTITY, corners=len(view.corners))
            if found.known:
                spans += 1
                keys = [_Key(view, found)]
        before = _Key(view, replace(found, sharpness=_sharpness(view)))
        if before.moment.known:
            known = before
            of_known = number
            lost = 0
        else:
            lost += 1
        yield before.moment


def _followed(keys: list[_Key], before: _Key, view: View, expected: tuple[float, float] | None) -> Moment | None:
    """Return a frame by the one before and by a key; None if neither tells."""
    stepped = _relative(before, view, before.moment.to_first)
    if stepped is None and expected is not None:
        stepped = _by_features(before, view, expected)
    seen = _by_key(keys, before, view, (stepped or before.moment).to_first)
    if stepped is None or seen is None:
        return stepped or seen
    return _corrected(stepped, seen, view.size_wh)


def _corrected(stepped: Moment, seen: Moment, size_wh: tuple[int, int]) -> Moment:
    """Return a frame by the one before, with some of what a key says, by their errors as in a Kalman filter."""
    width, height = size_wh
    middle = np.array([[width / 2, height / 2]])
    apart = float(np.linalg.norm(moved(middle, stepped.to_first) - moved(middle, seen.to_first)))
    if apart > max(_APART_PX, _APART_ERRORS * float(np.hypot(stepped.error_px, seen.error_px))):
        return seen if seen.fitting >= _AS_MANY * stepped.fitting else stepped
    of_step = stepped.error_px**2
    of_key = seen.error_px**2
    share = min(of_step / max(of_step + of_key, 1e-12), _MOST_TAKEN)
    mixed = {k: (1 - share) * getattr(stepped, k) + share * getattr(seen, k) for k in ("to_first", "gain", "offset")}
    # Frames that lean on the same key share its error, so the mean of both is not less wrong than the better one.
    error = np.sqrt(max((1 - share) ** 2 * of_step + share**2 * of_key, min(of_step, of_key)))
    return replace(stepped, **mixed, error_px=float(error))


def _by_key(keys: list[_Key], before: _Key, view: View, guess: Matrix) -> Moment | None:
    """Return a frame by a key; makes the frame before a key if none of them shows enough of the same background."""
    for k, share in _candidates(keys, guess):
        if share < (_IN_VIEW if k == len(keys) - 1 else _IN_VIEW_AGAIN):
            continue
        if (moment := _relative(keys[k], view, guess)) is not None and moment.fitting >= 3 * LEAST_CORNERS:
            keys.append(keys.pop(k))  # the one in use is the last
            return moment
    keys.append(before)
    return None


def _candidates(keys: list[_Key], guess: Matrix) -> list[tuple[int, float]]:
    """Return numbers of keys and the shares of their corners in view: the one in use, then the others by that share."""
    shares = [_in_view(key, guess) for key in keys]
    last = len(keys) - 1
    others = sorted(range(last), key=lambda k: (-shares[k], k))
    return [(k, shares[k]) for k in (last, *others)]


def _in_view(key: _Key, guess: Matrix) -> float:
    corners = key.view.corners
    if len(corners) < LEAST_CORNERS:
        return 0.0
    there = moved(corners, np.linalg.inv(guess) @ key.moment.to_first)
    return float(((there >= 0) & (there < key.view.size_wh)).all(axis=1).mean())


def _by_features(before: _Key, view: View, expected: tuple[float, float]) -> Moment | None:
    """Return a frame by features that the one before has, too; None unless it moved about as it states."""
    shift = match_features(before.view, view)
    if shift is None:
        return None
    size = np.array(view.size_wh)
    off = moved(size[None] / 2, shift.matrix)[0] - expected
    return _by_shift(before, view, shift) if np.linalg.norm(off) <= _MOST_OFF * size.min() else None


def _relative(key: _Key, view: View, guess: Matrix) -> Moment | None:
    """Return a frame relative to the first of its span, by way of a key."""
    return _by_shift(key, view, find_shift(key.view, view, np.linalg.inv(guess) @ key.moment.to_first))


def _by_shift(key: _Key, view: View, shift: Shift | None) -> Moment | None:
    if shift is None or shift.error_px > MOST_ERROR_PX:
        return None
    gain, offset = find_levels(key.view, view, shift.matrix)
    known = key.moment
    to_first = known.to_first @ np.linalg.inv(shift.matrix)
    return Moment(
        known.span,
        "followed",
        to_first / to_first[2, 2],
        float(np.hypot(known.error_px, shift.error_px)),
        shift.residual_px,
        shift.corners,
        shift.fitting,
        gain * known.gain,
        gain * known.offset + offset,
    )


def _same(one: View, other: View) -> bool:
    free = ~(one.blocked | other.blocked)
    return float(cv2.absdiff(one.grey, other.grey)[free].mean()) < _SAME_LEVELS if free.any() else False


def _alike(one: View, other: View) -> bool:
    """Whether two frames show the same scene, as far as small pictures of them tell."""
    small = [_small(v) for v in (one, other)]
    if min(s.std() for s in small) < 1:
        return True  # plain sky has nothing to tell
    # The camera may have moved by a part of the picture.
    h, w = small[1].shape
    part = small[1][h // 4 : h - h // 4, w // 4 : w - w // 4]
    return float(cv2.matchTemplate(small[0], part, cv2.TM_CCOEFF_NORMED).max()) >= _ALIKE


def _small(view: View) -> NDArray[np.float32]:
    width, height = view.size_wh
    size = (_SMALL_PX, max(4, round(_SMALL_PX * height / width)))
    return np.asarray(cv2.resize(view.grey, size, interpolation=cv2.INTER_AREA), np.float32)


def _sharpness(view: View) -> float:
    return float(cv2.Laplacian(view.grey, cv2.CV_32F).var())


def _bridged(moments: list[Moment]) -> list[Moment]:
    """Return the moments with short gaps filled: at most `BRIDGE` lost frames between two of one span."""
    found = list(moments)
    k = 0
    while k < len(found):
        if found[k].known:
            k += 1
            continue
        end = next((i for i in range(k, len(found)) if found[i].known), len(found))
        if k > 0 and end < len(found) and end - k <= BRIDGE and found[k - 1].span == found[end].span:
            a, b = found[k - 1], found[end]
            for i in range(k, end):
                if found[i].state == "frozen":
                    found[i] = replace(found[i - 1], state="frozen")
                    continue
                t = (i - k + 1) / (end - k + 1)
                found[i] = replace(
                    found[i],
                    span=a.span,
                    state="bridged",
                    to_first=(1 - t) * a.to_first + t * b.to_first,
                    error_px=max(a.error_px, b.error_px) + _step(a, b) / 2,
                    gain=(1 - t) * a.gain + t * b.gain,
                    offset=(1 - t) * a.offset + t * b.offset,
                )
        k = end
    return found


def _step(a: Moment, b: Moment) -> float:
    """Return by how many px two moments differ at the picture's origin."""
    origin = np.zeros((1, 2))
    return float(np.linalg.norm(moved(origin, a.to_first) - moved(origin, b.to_first)))


def moment_to_json(moment: Moment) -> dict[str, object]:
    """Return plain JSON values, rounded to far less than their errors."""
    facts = asdict(moment)
    facts["to_first"] = [float(f"{v:.9g}") for v in moment.to_first.ravel().tolist()]
    return {k: round(v, 5) if isinstance(v, float) else v for k, v in facts.items()}


def moment_from_json(facts: Mapping[str, Any]) -> Moment:
    """Return the moment of `moment_to_json`."""
    known = {k: v for k, v in facts.items() if k != "frame"}
    return Moment(**{**known, "to_first": np.array(known["to_first"], np.float64).reshape(3, 3)})
