"""hmm (github.com/fogleman/hmm), a program that triangulates pictures of heights as method ``max`` does.

It reads 16-bit grey levels, so the heights are rounded to 65,536 steps from the lowest to the highest; the
errors it is asked for and tells of are in units of that range. Its time is what it prints for
"triangulating": neither the decoding of the PNG nor the writing of the STL is in it.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np

LEVELS = 65535.0
# Binary STL: a normal and three corners in single precision a triangle.
HEAD = 84
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("count", "<u2")])


def write_png(z: np.ndarray, path: Path) -> None:
    """The heights as hmm reads them."""
    from PIL import Image

    low, span = _range(z)
    levels = np.empty(z.shape, np.uint16)
    for row, heights in enumerate(z):
        levels[row] = np.rint((heights - low) * (LEVELS / span))
    Image.fromarray(levels).save(path, compress_level=1)


def triangulate(
    binary: str, z: np.ndarray, png: Path, points: int | None, tolerance: float | None
) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """Figures of a run on ``png``, made of ``z``, and its mesh: points (column, row, height) and triangles.

    A corner is a point of its own in each of its triangles, for so it stands in an STL.
    """
    low, span = _range(z)
    stop = ["-e", "1e-9", "-p", str(points)] if tolerance is None else ["-e", repr(tolerance / span)]
    output = png.with_suffix(".stl")
    command = [binary, "-z", repr(span), *stop, str(png), str(output)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = [
        re.search(rf"{key} *([-+.\de]+)", done.stdout)
        for key in (r"triangulating\.\.\.", "error =", "points =")
    ]
    if done.returncode or None in found:
        raise SystemExit(f"{' '.join(command)} failed ({done.returncode}):\n{done.stdout}{done.stderr}")
    seconds, error, count = (float(match[1]) for match in found if match)
    corners = np.fromfile(output, TRIANGLE, offset=HEAD)["corners"].reshape(-1, 3)
    output.unlink()
    corners[:, 1] = z.shape[0] - 1 - corners[:, 1]  # its y points upwards
    corners[:, 2] += np.float32(low)
    triangles = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    return {"seconds": seconds, "next_error": error * span, "vertices": int(count)}, corners, triangles


def _range(z: np.ndarray) -> tuple[float, float]:
    low, high = float(z.min()), float(z.max())
    return low, (high - low) or 1.0
