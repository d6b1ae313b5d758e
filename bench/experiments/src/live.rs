//! Memory of this process: bytes on the heap by a counting allocator, without those that the system's allocator keeps
//! for later, and resident memory.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use anyhow::{Context, Result};

/// Bytes allocated and not freed.
static HELD: AtomicUsize = AtomicUsize::new(0);
/// Most of them at once since [`restart`].
static MOST: AtomicUsize = AtomicUsize::new(0);

/// The system's allocator with a count of bytes.
pub(crate) struct Counting;

fn given(bytes: usize) {
    let held = HELD.fetch_add(bytes, Relaxed) + bytes;
    MOST.fetch_max(held, Relaxed);
}

fn taken(bytes: usize) {
    HELD.fetch_sub(bytes, Relaxed);
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        given(layout.size());
        // SAFETY: the caller keeps the contract of `GlobalAlloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        given(layout.size());
        // SAFETY: the caller keeps the contract of `GlobalAlloc`.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        taken(layout.size());
        // SAFETY: the caller keeps the contract of `GlobalAlloc`.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        given(size);
        taken(layout.size());
        // SAFETY: the caller keeps the contract of `GlobalAlloc`.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

/// Restarts the search for the maximum.
pub(crate) fn restart() {
    MOST.store(HELD.load(Relaxed), Relaxed);
}

/// The most bytes held at once since [`restart`].
pub(crate) fn most() -> u64 {
    MOST.load(Relaxed) as u64
}

/// Bytes of memory that this process holds now, as Linux counts them.
pub(crate) fn resident_bytes() -> Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status").context("memory is read from /proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("/proc/self/status has no VmRSS")?;
    let kilobytes: u64 = line.split_whitespace().next().unwrap_or_default().parse().context("VmRSS")?;
    Ok(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_take_memory() {
        let memory = resident_bytes().expect("Linux");
        let pages = std::hint::black_box(vec![1u8; 64 << 20]);
        assert!(resident_bytes().expect("Linux") > memory + (48 << 20));
        drop(std::hint::black_box(pages));
    }

    #[test]
    fn what_is_held_counts_once_and_what_is_given_back_does_not() {
        restart();
        let before = most();
        // Untouched zeros take no memory, and the concurrent tests take far less than this.
        let mut held = std::hint::black_box(vec![0u8; 512 << 20]);
        held.reserve_exact(512 << 20);
        drop(std::hint::black_box(held));
        // While the memory grows, the old and the new block count.
        let grown = most() - before;
        assert!((1 << 30..7 << 28).contains(&grown), "{grown}");
        restart();
        assert!(most() < before + (1 << 28));
    }
}
