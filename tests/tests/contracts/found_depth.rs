//! Depth found by parallax, through the engine.

use std::collections::BTreeMap;

use streamsplat::scene::{resume_point_from_safetensors, resume_point_to_safetensors};
use streamsplat::stream::{FlowEffort, Interval, ModelSource, MotionFrom, Quality, Record, Reference, Reuse};
use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};
use streamsplat_fixtures::clip::cards::{Body, Cards, Moves};
use streamsplat_kernels::Level;
use streamsplat_tests::turned::{Depth, score, score_bodies};

const SIZE: [usize; 2] = [72, 128];

fn finding() -> Settings {
    Settings { find_depth: Some(true), ..Settings::default() }
}

fn flat() -> Settings {
    Settings { find_depth: Some(false), ..Settings::default() }
}

/// Pixels by which the camera moves points at y = 1 from time 0 to time 1.
const TRAVEL: f64 = 16.0;

fn frame(rgb: Vec<f32>) -> Frame {
    Frame { width: SIZE[1], height: SIZE[0], rgb, depth: None }
}

/// Three key frames of a camera that moves in front of cards, the lower ones nearer.
fn moving() -> Vec<Frame> {
    moving_at(1)
}

/// The frames of [`moving`], `factor` times larger.
fn moving_at(factor: usize) -> Vec<Frame> {
    let [height, width] = SIZE.map(|side| factor * side);
    let scene = Cards::new(9, width, height, TRAVEL * factor as f64);
    let rgb = |time| scene.straight(time).rgb;
    [0.0, 0.5, 1.0].into_iter().map(|time| Frame { width, height, rgb: rgb(time), depth: None }).collect()
}

fn run(settings: &Settings, frames: &[Frame]) -> (Vec<Interval>, Engine) {
    let mut engine = Engine::new(settings.clone()).expect("starts");
    let intervals =
        frames.iter().zip(0u32..).map(|(frame, second)| engine.push(frame.clone(), f64::from(second)).expect("taken"));
    (intervals.collect(), engine)
}

fn found(engine: &Engine) -> bool {
    engine.resume_point().is_some_and(|point| point.found.is_some())
}

fn same(a: &[Interval], b: &[Interval]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| format!("{:?}", a.gaussians) == format!("{:?}", b.gaussians))
}

/// True if both show the same picture at both ends, within 2/255, and `cards` have half of the relief of `own`.
fn cards_of(own: &[Interval], cards: &[Interval]) -> bool {
    let image = |interval: &Interval, time| {
        let options = RenderOptions::default();
        interval.render(time, &Camera::Canonical, &options, streamsplat_tests::workers()).expect("drawn").rgb
    };
    let relief = |interval: &Interval| {
        let y = interval.gaussians.iter().map(|record| record.mean[1]);
        let [least, most] = y.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], y| [a.min(y), b.max(y)]);
        most - least
    };
    own.len() == cards.len()
        && own.iter().zip(cards).all(|(own, card)| {
            let apart = [own.start, own.end]
                .into_iter()
                .flat_map(|time| image(own, time).into_iter().zip(image(card, time)).map(|(a, b)| (a - b).abs()));
            let (most, share) = (apart.fold(0.0, f32::max), relief(card) / relief(own));
            println!("largest difference {most}, relief {share}");
            most < 2.0 / 255.0 && (share - 0.5).abs() < 0.01
        })
}

#[test]
fn depth_is_found_by_default_where_time_is_not_all() {
    let frames = moving();
    let (by_default, engine) = run(&Settings::default(), &frames);
    assert!(engine.finds_depth() && found(&engine));
    assert!(same(&by_default, &run(&finding(), &frames).0));
    let network = Settings { motion: Some(MotionFrom::Network), ..finding() };
    let best = Settings::of_quality(Quality::Best);
    for (settings, finds) in [(network, false), (Settings::of_quality(Quality::Realtime), false), (best, true)] {
        assert_eq!(Engine::new(settings).expect("starts").finds_depth(), finds);
    }
    let tiny = streamsplat_fixtures::path("parity/tiny-nodino.safetensors");
    let tiny = Settings::with_model(ModelSource::File { checkpoint: tiny, dinov2: None });
    assert!(!Engine::new(tiny).expect("starts").finds_depth(), "another model");
}

#[test]
fn views_from_the_side_are_truer_with_found_depth() {
    let scenes: Vec<Cards> = (0..6).map(|seed| Cards::new(seed, 256, 144, TRAVEL)).collect();
    let [without, with] = [Depth::None, Depth::Found]
        .map(|depth| score(&Settings::default(), &scenes, depth, &[0.0, 1.0], 10.0, |_, _, _| ()));
    println!("without {without:?}\nfound   {with:?}");
    assert!(with.found >= 4, "found in {} of 6 scenes", with.found);
    assert!(with.views > without.views.max(with.card[0]) + 1.5, "{} dB", with.views);
    assert!(with.foreground > without.foreground.max(with.card[1]) + 1.5, "{} dB", with.foreground);
}

#[test]
fn found_depth_has_the_same_bits_on_every_level_and_thread_count() {
    // Coarse flow is too inexact for parallax in small pictures.
    for (flow, factor) in [(FlowEffort::Fine, 1), (FlowEffort::Coarse, 2)] {
        let frames = moving_at(factor);
        let settings = |level, threads| Settings { level: Some(level), threads, flow, ..finding() };
        let (first, engine) = run(&settings(Level::scalar(), 1), &frames);
        assert!(found(&engine), "{flow:?}");
        for level in Level::available() {
            for threads in [1, 3] {
                assert!(same(&first, &run(&settings(level, threads), &frames).0), "{level:?} {threads} {flow:?}");
            }
        }
    }
}

/// A body in front of a camera that only turns, or does not move at all.
fn bodies(turning: f64, size: [usize; 2]) -> Vec<Cards> {
    let moves = Moves { sideways: 0.0, turning, body: 0.9 };
    (0..3).map(|seed| Cards::with_body(seed, size, Body::Person, moves, &[])).collect()
}

#[test]
fn a_body_seen_from_the_side_is_truer_with_a_guess() {
    for turning in [0.0, 18.0] {
        let scenes = bodies(turning, [144, 256]);
        let times = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0];
        let [found, guessed] = [Depth::FoundInScale, Depth::GuessedInScale]
            .map(|depth| score_bodies(&Settings::default(), &scenes, depth, &times, 10.0, |_, _, _| ()));
        println!("found   {found:?}\nguessed {guessed:?}");
        assert_eq!(guessed.found, 3);
        assert!(guessed.around > found.around.max(guessed.card[0]) + 2.0, "{} dB", guessed.around);
        assert!(guessed.invented < 0.7 * found.invented, "{} of the pixels", guessed.invented);
    }
}

#[test]
fn guessed_depth_is_counted_has_the_same_bits_everywhere_and_needs_a_request() {
    for turning in [0.0, 9.0] {
        let scene = &bodies(turning, SIZE)[1];
        let frames: Vec<Frame> = [0.0, 0.5, 1.0].map(|time| frame(scene.straight(time).rgb)).into();
        assert!(!found(&run(&finding(), &frames).1), "nothing is guessed");
        let guessing = |level, threads| Settings { level: Some(level), threads, guess_depth: Some(true), ..finding() };
        let (first, engine) = run(&guessing(Level::scalar(), 1), &frames);
        assert!(found(&engine));
        assert_eq!(engine.work().stage("guess").map(|stage| stage.done), Some(2));
        let lifted = |engine: &Engine| engine.work().stage("lift").map(|stage| stage.done);
        assert_eq!(lifted(&engine), Some(3));
        // A picture that repeats itself from the start on is guessed as well; both key frames share what is lifted.
        let (_, frozen) = run(&guessing(Level::scalar(), 1), &[frames[0].clone(), frames[0].clone()]);
        assert_eq!((found(&frozen), lifted(&frozen)), (true, Some(1)));
        // A stream that is resumed has the same intervals.
        let (_, start) = run(&guessing(Level::scalar(), 1), &frames[..2]);
        let mut rest = Engine::new(guessing(Level::scalar(), 1)).expect("starts");
        rest.resume(&start.resume_point().expect("a point"), frames[1].clone()).expect("resumed");
        assert!(same(&first[2..], &[rest.push(frames[2].clone(), 2.0).expect("taken")]));
        for level in Level::available() {
            for threads in [1, 3] {
                assert!(same(&first, &run(&guessing(level, threads), &frames).0), "{level:?} {threads} {turning}");
            }
        }
    }
}

#[test]
fn without_parallax_scenes_are_cards_that_look_as_without_depth() {
    let scene = Cards::new(4, SIZE[1], 2 * SIZE[0], 0.0).straight(0.0).rgb;
    // Rows of one picture from `top` on: one plane, or a camera that turns.
    let window = |top: usize, gain: f32| {
        let area = SIZE[0] * SIZE[1];
        let rows = |c: usize| &scene[(2 * c * SIZE[0] + top) * SIZE[1]..][..area];
        frame((0..3).flat_map(rows).map(|x| x * gain).collect())
    };
    let still = vec![window(0, 1.0), window(0, 1.0), window(0, 0.995)];
    let turning = vec![window(0, 1.0), window(3, 1.0), window(6, 1.0)];
    for frames in [still, turning] {
        let (with, engine) = run(&finding(), &frames);
        assert!(!found(&engine));
        assert!(cards_of(&run(&flat(), &frames).0, &with));
    }
}

#[test]
fn the_first_interval_is_lifted_at_both_ends_and_a_given_map_goes_first() {
    let mut frames = moving();
    let (without, _) = run(&flat(), &frames);
    let (with, engine) = run(&finding(), &frames);
    assert!(found(&engine));
    assert!(cards_of(&without[..1], &with[..1]), "the first key frame has seen no motion");
    for key in [Reference::Start, Reference::End] {
        let range = |interval: &Interval| {
            let y = interval.gaussians.iter().filter(|r| r.reference == key).map(|r| r.mean[1]);
            y.fold([f32::INFINITY, 0.0], |[a, b], y| [a.min(y), b.max(y)])
        };
        let ([near, far], [front, back]) = (range(&with[1]), range(&without[1]));
        assert!(far - near > 3.0 * (back - front), "{key:?}: from {near} to {far}, {front} to {back} without depth");
    }
    // An identity of the first image belongs to what is at the same place in the interval after it.
    let place = |record: Record| (record.identity, [record.mean[0], record.mean[2]]);
    let first: BTreeMap<u64, [f32; 2]> = with[0].gaussians.iter().map(place).collect();
    let then = || with[1].gaussians.iter().filter(|record| record.reference == Reference::Start).map(place);
    let known = then().filter(|(identity, _)| first.contains_key(identity)).count();
    assert!(known > first.len() * 9 / 10, "{known} of {}", first.len());
    assert!(then().count() > known, "what the lift adds has identities of its own");
    let moved = then().filter(|(identity, at)| first.get(identity).is_some_and(|before| before != at)).count();
    assert_eq!(moved, 0, "identities that belong to another place");
    for (frame, sign) in frames.iter_mut().zip([1.0, 0.5, 0.25]) {
        frame.depth = Some((0..SIZE[0] * SIZE[1]).map(|i| sign * (i % SIZE[1]) as f32).collect());
    }
    let (given, engine) = run(&finding(), &frames);
    assert!(!found(&engine));
    assert!(same(&given, &run(&flat(), &frames).0));
}

#[test]
fn repeated_frames_and_resumed_streams_find_the_same_depth() {
    let mut frames = moving();
    frames.insert(2, frames[1].clone());
    let (whole, engine) = run(&finding(), &frames);
    assert!(found(&engine));
    assert!(same(&whole, &run(&Settings { reuse: Reuse::Off, ..finding() }, &frames).0));
    for cut in [1, 2, 3] {
        let (_, first) = run(&finding(), &frames[..cut]);
        let point = first.resume_point().expect("a point");
        assert_eq!(point.found.is_some(), cut > 1, "{cut}");
        let bytes = resume_point_to_safetensors(Some(&point), "note").expect("written");
        let (stored, _) = resume_point_from_safetensors(&bytes).expect("read");
        assert_eq!(stored.as_ref(), Some(&point));
        let mut second = Engine::new(finding()).expect("starts");
        second.resume(&point, frames[cut - 1].clone()).expect("resumed");
        let rest: Vec<Interval> =
            (cut..4).map(|at| second.push(frames[at].clone(), at as f64).expect("taken")).collect();
        assert!(same(&whole[cut..], &rest), "{cut}");
    }
}

#[test]
fn found_depth_that_does_not_fit_the_frame_is_refused() {
    let frames = moving();
    let (_, engine) = run(&finding(), &frames);
    let point = engine.resume_point().expect("a point");
    type Change = fn(&mut streamsplat::parallax::Found);
    let changes: [Change; 4] = [
        |found| found.grid[0] += 1,
        |found| found.inverse.truncate(7),
        |found| found.confidence[3] = f32::NAN,
        |found| found.nearest = -1.0,
    ];
    for change in changes {
        let mut wrong = point.clone();
        change(wrong.found.as_mut().expect("found"));
        let mut other = Engine::new(finding()).expect("starts");
        let error = other.resume(&wrong, frames[2].clone()).expect_err("refused");
        assert!(error.to_string().contains("inverse depth"), "{error}");
    }
}
