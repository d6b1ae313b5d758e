//! The compressed scene: its size, the closeness of its images, and that identities and tracks survive.

use std::path::Path;

use streamsplat::metrics::psnr;
use streamsplat::picture::Picture;
use streamsplat::scene::{ContainerWriter, Scene, to_safetensors};
use streamsplat::source::{Options, Source};
use streamsplat::stream::Interval;
use streamsplat::track::Track;
use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};
use streamsplat_tests::workers;

/// The scene of the shipped clip, every fourth frame a key frame.
fn scene() -> Vec<Interval> {
    let path = streamsplat_fixtures::path("clips/moving.y4m");
    let mut engine = Engine::new(Settings::default()).expect("an engine");
    let mut intervals = Vec::new();
    for (k, frame) in frames(&path).into_iter().enumerate().step_by(4) {
        intervals.push(engine.push(frame, k as f64 / 24.0).expect("an interval"));
    }
    intervals
}

fn frames(path: &Path) -> Vec<Frame> {
    let mut source = Source::open(path, &Options::default()).expect("the shipped clip");
    std::iter::from_fn(move || source.next_frame().expect("a sound frame"))
        .map(|f| Frame { width: f.picture.width, height: f.picture.height, rgb: f.picture.rgb, depth: None })
        .collect()
}

fn picture(interval: &Interval, time: f64) -> Picture {
    let image = interval.render(time, &Camera::Canonical, &RenderOptions::default(), workers()).expect("an image");
    Picture { width: image.width, height: image.height, rgb: image.rgb }
}

/// Plausible changes of colour: smooth in space, with some grain; those of survivors stay zero.
fn recoloured(interval: &Interval) -> Interval {
    let mut out = interval.clone();
    let g = &mut out.gaussians;
    for (i, rate) in g.rgb_rate.iter_mut().enumerate() {
        let [x, _, z] = g.mean[i];
        let grain = (g.identity[i].wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as f32 / 2560.0 - 0.05;
        if g.frame[i] + 1 >= out.index {
            *rate = [0.15 * x + grain, 0.1 * x * z - grain, 0.1 * z];
        }
    }
    out
}

/// Bytes of the folder's intervals and of the container, and the PSNR of the worst of its images at five times of every
/// interval.
fn cost(raw: &[Interval], path: &Path) -> (usize, u64, f64) {
    let mut writer = ContainerWriter::create(path, 24.0).expect("writable");
    raw.iter().for_each(|interval| writer.push(interval, workers()).expect("writable"));
    let bytes = writer.finish().expect("writable").expect("intervals").bytes;
    let before = raw.iter().map(|interval| to_safetensors(interval).expect("even arrays").len()).sum();
    let scene = Scene::open(path).expect("just written");
    let mut worst = f64::INFINITY;
    for (i, a) in raw.iter().enumerate() {
        let b = scene.interval(i).expect("just written");
        for t in [0.0, 0.25, 0.5, 0.75, 1.0] {
            let time = a.start + t * (a.end - a.start);
            worst = worst.min(psnr(&picture(a, time), &picture(&b, time)).expect("equal sizes"));
        }
    }
    (before, bytes, worst)
}

#[test]
fn colours_that_change_cost_little_and_keep_45_db() {
    let raw = scene();
    let changing: Vec<Interval> = raw.iter().map(recoloured).collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (before, bytes, _) = cost(&raw, &folder.path().join("still.ssz"));
    let (more_before, more_bytes, worst) = cost(&changing, &folder.path().join("changing.ssz"));
    println!("folder {before} to {more_before}, container {bytes} to {more_bytes} bytes, {worst:.2} dB at the worst");
    assert!(worst >= 45.0, "{worst} dB");
    assert!((more_bytes as f64) < 1.3 * bytes as f64, "{bytes} to {more_bytes}");
}

/// The intervals of the stored container of version 1, with colours that change.
fn version_2() -> Vec<Interval> {
    let scene = Scene::open(&streamsplat_fixtures::path("containers/version-1.ssz")).expect("a container");
    (0..2).map(|i| recoloured(&scene.interval(i).expect("sound"))).collect()
}

/// The intervals of [`version_2`], with some Gaussians thinner or thicker.
fn version_3() -> Vec<Interval> {
    let mut intervals = version_2();
    for gaussians in intervals.iter_mut().map(|interval| &mut interval.gaussians) {
        for (thickness, identity) in gaussians.thickness.iter_mut().zip(&gaussians.identity) {
            *thickness = 0.5 + (identity % 5) as f32 * 0.25;
        }
    }
    intervals
}

fn write_version_3(path: &Path) {
    let mut writer = ContainerWriter::create(path, 24.0).expect("writable");
    version_3().iter().for_each(|interval| writer.push(interval, workers()).expect("writable"));
    writer.finish().expect("writable").expect("intervals");
}

#[test]
fn the_stored_container_of_version_3_is_what_is_written() {
    let stored = streamsplat_fixtures::path("containers/version-3.ssz");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    write_version_3(&path);
    assert!(std::fs::read(&path).expect("just written") == std::fs::read(&stored).expect("stored"));
}

#[test]
fn stored_containers_read_back() {
    for (version, intervals) in [(2, version_2()), (3, version_3())] {
        let stored = streamsplat_fixtures::path(&format!("containers/version-{version}.ssz"));
        let scene = Scene::open(&stored).expect("a container");
        assert_eq!(scene.index().version, version);
        for (i, expected) in intervals.iter().enumerate() {
            let found = scene.interval(i).expect("sound").gaussians;
            assert_eq!((&found.mean, &found.rgb, &found.identity), {
                let g = &expected.gaussians;
                (&g.mean, &g.rgb, &g.identity)
            });
            let rates = found.rgb_rate.as_flattened().iter().zip(expected.gaussians.rgb_rate.as_flattened());
            let furthest = rates.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!((1e-4..0.501 / 255.0).contains(&furthest), "{furthest}");
            let thickness = found.thickness.iter().zip(&expected.gaussians.thickness);
            let furthest = thickness.map(|(a, b)| (a.log2() - b.log2()).abs()).fold(0.0, f32::max);
            assert!(furthest < 0.501 / 64.0, "{furthest}");
        }
    }
}

#[test]
#[ignore = "writes the stored container: cargo test --release -p streamsplat-tests --test container -- --ignored"]
fn store_the_container_of_version_3() {
    write_version_3(&streamsplat_fixtures::path("containers/version-3.ssz"));
}

#[test]
fn the_shipped_clip_is_eight_times_smaller_at_45_db_and_keeps_its_tracks() {
    let raw = scene();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let mut writer = ContainerWriter::create(&path, 24.0).expect("writable");
    raw.iter().for_each(|interval| writer.push(interval, workers()).expect("writable"));
    let bytes = writer.finish().expect("writable").expect("intervals").bytes;
    let before: usize = raw.iter().map(|interval| to_safetensors(interval).expect("even arrays").len()).sum();
    let ratio = before as f64 / bytes as f64;

    let scene = Scene::open(&path).expect("just written");
    let read: Vec<Interval> = (0..raw.len()).map(|i| scene.interval(i).expect("just written")).collect();
    let mut worst = f64::INFINITY;
    for (a, b) in raw.iter().zip(&read) {
        assert_eq!(a.gaussians.identity, b.gaussians.identity);
        assert_eq!(a.gaussians.birth, b.gaussians.birth);
        assert_eq!((&a.merges, a.start, a.end), (&b.merges, b.start, b.end));
        for t in [0.0, 0.25, 0.5, 0.75, 1.0] {
            let time = a.start + t * (a.end - a.start);
            worst = worst.min(psnr(&picture(a, time), &picture(b, time)).expect("equal sizes"));
        }
    }
    println!("{before} bytes to {bytes}: {ratio:.2} times smaller, {worst:.2} dB at the worst");
    assert!(ratio >= 8.0, "{before} bytes to {bytes}: {ratio:.2}");
    assert!(worst >= 45.0, "{worst} dB");

    for pixel in [[64.0, 40.0], [128.0, 72.0], [200.0, 100.0]] {
        let time = 0.5 * (raw[1].start + raw[1].end);
        let picked = raw[1].pick(time, pixel, workers()).expect("inside").expect("something is drawn");
        let (mut a, mut b) = (Track::new(&picked, time), Track::new(&picked, time));
        for (raw, read) in raw.iter().zip(&read).skip(1) {
            let times = [0.5 * (raw.start + raw.end)];
            let (Some((points, next)), Some((others, other))) = (a.forward(raw, &times), b.forward(read, &times))
            else {
                panic!("both go on to the clip's end");
            };
            for (p, q) in points.iter().zip(&others) {
                assert_eq!((p.identity, p.time), (q.identity, q.time));
                let away = (0..2).map(|i| (p.pixel[i] - q.pixel[i]).abs()).fold(0.0, f64::max);
                assert!(away < 0.2, "{away} pixels");
            }
            (a, b) = (next, other);
        }
    }
}
