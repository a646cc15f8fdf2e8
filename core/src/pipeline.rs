//! From heights to a mesh: the stages in their order, each a switch of its own.

use crate::beside::{beside_hard_edges, leave_out};
use crate::blend::Blend;
use crate::domain::{domain, Constraints};
use crate::error::{Error, Result};
use crate::fit::Fit;
use crate::flip::flip_pass;
use crate::grid::{largest, Grid, Height};
use crate::image::{is_by_tile, Image, Source};
use crate::ladder::End;
use crate::measure::count_covered;
use crate::memory;
use crate::mesh::{triangle_of, Mesh};
use crate::noise::{noise, spikes, MAX_SAMPLES};
use crate::order::runs;
use crate::outline::Shape;
use crate::predicate::Metric;
use crate::progress::Progress;
use crate::refine::Refiner;
use crate::refinement::Refinement;
use crate::repair::repair;
use crate::rule::{Rule, Stop};
use crate::scale::{choose, gaussian, gaussian_over, noise_left};
use crate::surface::Surface;
use crate::threads::spread;
use crate::tiles::release_seams;
use crate::tiling::Tiling;
use std::borrow::Cow;

/// Which smoothed images are refined, coarse to fine.
#[derive(Clone, Debug, PartialEq)]
pub enum Scales {
    /// One, chosen by Stein's estimate of the risk.
    Auto,
    /// Standard deviations in pixels, [along x, along y]; 0 is the image itself.
    Given(Vec<[f64; 2]>),
}

#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Number of vertices to stop at; the outline alone may need more.
    pub max_points: usize,
    /// Whether that number is one for the whole raster, of which the part inside the
    /// clip polygons gets its share.
    pub is_share: bool,
    /// New vertices at most in each scale; if not given, an even share of all.
    pub points_per_scale: Option<usize>,
    pub rule: Rule,
    /// Whether a tolerance was asked for: 0 is one, too.
    pub has_tolerance: bool,
    /// Also stop where more points would only fit the noise: when no residual on the
    /// smoothed image exceeds three standard deviations of the noise left in it.
    pub stop_at_noise: bool,
    pub scales: Scales,
    pub despike: bool,
    pub fit: bool,
    /// Rounds of error-lowering edge flips, each followed by a fit.
    pub flips: u32,
    pub shape: Shape,
    pub constraints: Constraints,
    /// Side in pixels of the tiles that are refined one by one, 0 for the whole raster at once.
    pub tile: usize,
}

/// What was done on the way.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    pub stop: Stop,
    /// Estimated standard deviation of the noise, after despiking.
    pub noise: f64,
    /// Pixels replaced by despiking, as `row * cols + col`.
    pub spikes: Vec<usize>,
    /// Standard deviations of the scales refined, in pixels.
    pub scales: Vec<[f64; 2]>,
    /// Whether the mesh is (constrained) Delaunay: no error-lowering flips were made.
    pub delaunay: bool,
}

pub struct Triangulation {
    pub surface: Surface,
    pub report: Report,
}

/// The image the mesh is made to follow, after despiking, and its smoothed forms.
struct Images<'a, T: Height> {
    data: Cow<'a, [T]>,
    spikes: Vec<usize>,
    noise: f64,
}

/// Widest smoothing, in pixels: beyond it the convolution takes minutes.
const MAX_SIGMA: f64 = 100.0;

/// Widest tolerance of the outline, in pixels: beyond it its search takes minutes.
const MAX_OUTLINE: f64 = 100.0;

/// Half-edges, six a vertex and numbered by fours, must fit 32 bits.
const MAX_POINTS: usize = 1 << 29;

/// Squares and products of heights must not overflow.
const MAX_HEIGHT: f64 = 1e100;

/// What smoothing may round off a height, as a part of the largest one.
const ROUNDING: f64 = 1e-13;

/// Residuals up to this many standard deviations of the noise are taken for noise.
const SIGNIFICANT: f64 = 3.0;

/// Runs the method. Errors: `too-small`, `too-large`, `no-area`, `clip-outside`,
/// `bad-option`, `cancelled`.
pub fn triangulate<T: Height>(
    grid: &Grid<T>,
    metric: Metric,
    options: &Options,
    progress: &mut Progress,
) -> Result<Triangulation> {
    progress.stage(if options.despike { "despike" } else { "outline" })?;
    let largest = largest(grid.z(), progress)?;
    validate(options, grid, largest)?;
    let rounding = ROUNDING * largest;
    let Images { data: whole, spikes, noise } = prepare(grid, options, progress)?;
    let whole = Grid::new(&whole, grid.rows(), grid.cols())?;
    progress.stage("outline")?;
    let tiling = Tiling::new(grid.rows(), grid.cols(), options.tile);
    let mut surface = domain(&whole, metric, &options.shape, &options.constraints, &tiling, progress)?;
    let mut beside = beside_hard_edges(&surface.mesh, grid.rows(), grid.cols());
    let mut data = Cow::Borrowed(whole.z());
    leave_out(&mut data, &beside);
    if data.iter().all(|z| z.to_f64().is_nan()) {
        // Free vertices need a height from somewhere.
        beside.clear();
        data = Cow::Borrowed(whole.z());
    }
    let data = Grid::new(&data, grid.rows(), grid.cols())?;

    progress.stage("smooth")?;
    let bounded = options.has_tolerance && options.rule.bound == 1.0;
    // An image that is wanted after its refinement is held.
    let is_wanted = bounded || options.rule.is_max() || options.fit || options.flips > 0;
    let by_tile = match &options.scales {
        Scales::Given(sigmas) if !is_wanted && tiling.count() > 1 && is_by_tile(grid.z(), sigmas) => {
            Some(Source { grid: whole, left_out: &beside, tiling: &tiling })
        }
        _ => None,
    };
    let (mut scales, mut finest) = match &options.scales {
        // A bound on the error counts against the data, so nothing is smoothed away.
        Scales::Auto if bounded => (vec![[0.0; 2]], Cow::Borrowed(data.z())),
        Scales::Auto => {
            let smooth = choose(&whole, noise, progress)?;
            (vec![[smooth.sigma; 2]], smooth.z)
        }
        Scales::Given(sigmas) if by_tile.is_some() => (sigmas.clone(), Cow::Borrowed(data.z())),
        Scales::Given(sigmas) => (sigmas.clone(), gaussian(&whole, sigmas[0], progress)?),
    };
    let most = count_limit(&surface.mesh, &whole, options, progress)?;
    // Without the one that a tolerance adds.
    let even = scales.len();
    if bounded && scales.last() != Some(&[0.0; 2]) {
        scales.push([0.0; 2]);
    }

    leave_out(&mut finest, &beside);
    let image = Image::of(Grid::new(&finest, grid.rows(), grid.cols())?, by_tile, scales[0], progress)?;
    surface.sample(&image, progress)?;
    surface.insert_pixels(&options.constraints.pixels, &image, progress)?;
    drop(image);
    let is_too_few = surface.count() > most;
    let mut stop = Stop::Tolerance;
    let first = surface.count();
    let mut refinement = Refinement::new(surface, &tiling)?;
    for (i, &sigma) in scales.iter().enumerate() {
        if i > 0 {
            progress.stage("smooth")?;
            if by_tile.is_none() {
                finest = gaussian_over(&whole, sigma, finest, progress)?;
                leave_out(&mut finest, &beside);
            }
            if bounded && sigma == [0.0; 2] {
                (surface, _) = refinement.finish(false, progress)?;
                surface.sample(&Image::Held(data), progress)?;
                refinement = Refinement::new(surface, &tiling)?;
            }
        }
        let image = Image::of(Grid::new(&finest, grid.rows(), grid.cols())?, by_tile, sigma, progress)?;
        progress.stage("refine")?;
        let end = if i + 1 == scales.len() { End::Level } else { End::Rough };
        let limit = match options.points_per_scale {
            Some(per_scale) => refinement.count().saturating_add(per_scale),
            None if i + 1 >= even => most,
            None => first.saturating_add(most.div_ceil(even) * (i + 1)),
        };
        let limit = most.min(limit);
        let mut rule = options.rule;
        if sigma != [0.0; 2] {
            // Smoothing rounds: without it nothing is known below this.
            rule.tolerance = rule.tolerance.max(rounding);
        }
        if options.stop_at_noise {
            rule.tolerance = rule.tolerance.max(SIGNIFICANT * noise * noise_left(sigma));
        }
        stop = refinement.refine(&image, &rule, (limit, end), progress)?;
    }
    let is_ordered = options.fit || options.flips > 0 || tiling.count() == 1;
    if is_ordered {
        progress.stage("order")?;
    }
    let seams;
    (surface, seams) = refinement.finish(is_ordered, progress)?;
    // Pixels on seams were no candidates, also where a seam runs along another constraint.
    let is_other = |&h: &u32| !surface.mesh.triangle(triangle_of(h)).is_seam((h & 3) as usize);
    let others: Vec<u32> = seams.iter().copied().filter(is_other).map(triangle_of).collect();
    let mut touched = release_seams(&mut surface.mesh, seams);
    if tiling.count() > 1 && (bounded || options.rule.is_max()) {
        touched.extend(others);
        touched.sort_unstable();
        touched.dedup();
        // All points are used up if it is them that end the refinement.
        let tolerance = if stop == Stop::Points { 0.0 } else { options.rule.tolerance };
        let image = Grid::new(&finest, grid.rows(), grid.cols())?;
        let repaired = repair(&mut surface, &image, tolerance, &touched, most, progress)?;
        stop = if stop == Stop::Tolerance { repaired } else { stop };
    }

    let (target, fitted) = if options.fit {
        let sigma = scales[scales.len() - 1];
        let (target, fitted) = fit(&mut surface, &data, finest, noise, sigma, progress)?;
        (target, Some(fitted))
    } else {
        (finest, None)
    };
    let target = Grid::new(&target, grid.rows(), grid.cols())?;
    let delaunay = flip(&mut surface, &target, fitted, options.flips, progress)?;
    if bounded && (options.fit || options.flips > 0) {
        (surface, stop) = restore_bound(surface, &data, &options.rule, most, progress)?;
    }
    stop = match stop {
        _ if is_too_few => Stop::Outline,
        Stop::Tolerance if options.stop_at_noise => Stop::Noise,
        Stop::Tolerance if !options.has_tolerance => Stop::Exact,
        stop => stop,
    };
    let report = Report { stop, noise, spikes, scales, delaunay };
    Ok(Triangulation { surface, report })
}

/// `largest`: of all |heights|.
fn validate<T: Height>(options: &Options, grid: &Grid<T>, largest: f64) -> Result<()> {
    let Rule { priority, weight, candidate, tolerance, bound } = options.rule;
    let quantile = |q: f64| q > 0.0 && q <= 1.0;
    let bad = |message: &str| Err(Error::option("bad-option", message));
    if ![priority, candidate, bound].into_iter().all(quantile) {
        return bad("a quantile must lie in (0, 1]");
    }
    if !(weight.is_finite() && tolerance.is_finite() && tolerance >= 0.0) {
        return bad("the tolerance must be a finite number, 0 or more");
    }
    if !(0.0..=MAX_OUTLINE).contains(&options.shape.tolerance) {
        return bad("the outline's tolerance must lie between 0 and 100 pixels");
    }
    if options.constraints.pixels.iter().any(|&(col, row)| col >= grid.cols() || row >= grid.rows()) {
        return bad("an initial point lies outside the raster");
    }
    if largest > MAX_HEIGHT {
        return Err(Error::input("height-range", "heights beyond 1e100 are no terrain"));
    }
    let Constraints { points, lines, flat, .. } = &options.constraints;
    let heights = points.iter().chain(lines.iter().flatten()).map(|v| v[2]).chain(flat.iter().map(|f| f.1));
    if heights.filter(|z| !z.is_nan()).any(|z| z.abs() > MAX_HEIGHT) {
        return Err(Error::input("height-range", "heights of constraints beyond 1e100 are no terrain"));
    }
    if let Scales::Given(sigmas) = &options.scales {
        if sigmas.is_empty() || !sigmas.iter().flatten().all(|s| (0.0..=MAX_SIGMA).contains(s)) {
            return bad("scales must be given and lie between 0 and 100 pixels");
        }
    }
    Ok(())
}

/// The number of vertices to stop at.
fn count_limit<T: Height>(
    mesh: &Mesh,
    grid: &Grid<T>,
    options: &Options,
    progress: &mut Progress,
) -> Result<usize> {
    let most = options.max_points.min(MAX_POINTS);
    if !options.is_share || options.constraints.clip.is_none() {
        return Ok(most);
    }
    let inside = count_covered(mesh, grid, progress)? as f64 / grid.count_valid() as f64;
    Ok((most as f64 * inside).round() as usize)
}

fn prepare<'a, T: Height>(
    grid: &Grid<'a, T>,
    options: &Options,
    progress: &mut Progress,
) -> Result<Images<'a, T>> {
    let mut data = Cow::Borrowed(grid.z());
    let mut removed = Vec::new();
    // The samples of the noise estimate, while their list grows.
    memory::ensure(24 * grid.z().len().min(MAX_SAMPLES))?;
    let before = if options.despike { noise(grid) } else { 0.0 };
    if options.despike {
        memory::ensure(size_of_val(grid.z()))?;
        for (pixel, z) in spikes(grid, before, progress)? {
            data.to_mut()[pixel] = z;
            removed.push(pixel);
        }
    }
    let is_needed =
        options.stop_at_noise || options.scales == Scales::Auto || options.fit || options.flips > 0;
    let noise = match is_needed {
        false => 0.0,
        true if options.despike && removed.is_empty() => before,
        true => noise(&Grid::new(&data, grid.rows(), grid.cols())?),
    };
    Ok(Images { data, spikes: removed, noise })
}

/// Pixels that are worked on together.
const CHUNK: usize = 1 << 16;

/// Fits the heights to the data, with as much of the smoothed image mixed in as the
/// noise that the mesh would still follow calls for; returns that mixture.
fn fit<'a, T: Height>(
    surface: &mut Surface,
    data: &Grid<'a, T>,
    mut smooth: Cow<'a, [T]>,
    noise: f64,
    sigma: [f64; 2],
    progress: &mut Progress,
) -> Result<(Cow<'a, [T]>, Fit)> {
    progress.stage("fit")?;
    let target = if noise == 0.0 || sigma == [0.0; 2] {
        Cow::Borrowed(data.z())
    } else {
        let share = Blend { data: *data, smooth: &smooth, sigma, noise }.share(surface, progress)?;
        let pixels = smooth.to_mut().chunks_mut(CHUNK).zip(data.z().chunks(CHUNK));
        spread(progress, pixels, |(smooth, data), _| {
            for (smooth, data) in smooth.iter_mut().zip(data) {
                *smooth = T::from_f64(share * smooth.to_f64() + (1.0 - share) * data.to_f64());
            }
            Ok(())
        })?;
        smooth
    };
    let image = Grid::new(&target, data.rows(), data.cols())?;
    let mut fit = Fit::of(surface, &image, progress)?;
    fit.solve(surface, progress)?;
    Ok((target, fit))
}

/// Rounds of flips, and another fit after them if there is one. Returns whether the mesh is as before.
fn flip<T: Height>(
    surface: &mut Surface,
    target: &Grid<T>,
    mut fit: Option<Fit>,
    rounds: u32,
    progress: &mut Progress,
) -> Result<bool> {
    if rounds == 0 {
        return Ok(true);
    }
    progress.stage("flip")?;
    let mut open = vec![true; surface.mesh.triangles().len()];
    let runs = runs(&surface.mesh);
    if let Some(fit) = &mut fit {
        fit.follow(surface, progress)?;
    }
    let mut flips = 0;
    for _ in 0..rounds {
        let count = flip_pass(surface, target, &runs, fit.as_ref(), &mut open, progress)?;
        if count == 0 {
            break;
        }
        flips += count;
        if let Some(fit) = &mut fit {
            fit.renew(surface, target, &open, progress)?;
        }
    }
    if let Some(mut fit) = fit.filter(|_| flips > 0) {
        fit.solve(surface, progress)?;
    }
    Ok(flips == 0)
}

/// Brings every pixel of `data` back within the tolerance: vertices are moved to
/// the edge of their pixel's band, and points are inserted where that is not enough.
fn restore_bound<T: Height>(
    mut surface: Surface,
    data: &Grid<T>,
    rule: &Rule,
    max_points: usize,
    progress: &mut Progress,
) -> Result<(Surface, Stop)> {
    let tolerance = rule.tolerance;
    let Surface { mesh, z, is_fixed } = &mut surface;
    for ((z, p), is_fixed) in z.iter_mut().zip(mesh.points()).zip(is_fixed) {
        let here = p.as_pixel().map_or(f64::NAN, |(col, row)| data.at(col, row));
        if !here.is_nan() && !*is_fixed {
            *z = z.clamp(here - tolerance, here + tolerance);
        }
    }
    progress.stage("refine")?;
    let mut refiner = Refiner::new(surface);
    let stop = refiner.run(&Image::Held(*data), rule, max_points, progress)?;
    Ok((refiner.surface, stop))
}
