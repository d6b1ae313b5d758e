//! Still scenes moved, turned and scaled.

use streamsplat_kernels::harmonics::reference::basis;
use streamsplat_kernels::math::f64::ln;

use super::{Still, after};
use crate::camera::Rotation;

/// Number of directions from which the rotation of harmonics is computed: more than the coefficients of a degree, in
/// general position.
const DIRECTIONS: usize = 24;

/// A similarity: `x ↦ scale·R·x + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Factor of lengths, above 0.
    pub scale: f64,
    /// Rotation R.
    pub rotation: Rotation,
    /// Translation, added last.
    pub offset: [f64; 3],
}

impl Still {
    /// Applies a similarity to centres, logarithms of scales, rotations, and the harmonics, whose coefficients c become
    /// c′ with `Σ c′ₖ·Yₖ(R·d) = Σ cₖ·Yₖ(d)` for every direction d, degree by degree. In binary64, each number rounded
    /// once; the identity keeps all bits.
    pub fn transform(&mut self, by: &Similarity) {
        let Similarity { scale, rotation, offset } = *by;
        let turns = !rotation.is_identity();
        if turns || scale != 1.0 || offset != [0.0; 3] {
            let matrix = rotation.matrix();
            for mean in &mut self.mean {
                let [x, y, z] = mean.map(f64::from);
                *mean = std::array::from_fn(|i| {
                    let [a, b, c] = matrix[i];
                    (scale * (a * x + b * y + c * z) + offset[i]) as f32
                });
            }
        }
        if self.about.offset != [0.0; 3] {
            let (offset, matrix) = (self.about.offset, rotation.matrix());
            self.about.offset = matrix.map(|[a, b, c]| scale * (a * offset[0] + b * offset[1] + c * offset[2]));
        }
        if scale != 1.0 {
            let by = ln(scale);
            self.log_scale.iter_mut().flatten().for_each(|s| *s = (f64::from(*s) + by) as f32);
        }
        if turns {
            let quaternion = rotation.quaternion();
            self.rotation.iter_mut().for_each(|q| *q = after(quaternion, q.map(f64::from)));
            self.turn_harmonics(&rotation);
        }
    }

    fn turn_harmonics(&mut self, rotation: &Rotation) {
        let width = 3 * self.rest();
        if width == 0 {
            return;
        }
        let matrices: Vec<Vec<Vec<f64>>> =
            (1..=self.degree).map(|degree| harmonic_rotation(degree, rotation)).collect();
        let mut turned = vec![0.0; width];
        for own in self.higher.chunks_exact_mut(width) {
            for (degree, matrix) in (1..).zip(&matrices) {
                // Number of coefficients of lower degrees, without the first.
                let before: usize = degree * degree - 1;
                for (k, row) in matrix.iter().enumerate() {
                    for channel in 0..3 {
                        let terms = row.iter().enumerate();
                        let sum: f64 = terms.map(|(j, m)| m * f64::from(own[3 * (before + j) + channel])).sum();
                        turned[3 * (before + k) + channel] = sum as f32;
                    }
                }
            }
            own.copy_from_slice(&turned);
        }
    }
}

/// The matrix M of a degree with `Yⱼ(d) = Σₖ Mₖⱼ·Yₖ(R·d)`, by least squares over many directions: `(AᵀA)⁻¹AᵀB` for `A =
/// Y(R·d)`, `B = Y(d)`. Entries within 10⁻¹² of 0, 1 or −1 are rounded to it, so that half and quarter turns about the
/// axes keep bits.
fn harmonic_rotation(degree: usize, rotation: &Rotation) -> Vec<Vec<f64>> {
    let size = 2 * degree + 1;
    let matrix = rotation.matrix();
    // [AᵀA | AᵀB]
    let mut rows = vec![vec![0.0; 2 * size]; size];
    for i in 0..DIRECTIONS {
        // A spiral from pole to pole.
        let height = (2 * i + 1) as f64 / DIRECTIONS as f64 - 1.0;
        let (sin, cos) = streamsplat_kernels::math::f64::sin_cos(2.4 * i as f64);
        let width = (1.0 - height * height).sqrt();
        let direction = [width * cos, width * sin, height];
        let turned = std::array::from_fn(|i| (0..3).map(|k| matrix[i][k] * direction[k]).sum());
        let [a, b] = [basis(turned), basis(direction)];
        let [a, b] = [&a[degree * degree..][..size], &b[degree * degree..][..size]];
        for (row, left) in rows.iter_mut().zip(a) {
            row.iter_mut().zip(a.iter().chain(b)).for_each(|(sum, right)| *sum += left * right);
        }
    }
    // Gauss and Jordan; AᵀA is close to a multiple of the identity.
    for pivot in 0..size {
        let lead = rows[pivot][pivot];
        rows[pivot].iter_mut().for_each(|x| *x /= lead);
        let own = rows[pivot].clone();
        for (_, row) in rows.iter_mut().enumerate().filter(|(i, _)| *i != pivot) {
            let factor = row[pivot];
            row.iter_mut().zip(&own).for_each(|(x, own)| *x -= factor * own);
        }
    }
    let snapped = |x: f64| if (x - x.round()).abs() < 1e-12 { x.round() } else { x };
    rows.into_iter().map(|row| row[size..].iter().map(|x| snapped(*x)).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use streamsplat_kernels::harmonics::Eye;
    use streamsplat_kernels::harmonics::reference::colour;

    fn still() -> Still {
        let value = |i: usize| ((i * 37) % 101) as f32 * 0.02 - 1.0;
        Still {
            mean: vec![[1.0, 2.0, 3.0], [-0.5, 0.25, 4.0]],
            log_scale: vec![[-1.0, -2.0, -3.0]; 2],
            rotation: vec![[0.5, 0.5, -0.5, 0.5], [1.0, 0.0, 0.0, 0.0]],
            logit: vec![0.3, -0.2],
            base: vec![[0.9, 1.1, 1.0]; 2],
            degree: 3,
            higher: (0..90).map(|i| 0.1 * value(i)).collect(),
            ..Still::default()
        }
    }

    #[test]
    fn what_is_seen_turns_with_the_eye() {
        let rotation = Rotation::from_quaternion([0.8, -0.3, 0.4, 0.2]).expect("a rotation");
        let by = Similarity { scale: 2.0, rotation, offset: [0.1, -0.2, 0.3] };
        let (before, mut after) = (still(), still());
        after.transform(&by);
        let matrix = rotation.matrix();
        let apply = |v: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| 2.0 * (0..3).map(|k| matrix[i][k] * v[k]).sum::<f64>() + by.offset[i])
        };
        for i in 0..2 {
            let expected = apply(before.mean[i].map(f64::from));
            assert!((0..3).all(|k| (f64::from(after.mean[i][k]) - expected[k]).abs() < 1e-6));
            assert!((0..3).all(|k| (after.log_scale[i][k] - before.log_scale[i][k] - 2.0_f32.ln()).abs() < 1e-6));
            for eye in [[0.0, 0.0, 0.0], [3.0, -1.0, 2.0], [-4.0, 5.0, 0.5]] {
                let seen = |still: &Still, eye: [f64; 3]| {
                    let higher = &still.higher.as_chunks::<3>().0[15 * i..][..15];
                    colour(3, still.base[i], higher, still.mean[i], Eye::At(eye.map(|x| x as f32)))
                };
                let (a, b) = (seen(&before, eye), seen(&after, apply(eye)));
                assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-5), "{a:?} {b:?}");
            }
            // Axes of the Gaussian itself.
            let axes = |still: &Still| {
                Rotation::from_quaternion(still.rotation[i].map(f64::from)).expect("a rotation").matrix()
            };
            let (a, b) = (axes(&before), axes(&after));
            for column in 0..3 {
                for row in 0..3 {
                    let turned: f64 = (0..3).map(|k| matrix[row][k] * a[k][column]).sum();
                    assert!((turned - b[row][column]).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn the_identity_and_two_half_turns_keep_every_bit() {
        let mut found = still();
        let identity = Similarity { scale: 1.0, rotation: Rotation::default(), offset: [0.0; 3] };
        found.transform(&identity);
        assert_eq!(found, still());
        for axis in 1..4 {
            let rotation = Rotation::from_quaternion(std::array::from_fn(|i| f64::from(u8::from(i == axis))))
                .expect("a half turn");
            let half = Similarity { rotation, ..identity };
            found.transform(&half);
            assert_ne!(found, still());
            found.transform(&half);
            // A whole turn is the opposite quaternion.
            found.rotation.iter_mut().flatten().for_each(|c| *c = -*c);
            assert_eq!(found, still());
        }
    }
}
