//! Sizes of slices: products that cannot overflow.
//!
//! Unsafe code relies on a slice having the length of its shape. Plain products of sizes overflow in release builds: a
//! shape of 2⁶⁰ rows of 16 values would fit an empty slice. So every size assertion of this crate multiplies here.

/// The largest size: no slice has more elements of a byte or more.
const MOST: usize = isize::MAX.cast_unsigned();

/// Returns the product of `factors`, or `None` where the product of the factors other than 0 is above `isize::MAX`.
///
/// If the result is `Some`, the product of any of the factors in any order fits, with room for a sum of two.
pub(crate) const fn checked_product<const N: usize>(factors: [usize; N]) -> Option<usize> {
    let (mut product, mut empty, mut i) = (1_usize, false, 0);
    while i < N {
        if factors[i] == 0 {
            empty = true;
        } else {
            product = match product.checked_mul(factors[i]) {
                Some(product) if product <= MOST => product,
                _ => return None,
            };
        }
        i += 1;
    }
    Some(if empty { 0 } else { product })
}

/// Returns the value of [`checked_product`].
///
/// # Panics
/// Where it is `None`.
#[track_caller]
pub(crate) fn product<const N: usize>(factors: [usize; N]) -> usize {
    match checked_product(factors) {
        Some(product) => product,
        None => panic!("a size of {factors:?}: the product is above {MOST}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_exact_or_refused() {
        assert_eq!(checked_product([]), Some(1));
        assert_eq!(checked_product([3, 4, 5]), Some(60));
        assert_eq!(checked_product([MOST]), Some(MOST));
        assert_eq!(checked_product([MOST, 1, 0]), Some(0));
        for wrapping in [[1 << 32, 1 << 32, 1], [1 << 60, 16, 1], [1 << 62, 1, 2], [usize::MAX, 1, 1]] {
            assert_eq!(checked_product(wrapping), None, "{wrapping:?}");
        }
        // A zero among the factors changes nothing: parts of the product are multiplied elsewhere.
        assert_eq!(checked_product([1 << 60, 0, 16]), None);
    }

    #[test]
    #[should_panic(expected = "a size of [1152921504606846976, 16]")]
    fn a_refusal_names_the_sizes() {
        product([1 << 60, 16]);
    }
}
