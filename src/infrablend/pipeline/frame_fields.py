"""Types of the fields of a frame record that commands use; anything else in their place is damage."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from infrablend.pipeline.run_fields import Fields, Place, Text

_Number = Annotated[float, Field(allow_inf_nan=False)]
_Side = Annotated[int, Field(ge=1)]


class _Background(Fields):
    id: Text = ""
    path: Place = ""
    sha256: Text = ""
    size_wh: Annotated[list[_Side], Field(min_length=2, max_length=2)] | None = None
    pitch_deg: _Number | None = None
    altitude_m: _Number | None = None
    time_of_day: Text | None = None


class _Inserted(Fields):
    category: Text = ""
    visibility: _Number | None = None
    extra: dict[Any, Any] = Field(default_factory=dict)


class FrameFields(Fields):
    """Fields of a frame record; what is not here is checked where it is read."""

    frame_id: Place
    image: Place
    image_sha256: Text
    background: _Background
    inserted: list[_Inserted]
    removed: list[dict[Any, Any]] = Field(default_factory=list)
    facts: dict[Any, Any] = Field(default_factory=dict)
    warnings: list[dict[Any, Any]] = Field(default_factory=list)
