//! Equality over levels and threads; agreement with the plain version; redrawing.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use super::*;

mod antialias;
mod bounded;
mod defocus;
mod edges;
mod falloff;
mod linear;
mod lists;
mod sphere;

/// A generator of test values; the quality of its bits does not matter.
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1_u64 << 24) as f32
    }
    pub(super) fn range(&mut self, from: f32, to: f32) -> f32 {
        from + (to - from) * self.unit()
    }
    fn pick<T: Copy, const N: usize>(&mut self, from: [T; N]) -> T {
        from[((self.unit() * N as f32) as usize).min(N - 1)]
    }
    fn quaternion(&mut self) -> [f32; 4] {
        let q: [f32; 4] = std::array::from_fn(|_| self.range(-1.0, 1.0));
        let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
        q.map(|v| v / norm)
    }
}

fn ordinary(count: usize, rotated: bool, seed: u64) -> OwnedGaussians {
    let mut random = Random(seed);
    let mut scene = OwnedGaussians { rotation: rotated.then(Vec::new), ..OwnedGaussians::default() };
    for _ in 0..count {
        let mean = [random.range(-1.1, 1.1), random.range(-1.1, 1.1), random.range(0.3, 4.0)];
        let scale = std::array::from_fn(|_| (random.range(-6.0, -2.0)).exp());
        let turn = random.quaternion();
        let opacity = random.range(0.0, 1.0);
        scene.push(mean, scale, turn, opacity, std::array::from_fn(|_| random.unit()));
    }
    scene
}

/// Extremes: needles, specks, walls, ties in depth, thresholds, tile corners, bad numbers.
fn extreme(count: usize, seed: u64) -> OwnedGaussians {
    let mut random = Random(seed);
    let mut scene = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
    let least = ALPHA_MIN;
    let under = f32::from_bits(least.to_bits() - 1);
    for _ in 0..count {
        let (anywhere, far, near, any, turned) = (
            random.range(-1.0, 1.0),
            random.range(-40.0, 40.0),
            random.range(0.1, 3.0),
            random.unit(),
            random.quaternion(),
        );
        let corner = (random.range(0.0, 6.0) as i32 * 8) as f32 / 32.0 - 0.75 + 1.0 / 64.0;
        let x = random.pick([0.0, corner, anywhere, far, 1e30, -1e38, 1e-42]);
        // Far out along both axes the plain version's own rounding decides.
        let y = random.pick([0.0, corner, anywhere, -0.7 * anywhere, if x.abs() < 1e20 { 3e5 } else { 0.5 }]);
        let z = random.pick([2.5, 2.5, 2.5, near, 1e-30, 1e-6, 2e-6, 0.0, -0.0, -1.0, 1e30, 1e-44]);
        let small = random.range(0.001, 0.1);
        let scale = random.pick([
            [small, small, small],
            [1000.0, 1e-3, 1e-3],
            [1.0, 1e-6, 1e-6],
            [1e-8; 3],
            [1e3; 3],
            [small, 1e-3, 0.2],
            [0.0; 3],
            [1e-42; 3],
            [-small, small, small],
        ]);
        let h = std::f32::consts::FRAC_1_SQRT_2;
        let eighth = [(0.5 + 0.5 * h).sqrt(), 0.0, 0.0, (0.5 - 0.5 * h).sqrt()];
        let turn = random.pick([turned, eighth, [1.0, 0.0, 0.0, 0.0], [0.0; 4], [1e-20; 4], [1e-42; 4]]);
        let opacity = random.pick([least, under, 1.0, 0.5, 0.0, -1.0, 0.99, 2.0, 1e-42, any]);
        let mut record =
            [x, y, z, scale[0], scale[1], scale[2], opacity, random.unit(), -random.unit(), 3.0 * random.unit()];
        if random.unit() < 0.1 {
            let at = (random.unit() * 10.0) as usize % 10;
            record[at] = random.pick([f32::NAN, f32::INFINITY, f32::NEG_INFINITY]);
        }
        let [x, y, z, sx, sy, sz, opacity, r, g, b] = record;
        scene.push([x, y, z], [sx, sy, sz], turn, opacity, [r, g, b]);
    }
    scene
}

fn everything(width: usize, height: usize) -> Request {
    Request { depth: true, alpha: true, statistics: true, ..Request::colour(width, height, [0.5, 0.25, 0.75]) }
}

fn projections(width: usize, height: usize) -> [Projection; 2] {
    let (w, h) = (width as f32, height as f32);
    [
        Projection::Orthographic { focal: [w / 2.0, h / 2.0] },
        Projection::Pinhole { focal: [w * 0.8, w * 0.75], centre: [w * 0.47, h * 0.52] },
    ]
}

/// All planes as bits.
fn bits(image: &Image) -> Vec<u32> {
    let floats = [Some(&image.rgb), image.depth.as_ref(), image.alpha.as_ref(), image.final_t.as_ref()];
    let mut all: Vec<u32> = floats.into_iter().flatten().flatten().map(|v| v.to_bits()).collect();
    all.extend(image.blended.iter().flatten());
    all
}

/// Compares an image with the plain version's. Pixels must be within `tolerance`, except where an alpha or a
/// transmittance is closer to its threshold than `doubt` (relative): these may have been decided differently.
fn assert_agrees(scene: &OwnedGaussians, projection: &Projection, request: &Request, tolerance: f64, doubt: f64) {
    let expected = reference::render(&scene.gaussians(), projection, request);
    let found = render(Level::detect(), &scene.gaussians(), projection, request);
    let pixels = request.width * request.height;
    assert_eq!(found.dropped, expected.dropped);
    let brightest = scene.rgb.iter().flatten().filter(|v| v.is_finite()).fold(1.0_f32, |a, v| a.max(v.abs()));
    for at in 0..pixels {
        let certain = expected.margin[at] > doubt;
        let close = |what: &str, found: f32, expected: f64, scale: f64| {
            let error = (f64::from(found) - expected).abs() / scale;
            let allowed = if certain { tolerance } else { 3.0 / 255.0 };
            assert!(error <= allowed, "{what} of pixel {at} is {found}, expected {expected}, relative {error:e}");
        };
        for channel in 0..3 {
            let value = found.rgb[channel * pixels + at];
            close("colour", value, expected.rgb[channel * pixels + at], f64::from(brightest));
        }
        close("alpha", found.alpha.as_ref().unwrap()[at], expected.alpha[at], 1.0);
        close("transmittance", found.final_t.as_ref().unwrap()[at], expected.final_t[at], 1.0);
        if certain {
            close("depth", found.depth.as_ref().unwrap()[at], expected.depth[at], expected.depth[at].abs().max(4.0));
            assert_eq!(found.blended.as_ref().unwrap()[at], expected.blended[at], "pixel {at}");
        }
    }
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

#[test]
fn ordinary_scenes_agree_with_the_plain_version() {
    for (width, height) in [(64, 48), (37, 51), (1, 1), (5, 130), (161, 3)] {
        for projection in projections(width, height) {
            for rotated in [false, true] {
                let scene = ordinary(700, rotated, 1 + width as u64);
                assert_agrees(&scene, &projection, &everything(width, height), 1e-5, 1e-4);
            }
        }
    }
}

#[test]
fn extreme_scenes_agree_with_the_plain_version() {
    for seed in 0..40 {
        for projection in projections(61, 47) {
            assert_agrees(&extreme(60, seed), &projection, &everything(61, 47), 5e-4, 5e-3);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, rng_seed: RngSeed::Fixed(5), ..ProptestConfig::default() })]

    #[test]
    fn any_scene_agrees_with_the_plain_version(
        seed: u64, count in 0_usize..300, width in 1_usize..90, height in 1_usize..70, rotated: bool, wild: bool,
    ) {
        let scene = if wild { extreme(count, seed) } else { ordinary(count, rotated, seed) };
        let (tolerance, doubt) = if wild { (5e-4, 5e-3) } else { (1e-5, 1e-4) };
        for projection in projections(width, height) {
            assert_agrees(&scene, &projection, &everything(width, height), tolerance, doubt);
        }
    }

    #[test]
    fn any_redraw_has_the_bits_of_a_fresh_image(
        seed: u64, count in 1_usize..400, width in 1_usize..150, height in 1_usize..120, rotated: bool, moved in 0.0_f32..0.3,
    ) {
        let mut scene = ordinary(count, rotated, seed);
        let mut random = Random(seed ^ 0x5eed);
        for projection in projections(width, height) {
            let mut rasteriser = Rasteriser::new(Level::detect());
            for _ in 0..3 {
                let request = everything(width, height);
                let redrawn = bits(rasteriser.render(&scene.gaussians(), &projection, &request));
                prop_assert_eq!(redrawn, bits(&render(Level::scalar(), &scene.gaussians(), &projection, &request)));
                for i in 0..count {
                    if random.unit() < moved {
                        scene.mean[i][0] += random.range(-0.1, 0.1);
                        scene.opacity[i] = random.pick([0.0, 0.5, f32::NAN, 1.0]);
                    }
                }
            }
        }
    }
}

#[test]
fn every_level_and_thread_count_gives_the_same_bits() {
    for (width, height) in [(131, 77), (33, 65)] {
        for projection in projections(width, height) {
            for scene in [ordinary(5000, false, 3), ordinary(5000, true, 4), extreme(900, 5)] {
                let request = everything(width, height);
                let expected = bits(&render(Level::scalar(), &scene.gaussians(), &projection, &request));
                for level in crate::testing::levels() {
                    for threads in [1, 2, 3, 8] {
                        let draw = || render(level, &scene.gaussians(), &projection, &request);
                        let found = pool(threads).install(draw);
                        assert!(bits(&found) == expected, "{} with {threads} threads differs", level.name());
                    }
                }
            }
        }
    }
}

#[test]
fn planes_nobody_asked_for_are_absent_and_change_nothing() {
    let scene = ordinary(2000, false, 9);
    let projection = projections(100, 60)[0];
    let full = render(Level::detect(), &scene.gaussians(), &projection, &everything(100, 60));
    let request = Request::colour(100, 60, [0.5, 0.25, 0.75]);
    let colour = render(Level::detect(), &scene.gaussians(), &projection, &request);
    assert_eq!(colour.rgb, full.rgb);
    assert!(colour.depth.is_none() && colour.alpha.is_none() && colour.final_t.is_none() && colour.blended.is_none());
}

#[test]
fn equal_depths_are_drawn_in_index_order() {
    let mut scene = OwnedGaussians::default();
    for i in 0..300 {
        scene.push([0.0, 0.0, 1.0], [50.0; 3], [1.0, 0.0, 0.0, 0.0], 0.9, if i == 0 { [1.0; 3] } else { [0.0; 3] });
    }
    let image = render(Level::detect(), &scene.gaussians(), &projections(8, 8)[0], &Request::colour(8, 8, [0.0; 3]));
    assert!(image.rgb.iter().all(|&v| v > 0.3), "{:?}", image.rgb);
}

#[test]
fn an_opacity_of_one_255th_is_drawn_at_its_centre_and_one_ulp_less_is_not() {
    let draw = |opacity: f32| {
        let mut scene = OwnedGaussians::default();
        scene.push([1.0 / 8.0, 1.0 / 8.0, 1.0], [0.1; 3], [1.0, 0.0, 0.0, 0.0], opacity, [1.0; 3]);
        render(Level::detect(), &scene.gaussians(), &projections(8, 8)[0], &everything(8, 8)).blended.unwrap()
    };
    let at = 4 * 8 + 4;
    assert_eq!(draw(ALPHA_MIN)[at], 1);
    assert_eq!(draw(ALPHA_MIN).iter().sum::<u32>(), 1);
    assert_eq!(draw(f32::from_bits(ALPHA_MIN.to_bits() - 1)).iter().sum::<u32>(), 0);
}

#[test]
fn only_tiles_touched_by_changed_splats_are_drawn_again() {
    let mut scene = ordinary(3000, false, 11);
    let projection = projections(256, 256)[0];
    let request = everything(256, 256);
    let mut rasteriser = Rasteriser::new(Level::detect());
    rasteriser.render(&scene.gaussians(), &projection, &request);
    assert_eq!(rasteriser.work().tiles_drawn, rasteriser.work().tiles);
    rasteriser.render(&scene.gaussians(), &projection, &request);
    assert_eq!((rasteriser.work().tiles_drawn, rasteriser.work().changed), (0, 0));
    let still =
        (0..scene.mean.len()).find(|&i| scene.opacity[i] > 0.5 && scene.scale[i][0].max(scene.scale[i][1]) < 0.02);
    scene.mean[still.unwrap()] = [0.1, 0.1, 1.0];
    let redrawn = bits(rasteriser.render(&scene.gaussians(), &projection, &request));
    let work = rasteriser.work();
    assert!(work.changed == 1 && work.tiles_drawn > 0 && work.tiles_drawn < work.tiles / 2, "{work:?}");
    assert_eq!(redrawn, bits(&render(Level::detect(), &scene.gaussians(), &projection, &request)));
}

#[test]
fn empty_scenes_and_empty_images_are_drawn() {
    let projection = projections(9, 5)[0];
    let image = render(Level::detect(), &Gaussians::default(), &projection, &everything(9, 5));
    assert!(image.rgb[..45].iter().all(|&v| v == 0.5) && image.final_t.unwrap().iter().all(|&t| t == 1.0));
    let scene = ordinary(10, false, 1);
    for (width, height) in [(0, 0), (0, 7), (7, 0)] {
        let image = render(Level::detect(), &scene.gaussians(), &projection, &everything(width, height));
        assert!(image.rgb.is_empty());
    }
    let request = Request { background: [f32::NAN, f32::INFINITY, 0.5], ..everything(2, 1) };
    let image = render(Level::detect(), &Gaussians::default(), &projection, &request);
    assert_eq!(image.rgb, [0.0, 0.0, 0.0, 0.0, 0.5, 0.5]);
}
