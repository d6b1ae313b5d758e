//! Gaussians in groups of neighbours, to skip most of a scene in images that show only a part of it.

use rayon::prelude::*;
use streamsplat_kernels::raster::ALPHA_MIN;

use super::window::{LARGEST, Window, reach};

/// Gaussians per group.
const GROUP: usize = 64;
/// Bits per axis of the lattice of the Z-order curve.
const STEPS: u32 = 21;

/// A scene's Gaussians, 64 to a group along a Z-order curve through their centres, each group with its bounds.
///
/// [`Groups::seen`] tests whole groups against the [`Window`] first, and then the members of the groups that may be
/// visible.
#[derive(Clone, Debug)]
pub(crate) struct Groups {
    members: Vec<Member>,
    bounds: Vec<Bounds>,
    /// Gaussians without a bound: not `tame`, huge, or with a number that is not finite (these are counted when drawn).
    others: Vec<u32>,
    count: usize,
}

#[derive(Clone, Copy, Debug)]
struct Member {
    centre: [f32; 3],
    reach: f32,
    place: u32,
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    middle: [f64; 3],
    half: [f64; 3],
    reach: f64,
}

impl Groups {
    /// Groups Gaussians by their centres. A Gaussian that is not `tame` is put into no group, and [`Groups::seen`]
    /// always returns it.
    pub(crate) fn new(
        mean: &[[f32; 3]],
        scale: &[[f32; 3]],
        opacity: &[f32],
        tame: impl Fn(usize) -> bool + Sync + Send,
    ) -> Self {
        // Single precision, rounded up.
        let reach = |i: usize| (reach(scale[i], opacity[i]) * (1.0 + 1e-6)) as f32;
        let known = |i: usize| {
            let small = mean[i].iter().all(|x| f64::from(x.abs()) <= LARGEST);
            small && f64::from(reach(i)) <= LARGEST && opacity[i].is_finite() && tame(i)
        };
        let (all, others): (Vec<u32>, Vec<u32>) =
            (0..mean.len() as u32).into_par_iter().partition(|&i| known(i as usize));
        // Gaussians too faint to be seen are in no group: no image shows them.
        let all: Vec<u32> = all.into_par_iter().filter(|&i| opacity[i as usize] >= ALPHA_MIN).collect();
        let (least, greatest) = all.par_iter().map(|&i| (mean[i as usize], mean[i as usize])).reduce(
            || ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]),
            |(a, b), (c, d)| (std::array::from_fn(|k| a[k].min(c[k])), std::array::from_fn(|k| b[k].max(d[k]))),
        );
        let mut order: Vec<(u64, u32)> =
            all.par_iter().map(|&i| (place_on_curve(mean[i as usize], least, greatest), i)).collect();
        order.par_sort_unstable();
        let members: Vec<Member> = order
            .par_iter()
            .map(|&(_, place)| {
                let i = place as usize;
                Member { centre: mean[i], reach: reach(i), place }
            })
            .collect();
        let bounds = members.par_chunks(GROUP).map(Bounds::of).collect();
        Self { members, bounds, others, count: mean.len() }
    }

    /// Returns the indices of all Gaussians that the image might show, ascending. `None` if they are more than half of
    /// all: drawing all is then faster than extracting them.
    pub(crate) fn seen(&self, window: &Window) -> Option<Vec<u32>> {
        let mut places: Vec<u32> = self
            .bounds
            .par_iter()
            .zip(self.members.par_chunks(GROUP))
            .with_min_len(16)
            .filter(|(bounds, _)| !window.misses(bounds.middle, bounds.half, bounds.reach))
            .flat_map_iter(|(_, members)| {
                members.iter().filter(|m| !window.misses(m.centre.map(f64::from), [0.0; 3], f64::from(m.reach)))
            })
            .map(|member| member.place)
            .collect();
        places.extend_from_slice(&self.others);
        if places.len() * 2 > self.count {
            return None;
        }
        places.par_sort_unstable();
        Some(places)
    }
}

impl Bounds {
    /// Returns the bounds of at least one member.
    fn of(members: &[Member]) -> Self {
        let (mut least, mut greatest, mut reach) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3], 0.0_f32);
        for member in members {
            for axis in 0..3 {
                least[axis] = least[axis].min(member.centre[axis]);
                greatest[axis] = greatest[axis].max(member.centre[axis]);
            }
            reach = reach.max(member.reach);
        }
        let ends = |axis: usize| (f64::from(least[axis]), f64::from(greatest[axis]));
        Self {
            middle: std::array::from_fn(|axis| 0.5 * (ends(axis).0 + ends(axis).1)),
            half: std::array::from_fn(|axis| 0.5 * (ends(axis).1 - ends(axis).0)),
            reach: reach.into(),
        }
    }
}

/// Returns the index of a point of a box on the Z-order curve through it: the bits of its coordinates interleaved.
fn place_on_curve(point: [f32; 3], least: [f32; 3], greatest: [f32; 3]) -> u64 {
    let step = |axis: usize| {
        let [at, from, to] = [point[axis], least[axis], greatest[axis]].map(f64::from);
        let part = if to > from { (at - from) / (to - from) } else { 0.0 };
        (part * f64::from((1 << STEPS) - 1)) as u64
    };
    (0..3).map(|axis| spread(step(axis)) << axis).sum()
}

/// Orders these indices along the curve through the centres, which are finite; equal ones keep their order.
pub(crate) fn along_curve(mean: &[[f32; 3]], mut places: Vec<usize>) -> Vec<usize> {
    let bounds = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let (least, greatest) = places.iter().fold(bounds, |(least, greatest), &i| {
        (std::array::from_fn(|k| least[k].min(mean[i][k])), std::array::from_fn(|k| greatest[k].max(mean[i][k])))
    });
    places.sort_by_cached_key(|&i| (place_on_curve(mean[i], least, greatest), i));
    places
}

/// Spreads 21 bits, with two zeros after each.
fn spread(x: u64) -> u64 {
    let x = (x | x << 32) & 0x001f_0000_0000_ffff;
    let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}
