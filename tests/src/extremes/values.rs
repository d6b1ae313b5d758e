//! Denormal, infinite and NaN values in every input: a record with an infinite or NaN value is dropped and counted, and
//! affects no other.

use std::sync::Arc;

use streamsplat::stream::{DepthRange, ModelSource, Reconstructor};
use streamsplat::{Camera, Engine, EngineError, RenderOptions, Settings};
use streamsplat_kernels::raster::{OwnedGaussians, render};
use streamsplat_model::{FrameInput, LoadOptions, ModelError, Network};

use super::scenes::{ORTHOGRAPHIC, PINHOLE, SIZE, Scene};
use super::splats::{against_reference, computed};
use super::{Case, Computed, Judged, Place, Unit};
use crate::parity;
use crate::theatre::Theatre;

const GROUP: &str = "Values that are no numbers";
const BAD: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];

/// The fields of a splat that are set to bad values.
const FIELDS: [&str; 5] = ["mean", "scale", "rotation", "opacity", "colour"];

/// Puts `value` into a field of splat `i`.
fn spoil(scene: &mut Scene, i: usize, field: &str, value: f32) {
    match field {
        "mean" => scene.splats.mean[i][i % 3] = value,
        "scale" => scene.splats.scale[i][i % 3] = value,
        "rotation" => scene.splats.rotation.iter_mut().for_each(|r| r[i][i % 4] = value),
        "opacity" => scene.splats.opacity[i] = value,
        _ => scene.splats.rgb[i][i % 3] = value,
    }
}

/// The scene without the splats `indices`.
fn without(scene: &Scene, indices: &[usize]) -> Scene {
    fn rest<T: Clone>(all: &[T], indices: &[usize]) -> Vec<T> {
        all.iter().enumerate().filter(|(i, _)| !indices.contains(i)).map(|(_, v)| v.clone()).collect()
    }
    let splats = OwnedGaussians {
        mean: rest(&scene.splats.mean, indices),
        scale: rest(&scene.splats.scale, indices),
        rotation: scene.splats.rotation.as_ref().map(|r| rest(r, indices)),
        opacity: rest(&scene.splats.opacity, indices),
        rgb: rest(&scene.splats.rgb, indices),
    };
    Scene { splats, projection: scene.projection }
}

/// Three splats of forty have a bad value: the image is that of the other thirty-seven, to the bit.
fn splat(kind: &'static str, field: &'static str) -> Case {
    const SPOILT: [usize; 3] = [3, 17, 38];
    let scene = move || match kind {
        "orthographic" => Scene::plain(ORTHOGRAPHIC, field == "rotation"),
        _ => Scene::plain(PINHOLE, true),
    };
    Case::new(
        GROUP,
        format!("splats, NaN and ±∞ in {field}, {kind}"),
        move |place| {
            let mut scene = scene();
            SPOILT.into_iter().zip(BAD).for_each(|(i, value)| spoil(&mut scene, i, field, value));
            computed(render(place.level, &scene.gaussians(), &scene.projection, &scene.request()))
        },
        move |found| {
            let clean = without(&scene(), &SPOILT);
            let level = streamsplat_kernels::Level::scalar();
            let expected = computed(render(level, &clean.gaussians(), &clean.projection, &clean.request()));
            let pixels = SIZE[0] * SIZE[1];
            let mut judged =
                against_reference(&clean, &Computed { rest: [&found.rest[..pixels], &[0]].concat(), ..found.clone() });
            judged.demand(found.values == expected.values, || "the image is not that of the others".into());
            judged.and(found.rest[pixels] == 3, || format!("{} dropped, expected 3", found.rest[pixels]))
        },
    )
}

/// Extreme but finite numbers: drawn unchanged.
fn denormal(value: f32, field: &'static str) -> Case {
    let scene = move || {
        let mut scene = Scene::plain(ORTHOGRAPHIC, true);
        [3, 17, 38].into_iter().for_each(|i| spoil(&mut scene, i, field, value));
        scene
    };
    Case::new(
        GROUP,
        format!("splats, {value:e} in {field}"),
        move |place| {
            let scene = scene();
            computed(render(place.level, &scene.gaussians(), &scene.projection, &scene.request()))
        },
        move |found| against_reference(&scene(), found),
    )
}

fn counted(name: &str, compute: impl Fn(Place) -> (u64, Vec<f32>) + Send + Sync + 'static, expected: u64) -> Case {
    Case::new(
        GROUP,
        name,
        move |place| {
            let (count, values) = compute(place);
            Computed::with(&values, [count])
        },
        move |found| {
            Judged { ours: found.rest[0] as f64, exact: expected as f64, ..Judged::new(Unit::Absolute) }
                .and(found.rest == [expected], || format!("{} counted, expected {expected}", found.rest[0]))
                .and(found.values.iter().all(|v| v.is_finite()), || "a value that is not finite came out".into())
        },
    )
}

/// A network on frames with one bad number in pixels or depth: an error that names its index.
fn network() -> Case {
    counted(
        "forward, NaN and ±∞ in pixels and depth: an error each",
        |place| {
            let options = LoadOptions { level: place.level, ..LoadOptions::default() };
            let network = Network::open(parity::path("tiny-nodino.safetensors"), &options).expect("a model");
            let [h, w] = network.config().resolution;
            let mut errors = 0;
            for value in BAD {
                for depth_too in [false, true] {
                    let (mut rgb, mut depth) = (vec![0.5; 3 * h * w], vec![0.25; h * w]);
                    *(if depth_too { &mut depth[5] } else { &mut rgb[5] }) = value;
                    let answer = network.session(None).embed(&FrameInput { rgb: &rgb, depth: Some(&depth) });
                    errors += u64::from(matches!(answer, Err(ModelError::InputNonFinite { index: 5, .. })));
                }
            }
            (errors, Vec::new())
        },
        6,
    )
}

fn engine(place: Place, theatre: Theatre, depth_range: DepthRange) -> (Engine, Arc<Theatre>) {
    let theatre = Arc::new(theatre);
    let model: Arc<dyn Reconstructor> = theatre.clone();
    let (level, threads) = (Some(place.level), place.threads);
    let settings = Settings { level, threads, depth_range, ..Settings::with_model(ModelSource::Shared(model)) };
    (Engine::new(settings).expect("starts"), theatre)
}

/// Gaussians that a stream drops when its network returns a bad number, over four key frames, and its last image.
fn stream(field: usize, name: &str, expected: u64) -> Case {
    counted(
        &format!("stream, a bad number in a Gaussian's {name}: it alone is dropped"),
        move |place| {
            let theatre = Theatre { poison: Some((17, field)), ..Theatre::new([6, 10]) };
            let (mut engine, theatre) = engine(place, theatre, DepthRange::Frame);
            let (mut dropped, mut values) = (0, Vec::new());
            for k in 0..4 {
                let interval = engine.push(theatre.frame(0.1), f64::from(k)).expect("taken");
                assert!(interval.gaussians.iter().all(|r| r.is_sound()));
                dropped += interval.dropped;
                let image =
                    interval.render(interval.end, &Camera::Canonical, &RenderOptions::default(), engine.workers());
                values = image.expect("drawn").rgb;
            }
            (dropped, values)
        },
        expected,
    )
}

fn pixels() -> Case {
    counted(
        "stream, NaN and ±∞ in pixels: the frame is refused, the stream goes on",
        |place| {
            let (mut engine, theatre) = engine(place, Theatre::new([6, 10]), DepthRange::Frame);
            engine.push(theatre.frame(0.0), 0.0).expect("taken");
            let mut refused = 0;
            for value in BAD {
                let mut frame = theatre.frame(0.1);
                frame.rgb[77] = value;
                refused +=
                    u64::from(matches!(engine.push(frame, 1.0), Err(EngineError::NonFinite { position: 77, .. })));
            }
            (refused, engine.push(theatre.frame(0.1), 1.0).expect("taken").gaussians.mean.concat())
        },
        3,
    )
}

fn depth(range: DepthRange) -> Case {
    counted(
        &format!("stream, NaN and ±∞ in depth, range {range}: counted, infinitely far"),
        move |place| {
            let (mut engine, theatre) = engine(place, Theatre::new([6, 10]), range);
            let mut frame = theatre.frame(0.0);
            let mut depth = vec![3.0; frame.width * frame.height];
            depth[..3].copy_from_slice(&BAD);
            depth[3] = 1e-40;
            frame.depth = Some(depth);
            let interval = engine.push(frame, 0.0).expect("taken");
            (interval.dropped, interval.gaussians.mean.concat())
        },
        3,
    )
}

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for kind in ["orthographic", "pinhole"] {
        cases.extend(FIELDS.map(|field| splat(kind, field)));
    }
    for field in ["mean", "scale", "opacity", "colour"] {
        cases.push(denormal(1e-40, field));
    }
    cases.extend([denormal(1e30, "colour"), denormal(3e38, "mean"), denormal(3e38, "scale")]);
    cases.push(network());
    cases.extend([stream(0, "position", 4), stream(1, "velocity", 6), stream(2, "γ", 6)]);
    cases.extend([pixels(), depth(DepthRange::Frame), depth(DepthRange::Given)]);
    cases
}
