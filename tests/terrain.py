"""Made terrain for the tests."""

from __future__ import annotations

import numpy as np

import tin


def hills(rows: int, cols: int, seed: int = 0, relief: float = 100.0) -> np.ndarray:
    """Smooth random relief, float64."""
    random = np.random.default_rng(seed)
    row, col = np.mgrid[:rows, :cols]
    z = np.zeros((rows, cols))
    for scale in (0.03, 0.07, 0.15, 0.3):
        angle, phase = random.uniform(0, 2 * np.pi, 2)
        z += np.sin(scale * (row * np.cos(angle) + col * np.sin(angle)) + phase) / scale
    return relief * (z - z.min()) / (z.max() - z.min())


def dem(rows: int = 60, cols: int = 80, seed: int = 0, **keywords: object) -> tin.DEM:
    """Hills with 30 m pixels in UTM."""
    keywords.setdefault("transform", (30.0, 0.0, 500000.0, 0.0, -30.0, 5_100_000.15))
    return tin.DEM(hills(rows, cols, seed), **keywords)
