"""From one CRS into another: which one is meant, points, and grids. All of GDAL's warping is called here."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tin.crs import CRS, UTM
from tin.errors import InputError

if TYPE_CHECKING:
    from tin.dem import DEM, Transform
    from tin.tin import Tin


def target(dem: DEM, crs: Any) -> CRS:
    """Return the CRS that ``crs`` means for ``dem``: anything ``CRS.parse`` takes, or "utm".

    "utm" is the WGS 84 / UTM zone of the DEM's centre, or UPS beyond 84 degrees north and 80 south. Of a
    compound CRS it is the horizontal part.

    Raises InputError: "no-crs" where the DEM has none, "bad-crs" where one of the two has no map coordinates,
    "outside-crs" where the DEM's centre has no longitude and latitude, "missing-library".
    """
    if dem.crs is None:
        message = "has no CRS, so its TIN cannot be put into another one; georeference it first"
        raise InputError("no-crs", f"{dem.name or 'DEM'}: {message}")
    _check_horizontal(dem.crs)
    found = _utm(dem) if isinstance(crs, str) and crs.strip().lower() == UTM else CRS.parse(crs)
    if found is None:
        raise InputError("bad-crs", "no CRS was given; give a code such as 'EPSG:26710', or 'utm'")
    _check_horizontal(found)
    return found.horizontal


def _utm(dem: DEM) -> CRS | None:
    assert dem.crs is not None
    centre = np.column_stack(dem.pixel_to_map([(dem.cols - 1) / 2], [(dem.rows - 1) / 2]))
    degrees = CRS.parse("EPSG:4326")
    assert degrees is not None
    longitude, latitude = points(dem.crs, degrees, centre)[0]
    if not -80.0 <= latitude <= 84.0:
        return CRS.parse("EPSG:32661" if latitude > 0.0 else "EPSG:32761")
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    return CRS.parse(f"EPSG:{(32600 if latitude >= 0.0 else 32700) + zone}")


def is_same(a: CRS, b: CRS) -> bool:
    """Whether the horizontal parts are the same CRS, however they are written."""
    return bool(_rasterio(a) == _rasterio(b))


def points(source: CRS, goal: CRS, places: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Transform the (n, 2) x, y ``places``; the vertical parts of compound CRSs count for nothing.

    Raises InputError: "outside-crs" where a place has no coordinates in ``goal``, "missing-library".
    """
    begin, end = _rasterio(source), _rasterio(goal)
    import rasterio.warp
    from rasterio._err import CPLE_BaseError

    message = f"points of {source} cannot be put into {goal}"
    try:
        moved = np.column_stack(rasterio.warp.transform(begin, end, places[:, 0], places[:, 1]))
    except (CPLE_BaseError, rasterio.errors.RasterioError) as error:
        reason = " ".join(str(error).split())
        raise InputError("outside-crs", f"{message} ({reason[:120]}); choose another CRS") from error
    lost = len(moved) - int(np.isfinite(moved).all(axis=1).sum())
    if lost:
        text = f"{message}: {lost} of {len(moved)} lie outside of where it is defined; choose another CRS"
        raise InputError("outside-crs", text)
    return moved


def to_grid(
    tin: Tin, values: npt.NDArray[np.floating[Any]]
) -> tuple[npt.NDArray[np.floating[Any]], Transform]:
    """Put values on the DEM's grid onto a grid in the CRS of ``tin``; returns them and its geotransform.

    ``values`` are (rows, cols), NaN where there are none. They are returned as they are where the TIN is in
    the CRS of its DEM; else interpolated bilinearly by GDAL, placed to 1/8 pixel, on a north-up grid of
    about as many pixels, which are square.

    Raises InputError "outside-crs".
    """
    dem = tin.dem
    if tin.crs is dem.crs or tin.crs is None or dem.crs is None:
        return values, dem.transform
    begin, end = _rasterio(dem.crs), _rasterio(tin.crs)
    import rasterio
    import rasterio.warp
    from rasterio._err import CPLE_BaseError

    try:
        place, cols, rows = _grid(dem, begin, end)
        moved = np.full((rows, cols), np.nan, values.dtype)
        rasterio.warp.reproject(
            values,
            moved,
            src_transform=rasterio.Affine(*dem.transform),
            src_crs=begin,
            src_nodata=math.nan,
            dst_transform=place,
            dst_crs=end,
            dst_nodata=math.nan,
            resampling=rasterio.warp.Resampling.bilinear,
            num_threads=os.cpu_count() or 1,
        )
    except (CPLE_BaseError, rasterio.errors.RasterioError) as error:
        reason = " ".join(str(error).split())
        message = f"the grid of {dem.crs} cannot be put into {tin.crs} ({reason[:120]}); choose another CRS"
        raise InputError("outside-crs", message) from error
    a, b, c, d, e, f = tuple(place)[:6]
    return moved, (a, b, c, d, e, f)


def _grid(dem: DEM, begin: Any, end: Any) -> tuple[Any, int, int]:
    """Return transform, columns and rows of the grid in ``end`` that suits that of ``dem``."""
    from rasterio.warp import calculate_default_transform

    # GDAL wants a north-up grid: that of the DEM, or for a rotated one the box around it, as dense.
    corners = dem.pixel_to_map([-0.5, dem.cols - 0.5] * 2, [-0.5, -0.5, dem.rows - 0.5, dem.rows - 0.5])
    (left, bottom), (right, top) = np.min(corners, axis=1), np.max(corners, axis=1)
    a, b, _, d, e, _ = dem.transform
    cols, rows = round((right - left) / math.hypot(a, b)), round((top - bottom) / math.hypot(d, e))
    size = max(1, cols), max(1, rows)
    place, cols, rows = calculate_default_transform(begin, end, *size, left, bottom, right, top)
    while min(cols, rows) < 2:  # a DEM has at least two
        size = 2 * size[0], 2 * size[1]
        place, cols, rows = calculate_default_transform(begin, end, *size, left, bottom, right, top)
    return place, cols, rows


def _check_horizontal(crs: CRS) -> None:
    known = _rasterio(crs)
    if not (known.is_geographic or known.is_projected):
        message = f"{crs}: is neither projected nor geographic, so no map can be put into it or out of it"
        raise InputError("bad-crs", message)


def _rasterio(crs: CRS) -> Any:
    try:
        import rasterio.crs
        import rasterio.errors
    except ImportError as error:
        raise InputError("missing-library", f"another CRS needs rasterio ({error}): install it") from error
    try:
        return rasterio.crs.CRS.from_user_input(crs.horizontal)
    except rasterio.errors.CRSError as error:
        raise InputError("bad-crs", f"{crs}: GDAL does not know this CRS ({error})") from error
