"""Seconds and memory of what is around the core: reading, writing, and the start of the command, as Markdown.

    python benchmarks/writers.py [--size 4096] [--percent 5] [--rounds 3] [--no-whole]

Each writer runs in a process of its own, and in each round all take their turn. dem2tin's times have in
them what makes the columns and geometries, and that the file is brought to disk; those of pyogrio's bulk
writers, the same rows to the same kind of file, have neither: the arrays are ready, and no file is synced.
Then ``dem2tin --help``, and the memory of whole commands, the libraries and the reading included, method
``max``, beside that of the DEM as float32.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path

import made_terrain
import numpy as np
import pyogrio
import rasterio
from common import table
from process import forked

import tin
from tin.formats import gpkg
from tin.formats.arrow import ColumnStream
from tin.formats.attributes import attributes

PLACE = (30.0, 0.0, 500_000.0, 0.0, -30.0, 4_000_000.0)
CRS = "EPSG:32616"
BASE = "pyogrio's `raw.write`"
FORMATS = {"GeoPackage": "tin.gpkg", "OBJ": "tin.obj", "GeoTIFF": "tin.tif", "UGRID": "tin.nc"}
COMMAND = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from tin import cli
from process import memory
code = cli.main(sys.argv[1:])
print(memory("VmHWM"), file=sys.stderr)
sys.exit(code)
"""


def bulk(mesh: tin.Tin, path: Path) -> Callable[[], object]:
    """pyogrio's writer of arrays: a bytes object a geometry."""
    columns = attributes(mesh)
    geometry = np.empty(len(mesh.triangles), object)
    geometry[:] = gpkg.polygons_wkb(mesh).tolist()
    fields, data = list(columns), list(columns.values())
    settings = gpkg._settings(mesh, "tin", "the same")
    return lambda: pyogrio.raw.write(
        path, geometry, field_data=data, fields=fields, geometry_type="Polygon Z", **settings
    )


def bulk_arrow(mesh: tin.Tin, path: Path) -> Callable[[], object]:
    """pyogrio's writer of Arrow streams."""
    columns = {**attributes(mesh), "geom": gpkg.polygons_wkb(mesh)}
    stream = ColumnStream(
        len(mesh.triangles), lambda rows: {name: column[rows] for name, column in columns.items()}
    )
    settings = gpkg._settings(mesh, "tin", "the same")
    return lambda: pyogrio.raw.write_arrow(
        stream, path, geometry_name="geom", geometry_type="Polygon Z", **settings
    )


def writers(mesh: tin.Tin, folder: Path) -> Mapping[str, tuple[Path, Callable[[], Callable[[], object]]]]:
    """By name the file, and what prepares the writing of it."""
    made: dict[str, tuple[Path, Callable[[], Callable[[], object]]]] = {
        BASE: (folder / "bulk.gpkg", lambda: bulk(mesh, folder / "bulk.gpkg")),
        "pyogrio's `raw.write_arrow`": (
            folder / "arrow.gpkg",
            lambda: bulk_arrow(mesh, folder / "arrow.gpkg"),
        ),
    }
    for name, file in FORMATS.items():
        made[name] = (folder / file, lambda path=folder / file: lambda: mesh.write(path, overwrite=True))
    return made


def time_writers(mesh: tin.Tin, folder: Path, rounds: int) -> str:
    """The table of the writers."""
    runs: dict[str, list[tuple[float, float]]] = defaultdict(list)
    sizes = {}
    for _ in range(rounds):
        for name, (path, prepare) in writers(mesh, folder).items():
            runs[name].append(forked(prepare))
            sizes[name] = path.stat().st_size / 2**20
            path.unlink()
    rows = [
        [
            name,
            f"{min(seconds for seconds, _ in figures):.2f}",
            f"{statistics.median(seconds for seconds, _ in figures):.2f}",
            f"{statistics.median(run[0] / base[0] for run, base in zip(figures, runs[BASE])):.2f}",
            f"{max(megabytes for _, megabytes in figures):.0f}",
            f"{sizes[name]:.0f}",
        ]
        for name, figures in runs.items()
    ]
    header = ("writer", "min s", "median s", f"of {BASE} time", "MB more at peak", "MB of the file")
    return table(header, rows)


def time_help(rounds: int) -> list[float]:
    """Seconds of ``dem2tin --help``, from the start of Python to its end."""
    command = [sys.executable, "-c", "from tin.cli import main; main()", "--help"]
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
        seconds.append(time.perf_counter() - start)
    return seconds


def whole(dem: Path, output: Path, points: str) -> float:
    """MB of a whole command at its peak."""
    arguments = [str(dem), str(output), "--method", "max", "--max-points", points, "--overwrite", "--quiet"]
    command = [sys.executable, "-c", COMMAND, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"dem2tin {' '.join(arguments)} failed:\n{done.stderr}")
    return float(done.stderr.split()[-1])


def measure_whole(z: np.ndarray, percents: list[float], folder: Path) -> str:
    """The table of the memory of whole commands."""
    path = folder / "dem.tif"
    size = {"height": z.shape[0], "width": z.shape[1], "count": 1, "dtype": "float32"}
    place = {"crs": CRS, "transform": rasterio.Affine(*PLACE)}
    with rasterio.open(path, "w", driver="GTiff", tiled=True, compress="deflate", **size, **place) as file:
        file.write(z, 1)
    rows = []
    for percent in percents:
        for name in ("OBJ", "GeoPackage", "GeoTIFF"):
            peak = whole(path, folder / FORMATS[name], f"{percent}%")
            rows.append([f"{name}, {percent:g} %", f"{peak:.0f}", f"{peak - z.nbytes / 2**20:.0f}"])
    return table(("output", "MB at peak", "MB beside the DEM"), rows)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=4096, help="side of the DEM (default: 4096)")
    parser.add_argument(
        "--percent", type=float, nargs="+", default=[5.0], help="vertices, in %% of the pixels (default: 5)"
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--no-writers", action="store_true", help="only the start and the whole commands")
    parser.add_argument("--no-whole", action="store_true", help="leave out the whole commands")
    given = parser.parse_args(arguments)

    z = made_terrain.make("smooth", given.size)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for percent in [] if given.no_writers else given.percent:
            dem = tin.DEM(z, transform=PLACE, crs=CRS, vertical_unit="m")
            mesh = tin.triangulate(dem, method="max", max_points=f"{percent}%")
            print(f"\n### {given.size} × {given.size}, {len(mesh.triangles):,} triangles\n")
            print(time_writers(mesh, folder, given.rounds), flush=True)
        seconds = time_help(given.rounds)
        print(
            f"\n`dem2tin --help`: {min(seconds):.2f} s at least, {statistics.median(seconds):.2f} s (median)"
        )
        if not given.no_whole:
            print(
                f"\n### Whole commands, {given.size} × {given.size}: {z.nbytes / 2**20:.0f} MB as float32\n"
            )
            print(measure_whole(z, given.percent, folder), flush=True)


if __name__ == "__main__":
    main()
