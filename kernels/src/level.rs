//! Instruction-set levels: detected once, passed explicitly, only ever lowered.

use std::fmt;

/// A bundle of CPU instructions that a kernel may use.
///
/// | name | instructions |
/// |---|---|
/// | `scalar` | those of every CPU of the architecture |
/// | `avx2` | AVX2 and FMA |
/// | `avx512` | and AVX-512 F, BW, DQ, VL |
/// | `avx512vnni` | and AVX-512 VNNI: dot products of bytes |
/// | `avx512bf16` | and AVX-512 BF16: dot products of bf16 |
/// | `neon` | NEON of 64-bit ARM |
///
/// A level includes those before it (of its architecture), and is ordered after them. A value proves that the CPU
/// running the program has the bundle: the only ways to get one are [`Level::scalar`], [`Level::detect`],
/// [`Level::available`] and [`Level::named`]. Every level computes the same bits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Level(pub(crate) InstructionSet);

#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Debug)]
pub(crate) enum InstructionSet {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx512Vnni,
    #[cfg(target_arch = "x86_64")]
    Avx512Bf16,
    #[cfg(target_arch = "aarch64")]
    Neon,
}

impl InstructionSet {
    /// The levels of the architecture, lowest first.
    pub(crate) const ALL: &[InstructionSet] = &[
        InstructionSet::Scalar,
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx2,
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx512,
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx512Vnni,
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx512Bf16,
        #[cfg(target_arch = "aarch64")]
        InstructionSet::Neon,
    ];

    /// Returns true if the CPU has the instructions.
    pub(crate) fn is_supported(self) -> bool {
        match self {
            InstructionSet::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512 => {
                InstructionSet::Avx2.is_supported()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
            }
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512Vnni => {
                InstructionSet::Avx512.is_supported() && is_x86_feature_detected!("avx512vnni")
            }
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512Bf16 => {
                InstructionSet::Avx512Vnni.is_supported() && is_x86_feature_detected!("avx512bf16")
            }
            #[cfg(target_arch = "aarch64")]
            InstructionSet::Neon => std::arch::is_aarch64_feature_detected!("neon"),
        }
    }

    /// Returns true if dot products are instructions.
    pub(crate) fn has_dot_products(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512Vnni | InstructionSet::Avx512Bf16 => true,
            _ => false,
        }
    }

    /// Returns true if the level's added instructions are slower on this CPU than those that they replace. On Intel's
    /// cores (measured on Emerald Rapids) the dot product of bf16 takes as long as four fused multiply-adds, where two
    /// do the same work.
    pub(crate) fn is_slow(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512Bf16 => {
                let vendor = std::arch::x86_64::__cpuid(0);
                [vendor.ebx, vendor.edx, vendor.ecx].map(u32::to_le_bytes).as_flattened() == b"GenuineIntel"
            }
            _ => false,
        }
    }
}

/// A level that cannot be used here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LevelError {
    /// The name is neither in [`Level::NAMES`] nor `auto`.
    Unknown(String),
    /// The name is a level's, but this machine does not have it.
    Unavailable {
        /// The requested level.
        asked: String,
        /// The levels of this machine, lowest first.
        available: Vec<Level>,
    },
}

impl fmt::Display for LevelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LevelError::Unknown(name) => {
                write!(f, "unknown instruction set {name:?}: expected {} or auto", Level::NAMES.join(", "))
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
    /// The names of all levels of all architectures.
    pub const NAMES: [&str; 6] = ["scalar", "avx2", "avx512", "avx512vnni", "avx512bf16", "neon"];

    /// The level every machine has.
    pub const fn scalar() -> Level {
        Level(InstructionSet::Scalar)
    }

    /// The name by which [`Level::named`] finds it.
    pub const fn name(self) -> &'static str {
        match self.0 {
            InstructionSet::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512 => "avx512",
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512Vnni => "avx512vnni",
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512Bf16 => "avx512bf16",
            #[cfg(target_arch = "aarch64")]
            InstructionSet::Neon => "neon",
        }
    }
}
