//! Views of scenes of cards from cameras around them, compared with the true ones.

use std::sync::Arc;

use streamsplat::camera::{Pose, Rotation};
use streamsplat::stream::{DepthRange, Interval, Reconstructor};
use streamsplat::world::{FAR, NEAR};
use streamsplat::{Camera, Engine, EngineError, Frame, RenderOptions, Settings};
use streamsplat_fixtures::clip::cards::{CardPicture, Cards};
use streamsplat_kernels::Level;
use streamsplat_kernels::math::f64::sin_cos;

use crate::workers;

/// Mean PSNR in dB over key frames and their views from both sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Score {
    /// Views, at pixels whose surface the key frame shows.
    pub views: f64,
    /// The foreground of views, at pixels whose surface the key frame shows.
    pub foreground: f64,
    /// Views, at pixels whose surface the key frame hides.
    pub behind: f64,
    /// Views, at pixels whose surface the key frame hides and an earlier one showed.
    pub covered: f64,
    /// Views halfway between the last two key frames, with the frames between them as input, at pixels whose surface
    /// the straight picture of that time shows. Only with true depth.
    pub middle: f64,
    /// Key frames from their own camera.
    pub key: f64,
    /// The true key frame turned as a card, as `views` and `foreground`.
    pub card: [f64; 2],
    /// Views.
    pub count: usize,
    /// Scenes.
    pub scenes: usize,
    /// Scenes whose depth was found by parallax.
    pub found: usize,
}

/// A camera turned by `degrees` about a vertical axis at the distance `pivot`, in half widths of a picture of `aspect`
/// = width / height.
///
/// # Panics
/// Never: a turn about an axis is a valid rotation.
pub fn around(degrees: f64, pivot: f64, aspect: f64) -> Camera {
    let (sin, cos) = sin_cos(degrees.to_radians());
    let rotation = Rotation::from_columns([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]]).expect("orthonormal");
    let back = pivot + 1.0;
    let position = [-back * sin, 0.0, pivot - back * cos].map(|x| aspect * x);
    Camera::orthographic(Pose { position, rotation })
}

/// Mean distance of the interval's visible Gaussians at `time` from its own camera.
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

/// The depth to which scenes are lifted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// None: the model's own.
    None,
    /// The true one.
    True,
    /// The one found by parallax, in the engine's scale.
    Found,
    /// The one found by parallax, in the true scale by least squares; `None` where none was found.
    FoundInScale,
    /// The same, guessed where none was found.
    GuessedInScale,
}

/// Takes pictures of a scene, a second apart, through an engine of these settings. Returns the interval of the last one
/// and the inverse depth found for it.
///
/// # Errors
/// As [`Engine::push`].
pub fn reconstruct(
    engine: &mut Engine,
    pictures: &[CardPicture],
    size: [usize; 2],
    depth: bool,
) -> Result<(Interval, Option<Vec<f32>>), EngineError> {
    let mut last = None;
    for (picture, second) in pictures.iter().zip(0u32..) {
        let map = || map_of(&picture.y);
        last = Some(engine.push(frame(picture, size, depth.then(map)), f64::from(second))?);
    }
    let found = engine.resume_point().and_then(|point| point.found);
    let map = found.zip(pictures.last()).map(|(found, picture)| found.map(Level::detect(), &picture.rgb, size));
    Ok((last.expect("a picture"), map))
}

/// The last interval of a scene at these times with true depth, and with frames at three times between key frames as
/// input.
fn seen_between(engine: &mut Engine, scene: &Cards, times: &[f64]) -> Result<Interval, EngineError> {
    let size = scene.size();
    let with_map = |time: f64| {
        let picture = scene.straight(time);
        frame(&picture, size, Some(map_of(&picture.y)))
    };
    let mut last = engine.push(with_map(times[0]), 0.0)?;
    for (pair, second) in times.windows(2).zip(0u32..) {
        let part = |share: f64| (pair[0] + share * (pair[1] - pair[0]), f64::from(second) + share);
        let between =
            [0.25, 0.5, 0.75].map(part).map(|(time, second)| (frame(&scene.straight(time), size, None), second));
        last = engine.push_with(between.into(), with_map(pair[1]), f64::from(second) + 1.0)?;
    }
    Ok(last)
}

/// The values of a depth map for these y.
fn map_of(y: &[f32]) -> Vec<f32> {
    y.iter().map(|y| (y - FAR) / (NEAR - FAR)).collect()
}

fn frame(picture: &CardPicture, [height, width]: [usize; 2], depth: Option<Vec<f32>>) -> Frame {
    Frame { width, height, rgb: picture.rgb.clone(), depth }
}

/// y of a map's values, after scaling the inverse distances `9.8·y + 0.2` to those of the true `y` by one factor, by
/// least squares.
fn in_scale(map: &[f32], truth: &[f32]) -> Vec<f32> {
    let inverse = |y: f32| 9.8 * f64::from(y) + 0.2;
    let found = |d: f32| inverse((NEAR - FAR).mul_add(d, FAR));
    let (mut product, mut square) = (0.0, 0.0);
    for (d, y) in map.iter().zip(truth) {
        product += found(*d) * inverse(*y);
        square += found(*d) * found(*d);
    }
    map.iter().map(|d| ((found(*d) * product / square - 0.2) / 9.8) as f32).collect()
}

/// Engines of one model, for scenes one after another.
struct Engines {
    settings: Settings,
    model: Arc<dyn Reconstructor>,
    depth: Depth,
}

/// The last key frame of a scene.
struct LastKey {
    /// The true picture.
    straight: CardPicture,
    interval: Interval,
    /// True if depth was found by parallax, or guessed.
    found: bool,
    /// True if the interval's depth is in the true scale.
    true_scale: bool,
}

impl Engines {
    fn new(settings: &Settings, depth: Depth) -> Self {
        let guesses = depth == Depth::GuessedInScale;
        let settings = Settings {
            depth_range: DepthRange::Given,
            find_depth: Some(guesses || matches!(depth, Depth::Found | Depth::FoundInScale)),
            guess_depth: Some(guesses),
            ..settings.clone()
        };
        let model = Arc::clone(Engine::new(settings.clone()).expect("starts").model());
        Self { settings, model, depth }
    }

    fn start(&self) -> Engine {
        Engine::with_model(self.settings.clone(), self.model.clone()).expect("starts")
    }

    /// Takes the pictures of a scene at these times through an engine.
    fn last_key(&self, scene: &Cards, times: &[f64]) -> LastKey {
        let mut pictures: Vec<CardPicture> = times.iter().map(|time| scene.straight(*time)).collect();
        let (mut interval, map) =
            reconstruct(&mut self.start(), &pictures, scene.size(), self.depth == Depth::True).expect("taken");
        let straight = pictures.pop().expect("a time");
        let mut true_scale = self.depth == Depth::True;
        if let (Depth::FoundInScale | Depth::GuessedInScale, Some(map)) = (self.depth, &map) {
            let map = map_of(&in_scale(map, &straight.y));
            interval = self.start().push(frame(&straight, scene.size(), Some(map)), 0.0).expect("taken");
            true_scale = true;
        }
        LastKey { straight, interval, found: map.is_some(), true_scale }
    }
}

impl LastKey {
    /// The image of a camera turned by `degrees` about the true distance, or the interval's own if its scale is
    /// another.
    fn turned(&self, degrees: f64, true_pivot: f64) -> Vec<f32> {
        let Self { interval, true_scale, .. } = self;
        let pivot = if *true_scale { true_pivot } else { middle(interval, interval.end).expect("drawn") };
        self.drawn(&around(degrees, pivot, interval.placement.aspect()))
    }

    fn drawn(&self, camera: &Camera) -> Vec<f32> {
        self.interval.render(self.interval.end, camera, &RenderOptions::default(), workers()).expect("drawn").rgb
    }
}

/// The score of the last key frames of `scenes`, with pictures at `times` and views at ±`degrees`. Each image, with its
/// name, is passed to `show`.
///
/// # Panics
/// When the engine refuses a valid input.
pub fn score(
    settings: &Settings,
    scenes: &[Cards],
    depth: Depth,
    times: &[f64],
    degrees: f64,
    mut show: impl FnMut(&str, usize, &[f32]),
) -> Score {
    let engines = Engines::new(settings, depth);
    let (mut sum, mut hidden, mut covered, mut halfway) = (Score::default(), 0, 0, 0);
    for (index, scene) in scenes.iter().enumerate() {
        let time = times[times.len() - 1];
        if scene.straight(time).foreground.iter().filter(|front| **front).count() < 50 {
            continue;
        }
        let last = engines.last_key(scene, times);
        let straight = &last.straight;
        sum.found += usize::from(last.found);
        sum.scenes += 1;
        let options = RenderOptions::default();
        if depth == Depth::True && times.len() > 1 {
            let half = 0.5 * (times[times.len() - 2] + time);
            let seen = seen_between(&mut engines.start(), scene, times).expect("taken");
            for degrees in [degrees, -degrees] {
                let (view, pivot) = scene.turned(half, degrees);
                let camera = around(degrees, pivot, seen.placement.aspect());
                let shown =
                    seen.render(0.5 * (seen.start + seen.end), &camera, &options, workers()).expect("drawn").rgb;
                sum.middle += psnr(&shown, &view.rgb, |i| view.known[i]);
                halfway += 1;
            }
        }
        let own = last.drawn(&Camera::Canonical);
        show("key-true", index, &straight.rgb);
        show("key", index, &own);
        for degrees in [degrees, -degrees] {
            let (view, turned) = scene.turned(time, degrees);
            let found = last.turned(degrees, turned);
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
            let earlier: Vec<Vec<bool>> =
                times[..times.len() - 1].iter().map(|earlier| scene.shown(time, degrees, turned, *earlier)).collect();
            let remembered = |i: usize| behind[i] && earlier.iter().any(|shown| shown[i]);
            if (0..behind.len()).any(remembered) {
                sum.covered += psnr(&found, &view.rgb, remembered);
                covered += 1;
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
        covered: if covered > 0 { sum.covered / f64::from(covered) } else { 0.0 },
        middle: if halfway > 0 { sum.middle / f64::from(halfway) } else { 0.0 },
        key: mean(sum.key),
        card: sum.card.map(mean),
        ..sum
    }
}

/// Quality of a moving body from both sides: means over scenes, at their last key frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct BodyScore {
    /// PSNR in dB on the body and within [`AROUND`] pixels of it.
    pub around: f64,
    /// Share of these pixels whose colour is neither in the true view nor in the scenery behind the body there.
    pub invented: f64,
    /// PSNR in dB of the key frame from its own camera, on the same pixels.
    pub key: f64,
    /// `around` and `invented` of the true key frame turned as a card.
    pub card: [f64; 2],
    /// Scenes whose depth was found by parallax.
    pub found: usize,
    /// Scenes.
    pub scenes: usize,
}

/// Pixels around a body, of a picture 256 wide, that count with it.
pub const AROUND: usize = 16;
/// Difference of a channel from which on colours count as different.
const OTHER: f32 = 0.15;
/// Pixels within which a colour may be found.
const WITHIN: usize = 3;

/// The score of scenes [with a body](Cards::with_body) at these times, with views at ±`degrees`. Each image, with its
/// name, is passed to `show`.
///
/// # Panics
/// When the engine refuses a valid input.
pub fn score_bodies(
    settings: &Settings,
    scenes: &[Cards],
    depth: Depth,
    times: &[f64],
    degrees: f64,
    mut show: impl FnMut(&str, usize, &[f32]),
) -> BodyScore {
    let engines = Engines::new(settings, depth);
    let (mut sum, mut views) = (BodyScore::default(), 0.0);
    for (index, scene) in scenes.iter().enumerate() {
        let (size, time) = (scene.size(), times[times.len() - 1]);
        let reach = AROUND * size[1] / 256;
        let last = engines.last_key(scene, times);
        let straight = &last.straight;
        sum.found += usize::from(last.found);
        sum.scenes += 1;
        let own = last.drawn(&Camera::Canonical);
        let here = around_of(&scene.shows_body(time, 0.0), size, reach);
        sum.key += psnr(&own, &straight.rgb, |i| here[i]);
        show("key-true", index, &straight.rgb);
        show("key", index, &own);
        for degrees in [degrees, -degrees] {
            let (view, turned) = scene.turned(time, degrees);
            let behind = scene.without_body().turned_about(time, degrees, turned);
            let found = last.turned(degrees, turned);
            let side = if degrees > 0.0 { "right" } else { "left" };
            show(&format!("{side}-true"), index, &view.rgb);
            show(side, index, &found);
            let card = flat(&straight.rgb, size, degrees);
            let here = around_of(&scene.shows_body(time, degrees), size, reach);
            sum.around += psnr(&found, &view.rgb, |i| here[i]);
            sum.card[0] += psnr(&card, &view.rgb, |i| here[i]);
            let invented = |image: &[f32]| {
                let all = here.iter().filter(|here| **here).count().max(1) as f64;
                let known = |pixel: usize| [&view.rgb, &behind.rgb].iter().any(|rgb| holds(rgb, size, image, pixel));
                (0..here.len()).filter(|i| here[*i] && !known(*i)).count() as f64 / all
            };
            sum.invented += invented(&found);
            sum.card[1] += invented(&card);
            views += 1.0;
        }
    }
    BodyScore {
        around: sum.around / views,
        invented: sum.invented / views,
        key: sum.key / sum.scenes as f64,
        card: sum.card.map(|sum| sum / views),
        ..sum
    }
}

/// True where one of the pixels to `reach` in rows and columns is in `mask`.
fn around_of(mask: &[bool], [height, width]: [usize; 2], reach: usize) -> Vec<bool> {
    let near = |i: usize, side: usize| i.saturating_sub(reach)..(i + reach + 1).min(side);
    let rows: Vec<bool> =
        (0..mask.len()).map(|i| near(i % width, width).any(|x| mask[i / width * width + x])).collect();
    (0..mask.len()).map(|i| near(i / width, height).any(|y| rows[y * width + i % width])).collect()
}

/// True if `rgb` has the colour of a pixel of `image` near that pixel.
fn holds(rgb: &[f32], [height, width]: [usize; 2], image: &[f32], pixel: usize) -> bool {
    let area = width * height;
    let near = |i: usize, side: usize| i.saturating_sub(WITHIN)..(i + WITHIN + 1).min(side);
    near(pixel / width, height).any(|y| {
        near(pixel % width, width).any(|x| {
            let at = y * width + x;
            (0..3).all(|c| (rgb[c * area + at] - image[c * area + pixel].clamp(0.0, 1.0)).abs() < OTHER)
        })
    })
}

/// PSNR over the pixels that `counts` selects, in dB; at most 100.
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

/// A picture turned like a card about its own middle.
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

/// How far straight edges of a static picture are from straight lines after the camera is turned, in pixels:
/// root mean square and 95th percentile over all rows of all edges.
///
/// The picture has slanted bars. No depth is found in it, so it is reconstructed as a card, and the orthographic views
/// of a card keep lines straight. In each row an edge is where brightness crosses the mean of both bars; the line is
/// fitted by least squares.
///
/// # Panics
/// When the engine refuses a valid input.
pub fn edges_from_lines(settings: &Settings, degrees: f64, [height, width]: [usize; 2]) -> [f64; 2] {
    const DARK: f64 = 0.2;
    const LIGHT: f64 = 0.8;
    let (period, slant) = (width as f64 / 12.0, 0.1);
    // Brightness of a pixel: the share of its width on either side of each edge.
    let bar = |x: f64| {
        let phase = (x / period).rem_euclid(1.0) * period;
        let light = (phase + 0.5).clamp(0.0, 1.0) - (phase - 0.5 * period + 0.5).clamp(0.0, 1.0);
        let next = (phase - period + 0.5).clamp(0.0, 1.0);
        (LIGHT - DARK).mul_add(light + next, DARK)
    };
    let row = |y: usize| (0..width).map(move |x| bar(x as f64 - slant * y as f64) as f32);
    let plane: Vec<f32> = (0..height).flat_map(row).collect();
    let picture = CardPicture { rgb: [&plane[..]; 3].concat(), ..CardPicture::default() };
    let engines = Engines::new(settings, Depth::Found);
    let pictures = [picture.clone(), picture.clone(), picture];
    let (interval, found) = reconstruct(&mut engines.start(), &pictures, [height, width], false).expect("taken");
    assert!(found.is_none(), "nothing moves");
    let key = LastKey { straight: CardPicture::default(), interval, found: false, true_scale: false };
    let mut astray = Vec::new();
    for side in [-degrees, degrees] {
        let image = key.turned(side, 0.0);
        let brightness = |x: usize, y: usize| f64::from(image[width * height + y * width + x]);
        let middle = (width as f64 - 1.0) * 0.5;
        let narrower = side.to_radians().cos();
        // Edges in the middle two thirds, from the first row on.
        for edge in (0..24).map(|k| f64::from(k) * 0.5 * period).filter(|x| (x - middle).abs() < width as f64 / 3.0) {
            let places: Vec<(f64, f64)> = (8..height - 8)
                .filter_map(|y| {
                    let guess = (edge + slant * y as f64 - 0.5 - middle).mul_add(narrower, middle);
                    let first = (guess - 0.25 * period * narrower).max(0.0) as usize;
                    let last = ((guess + 0.25 * period * narrower) as usize).min(width - 2);
                    let crossing = (first..last).find_map(|x| {
                        let [a, b] = [brightness(x, y), brightness(x + 1, y)].map(|v| v - 0.5 * (DARK + LIGHT));
                        (a * b <= 0.0 && a != b).then(|| x as f64 + a / (a - b))
                    });
                    crossing.map(|x| (y as f64, x))
                })
                .collect();
            astray.extend(from_line(&places));
        }
    }
    astray.sort_by(f64::total_cmp);
    let square = astray.iter().map(|d| d * d).sum::<f64>() / astray.len().max(1) as f64;
    [square.sqrt(), astray.get(astray.len() * 95 / 100).copied().unwrap_or(f64::INFINITY)]
}

/// Distances of points from their line `x = a + b·y` of least squares.
fn from_line(points: &[(f64, f64)]) -> Vec<f64> {
    let n = points.len() as f64;
    let (mean_y, mean_x) = points.iter().fold((0.0, 0.0), |(y, x), point| (y + point.0 / n, x + point.1 / n));
    let (mut yy, mut xy) = (0.0, 0.0);
    for (y, x) in points {
        yy += (y - mean_y) * (y - mean_y);
        xy += (y - mean_y) * (x - mean_x);
    }
    points.iter().map(|(y, x)| (x - mean_x - xy / yy.max(1e-12) * (y - mean_y)).abs()).collect()
}
