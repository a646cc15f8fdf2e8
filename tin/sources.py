"""What a DEM can be read from (rasterio, osgeo.gdal, xarray), each told in the same words."""

from __future__ import annotations

import re
import threading
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, Callable

import numpy as np
import numpy.typing as npt

from tin.crs import CRS
from tin.errors import InputError

BLOCK = 2**20  # pixels that are looked at together where masks of a whole DEM would take memory
MAX_SIDE = 2**20  # what the core's exact predicates have bits for
WARNING_FILTERS = threading.Lock()  # they belong to the whole process
_ALL_VALID, _BY_VALUE = 1, 8  # GDAL's mask flags

Gcp = tuple[float, float, float, float]
Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Source:
    """One band, known from its header; `pixels` and `mask` read it."""

    label: str
    """What to call it in messages."""
    name: str
    rows: int
    cols: int
    dtype: str
    """numpy's name, or one that starts with "complex"."""
    pixels: Callable[[str], Array]
    """Reads (rows, cols) heights as the float dtype asked for, as a new array."""
    mask: Callable[[], Array] | None = None
    """Reads (rows, cols), 0 where void; None where there are no voids but by value."""
    transform: tuple[float, ...] | None = None
    crs: CRS | None = None
    gcps: tuple[Gcp, ...] = ()
    """Ground control points: (col, row, x, y), from pixel corners."""
    nodata: float | None = None
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""


def _unit(src: Any, band: int) -> str:
    """The band's unit; a name that is no text is as good as none."""
    try:
        return str(src.units[band - 1] or "")
    except UnicodeDecodeError:
        return ""


def from_rasterio(src: Any, band: int) -> Source:
    """Describe a band of a rasterio dataset."""
    label = src.name
    check_band(label, band, src.count, src.subdatasets if src.count == 0 else ())
    gcps, gcp_crs = src.gcps
    crs = src.crs or gcp_crs
    by_value = [int(flag) for flag in src.mask_flag_enums[band - 1]] in ([_ALL_VALID], [_BY_VALUE])
    return Source(
        label=label,
        name=stem(label),
        rows=src.height,
        cols=src.width,
        dtype=src.dtypes[band - 1],
        pixels=lambda dtype: src.read(band, out_dtype=dtype),
        mask=None if by_value else lambda: src.read_masks(band),
        transform=_rasterio_transform(src),
        crs=CRS.from_rasterio(crs) if crs else None,
        gcps=tuple((p.col, p.row, p.x, p.y) for p in gcps),
        nodata=src.nodatavals[band - 1],
        scale=src.scales[band - 1],
        offset=src.offsets[band - 1],
        unit=_unit(src, band),
    )


def _rasterio_transform(src: Any) -> tuple[float, ...] | None:
    # Where there is none, some drivers (PNM) leave random bits in src.transform; the warning is reliable.
    with WARNING_FILTERS, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        src.read_transform()
    return None if caught else _known(tuple(src.transform)[:6])


_GDAL_TYPES = {1: "uint8", 2: "uint16", 3: "int16", 4: "uint32", 5: "int32", 6: "float32", 7: "float64"}
_GDAL_TYPES.update({12: "uint64", 13: "int64", 14: "int8", 15: "float16"})


def from_gdal(dataset: Any, band: int) -> Source:
    """Describe a band of an osgeo.gdal dataset; osgeo is not imported, nor is its array module used."""
    label = dataset.GetDescription() or "GDAL dataset"
    check_band(label, band, dataset.RasterCount, [name for name, _ in dataset.GetSubDatasets()])
    raster = dataset.GetRasterBand(band)
    rows, cols = dataset.RasterYSize, dataset.RasterXSize
    transform = dataset.GetGeoTransform(can_return_null=True)
    srs = dataset.GetSpatialRef() or dataset.GetGCPSpatialRef()

    def read(raster: Any, gdal_type: int, dtype: str) -> Array:
        raw = raster.ReadRaster(0, 0, cols, rows, buf_type=gdal_type)
        if raw is None:  # that is how osgeo fails where exceptions are off
            raise OSError("GDAL cannot read the band")
        return np.frombuffer(bytearray(raw) if isinstance(raw, bytes) else raw, dtype).reshape(rows, cols)

    return Source(
        label=label,
        name=stem(label),
        rows=rows,
        cols=cols,
        dtype=_GDAL_TYPES.get(raster.DataType, "complex"),
        pixels=lambda dtype: read(raster, 6 if dtype == "float32" else 7, dtype),
        mask=None
        if raster.GetMaskFlags() in (_ALL_VALID, _BY_VALUE)
        else lambda: read(raster.GetMaskBand(), 1, "uint8"),
        transform=None if transform is None else _known(tuple(transform[i] for i in (1, 2, 0, 4, 5, 3))),
        crs=None if srs is None else CRS.from_osgeo(srs),
        gcps=tuple((p.GCPPixel, p.GCPLine, p.GCPX, p.GCPY) for p in dataset.GetGCPs()),
        nodata=raster.GetNoDataValue(),
        scale=1.0 if raster.GetScale() is None else raster.GetScale(),
        offset=raster.GetOffset() or 0.0,
        unit=raster.GetUnitType() or "",
    )


def from_xarray(array: Any) -> Source:
    """Describe a DataArray, through the accessor that rioxarray gives it."""
    try:
        import rioxarray
    except ImportError as error:
        raise InputError("missing-library", "a DataArray needs rioxarray: pip install rioxarray") from error
    label = str(array.name or "DataArray")
    try:
        y, x = array.rio.y_dim, array.rio.x_dim
    except rioxarray.exceptions.RioXarrayError as error:
        raise InputError("no-spatial-dims", f"{label}: {error}") from error
    single = [dim for dim in array.dims if dim not in (y, x) and array.sizes[dim] == 1]
    plane = array.squeeze(single, drop=True)
    if plane.ndim != 2:
        raise InputError("not-2d", f"{label}: choose one layer, the dimensions are {tuple(array.dims)}")
    plane = plane.transpose(y, x)
    return Source(
        label=label,
        name=str(array.name or ""),
        rows=plane.shape[0],
        cols=plane.shape[1],
        dtype=plane.dtype.name,
        pixels=lambda dtype: np.array(plane.values, dtype=dtype),
        transform=_known(tuple(array.rio.transform())[:6]),
        crs=CRS.from_rasterio(array.rio.crs) if array.rio.crs else None,
        nodata=array.rio.nodata,
        scale=array.attrs.get("scale_factor", 1.0),
        offset=array.attrs.get("add_offset", 0.0),
        unit=str(array.attrs.get("units", "")),
    )


def stem(name: str) -> str:
    """Return the file name without folder, suffix and ".gz"; "" for a dataset in memory."""
    path = PurePath(name[:-3] if name.lower().endswith(".gz") else name)
    return "" if name.startswith("/vsimem/") else path.stem


def check_size(rows: int, cols: int, max_pixels: int | None, label: str) -> None:
    """Refuse, before any memory is taken, what is empty ("empty") or over the limits ("too-large")."""
    if rows * cols == 0:
        raise InputError("empty", f"{label}: {rows} x {cols} pixels, there is nothing to read")
    limit = f"{MAX_SIDE} a side" if max(rows, cols) > MAX_SIDE else ""
    if max_pixels is not None and rows * cols > max_pixels:
        limit = f"{max_pixels} in all (max_pixels)"
    if limit:
        raise InputError(
            "too-large", f"{label}: {rows} x {cols} pixels, over the limit of {limit}; cut it up"
        )


def working_dtype(dtype: str) -> str:
    """Return float32 where it holds every value of the dtype, else float64 (64-bit integers: nearly)."""
    return "float32" if dtype in ("int8", "uint8", "int16", "uint16", "float16", "float32") else "float64"


def blocks(rows: int, cols: int) -> Iterator[slice]:
    """Cut a grid into slices of whole rows, of BLOCK pixels or a little more."""
    step = -(-BLOCK // cols)
    return (slice(first, first + step) for first in range(0, rows, step))


def read(source: Source, max_pixels: int | None) -> Array:
    """Read the heights, scale and offset applied, as a new array with NaN where they are void."""
    if source.dtype.startswith("complex"):
        raise InputError("complex-data", f"{source.label}: complex numbers are no heights; take another band")
    if np.dtype(source.dtype).kind not in "iuf":
        raise InputError("not-real", f"{source.label}: heights must be real numbers, not {source.dtype}")
    check_size(source.rows, source.cols, max_pixels, source.label)
    is_scaled = (source.scale, source.offset) != (1, 0)
    try:
        heights = source.pixels("float64" if is_scaled else working_dtype(source.dtype))
        mask = None if source.mask is None else source.mask()
        for rows in blocks(source.rows, source.cols):
            block = heights[rows]
            void = _void(block, source)
            if mask is not None:
                void |= mask[rows] == 0
            if is_scaled:
                with np.errstate(all="ignore"):
                    block *= source.scale
                    block += source.offset
            block[void] = np.nan
    except (MemoryError, OSError, RuntimeError) as error:
        why = reason(error)
        # GDAL tells of memory that it does not get for its own buffers as of any damage.
        if isinstance(error, MemoryError) or re.search("cannot allocate|out of memory", why, re.IGNORECASE):
            code, what = "out-of-memory", f"{source.rows} x {source.cols} pixels do not fit into memory"
        else:
            code, what = "unreadable", f"damaged or incomplete ({why})"
        raise InputError(code, f"{source.label}: {what}") from error
    return heights


def _void(heights: Array, source: Source) -> npt.NDArray[np.bool_]:
    # A NoData value beyond float32 is stored as its largest value, which GDAL then forgets to call NoData.
    end = 3.4028e38 if source.dtype == "float32" else np.inf
    with np.errstate(all="ignore"):
        void: npt.NDArray[np.bool_] = ~((heights > -end) & (heights < end))
        if source.nodata is not None and abs(source.nodata) < end:
            # Two units in the last place on either side, because NoData is often declared as rounded text.
            value = heights.dtype.type(source.nodata)
            down, up = heights.dtype.type(-np.inf), heights.dtype.type(np.inf)
            low = np.nextafter(np.nextafter(value, down), down)
            high = np.nextafter(np.nextafter(value, up), up)
            void |= (heights >= low) & (heights <= high)
    return void


def georeference(source: Source) -> tuple[tuple[float, ...] | None, CRS | None]:
    """Return transform and CRS: the source's own, or fitted to its control points, or none at all."""
    if source.transform is not None:
        return source.transform, source.crs
    if source.gcps:
        return _fit(source.gcps, source.label), source.crs
    return None, None  # a CRS says nothing about coordinates that are mere pixel numbers


def _fit(gcps: tuple[Gcp, ...], label: str) -> tuple[float, ...]:
    """Fit an affine transform to control points, or refuse ("gcp-only") where they ask for more than that."""
    advice = "warp it first: gdalwarp -tps in.tif out.tif"
    points = np.array(gcps, dtype=np.float64)
    pixel, place = points[:, :2], points[:, 2:]
    with np.errstate(over="ignore", invalid="ignore"):
        middle = place.mean(axis=0)
        away = place - middle
    # Least squares never come to an end with what is not finite.
    if not (np.isfinite(pixel).all() and np.isfinite(away).all()):
        raise InputError("gcp-only", f"{label}: its ground control points are not finite; {advice}")
    matrix = np.column_stack([pixel, np.ones(len(pixel))])
    solution, _, rank, _ = np.linalg.lstsq(matrix, away, rcond=None)
    if rank < 3 or not np.isfinite(solution).all():
        raise InputError("gcp-only", f"{label}: its ground control points lie on a line; {advice}")
    linear = solution[:2].T
    if np.linalg.matrix_rank(linear) == 2:
        misfit = np.linalg.solve(linear, (away - matrix @ solution).T)
        if np.abs(misfit).max() > 0.5:
            worst = f"{np.abs(misfit).max():.1f} px"
            raise InputError("gcp-only", f"{label}: control points are {worst} off an affine; {advice}")
    (a, b), (d, e) = linear
    c, f = solution[2] + middle
    return tuple(float(number) for number in (a, b, c, d, e, f))


def _known(transform: tuple[float, ...]) -> tuple[float, ...] | None:
    return None if transform == (1, 0, 0, 0, 1, 0) else transform  # what GDAL says where there is none


def check_band(label: str, band: int, count: int, subdatasets: Sequence[str] = ()) -> None:
    """Refuse a band that is not there ("band-range"), and a container of rasters ("subdatasets")."""
    if count == 0 and subdatasets:
        some = ", ".join(subdatasets[:4]) + (", ..." if len(subdatasets) > 4 else "")
        raise InputError("subdatasets", f"{label}: holds several rasters, open one of them: {some}")
    if band not in range(1, count + 1):
        raise InputError("band-range", f"{label}: there is no band {band}; the raster has {count}")


def reason(error: BaseException) -> str:
    """Return the innermost message of a chain of exceptions, on one line."""
    while error.__cause__ is not None or error.__context__ is not None:
        error = error.__cause__ or error.__context__  # type: ignore[assignment]
    return " ".join(str(error).split()).rstrip(".")
