from __future__ import annotations

import re

import pytest
from terrain import hills

import tin
from tin import units
from tin.crs import CRS


@pytest.mark.parametrize(
    ("code", "vertical", "words"),
    [
        ("EPSG:4326", "metre", ["degrees", "--to-crs utm"]),
        ("EPSG:4326", "", ["degrees", "an unknown unit", "--to-crs utm"]),
        ("EPSG:4326", "foot", ["--to-crs utm", "--z-factor 0.3048 "]),
        ("EPSG:26710", "foot", ["--z-factor 0.3048 puts the heights in metre"]),
        ("EPSG:26710", "US survey foot", ["--z-factor 0.3048006096 "]),
        ("EPSG:2227", "metre", ["--z-factor 3.280833333 puts the heights in US survey foot", "--to-crs utm"]),
        ("EPSG:2256", "metre", ["--z-factor 3.280839895 puts the heights in foot", "--to-crs utm"]),
        ("EPSG:2256", "foot", ["take them for metres", "--to-crs utm", "--z-factor 0.3048 "]),
        ("EPSG:2227", "foot", ["take them for metres"]),
        ("EPSG:2227", "", ["take them for metres", "an unknown unit"]),
    ],
)
def test_it_says_what_is_wrong_and_what_to_do(code, vertical, words):
    message = units.warning(CRS.parse(code), vertical)
    assert message is not None
    assert "\n" not in message
    for word in words:
        assert word in message + " "


@pytest.mark.parametrize(("code", "vertical"), [("EPSG:26710", "metre"), ("EPSG:26710", ""), (None, "foot")])
def test_nothing_to_say(code, vertical):
    assert units.warning(CRS.parse(code), vertical) is None


@pytest.mark.parametrize("code", ["EPSG:26710", "EPSG:2227", "EPSG:2256"])
@pytest.mark.parametrize("vertical", ["metre", "foot", "US survey foot"])
@pytest.mark.parametrize("given", [1.0, 3.280839895])
def test_its_factors_are_understood(code, vertical, given):
    crs = CRS.parse(code)
    source = tin.DEM(hills(4, 4), crs=crs, vertical_unit=vertical)
    read = source.scaled(given)
    advice = re.search(r"--z-factor (\S+)", units.warning(crs, read.vertical_unit, given) or "")
    if advice:
        again = source.scaled(float(advice[1]))
        assert again.vertical_unit in ("metre", crs.unit_name)
