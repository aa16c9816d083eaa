"""Names of the records of commands: what stands in a folder with such a record is complete, see `core.workspace`."""

CONVERT_FILE = "convert.json"
SPLIT_FILE = "split.json"
WORLD_FILE = "world.json"
FRAMES_FILE = "frames.json"
TEMPERATURES_FILE = "temperatures.json"
