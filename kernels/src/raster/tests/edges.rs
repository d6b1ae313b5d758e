//! Needles, images of one pixel, thresholds, records that are not numbers.

use super::*;

/// Needles of axis ratio 10⁶ at every angle, from shorter than a pixel to longer than the image.
fn needles(count: usize, seed: u64) -> OwnedGaussians {
    let mut random = Random(seed);
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    for i in 0..count {
        // Along an axis, at 45°, then anywhere.
        let angle = match i % 8 {
            0 => 0.0,
            1 => std::f32::consts::FRAC_PI_2,
            2 | 3 => std::f32::consts::FRAC_PI_4,
            _ => random.range(0.0, std::f32::consts::PI),
        };
        let turn = if i % 8 == 7 { random.quaternion() } else { [(angle / 2.0).cos(), 0.0, 0.0, (angle / 2.0).sin()] };
        let long = random.range(-5.0, 7.0).exp();
        let mean = [random.range(-1.5, 1.5), random.range(-1.5, 1.5), random.range(0.5, 3.0)];
        scene.push(mean, [long, long * 1e-6, long * 1e-6], turn, random.range(0.01, 1.0), [random.unit(), 0.5, 1.0]);
    }
    scene
}

#[test]
fn needles_agree_with_the_plain_version() {
    for seed in 0..6 {
        for (width, height) in [(61, 47), (130, 70)] {
            for projection in projections(width, height) {
                assert_agrees(&needles(64, seed), &projection, &everything(width, height), 5e-4, 5e-3);
            }
        }
    }
}

#[test]
fn images_one_pixel_wide_agree_with_the_plain_version() {
    for (width, height) in [(1, 1), (1, 2), (2, 1), (1, 64), (65, 1), (1, 129), (4, 1), (5, 4)] {
        for seed in 0..6 {
            for projection in projections(width, height) {
                let request = everything(width, height);
                assert_agrees(&extreme(80, 100 + seed), &projection, &request, 5e-4, 5e-3);
                assert_agrees(&needles(40, seed), &projection, &request, 5e-4, 5e-3);
                assert_agrees(&ordinary(300, seed % 2 == 0, seed), &projection, &request, 1e-5, 1e-4);
            }
        }
    }
}

#[test]
fn opacities_around_the_threshold_are_drawn_where_alpha_reaches_it() {
    // Centres on pixels, so that α there is the opacity itself.
    for ulps in -3_i32..=3 {
        let opacity = f32::from_bits(ALPHA_MIN.to_bits().wrapping_add_signed(ulps));
        let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
        let turn = [0.6_f32.cos(), 0.0, 0.0, 0.6_f32.sin()];
        scene.push([1.0 / 8.0, 1.0 / 8.0, 1.0], [0.1, 0.3, 0.2], turn, opacity, [1.0; 3]);
        for level in crate::testing::levels() {
            for projection in [
                Projection::Orthographic { focal: [4.0; 2] },
                Projection::Pinhole { focal: [4.0; 2], centre: [3.5; 2] },
            ] {
                let image = render(level, &scene.gaussians(), &projection, &everything(8, 8));
                let count = image.blended.unwrap()[4 * 8 + 4];
                assert_eq!(count, u32::from(ulps >= 0), "{ulps} ulp from 1/255 on {}", level.name());
            }
        }
    }
}

#[test]
fn a_record_with_a_field_that_is_not_finite_is_dropped_and_changes_nothing() {
    for rotated in [false, true] {
        let scene = ordinary(200, rotated, 21);
        for projection in projections(50, 40) {
            let request = everything(50, 40);
            let clean = render(Level::detect(), &scene.gaussians(), &projection, &request);
            for field in 0..if rotated { 14 } else { 10 } {
                for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                    let mut spoiled = scene.clone();
                    let mut record = [0.1, 0.2, 1.0, 0.3, 0.3, 0.3, 0.9, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
                    record[field] = bad;
                    let [x, y, z, sx, sy, sz, opacity, r, g, b, turn @ ..] = record;
                    spoiled.push([x, y, z], [sx, sy, sz], turn, opacity, [r, g, b]);
                    for level in crate::testing::levels() {
                        let image = render(level, &spoiled.gaussians(), &projection, &request);
                        assert_eq!(image.dropped, 1, "field {field}, {bad}");
                        assert!(bits(&image) == bits(&clean), "field {field}, {bad} reaches the image");
                    }
                }
            }
        }
    }
}
