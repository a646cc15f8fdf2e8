"""GeoPackage: one POLYGON Z with its attributes per triangle, in the layer ``tin``."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tin.formats.arrow import ColumnStream
from tin.formats.attributes import area_unit, attributes
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
    """Write the triangles of ``tin`` as GeoPackage 1.3 with an R-tree.

    Polygons run counter-clockwise; the columns are those of `tin.formats.attributes.attributes`
    (NULL for NaN). Without a CRS the layer is "undefined Cartesian".
    """
    from pyogrio import raw
    from pyogrio.util import vsi_path

    columns = {**attributes(tin), "geom": polygons_wkb(tin)}
    plain = path.with_name("tin.gpkg")
    if vsi_path(str(plain)) != str(plain):  # it takes "a!b" for a member of an archive
        raise OSError(f"pyogrio would read a meaning into the directory's name {str(path.parent.parent)!r}")
    try:
        raw.write_arrow(
            ColumnStream(columns),
            plain,
            layer="tin",
            driver="GPKG",
            geometry_name="geom",
            geometry_type="Polygon Z",
            crs=crs_definition(tin) or _UNDEFINED,
            dataset_options={"VERSION": "1.3"},
            layer_options={"DESCRIPTION": _description(tin)},
        )
    except RuntimeError as error:  # the base of pyogrio's errors
        raise OSError(str(error)) from error
    _check_whole(plain, len(tin.triangles))
    plain.replace(path)


def polygons_wkb(tin: Tin) -> NDArray[Any]:
    """Return the m triangles as WKB polygons with z, an array (m,) of void items of 109 bytes."""
    polygons = np.empty(len(tin.triangles), _POLYGON_Z)
    polygons["byte_order"] = 1
    polygons["type"] = 1003
    polygons["rings"] = 1
    polygons["points"] = 4
    polygons["xyz"] = tin.vertices[tin.triangles[:, [0, 1, 2, 0]]]
    return polygons.view(f"V{_POLYGON_Z.itemsize}")


def _description(tin: Tin) -> str:
    heights = tin.dem.vertical_unit or "unknown unit"
    areas = f"square {area_unit(tin)}"
    return f"{title(tin)}: heights in {heights}, slope and aspect in degrees, areas in {areas}"


def _check_whole(path: Path, triangles: int) -> None:
    """Raise OSError unless all rows are indexed: pyogrio tells nothing of what fails on closing."""
    whole = "SELECT (SELECT count(*) FROM rtree_tin_geom_rowid), max_y IS NOT NULL FROM gpkg_contents"
    try:
        with contextlib.closing(sqlite3.connect(path)) as database:
            complete = database.execute(whole).fetchall() == [(triangles, 1)]
    except sqlite3.Error:
        complete = False
    if not complete:
        raise OSError("the GeoPackage came out incomplete; is the disk full?")
