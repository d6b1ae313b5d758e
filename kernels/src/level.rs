//! Instruction-set levels: detected once, passed explicitly, only ever lowered.

use std::fmt;

/// A bundle of CPU instructions that a kernel may use.
///
/// A value proves that the CPU running the program has the bundle: the only ways to get one are [`Level::detect`],
/// [`Level::scalar`] and lowering ([`Level::named`], [`Level::available`]). Every level gives the same bits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Level(pub(crate) Kind);

#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Debug)]
pub(crate) enum Kind {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "aarch64")]
    Neon,
}

/// A level that cannot be used here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LevelError {
    /// The name is none of `scalar`, `avx2`, `avx512`, `neon`, `auto`.
    Unknown(String),
    /// The name is a level's, but this machine does not have it.
    Unavailable {
        /// The level asked for.
        asked: String,
        /// The levels of this machine, lowest first.
        available: Vec<Level>,
    },
}

impl fmt::Display for LevelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LevelError::Unknown(name) => {
                write!(f, "unknown instruction set {name:?}: expected scalar, avx2, avx512, neon or auto")
            }
            LevelError::Unavailable { asked, available } => {
                let names: Vec<_> = available.iter().map(|l| l.name()).collect();
                write!(f, "instruction set {asked} is not available on this machine: it has {}", names.join(", "))
            }
        }
    }
}

impl std::error::Error for LevelError {}

impl fmt::Debug for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Level {
    /// The highest level of this machine.
    pub fn detect() -> Level {
        Self::available().pop().unwrap_or(Level(Kind::Scalar))
    }

    /// The level every machine has.
    pub const fn scalar() -> Level {
        Level(Kind::Scalar)
    }

    /// All levels of this machine, lowest first.
    pub fn available() -> Vec<Level> {
        #[cfg_attr(
            not(any(target_arch = "x86_64", target_arch = "aarch64")),
            expect(unused_mut, reason = "scalar only")
        )]
        let mut levels = vec![Level(Kind::Scalar)];
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            if avx2 {
                levels.push(Level(Kind::Avx2));
            }
            if avx2
                && is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
            {
                levels.push(Level(Kind::Avx512));
            }
        }
        #[cfg(target_arch = "aarch64")]
        if std::arch::is_aarch64_feature_detected!("neon") {
            levels.push(Level(Kind::Neon));
        }
        levels
    }

    /// The level called `name` (`scalar`, `avx2`, `avx512`, `neon`; `auto` is the highest there is).
    ///
    /// # Errors
    /// Unknown names and levels that this machine does not have.
    pub fn named(name: &str) -> Result<Level, LevelError> {
        if name == "auto" {
            return Ok(Self::detect());
        }
        let available = Self::available();
        if let Some(level) = available.iter().find(|l| l.name() == name) {
            return Ok(*level);
        }
        match name {
            "scalar" | "avx2" | "avx512" | "neon" => Err(LevelError::Unavailable { asked: name.to_owned(), available }),
            _ => Err(LevelError::Unknown(name.to_owned())),
        }
    }

    /// The name by which [`Level::named`] finds it.
    pub const fn name(self) -> &'static str {
        match self.0 {
            Kind::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => "neon",
        }
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
    }

    #[test]
    fn unknown_and_unavailable_names_are_errors() {
        assert!(matches!(Level::named("sse9"), Err(LevelError::Unknown(_))));
        let foreign = if cfg!(target_arch = "aarch64") { "avx2" } else { "neon" };
        assert!(matches!(Level::named(foreign), Err(LevelError::Unavailable { .. })));
    }
}
