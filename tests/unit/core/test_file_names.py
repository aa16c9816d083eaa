"""Names made out of data: the quick way for plain names gives what the whole way gives."""

import itertools
import re

from infrablend.core import file_names
from infrablend.core.file_names import fit_name

PIECES = ("a", "0", "_", "-", ".", "..", "/", " ", "\t", "\\", ":", "\x01", "\u2028", "\u00e9", "\n")


def test_plain_names_are_what_the_whole_way_gives(monkeypatch):
    names = ["".join(pieces) for n in range(1, 5) for pieces in itertools.product(PIECES, repeat=n)]
    quick = [fit_name(name) for name in names]
    plain = sum(file_names._PLAIN.fullmatch(name) is not None for name in names)
    monkeypatch.setattr(file_names, "_PLAIN", re.compile("(?!)"))
    assert [fit_name(name) for name in names] == quick
    assert 1000 < plain < len(names) // 2
