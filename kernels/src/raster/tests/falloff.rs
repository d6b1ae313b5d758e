//! Footprints that fall to 0 at an edge.

use super::*;
use crate::raster::Falloff;

fn request(width: usize, height: usize, falloff: Falloff) -> Request {
    Request { falloff, ..everything(width, height) }
}

#[test]
fn scenes_agree_with_the_plain_version() {
    for &falloff in Falloff::ALL {
        for projection in projections(64, 48) {
            for rotated in [false, true] {
                assert_agrees(&ordinary(700, rotated, 66), &projection, &request(64, 48, falloff), 1e-5, 1e-4);
            }
            for seed in 0..20 {
                assert_agrees(&extreme(60, seed), &projection, &request(64, 48, falloff), 5e-4, 5e-3);
            }
        }
    }
}

#[test]
fn every_level_and_thread_count_gives_the_same_bits() {
    let (width, height) = (131, 77);
    for falloff in [Falloff::SplatTransform, Falloff::PlayCanvas] {
        for projection in projections(width, height) {
            for scene in [ordinary(3000, false, 3), ordinary(3000, true, 4), extreme(900, 5)] {
                let draw = |level| render(level, &scene.gaussians(), &projection, &request(width, height, falloff));
                let expected = bits(&draw(Level::scalar()));
                for level in crate::testing::levels() {
                    for threads in [1, 3] {
                        let found = pool(threads).install(|| draw(level));
                        assert!(bits(&found) == expected, "{} with {threads} threads differs", level.name());
                    }
                }
            }
        }
    }
}

/// α of one round Gaussian, by the distance from its centre in standard deviations of 20 px.
fn alpha_at(falloff: Falloff, turned: bool, opacity: f32) -> impl Fn(f64) -> f64 {
    let mut scene = OwnedGaussians { rotation: turned.then(Vec::new), ..OwnedGaussians::default() };
    let h = std::f32::consts::FRAC_1_SQRT_2;
    // A variance of 400 px² with the low-pass.
    scene.push([0.0, 0.0, 1.0], [399.7_f32.sqrt(); 3], [h, 0.0, 0.0, h], opacity, [1.0; 3]);
    let projection = Projection::Orthographic { focal: [1.0; 2] };
    let image = render(Level::detect(), &scene.gaussians(), &projection, &request(161, 1, falloff));
    let alpha = image.alpha.expect("a plane that was asked for");
    move |deviations| f64::from(alpha[80 + (20.0 * deviations) as usize])
}

#[test]
fn each_has_its_own_formula() {
    for turned in [false, true] {
        for &falloff in Falloff::ALL {
            let at = alpha_at(falloff, turned, 0.8);
            for deviations in [0.0, 0.5, 1.0, 2.0, 2.5, 2.8, 2.85, 2.95, 3.0, 3.2, 3.5] {
                let whole = f64::exp(-0.5 * deviations * deviations);
                let expected = 0.8
                    * match falloff {
                        Falloff::Gaussian => whole,
                        Falloff::SplatTransform => whole - f64::exp(-4.5),
                        Falloff::PlayCanvas => (whole - f64::exp(-4.0)) / (1.0 - f64::exp(-4.0)),
                    };
                let expected = if expected < 1.0 / 255.0 { 0.0 } else { expected };
                assert!((at(deviations) - expected).abs() < 2e-6, "{falloff:?} at {deviations}: {}", at(deviations));
            }
        }
    }
}

#[test]
fn what_is_faint_or_less_than_nothing_is_not_drawn() {
    for &falloff in Falloff::ALL {
        for opacity in [0.0, -1.0, -0.2, 1e-42, 0.0039, f32::MIN_POSITIVE] {
            assert_eq!(alpha_at(falloff, false, opacity)(0.0), 0.0, "{falloff:?} {opacity}");
            assert_eq!(alpha_at(falloff, true, opacity)(2.9), 0.0, "{falloff:?} {opacity}");
        }
        assert!(alpha_at(falloff, true, 0.004)(0.0) > 0.0, "{falloff:?}");
        assert!((alpha_at(falloff, true, 5.0)(0.0) - 0.99).abs() < 1e-6, "{falloff:?}");
    }
}
