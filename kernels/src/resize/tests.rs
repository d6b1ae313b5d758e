//! Against the references, against values of other libraries, and bits across levels and threads.

use super::*;
use crate::Level;

/// Uniform numbers of the linear congruential generator with which the tables below were made.
fn noise(n: usize) -> Vec<f32> {
    let mut state = 1_u32;
    let next = |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 16_777_216.0
    };
    (0..n).map(next).collect()
}

/// Up, down, one axis only, one pixel wide or high, and larger than a task.
const SIZES: [(usize, usize, usize, usize); 11] = [
    (5, 7, 9, 12),
    (37, 37, 18, 32),
    (13, 50, 7, 9),
    (6, 40, 6, 17),
    (23, 8, 70, 8),
    (1, 9, 5, 4),
    (9, 1, 4, 33),
    (1, 1, 3, 40),
    (31, 17, 1, 1),
    (4, 4, 4, 4),
    (40, 19, 130, 101),
];

fn close(got: &[f32], expected: &[f64], what: &str) {
    assert_eq!(got.len(), expected.len());
    for (i, (a, b)) in got.iter().zip(expected).enumerate() {
        assert!((f64::from(*a) - b).abs() <= 4e-7, "{what}, element {i}: {a} instead of {b}");
    }
}

#[test]
fn bilinear_agrees_with_the_reference() {
    for (h, w, dst_h, dst_w) in SIZES {
        let source = noise(3 * h * w);
        let mut out = vec![f32::NAN; 3 * dst_h * dst_w];
        bilinear(Level::detect(), &source, 3, h, w, dst_h, dst_w, &mut out);
        let expected = reference::bilinear(&source, 3, h, w, dst_h, dst_w);
        close(&out, &expected, &format!("{h}×{w} to {dst_h}×{dst_w}"));
    }
}

#[test]
fn antialiasing_agrees_with_the_reference_in_both_layouts() {
    for (h, w, dst_h, dst_w) in SIZES {
        for filter in [Filter::Triangle, Filter::Cubic] {
            for (outer, inner) in [(3, 1), (1, 3), (2, 21)] {
                let grid = Grid { outer, height: h, width: w, inner };
                let source = noise(outer * inner * h * w);
                let mut out = vec![f32::NAN; outer * inner * dst_h * dst_w];
                antialiased(Level::detect(), filter, &source, grid, dst_h, dst_w, &mut out);
                let expected = reference::antialiased(filter, &source, grid, dst_h, dst_w);
                close(&out, &expected, &format!("{filter:?} {grid:?} to {dst_h}×{dst_w}"));
            }
        }
    }
}

#[test]
fn antialiasing_agrees_with_pillow() {
    // Image.fromarray(noise, mode="F").resize(…), Pillow 12: (flat index, value).
    let check = |out: &[f32], expected: &[(usize, f32)]| {
        for &(i, value) in expected {
            assert!((out[i] - value).abs() < 3e-7, "element {i}: {} instead of {value}", out[i]);
        }
    };
    let mut out = vec![0.0; 18 * 32];
    bicubic_antialiased(Level::detect(), &noise(37 * 37), 37, 37, 1, 18, 32, &mut out);
    let expected = [
        (0, 0.632_648_05),
        (52, 0.800_533_6),
        (104, 0.423_977_23),
        (156, 0.342_708_23),
        (209, 0.455_632_27),
        (261, 0.243_714_82),
        (313, 0.405_509),
        (365, 0.672_524_15),
        (418, 0.560_086_2),
        (470, 0.533_281_03),
        (522, 0.703_113_73),
        (575, 0.286_459_9),
    ];
    check(&out, &expected);
    let mut out = vec![0.0; 11 * 5];
    bilinear_antialiased(Level::detect(), &noise(37 * 37), 1, 37, 37, 11, 5, &mut out);
    let expected = [(0, 0.569_051_1), (4, 0.506_677_8), (19, 0.522_303_7), (34, 0.495_296_27), (54, 0.523_627_46)];
    check(&out, &expected);
    let mut out = vec![0.0; 9 * 12];
    bicubic_antialiased(Level::detect(), &noise(35), 5, 7, 1, 9, 12, &mut out);
    let expected = [(0, 0.195_849_97), (9, 0.367_958_9), (19, 0.166_981_34), (58, 0.311_384_74), (107, 0.340_635_5)];
    check(&out, &expected);
}

/// Results of all functions, planar where there is a choice.
fn every_way(level: Level, source: &[f32], size: (usize, usize, usize, usize)) -> Vec<Vec<u32>> {
    let (h, w, dst_h, dst_w) = size;
    let mut all = Vec::new();
    let mut run = |work: &dyn Fn(&mut [f32])| {
        let mut out = vec![f32::NAN; 3 * dst_h * dst_w];
        work(&mut out);
        all.push(out.into_iter().map(f32::to_bits).collect());
    };
    run(&|out| bilinear(level, source, 3, h, w, dst_h, dst_w, out));
    run(&|out| bilinear_antialiased(level, source, 3, h, w, dst_h, dst_w, out));
    run(&|out| bicubic_antialiased(level, source, h, w, 3, dst_h, dst_w, out));
    run(&|out| {
        antialiased(level, Filter::Cubic, source, Grid { outer: 3, height: h, width: w, inner: 1 }, dst_h, dst_w, out);
    });
    all
}

#[test]
fn bits_are_equal_on_every_level_and_for_any_number_of_threads() {
    for threads in [1, 2, 3, 8] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        for size in SIZES {
            let source = noise(3 * size.0 * size.1);
            let expected = every_way(Level::scalar(), &source, size);
            for level in crate::testing::levels() {
                let got = pool.install(|| every_way(level, &source, size));
                assert_eq!(got, expected, "{size:?} on {level} with {threads} threads");
            }
        }
    }
}

#[test]
fn the_same_size_is_a_copy() {
    let mut source = noise(3 * 9 * 21);
    source[17] = f32::INFINITY;
    source[18] = -0.0;
    source[19] = 1e-45;
    let bits: Vec<u32> = source.iter().map(|x| x.to_bits()).collect();
    for got in every_way(Level::detect(), &source, (9, 21, 9, 21)) {
        assert_eq!(got, bits);
    }
}

#[test]
fn constants_stay_constant() {
    for size in SIZES {
        let source = vec![0.3_f32; 3 * size.0 * size.1];
        for (way, got) in every_way(Level::detect(), &source, size).into_iter().enumerate() {
            for x in got {
                let x = f32::from_bits(x);
                // Two taps keep a constant to the bit; more have rounded weights.
                assert!(if way == 0 { x == 0.3 } else { (x - 0.3).abs() < 2e-7 }, "{size:?}: {x}");
            }
        }
    }
}

#[test]
fn one_bad_value_reaches_only_its_neighbours() {
    let (h, w, dst_h, dst_w) = (24, 40, 9, 15);
    let mut source = noise(3 * h * w);
    let (y, x) = (11, 23);
    source[y * w + x] = f32::NAN;
    let taps = |radius: f64| {
        let reach = |i: usize, n: usize, m: usize, at: usize| {
            let ratio = n as f64 / m as f64;
            ((i as f64 + 0.5) * ratio - at as f64 - 0.5).abs() <= radius * ratio + 1.0
        };
        (0..dst_h * dst_w)
            .filter(|i| reach(i / dst_w, h, dst_h, y) && reach(i % dst_w, w, dst_w, x))
            .collect::<Vec<_>>()
    };
    let mut out = vec![0.0; 3 * dst_h * dst_w];
    bilinear(Level::detect(), &source, 3, h, w, dst_h, dst_w, &mut out);
    assert!(out.iter().enumerate().all(|(i, v)| v.is_finite() || taps(1.0).contains(&i)));
    bilinear_antialiased(Level::detect(), &source, 3, h, w, dst_h, dst_w, &mut out);
    assert!(out.iter().any(|v| v.is_nan()));
    assert!(out.iter().enumerate().all(|(i, v)| v.is_finite() || taps(1.0).contains(&i)));
}

#[test]
fn nothing_to_write_is_no_work() {
    bilinear(Level::detect(), &[], 0, 3, 3, 5, 5, &mut []);
    bilinear(Level::detect(), &[0.5; 9], 1, 3, 3, 0, 5, &mut []);
    bicubic_antialiased(Level::detect(), &[0.5; 9], 3, 3, 1, 5, 0, &mut []);
}

#[test]
#[should_panic(expected = "cannot be resized")]
fn an_empty_image_has_no_other_size() {
    bilinear(Level::detect(), &[], 1, 0, 3, 1, 1, &mut [0.0]);
}
