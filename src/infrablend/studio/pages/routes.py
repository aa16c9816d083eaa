"""Routes of the pictures and rows. They are named by number, so that no path comes from a request."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING

from nicegui import app
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from infrablend.errors import DatasetError, InfraBlendError
from infrablend.studio.frame_index import View
from infrablend.studio.opened_run import OpenedRun

if TYPE_CHECKING:
    from infrablend.studio.tuning import Tuning

KEEP = {"cache-control": "private, max-age=3600"}
Pictures = OrderedDict[int, bytes]
"""The last pictures, by number."""


def add_run_routes(run: OpenedRun) -> None:
    """Add the routes below `/run/`."""

    @app.get("/run/rows")
    def rows(request: Request) -> Response:
        def answer() -> bytes:
            reading = run.reading
            verdicts = run.review.words
            view = View.from_query(dict(request.query_params))
            complete = reading.is_complete
            if not complete and view.needs_names_only:
                found = reading.names
            else:
                found = reading.wait()
                complete = True
            chosen = view.apply(found, verdicts, run.disagreement)
            listed = [(n, found[n].id, found[n].digest[:12], verdicts.get(found[n].id, "")) for n in chosen]
            return json.dumps({"rows": listed, "complete": complete}).encode()

        return answered(answer, "application/json", {"cache-control": "no-store"})

    @app.get("/run/sequences/{number}")
    def sequence(number: int) -> Response:
        def answer() -> bytes:
            found = run.sequences
            rows = run.rows
            if not 0 <= number < len(found):
                raise DatasetError(f"sequence {number}: no such sequence; the run has {len(found)}")
            shown = found[number]
            tracks = [
                {
                    "category": track.category, "id": track.id, "inserted": track.inserted,
                    "at": [at for at, _ in track.boxes],
                    "boxes": [[round(v, 2) for v in box] for _, box in track.boxes],
                }
                for track in shown.tracks
            ]  # fmt: skip
            frames = [(n, rows[n].id, rows[n].digest[:12]) for n in shown.frames]
            return json.dumps({"frames": frames, "times": shown.times_s, "tracks": tracks}).encode()

        return answered(answer, "application/json", {"cache-control": "no-store"})

    @app.get("/run/thumb/{number}.jpg")
    def thumbnail(number: int) -> Response:
        return answered(lambda: run.thumbnails.get(run.row(number)), "image/jpeg", KEEP)

    @app.get("/run/picture/{number}.png")
    def picture(number: int, boxes: bool = False, originals: bool = False) -> Response:
        return answered(lambda: run.picture(number, boxes=boxes, originals=originals), "image/png", KEEP)

    @app.get("/run/crop/{number}/{insert}.png")
    def crop(number: int, insert: int) -> Response:
        return answered(lambda: run.crop(number, insert), "image/png", KEEP)


def answered(make: Callable[[], bytes], media_type: str, headers: dict[str, str]) -> Response:
    """Return what a function makes, or its error in words."""
    try:
        return Response(make(), media_type=media_type, headers=headers)
    except InfraBlendError as error:
        return PlainTextResponse(error.message, 404 if isinstance(error, DatasetError) else 500)


def add_tune_routes(open_tuning: Callable[[], Tuning]) -> Pictures:
    """Add the routes of the pictures and of small ones of models and backgrounds; return where to put the pictures."""
    pictures: Pictures = OrderedDict()

    @app.get("/tune/model/{name}.jpg")
    def model(name: str) -> Response:
        return answered(lambda: open_tuning().model_picture(name), "image/jpeg", KEEP)

    @app.get("/tune/background/{number}.jpg")
    def background(number: int) -> Response:
        return answered(lambda: open_tuning().thumbnail(number), "image/jpeg", KEEP)

    @app.get("/tune/picture/{number}.png")
    def picture(number: int) -> Response:
        data = pictures.get(number)
        if data is None:
            return PlainTextResponse("a picture that has been replaced by a newer one", 404)
        return Response(data, media_type="image/png", headers=KEEP)

    return pictures
