//! The Python binding: arrays in, arrays out, nothing else.

use crate::check;
use crate::crop::Vertex;
use crate::domain::{Constraints, Polygon};
use crate::error::Error;
use crate::grid::{Grid, Height};
use crate::measure;
use crate::memory;
use crate::mesh;
use crate::outline::Shape;
use crate::pipeline::{self, Options, Report, Scales};
use crate::predicate::{Metric, UNIT};
use crate::progress::Progress;
use crate::rule::{Rule, Stop};
use crate::scale;
use crate::surface::Surface;
use numpy::{Element, IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::{PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::num::NonZeroUsize;
use std::thread;

/// That many, or as many as this process may use processors.
fn count(threads: Option<NonZeroUsize>) -> usize {
    threads.or_else(|| thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get)
}

/// Runs `work` without the GIL, on up to `threads` threads; its progress goes to `callback`
/// (or nowhere), and Ctrl-C, a false answer or an exception of the callback stop it.
fn detached<R: Send>(
    py: Python<'_>,
    callback: Option<Py<PyAny>>,
    threads: usize,
    work: impl Send + FnOnce(&mut Progress) -> Result<R, Error>,
) -> PyResult<R> {
    let mut raised: Option<PyErr> = None;
    let result = py.detach(|| {
        let mut report = |stage: &'static str, fraction: f64| {
            Python::attach(|py| {
                let answer = py.check_signals().and_then(|()| match &callback {
                    Some(callback) => callback.bind(py).call1((stage, fraction))?.is_truthy(),
                    None => Ok(true),
                });
                answer.unwrap_or_else(|error| {
                    raised = Some(error);
                    false
                })
            })
        };
        work(&mut Progress::new(&mut report).with_threads(threads))
    });
    match (result, raised) {
        (Ok(value), None) => Ok(value),
        (_, Some(error)) => Err(error),
        (Err(error), None) => Err(to_python(py, error)),
    }
}

/// The matching class of `tin.errors`.
fn to_python(py: Python<'_>, error: Error) -> PyErr {
    let make = |class: &str, code: &str, message: &str| -> PyResult<PyErr> {
        let class = py.import("tin.errors")?.getattr(class)?;
        Ok(PyErr::from_value(class.call1((code, message))?))
    };
    let made = match &error {
        Error::Cancelled => make("Cancelled", "cancelled", "cancelled"),
        Error::Input { code, message } => make("InputError", code, message),
        Error::Option { code, message } => make("OptionError", code, message),
    };
    made.unwrap_or_else(|failure| failure)
}

/// A raster of either sample type.
#[derive(FromPyObject)]
enum Heights<'py> {
    Single(PyReadonlyArray2<'py, f32>),
    Double(PyReadonlyArray2<'py, f64>),
}

/// The finished triangulation of a raster, in pixel coordinates.
#[pyclass(frozen, module = "tin._core")]
struct Mesh {
    mesh: mesh::Mesh,
    z: Vec<f64>,
    rows: usize,
    cols: usize,
    report: Report,
    /// Triangles that cover data, in the order of the outputs.
    kept: Vec<u32>,
    /// Output number of each vertex that such a triangle uses.
    numbers: Vec<u32>,
    points: usize,
    /// How many threads measure it.
    threads: usize,
}

impl Mesh {
    fn new(done: pipeline::Triangulation, rows: usize, cols: usize, threads: usize) -> Self {
        let pipeline::Triangulation { surface: Surface { mesh, z, .. }, report } = done;
        let kept: Vec<u32> =
            (0..mesh.triangles().len() as u32).filter(|&t| !mesh.triangle(t).is_void()).collect();
        let mut numbers = vec![mesh::NONE; z.len()];
        for &v in kept.iter().flat_map(|&t| &mesh.triangle(t).v) {
            numbers[v as usize] = 0;
        }
        let mut points = 0;
        for number in numbers.iter_mut().filter(|n| **n == 0) {
            *number = points as u32;
            points += 1;
        }
        Mesh { mesh, z, rows, cols, report, kept, numbers, points, threads }
    }

    fn used(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.z.len()).filter(|&v| self.numbers[v] != mesh::NONE)
    }

    fn measure_on<'py, T: Height>(
        &self,
        py: Python<'py>,
        z: &[T],
        callback: Option<Py<PyAny>>,
    ) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyArray1<f64>>)> {
        let (rows, cols) = (self.rows, self.cols);
        let (errors, largest) = detached(py, callback, self.threads, |progress| {
            progress.stage("measure")?;
            measure::errors(&self.mesh, &self.z, &Grid::new(z, rows, cols)?, progress)
        })?;
        let numbers = PyDict::new(py);
        for (key, value) in [
            ("rmse", errors.rmse),
            ("mae", errors.mae),
            ("p95", errors.p95),
            ("max_error", errors.max),
            ("mean", errors.mean),
        ] {
            numbers.set_item(key, value)?;
        }
        for (key, value) in [
            ("covered", errors.covered),
            ("uncovered", errors.uncovered),
            ("void_covered", errors.void_covered),
        ] {
            numbers.set_item(key, value)?;
        }
        let kept: Vec<f64> = self.kept.iter().map(|&t| largest[t as usize]).collect();
        Ok((numbers, kept.into_pyarray(py)))
    }

    fn raster_of<'py, T: Height + Element>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<T>>> {
        let (rows, cols) = (self.rows, self.cols);
        let surface: Vec<T> = detached(py, None, self.threads, |progress| {
            measure::rasterise(&self.mesh, &self.z, rows, cols, progress)
        })?;
        surface.into_pyarray(py).reshape([rows, cols])
    }
}

#[pymethods]
impl Mesh {
    /// (n, 2) float64: column and row of each vertex, pixel centres are integers.
    fn pixels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let unit = f64::from(UNIT);
        let flat: Vec<f64> = self
            .used()
            .map(|v| self.mesh.point(v as u32))
            .flat_map(|p| [f64::from(p.x) / unit, f64::from(p.y) / unit])
            .collect();
        flat.into_pyarray(py).reshape([self.points, 2])
    }

    /// (n,) float64: height of each vertex.
    fn heights<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.used().map(|v| self.z[v]).collect::<Vec<_>>().into_pyarray(py)
    }

    /// (m, 3) uint32: corners of each triangle, turning from +column to +row.
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        let corners =
            self.kept.iter().flat_map(|&t| self.mesh.triangle(t).v.map(|v| self.numbers[v as usize]));
        corners.collect::<Vec<_>>().into_pyarray(py).reshape([self.kept.len(), 3])
    }

    /// (m, 3) bool: whether the edge from corner k to corner k + 1 is a constraint.
    fn constrained<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<bool>>> {
        let edges =
            self.kept.iter().flat_map(|&t| [0, 1, 2].map(|k| self.mesh.triangle(t).is_constrained(k)));
        edges.collect::<Vec<_>>().into_pyarray(py).reshape([self.kept.len(), 3])
    }

    /// Error statistics against a raster of the same shape, and each triangle's
    /// largest absolute error.
    #[pyo3(signature = (z, progress=None))]
    fn errors<'py>(
        &self,
        py: Python<'py>,
        z: Heights<'py>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyArray1<f64>>)> {
        match &z {
            Heights::Single(z) => self.measure_on(py, z.as_slice()?, progress),
            Heights::Double(z) => self.measure_on(py, z.as_slice()?, progress),
        }
    }

    /// (rows, cols) heights on the pixel centres, NaN where no triangle is.
    fn rasterize_f32<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.raster_of(py)
    }

    /// (rows, cols) heights on the pixel centres, NaN where no triangle is.
    fn rasterize_f64<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.raster_of(py)
    }

    /// Raises RuntimeError with the first property of the mesh that does not hold.
    fn check(&self) -> PyResult<()> {
        check::check(&self.mesh, self.report.delaunay).map_err(PyRuntimeError::new_err)
    }

    /// "points", "tolerance", "noise", "exact" or "outline".
    #[getter]
    fn stop_reason(&self) -> &'static str {
        match self.report.stop {
            Stop::Points => "points",
            Stop::Tolerance => "tolerance",
            Stop::Noise => "noise",
            Stop::Exact => "exact",
            Stop::Outline => "outline",
        }
    }

    #[getter]
    fn noise(&self) -> f64 {
        self.report.noise
    }

    /// (k,) uint64: indices (row * cols + col) of the pixels that despiking replaced.
    fn spikes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u64>> {
        self.report.spikes.iter().map(|&i| i as u64).collect::<Vec<_>>().into_pyarray(py)
    }

    /// The sigmas (x, y) in pixels of the scales refined.
    #[getter]
    fn scales(&self) -> Vec<(f64, f64)> {
        self.report.scales.iter().map(|s| (s[0], s[1])).collect()
    }

    /// Whether the mesh is (constrained) Delaunay in the metric of the map.
    #[getter]
    fn delaunay(&self) -> bool {
        self.report.delaunay
    }

    /// The integer quadratic form (e, f, g) of the in-circle test.
    #[getter]
    fn metric(&self) -> (i64, i64, i64) {
        let Metric { e, f, g } = self.mesh.metric();
        (e, f, g)
    }
}

/// The rings of a polygon, each (n, 3) column, row and height.
type Rings<'py> = Vec<PyReadonlyArray2<'py, f64>>;

fn vertices(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Vertex>> {
    let array = array.as_array();
    if array.ncols() != 3 {
        return Err(PyTypeError::new_err("vertices must be (n, 3): column, row, height"));
    }
    Ok(array.rows().into_iter().map(|v| [v[0], v[1], v[2]]).collect())
}

fn polygon(rings: &Rings<'_>) -> PyResult<Polygon> {
    rings.iter().map(vertices).collect()
}

/// Triangulates a raster; see `tin.triangulate` for the meaning of the options.
#[pyfunction]
#[pyo3(signature = (z, metric, *, max_points, is_share, points_per_scale, priority, weight, candidate, tolerance, bound,
                    stop_at_noise, scales, despike, fit, flips, outline_tolerance, keep_isolated, sieve,
                    pixels, points, lines, clip, flat, tile, threads=None, progress=None))]
#[allow(clippy::too_many_arguments)]
fn triangulate(
    py: Python<'_>,
    z: Heights<'_>,
    metric: (f64, f64, f64),
    max_points: Option<usize>,
    is_share: bool,
    points_per_scale: Option<usize>,
    priority: f64,
    weight: f64,
    candidate: f64,
    tolerance: Option<f64>,
    bound: f64,
    stop_at_noise: bool,
    scales: Option<Vec<(f64, f64)>>,
    despike: bool,
    fit: bool,
    flips: u32,
    outline_tolerance: f64,
    keep_isolated: bool,
    sieve: usize,
    pixels: Vec<(usize, usize)>,
    points: PyReadonlyArray2<'_, f64>,
    lines: Vec<PyReadonlyArray2<'_, f64>>,
    clip: Option<Vec<Rings<'_>>>,
    flat: Vec<(Rings<'_>, f64)>,
    tile: usize,
    threads: Option<NonZeroUsize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Mesh> {
    let constraints = Constraints {
        pixels,
        points: vertices(&points)?,
        lines: lines.iter().map(vertices).collect::<PyResult<_>>()?,
        clip: clip.map(|areas| areas.iter().map(polygon).collect()).transpose()?,
        flat: flat.iter().map(|(rings, level)| Ok((polygon(rings)?, *level))).collect::<PyResult<_>>()?,
    };
    let options = Options {
        max_points: max_points.unwrap_or(usize::MAX),
        is_share,
        points_per_scale,
        rule: Rule { priority, weight, candidate, tolerance: tolerance.unwrap_or(0.0), bound },
        has_tolerance: tolerance.is_some(),
        stop_at_noise,
        scales: scales.map_or(Scales::Auto, |s| Scales::Given(s.into_iter().map(|(x, y)| [x, y]).collect())),
        despike,
        fit,
        flips,
        shape: Shape { tolerance: outline_tolerance, keep_isolated, sieve },
        constraints,
        tile,
    };
    match &z {
        Heights::Single(z) => run(py, z, metric, options, count(threads), progress),
        Heights::Double(z) => run(py, z, metric, options, count(threads), progress),
    }
}

fn run<T: Height + Element>(
    py: Python<'_>,
    z: &PyReadonlyArray2<'_, T>,
    (e, f, g): (f64, f64, f64),
    options: Options,
    threads: usize,
    callback: Option<Py<PyAny>>,
) -> PyResult<Mesh> {
    let [rows, cols] = *z.as_array().shape() else {
        return Err(PyTypeError::new_err("heights must have two dimensions"));
    };
    let heights = z.as_slice()?;
    detached(py, callback, threads, |progress| {
        let grid = Grid::new(heights, rows, cols)?;
        let metric = Metric::from_form(e, f, g, rows.max(cols))
            .ok_or_else(|| Error::input("bad-transform", "the geotransform is singular"))?;
        let done = pipeline::triangulate(&grid, metric, &options, progress)?;
        // For the arrays of the result.
        memory::ensure(128 * done.surface.z.len())?;
        Ok(Mesh::new(done, rows, cols, threads))
    })
}

/// The image at scale t = sigma^2 (Gaussian, `sigma` = (x, y) in pixels; voids are NaN).
#[pyfunction]
#[pyo3(signature = (z, sigma, threads=None))]
fn gaussian<'py>(
    py: Python<'py>,
    z: PyReadonlyArray2<'py, f64>,
    sigma: (f64, f64),
    threads: Option<NonZeroUsize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let [rows, cols] = *z.as_array().shape() else {
        return Err(PyTypeError::new_err("heights must have two dimensions"));
    };
    let heights = z.as_slice()?;
    let smooth = detached(py, None, count(threads), |progress| {
        let grid = Grid::new(heights, rows, cols)?;
        Ok(scale::gaussian(&grid, [sigma.0, sigma.1], progress)?.into_owned())
    })?;
    smooth.into_pyarray(py).reshape([rows, cols])
}

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Mesh>()?;
    module.add_function(wrap_pyfunction!(gaussian, module)?)?;
    module.add_function(wrap_pyfunction!(triangulate, module)?)
}
