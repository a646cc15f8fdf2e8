"""Make the sample DEMs of this folder; needs rasterio and matplotlib (for the SRTM heights it ships).

Run it from anywhere: python sample_dem/make_samples.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
import rasterio.shutil
import rasterio.warp
from matplotlib import cbook
from rasterio.enums import Resampling
from rasterio.io import MemoryFile
from rasterio.transform import from_bounds, from_origin
from rasterio.warp import transform_bounds

HERE = Path(__file__).resolve().parent
UTM = "EPSG:32616"
STEP = 90.0
MAX_COLS = 320  # of 346: a column takes 3 kB of ASCII, and the file should stay under 1 MB
NODATA = -9999.0


def jacksboro() -> None:
    """Write the Jacksboro fault as GeoTIFF, in the degrees of the SRTM tile it was cut from."""
    with cbook.get_sample_data("jacksboro_fault_dem.npz") as npz:
        heights = npz["elevation"].astype(np.int16)
        # ymin and ymax are swapped in that file; the rows run from north to south.
        south, north = sorted((float(npz["ymin"]), float(npz["ymax"])))
        transform = from_bounds(float(npz["xmin"]), south, float(npz["xmax"]), north, *heights.shape[::-1])
    profile = {"driver": "GTiff", "dtype": "int16", "count": 1, "crs": "EPSG:4326", "transform": transform}
    profile |= {"height": heights.shape[0], "width": heights.shape[1], "compress": "deflate", "predictor": 2}
    with rasterio.open(HERE / "jacksboro.tif", "w", **profile) as tif:
        tif.write(heights, 1)
        tif.set_band_unit(1, "m")


def jacksboro_usgs() -> None:
    """Write the same heights, reprojected to UTM at 90 m, as a USGS ASCII DEM."""
    with rasterio.open(HERE / "jacksboro.tif") as tif:
        west, south, _, north = transform_bounds(tif.crs, UTM, *tif.bounds, densify_pts=101)
        # USGS DEM wants pixel *centres* on multiples of the spacing.
        left, top = (np.floor(west / STEP) - 0.5) * STEP, (np.ceil(north / STEP) + 0.5) * STEP
        cols, rows = MAX_COLS, int(np.ceil((top - south) / STEP))
        heights = np.full((rows, cols), -32767, dtype=np.int16)
        rasterio.warp.reproject(
            rasterio.band(tif, 1),
            heights,
            dst_transform=from_origin(left, top, STEP, STEP),
            dst_crs=UTM,
            dst_nodata=-32767,
            resampling=Resampling.bilinear,
        )
    profile = {"driver": "GTiff", "dtype": "int16", "count": 1, "crs": UTM, "nodata": -32767}
    profile |= {"height": rows, "width": cols, "transform": from_origin(left, top, STEP, STEP)}
    # Without GDAL_PAM_ENABLED=NO a sidecar would be left that says nothing new.
    with rasterio.Env(GDAL_PAM_ENABLED="NO"), MemoryFile() as memory:
        with memory.open(**profile) as dataset:
            dataset.write(heights, 1)
        with memory.open() as dataset:
            rasterio.shutil.copy(
                dataset, HERE / "jacksboro.dem", driver="USGSDEM", PRODUCT="DEFAULT", PRODUCERCODE="dem2tin"
            )


def crater_lake_voids() -> None:
    """Write a made crater lake with an island: void where the lake is, and in slanted collars around."""
    rows, cols = 150, 200
    y, x = np.mgrid[:rows, :cols] + 0.5
    radius = np.hypot((x - 95) / 1.15, y - 72)
    island = np.hypot(x - 78, y - 80)
    rng = np.random.default_rng(20110829)
    relief = sum(
        rng.normal() * 40 / k * np.sin(k * (x * np.cos(a) + y * np.sin(a)) / 16 + rng.uniform(0, 6))
        for k, a in zip(range(1, 9), rng.uniform(0, np.pi, 8))
    )
    rim = 2200 + 320 * np.exp(-(((radius - 46) / 13) ** 2)) - 3.5 * np.clip(radius - 46, 0, None)
    floor = 1883.0 + 330 * np.exp(-((island / 9) ** 2))
    heights = np.where(radius < 36, floor, rim) + relief * np.clip((radius - 30) / 12, 0.05, 1)
    lake = (radius < 36) & (heights < 1925)
    collar = (x < 6 + 0.05 * y) | (x > cols - 11 + 0.04 * y) | (y < 4 + 0.03 * x) | (y > rows - 10 + 0.03 * x)
    heights[lake | collar] = NODATA
    profile = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": "EPSG:32610", "nodata": NODATA}
    profile |= {"transform": from_origin(565_000.0, 4_758_000.0, 60.0, 60.0), "height": rows, "width": cols}
    profile |= {"compress": "deflate", "predictor": 3}
    with rasterio.open(HERE / "crater_lake_voids.tif", "w", **profile) as tif:
        tif.write(np.round(heights, 1).astype(np.float32), 1)
        tif.set_band_unit(1, "m")


if __name__ == "__main__":
    jacksboro()
    jacksboro_usgs()
    crater_lake_voids()
