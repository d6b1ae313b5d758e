//! Crossing a key frame changes no bit of the image in persistent mode, and images in between do not change.

use std::sync::Arc;

use streamsplat::camera::Pose;
use streamsplat::stream::{Fusion, MaxAge, ModelSource, Reconstructor};
use streamsplat::track::Track;
use streamsplat::{Camera, Engine, Image, Interval, RenderOptions, Settings};
use streamsplat_tests::theatre::{BACKDROP, SPRITE, Theatre};
use streamsplat_tests::workers;

fn stream(fusion: Fusion, max_age: u32, gamma: [f32; 2], places: &[f32]) -> Vec<Interval> {
    let theatre = Arc::new(Theatre { gamma, ..Theatre::new([18, 32]) });
    let model: Arc<dyn Reconstructor> = theatre.clone();
    let settings = Settings { fusion, max_age: MaxAge(max_age), ..Settings::with_model(ModelSource::Shared(model)) };
    let mut engine = Engine::new(settings).expect("starts");
    // Uneven times: results must not depend on equal lengths.
    let push = |(k, &x): (usize, &f32)| {
        let time = k as f64 + 0.3 * (k % 3) as f64;
        engine.push(theatre.frame(x), time).expect("taken")
    };
    places.iter().enumerate().map(push).collect()
}

fn cameras() -> [Camera; 2] {
    let pose = Pose::look_at([0.5, -0.2, -0.9], [0.0, 0.0, 0.5], [0.0, -1.0, 0.0]).expect("a pose");
    [Camera::Canonical, Camera::pinhole(pose, 75.0, 16.0 / 9.0).expect("a camera")]
}

fn draw(interval: &Interval, time: f64, camera: &Camera) -> Image {
    let options = RenderOptions { depth: true, alpha: true, ..RenderOptions::default() };
    interval.render(time, camera, &options, workers()).expect("drawn")
}

fn jump(a: &Image, b: &Image) -> f32 {
    a.rgb.iter().zip(&b.rgb).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.rgb.len() as f32
}

const PLACES: [f32; 14] = [-0.6, -0.45, -0.2, 0.0, 0.05, 0.3, 0.55, 0.6, 0.6, 0.4, -0.3, -0.31, -0.5, 0.1];

#[test]
fn crossing_a_key_frame_changes_no_bit() {
    for max_age in [0, 1, 2, 8] {
        for gamma in [[0.0, 0.5], [3.0, 0.4], [1e6, 0.9], [1e6, 0.0]] {
            let intervals = stream(Fusion::Persistent, max_age, gamma, &PLACES);
            for pair in intervals.windows(2) {
                for camera in &cameras() {
                    let before = draw(&pair[0], pair[0].end, camera);
                    let after = draw(&pair[1], pair[1].start, camera);
                    assert_eq!(before, after, "key frame {}, γ {gamma:?}, max age {max_age}", pair[0].index);
                }
            }
        }
    }
}

#[test]
fn pairs_alone_jump_where_the_persistent_stream_does_not() {
    let largest = |fusion| {
        let intervals = stream(fusion, 8, [0.5, 0.5], &PLACES);
        let jumps = intervals.windows(2).map(|pair| {
            let before = draw(&pair[0], pair[0].end, &Camera::Canonical);
            jump(&before, &draw(&pair[1], pair[1].start, &Camera::Canonical))
        });
        jumps.fold(0.0, f32::max)
    };
    assert_eq!(largest(Fusion::Persistent), 0.0);
    assert!(largest(Fusion::Pairwise) > 0.01);
}

#[test]
fn nothing_flashes_around_a_key_frame() {
    let intervals = stream(Fusion::Persistent, 8, [3.0, 0.4], &PLACES);
    for interval in &intervals[1..] {
        let length = interval.end - interval.start;
        let images: Vec<Image> = (0..=64)
            .map(|i| draw(interval, interval.start + length * f64::from(i) / 64.0, &Camera::Canonical))
            .collect();
        let whole = jump(&images[0], &images[64]).max(0.02);
        for (i, pair) in images.windows(2).enumerate() {
            assert!(jump(&pair[0], &pair[1]) < 0.2 * whole, "interval {}, step {i} of 64", interval.index);
        }
    }
}

#[test]
fn the_image_at_a_key_frame_is_the_frames_own() {
    // Nothing vanishes here, so at a key frame only the frame's own Gaussians are present.
    let intervals = stream(Fusion::Persistent, 8, [3.0, 0.4], &[0.2; 5]);
    let alone = draw(&intervals[0], 0.0, &Camera::Canonical);
    for interval in &intervals[1..] {
        assert_eq!(draw(interval, interval.end, &Camera::Canonical), alone);
    }
}

#[test]
fn a_point_on_the_sprite_stays_on_the_sprite() {
    // Fractions of a cell per key frame (a cell is 1/16 wide): motion that a lattice alone would lose.
    let places: Vec<f32> = (0..90).map(|k| -0.65 + 0.0143 * k as f32).collect();
    let intervals = stream(Fusion::Persistent, 8, [3.0, 0.4], &places);
    let cell = 1.0 / 16.0;
    let mut errors = Vec::new();
    let mut lost = 0;
    for row in [12.0, 18.0, 24.0] {
        for column in [7.0, 10.0, 14.0] {
            let first = &intervals[0];
            let picked = first.pick(first.start, [column, row], workers()).expect("inside").expect("something");
            let origin = picked.position;
            assert_eq!(origin[1], SPRITE, "a point of the sprite");
            let mut track = Some(Track::new(&picked, first.start));
            for interval in &intervals {
                let Some((points, next)) = track.and_then(|t| t.forward(interval, &[interval.end])) else {
                    track = None;
                    break;
                };
                let truth = origin[0] + places[interval.index as usize] - places[0];
                let point = points[0];
                errors.push(((point.position[0] - truth).abs() / cell, (point.position[1] - SPRITE).abs()));
                track = Some(next);
            }
            lost += usize::from(track.is_none());
        }
    }
    assert_eq!(lost, 0, "tracks lost");
    errors.sort_by(|a, b| a.partial_cmp(b).expect("numbers"));
    let median = errors[errors.len() / 2].0;
    let worst = errors.last().expect("some").0;
    assert!(median < 0.5 && worst < 2.0, "median {median} cells, worst {worst}");
}

#[test]
fn a_point_on_the_backdrop_does_not_go_with_the_sprite() {
    let places: Vec<f32> = (0..20).map(|k| -0.65 + 0.02 * k as f32).collect();
    let intervals = stream(Fusion::Persistent, 8, [3.0, 0.4], &places);
    let first = &intervals[0];
    for pixel in [[60.0, 3.0], [2.0, 33.0], [62.0, 30.0]] {
        let picked = first.pick(first.start, pixel, workers()).expect("inside").expect("something");
        assert_eq!(picked.position[1], BACKDROP);
        let mut track = Track::new(&picked, first.start);
        for interval in &intervals {
            let (points, next) = track.forward(interval, &[interval.end]).expect("it stays");
            assert_eq!(points[0].position, picked.position);
            assert!((points[0].pixel[0] - pixel[0]).abs() < 1e-3 && (points[0].pixel[1] - pixel[1]).abs() < 1e-3);
            track = next;
        }
        // Then backward.
        for interval in intervals.iter().rev() {
            let (points, next) = track.backward(interval, &[interval.start]).expect("it was there");
            assert_eq!(points[0].position, picked.position);
            track = next;
        }
        assert_eq!(track.identity(), picked.identity);
    }
}

#[test]
fn an_identity_survives_while_it_is_hidden() {
    // The sprite passes over a point of the backdrop and uncovers it four key frames later.
    let places: Vec<f32> = (0..12).map(|k| -0.7 + 0.15 * k as f32).collect();
    let intervals = stream(Fusion::Persistent, 8, [0.0, 0.5], &places);
    let first = &intervals[0];
    let picked = first.pick(first.start, [40.0, 18.0], workers()).expect("inside").expect("something");
    assert_eq!(picked.position[1], BACKDROP);
    let mut track = Track::new(&picked, first.start);
    for interval in &intervals {
        let (_, next) = track.forward(interval, &[]).expect("remembered while hidden");
        track = next;
    }
    assert_eq!(track.identity(), picked.identity);
}
