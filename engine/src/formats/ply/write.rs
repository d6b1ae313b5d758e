//! Writing PLY in the layout of the original 3D Gaussian splatting release.

use super::comments;
use crate::formats::Written;
use crate::still::{About, Still};

/// Properties before the harmonics' higher coefficients, and after them.
const BEFORE: [&str; 9] = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
const AFTER: [&str; 8] = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];

/// Writes a still scene as a binary PLY file.
///
/// Positions are in scene space (x right, y down, z forward; scene units), as doubles if the scene has an offset.
/// Normals are 0. `f_rest` has all coefficients of the first channel, then the second, then the third; there are none
/// at degree 0. `opacity` is a logit, `scale` are logarithms, and `rot` has w first. Values keep the scene's own bits.
/// Records are in the scene's order. `comment SplatRenderMode: mip` marks scenes trained with anti-aliasing.
///
/// # Panics
/// If the arrays differ in length ([`Still::uneven`]).
pub fn write(still: &Still) -> Written {
    let (count, rest) = (still.len(), still.rest());
    let (offset, far) = (still.about.offset, still.about.offset != [0.0; 3]);
    let mut out = b"ply\nformat binary_little_endian 1.0\n".to_vec();
    // The coordinates already include the offset.
    let about = About { offset: [0.0; 3], ..still.about.clone() };
    comments(&about).iter().for_each(|line| out.extend_from_slice(line.as_bytes()));
    out.extend_from_slice(format!("element vertex {count}\n").as_bytes());
    let higher = (0..3 * rest).map(|i| format!("f_rest_{i}"));
    let names = BEFORE.map(str::to_owned).into_iter().chain(higher).chain(AFTER.map(str::to_owned));
    for (k, name) in names.enumerate() {
        let kind = if far && k < 3 { "double" } else { "float" };
        out.extend_from_slice(format!("property {kind} {name}\n").as_bytes());
    }
    out.extend_from_slice(b"end_header\n");
    let places = if far { 24 } else { 12 };
    out.reserve(count * (places + (BEFORE.len() - 3 + 3 * rest + AFTER.len()) * 4));
    for i in 0..count {
        let higher = &still.higher[i * 3 * rest..(i + 1) * 3 * rest];
        let by_channel = (0..3).flat_map(|channel| higher.iter().skip(channel).step_by(3));
        if far {
            let place = |k: usize| f64::from(still.mean[i][k]) + offset[k];
            (0..3).for_each(|k| out.extend_from_slice(&place(k).to_le_bytes()));
        } else {
            still.mean[i].iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
        }
        let fields = [0.0; 3].iter().chain(&still.base[i]).chain(by_channel);
        let fields = fields.chain([&still.logit[i]]).chain(&still.log_scale[i]).chain(&still.rotation[i]);
        fields.for_each(|x: &f32| out.extend_from_slice(&x.to_le_bytes()));
    }
    Written::of(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::Snapshot;

    const PROPERTIES: usize = BEFORE.len() + AFTER.len();

    #[test]
    fn a_file_reads_back_as_what_went_in() {
        let snapshot = Snapshot {
            index: vec![0, 5],
            mean: vec![[0.25, -0.5, 1.5], [1.0, 2.0, 3.0]],
            scale: vec![[0.01, 0.02, 0.015], [0.0, 1e3, 1.0]],
            opacity: vec![0.75, 1.0],
            rgb: vec![[0.0, 0.5, 1.0], [0.2, 0.3, 0.4]],
            dropped: 0,
        };
        let file = write(&Still::of(&snapshot)).bytes;
        let end = file.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
        let header = std::str::from_utf8(&file[..end]).expect("text");
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\n"));
        assert_eq!(header.matches("property float").count(), PROPERTIES);
        let values: Vec<f32> =
            file[end..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("four bytes"))).collect();
        assert_eq!(values.len(), 2 * PROPERTIES);
        let first = &values[..PROPERTIES];
        assert_eq!(first[..6], [0.25, -0.5, 1.5, 0.0, 0.0, 0.0]);
        assert!((0.5 + 0.282_094_8 * first[6]).abs() < 1e-6 && first[7] == 0.0);
        let opacity = 1.0 / (1.0 + (-first[9]).exp());
        assert!((opacity - 0.75).abs() < 1e-6);
        assert!((first[10].exp() - 0.01).abs() < 1e-8);
        assert_eq!(first[13..], [1.0, 0.0, 0.0, 0.0]);
        assert!(values.iter().all(|x| x.is_finite()), "also of an opacity of 1 and a scale of 0");
    }
}
