"""The mark in pictures that InfraBlend writes, by which a later call knows that it may replace them."""

from __future__ import annotations

from pathlib import Path

from infrablend.formats.pictures import open_picture

CONTACT_SHEET = "InfraBlend contact sheet"


def software_of(path: Path) -> str | None:
    """Return the program that a PNG file names as its author; None if it names none or cannot be read."""
    try:
        with open_picture(path, ("PNG",)) as picture:
            named = picture.info.get("Software")
    except (OSError, ValueError, SyntaxError, ImportError):  # Ultralytics, once imported, tries a library it may lack
        return None
    return named if isinstance(named, str) else None
