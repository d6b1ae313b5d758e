//! Views of scenes of cards from cameras led around them, beside the true ones.

use std::sync::Arc;

use streamsplat::camera::{Pose, Rotation};
use streamsplat::stream::{DepthRange, FAR, Interval, NEAR};
use streamsplat::{Camera, Engine, EngineError, Frame, RenderOptions, Settings};
use streamsplat_fixtures::clip::cards::{CardPicture, Cards};
use streamsplat_kernels::math::f64::sin_cos;

use crate::workers;

/// Mean PSNR in dB over key frames and their views from both sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Score {
    /// Views, where they show what the key frame shows.
    pub views: f64,
    /// The foreground of views, where they show what the key frame shows.
    pub foreground: f64,
    /// Views where they show what the key frame hides.
    pub behind: f64,
    /// Key frames from their own camera.
    pub key: f64,
    /// The true key frame turned as a card, as `views` and `foreground`.
    pub card: [f64; 2],
    /// Views.
    pub count: usize,
}

/// A camera turned by `degrees` about a vertical axis at the distance `pivot`, in half widths of a picture of `aspect` = width / height.
///
/// # Panics
/// Never: a turn about an axis is a rotation.
pub fn around(degrees: f64, pivot: f64, aspect: f64) -> Camera {
    let (sin, cos) = sin_cos(degrees.to_radians());
    let rotation = Rotation::from_columns([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]]).expect("orthonormal");
    let back = pivot + 1.0;
    let position = [-back * sin, 0.0, pivot - back * cos].map(|x| aspect * x);
    Camera::orthographic(Pose { position, rotation })
}

/// Mean distance of what the interval shows at `time` from its own camera.
///
/// # Errors
/// As [`Interval::render`].
pub fn middle(interval: &Interval, time: f64) -> Result<f64, streamsplat::render::RenderError> {
    let options = RenderOptions { depth: true, alpha: true, ..RenderOptions::default() };
    let image = interval.render(time, &Camera::Canonical, &options, workers())?;
    let planes = image.depth.iter().flatten().zip(image.alpha.iter().flatten());
    let (sum, count) = planes.fold((0.0, 0.0), |(sum, count), (depth, alpha)| {
        (sum + f64::from(*depth) / f64::from(*alpha).max(1e-6), count + 1.0)
    });
    Ok(sum / count)
}

/// The key frame of a scene, with its true depth where `depth` is true, through an engine of these settings.
///
/// # Errors
/// As [`Engine::push`].
pub fn reconstruct(
    engine: &mut Engine,
    straight: &CardPicture,
    size: [usize; 2],
    depth: bool,
) -> Result<Interval, EngineError> {
    let [height, width] = size;
    let map = || straight.y.iter().map(|y| (y - FAR) / (NEAR - FAR)).collect();
    let frame = Frame { width, height, rgb: straight.rgb.clone(), depth: depth.then(map) };
    engine.push(frame, 0.0)
}

/// The score of single key frames of `scenes`, views at ±`degrees`. Each image, with its name, goes to `show`.
///
/// # Panics
/// When the engine refuses what it should take.
pub fn score(
    settings: &Settings,
    scenes: &[Cards],
    depth: bool,
    degrees: f64,
    mut show: impl FnMut(&str, usize, &[f32]),
) -> Score {
    let settings = Settings { depth_range: DepthRange::Given, ..settings.clone() };
    let model = Arc::clone(Engine::new(settings.clone()).expect("starts").model());
    let mut sum = Score::default();
    let mut hidden = 0;
    for (index, scene) in scenes.iter().enumerate() {
        let straight = scene.straight(0.0);
        if straight.foreground.iter().filter(|front| **front).count() < 50 {
            continue;
        }
        let mut engine = Engine::with_model(settings.clone(), model.clone()).expect("starts");
        let interval = reconstruct(&mut engine, &straight, scene.size(), depth).expect("taken");
        let options = RenderOptions::default();
        let own = interval.render(0.0, &Camera::Canonical, &options, workers()).expect("drawn").rgb;
        show("key-true", index, &straight.rgb);
        show("key", index, &own);
        for degrees in [degrees, -degrees] {
            let (view, pivot) = scene.turned(0.0, degrees);
            let pivot = if depth { pivot } else { middle(&interval, 0.0).expect("drawn") };
            let camera = around(degrees, pivot, interval.placement.aspect());
            let found = interval.render(0.0, &camera, &options, workers()).expect("drawn").rgb;
            let side = if degrees > 0.0 { "right" } else { "left" };
            show(&format!("{side}-true"), index, &view.rgb);
            show(side, index, &found);
            let card = flat(&straight.rgb, scene.size(), degrees);
            let front: Vec<bool> = view.known.iter().zip(&view.foreground).map(|(a, b)| *a && *b).collect();
            let behind: Vec<bool> = view.known.iter().map(|known| !known).collect();
            sum.views += psnr(&found, &view.rgb, |i| view.known[i]);
            sum.foreground += psnr(&found, &view.rgb, |i| front[i]);
            if behind.iter().any(|b| *b) {
                sum.behind += psnr(&found, &view.rgb, |i| behind[i]);
                hidden += 1;
            }
            sum.key += psnr(&own, &straight.rgb, |_| true);
            sum.card[0] += psnr(&card, &view.rgb, |i| view.known[i]);
            sum.card[1] += psnr(&card, &view.rgb, |i| front[i]);
            sum.count += 1;
        }
    }
    let mean = |sum_of: f64| sum_of / sum.count as f64;
    Score {
        views: mean(sum.views),
        foreground: mean(sum.foreground),
        behind: sum.behind / f64::from(hidden),
        key: mean(sum.key),
        card: sum.card.map(mean),
        count: sum.count,
    }
}

/// PSNR over the pixels that `counts`, in dB; at most 100.
fn psnr(a: &[f32], b: &[f32], counts: impl Fn(usize) -> bool) -> f64 {
    let area = a.len() / 3;
    let (mut sum, mut count) = (0.0, 0.0);
    for pixel in (0..area).filter(|i| counts(*i)) {
        for channel in 0..3 {
            let [a, b] = [a, b].map(|image| f64::from(image[channel * area + pixel].clamp(0.0, 1.0)));
            sum += (a - b) * (a - b);
            count += 1.0;
        }
    }
    if count == 0.0 { 100.0 } else { -10.0 * (sum / count + 1e-10).log10() }
}

/// A picture turned as a card about its own middle.
fn flat(rgb: &[f32], [height, width]: [usize; 2], degrees: f64) -> Vec<f32> {
    let (_, cos) = sin_cos(degrees.to_radians());
    let middle = 0.5 * (width as f64 - 1.0);
    let mut out = Vec::with_capacity(rgb.len());
    for row in rgb.chunks_exact(width).take(3 * height) {
        for x in 0..width {
            let at = ((x as f64 - middle) / cos + middle).clamp(0.0, width as f64 - 1.0);
            let (low, high) = (at.floor() as usize, at.ceil() as usize);
            let part = (at - at.floor()) as f32;
            out.push(row[low] * (1.0 - part) + row[high] * part);
        }
    }
    out
}
