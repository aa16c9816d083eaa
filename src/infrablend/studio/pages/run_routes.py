"""Routes with the frames of the opened run. Frames are named by number, so that no path comes from a request."""

from __future__ import annotations

import json
from collections.abc import Callable

from nicegui import app
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from infrablend.errors import DatasetError, InfraBlendError
from infrablend.studio.frame_index import View
from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.pictures import crop_picture, frame_picture

_KEEP = {"cache-control": "private, max-age=3600"}


def add_routes(run: OpenedRun) -> None:
    """Add the routes below `/run/`."""

    @app.get("/run/rows")
    def rows(request: Request) -> Response:
        def answer() -> bytes:
            found, verdicts = run.rows, run.review.words
            chosen = View.from_query(dict(request.query_params)).apply(found, verdicts)
            listed = [(n, found[n].id, found[n].digest[:12], verdicts.get(found[n].id, "")) for n in chosen]
            return json.dumps(listed).encode()

        return _answered(answer, "application/json", {"cache-control": "no-store"})

    @app.get("/run/thumb/{number}.jpg")
    def thumbnail(number: int) -> Response:
        return _answered(lambda: run.thumbnails.get(run.row(number)), "image/jpeg", _KEEP)

    @app.get("/run/picture/{number}.png")
    def picture(number: int, boxes: bool = False) -> Response:
        return _answered(lambda: frame_picture(run.layout, run.row(number), boxes=boxes), "image/png", _KEEP)

    @app.get("/run/crop/{number}/{insert}.png")
    def crop(number: int, insert: int) -> Response:
        return _answered(lambda: crop_picture(run.layout, run.row(number), insert), "image/png", _KEEP)


def _answered(make: Callable[[], bytes], media_type: str, headers: dict[str, str]) -> Response:
    try:
        return Response(make(), media_type=media_type, headers=headers)
    except InfraBlendError as error:
        return PlainTextResponse(error.message, 404 if isinstance(error, DatasetError) else 500)
