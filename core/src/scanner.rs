//! Triangles scanned together, and their candidates in the queue.

use crate::candidate::Candidate;
use crate::facets::Facets;
use crate::grid::Height;
use crate::image::View;
use crate::lanes::{Vectors, LANES};
use crate::mesh::Class;
use crate::patch::Patch;
use crate::queue::{Order, Queue};
use crate::rank::{Ranked, Ranker};
use crate::rule::Rule;
use crate::surface::Surface;

pub struct Scanner {
    pub ranker: Ranker,
    pub queue: Queue,
    /// Triangles to be looked at together, with their numbers and versions.
    facets: Facets,
    looked_at: Vec<(u32, u32)>,
}

impl Scanner {
    pub fn new(vectors: Vectors) -> Self {
        Scanner {
            ranker: Ranker::new(vectors),
            queue: Queue::new(Order::Exact),
            facets: Facets::default(),
            looked_at: Vec::new(),
        }
    }

    /// Scans triangles and queues their candidates unless they are within the
    /// tolerance. Returns the work done in pixels.
    #[inline]
    pub fn scan<T: Height>(
        &mut self,
        surface: &Surface,
        triangles: impl IntoIterator<Item = u32>,
        view: &View<T>,
        patch: &Patch,
        rule: &Rule,
    ) -> usize {
        let mut work = 0;
        for t in triangles {
            let triangle = surface.mesh.triangle(t);
            if triangle.class() == Class::Data {
                self.looked_at.push((t, triangle.version));
                self.facets.push(surface.mesh.corners(t), surface.heights(t));
                if self.looked_at.len() == LANES {
                    work += self.look(view, patch, rule);
                }
            }
        }
        work + self.look(view, patch, rule)
    }

    /// Scans the triangles that are to be looked at.
    #[inline]
    fn look<T: Height>(&mut self, view: &View<T>, patch: &Patch, rule: &Rule) -> usize {
        if self.looked_at.is_empty() {
            return 0;
        }
        let Scanner { ranker, queue, facets, looked_at } = self;
        let work = ranker.rank(view, patch, rule, facets, |i, Ranked { priority, place, pick }| {
            let (triangle, version) = looked_at[i];
            queue.push(Candidate { priority, pixel: place as u32, triangle, version, pick });
        });
        facets.clear();
        looked_at.clear();
        work
    }
}
