"""Addresses of object storage, such as `s3://bucket/run`, beside paths of folders.

Both are `Path` objects, so that they can be given wherever a folder can. `Path` makes `s3:/bucket/run` of the address;
`address_of` returns what was meant.
"""

from __future__ import annotations

import re
from pathlib import Path

from infrablend.errors import ArgumentError

# `Path` leaves one slash. One letter would be a drive.
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/{1,2}(.*)", re.DOTALL)
_USER = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+:/{1,2})[^/\s]*@")
_QUERY = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+:/{1,2}[^\s?'\"]*\?)[^\s'\"]+")

_NO_STORAGE = frozenset({"data", "file", "ftp", "http", "https", "local", "memory"})
"""Schemes of fsspec that are no storage which several jobs can write to."""


def without_user(text: str) -> str:
    """Return a text in which addresses have `...` for name and password, and for what follows `?`, as signatures do."""
    return _QUERY.sub(r"\1...", _USER.sub(r"\1...@", text))


def address_of(path: str | Path) -> str | None:
    """Return the address that a path was made of, with single slashes and none at its end; None for a folder.

    A folder in the working directory with the name of a scheme, such as `ftp:`, hides the addresses of that scheme. It
    hides none of `s3`: a run would silently stay on this machine.
    """
    found = _ADDRESS.fullmatch(str(path))
    if found is None or (found[1].lower() != "s3" and Path(f"{found[1]}:").is_dir()):
        return None
    return f"{found[1].lower()}://{'/'.join(part for part in found[2].split('/') if part not in ('', '.'))}"


def shown(path: str | Path) -> str:
    """Return the text of a path, or of the address that it was made of, without a password."""
    address = address_of(path)
    return str(path) if address is None else without_user(address)


def require_folder(name: str, path: str | Path) -> None:
    """Check that an argument is no address, which would be taken for a folder named `s3:` in the working directory.

    The message shows the scheme only, because an address may contain a password.

    Raises:
        ArgumentError: It is an address.
    """
    if (address := address_of(path)) is None:
        return
    scheme = address.partition("://")[0]
    raise ArgumentError(
        f"{name}: found an address, {scheme}://..., expected a folder. Give a local or mounted one, "
        "and copy it from or to the storage with the storage's own program"
    )


def require_known(name: str, path: str | Path) -> None:
    """Check that an argument is a folder, or an address without a password that may be one of object storage.

    Raises:
        ArgumentError: It is another address; the message shows its scheme only.
    """
    if (address := address_of(path)) is None:
        return
    scheme, _, rest = address.partition("://")
    if scheme in _NO_STORAGE:
        raise ArgumentError(
            f"{name}: found an address, {scheme}://..., expected a folder or one of object storage, such as s3://"
        )
    if "@" in rest.partition("/")[0] or "?" in rest or "#" in rest:
        raise ArgumentError(
            f"{name}: found {scheme}://... with a name, a password or options; expected {scheme}://BUCKET/FOLDER. "
            "Credentials are taken from where the storage's library looks for them: environment, profile, instance"
        )
    if ".." in rest.split("/"):
        raise ArgumentError(f"{name}: found {address}, expected no '..', which is a name in object storage")
    if not rest.partition("/")[2]:
        raise ArgumentError(f"{name}: found {address}, expected a folder in it, such as {scheme}://BUCKET/FOLDER")
