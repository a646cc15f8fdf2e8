"""dem2tin: compact, noise-robust triangle meshes (TINs) from georeferenced DEMs.

import tin

dem = tin.open("x.dem")
mesh = tin.triangulate(dem, max_points=5000)
mesh.write("x.gpkg")
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from tin.errors import Cancelled, InputError, OptionError, OutputError, TinError

if TYPE_CHECKING:
    from tin.crs import CRS
    from tin.dem import DEM
    from tin.metrics import Errors, Report
    from tin.reader import open  # noqa: A004 - the name the format libraries use, too
    from tin.tin import Tin, triangulate

__version__ = "0.1.0"

__all__ = [
    "CRS",
    "DEM",
    "Cancelled",
    "Errors",
    "InputError",
    "OptionError",
    "OutputError",
    "Report",
    "Tin",
    "TinError",
    "open",
    "triangulate",
]

# Imported when first asked for: numpy takes longer to load than `dem2tin --help` may run.
_HOMES = {
    "CRS": "crs",
    "DEM": "dem",
    "Errors": "metrics",
    "Report": "metrics",
    "Tin": "tin",
    "open": "reader",
    "triangulate": "tin",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'tin' has no attribute {name!r}")
    found = globals()[name] = getattr(importlib.import_module(f"tin.{_HOMES[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted(globals().keys() | _HOMES.keys())
