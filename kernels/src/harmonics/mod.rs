//! Colours that depend on the direction they are seen from: real spherical harmonics up to degree 3.
//!
//! d = (x, y, z) is the unit direction from the eye to the Gaussian, c₀ … c₁₅ are the coefficients per channel. The
//! basis has the order and the signs of the original 3D Gaussian splatting release:
//!
//! ```text
//! Y₀  =  0.28209479177387814
//! Y₁  = −0.4886025119029199·y             Y₂  =  0.4886025119029199·z              Y₃ = −0.4886025119029199·x
//! Y₄  =  1.0925484305920792·x·y           Y₅  = −1.0925484305920792·y·z            Y₆ =  0.31539156525252005·(2z² − x² − y²)
//! Y₇  = −1.0925484305920792·x·z           Y₈  =  0.5462742152960396·(x² − y²)
//! Y₉  = −0.5900435899266435·y·(3x² − y²)  Y₁₀ =  2.890611442640554·x·y·z           Y₁₁ = −0.4570457994644658·y·(4z² − x² − y²)
//! Y₁₂ =  0.3731763325901154·z·(2z² − 3x² − 3y²)                                    Y₁₃ = −0.4570457994644658·x·(4z² − x² − y²)
//! Y₁₄ =  1.445305721320277·z·(x² − y²)    Y₁₅ = −0.5900435899266435·x·(x² − 3y²)
//! rgb = max(0, ½ + Σ_k c_k·Y_k(d))
//! ```
//!
//! # Order of operations
//!
//! Seen from a point e: `v = m − e`, each component divided by the largest magnitude; `n = √(v_x² + v_y² + v_z²)` with
//! the squares added from x to z by fused multiply-adds; `d = v / n`. At the eye itself d is (0, 0, 0), and only the
//! first coefficient shows. Squares and products of d are rounded singly from left to right, brackets as written with
//! fused multiply-adds; each constant is multiplied last. The sum starts at ½ and takes the coefficients in ascending
//! order, one fused multiply-add each.
//!
//! A coefficient or a position that is not finite makes only its own Gaussian's colour NaN or infinite.
//!
//! Source: Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (2023), and its release; Sloan,
//! "Efficient Spherical Harmonic Evaluation" (2013), for the basis.

mod adjoint;
pub mod reference;
#[cfg(test)]
mod tests;

pub use adjoint::{Gradients, adjoint};
use tracing::debug_span;

use crate::Level;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch};

/// The highest degree.
pub const MAX_DEGREE: usize = 3;

/// Y₀, the harmonic of degree 0.
pub const Y0: f64 = 0.282_094_791_773_878_14;
const Y1: f32 = 0.488_602_511_902_919_9;
const Y2: [f32; 3] = [1.092_548_430_592_079_2, 0.315_391_565_252_520_05, 0.546_274_215_296_039_6];
const Y3: [f32; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

/// Gaussians of a task.
const TASK: usize = 1 << 10;

/// Coefficients above the first, per channel: (degree + 1)² − 1; `usize::MAX` − 1 where that overflows.
pub const fn rest(degree: usize) -> usize {
    let orders = degree.saturating_add(1);
    orders.saturating_mul(orders) - 1
}

/// Where colours are seen from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Eye {
    /// One point: rays go from it to each Gaussian.
    At([f32; 3]),
    /// Far away: all rays have this direction, of length 1.
    Along([f32; 3]),
}

/// Colours as seen from `eye`. See [the module](self).
///
/// `base [N]`: the first coefficients, per channel. `higher [N, K, 3]`: the others, K = [`rest`]`(degree)`, channels
/// innermost. `mean [N]`: centres.
///
/// # Panics
/// When `degree` is above 3 or a slice has another length.
pub fn colours(
    level: Level,
    degree: usize,
    base: &[[f32; 3]],
    higher: &[f32],
    mean: &[[f32; 3]],
    eye: Eye,
    out: &mut [[f32; 3]],
) {
    assert!(degree <= MAX_DEGREE, "degree {degree}: at most {MAX_DEGREE}");
    let width = 3 * rest(degree);
    assert!(
        base.len() == out.len() && mean.len() == out.len() && higher.len() == out.len() * width,
        "{} colours of {} first and {} other coefficients, and {} centres",
        out.len(),
        base.len(),
        higher.len(),
        mean.len()
    );
    let _span = debug_span!("harmonics", degree, colours = out.len()).entered();
    for_each_chunk(out, TASK, |chunk, out| {
        let part = chunk * TASK..chunk * TASK + out.len();
        let higher = &higher[part.start * width..part.end * width];
        dispatch(level, Colours { degree, base: &base[part.clone()], higher, mean: &mean[part], eye, out });
    });
}

struct Colours<'a> {
    degree: usize,
    base: &'a [[f32; 3]],
    higher: &'a [f32],
    mean: &'a [[f32; 3]],
    eye: Eye,
    out: &'a mut [[f32; 3]],
}

impl Operation for Colours<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let count = rest(self.degree);
        let (half, zero) = (s.splat(0.5), s.splat(0.0));
        for (block, out) in self.out.chunks_mut(LANES).enumerate() {
            let from = block * LANES;
            let direction = match self.eye {
                Eye::Along(d) => d.map(|x| s.splat(x)),
                Eye::At(eye) => towards(s, &self.mean[from..from + out.len()], eye),
            };
            let basis = basis(s, self.degree, direction);
            let mut found = [[0.0; LANES]; 3];
            for (channel, found) in found.iter_mut().enumerate() {
                let mut lanes = [0.0; LANES];
                for (lane, base) in lanes.iter_mut().zip(&self.base[from..from + out.len()]) {
                    *lane = base[channel];
                }
                let mut sum = s.mul_add(s.splat(Y0 as f32), s.from_array(lanes), half);
                for k in 0..count {
                    for (i, lane) in lanes.iter_mut().enumerate().take(out.len()) {
                        *lane = self.higher[((from + i) * count + k) * 3 + channel];
                    }
                    sum = s.mul_add(basis[k], s.from_array(lanes), sum);
                }
                // The first operand loses where either is NaN; NaN stays NaN.
                *found = s.to_array(s.select(s.lt(sum, zero), zero, sum));
            }
            for (i, out) in out.iter_mut().enumerate() {
                *out = found.map(|channel| channel[i]);
            }
        }
    }
}

/// Unit directions from the eye to up to sixteen centres.
#[inline(always)]
fn towards<S: Simd>(s: S, mean: &[[f32; 3]], eye: [f32; 3]) -> [S::F32; 3] {
    let v: [S::F32; 3] = std::array::from_fn(|axis| {
        let mut lanes = [0.0; LANES];
        for (lane, mean) in lanes.iter_mut().zip(mean) {
            *lane = mean[axis];
        }
        s.sub(s.from_array(lanes), s.splat(eye[axis]))
    });
    let most = s.max(s.max(s.abs(v[0]), s.abs(v[1])), s.abs(v[2]));
    let one = s.splat(1.0);
    let away = s.lt(s.splat(0.0), most);
    let w = v.map(|v| s.div(v, s.select(away, most, one)));
    let n = s.sqrt(s.mul_add(w[2], w[2], s.mul_add(w[1], w[1], s.mul(w[0], w[0]))));
    w.map(|w| s.div(w, s.select(away, n, one)))
}

/// Y₁ … of a direction; zeros above `degree`.
#[inline(always)]
fn basis<S: Simd>(s: S, degree: usize, [x, y, z]: [S::F32; 3]) -> [S::F32; 15] {
    let mut out = [s.splat(0.0); 15];
    let times = |c: f32, v: S::F32| s.mul(s.splat(c), v);
    if degree >= 1 {
        [out[0], out[1], out[2]] = [times(-Y1, y), times(Y1, z), times(-Y1, x)];
    }
    if degree >= 2 {
        let (xx, yy, zz) = (s.mul(x, x), s.mul(y, y), s.mul(z, z));
        let (xy, yz, xz) = (s.mul(x, y), s.mul(y, z), s.mul(x, z));
        let (two, three, four) = (s.splat(2.0), s.splat(3.0), s.splat(4.0));
        let (difference, sum) = (s.sub(xx, yy), s.add(xx, yy));
        out[3] = times(Y2[0], xy);
        out[4] = times(-Y2[0], yz);
        out[5] = times(Y2[1], s.sub(s.mul_add(two, zz, s.neg(xx)), yy));
        out[6] = times(-Y2[0], xz);
        out[7] = times(Y2[2], difference);
        if degree >= 3 {
            let around = s.mul_add(four, zz, s.neg(sum));
            out[8] = times(-Y3[0], s.mul(y, s.mul_add(three, xx, s.neg(yy))));
            out[9] = times(Y3[1], s.mul(xy, z));
            out[10] = times(-Y3[2], s.mul(y, around));
            out[11] = times(Y3[3], s.mul(z, s.neg_mul_add(three, sum, s.mul(two, zz))));
            out[12] = times(-Y3[2], s.mul(x, around));
            out[13] = times(Y3[4], s.mul(z, difference));
            out[14] = times(-Y3[0], s.mul(x, s.neg_mul_add(three, yy, xx)));
        }
    }
    out
}
