//! What the constrained edges of a mesh stand for.

use std::collections::HashMap;

/// The region of the valid pixels, see [`Label::winding`].
pub const OUTLINE: u32 = 0;

/// What a segment stands for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Label {
    /// How often the border of each region runs along the segment less how often
    /// against it; the region lies on the positive side.
    pub winding: Vec<(u32, i32)>,
    /// A breakline: an edge of the result wherever it runs.
    pub is_line: bool,
    /// The surface runs straight between its ends, which have fixed heights.
    pub is_hard: bool,
    /// Parts two tiles.
    pub is_seam: bool,
}

impl Label {
    pub fn border(region: u32) -> Self {
        Label { winding: vec![(region, 1)], ..Label::default() }
    }

    /// 1 if the outline runs along the segment, -1 if against it, 0 if it does not.
    pub fn along_outline(&self) -> i64 {
        self.winding.iter().find(|w| w.0 == OUTLINE).map_or(0, |w| i64::from(w.1.signum()))
    }

    fn reversed(mut self) -> Self {
        self.winding.iter_mut().for_each(|(_, count)| *count = -*count);
        self
    }

    fn merge(&mut self, other: Label) {
        for (region, count) in other.winding {
            match self.winding.iter_mut().find(|w| w.0 == region) {
                Some(w) => w.1 += count,
                None => self.winding.push((region, count)),
            }
        }
        self.is_line |= other.is_line;
        self.is_hard |= other.is_hard;
        self.is_seam |= other.is_seam;
    }
}

/// The labels of the constrained edges, by their ends in ascending order.
#[derive(Default)]
pub struct Labels(HashMap<(u32, u32), Label>);

impl Labels {
    /// The label of the edge as seen from `a`.
    pub fn get(&self, a: u32, b: u32) -> Option<Label> {
        self.0.get(&(a.min(b), a.max(b))).map(|label| towards(a < b, label.clone()))
    }

    pub(crate) fn merge(&mut self, a: u32, b: u32, label: Label) {
        self.0.entry((a.min(b), a.max(b))).or_default().merge(towards(a < b, label));
    }

    pub(crate) fn remove(&mut self, a: u32, b: u32) -> Option<Label> {
        self.0.remove(&(a.min(b), a.max(b))).map(|label| towards(a < b, label))
    }
}

fn towards(is_ascending: bool, label: Label) -> Label {
    if is_ascending {
        label
    } else {
        label.reversed()
    }
}
