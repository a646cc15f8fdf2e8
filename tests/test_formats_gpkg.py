from __future__ import annotations

import contextlib
import re
import sqlite3
import weakref

import fiona
import geopandas
import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from fakes import UTM, FakeCRS, crs, grid_tin
from numpy.testing import assert_array_equal

import tin as package
from tin import formats
from tin.errors import OutputError
from tin.formats import arrow, gpkg, write
from tin.formats.attributes import attributes

ALBERS = (
    'PROJCS["Homemade Albers",GEOGCS["NAD83",DATUM["North_American_Datum_1983",'
    'SPHEROID["GRS 1980",6378137,298.257222101]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],'
    'PROJECTION["Albers_Conic_Equal_Area"],PARAMETER["latitude_of_center",33],PARAMETER["longitude_of_center",-101],'
    'PARAMETER["standard_parallel_1",30],PARAMETER["standard_parallel_2",41],PARAMETER["false_easting",5],'
    'PARAMETER["false_northing",7],UNIT["metre",1]]'
)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "out.gpkg"


def query(path, statement):
    with contextlib.closing(sqlite3.connect(path)) as database:
        return database.execute(statement).fetchall()


def test_every_reader_finds_the_same_triangles(path):
    tin = grid_tin(crs=crs("EPSG:26710"))
    write(tin, path)
    expected = tin.vertices[tin.triangles[:, [0, 1, 2, 0]]]

    frame = geopandas.read_file(path, layer="tin")
    coordinates = shapely.get_coordinates(frame.geometry, include_z=True)
    assert_array_equal(coordinates.reshape(expected.shape), expected)
    assert frame.crs == pyproj.CRS("EPSG:26710")
    assert shapely.is_valid(frame.geometry).all()
    assert shapely.is_ccw(shapely.get_exterior_ring(frame.geometry)).all()
    assert shapely.has_z(frame.geometry).all()

    for name, column in attributes(tin).items():
        assert_array_equal(frame[name], column)
        assert frame[name].dtype == column.dtype

    with fiona.open(path) as layer:
        assert layer.schema["geometry"] == "3D Polygon"
        assert layer.crs.to_epsg() == 26710
        assert len(layer) == len(expected)
        assert_array_equal(next(iter(layer)).geometry.coordinates[0], expected[0])
    assert pyogrio.read_info(path)["geometry_type"] == "Polygon Z"


def test_the_database_is_geopackage_1_3_with_an_r_tree(path):
    tin = grid_tin(crs=crs("EPSG:26710"))
    write(tin, path)
    assert query(path, "PRAGMA user_version") == [(10300,)]
    assert query(path, "PRAGMA integrity_check") == [("ok",)]
    assert query(path, "SELECT table_name, data_type, srs_id FROM gpkg_contents") == [
        ("tin", "features", 26710)
    ]
    assert query(path, "SELECT geometry_type_name, z, m FROM gpkg_geometry_columns") == [("POLYGON", 1, 0)]
    assert query(path, "SELECT count(*) FROM rtree_tin_geom") == [(len(tin.triangles),)]
    ((description,),) = query(path, "SELECT description FROM gpkg_contents")
    assert description == "TIN of hills: heights in metre, slope and aspect in degrees, areas in square metre"
    x, y = tin.vertices[3, :2]
    found = pyogrio.read_dataframe(path, bbox=(x - 1, y - 1, x + 1, y + 1))
    assert 0 < len(found) < 10


def test_flat_triangles_have_a_null_aspect(path):
    write(grid_tin(flat=True), path)
    assert query(path, "SELECT DISTINCT aspect, slope FROM tin") == [(None, 0.0)]


def test_nulls_of_some_rows_stay_theirs_over_several_batches(path, monkeypatch):
    monkeypatch.setattr(arrow, "_ROWS", 50)
    tin = grid_tin()
    tin.triangle_errors[[0, 49, 50, 77]] = np.nan
    write(tin, path)
    null = query(path, "SELECT fid - 1 FROM tin WHERE max_error IS NULL")
    assert null == [(0,), (49,), (50,), (77,)]
    assert_array_equal(pyogrio.read_dataframe(path)["max_error"], tin.triangle_errors)


def test_the_size_of_the_batches_shows_nowhere(path, monkeypatch):
    tin = grid_tin()
    write(tin, path)
    whole = query(path, "SELECT * FROM tin")
    monkeypatch.setattr(arrow, "_ROWS", 7)
    write(tin, path, overwrite=True)
    assert query(path, "SELECT * FROM tin") == whole


@pytest.mark.parametrize("error", [MemoryError, KeyboardInterrupt])
@pytest.mark.parametrize("row", [0, 100])
def test_what_stops_a_batch_comes_through(path, monkeypatch, error, row):
    def failing(tin, rows):
        if rows.stop > row:
            raise error
        return attributes(tin, rows)

    monkeypatch.setattr(arrow, "_ROWS", 50)
    monkeypatch.setattr(gpkg, "attributes", failing)
    with pytest.raises(error):
        write(grid_tin(), path)
    assert not list(path.parent.iterdir())


def test_batches_that_were_read_take_no_memory(path, monkeypatch):
    alive = []

    def watched(tin, rows):
        made = attributes(tin, rows)
        alive.append(weakref.ref(made["slope"]))
        assert sum(column() is not None for column in alive) <= 2
        return made

    monkeypatch.setattr(arrow, "_ROWS", 20)
    monkeypatch.setattr(gpkg, "attributes", watched)
    write(grid_tin(), path)
    assert len(alive) > 10


def test_without_a_crs_the_layer_is_undefined_cartesian(path):
    write(grid_tin(), path)
    assert query(path, "SELECT srs_id FROM gpkg_contents") == [(-1,)]
    assert query(path, "SELECT srs_id FROM gpkg_geometry_columns") == [(-1,)]
    ((description,),) = query(path, "SELECT description FROM gpkg_contents")
    assert description.endswith("areas in square map unit")


def test_a_crs_without_a_code_goes_by_its_wkt(path):
    write(grid_tin(crs=FakeCRS(ALBERS, name="Homemade Albers")), path)
    kept = geopandas.read_file(path).crs
    assert kept.name == "Homemade Albers"
    assert kept.equals(pyproj.CRS(ALBERS), ignore_axis_order=True)


@pytest.mark.parametrize("code", ["EPSG:4326", "EPSG:2227", "ESRI:102001", "EPSG:5498", "EPSG:4979"])
def test_other_crs_are_kept(path, code):
    transform = (0.01, 0, -84.0, 0, -0.01, 36.0)
    tin = grid_tin(crs=crs(code), transform=transform)
    write(tin, path)
    kept = geopandas.read_file(path)
    assert kept.crs == pyproj.CRS(code)
    assert_array_equal(shapely.get_coordinates(kept.geometry[0])[:3], tin.vertices[tin.triangles[0], :2])


@pytest.mark.parametrize("transform", [(30, 0, 5, 0, 30, 7), (20, 12, 5, 9, -25, 7), (-30, 0, 5, 0, -30, 7)])
def test_any_grid_gives_counter_clockwise_polygons(path, transform):
    write(grid_tin(transform=transform), path)
    frame = geopandas.read_file(path)
    assert shapely.is_ccw(shapely.get_exterior_ring(frame.geometry)).all()
    assert frame["area_2d"].to_numpy() == pytest.approx(frame.area.to_numpy())


@pytest.mark.parametrize(
    "name", ["a b.gpkg", "a;b#c?d.gpkg", "wow!.gpkg", "höhe.GPKG", "zip:x.gpkg", "-n.gpkg"]
)
def test_no_character_of_a_name_means_something(tmp_path, name):
    directory = tmp_path / "dir ;#&%20 é"
    directory.mkdir()
    write(grid_tin(), directory / name)
    assert [path.name for path in directory.iterdir()] == [name]


def test_a_directory_that_pyogrio_cannot_name(tmp_path):
    directory = tmp_path / "wow!"
    directory.mkdir()
    with pytest.raises(OutputError, match="directory's name") as caught:
        write(grid_tin(), directory / "out.gpkg")
    assert caught.value.code == "write-failed"
    assert not list(directory.iterdir())


def test_an_old_journal_does_not_corrupt_the_new_database(path):
    write(grid_tin(5, 5), path)
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("UPDATE gpkg_contents SET description = 'old'")
    database.commit()
    assert path.with_name("out.gpkg-wal").stat().st_size > 0
    write(grid_tin(), path, overwrite=True)
    database.close()
    assert not re.findall("-wal|-shm", " ".join(file.name for file in path.parent.iterdir()))
    assert query(path, "PRAGMA integrity_check") == [("ok",)]
    assert query(path, "SELECT count(*) FROM gpkg_contents WHERE description = 'old'") == [(0,)]


def test_a_name_that_is_not_unicode(path):
    tin = grid_tin()
    tin.name = "h\udcffhe"
    write(tin, path)
    assert "TIN of h?he" in query(path, "SELECT description FROM gpkg_contents")[0][0]


def test_wkb_is_what_shapely_reads():
    tin = grid_tin()
    polygons = shapely.from_wkb([item.item() for item in gpkg.polygons_wkb(tin)])
    assert shapely.equals_exact(polygons, shapely.polygons(tin.vertices[tin.triangles])).all()


def voids(**settings):
    z = np.add.outer(np.arange(40.0), np.arange(30.0) ** 1.5)
    z[10:20, 8:15] = np.nan
    z[:, 22:24] = np.nan
    dem = package.DEM(z, transform=UTM, name="hills", **settings)
    return package.triangulate(dem, max_points=200)


def test_the_outline_is_what_the_triangles_cover(path):
    mesh = voids(crs="EPSG:26710")
    formats.write_outline(mesh, path)
    frame = geopandas.read_file(path, layer="outline")
    assert frame.crs == pyproj.CRS("EPSG:26710")
    assert sorted(len(polygon.interiors) for polygon in frame.geometry) == [0, 1]
    assert shapely.is_valid(frame.geometry).all()
    assert shapely.is_ccw(shapely.get_exterior_ring(frame.geometry)).all()
    assert not shapely.has_z(frame.geometry).any()
    assert frame.area.sum() == pytest.approx(attributes(mesh)["area_2d"].sum(), rel=1e-9)
    assert query(path, "PRAGMA user_version") == [(10300,)]
    assert query(path, "SELECT table_name, srs_id, description FROM gpkg_contents") == [
        ("outline", 26710, "outline of the TIN of hills")
    ]
    assert query(path, "SELECT geometry_type_name, z, m FROM gpkg_geometry_columns") == [("POLYGON", 0, 0)]
    assert query(path, "SELECT count(*) FROM rtree_outline_geom") == [(2,)]
    with fiona.open(path) as layer:
        assert layer.schema["geometry"] == "Polygon"


def test_an_outline_without_a_crs_and_one_in_the_way(path):
    mesh = voids()
    formats.write_outline(mesh, path)
    assert query(path, "SELECT srs_id FROM gpkg_contents") == [(-1,)]
    before = path.read_bytes()
    with pytest.raises(OutputError) as caught:
        formats.write_outline(mesh, path)
    assert caught.value.code == "exists"
    assert path.read_bytes() == before
    formats.write_outline(mesh, path, overwrite=True)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_an_outline_is_a_geopackage(tmp_path):
    with pytest.raises(OutputError) as caught:
        formats.write_outline(voids(), tmp_path / "outline.shp")
    assert caught.value.code == "unknown-suffix"
    assert ".gpkg" in str(caught.value)


@pytest.mark.parametrize(
    ("outputs", "name", "code"),
    [
        ([], "o.tif", "unknown-suffix"),
        (["o.gpkg"], "o.gpkg", "duplicate-output"),
        ([], "no/o.gpkg", "no-directory"),
        ([], "in.gpkg", "same-as-input"),
        ([], "old.gpkg", "exists"),
    ],
)
def test_an_outline_is_checked_before_the_work(tmp_path, outputs, name, code):
    (tmp_path / "old.gpkg").touch()
    with pytest.raises(OutputError) as caught:
        formats.check_outputs(
            [tmp_path / output for output in outputs],
            inputs=[tmp_path / "in.gpkg"],
            outline=tmp_path / name,
        )
    assert caught.value.code == code
