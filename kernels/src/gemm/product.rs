//! A product with its operands.

use super::{Epilogue, Input, Weights};
use crate::size;

/// A product whose sizes have been checked.
#[derive(Clone, Copy)]
pub(crate) struct Product<'a> {
    pub(super) x: Input<'a>,
    pub(super) m: usize,
    pub(super) weights: &'a Weights,
    pub(super) epilogue: &'a Epilogue<'a>,
}

impl<'a> Product<'a> {
    /// Checks the sizes, with `len` values to write.
    pub(crate) fn new(x: Input<'a>, m: usize, weights: &'a Weights, epilogue: &'a Epilogue<'a>, len: usize) -> Self {
        let (n, k) = (weights.n, weights.k);
        x.check(m, k);
        assert_eq!(len, size::product([m, n]), "output holds {len} values, expected m·n = {m}·{n}");
        epilogue.check(m, n);
        Self { x, m, weights, epilogue }
    }
}
