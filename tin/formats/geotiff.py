"""GeoTIFF: the surface of the TIN, or its error, on the grid of the DEM it was made from."""

from __future__ import annotations

import math
import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tin.formats.common import crs_definition, title
from tin.sources import blocks
from tin.transform import to_grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tin.dem import Transform
    from tin.tin import Tin

# The fastest level takes half the time of the usual one, for 8 % more bytes; threads change none.
_PACKING = {"tiled": True, "compress": "deflate", "predictor": 3, "zlevel": 1, "num_threads": "all_cpus"}
_LARGEST = float(np.finfo(np.float32).max)


def write(tin: Tin, path: Path) -> None:
    """Write the heights of ``tin`` at the pixel centres of its DEM: size, transform and CRS are the DEM's.

    Where ``tin`` is in another CRS they are interpolated on a grid in that one.
    Heights are float32. The NoData value is the DEM's where float32 holds it and no height
    equals it, else -9999, else NaN; none is declared if the DEM has none and the TIN covers every pixel.
    """
    dem = tin.dem
    heights, place = to_grid(tin, tin.rasterize(np.float32))
    parts = [heights[rows] for rows in blocks(*heights.shape)]
    has_void = any(np.isnan(part).any() for part in parts)
    nodata = _nodata(dem.nodata, parts) if dem.nodata is not None or has_void else None
    if nodata is not None:
        for part in parts:
            part[np.isnan(part)] = nodata
    _write_band(tin, path, (heights, place), nodata, title(tin))


def write_error(tin: Tin, path: Path) -> None:
    """Write the signed error of ``tin``, see ``signed_error``; float32 with NaN, on the grid of ``write``."""
    _write_band(tin, path, to_grid(tin, signed_error(tin)), math.nan, f"error of {title(tin)}")


def signed_error(tin: Tin) -> NDArray[np.float32]:
    """Return (rows, cols) heights of the TIN less those of its DEM, NaN where either has none."""
    # Taken in float64: float32 would lose the millimetres of a height of kilometres.
    error = tin.rasterize(np.float64)
    np.subtract(error, tin.dem.z, out=error)
    return error.astype(np.float32)


def _write_band(
    tin: Tin,
    path: Path,
    band: tuple[NDArray[Any], Transform],
    nodata: float | None,
    description: str,
) -> None:
    import rasterio
    from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError

    values, place = band
    rows, cols = values.shape
    # GDAL does not report a full disk to rasterio: it writes to memory, and Python to the disk.
    with warnings.catch_warnings(), rasterio.MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            with memory.open(
                driver="GTiff",
                dtype="float32",
                count=1,
                height=rows,
                width=cols,
                crs=crs_definition(tin),
                transform=rasterio.Affine(*place),
                nodata=nodata,
                bigtiff="IF_SAFER",
                **_PACKING,
            ) as raster:
                raster.write(values, 1)
                raster.set_band_description(1, description)
                raster.set_band_unit(1, tin.dem.vertical_unit)
        except (CRSError, RasterioError) as error:
            raise OSError(str(error)) from error
        with path.open("wb") as file:
            shutil.copyfileobj(memory, file, 1 << 24)


def _nodata(declared: float | None, parts: Sequence[NDArray[Any]]) -> float:
    for value in (declared, -9999.0):
        if value is None or not _fits(value):
            continue
        if not any((part == np.float32(value)).any() for part in parts):
            return value
    return math.nan


def _fits(value: float) -> bool:
    """Whether float32 holds exactly ``value``, finite or NaN."""
    return math.isnan(value) or (abs(value) <= _LARGEST and float(np.float32(value)) == value)
