//! Equality over levels and threads; agreement with the plain version; its finite differences.

use super::reference::{ReferenceScene, render};
use super::*;
use crate::level::Level;
use crate::raster::tests::Random;
use crate::raster::{Gaussians, OwnedGaussians};
use crate::testing::{bits, on_every_level_and_thread_count};

/// A scene, its camera, its colours, and a loss: the weighted sum of the pixels.
struct Case {
    gaussians: OwnedGaussians,
    view: WorldView,
    channels: usize,
    colours: Vec<f32>,
    background: Vec<f32>,
    of_image: Vec<f32>,
    of_alpha: Vec<f32>,
    of_depth: Vec<f32>,
}

impl Case {
    fn new(count: usize, [width, height]: [usize; 2], channels: usize, seed: u64) -> Self {
        let mut random = Random(seed);
        let mut gaussians = OwnedGaussians { rotation: Some(Vec::new()), ..OwnedGaussians::default() };
        for _ in 0..count {
            let mean = [random.range(-1.0, 1.0), random.range(-0.8, 0.8), random.range(-0.8, 1.2)];
            let scale = std::array::from_fn(|_| random.range(-4.0, -0.7).exp());
            let turn = std::array::from_fn(|_| random.range(-1.0, 1.0));
            gaussians.push(mean, scale, turn, random.range(0.05, 0.95), [0.0; 3]);
        }
        // Nearly a rotation, and two units behind.
        let mut matrix = [[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, -0.1], [0.0, 0.0, 1.0, 2.5]];
        for row in &mut matrix {
            for entry in row.iter_mut() {
                *entry += random.range(-0.1, 0.1);
            }
        }
        let focal = 0.8 * width as f32;
        let centre = [0.47 * width as f32, 0.52 * height as f32];
        let mut view = WorldView::pinhole(matrix, [focal, 1.1 * focal], centre, [width, height]);
        view.antialias = seed % 2 == 1;
        view.low_pass = if seed.is_multiple_of(3) { 0.3 } else { 0.1 };
        if seed.is_multiple_of(5) {
            (view.projection, view.focal) = (WorldProjection::Orthographic, [0.4 * width as f32, 0.45 * width as f32]);
        }
        if seed.is_multiple_of(7) {
            view.largest_alpha = 0.8;
        }
        let mut values = |len: usize, from: f32| (0..len).map(|_| random.range(from, 1.0)).collect::<Vec<_>>();
        Self {
            colours: values(count * channels, 0.0),
            background: values(channels, 0.0),
            of_image: values(width * height * channels, -1.0),
            of_alpha: values(width * height, -1.0),
            of_depth: values(count, -1.0),
            gaussians,
            view,
            channels,
        }
    }

    fn drawing(&self) -> Drawing<'_> {
        Drawing { channels: self.channels, colours: &self.colours, background: &self.background }
    }

    fn reference(&self) -> ReferenceScene {
        let wide = |from: &[f32]| from.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
        let Gaussians { mean, scale, rotation, opacity, .. } = self.gaussians.gaussians();
        ReferenceScene {
            mean: mean.iter().map(|v| v.map(f64::from)).collect(),
            rotation: rotation.expect("rotations").iter().map(|v| v.map(f64::from)).collect(),
            scale: scale.iter().map(|v| v.map(f64::from)).collect(),
            opacity: wide(opacity),
            channels: self.channels,
            colours: wide(&self.colours),
            background: wide(&self.background),
            world_to_view: self.view.world_to_view.map(|row| row.map(f64::from)),
        }
    }

    /// The loss of a scene in binary64.
    fn loss(&self, scene: &ReferenceScene) -> f64 {
        let drawn = render(scene, &self.view);
        let sum = |of: &[f32], values: &[f64]| of.iter().zip(values).map(|(&g, v)| f64::from(g) * v).sum::<f64>();
        sum(&self.of_image, &drawn.image) + sum(&self.of_alpha, &drawn.alpha)
    }
}

/// Gradients of a case, one after the other as in [`Gradients::all`].
struct Gradients {
    image: Vec<f32>,
    alpha: Vec<f32>,
    mean: Vec<[f32; 3]>,
    rotation: Vec<[f32; 4]>,
    scale: Vec<[f32; 3]>,
    opacity: Vec<f32>,
    colours: Vec<f32>,
    background: Vec<f64>,
    view: [[f64; 4]; 3],
}

impl Gradients {
    fn of(level: Level, case: &Case, with_depth: bool) -> Self {
        let (gaussians, n) = (case.gaussians.gaussians(), case.gaussians.mean.len());
        let mut rasteriser = WorldRasteriser::new(level);
        rasteriser.project(&gaussians, &case.view);
        let (mut image, mut alpha) = (vec![0.5; case.of_image.len()], vec![0.5; case.of_alpha.len()]);
        rasteriser.draw(&case.drawing(), &mut image, &mut alpha);
        let mut footprints = vec![FootprintGradient::default(); n];
        let mut all = Self {
            mean: vec![[0.0; 3]; n],
            rotation: vec![[0.0; 4]; n],
            scale: vec![[0.0; 3]; n],
            opacity: vec![0.0; n],
            colours: vec![0.5; case.colours.len()],
            background: vec![0.5; case.channels],
            view: [[0.0; 4]; 3],
            image,
            alpha,
        };
        let of = [&case.of_image[..], &case.of_alpha];
        rasteriser.draw_adjoint(
            &case.drawing(),
            [&all.image, &all.alpha],
            of,
            &mut footprints,
            &mut all.colours,
            &mut all.background,
        );
        let to = WorldGradients {
            mean: &mut all.mean,
            rotation: &mut all.rotation,
            scale: &mut all.scale,
            opacity: &mut all.opacity,
        };
        let of_depth = with_depth.then_some(&case.of_depth[..]);
        all.view = rasteriser.project_adjoint(&gaussians, &footprints, of_depth, to);
        all
    }

    /// Everything that was computed, binary64 in two halves.
    fn all(&self) -> Vec<f32> {
        let mut all = [&self.image[..], &self.alpha, self.mean.as_flattened(), self.rotation.as_flattened()].concat();
        all.extend([self.scale.as_flattened(), &self.opacity, &self.colours].concat());
        let wide = self.background.iter().chain(self.view.as_flattened());
        all.extend(wide.flat_map(|v| [v.to_bits() as u32, (v.to_bits() >> 32) as u32].map(f32::from_bits)));
        all
    }
}

#[test]
fn levels_and_thread_counts_agree_to_the_bit() {
    let mut cases = vec![
        Case::new(40, [37, 21], 3, 1),
        Case::new(300, [130, 70], 5, 2),
        Case::new(9, [66, 33], 1, 5),
        Case::new(3, [3, 2], 2, 4),
        Case::new(0, [5, 5], 4, 3),
        Case::new(5000, [70, 45], 4, 6),
    ];
    // Numbers that are not finite, thresholds, needles, walls, and an opaque one.
    let mut extreme = Case::new(60, [70, 45], 3, 7);
    for (i, value) in [f32::NAN, f32::INFINITY, 1e30, -1e30, 1e-42, 0.0].into_iter().enumerate() {
        extreme.gaussians.mean[i][i % 3] = value;
        extreme.gaussians.scale[6 + i][i % 3] = value;
        extreme.gaussians.opacity[12 + i] = value;
        extreme.gaussians.rotation.as_mut().expect("rotations")[18 + i] = [value; 4];
        extreme.colours[72 + i] = value;
        extreme.of_image[3 * 700 + i] = value;
        extreme.of_alpha[90 + i] = value;
    }
    extreme.gaussians.opacity[30] = 1.0;
    extreme.gaussians.opacity[31] = 1.0 / 255.0;
    extreme.gaussians.scale[32] = [1e3; 3];
    extreme.gaussians.scale[33] = [2.0, 1e-6, 1e-6];
    extreme.background[1] = f32::NAN;
    cases.push(extreme);
    for case in &cases {
        let len = Gradients::of(Level::scalar(), case, true).all().len();
        let found = on_every_level_and_thread_count(len, |level, out| {
            out.copy_from_slice(&Gradients::of(level, case, true).all())
        });
        assert!(case.gaussians.mean.is_empty() || found.iter().any(|v| *v != 0.0));
        // Gradients of Gaussians with numbers that are not finite are finite too.
        let sound = Gradients::of(Level::detect(), case, false);
        for of in [sound.mean.as_flattened(), sound.rotation.as_flattened(), sound.scale.as_flattened(), &sound.opacity]
        {
            assert!(of.iter().all(|v| v.is_finite()));
        }
    }
}

#[test]
fn images_agree_with_the_plain_version() {
    let mut compared = 0;
    for seed in 0..40 {
        let case = Case::new(30, [48, 37], 1 + seed as usize % 6, seed);
        let expected = render(&case.reference(), &case.view);
        if expected.margin < 1e-5 {
            continue;
        }
        compared += 1;
        let found = Gradients::of(Level::detect(), &case, false);
        for (found, expected) in found.image.iter().zip(&expected.image) {
            assert!((f64::from(*found) - expected).abs() < 2e-5, "seed {seed}: {found}, expected {expected}");
        }
        for (found, expected) in found.alpha.iter().zip(&expected.alpha) {
            assert!((f64::from(*found) - expected).abs() < 2e-5, "seed {seed}: {found}, expected {expected}");
        }
    }
    assert!(compared > 20, "{compared} scenes are away from thresholds");
}

/// The largest distance of two vectors of `len` numbers each, relative to the expected vector's length or a hundredth
/// of the longest.
fn relative(found: &[f64], expected: &[f64], len: usize) -> f64 {
    assert_eq!(found.len(), expected.len());
    let length = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let longest = expected.chunks(len).map(length).fold(1e-3, f64::max);
    let apart = found.chunks(len).zip(expected.chunks(len)).map(|(found, expected)| {
        let difference: Vec<f64> = found.iter().zip(expected).map(|(f, e)| f - e).collect();
        length(&difference) / length(expected).max(0.01 * longest)
    });
    apart.fold(0.0, f64::max)
}

/// Central differences of a loss by the numbers that `of` takes from a scene.
fn differences(case: &Case, of: impl Fn(&mut ReferenceScene) -> &mut [f64]) -> Vec<f64> {
    let mut scene = case.reference();
    (0..of(&mut scene).len())
        .map(|at| {
            let value = of(&mut scene)[at];
            let step = 1e-6 * value.abs().max(0.1);
            of(&mut scene)[at] = value + step;
            let above = case.loss(&scene);
            of(&mut scene)[at] = value - step;
            let below = case.loss(&scene);
            of(&mut scene)[at] = value;
            (above - below) / (2.0 * step)
        })
        .collect()
}

#[test]
fn gradients_are_the_finite_differences_of_two_hundred_small_scenes() {
    let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let (mut scenes, mut seed) = (0, 100);
    while scenes < 200 {
        seed += 1;
        assert!(seed < 400, "too few scenes are away from thresholds");
        let case = Case::new(6, [22, 17], 1 + seed as usize % 5, seed);
        if render(&case.reference(), &case.view).margin < 3e-5 {
            continue;
        }
        scenes += 1;
        let found = Gradients::of(Level::detect(), &case, false);
        let view: Vec<f64> = found.view.as_flattened().to_vec();
        let pairs = [
            ("means", wide(found.mean.as_flattened()), differences(&case, |s| s.mean.as_flattened_mut()), 3),
            (
                "quaternions",
                wide(found.rotation.as_flattened()),
                differences(&case, |s| s.rotation.as_flattened_mut()),
                4,
            ),
            ("scales", wide(found.scale.as_flattened()), differences(&case, |s| s.scale.as_flattened_mut()), 3),
            ("opacities", wide(&found.opacity), differences(&case, |s| &mut s.opacity), 1),
            ("colours", wide(&found.colours), differences(&case, |s| &mut s.colours), case.channels),
            ("background", found.background.clone(), differences(&case, |s| &mut s.background), case.channels),
            ("view", view, differences(&case, |s| s.world_to_view.as_flattened_mut()), 12),
        ];
        for (name, found, expected, len) in pairs {
            let apart = relative(&found, &expected, len);
            assert!(apart < 1e-3, "seed {seed}, {name}: relative error {apart:e}\n{found:?}\n{expected:?}");
        }
    }
}

#[test]
fn a_loss_of_depths_reaches_means_and_the_camera() {
    let mut case = Case::new(6, [22, 17], 1, 12);
    let plain = Gradients::of(Level::detect(), &case, false);
    let both = Gradients::of(Level::detect(), &case, true);
    // Only visible Gaussians have a depth.
    let mut rasteriser = WorldRasteriser::new(Level::detect());
    rasteriser.project(&case.gaussians.gaussians(), &case.view);
    for i in 0..6 {
        let seen = rasteriser.projected().radius[i] != [0; 2];
        for k in 0..3 {
            let expected = if seen { case.of_depth[i] * case.view.world_to_view[2][k] } else { 0.0 };
            let found = both.mean[i][k] - plain.mean[i][k];
            assert!((found - expected).abs() < 1e-4, "{found}, expected {expected}");
        }
    }
    // Depth is drawn as one of the colour channels.
    case.colours.copy_from_slice(&rasteriser.projected().depth);
    let found = Gradients::of(Level::detect(), &case, false);
    let expected = render(
        &ReferenceScene { colours: case.colours.iter().map(|&z| z.into()).collect(), ..case.reference() },
        &case.view,
    );
    for (found, expected) in found.image.iter().zip(&expected.image) {
        assert!((f64::from(*found) - expected).abs() < 1e-4, "{found}, expected {expected}");
    }
}

#[test]
fn planes_and_radii_leave_gaussians_out() {
    let case = Case::new(50, [64, 48], 3, 22);
    let project = |view: &WorldView| {
        let mut rasteriser = WorldRasteriser::new(Level::detect());
        rasteriser.project(&case.gaussians.gaussians(), view);
        rasteriser.projected().clone()
    };
    let all = project(&case.view);
    let shown = |projected: &Projected| projected.radius.iter().filter(|r| **r != [0; 2]).count();
    assert!(shown(&all) > 30);
    let near = project(&WorldView { near: 2.5, ..case.view });
    let far = project(&WorldView { far: 2.5, ..case.view });
    assert_eq!(shown(&near) + shown(&far), shown(&all));
    assert!(shown(&near) > 0 && near.depth.iter().all(|z| *z == 0.0 || *z > 2.5));
    let large = project(&WorldView { least_radius: 20.0, ..case.view });
    assert!(shown(&large) > 0 && shown(&large) < shown(&all));
    assert!(large.radius.iter().all(|[x, y]| *x == 0 || x.max(y) > &20));
    for i in 0..50 {
        let [a, b, c] = all.conic[i];
        if all.radius[i] != [0; 2] {
            assert!(a > 0.0 && c > 0.0 && a * c > b * b);
            let extent = (2.0 * (all.opacity[i] * 255.0).ln()).sqrt().min(3.33);
            let expected = extent * (c / (a * c - b * b)).sqrt();
            assert!((all.radius[i][0] as f32 - expected).abs() < 1.01, "{} and {expected}", all.radius[i][0]);
        }
    }
}

#[test]
fn an_image_without_channels_has_alpha() {
    let mut case = Case::new(20, [30, 20], 3, 8);
    let with = Gradients::of(Level::detect(), &case, false);
    (case.channels, case.of_image) = (0, Vec::new());
    (case.colours, case.background) = (Vec::new(), Vec::new());
    let without = Gradients::of(Level::detect(), &case, false);
    assert_eq!(bits(&with.alpha), bits(&without.alpha));
    assert!(without.mean.as_flattened().iter().any(|v| *v != 0.0));
}
