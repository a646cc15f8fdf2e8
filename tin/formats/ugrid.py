"""UGRID NetCDF: the TIN as the mesh layer that QGIS opens natively, with its CRS."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from tin.formats.common import title

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tin.crs import CRS
    from tin.tin import Tin

Attribute = Union[str, int, float]

_TYPES = {"S1": 2, "i4": 4, "f8": 6}
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
_UNITS = {"metre": "m", "foot": "ft", "US survey foot": "US_survey_foot"}  # as UDUNITS spells them
_ROWS = 1 << 18  # turned big-endian at a time


@dataclass(frozen=True)
class Variable:
    """A NetCDF variable: its dimensions by name, its values and attributes."""

    name: str
    dimensions: tuple[str, ...]
    values: NDArray[Any]
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


def write(tin: Tin, path: Path) -> None:
    """Write the mesh of ``tin`` by the conventions CF-1.8 and UGRID-1.0.

    Nodes have x, y and z (``mesh2d_node_z``), faces their corners (counter-clockwise, from 0) and
    ``max_error``. The variable ``crs`` carries the CRS as WKT and, if it has one, its EPSG code.
    """
    dimensions = {"node": len(tin.vertices), "face": len(tin.triangles), "corner": 3}
    attributes = {"Conventions": "CF-1.8 UGRID-1.0", "title": title(tin)}
    with path.open("wb") as file:
        write_netcdf(file, dimensions, attributes, _variables(tin))


def _variables(tin: Tin) -> list[Variable]:
    x, y, z = tin.vertices.T
    (x_name, x_unit), (y_name, y_unit) = _axes(tin)
    height: dict[str, Attribute] = {"units": _UNITS.get(tin.dem.vertical_unit, "")}
    reference: dict[str, Attribute] = {"grid_mapping": "crs"} if tin.crs is not None else {}
    topology: dict[str, Attribute] = {
        "cf_role": "mesh_topology",
        "topology_dimension": 2,
        "node_coordinates": "mesh2d_node_x mesh2d_node_y",
        "face_node_connectivity": "mesh2d_face_nodes",
    }
    corners: dict[str, Attribute] = {"cf_role": "face_node_connectivity", "start_index": 0}
    on_nodes: dict[str, Attribute] = {"mesh": "mesh2d", "location": "node", "standard_name": "altitude"}
    on_faces: dict[str, Attribute] = {"mesh": "mesh2d", "location": "face", "long_name": "max_error"}
    nothing = np.zeros((), np.int32)  # a variable of which only the attributes matter
    return [
        Variable("mesh2d", (), nothing, topology),
        *([Variable("crs", (), nothing, _crs_attributes(tin.crs))] if tin.crs is not None else []),
        Variable("mesh2d_node_x", ("node",), x, {"standard_name": x_name, "units": x_unit, **reference}),
        Variable("mesh2d_node_y", ("node",), y, {"standard_name": y_name, "units": y_unit, **reference}),
        Variable("mesh2d_node_z", ("node",), z, {**on_nodes, **height, **reference}),
        Variable("mesh2d_face_nodes", ("face", "corner"), tin.triangles, corners),
        Variable("max_error", ("face",), tin.triangle_errors, {**on_faces, **height, **reference}),
    ]


def _axes(tin: Tin) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return standard name and unit of x and of y; the unit is "" where unknown."""
    if tin.crs is not None and tin.crs.is_geographic:
        return ("longitude", "degrees_east"), ("latitude", "degrees_north")
    unit = "" if tin.crs is None else _UNITS.get(tin.crs.unit_name, "")
    return ("projection_x_coordinate", unit), ("projection_y_coordinate", unit)


def _crs_attributes(crs: CRS) -> dict[str, Attribute]:
    """Return the CRS as CF (``crs_wkt``), GDAL (``spatial_ref``) and QGIS's MDAL (``wkt``) look for it."""
    wkt = " ".join(line.strip() for line in crs.wkt.splitlines())
    code = crs.code if crs.code and crs.code.startswith("EPSG:") else ""
    return {"crs_wkt": wkt, "spatial_ref": wkt, "wkt": wkt, "EPSG_code": code}


def write_netcdf(
    file: Any, dimensions: Mapping[str, int], attributes: Mapping[str, Attribute], variables: list[Variable]
) -> None:
    """Write a NetCDF classic file with 64-bit offsets (CDF-2); numpy alone, so that it works inside any GIS.

    Values are written as int32 or float64; empty attributes are left out.
    """
    index = {name: number for number, name in enumerate(dimensions)}
    start = b"CDF\2" + struct.pack(">i", 0)  # no records
    start += _list(_DIMENSIONS, [_name(name) + struct.pack(">i", size) for name, size in dimensions.items()])
    start += _attributes(attributes)
    kinds = ["f8" if variable.values.dtype.kind == "f" else "i4" for variable in variables]
    sizes = [_padded(int(v.values.size) * int(kind[1])) for v, kind in zip(variables, kinds)]
    heads = [
        _name(v.name)
        + struct.pack(f">i{len(v.dimensions)}i", len(v.dimensions), *(index[d] for d in v.dimensions))
        + _attributes(v.attributes)
        # The size of a variable beyond 4 GiB is not to be written down.
        + struct.pack(">iI", _TYPES[kind], min(size, 2**32 - 1))
        for v, kind, size in zip(variables, kinds, sizes)
    ]
    position = len(start) + len(_list(_VARIABLES, heads)) + 8 * len(heads)
    places = []
    for head, size in zip(heads, sizes):
        places.append(head + struct.pack(">q", position))
        position += size
    file.write(start + _list(_VARIABLES, places))
    for variable, kind, size in zip(variables, kinds, sizes):
        values = variable.values.reshape(-1)
        for first in range(0, len(values), _ROWS):
            file.write(values[first : first + _ROWS].astype(">" + kind).tobytes())
        file.write(bytes(size - len(values) * int(kind[1])))


def _attributes(attributes: Mapping[str, Attribute]) -> bytes:
    known = {name: value for name, value in attributes.items() if value != ""}
    return _list(_ATTRIBUTES, [_name(name) + _value(value) for name, value in known.items()])


def _value(value: Attribute) -> bytes:
    if isinstance(value, str):
        text = value.encode("utf-8", "replace")
        return struct.pack(">ii", _TYPES["S1"], len(text)) + text.ljust(_padded(len(text)), b"\0")
    kind, code = ("i4", "i") if isinstance(value, int) else ("f8", "d")
    return struct.pack(f">ii{code}", _TYPES[kind], 1, value)


def _name(name: str) -> bytes:
    text = name.encode()
    return struct.pack(">i", len(text)) + text.ljust(_padded(len(text)), b"\0")


def _list(tag: int, items: list[bytes]) -> bytes:
    return struct.pack(">ii", tag if items else 0, len(items)) + b"".join(items)


def _padded(length: int) -> int:
    return length + -length % 4
