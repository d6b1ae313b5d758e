//! Depths at which neighbours on one surface keep the model's order.
//!
//! A key frame's picture is made of Gaussians that overlap, drawn in the order of the model's own y. On a surface that
//! slopes their depths are in another order, and a camera that turns sorts them anew. So neighbours are moved until there
//! is as much room between them in depth as it takes that a camera turned by up to [`SLOPE`] draws them in the model's
//! order:
//!
//! ```text
//! z_j − z_i ≥ SLOPE·|p_i − p_j|        for i before j in the model's order, |p_i − p_j| ≤ WIDE·(σ_i + σ_j),
//!                                      both on one surface by the map's z
//! z_i ← z_i ± mean of what is lacking  over the neighbours of i where something is, in ROUNDS rounds, all i at once
//! ```
//!
//! p: centres in the picture, in the units of z; σ: the larger standard deviation. Two Gaussians lie on one surface
//! where their z differ by less than [`SURFACE`] times what is an edge. The rounds do not reach all of it, which they
//! must not: long rows of neighbours, each a little behind the one before, would bend the surface.
//!
//! Sums run over bins of [`BIN`] pixels row by row, in a bin by index, in binary32.

use streamsplat_kernels::parallel::map_indexed;

/// Change of depth per distance in the picture: the tangent of 10°.
pub(super) const SLOPE: f32 = 0.18;
/// Gaussians are neighbours where their centres are no more than so many of their standard deviations apart.
const WIDE: f32 = 2.0;
/// Differences of depth within one surface, in those of an edge.
const SURFACE: f32 = 2.0;
const ROUNDS: usize = 16;
/// Pixels of a bin's side.
const BIN: usize = 4;
/// Gaussians of a bin that others look at; bins of the model's lattice hold four.
const CROWD: usize = 32;
/// Largest standard deviation that counts, in pixels.
const LARGEST: f32 = 4.0;
/// Gaussians per task.
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

/// A neighbour of a Gaussian.
struct Neighbour {
    index: u32,
    /// Least distance in depth; negative, at least −0, where the neighbour is in front.
    room: f32,
}

/// The neighbours of some Gaussians, one after another.
#[derive(Default)]
struct Neighbours {
    all: Vec<Neighbour>,
    /// Where those of each end.
    ends: Vec<usize>,
}

/// z of each Gaussian of a picture of this height and width, of which all numbers are finite; `edge`: difference of z
/// at an edge.
pub(super) fn keep(lifted: &[Lifted], [height, width]: [usize; 2], edge: f32) -> Vec<f32> {
    let bins = Bins::new(lifted, [height, width]);
    let (unit, surface) = (2.0 / width as f32, SURFACE * edge);
    let sigma = |of: &Lifted| of.sigma.clamp(0.0, LARGEST);
    let parts = map_indexed(lifted.len().div_ceil(CHUNK), |chunk| {
        let mut part = Neighbours::default();
        for (i, own) in lifted.iter().enumerate().skip(chunk * CHUNK).take(CHUNK) {
            bins.visit(own.at, WIDE * (sigma(own) + bins.largest), |index| {
                let other = &lifted[index as usize];
                let [dx, dy] = [other.at[0] - own.at[0], other.at[1] - own.at[1]];
                let distance = dx.mul_add(dx, dy * dy).sqrt();
                let near = distance <= WIDE * (sigma(own) + sigma(other)) && (own.z - other.z).abs() <= surface;
                if near && index as usize != i {
                    let first = own.rank.total_cmp(&other.rank).then(index.cmp(&(i as u32)));
                    let side = if first.is_gt() { 1.0f32 } else { -1.0 };
                    part.all.push(Neighbour { index, room: (SLOPE * distance * unit).copysign(side) });
                }
            });
            part.ends.push(part.all.len());
        }
        part
    });
    let mut z: Vec<f32> = lifted.iter().map(|own| own.z).collect();
    for _ in 0..ROUNDS {
        let moved = map_indexed(parts.len(), |chunk| {
            let part = &parts[chunk];
            let mut start = 0;
            let each = part.ends.iter().zip(&z[chunk * CHUNK..]).map(|(end, own)| {
                let neighbours = &part.all[start..*end];
                start = *end;
                let (mut sum, mut count) = (0.0f32, 0.0f32);
                // Without a branch: what is lacking is as good as random.
                for Neighbour { index, room } in neighbours {
                    let side = 1.0f32.copysign(*room);
                    let lacking = room.abs() - side * (z[*index as usize] - own);
                    sum -= side * lacking.max(0.0);
                    count += f32::from(u8::from(lacking > 0.0));
                }
                if count > 0.0 { own + sum / count } else { *own }
            });
            each.collect::<Vec<f32>>()
        });
        z = moved.concat();
    }
    z
}

/// Gaussians by the bin that their centre lies in.
struct Bins {
    rows: usize,
    columns: usize,
    starts: Vec<u32>,
    members: Vec<u32>,
    /// Largest standard deviation of them.
    largest: f32,
}

impl Bins {
    fn new(lifted: &[Lifted], [height, width]: [usize; 2]) -> Self {
        let [rows, columns] = [height, width].map(|side| side.div_ceil(BIN).max(1));
        let mut bins = Self { rows, columns, starts: Vec::new(), members: Vec::new(), largest: 0.0 };
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
        bins
    }

    // Both saturate below zero and far above.
    fn column(&self, x: f32) -> usize {
        (x as usize / BIN).min(self.columns - 1)
    }

    fn row(&self, y: f32) -> usize {
        (y as usize / BIN).min(self.rows - 1)
    }

    /// Visits the members of all bins that the square around a place meets.
    fn visit(&self, [x, y]: [f32; 2], reach: f32, mut visitor: impl FnMut(u32)) {
        for row in self.row(y - reach)..=self.row(y + reach) {
            let bin = |column: usize| self.starts[row * self.columns + column] as usize;
            for &member in &self.members[bin(self.column(x - reach))..bin(self.column(x + reach) + 1)] {
                visitor(member);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [32, 64];

    /// A lattice of Gaussians on a slope of so much depth per pixel, in a scattered order.
    fn slope(of: f32) -> Vec<Lifted> {
        (0..16 * 32u32)
            .map(|i| {
                let at = [(i % 32 * 2) as f32 + 1.0, (i / 32 * 2) as f32 + 1.0];
                let rank = (i.wrapping_mul(2_654_435_761) >> 8) as f32 / 16_777_216.0;
                Lifted { at, sigma: 1.0, z: of.mul_add(at[0], 0.4), rank }
            })
            .collect()
    }

    /// The share of neighbours that are not in their order.
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
            let z = keep(&lifted, SIZE, 5.0);
            let before: Vec<f32> = lifted.iter().map(|own| own.z).collect();
            assert!(wrong(&lifted, &before) > 0.4 && wrong(&lifted, &z) < 0.05, "{of}: {}", wrong(&lifted, &z));
            // In pixels.
            let moved = |i: usize| (z[i] - before[i]) / unit;
            let mean = (0..z.len()).map(moved).sum::<f32>() / z.len() as f32;
            let most = (0..z.len()).map(|i| moved(i).abs()).fold(0.0, f32::max);
            assert!(mean.abs() < 0.2 && most < 6.0, "{of}: mean {mean}, most {most}");
        }
    }

    #[test]
    fn what_lies_on_another_surface_stays() {
        let edge = 0.1;
        let mut lifted = slope(0.0);
        for (i, own) in lifted.iter_mut().enumerate() {
            // In front the order says otherwise.
            (own.z, own.rank) = if i % 2 == 0 { (0.2, 0.0) } else { (0.5, 1.0) };
        }
        let z = keep(&lifted, SIZE, edge);
        assert!(z.iter().enumerate().all(|(i, z)| (z - if i % 2 == 0 { 0.2 } else { 0.5 }).abs() < 0.15));
    }

    #[test]
    fn a_crowd_huge_ones_and_places_outside_take_no_more_than_their_bounds() {
        let one = Lifted { at: [3.0, 3.0], sigma: 1e30, z: 0.5, rank: 0.5 };
        let mut lifted = vec![one; 100_000];
        lifted[1].at = [-1e30, 1e30];
        lifted[2].at = [f32::MAX, f32::MIN];
        let z = keep(&lifted, SIZE, 0.1);
        assert!(z.len() == lifted.len() && z.iter().all(|z| z.is_finite()));
        assert!(keep(&[], [1, 1], 0.1).is_empty());
    }
}
