"""The options table: one meaning on the command line and in Python."""

from __future__ import annotations

import math

import pytest
from terrain import dem

import tin
from tin import options


@pytest.mark.parametrize(
    ("name", "value", "parsed"),
    [
        ("max_points", "5000", 5000),
        ("max_points", 5000, 5000),
        ("max_points", "2.5%", options.Share(2.5)),
        ("max_points", "Auto", "auto"),
        ("tolerance", "0.5", 0.5),
        ("metric", "median", 0.5),
        ("metric", "MAX", 1.0),
        ("metric", 0.75, 0.75),
        ("scales", "auto", None),
        (
            "scales",
            "3px, 1.5px,0",
            (options.Distance(3, True), options.Distance(1.5, True), options.Distance(0)),
        ),
        ("scales", [90, "2px"], (options.Distance(90), options.Distance(2, True))),
        ("scales", 30.0, (options.Distance(30.0),)),
        ("despike", False, False),
        ("z_factor", "-0.3048", -0.3048),
        ("method", "MEDIAN", "median"),
        ("threads", " Auto", "auto"),
        ("threads", "3", 3),
        ("to_crs", " UTM", "utm"),
        ("to_crs", "EPSG:26710", tin.CRS.parse("EPSG:26710")),
    ],
)
def test_values_are_understood_as_text_and_as_python(name, value, parsed):
    assert options.BY_NAME[name].read(value) == parsed


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_points", 3),
        ("max_points", "0%"),
        ("max_points", "101%"),
        ("max_points", 4.5),
        ("max_points", "many"),
        ("max_points", True),
        ("tolerance", math.nan),
        ("tolerance", "-1"),
        ("tolerance", "inf"),
        ("tolerance", None.__class__),
        ("metric", 0),
        ("metric", 1.01),
        ("metric", "mean"),
        ("scales", ""),
        ("scales", []),
        ("scales", "1,,2"),
        ("scales", "-1px"),
        ("scales", ",".join(["1"] * 99)),
        ("points_per_scale", 0),
        ("flips", -1),
        ("threads", 0),
        ("threads", 1.5),
        ("threads", "all"),
        ("threads", 10**9),
        ("band", 0),
        ("z_factor", 0),
        ("z_factor", "nan"),
        ("method", "best"),
        ("fit", "yes please"),
        ("to_crs", "EPSG:999999"),
        ("to_crs", "UTM10"),
        ("to_crs", 26710),
    ],
)
def test_nonsense_is_refused_by_name(name, value):
    with pytest.raises(tin.OptionError) as caught:
        options.BY_NAME[name].read(value)
    assert caught.value.code == "bad-option"
    assert options.BY_NAME[name].flag in str(caught.value)


def test_unknown_options_are_refused():
    with pytest.raises(tin.OptionError) as caught:
        tin.triangulate(dem(), max_point=5)
    assert caught.value.code == "unknown-option"


def test_a_method_is_a_set_of_defaults():
    source = dem()
    arguments = options.core_arguments({"method": "median"}, source)
    assert (arguments["priority"], arguments["candidate"], arguments["weight"]) == (0.5, 0.5, 0.0)
    assert arguments["bound"] == 0.5
    assert arguments["points_per_scale"] is None
    overridden = options.core_arguments({"method": "max", "fit": True, "metric": "median"}, source)
    assert overridden["fit"] is True
    assert overridden["priority"] == 0.5
    assert overridden["candidate"] == 1.0


def test_points_default_to_five_percent_and_to_no_limit_with_a_tolerance():
    source = dem(100, 100)
    assert options.core_arguments({}, source)["max_points"] == 500
    assert options.core_arguments({"tolerance": 1.0}, source)["max_points"] is None
    assert options.core_arguments({"tolerance": 1.0, "max_points": "1%"}, source)["max_points"] == 100
    auto = options.core_arguments({"max_points": "auto"}, source)
    assert auto["max_points"] is None
    assert auto["stop_at_noise"] is True


def test_threads_are_all_there_are_unless_told_otherwise():
    assert options.core_arguments({}, dem())["threads"] is None
    assert options.core_arguments({"threads": "auto"}, dem())["threads"] is None
    assert options.core_arguments({"threads": 3}, dem())["threads"] == 3


def test_scales_take_ground_units():
    wide = dem(transform=(30.0, 0.0, 0.0, 0.0, -10.0, 0.0))
    assert options.core_arguments({"scales": 60}, wide)["scales"] == [(2.0, 6.0)]
    feet = dem(transform=(30.0, 0.0, 0.0, 0.0, -30.0, 0.0), crs="EPSG:2263")
    assert options.core_arguments({"scales": 60}, feet)["scales"] == [pytest.approx((2.0, 2.0))]
    degrees = dem(transform=(1 / 3600, 0.0, -84.0, 0.0, -1 / 3600, 36.0), crs="EPSG:4326")
    along_x, along_y = options.core_arguments({"scales": 60}, degrees)["scales"][0]
    assert along_y == pytest.approx(60 / (111_320 / 3600), rel=1e-6)
    assert along_x == pytest.approx(along_y / math.cos(math.radians(36)), rel=1e-3)


def test_every_option_is_documented():
    for option in options.OPTIONS:
        assert option.help
        assert option.group in {"method", "constraints", "input", "output"}
        assert option.is_flag or option.choices or option.metavar
        if option.default is not None:
            assert option.read(option.default) == option.default
