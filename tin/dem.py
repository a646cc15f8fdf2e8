"""A DEM in memory: heights with voids, where they lie, and in which units."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tin import sources
from tin.crs import CRS, length_of_unit, unit_name, unit_of_length
from tin.errors import InputError, OptionError

if TYPE_CHECKING:
    from tin.sources import Source

Floats = npt.NDArray[np.floating[Any]]
Transform = tuple[float, float, float, float, float, float]

USUAL_NODATA = (-9999.0, -32767.0, -32768.0, -99999.0)
MIN_GAP = 1000.0  # between such a value and the lowest height
MAX_HEIGHT = 1e38  # beyond it a float32 output would overflow; no real height comes near
METRES_PER_DEGREE = 111_320.0


class DEM:
    """A grid of heights with a geotransform and a CRS; it never changes once made.

    Args:
        z: heights, (rows, cols), any real dtype; a masked array's masked cells are voids. Copied.
        valid: (rows, cols) bool, False where there is no height; NaN and infinite heights are voids anyway.
        transform: (a, b, c, d, e, f) with x = a*col + b*row + c and y = d*col + e*row + f, of pixel
            *corners*, as an ``affine.Affine`` or as numbers. None: unit pixels, y up from the lower left.
        crs: anything ``CRS.parse`` takes.
        vertical_unit: such as "m", "foot" or "US survey foot"; by default that of a compound CRS, if any.
        nodata: the NoData value to declare in outputs; heights equal to it are *not* made void.
        name: what to call the DEM in outputs.

    Raises:
        InputError: "not-real", "not-2d", "empty", "too-large", "bad-mask", "all-nodata", "height-range",
            "bad-transform" or "bad-crs".
    """

    z: Floats
    """(rows, cols), float32 or float64, C order, read-only; NaN exactly where void."""
    transform: Transform
    """(a, b, c, d, e, f), in the units of the CRS, from pixel corners."""
    crs: CRS | None
    vertical_unit: str
    """"metre", "foot", "US survey foot", or "" where unknown."""
    nodata: float | None
    """As the source declared it: it may be NaN, beyond float32, or equal to a valid height after scaling."""
    name: str
    """The source's file stem, or ""."""

    def __init__(
        self,
        z: npt.ArrayLike,
        valid: npt.ArrayLike | None = None,
        transform: Any = None,
        crs: Any = None,
        *,
        vertical_unit: str = "",
        nodata: float | None = None,
        name: str = "",
    ) -> None:
        try:
            data: npt.NDArray[Any] = np.ma.getdata(z)  # type: ignore[no-untyped-call]
        except ValueError as error:
            raise InputError("not-2d", f"heights must be a grid of (rows, cols): {error}") from error
        if data.dtype.kind not in "iuf":
            raise InputError("not-real", f"heights must be real numbers, not {data.dtype}")
        if data.ndim != 2:
            raise InputError("not-2d", f"heights must be a grid of (rows, cols), not of shape {data.shape}")
        sources.check_size(data.shape[0], data.shape[1], None, name or "DEM")
        with np.errstate(all="ignore"):
            heights = np.array(data, dtype=sources.working_dtype(data.dtype.name), order="C")
        for rows in sources.blocks(*heights.shape):
            block = heights[rows]
            block[~np.isfinite(block)] = np.nan
        if isinstance(z, np.ma.MaskedArray):
            heights[np.ma.getmaskarray(z)] = np.nan
        if valid is not None:
            if np.shape(valid) != data.shape:
                raise InputError("bad-mask", f"valid is {np.shape(valid)}, the heights are {data.shape}")
            heights[~np.asarray(valid, dtype=bool)] = np.nan
        self._fill(
            heights,
            transform=transform,
            crs=CRS.parse(crs),
            vertical_unit=vertical_unit,
            nodata=nodata,
            name=name,
        )

    def _fill(
        self,
        heights: Floats,
        *,
        transform: Any,
        crs: CRS | None,
        vertical_unit: str,
        nodata: float | None,
        name: str,
    ) -> None:
        """Take ownership of the heights, NaN where void, and check them."""
        label = name or "DEM"
        low, high = np.fmin.reduce(heights, axis=None), np.fmax.reduce(heights, axis=None)
        if np.isnan(low):
            raise InputError("all-nodata", f"{label}: every pixel is NoData, so there is no surface to model")
        if max(abs(low), abs(high)) > MAX_HEIGHT:
            raise InputError(
                "height-range",
                f"{label}: heights from {low:g} to {high:g} are no terrain; declare the NoData value",
            )
        heights.flags.writeable = False
        unit = unit_name(vertical_unit) if vertical_unit or crs is None else crs.vertical_unit
        self.__dict__.update(
            z=heights,
            transform=_transform(transform, heights.shape[0], label),
            crs=crs,
            vertical_unit=unit,
            nodata=None if nodata is None else float(nodata),
            name=name,
        )
        if not all(0 < part < math.inf for part in self.metric()[::2]):
            raise InputError("bad-transform", f"{label}: the pixel size is out of range: {self.transform}")

    def warnings(self) -> list[str]:
        """What looks wrong with the heights: a NoData value that nobody declared."""
        low = np.fmin.reduce(self.z, axis=None)
        if float(low) not in USUAL_NODATA:
            return []
        count, others = 0, math.inf
        for rows in sources.blocks(self.rows, self.cols):
            block = self.z[rows]
            count += int(np.count_nonzero(block == low))
            others = min(others, float(block[block > low].min(initial=np.inf)))
        if not MIN_GAP <= others - low < math.inf:
            return []
        return [
            f"{count:,} pixels are {low:g}, far below all others: if that means NoData, declare it, "
            f"for example with gdal_edit.py -a_nodata {low:g}"
        ]

    @classmethod
    def _load(cls, source: Source, z_factor: float, max_pixels: int | None) -> DEM:
        heights = sources.read(source, max_pixels)
        transform, crs = sources.georeference(source)
        dem = cls.__new__(cls)
        dem._fill(
            heights,
            transform=transform,
            crs=crs,
            vertical_unit=source.unit,
            nodata=source.nodata,
            name=source.name,
        )
        if z_factor == 1:
            return dem
        heights.flags.writeable = True  # nobody else has the DEM, so that its heights can change in place
        return dem._scaled(z_factor, heights)

    @classmethod
    def from_rasterio(cls, src: Any, band: int = 1, z_factor: float = 1.0, max_pixels: int = 2**31) -> DEM:
        """Read one band of an open rasterio dataset (or WarpedVRT).

        NoData, mask and alpha bands, NaN and infinities become voids; scale and offset are applied; the
        vertical unit is the band's, else that of a compound CRS. Heights are multiplied by `z_factor`.

        Raises InputError with the codes of the class, and "band-range", "complex-data", "subdatasets",
        "gcp-only", "out-of-memory" and "unreadable".
        """
        with np.errstate(over="ignore"):  # rasterio compares a NoData value beyond float32 in float32
            return cls._load(sources.from_rasterio(src, band), z_factor, max_pixels)

    @classmethod
    def from_gdal(cls, dataset: Any, band: int = 1, z_factor: float = 1.0, max_pixels: int = 2**31) -> DEM:
        """Read one band of an open ``osgeo.gdal`` dataset, as `from_rasterio` does; needs numpy alone."""
        return cls._load(sources.from_gdal(dataset, band), z_factor, max_pixels)

    @classmethod
    def from_xarray(cls, array: Any, z_factor: float = 1.0) -> DEM:
        """Take a DataArray (y, x), or (1, y, x), whose CRS, coordinates and NoData rioxarray understands.

        Raises InputError with the codes of the class, "no-spatial-dims" and "missing-library".
        """
        return cls._load(sources.from_xarray(array), z_factor, None)

    def scaled(self, factor: float) -> DEM:
        """Return the DEM with all heights multiplied, and the vertical unit that this makes of them.

        Feet times 0.3048 are metres; a factor that leads to no known unit leaves the unit "". A vertical CRS
        that no longer holds is dropped. Raises OptionError ("bad-z-factor") for zero, NaN or infinity.
        """
        return self._scaled(factor, np.empty_like(self.z))

    def _scaled(self, factor: float, heights: Floats) -> DEM:
        """Do what `scaled` does, with the memory of ``heights``."""
        if not (math.isfinite(factor) and factor != 0):
            raise OptionError("bad-z-factor", f"the z factor must be finite and not 0, but is {factor}")
        with np.errstate(over="ignore", under="ignore"):
            np.multiply(self.z, factor, out=heights, dtype=np.float64, casting="same_kind")
        before = length_of_unit(self.vertical_unit)
        unit = "" if before is None else unit_of_length(before / factor)
        holds = self.crs is None or self.crs.vertical_unit in ("", unit)
        crs = self.crs if self.crs is None or holds else self.crs.horizontal
        made = type(self).__new__(type(self))
        made._fill(
            heights,
            transform=self.transform,
            crs=crs,
            vertical_unit=unit,
            nodata=self.nodata,
            name=self.name,
        )
        return made

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows, self.cols

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.z.shape[0])

    @property
    def cols(self) -> int:
        """Number of columns."""
        return int(self.z.shape[1])

    @cached_property
    def valid(self) -> npt.NDArray[np.bool_]:
        """(rows, cols) bool, read-only: True where there is a height."""
        valid = ~np.isnan(self.z)
        valid.flags.writeable = False
        return valid

    @cached_property
    def n_valid(self) -> int:
        """Number of pixels with a height."""
        every = sources.blocks(self.rows, self.cols)
        return sum(int(np.count_nonzero(~np.isnan(self.z[rows]))) for rows in every)

    def pixel_to_map(
        self, col: npt.ArrayLike, row: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Map pixel positions to x, y in the CRS; integers are pixel *centres*."""
        a, b, c, d, e, f = self.transform
        u, v = np.asarray(col, dtype=np.float64) + 0.5, np.asarray(row, dtype=np.float64) + 0.5
        return a * u + b * v + c, d * u + e * v + f

    def map_to_pixel(
        self, x: npt.ArrayLike, y: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Map x, y in the CRS to (col, row), the inverse of `pixel_to_map`."""
        a, b, c, d, e, f = self.transform
        u, v = np.asarray(x, dtype=np.float64) - c, np.asarray(y, dtype=np.float64) - f
        det = a * e - b * d
        return (e * u - b * v) / det - 0.5, (a * v - d * u) / det - 0.5

    def metric(self) -> tuple[float, float, float]:
        """Return (e, f, g) in metres^2: a step (dc, dr) in pixels is sqrt(e*dc^2 + 2*f*dc*dr + g*dr^2) long.

        In a geographic CRS a degree of longitude is shortened by the cosine of the centre's latitude.
        """
        a, b, _, d, e, _ = self.transform
        x_unit = y_unit = 1.0 if self.crs is None else self.crs.unit_factor
        if self.crs is not None and self.crs.is_geographic:
            latitude = float(self.pixel_to_map((self.cols - 1) / 2, (self.rows - 1) / 2)[1])
            y_unit = METRES_PER_DEGREE
            x_unit = METRES_PER_DEGREE * math.cos(math.radians(max(-89.9, min(89.9, latitude))))
        col, row = (a * x_unit, d * y_unit), (b * x_unit, e * y_unit)
        return _dot(col, col), _dot(col, row), _dot(row, row)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError("a DEM does not change; make a new one")

    def __repr__(self) -> str:
        crs = self.crs or "no CRS"
        return f"<DEM {self.name!r}: {self.rows} x {self.cols} ({self.n_valid} valid), {crs}, {self.z.dtype}>"


def _dot(u: tuple[float, float], v: tuple[float, float]) -> float:
    return u[0] * v[0] + u[1] * v[1]


def _transform(transform: Any, rows: int, label: str) -> Transform:
    if transform is None:
        return (1.0, 0.0, 0.0, 0.0, -1.0, float(rows))
    try:
        numbers = [float(number) for number in transform]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in (6, 9) or not all(map(math.isfinite, numbers)):
        raise InputError("bad-transform", f"{label}: a transform is six finite numbers, not {transform!r}")
    a, b, c, d, e, f = numbers[:6]
    # Relative to the pixel's own sides, so that neither small nor elongated pixels count as flat.
    if abs(a * e - b * d) <= 1e-9 * math.hypot(a, d) * math.hypot(b, e):
        raise InputError("bad-transform", f"{label}: the transform is singular, all pixels fall on a line")
    return a, b, c, d, e, f
