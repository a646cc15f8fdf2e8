"""Too little memory, as the system tells of it: a limit on the address space of the command."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import MaskFlags

import tin
from tin import sources

pytest.importorskip("resource")

# The limit is counted from what the process takes with all its libraries, so that it hits the reading.
PROGRAM = """
import resource, sys
import rasterio._io
from tin import cli, formats, reader, vector
from tin.tin import triangulate
taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
limit = taken + int(sys.argv[1]) * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
sys.exit(cli.main(sys.argv[2:]))
"""


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small file of 4000 x 4000 heights: 61 MiB as float32, and 15 MiB for each mask on the way."""
    path = tmp_path_factory.mktemp("large") / "dem.tif"
    packing = {"tiled": True, "compress": "deflate", "sparse_ok": True}
    size = {"height": 4000, "width": 4000, "count": 1, "transform": rasterio.Affine(30, 0, 0, 0, -30, 0)}
    with rasterio.open(path, "w", driver="GTiff", dtype="int16", crs="EPSG:32616", **size, **packing):
        pass
    return path


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize("mebibytes", [8, 32, 60, 66, 76, 84, 92])
def test_a_dem_that_does_not_fit_into_memory_gets_one_line(tmp_path, large, mebibytes):
    command = [sys.executable, "-c", PROGRAM, str(mebibytes), large, tmp_path / "x.obj"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3, done.stderr
    assert done.stderr == f"dem2tin: {large}: 4000 x 4000 pixels do not fit into memory\n"
    assert done.stdout == ""
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def rough(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1200 x 1200 heights of which a fifth become vertices: the mesh takes far more memory than they do."""
    path = tmp_path_factory.mktemp("rough") / "dem.tif"
    heights = np.random.default_rng(1).normal(size=(1200, 1200)).cumsum(0).cumsum(1).astype(np.float32)
    size = {"height": 1200, "width": 1200, "count": 1, "transform": rasterio.Affine(30, 0, 0, 0, -30, 0)}
    with rasterio.open(path, "w", driver="GTiff", dtype="float32", crs="EPSG:32616", **size) as file:
        file.write(heights, 1)
    return path


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize("mebibytes", [18, 22, 26, 30, 34, 42, 54, 70, 100, 140, 1000])
def test_a_tin_that_does_not_fit_into_memory_gets_one_line(tmp_path, rough, mebibytes):
    output = tmp_path / "x.obj"
    command = [sys.executable, "-c", PROGRAM, str(mebibytes), rough, output, "--max-points", "20%"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if mebibytes == 1000:
        assert done.returncode == 0, done.stderr
        assert output.exists()
        return
    assert done.returncode == 3, done.stderr
    assert done.stderr.startswith("dem2tin: ")
    assert "memory" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module", params=["nodata", "mask", "scale"])
def peculiar(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1500 x 1400 heights with voids; 8 MB as float32, 16 MB as the float64 that a scale asks for."""
    path = tmp_path_factory.mktemp("peculiar") / "dem.tif"
    heights = np.random.default_rng(2).integers(-9999, 9000, (1500, 1400)).astype(np.float32)
    shape = {"height": 1500, "width": 1400, "count": 1, "transform": rasterio.Affine(30, 0, 0, 0, -30, 0)}
    nodata = None if request.param == "mask" else -9999.0
    with rasterio.open(path, "w", driver="GTiff", dtype="float32", nodata=nodata, **shape) as file:
        file.write(heights, 1)
        if request.param == "mask":
            file.write_mask(heights > -5000)
        if request.param == "scale":
            file.scales, file.offsets = (0.3,), (7.0,)
    return path


def test_blocks_of_any_size_make_the_same_dem(peculiar, monkeypatch):
    whole = tin.open(peculiar, z_factor=0.3048)
    for size in (1, 5000, 10**9):
        monkeypatch.setattr(sources, "BLOCK", size)
        other = tin.open(peculiar, z_factor=0.3048)
        assert other.z.tobytes() == whole.z.tobytes()
        assert other.n_valid == whole.n_valid == np.isfinite(whole.z).sum() < whole.z.size
        assert other.warnings() == whole.warnings()


def test_reading_takes_the_memory_of_the_heights_and_little_more(peculiar, monkeypatch):
    monkeypatch.setattr(sources, "BLOCK", 2**14)
    tin.open(peculiar)  # what the libraries keep for themselves is not counted
    tracemalloc.start()
    dem = tin.open(peculiar, z_factor=0.3048)
    _ = dem.n_valid, dem.warnings()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    with rasterio.open(peculiar) as file:
        mask = dem.z.size if MaskFlags.per_dataset in file.mask_flag_enums[0] else 0
    assert dem.z.nbytes + mask <= peak < dem.z.nbytes + mask + 2**20


def test_undeclared_nodata_is_counted_over_all_blocks(monkeypatch):
    z = np.full((60, 50), 400.0, np.float32)
    z[::7, 3] = -9999.0
    whole = tin.DEM(z).warnings()
    assert "9 pixels are -9999" in whole[0]
    monkeypatch.setattr(sources, "BLOCK", 100)
    assert tin.DEM(z).warnings() == whole
    assert tin.DEM(np.where(z < 0, -9999.0, -9000.0)).warnings() == []
    assert tin.DEM(np.full((3, 3), -9999.0)).warnings() == []
