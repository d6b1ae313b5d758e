//! The register block: `MR` rows of `A` times `NV` panels of 16 columns of `B`, one block of `k`.

use crate::simd::{LANES, Simd};

/// The sums of one register block.
pub(crate) type Tile<S, const MR: usize, const NV: usize> = [[<S as Simd>::F32; NV]; MR];

/// `acc[r][v] = Σ_k rows[r][k] · panels[v][k]`: one fused multiply-add per step, `k` ascending, from +0.
///
/// # Safety
/// Every pointer of `rows` is readable for `k` values, every pointer of `panels` for `16 k`.
#[inline(always)]
pub(crate) unsafe fn multiply<S: Simd, const MR: usize, const NV: usize>(
    s: S,
    rows: [*const f32; MR],
    panels: [*const f32; NV],
    k: usize,
) -> Tile<S, MR, NV> {
    let mut acc = [[s.splat(0.0); NV]; MR];
    let mut i = 0;
    // SAFETY: i < k in every step.
    unsafe {
        while i + 4 <= k {
            step(s, &mut acc, rows, panels, i);
            step(s, &mut acc, rows, panels, i + 1);
            step(s, &mut acc, rows, panels, i + 2);
            step(s, &mut acc, rows, panels, i + 3);
            i += 4;
        }
        while i < k {
            step(s, &mut acc, rows, panels, i);
            i += 1;
        }
    }
    acc
}

/// One step of [`multiply`].
///
/// # Safety
/// As [`multiply`], with `i < k`.
#[inline(always)]
unsafe fn step<S: Simd, const MR: usize, const NV: usize>(
    s: S,
    acc: &mut Tile<S, MR, NV>,
    rows: [*const f32; MR],
    panels: [*const f32; NV],
    i: usize,
) {
    // SAFETY: the caller's.
    unsafe {
        let mut b = [s.splat(0.0); NV];
        for v in 0..NV {
            b[v] = s.load_ptr(panels[v].add(i * LANES));
        }
        for r in 0..MR {
            let a = s.splat(*rows[r].add(i));
            for v in 0..NV {
                acc[r][v] = s.mul_add(a, b[v], acc[r][v]);
            }
        }
    }
}
