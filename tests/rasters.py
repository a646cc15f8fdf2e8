"""Small rasters to read."""

import warnings

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning

from tin.errors import InputError
from tin.reader import open as open_dem

UTM = Affine(30, 0, 557805, 0, -30, 5122005)  # pixel centres on multiples of 30, as USGS DEM wants
ROWS, COLS = 40, 50
HEIGHTS = (1000 + 10 * np.arange(ROWS)[:, None] + np.arange(COLS)).astype(np.int16)
HEIGHTS.flags.writeable = False


def write(path, heights=HEIGHTS, *, driver="GTiff", transform=UTM, crs="EPSG:26710", **profile):
    """Write a raster with rasterio and return its path; `heights` may have several bands."""
    bands = np.atleast_3d(heights.T).T if heights.ndim == 2 else heights
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        profile = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2], **profile}
        with rasterio.open(
            path, "w", driver=driver, dtype=bands.dtype, transform=transform, crs=crs, **profile
        ) as dataset:
            dataset.write(bands)
    return path


def edit(path, function):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "r+") as dataset:
            function(dataset)
    return path


def code_of(path, **options):
    with pytest.raises(InputError) as caught:
        open_dem(path, **options)
    assert "\n" not in str(caught.value)
    return caught.value.code
