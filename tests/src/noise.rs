//! Numbers that look like noise and follow from a seed.

/// `len` values between −1 and 1 that follow from `seed`.
pub(crate) fn noise(len: usize, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state >> 40) as f32 - 8_388_608.0) / 8_388_608.0
    };
    (0..len).map(|_| next()).collect()
}
