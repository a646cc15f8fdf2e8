"""dem2tin: compact, noise-robust triangle meshes (TINs) from georeferenced DEMs.

import tin

dem = tin.open("x.dem")
mesh = tin.triangulate(dem, max_points=5000)
mesh.write("x.gpkg")
"""

from __future__ import annotations

from tin.crs import CRS
from tin.dem import DEM
from tin.errors import Cancelled, InputError, OptionError, OutputError, TinError
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
