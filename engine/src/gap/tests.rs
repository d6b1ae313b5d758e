use super::interpolation::{PEAK, Small, misses};
use super::{Auto, Choice, Chooser, Found, Gap, KeyFrames, grouped};
use crate::picture::Picture;

/// A textured plane, moved right by `shift` pixels, with a bright square at `square`.
fn picture(shift: i32, square: Option<usize>) -> Picture {
    let (width, height) = (256, 144);
    let pixel = |i: usize| {
        let (y, x) = ((i / width % height) as i32, (i % width) as i32 - shift);
        let inside = square.is_some_and(|at| (40..104).contains(&y) && (at..at + 64).contains(&(i % width)));
        if inside { 1.0 } else { 0.3 + 0.2 * ((x.div_euclid(23) + y / 17) % 3) as f32 * 0.5 }
    };
    Picture { width, height, rgb: (0..3 * width * height).map(pixel).collect() }
}

/// The largest sum of squared errors.
fn worst(frames: &[Small]) -> u64 {
    misses(frames).into_iter().max().unwrap_or(0)
}

/// Key frames chosen in a clip.
fn keys(gap: Gap, clip: &[Picture]) -> Vec<usize> {
    let ends = grouped(gap, clip).filter(|group| group.whole).scan(0, |end, group| {
        *end += group.frames.len();
        Some(*end - 1)
    });
    ends.collect()
}

#[test]
fn a_fixed_gap_takes_every_nth_frame() {
    let clip = vec![picture(0, None); 10];
    assert_eq!(keys(Gap::Every(1), &clip), (0..10).collect::<Vec<_>>());
    assert_eq!(keys(Gap::Every(4), &clip), [0, 4, 8]);
}

#[test]
fn a_still_scene_has_the_largest_gap_and_a_sudden_change_a_key_frame_on_both_sides() {
    let auto = Gap::Auto(Auto { least: 1, most: 8, decibels: 26.0 });
    let still = vec![picture(0, None); 25];
    // The gap is at most three times the one before.
    assert_eq!(keys(auto, &still), [0, 6, 14, 22]);
    let mut cut = still.clone();
    cut[11..].fill(picture(0, Some(100)));
    assert_eq!(keys(auto, &cut), [0, 6, 10, 11, 19]);
    // Not below the smallest gap.
    let bounded = Gap::Auto(Auto { least: 5, most: 8, decibels: 26.0 });
    let found = keys(bounded, &cut);
    assert!(found.windows(2).all(|pair| (5..=8).contains(&(pair[1] - pair[0]))), "{found:?}");
}

/// Key frames of `clip`, where an interval of n frames is measured to have `between` dB between its key frames, two
/// intervals late.
fn told(auto: Auto, clip: &[Picture], between: impl Fn(usize) -> f64) -> Vec<usize> {
    let mut chooser = Chooser::new(Gap::Auto(auto));
    let (mut keys, mut waiting) = (Vec::new(), std::collections::VecDeque::new());
    for (i, picture) in clip.iter().enumerate() {
        let key = match chooser.next(picture) {
            Choice::Wait => continue,
            Choice::This => i,
            Choice::Before => i - 1,
        };
        let n = keys.last().map_or(1, |before| key - before);
        keys.push(key);
        waiting.push_back(Found { key: 44.0, between: (n > 1).then(|| between(n)) });
        if waiting.len() > 1 {
            waiting.pop_front().iter().for_each(|found| chooser.learn(found));
        }
    }
    keys
}

/// The lengths of intervals.
fn lengths(keys: &[usize]) -> Vec<usize> {
    keys.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

#[test]
fn intervals_come_near_to_the_target_whatever_predictions_say() {
    let clip: Vec<Picture> = (0..150).map(|i| picture(2 * (i % 20), None)).collect();
    for asked in [34.0, 36.0, 38.0, 40.0] {
        // Easier and harder than expected.
        for offset in [-6.0, -3.0, 0.0, 3.0] {
            let auto = Auto { least: 2, most: 20, decibels: asked };
            let between = |n: usize| 44.0 + offset - 5.0 * (n as f64).ln();
            let mean = |n: usize| (44.0 + (n - 1) as f64 * between(n)) / n as f64;
            let found = lengths(&told(auto, &clip, between));
            // After the first measurements.
            let found = &found[4..];
            let free: Vec<f64> = found.iter().filter(|n| **n > 2).map(|n| mean(*n) - asked).collect();
            let over = free.iter().sum::<f64>() / free.len().max(1) as f64;
            let few = free.len() < found.len() / 4;
            assert!(few || (-0.5..2.5).contains(&over), "asked {asked}, offset {offset}: {over} over in {found:?}");
            // The longest is not much shorter than it may be. (Pictures that jump make others short.)
            let longest = *found.iter().max().expect("intervals");
            assert!(longest == 20 || mean(longest + 2) < asked, "asked {asked}, offset {offset}: {found:?}");
        }
    }
    let bounded = Auto { least: 2, most: 9, decibels: 60.0 };
    assert!(lengths(&told(bounded, &clip, |_| 10.0)).iter().all(|n| *n == 2));
    let easy = Auto { decibels: 12.0, ..bounded };
    // The gap grows until it is the largest.
    assert!(lengths(&told(easy, &clip, |_| 50.0)).iter().skip(2).all(|n| *n == 9));
}

#[test]
fn what_still_pictures_exceed_the_target_by_is_not_spent_on_motion() {
    // At rest every interval has 50 dB; then a square moves by its own width in two frames.
    let clip: Vec<Picture> = (0..90).map(|i: i32| picture(0, Some((30 * (i - 60).max(0) % 180) as usize))).collect();
    let auto = Auto { least: 2, most: 8, decibels: 38.0 };
    let lengths_after = |still: f64| {
        let keys = told(auto, &clip, |n| if n > 6 { still } else { 30.0 });
        let moving = keys.iter().position(|key| *key >= 64).expect("key frames");
        let lengths = lengths(&keys[moving..]);
        assert!(lengths.len() > 8, "{lengths:?}");
        lengths
    };
    assert!(lengths_after(50.0).iter().all(|n| *n == 2), "{:?}", lengths_after(50.0));
    assert_eq!(lengths_after(50.0), lengths_after(41.0));
}

#[test]
fn choices_go_on_from_where_they_were_replayed_to() {
    let clip: Vec<Picture> = (0..80).map(|i| picture(i * i / 40, (i > 50).then_some(30))).collect();
    let auto = Gap::Auto(Auto { least: 1, most: 11, decibels: 37.0 });
    let found = |key: usize| Found { key: 40.0, between: Some(30.0 + (key % 7) as f64) };
    let mut whole = Chooser::new(auto);
    let mut keys: Vec<usize> = Vec::new();
    let mut states = Vec::new();
    for (i, picture) in clip.iter().enumerate() {
        let key = match whole.next(picture) {
            Choice::Wait => continue,
            Choice::This => i,
            Choice::Before => i - 1,
        };
        keys.push(key);
        states.push(whole.state());
        whole.learn(&found(key));
    }
    assert!(keys.len() > 10, "{keys:?}");
    for at in 0..keys.len() {
        let mut again = Chooser::new(auto);
        again.replay(keys[..=at].windows(2).map(|pair| pair[1] - pair[0]), states[at].clone());
        let mut found_keys: Vec<usize> = Vec::new();
        for (i, picture) in clip.iter().enumerate() {
            let key = match again.next(picture) {
                Choice::Wait => continue,
                Choice::This => i,
                Choice::Before => i - 1,
            };
            found_keys.push(key);
            if !again.is_replaying() {
                again.learn(&found(key));
            }
        }
        assert_eq!(found_keys, keys, "from {at}");
    }
}

#[test]
fn uniform_motion_is_predicted_and_a_blink_is_not() {
    let small = |shift, square| Small::of(&picture(shift, square));
    let moving: Vec<Small> = (0..5).map(|i| small(4 * i, None)).collect();
    let blinking = [small(0, None), small(0, Some(90)), small(0, None)];
    let crossfade = {
        // The same frames in an order that no motion has.
        let mut shuffled = moving.clone();
        shuffled.swap(1, 3);
        worst(&shuffled)
    };
    assert_eq!(worst(&moving[..2]), 0);
    assert!(worst(&moving) < crossfade, "{} {crossfade}", worst(&moving));
    assert!(worst(&moving) < worst(&blinking) / 20, "{} {}", worst(&moving), worst(&blinking));
    let cells = 16 * 16 * PEAK * PEAK / 8;
    assert!(worst(&blinking) > cells, "{} {cells}", worst(&blinking));
}

#[test]
fn pictures_of_any_size_have_their_luma() {
    for (width, height) in [(1, 1), (3, 200), (63, 35), (640, 360)] {
        let picture = Picture { width, height, rgb: vec![1.0; 3 * width * height] };
        let black = Picture { rgb: vec![f32::NAN; 3 * width * height], ..picture.clone() };
        let frames = [Small::of(&picture), Small::of(&black), Small::of(&picture)];
        assert_eq!(worst(&frames), super::interpolation::CELLS as u64 * PEAK * PEAK, "{width}x{height}");
    }
}

#[test]
fn gaps_are_found_by_their_names_and_others_are_refused() {
    assert_eq!("7".parse(), Ok(Gap::Every(7)));
    assert_eq!("auto".parse(), Ok(Gap::Auto(Auto::default())));
    assert_eq!("auto:20".parse(), Ok(Gap::Auto(Auto { most: 20, ..Auto::default() })));
    assert_eq!("auto:3".parse(), Ok(Gap::Auto(Auto { least: 3, most: 3, ..Auto::default() })));
    assert_eq!("auto:1-8:30.5".parse(), Ok(Gap::Auto(Auto { least: 1, most: 8, decibels: 30.5 })));
    for gap in [Gap::Every(3), Gap::Auto(Auto { least: 2, most: 9, decibels: 24.5 })] {
        assert_eq!(gap.to_string().parse(), Ok(gap));
    }
    for wrong in [
        "0",
        "100001",
        "",
        "auto:",
        "auto:0",
        "auto:65",
        "auto:9-3",
        "auto:8:5",
        "auto:8:nan",
        "auto:8:30:1",
        "automatic",
    ] {
        assert!(wrong.parse::<Gap>().is_err(), "{wrong}");
    }
}

#[test]
fn groups_hold_every_frame_once_and_end_with_the_last() {
    let cut = |i: usize| picture(i as i32, (i >= 5).then_some(10 * i));
    let clip: Vec<Picture> = (0..11).map(cut).collect();
    for gap in [Gap::Every(1), Gap::Every(4), Gap::Auto(Auto { least: 1, most: 8, decibels: 40.0 })] {
        let mut keys = KeyFrames::new(gap);
        let (mut arriving, mut taken, mut ends) = (0..clip.len(), 0, Vec::new());
        loop {
            let arrive = || Ok(arriving.next().map(|i| &clip[i]));
            let group = keys.next(arrive, |waiting| {
                // Each frame comes last once, in order.
                assert!(std::ptr::eq(*waiting.last().expect("a frame"), &clip[taken]));
                taken += 1;
                Ok::<_, String>(())
            });
            let Some(group) = group.expect("no error") else { break };
            assert!(std::ptr::eq(*group.frames.last().expect("a frame"), &clip[taken - 1]));
            ends.push((taken - 1, group.whole));
        }
        assert_eq!(taken, clip.len(), "{gap}");
        assert!(ends[..ends.len() - 1].iter().all(|(_, whole)| *whole), "{gap}: {ends:?}");
        assert_eq!(ends.last().map(|(end, _)| *end), Some(10), "{gap}");
        if let Gap::Every(n) = gap {
            assert_eq!(ends.last().map(|(_, whole)| *whole), Some(n == 1), "{gap}");
        }
    }
    let mut keys = KeyFrames::<&Picture>::new(Gap::Every(2));
    assert_eq!(keys.next(|| Err("lost"), |_| Ok(())), Err("lost"));
}
