use super::{Tolerance, moved, reference};
use crate::testing::{noise, on_every_level_and_thread_count};

/// Rows that moved; checks that every level and thread count returns the same.
fn everywhere(tolerance: Tolerance, d: usize, x: &[f32], references: &[f32], at: Option<&[u32]>) -> Vec<bool> {
    let rows = x.len() / d;
    let out = on_every_level_and_thread_count(rows, |level, out| {
        let mut found = vec![false; rows];
        moved(level, tolerance, d, x, references, at, &mut found);
        out.iter_mut().zip(found).for_each(|(out, found)| *out = f32::from(u8::from(found)));
    });
    out.into_iter().map(|x| x == 1.0).collect()
}

#[test]
fn rows_further_than_the_tolerance_moved() {
    for (rows, d) in [(5, 1), (300, 67), (900, 192), (40, 768)] {
        let r = noise(rows * d, 1);
        // Distances around the bound, row by row.
        let x: Vec<f32> = r
            .iter()
            .zip(noise(rows * d, 2))
            .enumerate()
            .map(|(i, (r, e))| r + 0.1 * e * (i / d) as f32 / rows as f32)
            .collect();
        let found = everywhere(Tolerance::Relative(0.05), d, &x, &r, None);
        for (i, found) in found.iter().enumerate() {
            let excess = reference::excess(0.05, &x[i * d..][..d], &r[i * d..][..d]);
            assert!(excess.abs() < 1e-4 || *found == (excess > 0.0), "{rows}x{d}, row {i}: {excess:e}");
        }
        assert!(d == 1 || (found.contains(&true) && found.contains(&false)));
    }
}

#[test]
fn without_a_tolerance_one_bit_is_enough() {
    let d = 33;
    let r = noise(7 * d, 1);
    let mut x = r.clone();
    x[2 * d + 32] = f32::from_bits(x[2 * d + 32].to_bits() ^ 1);
    x[5 * d] = -0.0;
    let mut r = r;
    r[5 * d] = 0.0;
    let found = everywhere(Tolerance::Bits, d, &x, &r, None);
    assert_eq!(found, [false, false, true, false, false, true, false]);
    assert_eq!(everywhere(Tolerance::Relative(0.0), d, &r, &r, None), [false; 7]);
}

#[test]
fn rows_are_compared_with_the_references_at_their_places() {
    let d = 20;
    let r = noise(50 * d, 3);
    let at = [7, 3, 49];
    let mut x: Vec<f32> = at.iter().flat_map(|at| r[*at as usize * d..][..d].to_vec()).collect();
    x[d] += 1.0;
    for tolerance in [Tolerance::Bits, Tolerance::Relative(1e-3)] {
        assert_eq!(everywhere(tolerance, d, &x, &r, Some(&at)), [false, true, false]);
    }
}

#[test]
fn rows_that_overflow_or_are_undefined_moved() {
    let r = [1.0, 1e30, 1.0, 0.0];
    let x = [f32::NAN, -1e30, 1.0, 0.0];
    assert_eq!(everywhere(Tolerance::Relative(0.5), 1, &x, &r, None), [true, true, false, false]);
}
