"""Names of the files in the folder of a training."""

from __future__ import annotations

RECORD = "train.json"
JOB = "job.json"
CHECKPOINT = "checkpoint.pt"
NEW_CHECKPOINT = "checkpoint.new"
DAMAGED = "checkpoint.damaged.pt"
WEIGHTS = "weights.pt"
LOG = "train.log"
DATA = "data"
TILES = "tiles"
EIGHT_BIT = "8bit"
RUN = "run"
ULTRALYTICS = "ultralytics"
WORKING_FILES = (DATA, TILES, EIGHT_BIT, RUN, ULTRALYTICS, CHECKPOINT, NEW_CHECKPOINT)
"""What only an unfinished training needs."""
