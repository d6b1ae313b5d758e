//! Positions of all identities at a key frame, as CSV.

use std::fmt::Write as _;

use streamsplat_kernels::raster::ALPHA_MIN;

use crate::stream::{Handover, Interval, Record, Reference};

/// The first line.
const HEADER: &str = "identity,birth,time,x,y,world_x,world_y,world_z,opacity,into";

/// Returns a line for every identity in the scene at the interval's end, ascending in identity. It has the identity,
/// the key frame where it first appeared, the time in seconds, its tracked point in the source's image (pixel centres
/// at integers) and in the world, and its opacity. If an identity ends there because another one replaces it, `into` is
/// that one.
///
/// The tracked point is the record's position with its `offset`; [`Track`](crate::track::Track) follows the same
/// points. Records with numbers that are not finite are left out. Numbers have the fewest digits that read back as the
/// same bits.
pub fn write(interval: &Interval) -> String {
    let mut merges: Vec<(u64, u64)> = interval.merges.iter().map(|m| (m.identity, m.into)).collect();
    merges.sort_unstable();
    let into = |identity| merges.binary_search_by_key(&identity, |m| m.0).ok().map(|i| merges[i].1);
    let here = |r: &Record| {
        let own = interval.index == 0 || r.reference == Reference::End;
        let survives = r.handover == Handover::None && r.opacity_at(1.0) >= ALPHA_MIN;
        r.is_sound() && (own || survives || into(r.identity).is_some())
    };
    let mut records: Vec<Record> = interval.gaussians.iter().filter(here).collect();
    // If an identity has two records, the one of the frame at the end holds its position.
    records.sort_by_key(|r| (r.identity, r.reference == Reference::Start));
    records.dedup_by_key(|r| r.identity);
    let mut text = format!("{HEADER}\n");
    for r in &records {
        let [x, y, z]: [f32; 3] = std::array::from_fn(|axis| r.position_at(1.0)[axis] + r.offset[axis]);
        let [column, row] = interval.unproject([f64::from(x), -f64::from(z)]);
        let (identity, birth, time, opacity) = (r.identity, r.birth, interval.end, r.opacity_at(1.0));
        let into = into(identity).map(|into| into.to_string()).unwrap_or_default();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{identity},{birth},{time},{column},{row},{x},{y},{z},{opacity},{into}");
    }
    text
}
