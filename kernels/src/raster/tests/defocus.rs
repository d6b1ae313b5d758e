//! Lenses with a width.

use super::*;
use crate::raster::Defocus;

fn request(width: usize, height: usize, aperture: f32, focus: f32) -> Request {
    Request { defocus: Some(Defocus { aperture, focus }), ..everything(width, height) }
}

#[test]
fn scenes_agree_with_the_plain_version() {
    let projection = projections(64, 48)[1];
    for (aperture, focus) in [(0.3, 2.0), (0.02, 1.0), (1.0, f32::INFINITY), (1e-6, 3.0), (30.0, 1e-3)] {
        for antialias in [false, true] {
            let request = Request { antialias, ..request(64, 48, aperture, focus) };
            assert_agrees(&ordinary(500, true, 67), &projection, &request, 2e-5, 1e-3);
            for seed in 0..8 {
                assert_agrees(&extreme(60, seed), &projection, &request, 5e-4, 5e-3);
            }
        }
    }
}

#[test]
fn every_level_and_thread_count_gives_the_same_bits() {
    let (width, height) = (131, 77);
    let projection = projections(width, height)[1];
    for scene in [ordinary(2000, false, 3), ordinary(2000, true, 4), extreme(600, 5)] {
        let draw = |level| render(level, &scene.gaussians(), &projection, &request(width, height, 0.2, 2.0));
        let expected = bits(&draw(Level::scalar()));
        for level in crate::testing::levels() {
            for threads in [1, 2, 3, 8] {
                let found = pool(threads).install(|| draw(level));
                assert!(bits(&found) == expected, "{} with {threads} threads differs", level.name());
            }
        }
    }
}

/// α of one small Gaussian at this depth, summed over the image, and its largest.
fn covered(z: f32, aperture: f32, focus: f32) -> [f32; 2] {
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    scene.push([0.0, 0.0, z], [0.02 * z; 3], [1.0, 0.0, 0.0, 0.0], 0.9, [1.0; 3]);
    let projection = Projection::Pinhole { focal: [100.0; 2], centre: [127.5; 2] };
    let image = render(Level::detect(), &scene.gaussians(), &projection, &request(256, 256, aperture, focus));
    let alpha = image.alpha.expect("a plane that was asked for");
    [alpha.iter().sum(), alpha.iter().fold(0.0, |most, a| most.max(*a))]
}

#[test]
fn what_is_out_of_focus_is_wider_and_fainter_and_adds_up_to_the_same() {
    for z in [1.0, 2.0, 8.0] {
        let [sharp, peak] = covered(z, 0.0, 2.0);
        let [blurred, lower] = covered(z, 0.5, 2.0);
        if z == 2.0 {
            assert!((blurred / sharp - 1.0).abs() < 0.02 && (lower / peak - 1.0).abs() < 1e-5, "{blurred} of {sharp}");
        } else {
            assert!(lower < 0.3 * peak, "{lower} of {peak}");
            assert!((blurred / sharp - 1.0).abs() < 0.02, "{blurred} of {sharp} at {z}");
        }
    }
}

#[test]
fn a_blur_is_as_wide_as_the_disc_of_a_thin_lens() {
    // A point at depth 4, in focus 2: a disc with a radius of ½·0.4·100·(1/2 − 1/4) = 5 px, with a variance of 25/4
    // along an axis.
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    scene.push([0.0, 0.0, 4.0], [0.0; 3], [1.0, 0.0, 0.0, 0.0], 0.9, [1.0; 3]);
    let projection = Projection::Pinhole { focal: [100.0; 2], centre: [63.5; 2] };
    let image = render(Level::detect(), &scene.gaussians(), &projection, &request(128, 128, 0.4, 2.0));
    let alpha = image.alpha.expect("a plane that was asked for");
    let (mut sum, mut spread) = (0.0, 0.0);
    for (at, alpha) in alpha.iter().enumerate() {
        let x = (at % 128) as f64 - 63.5;
        sum += f64::from(*alpha);
        spread += f64::from(*alpha) * x * x;
    }
    assert!((spread / sum - (6.25 + 0.3)).abs() < 0.05, "{}", spread / sum);
}

#[test]
fn a_lens_without_width_or_focus_and_other_projections_change_no_bit() {
    let (width, height) = (64, 48);
    let scene = ordinary(500, true, 12);
    let [orthographic, pinhole] = projections(width, height);
    let draw = |projection, request: &Request| bits(&render(Level::detect(), &scene.gaussians(), projection, request));
    let sharp = draw(&pinhole, &everything(width, height));
    for (aperture, focus) in
        [(0.0, 2.0), (f32::NAN, 2.0), (0.1, f32::NAN), (-1.0, 2.0), (0.1, 0.0), (0.1, -1.0), (f32::INFINITY, 1.0)]
    {
        assert!(draw(&pinhole, &request(width, height, aperture, focus)) == sharp, "{aperture} {focus}");
    }
    assert!(draw(&pinhole, &request(width, height, 0.1, 2.0)) != sharp);
    assert!(draw(&orthographic, &request(width, height, 0.1, 2.0)) == draw(&orthographic, &everything(width, height)));
}
