//! One tile: its list, front to back, onto its blocks of 4×4 pixels.

use super::bin::{Reach, TILE};
use super::project::{ALPHA_MAX, ALPHA_MIN, BLOCK, Splat, TRANSMITTANCE_MIN, split};
use super::sort::Entry;
use crate::parallel::Disjoint;
use crate::simd::{LANES, Operation, Simd};

/// Blocks of a tile.
pub(super) const BLOCKS: usize = TILE[0] * TILE[1];
/// Values kept per block: transmittance, red, green, blue.
const STATE: usize = 4 * LANES;
/// Entries ahead of which a record is fetched.
const AHEAD: usize = 6;
const ALL: u16 = u16::MAX;

const _: () = assert!(TILE[1] <= LANES && BLOCK * BLOCK == LANES);

/// 2^−q for q ≥ 0, at most 4 units in the last place off; exactly 1 for 0; 2^−125 for q ≥ 125 and for NaN.
///
/// q is rounded to the whole number n by adding 1.5·2²³; with g = n − q in [−½, ½], 2^g is a polynomial of degree 5
/// (Chebyshev), and −n goes into the exponent.
#[inline(always)]
pub(super) fn exp2_negative<S: Simd>(s: S, q: S::F32) -> S::F32 {
    const MAGIC: f32 = 12_582_912.0;
    let q = s.min(q, s.splat(125.0));
    let shifted = s.sub(s.splat(MAGIC), q);
    let g = s.neg(s.add(q, s.sub(shifted, s.splat(MAGIC))));
    let mut sum = s.splat(0.001_338_130_2);
    for c in [0.009_666_368, 0.055_503_81, 0.240_223_5, std::f32::consts::LN_2, 1.0] {
        sum = s.mul_add(sum, g, s.splat(c));
    }
    s.from_bits(s.add_i32(s.to_bits(sum), s.shl::<23>(s.to_bits(shifted))))
}

/// What a thread needs to draw a tile.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    state: Vec<f32>,
    depth: Vec<f32>,
    count: Vec<f32>,
    /// Transmittance with which a pixel was finished; its own is zero from then on.
    finished: Vec<f32>,
    done: Vec<u16>,
    pub spare: Vec<Entry>,
    pub tally: Tally,
}

/// Work of the blend.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    /// Blocks blended.
    pub blocks: u64,
    /// Entries of lists that were not looked at because their tile was finished.
    pub unseen: u64,
}

/// Where a drawn tile goes.
pub(super) struct Planes<'a> {
    pub width: usize,
    pub height: usize,
    pub background: [f32; 3],
    pub rgb: Disjoint<'a, f32>,
    pub depth: Option<Disjoint<'a, f32>>,
    pub alpha: Option<Disjoint<'a, f32>>,
    pub final_t: Option<Disjoint<'a, f32>>,
    pub blended: Option<Disjoint<'a, u32>>,
}

/// Draws the tile at (`column`, `row`) of the grid.
pub(super) struct DrawTile<'a> {
    pub splats: &'a [Splat],
    /// In drawing order.
    pub list: &'a [Entry],
    pub separable: bool,
    pub column: usize,
    pub row: usize,
    pub planes: &'a Planes<'a>,
    pub scratch: &'a mut Scratch,
}

impl Operation for DrawTile<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        self.clear();
        let extras = self.planes.depth.is_some() || self.planes.blended.is_some();
        match (self.separable, extras) {
            (true, false) => self.blend::<S, true, false>(s),
            (true, true) => self.blend::<S, true, true>(s),
            (false, false) => self.blend::<S, false, false>(s),
            (false, true) => self.blend::<S, false, true>(s),
        }
        self.store(s);
    }
}

/// Colour and depth of a splat on all lanes.
struct Paint<S: Simd> {
    rgb: [S::F32; 3],
    depth: S::F32,
}

impl DrawTile<'_> {
    /// Transmittance 1 inside the image; pixels outside are finished from the start.
    #[inline(always)]
    fn clear(&mut self) {
        let scratch = &mut *self.scratch;
        scratch.state.clear();
        scratch.state.resize(BLOCKS * STATE, 0.0);
        scratch.finished.resize(BLOCKS * LANES, 0.0);
        scratch.done.clear();
        scratch.done.resize(BLOCKS, 0);
        if self.planes.depth.is_some() || self.planes.blended.is_some() {
            scratch.depth.clear();
            scratch.depth.resize(BLOCKS * LANES, 0.0);
            scratch.count.clear();
            scratch.count.resize(BLOCKS * LANES, 0.0);
        }
        for block in 0..BLOCKS {
            let x = (self.column * TILE[0] + block % TILE[0]) * BLOCK;
            let y = (self.row * TILE[1] + block / TILE[0]) * BLOCK;
            let transmittance = &mut scratch.state[block * STATE..][..LANES];
            if x + BLOCK <= self.planes.width && y + BLOCK <= self.planes.height {
                transmittance.fill(1.0);
                continue;
            }
            for lane in 0..LANES {
                if x + lane % BLOCK < self.planes.width && y + lane / BLOCK < self.planes.height {
                    transmittance[lane] = 1.0;
                } else {
                    scratch.done[block] |= 1 << lane;
                }
            }
        }
    }

    #[inline(always)]
    fn blend<S: Simd, const SEPARABLE: bool, const EXTRAS: bool>(&mut self, s: S) {
        let (first_column, first_row) = (self.column * TILE[0], self.row * TILE[1]);
        let list = self.list;
        let lane_x = s.from_array(std::array::from_fn(|i| (i % BLOCK) as f32));
        let lane = s.from_array(std::array::from_fn(|i| i as f32));
        let mut open = self.scratch.done.iter().filter(|&&done| done != ALL).count();
        let mut across = [0.0_f32; TILE[0] * BLOCK + LANES];
        let mut down = [0.0_f32; TILE[1] * BLOCK + LANES];
        let (mut middle, mut middle_rest) = ([0.0_f32; TILE[1] * BLOCK], [0.0_f32; TILE[1] * BLOCK]);
        for (at, entry) in list.iter().enumerate() {
            if open == 0 {
                self.scratch.tally.unseen += (list.len() - at) as u64;
                break;
            }
            if let Some(next) = list.get(at + AHEAD) {
                s.prefetch(self.splats.as_ptr().wrapping_add(next.index as usize));
            }
            let splat = &self.splats[entry.index as usize];
            let columns = [
                usize::from(splat.columns[0]).max(first_column),
                usize::from(splat.columns[1]).min(first_column + TILE[0] - 1),
            ];
            let rows =
                [usize::from(splat.rows[0]).max(first_row), usize::from(splat.rows[1]).min(first_row + TILE[1] - 1)];
            let (from, to) = strips::<S, SEPARABLE>(s, splat, lane, first_row, columns);
            let paint = Paint::<S> { rgb: splat.rgb.map(|c| s.splat(c)), depth: s.splat(splat.depth) };
            let (p, q, opacity) = (s.splat(splat.p), s.splat(splat.q), s.splat(splat.opacity));
            let (top, height) = (rows[0] * BLOCK, (rows[1] + 1 - rows[0]) * BLOCK);
            if SEPARABLE {
                let [(hi_x, lo_x), (hi_y, lo_y)] = [splat.u, splat.v].map(|v| {
                    let (hi, lo) = split(v);
                    (s.splat(hi), s.splat(lo))
                });
                for block in (columns[0]..=columns[1]).step_by(LANES / BLOCK) {
                    let x = s.add(s.splat((block * BLOCK) as f32), lane);
                    let t = s.mul(p, s.sub(s.sub(x, hi_x), lo_x));
                    s.store(exp2_negative(s, s.mul(t, t)), &mut across[(block - first_column) * BLOCK..]);
                }
                for block in (rows[0]..=rows[1]).step_by(LANES / BLOCK) {
                    let y = s.add(s.splat((block * BLOCK) as f32), lane);
                    let t = s.mul(q, s.sub(s.sub(y, hi_y), lo_y));
                    let factor = s.mul(opacity, exp2_negative(s, s.mul(t, t)));
                    s.store(factor, &mut down[(block - first_row) * BLOCK..]);
                }
            } else {
                for i in 0..height {
                    let dy = (top + i) as f64 - splat.v;
                    (middle[i], middle_rest[i]) = split(splat.u + splat.k * dy);
                    let t = splat.q * dy as f32;
                    down[i] = t * t;
                }
            }
            for row in rows[0] - first_row..=rows[1] - first_row {
                // SAFETY: `row` is a row of the tile, the arrays have four values for each that the splat touches.
                let (along_y, hi_x, lo_x) = unsafe {
                    if SEPARABLE {
                        (s.spread_four(down.as_ptr().add(row * BLOCK)), opacity, opacity)
                    } else {
                        let at = (first_row + row) * BLOCK - top;
                        let of = |values: &[f32]| s.spread_four(values.as_ptr().add(at));
                        (of(&down), of(&middle), of(&middle_rest))
                    }
                };
                let (from, to) = (from[row] as usize, to[row] as usize);
                self.scratch.tally.blocks += (to + 1).saturating_sub(from) as u64;
                for column in from..to + 1 {
                    let block = row * TILE[0] + column - first_column;
                    if self.scratch.done[block] == ALL {
                        continue;
                    }
                    let alpha = if SEPARABLE {
                        // SAFETY: `column` is a column of the tile, `across` has four values for each.
                        let x = unsafe { s.repeat_four(across.as_ptr().add((column - first_column) * BLOCK)) };
                        s.mul(along_y, x)
                    } else {
                        let x = s.add(s.splat((column * BLOCK) as f32), lane_x);
                        let t = s.mul(p, s.sub(s.sub(x, hi_x), lo_x));
                        s.mul(opacity, exp2_negative(s, s.mul_add(t, t, along_y)))
                    };
                    open -= usize::from(composite::<S, EXTRAS>(s, alpha, &paint, self.scratch, block));
                }
            }
        }
    }

    /// Adds the background and writes the planes.
    #[inline(always)]
    fn store<S: Simd>(&mut self, s: S) {
        let planes = self.planes;
        let plane = planes.width * planes.height;
        let background = planes.background.map(|c| s.splat(c));
        for block in 0..BLOCKS {
            let x = (self.column * TILE[0] + block % TILE[0]) * BLOCK;
            let y = (self.row * TILE[1] + block / TILE[0]) * BLOCK;
            if x >= planes.width || y >= planes.height {
                continue;
            }
            let scratch = &*self.scratch;
            let done = s.mask_from_bits(scratch.done[block]);
            let state = &scratch.state[block * STATE..][..STATE];
            let finished = s.load(&scratch.finished[block * LANES..]);
            let transmittance = s.select(done, finished, s.load(state));
            let put = |to: &Disjoint<'_, f32>, base: usize, values: S::F32| {
                put_block(to, base, planes, x, y, &s.to_array(values));
            };
            for channel in 0..3 {
                let colour = s.load(&state[(channel + 1) * LANES..]);
                put(&planes.rgb, channel * plane, s.mul_add(transmittance, background[channel], colour));
            }
            if let Some(to) = &planes.alpha {
                put(to, 0, s.sub(s.splat(1.0), transmittance));
            }
            if let Some(to) = &planes.final_t {
                put(to, 0, transmittance);
            }
            if let Some(to) = &planes.depth {
                put(to, 0, s.load(&scratch.depth[block * LANES..]));
            }
            if let Some(to) = &planes.blended {
                let count = s.to_array(s.load(&scratch.count[block * LANES..]));
                put_block(to, 0, planes, x, y, &count.map(|c| c as u32));
            }
        }
    }
}

/// Writes the pixels of a block that lie in the image.
#[inline(always)]
fn put_block<T: Copy>(to: &Disjoint<'_, T>, base: usize, planes: &Planes<'_>, x: usize, y: usize, values: &[T; LANES]) {
    let (columns, rows) = (BLOCK.min(planes.width - x), BLOCK.min(planes.height - y));
    for row in 0..rows {
        let start = base + (y + row) * planes.width + x;
        // SAFETY: a block belongs to one tile and a tile to one task; its pixels are nobody else's.
        let pixels = unsafe { to.part(start..start + columns) };
        pixels.copy_from_slice(&values[row * BLOCK..][..columns]);
    }
}

/// First and last block column that a footprint can reach in each row of blocks of the tile, inside `columns`.
#[inline(always)]
fn strips<S: Simd, const SEPARABLE: bool>(
    s: S,
    splat: &Splat,
    lane: S::F32,
    first_row: usize,
    columns: [usize; 2],
) -> ([i32; LANES], [i32; LANES]) {
    let reach = Reach::new(splat);
    let splats = |v: f32| s.splat(v);
    let clamp = |v: S::F32, low: S::F32, high: S::F32| s.min(s.max(v, low), high);
    let (bottom, top) = (splats(-reach.height), splats(reach.height));
    let y = s.sub(s.mul_add(lane, splats(BLOCK as f32), splats((first_row * BLOCK) as f32)), splats(reach.y));
    let low = clamp(y, bottom, top);
    let high = clamp(s.add(y, splats(BLOCK as f32 - 1.0)), bottom, top);
    let root = |dy: S::F32| {
        let t = s.mul(splats(reach.q), dy);
        s.sqrt(s.max(s.neg_mul_add(t, t, splats(reach.exponent)), splats(0.0)))
    };
    let (left, right);
    let inverse = splats(1.0 / reach.p);
    if SEPARABLE {
        right = s.mul(root(clamp(splats(0.0), low, high)), inverse);
        left = s.neg(right);
    } else {
        let at_right = clamp(splats(reach.rightmost), low, high);
        let at_left = clamp(splats(-reach.rightmost), low, high);
        right = s.mul_add(splats(reach.k), at_right, s.mul(root(at_right), inverse));
        left = s.sub(s.mul(splats(reach.k), at_left), s.mul(root(at_left), inverse));
    }
    let per_block = splats(1.0 / BLOCK as f32);
    let first = s.floor(s.mul(s.add(splats(reach.x - reach.slack), left), per_block));
    let last = s.floor(s.mul(s.add(splats(reach.x + reach.slack), right), per_block));
    // With NaN bounds the second operand is the result: the box of the footprint.
    let first = s.min(s.max(first, splats(columns[0] as f32)), splats(columns[1] as f32 + 1.0));
    let last = s.max(s.min(last, splats(columns[1] as f32)), splats(columns[0] as f32 - 1.0));
    (s.to_array_i32(s.to_i32(first)), s.to_array_i32(s.to_i32(last)))
}

/// Draws one splat on one block. True when that finished the block.
#[inline(always)]
fn composite<S: Simd, const EXTRAS: bool>(
    s: S,
    alpha: S::F32,
    paint: &Paint<S>,
    scratch: &mut Scratch,
    block: usize,
) -> bool {
    let state = &mut scratch.state[block * STATE..][..STATE];
    let alpha = s.min(alpha, s.splat(ALPHA_MAX));
    let hit = s.le(s.splat(ALPHA_MIN), alpha);
    let transmittance = s.load(state);
    let mut weight = s.mul(s.select(hit, alpha, s.splat(0.0)), transmittance);
    let mut left = s.sub(transmittance, weight);
    // Finished pixels have no transmittance and stay below the threshold.
    let below = s.bits(s.lt(left, s.splat(TRANSMITTANCE_MIN)));
    let mut complete = false;
    if below != scratch.done[block] {
        let mut weights = s.to_array(weight);
        let finished = &mut scratch.finished[block * LANES..][..LANES];
        complete = finish(below, &mut scratch.done[block], &mut state[..LANES], finished, &mut weights);
        weight = s.from_array(weights);
        left = s.sub(s.load(state), weight);
    }
    s.store(left, state);
    for channel in 0..3 {
        let values = &mut state[(channel + 1) * LANES..][..LANES];
        s.store(s.mul_add(weight, paint.rgb[channel], s.load(values)), values);
    }
    if EXTRAS {
        let depth = &mut scratch.depth[block * LANES..][..LANES];
        s.store(s.mul_add(weight, paint.depth, s.load(depth)), depth);
        let count = &mut scratch.count[block * LANES..][..LANES];
        let one = s.select(s.lt(s.splat(0.0), weight), s.splat(1.0), s.splat(0.0));
        s.store(s.add(s.load(count), one), count);
    }
    complete
}

/// Finishes the pixels of `below` that are not in `done`: keeps their transmittance apart, gives this splat no weight on them.
/// True when the block has no other pixels.
#[cold]
#[inline(never)]
fn finish(
    below: u16,
    done: &mut u16,
    transmittance: &mut [f32],
    finished: &mut [f32],
    weights: &mut [f32; LANES],
) -> bool {
    for lane in 0..LANES {
        if (below & !*done) >> lane & 1 != 0 {
            finished[lane] = transmittance[lane];
            transmittance[lane] = 0.0;
            weights[lane] = 0.0;
        }
    }
    *done |= below;
    *done == ALL
}
