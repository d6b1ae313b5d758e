//! Matching of a new frame's Gaussians with the old ones that they continue.
//!
//! An old Gaussian *coincides* with a new one whose position is in its footprint: with d from the old tracked point to
//! the new position, `q = (d_x/r_x)² + (d_y/r_y)² + (d_z/r_z)² ≤ 1`. The radii r are two standard deviations, limited
//! to one to two grid cells across the image, and to 0.05 to 0.2 in normalised inverse depth (which every frame
//! normalises anew, so that it shifts by some per cent).
//!
//! - The *host* of an old Gaussian is the coinciding new one of smallest q (ties: lower index).
//! - Identities go one to one: all coinciding pairs in ascending q (ties: lower new, then lower old index), each
//!   accepted when neither side is matched yet. The frame before goes first; older survivors share the rest. They are
//!   found by deferred acceptance, without sorting pairs: each old one offers itself to its candidates in ascending
//!   order, a new one keeps the best offer.
//!
//! New Gaussians are binned over the image with one cell each on average, and a query visits at most six by six bins,
//! so the cost is near-linear. To keep it so when many positions coincide, a query reads at most [`PER_BIN`] records of
//! a bin (the lowest indices) and keeps at most [`CANDIDATES`] pairs (the smallest q).
//!
//! The hierarchy of boxes of [`crate::space`] finds the same pairs (`by_tree.rs` tests it) but is several times slower
//! to build and to search: positions on a lattice are already binned, and a probe's footprint is a cell or two.

use streamsplat_kernels::parallel::map_indexed;

/// Old Gaussians per task.
const CHUNK: usize = 2048;
/// Records of a bin that a query reads.
const PER_BIN: usize = 64;
/// Pairs that one old Gaussian takes part in.
const CANDIDATES: usize = 8;
/// Smallest and largest radius along the normalised inverse depth.
const DEPTH_RADIUS: [f32; 2] = [0.05, 0.2];

/// The lattice of a frame's Gaussians, one per cell on average, over [−1, 1]².
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lattice {
    columns: usize,
    rows: usize,
}

impl Lattice {
    /// The lattice of `count` Gaussians over an image of `[height, width]`.
    pub(crate) fn new(count: usize, [height, width]: [usize; 2]) -> Self {
        let columns = (count as f64 * width as f64 / height.max(1) as f64).sqrt().round();
        let columns = (columns as usize).clamp(1, count.max(1));
        Self { columns, rows: count.div_ceil(columns).max(1) }
    }

    fn cell(&self) -> [f32; 2] {
        [2.0 / self.columns as f32, 2.0 / self.rows as f32]
    }

    /// Radii of the footprint of a Gaussian of this scale.
    pub(crate) fn radii(&self, [sx, sz]: [f32; 2]) -> [f32; 3] {
        let [cx, cz] = self.cell();
        let [least, most] = DEPTH_RADIUS;
        [(2.0 * sx).clamp(cx, 2.0 * cx), (sx + sz).clamp(least, most), (2.0 * sz).clamp(cz, 2.0 * cz)]
    }

    /// Column of an x, clamped to the lattice.
    fn column(&self, x: f32) -> usize {
        // Saturates below zero and far above.
        (((x + 1.0) * 0.5 * self.columns as f32) as usize).min(self.columns - 1)
    }

    /// Row of a z, clamped to the lattice.
    fn row(&self, z: f32) -> usize {
        (((1.0 - z) * 0.5 * self.rows as f32) as usize).min(self.rows - 1)
    }
}

/// An old Gaussian to match.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Probe {
    /// Its tracked point at the key frame.
    pub(crate) point: [f32; 3],
    /// Its footprint's radii.
    pub(crate) radii: [f32; 3],
    /// True if it is from the frame before: these go first.
    pub(crate) recent: bool,
}

/// Result of the matching.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Matches {
    /// Per old Gaussian, the new one it coincides with best.
    pub(crate) host: Vec<Option<u32>>,
    /// Per new Gaussian, the old one whose identity it inherits.
    pub(crate) parent: Vec<Option<u32>>,
}

/// Matches old Gaussians with the positions of new ones.
pub(crate) fn match_up(lattice: Lattice, old: &[Probe], new: &[[f32; 3]]) -> Matches {
    let bins = Bins::new(lattice, new);
    let parts = map_indexed(old.len().div_ceil(CHUNK), |chunk| {
        let start = chunk * CHUNK;
        let probes = &old[start..old.len().min(start + CHUNK)];
        let mut part = Candidates::default();
        let mut near = Vec::with_capacity(64);
        for probe in probes {
            bins.coinciding(probe, new, &mut near);
            near.sort_unstable();
            part.of_all.extend(near.iter().take(CANDIDATES));
            part.ends.push(part.of_all.len());
        }
        part
    });
    let mut host = Vec::with_capacity(old.len());
    for part in &parts {
        host.extend((0..part.ends.len()).map(|at| part.of(at).first().map(|&(_, new)| new)));
    }
    // The keys of pairs differ and both sides prefer lower ones. So there is one stable matching, the one that accepts
    // pairs in ascending order.
    let mut holder: Vec<Option<Holder>> = vec![None; new.len()];
    for (chunk, part) in parts.iter().enumerate() {
        for at in 0..part.ends.len() {
            let mut offer = Some((chunk * CHUNK + at, 0));
            while let Some((index, rank)) = offer {
                let candidates = parts[index / CHUNK].of(index % CHUNK);
                let Some(&(q, new)) = candidates.get(rank) else { break };
                let mine = Holder { key: (!old[index].recent, q, index as u32), rank: rank as u32 };
                let place = &mut holder[new as usize];
                offer = match *place {
                    Some(other) if other.key < mine.key => Some((index, rank + 1)),
                    before => {
                        *place = Some(mine);
                        before.map(|before| (before.key.2 as usize, before.rank as usize + 1))
                    }
                };
            }
        }
    }
    Matches { host, parent: holder.into_iter().map(|holder| holder.map(|holder| holder.key.2)).collect() }
}

/// New Gaussians that coincide with some old ones: (bits of q, index), ascending for each.
#[derive(Default)]
struct Candidates {
    of_all: Vec<(u32, u32)>,
    /// End of each old one's candidates.
    ends: Vec<usize>,
}

impl Candidates {
    /// The candidates of old Gaussian `at` of the chunk.
    fn of(&self, at: usize) -> &[(u32, u32)] {
        let start = if at == 0 { 0 } else { self.ends[at - 1] };
        &self.of_all[start..self.ends[at]]
    }
}

/// The old Gaussian that a new one is matched with so far.
#[derive(Clone, Copy)]
struct Holder {
    /// Order among those that coincide with the new one: the frame before first, then q (non-negative floats order as
    /// their bits do), then the index.
    key: (bool, u32, u32),
    /// Index of the new one among the old one's candidates.
    rank: u32,
}

/// Indices of positions by lattice cell, ascending within a cell.
struct Bins {
    lattice: Lattice,
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Bins {
    fn new(lattice: Lattice, positions: &[[f32; 3]]) -> Self {
        let bin = |p: &[f32; 3]| lattice.row(p[2]) * lattice.columns + lattice.column(p[0]);
        let mut starts = vec![0u32; lattice.rows * lattice.columns + 1];
        for p in positions {
            starts[bin(p) + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut members = vec![0; positions.len()];
        for (index, p) in positions.iter().enumerate() {
            let slot = &mut next[bin(p)];
            members[*slot as usize] = index as u32;
            *slot += 1;
        }
        Self { lattice, starts, members }
    }

    /// The pairs (bits of q, index) that coincide with the probe.
    fn coinciding(&self, probe: &Probe, positions: &[[f32; 3]], near: &mut Vec<(u32, u32)>) {
        near.clear();
        let ([x, y, z], [rx, ry, rz]) = (probe.point, probe.radii);
        for row in self.lattice.row(z + rz)..=self.lattice.row(z - rz) {
            for column in self.lattice.column(x - rx)..=self.lattice.column(x + rx) {
                let bin = row * self.lattice.columns + column;
                let members = &self.members[self.starts[bin] as usize..self.starts[bin + 1] as usize];
                for &index in members.iter().take(PER_BIN) {
                    let p = positions[index as usize];
                    let [dx, dy, dz] = [(p[0] - x) / rx, (p[1] - y) / ry, (p[2] - z) / rz];
                    let q = dx * dx + dy * dy + dz * dz;
                    if q <= 1.0 {
                        near.push((q.to_bits(), index));
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod by_tree;

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(rows: usize, columns: usize, shift: [f32; 2]) -> Vec<[f32; 3]> {
        (0..rows * columns)
            .map(|i| {
                let (r, c) = (i / columns, i % columns);
                let x = (2.0 * c as f32 + 1.0) / columns as f32 - 1.0;
                let z = 1.0 - (2.0 * r as f32 + 1.0) / rows as f32;
                [x + shift[0], 0.5, z + shift[1]]
            })
            .collect()
    }

    fn probes(lattice: Lattice, points: &[[f32; 3]]) -> Vec<Probe> {
        points.iter().map(|&point| Probe { point, radii: lattice.radii([0.0; 2]), recent: true }).collect()
    }

    #[test]
    fn what_does_not_move_finds_itself() {
        let lattice = Lattice::new(18 * 32, [18, 32]);
        assert_eq!(lattice, Lattice { columns: 32, rows: 18 });
        let points = grid(18, 32, [0.0; 2]);
        let matches = match_up(lattice, &probes(lattice, &points), &points);
        for i in 0..points.len() {
            assert_eq!(matches.host[i], Some(i as u32));
            assert_eq!(matches.parent[i], Some(i as u32));
        }
    }

    #[test]
    fn a_shift_by_one_cell_moves_every_identity_by_one_cell() {
        let lattice = Lattice::new(18 * 32, [18, 32]);
        let new = grid(18, 32, [0.0; 2]);
        let old = grid(18, 32, [2.0 / 32.0, 0.0]);
        let matches = match_up(lattice, &probes(lattice, &old), &new);
        for row in 0..18 {
            for column in 1..32u32 {
                let i = row * 32 + column;
                assert_eq!(matches.parent[i as usize], Some(i - 1), "cell {row}, {column}");
            }
        }
    }

    #[test]
    fn matching_is_one_to_one_and_equals_an_exhaustive_search() {
        // A reproducible scatter with uneven scales.
        let mut state = 9u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let lattice = Lattice::new(300, [9, 16]);
        let new: Vec<[f32; 3]> = (0..300).map(|_| [random() * 2.2 - 1.1, random(), random() * 2.2 - 1.1]).collect();
        let old: Vec<Probe> = (0..400)
            .map(|i| Probe {
                point: [random() * 2.2 - 1.1, random(), random() * 2.2 - 1.1],
                radii: lattice.radii([random() * 0.2, random() * 0.2]),
                recent: i % 3 != 0,
            })
            .collect();
        let found = match_up(lattice, &old, &new);

        let mut pairs = Vec::new();
        let mut host = Vec::new();
        for (i, probe) in old.iter().enumerate() {
            let mut near: Vec<(f32, u32)> = Vec::new();
            for (j, p) in new.iter().enumerate() {
                let d: [f32; 3] = std::array::from_fn(|a| (p[a] - probe.point[a]) / probe.radii[a]);
                let q = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                if q <= 1.0 {
                    near.push((q, j as u32));
                }
            }
            near.sort_by(|a, b| a.partial_cmp(b).unwrap());
            host.push(near.first().map(|n| n.1));
            pairs.extend(near.iter().take(CANDIDATES).map(|&(q, j)| (!probe.recent, q, j, i as u32)));
        }
        pairs.sort_by(|a, b| a.partial_cmp(b).unwrap());
        let mut parent = vec![None; new.len()];
        let mut taken = vec![false; old.len()];
        for (_, _, j, i) in pairs {
            if parent[j as usize].is_none() && !taken[i as usize] {
                parent[j as usize] = Some(i);
                taken[i as usize] = true;
            }
        }
        assert!(parent.iter().flatten().count() > 50, "the scatter has pairs");
        assert_eq!(found, Matches { host, parent });
    }

    #[test]
    fn positions_in_one_place_or_far_away_are_handled() {
        let lattice = Lattice::new(5000, [9, 16]);
        let pile = vec![[0.1, 0.5, 0.1]; 5000];
        let matches = match_up(lattice, &probes(lattice, &pile), &pile);
        assert_eq!(matches.host, vec![Some(0); 5000]);
        assert_eq!(matches.parent.iter().flatten().count(), CANDIDATES);
        let far = vec![[f32::MAX, 0.5, f32::MIN], [-1e30, 0.5, 1e30]];
        let matches = match_up(lattice, &probes(lattice, &far), &pile);
        assert_eq!(matches.host, vec![None; 2]);
        assert_eq!(match_up(Lattice::new(0, [0, 0]), &[], &[]), Matches::default());
    }
}
