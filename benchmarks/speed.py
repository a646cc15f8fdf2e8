"""Seconds of dem2tin and pydelatin on made terrain, in turn in one run; prints Markdown.

    python benchmarks/speed.py [--size 1024] [--percent 5] [--rounds 5]

Both refine the same float32 array to the same number of vertices. dem2tin's time is that of the
core's whole call (outline of the data, refinement, and with ``auto`` every stage); the stages of ``auto``
are told apart by its own progress reports.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict

import numpy as np
from common import fractal_terrain

import tin
from tin import _core, options
from tin.constraints import Constraints


def ours(dem: tin.DEM, points: int, method: str) -> tuple[float, int, dict[str, float]]:
    """Seconds of the core, vertices, and seconds by stage."""
    arguments = options.core_arguments({"method": method, "max_points": points}, dem)
    spent: dict[str, float] = defaultdict(float)
    last = ["start", time.perf_counter()]

    def watch(stage: str, fraction: float) -> bool:
        now = time.perf_counter()
        spent[last[0]] += now - last[1]
        last[:] = stage, now
        return True

    start = time.perf_counter()
    mesh = _core.triangulate(
        dem.z, dem.metric(), progress=watch, **arguments, **Constraints().core_arguments()
    )
    end = time.perf_counter()
    spent[last[0]] += end - last[1]
    return end - start, len(mesh.heights()), spent


def theirs(z: np.ndarray, points: int) -> tuple[float, int]:
    from pydelatin import Delatin

    start = time.perf_counter()
    mesh = Delatin(z, max_error=1e-9, max_points=points)
    return time.perf_counter() - start, len(mesh.vertices)


def main() -> None:
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    reader.add_argument("--size", type=int, default=1024)
    reader.add_argument("--percent", type=float, default=5.0)
    reader.add_argument("--rounds", type=int, default=5)
    given = reader.parse_args()
    points = round(given.size**2 * given.percent / 100)
    print("| terrain | method | vertices | min s | median s | of pydelatin's time, median of rounds |")
    print("|---|---|---|---|---|---|")
    stages: dict[str, list[float]] = defaultdict(list)
    for name, roughness, seed in (("smooth", 2.4, 1), ("rough", 1.8, 2)):
        z = fractal_terrain(given.size, roughness, seed).astype(np.float32)
        dem = tin.DEM(z)
        seconds: dict[str, list[float]] = defaultdict(list)
        vertices = {}
        for _ in range(given.rounds):
            for method in ("max", "median", "auto"):
                taken, vertices[method], spent = ours(dem, points, method)
                seconds[method].append(taken)
                if method == "auto":
                    for stage, part in spent.items():
                        stages[stage].append(part / spent["refine"])
            taken, vertices["pydelatin"] = theirs(z, points)
            seconds["pydelatin"].append(taken)
        for method, taken in seconds.items():
            ratio = statistics.median(a / b for a, b in zip(taken, seconds["pydelatin"]))
            print(
                f"| {name} {given.size}² | {method} | {vertices[method]:,} | {min(taken):.3f} "
                f"| {statistics.median(taken):.3f} | {ratio:.2f} |"
            )
    print("\n| stage of auto | time, in multiples of its refinement (median) |\n|---|---|")
    for stage, parts in stages.items():
        if stage != "start":
            print(f"| {stage} | {statistics.median(parts):.2f} |")


if __name__ == "__main__":
    main()
