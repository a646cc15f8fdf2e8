"""What holds for every DEM, on ten thousand tiny ones each: few pixels, many voids, many ties."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tin

METHODS = ("auto", "median", "max")
LIMITS = ({"max_points": "50%"}, {"tolerance": 2.0}, {"max_points": "auto"}, {"max_points": 6})
TRANSFORM = (2.0, 0.0, 500.0, 0.0, -3.0, 700.0)
SIDE = 7

thorough = settings(
    max_examples=10_000, deadline=None, suppress_health_check=[HealthCheck.too_slow], database=None
)


class Case(NamedTuple):
    z: np.ndarray
    valid: np.ndarray
    options: dict
    number: int
    """Anything from 0 to 65535, for what a property varies."""


def case_of(data: bytes) -> Case:
    rows, cols, method, limit, share, ties, low, high = data[:8]
    shape = 2 + rows % (SIDE - 1), 2 + cols % (SIDE - 1)
    random = np.random.default_rng(list(data[8:]))
    z, cover = random.integers(0, 256, (2, *shape), np.uint8)
    valid = cover >= share
    valid[:2, :2] = True  # so that there is a surface
    options = {"method": METHODS[method % 3], **LIMITS[limit % 4]}
    return Case((z & (1, 3, 15, 255)[ties % 4]).astype(np.float64), valid, options, low + 256 * high)


# One short draw an example: element by element, ten thousand arrays would take minutes.
cases = st.binary(min_size=11, max_size=11).map(case_of)


def mesh_of(z: np.ndarray, case: Case, transform: tuple = TRANSFORM, **options: object) -> tin.Tin:
    return tin.triangulate(tin.DEM(z, case.valid, transform), **{**case.options, **options})


def same(first: tin.Tin, second: tin.Tin) -> bool:
    """Whether both are the same but for the map's x and y."""
    return (
        first.triangles.tobytes() == second.triangles.tobytes()
        and first.pixels.tobytes() == second.pixels.tobytes()
        and first.vertices[:, 2].tobytes() == second.vertices[:, 2].tobytes()
        and first.constrained.tobytes() == second.constrained.tobytes()
        and first.triangle_errors.tobytes() == second.triangle_errors.tobytes()
        and first.error() == second.error()
    )


@thorough
@given(cases)
def test_where_the_map_has_its_origin_changes_x_and_y_alone(case):
    a, b, c, d, e, f = TRANSFORM
    moved = (a, b, c + 64.0 * case.number, d, e, f - 1e6 * case.number)
    here, there = mesh_of(case.z, case), mesh_of(case.z, case, moved)
    assert same(here, there)
    step = there.vertices[:, :2] - here.vertices[:, :2]
    assert (step == (64.0 * case.number, -1e6 * case.number)).all()


@thorough
@given(cases)
def test_another_unit_of_height_scales_heights_and_errors_exactly(case):
    factor = 2.0 ** (case.number % 61 - 30)
    here = mesh_of(case.z, case)
    scaled = {"tolerance": 2.0 * factor} if "tolerance" in case.options else {}
    there = mesh_of(case.z * factor, case, **scaled)
    assert np.array_equal(there.triangles, here.triangles)
    assert np.array_equal(there.vertices, here.vertices * (1, 1, factor))
    assert np.array_equal(there.triangle_errors, here.triangle_errors * factor)
    assert there.error().rmse == here.error().rmse * factor
    assert there.error().max_error == here.error().max_error * factor


@thorough
@given(cases)
def test_what_lies_under_the_voids_leaves_no_trace(case):
    random = np.random.default_rng(case.number)
    bits = case.z.copy().view(np.uint64)
    void = ~case.valid
    bits[void] = random.integers(0, 2**64, void.sum(), np.uint64)
    clean, dirty = mesh_of(case.z, case), mesh_of(bits.view(np.float64), case)
    assert same(clean, dirty)
    bits[void] |= np.uint64(0x7FF0_0000_0000_0001)  # NaNs of any payload, in place of a mask
    assert same(clean, tin.triangulate(tin.DEM(bits.view(np.float64), None, TRANSFORM), **case.options))


@thorough
@given(cases)
def test_the_triangles_fill_their_outline_exactly(case):
    mesh = mesh_of(case.z, case)
    lattice = mesh.pixels * 256  # the core's own units, in which everything is whole
    assert np.array_equal(lattice, np.rint(lattice))
    corners = lattice.astype(np.int64)[mesh.triangles]
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1).reshape(-1, 2).tolist()
    edges = dict(zip(map(tuple, ends), mesh.constrained.ravel().tolist()))
    assert len(edges) == mesh.triangles.size  # no edge is walked twice the same way
    border = [(start, end) for start, end in edges if (end, start) not in edges]
    assert all(edges[edge] for edge in border)
    assert sum(edges.values()) == len(border)  # nothing else is a constraint
    # Against the border, unsigned: a triangle that is turned over or lies on others would not cancel.
    sides = corners[:, 1:] - corners[:, :1]
    doubled = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    assert (doubled > 0).all()
    x, y = lattice.astype(np.int64)[np.array(border)].transpose(2, 1, 0)
    assert doubled.sum() == abs((x[0] * y[1] - x[1] * y[0]).sum())
    if case.valid.all():
        rows, cols = case.z.shape
        assert doubled.sum() == 2 * 256**2 * (rows - 1) * (cols - 1)


@thorough
@given(cases)
def test_a_mirrored_axis_gives_the_same_pixels_turned_over(case):
    a, b, c, d, e, f = TRANSFORM
    mirrored = (a, b, c, d, -e, f) if case.number % 2 else (-a, b, c, d, e, f)
    here, there = mesh_of(case.z, case), mesh_of(case.z, case, mirrored)
    assert np.array_equal(there.triangles, here.triangles[:, ::-1])
    assert np.array_equal(there.constrained, here.constrained[:, [1, 0, 2]])
    assert np.array_equal(there.pixels, here.pixels)
    assert np.array_equal(there.vertices[:, 2], here.vertices[:, 2])


@thorough
@given(cases)
def test_the_raster_has_the_errors_that_are_told(case):
    mesh = mesh_of(case.z, case)
    error = mesh.rasterize() - np.where(case.valid, case.z, np.nan)
    known = np.abs(error[np.isfinite(error)])
    told = mesh.error()
    assert known.size == told.covered == case.valid.sum() - told.uncovered
    assert np.isfinite(mesh.rasterize()).sum() == told.covered
    # A pixel on an edge is of two triangles, which may differ in the last place.
    assert told.max_error == mesh.triangle_errors.max()
    assert known.max() == pytest.approx(told.max_error, rel=1e-12, abs=1e-12)
    assert np.sqrt(np.mean(known**2)) == pytest.approx(told.rmse, rel=1e-12, abs=1e-12)
    assert known.mean() == pytest.approx(told.mae, rel=1e-12, abs=1e-12)
    assert np.count_nonzero(known <= told.p95 * (1 + 1e-6)) >= 0.95 * known.size
    kept = np.abs(error[np.isfinite(error) & ~mesh.spikes])
    without = kept.max() if kept.size else 0.0
    assert mesh.report.max_error_without_spikes == pytest.approx(without, rel=1e-12, abs=1e-12)
