//! Epilogues: bias, activation, scale and residual, applied to a product before it is written.

use std::ops::Range;

use super::places::{Layout, Places};
use crate::math;
use crate::simd::{LANES, Simd};

/// The function of an [`Epilogue`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Activation {
    /// `y`
    #[default]
    Identity,
    /// `y · σ(y)`; within 1e-4 of that where the operands are bf16 or 8-bit integers.
    Silu,
    /// `y · Φ(y)`, the exact form with the error function.
    Gelu,
}

/// Epilogue of a product `p`: `y = activation(p + bias)`, then `out = γ·y`, or, with a residual, `out += γ·y`.
///
/// Rows of `out` hold all columns unless [`Epilogue::in_groups_of`] or [`Epilogue::shuffled`] sets another layout.
///
/// `p + bias` is a plain addition. Without `γ` the residual is a plain addition; with it `γ·y + out` is rounded once.
///
/// ```
/// use streamsplat_kernels::{Level, gemm::{Epilogue, Weights, linear}};
/// let weights = Weights::pack(Level::detect(), &[1.0, 2.0, 3.0, 4.0], 2, 2);
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
    layout: Layout,
}

impl<'a> Epilogue<'a> {
    /// `out = p`
    pub const fn new() -> Self {
        Self { bias: None, activation: Activation::Identity, gamma: None, residual: false, layout: Layout::Rows }
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

    /// Applies exact GELU.
    #[must_use]
    pub const fn gelu(mut self) -> Self {
        self.activation = Activation::Gelu;
        self
    }

    /// Multiplies by `gamma [n]` (layer scale).
    #[must_use]
    pub const fn gamma(mut self, gamma: &'a [f32]) -> Self {
        self.gamma = Some(gamma);
        self
    }

    /// Adds to the values in `out` instead of replacing them.
    #[must_use]
    pub const fn residual(mut self) -> Self {
        self.residual = true;
        self
    }

    /// Writes the columns in groups of `width`, each a matrix of its own: `out [n/width][m][width]`, as attention reads
    /// its heads.
    #[must_use]
    pub const fn in_groups_of(mut self, width: usize) -> Self {
        self.layout = Layout::Groups(width);
        self
    }

    /// Writes a pixel shuffle: rows are the tokens of a grid with this many columns, line by line, and each becomes 2×2
    /// tokens of a grid twice as fine. The columns of a product are four groups, left and right of the upper and of the
    /// lower line: `out [m/columns][2][columns][2][n/4]` holds column `(2i + j)·n/4 + c` of token `(y, x)` at
    /// `[y][i][x][j][c]`.
    #[must_use]
    pub const fn shuffled(mut self, columns: usize) -> Self {
        self.layout = Layout::Shuffled(columns);
        self
    }

    /// Where a product of `m` rows and `n` columns is written.
    pub(super) fn places(&self, m: usize, n: usize) -> Places {
        Places::new(self.layout, m, n)
    }

    pub(super) fn check(&self, m: usize, n: usize) {
        match self.layout {
            Layout::Rows => {}
            Layout::Groups(width) => assert!(
                width > 0 && width.is_multiple_of(LANES) && n.is_multiple_of(width),
                "groups of {width} columns of {n}, expected a multiple of {LANES} that divides them"
            ),
            Layout::Shuffled(columns) => assert!(
                n.is_multiple_of(4 * LANES) && columns > 0 && m.is_multiple_of(columns),
                "a shuffle of {n} columns and {m} tokens in lines of {columns}, expected a multiple of {} and whole lines",
                4 * LANES
            ),
        }
        for (name, values) in [("bias", self.bias), ("gamma", self.gamma)] {
            if let Some(values) = values {
                assert_eq!(values.len(), n, "{name} holds {} values, expected n = {n}", values.len());
            }
        }
    }

    /// Returns true if no function is applied between the product and the additions.
    pub(super) fn is_affine(&self) -> bool {
        self.activation == Activation::Identity
    }

    /// The epilogue's vectors for up to 16 columns.
    #[inline(always)]
    pub(super) fn affine<S: Simd>(&self, s: S, columns: &Range<usize>) -> Affine<S> {
        let bias = match self.bias {
            Some(bias) => s.load_partial(&bias[columns.clone()], 0.0),
            None => s.splat(-0.0),
        };
        let gamma = match self.gamma {
            Some(gamma) => s.load_partial(&gamma[columns.clone()], 0.0),
            None => s.splat(1.0),
        };
        Affine { bias, gamma, residual: self.residual }
    }

    /// The function between the bias and the rest.
    pub(super) fn activation(&self) -> Activation {
        self.activation
    }
}

/// An [`Activation`] on vectors.
pub(crate) trait Function {
    fn of<S: Simd>(s: S, y: S::F32) -> S::F32;
}

pub(crate) struct Identity;
pub(crate) struct Silu;
pub(super) struct SiluLow;
pub(crate) struct Gelu;

impl Function for Identity {
    #[inline(always)]
    fn of<S: Simd>(_: S, y: S::F32) -> S::F32 {
        y
    }
}
impl Function for Silu {
    #[inline(always)]
    fn of<S: Simd>(s: S, y: S::F32) -> S::F32 {
        math::silu(s, y)
    }
}
impl Function for SiluLow {
    #[inline(always)]
    fn of<S: Simd>(s: S, y: S::F32) -> S::F32 {
        math::silu_low(s, y)
    }
}
impl Function for Gelu {
    #[inline(always)]
    fn of<S: Simd>(s: S, y: S::F32) -> S::F32 {
        math::gelu(s, y)
    }
}

/// An epilogue's vectors for 16 columns.
///
/// An absent bias is −0 and an absent `γ` is 1: neither changes a bit of its operand.
#[derive(Clone, Copy)]
pub(super) struct Affine<S: Simd> {
    pub(super) bias: S::F32,
    gamma: S::F32,
    pub(super) residual: bool,
}

impl<S: Simd> Affine<S> {
    /// The epilogue without a function; `before` is the value in the output where there is a residual.
    #[inline(always)]
    pub(super) fn apply(&self, s: S, p: S::F32, before: S::F32) -> S::F32 {
        self.finish(s, s.add(p, self.bias), before)
    }

    /// Scale and residual, which follow the function.
    #[inline(always)]
    pub(super) fn finish(&self, s: S, y: S::F32, before: S::F32) -> S::F32 {
        if self.residual { s.mul_add(self.gamma, y, before) } else { s.mul(self.gamma, y) }
    }
}
