//! The compressed scene: its size, the closeness of its images, and that identities and tracks survive.

use std::path::Path;

use streamsplat::fit::Placement;
use streamsplat::metrics::psnr;
use streamsplat::picture::Picture;
use streamsplat::scene::{ContainerWriter, Scene, to_safetensors};
use streamsplat::source::{Options, Source};
use streamsplat::stream::{Handover, Interval, Merge, Record, Reference};
use streamsplat::track::Track;
use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};
use streamsplat_tests::workers;

/// The stored container, in the fixtures.
const STORED: &str = "containers/version-1.ssz";

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

/// Two intervals of invented Gaussians: a sheet that moves to the right, with colours that change. The second interval
/// has those of the first, which leave, and others, two thirds of which continue them.
fn sheet() -> Vec<Interval> {
    let noise = |seed: u64| (seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f32 / (1 << 24) as f32;
    let record = |frame: u64, cell: u64| {
        let (x, z) = ((cell % 40) as f32 * 0.05 - 0.975, (cell / 40) as f32 * 0.0625 - 0.71875);
        let grain = noise(frame * 1000 + cell);
        let continues = !cell.is_multiple_of(3);
        Record {
            mean: [x + 0.01 * grain, 0.25 + 0.01 * (x + grain), z],
            velocity: [0.05, 0.01 * grain, 0.0],
            gamma: [4.0 + grain, 1.0],
            opacity: 0.7 + 0.25 * grain,
            scale: [0.03 + 0.01 * grain, 0.03],
            thickness: 0.5 + (cell % 5) as f32 * 0.25,
            rgb: [0.5 + 0.4 * x, 0.5 - 0.4 * z, 0.3 + 0.2 * grain],
            rgb_rate: [0.4 * x + 0.05 * grain, 0.3 * x * z, 0.3 * z],
            identity: if continues { cell } else { frame * 960 + cell },
            birth: if continues { 0 } else { frame },
            frame,
            offset: [0.002 * grain, 0.0, -0.001],
            reference: Reference::End,
            handover: Handover::Arrives,
        }
    };
    let leaving = |cell| Record { reference: Reference::Start, handover: Handover::Leaves, ..record(0, cell) };
    let placement = Placement { source: [144, 256], model: [288, 512], offset: [0, 0], content: [288, 512] };
    let first = Interval {
        index: 0,
        start: 0.0,
        end: 0.0,
        gaussians: (0..960).map(|cell| record(0, cell)).collect(),
        placement,
        merges: Vec::new(),
        dropped: 0,
    };
    let second = Interval {
        index: 1,
        end: 1.0 / 24.0,
        gaussians: (0..960).map(leaving).chain((0..960).map(|cell| record(1, cell))).collect(),
        merges: vec![Merge { identity: 0, into: 960 }, Merge { identity: 3, into: 963 }],
        dropped: 2,
        ..first.clone()
    };
    vec![first, second]
}

/// Writes [`sheet`], with a frame between its key frames that does not follow from the rate.
fn write_sheet(path: &Path) {
    let mut writer = ContainerWriter::create(path, 24.0).expect("writable");
    for (interval, frames) in sheet().iter().zip([&[0.0][..], &[0.01, 1.0 / 24.0]]) {
        writer.push_with(interval, frames, workers()).expect("writable");
    }
    writer.finish().expect("writable").expect("intervals");
}

#[test]
fn the_stored_container_is_what_is_written() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    write_sheet(&path);
    let stored = std::fs::read(streamsplat_fixtures::path(STORED)).expect("stored");
    assert!(std::fs::read(&path).expect("just written") == stored);
}

#[test]
fn the_stored_container_reads_back() {
    let scene = Scene::open(&streamsplat_fixtures::path(STORED)).expect("a container");
    assert_eq!((scene.index().version, scene.index().frames()), (1, Some(vec![0.0, 0.01, 1.0 / 24.0])));
    for (i, expected) in sheet().iter().enumerate() {
        let found = scene.interval(i).expect("sound");
        assert_eq!((&found.merges, found.dropped, found.index), (&expected.merges, expected.dropped, expected.index));
        let (found, expected) = (found.gaussians, &expected.gaussians);
        assert_eq!((&found.identity, &found.birth), (&expected.identity, &expected.birth));
        let furthest = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        for (steps, most, a, b) in [
            (2048.0, 0.501, found.mean.as_flattened(), expected.mean.as_flattened()),
            (1024.0, 0.501, found.velocity.as_flattened(), expected.velocity.as_flattened()),
            (128.0, 0.501, found.rgb.as_flattened(), expected.rgb.as_flattened()),
            (16.0, 0.651, found.rgb_rate.as_flattened(), expected.rgb_rate.as_flattened()),
        ] {
            let furthest = furthest(a, b) * steps;
            assert!((0.1..most).contains(&furthest), "{furthest} of a step of 1/{steps}");
        }
        let octaves = |values: &[f32]| values.iter().map(|value| value.log2()).collect::<Vec<_>>();
        for (steps, a, b) in [(8.0, &found.thickness, &expected.thickness), (16.0, &found.opacity, &expected.opacity)] {
            let furthest = furthest(&octaves(a), &octaves(b));
            assert!(furthest < 0.501 / steps, "{furthest}");
        }
    }
}

#[test]
#[ignore = "writes the stored container: cargo test --release -p streamsplat-tests --test contracts container:: -- --ignored"]
fn store_the_container() {
    write_sheet(&streamsplat_fixtures::path(STORED));
}

#[test]
fn the_shipped_clip_is_seventeen_times_smaller_at_47_db_and_keeps_its_tracks() {
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
    assert!(ratio >= 17.0, "{before} bytes to {bytes}: {ratio:.2}");
    assert!(worst >= 47.0, "{worst} dB");

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
