"""The parts of a page: tables, numbers and pictures, the same in HTML, in Markdown and on the command line.

HTML pages need no other file: templates, styles and pictures are all inside the page.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from infrablend.report.figures import decimals


@dataclass(frozen=True)
class Table:
    """A table of text: its head, its rows, and what it shows, in words."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""

    def markdown(self, align: Sequence[str] | None = None) -> str:
        """Return the table in Markdown; `align` holds a column's rule, such as `---:`."""
        lines = [self.head, align or ["---"] * len(self.head), *self.rows]
        return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in lines)


def bullets(items: Iterable[str]) -> str:
    """Return a list in Markdown."""
    return "\n".join(f"* {item}" for item in items)


def markdown_page(blocks: Iterable[str]) -> str:
    """Return a page in Markdown of its headings, paragraphs and tables; empty ones are left out."""
    return "\n\n".join(block for block in blocks if block) + "\n"


def render_page(name: str, package: str = __package__, /, **content: Any) -> str:
    """Return the page `templates/NAME.html.jinja` of a package, filled with the content; all text is escaped.

    The same content gives the same bytes. Templates may use those of this package.
    """
    return _environment(package).get_template(f"{name}.html.jinja").render(**content)


def page_part(name: str) -> str:
    """Return the text of `templates/NAME.jinja`, such as a script."""
    return _environment(__package__).get_template(f"{name}.jinja").render()


def data_uri(data: bytes, kind: str = "png") -> str:
    """Return a picture as an address that contains it."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


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
    environment.filters |= {"data_uri": data_uri, "decimals": decimals}
    return environment
