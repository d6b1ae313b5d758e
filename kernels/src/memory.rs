//! Memory on cache-line boundaries, and scratch memory that a thread keeps for the next call.

use std::cell::Cell;
use std::ops::{Deref, DerefMut};

use bytemuck::{Pod, Zeroable};

use crate::size::product;

/// One cache line.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
struct Line([u8; 64]);

/// Lines that `len` elements take.
fn lines_of<T>(len: usize) -> usize {
    product([len, size_of::<T>()]).div_ceil(size_of::<Line>())
}

/// A fixed number of elements that start on a cache-line boundary.
#[derive(Clone, Default)]
pub struct Aligned<T> {
    lines: Vec<Line>,
    len: usize,
    kind: std::marker::PhantomData<T>,
}

impl<T: Pod> Aligned<T> {
    /// `len` zeros.
    ///
    /// # Panics
    /// When memory for them cannot be allocated.
    pub fn zeroed(len: usize) -> Self {
        let lines = bytemuck::allocation::zeroed_vec(lines_of::<T>(len));
        Self { lines, len, kind: std::marker::PhantomData }
    }

    /// Makes room for `len` elements. Their content is unspecified (but initialised).
    ///
    /// # Panics
    /// When memory for them cannot be allocated.
    pub fn resize(&mut self, len: usize) {
        let lines = lines_of::<T>(len);
        if lines > self.lines.len() {
            self.lines = bytemuck::allocation::zeroed_vec(lines);
        }
        self.len = len;
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.lines.len() * 64
    }
}

impl<T: Pod> Deref for Aligned<T> {
    type Target = [T];
    #[inline(always)]
    fn deref(&self) -> &[T] {
        &bytemuck::cast_slice(&self.lines)[..self.len]
    }
}

impl<T: Pod> DerefMut for Aligned<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut bytemuck::cast_slice_mut(&mut self.lines)[..self.len]
    }
}

impl<T: Pod> AsRef<[T]> for Aligned<T> {
    fn as_ref(&self) -> &[T] {
        self
    }
}

thread_local! {
    static KEPT: Cell<Vec<Aligned<f32>>> = const { Cell::new(Vec::new()) };
}

/// Scratch memory of this thread: reused from earlier calls, given back to the thread when dropped.
///
/// Calls may nest; each has its own memory. The initial content is unspecified.
pub struct Scratch(Aligned<f32>);

impl Scratch {
    /// `len` values.
    ///
    /// # Panics
    /// When memory for them cannot be allocated.
    pub fn take(len: usize) -> Self {
        let bytes = product([len, size_of::<f32>()]);
        let mut kept = KEPT.take();
        // The smallest that is large enough, else the largest, which then grows.
        let fits = |a: &Aligned<f32>| a.bytes() >= bytes;
        let found = (0..kept.len()).filter(|&i| fits(&kept[i])).min_by_key(|&i| kept[i].bytes());
        let found = found.or_else(|| (0..kept.len()).max_by_key(|&i| kept[i].bytes()));
        let mut memory = found.map(|i| kept.swap_remove(i)).unwrap_or_default();
        KEPT.set(kept);
        memory.resize(len);
        Self(memory)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let mut kept = KEPT.take();
        kept.push(std::mem::take(&mut self.0));
        KEPT.set(kept);
    }
}

impl Deref for Scratch {
    type Target = [f32];
    #[inline(always)]
    fn deref(&self) -> &[f32] {
        &self.0
    }
}

impl DerefMut for Scratch {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_starts_on_a_cache_line_and_is_reused() {
        let first = {
            let a = Scratch::take(100);
            assert_eq!(a.as_ptr() as usize % 64, 0);
            a.as_ptr()
        };
        let b = Scratch::take(60);
        let c = Scratch::take(60);
        assert_eq!(b.as_ptr(), first);
        assert_ne!(c.as_ptr(), first);
        assert_eq!(b.len(), 60);
    }
}
