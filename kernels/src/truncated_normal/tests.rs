//! Against the exact distribution, the published formula, and at the extremes.

use super::reference::{distribution, published};
use super::*;

const MEANS: [f64; 6] = [-0.999, -0.7, 0.0, 0.001, 0.5, 0.999];
const LOG_SCALES: [f64; 14] = [-20.0, -12.0, -5.5, -4.9, -3.0, -1.0, 0.0, 1.0, 3.0, 6.6, 6.8, 20.0, 40.0, 60.0];

/// Largest distance of the empirical distribution of `values` from the exact one, times √n.
fn kolmogorov_smirnov(values: &mut [f64], mean: f64, log_scale: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let n = values.len() as f64;
    let distance = values.iter().enumerate().fold(0.0_f64, |d, (i, &x)| {
        let f = distribution(mean, log_scale, x);
        d.max((f - i as f64 / n).abs()).max(((i + 1) as f64 / n - f).abs())
    });
    distance * n.sqrt()
}

#[test]
fn draws_follow_the_exact_distribution_at_the_extremes() {
    let stream = Stream { seed: 11, frame: 5 };
    for (i, mean) in MEANS.into_iter().enumerate() {
        for (j, log_scale) in LOG_SCALES.into_iter().enumerate() {
            let first = ((i * 100 + j) as u64) << 32;
            let mut values: Vec<f64> = (0..5_000)
                .map(|k| quantile(mean, log_scale, f64::from(stream.uniform(first + k)) + 2.0_f64.powi(-25)))
                .collect();
            assert!(values.iter().all(|x| x.abs() <= f64::from(BOUND)));
            // Exceeded by chance once in 14,000.
            let distance = kolmogorov_smirnov(&mut values, mean, log_scale);
            assert!(distance < 2.2, "mean {mean}, log scale {log_scale}: {distance}");
        }
    }
}

#[test]
fn the_quantile_inverts_the_distribution_and_grows() {
    for mean in MEANS {
        for log_scale in LOG_SCALES {
            let mut last = -f64::from(BOUND);
            for i in 0..=400 {
                let u = f64::from(i) / 400.0;
                let x = quantile(mean, log_scale, u);
                assert!(x >= last - 1e-15, "{mean} {log_scale} {u}: {x} after {last}");
                last = x;
                // The spacing of binary64 around the mean limits the round trip where σ is tiny.
                let tolerance = 1e-12 + 2e-16 / double::exp(log_scale);
                let back = distribution(mean, log_scale, x);
                assert!((back - u).abs() <= tolerance, "{mean} {log_scale} {u}: {x} has mass {back}");
            }
            assert_eq!(last, quantile(mean, log_scale, 1.0));
        }
    }
}

#[test]
fn wide_normals_are_uniform_and_narrow_ones_are_their_mean() {
    let bound = f64::from(BOUND);
    for i in 0..=10 {
        let u = f64::from(i) / 10.0;
        for log_scale in [40.0, 60.0, 500.0, 800.0, f64::INFINITY] {
            let x = quantile(0.5, log_scale, u);
            assert!((x - bound * (2.0 * u - 1.0)).abs() < 1e-14, "{log_scale} {u}: {x}");
        }
        for log_scale in [-800.0, f64::NEG_INFINITY] {
            assert_eq!(quantile(0.5, log_scale, u), 0.5);
        }
    }
    assert_eq!(quantile(7.0, -800.0, 0.5), bound);
    for nan in [(f64::NAN, 0.0, 0.5), (0.0, f64::NAN, 0.5), (0.0, 0.0, f64::NAN)] {
        assert!(quantile(nan.0, nan.1, nan.2).is_nan());
    }
}

#[test]
fn samples_agree_with_the_published_formula_where_it_is_accurate() {
    let stream = Stream { seed: 1, frame: 0 };
    for i in 0..30_000_u64 {
        let [mean, log_scale, u] = [0, 1, 2].map(|k| stream.uniform(3 * i + k));
        let (mean, log_scale) = ((2.0 * mean - 1.0) * BOUND, 11.0 * log_scale - 6.0);
        let (ours, theirs) = (sample_one(mean, log_scale, u), published(mean, log_scale, u));
        // Rounding of Φ by 2⁻²⁵ moves the value by that over the density.
        let limit = 2e-6 + 4e-7 * log_scale.exp().max(1.0) + if (0.02..0.98).contains(&u) { 0.0 } else { 3e-5 };
        assert!((ours - theirs).abs() < limit, "{mean} {log_scale} {u}: {ours} and {theirs}");
    }
}

#[test]
fn the_published_choices_are_kept() {
    for u in [0.0, 0.3, 0.999_999] {
        // s ≤ −5: the mean, moved into the bounds.
        assert_eq!(sample_one(0.25, -5.0, u), 0.25);
        assert_eq!(sample_one(1.5, -20.0, u), BOUND);
        assert_eq!(sample_one(-0.999, -20.0, u), -BOUND);
        // Δ ≤ ε: the lower bound.
        assert_eq!(sample_one(0.25, 6.8, u), -BOUND);
        assert_eq!(sample_one(0.25, 60.0, u), -BOUND);
        assert_eq!(sample_one(0.25, f32::INFINITY, u), -BOUND);
        assert_ne!(sample_one(0.25, 6.6, u), -BOUND);
    }
    // u outside [ε, 1−ε] returns the value at the nearer end.
    assert_eq!(sample_one(0.1, 0.5, 0.0), sample_one(0.1, 0.5, EPSILON));
    assert_eq!(sample_one(0.1, 0.5, 0.999_999_9), sample_one(0.1, 0.5, BOUND));
}

#[test]
fn samples_stay_inside_the_bounds_for_every_parameter() {
    let numbers = [
        0.0,
        -0.0,
        1e-45,
        -1e-38,
        0.5,
        -0.999,
        0.999,
        1.0,
        -1.0,
        4.9,
        -4.999_999,
        6.6,
        6.685,
        60.0,
        -20.0,
        88.0,
        700.0,
        1e30,
        -1e30,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
    ];
    for mean in numbers {
        for log_scale in numbers {
            for u in [0.0, 1e-8, 0.001, 0.5, 0.999, 0.999_999_94, 1.0] {
                let x = sample_one(mean, log_scale, u);
                assert!(x.abs() <= BOUND, "{mean} {log_scale} {u}: {x}");
            }
        }
        for (mean, log_scale, u) in [(f32::NAN, mean, 0.5), (mean, f32::NAN, 0.5), (mean, mean, f32::NAN)] {
            assert!(sample_one(mean, log_scale, u).is_nan());
        }
    }
}

#[test]
fn draws_depend_on_their_coordinates_alone() {
    let n = 9_001;
    let stream = Stream { seed: 9, frame: 2 };
    let means: Vec<f32> = (0..n).map(|i| (i as f32 / n as f32) * 1.9 - 0.95).collect();
    let scales: Vec<f32> = (0..n).map(|i| (i % 17) as f32 - 9.0).collect();
    let mut uniform = vec![0.0; n];
    stream.fill_uniform(0, &mut uniform);
    let mut expected = vec![0.0; n];
    sample(&means, &scales, &uniform, &mut expected);
    for threads in [1, 2, 3, 8] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let mut out = vec![0.0; n];
        pool.install(|| draw(stream, &means, &scales, &mut out));
        assert_eq!(out, expected);
    }
}

#[test]
fn means_have_the_same_bits_on_every_level_and_stay_inside() {
    let x: Vec<f32> = (0..20_003).map(|i| (i as f32 - 10_000.0) * 1.7e-3).chain([1e30, f32::NEG_INFINITY]).collect();
    let mut expected = vec![0.0; x.len()];
    mean(Level::scalar(), &x, &mut expected);
    for level in crate::testing::levels() {
        for threads in [1, 2, 3, 8] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let mut out = vec![0.0; x.len()];
            pool.install(|| mean(level, &x, &mut out));
            assert!(out.iter().zip(&expected).all(|(a, b)| a.to_bits() == b.to_bits()), "{level}, {threads} threads");
        }
    }
    assert!(expected.iter().all(|m| m.abs() <= BOUND));
    assert_eq!(expected[x.len() - 1], -BOUND);
}
