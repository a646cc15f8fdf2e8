//! Exact incremental Delaunay refinement of digital elevation models.
//!
//! Modules, each using only those above it: `predicate`, `curve`, `grid`, `mesh` (`check`,
//! `constrain`), `scan`, `lanes` (`list`), `patch`, `walk`, `facet`, `noise`, `smoother` (`lines`), `scale`, `outline`,
//! `candidate`, `queue`, `rule`, `rank`, `scanner`, `refine`, `outlook`, `tiles`, `crew`, `ladder`, `strips`, `share` (`owned`), `shares`, `quads`, `pyramid`, `fit` (`normal`), `blend`,
//! `flip`, `pipeline`; `python` is the binding.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod beside;
pub mod blend;
pub mod candidate;
pub mod check;
pub mod constrain;
mod crew;
pub mod crop;
mod curve;
mod desk;
pub mod domain;
pub mod error;
pub mod facet;
pub mod facets;
pub mod fit;
pub mod flip;
pub mod grid;
pub mod image;
pub mod label;
pub mod ladder;
pub mod lanes;
mod lines;
pub mod list;
pub mod locate;
pub mod measure;
pub mod memory;
pub mod mesh;
pub mod noise;
pub mod normal;
pub mod order;
pub mod outline;
mod outlook;
pub mod owned;
pub mod patch;
pub mod pipeline;
pub mod predicate;
pub mod progress;
pub mod pyramid;
#[cfg(feature = "python")]
mod python;
mod quads;
pub mod queue;
mod rank;
pub mod refine;
pub mod refinement;
pub mod repair;
pub mod rule;
pub mod scale;
pub mod scan;
pub mod scanned;
mod scanner;
pub mod seams;
pub mod select;
pub mod share;
mod shares;
pub mod sieve;
pub mod simplify;
mod smoother;
mod strips;
pub mod surface;
pub mod threads;
pub mod tiles;
pub mod tiling;
mod top;
pub mod triangle;
pub mod walk;
pub mod window;
