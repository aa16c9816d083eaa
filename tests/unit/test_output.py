"""Places that commands must not write to."""

from __future__ import annotations

from pathlib import Path

import pytest

from infrablend.core.output_checks import require_apart, require_replaceable
from infrablend.errors import OutputError


def test_data_and_output_must_be_apart(tmp_path: Path) -> None:
    for data, out in (("a", "a"), ("a/b", "a"), ("a", "a/b")):
        with pytest.raises(OutputError, match="data folder"):
            require_apart(tmp_path / data, tmp_path / out)
    require_apart(tmp_path / "a", tmp_path / "ab")


def test_foreign_file_is_not_replaced(tmp_path: Path) -> None:
    file = tmp_path / "sheet.png"
    require_replaceable(file, "contact sheet", ours=False)
    file.write_text("mine")
    require_replaceable(file, "contact sheet", ours=True)
    with pytest.raises(OutputError, match=r"sheet\.png: exists and is not a contact sheet of InfraBlend; nothing was"):
        require_replaceable(file, "contact sheet", ours=False)
    with pytest.raises(OutputError, match="is a folder"):
        require_replaceable(tmp_path, "contact sheet", ours=True)
