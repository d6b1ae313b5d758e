//! Videos that break the assumptions of motion and colours: cuts, black, noise, jumps of exposure.

use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};

use super::{Case, Computed, Judged, Place, Unit};
use crate::noise::noise;

const GROUP: &str = "Videos";
/// Columns and rows of a frame: one tile of the embedded model's.
const SIZE: [usize; 2] = [96, 56];
/// Frames from key frame to key frame; all between are passed to the engine.
const GAP: usize = 2;
const FRAMES: usize = 2 * GAP + 1;

/// The pixel of frame `k` at column x, row y, channel c.
type Pixel = fn(usize, [usize; 2], usize) -> f32;

/// Bars that move by three pixels a frame.
fn bars(k: usize, [x, y]: [usize; 2], c: usize) -> f32 {
    let phase = (x + 3 * k) as f32 * 0.3 + y as f32 * 0.1 + c as f32;
    0.5 + 0.4 * phase.sin()
}

/// Checks of another colour.
fn checks([x, y]: [usize; 2], c: usize) -> f32 {
    if (x / 12 + y / 12 + c).is_multiple_of(2) { 0.9 } else { 0.15 }
}

fn frame(k: usize, pixel: Pixel) -> Vec<f32> {
    let [width, height] = SIZE;
    (0..3 * width * height)
        .map(|i| pixel(k, [i % width, i / width % height], i / (width * height)).clamp(0.0, 1.0))
        .collect()
}

fn video(name: &str, pixel: Pixel) -> Case {
    Case::new(GROUP, name, move |place| stream(place, pixel), move |found| judge(found, pixel))
}

/// The images at all key frames, then the colours of all Gaussians at both ends of their intervals.
fn stream(place: Place, pixel: Pixel) -> Computed {
    let settings = Settings { level: Some(place.level), threads: place.threads, ..Settings::default() };
    let mut engine = Engine::new(settings).expect("starts");
    let [width, height] = SIZE;
    let at = |k: usize| (Frame { width, height, rgb: frame(k, pixel), depth: None }, k as f64);
    let (mut images, mut colours, mut dropped) = (Vec::new(), Vec::new(), 0);
    for k in (0..FRAMES).step_by(GAP) {
        let between = (k.saturating_sub(GAP - 1)..k).map(at).collect();
        let (key, time) = at(k);
        let interval = engine.push_with(between, key, time).expect("taken");
        images.extend(
            interval.render(time, &Camera::Canonical, &RenderOptions::default(), engine.workers()).expect("drawn").rgb,
        );
        colours.extend(interval.gaussians.iter().flat_map(|r| [r.rgb_at(0.0), r.rgb_at(1.0)]).flatten());
        dropped += interval.dropped;
    }
    Computed::with(&[images, colours].concat(), [dropped])
}

/// The root mean square of the worst key frame's error.
fn judge(found: &Computed, pixel: Pixel) -> Judged {
    let area = 3 * SIZE[0] * SIZE[1];
    let keys: Vec<usize> = (0..FRAMES).step_by(GAP).collect();
    let mut judged = Judged::new(Unit::Absolute);
    for (image, k) in found.values.chunks_exact(area).zip(&keys) {
        let expected = frame(*k, pixel);
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / area as f64;
        let square = mean(&mut image.iter().zip(&expected).map(|(a, b)| (a - f64::from(*b)).powi(2)));
        judged.take(square.sqrt(), mean(&mut image.iter().copied()), mean(&mut expected.iter().map(|x| f64::from(*x))));
    }
    let colours = &found.values[keys.len() * area..];
    judged
        .and(found.values.iter().all(|x| x.is_finite()), || "a value that is not finite came out".into())
        .and(colours.iter().all(|x| (-4.001..=5.001).contains(x)), || "a colour left its range".into())
        .and(found.rest == [0], || format!("{} dropped", found.rest[0]))
}

pub(super) fn cases() -> Vec<Case> {
    vec![
        video("bars that move, for comparison", bars),
        video("a cut between key frames", |k, at, c| if k < 3 { bars(k, at, c) } else { checks(at, c) }),
        video("a cut at a key frame", |k, at, c| if k < 2 { bars(k, at, c) } else { checks(at, c) }),
        video("black frames", |_, _, _| 0.0),
        video("a black key frame", |k, at, c| if k == 2 { 0.0 } else { bars(k, at, c) }),
        video("a key frame of noise", |k, at, c| match k {
            2 => 0.5 + 0.5 * noise(1, (at[1] * 1000 + at[0] * 3 + c) as u64)[0],
            _ => bars(k, at, c),
        }),
        video("a frame of noise between", |k, at, c| match k {
            1 => 0.5 + 0.5 * noise(1, (at[1] * 1000 + at[0] * 3 + c) as u64)[0],
            _ => bars(k, at, c),
        }),
        video("exposure that doubles", |k, at, c| if k < 2 { 0.5 * bars(0, at, c) } else { bars(0, at, c) }),
        video("white after black", |k, _, _| if k < 2 { 0.0 } else { 1.0 }),
    ]
}
