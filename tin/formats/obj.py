"""Wavefront OBJ: the TIN as a mesh of shared vertices, relative to a local origin."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tin.formats.common import title

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tin.tin import Tin

_ROWS = 1 << 18  # formatted at a time: bounds the memory for text


def write(tin: Tin, path: Path, *, y_up: bool = False) -> None:
    """Write ``tin`` as OBJ, and its CRS as WKT to a ``.prj`` beside it.

    Viewers keep float32, so x and y are relative to an origin near the middle, a round number
    that the comments at the top name, with the CRS and the units. Adding it gives the map
    coordinates back in full. With ``y_up`` the axes are x east, y up, z south; else x east, y north, z up.
    """
    origin = _origin(tin.vertices)
    local = tin.vertices.copy()
    for axis in (0, 1):
        local[:, axis] = _local(tin.vertices[:, axis], origin[axis])
    if y_up:
        local = local[:, [0, 2, 1]] * (1.0, 1.0, -1.0)
    with path.open("wb") as file:
        file.write(_header(tin, origin, y_up).encode())
        for rows in _slices(len(local)):
            file.write(_lines(b"v", [_decimals(values) for values in local[rows].T]))
        numbers = np.arange(1, len(local) + 1).astype(f"S{len(str(len(local)))}")
        for rows in _slices(len(tin.triangles)):
            file.write(_lines(b"f", list(numbers[tin.triangles[rows].T])))
    if tin.crs is not None:
        path.with_suffix(".prj").write_text(_one_line(tin.crs.wkt) + "\n", encoding="utf-8")


def _header(tin: Tin, origin: NDArray[Any], y_up: bool) -> str:
    crs = tin.crs
    axes = "x east, y up, z south" if y_up else "x east, y north, z up"
    back = "(x, -z, y)" if y_up else "(x, y, z)"
    lines = [title(tin), f"vertices: {len(tin.vertices)}, triangles: {len(tin.triangles)}"]
    if crs is None:
        lines += ["CRS: none", "horizontal unit: unknown"]
    else:
        lines += [f"CRS: {crs.code or 'no code'} ({crs.name})", f"CRS WKT: {crs.wkt}"]
        degrees = " (longitude, latitude)" if crs.is_geographic else ""
        lines += [f"horizontal unit: {crs.unit_name}{degrees}"]
    lines += [
        f"vertical unit: {tin.dem.vertical_unit or 'unknown'}",
        f"axes: {axes}",
        "origin: " + " ".join(map(_number, origin.tolist())),
        f"map coordinates = origin + {back}",
    ]
    return "".join(f"# {_one_line(line)}\n" for line in lines) + "o tin\n"


def _one_line(text: str) -> str:
    return " ".join(line.strip() for line in text.splitlines())


def _origin(vertices: NDArray[Any]) -> NDArray[Any]:
    """Return the middle of x and y, rounded to a tenth of the extent's order of magnitude; z stays."""
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    decimals = 1 - math.floor(math.log10((high - low).max()))
    return np.array([*np.round((low + high) / 2, decimals), 0.0])


def _local(coordinates: NDArray[Any], origin: float) -> NDArray[Any]:
    """Return ``coordinates - origin`` in as few decimals as add up to ``coordinates`` again, if may be.

    The digits that a subtraction leaves behind them say nothing: 500345.1 - 500000 is 345.0999999999767.
    """
    local = coordinates - origin
    rounded = np.round(local, math.floor(-math.log10(np.spacing(np.abs(coordinates).max()))))
    return np.where(origin + rounded == coordinates, rounded, local)


def _decimals(values: NDArray[Any]) -> NDArray[Any]:
    """Return, as an array of bytes, the shortest decimals that read as ``values``."""
    unique, inverse = np.unique(values + 0.0, return_inverse=True)  # + 0.0: no negative zero
    texts = np.array([_number(value) for value in unique.tolist()], dtype=np.bytes_)
    return texts[inverse]


def _number(value: float) -> str:
    return repr(value).removesuffix(".0")


def _lines(key: bytes, columns: Sequence[NDArray[Any]]) -> bytes:
    """Return one line a row: fields of fixed width first, then without the NULs that pad them."""
    space = np.full(len(columns[0]), b" ")
    pieces = [np.full_like(space, key)]
    for column in columns:
        pieces += [space, column]
    pieces.append(np.full_like(space, b"\n"))
    table = np.empty(len(space), [(f"f{i}", piece.dtype) for i, piece in enumerate(pieces)])
    for name, piece in zip(table.dtype.names or (), pieces):
        table[name] = piece
    return table.tobytes().translate(None, b"\0")


def _slices(length: int) -> Iterator[slice]:
    return (slice(start, start + _ROWS) for start in range(0, length, _ROWS))
