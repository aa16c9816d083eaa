"""What differs between CSV files of different countries: the separator of columns, and the meaning of commas."""

from __future__ import annotations

import re
from collections.abc import Sequence

_DECIMAL_POINT = re.compile(r"[-+]?\d+\.\d+", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+", re.ASCII)
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+", re.ASCII)
# Characters that are searched for separators, and rows for decimal points and commas.
_LINE_CHARACTERS, _ROWS = 20_000, 200


def delimiter_of(text: str, lines: int = 1) -> str:
    """Return what separates columns: what occurs most often in the first lines, comma, semicolon or tab."""
    start = "\n".join(text[:_LINE_CHARACTERS].splitlines()[:lines])
    return max(",;\t", key=start.count)


def comma_of(rows: Sequence[Sequence[str]], delimiter: str) -> str:
    """Return what stands for a comma in numbers: nothing where it separates thousands, else a decimal point.

    Args:
        rows: Cells of the table; some rows are looked at.
        delimiter: What separates its columns.
    """
    cells = [cell.strip() for row in rows[:: max(1, len(rows) // _ROWS)] for cell in row]
    if any(_DECIMAL_POINT.fullmatch(c) for c in cells):
        return ""
    decimal = any(_DECIMAL_COMMA.fullmatch(c) and not _THOUSANDS.fullmatch(c) for c in cells)
    return "." if decimal or delimiter != "," else ""
