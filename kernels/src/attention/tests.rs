use super::{KEY_BLOCK, Rows, Shape, Windows, attend, attend_as, attend_some, reference};
use crate::gemm::Precision;
use crate::testing::{bits, noise, on_every_level_and_thread_count};

/// The largest error against binary64, relative to the largest value. Checks equality over levels and threads as well.
fn error(shape: Shape, queries: usize, keys: usize, q: &[f32], k: &[f32], v: &[f32]) -> f64 {
    let Shape { heads, width, windows } = shape;
    let d = heads * width;
    let out = on_every_level_and_thread_count(queries * d, |level, out| {
        let rows = |x, n| Rows::new(x, n, d, 0);
        attend(level, shape, rows(q, queries), rows(k, keys), rows(v, keys), out);
    });
    let run = |token: usize| match windows {
        Windows::Full => 0,
        Windows::Runs { length, roll } => (token + roll) % keys / length,
    };
    let expected = reference::attend(q, k, v, heads, width, |i, j| windows == Windows::Full || run(i) == run(j));
    let most = v.iter().fold(0.0_f64, |most, v| most.max(f64::from(v.abs())));
    out.iter().zip(expected).map(|(x, e)| (f64::from(*x) - e).abs() / most).fold(0.0, f64::max)
}

fn full(heads: usize) -> Shape {
    Shape { heads, width: 64, windows: Windows::Full }
}

#[test]
fn any_number_of_queries_and_keys_agrees_with_the_formula() {
    for (heads, queries, keys) in [(1, 1, 1), (1, 5, 3), (2, 17, 33), (1, 49, 129), (3, 101, 300)] {
        let d = heads * 64;
        let (q, k, v) = (noise(queries * d, 1), noise(keys * d, 2), noise(keys * d, 3));
        let worst = error(full(heads), queries, keys, &q, &k, &v);
        assert!(worst < 1e-6, "{heads} heads, {queries} queries, {keys} keys: {worst:e}");
    }
}

#[test]
fn other_head_widths_agree_with_the_formula() {
    for width in [16, 48, 80] {
        let shape = Shape { heads: 2, width, windows: Windows::Full };
        let (q, k, v) = (noise(31 * 2 * width, 1), noise(150 * 2 * width, 2), noise(150 * 2 * width, 3));
        let worst = error(shape, 31, 150, &q, &k, &v);
        assert!(worst < 1e-6, "width {width}: {worst:e}");
    }
}

#[test]
fn windows_see_their_own_run_and_wrap_when_rolled() {
    for (tokens, length, roll) in [(60, 20, 0), (60, 20, 10), (61, 20, 10), (300, 128, 64), (7, 100, 50), (290, 145, 1)]
    {
        let shape = Shape { heads: 2, width: 64, windows: Windows::Runs { length, roll } };
        let (q, k, v) = (noise(tokens * 128, 4), noise(tokens * 128, 5), noise(tokens * 128, 6));
        let worst = error(shape, tokens, tokens, &q, &k, &v);
        assert!(worst < 1e-6, "{tokens} tokens in runs of {length} rolled {roll}: {worst:e}");
    }
}

#[test]
fn matrices_inside_a_wider_one_are_read_in_place() {
    let (tokens, heads, d) = (50, 2, 128);
    let packed = noise(tokens * 3 * d, 7);
    let part = |first: usize| -> Vec<f32> { packed.chunks(3 * d).flat_map(|r| r[first..][..d].to_vec()).collect() };
    let (q, k, v) = (part(0), part(d), part(2 * d));
    let run =
        |q, k, v| on_every_level_and_thread_count(tokens * d, |level, out| attend(level, full(heads), q, k, v, out));
    let inside = |first| Rows::new(&packed, tokens, 3 * d, first);
    let apart = run(Rows::new(&q, tokens, d, 0), Rows::new(&k, tokens, d, 0), Rows::new(&v, tokens, d, 0));
    assert_eq!(run(inside(0), inside(d), inside(2 * d)), apart);
}

#[test]
fn heads_one_after_the_other_give_the_bits_of_heads_side_by_side() {
    for (tokens, windows) in [(50, Windows::Full), (401, Windows::Full), (300, Windows::Runs { length: 128, roll: 64 })]
    {
        let (heads, width) = (3, 64);
        let d = heads * width;
        let rows = noise(tokens * 3 * d, 7);
        let apart: Vec<f32> = (0..3 * heads)
            .flat_map(|head| rows.chunks(3 * d).flat_map(move |row| row[head * width..][..width].to_vec()))
            .collect();
        let shape = Shape { heads, width, windows };
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let run = |[q, k, v]: [Rows<'_>; 3]| {
                on_every_level_and_thread_count(tokens * d, |level, out| {
                    attend_as(precision, level, shape, q, k, v, out);
                })
            };
            let side_by_side = run([0, 1, 2].map(|part| Rows::new(&rows, tokens, 3 * d, part * d)));
            let in_turn = run([0, 1, 2].map(|part| Rows::of_heads(&apart, tokens, width, part * heads)));
            assert!(in_turn == side_by_side, "{precision:?}");
        }
    }
}

#[test]
#[should_panic(expected = "values: 2 heads of 64")]
fn heads_that_are_not_there_are_refused() {
    let x = [0.0; 128];
    let (two, one) = (Rows::of_heads(&x, 1, 64, 0), Rows::of_heads(&x, 1, 64, 1));
    attend(crate::Level::detect(), full(2), two, two, one, &mut [0.0; 128]);
}

#[test]
fn extreme_logits_keep_the_softmax() {
    let (queries, keys) = (20, 300);
    let v = noise(keys * 64, 3);
    // Logits near ±1e4, where one ulp of the score is 1e-3: the weights carry that, and stay an average of values.
    let scale = |x: Vec<f32>, by: f32| -> Vec<f32> { x.iter().map(|x| x * by).collect() };
    let (q, k) = (scale(noise(queries * 64, 1), 160.0), scale(noise(keys * 64, 2), 160.0));
    let worst = error(full(1), queries, keys, &q, &k, &v);
    assert!(worst < 2e-2, "large logits: {worst:e}");
    // All equal: the mean of the values.
    let same = vec![12.5; keys * 64];
    let worst = error(full(1), queries, keys, &vec![12.5; queries * 64], &same, &v);
    assert!(worst < 1e-6, "equal logits: {worst:e}");
    // One key far above the others: its value.
    let mut one = noise(keys * 64, 2);
    for c in 0..64 {
        one[200 * 64 + c] = 100.0;
    }
    let worst = error(full(1), queries, keys, &vec![12.5; queries * 64], &one, &v);
    assert!(worst < 1e-6, "one dominating key: {worst:e}");
}

#[test]
fn undefined_logits_never_spread() {
    let (queries, keys) = (5, 40);
    let (mut q, mut k, v) = (noise(queries * 64, 1), noise(keys * 64, 2), noise(keys * 64, 3));
    let clean = |q: &[f32], k: &[f32]| {
        on_every_level_and_thread_count(queries * 64, |level, out| {
            attend(
                level,
                full(1),
                Rows::new(q, queries, 64, 0),
                Rows::new(k, keys, 64, 0),
                Rows::new(&v, keys, 64, 0),
                out,
            );
        })
    };
    let before = clean(&q, &k);
    q[3 * 64] = f32::NAN;
    q[64..128].fill(1e30);
    k[7 * 64..8 * 64].fill(1e30);
    let after = clean(&q, &k);
    assert!(after.iter().all(|x| x.is_finite()));
    let mean: f32 = v.chunks(64).map(|v| v[0]).sum::<f32>() / keys as f32;
    assert!((after[3 * 64] - mean).abs() < 1e-5 && (after[64] - mean).abs() < 1e-5);
    k[7 * 64..8 * 64].copy_from_slice(&noise(keys * 64, 2)[7 * 64..8 * 64]);
    let repaired = clean(&q, &k);
    assert_eq!(repaired[..64], before[..64]);
    assert_eq!(repaired[4 * 64..], before[4 * 64..]);
}

#[test]
fn rows_without_a_finite_logit_are_the_mean_of_all_blocks_in_every_precision() {
    let (queries, keys) = (20, 2 * KEY_BLOCK + 17);
    let (q, v) = (vec![1.0; queries * 64], noise(keys * 64, 3));
    for logit in [f32::NEG_INFINITY, f32::INFINITY, f32::NAN] {
        let k = vec![logit; keys * 64];
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let out = on_every_level_and_thread_count(queries * 64, |level, out| {
                let rows = |x, n| Rows::new(x, n, 64, 0);
                attend_as(precision, level, full(1), rows(&q, queries), rows(&k, keys), rows(&v, keys), out);
            });
            for (i, out) in out.iter().enumerate() {
                let mean = v.chunks(64).map(|v| f64::from(v[i % 64])).sum::<f64>() / keys as f64;
                // Values themselves are rounded in the lower precisions.
                assert!((f64::from(*out) - mean).abs() < 1e-3, "{logit} {precision:?}: {out}, expected {mean}");
            }
        }
    }
}

#[test]
fn no_keys_give_zero_and_no_queries_nothing() {
    let rows = |x, n| Rows::new(x, n, 64, 0);
    let mut out = [1.0; 64];
    attend(crate::Level::detect(), full(1), rows(&[0.5; 64], 1), rows(&[], 0), rows(&[], 0), &mut out);
    assert_eq!(out, [0.0; 64]);
    attend(crate::Level::detect(), full(1), rows(&[], 0), rows(&[0.5; 64], 1), rows(&[0.5; 64], 1), &mut []);
}

#[test]
fn lower_precisions_stay_near_the_formula_and_agree_everywhere() {
    // Odd numbers of keys, more than a block of them, and widths that no level's register blocks divide.
    for (tokens, width) in [(211, 64), (1, 64), (401, 48), (50, 80), (33, 16)] {
        let (heads, d) = (2, 2 * width);
        let (q, k, v) = (noise(tokens * d, 1), noise(tokens * d, 2), noise(tokens * d, 3));
        let expected = reference::attend(&q, &k, &v, heads, width, |_, _| true);
        let shape = Shape { heads, width, windows: Windows::Full };
        for precision in [Precision::Bf16, Precision::Int8] {
            let out = on_every_level_and_thread_count(tokens * d, |level, out| {
                let rows = |x| Rows::new(x, tokens, d, 0);
                attend_as(precision, level, shape, rows(&q), rows(&k), rows(&v), out);
            });
            let error: f64 = out.iter().zip(&expected).map(|(o, e)| (f64::from(*o) - e).powi(2)).sum();
            let size: f64 = expected.iter().map(|e| e * e).sum();
            let error = (error / size).sqrt();
            assert!(error < 1e-2, "{precision:?}, {tokens} tokens of {width}: {error:e}");
        }
    }
}

#[test]
fn a_query_or_key_that_is_not_finite_counts_as_zeros_in_bytes() {
    fn rows(x: &[f32]) -> Rows<'_> {
        Rows::new(x, 40, 64, 0)
    }
    let (mut q, mut k, v) = (noise(40 * 64, 1), noise(40 * 64, 2), noise(40 * 64, 3));
    let run = |q: &[f32], k: &[f32]| {
        on_every_level_and_thread_count(40 * 64, |level, out| {
            attend_as(Precision::Int8, level, full(1), rows(q), rows(k), rows(&v), out);
        })
    };
    (q[64], k[7 * 64 + 3]) = (f32::NAN, f32::INFINITY);
    let found = run(&q, &k);
    q[64..128].fill(0.0);
    k[7 * 64..8 * 64].fill(0.0);
    assert_eq!(found, run(&q, &k));
}

#[test]
fn a_channel_of_values_that_is_not_finite_counts_as_zeros_in_its_block_in_bytes() {
    let keys = KEY_BLOCK + 30;
    let (q, k, mut v) = (noise(20 * 64, 1), noise(keys * 64, 2), noise(keys * 64, 3));
    let run = |v: &[f32]| {
        on_every_level_and_thread_count(20 * 64, |level, out| {
            let rows = |x, n| Rows::new(x, n, 64, 0);
            attend_as(Precision::Int8, level, full(1), rows(&q, 20), rows(&k, keys), rows(v, keys), out);
        })
    };
    (v[5 * 64 + 9], v[190 * 64 + 11]) = (f32::NAN, f32::NEG_INFINITY);
    let found = run(&v);
    for channel in [9, 11] {
        v.iter_mut().skip(channel).step_by(64).take(KEY_BLOCK).for_each(|v| *v = 0.0);
    }
    assert_eq!(found, run(&v));
}

#[test]
fn what_another_block_outweighs_a_thousandfold_still_counts_in_bytes() {
    // One key weighs half as much as all others together and is the peak of its block; each other key weighs less than
    // one step of 8 bits of it.
    let (queries, keys) = (16, 12 * KEY_BLOCK);
    let v = noise(keys * 64, 3);
    let mut k = vec![0.0; keys * 64];
    for (i, k) in k.chunks_mut(64).enumerate() {
        // The scale of a key is its own: a logit of 7 against noise around 0.
        let logit = if i == 77 { 7.0 } else { noise(1, i as u32 + 5)[0] * 0.1 };
        k[0] = logit * 8.0;
    }
    let mut q = vec![0.0; queries * 64];
    q.chunks_mut(64).for_each(|q| q[0] = 1.0);
    let expected = reference::attend(&q, &k, &v, 1, 64, |_, _| true);
    let out = on_every_level_and_thread_count(queries * 64, |level, out| {
        let rows = |x, n| Rows::new(x, n, 64, 0);
        attend_as(Precision::Int8, level, full(1), rows(&q, queries), rows(&k, keys), rows(&v, keys), out);
    });
    let error: f64 = out.iter().zip(&expected).map(|(o, e)| (f64::from(*o) - e).powi(2)).sum();
    let size: f64 = expected.iter().map(|e| e * e).sum();
    // Only the part of the tail in the peak's block is lost: a twelfth of it.
    assert!((error / size).sqrt() < 0.08, "{}", (error / size).sqrt());
}

#[test]
fn the_largest_values_of_all_leave_the_mean_a_mean_in_bytes() {
    let (q, v) = (vec![f32::MAX; 64], noise(40 * 64, 3));
    for sign in [1.0, -1.0] {
        let k: Vec<f32> = (0..40 * 64).map(|i| if i / 64 == 7 { sign * f32::MAX } else { 1.0 }).collect();
        let out = on_every_level_and_thread_count(64, |level, out| {
            let rows = |x, n| Rows::new(x, n, 64, 0);
            attend_as(Precision::Int8, level, full(1), rows(&q, 1), rows(&k, 40), rows(&v, 40), out);
        });
        for (c, out) in out.iter().enumerate() {
            let others = (0..40).filter(|&i| i != 7).map(|i| v[i * 64 + c]).sum::<f32>() / 39.0;
            let expected = if sign > 0.0 { v[7 * 64 + c] } else { others };
            assert!((out - expected).abs() < 5e-3, "{out}, expected {expected}");
        }
    }
}

#[test]
fn some_queries_give_the_bits_they_give_among_all() {
    for (tokens, windows) in [
        (211, Windows::Full),
        (300, Windows::Runs { length: 128, roll: 64 }),
        (300, Windows::Runs { length: 20, roll: 0 }),
        (7, Windows::Runs { length: 100, roll: 50 }),
    ] {
        let shape = Shape { heads: 2, width: 64, windows };
        let (q, k, v) = (noise(tokens * 128, 4), noise(tokens * 128, 5), noise(tokens * 128, 6));
        fn rows(x: &[f32], n: usize) -> Rows<'_> {
            Rows::new(x, n, 128, 0)
        }
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let mut all = vec![0.0; tokens * 128];
            let level = crate::Level::detect();
            attend_as(precision, level, shape, rows(&q, tokens), rows(&k, tokens), rows(&v, tokens), &mut all);
            for step in [1, 3, 50, 1000] {
                // In no order.
                let places: Vec<u32> =
                    (0..tokens as u32).rev().filter(|i| (i * 7 + 1) % step == 0 || *i == 0).collect();
                let pick = |x: &[f32]| -> Vec<f32> {
                    places.iter().flat_map(|i| x[*i as usize * 128..][..128].to_vec()).collect()
                };
                let some = pick(&q);
                let found = on_every_level_and_thread_count(some.len(), |level, out| {
                    let q = rows(&some, places.len());
                    attend_some(precision, level, shape, &places, q, rows(&k, tokens), rows(&v, tokens), out);
                });
                assert!(found == pick(&all), "{tokens} tokens, {windows:?}, {} queries", places.len());
            }
        }
    }
}

#[test]
fn logits_whose_rounding_is_more_than_one_give_equal_bits_and_means_of_values() {
    // A query's reference is a rounded product: past 2²⁴ the remainder of the largest logit may be any number of either
    // sign.
    let (queries, keys) = (37, 250);
    for size in [1e4, 1e6, 1e8, 1e11, 1e15] {
        let scaled = |n: usize, seed| noise(n * 64, seed).iter().map(|x| x * size).collect::<Vec<_>>();
        let (q, k, v) = (scaled(queries, 1), scaled(keys, 2), noise(keys * 64, 3));
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let out = on_every_level_and_thread_count(queries * 64, |level, out| {
                let rows = |x, n| Rows::new(x, n, 64, 0);
                attend_as(precision, level, full(1), rows(&q, queries), rows(&k, keys), rows(&v, keys), out);
            });
            let most = v.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
            assert!(out.iter().all(|x| x.abs() <= 1.01 * most), "{precision:?}, {size:e}: no mean of the values");
        }
    }
}

#[test]
fn every_level_gives_the_bits_of_the_defined_order() {
    let runs = |length, roll| Windows::Runs { length, roll };
    for (tokens, heads, width, windows) in [
        (1, 1, 16, Windows::Full),
        (50, 2, 80, Windows::Full),
        (401, 1, 48, Windows::Full),
        (131, 2, 64, runs(24, 12)),
        (401, 1, 16, runs(200, 7)),
    ] {
        let d = heads * width;
        // Magnitudes from those that are flushed to those whose logits leave one key.
        for size in [1.0, 1e-17, 30.0, 1e12] {
            let scaled = |seed| noise(tokens * d, seed).iter().map(|x| x * size).collect::<Vec<_>>();
            let (mut q, mut k, v) = (scaled(1), scaled(2), noise(tokens * d, 3));
            (q[0], k[tokens / 2 * d]) = (f32::NAN, 2e30);
            let keys = |i: usize| match windows {
                Windows::Full => (0..tokens).collect::<Vec<_>>(),
                Windows::Runs { length, roll } => {
                    let first = (i + roll) % tokens / length * length;
                    (first..tokens.min(first + length)).map(|j| (j + tokens - roll) % tokens).collect()
                }
            };
            for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
                let out = on_every_level_and_thread_count(tokens * d, |level, out| {
                    let rows = |x| Rows::new(x, tokens, d, 0);
                    attend_as(precision, level, Shape { heads, width, windows }, rows(&q), rows(&k), rows(&v), out);
                });
                let expected = reference::attend_in_order(precision, &q, &k, &v, heads, width, keys);
                assert!(bits(&out) == bits(&expected), "{precision:?}, {tokens} tokens of {heads}x{width}, {size:e}");
            }
        }
    }
}
