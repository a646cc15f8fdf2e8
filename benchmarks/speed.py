"""Seconds and memory of dem2tin and its peers, pydelatin and hmm, on made terrain; prints Markdown.

    python benchmarks/speed.py [--size 1024 2048] [--percent 1 5] [--threads 1 2] [--hmm hmm] [--rounds 3]

Every run is a process of its own (``speed_run.py``), and in each round all programs take their turn; ratios
are medians of the rounds' ratios. The base is the faster peer of the round: *speed-up* is its time by that
of the program. Method ``median`` is compared with the peers' refinement by the largest error at an equal
number of points, too, and every method with dem2tin's own ``max`` on as many threads.

They are compared at an equal number of points, and at an equal tolerance: the error that pydelatin has
reached at that number. Method ``median`` takes no part in the latter, since its tolerance bounds the
median of a triangle's errors. The time is that of the library's call, the heights already in memory:
dem2tin's has the outline of the data in it, and with ``auto`` every stage; hmm's is what it prints for
"triangulating" (see ``hmm.py``, also for the rounding of its heights), and its memory is not measured.
Errors are measured by ``common.rasterise``, in the first round.
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
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import hmm
import made_terrain
import numpy as np
from common import table

RUN = Path(__file__).with_name("speed_run.py")
METHODS = ("max", "median", "auto")
GUIDE = "pydelatin"  # the peer whose error is the tolerance
HEADER = (
    "program",
    "vertices",
    "min s",
    "median s",
    "ns a pixel",
    "of the base's time",
    "speed-up",
    "of `max`'s time",
    "MB before",
    "MB more at peak",
    "largest error",
    "RMSE",
)
Figures = dict[str, Any]


class Program(NamedTuple):
    """What is run: a method of ours on a number of threads, or a peer."""

    name: str
    threads: int = 1

    def __str__(self) -> str:
        return self.name if self.threads == 1 else f"{self.name}, {self.threads} threads"

    @property
    def is_peer(self) -> bool:
        return self.name not in METHODS


Runs = dict[Program, list[Figures]]


def run(job: Figures) -> Figures:
    """The figures of one run."""
    # One thread each but for those asked for, whatever the libraries would do.
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(RUN), json.dumps(job)],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    if done.returncode:
        raise SystemExit(f"{job['program']} failed ({done.returncode}):\n{done.stderr}")
    return json.loads(done.stdout)


def rounds(
    heights: Path,
    programs: Iterable[Program],
    points: int | None,
    tolerance: float | None,
    given: argparse.Namespace,
) -> Runs:
    """The figures of every round, by program."""
    runs: Runs = defaultdict(list)
    for i in range(given.rounds):
        for program in programs:
            job = {
                "heights": str(heights),
                "program": program.name,
                "threads": program.threads,
                "hmm": given.hmm,
                "points": points,
                "tolerance": tolerance,
                "errors": i == 0 and not given.no_errors,
            }
            runs[program].append(run(job))
    return runs


def seconds(figures: list[Figures]) -> np.ndarray:
    return np.array([run["seconds"] for run in figures])


def row(program: Program, runs: Runs, pixels: int) -> list[str]:
    figures, own = runs[program], seconds(runs[program])
    base = np.min([seconds(other) for peer, other in runs.items() if peer.is_peer], axis=0)
    best = runs.get(Program("max", program.threads))
    is_ours = best is not None and not program.is_peer

    def median(key: str, less: str | None = None) -> str:
        if key not in figures[0]:
            return "—"
        return f"{statistics.median(run[key] - (run[less] if less else 0) for run in figures):.0f}"

    return [
        str(program),
        f"{figures[0]['vertices']:,}",
        f"{own.min():.3f}",
        f"{np.median(own):.3f}",
        f"{np.median(own) / pixels * 1e9:.0f}",
        f"{np.median(own / base):.2f}",
        f"{np.median(base / own):.2f}",
        f"{np.median(own / seconds(best)):.2f}" if best and is_ours else "—",
        median("before_mb"),
        median("peak_mb", "before_mb"),
        *(f"{figures[0][key]:.3f}" if key in figures[0] else "—" for key in ("largest", "rmse")),
    ]


def compare(heights: Path, title: str, pixels: int, percent: float, given: argparse.Namespace) -> Runs:
    """Prints the tables of one number of points; returns the runs at that number."""
    points = round(pixels * percent / 100)
    peers = [Program(GUIDE), *([Program("hmm")] if given.hmm else [])]
    ours = [Program(method, threads) for method in given.methods for threads in given.threads]
    by_points = rounds(heights, [*ours, *peers], points, None, given)
    show(by_points, f"{title}, {points:,} points ({percent:g} %)", pixels)
    tolerance = by_points[Program(GUIDE)][0]["next_error"]
    bounded = [program for program in ours if program.name != "median"]
    by_tolerance = rounds(heights, [*bounded, *peers], None, tolerance, given)
    show(by_tolerance, f"{title}, tolerance {tolerance:.4g}", pixels)
    return by_points


def show(runs: Runs, title: str, pixels: int) -> None:
    print(f"\n### {title}\n")
    print(table(HEADER, [row(program, runs, pixels) for program in runs]), flush=True)
    missing = sum(figures[0].get("missing", 0) for figures in runs.values())
    if missing:
        print(f"\n{missing} pixels that no triangle covers are not in the errors.")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    several: dict[str, Any] = {"nargs": "+"}
    parser.add_argument(
        "--size", type=int, default=[1024], help="sides of the DEMs (default: 1024)", **several
    )
    parser.add_argument(
        "--terrain",
        choices=made_terrain.NAMES,
        default=list(made_terrain.SLOPES),
        help="smooth, rough (both made; the default), or the sample DEM resampled",
        **several,
    )
    parser.add_argument("--methods", choices=METHODS, default=list(METHODS), **several)
    parser.add_argument(
        "--percent",
        type=float,
        default=[5.0],
        help="vertices, in %% of the pixels (default: 5)",
        **several,
    )
    parser.add_argument("--threads", type=int, default=[1], help="of dem2tin (default: 1)", **several)
    parser.add_argument("--hmm", metavar="PATH", help="the program hmm, to be compared with, too")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--no-errors", action="store_true", help="leave out the errors: they need some 25 bytes a pixel"
    )
    given = parser.parse_args(arguments)

    shares: dict[tuple[str, int], list[float]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for size in given.size:
            for name in given.terrain:
                heights = Path(folder) / f"{name}{size}.npy"
                z = made_terrain.make(name, size)
                np.save(heights, z)
                if given.hmm:
                    hmm.write_png(z, heights.with_suffix(".png"))
                del z
                for percent in given.percent:
                    runs = compare(heights, f"{name} {size} × {size}", size**2, percent, given)
                    for threads in given.threads:
                        for figures in runs.get(Program("auto", threads), []):
                            for stage, spent in figures["stages"].items():
                                shares[stage, threads].append(spent / figures["stages"]["refine"])
                for file in (heights, heights.with_suffix(".png")):
                    file.unlink(missing_ok=True)
    if shares:
        print("\n### Stages of auto, in multiples of its refinement on as many threads\n")
        stages = [stage for stage in dict.fromkeys(stage for stage, _ in shares) if stage != "start"]
        shown = [
            [stage, *(f"{statistics.median(shares[stage, threads]):.2f}" for threads in given.threads)]
            for stage in stages
        ]
        print(table(("stage", *(str(Program("auto", threads)) for threads in given.threads)), shown))


if __name__ == "__main__":
    main()
