"""Tells addresses of object storage, such as `s3://bucket/run`, from folders."""

from __future__ import annotations

import re
from pathlib import Path

from infrablend.errors import ArgumentError

# `Path` makes `s3:/bucket` of `s3://bucket`. One letter would be a drive.
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+:)/")


_USER = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+:/{1,2})[^/\s]*@")


def without_user(text: str) -> str:
    """Return a text in which addresses such as `s3://name:password@bucket` have `...` for name and password."""
    return _USER.sub(r"\1...@", text)


def require_folder(name: str, path: str | Path) -> None:
    """Check that an argument is no address, which would be taken for a folder named `s3:` in the working directory.

    The message shows the scheme only, because an address may contain a password.

    Args:
        name: Name of the argument, for the message.
        path: Value of the argument.

    Raises:
        ArgumentError: It is an address, and no folder of that name exists.
    """
    found = _ADDRESS.match(str(path))
    if found is None or Path(found[1]).is_dir():
        return
    raise ArgumentError(
        f"{name}: found an address, {found[1]}//..., expected a folder. Give a local or mounted one, "
        "and copy it from or to the storage with the storage's own program"
    )
