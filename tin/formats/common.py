"""How a TIN and its CRS are named in files of any format."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tin.tin import Tin


def title(tin: Tin) -> str:
    """Return "TIN of NAME", one line that UTF-8 can hold."""
    name = " ".join(tin.name.encode("utf-8", "replace").decode().split())
    return f"TIN of {name}" if name else "TIN"


def crs_definition(tin: Tin) -> str | None:
    """Return what GDAL is to make the CRS of: an EPSG code, else WKT (it may not know other codes)."""
    if tin.crs is None:
        return None
    code = tin.crs.code or ""
    return code if code.startswith("EPSG:") else tin.crs.wkt
