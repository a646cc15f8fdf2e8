//! Which triangle comes first, and which of its pixels is inserted.
//!
//! In every triangle the errors |z - plane| of its pixels (closed triangle, corners excluded)
//! are taken. Their quantile `priority` times count^`weight` tells how urgent the triangle is;
//! the pixel at the quantile `candidate` is what is inserted. If that is the worst one, its error is added to the quantile, and this
//! is (unless another quantile than the maximum is bounded) that of the largest errors in eight groups of pixels: every eighth column is one.
//! The paper's metric is (0.5, 0, 0.5), Garland and Heckbert's is (1, 0, 1).

/// How triangles are ranked, what is inserted and when to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// Quantile of a triangle's errors that ranks it, in (0, 1].
    pub priority: f64,
    /// The rank is multiplied by (number of pixels)^weight.
    pub weight: f64,
    /// Quantile at which the pixel to insert stands, in (0, 1].
    pub candidate: f64,
    /// A triangle is left alone when the quantile `bound` of its errors is at or
    /// under `tolerance`.
    pub tolerance: f64,
    pub bound: f64,
}

impl Rule {
    /// Garland and Heckbert's: nothing but the worst pixel counts.
    pub fn is_max(&self) -> bool {
        [self.priority, self.candidate, self.bound] == [1.0; 3] && self.weight == 0.0
    }

    /// Whether the worst pixel is inserted, and others of its triangle have a say in when.
    pub fn is_by_groups(&self) -> bool {
        self.candidate == 1.0 && self.bound == 1.0 && !self.is_max()
    }

    /// How urgent a triangle of so many pixels is, whose errors have this quantile `priority`
    /// and this maximum.
    pub fn priority_of(&self, quantile: f64, worst: f64, pixels: f64) -> f64 {
        // A triangle that fits but for one pixel is not to wait forever.
        let worst = if self.candidate == 1.0 && !self.is_max() { worst } else { 0.0 };
        let weight = match self.weight {
            0.0 => 1.0,
            0.25 => pixels.sqrt().sqrt(),
            0.5 => pixels.sqrt(),
            weight => pixels.powf(weight),
        };
        (quantile + worst) * weight
    }

    /// The priority and the place of the candidate among errors in double precision, if they
    /// are beyond the tolerance. Places of one column have the same remainder by [`GROUPS`].
    pub fn rank(&self, errors: Vec<(f64, usize)>) -> Option<(f64, usize)> {
        let mut sorted = errors;
        // Stable: of equal errors the first pixel comes first.
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let quantile = |q: f64| sorted[quantile_index(sorted.len(), q)].0;
        let worst = sorted.last()?.0;
        if worst <= self.tolerance || quantile(self.bound) <= self.tolerance && self.tolerance > 0.0 {
            return None;
        }
        let at = quantile(self.candidate);
        let place = sorted.iter().find(|e| e.0 == at)?.1;
        let ranked = if self.is_by_groups() {
            let largest = |group: usize| sorted.iter().rev().find(|e| e.1 % GROUPS == group).map(|e| e.0);
            let mut groups: Vec<f64> = (0..GROUPS).filter_map(largest).collect();
            groups.sort_by(f64::total_cmp);
            groups[quantile_index(groups.len(), self.priority)]
        } else {
            quantile(self.priority)
        };
        Some((self.priority_of(ranked, worst, sorted.len() as f64), place))
    }
}

/// Of pixels, by their columns.
const GROUPS: usize = 8;

/// Index of the quantile `q` among `n` sorted errors; 0.5 gives the lower median.
pub fn quantile_index(n: usize, q: f64) -> usize {
    ((n - 1) as f64 * q) as usize
}

/// Why refinement ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The number of points was reached.
    Points,
    /// Every triangle is within the tolerance.
    Tolerance,
    /// What is left is noise.
    Noise,
    /// Every pixel lies on the mesh: more points would change nothing.
    Exact,
    /// The outline of the data and the initial points are more than was asked for.
    Outline,
}
