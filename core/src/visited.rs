//! A set of pixels, one bit each.

pub struct Visited(Vec<u64>);

impl Visited {
    pub fn new(pixels: usize) -> Self {
        Visited(vec![0; pixels.div_ceil(64)])
    }

    /// Adds the pixel; false if it was there.
    #[inline]
    pub fn insert(&mut self, pixel: usize) -> bool {
        let (word, bit) = (&mut self.0[pixel / 64], 1u64 << (pixel % 64));
        let new = *word & bit == 0;
        *word |= bit;
        new
    }
}
