//! The canonical set: the Gaussians that the stream remembers, and how a key frame changes them.
//!
//! At key frame k the set holds *survivors* (older Gaussians that no frame continues, as they are at t_k) and the
//! *current* Gaussians (those of frame k). [`CanonicalSet::advance`] takes frame k+1 and the pair's two deformation
//! fields and returns interval k+1:
//!
//! - **Update.** Current Gaussians move with their forward field. An older one that coincides with a current Gaussian
//!   was continued by it one key frame ago (below), so it moves with that one's field, under that one's record. The
//!   rest, the survivors, keep their velocity in the scene's own time and the colour that they had at the key frame.
//!   They fade: γ₀ is at least [`FADE`](super::fuse::FADE), γ₁ = 0, and their opacity at the key frame is the starting
//!   value.
//! - **Keep.** Current Gaussians of static blocks ([`keep`](super::keep)) stay as they are: one record from key frame
//!   to key frame, whose colour may change. They are not matched with others, and from then on precede the new ones in
//!   drawing order. Where the frame has details, a kept one may have another index in the new frame ([`Keeps`]).
//! - **Fuse.** Frame k+1's Gaussians join with their backward field. Identities pass on one to one. Old Gaussians that
//!   coincide with a new one but pass on no identity end as [merged](Merge) into it. Those that coincide with none are
//!   vanishing. Where a depth map lifts either frame, matching ignores depth and a tracked point takes the new
//!   Gaussian's depth. Gaussians added behind others are then matched only among themselves. An old detail passes on
//!   its identity after the others, a new one takes on none. No added Gaussian becomes a survivor.
//! - **Hand over.** Old Gaussians that are continued fade out over the last eighth of the interval, new ones fade in
//!   over the first. So at a key frame the image holds the frame's own Gaussians and the vanishing ones, whichever
//!   interval it is seen from, and crossing it changes no bit.
//! - **Prune.** Vanishing ones are kept while their opacity is at least 1/255 and their age at most `max_age`. Those
//!   that reach `max_age` fade out like continued ones, so that dropping them changes no image either.
//!
//! Pairwise fusion keeps the current Gaussians alone and hands nothing over.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;
use streamsplat_kernels::parallel::map_indexed;
use streamsplat_kernels::raster::ALPHA_MIN;
use streamsplat_model::{StaticGaussian, StaticGaussians};

use super::fuse::{Meeting, fuse};
use super::identities::Identities;
use super::keep::Keeps;
use super::matching::Lattice;
use super::reconstructor::Motion;
use super::{DynamicGaussians, Fusion, Merge, Record, Reference};

/// Gaussians per task.
pub(super) const CHUNK: usize = 2048;

/// One Gaussian of the last key frame, as the stream remembers it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Current {
    /// Its index in the frame's arrays.
    pub cell: u32,
    /// See [`Record::identity`].
    pub identity: u64,
    /// See [`Record::birth`].
    pub birth: u64,
    /// See [`Record::offset`].
    pub offset: [f32; 3],
}

/// The stream's Gaussians at a key frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct CanonicalSet {
    /// The key frame.
    pub(super) frame: u64,
    /// Length of the interval the survivors' velocities belong to.
    pub(super) length: f64,
    /// As they are at the key frame, oldest first.
    pub(super) survivors: Vec<Record>,
    pub(super) current: Vec<Current>,
    /// The frame's arrays.
    pub(super) gaussians: Arc<StaticGaussians>,
    /// The layers they belong to.
    pub(super) layers: Layers,
    pub(super) identities: Identities,
}

/// Layers of a frame's Gaussians, one after another: the model's own, those that a [lift](super::lift) adds along
/// edges, those that it adds behind others, and [details](super::detail).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Layers {
    /// Number of the model's own, on its lattice.
    pub(crate) cells: usize,
    /// Number of these and those along edges.
    pub(crate) outline: usize,
    /// Number of these and those behind others.
    pub(crate) behind: usize,
}

/// The part that a Gaussian has in its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layer {
    /// One of the model's own. Only these become survivors.
    Own,
    /// Added along an edge of depth.
    Outline,
    /// Added behind others.
    Behind,
    /// Added where the fit of colours leaves error.
    Detail,
}

impl Layers {
    /// Layers of a frame that only has Gaussians of the model.
    #[cfg(test)]
    pub(crate) fn of_cells(cells: usize) -> Self {
        Self { cells, outline: cells, behind: cells }
    }

    /// The layer of a Gaussian by its index in the frame's arrays.
    pub(super) fn of(self, index: u32) -> Layer {
        let index = index as usize;
        match index {
            _ if index < self.cells => Layer::Own,
            _ if index < self.outline => Layer::Outline,
            _ if index < self.behind => Layer::Behind,
            _ => Layer::Detail,
        }
    }
}

/// The content of an interval.
#[derive(Debug, Default)]
pub(crate) struct Advance {
    pub(crate) gaussians: DynamicGaussians,
    /// Range of the kept ones.
    pub(crate) kept: Range<usize>,
    pub(crate) merges: Vec<Merge>,
    pub(crate) dropped: u64,
}

/// A key frame by which the set advances.
pub(crate) struct Step<'a> {
    /// The new key frame's Gaussians.
    pub(crate) gaussians: &'a Arc<StaticGaussians>,
    /// The layers they belong to.
    pub(crate) layers: Layers,
    /// Motion of the frame before.
    pub(crate) forward: &'a Motion,
    /// Motion of the new frame.
    pub(crate) backward: &'a Motion,
    /// Seconds between the two.
    pub(crate) length: f64,
    /// True if a depth map lifts the Gaussians of either frame. Maps of two frames are not comparable, so matching then
    /// ignores depth.
    pub(crate) lifted: bool,
    /// Height and width of the image that the Gaussians belong to.
    pub(crate) image: [usize; 2],
    pub(crate) fusion: Fusion,
    pub(crate) max_age: u32,
    /// The Gaussians of the frame before that are kept; `None` where all are computed.
    pub(crate) kept: Option<&'a Keeps>,
}

impl Step<'_> {
    /// The index in the new frame of a Gaussian of the frame before, if it is kept.
    fn keeps(&self, cell: u32) -> Option<u32> {
        self.kept.and_then(|kept| kept.index(cell as usize)).map(|index| index as u32)
    }
}

impl CanonicalSet {
    /// The set after the first frame, and its static scene.
    pub(crate) fn first(gaussians: &Arc<StaticGaussians>, layers: Layers) -> (Self, Advance) {
        let mut set = Self { gaussians: gaussians.clone(), layers, ..Self::default() };
        let mut out = Advance::default();
        for cell in 0..gaussians.len() {
            let record = still(gaussians, cell, 0);
            if !record.is_sound() {
                out.dropped += 1;
            } else if record.opacity >= ALPHA_MIN {
                let identity = set.identities.fresh();
                out.gaussians.push(Record { identity, ..record });
                set.current.push(Current { cell: cell as u32, identity, birth: 0, offset: [0.0; 3] });
            }
        }
        (set, out)
    }

    /// The set after the first frame once its Gaussians are lifted. The model's own keep their identities, and so do
    /// details in the same place; the others get new ones.
    pub(crate) fn lifted(&self, gaussians: &Arc<StaticGaussians>, layers: Layers) -> Self {
        let key = |gaussians: &StaticGaussians, layers: Layers, cell: u32| match layers.of(cell) {
            Layer::Own => Some([cell, 0, 0]),
            Layer::Outline | Layer::Behind => None,
            Layer::Detail => {
                let [x, _, z] = gaussians.position[cell as usize];
                Some([u32::MAX, x.to_bits(), z.to_bits()])
            }
        };
        let known = |current: &Current| Some((key(&self.gaussians, self.layers, current.cell)?, current.identity));
        let known: BTreeMap<[u32; 3], u64> = self.current.iter().filter_map(known).collect();
        let (mut set, _) = Self::first(gaussians, layers);
        set.identities = self.identities.clone();
        for Current { cell, identity, .. } in &mut set.current {
            let known = key(gaussians, layers, *cell).and_then(|key| known.get(&key));
            *identity = known.copied().unwrap_or_else(|| set.identities.fresh());
        }
        set
    }

    /// Returns the set after the next key frame, and the interval up to it. `self` is unchanged.
    pub(crate) fn advance(&self, step: &Step<'_>) -> (Self, Advance) {
        let frame = self.frame + 1;
        let mut out = Advance::default();
        let (mut old, layers) = self.updated(step, &mut out.dropped);
        let kept = self.kept(step);
        let mut new = arriving(step, frame, &mut out.dropped);
        let mut identities = self.identities.clone();
        let survivors = match step.fusion {
            Fusion::Pairwise => {
                new.iter_mut().for_each(|n| n.record.identity = identities.fresh());
                Vec::new()
            }
            Fusion::Persistent => {
                let meeting = Meeting {
                    frame,
                    lattice: Lattice::new(step.layers.cells, step.image),
                    layers: [&layers, &new.iter().map(|arrival| step.layers.of(arrival.cell)).collect::<Vec<_>>()],
                    lifted: step.lifted,
                    max_age: step.max_age,
                };
                let fused = fuse(meeting, &mut old, &mut new, &mut identities);
                out.merges = fused.merges;
                fused.survivors
            }
        };
        let current = |a: &Arrival| Current {
            cell: a.cell,
            identity: a.record.identity,
            birth: a.record.birth,
            offset: a.record.offset,
        };
        // In the order in which they are drawn, so that crossing a key frame changes no bit.
        let staying = |current: &Current| Some(Current { cell: step.keeps(current.cell)?, ..*current });
        let current = self.current.iter().filter_map(staying).chain(new.iter().map(current)).collect();
        out.kept = old.len()..old.len() + kept.len();
        let of_old =
            old.par_chunks(CHUNK).chain(kept.par_chunks(CHUNK)).map(|records| records.iter().copied().collect());
        let of_new =
            new.par_chunks(CHUNK).map(|arrivals| arrivals.iter().filter(|a| a.shown).map(|a| a.record).collect());
        out.gaussians = DynamicGaussians::concat(&of_old.chain(of_new).collect::<Vec<DynamicGaussians>>());
        let set = Self {
            frame,
            length: step.length,
            survivors,
            current,
            gaussians: step.gaussians.clone(),
            layers: step.layers,
            identities,
        };
        (set, out)
    }

    /// Sets the survivors' colours to those at the end of the interval `gaussians`, so that crossing the key frame
    /// changes none.
    pub(super) fn recolour_survivors(&mut self, gaussians: &DynamicGaussians) {
        let mut at = 0;
        for survivor in &mut self.survivors {
            // Survivors are some of the interval's old Gaussians, in their order.
            while gaussians.identity.get(at).is_some_and(|identity| *identity != survivor.identity) {
                at += 1;
            }
            if at == gaussians.len() {
                return;
            }
            survivor.rgb = gaussians.get(at).rgb_at(1.0);
        }
    }

    /// The Gaussians that are kept, over the new interval.
    fn kept(&self, step: &Step<'_>) -> Vec<Record> {
        let record = |current: &Current| {
            let cell = current.cell as usize;
            let (then, now) = (self.gaussians.rgb[cell], step.gaussians.rgb[step.keeps(current.cell)? as usize]);
            Some(Record {
                rgb_rate: std::array::from_fn(|channel| now[channel] - then[channel]),
                identity: current.identity,
                birth: current.birth,
                offset: current.offset,
                ..still(&self.gaussians, cell, self.frame)
            })
        };
        self.current.iter().filter_map(record).collect()
    }

    /// The old Gaussians over the new interval that are not kept: survivors, then the Gaussians of the frame at its
    /// start. Also the layer of each; survivors were the model's own.
    fn updated(&self, step: &Step<'_>, dropped: &mut u64) -> (Vec<Record>, Vec<Layer>) {
        let mut old = Vec::with_capacity(self.survivors.len() + self.current.len());
        // The same velocity in the scene's own time.
        let longer = step.length / self.length;
        for survivor in &self.survivors {
            let velocity = survivor.velocity.map(|v| (f64::from(v) * longer) as f32);
            old.push(Record { velocity, ..*survivor });
        }
        let leaving: Vec<&Current> = self.current.iter().filter(|current| step.keeps(current.cell).is_none()).collect();
        old.par_extend(leaving.par_iter().with_min_len(CHUNK).map(|current| {
            let cell = current.cell as usize;
            Record {
                velocity: step.forward.0[cell],
                gamma: step.forward.1[cell],
                identity: current.identity,
                birth: current.birth,
                offset: current.offset,
                ..still(&self.gaussians, cell, self.frame)
            }
        }));
        let mut layers = vec![Layer::Own; self.survivors.len()];
        layers.extend(leaving.iter().map(|current| self.layers.of(current.cell)));
        let all = old.len();
        if !old.par_iter().with_min_len(CHUNK).all(Record::is_sound) {
            let mut sound = old.iter().map(Record::is_sound);
            layers.retain(|_| sound.next() == Some(true));
            old.retain(Record::is_sound);
        }
        *dropped += (all - old.len()) as u64;
        (old, layers)
    }
}

/// A Gaussian of the new frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    cell: u32,
    pub(super) record: Record,
    /// True if its motion in this interval is sound; otherwise it waits for the next one.
    shown: bool,
}

/// The new frame's Gaussians with their backward field, not yet with identities.
fn arriving(step: &Step<'_>, frame: u64, dropped: &mut u64) -> Vec<Arrival> {
    let count = step.gaussians.position.len();
    let parts = map_indexed(count.div_ceil(CHUNK), |chunk| {
        let mut lost = 0;
        let mut new = Vec::with_capacity(CHUNK);
        for cell in chunk * CHUNK..count.min((chunk + 1) * CHUNK) {
            if step.kept.is_some_and(|kept| kept.holds(cell)) {
                continue;
            }
            let record = still(step.gaussians, cell, frame);
            if !record.is_sound() {
                lost += 1;
                continue;
            }
            if record.opacity < ALPHA_MIN {
                continue;
            }
            let (velocity, gamma) = (step.backward.0[cell], step.backward.1[cell]);
            let moving = Record { velocity, gamma, reference: Reference::End, ..record };
            let shown = moving.is_sound();
            lost += u64::from(!shown);
            new.push(Arrival { cell: cell as u32, record: if shown { moving } else { record }, shown });
        }
        (new, lost)
    });
    let mut new = Vec::with_capacity(count);
    for (part, lost) in parts {
        new.extend(part);
        *dropped += lost;
    }
    new
}

/// Gaussian `cell` of key frame `frame` without motion or identity.
pub(super) fn still(gaussians: &StaticGaussians, cell: usize, frame: u64) -> Record {
    let StaticGaussian { position: mean, scale, thickness, opacity, rgb } = gaussians.get(cell);
    Record { mean, scale, thickness, opacity, rgb, birth: frame, frame, ..Record::default() }
}
