"""Seconds and memory of dem2tin and pydelatin on made terrain; prints Markdown.

    python benchmarks/speed.py [--size 1024 2048] [--percent 5] [--rounds 3]

Every run is a process of its own (``speed_run.py``), and in each round all programs take their turn.
They are compared at an equal number of points, and at an equal tolerance: the error that pydelatin has
reached at that number. Method ``median`` takes no part in the latter, since its tolerance bounds the
median of a triangle's errors. The time is that of the library's call, the heights already in memory:
dem2tin's has the outline of the data in it, and with ``auto`` every stage. Errors are measured by
``common.rasterise``, in the first round.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import made_terrain
import numpy as np
from common import table

RUN = Path(__file__).with_name("speed_run.py")
METHODS = ("max", "median", "auto")
PEER = "pydelatin"
HEADER = (
    "program",
    "vertices",
    "min s",
    "median s",
    f"of {PEER}'s time",
    "MB before",
    "MB more at peak",
    "largest error",
    "RMSE",
)
Figures = dict[str, Any]


def run(heights: Path, program: str, points: int | None, tolerance: float | None, errors: bool) -> Figures:
    """The figures of one run."""
    job = {
        "heights": str(heights),
        "program": program,
        "points": points,
        "tolerance": tolerance,
        "errors": errors,
    }
    # One thread each, whatever the libraries would do.
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(RUN), json.dumps(job)],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    if done.returncode:
        raise SystemExit(f"{program} on {heights.name} failed ({done.returncode}):\n{done.stderr}")
    return json.loads(done.stdout)


def rounds(
    heights: Path, programs: list[str], points: int | None, tolerance: float | None, given: argparse.Namespace
) -> dict[str, list[Figures]]:
    """The figures of every round, by program."""
    runs: dict[str, list[Figures]] = defaultdict(list)
    for i in range(given.rounds):
        for program in programs:
            with_errors = i == 0 and not given.no_errors
            runs[program].append(run(heights, program, points, tolerance, with_errors))
    return runs


def row(program: str, runs: list[Figures], peer: list[Figures]) -> list[str]:
    seconds = [figures["seconds"] for figures in runs]
    ratios = [figures["seconds"] / other["seconds"] for figures, other in zip(runs, peer)]
    first = runs[0]
    return [
        program,
        f"{first['vertices']:,}",
        f"{min(seconds):.3f}",
        f"{statistics.median(seconds):.3f}",
        f"{statistics.median(ratios):.2f}",
        f"{statistics.median(figures['before_mb'] for figures in runs):.0f}",
        f"{statistics.median(figures['peak_mb'] - figures['before_mb'] for figures in runs):.0f}",
        f"{first['largest']:.3f}" if "largest" in first else "—",
        f"{first['rmse']:.3f}" if "rmse" in first else "—",
    ]


def compare(heights: Path, name: str, size: int, given: argparse.Namespace) -> list[Figures]:
    """Prints both tables; returns the runs of ``auto`` at an equal number of points."""
    points = round(size**2 * given.percent / 100)
    by_points = rounds(heights, [*given.methods, PEER], points, None, given)
    tolerance = by_points[PEER][0]["next_error"]
    methods = [method for method in given.methods if method != "median"]
    by_tolerance = rounds(heights, [*methods, PEER], None, tolerance, given)
    for title, runs in (
        (f"{points:,} points", by_points),
        (f"tolerance {tolerance:.4g}", by_tolerance),
    ):
        missing = sum(figures[0].get("missing", 0) for figures in runs.values())
        print(f"\n### {name} {size} × {size}, {title}\n")
        rows = [row(program, figures, runs[PEER]) for program, figures in runs.items()]
        print(table(HEADER, rows), flush=True)
        if missing:
            print(f"\n{missing} pixels that no triangle covers are not in the errors.")
    return by_points.get("auto", [])


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--size", type=int, nargs="+", default=[1024], help="sides of the DEMs (default: 1024)"
    )
    parser.add_argument(
        "--terrain",
        nargs="+",
        choices=made_terrain.NAMES,
        default=list(made_terrain.SLOPES),
        help="smooth, rough (both made; the default), or the sample DEM resampled",
    )
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument(
        "--percent", type=float, default=5.0, help="vertices, in %% of the pixels (default: 5)"
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--no-errors", action="store_true", help="leave out the errors: they need some 45 bytes a pixel"
    )
    given = parser.parse_args(arguments)

    shares: dict[str, list[float]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for size in given.size:
            for name in given.terrain:
                heights = Path(folder) / f"{name}{size}.npy"
                np.save(heights, made_terrain.make(name, size))
                for figures in compare(heights, name, size, given):
                    for stage, seconds in figures["stages"].items():
                        shares[stage].append(seconds / figures["stages"]["refine"])
                heights.unlink()
    if shares:
        print("\n### Stages of auto, in multiples of its refinement\n")
        shown = [
            (stage, f"{statistics.median(parts):.2f}") for stage, parts in shares.items() if stage != "start"
        ]
        print(table(("stage", "median"), shown))


if __name__ == "__main__":
    main()
