"""The picture of docs/constraints.md: one DEM with and without what a TIN can follow.

python benchmarks/constraints_figure.py docs/images
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

import tin

SUN = np.array([-0.5, 0.5, 0.7]) / np.linalg.norm([-0.5, 0.5, 0.7])
SAMPLE = Path(__file__).parents[1] / "sample_dem" / "jacksboro.dem"


def draw(axes, mesh, title):
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    shade = normal @ SUN / np.linalg.norm(normal, axis=1)
    x, y, _ = mesh.vertices.T / 1000
    axes.tripcolor(x, y, mesh.triangles, facecolors=shade, cmap="Greys_r", vmin=-0.2, vmax=1.1)
    axes.triplot(x, y, mesh.triangles, color="#14324a", linewidth=0.25)
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1)[mesh.constrained]
    axes.add_collection(LineCollection(mesh.vertices[ends, :2] / 1000, color="#c1121f", linewidth=1.1))
    axes.set(title=title, aspect="equal", xticks=[], yticks=[])


def main(folder: Path) -> None:
    whole = tin.open(SAMPLE)
    a, _, left, _, e, top = whole.transform
    dem = tin.DEM(whole.z[80:180, 60:190], transform=(a, 0, left + 60 * a, 0, e, top + 80 * e), crs=whole.crs)

    def place(*pixels):
        x, y = dem.pixel_to_map(*np.array(pixels, float).T[:2])
        return np.column_stack([x, y, *np.array(pixels, float).T[2:]])

    angle = np.linspace(0, 2 * np.pi, 60)
    lake = place(
        *np.column_stack([85 + (22 + 4 * np.sin(3 * angle)) * np.cos(angle), 62 + 16 * np.sin(angle)])
    )
    island = place(*np.column_stack([88 + 6 * np.cos(angle), 62 + 4 * np.sin(angle)]))
    road = place((6, 12), (45, 40), (70, 20), (122, 30))
    clip = place((2, 4), (80, 1), (127, 20), (124, 92), (60, 97), (8, 80))
    made = Figure((10, 4.2), layout="constrained")
    one, other = made.subplots(1, 2)
    draw(one, tin.triangulate(dem, max_points=900), "The DEM alone")
    followed = tin.triangulate(dem, max_points=900, breaklines=road, clip=clip, flat=[[lake, island]])
    draw(other, followed, "With a road, a lake with an island, and a clip polygon")
    canvas = FigureCanvasAgg(made)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(48, dither=Image.Dither.NONE).save(folder / "constraints.png", optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
