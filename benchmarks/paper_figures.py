"""Figures 1 and 3 of da Silva et al. (2011), redrawn from any image or DEM.

    python benchmarks/paper_figures.py sample_dem/jacksboro.tif docs/images [--points 2500]

Heights are taken for an 8-bit image, so that the paper's noise has its meaning.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from common import evaluate, paper_noise
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image
from scipy.ndimage import gaussian_filter

import tin

SIGMAS = (4.0, 2.0, 1.0, 0.0)
COLOURS = 32
MESH_COLOUR = "#14324a"


def draw(image: np.ndarray, folder: Path, points: int = 5000) -> None:
    """Write figure1.png and figure3.png of a grey image (0 to 255) to ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in (("figure1.png", scales(image, points)), ("figure3.png", metrics(image, points))):
        picture = io.BytesIO()
        figure.savefig(picture, format="png", metadata={"Software": None})
        # Greys and one line colour: a palette makes the file a third as large.
        Image.open(picture).convert("RGB").quantize(COLOURS).save(folder / name, optimize=True)


def scales(image: np.ndarray, points: int) -> Figure:
    """The image at its scales, coarse to fine, and the mesh that Algorithm 2 has when it leaves each."""
    figure, panels = _figure(image, 2, len(SIGMAS))
    per_scale = points // len(SIGMAS)
    for i, sigma in enumerate(SIGMAS):
        smooth = gaussian_filter(image, sigma) if sigma else image
        mesh = tin.triangulate(
            tin.DEM(image),
            method="median",
            scales=[f"{s}px" for s in SIGMAS[: i + 1]],
            points_per_scale=per_scale,
            max_points=per_scale * (i + 1),
        )
        _show(panels[0, i], smooth, f"σ = {sigma:g} px" if sigma else "the image itself")
        _show_mesh(panels[1, i], mesh, f"{len(mesh.vertices):,} points")
    return figure


def metrics(image: np.ndarray, points: int) -> Figure:
    """Meshes by the maximum and by the median, and by method auto, under both noises."""
    figure, panels = _figure(image, 2, 4)
    names = {"impulsive": "salt and pepper on 1 % of the pixels", "gaussian": "Gaussian noise, σ = 25.5"}
    for row, (kind, name) in zip(panels, names.items()):
        noisy = paper_noise(image, kind, seed=0)
        _show(row[0], noisy, name)
        for axes, method in zip(row[1:], ("max", "median", "auto")):
            settings = {"scales": "0px"} if method == "median" else {}
            mesh = tin.triangulate(tin.DEM(noisy), method=method, max_points=points, **settings)
            error = evaluate(mesh.rasterize(), image).rmse
            _show_mesh(axes, mesh, f"{method}: RMSE {error:.1f}")
    figure.supxlabel(f"{points:,} points each; RMSE against the image without noise", fontsize=10)
    return figure


def _figure(image: np.ndarray, rows: int, cols: int) -> tuple[Figure, np.ndarray]:
    side = 3.0
    height = rows * (side * image.shape[0] / image.shape[1] + 0.35) + 0.3
    figure = Figure(figsize=(cols * side, height), dpi=90, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, cols, squeeze=False)


def _show(axes, image: np.ndarray, title: str, alpha: float = 1.0) -> None:
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, alpha=alpha, interpolation="antialiased")
    axes.set_title(title, fontsize=10)
    axes.set_axis_off()


def _show_mesh(axes, mesh: tin.Tin, title: str) -> None:
    _show(axes, mesh.rasterize(), title, alpha=0.45)
    corners = np.sort(np.concatenate([np.roll(mesh.triangles, -k, axis=1)[:, :2] for k in range(3)]), axis=1)
    lines = mesh.pixels[np.unique(corners, axis=0)]
    axes.add_collection(LineCollection(lines, colors=MESH_COLOUR, linewidths=0.3))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("picture", type=Path, help="image or DEM")
    parser.add_argument("folder", type=Path, help="where figure1.png and figure3.png go")
    parser.add_argument("--points", type=int, default=2500, help="vertices of the meshes (default: 2500)")
    given = parser.parse_args(arguments)
    z = np.asarray(tin.open(given.picture).z, dtype=np.float64)
    grey = np.rint(255.0 * (z - np.nanmin(z)) / max(1e-300, np.nanmax(z) - np.nanmin(z)))
    draw(grey, given.folder, given.points)


if __name__ == "__main__":
    main()
