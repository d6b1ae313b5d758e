//! Preparation, done once for a scene: the record of each tile, and the destination of its splats' sums.

#![expect(unsafe_code, reason = "tasks sort lists of one array and fill records of another")]

use std::sync::PoisonError;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use tracing::debug_span;

use super::super::blend::Walk;
use super::super::sort::by_depth;
use super::record::{Record, RecordTile};
use super::{ColourMap, Thread};
use crate::parallel::Disjoint;
use crate::simd::dispatch;

impl ColourMap {
    /// Sorts and records the tiles of `order`.
    pub(super) fn record(&mut self) {
        let tiles = self.grid.len();
        let _span = debug_span!("record", tiles).entered();
        let starts = &self.rasteriser.starts;
        let length = |tile: u32| starts[tile as usize + 1] - starts[tile as usize];
        self.order.sort_unstable_by_key(|&tile| (std::cmp::Reverse(length(tile)), tile));
        for tile in &mut self.tiles {
            tile.kept = false;
            tile.record.gaussians.clear();
        }
        let (next, used) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let entries = Disjoint::new(&mut self.rasteriser.entries);
        let slots = Disjoint::new(&mut self.tiles);
        let spare = self.spare.get_mut().unwrap_or_else(PoisonError::into_inner);
        spare.threads.resize_with(rayon::current_num_threads(), Thread::default);
        let (order, splats, level, budget) = (&self.order, &self.rasteriser.splats, self.level, self.budget);
        let least = self.least;
        let (shape, size, columns) = (self.shape, self.size, self.grid.columns);
        spare.threads.par_iter_mut().with_max_len(1).for_each(|thread| {
            while let Some(&tile) = order.get(next.fetch_add(1, Ordering::Relaxed)) {
                let tile = tile as usize;
                // SAFETY: a tile is taken once, and lists of tiles do not overlap.
                let list = unsafe { entries.part(starts[tile] as usize..starts[tile + 1] as usize) };
                by_depth(list, &mut thread.spare);
                // SAFETY: a tile is taken once.
                let slot = unsafe { &mut slots.part(tile..tile + 1)[0] };
                let walk = Walk { splats, list, shape, tile: [tile % columns, tile / columns], size };
                // No bit depends on which tiles are kept.
                slot.kept = used.load(Ordering::Relaxed) < budget;
                let record = &mut thread.record;
                dispatch(level, RecordTile { walk, wanted: slot.wanted, light: &mut thread.light, record, least });
                if slot.kept {
                    // A copy has the right size; a record that grows hit by hit has room for up to twice its hits.
                    slot.record = record.clone();
                    used.fetch_add(slot.record.bytes(), Ordering::Relaxed);
                } else {
                    slot.record = Record { gaussians: thread.record.gaussians.clone(), ..Record::default() };
                }
            }
        });
    }

    /// Assigns the place of its sums to every splat of every tile.
    pub(super) fn index(&mut self, gaussians: usize) {
        let _span = debug_span!("index", gaussians).entered();
        self.offsets.clear();
        self.offsets.resize(gaussians + 1, 0);
        self.starts.clear();
        let mut total = 0;
        for tile in &self.tiles {
            self.starts.push(total);
            total += tile.record.gaussians.len();
            for &gaussian in &tile.record.gaussians {
                self.offsets[gaussian as usize] += 1;
            }
        }
        self.starts.push(total);
        assert!(u32::try_from(total).is_ok(), "{total} places for sums, at most 2³² − 1");
        let mut start = 0;
        for offset in &mut self.offsets {
            start += std::mem::replace(offset, start);
        }
        // Each offset moves to its Gaussian's end, which is where the next one starts.
        self.slots.clear();
        for tile in &self.tiles {
            self.slots.extend(tile.record.gaussians.iter().map(|&gaussian| {
                let slot = self.offsets[gaussian as usize];
                self.offsets[gaussian as usize] += 1;
                slot
            }));
        }
        self.offsets.rotate_right(1);
        self.offsets[0] = 0;
    }
}
