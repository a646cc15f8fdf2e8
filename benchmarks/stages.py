"""What each stage of method `auto` is worth: its error with the stage changed or left out, as Markdown.

    python benchmarks/stages.py [DEM ...] [--percent 5] [--size 512]

Geometric means over the DEMs of RMSE against the DEM without noise, as multiples of that of `auto`.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np
from common import KINDS, SAMPLE, dem_noise, evaluate, table, terrains

import tin

VARIANTS: dict[str, dict[str, object]] = {
    "`auto`": {},
    "without despiking": {"despike": False},
    "without smoothing": {"scales": "0px"},
    "without least-squares heights": {"fit": False},
    "without flips (stays Delaunay)": {"flips": 0},
    "without fit and flips": {"fit": False, "flips": 0},
    "candidate: the median pixel": {"candidate": "median"},
    "candidate: the 0.9 quantile": {"candidate": 0.9},
    "priority: median, weight 0": {"weight": 0.0},
    "priority: median, weight 0.5": {"weight": 0.5},
    "priority: maximum, weight 0": {"metric": "max", "weight": 0.0},
    "priority: maximum, weight 0.25": {"metric": "max", "weight": 0.25},
    "the paper's pair: median, weight 0, median pixel": {"weight": 0.0, "candidate": "median"},
    "method `median` (the paper, many scales)": {"method": "median"},
    "method `median`, one scale": {"method": "median", "scales": "0px"},
    "method `max`": {"method": "max"},
}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dems", nargs="*", type=Path, metavar="DEM", help="more DEMs")
    parser.add_argument(
        "--percent", type=float, default=5.0, help="vertices, in %% of the pixels (default: 5)"
    )
    parser.add_argument("--size", type=int, default=512, help="side of the made terrain (default: 512)")
    given = parser.parse_args(arguments)

    heights = terrains([SAMPLE, *given.dems], given.size)
    logs = {(variant, kind): [] for variant in VARIANTS for kind in KINDS}
    seconds = dict.fromkeys(VARIANTS, 0.0)
    for z in heights.values():
        for kind in KINDS:
            dem = tin.DEM(dem_noise(z, kind, seed=1))
            for variant, options in VARIANTS.items():
                start = time.perf_counter()
                mesh = tin.triangulate(dem, max_points=f"{given.percent}%", **options)
                seconds[variant] += time.perf_counter() - start
                logs[variant, kind].append(math.log(evaluate(mesh.rasterize(), z).rmse))
    first = next(iter(VARIANTS))
    rows = []
    for variant in VARIANTS:
        ratios = [math.exp(np.mean(logs[variant, kind]) - np.mean(logs[first, kind])) for kind in KINDS]
        rows.append(
            [variant, *(f"{ratio:.2f}" for ratio in ratios), f"{seconds[variant] / seconds[first]:.2f}"]
        )
    print(f"{', '.join(heights)}; {given.percent:g} % of the pixels.\n")
    print(table(["variant", *KINDS, "time"], rows))


if __name__ == "__main__":
    main()
