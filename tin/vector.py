"""Reading vector files: points that are to be vertices of the TIN."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tin.errors import InputError

if TYPE_CHECKING:
    from tin.crs import CRS


def read_points(source: str, crs: CRS | None) -> npt.NDArray[np.float64]:
    """The points of a vector file in the CRS of the DEM.

    Args:
        source: FILE or FILE:LAYER, in any format that fiona reads; without a layer the first one.
        crs: that of the DEM; points of another CRS are transformed, points without one are taken as they are.

    Returns:
        (n, 2) map x and y; empty geometries and coordinates that are not finite are left out.

    Raises:
        InputError: "not-found", "not-a-vector", "no-layer", "not-points", "bad-crs" or "missing-library".
    """
    try:
        import fiona
        import fiona.errors
        import fiona.transform
        import shapely
        import shapely.geometry
    except ImportError as error:
        raise InputError(
            "missing-library", f"{source}: reading points needs fiona and shapely: {error}"
        ) from error
    path, layer = _split(source)
    try:
        layers = fiona.listlayers(path)
        if layer is not None and layer not in layers:
            raise InputError(
                "no-layer", f"{path}: there is no layer {layer!r}; there are {', '.join(layers)}"
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with fiona.open(path, layer=layer) as file:
                shapes = [_points(feature.geometry, path) for feature in file if feature.geometry]
                own = file.crs_wkt
    except fiona.errors.FionaError as error:
        raise InputError("not-a-vector", f"{path}: cannot be read as a vector file ({error})") from error
    points: npt.NDArray[np.float64] = shapely.get_coordinates(shapes)
    points = points[np.isfinite(points).all(axis=1)]
    if own and crs is not None and len(points):
        try:
            points = np.column_stack(fiona.transform.transform(own, crs.to_wkt(), *points.T))
        except fiona.errors.FionaError as error:
            raise InputError("bad-crs", f"{path}: cannot be transformed to {crs} ({error})") from error
    return points


def _split(source: str) -> tuple[str, str | None]:
    path, layer = source, None
    if not Path(source).exists() and ":" in source:
        path, layer = source.rsplit(":", 1)
    if not Path(path).exists():
        raise InputError("not-found", f"{path}: no such file")
    return path, layer


def _points(geometry: Any, path: str) -> Any:
    import shapely.geometry

    shape = shapely.geometry.shape(geometry)
    if shape.geom_type not in ("Point", "MultiPoint"):
        raise InputError("not-points", f"{path}: holds a {shape.geom_type}; --points takes points only")
    return shape
