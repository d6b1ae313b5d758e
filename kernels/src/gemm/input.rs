//! Rows of a product: unchanged, or normalised while they are packed.

use crate::norm::Norm;
use crate::size::product;

/// The rows of a product.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// As they are.
    Rows(&'a [f32]),
    /// Normalised row by row while they are packed: the same bits as with [`norm`](crate::norm) before, without an
    /// intermediate matrix.
    Normed(&'a [f32], Norm<'a>),
}

impl<'a> Input<'a> {
    /// The values before any normalisation.
    pub(crate) const fn values(&self) -> &'a [f32] {
        match self {
            Self::Rows(x) | Self::Normed(x, _) => x,
        }
    }

    pub(crate) fn check(&self, m: usize, k: usize) {
        let len = self.values().len();
        assert_eq!(len, product([m, k]), "input holds {len} values, expected m·k = {m}·{k}");
        if let Self::Normed(_, norm) = self {
            assert_eq!(norm.width(), k, "the norm is of {} values, expected k = {k}", norm.width());
        }
    }
}

impl<'a, T: AsRef<[f32]> + ?Sized> From<&'a T> for Input<'a> {
    fn from(rows: &'a T) -> Self {
        Self::Rows(rows.as_ref())
    }
}
