use super::{layer_norm, reference, rms_norm};
use crate::testing::{bits, noise, on_every_level_and_thread_count};

#[test]
fn rms_norm_agrees_with_its_formula_and_itself_everywhere() {
    for (rows, d) in [(1, 1), (3, 5), (7, 16), (5, 33), (301, 67), (2, 768)] {
        for scale in [1.0, 1e-30, 1e-3, 1e8, 1e18, 2e38] {
            let x: Vec<f32> = noise(rows * d, 1).iter().map(|x| x * scale).collect();
            let w = noise(d, 2);
            let out = on_every_level_and_thread_count(rows * d, |level, out| rms_norm(level, &x, &w, 1e-5, out));
            for row in 0..rows {
                let expected = reference::rms_norm(&x[row * d..][..d], &w, 1e-5);
                for (i, expected) in expected.iter().enumerate() {
                    let error = (f64::from(out[row * d + i]) - expected).abs();
                    assert!(
                        error <= 4e-7 * expected.abs() + 1e-44,
                        "{rows}x{d} at {scale:e}: {error:e} of {expected:e}"
                    );
                }
            }
        }
    }
}

#[test]
fn layer_norm_agrees_with_its_formula_and_itself_everywhere() {
    for (rows, d) in [(1, 1), (3, 5), (7, 16), (5, 33), (301, 67), (2, 768)] {
        for (scale, shift) in [(1.0, 0.0), (1.0, 100.0), (1e-20, 0.0), (1e18, 0.0), (1e37, 1e38)] {
            let x: Vec<f32> = noise(rows * d, 3).iter().map(|x| x * scale + shift).collect();
            let (w, b) = (noise(d, 4), noise(d, 5));
            let out = on_every_level_and_thread_count(rows * d, |level, out| layer_norm(level, &x, &w, &b, 1e-6, out));
            for row in 0..rows {
                let expected = reference::layer_norm(&x[row * d..][..d], &w, &b, 1e-6);
                // Terms that cancel in the mean are lost in its rounding.
                let lost = 1e-7 * f64::from(1.0 + shift.abs() / scale.max(1e-3)) * 20.0;
                for (i, expected) in expected.iter().enumerate() {
                    let error = (f64::from(out[row * d + i]) - expected).abs();
                    assert!(error <= lost || d == 1, "{rows}x{d} at {scale:e}+{shift:e}: {error:e} of {expected:e}");
                }
            }
        }
    }
}

#[test]
fn a_bad_value_spoils_its_own_row_only() {
    let mut x = noise(3 * 20, 6);
    (x[20], x[45]) = (f32::NAN, f32::INFINITY);
    let w = noise(20, 7);
    let clean = noise(3 * 20, 6);
    for level in crate::testing::levels() {
        let (mut out, mut expected) = (vec![0.0; 60], vec![0.0; 60]);
        rms_norm(level, &x, &w, 1e-5, &mut out);
        rms_norm(level, &clean, &w, 1e-5, &mut expected);
        assert_eq!(out[..20], expected[..20]);
        assert!(out[20].is_nan() && out[45].is_nan());
    }
}

#[test]
fn every_level_gives_the_bits_of_the_defined_order() {
    for (rows, d) in [(1, 1), (3, 5), (7, 16), (5, 33), (301, 67), (2, 768)] {
        let (w, b) = (noise(d, 4), noise(d, 5));
        for (scale, shift) in [(1.0, 0.0), (1.0, 100.0), (1e-20, 0.0), (1e18, 0.0), (1e37, 1e38)] {
            let x: Vec<f32> = noise(rows * d, 3).iter().map(|x| x * scale + shift).collect();
            for b in [None, Some(&b[..])] {
                let out = on_every_level_and_thread_count(rows * d, |level, out| match b {
                    None => rms_norm(level, &x, &w, 1e-5, out),
                    Some(b) => layer_norm(level, &x, &w, b, 1e-5, out),
                });
                let expected = x.chunks(d).flat_map(|x| reference::norm_in_order(x, &w, b, 1e-5)).collect::<Vec<_>>();
                assert!(bits(&out) == bits(&expected), "{rows}x{d} at {scale:e}+{shift:e}, biases {}", b.is_some());
            }
        }
    }
}
