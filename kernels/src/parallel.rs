//! Work split at fixed boundaries, so that no result depends on the number of threads.
//!
//! Kernels hand out chunks whose boundaries follow from the sizes alone; a task writes only its own chunk. Nothing is
//! reduced across threads in an order that could vary: partial results are stored by index and merged in index order.

#![expect(unsafe_code, reason = "parts of one slice are handed to several tasks")]

use rayon::prelude::*;

/// Calls `work(index, chunk)` for consecutive chunks of `len` elements of `data` (the last may be shorter).
pub fn for_each_chunk<T: Send>(data: &mut [T], len: usize, work: impl Fn(usize, &mut [T]) + Sync + Send) {
    data.par_chunks_mut(len.max(1)).enumerate().for_each(|(index, chunk)| work(index, chunk));
}

/// Calls `work(i)` for `i` in `0..count`; returns the results in index order.
pub fn map_indexed<R: Send>(count: usize, work: impl Fn(usize) -> R + Sync + Send) -> Vec<R> {
    (0..count).into_par_iter().map(work).collect()
}

/// A shared pointer to a slice; every task writes its own disjoint part.
///
/// For layouts in which a task's part is not contiguous (a block of columns, one head of a row).
pub struct Disjoint<'a, T> {
    start: *mut T,
    len: usize,
    life: std::marker::PhantomData<&'a mut [T]>,
}

// SAFETY: handing out parts is unsafe and promises that they do not overlap.
unsafe impl<T: Send> Sync for Disjoint<'_, T> {}
// SAFETY: as above.
unsafe impl<T: Send> Send for Disjoint<'_, T> {}

impl<'a, T> Disjoint<'a, T> {
    /// Shares `data`.
    pub fn new(data: &'a mut [T]) -> Self {
        Self { start: data.as_mut_ptr(), len: data.len(), life: std::marker::PhantomData }
    }

    /// Elements shared.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Returns true if nothing is shared.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Address of element `index`, for prefetch hints.
    #[inline(always)]
    pub(crate) fn address(&self, index: usize) -> *const T {
        self.start.wrapping_add(index)
    }

    /// Element `start`, as the first of parts that end before `end`. Panics when that is past the last element.
    ///
    /// # Safety
    /// As [`Disjoint::part`]; nothing but those parts is read or written through the pointer.
    #[inline(always)]
    pub(crate) unsafe fn parts(&self, start: usize, end: usize) -> *mut T {
        assert!(start < end && end <= self.len, "parts to {end} of {} elements", self.len);
        self.start.wrapping_add(start)
    }

    /// The part `range`. Panics when it is not inside the slice.
    ///
    /// # Safety
    /// No two parts that live at the same time overlap.
    #[inline(always)]
    #[expect(clippy::mut_from_ref, reason = "the caller promises disjoint parts")]
    pub unsafe fn part(&self, range: std::ops::Range<usize>) -> &mut [T] {
        assert!(range.start <= range.end && range.end <= self.len, "part {range:?} of {} elements", self.len);
        // SAFETY: inside the slice; disjoint by the caller's promise.
        unsafe { std::slice::from_raw_parts_mut(self.start.add(range.start), range.end - range.start) }
    }
}
