use streamsplat_model::StaticGaussians;

use super::*;
use crate::stream::StaticRegions;

const SIZE: [usize; 2] = [64, 80];

/// A texture with noise of a standard deviation of about `noise`, the same for the same seed.
fn picture(noise: f32, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1 << 24) as f32 - 0.5
    };
    let texture = |i: usize| 0.5 + 0.2 * ((i % SIZE[1]) as f32 * 0.4).sin() * ((i / SIZE[1]) as f32 * 0.3).cos();
    (0..3 * SIZE[0] * SIZE[1]).map(|i| texture(i) + 12f32.sqrt() * noise * next()).collect()
}

fn blocks() -> Blocks {
    Blocks::of(SIZE).expect("whole cells")
}

fn camera(mean: &[f32], past: Option<&Past>, frames: &[Vec<f32>]) -> Camera {
    camera_within(2.0 / 255.0, mean, past, frames)
}

fn camera_within(close: f64, mean: &[f32], past: Option<&Past>, frames: &[Vec<f32>]) -> Camera {
    let count = frames.len() as f32;
    let frames: Vec<(f32, &[f32])> =
        frames.iter().enumerate().map(|(i, frame)| ((i + 1) as f32 / count, &frame[..])).collect();
    Camera::over(blocks(), mean, past, &frames, close)
}

/// What is kept, if anything; kept blocks of `frames` are replaced by their mean.
fn keep(mean: &[f32], past: Option<&Past>, frames: &mut [Vec<f32>]) -> Option<Kept> {
    let Camera::Static(kept) = camera(mean, past, frames) else { return None };
    let kept = kept?;
    let count = frames.len() as f32;
    for (i, frame) in frames.iter_mut().enumerate() {
        kept.show(mean, (i + 1) as f32 / count, frame);
    }
    Some(kept)
}

fn error(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b) * f64::from(a - b)).sum();
    (sum / a.len() as f64).sqrt()
}

#[test]
fn noise_rests_and_its_mean_comes_nearer_to_the_scene() {
    let truth = picture(0.0, 0);
    for noise in [0.5, 1.5, 3.0, 6.0].map(|n| n / 255.0) {
        let mut mean = picture(noise, 1);
        let mut past = None;
        for interval in 0..6 {
            let mut frames: Vec<Vec<f32>> = (0..4).map(|i| picture(noise, 2 + 4 * interval + i)).collect();
            let kept = keep(&mean, past.as_ref(), &mut frames).expect("all of it");
            assert!(kept.share()[0] * 20 >= kept.share()[1] * 19, "noise {noise}: {:?}", kept.share());
            assert!(kept.mostly());
            (mean, past) = (frames.pop().expect("four"), Some(kept.past));
        }
        assert!(error(&mean, &truth) < 0.35 * f64::from(noise), "{} of {noise}", error(&mean, &truth));
    }
}

#[test]
fn what_moves_changes_and_nothing_else() {
    let noise = 1.5 / 255.0;
    let mean = picture(noise, 1);
    let mut frames: Vec<Vec<f32>> = (0..3).map(|i| picture(noise, 2 + i)).collect();
    // 6×6 pixels, an eighth brighter, in the second block of the second row, in one frame between.
    for (y, x) in (20..26).flat_map(|y| (20..26).map(move |x| (y, x))) {
        frames[1][y * SIZE[1] + x] += 0.125;
    }
    let kept = keep(&mean, None, &mut frames).expect("the rest of it");
    let changed: Vec<usize> = (0..kept.changes.len()).filter(|at| kept.changes[*at] == Change::All).collect();
    assert_eq!(changed, [6]);
    // That block is as it came, the others show the mean in all frames.
    assert!(frames[1][20 * SIZE[1] + 20] != frames[2][20 * SIZE[1] + 20]);
    assert!(frames[1][0] == frames[2][0]);
    assert_eq!(kept.changing().expect("a rectangle"), [0..64, 0..64]);
    assert!(kept.any_in([30..36, 30..36], |change| change == Change::All));
    assert!(!kept.any_in([40..60, 40..60], |change| change == Change::All));
}

#[test]
fn light_that_fades_is_followed_and_light_that_flickers_is_not() {
    let noise = 0.8 / 255.0;
    let mean = picture(noise, 1);
    let lit = |seed: u64, light: f32| -> Vec<f32> { picture(noise, seed).iter().map(|x| x + light / 255.0).collect() };
    let mut fading: Vec<Vec<f32>> = (1..=4).map(|i| lit(1 + i, i as f32)).collect();
    let kept = keep(&mean, None, &mut fading).expect("all of it");
    assert!(kept.changes.iter().all(|change| *change == Change::Colours));
    assert!(error(&fading[3], &lit(9, 4.0)) < 1.9 * f64::from(noise));
    let mut flickering: Vec<Vec<f32>> = [6.0, 0.0, 6.0, 1.0].iter().zip(2..).map(|(l, s)| lit(s, *l)).collect();
    assert!(keep(&mean, None, &mut flickering).is_none());
}

/// Every cell of 4×4 pixels is brighter or darker in each frame, as after coarse quantisation.
fn coded(mean: &[f32], frame: usize, strength: f32) -> Vec<f32> {
    let sign = |i: usize| {
        let (x, y) = (i % SIZE[1] / CELL, i / SIZE[1] / CELL);
        if (x + y + (frame >> (x / 4 % 2))).is_multiple_of(2) { 1.0 } else { -1.0 }
    };
    mean.iter().enumerate().map(|(i, value)| value + sign(i) * strength / 255.0).collect()
}

#[test]
fn blocks_that_a_codec_updates_are_kept_while_they_are_close_to_their_mean() {
    let mean = picture(0.0, 0);
    let mut frames: Vec<Vec<f32>> = (0..4).map(|frame| coded(&mean, frame, 1.5)).collect();
    let came = frames.clone();
    let kept = keep(&mean, None, &mut frames).expect("all of it");
    assert_eq!(kept.share(), [20, 20]);
    for (shown, came) in frames.iter().zip(&came) {
        assert!(error(shown, came) < 2.0 / 255.0, "{}", 255.0 * error(shown, came));
    }
    let mut frames: Vec<Vec<f32>> = (0..4).map(|frame| coded(&mean, frame, 2.5)).collect();
    assert!(keep(&mean, None, &mut frames).is_none());
}

#[test]
fn loose_regions_are_kept_while_they_are_within_three_levels_of_their_mean() {
    let mean = picture(0.0, 0);
    for (strength, kept) in [(1.5, [true, true]), (2.2, [false, true]), (2.5, [false, false])] {
        let frames: Vec<Vec<f32>> = (0..4).map(|frame| coded(&mean, frame, strength)).collect();
        for (still, expected) in [StaticRegions::Keep, StaticRegions::Loose].into_iter().zip(kept) {
            let camera = camera_within(still.close().expect("some are kept"), &mean, None, &frames);
            let found = matches!(camera, Camera::Static(Some(_)));
            assert_eq!(found, expected, "{strength}, {still}");
        }
    }
    assert_eq!(StaticRegions::Off.close(), None);
}

#[test]
fn a_mean_stays_within_the_range_of_pictures_however_bright_it_becomes() {
    let bright = |seed: u64, light: f32| -> Vec<f32> {
        picture(0.4 / 255.0, seed).iter().map(|x| (x + 0.28 + light / 255.0).min(1.0)).collect()
    };
    let mut frames: Vec<Vec<f32>> = (1..=3).map(|i| bright(1 + i, 2.0 * i as f32)).collect();
    let kept = keep(&bright(1, 0.0), None, &mut frames).expect("nearly all of it");
    assert!(kept.changes.iter().filter(|change| **change == Change::Colours).count() > 10);
    let rgb = frames.pop().expect("three");
    assert!(rgb.iter().all(|x| (0.0..=1.0).contains(x)));
}

#[test]
fn a_scene_without_noise_keeps_what_is_equal() {
    let mean = picture(0.0, 0);
    let mut frames = vec![mean.clone(); 3];
    for (y, x) in (4..8).flat_map(|y| (4..8).map(move |x| (y, x))) {
        frames[2][y * SIZE[1] + x] += 0.05;
    }
    let at = 4 * SIZE[1] + 4;
    let before = frames[2][at];
    let kept = keep(&mean, None, &mut frames).expect("nearly all of it");
    assert_eq!(kept.share(), [19, 20]);
    assert_eq!(frames[2][at].to_bits(), before.to_bits());
    assert!(frames[0].iter().zip(&mean).all(|(a, b)| a.to_bits() == b.to_bits()));
    assert!(kept.changes[1..].iter().all(|change| *change == Change::Colours || *change == Change::None));
}

#[test]
fn kept_details_follow_the_models_own_in_their_order() {
    use Change::{All, Colours, None};
    let keeps = Keeps::new(vec![None, All, Colours, All, None, All, Colours], 3);
    let indices: Vec<Option<usize>> = (0..7).map(|at| keeps.index(at)).collect();
    assert_eq!(indices, [Some(0), Option::None, Some(2), Option::None, Some(3), Option::None, Some(4)]);
    // New details come after the two kept ones.
    let held: Vec<bool> = (0..7).map(|at| keeps.holds(at)).collect();
    assert_eq!(held, [true, false, true, true, true, false, false]);
    assert_eq!(keeps.of_new().collect::<Vec<_>>(), [None, All, Colours, None, Colours]);
    assert_eq!((keeps.details(), keeps.of_own()), (2, &[None, All, Colours][..]));
    let of = |opacities: &[f32]| {
        let one = |opacity: &f32| streamsplat_model::StaticGaussian { opacity: *opacity, ..Default::default() };
        opacities.iter().map(one).collect::<StaticGaussians>()
    };
    let mut now = of(&[0.1, 0.2, 0.3]);
    with_kept(&mut now, &of(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]), &keeps);
    assert_eq!(now.opacity, [1.0, 0.2, 3.0, 5.0, 7.0]);
}

#[test]
fn a_moving_picture_keeps_nothing() {
    let mean = picture(0.0, 0);
    let mut moved = mean.clone();
    moved.rotate_left(3);
    assert!(matches!(camera(&mean, None, &[moved]), Camera::Moving));
}

#[test]
fn a_static_camera_is_static_while_a_codec_or_light_changes_the_picture() {
    let mean = picture(0.0, 0);
    // Each cell is brighter or darker by 5/255, and all of them by the step of exposure.
    let coded = |step: f32| -> Vec<f32> {
        let sign = |i: usize| if (i % SIZE[1] / CELL + i / SIZE[1] / CELL).is_multiple_of(2) { 1.0 } else { -1.0 };
        mean.iter().enumerate().map(|(i, value)| value + (5.0 * sign(i) + step) / 255.0).collect()
    };
    let frames: Vec<Vec<f32>> = [12.0, -9.0, 6.0].into_iter().map(coded).collect();
    assert!(matches!(camera(&mean, None, &frames), Camera::Static(None)));
    // A quarter of the blocks is not enough.
    let steady = coded(0.0);
    let moved = (0..3 * SIZE[0] * SIZE[1]).map(|i| {
        let row = i / SIZE[1] % SIZE[0];
        if row < SIZE[0] / 4 { steady[i] } else { mean[(i + 3) % mean.len()] }
    });
    let moved = moved.collect();
    assert!(matches!(camera(&mean, None, &[moved]), Camera::Moving));
}

#[test]
fn a_past_that_does_not_fit_is_found() {
    let past = Past::none(blocks(), &picture(0.0, 0));
    assert_eq!(past.contradiction(SIZE), None);
    assert!(past.contradiction([64, 96]).is_some());
    let zero = Past { count: vec![0; past.count.len()], ..past.clone() };
    assert!(zero.contradiction(SIZE).is_some());
    assert!(Blocks::of([10, 16]).is_none() && Blocks::of([0, 16]).is_none());
}
