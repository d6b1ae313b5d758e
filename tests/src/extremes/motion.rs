//! Intervals of every length, and invalid time stamps.

use std::io::Write;
use std::sync::Arc;

use streamsplat::source::{Options, Source};
use streamsplat::stream::{Fusion, ModelSource, Reconstructor};
use streamsplat::{Camera, Engine, EngineError, RenderOptions, Settings};

use super::{Case, Computed, Judged, Place, Unit};
use crate::theatre::Theatre;

const GROUP: &str = "Time";
const FRAMES: usize = 6;

fn engine(place: Place, fusion: Fusion) -> (Engine, Arc<Theatre>) {
    let theatre = Arc::new(Theatre::new([6, 10]));
    let model: Arc<dyn Reconstructor> = theatre.clone();
    let level = Some(place.level);
    let settings =
        Settings { fusion, level, threads: place.threads, ..Settings::with_model(ModelSource::Shared(model)) };
    (Engine::new(settings).expect("starts"), theatre)
}

/// The images of all intervals at five times each, then the velocities; and the number of dropped or invalid records.
fn stream(place: Place, fusion: Fusion, times: &[f64]) -> Computed {
    let (mut engine, theatre) = engine(place, fusion);
    let (mut values, mut rest) = (Vec::new(), Vec::new());
    for (k, time) in times.iter().enumerate() {
        let interval = engine.push(theatre.frame(0.15 * k as f32 - 0.5), *time).expect("ascending times");
        let unsound = interval.gaussians.iter().filter(|r| !r.is_sound()).count();
        rest.extend([interval.dropped, unsound as u64]);
        for part in [0.0, 0.25, 0.5, 0.75, 1.0] {
            let time = interval.start + part * (interval.end - interval.start);
            let image = interval.render(
                time.clamp(interval.start, interval.end),
                &Camera::Canonical,
                &RenderOptions::default(),
                engine.workers(),
            );
            values.extend(image.expect("inside the interval").rgb);
        }
    }
    Computed::with(&values, rest)
}

/// Images equal those of a stream whose intervals last a second: the scene does not depend on the length of time.
fn steady(name: &str, fusion: Fusion, start: f64, length: f64) -> Case {
    let times = move |start: f64, length: f64| (0..FRAMES).map(|k| start + length * k as f64).collect::<Vec<_>>();
    Case::new(
        GROUP,
        format!("{name}, {fusion}"),
        move |place| stream(place, fusion, &times(start, length)),
        move |found| {
            let place = Place { level: streamsplat_kernels::Level::scalar(), threads: 1, form: super::Form::Short };
            let second = stream(place, fusion, &times(0.0, 1.0));
            Judged::of(Unit::Absolute, &found.values, second.values)
                .and(found.rest.iter().all(|n| *n == 0), || "records were dropped or are not sound".into())
        },
    )
}

/// Lengths that change by eighteen orders of magnitude from one interval to the next: survivors' velocities stay
/// finite.
fn stiff(fusion: Fusion) -> Case {
    let times = [0.0, 1e-9, 1e9, 1e9 + 1e-6, 2e9, 2e9 + 1.0, 3e9];
    Case::new(
        GROUP,
        format!("lengths of 1e-9 s and 1e9 s in turn, {fusion}"),
        move |place| stream(place, fusion, &times),
        |found| {
            let outside = found.values.iter().filter(|v| !(-1e-6..=1.000_001).contains(*v)).count();
            Judged { ours: 0.0, exact: 0.0, ..Judged::new(Unit::Absolute) }
                .and(outside == 0, || format!("{outside} values of images are not in [0, 1]"))
                .and(found.rest.iter().all(|n| *n == 0), || "records were dropped or are not sound".into())
        },
    )
}

/// Refused time stamps; the stream then continues unchanged.
fn refused() -> Case {
    let bad = [0.5, 0.4, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    Case::new(
        GROUP,
        "equal, decreasing, NaN and infinite time stamps: an error each, and the stream as before",
        move |place| {
            let (mut engine, theatre) = engine(place, Fusion::Persistent);
            let (mut untouched, _) = self::engine(place, Fusion::Persistent);
            let mut refused = 0;
            for engine in [&mut engine, &mut untouched] {
                engine.push(theatre.frame(0.1), 0.5).expect("taken");
            }
            for time in bad {
                let answer = engine.push(theatre.frame(0.2), time);
                refused += u64::from(matches!(answer, Err(EngineError::Time { index: 1, after: Some(0.5), .. })));
            }
            let [a, b] = [&mut engine, &mut untouched].map(|e| e.push(theatre.frame(0.2), 1.0).expect("taken"));
            Computed::with(a.gaussians.mean.as_flattened(), [refused, u64::from(a.gaussians == b.gaussians)])
        },
        move |found| {
            Judged { ours: found.rest[0] as f64, exact: bad.len() as f64, ..Judged::new(Unit::Absolute) }
                .and(found.rest == [bad.len() as u64, 1], || format!("refused, equal: {:?}", found.rest))
        },
    )
}

/// A stream without a frame rate: frames are taken as 24 per second.
fn missing() -> Case {
    Case::new(
        GROUP,
        "a stream without time stamps (y4m, F0:0): 1/24 s apart",
        |_| {
            let mut file = tempfile::Builder::new().suffix(".y4m").tempfile().expect("a file");
            file.write_all(b"YUV4MPEG2 W1 H1 F0:0 Cmono\n").expect("written");
            (0..50).for_each(|_| file.write_all(b"FRAME\nx").expect("written"));
            let mut source = Source::open(file.path(), &Options::default()).expect("a stream");
            let mut times = Computed::default();
            while let Some(frame) = source.next_frame().expect("a frame") {
                times.values.push(frame.timestamp);
            }
            times
        },
        |found| {
            Judged::of(Unit::Absolute, &found.values, (0..50).map(|i| f64::from(i) / 24.0))
                .and(found.values.windows(2).all(|t| t[0] < t[1]), || "time stamps do not ascend".into())
        },
    )
}

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for fusion in [Fusion::Pairwise, Fusion::Persistent] {
        cases.extend([
            steady("intervals of 1e-9 s", fusion, 0.0, 1e-9),
            steady("intervals of 1e-9 s after 1e3 s", fusion, 1e3, 1e-9),
            steady("intervals of 1e9 s", fusion, -5e9, 1e9),
            steady("intervals of 3e307 s", fusion, -1.5e308, 0.3e308),
            stiff(fusion),
        ]);
    }
    cases.extend([refused(), missing()]);
    cases
}
