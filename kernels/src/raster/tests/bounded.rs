//! Footprints of Gaussians far outside the image.

use super::*;

fn request(width: usize, height: usize) -> Request {
    Request { bounded: true, ..everything(width, height) }
}

/// Gaussians all around the eye, many of them close to its plane.
fn around(count: usize, seed: u64) -> OwnedGaussians {
    let mut random = Random(seed);
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    for _ in 0..count {
        let mean = [random.range(-3.0, 3.0), random.range(-3.0, 3.0), random.range(-0.5, 1.0)];
        let scale = std::array::from_fn(|_| random.range(-4.0, -1.0).exp());
        scene.push(mean, scale, random.quaternion(), random.range(0.1, 1.0), std::array::from_fn(|_| random.unit()));
    }
    scene
}

#[test]
fn scenes_agree_with_the_plain_version_and_every_level_has_the_same_bits() {
    let (width, height) = (64, 48);
    let projection = projections(width, height)[1];
    for seed in 0..12 {
        for scene in [around(120, seed), extreme(60, seed), ordinary(300, true, seed)] {
            for antialias in [false, true] {
                let request = Request { antialias, ..request(width, height) };
                assert_agrees(&scene, &projection, &request, 5e-4, 5e-3);
                let expected = bits(&render(Level::scalar(), &scene.gaussians(), &projection, &request));
                for level in Level::available() {
                    assert!(bits(&render(level, &scene.gaussians(), &projection, &request)) == expected);
                }
            }
        }
    }
}

#[test]
fn what_is_close_and_far_beside_does_not_smear_over_the_image() {
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    scene.push([2.0, 0.0, 0.05], [0.05; 3], [1.0, 0.0, 0.0, 0.0], 0.9, [1.0; 3]);
    let projection = projections(64, 48)[1];
    let drawn = |request| render(Level::detect(), &scene.gaussians(), &projection, &request).blended;
    assert!(drawn(everything(64, 48)).expect("asked for").iter().any(|n| *n > 0));
    assert!(drawn(request(64, 48)).expect("asked for").iter().all(|n| *n == 0));
}

#[test]
fn nothing_in_the_image_or_near_it_changes() {
    let mut random = Random(5);
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    let (width, height) = (64, 48);
    let projection = projections(width, height)[1];
    let Projection::Pinhole { focal, centre } = projection else { panic!("a pinhole") };
    for _ in 0..500 {
        let z = random.range(0.5, 3.0);
        let pixel = [random.range(-9.0, 73.0), random.range(-7.0, 54.0)];
        let [x, y] = [0, 1].map(|i| (pixel[i] - centre[i]) / focal[i] * z);
        let scale = std::array::from_fn(|_| random.range(-5.0, -1.0).exp());
        scene.push([x, y, z], scale, random.quaternion(), random.unit(), std::array::from_fn(|_| random.unit()));
    }
    let draw = |request| bits(&render(Level::detect(), &scene.gaussians(), &projection, &request));
    assert!(draw(request(width, height)) == draw(everything(width, height)));
}
