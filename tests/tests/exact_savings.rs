//! What is left out and changes no bit: each kind of it beside the run without it, with the counter in `run.json` that tells of it.
//!
//! | left out | `work` in `run.json` | without it |
//! |---|---|---|
//! | the network on a repeated frame | `encoder`, `upsampler`, `heads`, `dinov2`, `decoder` | `--reuse off`: `stream_reuse.rs` |
//! | residual branches that add nothing | `encoder.branches`, `upsampler.branches`, `decoder.branches` | `--reuse off`: here |
//! | DINOv2, where the model is not conditioned on it | `dinov2` | never opened: here |
//! | depth maps nobody gave | none: no file is looked for | a map of zeros: here |
//! | copies of weights: checkpoints are mapped | none | read into memory: here |
//! | Gaussians that reach no pixel | `render.project` | the scene without them: here |
//! | splats behind finished pixels | `render.blend` | the scene without them: here |
//! | tiles none of whose splats changed | `render.tiles` | a fresh image: here |
//! | planes nobody asked for | `render.planes` | all planes: here |
//! | turning splats in a view that turns none | `render.turned` | rotations by nothing: here |

use streamsplat::stream::{DynamicGaussians, ModelSource, Reuse};
use streamsplat::{Camera, Engine, Frame, Interval, RenderOptions, Settings};
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{Gaussians, Image, Projection, Renderer, Request, render};
use streamsplat_model::{FrameInput, LoadOptions, Network};

fn checkpoint(name: &str) -> std::path::PathBuf {
    streamsplat_fixtures::path(&format!("parity/{name}"))
}

/// Gaussians without rotation in view space.
#[derive(Clone, Default)]
struct Scene {
    mean: Vec<[f32; 3]>,
    scale: Vec<[f32; 3]>,
    opacity: Vec<f32>,
    rgb: Vec<[f32; 3]>,
}

impl Scene {
    /// Many, all over the image and around it.
    fn scattered(count: u32) -> Scene {
        let mut scene = Scene::default();
        for i in 0..count {
            let part = |n: u32| (i.wrapping_mul(n) % 1009) as f32 / 1009.0;
            let mean = [2.4 * part(389) - 1.2, 2.4 * part(701) - 1.2, 0.2 + 4.0 * part(127)];
            scene.push(mean, 0.01 + 0.1 * part(53), 0.3 + 0.65 * part(911), [part(17), part(31), part(71)]);
        }
        scene
    }

    fn push(&mut self, mean: [f32; 3], scale: f32, opacity: f32, rgb: [f32; 3]) {
        self.mean.push(mean);
        self.scale.push([scale; 3]);
        self.opacity.push(opacity);
        self.rgb.push(rgb);
    }

    fn gaussians(&self) -> Gaussians<'_> {
        let Scene { mean, scale, opacity, rgb } = self;
        Gaussians { mean, scale, rotation: None, opacity, rgb }
    }
}

const VIEW: Projection = Projection::Orthographic { focal: [64.0, 40.0] };

fn request() -> Request {
    Request { depth: true, alpha: true, ..Request::colour(128, 80, [0.5; 3]) }
}

fn bits(image: &Image) -> Vec<u32> {
    let planes = [Some(&image.rgb), image.depth.as_ref(), image.alpha.as_ref()];
    planes.into_iter().flatten().flatten().map(|v| v.to_bits()).collect()
}

#[test]
fn gaussians_that_reach_no_pixel_are_counted_and_change_no_bit() {
    let scene = Scene::scattered(800);
    let mut more = scene.clone();
    for i in 0..500 {
        let x = i as f32 * 0.01;
        // Beside the image, behind the camera, too faint.
        more.push([3.0 + x, 0.0, 1.0], 0.1, 0.9, [1.0; 3]);
        more.push([0.0, 0.1, -x], 0.1, 0.9, [1.0; 3]);
        more.push([0.0, 0.1, 0.1], 0.1, 0.0039, [1.0; 3]);
    }
    let draw = |scene: &Scene| {
        let mut renderer = Renderer::new(Level::detect());
        let found = bits(renderer.render(&scene.gaussians(), &VIEW, &request()));
        (found, renderer.work().culled)
    };
    let ((expected, before), (found, after)) = (draw(&scene), draw(&more));
    assert!(found == expected);
    assert_eq!(after - before, 1500);
}

#[test]
fn splats_behind_finished_pixels_are_counted_and_change_no_bit() {
    let mut scene = Scene::default();
    (0..40).for_each(|i| scene.push([0.0, 0.0, 0.2 + 1e-3 * i as f32], 50.0, 0.95, [0.2, 0.4, 0.6]));
    let mut more = scene.clone();
    let behind = Scene::scattered(2000);
    for i in 0..2000 {
        let [x, y, z] = behind.mean[i];
        more.push([x, y, 1.0 + z], behind.scale[i][0], behind.opacity[i], behind.rgb[i]);
    }
    let draw = |scene: &Scene| {
        let mut renderer = Renderer::new(Level::detect());
        let found = bits(renderer.render(&scene.gaussians(), &VIEW, &request()));
        (found, renderer.work())
    };
    let ((expected, before), (found, after)) = (draw(&scene), draw(&more));
    assert!(found == expected);
    let added = after.entries - before.entries;
    assert!(added > 2000 && after.entries_unseen - before.entries_unseen == added, "{after:?}");
}

#[test]
fn tiles_that_did_not_change_are_counted_and_keep_their_bits() {
    let mut scene = Scene::scattered(800);
    let mut renderer = Renderer::new(Level::detect());
    renderer.render(&scene.gaussians(), &VIEW, &request());
    scene.push([0.5, 0.5, 0.15], 0.02, 0.9, [1.0; 3]);
    // As many Gaussians as before: one takes another's place.
    for plane in [&mut scene.mean, &mut scene.scale, &mut scene.rgb] {
        plane.swap_remove(7);
    }
    scene.opacity.swap_remove(7);
    let redrawn = bits(renderer.render(&scene.gaussians(), &VIEW, &request()));
    let work = renderer.work();
    assert!(work.tiles_drawn > 0 && work.tiles_drawn < work.tiles, "{work:?}");
    assert!(redrawn == bits(&render(Level::detect(), &scene.gaussians(), &VIEW, &request())));
}

#[test]
fn planes_nobody_asked_for_change_no_bit_of_those_that_were() {
    let scene = Scene::scattered(800);
    let full = render(Level::detect(), &scene.gaussians(), &VIEW, &request());
    for (depth, alpha) in [(false, false), (true, false), (false, true)] {
        let some = render(Level::detect(), &scene.gaussians(), &VIEW, &Request { depth, alpha, ..request() });
        assert_eq!((some.depth.is_some(), some.alpha.is_some()), (depth, alpha));
        assert_eq!(some.rgb, full.rgb);
        assert!(some.depth.is_none_or(|plane| Some(plane) == full.depth));
        assert!(some.alpha.is_none_or(|plane| Some(plane) == full.alpha));
    }
}

#[test]
fn rotations_by_nothing_are_not_computed_with() {
    let scene = Scene::scattered(800);
    let expected = bits(&render(Level::detect(), &scene.gaussians(), &VIEW, &request()));
    let still = vec![[1.0, 0.0, 0.0, 0.0]; scene.mean.len()];
    let gaussians = Gaussians { rotation: Some(&still), ..scene.gaussians() };
    assert!(bits(&render(Level::detect(), &gaussians, &VIEW, &request())) == expected);
}

#[test]
fn a_mapped_checkpoint_gives_the_bits_of_one_in_memory() {
    let path = checkpoint("tiny-nodino.safetensors");
    let options = LoadOptions { level: Level::detect(), ..LoadOptions::default() };
    let mapped = Network::open(&path, &options).expect("loads");
    let bytes: &'static [u8] = std::fs::read(&path).expect("readable").leak();
    let config = std::fs::read_to_string(checkpoint("tiny-nodino.json")).expect("readable");
    let read = Network::from_parts(bytes, &config, &options).expect("loads");
    let [height, width] = mapped.config().resolution;
    let rgb: Vec<f32> = (0..3 * height * width).map(|i| (i % 251) as f32 / 251.0).collect();
    let input = FrameInput { rgb: &rgb, depth: None };
    let [a, b] = [&mapped, &read].map(|network| network.embed(&input).expect("embeds").h);
    assert!(a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits())));
}

fn frame(depth: Option<f32>) -> Frame {
    let (width, height) = (80, 48);
    let rgb = (0..3 * width * height).map(|i| (i % 97) as f32 / 97.0).collect();
    Frame { width, height, rgb, depth: depth.map(|d| vec![d; width * height]) }
}

fn stream(dinov2: Option<std::path::PathBuf>, depth: Option<f32>) -> (Vec<Interval>, Engine) {
    let source = ModelSource::File { checkpoint: checkpoint("tiny-nodino.safetensors"), dinov2 };
    let mut engine = Engine::new(Settings::with_model(source)).expect("starts");
    let mut push = |k: u32| {
        let mut frame = frame(depth);
        frame.rgb[0] = k as f32 * 0.1;
        engine.push(frame, f64::from(k)).expect("taken")
    };
    let intervals = (0..3).map(&mut push).collect();
    (intervals, engine)
}

fn gaussians(intervals: &[Interval]) -> Vec<&DynamicGaussians> {
    intervals.iter().map(|interval| &interval.gaussians).collect()
}

#[test]
fn dinov2_is_not_opened_by_a_model_that_does_not_read_it() {
    let (with, engine) = stream(Some(checkpoint("no-such-file.safetensors")), None);
    let (without, _) = stream(None, None);
    assert_eq!(gaussians(&with), gaussians(&without));
    let work = engine.work().stage("dinov2").expect("a stage");
    assert_eq!((work.done, work.avoided), (0, 3));
}

#[test]
fn residual_branches_that_add_nothing_are_counted_and_change_no_bit() {
    // The small checkpoint has them: an attention of the encoder, a feed-forward layer of the decoder.
    let run = |reuse| {
        let mut engine = Engine::new(Settings { reuse, ..Settings::default() }).expect("starts");
        let mut push = |k: u32| {
            let mut frame = frame(None);
            frame.rgb[0] = k as f32 * 0.1;
            engine.push(frame, f64::from(k)).expect("taken")
        };
        let intervals: Vec<Interval> = (0..3).map(&mut push).collect();
        (intervals, engine)
    };
    let ((with, engine), (without, off)) = (run(Reuse::Exact), run(Reuse::Off));
    assert_eq!(gaussians(&with), gaussians(&without));
    let count = |stage| engine.work().stage(stage).map(|s| (s.done, s.avoided));
    assert_eq!(count("encoder.branches"), Some((3, 3)));
    assert_eq!(count("upsampler.branches"), Some((7 * 8, 0)));
    assert_eq!(count("decoder.branches"), Some((2 * 8, 2)));
    assert!(off.work().stages().iter().all(|stage| !stage.stage.ends_with(".branches")));
}

#[test]
fn depth_that_is_not_there_is_depth_of_zero() {
    // A constant map is normalised to zero.
    let ((with, _), (without, engine)) = (stream(None, Some(0.7)), stream(None, None));
    assert_eq!(gaussians(&with), gaussians(&without));
    assert_eq!(engine.work().stage("encoder").map(|s| s.done), Some(3));
    let draw = |i: &Interval| i.render(i.end, &Camera::Canonical, &RenderOptions::default()).expect("drawn");
    assert_eq!(draw(&with[2]), draw(&without[2]));
}
