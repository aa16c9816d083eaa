"""Names made out of data: the quick way for plain names gives what the whole way gives."""

import itertools
import re

import pytest

from infrablend.core import file_names
from infrablend.core.file_names import can_exist, file_name, fit_name, is_inside

PIECES = ("a", "0", "_", "-", ".", "..", "/", " ", "\t", "\\", ":", "\x01", "\u2028", "\u00e9", "\n", "nul")


def test_plain_names_are_what_the_whole_way_gives(monkeypatch):
    names = ["".join(pieces) for n in range(1, 5) for pieces in itertools.product(PIECES, repeat=n)]
    quick = [fit_name(name) for name in names]
    plain = sum(file_names._PLAIN.fullmatch(name) is not None for name in names)
    monkeypatch.setattr(file_names, "_PLAIN", re.compile("(?!)"))
    assert [fit_name(name) for name in names] == quick
    assert 1000 < plain < len(names) // 2


@pytest.mark.parametrize(
    ("name", "fit"),
    [
        ("day/con.png", "day/con_.png"),
        ("NUL", "NUL_"),
        ("lpt1/com\u00b9.tar.gz", "lpt1_/com\u00b9_.tar.gz"),
        ("console/com10.png", "console/com10.png"),
        ('a<b>c:"d"|?*.png', "a_b_c__d____.png"),
        ("dots../x.", "dots__/x_"),
        ("../x", "../x"),
    ],
)
def test_names_that_windows_reserves_get_others(name, fit):
    assert fit_name(name) == fit
    assert fit_name(fit) == fit


def test_names_of_files_are_no_devices():
    assert [file_name(n) for n in ("CON", "aux.v2", "con.", "concert")] == ["CON_", "aux_.v2", "con_", "concert"]


def test_paths_are_inside_by_their_parts(tmp_path):
    assert is_inside(tmp_path / "a" / "b", tmp_path / "a") and is_inside(tmp_path, tmp_path)
    assert not is_inside(tmp_path / "ab", tmp_path / "a")


def test_names_of_more_than_255_bytes_cannot_exist():
    assert can_exist("a/" + 255 * "b") and can_exist("")
    assert not can_exist("a/" + 128 * "\u00e9")
