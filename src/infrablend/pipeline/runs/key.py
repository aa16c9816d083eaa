"""Compares the keys of two runs; frames belong to one run only if the keys are equal."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from infrablend.errors import OtherSettingsError
from infrablend.pipeline.plans.plan import RunPlan

_BACKGROUNDS = "backgrounds"
_SHOWN = 3


def differences(
    earlier: Mapping[str, object],
    key: Mapping[str, object],
    asked_earlier: Mapping[str, object] | None = None,
    asked: Mapping[str, object] | None = None,
) -> list[str]:
    """Return a text per field in which the key of a run differs from an earlier one; empty if they are equal.

    Args:
        earlier: Key of the earlier run (`RunPlan.key`).
        key: Key of the run.
        asked_earlier: How the earlier run read its backgrounds and chose frames (`RunPlan.request`), which
            explains other backgrounds; None if it is not known.
        asked: The same of the run.
    """
    was, now = _comparable(earlier), _comparable(key)
    texts = []
    asked_texts = _asked_differences(asked_earlier, asked)
    for k in sorted(k for k in now if was.get(k) != now[k]):
        if k == _BACKGROUNDS:  # digests, which nobody can compare by eye
            texts += asked_texts or ["the backgrounds, their labels or their metadata have changed"]
        elif isinstance(now[k], Mapping):
            fields = _differing_fields(was.get(k, {}), now[k], k)
            texts += [f"{name} was {a!r}, is {b!r}" for name, a, b in fields]
        else:
            texts.append(f"{k} was {_short(was.get(k))}, is {_short(now[k])}")
    return list(dict.fromkeys(texts))


def require_same_key(previous: Mapping[str, Any], plan: RunPlan, out: Path | str) -> None:
    """Check that the record of an earlier run, or of a shard, is of the run that is planned.

    Raises:
        OtherSettingsError: It is of another run; the message lists the differences.
    """
    if texts := differences(previous.get("key", {}), plan.key, previous.get("request"), plan.request):
        raise OtherSettingsError(
            f"{out}: cannot be resumed because this is a different run: {'; '.join(texts)}. "
            "Use the same recipe, data, seed, splits and choice of frames, or --overwrite, or another --out."
        )


def _asked_differences(earlier: Mapping[str, object] | None, asked: Mapping[str, object] | None) -> list[str]:
    if earlier is None or asked is None:
        return []
    return [
        f"{path.rpartition('.')[2]} was {_short(was)}, is {_short(now)}"
        for name in ("reading", "selection")
        for path, was, now in _differing_fields(_plain(earlier.get(name, {})), _plain(asked.get(name, {})), name)
    ]


def _plain(values: Any) -> Any:
    return json.loads(json.dumps(values, default=str))


def _short(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, list) and len(value) > _SHOWN:
        return f"{len(value)} ({', '.join(map(str, value[:_SHOWN]))}, ...)"
    return ", ".join(map(str, value)) if isinstance(value, list) else repr(value)


def _comparable(key: Mapping[str, object]) -> dict[str, object]:
    comparable = dict(key)
    recipe = key.get("recipe")
    if isinstance(recipe, Mapping):
        comparable["recipe"] = {k: v for k, v in recipe.items() if k != "description"}
    return comparable


def _differing_fields(was: Any, now: Any, path: str) -> Iterator[tuple[str, Any, Any]]:
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for k in sorted({*was, *now}):
            yield from _differing_fields(was.get(k), now.get(k), f"{path}.{k}")
    elif was != now:
        yield path, was, now
