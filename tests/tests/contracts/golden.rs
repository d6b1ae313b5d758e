//! Golden digests and images: results equal the stored ones to the last bit, on every level and for any number of
//! threads. `fixtures/golden/README.md` describes how to store new ones after an intended change of bits.

use std::collections::BTreeMap;
use std::path::PathBuf;

use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};
use streamsplat_fixtures::clip::{Clip, ClipKind, Picture, write};
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{Image, render};
use streamsplat_tests::digest::{scene, things};

fn golden(name: &str) -> PathBuf {
    streamsplat_fixtures::path(&format!("golden/{name}"))
}

/// Levels with the thread counts tested on them: all on the highest, one on the others, to save time.
fn levels() -> impl Iterator<Item = (Level, &'static [usize])> {
    Level::available()
        .into_iter()
        .map(|level| (level, if level == Level::detect() { &[1, 2, 3, 8][..] } else { &[3][..] }))
}

#[test]
fn everything_computed_has_its_golden_digest_on_every_level_and_thread_count() {
    let text = std::fs::read_to_string(golden("digests.txt")).expect("the golden digests");
    let mut expected: BTreeMap<&str, &str> =
        text.lines().filter_map(|l| l.split_once("  ")).map(|(d, n)| (n, d)).collect();
    let mut wrong = Vec::new();
    for thing in things() {
        let Some(expected) = expected.remove(thing.name.as_str()) else {
            wrong.push(format!("{}: no golden digest", thing.name));
            continue;
        };
        for (level, threads) in levels() {
            for &threads in threads {
                let found = thing.digest(level, threads);
                if found != expected {
                    wrong.push(format!(
                        "{} on {level}, {threads} threads: expected {expected}, found {found}",
                        thing.name
                    ));
                }
            }
        }
    }
    wrong.extend(expected.keys().map(|name| format!("{name}: a golden digest of nothing")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Compares with a stored PNG, byte by byte; where `STORE_GOLDEN` is set, writes it instead.
fn assert_golden(name: &str, image: &Image) {
    let picture = Picture {
        width: image.width,
        height: image.height,
        rgb: image.rgb.iter().map(|v| v.clamp(0.0, 1.0)).collect(),
        inverse_depth: Vec::new(),
        surface: Vec::new(),
    };
    let (path, bytes) = (golden(name), write::to_bytes(&picture));
    if std::env::var_os("STORE_GOLDEN").is_some() {
        let (width, height) = (image.width as u32, image.height as u32);
        image::save_buffer(&path, &bytes, width, height, image::ColorType::Rgb8).expect("written");
    }
    let stored = image::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).into_rgb8();
    assert_eq!((stored.width() as usize, stored.height() as usize), (image.width, image.height), "{name}");
    let differ = stored.as_raw().iter().zip(&bytes).filter(|(a, b)| a != b).count();
    assert_eq!(differ, 0, "{name}: {differ} of {} bytes differ", bytes.len());
}

#[test]
fn scenes_are_drawn_as_their_golden_images() {
    for name in ["predicted-t050", "perspective", "extreme"] {
        let scene = scene(name);
        for level in Level::available() {
            assert_golden(
                &format!("{name}.png"),
                &render(level, &scene.gaussians(), &scene.projection, &scene.request),
            );
        }
    }
}

#[test]
fn the_embedded_model_gives_its_golden_images_on_every_vector_level() {
    let clip = Clip::new(ClipKind::Moving, 1, 256, 144);
    // The scalar level emulates fused steps where it must and is slow; the small models above test it.
    let vector = Level::available().into_iter().filter(|level| *level != Level::scalar());
    for (level, threads) in vector.flat_map(|level| [(level, 1), (level, 3)]) {
        let settings = Settings { level: Some(level), threads, ..Settings::default() };
        let mut engine = Engine::new(settings).expect("an engine");
        let mut push = |time: f64| {
            let Picture { width, height, rgb, .. } = clip.picture(time);
            engine.push(Frame { width, height, rgb, depth: None }, time).expect("an interval")
        };
        push(0.0);
        let interval = push(0.125);
        for (name, time) in [("embedded-key.png", 0.0), ("embedded-middle.png", 0.0625)] {
            let image = interval
                .render(time, &Camera::Canonical, &RenderOptions::default(), engine.workers())
                .expect("an image");
            assert_golden(name, &image);
        }
    }
}
