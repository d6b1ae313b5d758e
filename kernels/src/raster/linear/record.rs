//! The weights of a tile, stored: its splats front to back, and for each the blocks on which it is drawn.

use super::super::blend::{BLOCKS, Block, BlockSet, Lanes, Sink, Transmittance, Walk};
use super::super::project::Splat;
use super::super::sort::Entry;
use crate::simd::{LANES, Operation, Simd};

const _: () = assert!(BLOCKS <= 1 << u8::BITS);

/// Weights of one hit: `α·T` of 4×4 pixels in units of [`Unit::value`], at most [`MOST`].
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(super) struct Weights(pub [u8; LANES]);

/// Largest stored weight.
const MOST: f32 = 255.0;

/// Unit of the stored weights of a hit, a power of two: the biased exponent of its binary32.
///
/// An image of stored weights differs from that of the blend by half a unit per Gaussian and pixel (a whole one where a
/// weight would be 256 units). Each step of a fit reads little more than a quarter of the memory that binary32 would
/// take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit(u8);

impl Unit {
    /// 2⁻¹⁶
    const LEAST: Unit = Unit(127 - 16);

    /// The smallest unit, at least 2⁻¹⁶, with a hit's largest weight (below 1) less than 256 units.
    #[inline(always)]
    fn of(most: f32) -> Unit {
        // 2⁸ units are the power of two above a weight: its exponent and one more.
        Unit(((most.to_bits() >> 23) as u8).saturating_sub(7).max(Self::LEAST.0))
    }

    #[inline(always)]
    pub(super) fn value(self) -> f32 {
        f32::from_bits(u32::from(self.0) << 23)
    }
}

/// Weights `α·T` of a tile. A *hit* is a splat and a block of 4×4 pixels with a nonzero stored weight on at least one
/// pixel, and a weight that is not below the least on one of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Record {
    /// Gaussian of each splat that has hits, in drawing order.
    pub gaussians: Vec<u32>,
    /// End of each splat's hits.
    pub ends: Vec<u32>,
    /// Block of each hit, ascending for each splat.
    pub blocks: Vec<u8>,
    /// Weights of each hit.
    pub weights: Vec<Weights>,
    /// Unit of each hit's weights.
    pub units: Vec<Unit>,
    /// Transmittance behind all splats, one value per block; zero outside the image and on blocks that are left out.
    pub light: Vec<Lanes>,
    /// Red, green and blue of the weights below the least, one value per block; empty where there is no least weight.
    pub rest: Vec<[Lanes; 3]>,
}

impl Record {
    /// Bytes of its arrays.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.gaussians)
            + size_of_val(&*self.ends)
            + size_of_val(&*self.blocks)
            + size_of_val(&*self.weights)
            + size_of_val(&*self.units)
            + size_of_val(&*self.light)
            + size_of_val(&*self.rest)
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

    /// Block, weights and unit of some hits.
    #[inline(always)]
    pub(super) fn hits(&self, hits: std::ops::Range<usize>) -> impl Iterator<Item = (&u8, (&Weights, &Unit))> + '_ {
        self.blocks[hits.clone()].iter().zip(self.weights[hits.clone()].iter().zip(&self.units[hits]))
    }
}

/// Fills a record.
pub(super) struct RecordTile<'a> {
    pub walk: Walk<'a>,
    /// The blocks whose weights are recorded.
    pub wanted: BlockSet,
    pub light: &'a mut Transmittance,
    pub record: &'a mut Record,
    /// The least weight.
    pub least: f32,
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
        record.units.clear();
        record.rest.clear();
        if self.least > 0.0 {
            record.rest.resize(BLOCKS, [Lanes::ZERO; 3]);
        }
        let mut recorder = Recorder {
            record,
            least: self.least,
            blocks: [0; BLOCKS],
            weights: [Weights([0; LANES]); BLOCKS],
            units: [Unit::LEAST; BLOCKS],
            hits: 0,
        };
        self.walk.run_on(s, self.light, self.wanted, &mut recorder);
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
    units: [Unit; BLOCKS],
    /// Hits of the splat so far.
    hits: usize,
    least: f32,
}

impl<S: Simd> Sink<S> for Recorder<'_> {
    type Paint = [S::F32; 3];

    #[inline(always)]
    fn begin(&mut self, s: S, splat: &Splat, _: &Entry) -> [S::F32; 3] {
        self.hits = 0;
        splat.rgb.map(|c| s.splat(c))
    }

    #[inline(always)]
    fn add(&mut self, s: S, at: Block, weight: S::F32, paint: &[S::F32; 3]) {
        debug_assert!(self.hits < BLOCKS, "a splat visits each block at most once");
        let most = s.max_lane(weight);
        if most < self.least {
            let rest = &mut self.record.rest[at.index()];
            for (rest, paint) in rest.iter_mut().zip(paint) {
                s.store(s.mul_add(weight, *paint, s.load(&rest.0)), &mut rest.0);
            }
            return;
        }
        let unit = Unit::of(most);
        // Rounded half up; the unit's inverse is exact.
        let stored = s.mul_add(weight, s.splat(1.0 / unit.value()), s.splat(0.5));
        let stored = s.to_i32(s.min(stored, s.splat(MOST)));
        let place = self.hits & (BLOCKS - 1);
        self.blocks[place] = at.index() as u8;
        self.weights[place] = Weights(s.low_bytes(stored));
        self.units[place] = unit;
        // A block without a hit is written over by the next.
        self.hits += usize::from(s.any(s.gt_i32(stored, s.splat_i32(0))));
    }

    #[inline(always)]
    fn end(&mut self, entry: &Entry) {
        let Self { record, blocks, weights, units, hits, .. } = self;
        if *hits > 0 {
            record.blocks.extend_from_slice(&blocks[..*hits]);
            record.weights.extend_from_slice(&weights[..*hits]);
            record.units.extend_from_slice(&units[..*hits]);
            record.gaussians.push(entry.index);
            record.ends.push(u32::try_from(record.blocks.len()).expect("fewer than 2³² hits in a tile"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_the_smallest_power_of_two_that_holds_the_largest_weight() {
        let mut weights = vec![0.99, 0.5, 0.25, 0.3, f32::MIN_POSITIVE, 1e-40, 0.0];
        weights.extend((1..30).flat_map(|i| [0.5_f32.powi(i).next_down(), 0.5_f32.powi(i), 0.5_f32.powi(i).next_up()]));
        for most in weights {
            let unit = Unit::of(most);
            let found = unit.value();
            assert_eq!(found.to_bits() & 0x007f_ffff, 0, "{most}: {found} is no power of two");
            assert!(most < 256.0 * found, "{most}: {found}");
            assert!(unit == Unit::LEAST || most >= 128.0 * found, "{most}: {found}");
        }
    }
}
