"""Stand-ins for Tin, DEM and CRS: what the writers use of them, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class FakeCRS:
    wkt: str
    code: str | None = None
    is_geographic: bool = False
    unit_factor: float = 1.0
    unit_name: str = "metre"
    name: str = "a CRS"

    def to_wkt(self) -> str:
        return self.wkt


def crs(code: str) -> FakeCRS:
    import pyproj

    known = pyproj.CRS(code)
    axis = known.axis_info[0]
    return FakeCRS(
        wkt=known.to_wkt(pretty=True),
        code=code,
        is_geographic=known.is_geographic,
        unit_factor=1.0 if known.is_geographic else axis.unit_conversion_factor,
        unit_name=axis.unit_name,
        name=known.name,
    )


@dataclass
class FakeDEM:
    shape: tuple
    transform: tuple
    crs: FakeCRS | None = None
    vertical_unit: str = "metre"
    nodata: float | None = None
    rows = property(lambda self: self.shape[0])
    cols = property(lambda self: self.shape[1])


@dataclass
class FakeTin:
    vertices: np.ndarray
    triangles: np.ndarray
    dem: FakeDEM
    heights: np.ndarray
    name: str = "hills"
    constrained: np.ndarray = field(init=False)
    triangle_errors: np.ndarray = field(init=False)
    crs = property(lambda self: self.dem.crs)

    def __post_init__(self):
        count = len(self.triangles)
        self.constrained = np.arange(count * 3).reshape(-1, 3) % 5 == 0
        self.triangle_errors = np.linspace(0.0, 7.0, count)

    def rasterize(self, dtype=np.float64):
        return self.heights.astype(dtype)


UTM = (30.0, 0.0, 561_245.1, 0.0, -30.0, 5_118_400.7)


def grid_tin(rows=12, cols=17, *, transform=UTM, crs=None, vertical_unit="metre", nodata=None, flat=False):
    """A grid cut into triangles, whose every pixel is a vertex: hills, with one pixel void."""
    a, b, c, d, e, f = transform
    row, col = np.mgrid[0:rows, 0:cols]
    z = np.zeros((rows, cols)) if flat else 300 + 40 * np.sin(row / 2.5) * np.cos(col / 3.1) + 0.1 * col
    x, y = a * (col + 0.5) + b * (row + 0.5) + c, d * (col + 0.5) + e * (row + 0.5) + f
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    index = np.arange(rows * cols).reshape(rows, cols)
    nw, ne, sw, se = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.stack([nw, sw, se, nw, se, ne], axis=-1).reshape(-1, 3)
    if a * e - b * d > 0:  # y down
        triangles = triangles[:, ::-1]
    heights = z.copy()
    heights[0, 0] = np.nan
    dem = FakeDEM((rows, cols), transform, crs, vertical_unit, nodata)
    return FakeTin(vertices, np.ascontiguousarray(triangles, np.uint32), dem, heights)
