//! Asking for memory before it is used: where the allocator itself runs dry, Rust ends
//! the whole process. And copies that take little.

use crate::error::{Error, Result};

/// Asked for beyond what is counted: short lists are not asked for.
const MARGIN: usize = 16 << 20;
/// And what another thread's first one may take of the addresses at once (glibc's arenas), where these are limited;
/// not beside small requests, since to give so much back interrupts all threads.
const ARENA: usize = 64 << 20;
const SMALL: usize = 4 << 20;

/// A copy may grow by this share, and a little, before it has to move.
const SLACK: usize = 16;

/// A copy with little room to grow.
pub fn compact<T: Copy>(values: &[T]) -> Vec<T> {
    let mut copy = Vec::with_capacity(values.len() + values.len() / SLACK + SLACK);
    copy.extend_from_slice(values);
    copy
}

/// Fails if `bytes` more cannot be had now. Errors: `out-of-memory`.
pub fn ensure(bytes: usize) -> Result<()> {
    let (mut probe, mut arena): (Vec<u8>, Vec<u8>) = (Vec::new(), Vec::new());
    let is_there = probe.try_reserve_exact(bytes.saturating_add(MARGIN)).is_ok()
        && (bytes < SMALL || arena.try_reserve_exact(ARENA).is_ok());
    // Looked at, so that the compiler does not leave out the allocations.
    std::hint::black_box((&probe, &arena));
    if is_there {
        return Ok(());
    }
    let megabytes = bytes.div_ceil(1 << 20);
    let message = format!("not enough memory: {megabytes} MB more are needed; cut the DEM into tiles");
    Err(Error::input("out-of-memory", message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_machine_has_is_refused() {
        assert!(ensure(1 << 20).is_ok());
        assert!(ensure(0).is_ok());
        let refused = ensure(usize::MAX / 4);
        assert!(matches!(refused, Err(Error::Input { code: "out-of-memory", .. })));
    }
}
