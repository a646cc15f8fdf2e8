"""Too little memory, as the system tells of it: a limit on the address space of the command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio

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
