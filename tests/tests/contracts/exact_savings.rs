//! Savings that change no bit: each kind compared with the run without it, with its counter in `run.json`.
//!
//! | left out | `work` in `run.json` | without it |
//! |---|---|---|
//! | the network on a repeated frame | `encoder`, `upsampler`, `heads`, `dinov2`, `decoder` | `--reuse off`: `stream_reuse.rs` |
//! | patches that a tile only borrows from its neighbours, or whose Gaussians are all kept | `patches` | all patches: here |
//! | residual branches that add nothing | `encoder.branches`, `upsampler.branches`, `decoder.branches` | `--reuse off`: here |
//! | DINOv2, where the model is not conditioned on it | `dinov2` | never opened: here |
//! | depth without maps | none: no file is looked for | a map of zeros: here |
//! | copies of weights: checkpoints are mapped | none | read into memory: here |
//! | Gaussians that reach no pixel | `render.project` | the scene without them: here |
//! | Gaussians that are seen to reach none before they are projected | `render.window` | the whole scene projected: here |
//! | splats behind finished pixels | `render.blend` | the scene without them: here |
//! | tiles without a changed splat | `render.tiles` | a fresh image: here |
//! | planes that are not requested | `render.planes` | all planes: here |
//! | turning splats in a view that turns none | `render.turned` | rotations by nothing: here |

use streamsplat::camera::{Lens, Pose};
use streamsplat::render::Renderer;
use streamsplat::still::{Drawable, Still};
use streamsplat::stream::{DynamicGaussians, EMBEDDED_CHECKPOINT, EMBEDDED_CONFIG, Fade, ModelSource, Reuse, Workers};
use streamsplat::{Camera, Engine, Frame, Interval, RenderOptions, Settings, Size};
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{Gaussians, Image, OwnedGaussians, Projection, Rasteriser, Request, render};
use streamsplat_model::reuse::Saving;
use streamsplat_model::{FrameInput, LoadOptions, Network, Precision, Sampling, StaticGaussian};

fn checkpoint(name: &str) -> std::path::PathBuf {
    streamsplat_fixtures::path(&format!("parity/{name}"))
}

/// Gaussians all over the image and around it.
fn scattered(count: u32) -> OwnedGaussians {
    let mut scene = OwnedGaussians::default();
    for i in 0..count {
        let part = |n: u32| (i.wrapping_mul(n) % 1009) as f32 / 1009.0;
        let mean = [2.4 * part(389) - 1.2, 2.4 * part(701) - 1.2, 0.2 + 4.0 * part(127)];
        add(&mut scene, mean, 0.01 + 0.1 * part(53), 0.3 + 0.65 * part(911), [part(17), part(31), part(71)]);
    }
    scene
}

/// Adds a round Gaussian.
fn add(scene: &mut OwnedGaussians, mean: [f32; 3], scale: f32, opacity: f32, rgb: [f32; 3]) {
    scene.push(mean, [scale; 3], [1.0, 0.0, 0.0, 0.0], opacity, rgb);
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
    let scene = scattered(800);
    let mut more = scene.clone();
    for i in 0..500 {
        let x = i as f32 * 0.01;
        // Outside the image, behind the camera, too faint.
        add(&mut more, [3.0 + x, 0.0, 1.0], 0.1, 0.9, [1.0; 3]);
        add(&mut more, [0.0, 0.1, -x], 0.1, 0.9, [1.0; 3]);
        add(&mut more, [0.0, 0.1, 0.1], 0.1, 0.0039, [1.0; 3]);
    }
    let draw = |scene: &OwnedGaussians| {
        let mut rasteriser = Rasteriser::new(Level::detect());
        let found = bits(rasteriser.render(&scene.gaussians(), &VIEW, &request()));
        (found, rasteriser.work().culled)
    };
    let ((expected, before), (found, after)) = (draw(&scene), draw(&more));
    assert!(found == expected);
    assert_eq!(after - before, 1500);
}

/// A scene around a camera that sees a part of it: Gaussians far and near, large and small, turned, faint, huge, and
/// with NaN.
fn around(count: usize, seed: u64, wild: bool) -> Still {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut random = |from: f32, to: f32| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        from + (to - from) * ((state >> 40) as f32 / (1 << 24) as f32)
    };
    let mut still = Still { degree: 1, ..Still::default() };
    for _ in 0..count {
        let away = random(-2.0, 3.0).exp();
        still.mean.push([random(-1.0, 1.0) * away, random(-1.0, 1.0) * away, random(-1.0, 1.0) * away]);
        let large = if random(0.0, 1.0) < 0.1 { 1.0 } else { -4.0 };
        still.log_scale.push(std::array::from_fn(|_| large + random(-1.5, 1.5)));
        still.rotation.push(std::array::from_fn(|_| random(-1.0, 1.0)));
        still.logit.push(random(-7.0, 7.0));
        still.base.push(std::array::from_fn(|_| random(-1.0, 1.0)));
        still.higher.extend((0..9).map(|_| random(-0.5, 0.5)));
        if wild && random(0.0, 1.0) < 0.3 {
            let i = still.len() - 1;
            let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-30, 1e20, -3e38, 70.0, -90.0, 0.0];
            let value = odd[random(0.0, 8.999) as usize];
            match random(0.0, 6.999) as usize {
                0 => still.mean[i][i % 3] = value,
                1 => still.log_scale[i][i % 3] = value,
                2 => still.rotation[i][i % 4] = value,
                3 => still.rotation[i] = [value; 4],
                4 => still.logit[i] = value,
                5 => still.base[i][i % 3] = value,
                _ => still.higher[9 * i + i % 9] = value,
            }
        }
    }
    still
}

/// Cameras inside a scene, from very narrow to very wide.
fn narrow(seed: u64) -> Vec<(Camera, [usize; 2])> {
    let part = |n: u64| (seed.wrapping_mul(n) % 1009) as f64 / 1009.0;
    [(60.0, [64, 48]), (20.0, [48, 64]), (3.0, [33, 9]), (0.01, [16, 16]), (150.0, [40, 30])]
        .into_iter()
        .enumerate()
        .map(|(i, (degrees, size))| {
            let eye = [part(389 + i as u64) - 0.5, part(701) - 0.5, part(127) - 0.5].map(|x| x * 4.0);
            let target = [part(53), part(911 + i as u64) - 0.5, part(17) - 0.5];
            let pose = Pose::look_at(eye, target, [0.1, -1.0, 0.2]).expect("apart");
            let Some(Camera::Posed { pose, lens: Lens::Pinhole { focal, .. } }) = Camera::pinhole(pose, degrees, 1.3)
            else {
                panic!("a pinhole");
            };
            // Off the middle, and sometimes outside the image.
            let centre = [part(31) * 1.5 - 0.25, 0.4];
            (Camera::Posed { pose, lens: Lens::Pinhole { focal, centre } }, size)
        })
        .collect()
}

fn sized([width, height]: [usize; 2]) -> RenderOptions {
    let size = Size::Exact { width, height };
    RenderOptions { size, depth: true, alpha: true, statistics: true, ..RenderOptions::default() }
}

#[test]
fn gaussians_beside_a_still_image_are_counted_and_change_no_bit() {
    let workers = Workers::new(Level::detect(), 2).expect("threads start");
    let (mut left_out, mut culled) = ([0; 2], [0; 2]);
    for seed in 0..60 {
        let wild = seed % 2 == 1;
        let still = around(1500, seed, wild);
        let whole = Drawable::new(still, &workers).expect("even arrays");
        let grouped = whole.clone().grouped(&workers);
        for (camera, size) in narrow(seed) {
            let draw = |scene: &Drawable, camera: &Camera| {
                let mut renderer = Renderer::new(&workers);
                let image = renderer.render_still(scene, camera, &sized(size)).expect("a camera").clone();
                (image, renderer.work(), renderer.left_out())
            };
            let ((expected, all, none), (found, work, some)) = (draw(&whole, &camera), draw(&grouped, &camera));
            assert!(bits(&expected) == bits(&found) && expected.blended == found.blended, "{seed}: {camera:?}");
            assert_eq!((expected.dropped, all.gaussians, all.culled), (found.dropped, work.gaussians, work.culled));
            assert_eq!(none, 0);
            left_out[usize::from(wild)] += some;
            culled[usize::from(wild)] += work.culled;
            // An orthographic image is separable only if all Gaussians are.
            let Camera::Posed { pose, .. } = camera else { panic!("posed") };
            let lens = Lens::Orthographic { half_extent: Some([0.1; 2]) };
            let camera = Camera::Posed { pose, lens };
            let ((expected, ..), (found, _, some)) = (draw(&whole, &camera), draw(&grouped, &camera));
            assert!(bits(&expected) == bits(&found) && some == 0);
        }
    }
    // Nearly all before the projection, except for scenes with a third of unusual Gaussians.
    assert!(culled[0] > 100_000 && left_out[0] * 10 > culled[0] * 8, "{left_out:?} of {culled:?}");
    assert!(left_out[1] * 2 > culled[1], "{left_out:?} of {culled:?}");
}

#[test]
fn a_gaussian_beside_the_frustum_whose_footprint_reaches_the_image_is_drawn() {
    // 1.4 units to the side and one ahead, with a deviation of ⅓. Its centre is 54° from the axis of a camera that sees
    // 20°. Its affine footprint, formed at 15 % of the image's size beyond its edge, is 3.33/3·√(1 + 0.42²) = 1.2
    // tangents long.
    let one = |mean: [f32; 3]| Still {
        mean: vec![mean],
        log_scale: vec![[(1.0_f32 / 3.0).ln(); 3]],
        rotation: vec![[1.0, 0.0, 0.0, 0.0]],
        logit: vec![9.0],
        base: vec![[1.0; 3]],
        ..Still::default()
    };
    let workers = Workers::new(Level::detect(), 1).expect("one thread");
    let camera = Camera::pinhole(Pose::default(), 40.0, 1.0).expect("a camera");
    let draw = |mean: [f32; 3]| {
        let mut scene = one(mean);
        // Behind the camera, so that more than half can be left out.
        for _ in 0..9 {
            let behind = one([0.0, 0.0, -5.0]);
            scene.mean.extend(behind.mean);
            scene.log_scale.extend(behind.log_scale);
            scene.rotation.extend(behind.rotation);
            scene.logit.extend(behind.logit);
            scene.base.extend(behind.base);
        }
        let scene = Drawable::new(scene, &workers).expect("even arrays").grouped(&workers);
        let mut renderer = Renderer::new(&workers);
        let image = renderer.render_still(&scene, &camera, &sized([32, 32])).expect("a camera");
        let seen = image.alpha.iter().flatten().any(|a| *a > 0.0);
        (seen, renderer.left_out())
    };
    assert_eq!(draw([1.4, 0.0, 1.0]), (true, 9));
    assert_eq!(draw([10.0, 0.0, 1.5]), (false, 10));
}

#[test]
fn splats_behind_finished_pixels_are_counted_and_change_no_bit() {
    let mut scene = OwnedGaussians::default();
    (0..40).for_each(|i| add(&mut scene, [0.0, 0.0, 0.2 + 1e-3 * i as f32], 50.0, 0.95, [0.2, 0.4, 0.6]));
    let mut more = scene.clone();
    let behind = scattered(2000);
    for i in 0..2000 {
        let [x, y, z] = behind.mean[i];
        add(&mut more, [x, y, 1.0 + z], behind.scale[i][0], behind.opacity[i], behind.rgb[i]);
    }
    let draw = |scene: &OwnedGaussians| {
        let mut rasteriser = Rasteriser::new(Level::detect());
        let found = bits(rasteriser.render(&scene.gaussians(), &VIEW, &request()));
        (found, rasteriser.work())
    };
    let ((expected, before), (found, after)) = (draw(&scene), draw(&more));
    assert!(found == expected);
    let added = after.entries - before.entries;
    assert!(added > 2000 && after.entries_unseen - before.entries_unseen == added, "{after:?}");
}

#[test]
fn tiles_that_did_not_change_are_counted_and_keep_their_bits() {
    let mut scene = scattered(800);
    let mut rasteriser = Rasteriser::new(Level::detect());
    rasteriser.render(&scene.gaussians(), &VIEW, &request());
    add(&mut scene, [0.5, 0.5, 0.15], 0.02, 0.9, [1.0; 3]);
    // The same number of Gaussians: one replaces another.
    for plane in [&mut scene.mean, &mut scene.scale, &mut scene.rgb] {
        plane.swap_remove(7);
    }
    scene.opacity.swap_remove(7);
    let redrawn = bits(rasteriser.render(&scene.gaussians(), &VIEW, &request()));
    let work = rasteriser.work();
    assert!(work.tiles_drawn > 0 && work.tiles_drawn < work.tiles, "{work:?}");
    assert!(redrawn == bits(&render(Level::detect(), &scene.gaussians(), &VIEW, &request())));
}

#[test]
fn planes_nobody_asked_for_change_no_bit_of_those_that_were() {
    let scene = scattered(800);
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
    let scene = scattered(800);
    let expected = bits(&render(Level::detect(), &scene.gaussians(), &VIEW, &request()));
    let still = vec![[1.0, 0.0, 0.0, 0.0]; scene.mean.len()];
    let gaussians = Gaussians { rotation: Some(&still), ..scene.gaussians() };
    assert!(bits(&render(Level::detect(), &gaussians, &VIEW, &request())) == expected);
}

/// Patches of a frame through embedding, upsampler and head: their Gaussians' bits do not depend on which others are
/// computed.
#[test]
fn some_patches_of_a_frame_have_the_bits_of_all() {
    let levels = Level::available();
    for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
        for &level in &levels {
            let options = LoadOptions { level, precision, ..LoadOptions::default() };
            let network = Network::from_parts(EMBEDDED_CHECKPOINT, EMBEDDED_CONFIG, &options).expect("loads");
            let network = network.on_grid([5, 7]).expect("a part of its grid");
            let rgb: Vec<f32> = (0..3 * 40 * 56).map(|i| (i * 7919 % 1013) as f32 / 1012.0).collect();
            let frame = FrameInput { rgb: &rgb, depth: None };
            let mut session = network.session(None);
            assert!(session.computes_parts());
            let embedding = session.embed(&frame).expect("an embedding");
            let all = session.static_gaussians(&embedding, &Sampling::Mean).expect("Gaussians").gaussians;
            let every: Vec<u32> = (0..35).collect();
            for part in [&every, &vec![0], &vec![34], &vec![3, 4, 11, 20, 33], &every[7..28].to_vec()] {
                let h = session.embed_part(&frame, part).expect("rows").h;
                assert_eq!(h.len(), part.len() * network.config().hidden_dim);
                let tokens = session.upsample_static_part(&h, part).expect("tokens");
                assert_eq!(tokens.len(), 16 * part.len() * network.config().gaussian_dim());
                let some = session.static_head_part(&tokens, part).expect("Gaussians");
                assert_eq!(some.len(), all.len());
                for cell in 0..all.len() {
                    let patch = (cell / 28 / 4 * 7 + cell % 28 / 4) as u32;
                    let expected = if part.contains(&patch) { all.get(cell) } else { StaticGaussian::default() };
                    assert_eq!(some.get(cell), expected, "{level:?} {precision:?}: cell {cell} of {part:?}");
                }
            }
            assert!(session.embed_part(&frame, &[]).is_err(), "no patch");
            assert!(session.embed_part(&frame, &[35]).is_err(), "outside of the grid");
            assert!(session.embed_part(&frame, &[2, 2]).is_err(), "twice");
        }
    }
}

/// A frame of four times the model's area goes through it in nine tiles of 14×24 patches or less, which overlap. The
/// decoder reads every token of a tile.
#[test]
fn patches_in_an_overlap_are_computed_once() {
    let resolution = streamsplat::stream::Resolution::Exact([288, 512]);
    let rgb: Vec<f32> = (0..3 * 288 * 512).map(|i| (i * 7919 % 1013) as f32 / 1012.0).collect();
    let frame = || Frame { width: 512, height: 288, rgb: rgb.clone(), depth: None };
    let work = |fade: Fade| {
        let settings = Settings { resolution: Some(resolution), fade: Some(fade), ..Settings::default() };
        let mut engine = Engine::new(settings).expect("starts");
        let scene = engine.push(frame(), 0.0).expect("taken");
        let patches = *engine.work().stage("patches").expect("counted");
        engine.push(frame(), 1.0).expect("taken");
        let again = *engine.work().stage("patches").expect("counted");
        assert_eq!([again.done, again.avoided], [patches.done, 2 * patches.avoided + patches.done]);
        (scene, [patches.done, patches.avoided])
    };
    let (some, [done, avoided]) = work(Fade::Fixed);
    assert_eq!([done, done + avoided], [36 * 64, 40 * 68]);
    let (all, counted) = work(Fade::Network);
    assert_eq!(counted, [40 * 68, 0]);
    assert!(some.gaussians.mean == all.gaussians.mean && some.gaussians.rgb == all.gaussians.rgb);
}

/// Windows of the upsampler mix patches, and a cache needs all of them: then everything is computed.
#[test]
fn networks_that_mix_patches_compute_all_of_them() {
    let network = Network::open(checkpoint("tiny-nodino.safetensors"), &LoadOptions::default()).expect("loads");
    let [height, width] = network.config().resolution;
    let rgb: Vec<f32> = (0..3 * height * width).map(|i| (i % 251) as f32 / 251.0).collect();
    let frame = FrameInput { rgb: &rgb, depth: None };
    for saving in [None, Some(Saving::Within(0.02))] {
        let [mut all, mut some] = [saving; 2].map(|saving| network.session(saving));
        assert!(!some.computes_parts());
        let embedding = all.embed(&frame).expect("an embedding");
        let expected = all.static_gaussians(&embedding, &Sampling::Mean).expect("Gaussians").gaussians;
        let h = some.embed_part(&frame, &[1]).expect("an embedding").h;
        let tokens = some.upsample_static_part(&h, &[1]).expect("tokens");
        assert!(some.static_head_part(&tokens, &[1]).expect("Gaussians") == expected);
    }
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
    let [a, b] = [&mapped, &read].map(|network| network.session(None).embed(&input).expect("embeds").h);
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
    // The small checkpoint has such branches: the static upsampler's attention, half of the decoder, all of the
    // deformation upsampler's.
    let run = |reuse| {
        let mut engine =
            Engine::new(Settings { reuse, fade: Some(Fade::Network), ..Settings::default() }).expect("starts");
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
    assert_eq!(count("encoder.branches"), Some((6, 0)));
    assert_eq!(count("upsampler.branches"), Some((12, 44)));
    assert_eq!(count("decoder.branches"), Some((6, 6)));
    assert!(off.work().stages().iter().all(|stage| !stage.stage.ends_with(".branches")));
}

#[test]
fn depth_that_is_not_there_is_depth_of_zero() {
    // A constant map is normalised to zero.
    let ((with, _), (without, engine)) = (stream(None, Some(0.7)), stream(None, None));
    assert_eq!(gaussians(&with), gaussians(&without));
    assert_eq!(engine.work().stage("encoder").map(|s| s.done), Some(3));
    let draw =
        |i: &Interval| i.render(i.end, &Camera::Canonical, &RenderOptions::default(), engine.workers()).expect("drawn");
    assert_eq!(draw(&with[2]), draw(&without[2]));
}
