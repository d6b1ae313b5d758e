//! Streams of thousands of key frames: bounded, unique, without drift.

use std::collections::HashSet;
use std::sync::Arc;

use streamsplat::stream::{Fusion, ModelSource, Reconstructor};
use streamsplat::{Camera, Engine, Frame, Interval, RenderOptions, Settings};
use streamsplat_tests::theatre::Theatre;
use streamsplat_tests::workers;

/// A sprite that wanders back and forth at changing speed.
fn wander(k: u64) -> f32 {
    let phase = (k * 37 % 200) as f32 / 100.0 - 1.0;
    0.6 * (2.0 * phase.abs() - 1.0)
}

fn engine(theatre: &Arc<Theatre>, fusion: Fusion) -> Engine {
    let model: Arc<dyn Reconstructor> = theatre.clone();
    Engine::new(Settings { fusion, threads: 1, ..Settings::with_model(ModelSource::Shared(model)) }).expect("starts")
}

fn push(engine: &mut Engine, frame: Frame, k: u64) -> Interval {
    engine.push(frame, k as f64 * 0.2).expect("taken")
}

#[test]
fn ten_thousand_key_frames_stay_bounded_and_identities_unique() {
    let theatre = Arc::new(Theatre::new([6, 10]));
    let cells = 60;
    let mut engine = engine(&theatre, Fusion::Persistent);
    let mut ended: HashSet<u64> = HashSet::new();
    let mut alive: HashSet<u64> = HashSet::new();
    let mut newest = None;
    let mut largest = [0; 2];
    for k in 0..10_000 {
        let interval = push(&mut engine, theatre.frame(wander(k)), k);
        let g = &interval.gaussians;
        largest[usize::from(k >= 100)] = largest[usize::from(k >= 100)].max(g.len());
        // A frame's own Gaussians never share an identity.
        for frame in [k.checked_sub(1), Some(k)].into_iter().flatten() {
            let own: Vec<u64> = g.iter().filter(|r| r.frame == frame).map(|r| r.identity).collect();
            assert_eq!(own.len(), cells, "key frame {k}");
            assert_eq!(own.iter().collect::<HashSet<_>>().len(), cells, "key frame {k}");
        }
        let now: HashSet<u64> = g.identity.iter().copied().collect();
        assert!(now.is_disjoint(&ended), "an identity came back at key frame {k}");
        for identity in now.difference(&alive) {
            assert!(newest.is_none_or(|n| *identity > n), "identities ascend");
        }
        newest = newest.max(now.iter().max().copied());
        ended.extend(alive.difference(&now));
        alive = now;
        assert!(g.iter().all(|r| r.birth <= r.frame && r.frame <= k && k - r.frame <= 9));
    }
    assert!(largest[1] <= largest[0], "as large after 100 key frames as after 10,000: {largest:?}");
    assert!(newest.expect("some") > 1000, "identities emerge and vanish all along");
}

#[test]
fn pairwise_key_frame_ten_thousand_equals_a_fresh_stream() {
    let theatre = Arc::new(Theatre::new([6, 10]));
    let mut long = engine(&theatre, Fusion::Pairwise);
    let mut last = None;
    for k in 0..=10_000 {
        last = Some(push(&mut long, theatre.frame(wander(k)), k));
    }
    let last = last.expect("pushed");
    let mut fresh = engine(&theatre, Fusion::Pairwise);
    let mut other = None;
    for k in 9_998..=10_000 {
        other = Some(push(&mut fresh, theatre.frame(wander(k)), k));
    }
    let other = other.expect("pushed");
    let [a, b] = [&last, &other].map(|interval| {
        let mut columns = interval.gaussians.columns();
        columns.retain(|column| !["identity", "birth", "frame", "offset", "handover"].contains(&column.name));
        columns
    });
    assert_eq!(a, b);
    assert_eq!((last.start, last.end), (other.start, other.end));
    for time in [last.start, 0.5 * (last.start + last.end), last.end] {
        let draw =
            |i: &Interval| i.render(time, &Camera::Canonical, &RenderOptions::default(), workers()).expect("drawn");
        assert_eq!(draw(&last), draw(&other));
    }
}
