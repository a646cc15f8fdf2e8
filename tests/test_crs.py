import importlib
import subprocess
import sys

import pytest
from rasterio.crs import CRS as RasterioCRS

from tin.crs import CRS, length_of_unit, unit_name, unit_of_length
from tin.errors import InputError

VERSIONS = ["WKT1_GDAL", "WKT1_ESRI", "WKT2_2015", "WKT2_2019"]


def wkt(definition, version="WKT2_2019"):
    return RasterioCRS.from_user_input(definition).to_wkt(version=version)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    ("code", "geographic", "unit", "factor"),
    [
        ("EPSG:26710", False, "metre", 1.0),
        ("EPSG:2227", False, "US survey foot", 1200 / 3937),
        ("EPSG:2256", False, "foot", 0.3048),
        ("EPSG:4326", True, "degree", 1.0),
        ("EPSG:4269", True, "degree", 1.0),
    ],
)
def test_facts_are_the_same_whatever_the_wkt_version(code, version, geographic, unit, factor):
    crs = CRS.from_wkt(wkt(code, version))
    assert (crs.is_geographic, crs.unit_name) == (geographic, unit)
    assert crs.unit_factor == pytest.approx(factor, rel=1e-12)
    assert crs.code in ((None, code) if version == "WKT1_ESRI" else (code,))
    assert crs.vertical_unit == ""


def test_name_code_and_text_of_the_st_helens_crs():
    crs = CRS.parse("EPSG:26710")
    assert (crs.name, crs.code, str(crs)) == ("NAD27 / UTM zone 10N", "EPSG:26710", "EPSG:26710")
    assert crs.horizontal is crs


def test_a_crs_without_a_code_prints_its_name():
    crs = CRS.from_wkt('LOCAL_CS["site grid",UNIT["foot",0.3048]]')
    assert (crs.code, str(crs), crs.unit_name, crs.unit_factor) == (None, "site grid", "foot", 0.3048)


def test_esri_flavoured_definition_gets_its_epsg_code_back():
    crs = CRS.from_rasterio(RasterioCRS.from_wkt(wkt("EPSG:26710", "WKT1_ESRI")))
    assert crs.code == "EPSG:26710"


@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT2_2015", "WKT2_2019"])
@pytest.mark.parametrize(
    ("definition", "unit", "vertical"),
    [
        ("EPSG:26910+5703", "metre", "metre"),
        ("EPSG:26910+6360", "metre", "US survey foot"),
        ("EPSG:2227+8228", "US survey foot", "foot"),
        ("EPSG:4326+5773", "degree", "metre"),
    ],
)
def test_compound_crs_gives_its_vertical_unit(definition, unit, vertical, version):
    crs = CRS.from_wkt(wkt(definition, version))
    assert (crs.unit_name, crs.vertical_unit) == (unit, vertical)
    assert "VERT" in crs.wkt


@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT2_2019"])
def test_horizontal_part_of_a_compound_crs(version):
    compound = CRS.from_wkt(wkt("EPSG:26910+5703", version))
    assert compound.horizontal.code == "EPSG:26910"
    assert compound.horizontal.vertical_unit == ""
    assert RasterioCRS.from_user_input(compound.horizontal).to_epsg() == 26910


def test_three_dimensional_geographic_crs():
    crs = CRS.parse("EPSG:4979")
    assert (crs.is_geographic, crs.vertical_unit) == (True, "metre")


def test_geocentric_crs_is_not_geographic():
    assert not CRS.parse("EPSG:4978").is_geographic


def test_bound_crs_is_seen_through():
    bound = RasterioCRS.from_string("+proj=utm +zone=10 +ellps=clrk66 +towgs84=-8,160,176 +units=us-ft")
    crs = CRS.from_rasterio(bound)
    assert "BOUNDCRS" in crs.wkt
    assert (crs.is_geographic, crs.unit_name) == (False, "US survey foot")


def test_derived_geographic_crs_is_geographic():
    rotated = RasterioCRS.from_string("+proj=ob_tran +o_proj=longlat +o_lon_p=0 +o_lat_p=30 +datum=WGS84")
    assert CRS.from_rasterio(rotated).is_geographic


def test_other_libraries_take_it_as_it_is():
    pyproj = importlib.import_module("pyproj")
    crs = CRS.parse("EPSG:26710")
    assert RasterioCRS.from_user_input(crs).to_epsg() == 26710
    assert pyproj.CRS.from_user_input(crs).to_epsg() == 26710
    assert CRS.parse(pyproj.CRS(26710)) == crs
    assert CRS.parse(RasterioCRS.from_epsg(26710)) == crs
    assert CRS.parse(crs) is crs
    assert CRS.parse(None) is None


@pytest.mark.parametrize(
    "broken", ["", "EPSG:999999", "no such thing", 'PROJCS["x"', "]]", 'PROJCS["x",UNIT["y"]]', "a[", 26710]
)
def test_what_is_not_a_crs_is_refused(broken):
    with pytest.raises(InputError) as caught:
        CRS.parse(broken)
    assert caught.value.code == "bad-crs"
    assert "\n" not in str(caught.value)


def test_unit_spellings():
    assert {unit_name(t) for t in ("m", "Metre", "meters")} == {"metre"}
    assert {unit_name(t) for t in ("ft", "FEET", "foot")} == {"foot"}
    assert {unit_name(t) for t in ("us-ft", "ftUS", "US survey foot", "Foot_US")} == {"US survey foot"}
    assert unit_name("") == unit_name("cm") == unit_name("fathom") == ""


def test_the_two_feet_are_told_apart_by_their_length():
    assert [unit_of_length(length_of_unit(u)) for u in ("metre", "foot", "US survey foot")] == [
        "metre",
        "foot",
        "US survey foot",
    ]
    assert unit_of_length(0.304801) == ""
    assert length_of_unit("degree") is None


def test_reading_wkt_needs_no_library():
    code = "import sys; from tin.crs import CRS; CRS.from_wkt(sys.argv[1]); print('rasterio' in sys.modules)"
    command = [sys.executable, "-c", code, wkt("EPSG:26710")]
    assert subprocess.check_output(command, text=True).strip() == "False"
