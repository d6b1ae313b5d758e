//! Random numbers that depend on nothing but their coordinates: Philox 4×32-10.
//!
//! ten times: (c₀, c₁, c₂, c₃) ← (high(M₁c₂) ⊕ c₁ ⊕ k₀, low(M₁c₂), high(M₀c₀) ⊕ c₃ ⊕ k₁, low(M₀c₀)),
//!            then (k₀, k₁) ← (k₀ + W₀, k₁ + W₁)
//!
//! Salmon, Moraes, Dror, Shaw: "Parallel Random Numbers: As Easy as 1, 2, 3" (SC 2011). Integers only: the same bits
//! everywhere, in any order, on any number of threads.
//!
//! A stream is keyed by (seed, frame); the element index is the counter. The key holds the lower 32 bits of seed and
//! frame. Counter words 0 and 1 hold the element index, words 2 and 3 the upper 32 bits of seed and frame. So 64 bits
//! of each count; for small numbers the key is (seed, frame) itself.

use crate::parallel;

/// One block: ten rounds of `counter` under `key`.
pub const fn block(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    const M: [u32; 2] = [0xd251_1f53, 0xcd9e_8d57];
    const W: [u32; 2] = [0x9e37_79b9, 0xbb67_ae85];
    let mut round = 0;
    while round < 10 {
        let p = M[0] as u64 * counter[0] as u64;
        let q = M[1] as u64 * counter[2] as u64;
        counter = [(q >> 32) as u32 ^ counter[1] ^ key[0], q as u32, (p >> 32) as u32 ^ counter[3] ^ key[1], p as u32];
        key = [key[0].wrapping_add(W[0]), key[1].wrapping_add(W[1])];
        round += 1;
    }
    counter
}

/// The random numbers of one frame under one seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    /// Chosen by the user.
    pub seed: u64,
    /// Index of the frame in its video.
    pub frame: u64,
}

impl Stream {
    /// The four words of an element.
    pub const fn words(self, element: u64) -> [u32; 4] {
        let counter = [element as u32, (element >> 32) as u32, (self.seed >> 32) as u32, (self.frame >> 32) as u32];
        block(counter, [self.seed as u32, self.frame as u32])
    }

    /// The uniform number of an element in [0, 1): a multiple of 2⁻²⁴ from the upper 24 bits of its first word.
    pub const fn uniform(self, element: u64) -> f32 {
        (self.words(element)[0] >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// `out[i]` = the uniform number of element `first + i`.
    pub fn fill_uniform(self, first: u64, out: &mut [f32]) {
        const CHUNK: usize = 4096;
        parallel::for_each_chunk(out, CHUNK, |chunk, out| {
            let first = first.wrapping_add((chunk * CHUNK) as u64);
            for (i, x) in out.iter_mut().enumerate() {
                *x = self.uniform(first.wrapping_add(i as u64));
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_the_known_answers_of_random123() {
        assert_eq!(block([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(block([u32::MAX; 4], [u32::MAX; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
        assert_eq!(
            block([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn an_element_is_the_same_however_it_is_reached() {
        let stream = Stream { seed: 0x1_2345_6789, frame: 3 };
        let mut all = vec![0.0; 10_001];
        stream.fill_uniform(7, &mut all);
        for threads in [1, 2, 3, 8] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let mut again = vec![0.0; 10_001];
            pool.install(|| stream.fill_uniform(7, &mut again));
            assert_eq!(again, all);
        }
        for (i, x) in all.iter().enumerate() {
            assert_eq!(*x, stream.uniform(7 + i as u64));
        }
    }

    #[test]
    fn every_bit_of_seed_frame_and_element_counts() {
        let at = |seed, frame, element| Stream { seed, frame }.words(element);
        for bit in 0..64 {
            assert_ne!(at(1 << bit, 0, 0), at(0, 0, 0));
            assert_ne!(at(0, 1 << bit, 0), at(0, 0, 0));
            assert_ne!(at(0, 0, 1 << bit), at(0, 0, 0));
            assert_ne!(at(1 << bit, 0, 0), at(0, 1 << bit, 0));
        }
    }

    #[test]
    fn uniforms_fill_the_unit_interval_evenly() {
        let mut all = vec![0.0; 1 << 16];
        Stream { seed: 42, frame: 0 }.fill_uniform(0, &mut all);
        let mut counts = [0_i64; 64];
        for x in &all {
            assert!((0.0..1.0).contains(x));
            counts[(x * 64.0) as usize] += 1;
        }
        // χ² with 63 degrees of freedom passes 120 with probability 2e-5.
        let expected = all.len() as f64 / 64.0;
        let chi: f64 = counts.iter().map(|&n| (n as f64 - expected).powi(2) / expected).sum();
        assert!(chi < 120.0, "{chi}");
    }
}
