use streamsplat_kernels::Level;
use streamsplat_kernels::raster::Projection;

use super::*;
use crate::camera::{Lens, Pose, Rotation};
use crate::fit::{Fit, Placement};
use crate::formats;
use crate::stream::{DynamicGaussians, Record, Workers};
use crate::world::to_scene;

/// A lattice of splats with some depth, over a 24×40 model input.
fn interval(source: [usize; 2]) -> Interval {
    let (rows, columns) = (12, 20);
    let gaussians: DynamicGaussians = (0..rows * columns)
        .map(|i| {
            let (row, column) = (i / columns, i % columns);
            let x = (2.0 * column as f32 + 1.0) / columns as f32 - 1.0;
            let z = 1.0 - (2.0 * row as f32 + 1.0) / rows as f32;
            let grain = (i * 7919 % 1013) as f32 / 1013.0;
            Record {
                mean: [x, 0.3 + 0.4 * grain, z],
                velocity: [0.1 - 0.2 * grain, 0.05, 0.02],
                gamma: [3.0 * grain, 0.5],
                opacity: 0.6 + 0.4 * grain,
                scale: [0.05, 0.07],
                rgb: [grain, 1.0 - grain, 0.5],
                identity: i as u64,
                ..Record::default()
            }
        })
        .collect();
    let placement = Placement::new(Fit::Letterbox, source, [24, 40]).unwrap();
    Interval { index: 1, start: 2.0, end: 4.0, gaussians, placement, merges: Vec::new(), dropped: 0 }
}

fn workers() -> Workers {
    Workers::new(Level::detect(), 2).unwrap()
}

fn difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}

#[test]
fn a_letterboxed_image_is_the_cut_of_the_whole_one() {
    for source in [[10, 40], [48, 31], [24, 40], [7, 7]] {
        let boxed = interval(source);
        let whole = interval([24, 40]);
        let options = RenderOptions { depth: true, alpha: true, ..RenderOptions::default() };
        let a = boxed.render(3.0, &Camera::Canonical, &options, &workers()).unwrap();
        let b = whole.render(3.0, &Camera::Canonical, &options, &workers()).unwrap();
        assert_eq!([a.height, a.width], boxed.placement.content);
        assert!(difference(&a.rgb, &boxed.placement.crop(&b.rgb)) < 2e-5, "{source:?}");
        assert!(difference(a.alpha.as_ref().unwrap(), &boxed.placement.crop(b.alpha.as_ref().unwrap())) < 2e-5);
        assert!(difference(a.depth.as_ref().unwrap(), &boxed.placement.crop(b.depth.as_ref().unwrap())) < 2e-4);
    }
}

#[test]
fn an_enlarged_image_shows_the_models_own_pixels_between_which_it_is_closed() {
    for source in [[24, 40], [48, 31]] {
        let interval = interval(source);
        let [height, width] = interval.placement.content;
        let draw = |zoom: usize| {
            let size = Size::Exact { width: zoom * width, height: zoom * height };
            let options = RenderOptions { size, alpha: true, ..RenderOptions::default() };
            interval.render(3.0, &Camera::Canonical, &options, &workers()).expect("a size")
        };
        let (own, large) = (draw(1), draw(3));
        // The middle of each 3×3 pixels is at the model's pixel: the same Gaussians, equally wide.
        for y in 0..height {
            for x in 0..width {
                let (at, middle) = (y * width + x, (3 * y + 1) * 3 * width + 3 * x + 1);
                for c in 0..3 {
                    let (a, b) = (own.rgb[c * width * height + at], large.rgb[c * 9 * width * height + middle]);
                    // A Gaussian at the drawing threshold may be on the other side of it.
                    assert!((a - b).abs() < 2.5 / 255.0, "{source:?} at {x}, {y}: {a} and {b}");
                }
            }
        }
    }
}

#[test]
fn every_size_can_be_drawn_and_impossible_ones_are_refused() {
    let interval = interval([30, 100]);
    let sized = |width, height| {
        let options = RenderOptions { size: Size::Exact { width, height }, ..RenderOptions::default() };
        interval.render(2.5, &Camera::Canonical, &options, &workers())
    };
    for [width, height] in [[1, 1], [1, 77], [333, 10], [100, 30]] {
        let image = sized(width, height).unwrap();
        assert_eq!(image.rgb.len(), 3 * width * height);
        assert!(image.rgb.iter().all(|x| (0.0..=1.0).contains(x)));
    }
    let source = RenderOptions { size: Size::Source, ..RenderOptions::default() };
    assert_eq!(interval.render(2.5, &Camera::Canonical, &source, &workers()).unwrap(), sized(100, 30).unwrap());
    assert!(matches!(sized(0, 5), Err(RenderError::Size { width: 0, .. })));
    assert!(matches!(sized(5, usize::MAX), Err(RenderError::Size { .. })));
}

#[test]
fn the_canonical_camera_is_the_orthographic_one_at_the_origin() {
    let interval = interval([24, 40]);
    let options = RenderOptions::default();
    let canonical = interval.render(3.5, &Camera::Canonical, &options, &workers()).unwrap();
    let origin = interval.render(3.5, &Camera::orthographic(Pose::default()), &options, &workers()).unwrap();
    assert!(difference(&origin.rgb, &canonical.rgb) < 1e-4);
    // A rotation by no more than rounding uses the general path and draws almost the same image.
    let nearly = Rotation::from_quaternion([1.0, 0.0, 0.0, 1e-12]).unwrap();
    let turned = Camera::orthographic(Pose { rotation: nearly, ..Pose::default() });
    let turned = interval.render(3.5, &turned, &options, &workers()).unwrap();
    assert!(difference(&turned.rgb, &canonical.rgb) < 5e-3);
}

#[test]
fn turning_the_camera_by_a_right_angle_turns_the_image() {
    let interval = interval([24, 40]);
    let half = 0.5f64.sqrt();
    // Right becomes down: the camera's own right axis is scene-space down.
    let rotation = Rotation::from_quaternion([half, 0.0, 0.0, half]).unwrap();
    let lens = Lens::Orthographic { half_extent: None };
    let side = RenderOptions { size: Size::Exact { width: 32, height: 32 }, ..RenderOptions::default() };
    let upright = interval.render(3.0, &Camera::Posed { pose: Pose::default(), lens }, &side, &workers()).unwrap();
    let turned = interval
        .render(3.0, &Camera::Posed { pose: Pose { rotation, ..Pose::default() }, lens }, &side, &workers())
        .unwrap();
    let mut expected = Vec::new();
    for plane in upright.rgb.chunks(32 * 32) {
        for y in 0..32 {
            for x in 0..32 {
                // View (x, y) shows scene (−y, x).
                expected.push(plane[x * 32 + (31 - y)]);
            }
        }
    }
    assert!(difference(&turned.rgb, &expected) < 5e-3);
}

#[test]
fn a_pinhole_far_away_sees_what_the_orthographic_camera_sees() {
    let interval = interval([24, 40]);
    let distance = 3000.0;
    let pose = Pose { position: [0.0, 0.0, -distance], ..Pose::default() };
    let lens = Lens::Pinhole { focal: [0.5 * distance * 24.0 / 40.0, 0.5 * distance], centre: [0.5; 2] };
    let options = RenderOptions::default();
    let far = interval.render(2.2, &Camera::Posed { pose, lens }, &options, &workers()).unwrap();
    let canonical = interval.render(2.2, &Camera::Canonical, &options, &workers()).unwrap();
    assert!(difference(&far.rgb, &canonical.rgb) < 0.02);
}

#[test]
fn a_lens_is_in_parts_of_the_image() {
    let placement = Placement::new(Fit::Stretch, [24, 40], [24, 40]).unwrap();
    let lens = Lens::Pinhole { focal: [1.0, 2.0], centre: [0.5, 0.25] };
    let view = View::new(&Camera::Posed { pose: Pose::default(), lens }, &placement, [100, 200]);
    assert_eq!(*view.projection(), Projection::Pinhole { focal: [200.0, 200.0], centre: [99.5, 24.5] });
    let view = View::new(&Camera::Canonical, &placement, [48, 80]);
    assert_eq!(*view.projection(), Projection::Orthographic { focal: [40.0, 24.0] });
    assert_eq!(view.rotation(), None);
}

#[test]
fn what_lies_outside_the_depth_range_or_is_not_finite_is_not_drawn() {
    assert_eq!(to_scene([0.5, -1e-6, 0.25]), None);
    assert_eq!(to_scene([0.5, 1.000_001, 0.25]), None);
    assert_eq!(to_scene([0.5, f32::NAN, 0.25]), None);
    let [x, y, z] = to_scene([0.5, 0.0, 0.25]).unwrap();
    assert_eq!((x, y), (0.5, -0.25));
    assert!((z - 4.999_975).abs() < 1e-5);

    let mut broken = interval([24, 40]);
    broken.gaussians.mean[3][0] = f32::NAN;
    broken.gaussians.gamma[4][1] = f32::INFINITY;
    broken.gaussians.opacity[5] = -1.0;
    let seen = Snapshot::of(&broken, 3.0, &workers()).unwrap();
    assert_eq!(seen.dropped, 3);
    assert!(!seen.index.iter().any(|i| (3..=5).contains(i)));
    let image = broken.render(3.0, &Camera::Canonical, &RenderOptions::default(), &workers()).unwrap();
    assert!(image.rgb.iter().all(|x| x.is_finite()));

    broken.gaussians.rgb.pop();
    let error = Snapshot::of(&broken, 3.0, &workers()).unwrap_err();
    assert_eq!(error, RenderError::Records { array: "rgb", expected: 240, found: 239 });
}

#[test]
fn times_outside_the_interval_are_refused() {
    let interval = interval([24, 40]);
    for time in [1.999, 4.001, f64::NAN, f64::INFINITY] {
        let found = interval.render(time, &Camera::Canonical, &RenderOptions::default(), &workers());
        assert!(matches!(found, Err(RenderError::Time { start: 2.0, end: 4.0, .. })));
    }
}

#[test]
fn levels_threads_and_renderers_draw_the_same_bits() {
    let options = RenderOptions { depth: true, alpha: true, statistics: true, ..RenderOptions::default() };
    let pose = Pose::look_at([0.4, -0.3, -1.0], [0.0, 0.0, 0.4], [0.0, -1.0, 0.0]).unwrap();
    for camera in [Camera::Canonical, Camera::pinhole(pose, 70.0, 40.0 / 24.0).unwrap()] {
        let interval = interval([24, 37]);
        let one = Workers::new(Level::scalar(), 1).unwrap();
        let times = [2.0, 2.01, 3.3, 4.0];
        let expected: Vec<Image> = times.map(|time| interval.render(time, &camera, &options, &one).unwrap()).into();
        for level in Level::available() {
            for threads in [1, 2, 3, 8] {
                let mut renderer = Renderer::new(&Workers::new(level, threads).unwrap());
                for (time, expected) in times.into_iter().zip(&expected) {
                    let found = renderer.render(&interval, time, &camera, &options).unwrap();
                    assert!(found.rgb.iter().zip(&expected.rgb).all(|(a, b)| a.to_bits() == b.to_bits()));
                    assert_eq!(found, expected, "{level}, {threads} threads, {time} s");
                }
            }
        }
    }
}

#[test]
fn a_colour_that_changes_is_halfway_there_at_half_time() {
    let moving = interval([24, 40]);
    let mut changing = moving.clone();
    let (now, then) = ([0.25, 0.5, 0.75], [0.75, 0.25, 0.75]);
    changing.gaussians.rgb.fill(now);
    changing.gaussians.rgb_rate.fill([0.5, -0.25, 0.0]);
    let draw = |interval: &Interval, time| {
        interval.render(time, &Camera::Canonical, &RenderOptions::default(), &workers()).expect("inside").rgb
    };
    let painted = |rgb| {
        let mut painted = moving.clone();
        painted.gaussians.rgb.fill(rgb);
        painted
    };
    for (time, rgb) in [(2.0, now), (3.0, [0.5, 0.375, 0.75]), (4.0, then)] {
        let snapshot = Snapshot::of(&changing, time, &workers()).expect("inside");
        assert!(snapshot.rgb.iter().all(|found| *found == rgb), "{time}");
        assert!(draw(&changing, time) == draw(&painted(rgb), time), "{time}");
        // Files of one time hold the Gaussians visible then.
        let expected = Snapshot::of(&painted(rgb), time, &workers()).expect("inside");
        for format in &formats::FORMATS {
            let write = |snapshot| (format.snapshot)(snapshot, &formats::Options::default());
            assert_eq!(write(&snapshot), write(&expected), "{time}");
        }
    }
    // Seen backward, from the end.
    changing.gaussians.rgb.fill(then);
    let end = |gaussians: &mut DynamicGaussians| gaussians.reference.fill(crate::stream::Reference::End);
    end(&mut changing.gaussians);
    let mut middle = painted([0.5, 0.375, 0.75]);
    end(&mut middle.gaussians);
    assert!(draw(&changing, 3.0) == draw(&middle, 3.0));
}

#[test]
fn thickness_shows_from_the_side_and_not_from_the_front() {
    let network = interval([24, 40]);
    let mut thin = network.clone();
    thin.gaussians.thickness.fill(0.25);
    let snapshots = [&network, &thin].map(|interval| Snapshot::of(interval, 2.0, &workers()).expect("inside"));
    for (a, b) in snapshots[0].scale.iter().zip(&snapshots[1].scale) {
        assert_eq!(*a, [a[0], a[1], 0.5 * (a[0] + a[1])]);
        assert_eq!(*b, [a[0], a[1], 0.25 * a[2]]);
    }
    let draw = |interval: &Interval, camera: &Camera| {
        interval.render(2.0, camera, &RenderOptions::default(), &workers()).expect("inside").rgb
    };
    assert!(draw(&network, &Camera::Canonical) == draw(&thin, &Camera::Canonical));
    let rotation = Rotation::from_columns([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]).expect("orthonormal");
    let side = Camera::orthographic(Pose { position: [0.0; 3], rotation });
    assert!(draw(&network, &side) != draw(&thin, &side));
}

#[test]
fn what_rests_within_an_interval_is_drawn_once() {
    // What is right of an edge rests, the rest comes and goes: other Gaussians can be seen at each time.
    let resting_from = |edge: f32| {
        let mut scene = interval([24, 40]);
        let records = scene.gaussians.iter().map(|record| {
            let gamma = if record.mean[0] > edge { [0.0; 2] } else { [40.0, 0.1] };
            Record { velocity: [0.0; 3], gamma, ..record }
        });
        scene.gaussians = records.collect();
        scene
    };
    let options = RenderOptions { size: Size::Exact { width: 640, height: 384 }, ..RenderOptions::default() };
    // A half of the records, and a fifth: too few to look for them.
    for (interval, rests) in [(&resting_from(0.0), true), (&resting_from(0.6), false)] {
        let mut renderer = Renderer::new(&workers());
        for time in [2.1, 2.6, 3.9] {
            let image = renderer.render(interval, time, &Camera::Canonical, &options).expect("drawn").clone();
            assert_eq!(
                image,
                interval.render(time, &Camera::Canonical, &options, &workers()).expect("drawn"),
                "{time}"
            );
            let work = renderer.work();
            let all = time == 2.1 || !rests;
            assert_eq!(work.tiles_drawn == work.tiles, all, "{time}: {} of {} tiles", work.tiles_drawn, work.tiles);
            assert!(all || 3 * work.tiles_drawn < 2 * work.tiles, "{} of {} tiles", work.tiles_drawn, work.tiles);
        }
    }
}
