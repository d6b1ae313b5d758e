//! Tests that refused calls leave a stream unchanged.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use streamsplat::stream::{
    DepthRange, Fade, Fusion, ModelSource, Motion, MotionFrom, Reconstructor, Resolution, Session, StaticRegions,
    Tiling,
};
use streamsplat::{Engine, EngineError, Frame, Interval, Settings};
use streamsplat_model::reuse::{Saving, Tokens};
use streamsplat_model::zero_output::ZeroOutput;
use streamsplat_model::{Embedding, FrameInput, ModelError, Sampling, Side, StaticGaussians};
use streamsplat_tests::theatre::Theatre;

fn engine(theatre: Theatre) -> (Engine, Arc<Theatre>) {
    let theatre = Arc::new(theatre);
    let model: Arc<dyn Reconstructor> = theatre.clone();
    let settings = Settings { threads: 1, ..Settings::with_model(ModelSource::Shared(model)) };
    (Engine::new(settings).expect("starts"), theatre)
}

#[test]
fn bad_frames_and_times_are_refused_and_leave_the_stream_as_it_was() {
    let (mut engine, theatre) = engine(Theatre::new([6, 10]));
    let (mut untouched, _) = self::engine(Theatre::new([6, 10]));
    let good = theatre.frame(0.1);
    let change = |f: &dyn Fn(&mut Frame)| {
        let mut frame = good.clone();
        f(&mut frame);
        frame
    };
    assert!(matches!(engine.push(Frame::default(), 0.0), Err(EngineError::Empty { index: 0, .. })));
    engine.push(good.clone(), 0.5).expect("taken");
    untouched.push(good.clone(), 0.5).expect("taken");

    for time in [0.5, 0.4, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert!(matches!(engine.push(good.clone(), time), Err(EngineError::Time { index: 1, after: Some(0.5), .. })));
    }
    let short = change(&|f| {
        f.rgb.pop();
    });
    assert!(matches!(engine.push(short, 1.0), Err(EngineError::Length { what: "rgb", .. })));
    let depth = change(&|f| f.depth = Some(vec![0.0; 3]));
    assert!(matches!(engine.push(depth, 1.0), Err(EngineError::Length { what: "depth", found: 3, .. })));
    let nan = change(&|f| f.rgb[77] = f32::NAN);
    assert!(matches!(engine.push(nan, 1.0), Err(EngineError::NonFinite { position: 77, .. })));
    let other = Frame { width: 1, height: 1, rgb: vec![0.0; 3], depth: None };
    assert!(matches!(engine.push(other, 1.0), Err(EngineError::Size { found: [1, 1], .. })));

    let next = theatre.frame(0.3);
    let (a, b) = (engine.push(next.clone(), 1.0).expect("taken"), untouched.push(next, 1.0).expect("taken"));
    assert_eq!(a.gaussians, b.gaussians);
    assert_eq!((a.index, a.start, a.end), (1, 0.5, 1.0));
}

#[test]
fn a_gaussian_with_a_bad_number_is_dropped_and_counted() {
    for (field, drops) in [(0, [1, 2]), (1, [0, 2]), (2, [0, 2])] {
        let (mut engine, theatre) = engine(Theatre { poison: Some((17, field)), ..Theatre::new([6, 10]) });
        let first = engine.push(theatre.frame(0.0), 0.0).expect("taken");
        assert_eq!((first.dropped, first.gaussians.len() as u64), (drops[0], 60 - drops[0]), "field {field}");
        for k in 1..5 {
            let interval = engine.push(theatre.frame(0.0), f64::from(k)).expect("taken");
            // A dropped Gaussian cannot be dropped again as part of the previous frame.
            let expected = if field == 0 { 1 } else { drops[1] };
            assert_eq!(interval.dropped, expected, "field {field}, key frame {k}");
            assert!(interval.gaussians.iter().all(|r| r.is_sound()));
            assert_eq!(interval.gaussians.len(), 118);
        }
    }
}

#[test]
fn intervals_of_any_length_give_the_same_scene() {
    for fusion in [Fusion::Pairwise, Fusion::Persistent] {
        let scene = |start: f64, length: f64| {
            let theatre = Arc::new(Theatre::new([6, 10]));
            let model: Arc<dyn Reconstructor> = theatre.clone();
            let settings = Settings { fusion, threads: 1, ..Settings::with_model(ModelSource::Shared(model)) };
            let mut engine = Engine::new(settings).expect("starts");
            let mut last = None;
            for k in 0..6 {
                let time = start + length * f64::from(k);
                last = Some(engine.push(theatre.frame(0.15 * k as f32 - 0.5), time).expect("taken"));
            }
            last.expect("pushed")
        };
        let second = scene(0.0, 1.0);
        for (start, length) in [(0.0, 1e-9), (-5e9, 1e9), (1e3, 2f64.powi(-20)), (-1.5e308, 0.3e308)] {
            let other = scene(start, length);
            assert_eq!(other.relative(other.start), Some(0.0));
            assert_eq!(other.relative(other.end), Some(1.0));
            assert_eq!(other.relative(other.end + length), None);
            let close = |a: f32, b: f32| (a - b).abs() <= 1e-5;
            for (a, b) in second.gaussians.iter().zip(other.gaussians.iter()) {
                assert!((0..3).all(|i| close(a.velocity[i], b.velocity[i])), "{start} {length}: {a:?} {b:?}");
                assert_eq!((a.mean.map(f32::to_bits), a.identity), (b.mean.map(f32::to_bits), b.identity));
            }
        }
    }
}

#[test]
fn depth_is_normalised_and_its_bad_values_are_counted() {
    let (_, theatre) = engine(Theatre::new([6, 10]));
    for range in [DepthRange::Frame, DepthRange::Given] {
        let model: Arc<dyn Reconstructor> = theatre.clone();
        let settings = Settings { depth_range: range, ..Settings::with_model(ModelSource::Shared(model)) };
        let mut engine = Engine::new(settings).expect("starts");
        let mut frame = theatre.frame(0.0);
        let mut depth = vec![3.0; frame.width * frame.height];
        (depth[0], depth[1], depth[2]) = (f32::NAN, f32::INFINITY, f32::NEG_INFINITY);
        frame.depth = Some(depth);
        assert_eq!(engine.push(frame, 0.0).expect("taken").dropped, 3);
    }
}

/// The calls of a reconstructor and its session, in which [`Failing`] panics.
const CALLS: [&str; 9] =
    ["embed", "upsample", "gaussians", "condition", "decode", "upsample_motion", "motion", "tokens", "zero_output"];

/// The calls of a session that computes parts of frames.
const PARTS: [&str; 3] = ["embed_part", "upsample_part", "gaussians_part"];

/// A theatre whose call named in the mutex panics once. It computes parts of frames if it has this tiling.
struct Failing(Arc<Theatre>, Arc<std::sync::Mutex<Option<&'static str>>>, Option<Tiling>);

struct FailingSession(Box<dyn Session>, Arc<std::sync::Mutex<Option<&'static str>>>, bool);

fn fail(told: &std::sync::Mutex<Option<&'static str>>, call: &str) {
    let now = told.lock().expect("unpoisoned").take_if(|told| *told == call).is_some();
    assert!(!now, "told to panic in {call}");
}

impl Reconstructor for Failing {
    fn resolution(&self) -> [usize; 2] {
        self.0.resolution()
    }

    fn tiling(&self) -> Option<Tiling> {
        self.2
    }

    fn zero_output(&self) -> &[ZeroOutput] {
        fail(&self.1, "zero_output");
        &[]
    }

    fn session(self: Arc<Self>, saving: Option<Saving>) -> Box<dyn Session> {
        Box::new(FailingSession(self.0.clone().session(saving), self.1.clone(), self.2.is_some()))
    }
}

impl Session for FailingSession {
    fn embed(&mut self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        fail(&self.1, "embed");
        self.0.embed(frame)
    }

    fn upsample(&mut self, embedding: &Embedding) -> Result<Vec<f32>, ModelError> {
        fail(&self.1, "upsample");
        self.0.upsample(embedding)
    }

    fn gaussians(&mut self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        fail(&self.1, "gaussians");
        self.0.gaussians(tokens, sampling)
    }

    fn computes_parts(&self) -> bool {
        self.2
    }

    fn embed_part(&mut self, frame: &FrameInput<'_>, part: &[u32]) -> Result<Embedding, ModelError> {
        fail(&self.1, "embed_part");
        self.0.embed_part(frame, part)
    }

    fn upsample_part(&mut self, embedding: &Embedding, part: &[u32]) -> Result<Vec<f32>, ModelError> {
        fail(&self.1, "upsample_part");
        self.0.upsample_part(embedding, part)
    }

    fn gaussians_part(&mut self, tokens: &[f32], part: &[u32]) -> Result<StaticGaussians, ModelError> {
        fail(&self.1, "gaussians_part");
        self.0.gaussians_part(tokens, part)
    }

    fn draws_positions(&self) -> bool {
        self.0.draws_positions()
    }

    fn reads_condition(&self) -> bool {
        true
    }

    fn condition(&mut self, frame: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError> {
        fail(&self.1, "condition");
        self.0.condition(frame)
    }

    fn decode(&mut self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        fail(&self.1, "decode");
        self.0.decode(a, b)
    }

    fn upsample_motion(&mut self, place: usize, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        fail(&self.1, "upsample_motion");
        self.0.upsample_motion(place, d)
    }

    fn motion(&mut self, place: usize, static_tokens: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError> {
        fail(&self.1, "motion");
        self.0.motion(place, static_tokens, motion_tokens)
    }

    fn tokens(&self) -> Option<Vec<(&'static str, Tokens)>> {
        fail(&self.1, "tokens");
        self.0.tokens()
    }
}

/// Frame `k` of a static camera: a wall with a disc that moves before it.
fn disc(k: usize) -> Frame {
    let (width, height) = (256, 144);
    let rgb = (0..3 * width * height)
        .map(|i| {
            let (plane, y, x) = (i / (width * height), (i / width % height) as f32, (i % width) as f32);
            let inside = (x - 60.0 - 3.0 * k as f32).hypot(y - 72.0) < 14.0;
            if inside { [0.9, 0.2, 0.1][plane] } else { 0.5 + 0.2 * (0.13 * x).sin() * (0.09 * y).cos() }
        })
        .collect();
    Frame { width, height, rgb, depth: None }
}

/// Pushes every second of these frames as a key frame.
fn push(engine: &mut Engine, key: usize) -> Result<Interval, EngineError> {
    let between = if key > 0 { vec![(disc(2 * key - 1), 2.0 * key as f64 - 1.0)] } else { Vec::new() };
    engine.push_with(between, disc(2 * key), 2.0 * key as f64)
}

#[test]
fn a_panic_in_a_call_for_a_part_of_a_frame_leaves_the_stream_as_it_was() {
    let theatre = Arc::new(Theatre::new([72, 128]));
    let tiling = Some(Tiling { patch: 8, cells: 4, partial: false });
    for call in PARTS {
        let told = Arc::new(std::sync::Mutex::new(None));
        let engine = || {
            let model: Arc<dyn Reconstructor> = Arc::new(Failing(theatre.clone(), told.clone(), tiling));
            let settings = Settings {
                motion: Some(MotionFrom::Between),
                fade: Some(Fade::Fixed),
                still: Some(StaticRegions::Keep),
                refine: Some(2),
                threads: 1,
                ..Settings::with_model(ModelSource::Shared(model))
            };
            Engine::new(settings).expect("starts")
        };
        let (mut struck, mut untouched) = (engine(), engine());
        for key in 0..4 {
            let expected = push(&mut untouched, key).expect("taken");
            if key == 2 {
                *told.lock().expect("unpoisoned") = Some(call);
                let struck = std::panic::AssertUnwindSafe(|| push(&mut struck, key));
                assert!(std::panic::catch_unwind(struck).is_err(), "{call} was not called");
            }
            let found = push(&mut struck, key).expect("taken");
            assert_eq!((found.index, found.start, found.end), (expected.index, expected.start, expected.end), "{call}");
            assert_eq!(found.gaussians, expected.gaussians, "{call}");
        }
    }
}

#[test]
fn a_panic_in_any_call_of_a_reconstructor_leaves_the_stream_as_it_was() {
    let theatre = Arc::new(Theatre::new([6, 10]));
    for call in CALLS {
        let told = Arc::new(std::sync::Mutex::new(None));
        let engine = || {
            let model: Arc<dyn Reconstructor> = Arc::new(Failing(theatre.clone(), told.clone(), None));
            Engine::new(Settings { threads: 1, ..Settings::with_model(ModelSource::Shared(model)) }).expect("starts")
        };
        let (mut struck, mut untouched) = (engine(), engine());
        for k in 0..4_u8 {
            let frame = theatre.frame(0.1 * f32::from(k));
            let expected = untouched.push(frame.clone(), f64::from(k)).expect("taken");
            if k == 2 {
                *told.lock().expect("unpoisoned") = Some(call);
                let struck = std::panic::AssertUnwindSafe(|| struck.push(frame.clone(), f64::from(k)));
                assert!(std::panic::catch_unwind(struck).is_err(), "{call} was not called");
            }
            let found = struck.push(frame, f64::from(k)).expect("taken");
            assert_eq!((found.index, found.start, found.end), (expected.index, expected.start, expected.end), "{call}");
            assert_eq!(found.gaussians, expected.gaussians, "{call}");
            // The frame of the panic counts as well.
            let frames = |engine: &Engine| engine.work().stage("fit").map(|stage| stage.done);
            assert_eq!(frames(&struck), frames(&untouched).map(|n| n + u64::from(k >= 2)), "{call}: the account");
        }
    }
}

/// A theatre for tiles of its size, of which the second and the third refuse every frame.
struct Refusing(Arc<Theatre>, AtomicUsize);

struct RefusingSession(Box<dyn Session>, usize);

impl Reconstructor for Refusing {
    fn resolution(&self) -> [usize; 2] {
        self.0.resolution()
    }

    fn tiling(&self) -> Option<Tiling> {
        Some(Tiling { patch: 8, cells: 4, partial: false })
    }

    fn session(self: Arc<Self>, saving: Option<Saving>) -> Box<dyn Session> {
        Box::new(RefusingSession(self.0.clone().session(saving), self.1.fetch_add(1, Ordering::Relaxed)))
    }
}

impl Session for RefusingSession {
    fn embed(&mut self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        match self.1 {
            1 | 2 => Err(ModelError::Format { file: format!("tile {}", self.1), reason: "refused".to_owned() }),
            _ => self.0.embed(frame),
        }
    }

    fn upsample(&mut self, embedding: &Embedding) -> Result<Vec<f32>, ModelError> {
        self.0.upsample(embedding)
    }

    fn gaussians(&mut self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        self.0.gaussians(tokens, sampling)
    }

    fn draws_positions(&self) -> bool {
        false
    }

    fn reads_condition(&self) -> bool {
        false
    }

    fn condition(&mut self, _: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError> {
        Ok(None)
    }

    fn decode(&mut self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        self.0.decode(a, b)
    }

    fn upsample_motion(&mut self, place: usize, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.0.upsample_motion(place, d)
    }

    fn motion(&mut self, place: usize, tokens: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError> {
        self.0.motion(place, tokens, motion_tokens)
    }
}

#[test]
fn of_several_tiles_that_refuse_a_frame_the_first_is_named_and_the_work_of_all_counts() {
    for threads in [1, 4] {
        let model: Arc<dyn Reconstructor> = Arc::new(Refusing(Arc::new(Theatre::new([8, 8])), AtomicUsize::new(0)));
        let settings = Settings {
            resolution: Some(Resolution::Exact([32, 32])),
            threads,
            ..Settings::with_model(ModelSource::Shared(model))
        };
        let mut engine = Engine::new(settings).expect("starts");
        let frame = Frame { width: 32, height: 32, rgb: vec![0.5; 3 * 32 * 32], depth: None };
        for _ in 0..8 {
            let error = engine.push(frame.clone(), 0.0).expect_err("two tiles refuse it").to_string();
            assert!(error.contains("tile 1: refused"), "{threads} threads: {error}");
        }
        let done = |stage| engine.work().stage(stage).map(|stage| stage.done);
        // Four tiles are encoded, two of them without a result.
        assert_eq!([done("encoder"), done("upsampler")], [Some(8 * 4), Some(8 * 2)], "{threads} threads");
    }
}
