"""Heights of any set of triangles on a grid; numpy alone."""

import numpy as np

SLACK = 1e-6  # pixels: map coordinates of pixel centres come back with rounding errors
BLOCK = 1 << 21  # rows or pixels at a time: bounds the memory


def rasterize(corners, shape, check):
    """Return (rows, cols) float64, NaN where no triangle is.

    ``corners``: (m, 3, 3) of column, row (pixel centres are whole numbers) and height. Edges belong to their
    triangles; upright or flat triangles are left out. ``check(fraction)`` is called now and then.
    """
    rows, cols = shape
    surface = np.full(rows * cols, np.nan)
    first, gradient = _planes(corners)
    top, end = _range(corners[:, :, 1].min(axis=1), corners[:, :, 1].max(axis=1), rows)
    end[~np.isfinite(gradient).all(axis=1)] = 0
    for triangles in _blocks(np.maximum(end - top, 0)):
        check(triangles.start / len(corners))
        which, row = _expand(top[triangles], end[triangles])
        which += triangles.start
        left, right = _spans(corners[which], row)
        start, stop = _range(left, right, cols)
        for spans in _blocks(np.maximum(stop - start, 0)):
            check(triangles.start / len(corners))
            span, col = _expand(start[spans], stop[spans])
            span += spans.start
            t = which[span]
            step = np.stack([col, row[span]], axis=1) - first[t, :2]
            surface[row[span] * cols + col] = first[t, 2] + (gradient[t] * step).sum(axis=1)
    return surface.reshape(shape)


def _planes(corners):
    """Return a corner of each triangle, and the slope of its plane along columns and rows."""
    first = corners[:, 0]
    (ux, uy, uz), (vx, vy, vz) = (corners[:, 1] - first).T, (corners[:, 2] - first).T
    with np.errstate(divide="ignore", invalid="ignore"):
        doubled = ux * vy - uy * vx
        gradient = np.stack([uz * vy - uy * vz, ux * vz - uz * vx], axis=1) / doubled[:, None]
    return first, gradient


def _spans(corners, row):
    """Return where each triangle begins and ends on its row."""
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for k in range(3):
        (ax, ay), (bx, by) = corners[:, k, :2].T, corners[:, (k + 1) % 3, :2].T
        crossed = (np.minimum(ay, by) - SLACK <= row) & (row <= np.maximum(ay, by) + SLACK)
        level = np.abs(by - ay) <= SLACK
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.clip((row - ay) / (by - ay), 0.0, 1.0)
        at = ax + share * (bx - ax)
        low, high = np.where(level, np.minimum(ax, bx), at), np.where(level, np.maximum(ax, bx), at)
        left = np.where(crossed, np.minimum(left, low), left)
        right = np.where(crossed, np.maximum(right, high), right)
    return left, right


def _range(low, high, size):
    """Return first and end of the whole numbers from ``low`` to ``high`` that are inside the grid."""
    first = np.clip(np.ceil(low - SLACK), 0, size)
    end = np.clip(np.floor(high + SLACK) + 1, 0, size)
    return first.astype(np.int64), end.astype(np.int64)


def _expand(first, end):
    """Return, for every whole number of every range, the range's index and the number."""
    counts = np.maximum(end - first, 0)
    index = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return index, np.arange(len(index)) - before[index] + first[index]


def _blocks(counts):
    """Yield slices of ``counts`` that sum up to about BLOCK each."""
    block = np.cumsum(counts) // BLOCK
    edges = np.flatnonzero(np.diff(block)) + 1
    limits = [0, *edges.tolist(), len(counts)]
    for start, stop in zip(limits, limits[1:]):
        if stop > start:
            yield slice(start, stop)
