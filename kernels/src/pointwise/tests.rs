use super::{Layer, TOKENS, load, reference, store};
use crate::Level;
use crate::gemm::{Activation, Epilogue, Weights, linear};
use crate::testing::{bits, noise, on_every_level_and_thread_count};

/// `layer` on rows of tokens, block by block.
fn on_rows(level: Level, layer: &Layer, x: &[f32], out: &mut [f32]) {
    let (n, k) = (layer.n(), layer.k());
    let (mut from, mut to) = (vec![f32::NAN; k * TOKENS], vec![f32::NAN; n * TOKENS]);
    for (i, out) in out.chunks_mut(n * TOKENS).enumerate() {
        let count = out.len() / n;
        load(&x[i * TOKENS * k..][..count * k], k, &mut from);
        layer.apply(level, &from, &mut to);
        store(&to, n, out);
    }
}

#[test]
fn every_level_gives_the_bits_of_the_reference_and_of_gemm() {
    for (m, n, k) in
        [(1, 1, 1), (48, 8, 4), (49, 64, 64), (7, 5, 131), (100, 12, 256), (50, 17, 257), (3, 9, 700), (4, 3, 0)]
    {
        let (x, w, bias) = (noise(m * k, 1), noise(n * k, 2), noise(n, 3));
        for (activation, epilogue) in [
            (Activation::Identity, Epilogue::new().bias(&bias)),
            (Activation::Silu, Epilogue::new().bias(&bias).silu()),
            (Activation::Gelu, Epilogue::new().bias(&bias).gelu()),
        ] {
            let layer = Layer::pack(&w, Some(&bias), activation, n, k);
            let out = on_every_level_and_thread_count(m * n, |level, out| on_rows(level, &layer, &x, out));
            let expected = reference::layer(&x, &w, &bias, activation, m, k);
            assert!(bits(&out) == bits(&expected), "{m}x{n}x{k}, {activation:?}");
            let mut product = vec![0.0; m * n];
            linear(Level::detect(), &x, m, &Weights::pack(Level::detect(), &w, n, k), &epilogue, &mut product);
            assert!(bits(&out) == bits(&product), "{m}x{n}x{k}, {activation:?}: gemm differs");
        }
    }
}

#[test]
fn an_absent_bias_changes_no_bit() {
    // A negative product that underflows is −0; adding +0 would change its sign.
    let layer = Layer::pack(&[1e-30; 9], None, Activation::Identity, 9, 1);
    for level in crate::testing::levels() {
        let mut out = vec![1.0; 9 * TOKENS];
        layer.apply(level, &[-1e-30; TOKENS], &mut out);
        assert!(out.iter().all(|y| y.to_bits() == (-0.0_f32).to_bits()), "{level}: {}", out[0]);
    }
}

#[test]
fn a_bad_value_spoils_its_own_token_only() {
    let (k, n) = (20, 9);
    let (clean, w, bias) = (noise(k * TOKENS, 5), noise(n * k, 6), noise(n, 7));
    let layer = Layer::pack(&w, Some(&bias), Activation::Silu, n, k);
    let mut x = clean.clone();
    (x[3 * TOKENS + 7], x[11 * TOKENS + 40]) = (f32::NAN, f32::INFINITY);
    for level in crate::testing::levels() {
        let (mut out, mut expected) = (vec![0.0; n * TOKENS], vec![0.0; n * TOKENS]);
        layer.apply(level, &x, &mut out);
        layer.apply(level, &clean, &mut expected);
        for (i, (out, expected)) in out.iter().zip(&expected).enumerate() {
            match i % TOKENS {
                7 => assert!(out.is_nan()),
                40 => assert!(!(out.is_finite() && *out == *expected)),
                _ => assert_eq!(out, expected),
            }
        }
    }
}

#[test]
fn rows_come_back_from_lanes() {
    for (count, k) in [(0, 3), (1, 1), (47, 5), (48, 66), (48, 0)] {
        let rows = noise(count * k, 4);
        let mut block = vec![f32::NAN; k * TOKENS];
        load(&rows, k, &mut block);
        for channel in 0..k {
            assert!(block[channel * TOKENS + count..][..TOKENS - count].iter().all(|x| *x == 0.0));
        }
        let mut back = vec![0.0; count * k];
        store(&block, k, &mut back);
        assert_eq!(back, rows);
    }
}

#[test]
#[should_panic(expected = "expected k·48")]
fn an_input_of_another_size_is_refused() {
    Layer::pack(&[0.0; 6], None, Activation::Identity, 2, 3).apply(Level::detect(), &[0.0; 48], &mut [0.0; 96]);
}
