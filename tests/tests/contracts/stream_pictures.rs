//! The embedded model with its defaults: tiles, motion from flow and fitted colours leave no seam, change no bit where
//! they save work, and work at odd sizes.

use std::time::{Duration, Instant};

use streamsplat::stream::{Quality, Reuse};
use streamsplat::{Camera, Engine, Frame, Image, Interval, RenderOptions, Settings};
use streamsplat_fixtures::clip::{Clip, ClipKind};
use streamsplat_tests::{bits, workers};

/// Frame `k` of a clip whose camera moves, and its time.
fn frame(clip: &Clip, k: usize) -> (Frame, f64) {
    let time = k as f64 / 24.0;
    let picture = clip.picture(time);
    (Frame { width: picture.width, height: picture.height, rgb: picture.rgb, depth: None }, time)
}

fn draw(interval: &Interval, time: f64) -> Image {
    interval.render(time, &Camera::Canonical, &RenderOptions::default(), workers()).expect("drawn")
}

/// Key frames 0, 3, 6, 6 again and 9 of a clip with the frames in between.
fn stream(quality: Quality, reuse: Reuse) -> (Vec<Interval>, Engine) {
    let clip = Clip::new(ClipKind::StaticCamera, 3, 320, 176);
    let mut engine = Engine::new(Settings { reuse, ..Settings::of_quality(quality) }).expect("starts");
    let mut intervals = Vec::new();
    for (place, k) in [0_usize, 3, 6, 6, 9].into_iter().enumerate() {
        let time = place as f64;
        let between = match place {
            // A pause: no frame is between the two equal ones.
            0 | 3 => Vec::new(),
            _ => vec![(frame(&clip, k - 2).0, time - 0.66), (frame(&clip, k - 1).0, time - 0.33)],
        };
        intervals.push(engine.push_with(between, frame(&clip, k).0, time).expect("taken"));
    }
    (intervals, engine)
}

#[test]
fn exact_savings_change_no_bit_of_tiles_flow_and_colours() {
    for &quality in Quality::ALL {
        let (plain, _) = stream(quality, Reuse::Off);
        let (saving, engine) = stream(quality, Reuse::Exact);
        for (a, b) in plain.iter().zip(&saving) {
            assert!(bits(&a.gaussians) == bits(&b.gaussians), "{quality}, interval {}", a.index);
            assert_eq!(draw(a, 0.5 * (a.start + a.end)), draw(b, 0.5 * (b.start + b.end)));
        }
        let count = |stage| engine.work().stage(stage).map(|s| (s.done, s.avoided)).expect("counted");
        // The pause: four tiles are kept, and the flow between equal frames is zero.
        assert!(count("encoder").1 >= 4, "{:?} tiles kept", count("encoder"));
        assert!(count("flow").1 >= 1);
        // Motion is from flow, and all fade alike: four pairs of four tiles.
        assert_eq!(count("decoder"), (0, 16));
    }
}

#[test]
fn crossing_a_key_frame_changes_no_bit_of_fitted_colours() {
    let (intervals, _) = stream(Quality::Balanced, Reuse::Exact);
    for pair in intervals.windows(2) {
        assert_eq!(draw(&pair[0], pair[0].end), draw(&pair[1], pair[1].start), "key frame {}", pair[0].index);
    }
}

/// Mean squared errors within 4 pixels of the tiles' borders, and elsewhere.
fn errors(image: &Image, truth: &[f32]) -> [f64; 2] {
    let (width, height) = (image.width, image.height);
    let near = |at: usize, side: usize| (at as f64 + 0.5 - side as f64 / 2.0).abs() < 4.0;
    let mut sums = [[0.0, 0.0]; 2];
    for (i, (a, b)) in image.rgb.iter().zip(truth).enumerate() {
        let (x, y) = (i % width, i / width % height);
        let sum = &mut sums[usize::from(!(near(x, width) || near(y, height)))];
        *sum = [sum[0] + f64::from(a - b).powi(2), sum[1] + 1.0];
    }
    sums.map(|[sum, count]| sum / count)
}

/// A texture that looks the same everywhere, moving by two pixels a frame: waves of many lengths and directions.
fn waves(seed: usize, k: usize) -> Frame {
    let (width, height) = (512, 288);
    let waves: Vec<[f32; 4]> = (0..24)
        .map(|i| {
            let angle = (i * 7 + seed * 3) as f32;
            let length = 4.0 * 1.2_f32.powi(i as i32 % 16);
            let [dx, dy] = [angle.cos(), angle.sin()].map(|c| std::f32::consts::TAU * c / length);
            [dx, dy, (i * i + seed) as f32, 0.02 + 0.002 * length.min(20.0)]
        })
        .collect();
    let pixel = |i: usize| {
        let (x, y, c) = (i % width + 2 * k, i / width % height, i / (width * height));
        let sum: f32 = waves
            .iter()
            .map(|[dx, dy, phase, size]| size * (x as f32 * dx + y as f32 * dy + phase * (1.0 + c as f32)).sin())
            .sum();
        (0.5 + sum).clamp(0.0, 1.0)
    };
    Frame { width, height, rgb: (0..3 * width * height).map(pixel).collect(), depth: None }
}

#[test]
fn tiles_leave_no_seam() {
    let (mut key, mut middle) = ([0.0; 2], [0.0; 2]);
    for seed in 0..3 {
        let mut engine = Engine::new(Settings::default()).expect("starts");
        for k in [0, 2, 4] {
            let between = if k == 0 { Vec::new() } else { vec![(waves(seed, k - 1), k as f64 - 1.0)] };
            let interval = engine.push_with(between, waves(seed, k), k as f64).expect("taken");
            for at in [k, k.saturating_sub(1)] {
                let [seam, elsewhere] = errors(&draw(&interval, at as f64), &waves(seed, at).rgb);
                let sums = if at == k { &mut key } else { &mut middle };
                *sums = [sums[0] + seam, sums[1] + elsewhere];
            }
        }
    }
    for (what, [seam, elsewhere]) in [("key frames", key), ("between", middle)] {
        println!(
            "{what}: mean squared error at seams {seam:.3e}, elsewhere {elsewhere:.3e}, ratio {:.2}",
            seam / elsewhere
        );
        assert!(seam <= 1.1 * elsewhere, "{what}: {seam:e} at seams, {elsewhere:e} elsewhere");
    }
}

#[test]
fn a_4k_source_is_taken_at_the_default_size_within_bounds_of_time() {
    let (width, height) = (3840, 2160);
    let pixel = |k: usize, i: usize| 0.5 + 0.4 * ((i % width + 8 * k) as f32 * 0.01 + (i / width) as f32 * 0.003).sin();
    let mut engine = Engine::new(Settings::default()).expect("starts");
    let start = Instant::now();
    for k in 0..2 {
        let rgb = (0..3 * width * height).map(|i| pixel(k, i)).collect();
        let interval = engine.push(Frame { width, height, rgb, depth: None }, k as f64).expect("taken");
        let image = draw(&interval, interval.end);
        assert_eq!([image.height, image.width], [288, 512]);
        assert!(image.rgb.iter().all(|x| x.is_finite()));
    }
    // Seconds on two cores; a debug build or a busy machine may take several times that.
    assert!(start.elapsed() < Duration::from_secs(60), "{:?}", start.elapsed());
}
