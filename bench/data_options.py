"""Options that several measurements of annotated datasets share."""

from __future__ import annotations

import argparse
from pathlib import Path


def data_parser(description: str | None) -> argparse.ArgumentParser:
    """Return a parser of datasets (`data`), the class of the objects (`--category`) and a split (`--split`)."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("data", type=Path, nargs="+")
    parser.add_argument("--category", default="Car")
    parser.add_argument("--split", default="train")
    return parser
