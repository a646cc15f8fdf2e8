"""What the accuracy benchmarks share: images, noise, made terrain, one evaluator, Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import tin
from tin.sources import blocks

SAMPLE = Path(__file__).resolve().parent.parent / "sample_dem" / "jacksboro.tif"
GAUSSIAN_SIGMA = 25.5  # the paper's, on 8-bit images
IMPULSES = 0.01


def read_image(path: Path) -> np.ndarray:
    """(rows, cols) float64 grey values of an 8-bit image."""
    import OpenImageIO as oiio

    pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
    if pixels is None:
        raise SystemExit(f"{path}: OpenImageIO cannot read it")
    return np.asarray(pixels)[..., 0].astype(np.float64)


def paper_noise(image: np.ndarray, kind: str, seed: int) -> np.ndarray:
    """The paper's noise on an 8-bit image: "none", "impulsive" (salt and pepper) or "gaussian"."""
    random = np.random.default_rng(seed)
    if kind == "impulsive":
        hit = random.random(image.shape) < IMPULSES
        return np.where(hit, random.choice([0.0, 255.0], image.shape), image)
    if kind == "gaussian":
        return np.clip(np.rint(image + random.normal(0.0, GAUSSIAN_SIGMA, image.shape)), 0.0, 255.0)
    return image


def dem_noise(z: np.ndarray, kind: str, seed: int) -> np.ndarray:
    """Noise of a survey, in the unit of the heights; ``kind`` is one of KINDS."""
    random = np.random.default_rng(seed)
    if kind == "clean":
        return z
    noisy = z + np.where(random.random(z.shape) < IMPULSES, random.choice([-100.0, 100.0], z.shape), 0.0)
    return noisy + random.normal(0.0, 5.0, z.shape) if kind == "noisy" else noisy


KINDS = {
    "clean": "as it is",
    "spikes": "spikes of ±100 on 1 % of the pixels",
    "noisy": "Gaussian noise of σ = 5, and the spikes",
}
"""The kinds of ``dem_noise``, in words."""


def terrains(dems: Sequence[Path], size: int) -> dict[str, np.ndarray]:
    """The heights of the benchmarks by name: made ones of fixed seeds, and those of ``dems``."""
    made = {
        f"fractal, smooth ({size} × {size})": fractal_terrain(size, 2.4, seed=1),
        f"fractal, rough ({size} × {size})": fractal_terrain(size, 1.8, seed=2),
    }
    read = {path.stem: np.asarray(tin.open(path).z, dtype=np.float64) for path in dems}
    named = {f"{name} ({z.shape[1]} × {z.shape[0]})": z for name, z in read.items()}
    return {**named, **made}


def fractal_terrain(size: int, roughness: float, seed: int) -> np.ndarray:
    """(size, size) heights from 0 to 1000 with the power spectrum f^-2 roughness (spectral synthesis)."""
    random = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(2 * size)[:, None], np.fft.rfftfreq(2 * size))
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(random.normal(size=(2 * size, 2 * size))) * frequency**-roughness
    # A quarter of the periodic field does not repeat.
    z = np.fft.irfft2(spectrum)[:size, :size]
    return 1000.0 * (z - z.min()) / np.ptp(z)


def rasterise(points: np.ndarray, triangles: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Heights of any mesh on the pixel centres, NaN where no triangle is.

    ``points`` is (n, 3) column, row, height, not necessarily whole numbers; closed triangles of
    either turn. Independent of the code under test.
    """
    surface = np.full(shape, np.nan)
    for part in np.array_split(triangles, 1 + len(triangles) // 100_000):
        _rasterise_few(points, part, surface)
    return surface


def _rasterise_few(points: np.ndarray, triangles: np.ndarray, surface: np.ndarray) -> None:
    x, y, z = (points[triangles, k].astype(np.float64) for k in range(3))
    x_b, y_b, x_c, y_c = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0], x[:, 2] - x[:, 0], y[:, 2] - y[:, 0]
    area = x_b * y_c - y_b * x_c
    last_row, last_col = surface.shape[0] - 1, surface.shape[1] - 1
    left, right = _whole(x, last_col)
    top, bottom = _whole(y, last_row)
    width, height = np.maximum(right - left + 1, 0), np.maximum(bottom - top + 1, 0)
    kept = np.flatnonzero((area != 0.0) & (width * height > 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        # The weight of corner b at (x, y) is x v_x + y v_y, from corner a; that of c likewise.
        v_x, v_y, w_x, w_y = y_c / area, -x_c / area, -y_b / area, x_b / area
    z_b, z_c = z[:, 1] - z[:, 0], z[:, 2] - z[:, 0]
    for part in np.array_split(kept, 1 + int((width * height)[kept].sum() // 1_000_000)):
        count = (width * height)[part]
        t = np.repeat(part, count)
        # The position of each pixel in the box of its triangle.
        k = np.arange(len(t)) - np.repeat(np.cumsum(count) - count, count)
        down, across = np.divmod(k, width[t])
        col, row = left[t] + across, top[t] + down
        dx, dy = col - x[t, 0], row - y[t, 0]
        v, w = dx * v_x[t] + dy * v_y[t], dx * w_x[t] + dy * w_y[t]
        inside = (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1.0 + 1e-9)
        plane = z[t, 0] + v * z_b[t] + w * z_c[t]
        surface[row[inside], col[inside]] = plane[inside]


def _whole(corners: np.ndarray, last: int) -> tuple[np.ndarray, np.ndarray]:
    """First and last whole number between each triangle's corners, and from 0 to ``last``."""
    low = np.clip(np.ceil(corners.min(axis=1) - 1e-9), 0, last).astype(int)
    return low, np.clip(np.floor(corners.max(axis=1) + 1e-9), -1, last).astype(int)


@dataclass(frozen=True)
class Errors:
    rmse: float
    mae: float
    p95: float
    largest: float
    missing: int
    """Valid pixels that no triangle covers; the errors leave them out."""


def evaluate(surface: np.ndarray, truth: np.ndarray) -> Errors:
    """Vertical errors over the pixels that both cover; takes 8 bytes a pixel beside the arguments."""
    covered, missing, count = np.empty(surface.size), 0, 0
    for rows in blocks(*surface.shape):
        error = np.abs(surface[rows] - truth[rows])
        known = error[np.isfinite(error)]
        covered[count : count + len(known)] = known
        count += len(known)
        missing += int(np.isfinite(truth[rows]).sum()) - len(known)
    covered = covered[:count]
    return Errors(
        rmse=float(np.sqrt(np.dot(covered, covered) / count)),
        mae=float(covered.mean()),
        largest=float(covered.max()),
        p95=float(np.percentile(covered, 95, overwrite_input=True)),
        missing=missing,
    )


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; the first column is text, the others are numbers."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)
