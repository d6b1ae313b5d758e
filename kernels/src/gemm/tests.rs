use super::{Epilogue, Input, Precision, Weights, linear, reference};
use crate::Level;
use crate::norm::{self, Norm};
use crate::testing::{bits, noise, on_every_level_and_thread_count};

const SIZES: [(usize, usize, usize); 9] = [
    (1, 1, 1),
    (1, 16, 4),
    (5, 17, 3),
    (13, 33, 255),
    (97, 50, 256),
    (12, 96, 257),
    (101, 70, 513),
    (55, 23, 1030),
    (3, 5, 0),
];

#[test]
fn every_level_and_thread_count_gives_the_defined_bits() {
    for (m, n, k) in SIZES {
        let (x, w) = (noise(m * k, 1), noise(n * k, 2));
        let weights = Weights::pack(Level::detect(), &w, n, k);
        let out = on_every_level_and_thread_count(m * n, |level, out| {
            linear(level, &x, m, &weights, &Epilogue::new(), out);
        });
        assert!(bits(&out) == bits(&reference::product(&x, &w, m, n, k)), "{m}x{n}x{k}");
    }
}

#[test]
fn lower_precisions_give_their_defined_bits_everywhere() {
    for precision in [Precision::Bf16, Precision::Int8] {
        for (m, n, k) in SIZES.into_iter().chain([(7, 20, 2051)]) {
            let (mut x, mut w) = (noise(m * k, 1), noise(n * k, 2));
            // Every magnitude a row can have, and values that a format flushes or cannot hold.
            for (i, row) in x.chunks_mut(k.max(1)).enumerate() {
                row.iter_mut().for_each(|x| *x *= [1.0, 1e-20, 1e15, 1e-40, 0.0][i % 5]);
                if i % 7 == 6 {
                    row[k / 2] = f32::NAN;
                }
            }
            w.iter_mut().step_by(11).for_each(|w| *w *= 1e-17);
            let weights = Weights::pack_as(Level::detect(), precision, &w, n, k);
            let out = on_every_level_and_thread_count(m * n, |level, out| {
                linear(level, &x, m, &weights, &Epilogue::new(), out);
            });
            assert!(
                bits(&out) == bits(&reference::product_as(precision, &x, &w, m, n, k)),
                "{precision:?} {m}x{n}x{k}"
            );
        }
    }
}

#[test]
fn weights_are_packed_alike_on_every_level() {
    for (_, n, k) in SIZES {
        let mut w = noise(n * k, 2);
        // Values that a format flushes, rounds to zero, or cannot hold.
        w.iter_mut().step_by(11).for_each(|w| *w *= 1e-17);
        w.iter_mut().step_by(13).for_each(|w| *w = -0.0);
        if let Some(w) = w.last_mut() {
            *w = f32::INFINITY;
        }
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let expected = Weights::pack_as(Level::scalar(), precision, &w, n, k);
            for level in crate::testing::levels() {
                let packed = Weights::pack_as(level, precision, &w, n, k);
                assert!(packed.panels[..] == expected.panels[..], "{level}, {precision:?}, {n}x{k}");
                assert_eq!(packed.scales, expected.scales, "{level}, {precision:?}, {n}x{k}");
                assert_eq!(packed.offsets, expected.offsets, "{level}, {precision:?}, {n}x{k}");
            }
        }
    }
}

#[test]
fn lower_precisions_stay_near_the_exact_product() {
    let (m, n, k) = (9, 40, 768);
    let (x, w) = (noise(m * k, 3), noise(n * k, 4));
    let exact = reference::product_f64(&x, &w, m, n, k);
    let size: f64 = exact.iter().map(|e| e * e).sum();
    for (precision, bound) in [(Precision::F32, 1e-6), (Precision::Bf16, 4e-3), (Precision::Int8, 8e-3)] {
        let mut out = vec![0.0; m * n];
        linear(
            Level::detect(),
            &x,
            m,
            &Weights::pack_as(Level::detect(), precision, &w, n, k),
            &Epilogue::new(),
            &mut out,
        );
        let error: f64 = out.iter().zip(&exact).map(|(o, e)| (f64::from(*o) - e).powi(2)).sum();
        assert!((error / size).sqrt() < bound, "{precision:?}: {:e}", (error / size).sqrt());
    }
}

#[test]
fn the_error_stays_far_below_that_of_one_long_chain() {
    let (m, n, k) = (4, 19, 3000);
    let (x, w) = (noise(m * k, 3), noise(n * k, 4));
    let mut out = vec![0.0; m * n];
    linear(Level::detect(), &x, m, &Weights::pack(Level::detect(), &w, n, k), &Epilogue::new(), &mut out);
    let size = reference::product_f64(
        &x.iter().map(|x| x.abs()).collect::<Vec<_>>(),
        &w.iter().map(|w| w.abs()).collect::<Vec<_>>(),
        m,
        n,
        k,
    );
    for (i, e) in reference::product_f64(&x, &w, m, n, k).iter().enumerate() {
        let error = (f64::from(out[i]) - e).abs();
        assert!(error < 2e-7 * size[i], "{error:e} of {:e}", size[i]);
    }
}

#[test]
fn sums_that_cancel_lose_only_their_own_rounding() {
    // +big, small, −big inside one block: the chain keeps the bits that fit next to big.
    let (mut x, w) = (vec![0.0; 300], vec![1.0; 300]);
    (x[0], x[1], x[2]) = (1e6, 0.25, -1e6);
    (x[260], x[299]) = (3e38, -3e38);
    let out = on_every_level_and_thread_count(1, |level, out| {
        linear(level, &x, 1, &Weights::pack(Level::detect(), &w, 1, 300), &Epilogue::new(), out);
    });
    assert_eq!(out[0], 0.25);
}

#[test]
fn epilogues_are_the_functions_they_name() {
    let (m, n, k) = (7, 37, 20);
    let (x, w, bias, gamma) = (noise(m * k, 5), noise(n * k, 6), noise(n, 7), noise(n, 8));
    let product = reference::product_f64(&x, &w, m, n, k);
    let weights = Weights::pack(Level::detect(), &w, n, k);
    let silu = |y: f64| y / (1.0 + (-y).exp());
    // Φ by its series: exact enough for a test.
    let gelu = |y: f64| {
        let z = y / std::f64::consts::SQRT_2;
        let (mut term, mut sum) = (z, z);
        for i in 1..80 {
            term *= -z * z / f64::from(i);
            sum += term / f64::from(2 * i + 1);
        }
        y * 0.5 * (1.0 + sum * 2.0 / std::f64::consts::PI.sqrt())
    };
    let b = Epilogue::new().bias(&bias);
    let cases: [(&str, Epilogue<'_>, &dyn Fn(f64, f64, f64) -> f64); 7] = [
        ("none", Epilogue::new(), &|p, _, _| p),
        ("bias", b, &|p, b, _| p + b),
        ("silu", Epilogue::new().silu(), &|p, _, _| silu(p)),
        ("bias, silu", b.silu(), &|p, b, _| silu(p + b)),
        ("bias, gelu", b.gelu(), &|p, b, _| gelu(p + b)),
        ("bias, residual", b.residual(), &|p, b, _| 0.5 + p + b),
        ("bias, gamma, residual", b.gamma(&gamma).residual(), &|p, b, g| 0.5 + g * (p + b)),
    ];
    for (name, epilogue, _) in &cases {
        for precision in [Precision::Bf16, Precision::Int8] {
            let weights = Weights::pack_as(Level::detect(), precision, &w, n, k);
            on_every_level_and_thread_count(m * n, |level, out| linear(level, &x, m, &weights, epilogue, out));
            assert!(weights.bytes() < n.next_multiple_of(16) * k * 3, "{name}");
        }
    }
    for (name, epilogue, expected) in cases {
        let out = on_every_level_and_thread_count(m * n, |level, out| linear(level, &x, m, &weights, &epilogue, out));
        for i in 0..m * n {
            let e = expected(product[i], f64::from(bias[i % n]), f64::from(gamma[i % n]));
            assert!((f64::from(out[i]) - e).abs() < 2e-6, "{name}: {} but {e}", out[i]);
        }
    }
}

#[test]
#[should_panic(expected = "expected m·k")]
fn a_short_input_is_refused() {
    linear(
        Level::detect(),
        &[0.0; 5],
        2,
        &Weights::pack(Level::detect(), &[0.0; 9], 3, 3),
        &Epilogue::new(),
        &mut [0.0; 6],
    );
}

#[test]
fn rows_normalised_on_their_way_are_those_normalised_before() {
    for (m, n, k) in SIZES.into_iter().chain([(400, 40, 70)]) {
        let (x, w, scale, shift) = (noise(m * k, 1), noise(n * k, 2), noise(k, 3), noise(k, 4));
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let weights = Weights::pack_as(Level::detect(), precision, &w, n, k);
            for norm in [Norm::rms(&scale, 1e-5), Norm::layer(&scale, &shift, 1e-6)] {
                let out = on_every_level_and_thread_count(m * n, |level, out| {
                    linear(level, Input::Normed(&x, norm), m, &weights, &Epilogue::new(), out);
                });
                let (level, mut normed, mut expected) = (Level::detect(), vec![0.0; m * k], vec![0.0; m * n]);
                norm::rows(level, &x, &mut normed, norm);
                linear(level, &normed, m, &weights, &Epilogue::new(), &mut expected);
                assert!(bits(&out) == bits(&expected), "{m}x{n}x{k}, {precision:?}");
            }
        }
    }
}

#[test]
#[should_panic(expected = "the norm is of 2 values, expected k = 3")]
fn a_norm_of_another_width_is_refused() {
    let input = Input::Normed(&[0.0; 6], Norm::rms(&[1.0; 2], 1e-5));
    linear(
        Level::detect(),
        input,
        2,
        &Weights::pack(Level::detect(), &[0.0; 9], 3, 3),
        &Epilogue::new(),
        &mut [0.0; 6],
    );
}

#[test]
fn columns_in_groups_are_the_same_values_elsewhere() {
    for (m, group, groups, k) in [(1, 16, 3, 20), (29, 48, 2, 70), (100, 64, 6, 300), (13, 16, 1, 1)] {
        let n = group * groups;
        let (x, w, bias) = (noise(m * k, 1), noise(n * k, 2), noise(n, 3));
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let weights = Weights::pack_as(Level::detect(), precision, &w, n, k);
            for epilogue in [Epilogue::new().bias(&bias), Epilogue::new().silu().residual()] {
                let mut rows = vec![0.5; m * n];
                linear(Level::detect(), &x, m, &weights, &epilogue, &mut rows);
                let grouped = on_every_level_and_thread_count(m * n, |level, out| {
                    linear(level, &x, m, &weights, &epilogue.in_groups_of(group), out);
                });
                let expected: Vec<f32> = (0..groups)
                    .flat_map(|g| rows.chunks(n).flat_map(move |row| row[g * group..][..group].to_vec()))
                    .collect();
                assert!(bits(&grouped) == bits(&expected), "{precision:?} {m}x{n}x{k} in groups of {group}");
            }
        }
    }
}

#[test]
#[should_panic(expected = "groups of 24 columns of 48")]
fn groups_that_are_no_whole_vectors_are_refused() {
    let weights = Weights::pack(Level::detect(), &[0.0; 48], 48, 1);
    linear(Level::detect(), &[0.0], 1, &weights, &Epilogue::new().in_groups_of(24), &mut [0.0; 48]);
}

#[test]
fn shuffled_columns_land_where_the_formula_says() {
    for (height, width, channels, k) in
        [(1, 1, 16, 20), (3, 5, 16, 70), (4, 7, 48, 300), (9, 24, 64, 9), (30, 12, 16, 9), (0, 3, 16, 4)]
    {
        let (m, n) = (height * width, 4 * channels);
        let (x, w, bias) = (noise(m * k, 1), noise(n * k, 2), noise(n, 3));
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let weights = Weights::pack_as(Level::detect(), precision, &w, n, k);
            for epilogue in [Epilogue::new().bias(&bias), Epilogue::new().silu(), Epilogue::new().residual()] {
                let mut rows = vec![0.5; m * n];
                linear(Level::detect(), &x, m, &weights, &epilogue, &mut rows);
                let shuffled = on_every_level_and_thread_count(m * n, |level, out| {
                    linear(level, &x, m, &weights, &epilogue.shuffled(width), out);
                });
                for (token, row) in rows.chunks(n).enumerate() {
                    for (column, value) in row.iter().enumerate() {
                        let (y, x, part, c) = (token / width, token % width, column / channels, column % channels);
                        let at = ((2 * y + part / 2) * 2 * width + 2 * x + part % 2) * channels + c;
                        assert_eq!(
                            shuffled[at].to_bits(),
                            value.to_bits(),
                            "{precision:?}, token {token}, column {column}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
#[should_panic(expected = "a shuffle of 64 columns and 5 tokens in lines of 2")]
fn a_shuffle_of_broken_lines_is_refused() {
    let weights = Weights::pack(Level::detect(), &[0.0; 64], 64, 1);
    linear(Level::detect(), &[0.0; 5], 5, &weights, &Epilogue::new().shuffled(2), &mut [0.0; 5 * 64]);
}

#[test]
#[should_panic(expected = "a shuffle of 96 columns")]
fn a_shuffle_of_no_whole_vectors_is_refused() {
    let weights = Weights::pack(Level::detect(), &[0.0; 96], 96, 1);
    linear(Level::detect(), &[0.0], 1, &weights, &Epilogue::new().shuffled(1), &mut [0.0; 96]);
}
