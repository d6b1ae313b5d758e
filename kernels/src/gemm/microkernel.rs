//! The register block: `MR` rows of `A` times `NV` panels of 16 columns of `B`, one block of `k`.

#![expect(unsafe_code, reason = "register blocks read operands by pointer")]

use crate::simd::{Elementwise, LANES, Simd, prefetch, transpose2, transpose4};

/// The sums of one register block.
pub(crate) type Tile<S, const MR: usize, const NV: usize> = [[<S as Elementwise>::F32; NV]; MR];

/// A hook for prefetches, which are spread over the steps of a product: many at once would delay its own operands.
pub(crate) trait PrefetchHook {
    /// Called before every [`HOOK_STEPS`] steps.
    fn prefetch(&mut self);
}

/// Steps from one call of a [`PrefetchHook`] to the next.
pub(crate) const HOOK_STEPS: usize = 16;

impl PrefetchHook for () {
    #[inline(always)]
    fn prefetch(&mut self) {}
}

/// The words of a register block's rows: that of row `r` in step `i` is at `i·step + r·row`. Multiples of a
/// compile-time distance are compile-time constants.
#[derive(Clone, Copy)]
pub(crate) struct Strided {
    at: *const u32,
    step: usize,
    row: usize,
}

impl Strided {
    /// The words of a step one after the other, those of the next `stride` further; where rows are interleaved, as many
    /// as there are rows.
    #[inline(always)]
    pub(crate) fn across(at: *const u32, stride: usize) -> Self {
        Self { at, step: stride, row: 1 }
    }

    /// The words of a row one after the other, those of the next row `stride` further.
    #[inline(always)]
    pub(crate) fn along(at: *const u32, stride: usize) -> Self {
        Self { at, step: 1, row: stride }
    }

    /// The word of row `r` in step `i` from here.
    #[inline(always)]
    pub(crate) fn word(self, i: usize, r: usize) -> *const u32 {
        self.at.wrapping_add(i * self.step + r * self.row)
    }

    /// From `steps` further on.
    #[inline(always)]
    pub(crate) fn skip(self, steps: usize) -> Self {
        Self { at: self.at.wrapping_add(steps * self.step), ..self }
    }
}

/// `acc[r][v] = Σ_k rows[r][k] · panels[v][k]`: one fused multiply-add per step, `k` ascending, from +0.
///
/// # Safety
/// `MR` rows are readable for `k` words, every pointer of `panels` for `16 k`.
#[inline(always)]
pub(crate) unsafe fn multiply<S: Simd, const MR: usize, const NV: usize>(
    s: S,
    mut rows: Strided,
    panels: [*const f32; NV],
    k: usize,
    hook: &mut impl PrefetchHook,
) -> Tile<S, MR, NV> {
    let mut acc = [[s.splat(0.0); NV]; MR];
    let mut i = 0;
    // SAFETY: i < k in every step.
    unsafe {
        while i + 4 <= k {
            if i.is_multiple_of(HOOK_STEPS) {
                hook.prefetch();
            }
            for j in 0..4 {
                step(s, &mut acc, rows, j, panels.map(|panel| panel.add((i + j) * LANES)));
            }
            rows = rows.skip(4);
            i += 4;
        }
        for j in 0..k - i {
            step(s, &mut acc, rows, j, panels.map(|panel| panel.add((i + j) * LANES)));
        }
    }
    acc
}

/// One step of [`multiply`].
///
/// # Safety
/// Word `j` of the rows is readable, every pointer of `panels` for 16 values.
#[inline(always)]
unsafe fn step<S: Simd, const MR: usize, const NV: usize>(
    s: S,
    acc: &mut Tile<S, MR, NV>,
    rows: Strided,
    j: usize,
    panels: [*const f32; NV],
) {
    // SAFETY: the caller's.
    unsafe {
        let mut b = [s.splat(0.0); NV];
        for v in 0..NV {
            b[v] = s.load_ptr(panels[v]);
        }
        for r in 0..MR {
            let a = s.splat(*rows.word(j, r).cast::<f32>());
            for v in 0..NV {
                acc[r][v] = s.mul_add(a, b[v], acc[r][v]);
            }
        }
    }
}

/// Interleaves rows of `k` values in groups of `MR`: `to [rows/MR][k][MR]`. `row(i)` is row `i`; a last group is filled
/// with zeros.
#[inline(always)]
pub(crate) fn interleave<'a, const MR: usize>(rows: usize, k: usize, row: impl Fn(usize) -> &'a [f32], to: &mut [f32]) {
    const { assert!(MR.is_multiple_of(2), "rows are transposed in fours and twos") };
    if k == 0 {
        return;
    }
    for (group, to) in to[..rows.next_multiple_of(MR) * k].chunks_exact_mut(MR * k).enumerate() {
        let first = group * MR;
        if first + MR <= rows {
            let from: [*const f32; MR] = std::array::from_fn(|r| row(first + r)[..k].as_ptr());
            let start = to.as_mut_ptr();
            // The next group begins `MR` row distances ahead: it is prefetched while this one is copied.
            let ahead = (from[1] as usize).wrapping_sub(from[0] as usize).wrapping_mul(MR);
            for i in (0..k / 4 * 4).step_by(4) {
                if i % LANES == 0 {
                    for from in from {
                        prefetch(from.wrapping_add(i).wrapping_byte_add(ahead));
                    }
                }
                let mut r = 0;
                // SAFETY: rows hold k values and `to` MR · k; i + 3 < k and r + 3 (or r + 1) < MR.
                unsafe {
                    let at = [0, 1, 2, 3].map(|j| start.add((i + j) * MR));
                    while r + 4 <= MR {
                        let rows = [from[r].add(i), from[r + 1].add(i), from[r + 2].add(i), from[r + 3].add(i)];
                        transpose4(rows, at.map(|at| at.add(r)));
                        r += 4;
                    }
                    if r + 2 <= MR {
                        transpose2([from[r].add(i), from[r + 1].add(i)], at.map(|at| at.add(r)));
                    }
                }
            }
            for i in k / 4 * 4..k {
                for r in 0..MR {
                    // SAFETY: as above.
                    unsafe { *start.add(i * MR + r) = *from[r].add(i) };
                }
            }
        } else {
            to.fill(0.0);
            for r in 0..rows - first {
                for (to, &x) in to[r..].iter_mut().step_by(MR).zip(row(first + r)) {
                    *to = x;
                }
            }
        }
    }
}

/// Writes `from [k][16]` as the rows `to`, at most 16 of `k` values.
#[inline(always)]
pub(crate) fn deinterleave(from: &[f32], to: &mut [&mut [f32]]) {
    let k = from.len() / LANES;
    let mut r = 0;
    while r + 4 <= to.len().min(LANES) {
        let rows = [0, 1, 2, 3].map(|j| to[r + j][..k].as_mut_ptr());
        for i in (0..k / 4 * 4).step_by(4) {
            let at = from[i * LANES..(i + 4) * LANES].as_ptr();
            // SAFETY: r..r+4 are read of four vectors from i on; four rows of k values, i + 3 < k.
            unsafe { transpose4([0, 1, 2, 3].map(|j| at.add(j * LANES + r)), rows.map(|row| row.add(i))) };
        }
        for i in k / 4 * 4..k {
            for j in 0..4 {
                to[r + j][i] = from[i * LANES + r + j];
            }
        }
        r += 4;
    }
    for (r, to) in to.iter_mut().enumerate().skip(r) {
        for (to, from) in to.iter_mut().zip(from[r..].iter().step_by(LANES)) {
            *to = *from;
        }
    }
}
