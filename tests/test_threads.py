"""Several triangulations at once in one process."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from terrain import dem, hills

import tin

THREADS = 8


def fingerprint(mesh: tin.Tin) -> tuple[bytes, ...]:
    arrays = (mesh.vertices, mesh.triangles, mesh.constrained, mesh.triangle_errors, mesh.spikes)
    return tuple(array.tobytes() for array in arrays)


def ragged(seed: int) -> tin.DEM:
    random = np.random.default_rng(seed)
    z = hills(90, 110, seed) + random.normal(0, 1.0, (90, 110))
    return tin.DEM(z.astype(np.float32 if seed % 2 else np.float64), random.random(z.shape) < 0.9)


@pytest.mark.parametrize("method", ["auto", "median", "max"])
def test_eight_threads_give_the_bytes_of_one(method):
    sources = [*(dem(100, 120, seed) for seed in range(3)), *(ragged(seed) for seed in range(3))]
    alone = [fingerprint(tin.triangulate(source, max_points="6%", method=method)) for source in sources]
    assert len(set(alone)) == len(sources)
    together = threading.Barrier(THREADS)

    def work(number: int) -> list[bool]:
        # Half of the threads are at the same DEM at the same time, the others each at another.
        start = 0 if number % 2 else number
        order = [*range(start, len(sources)), *range(start)]
        same = []
        for index in order:
            together.wait(60)
            mesh = tin.triangulate(sources[index], max_points="6%", method=method)
            same.append(fingerprint(mesh) == alone[index])
        return same

    with ThreadPoolExecutor(THREADS) as pool:
        results = list(pool.map(work, range(THREADS)))
    assert results == [[True] * len(sources)] * THREADS
