//! Opacities lowered by as much as the low-pass widens footprints.

use super::*;

fn request(width: usize, height: usize) -> Request {
    Request { antialias: true, ..everything(width, height) }
}

#[test]
fn scenes_agree_with_the_plain_version() {
    for projection in projections(64, 48) {
        for rotated in [false, true] {
            assert_agrees(&ordinary(700, rotated, 65), &projection, &request(64, 48), 1e-5, 1e-4);
        }
        for seed in 0..20 {
            assert_agrees(&extreme(60, seed), &projection, &request(64, 48), 5e-4, 5e-3);
        }
    }
}

#[test]
fn every_level_and_thread_count_gives_the_same_bits() {
    let (width, height) = (131, 77);
    for projection in projections(width, height) {
        for scene in [ordinary(5000, false, 3), ordinary(5000, true, 4), extreme(900, 5)] {
            let draw = |level| render(level, &scene.gaussians(), &projection, &request(width, height));
            let expected = bits(&draw(Level::scalar()));
            for level in Level::available() {
                for threads in [1, 3] {
                    let found = pool(threads).install(|| draw(level));
                    assert!(bits(&found) == expected, "{} with {threads} threads differs", level.name());
                }
            }
        }
    }
}

/// α of one upright Gaussian of this size in pixels, summed over an image, by a separable or a general footprint.
fn covered(size: [f32; 2], opacity: f32, turned: bool, antialias: bool) -> f32 {
    let mut scene = OwnedGaussians { rotation: turned.then(Vec::new), ..OwnedGaussians::default() };
    // 90° about z, with the sides exchanged.
    let h = std::f32::consts::FRAC_1_SQRT_2;
    let [wide, high] = if turned { [size[1], size[0]] } else { size };
    scene.push([0.011, -0.007, 1.0], [wide / 32.0, high / 32.0, 0.01], [h, 0.0, 0.0, h], opacity, [1.0; 3]);
    let projection = Projection::Orthographic { focal: [32.0; 2] };
    let image = render(Level::detect(), &scene.gaussians(), &projection, &Request { antialias, ..everything(64, 64) });
    image.alpha.expect("a plane that was asked for").iter().sum()
}

#[test]
fn what_is_smaller_than_a_pixel_covers_as_much_as_it_is_large() {
    for turned in [false, true] {
        for (size, opacity) in [([0.25, 0.25], 0.9), ([0.1, 2.0], 0.8), ([0.4, 0.3], 0.5)] {
            let area = std::f32::consts::TAU * size[0] * size[1] * opacity;
            let found = covered(size, opacity, turned, true);
            // Without its rim, where α is under 1/255.
            assert!((0.85..1.0).contains(&(found / area)), "{size:?}: {found} of {area}");
            let larger = covered(size, opacity, turned, false);
            assert!(larger > 1.5 * area, "{size:?}: {larger} of {area}");
        }
        // Much larger Gaussians do not change.
        let (with, without) = (covered([6.0, 5.0], 0.7, turned, true), covered([6.0, 5.0], 0.7, turned, false));
        assert!(with < without && with > 0.98 * without, "{with} {without}");
    }
}

#[test]
fn a_flat_gaussian_seen_from_its_side_is_not_drawn() {
    for turned in [false, true] {
        assert_eq!(covered([0.0, 3.0], 1.0, turned, true), 0.0);
        assert!(covered([0.0, 3.0], 1.0, turned, false) > 1.0);
    }
}

#[test]
fn a_renderer_draws_anew_when_it_changes() {
    let scene = ordinary(500, true, 12);
    let projection = projections(80, 60)[1];
    let mut rasteriser = Rasteriser::new(Level::detect());
    let plain = bits(rasteriser.render(&scene.gaussians(), &projection, &everything(80, 60)));
    let lowered = bits(rasteriser.render(&scene.gaussians(), &projection, &request(80, 60)));
    assert!(plain != lowered);
    assert!(lowered == bits(&render(Level::scalar(), &scene.gaussians(), &projection, &request(80, 60))));
}
