//! The fixed position code.

use rayon::prelude::*;

use streamsplat_kernels::math::f64::{exp, sin_cos};

/// `pe[i, 2k] = sin(i·ω_k)`, `pe[i, 2k+1] = cos(i·ω_k)`, `ω_k = 10000^(−2k/d)`: a table `[n, d]`.
///
/// Frequencies and angles are rounded to f32 where the published code rounds them. Its tables differ from the exact
/// ones by 1e-4 at token 2304, and checkpoints without a stored table were trained with them.
pub(crate) fn sinusoid(n: usize, d: usize) -> Vec<f32> {
    // ln 10000
    let rate = (-9.210_340_371_976_184 / d as f64) as f32;
    let frequency: Vec<f32> = (0..d / 2).map(|k| exp(f64::from((2 * k) as f32 * rate)) as f32).collect();
    let mut table = vec![0.0; n * d];
    table.par_chunks_mut(d.max(1)).enumerate().for_each(|(i, row)| {
        for (pair, &omega) in row.chunks_exact_mut(2).zip(&frequency) {
            let (sin, cos) = sin_cos(f64::from(i as f32 * omega));
            (pair[0], pair[1]) = (sin as f32, cos as f32);
        }
    });
    table
}

/// `x += 0`: −0 becomes +0, and no other bit changes. Only this remains of a zero-output branch: see
/// [`crate::zero_output`].
pub(crate) fn add_zero(x: &mut [f32]) {
    x.par_chunks_mut(1 << 14).for_each(|x| x.iter_mut().for_each(|x| *x += 0.0));
}

/// `x += y`, element by element.
pub(crate) fn add(x: &mut [f32], y: &[f32]) {
    assert_eq!(x.len(), y.len(), "as many on both sides");
    x.par_chunks_mut(1 << 14)
        .zip(y.par_chunks(1 << 14))
        .for_each(|(x, y)| x.iter_mut().zip(y).for_each(|(x, y)| *x += y));
}
