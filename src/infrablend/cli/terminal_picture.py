"""Shows PNG pictures in terminals that can: by the protocols of kitty and iTerm, or as sixels.

The terminal is recognised by its environment variables. It is never asked, because a terminal that does not answer
would make the program wait.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from typing import Literal, get_args

Protocol = Literal["kitty", "iterm", "sixel"]

VARIABLE = "INFRABLEND_PICTURES"
"""Environment variable that overrides the choice: kitty, iterm, sixel, or anything else for none."""

CLEAR = "\x1b[2J\x1b[3J\x1b[H"
"""Clears the screen, so that the next picture takes the place of the last one."""

_CHUNK = 4096  # kitty's limit
_COLOURS = 64
_BAND_PX = 6


def picture_protocol(environment: Mapping[str, str]) -> Protocol | None:
    """Return the protocol of the terminal that these environment variables describe; None if it shows no pictures."""
    if VARIABLE in environment:
        return next((p for p in get_args(Protocol) if p == environment[VARIABLE].lower()), None)
    if "TMUX" in environment or "STY" in environment:  # they do not pass pictures on
        return None
    term, program = environment.get("TERM", ""), environment.get("TERM_PROGRAM", "")
    if "kitty" in term or "ghostty" in term or program == "ghostty" or "KITTY_WINDOW_ID" in environment:
        return "kitty"
    if program in {"iTerm.app", "WezTerm", "mintty"} or environment.get("LC_TERMINAL") == "iTerm2":
        return "iterm"
    if term.startswith(("foot", "mlterm", "contour", "yaft")) or "sixel" in term:
        return "sixel"
    return "kitty" if "KONSOLE_VERSION" in environment else None


def picture_text(png: bytes, protocol: Protocol) -> str:
    """Return the text that shows a PNG file in a terminal with this protocol."""
    if protocol == "kitty":
        return _kitty(png)
    return _iterm(png) if protocol == "iterm" else _sixel(png)


def _kitty(png: bytes) -> str:
    """Return kitty's graphics commands: format 100 is PNG, `a=T` shows it, `q=2` asks for no answer."""
    data = base64.standard_b64encode(png).decode()
    chunks = [data[k : k + _CHUNK] for k in range(0, len(data), _CHUNK)]
    commands = []
    for k, chunk in enumerate(chunks):
        control = f"{'a=T,f=100,q=2,' if k == 0 else 'q=2,'}m={int(k + 1 < len(chunks))}"
        commands.append(f"\x1b_G{control};{chunk}\x1b\\")
    return "".join(commands) + "\n"


def _iterm(png: bytes) -> str:
    data = base64.standard_b64encode(png).decode()
    return f"\x1b]1337;File=inline=1;size={len(png)};preserveAspectRatio=1:{data}\x07\n"


def _sixel(png: bytes) -> str:
    """Return the picture as sixels of at most 64 colours: bands of six rows, each colour of a band in turn."""
    import numpy as np
    from PIL import Image

    with Image.open(io.BytesIO(png)) as picture:
        quantized = picture.convert("RGB").quantize(_COLOURS)
    index = np.asarray(quantized)
    palette = np.array(quantized.getpalette(), np.int64).reshape(-1, 3)[:_COLOURS]
    percent = (palette * 100 + 127) // 255
    h, w = index.shape
    parts = [f'\x1bPq"1;1;{w};{h}']
    parts += [f"#{k};2;{r};{g};{b}" for k, (r, g, b) in enumerate(percent.tolist())]
    for top in range(0, h, _BAND_PX):
        band = index[top : top + _BAND_PX]
        weights = 1 << np.arange(len(band))
        rows = [f"#{k}" + _runs((weights @ (band == k)).tolist()) for k in np.unique(band).tolist()]
        parts.append("$".join(rows) + "-")
    return "".join(parts) + "\x1b\\\n"


def _runs(columns: list[int]) -> str:
    """Return the sixel characters of a row of columns, with repeated ones shortened."""
    text, start = [], 0
    for k in range(1, len(columns) + 1):
        if k < len(columns) and columns[k] == columns[start]:
            continue
        character, count = chr(63 + columns[start]), k - start
        text.append(f"!{count}{character}" if count > 3 else character * count)
        start = k
    return "".join(text)
