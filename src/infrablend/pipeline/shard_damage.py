"""Compares the files of a packed shard with the sizes and digests in its record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from infrablend.core.files import sha256_of
from infrablend.core.run_layout import ShardFiles
from infrablend.pipeline.folder import ARCHIVE
from infrablend.pipeline.shard import Shard


def number_damage(record: Mapping[str, Any], shard: Shard | None) -> str | None:
    """Return what is wrong if a record is that of another shard than its name says; None if nothing is."""
    if shard is None or record.get("shard") == str(shard):
        return None
    return f"it is the record of shard {record.get('shard')}, expected {shard}"


def damage_of(files: ShardFiles, record: Mapping[str, Any], *, digests: bool = True) -> str | None:
    """Return what is wrong with the tar or the table of a finished shard; None if both are as they were written.

    Args:
        files: Files of the shard.
        record: Its record.
        digests: Whether to read the files; otherwise only their sizes are compared.
    """
    for path, name in ((files.tar, "tar"), (files.table, "table")):
        try:
            facts = record[ARCHIVE][name]
            if not path.is_file():
                return f"{path.name} is missing"
            if (size := path.stat().st_size) != facts["bytes"]:
                return f"{path.name} has {size} bytes, expected {facts['bytes']}"
            if digests and sha256_of(path, files.folder) != facts["sha256"]:
                return f"{path.name} was changed after it was written"
        except OSError as error:
            return f"{path.name} cannot be read ({error.strerror or error})"
        except (LookupError, TypeError):
            return f"{files.marker.name} is damaged: no facts about the {name}"
    return None
