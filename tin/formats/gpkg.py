"""GeoPackage: a POLYGON Z with its attributes per triangle; or the outline of the TIN as polygons."""

from __future__ import annotations

import contextlib
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tin.formats.arrow import ColumnStream
from tin.formats.attributes import ALL, area_unit, attributes
from tin.formats.common import crs_definition, title

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tin.tin import Tin

_UNDEFINED = 'LOCAL_CS["Undefined Cartesian SRS"]'  # which GeoPackage numbers -1
_POLYGON_Z = np.dtype(
    [
        ("byte_order", "u1"),
        ("type", "<u4"),
        ("rings", "<u4"),
        ("points", "<u4"),
        ("xyz", "<f8", (4, 3)),
    ]
)


def write(tin: Tin, path: Path) -> None:
    """Write the triangles of ``tin`` as GeoPackage 1.3 with an R-tree, in the layer ``tin``.

    Polygons run counter-clockwise; the columns are those of `tin.formats.attributes.attributes`
    (NULL for NaN). Without a CRS the layer is "undefined Cartesian".
    """
    from pyogrio import raw

    count = len(tin.triangles)
    table = ColumnStream(count, lambda rows: {**attributes(tin, rows), "geom": polygons_wkb(tin, rows)})
    with _database(path, "tin", count) as plain:
        try:
            raw.write_arrow(
                table,
                plain,
                geometry_name="geom",
                geometry_type="Polygon Z",
                **_settings(tin, "tin", _description(tin)),
            )
        finally:
            table.check()


def write_outline(tin: Tin, path: Path) -> None:
    """Write the area that ``tin`` covers as GeoPackage 1.3: a valid POLYGON a part, in the layer ``outline``.

    Polygons are those of `Tin.outline` without z, which nobody cuts with.
    """
    from pyogrio import raw

    polygons = [outline_wkb(polygon) for polygon in tin.outline()]
    geometry = np.empty(len(polygons), dtype=object)
    geometry[:] = polygons
    with _database(path, "outline", len(polygons)) as plain:
        raw.write(
            plain,
            geometry,
            field_data=[],
            fields=[],
            geometry_type="Polygon",
            **_settings(tin, "outline", f"outline of the {title(tin)}"),
        )


def _settings(tin: Tin, layer: str, description: str) -> dict[str, Any]:
    return {
        "layer": layer,
        "driver": "GPKG",
        "crs": crs_definition(tin) or _UNDEFINED,
        "dataset_options": {"VERSION": "1.3"},
        "layer_options": {"DESCRIPTION": description},
    }


@contextlib.contextmanager
def _database(path: Path, layer: str, rows: int) -> Iterator[Path]:
    """Yield a name to write ``layer`` to that GDAL reads no meaning into; then check it, and rename it."""
    from pyogrio.util import vsi_path

    plain = path.with_name("tin.gpkg")
    if vsi_path(str(plain)) != str(plain):  # it takes "a!b" for a member of an archive
        raise OSError(f"pyogrio would read a meaning into the directory's name {str(path.parent.parent)!r}")
    try:
        yield plain
    except RuntimeError as error:  # the base of pyogrio's errors
        raise OSError(str(error)) from error
    _check_whole(plain, layer, rows)
    plain.replace(path)


def polygons_wkb(tin: Tin, rows: slice = ALL) -> NDArray[Any]:
    """Return the m triangles in ``rows`` as WKB polygons with z, an array (m,) of void items of 109 bytes."""
    triangles = tin.triangles[rows]
    polygons = np.empty(len(triangles), _POLYGON_Z)
    polygons["byte_order"] = 1
    polygons["type"] = 1003
    polygons["rings"] = 1
    polygons["points"] = 4
    polygons["xyz"] = tin.vertices[triangles[:, [0, 1, 2, 0]]]
    return polygons.view(f"V{_POLYGON_Z.itemsize}")


def outline_wkb(polygon: list[NDArray[np.float64]]) -> bytes:
    """Return closed rings (k, 2 or 3), the exterior first, as a WKB polygon of x and y."""
    rings = (struct.pack("<I", len(ring)) + ring[:, :2].astype("<f8").tobytes() for ring in polygon)
    return struct.pack("<BII", 1, 3, len(polygon)) + b"".join(rings)


def _description(tin: Tin) -> str:
    heights = tin.dem.vertical_unit or "unknown unit"
    areas = f"square {area_unit(tin)}"
    return f"{title(tin)}: heights in {heights}, slope and aspect in degrees, areas in {areas}"


def _check_whole(path: Path, layer: str, rows: int) -> None:
    """Raise OSError unless all rows are indexed: pyogrio tells nothing of what fails on closing."""
    whole = f"SELECT (SELECT count(*) FROM rtree_{layer}_geom_rowid), max_y IS NOT NULL FROM gpkg_contents"
    try:
        with contextlib.closing(sqlite3.connect(path)) as database:
            complete = database.execute(whole).fetchall() == [(rows, 1)]
    except sqlite3.Error:
        complete = False
    if not complete:
        raise OSError("the GeoPackage came out incomplete; is the disk full?")
