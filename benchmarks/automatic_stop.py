"""Where ``--max-points auto`` stops, against the best number of points; prints Markdown.

    python benchmarks/automatic_stop.py [DEM ...]

Gaussian noise is added to each DEM (the Jacksboro sample if none is named), TINs of many sizes are made,
and all are compared with the DEM as it was.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from common import SAMPLE

import tin

PERCENT = (0.3, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24)
SIGMAS = (5.0, 10.0, 25.0)


def rmse(mesh: tin.Tin, z: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean((mesh.rasterize() - z) ** 2)))


def main() -> None:
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    reader.add_argument("dems", nargs="*", type=Path, default=[SAMPLE])
    print("| DEM | noise | auto: points | RMSE | best of the others: points | RMSE | auto / best |")
    print("|---|---|---|---|---|---|---|")
    for path in reader.parse_args().dems:
        clean = tin.open(path)
        z = np.asarray(clean.z, dtype=np.float64)
        for sigma in SIGMAS:
            noisy = z + np.random.default_rng(1).normal(0.0, sigma, z.shape)
            dem = tin.DEM(noisy, transform=clean.transform, crs=clean.crs)
            sizes = {p: rmse(tin.triangulate(dem, max_points=f"{p}%"), z) for p in PERCENT}
            best = min(sizes, key=sizes.__getitem__)
            chosen = tin.triangulate(dem, max_points="auto")
            share = 100 * chosen.report.points / dem.n_valid
            found = rmse(chosen, z)
            print(
                f"| {path.stem} | {sigma:g} | {share:.1f} % | {found:.3f} | {best:g} % | {sizes[best]:.3f} "
                f"| {found / sizes[best]:.3f} |"
            )


if __name__ == "__main__":
    main()
