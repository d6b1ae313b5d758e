//! Reuse in the network: exact reuse changes nothing; reuse within a tolerance is the same on every level and for any
//! number of threads.

use std::path::PathBuf;

use streamsplat::stream::{ModelSource, Reuse};
use streamsplat::{Engine, Frame, Interval, Settings};
use streamsplat_kernels::Level;
use streamsplat_model::reuse::{Cache, Saving};
use streamsplat_model::{Dino, DinoSession, FrameInput, LoadOptions, Network, Sampling, Session, Side};

fn checkpoint(name: &str) -> PathBuf {
    streamsplat_fixtures::path(&format!("parity/{name}.safetensors"))
}

fn open(name: &str, level: Level) -> Network {
    Network::open(checkpoint(name), &LoadOptions { level, ..LoadOptions::default() }).expect("loads")
}

/// A still, noisy backdrop of the network's size with a small square at column `x` in front of it.
fn picture([height, width]: [usize; 2], x: usize) -> Vec<f32> {
    let pixel = |i: usize| {
        let (row, column) = (i / width % height, i % width);
        let square = (8..16).contains(&row) && (x..x + 8).contains(&column);
        if square { 0.9 } else { (i * 7919 % 1013) as f32 / 2000.0 }
    };
    (0..3 * height * width).map(pixel).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|x| x.to_bits()).collect()
}

/// All outputs of the network for frames, pair by pair.
fn pass(session: &mut Session<&Network>, pictures: &[Vec<f32>]) -> Vec<Vec<f32>> {
    let mut results = Vec::new();
    let mut before: Option<(Vec<f32>, Vec<f32>)> = None;
    for rgb in pictures {
        let embedding = session.embed(&FrameInput { rgb, depth: None }).expect("h");
        let frame = session.static_gaussians(&embedding, &Sampling::Mean).expect("Gaussians");
        let (h, still, gaussians) = (embedding.h, frame.tokens, frame.gaussians);
        results.extend([h.clone(), still.clone(), gaussians.position.concat(), gaussians.scale.concat()]);
        results.extend([gaussians.opacity, gaussians.rgb.concat()]);
        if let Some((h_a, still_a)) = &before {
            let a = Side { h: h_a, static_tokens: still_a, condition: None };
            let b = Side { h: &h, static_tokens: &still, condition: None };
            for m in session.deform(a, b).expect("motion") {
                results.extend([m.d, m.tokens, m.velocity.concat(), m.gamma.concat()]);
            }
        }
        before = Some((h, still));
    }
    results
}

fn avoided(session: &Session<&Network>, part: &str) -> (u64, u64) {
    let tokens =
        session.cache().expect("a cache").tokens().into_iter().find(|(name, _)| *name == part).expect("a part").1;
    (tokens.done, tokens.avoided)
}

fn on_pools(work: impl Fn() + Sync) {
    for threads in [1, 3] {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads").install(&work);
    }
}

#[test]
fn windows_whose_tokens_kept_their_bits_are_not_computed_again_and_change_no_bit() {
    for level in Level::available() {
        let network = open("tiny-window", level);
        let size = network.config().resolution;
        let pictures: Vec<_> = [0, 8, 8, 24].map(|x| picture(size, x)).to_vec();
        let expected = pass(&mut network.session(None), &pictures);
        on_pools(|| {
            let mut session = network.session(Some(Saving::Exact));
            let found = pass(&mut session, &pictures);
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                assert!(bits(found) == bits(expected), "{level}: result {i}");
            }
            for part in ["encoder", "upsampler", "heads"] {
                let (done, avoided) = avoided(&session, part);
                assert!(done > 0 && avoided > 0, "{part}: {done} done, {avoided} avoided");
            }
        });
    }
}

#[test]
fn a_network_in_which_every_token_sees_all_keeps_nothing_exactly() {
    assert!(open("tiny-nodino", Level::detect()).session(Some(Saving::Exact)).cache().is_none());
}

#[test]
fn frames_that_change_everywhere_are_computed_as_without_a_cache() {
    let network = open("tiny-nodino", Level::detect());
    let [height, width] = network.config().resolution;
    let noise = |k: usize| (0..3 * height * width).map(|i| ((i * 31 + k * 7919) % 1009) as f32 / 1009.0).collect();
    let pictures: Vec<Vec<f32>> = (1..6).map(noise).collect();
    let mut session = network.session(Some(Saving::Within(0.01)));
    let (found, expected) = (pass(&mut session, &pictures), pass(&mut network.session(None), &pictures));
    assert!(found.iter().zip(&expected).all(|(a, b)| bits(a) == bits(b)));
    assert!(session.cache().expect("a cache").tokens().iter().all(|(_, tokens)| tokens.avoided == 0));
}

#[test]
fn a_refresh_gives_what_a_network_without_a_cache_gives() {
    let network = open("tiny-nodino", Level::detect());
    let size = network.config().resolution;
    let steps = Cache::REFRESH as usize + 2;
    let pictures: Vec<_> = (0..steps).map(|k| picture(size, k % 2)).collect();
    let mut session = network.session(Some(Saving::Within(0.5)));
    let (found, expected) = (pass(&mut session, &pictures), pass(&mut network.session(None), &pictures));
    // A frame has 6 results, and 8 with the pair it ends.
    let h = |results: &[Vec<f32>], k: usize| bits(&results[if k == 0 { 0 } else { 6 + 14 * (k - 1) }]);
    let equal: Vec<usize> = (0..steps).filter(|k| h(&found, *k) == h(&expected, *k)).collect();
    // In between, the square's motion by a pixel is ignored.
    assert!(equal.contains(&0) && equal.contains(&(Cache::REFRESH as usize)) && !equal.contains(&1), "{equal:?}");
}

#[test]
fn tokens_that_hardly_moved_keep_what_was_computed_and_the_cache_is_bounded() {
    let network = open("tiny-nodino", Level::detect());
    let size = network.config().resolution;
    let pictures: Vec<_> = (0..12).map(|k| picture(size, 2 * k)).collect();
    let mut session = network.session(Some(Saving::Within(0.02)));
    pass(&mut session, &pictures[..4]);
    let bytes = |session: &Session<&Network>| session.cache().expect("a cache").bytes();
    let most = bytes(&session);
    pass(&mut session, &pictures);
    assert_eq!(bytes(&session), most);
    for (part, tokens) in session.cache().expect("a cache").tokens() {
        assert!(tokens.avoided > tokens.done, "{part}: {tokens:?}");
    }
}

fn stream(name: &str, reuse: Reuse, level: Level, threads: usize) -> (Vec<Interval>, Engine) {
    let dinov2 = (name == "tiny-dino").then(|| checkpoint("dino-tiny"));
    let model = ModelSource::File { checkpoint: checkpoint(name), dinov2 };
    let settings = Settings { reuse, level: Some(level), threads, ..Settings::with_model(model) };
    let mut engine = Engine::new(settings).expect("starts");
    let [height, width] = engine.model().resolution();
    let mut push = |k: usize| {
        let frame = Frame { width, height, rgb: picture([height, width], [0, 2, 4, 12][k]), depth: None };
        engine.push(frame, k as f64).expect("taken")
    };
    let intervals = (0..4).map(&mut push).collect();
    (intervals, engine)
}

#[test]
fn what_is_left_out_within_a_tolerance_depends_on_neither_level_nor_threads() {
    for name in ["tiny-nodino", "tiny-dino", "tiny-window"] {
        let (expected, engine) = stream(name, Reuse::Within(0.02), Level::scalar(), 1);
        let decoder = engine.work().stage("decoder.tokens").expect("counted");
        assert!(decoder.avoided > 0 && decoder.done > 0, "{name}: {decoder:?}");
        let dinov2 = engine.work().stage("dinov2.tokens").map(|tokens| tokens.avoided > 0 && tokens.done > 0);
        assert_eq!(dinov2, (name == "tiny-dino").then_some(true), "{name}");
        for level in Level::available() {
            for threads in [1, 3] {
                let (found, _) = stream(name, Reuse::Within(0.02), level, threads);
                assert!(
                    found.iter().zip(&expected).all(|(a, b)| a.gaussians == b.gaussians),
                    "{name}, {level}, {threads}"
                );
            }
        }
    }
}

#[test]
fn a_stream_with_exact_reuse_gives_the_bits_of_one_without() {
    for name in ["tiny-nodino", "tiny-dino", "tiny-window"] {
        let (with, engine) = stream(name, Reuse::Exact, Level::detect(), 2);
        let (without, _) = stream(name, Reuse::Off, Level::detect(), 2);
        assert!(with.iter().zip(&without).all(|(a, b)| a.gaussians == b.gaussians && a.merges == b.merges), "{name}");
        assert_eq!(engine.work().stage("encoder.tokens").is_some(), name == "tiny-window");
    }
}

#[test]
fn features_of_dinov2_are_computed_anew_where_a_frame_changed_and_the_same_on_every_level() {
    let (size, pixels) = ([32, 64], 3 * 32 * 64);
    let pictures: Vec<Vec<f32>> = [8, 8, 24].map(|x| picture(size, x)).to_vec();
    let error = |a: &[f32], b: &[f32]| {
        let square = |x: f32| f64::from(x) * f64::from(x);
        let difference: f64 = a.iter().zip(b).map(|(a, b)| square(a - b)).sum();
        (difference / b.iter().map(|b| square(*b)).sum::<f64>()).sqrt()
    };
    let mut first: Option<Vec<Vec<u32>>> = None;
    for level in Level::available() {
        let dino =
            Dino::open(checkpoint("dino-tiny"), &LoadOptions { level, ..LoadOptions::default() }).expect("loads");
        let plain = |rgb: &[f32]| dino.features(rgb, size).expect("features").patch_tokens;
        for (threads, saving) in [(1, Saving::Within(1e-3)), (3, Saving::Within(1e-3)), (2, Saving::Exact)] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let mut session = DinoSession::new(&dino, Some(saving));
            let mut take = |rgb: &[f32]| pool.install(|| session.features(rgb, size).expect("features").patch_tokens);
            let found: Vec<Vec<f32>> = pictures.iter().map(|rgb| take(rgb)).collect();
            let [same, moved] = [1, 2].map(|k| plain(&pictures[k]));
            assert!(bits(&found[0]) == bits(&same) && bits(&found[1]) == bits(&same), "{level}");
            if saving == Saving::Exact {
                assert!(bits(&found[2]) == bits(&moved) && session.tokens().is_none(), "{level}");
                continue;
            }
            let (kept, stale) = (error(&found[2], &moved), error(&same, &moved));
            assert!(kept < 0.7 * stale, "{level}: {kept} of {stale}");
            let tokens = session.tokens().expect("counted");
            assert!(tokens.done < 2 * tokens.avoided, "{level}: {tokens:?}");
            let expected = first.get_or_insert_with(|| found.iter().map(|x| bits(x)).collect());
            assert!(found.iter().zip(expected).all(|(a, b)| bits(a) == *b), "{level}, {threads} threads");

            let bytes = session.bytes();
            let noise: Vec<f32> = (0..pixels).map(|i| (i * 31 % 1009) as f32 / 1009.0).collect();
            let all = session.features(&noise, size).expect("features").patch_tokens;
            assert!(bits(&all) == bits(&plain(&noise)), "{level}: a frame that changed everywhere");
            session.forget();
            let again = session.features(&pictures[2], size).expect("features").patch_tokens;
            assert!(bits(&again) == bits(&moved), "{level}: after forgetting");
            assert!(session.bytes() <= bytes && session.tokens().expect("counted").avoided == tokens.avoided);
        }
    }
}
