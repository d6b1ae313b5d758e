//! Intervals and images have the same bits on every level, for any number of threads and in every run. Pairwise fusion
//! is the model's own definition of an interval.

use std::path::PathBuf;

use streamsplat::fit::Fit;
use streamsplat::stream::{Fusion, ModelSource, SamplingMode};
use streamsplat::{Camera, Engine, EngineError, Frame, Image, Interval, RenderOptions, Settings};
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{self, Gaussians, Projection, Request};
use streamsplat_model::{FrameInput, LoadOptions, Network, Sampling, Side, motion};

/// A moving pattern with noise, at an odd size.
fn frame(k: usize) -> Frame {
    let (width, height) = (83, 47);
    let pixel = |i: usize| {
        let (plane, y, x) = (i / (width * height), i / width % height, i % width);
        let wave = ((x + 3 * k) / 9 + (y + k) / 7 + plane) % 4;
        0.2 * wave as f32 + (i * 7919 % 1013) as f32 / 6000.0
    };
    Frame { width, height, rgb: (0..3 * width * height).map(pixel).collect(), depth: None }
}

fn checkpoint(name: &str) -> PathBuf {
    streamsplat_fixtures::path(&format!("parity/{name}.safetensors"))
}

fn stream(settings: Settings) -> Vec<(Interval, Image)> {
    let mut engine = Engine::new(settings).expect("starts");
    let push = |k: usize| {
        let interval = engine.push(frame(k), 0.5 * k as f64).expect("taken");
        let time = interval.start + 0.3 * (interval.end - interval.start);
        let options = RenderOptions { depth: true, alpha: true, ..RenderOptions::default() };
        let image = interval.render(time, &Camera::Canonical, &options, engine.workers()).expect("drawn");
        (interval, image)
    };
    (0..3).map(push).collect()
}

#[test]
fn levels_and_threads_give_the_same_intervals_and_images() {
    let settings = |level, threads| Settings {
        model: ModelSource::File { checkpoint: checkpoint("tiny-sampled"), dinov2: None },
        sampling: SamplingMode::Sample,
        seed: 7,
        level: Some(level),
        threads,
        ..Settings::default()
    };
    let expected = stream(settings(Level::scalar(), 1));
    for level in Level::available() {
        for threads in [1, 2, 3, 8] {
            for ((a, image_a), (b, image_b)) in expected.iter().zip(&stream(settings(level, threads))) {
                assert_eq!(a.gaussians, b.gaussians, "{level}, {threads} threads");
                assert_eq!(a.merges, b.merges);
                let bits = |image: &Image| image.rgb.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(image_a), bits(image_b), "{level}, {threads} threads");
                assert_eq!(image_a, image_b);
            }
        }
    }
}

#[test]
fn a_model_conditioned_on_dinov2_streams_with_its_features_and_says_what_is_missing() {
    let settings = |dinov2| Settings {
        model: ModelSource::File { checkpoint: checkpoint("tiny-dino"), dinov2 },
        ..Settings::default()
    };
    assert!(matches!(Engine::new(settings(None)).map(|_| ()), Err(EngineError::Condition)));
    let missing = settings(Some(checkpoint("no-such-file")));
    assert!(matches!(Engine::new(missing).map(|_| ()), Err(EngineError::Model(_))));
    let mut engine = Engine::new(settings(Some(checkpoint("dino-tiny")))).expect("starts");
    for (k, shown) in [0, 1, 1].into_iter().enumerate() {
        engine.push(frame(shown), k as f64).expect("taken");
    }
    let dinov2 = engine.work().stage("dinov2").expect("a stage");
    assert_eq!((dinov2.done, dinov2.avoided), (2, 1));
}

#[test]
fn pairwise_fusion_is_the_models_own_interval() {
    let options = LoadOptions { level: Level::detect(), ..LoadOptions::default() };
    let network = Network::open(checkpoint("tiny-nodino"), &options).expect("loads");
    let [height, width] = network.config().resolution;
    let frames: Vec<Frame> = (0..3)
        .map(|k| {
            let pixel = |i: usize| ((i * 31 + k * 17) % 101) as f32 / 101.0;
            Frame { width, height, rgb: (0..3 * width * height).map(pixel).collect(), depth: None }
        })
        .collect();
    let mut engine = Engine::new(Settings {
        model: ModelSource::File { checkpoint: checkpoint("tiny-nodino"), dinov2: None },
        fusion: Fusion::Pairwise,
        fit: Fit::Stretch,
        ..Settings::default()
    })
    .expect("starts");
    let mut session = network.session(None);
    let parts: Vec<_> = frames
        .iter()
        .map(|f| {
            let h = session.embed(&FrameInput { rgb: &f.rgb, depth: None }).expect("embeds");
            let fixed = session.static_gaussians(&h, &Sampling::Mean).expect("reconstructs");
            (h, fixed)
        })
        .collect();
    for (k, f) in frames.iter().enumerate() {
        let interval = engine.push(f.clone(), k as f64).expect("taken");
        if k == 0 {
            continue;
        }
        let side = |i: usize| Side { h: &parts[i].0.h, static_tokens: &parts[i].1.tokens, condition: None };
        let fields = session.deform(side(k - 1), side(k)).expect("deforms");
        for t in [0.0f32, 0.25, 0.5, 0.8125, 1.0] {
            let (mut mean, mut scale, mut opacity, mut rgb) = (vec![], vec![], vec![], vec![]);
            for (side, own) in [(0, 0.0), (1, 1.0)] {
                let g = &parts[k - 1 + side].1.gaussians;
                let n = g.position.len();
                let (mut at, mut seen) = (vec![[0.0; 3]; n], vec![0.0; n]);
                motion::position_at(&g.position, &fields[side].velocity, t - own, &mut at);
                motion::opacity_at(Level::detect(), &g.opacity, &fields[side].gamma, t - own, &mut seen);
                for i in 0..n {
                    let [x, y, z] = at[i];
                    if (0.0..=1.0).contains(&y) {
                        mean.push([x, -z, 1.0 / (9.8 * y + 0.2 + 1e-6)]);
                        let [sx, sz] = g.scale[i];
                        scale.push([sx, sz, (sx + sz) * 0.5]);
                        opacity.push(seen[i]);
                        rgb.push(g.rgb[i]);
                    }
                }
            }
            let gaussians = Gaussians { mean: &mean, scale: &scale, rotation: None, opacity: &opacity, rgb: &rgb };
            let projection = Projection::Orthographic { focal: [width as f32 / 2.0, height as f32 / 2.0] };
            let request = Request::colour(width, height, [0.5; 3]);
            let expected = raster::render(Level::detect(), &gaussians, &projection, &request);
            let time = (k - 1) as f64 + f64::from(t);
            let found =
                interval.render(time, &Camera::Canonical, &RenderOptions::default(), engine.workers()).expect("drawn");
            let bits = |image: &Image| image.rgb.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            assert!(bits(&expected) == bits(&found), "interval {k}, t = {t}");
        }
    }
}
