"""Reading vector files: points, lines and polygons that the TIN follows."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tin import reader, sources
from tin.crs import CRS
from tin.errors import InputError
from tin.shapes import Collector, Shapes

if TYPE_CHECKING:
    from collections.abc import Iterator


def read(source: str, *, allow_remote: bool = False) -> tuple[Shapes, CRS | None]:
    """All geometries of one layer of a vector file, and their CRS.

    Curves come as the chords that GDAL puts in their place; measures (M) and attributes are left out.

    Args:
        source: FILE or FILE:LAYER, in any format that fiona reads; without a layer the first one. A file
            of exactly that name comes first, so names may hold colons.
        allow_remote: also read from the network.

    Raises:
        InputError: "not-found", "not-a-vector", "no-layer", "unreadable", "remote", "bad-crs" or
            "missing-library".
    """
    path, layer = _split(source)
    try:
        import fiona
        import fiona.errors
        from fiona._err import CPLE_BaseError
    except ImportError as error:
        raise InputError(
            "missing-library", f"{source}: vector files need fiona: pip install fiona ({error})"
        ) from error
    settings = {} if allow_remote else {"CPL_VSIL_CURL_ALLOWED_FILENAME": "-"}
    try:
        if not allow_remote:
            reader.refuse_remote(path)
        # In fiona's environment GDAL logs its complaints, elsewhere it would print them.
        with fiona.Env(**settings), sources.WARNING_FILTERS, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if layer is not None:
                _check_layer(path, layer, fiona.listlayers(path))
            with fiona.open(path, layer=layer) as file:
                if file.schema["geometry"] == "None":
                    raise InputError("not-a-vector", f"{source}: a table without geometries")
                return _shapes(file, source), _crs(file)
    except (fiona.errors.FionaError, CPLE_BaseError, OSError, UnicodeError) as error:
        why = " ".join(str(error).split())
        raise InputError("not-a-vector", f"{path}: cannot be read as a vector file ({why})") from error


def _split(source: str) -> tuple[str, str | None]:
    """Return file and layer, the file as a whole path: fiona sees a meaning in some names."""
    head, _, tail = source.rpartition(":")
    if source.startswith("/vsi") or reader.is_remote(source):
        # The colon of a scheme or of a port is followed by a slash.
        return (head, tail) if head and "/" not in tail else (source, None)
    colons = [index for index, character in enumerate(source) if character == ":"]
    for end in [len(source), *reversed(colons)]:
        path = source[:end]
        try:
            if path and Path(path).exists():
                return str(Path(path).absolute()), None if end == len(source) else source[end + 1 :]
        except (OSError, ValueError) as error:  # a name too long, or with a null character
            raise InputError("not-found", f"{source!r}: no such file ({error})") from error
    is_drive = len(head) == 1
    raise InputError("not-found", f"{source if is_drive else head or source}: no such file")


def _check_layer(path: str, layer: str, layers: list[str]) -> None:
    if layer not in layers:
        raise InputError("no-layer", f"{path}: there is no layer {layer!r}; there are {', '.join(layers)}")


class _Complaints(logging.Handler):
    """Keeps what GDAL says is wrong, all that tells a damaged geometry from one that is not there."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the message."""
        self.messages.append(record.getMessage())


def _shapes(file: Any, source: str) -> Shapes:
    collector, complaints = Collector(), _Complaints()
    logger = logging.getLogger("fiona._env")
    logger.addHandler(complaints)
    try:
        for geometry in _geometries(file):
            collector.add(geometry)
    finally:
        logger.removeHandler(complaints)
    if complaints.messages:
        raise InputError("unreadable", f"{source}: damaged or incomplete ({complaints.messages[0]})")
    try:
        return collector.shapes()
    except (TypeError, ValueError) as error:
        raise InputError("unreadable", f"{source}: has damaged coordinates ({error})") from error


def _geometries(file: Any) -> Iterator[Any]:
    """Yield what has a geometry; fiona tells an empty point of GeoJSON or CSV as one at (0, 0)."""
    doubtful = {}
    for feature in file:
        geometry = feature.geometry
        if geometry is None:
            continue
        if geometry.type == "Point" and geometry.coordinates[:2] == (0.0, 0.0):
            doubtful[feature.id] = geometry
        else:
            yield geometry
    if doubtful:
        # A spatial filter never finds what is empty.
        yield from (doubtful[found.id] for found in file.filter(bbox=(-1, -1, 1, 1)) if found.id in doubtful)


def _crs(file: Any) -> CRS | None:
    if not file.crs:
        return None
    crs = CRS.from_rasterio(file.crs)  # fiona's CRS has the same two methods
    return None if crs.name.startswith("Undefined ") else crs  # what a GeoPackage says where there is none
