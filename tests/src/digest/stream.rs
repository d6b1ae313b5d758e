//! A short stream: video in, dynamic Gaussians and images out.

use streamsplat::camera::{Camera, Pose, Rotation};
use streamsplat::scene::{ContainerWriter, intervals_from_container};
use streamsplat::stream::{
    DynamicGaussians, Fusion, ModelSource, MotionFrom, Numbers, Quality, Resolution, SamplingMode,
};
use streamsplat::{Engine, Frame, Interval, RenderOptions, Settings};
use streamsplat_fixtures::clip::{Clip, ClipKind};
use streamsplat_kernels::Level;

use super::{Digest, Thing, splats};

pub(super) fn things() -> Vec<Thing> {
    vec![
        Thing::new("stream/persistent", |level, digest| {
            stream(level, digest, "tiny-nodino", &Settings { fusion: Fusion::Persistent, ..Settings::default() });
        }),
        Thing::new("stream/pairwise", |level, digest| {
            stream(level, digest, "tiny-nodino", &Settings { fusion: Fusion::Pairwise, ..Settings::default() });
        }),
        Thing::new("stream/sampled", |level, digest| {
            let settings = Settings { sampling: SamplingMode::Sample, seed: 5, ..Settings::default() };
            stream(level, digest, "tiny-sampled", &settings);
        }),
        Thing::new("stream/container", container),
        // Tiles that overlap, since this model does not take a part of its grid.
        Thing::new("stream/tiles-motion-colours", |level, digest| {
            let checkpoint = streamsplat_fixtures::path("parity/tiny-nodino.safetensors");
            let settings = Settings {
                resolution: Some(Resolution::Exact([72, 120])),
                motion: Some(MotionFrom::Between),
                refine: Some(3),
                ..Settings::with_model(ModelSource::File { checkpoint, dinov2: None })
            };
            seen(level, digest, &settings, [120, 72], None);
        }),
        // A grid of the source's shape, smaller than the model's.
        Thing::new("stream/embedded-frames", |level, digest| {
            let settings = Settings { motion: Some(MotionFrom::Frames), refine: Some(2), ..Settings::default() };
            seen(level, digest, &settings, [80, 48], None);
        }),
        // Lifted to the depth of the clip, and to the depth that is found in it.
        Thing::new("stream/embedded-given-depth", |level, digest| {
            let settings = Settings { motion: Some(MotionFrom::Frames), refine: Some(2), ..Settings::default() };
            seen(level, digest, &settings, [80, 48], Some(Depth::Given));
        }),
        Thing::new("stream/embedded-found-depth", |level, digest| {
            let settings = Settings { motion: Some(MotionFrom::Frames), refine: Some(2), ..Settings::default() };
            seen(level, digest, &settings, [160, 96], Some(Depth::Found));
        }),
        // Without the dynamic half, colours fitted to every second frame, products of bytes.
        Thing::new("stream/embedded-realtime", |level, digest| {
            seen(level, digest, &Settings::of_quality(Quality::Realtime), [80, 48], None);
        }),
        Thing::new("stream/embedded-static", static_camera),
    ]
}

/// Depth to which Gaussians are lifted.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Depth {
    Given,
    Found,
}

/// Three key frames, with two frames between each pair passed to the engine.
fn seen(level: Level, digest: &mut Digest, settings: &Settings, [width, height]: [usize; 2], depth: Option<Depth>) {
    let settings = Settings {
        level: Some(level),
        threads: rayon::current_num_threads(),
        find_depth: Some(depth == Some(Depth::Found)),
        ..settings.clone()
    };
    let mut engine = Engine::new(settings).expect("an engine");
    let clip = Clip::new(ClipKind::Moving, 4, width, height);
    let frame = |k: usize| {
        let time = 0.05 * k as f64;
        let picture = clip.picture(time);
        let given = (depth == Some(Depth::Given)).then_some(picture.inverse_depth);
        (Frame { width: picture.width, height: picture.height, rgb: picture.rgb, depth: given }, time)
    };
    for k in [0, 3, 6] {
        let (key, time) = frame(k);
        let between = (k.saturating_sub(2)..k).map(frame).collect();
        let interval = engine.push_with(between, key, time).expect("an interval");
        let found = engine.resume_point().is_some_and(|point| point.found.is_some());
        assert_eq!(found, depth == Some(Depth::Found) && k > 0, "depth found for key frame {k}");
        records(digest, &interval);
        interval.gaussians.rgb_rate.iter().for_each(|rate| digest.floats(rate));
        for at in [0.0, 0.4] {
            let at = interval.start + (interval.end - interval.start) * at;
            splats::add(
                digest,
                &interval
                    .render(at, &Camera::Canonical, &RenderOptions::default(), engine.workers())
                    .expect("an image"),
            );
        }
    }
}

/// Three key frames of a static camera with a square that moves, with five frames between each pair.
fn static_camera(level: Level, digest: &mut Digest) {
    let quality = Settings::of_quality(Quality::Balanced);
    let settings = Settings { level: Some(level), threads: rayon::current_num_threads(), ..quality };
    let mut engine = Engine::new(settings).expect("an engine");
    let [width, height] = [80, 48];
    let room = Clip::new(ClipKind::Moving, 4, width, height).picture(0.0).rgb;
    let frame = |k: usize| {
        let mut rgb = room.clone();
        for plane in rgb.chunks_exact_mut(width * height) {
            plane.chunks_exact_mut(width).skip(16).take(16).for_each(|row| row[4 * k..4 * k + 16].fill(0.9));
        }
        (Frame { width, height, rgb, depth: None }, 0.05 * k as f64)
    };
    for k in [0, 6, 12] {
        let (key, time) = frame(k);
        let between = (k.saturating_sub(5)..k).map(frame).collect();
        let interval = engine.push_with(between, key, time).expect("an interval");
        records(digest, &interval);
        interval.gaussians.rgb_rate.iter().for_each(|rate| digest.floats(rate));
    }
    let still = engine.work().stage("still").expect("counted");
    assert!(still.avoided > 0, "the camera is static: {still:?}");
}

/// Three key frames as a compressed scene: its bytes, and the scene read from them.
fn container(level: Level, digest: &mut Digest) {
    let checkpoint = streamsplat_fixtures::path("parity/tiny-nodino.safetensors");
    let settings = Settings {
        level: Some(level),
        threads: rayon::current_num_threads(),
        ..Settings::with_model(ModelSource::File { checkpoint, dinov2: None })
    };
    let mut engine = Engine::new(settings).expect("an engine");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let mut writer = ContainerWriter::create(&path, 8.0).expect("writable");
    let clip = Clip::new(ClipKind::Moving, 4, 40, 24);
    for time in [0.0, 0.125, 0.25] {
        let picture = clip.picture(time);
        let frame = Frame { width: picture.width, height: picture.height, rgb: picture.rgb, depth: None };
        writer.push(&engine.push(frame, time).expect("an interval"), engine.workers()).expect("writable");
    }
    writer.finish().expect("writable");
    let bytes = std::fs::read(&path).expect("just written");
    digest.integers(bytes.iter().map(|byte| u64::from(*byte)));
    for interval in intervals_from_container(&bytes).expect("a scene") {
        records(digest, &interval);
    }
}

/// Three key frames with depth, letterboxed into the model's input; every record and several images of each interval.
fn stream(level: Level, digest: &mut Digest, model: &str, settings: &Settings) {
    let checkpoint = streamsplat_fixtures::path(&format!("parity/{model}.safetensors"));
    let settings = Settings {
        model: ModelSource::File { checkpoint, dinov2: None },
        level: Some(level),
        threads: rayon::current_num_threads(),
        ..settings.clone()
    };
    let mut engine = Engine::new(settings).expect("an engine");
    let clip = Clip::new(ClipKind::Moving, 4, 61, 53);
    for time in [0.0, 0.3, 0.5] {
        let picture = clip.picture(time);
        let depth = Some(picture.inverse_depth);
        let frame = Frame { width: picture.width, height: picture.height, rgb: picture.rgb, depth };
        let interval = engine.push(frame, time).expect("an interval");
        records(digest, &interval);
        let pose = Pose {
            rotation: Rotation::from_quaternion([1.0, 0.05, -0.1, 0.02]).expect("a rotation"),
            ..Pose::default()
        };
        let pinhole = Camera::pinhole(pose, 60.0, 64.0 / 48.0).expect("a camera");
        let options = RenderOptions { depth: true, alpha: true, statistics: true, ..RenderOptions::default() };
        for (at, camera) in [(0.0, Camera::Canonical), (0.4, Camera::Canonical), (1.0, pinhole)] {
            let at = interval.start + (interval.end - interval.start) * at;
            splats::add(digest, &interval.render(at, &camera, &options, engine.workers()).expect("an image"));
        }
    }
}

fn records(digest: &mut Digest, interval: &Interval) {
    digest.doubles(&[interval.start, interval.end]);
    for r in interval.gaussians.iter() {
        digest.integers([r.identity, r.birth]);
        digest.floats(r.mean.as_slice());
        digest.floats(r.velocity.as_slice());
        digest.floats(&[r.gamma[0], r.gamma[1], r.opacity, r.scale[0], r.scale[1]]);
        digest.floats(r.rgb.as_slice());
        // Properties that were added later, where they are not their default.
        let one: DynamicGaussians = [r].into_iter().collect();
        for column in one.columns().iter().filter(|column| column.default.is_some() && !column.is_default()) {
            match &column.numbers {
                Numbers::Floats(numbers) => digest.floats(numbers),
                Numbers::Words(numbers) => digest.integers(numbers.iter().copied()),
                Numbers::Codes(codes) => digest.integers(codes.iter().map(|code| u64::from(*code))),
            }
        }
    }
}
