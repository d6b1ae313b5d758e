//! Entry into code compiled for a level.

#[cfg(target_arch = "aarch64")]
use super::neon;
use super::scalar::Scalar;
use super::vector::Operation;
#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512};
use crate::level::{InstructionSet, Level};

/// Runs `operation` with the token of `level`, compiled for that level's instructions.
#[inline]
pub fn dispatch<O: Operation>(level: Level, operation: O) -> O::Output {
    match level.0 {
        InstructionSet::Scalar => operation.run(Scalar),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: a `Level` proves that the CPU has its instructions.
        InstructionSet::Avx2 => unsafe { avx2::enter(operation) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        InstructionSet::Avx512Vnni if O::DOT_PRODUCTS => unsafe { avx512::enter_vnni(operation) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        InstructionSet::Avx512Bf16 if O::DOT_PRODUCTS => unsafe { avx512::enter_bf16(operation) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above; the levels beyond AVX-512 include it.
        InstructionSet::Avx512 | InstructionSet::Avx512Vnni | InstructionSet::Avx512Bf16 => unsafe {
            avx512::enter(operation)
        },
        #[cfg(target_arch = "aarch64")]
        // SAFETY: as above.
        InstructionSet::Neon => unsafe { neon::enter(operation) },
    }
}
