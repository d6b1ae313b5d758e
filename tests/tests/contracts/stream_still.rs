//! Static regions of the picture keep their Gaussians: the same bits on every level, thread count and after resuming,
//! no seam at key frames, no growing error.

use streamsplat::stream::{Handover, Record, StaticRegions};
use streamsplat::{Camera, Engine, Frame, Image, Interval, RenderOptions, Settings};
use streamsplat_fixtures::clip::cards::Cards;
use streamsplat_kernels::Level;
use streamsplat_tests::{bits, workers};

const SIZE: [usize; 2] = [256, 144];

/// Frame `k` of a static camera: a room with noise of 1.5/255 whose light is `light`, and a disc that moves where
/// `mover` is true.
fn frame(k: usize, light: f32, mover: bool) -> Frame {
    let [width, height] = SIZE;
    let mut state = (k as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut noise = move || {
        // Nearly Gaussian noise: the sum of four uniform numbers.
        let mut sum = 0.0;
        for _ in 0..4 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            sum += (state >> 40) as f32 / (1 << 24) as f32 - 0.5;
        }
        sum * 3f32.sqrt() * 1.5 / 255.0
    };
    let (cx, cy) = (40.0 + 2.0 * (k % 80) as f32, 72.0);
    let rgb = (0..3 * width * height)
        .map(|i| {
            let (plane, y, x) = (i / (width * height), i / width % height, i % width);
            let (fx, fy) = (x as f32, y as f32);
            let wall =
                0.5 + 0.15 * (fx * 0.13).sin() * (fy * 0.09).cos() + 0.08 * ((x / 23 + y / 17 + plane) % 3) as f32;
            let inside = mover && (fx - cx).hypot(fy - cy) < 14.0;
            let colour = if inside { [0.9, 0.2, 0.1][plane] + 0.05 * (fx - cx).cos() } else { wall * light };
            ((colour + noise()) * 255.0).round().clamp(0.0, 255.0) / 255.0
        })
        .collect();
    Frame { width, height, rgb, depth: None }
}

fn settings(still: StaticRegions) -> Settings {
    Settings { still: Some(still), ..Settings::default() }
}

/// Pushes key frame `key` of every four frames.
fn push(engine: &mut Engine, key: usize, light: impl Fn(usize) -> f32, mover: bool) -> Interval {
    let of = |k: usize| frame(k, light(k), mover);
    let last = 4 * key;
    let between = (last.saturating_sub(3)..last).filter(|_| key > 0).map(|k| (of(k), k as f64)).collect();
    engine.push_with(between, of(last), last as f64).expect("taken")
}

fn draw(interval: &Interval, time: f64) -> Image {
    interval.render(time, &Camera::Canonical, &RenderOptions::default(), workers()).expect("drawn")
}

fn psnr(image: &Image, truth: &Frame) -> f64 {
    assert_eq!([image.width, image.height], SIZE);
    let sum: f64 = image.rgb.iter().zip(&truth.rgb).map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b).powi(2)).sum();
    -10.0 * (sum / truth.rgb.len() as f64).log10()
}

#[test]
fn a_standing_camera_keeps_most_of_its_gaussians_for_less_than_a_decibel() {
    let light = |_: usize| 1.0;
    let run = |still| {
        let mut engine = Engine::new(settings(still)).expect("starts");
        let intervals: Vec<Interval> = (0..5).map(|key| push(&mut engine, key, light, true)).collect();
        (intervals, engine)
    };
    let (kept, engine) = run(StaticRegions::Keep);
    let (whole, all) = run(StaticRegions::Off);
    let done = |engine: &Engine, stage| engine.work().stage(stage).map(|s| [s.done, s.avoided]).expect("counted");
    let [computed, avoided] = done(&engine, "still");
    assert!(avoided > 3 * computed, "{computed} blocks computed, {avoided} kept");
    assert_eq!(done(&all, "still"), [0, 0]);
    assert!(done(&engine, "colours")[0] <= done(&all, "colours")[0]);
    for (kept, whole) in kept.iter().zip(&whole).skip(1) {
        let [n, m] = [kept, whole].map(|interval| interval.gaussians.len());
        assert!(10 * n < 7 * m, "interval {}: {n} Gaussians of {m}", kept.index);
        let arriving = kept.gaussians.handover.iter().filter(|handover| **handover == Handover::Arrives).count();
        assert!(4 * arriving < m, "{arriving} arrive");
        for k in 4 * kept.index - 3..=4 * kept.index {
            let truth = frame(k as usize, 1.0, true);
            let [a, b] = [kept, whole].map(|interval| psnr(&draw(interval, k as f64), &truth));
            // Fits of single frames come nearer to their noise than a mean does.
            let most = 0.8;
            assert!(a > b - most || a > 40.0, "frame {k}: {a:.2} dB kept, {b:.2} dB computed");
        }
    }
}

#[test]
fn details_bring_pictures_closer_and_those_of_static_regions_are_kept() {
    // Grain on the walls, finer than the model's lattice.
    let grained = |k: usize| {
        let mut frame = frame(k, 1.0, true);
        let pixels = SIZE[0] * SIZE[1];
        for (i, value) in frame.rgb.iter_mut().enumerate() {
            let grain = ((i % pixels) as u32).wrapping_mul(0x9E37_79B1) >> 28;
            *value = (*value + if grain == 0 { 0.15 } else { 0.0 }).min(1.0);
        }
        frame
    };
    let run = |detail| {
        let mut engine = Engine::new(Settings { detail, ..settings(StaticRegions::Keep) }).expect("starts");
        let mut added = Vec::new();
        let intervals: Vec<Interval> = (0..4)
            .map(|key: usize| {
                let between = (1..4).filter(|_| key > 0).map(|k| 4 * key - k).rev();
                let between = between.map(|k| (grained(k), k as f64)).collect();
                let interval = engine.push_with(between, grained(4 * key), 4.0 * key as f64).expect("taken");
                added.push(engine.work().stage("detail").expect("counted").done);
                interval
            })
            .collect();
        (intervals, added)
    };
    let (with, added) = run(None);
    let (without, none) = run(Some(0));
    assert_eq!(none, [0; 4]);
    // At most 50 of each 1000 pixels; later on only where the disc moves.
    let most = (SIZE[0] * SIZE[1] / 20) as u64;
    assert!(added[0] > most / 2 && added[0] <= most, "{added:?}");
    assert!(added[3] - added[0] < added[0], "{added:?}");
    let small = |interval: &Interval| {
        let kept = |record: &Record| record.handover == Handover::None && record.scale[0] < 0.4 * 2.0 / SIZE[0] as f32;
        interval.gaussians.iter().filter(kept).count() as u64
    };
    assert!(4 * small(&with[3]) > added[0], "{} of {} are kept", small(&with[3]), added[0]);
    for (with, without) in with.iter().zip(&without).skip(1) {
        for k in 4 * with.index - 3..=4 * with.index {
            let truth = grained(k as usize);
            let [a, b] = [with, without].map(|interval| psnr(&draw(interval, k as f64), &truth));
            assert!(a > b + 0.5, "frame {k}: {a:.2} dB, {b:.2} dB without details");
        }
    }
    for pair in with.windows(2) {
        assert!(draw(&pair[0], pair[0].end) == draw(&pair[1], pair[1].start), "key frame {}", pair[0].index);
    }
}

#[test]
fn levels_threads_and_a_resumed_stream_are_the_same_bits_and_crossing_changes_none() {
    // Fading light makes colours change.
    let light = |k: usize| 1.0 - 0.0004 * k as f32;
    let stream = |level, threads| {
        let mut engine =
            Engine::new(Settings { level: Some(level), threads, ..settings(StaticRegions::Keep) }).expect("starts");
        (0..4).map(|key| push(&mut engine, key, light, true)).collect::<Vec<_>>()
    };
    let expected = stream(Level::detect(), 2);
    assert!(expected[2].gaussians.rgb_rate.iter().any(|rate| *rate != [0.0; 3]));
    for (level, threads) in Level::available().into_iter().map(|level| (level, 1)).chain([(Level::detect(), 3)]) {
        for (a, b) in expected.iter().zip(&stream(level, threads)) {
            assert!(bits(&a.gaussians) == bits(&b.gaussians), "interval {}, {level}, {threads} threads", a.index);
        }
    }
    for pair in expected.windows(2) {
        assert!(draw(&pair[0], pair[0].end) == draw(&pair[1], pair[1].start), "key frame {}", pair[0].index);
    }
    for stop in 1..3 {
        let mut before = Engine::new(settings(StaticRegions::Keep)).expect("starts");
        (0..=stop).for_each(|key| drop(push(&mut before, key, light, true)));
        let point = before.resume_point().expect("a point");
        assert!(point.kept.is_some());
        let bytes = streamsplat::scene::resume_point_to_safetensors(Some(&point), "").expect("written");
        let (read, _) = streamsplat::scene::resume_point_from_safetensors(&bytes).expect("read");
        assert_eq!(read.as_ref(), Some(&point));
        let mut after = Engine::new(settings(StaticRegions::Keep)).expect("starts");
        after.resume(&point, frame(4 * stop, light(4 * stop), true)).expect("resumed");
        for (key, expected) in expected.iter().enumerate().skip(stop + 1) {
            let found = push(&mut after, key, light, true);
            assert!(bits(&found.gaussians) == bits(&expected.gaussians), "stopped at {stop}, interval {key}");
        }
    }
}

#[test]
fn frames_that_flow_leaves_out_show_a_body_that_moves_on_every_level() {
    // Ten pixels a frame, six frames to an interval: flow takes the second and the fourth of five in between.
    let frame = |k: usize| frame(5 * k, 1.0, true);
    let start = |level, threads| {
        Engine::new(Settings { level: Some(level), threads, ..settings(StaticRegions::Keep) }).expect("starts")
    };
    let push = |engine: &mut Engine, key: usize| {
        let between = (key.saturating_sub(5)..key).map(|k| (frame(k), k as f64)).collect();
        engine.push_with(between, frame(key), key as f64).expect("taken")
    };
    let stream = |level, threads| {
        let mut engine = start(level, threads);
        [0, 6, 12].map(|key| push(&mut engine, key))
    };
    let expected = stream(Level::detect(), 2);
    for (first, interval) in [(1, &expected[1]), (7, &expected[2])] {
        let found: Vec<f64> = (first..first + 5).map(|k| psnr(&draw(interval, k as f64), &frame(k))).collect();
        let [out, used] = [0, 1].map(|from| found.iter().skip(from).step_by(2).copied().fold(f64::INFINITY, f64::min));
        assert!(out > used - 2.5, "left out {out:.2} dB, used {used:.2} dB: {found:.2?}");
    }
    for (level, threads) in Level::available().into_iter().map(|level| (level, 1)) {
        for (a, b) in expected.iter().zip(&stream(level, threads)) {
            assert!(bits(&a.gaussians) == bits(&b.gaussians), "interval {}, {level}, {threads} threads", a.index);
        }
    }
    let [mut stopped, mut resumed] = [(); 2].map(|()| start(Level::detect(), 2));
    [0, 6].into_iter().for_each(|key| drop(push(&mut stopped, key)));
    resumed.resume(&stopped.resume_point().expect("a point"), frame(6)).expect("resumed");
    assert!(bits(&push(&mut resumed, 12).gaussians) == bits(&expected[2].gaussians), "resumed");
}

#[test]
fn light_that_fades_slowly_is_followed_without_an_error_that_grows() {
    let light = |k: usize| 1.0 - 0.3 * (k as f32 / 160.0);
    let mut engine = Engine::new(settings(StaticRegions::Keep)).expect("starts");
    let mut worst = [f64::INFINITY; 2];
    for key in 0..=40 {
        let interval = push(&mut engine, key, light, false);
        let half = usize::from(key > 20);
        for k in [(4 * key).saturating_sub(2), 4 * key] {
            worst[half] = worst[half].min(psnr(&draw(&interval, k as f64), &frame(k, light(k), false)));
        }
    }
    let [first, second] = worst;
    assert!(first > 39.0 && second > first - 0.3, "worst frame {first:.2} dB, then {second:.2} dB");
    let still = engine.work().stage("still").expect("counted");
    assert!(still.avoided > 4 * still.done, "{} blocks computed, {} kept", still.done, still.avoided);
}

#[test]
fn frames_are_used_as_they_came_where_depth_is_found_after_blocks_were_kept() {
    // A static band above the picture of a camera that moves sideways, a little farther in every second frame.
    let ([width, height], rows) = ([512, 288], 128);
    let (scene, band) = (Cards::new(9, width, height, 64.0), Cards::new(4, width, height, 0.0).straight(0.0).rgb);
    let frame = |k: usize| {
        let mut rgb = scene.straight(k as f64 / 12.0 + 0.015 * (k % 2) as f64).rgb;
        for plane in 0..3 {
            let part = plane * width * height..(plane * height + rows) * width;
            rgb[part.clone()].copy_from_slice(&band[part]);
        }
        Frame { width, height, rgb, depth: None }
    };
    let run = |still, find_depth| {
        let mut engine = Engine::new(Settings { find_depth: Some(find_depth), ..settings(still) }).expect("starts");
        let worst = [0, 6, 12].map(|key: usize| {
            let frames = key.saturating_sub(5)..key;
            let between = frames.clone().map(|k| (frame(k), k as f64)).collect();
            let interval = engine.push_with(between, frame(key), key as f64).expect("taken");
            let errors = frames.map(|k| {
                let squares = draw(&interval, k as f64).rgb.into_iter().zip(frame(k).rgb).map(|(a, b)| (a - b).powi(2));
                squares.map(f64::from).sum::<f64>() / (3 * width * height) as f64
            });
            -10.0 * errors.fold(0.0, f64::max).log10()
        });
        println!("{still:?}, depth {find_depth}: worst frames {worst:.2?} dB");
        (worst, engine)
    };
    let kept = |engine: &Engine| engine.work().stage("still").map(|still| still.avoided).expect("counted");
    let (_, cards) = run(StaticRegions::Keep, false);
    assert!(kept(&cards) > 0, "the band is kept where no depth is found");
    let (found, engine) = run(StaticRegions::Keep, true);
    assert!(engine.resume_point().is_some_and(|point| point.found.is_some()));
    assert_eq!(kept(&engine), 0);
    let (all, _) = run(StaticRegions::Off, true);
    // The depth itself may differ: it is found along flow in the changing part alone.
    assert!(found[1] > all[1] - 0.3, "{found:?} dB, {all:?} dB where nothing is kept");
}
