//! The compressed scene: how much smaller it is, how close its images are, and that identities and tracks survive.

use std::path::Path;

use streamsplat::metrics::psnr;
use streamsplat::picture::Picture;
use streamsplat::scene::{ContainerWriter, Scene, to_safetensors};
use streamsplat::source::{Options, Source};
use streamsplat::stream::{Interval, Track};
use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};

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
    let image = interval.render(time, &Camera::Canonical, &RenderOptions::default()).expect("an image");
    Picture { width: image.width, height: image.height, rgb: image.rgb }
}

#[test]
fn the_shipped_clip_is_eight_times_smaller_at_45_db_and_keeps_its_tracks() {
    let raw = scene();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ssz");
    let mut writer = ContainerWriter::create(&path, 24.0).expect("writable");
    raw.iter().for_each(|interval| writer.push(interval).expect("writable"));
    let bytes = writer.finish().expect("writable").expect("intervals").bytes;
    let before: usize = raw.iter().map(|interval| to_safetensors(interval).expect("even arrays").len()).sum();
    let ratio = before as f64 / bytes as f64;

    let scene = Scene::open(&path).expect("just written");
    let read: Vec<Interval> =
        (0..raw.len()).map(|i| scene.interval(i, &raw[0].workers).expect("just written")).collect();
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
        let picked = raw[1].pick(time, pixel).expect("inside").expect("something is drawn");
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
