//! Depths at which neighbours on one surface keep the model's drawing order.
//!
//! A key frame's picture is made of overlapping Gaussians, drawn in the order of the model's own y. On a sloping
//! surface their depths are in another order, and a turning camera sorts them anew. So neighbours are moved apart in
//! depth until a camera turned by up to [`SLOPE`] draws them in the model's order:
//!
//! ```text
//! z_j − z_i ≥ SLOPE·|p_i − p_j|        for i before j in the model's order, |p_i − p_j| ≤ WIDE·(σ_i + σ_j),
//!                                      both on one surface by the map's z
//! z_i ← z_i ± mean missing distance    over the neighbours of i that lack some, in ROUNDS rounds, all i at once
//! ```
//!
//! p: centres in the picture, in the units of z; σ: the larger standard deviation. Two Gaussians are on one surface
//! where their z differ by less than [`SURFACE`] times the difference that makes an edge. The rounds deliberately stop
//! before convergence: long rows of neighbours, each a little behind the previous one, would bend the surface.
//!
//! Sums run over bins of [`BIN`] pixels row by row, in a bin by index, in binary32.

use std::ops::Range;

use streamsplat_kernels::Level;
use streamsplat_kernels::parallel::map_indexed;
use streamsplat_kernels::simd::{LANES, Operation, Simd, dispatch};

/// Change of depth per distance in the picture: the tangent of 10°.
pub(super) const SLOPE: f32 = 0.18;
/// Gaussians are neighbours where their centres are no farther apart than this multiple of the sum of their standard
/// deviations.
const WIDE: f32 = 2.0;
/// Largest difference of depth within one surface, relative to that of an edge.
const SURFACE: f32 = 2.0;
const ROUNDS: usize = 16;
/// Pixels of a bin's side.
const BIN: usize = 4;
/// Most Gaussians of a bin that count as neighbours; bins of the model's lattice hold four.
const CROWD: usize = 32;
/// Largest standard deviation that counts, in pixels.
const LARGEST: f32 = 4.0;
/// Gaussians per task, whole vectors of them.
const CHUNK: usize = 1024;

/// A Gaussian on its surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lifted {
    /// Column and row of its centre, in pixels.
    pub(super) at: [f32; 2],
    /// Its larger standard deviation, in pixels.
    pub(super) sigma: f32,
    /// z in the scene, by the map.
    pub(super) z: f32,
    /// y of the model, 1 nearest.
    pub(super) rank: f32,
}

impl Lifted {
    /// The standard deviation that counts.
    fn sigma(&self) -> f32 {
        self.sigma.clamp(0.0, LARGEST)
    }
}

/// A neighbour of each Gaussian of a vector.
#[derive(Clone, Copy)]
struct Neighbours {
    index: [u32; LANES],
    /// Least distance in depth; negative, or −0, where the neighbour is in front. A Gaussian with fewer neighbours than
    /// others of the vector is padded with itself at distance 0, where nothing is lacking. Lanes past the last Gaussian
    /// are not read.
    room: [f32; LANES],
}

/// The neighbours of the Gaussians of a task, one vector after another.
#[derive(Default)]
struct Part {
    all: Vec<Neighbours>,
    /// End of each vector's neighbours in `all`.
    ends: Vec<usize>,
}

/// Returns z of each Gaussian of a picture of this height and width. All numbers must be finite. `edge`: difference of
/// z at an edge.
pub(super) fn keep(level: Level, lifted: &[Lifted], [height, width]: [usize; 2], edge: f32) -> Vec<f32> {
    let bins = Bins::new(lifted, [height, width]);
    let (unit, surface) = (2.0 / width as f32, SURFACE * edge);
    let count = lifted.len().div_ceil(CHUNK);
    let start = |chunk: usize| chunk * CHUNK;
    let parts =
        map_indexed(count, |chunk| dispatch(level, Search { lifted, bins: &bins, start: start(chunk), unit, surface }));
    let mut z: Vec<f32> = lifted.iter().map(|own| own.z).collect();
    for _ in 0..ROUNDS {
        let moved =
            map_indexed(count, |chunk| dispatch(level, Round { part: &parts[chunk], z: &z, start: start(chunk) }));
        z = moved.concat();
    }
    z
}

/// The search for the neighbours of a task's Gaussians.
struct Search<'a> {
    lifted: &'a [Lifted],
    bins: &'a Bins,
    start: usize,
    unit: f32,
    surface: f32,
}

impl Operation for Search<'_> {
    type Output = Part;
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Part {
        let mut part = Part::default();
        let end = (self.start + CHUNK).min(self.lifted.len());
        for first in (self.start..end).step_by(LANES) {
            let begin = part.all.len();
            let own = |lane: usize| (first + lane).min(end - 1) as u32;
            let themselves = Neighbours { index: std::array::from_fn(own), room: [0.0; LANES] };
            for i in first..(first + LANES).min(end) {
                let mut found = begin;
                self.each(s, i, |index, room| {
                    if found == part.all.len() {
                        part.all.push(themselves);
                    }
                    let neighbours = &mut part.all[found];
                    (neighbours.index[i - first], neighbours.room[i - first]) = (index, room);
                    found += 1;
                });
            }
            part.ends.push(part.all.len());
        }
        part
    }
}

impl Search<'_> {
    /// Visits the neighbours of a Gaussian.
    #[inline(always)]
    fn each<S: Simd>(&self, s: S, i: usize, mut visitor: impl FnMut(u32, f32)) {
        let (own, bins) = (&self.lifted[i], self.bins);
        let (x, y, sigma, z) = (s.splat(own.at[0]), s.splat(own.at[1]), s.splat(own.sigma()), s.splat(own.z));
        for members in bins.around(own.at, WIDE * (own.sigma() + bins.largest)) {
            for start in members.clone().step_by(LANES) {
                let other = |value: usize| s.load(&bins.values[value][start..]);
                let (dx, dy) = (s.sub(other(0), x), s.sub(other(1), y));
                let distance = s.sqrt(s.mul_add(dx, dx, s.mul(dy, dy)));
                let wide = s.mul(s.splat(WIDE), s.add(sigma, other(2)));
                let same = s.le(s.abs(s.sub(z, other(3))), s.splat(self.surface));
                let mut near = s.bits(s.and(s.le(distance, wide), same));
                if members.end - start < LANES {
                    near &= (1 << (members.end - start)) - 1;
                }
                let room = s.to_array(s.mul(s.mul(s.splat(SLOPE), distance), s.splat(self.unit)));
                while near != 0 {
                    let lane = near.trailing_zeros() as usize;
                    near &= near - 1;
                    let index = bins.members[start + lane];
                    if index as usize != i {
                        let rank = bins.values[4][start + lane];
                        let first = own.rank.total_cmp(&rank).then(index.cmp(&(i as u32)));
                        visitor(index, room[lane].copysign(if first.is_gt() { 1.0 } else { -1.0 }));
                    }
                }
            }
        }
    }
}

/// One round for the Gaussians of a task.
struct Round<'a> {
    part: &'a Part,
    z: &'a [f32],
    start: usize,
}

impl Operation for Round<'_> {
    type Output = Vec<f32>;
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Vec<f32> {
        let z = &self.z[self.start..];
        let mut moved = vec![0.0; z.len().min(CHUNK)];
        let mut start = 0;
        for ((out, own), end) in moved.chunks_mut(LANES).zip(z.chunks(LANES)).zip(&self.part.ends) {
            let own = s.load_partial(own, 0.0);
            let (mut sum, mut count) = (s.splat(0.0), s.splat(0.0));
            for Neighbours { index, room } in &self.part.all[start..*end] {
                let room = s.from_array(*room);
                let front = s.and_i32(s.to_bits(room), s.splat_i32(i32::MIN));
                let signed = |x: S::F32| s.from_bits(s.xor_i32(s.to_bits(x), front));
                let mut other = [0.0; LANES];
                for lane in 0..LANES {
                    other[lane] = self.z[index[lane] as usize];
                }
                let other = s.from_array(other);
                let lacking = s.sub(s.abs(room), signed(s.sub(other, own)));
                sum = s.sub(sum, signed(s.max(lacking, s.splat(0.0))));
                count = s.add(count, s.keep(s.lt(s.splat(0.0), lacking), s.splat(1.0)));
            }
            start = *end;
            s.store_partial(s.select(s.lt(s.splat(0.0), count), s.add(own, s.div(sum, count)), own), out);
        }
        moved
    }
}

/// Gaussians by the bin that contains their centre.
struct Bins {
    rows: usize,
    columns: usize,
    starts: Vec<u32>,
    members: Vec<u32>,
    /// Column, row, standard deviation, z and rank of the members, padded by a vector after the last.
    values: [Vec<f32>; 5],
    /// Largest standard deviation of the members.
    largest: f32,
}

impl Bins {
    fn new(lifted: &[Lifted], [height, width]: [usize; 2]) -> Self {
        let [rows, columns] = [height, width].map(|side| side.div_ceil(BIN).max(1));
        let mut bins =
            Self { rows, columns, starts: Vec::new(), members: Vec::new(), values: Default::default(), largest: 0.0 };
        let mut of_bins: Vec<Vec<u32>> = vec![Vec::new(); rows * columns];
        for (i, own) in lifted.iter().enumerate() {
            let bin = &mut of_bins[bins.row(own.at[1]) * columns + bins.column(own.at[0])];
            if bin.len() < CROWD {
                bin.push(i as u32);
                bins.largest = bins.largest.max(own.sigma.min(LARGEST));
            }
        }
        bins.starts.push(0);
        for bin in of_bins {
            bins.members.extend(bin);
            bins.starts.push(bins.members.len() as u32);
        }
        let value = |of: fn(&Lifted) -> f32| -> Vec<f32> {
            let members = bins.members.iter().map(|member| of(&lifted[*member as usize]));
            members.chain([0.0; LANES]).collect()
        };
        let [x, y] = [value(|of| of.at[0]), value(|of| of.at[1])];
        bins.values = [x, y, value(Lifted::sigma), value(|of| of.z), value(|of| of.rank)];
        bins
    }

    // Both casts saturate below zero and far above.
    fn column(&self, x: f32) -> usize {
        (x as usize / BIN).min(self.columns - 1)
    }

    fn row(&self, y: f32) -> usize {
        (y as usize / BIN).min(self.rows - 1)
    }

    /// The members of all bins that meet the square around a place, row by row.
    fn around(&self, [x, y]: [f32; 2], reach: f32) -> impl Iterator<Item = Range<usize>> {
        let columns = [self.column(x - reach), self.column(x + reach) + 1];
        let bin = move |row: usize, column: usize| self.starts[row * self.columns + column] as usize;
        (self.row(y - reach)..=self.row(y + reach)).map(move |row| bin(row, columns[0])..bin(row, columns[1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [32, 64];

    /// A lattice of Gaussians on a slope of `of` in depth per pixel, in a scattered order.
    fn slope(of: f32) -> Vec<Lifted> {
        (0..16 * 32u32)
            .map(|i| {
                let at = [(i % 32 * 2) as f32 + 1.0, (i / 32 * 2) as f32 + 1.0];
                let rank = (i.wrapping_mul(2_654_435_761) >> 8) as f32 / 16_777_216.0;
                Lifted { at, sigma: 1.0, z: of.mul_add(at[0], 0.4), rank }
            })
            .collect()
    }

    /// The share of neighbours that are out of order.
    fn wrong(lifted: &[Lifted], z: &[f32]) -> f64 {
        let (mut wrong, mut all) = (0, 0);
        for i in 0..z.len() {
            for j in 0..i {
                let [dx, dy] = [0, 1].map(|axis| lifted[i].at[axis] - lifted[j].at[axis]);
                if dx.hypot(dy) <= 4.0 {
                    all += 1;
                    wrong += u32::from((lifted[i].rank > lifted[j].rank) != (z[i] < z[j]));
                }
            }
        }
        f64::from(wrong) / f64::from(all)
    }

    #[test]
    fn neighbours_on_a_slope_keep_their_order_and_the_slope_stays() {
        let unit = 2.0 / 64.0;
        for of in [0.0, 0.2 * unit, -0.5 * unit] {
            let lifted = slope(of);
            let z = keep(Level::scalar(), &lifted, SIZE, 5.0);
            let before: Vec<f32> = lifted.iter().map(|own| own.z).collect();
            assert!(wrong(&lifted, &before) > 0.4 && wrong(&lifted, &z) < 0.05, "{of}: {}", wrong(&lifted, &z));
            // In pixels.
            let moved = |i: usize| (z[i] - before[i]) / unit;
            let mean = (0..z.len()).map(moved).sum::<f32>() / z.len() as f32;
            let most = (0..z.len()).map(|i| moved(i).abs()).fold(0.0, f32::max);
            assert!(mean.abs() < 0.2 && most < 6.0, "{of}: mean {mean}, most {most}");
        }
    }

    /// z computed directly from the definition, one neighbour after another; no bin is crowded.
    fn plainly(lifted: &[Lifted], width: usize, edge: f32) -> Vec<f32> {
        let unit = 2.0 / width as f32;
        let bin = |own: &Lifted| [own.at[1], own.at[0]].map(|x| x as usize / BIN);
        let mut order: Vec<usize> = (0..lifted.len()).collect();
        order.sort_by_key(|i| bin(&lifted[*i]));
        let mut z: Vec<f32> = lifted.iter().map(|own| own.z).collect();
        for _ in 0..ROUNDS {
            let moved = |(i, own): (usize, &Lifted)| {
                let (mut sum, mut count) = (0.0f32, 0.0f32);
                for &j in order.iter().filter(|j| **j != i) {
                    let other = &lifted[j];
                    let [dx, dy] = [0, 1].map(|axis| other.at[axis] - own.at[axis]);
                    let distance = dx.mul_add(dx, dy * dy).sqrt();
                    if distance <= WIDE * (own.sigma + other.sigma) && (own.z - other.z).abs() <= SURFACE * edge {
                        let side = if (own.rank, j) > (other.rank, i) { 1.0 } else { -1.0 };
                        let lacking = SLOPE * distance * unit - side * (z[j] - z[i]);
                        if lacking > 0.0 {
                            (sum, count) = (sum - side * lacking, count + 1.0);
                        }
                    }
                }
                if count > 0.0 { z[i] + sum / count } else { z[i] }
            };
            z = lifted.iter().enumerate().map(moved).collect();
        }
        z
    }

    #[test]
    fn every_level_gives_the_bits_of_the_definition() {
        // In the narrow picture neighbours are at the end of one row of bins and at the start of the next.
        for (width, largest) in [(SIZE[1], 1.5), (SIZE[1] / 4, LARGEST)] {
            let mut lifted = slope(0.01);
            // Not whole vectors, in all or in a row of bins; several sizes, some equal ranks.
            let mut count = 0;
            lifted.retain(|_| {
                count += 1;
                count % 11 != 3
            });
            for (i, own) in lifted.iter_mut().enumerate() {
                own.at[0] *= width as f32 / SIZE[1] as f32;
                own.sigma = (i % 7 + 1) as f32 / 7.0 * largest;
                own.rank = (own.rank * 64.0).floor();
            }
            let expected = plainly(&lifted, width, 0.05);
            assert!(wrong(&lifted, &expected) < wrong(&lifted, &lifted.iter().map(|own| own.z).collect::<Vec<_>>()));
            for level in Level::available() {
                assert_eq!(keep(level, &lifted, [SIZE[0], width], 0.05), expected, "{level}, {width} pixels wide");
            }
        }
    }

    #[test]
    fn what_lies_on_another_surface_stays() {
        let edge = 0.1;
        let mut lifted = slope(0.0);
        for (i, own) in lifted.iter_mut().enumerate() {
            // In front of the others, where the order is the opposite.
            (own.z, own.rank) = if i % 2 == 0 { (0.2, 0.0) } else { (0.5, 1.0) };
        }
        let z = keep(Level::scalar(), &lifted, SIZE, edge);
        assert!(z.iter().enumerate().all(|(i, z)| (z - if i % 2 == 0 { 0.2 } else { 0.5 }).abs() < 0.15));
    }

    #[test]
    fn a_crowd_huge_ones_and_places_outside_take_no_more_than_their_bounds() {
        let one = Lifted { at: [3.0, 3.0], sigma: 1e30, z: 0.5, rank: 0.5 };
        let mut lifted = vec![one; 100_000];
        lifted[1].at = [-1e30, 1e30];
        lifted[2].at = [f32::MAX, f32::MIN];
        let z = keep(Level::scalar(), &lifted, SIZE, 0.1);
        assert!(z.len() == lifted.len() && z.iter().all(|z| z.is_finite()));
        assert!(keep(Level::scalar(), &[], [1, 1], 0.1).is_empty());
    }
}
