//! The same pairs by the hierarchy of boxes ([`crate::space::Tree`]), which the bins are compared with.

use proptest::prelude::*;

use super::*;
use crate::space::{Bounds, Tree};

fn tree(positions: &[[f32; 3]]) -> Tree {
    Tree::new((0..).zip(positions.iter().map(|&p| Bounds { least: p, greatest: p })))
}

/// The pairs (bits of q, index) that coincide with the probe.
fn coinciding(tree: &Tree, probe: &Probe, positions: &[[f32; 3]], near: &mut Vec<(u32, u32)>) {
    near.clear();
    let ([x, y, z], [rx, ry, rz]) = (probe.point, probe.radii);
    // A little more than the radii, against rounding.
    let side = |sign: f32| [x + sign * 1.001 * rx, y + sign * 1.001 * ry, z + sign * 1.001 * rz];
    for index in tree.overlapping(&Bounds { least: side(-1.0), greatest: side(1.0) }) {
        let p = positions[index as usize];
        let [dx, dy, dz] = [(p[0] - x) / rx, (p[1] - y) / ry, (p[2] - z) / rz];
        let q = dx * dx + dy * dy + dz * dz;
        if q <= 1.0 {
            near.push((q.to_bits(), index));
        }
    }
}

fn place() -> impl Strategy<Value = [f32; 3]> {
    [-1.1_f32..1.1, -0.1_f32..1.1, -1.1_f32..1.1]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_tree_finds_the_pairs_that_the_bins_find(
        new in prop::collection::vec(place(), 1..500),
        old in prop::collection::vec((place(), [0.0_f32..0.3, 0.0_f32..0.3]), 1..100),
    ) {
        let lattice = Lattice::new(new.len(), [9, 16]);
        let (bins, tree) = (Bins::new(lattice, &new), tree(&new));
        let (mut expected, mut found) = (Vec::new(), Vec::new());
        for (point, scale) in old {
            let probe = Probe { point, radii: lattice.radii(scale), recent: true };
            bins.coinciding(&probe, &new, &mut expected);
            coinciding(&tree, &probe, &new, &mut found);
            expected.sort_unstable();
            found.sort_unstable();
            prop_assert_eq!(&found, &expected);
        }
    }
}

#[test]
#[ignore = "a measurement: cargo test --release -p streamsplat --lib by_tree -- --ignored --nocapture"]
fn bins_and_tree_timed_on_two_frames_of_the_papers_size() {
    use std::time::Instant;
    let lattice = Lattice::new(144 * 256, [144, 256]);
    let mut state = 5_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    // One per cell with jitter within the cell, and depth in two sheets.
    let mut frame = |shift: f32| -> Vec<[f32; 3]> {
        let jitter = |i: usize, n: usize, r: f32| (2.0 * (i as f32 + r) + 1.0) / n as f32 - 1.0;
        (0..144 * 256)
            .map(|i| {
                let (x, z) = (jitter(i % 256, 256, random() - 0.5), jitter(i / 256, 144, random() - 0.5));
                [x + shift, if random() < 0.5 { 0.3 } else { 0.7 } + 0.05 * random(), z]
            })
            .collect()
    };
    let (new, points) = (frame(0.0), frame(0.004));
    let old: Vec<Probe> =
        points.iter().map(|&point| Probe { point, radii: lattice.radii([0.006; 2]), recent: true }).collect();
    let mut near = Vec::new();
    for _ in 0..5 {
        let start = Instant::now();
        let bins = Bins::new(lattice, &new);
        let binned = Instant::now();
        let mut pairs = [0; 2];
        for probe in &old {
            bins.coinciding(probe, &new, &mut near);
            pairs[0] += near.len();
        }
        let searched = Instant::now();
        let tree = tree(&new);
        let built = Instant::now();
        for probe in &old {
            coinciding(&tree, probe, &new, &mut near);
            pairs[1] += near.len();
        }
        let end = Instant::now();
        assert_eq!(pairs[0], pairs[1]);
        let [a, b, c, d] =
            [binned - start, searched - binned, built - searched, end - built].map(|t| t.as_secs_f64() * 1e3);
        println!(
            "{} pairs; bins {a:.2} + {b:.2} ms, tree {c:.2} + {d:.2} ms: {:.1} times",
            pairs[0],
            (c + d) / (a + b)
        );
    }
}
