"""A large DEM in QGIS takes at most half as much again as on the command line; runs with ``QGIS_BIG=1``."""

import os
import subprocess
import sys

import numpy as np
import pytest
from osgeo import gdal, osr
from support import ROOT

pytestmark = pytest.mark.skipif(not os.environ.get("QGIS_BIG"), reason="takes minutes")
SIDE = 4096


@pytest.fixture(scope="module")
def big(tmp_path_factory):
    """Fractal terrain."""
    random = np.random.default_rng(1)
    frequency = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.rfftfreq(SIDE)[None, :])
    frequency[0, 0] = 1
    waves = (random.normal(size=frequency.shape) + 1j * random.normal(size=frequency.shape)) / frequency**2
    waves[0, 0] = 0
    z = np.fft.irfft2(waves, s=(SIDE, SIDE))
    z = (1000 + 400 * z / z.std()).astype(np.float32)
    path = tmp_path_factory.mktemp("big") / "big.tif"
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), SIDE, SIDE, 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((500000, 10, 0, 5000000, 0, -10))
    reference = osr.SpatialReference()
    reference.ImportFromEPSG(32610)
    dataset.SetSpatialRef(reference)
    dataset.GetRasterBand(1).WriteRaster(0, 0, SIDE, SIDE, z.tobytes(), buf_type=gdal.GDT_Float32)
    return path


LAUNCHER = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(process.pid, 0)
print(status, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024)
"""


def cost(arguments, environment):
    """Processor seconds and peak bytes of a command; from a small process, whose peak it inherits."""
    command = [sys.executable, "-c", LAUNCHER, *map(str, arguments)]
    told = subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout
    status, seconds, peak = map(float, told.split())
    assert status == 0
    return seconds, peak


@pytest.mark.parametrize(("output", "suffix"), [("OUTPUT", ".gpkg"), ("MESH", ".nc")])
def test_within_half_as_much_again(big, tmp_path, output, suffix):
    program = os.environ.get("DEM2TIN", str(ROOT / ".venv" / "bin" / "dem2tin"))
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    theirs = cost([program, big, tmp_path / f"c{suffix}", "--max-points", "1%", "--quiet"], clean)
    inside = {**os.environ, "QGIS_PLUGINPATH": str(ROOT / "qgis_plugin")}
    # Refused where the plugin is enabled already.
    subprocess.run(["qgis_process.bin", "plugins", "enable", "dem2tin"], env=inside, check=False)
    target = tmp_path / f"q{suffix}"
    settings = [f"--INPUT={big}", "--MAX_POINTS=1%", f"--{output}={target}"]
    ours = cost(["qgis_process.bin", "run", "dem2tin:demtotin", *settings], inside)
    told = [f"{seconds:.1f} s, {peak / 1e6:.0f} MB" for seconds, peak in (theirs, ours)]
    print(f"\n{suffix}: command line {told[0]}; QGIS {told[1]}")
    assert ours[0] < 1.5 * theirs[0]
    assert ours[1] < 1.5 * theirs[1]
