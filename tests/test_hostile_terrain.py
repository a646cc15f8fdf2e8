"""Terrain and georeference at their extremes, up to every file that is written of them."""

from __future__ import annotations

import json
import math
import signal
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
import scipy.io
import shapely
from pyogrio import raw
from rasterio.control import GroundControlPoint
from terrain import hills

import tin
from tin import cli, formats

METHODS = ["auto", "median", "max"]
UTM = (30.0, 0.0, 500000.0, 0.0, -30.0, 5_100_000.0)
each_method = pytest.mark.parametrize("method", METHODS)


def turned(degrees: float) -> tuple[float, ...]:
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (30 * cos, 30 * sin, 500000.0, 30 * sin, -30 * cos, 5_100_000.0)


def checked(dem: tin.DEM, **keywords: object) -> tin.Tin:
    mesh = tin.triangulate(dem, **keywords)
    mesh.check()
    assert np.isfinite(mesh.vertices).all()
    errors = mesh.error()
    assert all(map(math.isfinite, (errors.rmse, errors.mae, errors.p95, errors.max_error, errors.mean)))
    assert errors.void_covered == 0
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    assert ((b - a)[:, 0] * (c - a)[:, 1] > (b - a)[:, 1] * (c - a)[:, 0]).all()
    return mesh


# Heights


@each_method
def test_an_undeclared_nodata_value_is_a_height_that_shows(method):
    z = hills(40, 50)
    z[10:20, 10:20] = -32768
    mesh = checked(tin.DEM(z), method=method)
    # Nothing is guessed: the pit is in the TIN, for everybody to see.
    assert mesh.vertices[:, 2].min() < -30000
    assert mesh.error().covered == z.size


@pytest.mark.parametrize("undeclared", [-32768, -9999])
def test_undeclared_nodata_pixels_here_and_there_are_told_as_spikes(undeclared):
    z = hills(40, 50)
    random = np.random.default_rng(0)
    z[random.integers(1, 39, 12), random.integers(1, 49, 12)] = undeclared
    wrong = z == undeclared
    mesh = checked(tin.DEM(z))
    np.testing.assert_array_equal(mesh.spikes, wrong)
    assert f"{wrong.sum()} spikes replaced" in str(mesh.report)
    assert mesh.error().max_error > -undeclared
    assert mesh.report.max_error_without_spikes < 10


@each_method
@pytest.mark.parametrize("height", [1e38, -1e38, 9.9e37])
def test_heights_just_within_the_range(method, height):
    z = hills(40, 50)
    z.ravel()[np.random.default_rng(0).permutation(z.size)[:20]] = height
    checked(tin.DEM(z), method=method)
    checked(tin.DEM(z.astype(np.float32)), method=method)


@each_method
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_denormal_heights(method, dtype):
    least = float(np.finfo(dtype).smallest_subnormal)
    z = (hills(40, 50) * least).astype(dtype)
    assert 0 < z.max() < np.finfo(dtype).tiny
    mesh = checked(tin.DEM(z), method=method, tolerance=3 * least)
    assert mesh.report.stop_reason == "tolerance"
    if method != "median":  # whose tolerance is on the median of a triangle
        assert np.abs(mesh.rasterize() - z).max() <= 4 * least


@each_method
def test_negative_zero_is_zero(method):
    z = np.zeros((10, 12))
    plus = tin.triangulate(tin.DEM(z), method=method)
    z[::2, 1::2] = -0.0
    mesh = checked(tin.DEM(z), method=method)
    assert mesh.triangles.tobytes() == plus.triangles.tobytes()
    assert (len(mesh.triangles), mesh.error().max_error) == (2, 0.0)
    np.testing.assert_array_equal(mesh.vertices, plus.vertices)


@pytest.mark.parametrize("method", ["auto", "max"])
@pytest.mark.parametrize("limits", [{}, {"tolerance": 0}, {"max_points": "auto"}, {"max_points": 100}])
@pytest.mark.parametrize("height", [0.0, 7.1, -1e38, 5e-324])
def test_a_constant_dem_is_two_triangles_without_error(method, limits, height):
    mesh = checked(tin.DEM(np.full((20, 30), height)), method=method, **limits)
    assert mesh.triangles.shape == (2, 3)
    assert (mesh.vertices[:, 2] == height).all()
    assert (mesh.error().rmse, mesh.error().max_error) == (0, 0)


@pytest.mark.parametrize("method", ["auto", "max"])
@pytest.mark.parametrize("limits", [{}, {"tolerance": 0}, {"max_points": "auto"}])
@pytest.mark.parametrize("dtype", ["int16", "float32", "float64"])
def test_an_exact_plane_is_two_triangles_without_error(method, limits, dtype):
    row, col = np.mgrid[:33, :65]  # sides of powers of two, so that weights are exact
    mesh = checked(tin.DEM((3 * col - 2 * row + 500).astype(dtype)), method=method, **limits)
    assert mesh.triangles.shape == (2, 3)
    assert mesh.error().max_error == 0


def test_flat_terrain_for_the_method_that_smooths():
    # Smoothing rounds in the last place, which only a tolerance of more than that can overlook.
    row, col = np.mgrid[:33, :65]
    for z in (np.full((20, 30), 7.1), 3.0 * col - 2.0 * row):
        mesh = checked(tin.DEM(z), method="median", tolerance=1e-9)
        assert mesh.triangles.shape == (2, 3)
        assert mesh.error().max_error < 1e-9


# Georeference

TRANSFORMS = {
    "1000:1": ((1000.0, 0.0, 0.0, 0.0, -1.0, 0.0), "EPSG:32616"),
    "1:1000": ((1.0, 0.0, 0.0, 0.0, -1000.0, 0.0), "EPSG:32616"),
    "south-up": ((30.0, 0.0, 500000.0, 0.0, 30.0, 5_100_000.0), "EPSG:32616"),
    "rotated": (turned(20), "EPSG:32616"),
    "antimeridian": ((0.005, 0.0, 179.9, 0.0, -0.005, 10.0), "EPSG:4326"),
    "wrapped": ((0.005, 0.0, -180.1, 0.0, -0.005, 10.0), "EPSG:4326"),
    "pole": ((0.005, 0.0, 0.0, 0.0, -0.005, 90.0), "EPSG:4326"),
    "south pole": ((0.005, 0.0, 0.0, 0.0, -0.005, -89.85), "EPSG:4326"),
    "the Earth": ((7.2, 0.0, -180.0, 0.0, -6.0, 90.0), "EPSG:4326"),
}


@each_method
@pytest.mark.parametrize(("transform", "crs"), TRANSFORMS.values(), ids=TRANSFORMS)
def test_the_mesh_holds_on_any_grid(method, transform, crs):
    z = hills(30, 50)
    mesh = checked(tin.DEM(z, transform=transform, crs=crs), method=method, max_points=150)
    assert mesh.report.points == 150
    # Nothing jumps at the antimeridian or the pole: the pixels are where the transform puts them.
    x, y = mesh.dem.pixel_to_map(*mesh.pixels.T)
    np.testing.assert_array_equal(mesh.vertices[:, :2], np.column_stack([x, y]))
    assert mesh.error().covered == z.size


def test_a_dem_across_the_antimeridian_is_the_same_as_one_beside_it():
    z = hills(30, 50)
    meshes = [
        tin.triangulate(tin.DEM(z, transform=(0.005, 0, west, 0, -0.005, 10), crs="EPSG:4326"))
        for west in (179.9, -180.1, 20.0)
    ]
    for mesh in meshes:
        np.testing.assert_array_equal(mesh.triangles, meshes[0].triangles)
        np.testing.assert_array_equal(mesh.pixels, meshes[0].pixels)


@each_method
@pytest.mark.parametrize("shape", [(2, 2), (2, 3), (3, 2), (2, 500), (500, 2)])
def test_two_rows_or_columns(method, shape):
    z = hills(*shape)
    mesh = checked(tin.DEM(z), method=method, max_points="50%")
    area = (shape[0] - 1) * (shape[1] - 1)
    assert np.isfinite(mesh.rasterize()).all()
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert twice.sum() == 2 * area


# The command, from a file to all files


def raster(path: Path, z: np.ndarray, transform: object = UTM, crs: object = "EPSG:32616", **more) -> Path:
    gcps = more.pop("gcps", None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        placed = {} if gcps else {"transform": rasterio.Affine(*transform), "crs": crs}
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            dtype=z.dtype,
            height=z.shape[0],
            width=z.shape[1],
            count=1,
            **placed,
            **more,
        ) as file:
            file.write(z, 1)
            if gcps:
                file.gcps = gcps, rasterio.CRS.from_string(crs)
    return path


def ground_points(bend: float) -> list[GroundControlPoint]:
    return [
        GroundControlPoint(row, col, 500000 + 30 * col + 5 * row + bend * row * col, 5_100_000 - 30 * row)
        for row in (0, 12)
        for col in (0, 16)
    ]


def spiky(shape: tuple[int, int], height: float) -> np.ndarray:
    z = hills(*shape)
    z[5, 5], z[7, 2] = height, -height
    return z


ROW, COL = np.mgrid[:17, :33]
SMALL = {
    **{
        name: (hills(12, 16), {"transform": transform, "crs": crs})
        for name, (transform, crs) in TRANSFORMS.items()
        if name not in ("1:1000", "wrapped", "south pole")  # each takes a second and has its like
    },
    "constant": (np.full((12, 16), 7.0), {}),
    "plane": ((3 * COL - 2 * ROW).astype(np.int16), {}),
    "undeclared": (spiky((12, 16), 32767).astype(np.int16), {}),
    "denormals": (hills(12, 16) * 5e-324, {}),
    "negative zero": (np.where(hills(12, 16) > 50, -0.0, 1.0), {}),
    "huge": (spiky((12, 16), 1e38), {}),
    "2 x 2": (hills(2, 2), {}),
    "2 x 40": (hills(2, 40), {}),
    "40 x 2": (hills(40, 2), {}),
    "control points": (hills(12, 16), {"gcps": ground_points(0.0)}),
    "voids": (
        np.where(np.random.default_rng(1).random((12, 16)) < 0.8, hills(12, 16), -9999),
        {"nodata": -9999},
    ),
}


@pytest.fixture
def command(monkeypatch, capsys):
    """The command in this process; it takes over a signal, which is given back."""
    before = signal.getsignal(signal.SIGTERM)

    def run(*arguments: object) -> tuple[int, str, str]:
        code = cli.main([str(argument) for argument in arguments])
        return (code, *capsys.readouterr())

    yield run
    signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize(("z", "profile"), SMALL.values(), ids=SMALL)
def test_all_files_of_a_small_hostile_raster(tmp_path, command, z, profile):
    source = raster(tmp_path / "dem.tif", z, **profile)
    outputs = [tmp_path / f"x{suffix}" for suffix in formats.WRITERS]
    extra = ["--error-map", tmp_path / "e.tif", "--json", tmp_path / "r.json", "--max-points", "30%"]
    code, shown, said = command(source, *outputs, *extra)
    assert code == 0
    assert all(line.startswith("dem2tin: warning: ") for line in said.splitlines())
    report = json.loads((tmp_path / "r.json").read_text())
    assert f"{report['triangles']} triangles" in shown
    assert report["void_covered"] == 0

    polygons = shapely.from_wkb(raw.read(tmp_path / "x.gpkg")[2])
    assert len(polygons) == report["triangles"]
    assert shapely.is_valid(polygons).all()
    assert shapely.is_ccw(shapely.get_exterior_ring(polygons)).all()
    text = (tmp_path / "x.obj").read_text()
    assert (text.count("\nv "), text.count("\nf ")) == (report["points"], report["triangles"])
    with scipy.io.netcdf_file(tmp_path / "x.nc", mmap=False) as file:
        assert file.variables["mesh2d_face_nodes"].shape == (report["triangles"], 3)
        heights = file.variables["mesh2d_node_z"].data.copy()
    assert np.isfinite(heights).all()
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "x.tiff").read_bytes() == (tmp_path / "x.tif").read_bytes()
    dem = tin.open(source)
    with rasterio.open(tmp_path / "x.tif") as file:
        assert file.shape == z.shape
        np.testing.assert_allclose(tuple(file.transform)[:6], dem.transform, rtol=1e-12)
        surface = file.read(1, masked=True).astype(float).filled(np.nan)
    error = np.abs(surface - dem.z)
    assert np.isfinite(error).sum() == report["covered"]
    rounding = 1e-6 * float(np.nanmax(np.abs(dem.z))) + 1e-44  # the raster is float32
    assert np.nanmax(error) == pytest.approx(report["max_error"], rel=1e-5, abs=rounding)
    with rasterio.open(tmp_path / "e.tif") as file:
        assert np.nanmax(np.abs(file.read(1))) == pytest.approx(report["max_error"], rel=1e-6, abs=1e-44)


@pytest.mark.parametrize(
    ("z", "profile", "words"),
    [
        (spiky((12, 16), 1e308), {}, "declare the NoData value"),
        (np.full((12, 16), -1e308), {}, "declare the NoData value"),
        (hills(12, 16), {"gcps": ground_points(3.0)}, "gdalwarp"),
        (hills(1, 16), {}, "2 x 2"),
        (hills(16, 1), {}, "2 x 2"),
    ],
    ids=["1e308", "all -1e308", "bent control points", "one row", "one column"],
)
def test_what_is_no_terrain_gets_one_line(tmp_path, command, z, profile, words):
    source = raster(tmp_path / "dem.tif", z, **profile)
    code, shown, said = command(source, *(tmp_path / f"x{suffix}" for suffix in formats.WRITERS))
    assert (code, shown) == (3, "")
    assert words in said
    assert said.startswith("dem2tin: ")
    assert said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["dem.tif"]


@pytest.mark.parametrize("wrong", [{"col": np.inf}, {"row": np.nan}, {"x": 1e308}, {"y": -np.inf}])
def test_control_points_that_are_not_finite_do_not_hang(tmp_path, wrong):
    corners = [(0.0, 0.0, 10.0, 50.0), (0.0, 7.0, 17.0, 50.0), (6.0, 0.0, 10.0, 44.0)]
    places = [dict(zip(("row", "col", "x", "y"), corner)) for corner in corners]
    places[1].update(wrong)
    places[2].update(wrong)
    gcps = [rasterio.control.GroundControlPoint(**place) for place in places]
    path = tmp_path / "gcps.tif"
    size = {"height": 6, "width": 7, "count": 1, "dtype": "float32", "crs": "EPSG:4326"}
    with rasterio.open(path, "w", driver="GTiff", gcps=gcps, **size) as file:
        file.write(np.ones((6, 7), np.float32), 1)
    with pytest.raises(tin.InputError) as caught:
        tin.open(path)
    assert caught.value.code == "gcp-only"
