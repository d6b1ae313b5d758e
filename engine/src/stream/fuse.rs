//! Fusion of two frames: identities pass on, continued Gaussians hand over, the rest survives for a while.

use rayon::prelude::*;
use streamsplat_kernels::raster::ALPHA_MIN;

use super::canonical::{Arrival, CHUNK, Layer};
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
pub(super) struct Meeting<'a> {
    /// Index of the new key frame.
    pub(super) frame: u64,
    pub(super) lattice: Lattice,
    /// The layers of the old and of the new Gaussians; only the model's own survive.
    pub(super) layers: [&'a [Layer]; 2],
    /// As [`Step::lifted`](super::canonical::Step): matching ignores depth but separates Gaussians behind others from
    /// the rest, and a tracked point takes the new Gaussian's depth.
    pub(super) lifted: bool,
    pub(super) max_age: u32,
}

/// Matches old and new Gaussians at a key frame; sets the identities of the new ones and the handovers of both.
pub(super) fn fuse(
    Meeting { frame, lattice, layers, lifted, max_age }: Meeting<'_>,
    old: &mut [Record],
    new: &mut [Arrival],
    identities: &mut Identities,
) -> Fused {
    let ends: Vec<[f32; 3]> = old.par_iter().with_min_len(CHUNK).map(|r| r.position_at(1.0)).collect();
    let depth = |layer: Layer| if layer == Layer::Behind { 1.0 } else { 0.0 };
    let probe = |(i, (r, end)): (usize, (&Record, &[f32; 3]))| {
        let mut point = std::array::from_fn(|axis| end[axis] + r.offset[axis]);
        let mut radii = lattice.radii(r.scale);
        if lifted {
            (point[1], radii[1]) = (depth(layers[0][i]), 0.5);
        }
        Probe { point, radii, recent: r.frame + 1 == frame && layers[0][i] != Layer::Detail }
    };
    let probes: Vec<Probe> = old.par_iter().zip(&ends).enumerate().with_min_len(CHUNK).map(probe).collect();
    let position = |(i, arrival): (usize, &Arrival)| {
        let [x, y, z] = arrival.record.mean;
        [x, if lifted { depth(layers[1][i]) } else { y }, z]
    };
    // New details, which are the last, take on no identity.
    let lasting = layers[1].partition_point(|layer| *layer != Layer::Detail);
    let positions: Vec<[f32; 3]> = new[..lasting].par_iter().enumerate().with_min_len(CHUNK).map(position).collect();
    let mut matches = match_up(lattice, &probes, &positions);
    matches.parent.resize(new.len(), None);

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
                    None if layers[0][i] != Layer::Own || frame - record.frame > u64::from(max_age) => {
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
