//! Memory that the blocks of a part use one after the other.

use streamsplat_kernels::memory::Aligned;

/// Intermediate matrices of a block. Contents have no meaning between uses.
#[derive(Default)]
pub(crate) struct Workspace {
    pub(crate) normed: Aligned<f32>,
    pub(crate) projected: Aligned<f32>,
    pub(crate) keys_values: Aligned<f32>,
    pub(crate) mixed: Aligned<f32>,
    pub(crate) hidden: Aligned<f32>,
}

/// The first `len` values of `memory`, which grows if it must.
pub(crate) fn sized(memory: &mut Aligned<f32>, len: usize) -> &mut [f32] {
    memory.resize(len);
    memory
}
