"""How closely the outline follows the data, and what counts as data, against scipy on masks of every kind."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
import rasterio.warp
from scipy import ndimage
from terrain import hills

import tin
from tin.errors import InputError

TOLERANCES = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)


def mesh_of(valid, tolerance=1.0, **options):
    z = np.where(valid, hills(*valid.shape), np.nan)
    settings = {"method": "max", "max_points": 4, "outline_tolerance": f"{tolerance}px", **options}
    mesh = tin.triangulate(tin.DEM(z), **settings)
    mesh.check()
    return mesh


def in_cells(valid):
    """The valid pixels of 2 x 2 blocks with three valid ones: those that span an area."""
    number = valid.astype(int)
    blocks = number[:-1, :-1] + number[1:, :-1] + number[:-1, 1:] + number[1:, 1:] >= 3
    pixels = np.zeros(valid.shape, bool)
    for rows in (slice(None, -1), slice(1, None)):
        for cols in (slice(None, -1), slice(1, None)):
            pixels[rows, cols] |= blocks
    return pixels & valid


def corners(mesh):
    return sum(len(ring) - 1 for polygon in mesh.outline() for ring in polygon)


def check(valid, tolerance, **options):
    mesh = mesh_of(valid, tolerance, **options)
    covered = np.isfinite(mesh.rasterize())
    needed = in_cells(valid)
    assert not (needed & ~covered).any()
    taken = covered & ~valid
    if tolerance <= 1.0:
        assert not taken.any()
    else:
        assert ndimage.distance_transform_edt(~valid)[taken].max(initial=0.0) <= tolerance + 1e-9
    return mesh


def blobs(random, shape, share, sigma):
    field = ndimage.gaussian_filter(random.normal(size=shape), sigma)
    return field > np.quantile(field, 1 - share)


def some_masks():
    random = np.random.default_rng(1)
    for number in range(120):
        shape = random.integers(2, 40, 2)
        share = random.choice([0.3, 0.5, 0.8, 0.95])
        if number % 2:
            valid = random.random(shape) < share
        else:
            valid = blobs(random, shape, share, random.choice([0.7, 1.5, 4.0]))
        if in_cells(valid).any():
            yield valid


def test_no_data_are_lost_and_no_void_is_taken_in_beyond_the_tolerance():
    count = {tolerance: [] for tolerance in TOLERANCES}
    for valid in some_masks():
        for tolerance in TOLERANCES:
            count[tolerance].append(corners(check(valid, tolerance)))
    means = [np.mean(count[tolerance]) for tolerance in TOLERANCES]
    assert means == sorted(means, reverse=True)
    assert means[-1] < 0.7 * means[0]


def mask(text):
    return np.array([[letter == "#" for letter in line] for line in text.split()])


def disc(radius, side=60):
    row, col = np.mgrid[:side, :side]
    return np.hypot(row - side / 2, col - side / 2) < radius


FIGURES = {
    "checkerboard with a block": (np.indices((20, 21)).sum(axis=0) % 2 == 0) | disc(4, 21)[:20],
    "ring": disc(25) & ~disc(15),
    "thin ring": disc(25) & ~disc(23),
    "disc": disc(28),
    "all but a disc": ~disc(20),
    "disc that the border cuts": disc(35),
    "void at all corners": np.abs(np.indices((30, 40)) - np.array([14.5, 19.5])[:, None, None]).sum(axis=0)
    < 26,
    "touching at a corner": mask("###... ###... ###... ...### ...### ...###"),
    "touching holes": mask("######## ######## ##..#### ##..#### ####..## ####..## ######## ########"),
    "hole that touches the border": mask("##..## ##..## ###### ######"),
    "one block": mask("##.. #... .... ...."),
    "comb": mask(
        "####################### ##.##.##.##.##.##.##.## ##.##.##.##.##.##.##.## ##.##.##.##.##.##.##.##"
    ),
    "staircase": np.tri(40, 60, 3, dtype=bool),
    "hairs": mask("##....... #########  ##.......  ##.......  .......## .......## ..#######"),
}


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("name", FIGURES)
def test_figures(name, tolerance):
    for turns in range(4):
        check(np.rot90(FIGURES[name], turns), tolerance)


def test_a_smooth_shore_needs_fewer_points_with_tolerance():
    # A bay: where the data bulge, every chord cuts some off.
    coarse = [corners(check(~disc(20), tolerance)) for tolerance in TOLERANCES]
    assert coarse == sorted(coarse, reverse=True)
    assert coarse[-1] <= 4 + 10


def test_the_tolerance_is_a_length_on_the_ground():
    z = np.where(~disc(28), hills(60, 60), np.nan)
    source = tin.DEM(z, transform=(30.0, 0.0, 0.0, 0.0, -30.0, 0.0))
    options = {"method": "max", "max_points": 4}
    ground = tin.triangulate(source, outline_tolerance=90, **options)
    pixels = tin.triangulate(source, outline_tolerance="3px", **options)
    assert (ground.vertices == pixels.vertices).all()
    # It holds in every direction of pixels that are no squares.
    source = tin.DEM(z, transform=(30.0, 0.0, 0.0, 0.0, -60.0, 0.0))
    narrow = tin.triangulate(source, outline_tolerance=180, **options)
    taken = np.isfinite(narrow.rasterize()) & np.isnan(z)
    assert taken.any()
    assert ndimage.distance_transform_edt(np.isnan(z), sampling=(60.0, 30.0))[taken].max() <= 180


@pytest.mark.parametrize("share", [0.02, 0.1, 0.3, 0.5, 0.9])
def test_keep_isolated_covers_every_valid_pixel(share):
    random = np.random.default_rng(4)
    for _ in range(20):
        valid = random.random(random.integers(2, 30, 2)) < share
        if not valid.any():
            continue
        for tolerance in (0.0, 1.0, 3.0):
            mesh = mesh_of(valid, tolerance, keep_isolated=True)
            covered = np.isfinite(mesh.rasterize())
            assert covered[valid].all()
            if tolerance <= 1.0:
                assert (covered == valid).all()
            assert np.isfinite(mesh.vertices).all()


def test_single_pixels_are_islands_only_where_asked():
    valid = mask("#.... ..... ..#.. ..... ####.")
    with pytest.raises(InputError) as caught:
        mesh_of(valid)
    assert caught.value.code == "no-area"
    mesh = mesh_of(valid, keep_isolated=True)
    assert len(mesh.outline()) >= 3
    assert (np.isfinite(mesh.rasterize()) == valid).all()


def sieved(valid, least):
    islands, _ = ndimage.label(valid)
    valid = valid & (np.bincount(islands.ravel()) >= least)[islands]
    holes, _ = ndimage.label(~valid, structure=np.ones((3, 3)))
    border = np.concatenate([holes[0], holes[-1], holes[:, 0], holes[:, -1]])
    size = np.bincount(holes.ravel())
    is_filled = size < least
    is_filled[border] = False
    is_filled[0] = False
    return valid | is_filled[holes]


@pytest.mark.parametrize("least", [0, 1, 2, 3, 5, 20, 1000])
def test_sieve_against_labelled_islands_and_holes(least):
    random = np.random.default_rng(6)
    for number in range(60):
        shape = random.integers(3, 40, 2)
        valid = random.random(shape) < 0.8 if number % 2 else blobs(random, shape, 0.6, 1.0)
        wanted = sieved(valid, least)
        if not in_cells(wanted).any():
            with pytest.raises(InputError) as caught:
                mesh_of(valid, 0.0, sieve=least)
            assert caught.value.code == "no-area"
            continue
        covered = np.isfinite(mesh_of(valid, 0.0, sieve=least).rasterize())
        assert (covered == np.isfinite(mesh_of(wanted, 0.0).rasterize())).all()


@pytest.mark.parametrize("angle", [20.0, 33.0, 71.3])
def test_a_raster_that_was_turned_has_a_clean_border(angle):
    height, width = 300, 400
    source = rasterio.Affine(10.0, 0.0, 5e5, 0.0, -10.0, 5e6)
    turned = source * rasterio.Affine.rotation(angle, pivot=(width / 2, height / 2))
    turned = turned * rasterio.Affine.translation(-100, -100)
    z = np.full((height + 200, width + 200), np.nan)
    rasterio.warp.reproject(
        hills(height, width),
        z,
        src_transform=source,
        dst_transform=turned,
        src_crs="EPSG:32610",
        dst_crs="EPSG:32610",
        dst_nodata=np.nan,
        resampling=rasterio.warp.Resampling.bilinear,
    )
    valid = np.isfinite(z)
    assert 0.3 < valid.mean() < 0.7
    exact = corners(mesh_of(valid, 0.0))
    mesh = check(valid, 1.0, max_points=2000)
    assert corners(mesh) < 0.25 * exact
    assert (np.isfinite(mesh.rasterize()) == valid).all() or (in_cells(valid) != valid).any()
    assert corners(check(valid, 2.0)) <= corners(mesh_of(valid, 1.0))


@pytest.mark.parametrize("value", ["-1", "nan", "101px", "x"])
def test_a_tolerance_out_of_bounds_is_refused(value):
    with pytest.raises(tin.OptionError) as caught:
        mesh_of(disc(20), outline_tolerance=value)
    assert caught.value.code == "bad-option"
