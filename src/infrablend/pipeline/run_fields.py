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
Text = InstanceOf[str]
Place = Annotated[InstanceOf[str], AfterValidator(_place)]
_Table = dict[Any, Any]
_Counts = dict[Any, int]
_Number = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Fields(BaseModel):
    """Part of a record: fields may be missing, as in records of earlier versions, and others are left alone."""

    model_config = ConfigDict(strict=True, extra="ignore")


class _Data(Fields):
    root: Place = ""
    format: Text = ""


class _Reading(Fields):
    splits: list[Text] | None = None
    format: Text | None = None
    form: Text | None = None
    metadata: Place | None = None
    options: dict[Any, Text] = {}


class _Selection(Fields):
    limit: int | None = None
    sample: int | None = None
    frames: list[Text] | None = None


class _Problem(Fields):
    model_config = ConfigDict(extra="forbid")

    where: Text
    code: Text
    found: Text
    expected: Text = ""
    todo: Text = ""
    severity: Literal["error", "warning"] = "error"


class _Request(Fields):
    reading: _Reading = _Reading()
    selection: _Selection = _Selection()
    warnings: list[_Problem] = []


class _RunCounts(Fields):
    frames: int = 0
    failed_frames: int = 0
    skipped_backgrounds: int = 0
    labels: _Counts = {}
    labels_inserted: _Counts = {}


class _Timing(Fields):
    seconds: _Number = 0.0
    frames_seconds: _Number = 0.0
    labels_seconds: _Number = 0.0
    resumed_frames: int = 0
    worker_seconds: dict[Any, _Number] = {}


class _Machine(Fields):
    renderer: Text = ""
    device: Text = ""
    workers: int | None = None


class _File(Fields):
    bytes: int
    sha256: Text


class _Archive(Fields):
    tar: _File
    table: _File


class _Run(Fields):
    infrablend: Text
    recipe: _Table
    data: _Data = _Data()
    formats: list[Text] = []
    seed: int = 0
    key: _Table = {}
    request: _Request | None = None
    machine: _Machine = _Machine()
    packages: _Table = {}
    counts: _RunCounts = _RunCounts()
    problems: list[_Problem] = []
    timing: _Timing = _Timing()
    files: int = 0
    run: Text = ""
    levels: Annotated[list[Annotated[float, Field(allow_inf_nan=False)]], Field(min_length=2, max_length=2)] | None = (
        None
    )
    unfinished: dict[Any, _Table] = {}
    archive: _Archive | None = None


def damage(record: Mapping[str, Any], fields: type[Fields] = _Run) -> str | None:
    """Return the first damaged field of a record, what is wrong with it and what it is; None if none is.

    Args:
        record: Record of a run, or another one.
        fields: Types of its fields.
    """
    try:
        fields.model_validate(dict(record))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(step) for step in first["loc"])
        return f"{where}: {first['msg'][:1].lower()}{first['msg'][1:]}, found {shorten(first['input'])}"
    return None
