"""The rasteriser of any triangles, against every pixel tried."""

import numpy as np
import pytest
from dem2tin import surface
from dem2tin.surface import rasterize


def every_pixel(corners, shape):
    heights = np.full(shape, np.nan)
    row, col = np.mgrid[: shape[0], : shape[1]]
    for (ax, ay, az), (bx, by, bz), (cx, cy, cz) in corners:
        doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if doubled == 0:
            continue
        b = ((col - ax) * (cy - ay) - (row - ay) * (cx - ax)) / doubled
        c = ((bx - ax) * (row - ay) - (by - ay) * (col - ax)) / doubled
        inside = (b >= -1e-9) & (c >= -1e-9) & (b + c <= 1 + 1e-9)
        heights[inside] = (az + b * (bz - az) + c * (cz - az))[inside]
    return heights


@pytest.mark.parametrize("block", [1 << 21, 7])
def test_random_triangles(monkeypatch, block):
    monkeypatch.setattr(surface, "BLOCK", block)
    random = np.random.default_rng(5)
    for size in (0.4, 3, 30):
        for _ in range(20):
            middle = random.uniform(-5, 35, 2)
            corners = np.empty((1, 3, 3))
            corners[0, :, :2] = middle + random.uniform(-size, size, (3, 2))
            corners[0, :, 2] = random.uniform(0, 9, 3)
            drawn = rasterize(corners, (21, 27), lambda _: None)
            assert np.allclose(drawn, every_pixel(corners, (21, 27)), equal_nan=True)


def test_corners_on_pixels_and_triangles_without_area():
    square = [[0, 0, 1.0], [4, 0, 2.0], [4, 3, 3.0], [0, 3, 4.0]]
    line, point = [[0, 0, 9.0], [2, 0, 9], [4, 0, 9]], [[1, 1, 9.0]] * 3
    corners = np.array([line, point, [square[0], square[1], square[2]], [square[0], square[2], square[3]]])
    drawn = rasterize(corners, (5, 6), lambda _: None)
    assert np.allclose(drawn, every_pixel(corners, (5, 6)), equal_nan=True)
    assert np.isfinite(drawn[:4, :5]).all()
    assert np.isnan(drawn[4]).all()
    assert np.isnan(drawn[:, 5]).all()
