"""The pictures of the tuning pages, kept until the browsers have fetched them."""

from __future__ import annotations

from collections import OrderedDict

from nicegui import app
from starlette.responses import PlainTextResponse, Response

Pictures = OrderedDict[int, bytes]
"""The last pictures, by number."""


def add_routes() -> Pictures:
    """Add the route of the pictures; return where to put them."""
    pictures: Pictures = OrderedDict()

    @app.get("/tune/picture/{number}.png")
    def picture(number: int) -> Response:
        data = pictures.get(number)
        if data is None:
            return PlainTextResponse("a picture that has been replaced by a newer one", 404)
        return Response(data, media_type="image/png", headers={"cache-control": "private, max-age=3600"})

    return pictures
