"""HTML pages that need no other file: templates, styles and pictures are all inside the page."""

from __future__ import annotations

import base64
from functools import cache
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from infrablend.report.figures import compact, decimals, human_seconds, interval


def render_page(name: str, package: str = __package__, /, **content: Any) -> str:
    """Return the page `templates/NAME.html.jinja` of a package, filled with the content; all text is escaped.

    The same content gives the same bytes. Templates may use those of this package.
    """
    return _environment(package).get_template(f"{name}.html.jinja").render(**content)


def page_part(name: str) -> str:
    """Return the text of `templates/NAME.jinja`, such as a script."""
    return _environment(__package__).get_template(f"{name}.jinja").render()


@cache
def _environment(package: str) -> Environment:
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader(__package__)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "compact": compact,
        "data_uri": _data_uri,
        "decimals": decimals,
        "interval": interval,
        "seconds": human_seconds,
    }
    return environment


def _data_uri(png: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
