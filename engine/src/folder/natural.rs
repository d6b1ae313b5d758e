//! Natural order of file names: `frame2` comes before `frame10`.

use std::cmp::Ordering;

/// Compares names with runs of digits compared as numbers.
///
/// The names are split into single bytes and runs of ASCII digits. Pieces are compared in turn: two runs by value (of
/// any length, leading zeros ignored), everything else by byte. Names that compare equal in this way (`a1`, `a01`) are
/// ordered by their bytes. So the order is total: only identical names are equal.
pub fn compare(left: &[u8], right: &[u8]) -> Ordering {
    let (mut a, mut b) = (left, right);
    loop {
        match (a.first(), b.first()) {
            (None, None) => return left.cmp(right),
            (None, Some(_)) => return Ordering::Less,
            (Some(_), None) => return Ordering::Greater,
            (Some(x), Some(y)) if x.is_ascii_digit() && y.is_ascii_digit() => {
                let (run_a, rest_a) = digits(a);
                let (run_b, rest_b) = digits(b);
                // Without leading zeros, the longer run is the larger number.
                let order = run_a.len().cmp(&run_b.len()).then_with(|| run_a.cmp(run_b));
                if order != Ordering::Equal {
                    return order;
                }
                (a, b) = (rest_a, rest_b);
            }
            (Some(x), Some(y)) => {
                if x != y {
                    return x.cmp(y);
                }
                (a, b) = (&a[1..], &b[1..]);
            }
        }
    }
}

/// Splits off the leading run of digits, without its leading zeros.
fn digits(name: &[u8]) -> (&[u8], &[u8]) {
    let end = name.iter().position(|c| !c.is_ascii_digit()).unwrap_or(name.len());
    let (run, rest) = name.split_at(end);
    let first = run.iter().position(|&c| c != b'0').unwrap_or(run.len());
    (&run[first..], rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sorted(names: &[&'static str]) -> Vec<&'static str> {
        let mut names = names.to_vec();
        names.sort_by(|a, b| compare(a.as_bytes(), b.as_bytes()));
        names
    }

    #[test]
    fn numbers_count_as_numbers() {
        assert_eq!(
            sorted(&["f10.png", "f9.png", "f1.png", "f010.png", "f2b.png", "f2a.png", "e99.png", "f.png"]),
            ["e99.png", "f.png", "f1.png", "f2a.png", "f2b.png", "f9.png", "f010.png", "f10.png"]
        );
        assert_eq!(sorted(&["99999999999999999999999", "100000000000000000000000"])[0], "99999999999999999999999");
    }

    proptest! {
        #[test]
        fn the_order_is_total(a in "[a0-2]{0,6}", b in "[a0-2]{0,6}", c in "[a0-2]{0,6}") {
            let (a, b, c) = (a.as_bytes(), b.as_bytes(), c.as_bytes());
            prop_assert_eq!(compare(a, b), compare(b, a).reverse());
            prop_assert_eq!(compare(a, b) == Ordering::Equal, a == b);
            if compare(a, b) == Ordering::Less && compare(b, c) == Ordering::Less {
                prop_assert_eq!(compare(a, c), Ordering::Less);
            }
        }
    }
}
