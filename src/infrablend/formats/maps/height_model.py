"""Reads height models: rasters of the height of the ground, of which only differences count."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.ground_position import LocalFrame
from infrablend.core.mesh import FloatArray
from infrablend.errors import DatasetError, MissingDependencyError, Problem

_DEGREE_M = 111_195.0
# Cells along a side of what is read at most; a finer model is read more coarsely.
_MOST_CELLS = 4000


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """Heights of the ground on a lattice, metres east and north of an origin.

    Attributes:
        heights_m: (rows, columns) heights of the middles of cells, NaN where the model has none; the first row is in
            the south.
        low: (2,) south-western corner.
        cell_m: Side of a cell.
    """

    heights_m: FloatArray
    low: FloatArray
    cell_m: float

    def at(self, en: FloatArray) -> FloatArray:
        """Return (n,) heights at (n, 2) metres east and north, between the cells around; NaN beside the model."""
        at = (en - self.low) / self.cell_m - 0.5
        rows, columns = self.heights_m.shape
        inside = np.asarray(((at >= 0) & (at <= (columns - 1, rows - 1))).all(axis=1))
        cell = np.asarray(np.clip(np.where(inside[:, None], at, 0), 0, (columns - 2, rows - 2)), np.int64)
        x, y = (at - cell).T
        h = self.heights_m
        south = h[cell[:, 1], cell[:, 0]] * (1 - x) + h[cell[:, 1], cell[:, 0] + 1] * x
        north = h[cell[:, 1] + 1, cell[:, 0]] * (1 - x) + h[cell[:, 1] + 1, cell[:, 0] + 1] * x
        return np.where(inside, south * (1 - y) + north * y, np.nan)


def load_rasterio() -> Any:
    """Return the package that reads rasters.

    Raises:
        MissingDependencyError: It is not installed.
    """
    try:
        import rasterio
        import rasterio.warp
    except ImportError as error:
        raise MissingDependencyError(
            'rasterio is not installed, which height models need; install with\n  pip install "infrablend[terrain]"'
        ) from error
    return rasterio


def read_heights(path: Path, frame: LocalFrame, low: FloatArray, high: FloatArray) -> HeightGrid:
    """Return the part of a GeoTIFF's heights between two corners, (2,) metres east and north.

    Raises:
        MissingDependencyError: rasterio is not installed.
        DatasetError: The file is no height model.
    """
    rasterio = load_rasterio()
    try:
        with rasterio.open(path, driver="GTiff") as source:
            if source.crs is None or source.count != 1:
                found = f"{source.count} band(s), coordinates {source.crs or 'not stated'}"
                raise _refused(path, found)
            unit_m = _DEGREE_M if source.crs.is_geographic else source.crs.linear_units_factor[1]
            cell_m = max(abs(source.transform.e) * unit_m, float((high - low).max()) / _MOST_CELLS)
            columns, rows = (max(2, math.ceil(side / cell_m)) for side in high - low)
            north = float(low[1]) + rows * cell_m
            heights = np.full((rows, columns), np.nan)
            rasterio.warp.reproject(
                rasterio.band(source, 1), heights, dst_nodata=np.nan, resampling=rasterio.enums.Resampling.bilinear,
                dst_transform=rasterio.Affine(cell_m, 0.0, float(low[0]), 0.0, -cell_m, north),
                dst_crs=f"+proj=aeqd +datum=WGS84 +lat_0={frame.latitude_deg!r} +lon_0={frame.longitude_deg!r}",
            )  # fmt: skip
    except rasterio.errors.RasterioError as error:
        raise _refused(path, f"cannot be read: {error}"[:200]) from error
    return HeightGrid(heights[::-1], low, cell_m)


def _refused(path: Path, found: str) -> DatasetError:
    expected = "a GeoTIFF of heights in metres: one band, with its coordinates"
    return DatasetError(f"{path}: not a height model", [Problem(path.name, "terrain", found, expected)])
