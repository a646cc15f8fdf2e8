"""The compiled core."""

from typing import Any, Callable

import numpy as np
import numpy.typing as npt

class Mesh:
    """The finished triangulation of a raster, in pixel coordinates."""

    def pixels(self) -> npt.NDArray[np.float64]:
        """(n, 2) column and row of each vertex; pixel centres are whole numbers."""
    def heights(self) -> npt.NDArray[np.float64]:
        """(n,) height of each vertex."""
    def triangles(self) -> npt.NDArray[np.uint32]:
        """(m, 3) corners of each triangle, turning from +column to +row."""
    def constrained(self) -> npt.NDArray[np.bool_]:
        """(m, 3) whether the edge from corner k to corner k + 1 is a constraint."""
    def errors(
        self, z: npt.NDArray[np.floating[Any]], progress: Callable[[str, float], Any] | None = None
    ) -> tuple[dict[str, Any], npt.NDArray[np.float64]]:
        """Statistics against a raster of the same shape, and each triangle's largest absolute error."""
    def rasterize_f32(self) -> npt.NDArray[np.float32]:
        """(rows, cols) heights on the pixel centres, NaN where no triangle is."""
    def rasterize_f64(self) -> npt.NDArray[np.float64]:
        """(rows, cols) heights on the pixel centres, NaN where no triangle is."""
    def spikes(self) -> npt.NDArray[np.uint64]:
        """(k,) indices (row * cols + col) of the pixels that despiking replaced."""
    def check(self) -> None:
        """Raises RuntimeError with the first property of the mesh that does not hold."""
    @property
    def stop_reason(self) -> str: ...
    @property
    def noise(self) -> float: ...
    @property
    def scales(self) -> list[tuple[float, float]]: ...
    @property
    def delaunay(self) -> bool: ...
    @property
    def metric(self) -> tuple[int, int, int]: ...

def gaussian(
    z: npt.NDArray[np.float64], sigma: tuple[float, float], threads: int | None = None
) -> npt.NDArray[np.float64]:
    """The image at scale t = sigma^2 (Gaussian, sigma = (x, y) in pixels; voids are NaN)."""

def triangulate(
    z: npt.NDArray[np.floating[Any]],
    metric: tuple[float, float, float],
    *,
    max_points: int | None,
    is_share: bool,
    points_per_scale: int | None,
    priority: float,
    weight: float,
    candidate: float,
    tolerance: float | None,
    bound: float,
    stop_at_noise: bool,
    scales: list[tuple[float, float]] | None,
    despike: bool,
    fit: bool,
    flips: int,
    outline_tolerance: float,
    keep_isolated: bool,
    sieve: int,
    pixels: list[tuple[int, int]],
    points: npt.NDArray[np.float64],
    lines: list[npt.NDArray[np.float64]],
    clip: list[list[npt.NDArray[np.float64]]] | None,
    flat: list[tuple[list[npt.NDArray[np.float64]], float]],
    tile: int,
    threads: int | None = None,
    progress: Callable[[str, float], Any] | None = None,
) -> Mesh:
    """Triangulates a raster; see tin.triangulate. Vertices are (n, 3): column, row, height or NaN.

    Threads: None for as many as this process may use CPUs; the mesh is measured by as many.
    """
