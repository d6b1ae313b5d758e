//! PLY in the layout of the original 3D Gaussian splatting release.

use streamsplat_kernels::math::f64::ln;

use crate::render::Snapshot;

/// The zeroth spherical harmonic, 1 / (2√π): viewers show `0.5 + HARMONIC·f_dc`.
const HARMONIC: f64 = 0.282_094_791_773_878_14;
/// The least scale and the distance of opacities from 0 and 1 that survive a logarithm.
const LEAST: f64 = 1e-12;

const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

/// The Gaussians of one time as a binary PLY file.
///
/// Positions in scene space (x right, y down, z forward; scene units); normals 0; `f_dc` = (rgb − ½) / (1/(2√π)), colours being
/// display-space values; `opacity` = ln(o / (1 − o)); `scale` = ln(standard deviation); `rot` = quaternion, w first, the identity.
/// Scales under 10⁻¹² and opacities nearer than that to 0 or 1 are moved there, so that every value is finite. Records in
/// drawing order. Values are formed in binary64 and rounded once; the same bytes on every machine.
pub fn ply(snapshot: &Snapshot) -> Vec<u8> {
    let count = snapshot.mean.len();
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n").into_bytes();
    for name in PROPERTIES {
        out.extend_from_slice(format!("property float {name}\n").as_bytes());
    }
    out.extend_from_slice(b"end_header\n");
    out.reserve(count * PROPERTIES.len() * 4);
    for i in 0..count {
        let colour = snapshot.rgb[i].map(|c| ((f64::from(c) - 0.5) / HARMONIC) as f32);
        let opacity = f64::from(snapshot.opacity[i]).clamp(LEAST, 1.0 - LEAST);
        let logit = (ln(opacity) - ln(1.0 - opacity)) as f32;
        let scale = snapshot.scale[i].map(|s| ln(f64::from(s).max(LEAST)) as f32);
        let normal = [0.0; 3];
        let fields = [snapshot.mean[i], normal, colour].concat();
        let fields = fields.into_iter().chain([logit]).chain(scale).chain([1.0, 0.0, 0.0, 0.0]);
        fields.for_each(|x: f32| out.extend_from_slice(&x.to_le_bytes()));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let file = ply(&snapshot);
        let end = file.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
        let header = std::str::from_utf8(&file[..end]).expect("text");
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\n"));
        assert_eq!(header.matches("property float").count(), PROPERTIES.len());
        let values: Vec<f32> =
            file[end..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("four bytes"))).collect();
        assert_eq!(values.len(), 2 * PROPERTIES.len());
        let first = &values[..PROPERTIES.len()];
        assert_eq!(first[..6], [0.25, -0.5, 1.5, 0.0, 0.0, 0.0]);
        assert!((0.5 + 0.282_094_8 * first[6]).abs() < 1e-6 && first[7] == 0.0);
        let opacity = 1.0 / (1.0 + (-first[9]).exp());
        assert!((opacity - 0.75).abs() < 1e-6);
        assert!((first[10].exp() - 0.01).abs() < 1e-8);
        assert_eq!(first[13..], [1.0, 0.0, 0.0, 0.0]);
        assert!(values.iter().all(|x| x.is_finite()), "also of an opacity of 1 and a scale of 0");
    }
}
