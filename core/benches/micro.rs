//! Micro-benchmarks of what the refinement spends its time on: `make bench-core`.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{hash, method, terrain, unit};
use criterion::{criterion_group, criterion_main, Criterion, Throughput};
use dem2tin_core::candidate::{Candidate, Pick};
use dem2tin_core::facet::Facet;
use dem2tin_core::grid::{Grid, Height};
use dem2tin_core::image::View;
use dem2tin_core::lanes::{Kernel, Lanes, Vectors};
use dem2tin_core::list::List;
use dem2tin_core::patch::Patch;
use dem2tin_core::pipeline::triangulate;
use dem2tin_core::predicate::{orient2d, Metric, Point};
use dem2tin_core::progress::Progress;
use dem2tin_core::queue::{Order, Queue};
use dem2tin_core::rule::quantile_index;
use dem2tin_core::scanned::Scan;
use dem2tin_core::select::Selector;
use dem2tin_core::window::Window;
use std::hint::black_box;
use std::time::Duration;

/// Side of the raster of the scans: within the second-level cache even in f64.
const SIZE: usize = 256;

/// Positive triangles of pixels in a box of `side` pixels, strewn over the raster.
fn triangles(n: u64, side: usize) -> Vec<[Point; 3]> {
    let below = |i: u64, n: usize| (hash(i) % n as u64) as usize;
    let triangle = |i: u64| {
        let (left, top) = (below(8 * i, SIZE - side), below(8 * i + 1, SIZE - side));
        let corner = |k: u64| Point::pixel(left + below(8 * i + k, side), top + below(8 * i + k + 1, side));
        [corner(2), corner(4), corner(6)]
    };
    let area = |p: &[Point; 3]| orient2d(p[0], p[1], p[2]);
    let turned = |p: [Point; 3]| if area(&p) < 0 { [p[0], p[2], p[1]] } else { p };
    (0..).map(triangle).filter(|p| area(p) != 0).map(turned).take(n as usize).collect()
}

fn heights<T: Height>(grid: &Grid<T>, p: [Point; 3]) -> [f64; 3] {
    p.map(|q| q.as_pixel().map_or(f64::NAN, |(col, row)| grid.at(col, row)))
}

fn all_vectors() -> [(&'static str, Vectors); 2] {
    [("plain", Vectors::Plain), ("best", Vectors::best())]
}

struct Worst<'a>(&'a Facet, &'a Patch);

impl Kernel for Worst<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<L: Lanes>(self) -> f32 {
        self.0.worst::<L>(self.1).error
    }
}

struct Collect<'a>(&'a Facet, &'a Patch, &'a mut List);

impl Kernel for Collect<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<L: Lanes>(self) -> f32 {
        self.0.collect::<L>(self.1, self.2)
    }
}

fn scan(c: &mut Criterion) {
    let z = terrain(SIZE);
    let grid = Grid::new(&z, SIZE, SIZE).unwrap();
    let window = Window { col: 0, row: 0, cols: SIZE, rows: SIZE };
    let patch = Patch::new(&View::of(&grid), window).unwrap();
    let mut errors = List::default();
    for (name, n, side) in [("small", 4096, 10), ("large", 16, 200)] {
        let triangles: Vec<_> = triangles(n, side).into_iter().map(|p| (p, heights(&grid, p))).collect();
        let facets = || triangles.iter().map(|&(p, z)| Facet::new(&patch, black_box(p), z));
        let mut group = c.benchmark_group(format!("scan/{name}"));
        group.throughput(Throughput::Elements(facets().map(|facet| facet.pixels as u64).sum()));
        for (kind, vectors) in all_vectors() {
            group.bench_function(format!("worst/{kind}"), |b| {
                b.iter(|| facets().map(|facet| vectors.run(Worst(&facet, &patch))).sum::<f32>())
            });
            group.bench_function(format!("collect/{kind}"), |b| {
                b.iter(|| {
                    facets().map(|facet| vectors.run(Collect(&facet, &patch, &mut errors))).sum::<f32>()
                })
            });
        }
    }
}

struct Median<'a>(&'a List, &'a mut Selector);

impl Kernel for Median<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<L: Lanes>(self) -> f32 {
        self.1.nth::<L>(self.0, quantile_index(self.0.values().len(), 0.5))
    }
}

/// The median, of so many lists that no branch is learnt by heart.
fn selection(c: &mut Criterion) {
    const ERRORS: u64 = 1 << 17;
    let errors: Vec<f32> = (0..ERRORS).map(|i| 100.0 * unit(i) as f32).collect();
    let mut selector = Selector::default();
    for n in [8, 32, 128, 1024, 16384] {
        let mut group = c.benchmark_group(format!("selection/{n}"));
        group.throughput(Throughput::Elements(ERRORS));
        for (kind, vectors) in all_vectors() {
            let lists: Vec<List> =
                errors.chunks_exact(n).map(|list| list.iter().copied().collect()).collect();
            let mut median = |list| vectors.run(Median(list, &mut selector));
            group.bench_function(kind, |b| b.iter(|| lists.iter().map(&mut median).sum::<f32>()));
        }
    }
}

fn predicates(c: &mut Criterion) {
    const N: u64 = 1024;
    let near = |i: u64| Point::pixel(1000 + (hash(i) % 16) as usize, 1000 + (hash(!i) % 16) as usize);
    let quads: Vec<[Point; 4]> = (0..N).map(|i| [0, 1, 2, 3].map(|k| near(4 * i + k))).collect();
    let mut group = c.benchmark_group("predicate");
    group.throughput(Throughput::Elements(N));
    group.bench_function("orient2d", |b| {
        b.iter(|| {
            for &[p, q, r, _] in &quads {
                black_box(orient2d(black_box(p), q, r));
            }
        })
    });
    let skew = Metric { e: 1009, f: 307, g: 1511 };
    for (name, metric) in [("in_circle", Metric::SQUARE), ("in_circle, skew", skew)] {
        group.bench_function(name, |b| {
            b.iter(|| {
                for &[p, q, r, s] in &quads {
                    black_box(metric.in_circle(black_box(p), q, r, s));
                }
            })
        });
    }
}

/// What a refinement asks of the queue: each candidate taken makes six triangles stale or
/// new, each with a lower priority than the one taken.
fn queue_mix(order: Order) -> usize {
    const TRIANGLES: u64 = 1 << 13;
    const STEPS: u64 = 1 << 12;
    const SIDE: u64 = 1 << 10;
    let mut versions = vec![0u32; TRIANGLES as usize];
    let mut queue = Queue::new(order);
    let candidate = |i: u64, triangle: u32, version: u32, most: f64| {
        let priority = most * unit(2 * i).max(1e-9);
        let pixel = (hash(2 * i + 1) % (SIDE * SIDE)) as u32;
        Candidate { priority, pixel, triangle, version, pick: Pick::KNOWN }
    };
    for i in 0..TRIANGLES {
        queue.push(candidate(i, i as u32, 0, 100.0));
    }
    let mut popped = 0;
    for step in 0..STEPS {
        let remaining = (STEPS - step) as usize;
        let Some(best) = queue.pop(remaining, |c| versions[c.triangle as usize] == c.version) else {
            break;
        };
        popped += 1;
        for k in 0..6 {
            let i = TRIANGLES + 6 * step + k;
            let triangle = (u64::from(best.triangle) + k) % TRIANGLES;
            let version = &mut versions[triangle as usize];
            *version += 1;
            queue.push(candidate(i, triangle as u32, *version, best.priority));
        }
    }
    popped
}

fn queue(c: &mut Criterion) {
    let mut group = c.benchmark_group("queue");
    group.throughput(Throughput::Elements(queue_mix(Order::Exact) as u64));
    for (name, order) in
        [("exact", Order::Exact), ("latest", Order::Latest), ("curve", Order::Curve(1 << 10))]
    {
        group.bench_function(name, |b| b.iter(|| queue_mix(black_box(order))));
    }
}

fn whole(c: &mut Criterion) {
    const SIDE: usize = 128;
    let z = terrain(SIDE);
    let grid = Grid::new(&z, SIDE, SIDE).unwrap();
    let mut group = c.benchmark_group("triangulate/128");
    for name in common::METHODS {
        let options = method(name, SIDE * SIDE / 20).unwrap();
        group.bench_function(name, |b| {
            b.iter(|| {
                let mut quiet = |_: &'static str, _: f64| true;
                triangulate(&grid, Metric::SQUARE, &options, &mut Progress::new(&mut quiet)).unwrap()
            })
        });
    }
}

fn short() -> Criterion {
    Criterion::default()
        .sample_size(30)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
}

criterion_group! { name = benches; config = short(); targets = scan, selection, predicates, queue, whole }
criterion_main!(benches);
