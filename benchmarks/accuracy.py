"""Accuracy at equal vertex counts: dem2tin's methods and what else makes meshes of a DEM, as Markdown.

    python benchmarks/accuracy.py [DEM ...] [--percent 2 5] [--size 512]

Jacksboro and made terrain are always there. Meshes are made of the noisy DEM and compared with the
one without noise, all by the same rasteriser, which shares no code with dem2tin. Grids are taken
for square pixels, as the other programs know nothing else.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from common import KINDS, SAMPLE, Errors, dem_noise, evaluate, rasterise, table, terrains

import tin

Mesh = tuple[np.ndarray, np.ndarray]
"""(n, 3) column, row, height, and (m, 3) triangles."""

PERCENT = (2.0, 5.0)
# RMSE that `auto` is to reach at most on Jacksboro, at 2 % and 5 % of the pixels.
TARGETS = {"clean": (14.2, 8.3), "spikes": (14.2, 8.4), "noisy": (14.5, 8.8)}


def by_tin(z: np.ndarray, points: int, method: str) -> Mesh:
    """One of dem2tin's methods."""
    mesh = tin.triangulate(tin.DEM(z), method=method, max_points=points)
    return np.column_stack([mesh.pixels, mesh.vertices[:, 2]]), mesh.triangles


def by_pydelatin(z: np.ndarray, points: int) -> Mesh:
    """Garland and Heckbert's greedy insertion, as hmm has it."""
    from pydelatin import Delatin

    mesh = Delatin(z.astype(np.float32), max_error=0.0, max_points=points)
    # Its rows are counted from below.
    vertices = np.array(mesh.vertices, dtype=np.float64)
    vertices[:, 1] = z.shape[0] - 1 - vertices[:, 1]
    return vertices, np.array(mesh.triangles)


def by_pyfqmr(z: np.ndarray, points: int) -> Mesh:
    """Quadric simplification of the full grid, with heights scaled to a mean slope of 1.

    The border is left free: kept, it alone would take half of the vertices at 2 %.
    """
    import pyfqmr

    rows, cols = np.indices(z.shape)
    slope = float(np.mean(np.hypot(*np.gradient(z)))) or 1.0
    vertices = np.column_stack([cols.ravel(), rows.ravel(), z.ravel() / slope])
    best, target, low, high = None, 2 * points, 2, 2 * vertices.shape[0]
    # It is told triangles and stops near them: aim again until the vertices come near.
    for _ in range(5):
        simplifier = pyfqmr.Simplify()
        simplifier.setMesh(vertices, _grid_triangles(*z.shape))
        simplifier.simplify_mesh(target_count=target, preserve_border=False, verbose=False)
        found, triangles, _ = simplifier.getMesh()
        if best is None or abs(len(found) - points) < abs(len(best[0]) - points):
            best = np.array(found, dtype=np.float64), np.array(triangles)
        low, high = (target, high) if len(found) < points else (low, target)
        target = min(max(round(target * points / len(found)), low + 1), high - 1)
        if abs(len(found) - points) <= 0.01 * points or high - low <= 2:
            break
    return best[0] * (1.0, 1.0, slope), best[1]


def by_grid(z: np.ndarray, points: int) -> Mesh:
    """Every n-th pixel or so along rows and columns."""
    rows = max(2, round(math.sqrt(points * z.shape[0] / z.shape[1])))
    cols = max(2, points // rows)
    at = [np.rint(np.linspace(0, n - 1, count)).astype(int) for n, count in zip(z.shape, (rows, cols))]
    row, col = (grid.ravel() for grid in np.meshgrid(*at, indexing="ij"))
    return np.column_stack([col, row, z[row, col]]), _grid_triangles(rows, cols)


def _grid_triangles(rows: int, cols: int) -> np.ndarray:
    index = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    return np.stack([a, c, d, a, d, b], axis=-1).reshape(-1, 3)


METHODS: dict[str, Callable[[np.ndarray, int], Mesh]] = {
    "**auto**": lambda z, points: by_tin(z, points, "auto"),
    "max": lambda z, points: by_tin(z, points, "max"),
    "median": lambda z, points: by_tin(z, points, "median"),
    "pydelatin": by_pydelatin,
    "pyfqmr": by_pyfqmr,
    "regular grid": by_grid,
}


def compare(z: np.ndarray, kind: str, percent: float) -> list[tuple[str, int, Errors]]:
    """(method, vertices, errors) of every method."""
    noisy = dem_noise(z, kind, seed=1)
    points = round(z.size * percent / 100.0)
    results = []
    for name, method in METHODS.items():
        vertices, triangles = method(noisy, points)
        used = len(np.unique(triangles))
        results.append((name, used, evaluate(rasterise(vertices, triangles, z.shape), z)))
    return results


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dems", nargs="*", type=Path, metavar="DEM", help="more DEMs, without voids")
    parser.add_argument(
        "--percent", nargs="+", type=float, default=PERCENT, help="vertices, in %% of the pixels"
    )
    parser.add_argument("--size", type=int, default=512, help="side of the made terrain (default: 512)")
    given = parser.parse_args(arguments)

    ratios: dict[tuple[str, str], list[Errors]] = {}
    targets, details = [], []
    header = ["method", "vertices", "RMSE", "MAE", "P95", "max", "pixels missed"]
    for name, z in terrains([SAMPLE, *given.dems], given.size).items():
        if np.isnan(z).any():
            raise SystemExit(f"{name}: has voids, which most of the programs cannot take")
        for kind, words in KINDS.items():
            for i, percent in enumerate(given.percent):
                results = compare(z, kind, percent)
                rows = [[m, f"{n:,}", *_numbers(errors)] for m, n, errors in results]
                details.append(f"### {name}, {words}, {percent:g} %\n\n{table(header, rows)}")
                for method, _, errors in results:
                    ratios.setdefault((method, kind), []).append(errors)
                if name.startswith("jacksboro") and tuple(given.percent) == PERCENT:
                    met = results[0][2].rmse <= TARGETS[kind][i]
                    measured = f"{results[0][2].rmse:.2f}"
                    targets.append(
                        [f"{words}, {percent:g} %", TARGETS[kind][i], measured, "yes" if met else "**no**"]
                    )
    print(f"## In one table\n\nMultiples of the errors of `auto`, geometric means.\n\n{_summary(ratios)}\n")
    if targets:
        print("## Targets of auto on Jacksboro\n")
        print(table(["noise, vertices", "RMSE at most", "measured", "met"], targets), end="\n\n")
    print("## One by one\n\n" + "\n\n".join(details))


def _numbers(errors: Errors) -> list[str]:
    sizes = (errors.rmse, errors.mae, errors.p95, errors.largest)
    return [*(f"{size:.2f}" for size in sizes), f"{errors.missing:,}"]


def _summary(results: dict[tuple[str, str], list[Errors]]) -> str:
    """Geometric means of RMSE and of the largest error, as multiples of those of auto."""
    first = next(iter(METHODS))
    header = ["method"] + [f"{what}, {kind}" for what in ("RMSE", "max") for kind in KINDS]
    rows = []
    for method in METHODS:
        row = [method]
        for what in ("rmse", "largest"):
            for kind in KINDS:
                pairs = zip(results[method, kind], results[first, kind])
                logs = [math.log(getattr(a, what) / getattr(b, what)) for a, b in pairs]
                row.append(f"{math.exp(np.mean(logs)):.2f}")
        rows.append(row)
    return table(header, rows)


if __name__ == "__main__":
    main()
