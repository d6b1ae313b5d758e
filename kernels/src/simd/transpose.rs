//! Small transpositions of 32-bit values, with the instructions that every CPU of the architecture has.

/// Writes `from[r][c]` to `to[c][r]`, 4 × 4.
///
/// # Safety
/// Each of `from` is readable, each of `to` writable, for 4 values.
#[inline(always)]
pub(crate) unsafe fn transpose4(from: [*const f32; 4], to: [*mut f32; 4]) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: the caller's; SSE is part of x86-64.
    unsafe {
        use core::arch::x86_64::*;
        let [a, b, c, d] = [_mm_loadu_ps(from[0]), _mm_loadu_ps(from[1]), _mm_loadu_ps(from[2]), _mm_loadu_ps(from[3])];
        let (ab, cd) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
        _mm_storeu_ps(to[0], _mm_movelh_ps(ab, cd));
        _mm_storeu_ps(to[1], _mm_movehl_ps(cd, ab));
        let (ab, cd) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
        _mm_storeu_ps(to[2], _mm_movelh_ps(ab, cd));
        _mm_storeu_ps(to[3], _mm_movehl_ps(cd, ab));
    }
    #[cfg(not(target_arch = "x86_64"))]
    for (r, from) in from.into_iter().enumerate() {
        for (c, to) in to.into_iter().enumerate() {
            // SAFETY: the caller's.
            unsafe { *to.add(r) = *from.add(c) };
        }
    }
}

/// Writes `from[r][c]` to `to[c][r]` for two rows of 4.
///
/// # Safety
/// Each of `from` is readable for 4 values, each of `to` writable for 2.
#[inline(always)]
pub(crate) unsafe fn transpose2(from: [*const f32; 2], to: [*mut f32; 4]) {
    for (r, from) in from.into_iter().enumerate() {
        for (c, to) in to.into_iter().enumerate() {
            // SAFETY: the caller's.
            unsafe { *to.add(r) = *from.add(c) };
        }
    }
}
