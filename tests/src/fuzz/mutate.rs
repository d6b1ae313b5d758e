//! Mutations of an input from a seed, as a fuzzer makes them first.

/// Bytes that often matter: signs, limits, and separators of text.
const BYTES: [u8; 16] = [0, 1, 0x7f, 0x80, 0xff, b'0', b'9', b'-', b'.', b'"', b'[', b'{', b',', b':', b'\n', b'e'];

/// An endless series of inputs near a seed.
pub struct Mutations<'a> {
    input: &'a [u8],
    state: u64,
}

impl<'a> Mutations<'a> {
    /// The series that follows from `seed`.
    pub fn new(input: &'a [u8], seed: u64) -> Self {
        Self { input, state: seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1 }
    }

    /// A number below `limit`; 0 where that is 0.
    fn below(&mut self, limit: usize) -> usize {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        (self.state >> 11) as usize % limit.max(1)
    }

    fn mutate(&mut self, bytes: &mut Vec<u8>) {
        let at = self.below(bytes.len());
        match self.below(7) {
            _ if bytes.is_empty() => bytes.push(self.below(256) as u8),
            0 => bytes[at] ^= 1 << self.below(8),
            1 => bytes[at] = BYTES[self.below(BYTES.len())],
            2 => bytes.truncate(at),
            3 => bytes.insert(at, BYTES[self.below(BYTES.len())]),
            4 => {
                // Four bytes of an extreme number.
                let word = [0, 1, u32::MAX, 1 << 31, i32::MAX as u32, 0x7fc0_0000, 0x7f80_0000, 1][self.below(8)];
                for (to, from) in bytes[at..].iter_mut().zip(word.to_le_bytes()) {
                    *to = from;
                }
            }
            5 => {
                let end = (at + 1 + self.below(16)).min(bytes.len());
                let part = bytes[at..end].to_vec();
                let to = self.below(bytes.len());
                bytes.splice(to..to, part);
            }
            _ => {
                let end = (at + 1 + self.below(8)).min(bytes.len());
                bytes.drain(at..end);
            }
        }
    }
}

impl Iterator for Mutations<'_> {
    type Item = Vec<u8>;

    fn next(&mut self) -> Option<Vec<u8>> {
        let mut bytes = self.input.to_vec();
        for _ in 0..1 + self.below(4) {
            self.mutate(&mut bytes);
        }
        Some(bytes)
    }
}
