"""Paths inside the folder of a run. docs/reference/run_folder.md describes what each file contains."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from infrablend.core.dataset import SPLITS
from infrablend.core.file_names import join_inside

RUN_FILE = "run.json"
IMAGES = "images"
SCENES = "scenes"
LOGS = "log"
EIGHT_BIT = "8bit"
PICTURE_TABLES = tuple(f"{IMAGES}/{split}/metadata.jsonl" for split in SPLITS)
"""Tables with the labels of the pictures beside them, as Hugging Face's `imagefolder` reads them."""
EXCLUDED = "excluded"
EXCLUDED_FILE = "excluded.json"
REPORT_FILE = "report.html"
SHARDS_FILE = "shards.json"
"""Plan of a run in shards, in the folder that has a folder per shard."""


@dataclass(frozen=True)
class RunLayout:
    """Paths of a run; nothing is read or written here.

    A path that leads out of the folder is a `ValueError`.

    Attributes:
        root: Folder of the run.
    """

    root: Path

    @property
    def run_file(self) -> Path:
        """Record of the run: settings, counts, problems."""
        return self.root / RUN_FILE

    @property
    def report_file(self) -> Path:
        """Report of the run, a page for browsers."""
        return self.root / REPORT_FILE

    @property
    def log_folder(self) -> Path:
        """Folder of the log files."""
        return self.root / LOGS

    def image(self, relative: str) -> Path:
        """Return an image by its path below `images/`, e.g. `train/a_c0.jpg`."""
        return join_inside(self.root / IMAGES, relative)

    def record(self, frame_id: str) -> Path:
        """Return the record of a frame, e.g. `train/a_c0`: its scene, its labels and the decisions made."""
        return join_inside(self.root / SCENES, f"{frame_id}.json")

    def records(self, split: str = "") -> list[Path]:
        """Return the records that exist, of one split or of all, sorted."""
        return sorted((self.root / SCENES / split).rglob("*.json"))

    def frame_id(self, record: Path) -> str:
        """Return the frame that a record describes, the inverse of `record`."""
        return record.relative_to(self.root / SCENES).with_suffix("").as_posix()

    def labels(self, format_name: str) -> Path:
        """Return the folder with the labels of one format."""
        return self.root / format_name

    @property
    def excluded_file(self) -> Path:
        """File with the frames that were left out after the run."""
        return self.root / EXCLUDED_FILE

    @property
    def eight_bit(self) -> Path:
        """Folder of the dataset with 8-bit pictures: `images/`, and a folder per label format."""
        return self.root / EIGHT_BIT

    def coco_file(self, split: str) -> Path:
        """Return the COCO file of a split."""
        return self.labels("coco") / f"{split}.json"


@dataclass(frozen=True)
class ShardFiles:
    """Files of a finished shard of a run with `output.layout: shards`.

    Attributes:
        folder: Folder that they are in.
        name: Name of the shard, the stem of all of them.
    """

    folder: Path
    name: str

    @property
    def tar(self) -> Path:
        """Pictures, labels and scenes."""
        return self.folder / f"{self.name}.tar"

    @property
    def table(self) -> Path:
        """Parquet table with a row per frame."""
        return self.folder / f"{self.name}.parquet"

    @property
    def marker(self) -> Path:
        """Record of the shard; it is written last."""
        return self.folder / f"{self.name}.json"
