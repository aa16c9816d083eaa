"""MONET (Riz et al. 2023): COCO JSON that contains the drone's telemetry, pictures in one folder per sequence.

    [train/|val/|test/]<sequence>/lwir/image*.png      COCO files anywhere below the folder

No file of MONET was at hand. Known are: COCO, PNG in `<sequence>/lwir`, sequences `runway_NN` and `dirtroad_NN`,
telemetry inside the annotation files and empty for some of them, and a gimbal pitch below 0 for a camera that looks
down. The place of the JSON files, the way they name pictures, keys, units and sizes are searched for, reported in
`Dataset.notes`, checked, and can be set by options. docs/formats/monet.md lists the source of each assumption.
"""

from infrablend.formats.published.monet.folders import (
    ALTITUDE_KEYS,
    NAME,
    OPTIONS,
    PITCH_KEYS,
    TIME_KEYS,
    detect,
    find_files,
)
from infrablend.formats.published.monet.monet_reading import read
from infrablend.formats.published.monet.monet_writing import write
from infrablend.formats.published.monet.telemetry import NEST

__all__ = [
    "ALTITUDE_KEYS",
    "NAME",
    "NEST",
    "OPTIONS",
    "PITCH_KEYS",
    "TIME_KEYS",
    "detect",
    "find_files",
    "read",
    "write",
]
