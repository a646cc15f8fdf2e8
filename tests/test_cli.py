"""The ``dem2tin`` command as a user runs it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from terrain import hills

import tin
from tin import cli

SAMPLES = Path(__file__).parents[1] / "sample_dem"
JACKSBORO = SAMPLES / "jacksboro.dem"


def command(*arguments: object) -> list[str]:
    return [
        sys.executable,
        "-c",
        "import sys; from tin.cli import main; sys.exit(main())",
        *map(str, arguments),
    ]


def run(*arguments: object, **keywords: object) -> subprocess.CompletedProcess:
    return subprocess.run(command(*arguments), capture_output=True, text=True, check=False, **keywords)


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    text = path.read_text()
    origin = [float(v) for v in re.search(r"^# origin: (\S+) (\S+)", text, re.M).groups()]
    vertices = np.array([line.split()[1:] for line in text.splitlines() if line.startswith("v ")], float)
    faces = np.array([line.split()[1:] for line in text.splitlines() if line.startswith("f ")], int) - 1
    vertices[:, :2] += origin
    return vertices, faces


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, str]:
    folder = tmp_path_factory.mktemp("out")
    paths = [folder / f"x.{suffix}" for suffix in ("gpkg", "obj", "tif")]
    done = run(JACKSBORO, *paths, "--max-points", "5%", "--json", folder / "x.json")
    assert done.returncode == 0, done.stderr
    return folder, json.loads((folder / "x.json").read_text()), done.stdout


def test_report_has_the_stable_keys(outputs):
    folder, report, shown = outputs
    keys = {"points", "triangles", "rmse", "mae", "p95", "max_error", "stop_reason", "seconds", "crs"}
    assert keys <= report.keys()
    assert report["crs"] == "EPSG:32616"
    assert report["stop_reason"] == "points"
    assert f"{report['points']:,} points" in shown
    assert report["points"] == round(tin.open(JACKSBORO).n_valid * 0.05)


def test_reported_errors_are_those_of_the_written_raster(outputs):
    folder, report, _ = outputs
    with rasterio.open(JACKSBORO) as source, rasterio.open(folder / "x.tif") as written:
        assert (written.shape, written.transform) == (source.shape, source.transform)
        assert written.crs.to_epsg() == 32616
        z, surface = source.read(1, masked=True).astype(float), written.read(1, masked=True).astype(float)
    assert not (~np.ma.getmaskarray(surface) & np.ma.getmaskarray(z)).any()
    error = np.ma.abs(surface - z).compressed()
    assert error.size == report["covered"]
    assert report["rmse"] == pytest.approx(np.sqrt((error**2).mean()), rel=1e-4)
    assert report["mae"] == pytest.approx(error.mean(), rel=1e-4)
    assert report["max_error"] == pytest.approx(error.max(), rel=1e-4)
    assert report["p95"] == pytest.approx(np.quantile(error, 0.95), rel=1e-3)


def test_polygons_are_valid_and_describe_the_same_triangles_as_the_obj(outputs):
    folder, report, _ = outputs
    info, table = pyogrio.read_info(folder / "x.gpkg"), pyogrio.raw.read(folder / "x.gpkg")
    assert info["layer_name"] == "tin"
    assert info["geometry_type"] == "Polygon Z"
    assert info["crs"] == "EPSG:32616"
    polygons = shapely.from_wkb(table[2])
    assert len(polygons) == report["triangles"]
    assert shapely.is_valid(polygons).all()
    assert shapely.is_ccw(shapely.get_exterior_ring(polygons)).all()
    vertices, faces = read_obj(folder / "x.obj")
    assert len(vertices) == report["points"]
    corners = shapely.get_coordinates(polygons, include_z=True).reshape(-1, 4, 3)[:, :3]
    np.testing.assert_allclose(vertices[faces], corners, atol=1e-6)


def test_a_tolerance_holds_in_the_written_raster(tmp_path):
    done = run(JACKSBORO, tmp_path / "x.tif", "--method", "max", "--tolerance", 5, "--json", "-")
    report = json.loads(done.stdout)
    assert report["stop_reason"] == "tolerance"
    with rasterio.open(JACKSBORO) as source, rasterio.open(tmp_path / "x.tif") as written:
        error = np.ma.abs(written.read(1, masked=True).astype(float) - source.read(1, masked=True))
    assert error.max() <= 5 + 1e-3
    assert "points" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["missing.tif", "x.gpkg"], 3, "no such file"),
        ([__file__, "x.gpkg"], 3, "not a raster"),
        ([JACKSBORO, "x.foo"], 4, "unknown suffix '.foo'"),
        ([JACKSBORO, "nowhere/x.gpkg"], 4, "no directory"),
        ([JACKSBORO, JACKSBORO], 4, "unknown suffix"),
        ([SAMPLES / "jacksboro.tif", SAMPLES / "jacksboro.tif", "--overwrite"], 4, "input"),
        ([JACKSBORO, "x.obj", "x.obj"], 4, "twice"),
        ([JACKSBORO, "x.obj", "--json", "x.obj"], 4, "twice"),
        ([JACKSBORO, "taken.gpkg"], 4, "exists already"),
        ([JACKSBORO, "x.obj", "--json", "taken.gpkg"], 4, "exists already"),
        ([JACKSBORO], 2, "OUTPUT"),
        ([JACKSBORO, "x.gpkg", "--tolerance", "nan"], 2, "--tolerance"),
        ([JACKSBORO, "x.gpkg", "--tolerance=-1"], 2, "--tolerance"),
        ([JACKSBORO, "x.gpkg", "--max-points", "3"], 2, "at least 4"),
        ([JACKSBORO, "x.gpkg", "--method", "best"], 2, "auto, median, max"),
        ([JACKSBORO, "x.gpkg", "--no-such"], 2, "--no-such"),
        ([JACKSBORO, "x.gpkg", "--band", "2"], 3, "band"),
        ([JACKSBORO, "x.gpkg", "--to-crs", "EPSG:999999"], 2, "--to-crs"),
        ([JACKSBORO, "x.gpkg", "--to-crs", "EPSG:5703"], 3, "neither projected nor geographic"),
        (["plain.pgm", "x.gpkg", "--to-crs", "utm"], 3, "has no CRS"),
        ([JACKSBORO, "x.gpkg", "--outline", "x.tif"], 4, "unknown suffix"),
        ([JACKSBORO, "x.gpkg", "--outline", "x.gpkg"], 4, "twice"),
        ([JACKSBORO, "x.gpkg", "--outline", "taken.gpkg"], 4, "exists already"),
    ],
)
def test_a_mistake_gets_one_line_and_the_right_exit_code(tmp_path, arguments, code, words):
    (tmp_path / "taken.gpkg").write_text("mine")
    (tmp_path / "plain.pgm").write_text("P2 3 3 9\n1 2 3\n4 5 6\n7 8 9\n")
    before = sorted(tmp_path.iterdir())
    done = run(*arguments, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(SAMPLES.parent)})
    assert done.returncode == code
    assert done.stdout == ""
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("dem2tin: ")
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "taken.gpkg").read_text() == "mine"


def test_an_input_named_with_a_layer_or_subdataset_is_not_overwritten(tmp_path):
    import geopandas

    points = tmp_path / "points.gpkg"
    frame = geopandas.GeoDataFrame(geometry=[shapely.Point(745000, 4053000)], crs="EPSG:32616")
    frame.to_file(points, layer="summits", engine="fiona")
    copy = tmp_path / "dem.tif"
    copy.write_bytes((SAMPLES / "jacksboro.tif").read_bytes())
    for arguments in (
        [JACKSBORO, points, "--points", f"{points}:summits"],
        [f"GTIFF_DIR:1:{copy}", copy],
    ):
        before = Path(arguments[1]).read_bytes()
        done = run(*arguments, "--overwrite")
        assert done.returncode == 4, done
        assert "belongs to the input" in done.stderr
        assert Path(arguments[1]).read_bytes() == before


@pytest.mark.parametrize(
    ("name", "options"),
    [("x" * 300 + ".obj", []), ("x.obj", ["--json", "y" * 300]), ("x.obj", ["--max-points", "9" * 20])],
)
def test_names_and_numbers_beyond_all_bounds_get_one_line(tmp_path, name, options):
    done = run(
        JACKSBORO,
        tmp_path / name,
        *options,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(SAMPLES.parent)},
    )
    assert done.returncode in (2, 4)
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_report_that_cannot_be_printed_gets_one_line(tmp_path):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command(JACKSBORO, tmp_path / "x.obj"),
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 4
    assert done.stderr.count("\n") == 1


def test_points_outside_the_dem_are_counted(tmp_path):
    points = tmp_path / "p.geojson"
    points.write_text(
        '{"type":"FeatureCollection","features":[{"type":"Feature","properties":{},'
        '"geometry":{"type":"Point","coordinates":[0,0]}}]}'
    )
    done = run(JACKSBORO, tmp_path / "x.obj", "--points", points)
    assert done.returncode == 0
    assert "1 of 1 points lie outside the DEM" in done.stderr


def test_overwrite_replaces_and_quiet_is_quiet(tmp_path):
    (tmp_path / "x.obj").write_text("old")
    done = run(JACKSBORO, tmp_path / "x.obj", "--overwrite", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (tmp_path / "x.obj").read_text().startswith("#")


@pytest.mark.parametrize("threads", ["1", "3"])
def test_interrupt_ends_with_130_and_leaves_nothing(tmp_path, threads):
    big = tmp_path / "big.tif"
    profile = {"driver": "GTiff", "width": 3000, "height": 3000, "count": 1, "dtype": "float32"}
    transform = rasterio.Affine(30.0, 0.0, 0.0, 0.0, -30.0, 0.0)
    with rasterio.open(big, "w", transform=transform, crs="EPSG:32610", **profile) as file:
        file.write(hills(3000, 3000).astype("float32"), 1)
    process = subprocess.Popen(
        command(big, tmp_path / "x.gpkg", "--threads", threads), stderr=subprocess.PIPE, text=True
    )
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    asked = time.perf_counter()
    _, said = process.communicate()
    assert time.perf_counter() - asked < 2.0
    assert process.returncode == 130
    assert said == "dem2tin: interrupted\n"
    assert list(tmp_path.iterdir()) == [big]


def test_error_map_is_written_and_guarded(tmp_path):
    done = run(JACKSBORO, tmp_path / "x.tif", "--error-map", tmp_path / "e.tif", "--json", "-")
    assert done.returncode == 0, done.stderr
    with rasterio.open(tmp_path / "e.tif") as file:
        error = np.ma.masked_invalid(file.read(1, masked=True))
    assert np.sqrt((error.astype(float) ** 2).mean()) == pytest.approx(
        json.loads(done.stdout)["rmse"], rel=1e-4
    )
    again = run(JACKSBORO, tmp_path / "y.tif", "--error-map", tmp_path / "e.tif")
    assert again.returncode == 4
    assert "exists already" in again.stderr


@pytest.fixture(scope="module")
def degrees(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("in") / "degrees.tif"
    profile = {"driver": "GTiff", "width": 50, "height": 40, "count": 1, "dtype": "float32"}
    transform = rasterio.Affine(1 / 1200, 0.0, -84.3, 0.0, -1 / 1200, 36.5)
    with rasterio.open(path, "w", transform=transform, crs="EPSG:4326", **profile) as file:
        file.write(hills(40, 50).astype("float32"), 1)
        file.set_band_unit(1, "ft")
    return path


def test_another_crs_and_the_outline(tmp_path, degrees):
    outputs = [tmp_path / name for name in ("x.obj", "x.tif", "x.gpkg")]
    options = ["--to-crs", "utm", "--z-factor", "0.3048", "--outline", tmp_path / "outline.gpkg"]
    done = run(degrees, *outputs, *options, "--error-map", tmp_path / "e.tif", "--json", "-")
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    report = json.loads(done.stdout)
    assert report["crs"] == "EPSG:32616"
    assert report["warnings"] == []
    for name in ("x.tif", "e.tif"):
        with rasterio.open(tmp_path / name) as file:
            assert file.crs.to_epsg() == 32616
            assert file.units == ("metre",)
    triangles, outline = (pyogrio.read_dataframe(tmp_path / name) for name in ("x.gpkg", "outline.gpkg"))
    assert triangles.crs.to_epsg() == outline.crs.to_epsg() == 32616
    assert len(triangles) == report["triangles"]
    assert outline.area.sum() == pytest.approx(triangles.area.sum(), rel=1e-9)
    vertices, _ = read_obj(tmp_path / "x.obj")
    assert triangles.total_bounds == pytest.approx([*vertices.min(0)[:2], *vertices.max(0)[:2]])


@pytest.mark.parametrize(("suffix", "warned"), [("obj", True), ("nc", True), ("gpkg", False), ("tif", False)])
def test_units_that_do_not_fit_are_warned_of_where_it_matters(tmp_path, degrees, suffix, warned):
    done = run(degrees, tmp_path / f"x.{suffix}", "--json", tmp_path / "x.json")
    assert done.returncode == 0
    warnings = json.loads((tmp_path / "x.json").read_text())["warnings"]
    assert len(warnings) == warned
    assert done.stderr == "".join(f"dem2tin: warning: {warning}\n" for warning in warnings)
    if warned:
        assert "--to-crs utm" in warnings[0]
        assert "--z-factor 0.3048" in warnings[0]
    again = run(degrees, tmp_path / f"x.{suffix}", "--overwrite", "--quiet")
    assert again.stderr == ""


def test_help_names_every_option():
    shown = run("--help").stdout
    for option in cli.options.OPTIONS:
        assert option.flag in shown


def test_help_imports_neither_numpy_nor_the_raster_libraries():
    code = (
        "import sys; from tin import cli; cli.parser();"
        "sys.exit(' '.join({'numpy', 'rasterio', 'tin._core'} & set(sys.modules)) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_height_factor_and_feet(tmp_path):
    run(JACKSBORO, tmp_path / "x.obj", "--z-factor", "3.280839895", "--max-points", "50", "--quiet")
    vertices, _ = read_obj(tmp_path / "x.obj")
    assert vertices[:, 2].max() > 2000
