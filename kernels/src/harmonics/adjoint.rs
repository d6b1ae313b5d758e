//! Gradients by coefficients, centres and the eye from those by colours.
//!
//! With g the gradient by a colour, 0 for channels whose colour is not above 0, d = v/|v| and v = m − e:
//!
//! ```text
//! ∂L/∂c_k = Y_k(d)·g      h = Σ_k (c_k·g)·∇Y_k(d)      ∂L/∂m = (h − d·(d·h))/|v|      ∂L/∂e = −Σ ∂L/∂m
//! ```
//!
//! # Order of operations
//!
//! Binary64, the formulas as written, k ascending, products of c_k and g summed from the first channel to the last;
//! coefficients' gradients are rounded once, those by centres too, and then added. The eye's is summed over the
//! Gaussians of chunks of 1024, then over the chunks, both in ascending order.
//!
//! At the eye itself, and along one direction, centres have no gradient. Gradients that are not finite count as +0.

use rayon::prelude::*;
use tracing::debug_span;

use super::{Eye, MAX_DEGREE, TASK, Y0, rest};
use crate::Level;
use crate::simd::{Operation, Simd, dispatch};

const Y1: f64 = 0.488_602_511_902_919_9;
const Y2: [f64; 3] = [1.092_548_430_592_079_2, 0.315_391_565_252_520_05, 0.546_274_215_296_039_6];
const Y3: [f64; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

/// Gradients of a loss with respect to the inputs of colours.
#[derive(Debug)]
pub struct Gradients<'a> {
    /// By the first coefficients, `[N]`; overwritten.
    pub base: &'a mut [[f32; 3]],
    /// By the others, `[N, K, 3]`; overwritten.
    pub higher: &'a mut [f32],
    /// By centres, `[N]`; added to.
    pub mean: &'a mut [[f32; 3]],
}

/// The adjoint of [`colours`](super::colours). Takes the gradients `of [N]` by the colours `out [N]`, computed from
/// `higher` and `mean`, to those in `to`. Returns the gradient by the eye's position.
///
/// # Panics
/// When `degree` is above 3 or a slice has another length.
#[expect(clippy::too_many_arguments, reason = "the arguments of the colours, and gradients")]
pub fn adjoint(
    level: Level,
    degree: usize,
    higher: &[f32],
    mean: &[[f32; 3]],
    eye: Eye,
    out: &[[f32; 3]],
    of: &[[f32; 3]],
    to: Gradients<'_>,
) -> [f64; 3] {
    assert!(degree <= MAX_DEGREE, "degree {degree}: at most {MAX_DEGREE}");
    let (n, width) = (of.len(), 3 * rest(degree));
    assert!(
        [out.len(), mean.len(), to.base.len(), to.mean.len()] == [n; 4]
            && [higher.len(), to.higher.len()] == [n * width; 2],
        "gradients of {n} colours of degree {degree}: {} colours, {} centres, {} other coefficients, and {}, {} and {} gradients",
        out.len(),
        mean.len(),
        higher.len(),
        to.base.len(),
        to.mean.len(),
        to.higher.len()
    );
    let _span = debug_span!("harmonics_adjoint", degree, colours = n).entered();
    let part = |index: usize, base: &mut [[f32; 3]], higher_to: &mut [f32], mean_to: &mut [[f32; 3]]| {
        let range = index * TASK..index * TASK + base.len();
        let task = Adjoint {
            degree,
            higher: &higher[range.start * width..range.end * width],
            mean: &mean[range.clone()],
            eye,
            out: &out[range.clone()],
            of: &of[range],
            to: Gradients { base, higher: higher_to, mean: mean_to },
        };
        dispatch(level, task)
    };
    let chunks = to.base.par_chunks_mut(TASK).zip(to.mean.par_chunks_mut(TASK)).enumerate();
    let eyes: Vec<[f64; 3]> = if width == 0 {
        chunks.map(|(index, (base, mean))| part(index, base, &mut [], mean)).collect()
    } else {
        let all = chunks.zip(to.higher.par_chunks_mut(TASK * width));
        all.map(|((index, (base, mean)), higher)| part(index, base, higher, mean)).collect()
    };
    eyes.iter().fold([0.0; 3], |sum, eye| std::array::from_fn(|axis| sum[axis] + eye[axis]))
}

struct Adjoint<'a> {
    degree: usize,
    higher: &'a [f32],
    mean: &'a [[f32; 3]],
    eye: Eye,
    out: &'a [[f32; 3]],
    of: &'a [[f32; 3]],
    to: Gradients<'a>,
}

impl Operation for Adjoint<'_> {
    type Output = [f64; 3];
    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> [f64; 3] {
        let count = rest(self.degree);
        let mut of_eye = [0.0; 3];
        for i in 0..self.of.len() {
            let g: [f64; 3] = std::array::from_fn(|c| {
                let of = self.of[i][c];
                if self.out[i][c] > 0.0 && of.is_finite() { f64::from(of) } else { 0.0 }
            });
            let (direction, length) = match self.eye {
                Eye::Along(d) => (d.map(f64::from), 0.0),
                Eye::At(eye) => {
                    let v: [f64; 3] = std::array::from_fn(|a| f64::from(self.mean[i][a]) - f64::from(eye[a]));
                    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
                    (if length > 0.0 { v.map(|v| v / length) } else { [0.0; 3] }, length)
                }
            };
            self.to.base[i] = g.map(|g| (Y0 * g) as f32);
            let (basis, slopes) = basis(self.degree, direction);
            let mut h = [0.0; 3];
            for k in 0..count {
                let at = (i * count + k) * 3;
                let mut along = 0.0;
                for c in 0..3 {
                    along += f64::from(self.higher[at + c]) * g[c];
                    self.to.higher[at + c] = (basis[k] * g[c]) as f32;
                }
                for axis in 0..3 {
                    h[axis] += along * slopes[k][axis];
                }
            }
            if length > 0.0 && count > 0 {
                let radial = direction[0] * h[0] + direction[1] * h[1] + direction[2] * h[2];
                for axis in 0..3 {
                    let of = (h[axis] - direction[axis] * radial) / length;
                    if of.is_finite() {
                        self.to.mean[i][axis] += of as f32;
                        of_eye[axis] -= of;
                    }
                }
            }
        }
        of_eye
    }
}

/// Y₁ … of a direction and their gradients; zeros above `degree`.
#[inline(always)]
fn basis(degree: usize, [x, y, z]: [f64; 3]) -> ([f64; 15], [[f64; 3]; 15]) {
    let (mut out, mut of) = ([0.0; 15], [[0.0; 3]; 15]);
    if degree >= 1 {
        [out[0], out[1], out[2]] = [-Y1 * y, Y1 * z, -Y1 * x];
        [of[0], of[1], of[2]] = [[0.0, -Y1, 0.0], [0.0, 0.0, Y1], [-Y1, 0.0, 0.0]];
    }
    if degree >= 2 {
        let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
        let [a, b, c] = Y2;
        out[3] = a * xy;
        of[3] = [a * y, a * x, 0.0];
        out[4] = -a * yz;
        of[4] = [0.0, -a * z, -a * y];
        out[5] = b * (2.0 * zz - xx - yy);
        of[5] = [-2.0 * b * x, -2.0 * b * y, 4.0 * b * z];
        out[6] = -a * xz;
        of[6] = [-a * z, 0.0, -a * x];
        out[7] = c * (xx - yy);
        of[7] = [2.0 * c * x, -2.0 * c * y, 0.0];
        if degree >= 3 {
            let [d, e, f, g, h] = Y3;
            out[8] = -d * (y * (3.0 * xx - yy));
            of[8] = [-6.0 * d * xy, -3.0 * d * (xx - yy), 0.0];
            out[9] = e * (xy * z);
            of[9] = [e * yz, e * xz, e * xy];
            out[10] = -f * (y * (4.0 * zz - xx - yy));
            of[10] = [2.0 * f * xy, -f * (4.0 * zz - xx - 3.0 * yy), -8.0 * f * yz];
            out[11] = g * (z * (2.0 * zz - 3.0 * xx - 3.0 * yy));
            of[11] = [-6.0 * g * xz, -6.0 * g * yz, 3.0 * g * (2.0 * zz - xx - yy)];
            out[12] = -f * (x * (4.0 * zz - xx - yy));
            of[12] = [-f * (4.0 * zz - 3.0 * xx - yy), 2.0 * f * xy, -8.0 * f * xz];
            out[13] = h * (z * (xx - yy));
            of[13] = [2.0 * h * xz, -2.0 * h * yz, h * (xx - yy)];
            out[14] = -d * (x * (xx - 3.0 * yy));
            of[14] = [-3.0 * d * (xx - yy), 6.0 * d * xy, 0.0];
        }
    }
    (out, of)
}
