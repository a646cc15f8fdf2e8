//! Which triangle comes first, and which of its pixels is inserted.
//!
//! In every triangle the errors |z - plane| of its pixels (closed triangle, corners excluded)
//! are taken. Their quantile `priority` times count^`weight` tells how urgent the triangle is;
//! the pixel at the quantile `candidate` is what is inserted (if that is the worst one, a share
//! of its error counts, too). The paper's metric is (0.5, 0, 0.5), Garland and Heckbert's is
//! (1, 0, 1).

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

    /// How urgent a triangle of so many pixels is, whose errors have this quantile `priority`
    /// and this maximum.
    pub fn priority_of(&self, quantile: f64, worst: f64, pixels: f64) -> f64 {
        let share = if self.candidate == 1.0 && self.priority < 1.0 { WORST_SHARE * worst } else { 0.0 };
        let weight = match self.weight {
            0.0 => 1.0,
            0.5 => pixels.sqrt(),
            weight => pixels.powf(weight),
        };
        (quantile + share) * weight
    }

    /// The priority and the place of the candidate among errors in double precision, if they
    /// are beyond the tolerance.
    pub fn rank(&self, errors: Vec<(f64, usize)>) -> Option<(f64, usize)> {
        let mut sorted = errors;
        // Stable: of equal errors the first pixel comes first.
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let count = sorted.len();
        let quantile = |q: f64| sorted[quantile_index(count, q)].0;
        let worst = sorted.last()?.0;
        if worst <= self.tolerance || quantile(self.bound) <= self.tolerance && self.tolerance > 0.0 {
            return None;
        }
        let at = quantile(self.candidate);
        let place = sorted.iter().find(|e| e.0 == at)?.1;
        Some((self.priority_of(quantile(self.priority), worst, count as f64), place))
    }
}

/// Where the worst pixel is what gets inserted, this share of its error counts beside
/// the quantile: a triangle that fits but for one pixel does not wait forever, and
/// those whose median error is zero are told apart.
const WORST_SHARE: f64 = 0.3;

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
