//! The weights of a tile, stored: its splats front to back, and for each the blocks on which it is drawn.

use super::super::blend::{BLOCKS, Block, Lanes, Sink, Transmittance, Walk};
use super::super::project::Splat;
use super::super::sort::Entry;
use crate::simd::{LANES, Operation, Simd};

const _: () = assert!(BLOCKS <= 1 << u8::BITS);

/// Weights of one hit: `α·T` of 4×4 pixels in units of [`UNIT`].
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct Weights(pub [u16; LANES]);

/// Unit of stored weights. An image of stored weights differs from that of the blend by half of it per Gaussian and pixel; half the memory is read in each step of a fit.
pub(super) const UNIT: f32 = 1.0 / 65536.0;

/// Weights `α·T` of a tile. A *hit* is a splat and a block of 4×4 pixels on one of which its stored weight is not zero.
#[derive(Debug, Default)]
pub(super) struct Record {
    /// Gaussian of each splat that has hits, in drawing order.
    pub gaussians: Vec<u32>,
    /// End of each splat's hits.
    pub ends: Vec<u32>,
    /// Block of each hit, ascending for each splat.
    pub blocks: Vec<u8>,
    /// Weights of each hit.
    pub weights: Vec<Weights>,
    /// Transmittance behind all splats, one value per block; zero outside the image.
    pub light: Vec<Lanes>,
}

impl Record {
    /// Bytes of its arrays.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.gaussians)
            + size_of_val(&*self.ends)
            + size_of_val(&*self.blocks)
            + size_of_val(&*self.weights)
            + size_of_val(&*self.light)
    }

    /// The splats: place in the record, Gaussian, hits.
    #[inline(always)]
    pub(super) fn splats(&self) -> impl Iterator<Item = (usize, u32, std::ops::Range<usize>)> + '_ {
        let mut from = 0;
        self.gaussians.iter().zip(&self.ends).enumerate().map(move |(at, (&gaussian, &end))| {
            let hits = from..end as usize;
            from = hits.end;
            (at, gaussian, hits)
        })
    }
}

/// Fills a record.
pub(super) struct RecordTile<'a> {
    pub walk: Walk<'a>,
    pub light: &'a mut Transmittance,
    pub record: &'a mut Record,
}

impl Operation for RecordTile<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let record = self.record;
        record.gaussians.clear();
        record.ends.clear();
        record.blocks.clear();
        record.weights.clear();
        let mut recorder = Recorder { record, blocks: [0; BLOCKS], weights: [Weights([0; LANES]); BLOCKS], hits: 0 };
        self.walk.run(s, self.light, &mut recorder);
        record.light.clear();
        record.light.resize(BLOCKS, Lanes::ZERO);
        for (block, light) in record.light.iter_mut().enumerate() {
            s.store(self.light.last(s, block), &mut light.0);
        }
        debug_assert!(record.blocks.len() == record.weights.len());
    }
}

/// Collects the hits of a splat and appends them to the record.
struct Recorder<'a> {
    record: &'a mut Record,
    blocks: [u8; BLOCKS],
    weights: [Weights; BLOCKS],
    /// Hits of the splat so far.
    hits: usize,
}

impl<S: Simd> Sink<S> for Recorder<'_> {
    type Paint = ();

    #[inline(always)]
    fn begin(&mut self, _: S, _: &Splat) {
        self.hits = 0;
    }

    #[inline(always)]
    fn add(&mut self, s: S, at: Block, weight: S::F32, (): &()) {
        debug_assert!(self.hits < BLOCKS, "a splat visits each block at most once");
        // At most 0.99 / UNIT; rounded half up.
        let stored = s.to_i32(s.mul_add(weight, s.splat(1.0 / UNIT), s.splat(0.5)));
        let place = self.hits & (BLOCKS - 1);
        self.blocks[place] = at.index() as u8;
        s.store_u16(stored, &mut self.weights[place].0);
        // A block without a hit is written over by the next.
        self.hits += usize::from(s.any(s.gt_i32(stored, s.splat_i32(0))));
    }

    #[inline(always)]
    fn end(&mut self, entry: &Entry) {
        let Self { record, blocks, weights, hits } = self;
        if *hits > 0 {
            record.blocks.extend_from_slice(&blocks[..*hits]);
            record.weights.extend_from_slice(&weights[..*hits]);
            record.gaussians.push(entry.index);
            record.ends.push(u32::try_from(record.blocks.len()).expect("fewer than 2³² hits in a tile"));
        }
    }
}
