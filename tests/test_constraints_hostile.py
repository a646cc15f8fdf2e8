"""Constraints that cross, repeat, touch or make no sense, a million of them, and any mixture on tiny DEMs."""

from __future__ import annotations

import time

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, box
from terrain import hills
from test_constraints import LATTICE, ONE_TO_ONE, Z, dem, is_followed, mesh_of, with_voids

import tin
from tin import features
from tin.errors import InputError

DOCUMENTED = {"no-area", "clip-outside"}


def heights_at(mesh, places):
    heights = {tuple(p): z for p, z in zip(mesh.pixels.tolist(), mesh.vertices[:, 2].tolist())}
    return [heights[tuple(place)] for place in places]


def test_crossing_lines_meet_in_one_vertex():
    lines = [[(5, 5, 0), (70, 50, 100)], [(5, 50, 50), (70, 5, 60)]]
    mesh = mesh_of(breaklines=lines)
    assert all(is_followed(mesh, line) for line in lines)
    distance = np.hypot(*(mesh.pixels - (37.5, 27.5)).T)
    assert distance.min() <= 2 * LATTICE
    assert mesh.vertices[distance.argmin(), 2] == pytest.approx((50 + 55) / 2, abs=0.1)


CROWDS = {
    "twice": [[(5, 5, 0), (70, 50, 100)]] * 2,
    "there and back": [[(5, 5, 0), (70, 50, 100), (5, 5, 0)]],
    "nearly the same": [[(5, 5 + k / 300), (70, 50 - k / 300)] for k in range(40)],
    "along the outline": [[(0, 0), (79, 0), (79, 59), (0, 59), (0, 0)]],
    "beside the outline": [[(0, k / 256), (79, k / 256)] for k in range(6)],
    "ends on another": [[(5, 5), (70, 50)], [(37.5, 27.5), (60, 5)], [(20.123, 5), (20.123, 15.47)]],
    "closed": [[(5, 5, 1), (40, 8, 2), (30, 40, 3), (5, 5, 1)]],
    "crosses itself": [[(5, 5), (70, 50), (70, 5), (5, 50), (30, 2)]],
    "star": [
        [(40 - 30 * c, 30 - 25 * s), (40 + 30 * c, 30 + 25 * s)]
        for c, s in ((np.cos(a), np.sin(a)) for a in np.linspace(0, np.pi, 50, endpoint=False))
    ],
    "from outside": [[(-50.3, -20.7), (130.1, 80.9)]],
    "tiny": [[(5 + k / 1000, 5), (5.001 + k / 1000, 5.001)] for k in range(500)],
}


@pytest.mark.parametrize("name", CROWDS)
@pytest.mark.parametrize("has_voids", [False, True])
def test_lines_that_get_into_each_others_way(name, has_voids):
    source = with_voids() if has_voids else dem()
    mesh = mesh_of(source, breaklines=CROWDS[name])
    if name not in ("nearly the same", "beside the outline", "tiny") and not has_voids:
        inside = box(0, 0, 79, 59)
        for line in CROWDS[name]:
            shape = shapely.intersection(shapely.force_2d(LineString(line)), inside)
            parts = [shape] if shape.is_simple and shape.geom_type == "LineString" else []
            assert all(is_followed(mesh, part.coords) for part in parts)


def test_lines_through_voids_end_at_their_shores():
    lines = [[(3, 25, 7), (75, 25, 7)], [(35, 22), (45, 27)]]
    mesh = mesh_of(with_voids(), breaklines=lines, outline_tolerance="0px")
    grid = mesh.rasterize()
    assert np.isnan(grid[25, 31:49]).all()
    np.testing.assert_allclose(grid[25, np.r_[3:30, 50:76]], 7)
    assert is_followed(mesh, [(3, 25), (29, 25)]) and is_followed(mesh, [(50, 25), (75, 25)])


def test_coordinates_that_are_no_numbers_cut_a_line():
    mesh = mesh_of(breaklines=[[(5, 5), (9, 9), (np.nan, 3), (20, 20), (30, 25), (np.inf, 1), (40, 40)]])
    assert is_followed(mesh, [(5, 5), (9, 9)]) and is_followed(mesh, [(20, 20), (30, 25)])
    assert not is_followed(mesh, [(9, 9), (20, 20)])
    assert not is_followed(mesh, [(30, 25), (30, 25), (5, 5)])
    assert len(mesh_of(points=[(np.nan, 1, 5), (3, 3, 5)]).report.warnings) == 0


@pytest.mark.parametrize("spot", [(10.3, 10.4, 7.0), (10.3, 10.4)])
def test_a_hundred_thousand_points_on_one_place_are_one(spot):
    many = mesh_of(points=np.tile([spot], (100_000, 1)))
    one = mesh_of(points=[spot])
    assert (many.vertices == one.vertices).all()
    line = [spot, (20.0, 20.0, 9.0)[: len(spot)]]
    lines = mesh_of(breaklines=[line] * 10_000)
    assert (lines.vertices == mesh_of(breaklines=line).vertices).all()


@pytest.mark.parametrize("options", [{"outline_tolerance": "3px"}, {"sieve": 2}])
def test_a_point_in_a_void_that_the_tin_covers_leaves_it_whole(options):
    z = np.zeros((5, 6))
    z[(3, 5) if "outline_tolerance" in options else (2, 2)] = np.nan
    point = (5, 3) if "outline_tolerance" in options else (2, 2)
    mesh = mesh_of(dem(z), points=[point], **options)
    assert np.isfinite(mesh.vertices).all()


def test_a_vertex_that_no_pixel_determines_has_a_height_like_the_dem():
    mesh = mesh_of(
        dem(np.eye(6)), breaklines=[(0.9, 3.0), (1.0, 0.2)], method="max", fit=True, max_points="30%"
    )
    assert np.abs(mesh.vertices[:, 2]).max() <= 2.0


def test_a_finely_digitised_line_has_heights_like_the_dem():
    share = np.linspace(0, 1, 2000)
    river = np.column_stack([5 + 68 * share, 30 + 20 * np.sin(12 * share)])
    z = Z + np.random.default_rng(0).normal(size=Z.shape)
    heights = mesh_of(dem(z), breaklines=river).vertices[:, 2]
    assert z.min() - np.ptp(z) <= heights.min() <= heights.max() <= z.max() + np.ptp(z)


def test_of_two_heights_at_one_place_the_first_counts():
    assert heights_at(mesh_of(points=[(9, 9, 5.0), (9, 9, 900.0)]), [(9, 9)]) == [5.0]


def spiral(count):
    share = np.linspace(0, 1, count)
    return np.column_stack([500 + 480 * share * f(80 * np.pi * share) for f in (np.cos, np.sin)])


def walk(count):
    steps = np.random.default_rng(0).normal(size=(count, 2))
    folded = np.mod(500 + np.cumsum(steps, axis=0), 2 * 990)
    return 5 + np.where(folded > 990, 2 * 990 - folded, folded)


@pytest.mark.parametrize(("path", "count"), [(spiral, 1_000_000), (walk, 300_000)])
def test_a_line_of_a_million_vertices(path, count, record_property):
    source = dem(hills(1000, 1000))
    line = path(count)  # a walk of a million takes 35 s
    start = time.perf_counter()
    mesh = mesh_of(source, breaklines=line, max_points=50_000)
    record_property("seconds", round(time.perf_counter() - start, 1))
    ends = np.rint(line[[0, -1]] / LATTICE) * LATTICE
    distance = [np.hypot(*(mesh.pixels - end).T).min() for end in ends]
    assert max(distance) <= LATTICE
    assert mesh.report.errors.uncovered == 0


def some_constraints(random, cols, rows):
    """Any mixture, as likely on whole pixels, on the lattice, anywhere or beyond the border."""

    def places(count):
        kind = random.integers(4)
        grid = random.integers((0, 0), (cols, rows), (count, 2))
        if kind == 0:
            return grid.astype(float)
        if kind == 1:  # crowded together
            return grid[:1] + random.integers(-3, 4, (count, 2)) / 256
        return random.uniform((-1, -1), (cols, rows), (count, 2)) * (1 if kind == 2 else 1.5)

    def with_heights(xy):
        z = random.integers(-50, 50, (len(xy), 1)) * random.choice([1.0, 0.37, 1e6])
        z[random.random(len(xy)) < random.choice([0.0, 0.3, 1.0])] = np.nan
        return np.column_stack([xy, z])

    made = {}
    if random.random() < 0.7:
        made["breaklines"] = [
            with_heights(places(random.integers(2, 8))) for _ in range(random.integers(1, 5))
        ]
    if random.random() < 0.6:
        made["points"] = with_heights(places(random.integers(1, 9)))
    if random.random() < 0.3:
        made["clip"] = [places(random.integers(3, 9)) for _ in range(random.integers(1, 3))]
    if random.random() < 0.4:
        rings = [places(random.integers(3, 9)) for _ in range(random.integers(1, 4))]
        made["flat"] = [np.column_stack([r, np.full(len(r), random.choice([np.nan, 5.0]))]) for r in rings]
    return made


@settings(max_examples=2000, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.binary(min_size=6, max_size=6))
def test_any_mixture_gives_a_sound_mesh_with_the_heights_given(data):
    random = np.random.default_rng(list(data))
    rows, cols = random.integers(2, 9, 2)
    z = random.integers(0, 256, (rows, cols)).astype(float)
    z[random.random(z.shape) < random.choice([0.0, 0.1, 0.4])] = np.nan
    if np.isnan(z).all():
        return
    given_ones = some_constraints(random, cols, rows)
    options = {"method": str(random.choice(["auto", "median", "max"]))}
    options |= [{"max_points": "50%"}, {"tolerance": 2.0}, {"max_points": 4}][random.integers(3)]
    options["outline_tolerance"] = str(random.choice(["0px", "1px", "3px"]))
    options["keep_isolated"] = bool(random.integers(2))
    options["sieve"] = int(random.integers(4))
    spots = given_ones.get("points", np.empty((0, 3)))
    nearest = np.rint(np.clip(spots[:, :2], 0, (cols - 1, rows - 1))).astype(int)
    spots = spots[~np.isnan(spots[:, 2]) | ~np.isnan(z[nearest[:, 1], nearest[:, 0]])]
    given_ones["points"] = spots
    try:
        mesh = tin.triangulate(dem(z, transform=ONE_TO_ONE), **options, **given_ones)
    except InputError as error:
        assert error.code in DOCUMENTED, error
        return
    mesh.check()
    assert np.isfinite(mesh.vertices).all()
    heights = {tuple(p): z for p, z in zip(mesh.pixels.tolist(), mesh.vertices[:, 2].tolist())}
    first = {}
    lines = features.lines(given_ones.get("breaklines", []), None)
    for col, row, height in np.concatenate([spots, *lines]):
        place = tuple((np.rint(np.array([col, row]) / LATTICE) * LATTICE).tolist())
        # On the border, the height at which a line is cut off may have come before.
        if not np.isnan(height) and 0 < place[0] < cols - 1 and 0 < place[1] < rows - 1:
            first.setdefault(place, height)
    lakes = [shapely.make_valid(shapely.Polygon(ring[:, :2])) for ring in given_ones.get("flat", [])]
    shores = shapely.union_all(lakes)
    for place, height in first.items():
        # A vertex in a void is none of the TIN's; in a lake it is at the lake's level.
        if place in heights and not shapely.dwithin(shores, shapely.Point(place), 6 * LATTICE):
            assert heights[place] == height
