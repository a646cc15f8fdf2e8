"""The TIN against oracles: scipy, brute-force numpy, and what a DEM's owner knows."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg
import scipy.spatial
from hypothesis import given, settings
from hypothesis import strategies as st
from terrain import dem, hills

import tin
from tin import _core

PLAIN = {"scales": "0px", "despike": False, "fit": False, "flips": 0}


def signed_areas(mesh: tin.Tin) -> np.ndarray:
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    return ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2


def hats(mesh: tin.Tin, shape: tuple[int, int]) -> scipy.sparse.csr_matrix:
    """Each pixel's height as a combination of the vertices' heights, by brute force."""
    entries = {}
    corners = mesh.pixels[mesh.triangles]
    for triangle, (p, q, r) in zip(mesh.triangles, corners):
        matrix = np.array([[*p, 1], [*q, 1], [*r, 1]]).T
        low, high = np.floor(np.min([p, q, r], 0)).astype(int), np.ceil(np.max([p, q, r], 0)).astype(int)
        for col in range(low[0], high[0] + 1):
            for row in range(low[1], high[1] + 1):
                weights = np.linalg.solve(matrix, [col, row, 1])
                if weights.min() > -1e-9:
                    entries[row * shape[1] + col] = (triangle, weights)
    rows = np.repeat(list(entries), 3)
    columns = np.concatenate([triangle for triangle, _ in entries.values()])
    values = np.concatenate([weights for _, weights in entries.values()])
    return scipy.sparse.csr_matrix((values, (rows, columns)), (shape[0] * shape[1], len(mesh.vertices)))


def test_the_mesh_is_the_delaunay_triangulation_of_its_points():
    random = np.random.default_rng(1)
    z = random.normal(size=(300, 300))
    mesh = tin.triangulate(tin.DEM(z), max_points=400, method="max")
    mesh.check()
    ours = {tuple(sorted(t)) for t in mesh.triangles.tolist()}
    theirs = {tuple(sorted(t)) for t in scipy.spatial.Delaunay(mesh.pixels).simplices.tolist()}
    # Four points on one circle leave a choice; all other triangles agree.
    assert len(ours & theirs) > 0.95 * len(ours)
    assert mesh.report.delaunay


def test_map_metric_makes_the_mesh_delaunay_on_the_ground():
    z = hills(120, 90, 3)
    wide = tin.DEM(z, transform=(20.0, 0.0, 0.0, 0.0, -5.0, 0.0))
    mesh = tin.triangulate(wide, max_points=300, **PLAIN)
    mesh.check()
    ours = {tuple(sorted(t)) for t in mesh.triangles.tolist()}
    theirs = {tuple(sorted(t)) for t in scipy.spatial.Delaunay(mesh.vertices[:, :2]).simplices.tolist()}
    assert len(ours & theirs) > 0.9 * len(ours)


@pytest.mark.parametrize(
    "transform",
    [
        (30.0, 0.0, 500000.0, 0.0, -30.0, 5100000.0),
        (30.0, 0.0, 500000.0, 0.0, 30.0, 5100000.0),
        (-30.0, 0.0, 500000.0, 0.0, -30.0, 5100000.0),
        (10.0, 8.0, 0.0, 6.0, -12.0, 0.0),
        (10.0, 9.0, 0.0, 0.0, -3.0, 0.0),
    ],
    ids=["north-up", "south-up", "west-up", "rotated", "sheared"],
)
def test_triangles_turn_counter_clockwise_on_any_grid(transform):
    mesh = tin.triangulate(dem(transform=transform), max_points=200)
    mesh.check()
    assert (signed_areas(mesh) > 0).all()
    area = abs(transform[0] * transform[4] - transform[1] * transform[3]) * 59 * 79
    assert signed_areas(mesh).sum() == pytest.approx(area)


def test_vertices_keep_their_place_to_the_last_digit():
    mesh = tin.triangulate(dem(), max_points=100, **PLAIN)
    col, row = mesh.pixels.T
    np.testing.assert_array_equal(mesh.vertices[:, 0], 500000.0 + 30.0 * (col + 0.5))
    np.testing.assert_array_equal(mesh.vertices[:, 1], -30.0 * (row + 0.5) + 5_100_000.15)
    z = hills(60, 80)
    np.testing.assert_array_equal(mesh.vertices[:, 2], z[row.astype(int), col.astype(int)])


@settings(max_examples=40, deadline=None)
@given(
    rows=st.integers(3, 30),
    cols=st.integers(3, 30),
    share=st.floats(0.3, 1.0),
    aspect=st.floats(0.05, 20.0),
    seed=st.integers(0, 2**20),
    method=st.sampled_from(["auto", "median", "max"]),
)
def test_nothing_is_invented_on_voids(rows, cols, share, aspect, seed, method):
    random = np.random.default_rng(seed)
    valid = random.random((rows, cols)) < share
    valid[:2, :2] = True
    heights = tin.DEM(hills(rows, cols, seed), valid, transform=(aspect, 0, 0, 0, -1.0, 0))
    mesh = tin.triangulate(heights, max_points="40%", method=method)
    mesh.check()
    col, row = mesh.pixels.astype(int).T
    assert valid[row, col].all()
    surface = mesh.rasterize()
    assert not (np.isfinite(surface) & ~valid).any()
    errors = mesh.error()
    assert errors.covered + errors.uncovered == valid.sum()
    assert errors.void_covered == 0
    cells = sum(valid[i : rows - 1 + i, j : cols - 1 + j].astype(int) for i in (0, 1) for j in (0, 1)) >= 3
    in_cell = np.zeros_like(valid)
    for i in (0, 1):
        for j in (0, 1):
            in_cell[i : rows - 1 + i, j : cols - 1 + j] |= cells
    np.testing.assert_array_equal(np.isfinite(surface), valid & in_cell)


@pytest.mark.parametrize("method", ["auto", "median", "max"])
def test_errors_and_raster_agree_with_brute_force(method):
    source = dem(40, 50, seed=2)
    mesh = tin.triangulate(source, max_points=150, method=method)
    surface = (hats(mesh, source.shape) @ mesh.vertices[:, 2]).reshape(source.shape)
    np.testing.assert_allclose(mesh.rasterize(), surface, atol=1e-9)
    np.testing.assert_allclose(mesh.rasterize(np.float32), surface, rtol=1e-6)
    error = np.abs(surface - source.z)
    found = mesh.error()
    assert found.rmse == pytest.approx(np.sqrt((error**2).mean()), rel=1e-9)
    assert found.mae == pytest.approx(error.mean(), rel=1e-9)
    assert found.max_error == pytest.approx(error.max(), rel=1e-9)
    assert found.mean == pytest.approx((surface - source.z).mean(), abs=1e-9)
    assert found.p95 == pytest.approx(np.quantile(error, 0.95, method="inverted_cdf"), rel=1e-6)
    assert mesh.triangle_errors.max() == pytest.approx(error.max(), rel=1e-9)


def test_fit_is_the_least_squares_solution():
    source = dem(40, 50, seed=4)
    plain = tin.triangulate(source, max_points=120, **PLAIN)
    fitted = tin.triangulate(source, max_points=120, **{**PLAIN, "fit": True})
    np.testing.assert_array_equal(plain.triangles, fitted.triangles)
    matrix = hats(plain, source.shape)
    best = scipy.sparse.linalg.lsqr(matrix, source.z.ravel(), atol=1e-12, btol=1e-12)[0]
    np.testing.assert_allclose(fitted.vertices[:, 2], best, atol=0.02)
    assert fitted.error().rmse < plain.error().rmse


@pytest.mark.parametrize("sigma", [(0.5, 0.5), (2.0, 1.0), (0.0, 3.0)])
def test_gaussian_agrees_with_scipy_away_from_voids(sigma):
    z = hills(50, 70, 5) + np.random.default_rng(5).normal(size=(50, 70))
    z[20:25, 30:34] = np.nan
    smooth = _core.gaussian(z, sigma)
    expected = scipy.ndimage.gaussian_filter(np.nan_to_num(z), sigma[::-1], truncate=4.0)
    reach = [int(4 * s + 0.5) for s in sigma[::-1]]
    known = scipy.ndimage.binary_erosion(np.isfinite(z), np.ones([2 * r + 1 for r in reach]))
    np.testing.assert_allclose(smooth[known], expected[known], rtol=1e-12)
    np.testing.assert_array_equal(np.isnan(smooth), np.isnan(z))


def test_gaussian_keeps_a_plane_up_to_borders_and_voids():
    row, col = np.mgrid[:30, :40]
    plane = 1000.0 + 3.0 * col - 7.0 * row
    plane[10:15, 5:20] = np.nan
    np.testing.assert_allclose(_core.gaussian(plane, (1.5, 2.0)), plane, rtol=1e-12)


def test_a_tolerance_is_a_promise():
    noisy = tin.DEM(hills(90, 110, 6) + np.random.default_rng(6).normal(0, 2, (90, 110)))
    for method in ("max", "auto"):
        mesh = tin.triangulate(noisy, method=method, tolerance=4.0, despike=False)
        assert mesh.report.stop_reason == "tolerance"
        assert np.nanmax(np.abs(mesh.rasterize() - noisy.z)) <= 4.0 + 1e-9
        assert mesh.report.max_error_without_spikes == mesh.error().max_error


def test_a_tolerance_of_zero_is_a_tolerance():
    z = np.round(hills(30, 40, 13))
    mesh = tin.triangulate(tin.DEM(z), tolerance=0, despike=False)
    assert mesh.report.stop_reason == "tolerance"
    assert mesh.error().max_error < 1e-9
    assert mesh.report.points < z.size


def test_the_reason_to_stop_is_what_was_asked_for():
    assert tin.triangulate(tin.DEM(np.zeros((20, 30))), max_points=100).report.stop_reason == "exact"
    ragged = np.random.default_rng(3).random((40, 40)) < 0.8
    mesh = tin.triangulate(tin.DEM(hills(40, 40), ragged), max_points=4)
    assert mesh.report.stop_reason == "outline"
    assert "outline" in str(mesh.report)


def test_a_tolerance_excepts_only_what_was_despiked():
    z = hills(80, 80, 7)
    z[20, 30] += 500
    source = tin.DEM(z)
    mesh = tin.triangulate(source, tolerance=3.0)
    assert mesh.spikes[20, 30]
    error = np.abs(mesh.rasterize() - source.z)
    assert error[~mesh.spikes].max() <= 3.0 + 1e-9 < error.max()
    assert mesh.report.max_error_without_spikes == pytest.approx(error[~mesh.spikes].max())
    assert mesh.report.spikes == mesh.spikes.sum()


def test_points_that_run_out_before_the_tolerance_are_reported():
    mesh = tin.triangulate(dem(), method="max", tolerance=0.01, max_points=50)
    assert mesh.report.stop_reason == "points"
    assert mesh.report.points == 50
    assert mesh.error().max_error > 0.01


@pytest.mark.parametrize("method", ["auto", "median", "max"])
def test_a_plane_needs_two_triangles(method):
    row, col = np.mgrid[:20, :30]
    mesh = tin.triangulate(tin.DEM(3.0 * col - 2.0 * row), method=method, tolerance=1e-6)
    assert mesh.triangles.shape == (2, 3)


def test_initial_points_are_vertices():
    source = dem()
    wanted = np.array([source.pixel_to_map(40, 30), source.pixel_to_map(7, 55), source.pixel_to_map(7, 55)])
    outside = [[0.0, 0.0], [np.nan, 1.0]]
    mesh = tin.triangulate(source, points=np.vstack([wanted, outside]), max_points=10, **PLAIN)
    placed = {tuple(p) for p in mesh.pixels.astype(int).tolist()}
    assert {(40, 30), (7, 55)} <= placed


def test_points_that_are_none_are_refused():
    for points, code in (("x", "not-found"), (7, "bad-features"), ([1.0, 2.0], "bad-features")):
        with pytest.raises(tin.InputError) as caught:
            tin.triangulate(dem(), points=points)
        assert caught.value.code == code
    assert tin.triangulate(dem(), points=[], max_points=20).report.points == 20


def test_same_input_same_bytes():
    first, second = (tin.triangulate(dem(seed=9), max_points=300) for _ in range(2))
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.triangles.tobytes() == second.triangles.tobytes()


def test_threads_do_not_disturb_each_other():
    source = dem(100, 100, seed=10)
    alone = tin.triangulate(source, max_points=500)
    found: list[tin.Tin] = []
    threads = [
        threading.Thread(target=lambda: found.append(tin.triangulate(source, max_points=500)))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    assert all(np.array_equal(alone.vertices, mesh.vertices) for mesh in found)


def test_progress_names_stages_and_cancels_quickly():
    source = tin.DEM(hills(1500, 1500, 11).astype(np.float32))
    stages, asked = [], []

    def watch(stage: str, fraction: float) -> bool:
        assert 0.0 <= fraction <= 1.0
        stages.append(stage)
        if stage == "refine" and fraction > 0 and not asked:
            asked.append(time.perf_counter())
        return not asked

    with pytest.raises(tin.Cancelled) as caught:
        tin.triangulate(source, progress=watch)
    assert caught.value.code == "cancelled"
    assert time.perf_counter() - asked[0] < 0.2
    assert stages[0] == "despike"


def test_an_exception_in_the_callback_comes_through():
    def fail(stage: str, fraction: float) -> bool:
        raise KeyError(stage)

    with pytest.raises(KeyError, match="despike"):
        tin.triangulate(dem(), progress=fail)


@pytest.mark.parametrize(
    ("z", "code"),
    [
        (np.zeros((1, 9)), "too-small"),
        (np.zeros((9, 1)), "too-small"),
        (np.where(np.eye(5), 1.0, np.nan), "no-area"),
        (np.array([[1.0, np.nan], [np.nan, 2.0]]), "no-area"),
        (np.array([[1.0, 2.0, 3.0], [np.nan] * 3]), "no-area"),
    ],
)
def test_heights_without_area_are_refused(z, code):
    with pytest.raises(tin.InputError) as caught:
        tin.triangulate(tin.DEM(z))
    assert caught.value.code == code


def test_import_needs_numpy_alone():
    code = (
        "import sys, tin; "
        "bad = {'rasterio','fiona','pyogrio','shapely','scipy','matplotlib','OpenImageIO','osgeo','pyproj'};"
        "sys.exit(', '.join(bad & set(sys.modules)) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_package_has_all_its_names_and_no_others():
    code = "import tin; names = dir(tin); from tin import *; print({*tin.__all__} - {*names}, DEM is tin.DEM)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "set() True\n"
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = tin.nothing


def test_to_geodataframe_holds_valid_polygons_with_the_crs():
    frame = tin.triangulate(dem(crs="EPSG:32610"), max_points=80).to_geodataframe()
    assert frame.crs.to_epsg() == 32610
    assert frame.is_valid.all()
    assert frame.geometry.has_z.all()
    assert frame.geometry.exterior.is_ccw.all()
    assert frame["max_error"].max() > 0


@pytest.mark.parametrize("sigma", [2.0, 10.0])
def test_automatic_stop_is_near_the_best_number_of_points(sigma):
    z = hills(200, 200, 12, relief=500)
    noisy = tin.DEM(z + np.random.default_rng(12).normal(0, sigma, z.shape))

    def rmse(max_points: object) -> float:
        return float(np.sqrt(np.mean((tin.triangulate(noisy, max_points=max_points).rasterize() - z) ** 2)))

    best = min(rmse(f"{percent}%") for percent in (0.5, 1, 2, 3, 5, 8, 12, 20))
    assert rmse("auto") <= 1.05 * best
    assert tin.triangulate(noisy, max_points="auto").report.stop_reason == "noise"


@pytest.mark.parametrize("given", [hills(9, 9), "dem.tif", None])
def test_what_is_no_dem_is_named_with_what_makes_one(given):
    with pytest.raises(tin.InputError, match=r"tin\.open") as caught:
        tin.triangulate(given)
    assert caught.value.code == "not-a-dem"
