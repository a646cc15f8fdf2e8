"""Rasters that are out to do harm, and how they are to be refused."""

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine

from tin.errors import InputError
from tin.reader import open as open_dem

UTM = Affine(30, 0, 557805, 0, -30, 5122005)
HEIGHTS = (1000 + 10 * np.arange(40)[:, None] + np.arange(50)).astype(np.float32)


def write(path, heights=HEIGHTS, **profile):
    rows, cols = heights.shape
    profile = {"transform": UTM, "crs": "EPSG:26710", "count": 1, "height": rows, "width": cols, **profile}
    with rasterio.open(path, "w", driver="GTiff", dtype=heights.dtype, **profile) as dataset:
        dataset.write(heights, 1)
    return path


def vrt(path, source="dem.tif", *, size=(50, 40), extra="", kind="SimpleSource", nodata=""):
    path.write_text(
        f'<VRTDataset rasterXSize="{size[0]}" rasterYSize="{size[1]}">{extra}'
        f'<VRTRasterBand dataType="Float32" band="1">{nodata}<{kind}>'
        f'<SourceFilename relativeToVRT="1">{source}</SourceFilename><SourceBand>1</SourceBand>'
        f"</{kind}></VRTRasterBand></VRTDataset>"
    )
    return path


def refused(path, *codes, says="", **options):
    with pytest.raises(InputError) as caught:
        open_dem(path, **options)
    message = str(caught.value)
    assert caught.value.code in codes, message
    assert "\n" not in message
    assert says in message
    return message
