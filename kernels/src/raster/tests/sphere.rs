//! Equirectangular images.

use super::*;

const AROUND: Projection = Projection::Equirectangular;

/// Gaussians all around the eye: on the poles, on the seam, at the eye, behind it and around it.
fn around(count: usize, seed: u64) -> OwnedGaussians {
    let mut random = Random(seed);
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    for i in 0..count {
        let near = |random: &mut Random| random.range(-0.01, 0.01);
        let any = std::array::from_fn(|_| random.range(-3.0, 3.0));
        let mean = match i % 8 {
            0 => [near(&mut random), random.pick([-2.0, 2.0]), near(&mut random)],
            1 => [0.0, random.pick([-1.0, 3.0]), 0.0],
            2 => [near(&mut random), near(&mut random), -2.0],
            3 => [near(&mut random); 3],
            4 => [0.0, random.range(-0.5, 0.5), -1.0],
            _ => any,
        };
        let scale = std::array::from_fn(|_| random.range(-5.0, -0.5).exp());
        scene.push(mean, scale, random.quaternion(), random.range(0.1, 1.0), std::array::from_fn(|_| random.unit()));
    }
    scene
}

#[test]
fn scenes_agree_with_the_plain_version() {
    for (width, height) in [(96, 48), (37, 51), (1, 1), (130, 5), (70, 36)] {
        for seed in 0..3 {
            for antialias in [false, true] {
                let request = Request { antialias, ..everything(width, height) };
                assert_agrees(&around(150, seed), &AROUND, &request, 1e-3, 2e-2);
            }
            assert_agrees(&ordinary(300, true, seed), &AROUND, &everything(width, height), 1e-3, 2e-2);
        }
    }
    for seed in 0..20 {
        assert_agrees(&extreme(60, seed), &AROUND, &everything(96, 48), 5e-3, 5e-2);
    }
}

#[test]
fn every_level_and_thread_count_gives_the_same_bits() {
    for (width, height) in [(132, 66), (131, 77)] {
        for scene in [around(1200, 3), ordinary(1000, false, 4), extreme(600, 5)] {
            let draw = |level| render(level, &scene.gaussians(), &AROUND, &everything(width, height));
            let expected = bits(&draw(Level::scalar()));
            for level in crate::testing::levels() {
                for threads in [1, 2, 3, 8] {
                    let found = pool(threads).install(|| draw(level));
                    assert!(bits(&found) == expected, "{} with {threads} threads differs", level.name());
                }
            }
        }
    }
}

#[test]
fn a_redraw_has_the_bits_of_a_fresh_image() {
    let (mut scene, mut random) = (around(400, 9), Random(10));
    let mut rasteriser = Rasteriser::new(Level::detect());
    for _ in 0..4 {
        let redrawn = bits(rasteriser.render(&scene.gaussians(), &AROUND, &everything(300, 150)));
        assert!(redrawn == bits(&render(Level::scalar(), &scene.gaussians(), &AROUND, &everything(300, 150))));
        for i in (0..400).step_by(17) {
            scene.mean[i][0] += random.range(-0.2, 0.2);
        }
    }
}

/// α of one Gaussian in a direction, in squares of a pixel at the equator.
fn covered(longitude: f64, latitude: f64, size: [f32; 3]) -> f64 {
    let (width, height) = (512, 256);
    let level = latitude.cos();
    let mean = [level * longitude.sin(), latitude.sin(), level * longitude.cos()].map(|c| 2.0 * c as f32);
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    scene.push(mean, size, [1.0, 0.0, 0.0, 0.0], 0.9, [1.0; 3]);
    let image = render(Level::detect(), &scene.gaussians(), &AROUND, &everything(width, height));
    let alpha = image.alpha.expect("a plane that was asked for");
    let row = |v: usize| (std::f64::consts::PI * ((v as f64 + 0.5) / height as f64 - 0.5)).cos();
    alpha.iter().enumerate().map(|(at, alpha)| f64::from(*alpha) * row(at / width)).sum()
}

#[test]
fn a_ball_covers_as_much_of_the_sphere_wherever_it_lies() {
    use std::f64::consts::{FRAC_PI_2, PI};
    for size in [[0.1; 3], [0.4; 3]] {
        let expected = covered(0.0, 0.0, size);
        for longitude in [-PI, -3.1, -1.0, 0.5, 2.0, 3.139, PI] {
            for latitude in [-FRAC_PI_2, -1.55, -1.2, -0.4, 0.9, 1.5, 1.57, FRAC_PI_2] {
                let found = covered(longitude, latitude, size);
                assert!((found / expected - 1.0).abs() < 0.02, "{longitude} {latitude}: {found}, expected {expected}");
            }
        }
    }
}

#[test]
fn a_scene_turned_by_a_column_is_the_image_moved_by_one() {
    let (width, height) = (128, 64);
    let scene = around(300, 21);
    let mut turned = scene.clone();
    let (sin, cos) = (std::f64::consts::TAU * 40.0 / width as f64).sin_cos();
    for mean in &mut turned.mean {
        let [x, y, z] = mean.map(f64::from);
        *mean = [(cos * x + sin * z) as f32, y as f32, (cos * z - sin * x) as f32];
    }
    let (half_sin, half_cos) = (std::f64::consts::TAU * 20.0 / width as f64).sin_cos();
    for turn in turned.rotation.as_mut().expect("turned") {
        // About y, before its own.
        let [w, x, y, z] = turn.map(f64::from);
        let (c, s) = (half_cos, half_sin);
        *turn = [c * w - s * y, c * x + s * z, c * y + s * w, c * z - s * x].map(|q| q as f32);
    }
    let draw =
        |scene: &OwnedGaussians| render(Level::detect(), &scene.gaussians(), &AROUND, &everything(width, height)).rgb;
    let (still, moved) = (draw(&scene), draw(&turned));
    let mut apart = 0;
    for (at, value) in still.iter().enumerate() {
        let (line, column) = (at / width, at % width);
        let other = moved[line * width + (column + 40) % width];
        // Where an α is next to 1/255 the other decides differently.
        apart += usize::from((value - other).abs() > 1e-3);
        assert!((value - other).abs() < 0.02, "{value} {other} at {column} {line}");
    }
    assert!(apart * 100 < still.len(), "{apart} of {}", still.len());
}

#[test]
fn what_is_at_the_eye_is_not_drawn_and_what_is_behind_it_is() {
    let draw = |mean: [f32; 3]| {
        let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
        scene.push(mean, [0.1; 3], [1.0, 0.0, 0.0, 0.0], 0.9, [1.0; 3]);
        let image = render(Level::detect(), &scene.gaussians(), &AROUND, &everything(64, 32));
        assert!(image.rgb.iter().all(|c| c.is_finite()));
        let blended = image.blended.expect("asked for");
        let depth = image
            .depth
            .expect("asked for")
            .iter()
            .zip(image.alpha.expect("asked for"))
            .map(|(d, a)| d / a)
            .fold(0.0, f32::max);
        (blended, depth)
    };
    assert!(draw([0.0; 3]).0.iter().all(|n| *n == 0));
    assert!(draw([1e-7, 0.0, 0.0]).0.iter().all(|n| *n == 0));
    assert!(draw([3e38; 3]).0.iter().all(|n| *n == 0));
    let (behind, depth) = draw([0.0, 0.0, -2.0]);
    // On both sides of the seam, and nowhere else.
    assert!(behind[16 * 64] == 1 && behind[16 * 64 + 63] == 1 && behind[16 * 64 + 32] == 0);
    assert!((depth - 2.0).abs() < 1e-5, "{depth}");
    // Inside of it: half of the sphere.
    assert!(draw([0.0, 0.0, 0.01]).0.iter().filter(|n| **n > 0).count() > 900);
}
