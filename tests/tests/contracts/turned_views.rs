//! Scenes with true depth from the side, and depth maps with little information.

use streamsplat::stream::{Behind, DepthRange, Interval, MotionFrom, Reuse};
use streamsplat::{Engine, Frame, RenderOptions, Settings};
use streamsplat_fixtures::clip::cards::Cards;
use streamsplat_kernels::Level;
use streamsplat_tests::turned::{Depth, around, edges_from_lines, reconstruct, score};

const SIZE: [usize; 2] = [144, 256];

fn scenes() -> Vec<Cards> {
    (0..4).map(|seed| Cards::new(seed, SIZE[1], SIZE[0], 0.0)).collect()
}

#[test]
fn true_depth_makes_views_from_the_side_true() {
    let settings = Settings::default();
    let [without, with] =
        [Depth::None, Depth::True].map(|depth| score(&settings, &scenes(), depth, &[0.0], 10.0, |_, _, _| ()));
    println!("without {without:?}\nwith    {with:?}");
    assert!(with.views >= 29.0 && with.foreground >= 28.0, "{with:?}");
    assert!(with.views >= without.views + 3.0 && with.foreground >= without.foreground + 3.0, "{without:?} {with:?}");
    assert!(with.key >= without.key - 0.3, "{without:?} {with:?}");
    let off = Settings { behind: Behind::Off, ..settings };
    let off = score(&off, &scenes(), Depth::True, &[0.0], 10.0, |_, _, _| ());
    println!("off     {off:?}");
    assert!(with.behind >= off.behind + 0.2, "past edges there is more to see: {off:?} {with:?}");
    assert!(with.key >= off.key - 0.1, "the own view hides it: {off:?} {with:?}");
}

#[test]
fn a_picture_without_depth_is_a_card_whose_edges_stay_straight() {
    for (degrees, allowed) in [(10.0, 0.4), (20.0, 0.7)] {
        let [rms, most] = edges_from_lines(&Settings::default(), degrees, [288, 512]);
        println!("{degrees}°: {rms:.2} pixels, 95 % within {most:.2}");
        assert!(most < allowed, "{degrees}°: {rms} pixels, 95 % within {most}, expected {allowed}");
    }
}

#[test]
fn views_past_edges_show_what_earlier_frames_saw_there() {
    let scenes: Vec<Cards> = (0..6).map(|seed| Cards::new(seed, SIZE[1], SIZE[0], 40.0)).collect();
    let times = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0];
    let with = score(&Settings::default(), &scenes, Depth::True, &times, 10.0, |_, _, _| ());
    // The same without flow, along which depth is carried over.
    let network = Settings { motion: Some(MotionFrom::Network), ..Settings::default() };
    let without = score(&network, &scenes, Depth::True, &times, 10.0, |_, _, _| ());
    println!("with    {with:?}\nwithout {without:?}");
    assert!(with.covered >= without.covered + 0.2, "{} dB, {} dB without", with.covered, without.covered);
    assert!(with.views >= without.views - 0.1 && with.key >= without.key - 0.1, "nothing else is worse for it");
}

/// Records of all intervals of a few key frames with these depth maps.
fn stream(level: Option<Level>, threads: usize, depth: impl Fn(usize, &[f32]) -> Option<Vec<f32>>) -> Vec<Interval> {
    let scene = covering();
    let settings = Settings { level, threads, find_depth: Some(false), ..Settings::default() };
    let mut engine = Engine::new(settings).expect("starts");
    (0..3)
        .map(|key| {
            let picture = scene.straight(0.5 * key as f64);
            let depth = depth(key, &picture.y);
            engine.push(Frame { width: 128, height: 80, rgb: picture.rgb, depth }, key as f64).expect("taken")
        })
        .collect()
}

/// A scene in which near objects cover parts that were visible a key frame ago.
fn covering() -> Cards {
    Cards::new(4, 128, 80, 30.0)
}

fn same(a: &[Interval], b: &[Interval]) -> bool {
    a.iter().zip(b).all(|(a, b)| format!("{:?}", a.gaussians) == format!("{:?}", b.gaussians))
}

#[test]
fn lifted_scenes_have_the_same_bits_on_every_level_and_thread_count() {
    let map = |key: usize, y: &[f32]| {
        let holes = |(i, y): (usize, &f32)| if (i + key).is_multiple_of(11) { f32::NAN } else { *y };
        Some(y.iter().enumerate().map(holes).collect())
    };
    let first = stream(Some(Level::scalar()), 1, map);
    for level in Level::available() {
        for threads in [1, 3] {
            assert!(same(&first, &stream(Some(level), threads, map)), "{level:?} {threads}");
        }
    }
}

#[test]
fn maps_that_tell_nothing_are_as_no_map() {
    let without = stream(None, 0, |_, _| None);
    for value in [0.0, 0.7, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert!(same(&without, &stream(None, 0, |_, y| Some(vec![value; y.len()]))), "{value}");
    }
    let some = stream(None, 0, |_, y| Some(y.to_vec()));
    assert!(!same(&without, &some));
    // Inverted, or of huge numbers: another scene, but a valid one.
    for depth in [(|y: f32| 1.0 - y) as fn(f32) -> f32, |y| y * f32::MAX, |y| if y > 0.5 { f32::INFINITY } else { y }] {
        let odd = stream(None, 0, |_, y| Some(y.iter().map(|y| depth(*y)).collect()));
        assert!(odd.iter().all(|i| i.gaussians.iter().all(|r| r.is_sound()) && i.dropped == 0));
    }
}

#[test]
fn repeated_frames_and_resumed_streams_are_lifted_to_the_same_bits() {
    let scene = covering();
    let frame = |time: f64| {
        let picture = scene.straight(time);
        Frame { width: 128, height: 80, rgb: picture.rgb, depth: Some(picture.y) }
    };
    let times = [0.0, 0.5, 0.5, 1.0];
    let run = |reuse: Reuse| -> Vec<Interval> {
        let mut engine = Engine::new(Settings { reuse, ..Settings::default() }).expect("starts");
        times.iter().zip(0u8..).map(|(t, key)| engine.push(frame(*t), f64::from(key)).expect("taken")).collect()
    };
    let whole = run(Reuse::Exact);
    assert!(same(&whole, &run(Reuse::Off)));
    let mut first = Engine::new(Settings::default()).expect("starts");
    for (key, time) in times[..3].iter().enumerate() {
        first.push(frame(*time), key as f64).expect("taken");
    }
    let point = first.resume_point().expect("a point");
    assert!(point.depth.is_some() && point.covered.len() > 50, "{} covered places", point.covered.len());
    let bytes = streamsplat::scene::resume_point_to_safetensors(Some(&point), "note").expect("written");
    let (stored, _) = streamsplat::scene::resume_point_from_safetensors(&bytes).expect("read");
    assert_eq!(stored.as_ref(), Some(&point));
    let mut second = Engine::new(Settings::default()).expect("starts");
    second.resume(&point, frame(times[2])).expect("resumed");
    let last = second.push(frame(times[3]), 3.0).expect("taken");
    assert!(same(&whole[3..], &[last]));
}

#[test]
fn a_still_scene_does_not_breathe_when_its_maps_flicker() {
    let scene = Cards::new(2, SIZE[1], SIZE[0], 0.0);
    let straight = scene.straight(0.0);
    let settings = Settings { depth_range: DepthRange::Given, ..Settings::default() };
    let mut engine = Engine::new(settings).expect("starts");
    let mut views = Vec::new();
    for key in 0..3u8 {
        let mut picture = straight.clone();
        let (scale, shift) = [(1.0, 0.0), (0.8, 0.1), (0.9, 0.02)][usize::from(key)];
        picture.y.iter_mut().for_each(|y| *y = 0.5 + (*y - 0.5) * scale + shift);
        // One level of eight bits: the picture changes, though nothing moves.
        picture.rgb.iter_mut().for_each(|c| *c = (*c + f32::from(key) / 255.0).min(1.0));
        let interval = match key {
            0 => reconstruct(&mut engine, &[picture], SIZE, true).expect("taken").0,
            _ => {
                let depth = picture.y.iter().map(|y| (y - 0.1) / 0.85).collect();
                let frame = Frame { width: SIZE[1], height: SIZE[0], rgb: picture.rgb, depth: Some(depth) };
                engine.push(frame, f64::from(key)).expect("taken")
            }
        };
        let camera = around(10.0, 0.3, interval.placement.aspect());
        views.push(
            interval.render(f64::from(key), &camera, &RenderOptions::default(), engine.workers()).expect("drawn").rgb,
        );
    }
    for (key, pair) in views.windows(2).enumerate() {
        let square = pair[0].iter().zip(&pair[1]).map(|(a, b)| f64::from((a - b) * (a - b))).sum::<f64>();
        let decibels = -10.0 * (square / pair[0].len() as f64).log10();
        println!("views of key frames {key} and {}: {decibels:.2} dB", key + 1);
        assert!(decibels > 38.0, "{decibels}");
    }
}
