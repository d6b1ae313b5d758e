//! Modes, cameras and harmonics against their definitions, gradients against finite differences, and errors.

use super::*;

/// A generator of test values between −1 and 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
    }

    fn many(&mut self, len: usize) -> Vec<f32> {
        (0..len).map(|_| self.next()).collect()
    }
}

const SIZE: [usize; 2] = [40, 30];
const CAMERAS: usize = 2;

#[derive(Clone)]
struct Scene {
    means: Vec<[f32; 3]>,
    quats: Vec<[f32; 4]>,
    scales: Vec<[f32; 3]>,
    opacities: Vec<f32>,
    colours: Vec<f32>,
    backgrounds: Vec<f32>,
    viewmats: Vec<ViewMatrix>,
    mode: RenderMode,
    /// Degree, and coefficients per channel.
    harmonics: Option<(usize, usize)>,
    orthographic: bool,
}

impl Scene {
    fn new(n: usize, mode: RenderMode, harmonics: Option<(usize, usize)>, per_camera: bool) -> Self {
        let mut random = Random(5);
        let mut triples = |scale: f32, add: f32| -> Vec<[f32; 3]> {
            (0..n).map(|_| std::array::from_fn(|_| scale * random.next() + add)).collect()
        };
        let (means, scales) = (triples(0.7, 0.0), triples(0.1, 0.25));
        let each = harmonics.map_or(3, |(_, count)| 3 * count);
        let mut viewmats = vec![[[0.0; 4]; 4]; CAMERAS];
        for matrix in &mut viewmats {
            for (row, values) in matrix.iter_mut().enumerate() {
                values[row] = 1.0;
            }
            for row in &mut matrix[..3] {
                row.iter_mut().for_each(|v| *v += 0.1 * random.next());
            }
            matrix[2][3] += 3.0;
        }
        Self {
            means,
            quats: (0..n).map(|_| std::array::from_fn(|_| random.next())).collect(),
            scales,
            opacities: random.many(n).iter().map(|v| 0.6 + 0.3 * v).collect(),
            colours: random
                .many(n * each * if per_camera { CAMERAS } else { 1 })
                .iter()
                .map(|v| 0.3 * v + 0.2)
                .collect(),
            backgrounds: random.many(3 * CAMERAS),
            viewmats,
            mode,
            harmonics,
            orthographic: false,
        }
    }

    fn with<R>(&self, work: impl FnOnce(Result<Rasterisation<'_>, RasterError>) -> R) -> R {
        let Self { means, quats, scales, opacities, colours, .. } = self;
        let gaussians = Gaussians { means, quats, scales, opacities };
        let colours = match self.harmonics {
            None => Colours::Channels { values: colours, channels: 3 },
            Some((degree, count)) => Colours::Harmonics { coefficients: colours, count, degree },
        };
        let k = [[35.0, 0.0, 19.0], [0.0, 36.0, 16.0], [0.0, 0.0, 1.0]];
        let flat = [[15.0, 0.0, 19.0], [0.0, 14.0, 16.0], [0.0, 0.0, 1.0]];
        let options = Options {
            backgrounds: Some(&self.backgrounds),
            render_mode: self.mode,
            antialiased: true,
            orthographic: self.orthographic,
            ..Options::new(SIZE[0], SIZE[1])
        };
        let ks = vec![if self.orthographic { flat } else { k }; self.viewmats.len()];
        work(rasterise(&gaussians, &colours, &self.viewmats, &ks, &options))
    }

    fn loss(&self, of: &[f32], of_alpha: &[f32]) -> f64 {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        self.with(|drawn| {
            let drawn = drawn.expect("a scene");
            dot(drawn.colours(), of) + dot(drawn.alphas(), of_alpha)
        })
    }
}

#[test]
fn modes_hold_colours_and_depth() {
    let draw = |mode| {
        Scene::new(12, mode, None, true).with(|drawn| {
            let drawn = drawn.expect("a scene");
            (drawn.channels(), drawn.colours().to_vec(), drawn.alphas().to_vec())
        })
    };
    let (_, rgb, alpha) = draw(RenderMode::Rgb);
    let (one, depth, _) = draw(RenderMode::Depth);
    let (_, expected, _) = draw(RenderMode::ExpectedDepth);
    let (four, both, _) = draw(RenderMode::RgbDepth);
    let (_, both_expected, _) = draw(RenderMode::RgbExpectedDepth);
    assert_eq!((one, four), (1, 4));
    assert_eq!(rgb.len(), CAMERAS * SIZE[0] * SIZE[1] * 3);
    for at in 0..alpha.len() {
        assert_eq!(both[4 * at..][..3], rgb[3 * at..][..3]);
        assert_eq!(both[4 * at + 3], depth[at]);
        assert_eq!(expected[at], depth[at] / alpha[at].max(1e-10));
        assert_eq!(both_expected[4 * at + 3], expected[at]);
    }
    assert!(depth.iter().any(|z| *z > 1.0));
}

#[test]
fn gradients_are_finite_differences_of_the_images() {
    let harmonics = Some((2, 10));
    let mut flat = Scene::new(10, RenderMode::RgbDepth, None, false);
    flat.orthographic = true;
    let scenes = [
        Scene::new(10, RenderMode::RgbExpectedDepth, harmonics, false),
        Scene::new(10, RenderMode::RgbDepth, harmonics, true),
        Scene::new(10, RenderMode::ExpectedDepth, None, false),
        Scene::new(10, RenderMode::Rgb, None, true),
        flat,
    ];
    for (case, scene) in scenes.iter().enumerate() {
        let mut random = Random(9);
        // Smooth weights: edges of footprints, which have no gradient, have little effect.
        let channels = scene.with(|drawn| drawn.expect("a scene").channels());
        let smooth =
            |i: usize| 1.0 + 0.5 * ((i / SIZE[0]) as f32 * 0.3).sin() + 0.5 * ((i % SIZE[0]) as f32 * 0.2).cos();
        let pixels = CAMERAS * SIZE[0] * SIZE[1];
        let mut of: Vec<f32> = (0..pixels * channels).map(|i| smooth(i / channels)).collect();
        if scene.mode.is_expected() {
            // Where the alpha is small, a few Gaussians decide the expected depth.
            let alphas = scene.with(|drawn| drawn.expect("a scene").alphas().to_vec());
            for (of, _) in of.chunks_mut(channels).zip(&alphas).filter(|(_, alpha)| **alpha < 0.3) {
                of[channels - 1] = 0.0;
            }
        }
        let of_alpha: Vec<f32> = (0..pixels).map(|i| 0.5 * smooth(i + 11)).collect();
        let found = scene.with(|drawn| drawn.expect("a scene").backward(&of, &of_alpha)).expect("gradients");
        type Part = fn(&mut Scene) -> &mut [f32];
        let parts: [(&str, &[f32], Part); 7] = [
            ("means", found.means.as_flattened(), |s| s.means.as_flattened_mut()),
            ("quats", found.quats.as_flattened(), |s| s.quats.as_flattened_mut()),
            ("scales", found.scales.as_flattened(), |s| s.scales.as_flattened_mut()),
            ("opacities", &found.opacities, |s| &mut s.opacities),
            ("colours", &found.colours, |s| &mut s.colours),
            ("backgrounds", &found.backgrounds, |s| &mut s.backgrounds),
            ("viewmats", found.viewmats.as_flattened().as_flattened(), |s| {
                s.viewmats.as_flattened_mut().as_flattened_mut()
            }),
        ];
        for (name, gradient, part) in parts {
            // Along the gradient itself, and along its values times random factors.
            let longest = gradient.iter().map(|v| v.abs()).fold(0.0, f32::max);
            if longest == 0.0 {
                assert!(
                    scene.mode == RenderMode::ExpectedDepth && ["colours", "backgrounds"].contains(&name),
                    "{name}"
                );
                continue;
            }
            let pick: Vec<f32> = gradient.iter().map(|_| random.next()).collect();
            for direction in [gradient.to_vec(), gradient.iter().zip(&pick).map(|(g, r)| g * r).collect::<Vec<_>>()] {
                let step = 2e-3 / longest;
                let moved = |sign: f32| {
                    let mut moved = scene.clone();
                    part(&mut moved).iter_mut().zip(&direction).for_each(|(v, d)| *v += sign * step * d);
                    moved.loss(&of, &of_alpha)
                };
                let expected = (moved(1.0) - moved(-1.0)) / (2.0 * f64::from(step));
                let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
                let scale: f64 = gradient.iter().zip(&direction).map(|(g, d)| f64::from((g * d).abs())).sum();
                // Footprints end where α is 1/255, and these ends move: about ln(255·o)/(255·o) of a change in size,
                // which is not part of the gradient.
                assert!((slope - expected).abs() < 0.1 * scale, "case {case}, {name}: {slope}, expected {expected}");
            }
        }
    }
}

#[test]
fn arguments_that_cannot_be_drawn_are_named() {
    let refused = |change: fn(&mut Scene)| {
        let mut scene = Scene::new(4, RenderMode::Rgb, None, false);
        change(&mut scene);
        scene.with(|drawn| drawn.expect_err("a refusal").to_string())
    };
    let found = [
        refused(|s| s.means.clear()),
        refused(|s| s.quats.truncate(3)),
        refused(|s| s.means[1][2] = f32::NAN),
        refused(|s| s.colours.truncate(7)),
        refused(|s| s.backgrounds.truncate(4)),
        refused(|s| s.viewmats[0][1] = s.viewmats[0][0]),
        refused(|s| s.viewmats[0][3][3] = 2.0),
        refused(|s| s.viewmats.clear()),
        refused(|s| s.harmonics = Some((4, 1))),
        refused(|s| s.harmonics = Some((1, 1))),
    ];
    let expected = [
        "means: expected at least one, found none",
        "quats: expected 16 values, found 12",
        "means: expected finite numbers, found NaN at place 5",
        "colors: expected 24 values, found 7",
        "backgrounds: expected 6 values, found 4",
        "viewmats: expected a matrix with an inverse",
        "viewmats: expected a matrix with an inverse",
        "viewmats: expected at least one, found none",
        "sh_degree: expected at most 3, found 4",
        "colors: expected 12 values, found 3",
    ];
    for (found, expected) in found.iter().zip(expected) {
        assert!(found.starts_with(expected), "{found}, expected {expected}");
    }
    let wide = vec![[0.0; 3]; MAX_GAUSSIANS + 1];
    let gaussians = Gaussians { means: &wide, ..Gaussians::default() };
    let colours = Colours::Channels { values: &[], channels: 3 };
    let many = rasterise(&gaussians, &colours, &[[[0.0; 4]; 4]], &[[[0.0; 3]; 3]], &Options::new(8, 8));
    assert_eq!(many.expect_err("too many").to_string(), "means: expected at most 16777216, found 16777217");
    let one = Gaussians { means: &[[0.0, 0.0, 2.0]], quats: &[[1.0; 4]], scales: &[[1.0; 3]], opacities: &[0.5] };
    let matrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let options = Options { near_plane: -1.0, ..Options::new(8, 8) };
    for (k, options, expected) in [
        ([[0.0; 3]; 3], Options::new(8, 8), "Ks: expected [[fx, 0, cx]"),
        ([[1.0; 3]; 3], options, "near_plane: expected a number from 0 on, found -1"),
        ([[1.0; 3]; 3], Options::new(0, 8), "width: expected at least one, found none"),
        ([[1.0; 3]; 3], Options::new(8, 70_000), "height: expected at most 65536, found 70000"),
    ] {
        let found = View::new(&one, &matrix, &k, &options).map(|_| ()).expect_err("a refusal").to_string();
        assert!(found.starts_with(expected), "{found}, expected {expected}");
    }
}

#[test]
fn planes_are_orthographic_views_and_have_their_gradients() {
    const COUNT: usize = 60;
    let mut random = Random(5);
    let mut splat = || {
        let [u, v, a, c, o] = std::array::from_fn(|_| random.next());
        [20.0 + 20.0 * u, 15.0 + 15.0 * v, 4.5 + 4.0 * a, 3.0 + 2.5 * c, 0.5 + 0.45 * o]
    };
    let splats: Vec<PlaneSplat> = (0..2 * COUNT).map(|_| splat()).collect();
    let keys: Vec<f32> = random.many(2 * COUNT);
    let positive: Vec<f32> = keys.iter().map(|key| 2.0 + key).collect();
    let (colours, backgrounds) = (random.many(2 * COUNT * 4), random.many(8));
    let planes = Planes::new(splats.clone(), &keys, COUNT, SIZE, 0.99).expect("splats that can be drawn");
    let drawn = planes.draw(&colours, 4, &backgrounds).expect("colours that fit");
    let same = Planes::new(splats.clone(), &positive, COUNT, SIZE, 0.99).expect("splats that can be drawn");
    assert_eq!(drawn, same.draw(&colours, 4, &backgrounds).expect("colours that fit"), "the order is that of the keys");
    let pixels = SIZE[0] * SIZE[1];
    let (of_image, of_alpha) = (random.many(2 * pixels * 4), random.many(2 * pixels));
    let (of_splats, of_colours) = planes
        .gradients(&colours, 4, &backgrounds, [&drawn.0, &drawn.1], [&of_image, &of_alpha])
        .expect("gradients that fit");
    let options = Options {
        near_plane: 0.0,
        eps2d: 0.0,
        orthographic: true,
        largest_alpha: 0.99,
        ..Options::new(SIZE[0], SIZE[1])
    };
    let (mut viewmat, mut k) = ([[0.0; 4]; 4], [[0.0; 3]; 3]);
    (0..4).for_each(|i| viewmat[i][i] = 1.0);
    (0..3).for_each(|i| k[i][i] = 1.0);
    for m in 0..2 {
        let part = m * COUNT..(m + 1) * COUNT;
        let splats = &splats[part.clone()];
        let means: Vec<_> =
            splats.iter().zip(&positive[part.clone()]).map(|(s, z)| [s[0] + 0.5, s[1] + 0.5, *z]).collect();
        let scales: Vec<_> = splats.iter().map(|s| [s[2].sqrt(), s[3].sqrt(), 0.0]).collect();
        let opacities: Vec<_> = splats.iter().map(|s| s[4]).collect();
        let quats = [[1.0, 0.0, 0.0, 0.0]; COUNT];
        let gaussians = Gaussians { means: &means, quats: &quats, scales: &scales, opacities: &opacities };
        let view = View::new(&gaussians, &viewmat, &k, &options).expect("a view");
        let (colours, background) = (&colours[m * COUNT * 4..][..COUNT * 4], &backgrounds[m * 4..][..4]);
        let (image, alpha) = view.draw(colours, 4, background).expect("an image");
        assert!(
            image == drawn.0[m * pixels * 4..][..pixels * 4] && alpha == drawn.1[m * pixels..][..pixels],
            "image {m}"
        );
        let (mut expected, mut behind) = (vec![0.0; COUNT * 4], [0.0; 4]);
        let of = [&of_image[m * pixels * 4..][..pixels * 4], &of_alpha[m * pixels..][..pixels]];
        let footprints = view
            .draw_gradients(colours, 4, background, [&image, &alpha], of, &mut expected, &mut behind)
            .expect("gradients");
        assert_eq!(expected, of_colours[m * COUNT * 4..][..COUNT * 4], "colours of image {m}");
        let mut to = GaussianGradients::zeros(COUNT);
        view.gradients(&gaussians, &footprints, None, [0.0; 3], &mut to).expect("gradients");
        for (i, found) in of_splats[part].iter().enumerate() {
            let by = |axis: usize| to.scales[i][axis] / (2.0 * scales[i][axis]);
            let expected = [to.means[i][0], to.means[i][1], by(0), by(1), to.opacities[i]];
            for (found, expected) in found.iter().zip(expected) {
                assert!(
                    (found - expected).abs() <= 1e-4 * expected.abs() + 1e-6,
                    "splat {i}: {found}, expected {expected}"
                );
            }
        }
    }
    let refused = Planes::new(vec![[0.0; 5]; 3], &[1.0; 3], 2, SIZE, 0.99).expect_err("half an image");
    assert_eq!(refused.to_string(), "splats: expected 4 values, found 3");
    let refused =
        Planes::new(vec![[0.0, 0.0, 1.0, -2.0, 0.5]], &[1.0], 1, SIZE, 0.99).expect_err("a negative variance");
    assert_eq!(refused.to_string(), "splats: expected variances from 0 on, found -2");
}
