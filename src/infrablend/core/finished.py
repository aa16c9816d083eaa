"""Names of the records of commands: what stands in a folder with such a record is complete, see `core.workspace`."""

from collections.abc import Mapping

CONVERT_FILE = "convert.json"
SPLIT_FILE = "split.json"
WORLD_FILE = "world.json"
FRAMES_FILE = "frames.json"
TEMPERATURES_FILE = "temperatures.json"

COMPLETE = "complete"


def is_finished(record: Mapping[str, object]) -> bool:
    """Return whether a record says that its folder is finished."""
    return record.get("status", COMPLETE) == COMPLETE
