//! What follows a product before it is written.

use std::ops::Range;

use crate::math;
use crate::simd::{LANES, Simd};

/// The function of an [`Epilogue`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Activation {
    /// `y`
    #[default]
    Identity,
    /// `y · σ(y)`
    Silu,
}

/// What follows a product `p`: `y = activation(p + bias)`, then `out = γ·y`, or, with a residual, `out += γ·y`.
///
/// `p + bias` is a plain addition. Without `γ` the residual is a plain addition; with it `γ·y + out` is rounded once.
///
/// ```
/// use streamsplat_kernels::{Level, gemm::{Epilogue, Weights, linear}};
/// let weights = Weights::pack(&[1.0, 2.0, 3.0, 4.0], 2, 2);
/// let mut out = [10.0, 20.0];
/// linear(Level::detect(), &[1.0, 1.0], 1, &weights, &Epilogue::new().bias(&[0.5, 0.5]).residual(), &mut out);
/// assert_eq!(out, [13.5, 27.5]);
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Epilogue<'a> {
    bias: Option<&'a [f32]>,
    activation: Activation,
    gamma: Option<&'a [f32]>,
    residual: bool,
}

impl<'a> Epilogue<'a> {
    /// `out = p`
    pub const fn new() -> Self {
        Self { bias: None, activation: Activation::Identity, gamma: None, residual: false }
    }

    /// Adds `bias [n]`.
    #[must_use]
    pub const fn bias(mut self, bias: &'a [f32]) -> Self {
        self.bias = Some(bias);
        self
    }

    /// Adds `bias [n]` where there is one.
    #[must_use]
    pub const fn maybe_bias(mut self, bias: Option<&'a [f32]>) -> Self {
        self.bias = bias;
        self
    }

    /// Applies SiLU.
    #[must_use]
    pub const fn silu(mut self) -> Self {
        self.activation = Activation::Silu;
        self
    }

    /// Multiplies by `gamma [n]` (layer scale).
    #[must_use]
    pub const fn gamma(mut self, gamma: &'a [f32]) -> Self {
        self.gamma = Some(gamma);
        self
    }

    /// Adds to what `out` holds instead of replacing it.
    #[must_use]
    pub const fn residual(mut self) -> Self {
        self.residual = true;
        self
    }

    pub(super) fn check(&self, n: usize) {
        for (name, values) in [("bias", self.bias), ("gamma", self.gamma)] {
            if let Some(values) = values {
                assert_eq!(values.len(), n, "{name} holds {} values, expected n = {n}", values.len());
            }
        }
    }

    /// Applies to the sums of `columns` of one row (padded to whole vectors).
    #[inline(always)]
    pub(super) fn apply<S: Simd>(&self, s: S, sums: &[f32], columns: Range<usize>, out: &mut [f32]) {
        for (v, out) in out.chunks_mut(LANES).enumerate() {
            let start = columns.start + v * LANES;
            let here = start..(start + LANES).min(columns.end);
            let mut y = s.load(&sums[v * LANES..]);
            if let Some(bias) = self.bias {
                y = s.add(y, s.load_partial(&bias[here.clone()], 0.0));
            }
            y = match self.activation {
                Activation::Identity => y,
                Activation::Silu => math::silu(s, y),
            };
            let gamma = self.gamma.map(|gamma| s.load_partial(&gamma[here], 0.0));
            let y = match (gamma, self.residual) {
                (None, false) => y,
                (Some(gamma), false) => s.mul(gamma, y),
                (None, true) => s.add(s.load_partial(out, 0.0), y),
                (Some(gamma), true) => s.mul_add(gamma, y, s.load_partial(out, 0.0)),
            };
            s.store_partial(y, out);
        }
    }
}
