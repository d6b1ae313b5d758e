//! Options of loading a model.

use std::fmt;
use std::str::FromStr;

use streamsplat_kernels::{Level, gemm};

/// Options of loading a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadOptions {
    /// The instruction-set level of every kernel. It changes no output bit.
    pub level: Level,
    /// The arithmetic of the large matrix products.
    pub precision: Precision,
    /// True if residual branches that add nothing are computed as well. It changes no output bit: see
    /// [`crate::zero_output`].
    pub compute_zero_output: bool,
}

impl Default for LoadOptions {
    /// The machine's default level, f32, without branches that add nothing.
    fn default() -> Self {
        Self { level: Level::detect(), precision: Precision::F32, compute_zero_output: false }
    }
}

/// The arithmetic of the large matrix products; norms, residual streams and heads are f32 in every mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Precision {
    /// Everything in binary32: the reference.
    #[default]
    F32,
    /// Weights and activations of matrix products in bfloat16, accumulated in f32.
    Bf16,
    /// Weights per output channel and activations per token in 8 bits, accumulated in integers; all of attention's
    /// products in 8 bits; the encoder's first block and the widening layers of the upsamplers in bfloat16.
    Int8,
}

impl Precision {
    /// All modes, most exact first.
    pub const ALL: [Precision; 3] = [Precision::F32, Precision::Bf16, Precision::Int8];

    /// The operands of the products inside blocks and upsamplers. Everything else multiplies in f32: the convolutions
    /// of pixels, the projection of the condition, the heads.
    pub(crate) const fn of_blocks(self) -> gemm::Precision {
        match self {
            Precision::F32 => gemm::Precision::F32,
            Precision::Bf16 => gemm::Precision::Bf16,
            Precision::Int8 => gemm::Precision::Int8,
        }
    }

    /// The operands of the products for which 8 bits are too coarse: the first block of the encoder, whose outlying
    /// channels carry a patch's colours, and the layers that widen a token to finer ones. They are bf16 in
    /// [`Precision::Int8`].
    pub(crate) const fn of_edges(self) -> gemm::Precision {
        match self {
            Precision::Int8 => gemm::Precision::Bf16,
            other => other.of_blocks(),
        }
    }

    /// The name by which [`Precision::from_str`] finds it.
    pub const fn name(self) -> &'static str {
        match self {
            Precision::F32 => "f32",
            Precision::Bf16 => "bf16",
            Precision::Int8 => "int8",
        }
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A name that is not a precision mode's.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown precision {0:?}: expected f32, bf16 or int8")]
pub struct UnknownPrecision(pub String);

impl FromStr for Precision {
    type Err = UnknownPrecision;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|p| p.name() == name).ok_or_else(|| UnknownPrecision(name.to_owned()))
    }
}
