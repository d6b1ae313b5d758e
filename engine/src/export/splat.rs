//! The 32-byte records of web viewers (`.splat`).

use crate::picture::to_u8;
use crate::render::Snapshot;

/// The identity, w first: each component times 128, plus 128, at most 255.
const UNTURNED: [u8; 4] = [255, 128, 128, 128];

/// The Gaussians of one time as `.splat` records, without a header.
///
/// Each record: position (three f32, little-endian; scene space, x right, y down, z forward), standard deviations (three f32,
/// scene units), red, green, blue and opacity (bytes: [0, 1] times 255, rounded half up), rotation (four bytes: a quaternion, w
/// first, `128·q + 128`; the identity). In drawing order.
pub fn splat(snapshot: &Snapshot) -> Vec<u8> {
    let mut out = Vec::with_capacity(snapshot.mean.len() * 32);
    for (i, mean) in snapshot.mean.iter().enumerate() {
        mean.iter().chain(&snapshot.scale[i]).for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
        out.extend_from_slice(&snapshot.rgb[i].map(to_u8));
        out.push(to_u8(snapshot.opacity[i]));
        out.extend_from_slice(&UNTURNED);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_hold_what_went_in() {
        let snapshot = Snapshot {
            index: vec![0, 5],
            mean: vec![[0.25, -0.5, 1.5], [1.0, 2.0, 3.0]],
            scale: vec![[0.01, 0.02, 0.015], [0.0, 1e3, 1.0]],
            opacity: vec![0.5, 1.0],
            rgb: vec![[0.0, 0.2, 1.0], [-3.0, 7.0, 0.4]],
            dropped: 0,
        };
        let file = splat(&snapshot);
        let (records, rest) = file.as_chunks::<32>();
        assert_eq!((records.len(), rest.len()), (2, 0));
        for (i, record) in records.iter().enumerate() {
            let floats: Vec<f32> = record[..24].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            assert_eq!(floats, [snapshot.mean[i], snapshot.scale[i]].concat());
            assert_eq!(record[28..], [255, 128, 128, 128]);
        }
        assert_eq!(records[0][24..28], [0, 51, 255, 128]);
        assert_eq!(records[1][24..28], [0, 255, 102, 255]);
    }
}
