//! Memory that the parts use one after another, and keep for the next call.

use std::sync::{Mutex, PoisonError};

use streamsplat_kernels::memory::Aligned;

/// Intermediate matrices of a part and its blocks. Contents have no meaning between uses.
#[derive(Default)]
pub(crate) struct Workspace {
    pub(crate) tokens: Aligned<f32>,
    pub(crate) wide: Aligned<f32>,
    pub(crate) projected: Aligned<f32>,
    pub(crate) keys_values: Aligned<f32>,
    pub(crate) mixed: Aligned<f32>,
}

/// Free workspaces, up to the largest number of concurrent calls so far. Fresh memory is slow, as the system clears it
/// page by page.
#[derive(Default)]
pub(crate) struct Workspaces(Mutex<Vec<Workspace>>);

impl Workspaces {
    /// Calls `work` with one of them.
    pub(crate) fn lend<R>(&self, work: impl FnOnce(&mut Workspace) -> R) -> R {
        let kept = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut lent = kept().pop().unwrap_or_default();
        let result = work(&mut lent);
        kept().push(lent);
        result
    }

    /// Frees those that are not lent.
    pub(crate) fn release(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

/// The first `len` values of `memory`, which grows if it must.
pub(crate) fn sized(memory: &mut Aligned<f32>, len: usize) -> &mut [f32] {
    memory.resize(len);
    memory
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_kept_for_the_next_call_and_is_one_calls_at_a_time() {
        let workspaces = Workspaces::default();
        let first = workspaces.lend(|work| sized(&mut work.mixed, 1000).as_ptr() as usize);
        workspaces.lend(|work| {
            assert_eq!(sized(&mut work.mixed, 900).as_ptr() as usize, first);
            let inner = workspaces.lend(|work| sized(&mut work.mixed, 900).as_ptr() as usize);
            assert_ne!(inner, first);
            workspaces.release();
            // The one that is lent.
            assert_eq!(sized(&mut work.mixed, 900).as_ptr() as usize, first);
        });
        workspaces.release();
        assert_eq!(workspaces.lend(|work| work.mixed.bytes()), 0);
    }
}
