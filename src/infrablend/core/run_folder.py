"""The folder of a run: its paths and its ledger. docs/reference/run_folder.md describes what each file contains."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from infrablend.core.dataset import SPLITS
from infrablend.core.file_names import join_inside
from infrablend.core.files import has_size
from infrablend.core.frame_row import FrameRecord
from infrablend.core.ledger import LEDGER, DoneFrame, Ledger
from infrablend.core.run_record import RunRecord
from infrablend.core.workspace import unfinished
from infrablend.errors import OutputError

RUN_FILE = "run.json"
IMAGES = "images"
EIGHT_BIT = "8bit"
TRACKS = "tracks"
VIDEO = "video"
PICTURE_TABLES = tuple(f"{IMAGES}/{split}/metadata.jsonl" for split in SPLITS)
"""Tables with the labels of the pictures beside them, as Hugging Face's `imagefolder` reads them."""
EXCLUDED = "excluded"
WORKERS_LOG = "workers.log"
"""Output of the workers, kept while a run is unfinished or if a frame failed."""
DERIVED = ("preview.png", "ground.png", "realism")
"""What `preview` and `realism` write into the folder of a run, unless told otherwise."""
SHARDS_FILE = "shards.json"
"""Plan of a run in shards, in the folder that has a folder per shard."""


@dataclass(frozen=True)
class RunFolder:
    """Folder of a run.

    A path that leads out of the folder is a `ValueError`; reading what is no finished run is an `OutputError`.

    Attributes:
        root: The folder, or the workspace of an unfinished run.
    """

    root: Path

    @property
    def run_file(self) -> Path:
        """Summary of the run: settings, counts, problems."""
        return self.root / RUN_FILE

    @property
    def report_file(self) -> Path:
        """Report of the run, a page for browsers."""
        return self.root / "report.html"

    def image(self, relative: str) -> Path:
        """Return an image by its path below `images/`, e.g. `train/a_c0.jpg`."""
        return join_inside(self.root / IMAGES, relative)

    def excluded(self, relative: str) -> Path:
        """Return where an image is while its frame is left out, by its path below `images/`."""
        return join_inside(self.root / EXCLUDED, relative)

    def has_picture(self, frame: DoneFrame) -> bool:
        """Return whether a picture is there, in its place or left out, with the size in the ledger."""
        return any(has_size(path, frame.bytes) for path in (self.image(frame.image), self.excluded(frame.image)))

    def labels(self, format_name: str) -> Path:
        """Return the folder with the labels of one format."""
        return self.root / format_name

    @property
    def eight_bit(self) -> Path:
        """Folder of the dataset with 8-bit pictures: `images/`, and a folder per label format."""
        return self.root / EIGHT_BIT

    def coco_file(self, split: str) -> Path:
        """Return the COCO file of a split."""
        return self.labels("coco") / f"{split}.json"

    def ledger(self) -> Ledger:
        """Open the ledger of the run for reading."""
        if not (self.root / LEDGER).is_file():
            raise OutputError(f"{self.root}: {self._what_it_is()}")
        return Ledger.open(self.root)

    def read_run(self) -> RunRecord:
        """Return the record of the run."""
        with self.ledger() as ledger:
            return ledger.read_run()

    def records(self) -> Iterator[FrameRecord]:
        """Yield the records of all frames of the finished run that are not left out, by id."""
        with self.ledger() as ledger:
            yield from ledger.records()

    def record(self, frame_id: str) -> FrameRecord:
        """Return the record of a frame; an `OutputError` if the run has no such frame."""
        with self.ledger() as ledger:
            try:
                return ledger.record(frame_id)
            except KeyError:
                ids = ledger.frame_ids()
        near = [i for i in ids if i.rpartition("/")[2] == frame_id.rpartition("/")[2]] or ids
        hint = f", such as {near[0]}" if near else ""
        raise OutputError(f"{self.root}: no finished frame {frame_id!r}; expected the id of a frame{hint}")

    def _what_it_is(self) -> str:
        if (left := unfinished(self.root)) is not None:
            return f"not finished; {left}"
        if os.path.lexists(self.root / SHARDS_FILE):
            return f"shards of a run, expected a run. Merge the shards first: infrablend merge {self.root} DST"
        return "not the folder of a run; expected one that `infrablend generate` or `infrablend merge` wrote"


def kept_aside(folder: Path) -> frozenset[str]:
    """Return the names of folders of a run that are no part of its dataset: frames left out; none for others."""
    return frozenset({EXCLUDED} if (folder / LEDGER).is_file() else ())


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
        """Pictures, labels and records of the frames."""
        return self.folder / f"{self.name}.tar"

    @property
    def table(self) -> Path:
        """Parquet table with a row per frame."""
        return self.folder / f"{self.name}.parquet"

    @property
    def marker(self) -> Path:
        """Record of the shard; it is written last."""
        return self.folder / f"{self.name}.json"
