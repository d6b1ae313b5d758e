//! Fusion of two frames: identities pass on, continued Gaussians hand over, the rest survives for a while.

use rayon::prelude::*;
use streamsplat_kernels::raster::ALPHA_MIN;

use super::canonical::{Arrival, CHUNK};
use super::identities::Identities;
use super::matching::{Lattice, Probe, match_up};
use super::{Handover, Merge, Record, Reference};

/// The least γ₀ of a survivor: ln 3, which halves its opacity in every interval (`2·σ(−ln 3) = ½`).
pub(crate) const FADE: f32 = 1.098_612_3;

/// Results of fusion, except for the records themselves.
#[derive(Debug, Default)]
pub(super) struct Fused {
    pub(super) merges: Vec<Merge>,
    /// The vanishing Gaussians that are kept, as they are at the key frame.
    pub(super) survivors: Vec<Record>,
}

/// Where two frames meet, and the limits of their fusion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting {
    /// Index of the new key frame.
    pub(super) frame: u64,
    pub(super) lattice: Lattice,
    /// Number of old Gaussians of the model's own; those that a [lift](super::lift) adds do not survive.
    pub(super) lasting: usize,
    /// Number of old and of new Gaussians before those that are behind others.
    pub(super) seen: [usize; 2],
    /// As [`Step::lifted`](super::canonical::Step): matching ignores depth but separates Gaussians behind others from
    /// the rest, and a tracked point takes the new Gaussian's depth.
    pub(super) lifted: bool,
    pub(super) max_age: u32,
}

/// Matches old and new Gaussians at a key frame; sets the identities of the new ones and the handovers of both.
pub(super) fn fuse(
    Meeting { frame, lattice, lasting, seen, lifted, max_age }: Meeting,
    old: &mut [Record],
    new: &mut [Arrival],
    identities: &mut Identities,
) -> Fused {
    let ends: Vec<[f32; 3]> = old.par_iter().with_min_len(CHUNK).map(|r| r.position_at(1.0)).collect();
    let layer = |behind: bool| if behind { 1.0 } else { 0.0 };
    let probe = |(i, (r, end)): (usize, (&Record, &[f32; 3]))| {
        let mut point = std::array::from_fn(|axis| end[axis] + r.offset[axis]);
        let mut radii = lattice.radii(r.scale);
        if lifted {
            (point[1], radii[1]) = (layer(i >= seen[0]), 0.5);
        }
        Probe { point, radii, recent: r.frame + 1 == frame }
    };
    let probes: Vec<Probe> = old.par_iter().zip(&ends).enumerate().with_min_len(CHUNK).map(probe).collect();
    let position = |(i, arrival): (usize, &Arrival)| {
        let [x, y, z] = arrival.record.mean;
        [x, if lifted { layer(i >= seen[1]) } else { y }, z]
    };
    let positions: Vec<[f32; 3]> = new.par_iter().enumerate().with_min_len(CHUNK).map(position).collect();
    let matches = match_up(lattice, &probes, &positions);

    let mut passed_on = vec![false; old.len()];
    let fresh: Vec<u64> = matches
        .parent
        .iter()
        .map(|parent| match *parent {
            None => identities.fresh(),
            Some(parent) => {
                passed_on[parent as usize] = true;
                0
            }
        })
        .collect();
    new.par_iter_mut().with_min_len(CHUNK).zip(&matches.parent).zip(fresh).for_each(|((arrival, parent), fresh)| {
        let record = &mut arrival.record;
        record.handover = Handover::Arrives;
        match *parent {
            None => record.identity = fresh,
            Some(parent) => {
                let parent = parent as usize;
                record.identity = old[parent].identity;
                record.birth = old[parent].birth;
                record.offset = std::array::from_fn(|axis| probes[parent].point[axis] - record.mean[axis]);
                if lifted {
                    record.offset[1] = 0.0;
                }
            }
        }
    });

    let new = &*new;
    let parts: Vec<Fused> = old
        .par_chunks_mut(CHUNK)
        .enumerate()
        .map(|(chunk, old)| {
            let mut out = Fused::default();
            for (i, record) in (chunk * CHUNK..).zip(old) {
                match matches.host[i] {
                    Some(host) => {
                        record.handover = Handover::Leaves;
                        if !passed_on[i] {
                            let into = new[host as usize].record.identity;
                            out.merges.push(Merge { identity: record.identity, into });
                        }
                    }
                    None if i >= lasting || frame - record.frame > u64::from(max_age) => {
                        record.handover = Handover::Leaves
                    }
                    None => out.survivors.extend(survivor(record, ends[i])),
                }
            }
            out
        })
        .collect();
    let mut out = Fused::default();
    for part in parts {
        out.merges.extend(part.merges);
        out.survivors.extend(part.survivors);
    }
    out
}

/// Returns a vanishing Gaussian as it is at the key frame; `None` where it can no longer be seen.
fn survivor(record: &Record, end: [f32; 3]) -> Option<Record> {
    let opacity = record.opacity_at(1.0);
    (opacity >= ALPHA_MIN).then(|| Record {
        mean: end,
        opacity,
        gamma: [record.gamma[0].max(FADE), 0.0],
        rgb: record.rgb_at(1.0),
        rgb_rate: [0.0; 3],
        reference: Reference::Start,
        handover: Handover::None,
        ..*record
    })
}
