"""Several triangulations at once in one process, and one on several threads."""

from __future__ import annotations

import _thread
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from terrain import dem, hills

import tin
from tin import _core

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


@pytest.mark.parametrize("method", ["auto", "median", "max"])
@pytest.mark.parametrize("stop", [{"max_points": "5%"}, {"tolerance": 4.0}])
def test_the_bytes_do_not_depend_on_the_number_of_threads(method, stop):
    z = hills(210, 170, 7) + np.random.default_rng(7).normal(0, 1.5, (210, 170))
    z[::37, ::41] += 300.0
    z[:50, :40] = z[90:120, 60:100] = np.nan
    source = tin.DEM(z.astype(np.float32))

    def run(**threads: object) -> tuple[object, ...]:
        mesh = tin.triangulate(source, method=method, **stop, **threads)
        return (*fingerprint(mesh), mesh.rasterize().tobytes(), mesh.report.noise, repr(mesh.error()))

    alone = run(threads=1)
    for more in ({"threads": 2}, {"threads": 3}, {"threads": 8}, {"threads": "auto"}, {}):
        assert run(**more) == alone, more


def test_smoothing_does_not_depend_on_the_number_of_threads():
    z = hills(300, 500, 3)
    z[40:60, 70:200] = np.nan
    alone = _core.gaussian(z, (3.0, 1.3), threads=1).tobytes()
    for threads in (2, 3, 8, None):
        assert _core.gaussian(z, (3.0, 1.3), threads=threads).tobytes() == alone


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize(
    "stage", ["despike", "outline", "smooth", "refine", "order", "fit", "flip", "measure"]
)
def test_a_callback_that_says_no_ends_every_stage_on_any_number_of_threads(stage, threads):
    source = tin.DEM(hills(700, 700, 11).astype(np.float32))
    asked: list[float] = []

    def watch(name: str, fraction: float) -> bool:
        assert not asked, "called again after a false answer"
        assert threading.current_thread() is here
        if name == stage:
            asked.append(time.perf_counter())
        return not asked

    here = threading.current_thread()
    with pytest.raises(tin.Cancelled):
        tin.triangulate(source, threads=threads, progress=watch)
    assert time.perf_counter() - asked[0] < 1.0


@pytest.mark.parametrize("threads", [1, 3])
def test_ctrl_c_stops_all_threads(threads):
    before = threading.active_count()
    z = np.zeros((3000, 3000))
    interrupt = threading.Timer(0.3, _thread.interrupt_main)
    interrupt.start()
    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        # Takes many seconds.
        _core.gaussian(z, (100.0, 100.0), threads=threads)
    assert time.perf_counter() - start < 2.0
    interrupt.join()
    assert threading.active_count() == before
