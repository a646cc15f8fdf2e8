"""Fractal terrain for timing, also of rasters that only just fit the memory."""

from __future__ import annotations

import numpy as np
from common import SAMPLE
from scipy import fft

SLOPES = {"smooth": (3.0, 1), "rough": (2.2, 2)}
"""By name: b in the power f^-b of a profile's spectrum (real relief: mostly 2 to 3), and seed."""

NAMES = (*SLOPES, "sample")


def make(name: str, size: int) -> np.ndarray:
    """(size, size) float32 heights of the terrain of that name, from 0 to 1000 if it is made up."""
    return sample(size) if name == "sample" else fractal(size, *SLOPES[name])


def fractal(size: int, slope: float, seed: int) -> np.ndarray:
    """Gaussian noise with the power f^-slope along any line, periodic, by one inverse FFT in float32.

    Takes 12 bytes a pixel at its peak: 1.4 GB at 10812 x 10812.
    """
    random = np.random.default_rng(seed)
    across = np.square(fft.rfftfreq(size))
    spectrum = np.empty((size, len(across)), np.complex64)
    # A surface's power falls by one power of f faster than a profile's; amplitude is its root.
    power = -(slope + 1.0) / 4.0
    for row, along in enumerate(np.square(fft.fftfreq(size))):
        noise = random.standard_normal((2, len(across)), np.float32)
        with np.errstate(divide="ignore"):
            amplitude = (across + along) ** power
        spectrum[row] = (noise[0] + 1j * noise[1]) * np.where(np.isfinite(amplitude), amplitude, 0.0)
    z = fft.irfft2(spectrum, s=(size, size), overwrite_x=True)
    del spectrum
    z -= z.min()
    z *= np.float32(1000.0) / z.max()
    return z


def sample(size: int) -> np.ndarray:
    """The sample DEM resampled to size x size by cubic convolution: smooth between its own pixels."""
    import rasterio
    from rasterio.enums import Resampling

    with rasterio.open(SAMPLE) as dem:
        return dem.read(1, out_shape=(size, size), resampling=Resampling.cubic).astype(np.float32)
