"""Types of the fields of a run record that commands use; anything else in their place is damage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, InstanceOf, ValidationError

from infrablend.core.file_names import can_exist
from infrablend.core.validation_messages import shorten


def _place(text: str) -> str:
    if not can_exist(text):
        raise ValueError("not a path that a file system can hold")
    return text


# Texts and paths may hold what UTF-8 cannot, which pydantic's own type of text refuses.
_Text = InstanceOf[str]
_Place = Annotated[InstanceOf[str], AfterValidator(_place)]
_Table = dict[Any, Any]
_Counts = dict[Any, int]
_Number = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Fields(BaseModel):
    """Part of a record: fields may be missing, as in records of earlier versions, and others are left alone."""

    model_config = ConfigDict(strict=True, extra="ignore")


class _Data(_Fields):
    root: _Place = ""
    format: _Text = ""


class _Reading(_Fields):
    splits: list[_Text] | None = None
    format: _Text | None = None
    form: _Text | None = None
    metadata: _Place | None = None
    options: dict[Any, _Text] = {}


class _Selection(_Fields):
    limit: int | None = None
    sample: int | None = None
    frames: list[_Text] | None = None


class _Problem(_Fields):
    model_config = ConfigDict(extra="forbid")

    where: _Text
    code: _Text
    found: _Text
    expected: _Text = ""
    todo: _Text = ""
    severity: Literal["error", "warning"] = "error"


class _Request(_Fields):
    reading: _Reading = _Reading()
    selection: _Selection = _Selection()
    warnings: list[_Problem] = []


class _RunCounts(_Fields):
    frames: int = 0
    failed_frames: int = 0
    skipped_backgrounds: int = 0
    labels: _Counts = {}
    labels_inserted: _Counts = {}


class _Timing(_Fields):
    seconds: _Number = 0.0
    frames_seconds: _Number = 0.0
    labels_seconds: _Number = 0.0
    resumed_frames: int = 0
    worker_seconds: dict[Any, _Number] = {}


class _Machine(_Fields):
    renderer: _Text = ""
    device: _Text = ""
    workers: int | None = None


class _Run(_Fields):
    infrablend: _Text
    recipe: _Table
    data: _Data = _Data()
    formats: list[_Text] = []
    seed: int = 0
    key: _Table = {}
    request: _Request | None = None
    machine: _Machine = _Machine()
    packages: _Table = {}
    counts: _RunCounts = _RunCounts()
    problems: list[_Problem] = []
    timing: _Timing = _Timing()
    files: int = 0
    run: _Text = ""
    levels: Annotated[list[Annotated[float, Field(allow_inf_nan=False)]], Field(min_length=2, max_length=2)] | None = (
        None
    )
    unfinished: dict[Any, _Table] = {}


def damage(record: Mapping[str, Any]) -> str | None:
    """Return the first field of a run record that is damaged, what is wrong with it and what it is; None if none is."""
    try:
        _Run.model_validate(dict(record))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(step) for step in first["loc"])
        return f"{where}: {first['msg'][:1].lower()}{first['msg'][1:]}, found {shorten(first['input'])}"
    return None
