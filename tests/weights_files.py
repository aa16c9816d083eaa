"""Small files of the layout of Ultralytics' weights, without tensors."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path
from types import SimpleNamespace


def write_weights(path: Path, head: str = "Detect", network: str = "yolov5n") -> Path:
    """Write a .pt file whose network has that name and ends in that head."""
    yaml = {"head": [[[-1], 1, head, ["nc"]]], "yaml_file": f"{network}.yaml"}
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(
            zipfile.ZipInfo(f"{path.stem}/data.pkl"),
            pickle.dumps({"ema": None, "model": SimpleNamespace(yaml=yaml)}),
        )
    return path
