"""Pictures in terminals: recognised by environment variables, and the text decodes to the picture."""

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

from infrablend.cli.terminal_picture import picture_protocol, picture_text


def png(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


NOISE = png(np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8))


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, None),
        ({"TERM": "xterm-256color"}, None),
        ({"TERM": "xterm-kitty"}, "kitty"),
        ({"TERM_PROGRAM": "ghostty"}, "kitty"),
        ({"TERM": "xterm-256color", "KONSOLE_VERSION": "230805"}, "kitty"),
        ({"TERM_PROGRAM": "iTerm.app"}, "iterm"),
        ({"TERM_PROGRAM": "WezTerm"}, "iterm"),
        ({"TERM": "foot"}, "sixel"),
        ({"TERM": "mlterm"}, "sixel"),
        ({"TERM": "xterm-kitty", "TMUX": "/tmp/tmux"}, None),
        ({"TERM": "xterm-kitty", "INFRABLEND_PICTURES": "none"}, None),
        ({"TERM": "xterm", "INFRABLEND_PICTURES": "sixel"}, "sixel"),
    ],
)
def test_the_environment_names_the_protocol(environment, expected):
    assert picture_protocol(environment) == expected


def test_kitty_gets_the_file_in_chunks_and_is_asked_for_no_answer():
    commands = re.findall(r"\x1b_G([^;]*);([^\x1b]*)\x1b\\", picture_text(NOISE, "kitty"))
    assert base64.b64decode("".join(data for _, data in commands)) == NOISE
    assert commands[0][0] == "a=T,f=100,q=2,m=1"
    assert [control for control, _ in commands[1:]] == ["q=2,m=1"] * (len(commands) - 2) + ["q=2,m=0"]
    assert max(len(data) for _, data in commands) == 4096


def test_iterm_gets_the_file_inline():
    ((size, data),) = re.findall(
        r"\x1b\]1337;File=inline=1;size=(\d+);[^:]*:([^\x07]*)\x07", picture_text(NOISE, "iterm")
    )
    assert int(size) == len(NOISE)
    assert base64.b64decode(data) == NOISE


def test_sixels_decode_to_the_picture():
    pixels = np.zeros((15, 40, 3), np.uint8)
    pixels[3:9, 5:30] = (255, 0, 0)
    pixels[9:, 20:] = 255
    shown = decode_sixel(picture_text(png(pixels), "sixel"))
    assert (shown == pixels).all()


def decode_sixel(text: str) -> np.ndarray:
    body = re.fullmatch(r"\x1bPq(.*)\x1b\\\n", text, re.DOTALL).group(1)
    width, height = map(int, re.match(r'"1;1;(\d+);(\d+)', body).groups())
    canvas, palette = np.zeros((height + 6, width, 3), np.uint8), {}
    x = y = colour = 0
    for token in re.findall(r'"[\d;]+|#\d+;2;\d+;\d+;\d+|#\d+|!\d+[?-~]|[$-]|[?-~]', body):
        if token.startswith("#") and ";" in token:
            number, _, *rgb = map(int, token[1:].split(";"))
            palette[number] = np.round(np.array(rgb) * 2.55)
        elif token.startswith("#"):
            colour = int(token[1:])
        elif token in "$-":
            x, y = 0, y + 6 * (token == "-")
        elif not token.startswith('"'):
            count = int(token[1:-1]) if token.startswith("!") else 1
            bits = ord(token[-1]) - 63
            for row in range(6):
                if bits >> row & 1:
                    canvas[y + row, x : x + count] = palette[colour]
            x += count
    return canvas[:height]
