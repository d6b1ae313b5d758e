//! Where two frames meet: identities pass on, the continued hand over, the rest survives for a while.

use super::canonical::{Arrival, VISIBLE};
use super::identities::Identities;
use super::matching::{Lattice, Probe, match_up};
use super::{Handover, Merge, Record, Reference};

/// The least γ₀ of a survivor: ln 3, which halves its opacity in every interval (`2·σ(−ln 3) = ½`).
pub(crate) const FADE: f32 = 1.098_612_3;

/// Results of fusion beside the records themselves.
#[derive(Debug, Default)]
pub(super) struct Fused {
    pub(super) merges: Vec<Merge>,
    /// The vanishing that are kept, as they are at the key frame.
    pub(super) survivors: Vec<Record>,
}

/// Matches old and new Gaussians at key frame `frame`; gives the new ones their identities and both their handovers.
pub(super) fn fuse(
    lattice: Lattice,
    max_age: u32,
    frame: u64,
    old: &mut [Record],
    new: &mut [Arrival],
    identities: &mut Identities,
) -> Fused {
    let ends: Vec<[f32; 3]> = old.iter().map(|r| r.position_at(1.0)).collect();
    let probes: Vec<Probe> = old
        .iter()
        .zip(&ends)
        .map(|(r, end)| Probe {
            point: std::array::from_fn(|axis| end[axis] + r.offset[axis]),
            radii: lattice.radii(r.scale),
            recent: r.frame + 1 == frame,
        })
        .collect();
    let positions: Vec<[f32; 3]> = new.iter().map(|a| a.record.mean).collect();
    let matches = match_up(lattice, &probes, &positions);

    let mut passed_on = vec![false; old.len()];
    for (arrival, parent) in new.iter_mut().zip(&matches.parent) {
        let record = &mut arrival.record;
        record.handover = Handover::Arrives;
        match *parent {
            None => record.identity = identities.fresh(),
            Some(parent) => {
                let parent = parent as usize;
                passed_on[parent] = true;
                record.identity = old[parent].identity;
                record.birth = old[parent].birth;
                record.offset = std::array::from_fn(|axis| probes[parent].point[axis] - record.mean[axis]);
            }
        }
    }

    let mut out = Fused::default();
    for (i, record) in old.iter_mut().enumerate() {
        match matches.host[i] {
            Some(host) => {
                record.handover = Handover::Leaves;
                if !passed_on[i] {
                    out.merges.push(Merge { identity: record.identity, into: new[host as usize].record.identity });
                }
            }
            None if frame - record.frame > u64::from(max_age) => record.handover = Handover::Leaves,
            None => {
                let opacity = record.opacity_at(1.0);
                if opacity >= VISIBLE {
                    let gamma = [record.gamma[0].max(FADE), 0.0];
                    out.survivors.push(Record {
                        mean: ends[i],
                        opacity,
                        gamma,
                        rgb: record.rgb_at(1.0),
                        rgb_rate: [0.0; 3],
                        reference: Reference::Start,
                        handover: Handover::None,
                        ..*record
                    });
                }
            }
        }
    }
    out
}
