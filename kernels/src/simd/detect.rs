//! The levels of this machine.

use std::sync::OnceLock;

use super::dispatch::dispatch;
use super::vector::{LANES, Operation, Simd};
use crate::level::{InstructionSet, Level, LevelError};

/// Levels of this machine, detected once.
struct Machine {
    available: Vec<Level>,
    preferred: Level,
}

fn machine() -> &'static Machine {
    static MACHINE: OnceLock<Machine> = OnceLock::new();
    MACHINE.get_or_init(|| {
        let known = dispatch(Level::scalar(), Answers);
        let gives_known_answers = |level: &Level| !level.0.has_dot_products() || dispatch(*level, Answers) == known;
        let available: Vec<_> = InstructionSet::ALL
            .iter()
            .filter(|kind| kind.is_supported())
            .map(|&kind| Level(kind))
            .filter(gives_known_answers)
            .collect();
        let preferred = available.iter().rfind(|level| !level.0.is_slow()).copied().unwrap_or(Level::scalar());
        Machine { available, preferred }
    })
}

impl Level {
    /// The default level: the highest whose instructions are no slower than those of a lower one.
    ///
    /// That is the highest of all except on Intel's cores, where it is `avx512vnni` although they may have
    /// `avx512bf16`.
    pub fn detect() -> Level {
        machine().preferred
    }

    /// All levels of this machine, lowest first.
    ///
    /// A level whose dot products are instructions has to reproduce reference results first.
    pub fn available() -> Vec<Level> {
        machine().available.clone()
    }

    /// The level called `name`, one of [`Level::NAMES`]; `auto` is [`Level::detect`].
    ///
    /// # Errors
    /// Unknown names and levels that this machine does not have.
    pub fn named(name: &str) -> Result<Level, LevelError> {
        if name == "auto" {
            return Ok(Self::detect());
        }
        let available = Self::available();
        match available.iter().find(|level| level.name() == name) {
            Some(level) => Ok(*level),
            None if Self::NAMES.contains(&name) => Err(LevelError::Unavailable { asked: name.to_owned(), available }),
            None => Err(LevelError::Unknown(name.to_owned())),
        }
    }
}

/// Dot products that an instruction must reproduce before it is used: random pairs of every magnitude that products
/// have, and sums that cancel.
struct Answers;

impl Operation for Answers {
    const DOT_PRODUCTS: bool = true;
    type Output = Vec<i32>;
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Vec<i32> {
        let mut answers = Vec::new();
        let mut state = 0x1234_5678_u32;
        let mut floats = s.splat(0.0);
        let mut whole = s.splat_i32(0);
        for round in 0..512 {
            let mut words = [[0_i32; LANES]; 2];
            let mut raw = [[0_i32; LANES]; 2];
            for which in 0..2 {
                for lane in 0..LANES {
                    let mut word = 0_u32;
                    for half in 0..2 {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        // Exponents from 2^-56 on, wide in some rounds and near 1 in others; some zeros.
                        let spread = if round % 3 == 0 { 100 } else { 6 };
                        let exponent = if round % 3 == 0 { 71 } else { 124 } + (state >> 20) % spread;
                        let bits = (state >> 31 << 15) | exponent << 7 | (state >> 9 & 0x7f);
                        word |= (if state >> 13 & 31 == 0 { 0 } else { bits }) << (16 * half);
                    }
                    words[which][lane] = word.cast_signed();
                    raw[which][lane] = state.rotate_left(7).wrapping_mul(0x9e37_79b9).cast_signed();
                }
            }
            if round % 16 == 0 {
                floats = s.splat(0.0);
            }
            floats = s.dot_bf16(floats, s.from_array_i32(words[0]), s.from_array_i32(words[1]));
            whole = s.dot_bytes(whole, s.from_array_i32(raw[0]), s.from_array_i32(raw[1]));
            answers.extend(s.to_array_i32(s.to_bits(floats)));
            answers.extend(s.to_array_i32(whole));
        }
        answers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_available_level_is_found_by_its_name() {
        for level in Level::available() {
            assert_eq!(Level::named(level.name()), Ok(level));
        }
        assert_eq!(Level::named("auto"), Ok(Level::detect()));
        assert!(Level::available().is_sorted() && Level::available().contains(&Level::detect()));
    }

    #[test]
    fn unknown_and_unavailable_names_are_errors() {
        assert!(matches!(Level::named("sse9"), Err(LevelError::Unknown(_))));
        let foreign = if cfg!(target_arch = "aarch64") { "avx512vnni" } else { "neon" };
        assert!(matches!(Level::named(foreign), Err(LevelError::Unavailable { .. })));
    }

    #[test]
    fn dot_products_have_their_known_answers_on_every_level() {
        let expected = dispatch(Level::scalar(), Answers);
        for kind in InstructionSet::ALL.iter().filter(|kind| kind.is_supported()) {
            assert!(dispatch(Level(*kind), Answers) == expected, "{}", Level(*kind));
        }
    }

    #[test]
    fn bytes_split_into_pairs_and_pairs_multiply_on_every_level() {
        struct Split;
        impl Operation for Split {
            type Output = [i32; LANES];
            #[inline(always)]
            fn run<S: Simd>(self, s: S) -> [i32; LANES] {
                let a = s.from_array_i32(std::array::from_fn(|i| {
                    (i as i32).wrapping_mul(0x1c9e_b74d) ^ 0x80ff_7f01_u32 as i32
                }));
                let [even, odd] = s.split_bytes(a);
                s.to_array_i32(s.add_i32(s.dot_i16(even, odd), s.dot_i16(even, even)))
            }
        }
        let expected: [i32; LANES] = std::array::from_fn(|i| {
            let b = ((i as i32).wrapping_mul(0x1c9e_b74d) ^ 0x80ff_7f01_u32 as i32).to_le_bytes();
            let [a, b, c, d] = b.map(|b| i32::from(b.cast_signed()));
            a * b + c * d + a * a + c * c
        });
        for level in Level::available() {
            assert_eq!(dispatch(level, Split), expected, "{level}");
        }
    }
}
