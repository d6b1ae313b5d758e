//! Reuse in the stream changes no bit.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use streamsplat::stream::{Fade, Fusion, ModelSource, MotionFrom, Reconstructor, Reuse, SamplingMode};
use streamsplat::{Engine, Interval, Settings};
use streamsplat_tests::theatre::Theatre;

const STOPS: [f32; 12] = [0.0, 0.0, 0.0, 0.1, 0.1, 0.0, 0.0, 0.0, -0.2, -0.2, -0.2, -0.2];

fn run(reuse: Reuse, fusion: Fusion, draws: bool) -> (Vec<Interval>, Engine, Arc<Theatre>) {
    run_with(Settings { reuse, fusion, ..Settings::default() }, draws)
}

/// As [`run`], with other settings than those of the model and of sampling.
fn run_with(settings: Settings, draws: bool) -> (Vec<Interval>, Engine, Arc<Theatre>) {
    let theatre = Arc::new(Theatre { draws, ..Theatre::new([9, 16]) });
    let model: Arc<dyn Reconstructor> = theatre.clone();
    let sampling = if draws { SamplingMode::Sample } else { SamplingMode::Mean };
    let settings = Settings { model: ModelSource::Shared(model), sampling, ..settings };
    let mut engine = Engine::new(settings).expect("starts");
    let intervals =
        STOPS.iter().enumerate().map(|(k, &x)| engine.push(theatre.frame(x), k as f64).expect("taken")).collect();
    (intervals, engine, theatre)
}

#[test]
fn a_repeated_frame_costs_no_network_and_changes_no_bit() {
    for fusion in [Fusion::Persistent, Fusion::Pairwise] {
        let (with, engine, theatre) = run(Reuse::Exact, fusion, false);
        let (without, engine_off, theatre_off) = run(Reuse::Off, fusion, false);
        for (a, b) in with.iter().zip(&without) {
            assert_eq!(a.gaussians, b.gaussians);
            assert_eq!(a.merges, b.merges);
        }
        // Runs of equal frames: 3, 2, 3, 4. A run of n costs one frame; pairs inside a run cost one.
        let calls = |t: &Theatre| t.calls.each_ref().map(|c| c.load(Relaxed));
        assert_eq!(calls(&theatre), [4, 4, 3 + 4]);
        assert_eq!(calls(&theatre_off), [12, 12, 11]);
        let count = |e: &Engine, stage| e.work().stage(stage).map(|s| (s.done, s.avoided));
        assert_eq!(count(&engine, "encoder"), Some((4, 8)));
        assert_eq!(count(&engine, "upsampler"), Some((4 + 14, 8 + 8)));
        assert_eq!(count(&engine, "heads"), Some((4 + 14, 8 + 8)));
        assert_eq!(count(&engine, "decoder"), Some((7, 4)));
        assert_eq!(count(&engine_off, "encoder"), Some((12, 0)));
        assert_eq!(count(&engine_off, "upsampler"), Some((12 + 22, 0)));
        assert_eq!(count(&engine_off, "decoder"), Some((11, 0)));
    }
}

#[test]
fn drawn_positions_are_drawn_anew_in_a_repeated_frame() {
    let (with, engine, _) = run(Reuse::Exact, Fusion::Persistent, true);
    let (without, ..) = run(Reuse::Off, Fusion::Persistent, true);
    for (a, b) in with.iter().zip(&without) {
        assert_eq!(a.gaussians, b.gaussians);
    }
    let count = |stage| engine.work().stage(stage).map(|s| (s.done, s.avoided));
    assert_eq!(count("encoder"), Some((4, 8)));
    assert_eq!(count("upsampler"), Some((4 + 14, 8 + 8)));
    assert_eq!(count("heads"), Some((12 + 14, 8)));
    assert_eq!(count("decoder"), Some((7, 4)));
}

#[test]
fn drawn_positions_are_drawn_anew_where_no_pair_is_decoded() {
    let run = |reuse| {
        let (motion, fade) = (Some(MotionFrom::Frames), Some(Fade::Fixed));
        run_with(Settings { reuse, motion, fade, ..Settings::default() }, true)
    };
    let ((with, engine, _), (without, ..)) = (run(Reuse::Exact), run(Reuse::Off));
    for (a, b) in with.iter().zip(&without) {
        assert_eq!(a.gaussians, b.gaussians);
    }
    let count = |stage| engine.work().stage(stage).map(|s| (s.done, s.avoided));
    assert_eq!(count("encoder"), Some((4, 8)));
    assert_eq!(count("decoder").map(|(done, _)| done), Some(0));
}
