//! Scenes of known depth: planes at different distances, seen through exact flow.

use glam::DVec3;
use streamsplat_kernels::Level;
use streamsplat_kernels::flow::Field;
use streamsplat_kernels::philox::Stream;

use super::*;

const SIZE: [usize; 2] = [96, 160];
const STREAM: Stream = Stream { seed: 7, frame: 3 };

/// Inverse depth, and the object's own displacement in pixels, at a position in pixels.
type Scene = fn(f64, f64) -> (f64, [f64; 2]);

/// Returns a near plane in front of a far one that recedes to the right.
fn planes(x: f64, y: f64) -> (f64, [f64; 2]) {
    if (30.0..110.0).contains(&x) && y > 20.0 { (0.9, [0.0; 2]) } else { (0.3 - 0.001 * x, [0.0; 2]) }
}

/// Returns a picture with texture everywhere.
fn picture() -> Vec<f32> {
    let [height, width] = SIZE;
    (0..3 * height * width).map(|i| Stream { seed: 1, frame: 1 }.uniform((i % (height * width)) as u64)).collect()
}

/// Returns the exact flow of a scene under a motion of the camera, and its inverse.
fn flow(scene: Scene, motion: Motion, length: f64) -> [Field; 2] {
    let [height, width] = SIZE;
    let focal = motion.focal * width as f64;
    let middle = [(width as f64 - 1.0) * 0.5, (height as f64 - 1.0) * 0.5];
    let (mut there, mut back) = (Field::zero(SIZE), Field::zero(SIZE));
    let mut nearest = vec![f64::NEG_INFINITY; height * width];
    for row in 0..height {
        for column in 0..width {
            let (x, y) = (column as f64, row as f64);
            let (inverse, own) = scene(x, y);
            let ray = DVec3::new((x - middle[0]) / focal, (y - middle[1]) / focal, 1.0);
            let to = motion.rotation * ray + length * inverse * motion.translation;
            let u = to.x / to.z * focal + middle[0] - x + own[0];
            let v = to.y / to.z * focal + middle[1] - y + own[1];
            let at = row * width + column;
            (there.u[at], there.v[at]) = (u as f32, v as f32);
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let (cx, cy) = ((x + u).floor() as i64 + dx, (y + v).floor() as i64 + dy);
                if (0..width as i64).contains(&cx) && (0..height as i64).contains(&cy) {
                    let into = cy as usize * width + cx as usize;
                    if inverse > nearest[into] {
                        nearest[into] = inverse;
                        (back.u[into], back.v[into]) = (-u as f32, -v as f32);
                    }
                }
            }
        }
    }
    [there, back]
}

fn motion(turn: [f64; 3], translation: [f64; 3]) -> Motion {
    let translation = DVec3::from_array(translation);
    Motion {
        rotation: epipolar::turn(DVec3::from_array(turn)),
        translation: translation.normalize_or(DVec3::X),
        focal: FOCAL,
    }
}

fn found(scene: Scene, motion: Motion, length: f64, before: Option<&Found>) -> Option<Found> {
    let [there, back] = flow(scene, motion, length);
    let rgb = picture();
    find(Level::scalar(), Evidence { rgb: &rgb, there: &there, back: &back }, before, &Window::default(), STREAM).0
}

fn reason(scene: Scene, motion: Motion, length: f64) -> Option<NoParallax> {
    let [there, back] = flow(scene, motion, length);
    camera(Level::scalar(), Evidence { rgb: &picture(), there: &there, back: &back }, STREAM).err()
}

/// Returns the fraction of pairs of cells whose order is the same in a map and in the truth.
fn order(map: &[f32], scene: Scene) -> f64 {
    let width = SIZE[1];
    let truth: Vec<f64> = (0..map.len()).map(|i| scene((i % width) as f64, (i / width) as f64).0).collect();
    let (mut alike, mut all) = (0.0, 0.0);
    for k in 0..20_000_u64 {
        let [a, b, ..] = Stream { seed: 5, frame: 5 }.words(k).map(|word| word as usize % map.len());
        if (truth[a] - truth[b]).abs() > 0.02 {
            all += 1.0;
            alike += f64::from(u8::from((map[a] > map[b]) == (truth[a] > truth[b])));
        }
    }
    alike / all
}

#[test]
fn depth_is_found_whichever_way_the_camera_goes() {
    for (turn, translation) in [
        ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        ([0.01, -0.03, 0.01], [0.6, -0.7, 0.2]),
        ([-0.02, 0.02, 0.0], [-0.3, 0.9, -0.3]),
    ] {
        let found = found(planes, motion(turn, translation), 0.1, None).expect("parallax");
        let map = found.map(Level::scalar(), &picture(), SIZE);
        assert!(map.iter().all(|v| (0.0..=1.0).contains(v)));
        let order = order(&map, planes);
        assert!(order > 0.9, "{translation:?}: {order}");
    }
}

#[test]
fn the_camera_is_the_one_that_made_the_flow() {
    let true_motion = motion([0.01, -0.03, 0.01], [0.6, -0.7, 0.2]);
    let [there, back] = flow(planes, true_motion, 0.1);
    let found = camera(Level::scalar(), Evidence { rgb: &picture(), there: &there, back: &back }, STREAM);
    let translation = found.expect("parallax").translation;
    assert!(translation.dot(true_motion.translation) > 0.99, "{translation}");
}

#[test]
fn what_shows_no_parallax_is_told_from_what_does() {
    let (none, right) = (motion([0.0; 3], [1.0, 0.0, 0.0]), motion([0.0; 3], [1.0, 0.0, 0.0]));
    assert_eq!(reason(planes, none, 0.0), Some(NoParallax::Still));
    assert_eq!(reason(planes, motion([0.01, 0.05, 0.02], [1.0, 0.0, 0.0]), 0.0), Some(NoParallax::Flat));
    assert_eq!(reason(|x, _| (0.5 - 0.001 * x, [0.0; 2]), right, 0.1), Some(NoParallax::Flat));
    // Every point moves independently.
    let restless: Scene = |x, y| {
        let word = |k: u64| f64::from(Stream { seed: k, frame: 0 }.uniform((x / 12.0) as u64 + 64 * (y / 12.0) as u64));
        (0.3, [24.0 * (word(1) - 0.5), 24.0 * (word(2) - 0.5)])
    };
    assert!(reason(restless, right, 0.1).is_some());
    assert_eq!(found(planes, none, 0.0, None), None);
}

#[test]
fn a_small_thing_before_one_plane_is_parallax_unless_the_camera_may_only_turn() {
    // 14 % of the picture are at rest in front of a wall, or move in front of it.
    let standing: Scene =
        |x, y| if (60.0..100.0).contains(&x) && (30.0..84.0).contains(&y) { (0.9, [0.0; 2]) } else { (0.4, [0.0; 2]) };
    let moving: Scene = |x, y| {
        if (60.0..100.0).contains(&x) && (30.0..84.0).contains(&y) { (0.4, [8.0, 0.0]) } else { (0.4, [0.0; 2]) }
    };
    assert_eq!(reason(standing, motion([0.0; 3], [1.0, 0.0, 0.0]), 0.4), None);
    assert_eq!(reason(moving, motion([0.0, 0.1, 0.02], [1.0, 0.0, 0.0]), 0.0), Some(NoParallax::Flat));
    // Parallax of less than 0.4 pixels of 512 does not count.
    assert_eq!(reason(planes, motion([0.0, 0.1, 0.02], [1.0, 0.0, 0.0]), 0.001), Some(NoParallax::Flat));
}

/// Returns ground that comes nearer downwards, with a wall at the left.
fn ground(x: f64, y: f64) -> (f64, [f64; 2]) {
    (0.2 + 0.006 * y + if x < 50.0 { 0.3 } else { 0.0 }, [0.0; 2])
}

#[test]
fn a_long_lens_that_follows_something_does_not_turn_near_and_far_around() {
    // The camera moves to the right and turns against it, by more pixels than the parallax has.
    let long = Motion { focal: 2.2 * FOCAL, ..motion([0.0, -0.08, 0.0], [1.0, 0.0, 0.0]) };
    let [there, back] = flow(ground, long, 0.04);
    let rgb = picture();
    let evidence = Evidence { rgb: &rgb, there: &there, back: &back };
    let sight = Sight::new(Level::scalar(), evidence);
    let matches = matches::of(&sight, &Track::of(&sight)).expect("matches");
    let fits = FITS * sight.unit / sight.focal;
    let usual = ransac::motion(&matches, fits, STREAM, 0, None).expect("a motion");
    let upright = lens::upright(&usual, &matches, 2.0 * fits);
    assert!(upright < -lens::DOUBT, "the assumed lens turns the scene around: {upright}");
    let found = found(ground, long, 0.04, None).expect("parallax");
    let order = order(&found.map(Level::scalar(), &rgb, SIZE), ground);
    assert!(order > 0.9, "{order}");
    let camera = camera(Level::scalar(), evidence, STREAM).expect("parallax");
    assert!(camera.focal > 1.2 * FOCAL, "{}", camera.focal);
    // Where it turns less, the assumed lens puts a part of the scene behind the camera.
    let less = Motion { rotation: epipolar::turn(DVec3::new(0.0, -0.052, 0.0)), ..long };
    let [there, back] = flow(ground, less, 0.08);
    let evidence = Evidence { rgb: &rgb, there: &there, back: &back };
    let camera = super::camera(Level::scalar(), evidence, STREAM).expect("parallax");
    assert!(camera.focal > 1.2 * FOCAL, "{}", camera.focal);
}

#[test]
fn a_scene_whose_upper_parts_are_nearer_has_no_depth() {
    let ceiling: Scene = |x, y| ground(x, SIZE[0] as f64 - 1.0 - y);
    let right = motion([0.0; 3], [1.0, 0.0, 0.0]);
    assert_eq!(reason(ceiling, right, 0.12), Some(NoParallax::Reversed));
    assert_eq!(reason(ground, right, 0.12), None);
}

#[test]
fn flow_that_is_no_number_gives_no_depth() {
    let rgb = picture();
    let nowhere = Field { size: SIZE, u: vec![f32::NAN; SIZE[0] * SIZE[1]], v: vec![f32::NAN; SIZE[0] * SIZE[1]] };
    let evidence = Evidence { rgb: &rgb, there: &nowhere, back: &nowhere };
    assert_eq!(camera(Level::scalar(), evidence, STREAM), Err(NoParallax::Inconsistent));
    let (found, window) = find(Level::scalar(), evidence, None, &Window::default(), STREAM);
    assert_eq!(found, None);
    assert!(window.tracks[0].astray.iter().all(|astray| *astray == f32::INFINITY));
}

#[test]
fn what_moves_by_itself_takes_the_depth_of_the_ground_under_it() {
    // An object in the middle that slides across the epipolar lines, over ground that comes nearer downwards.
    let scene: Scene = |x, y| {
        let own = if (60.0..100.0).contains(&x) && (30.0..60.0).contains(&y) { [0.0, 5.0] } else { [0.0; 2] };
        let wall = if x < 50.0 { 0.3 } else { 0.0 };
        (0.2 + 0.006 * y + wall, own)
    };
    let found = found(scene, motion([0.0; 3], [1.0, 0.0, 0.0]), 0.12, None).expect("parallax");
    let map = found.map(Level::scalar(), &picture(), SIZE);
    let at = |x: usize, y: usize| map[y * SIZE[1] + x];
    let (thing, ground, above) = (at(80, 42), at(80, 66), at(80, 20));
    assert!((thing - ground).abs() < (thing - above).abs(), "{thing}, ground {ground}, above {above}");
}

/// Returns a body over ground that comes nearer downwards: its sides slide across the epipolar lines, a strip in its
/// middle along them.
fn body(x: f64, y: f64) -> (f64, [f64; 2]) {
    let inside = (60.0..100.0).contains(&x) && (30.0..60.0).contains(&y);
    let own = match inside {
        true if (73.0..87.0).contains(&x) && y < 48.0 => [5.0, 0.0],
        true => [0.0, 5.0],
        false => [0.0; 2],
    };
    (0.2 + 0.006 * y + if x < 50.0 { 0.3 } else { 0.0 }, own)
}

/// Returns the largest and smallest inverse depth of cells inside the body.
fn of_body(found: &Found) -> [f32; 2] {
    let cells = (17..28).flat_map(|row| (32..48).map(move |column| row * found.grid[1] + column));
    cells.fold([0.0, f32::INFINITY], |[most, least], cell| {
        let here = found.inverse[cell];
        [f32::max(most, here), f32::min(least, here)]
    })
}

#[test]
fn a_body_has_one_depth_with_its_parts_that_move_along_the_epipolar_lines() {
    let right = motion([0.0; 3], [1.0, 0.0, 0.0]);
    let first = found(body, right, 0.12, None).expect("parallax");
    let [most, least] = of_body(&first);
    assert!(least > 0.0 && most == least, "{least} to {most}");
    assert!(first.body[22 * first.grid[1] + 40] == 1.0 && first.body[5 * first.grid[1] + 40] == 0.0);
    // When it comes to rest it still has one depth, and is forgotten after some key frames.
    let resting: Scene = |x, y| (body(x, y).0, [0.0; 2]);
    let mut last = found(resting, right, 0.12, Some(&first)).expect("parallax");
    let [most, least] = of_body(&last);
    let score = last.body[22 * last.grid[1] + 40];
    assert!(most == least && score > 0.0 && score < 1.0, "{least} to {most}, score {score}");
    for _ in 0..6 {
        last = found(resting, right, 0.12, Some(&last)).expect("parallax");
    }
    assert!(last.body.iter().all(|score| *score == 0.0));
}

#[test]
fn what_was_found_is_carried_on_while_the_camera_rests() {
    let first = found(planes, motion([0.0; 3], [1.0, 0.0, 0.0]), 0.1, None).expect("parallax");
    let resting = motion([0.0; 3], [1.0, 0.0, 0.0]);
    let then = found(planes, resting, 0.0, Some(&first)).expect("carried");
    assert_eq!(then.inverse.len(), first.inverse.len());
    assert!(order(&then.map(Level::scalar(), &picture(), SIZE), planes) > 0.9);
    // But not forever.
    let mut last = Some(then);
    for _ in 0..64 {
        last = found(planes, resting, 0.0, last.as_ref());
    }
    assert_eq!(last, None);
}

#[test]
fn a_scene_keeps_its_scale_from_key_frame_to_key_frame() {
    let right = motion([0.0; 3], [1.0, 0.0, 0.0]);
    let first = found(planes, right, 0.1, None).expect("parallax");
    // At half the baseline, the parallax is half as long, and the result contains it.
    let second = found(planes, right, 0.05, Some(&first)).expect("parallax");
    let near = |found: &Found| {
        let cell = 30 * found.grid[1] + 32;
        found.inverse[cell]
    };
    assert!((near(&second) / near(&first) - 1.0).abs() < 0.1, "{} then {}", near(&first), near(&second));
}

#[test]
fn the_bits_are_the_same_every_time_and_another_seed_finds_the_same_camera() {
    let moved = motion([0.01, -0.03, 0.01], [0.6, -0.7, 0.2]);
    let [there, back] = flow(planes, moved, 0.1);
    let rgb = picture();
    let evidence = Evidence { rgb: &rgb, there: &there, back: &back };
    let once = find(Level::scalar(), evidence, None, &Window::default(), STREAM);
    assert_eq!(once, find(Level::detect(), evidence, None, &Window::default(), STREAM));
    let other = camera(Level::scalar(), evidence, Stream { seed: 8, ..STREAM }).expect("parallax");
    let one = camera(Level::scalar(), evidence, STREAM).expect("parallax");
    assert!(one.translation.dot(other.translation) > 0.999);
}

/// Flow and its errors: a smooth field of up to `most` pixels that is another one in each of `frame`'s pictures.
fn with_errors(mut field: Field, frame: u64, most: f64) -> Field {
    for at in 0..field.u.len() {
        let block = |k: u64| {
            let (x, y) = ((at % SIZE[1]) as f64 / 24.0, (at / SIZE[1]) as f64 / 24.0);
            let node = |x: u64, y: u64| f64::from(Stream { seed: k, frame }.uniform(x + 64 * y)) - 0.5;
            let (left, above) = (x as u64, y as u64);
            let (dx, dy) = (x.fract(), y.fract());
            let line = |y: u64| node(left, y) * (1.0 - dx) + node(left + 1, y) * dx;
            2.0 * most * (line(above) * (1.0 - dy) + line(above + 1) * dy)
        };
        field.u[at] += block(11) as f32;
        field.v[at] += block(12) as f32;
    }
    field
}

#[test]
fn slow_motion_is_measured_over_several_key_frames() {
    // Eight short steps to the right, with errors of flow that are as long as the parallax. `planes` in the coordinates
    // of the last frame: earlier ones differ by up to four pixels.
    let right = motion([0.0; 3], [1.0, 0.0, 0.0]);
    let rgb = picture();
    let run = |steps: u64, length: f64, most: f64| {
        let mut window = Window::default();
        let mut last = None;
        for step in 0..steps {
            let [there, back] = flow(planes, right, length);
            // The errors of both directions cancel in the round trip, as those of real flow often do.
            let there = with_errors(there, step, most);
            let back =
                Field { u: there.u.iter().map(|u| -u).collect(), v: there.v.iter().map(|v| -v).collect(), ..back };
            let evidence = Evidence { rgb: &rgb, there: &there, back: &back };
            (last, window) = find(Level::scalar(), evidence, None, &window, STREAM);
        }
        (last.map(|found| order(&found.map(Level::scalar(), &rgb, SIZE), planes)), window)
    };
    assert_eq!(run(1, 0.004, 0.05).0, None, "errors hide the parallax of one step");
    let (eight, window) = run(9, 0.004, 0.05);
    assert_eq!(window.tracks.len(), 8, "older frames are forgotten");
    let eight = eight.expect("parallax");
    assert!(eight > 0.9, "{eight}");
    // With errors four times as large some of the order is lost.
    let worse = run(9, 0.004, 0.2).0.expect("parallax");
    assert!((0.6..eight).contains(&worse), "{worse}");
}

#[test]
fn a_window_of_other_numbers_is_refused() {
    let [there, back] = flow(planes, motion([0.0; 3], [1.0, 0.0, 0.0]), 0.1);
    let rgb = picture();
    let evidence = Evidence { rgb: &rgb, there: &there, back: &back };
    let (_, window) = find(Level::scalar(), evidence, None, &Window::default(), STREAM);
    assert_eq!(window.contradiction(SIZE), None);
    assert!(window.contradiction([SIZE[0] + 2, SIZE[1]]).is_some_and(|reason| reason.contains("98")));
    let changes: [fn(&mut Window); 4] = [
        |window| window.tracks[0].u[3] = f32::NAN,
        |window| window.tracks[0].astray[3] = -1.0,
        |window| _ = window.tracks[0].v.pop(),
        |window| window.tracks = vec![window.tracks[0].clone(); 9],
    ];
    for change in changes {
        let mut wrong = window.clone();
        change(&mut wrong);
        assert!(wrong.contradiction(SIZE).is_some());
    }
}

/// A ground without its own motion, and an upright body on it that moves to the right.
fn walker(x: f64, y: f64) -> (f64, [f64; 2]) {
    if (60.0..84.0).contains(&x) && (24.0..76.0).contains(&y) { (0.9, [6.0, 0.0]) } else { (0.3, [0.0; 2]) }
}

/// A search with a guess.
fn guessed(scene: Scene, motion: Motion, length: f64, before: Option<&Found>) -> Search {
    let [there, back] = flow(scene, motion, length);
    let rgb = picture();
    let evidence = Evidence { rgb: &rgb, there: &there, back: &back };
    search(Level::scalar(), evidence, before, &Window::default(), STREAM, true)
}

#[test]
fn without_parallax_a_guess_is_a_ground_with_upright_bodies_on_it() {
    let [still, turning] = [[0.0; 3], [0.0, 0.04, 0.0]].map(|turn| motion(turn, [1.0, 0.0, 0.0]));
    for camera in [still, turning] {
        assert_eq!(found(walker, camera, 0.0, None), None, "nothing is guessed unless that is requested");
        let Search { filled, guessed, .. } = guessed(walker, camera, 0.0, None);
        let found = filled.expect("a guess").found;
        assert!(guessed);
        let [rows, columns] = found.grid;
        let at = |row: usize, column: usize| found.inverse[row * columns + column];
        for row in 1..rows {
            assert!(at(row, 3) >= at(row - 1, 3), "lower is not farther");
        }
        assert!(at(rows - 1, 3) > 3.0 * at(0, 3));
        // The body is at one depth, that of the ground under its feet.
        let (head, feet) = (at(14, 36), at(36, 36));
        assert_eq!(head, feet);
        assert!((feet / at(39, 3) - 1.0).abs() < 0.1, "{feet} on a ground of {}", at(39, 3));
        assert!(feet > 1.5 * at(14, 3), "in front of what is behind it");
    }
}

#[test]
fn measured_depth_outweighs_a_guess() {
    let (still, moving) = (motion([0.0; 3], [1.0, 0.0, 0.0]), motion([0.0, 0.01, 0.0], [1.0, 0.0, 0.0]));
    let ordered = |found: &Found| order(&found.map(Level::scalar(), &picture(), SIZE), planes);
    // Any number of guesses before, whose order is another one.
    let mut before = None;
    for _ in 0..8 {
        before = guessed(walker, still, 0.0, before.as_ref()).filled.map(|filled| filled.found);
    }
    assert!(before.as_ref().is_some_and(|found| found.confidence.iter().all(|c| *c <= 0.03)), "it does not grow");
    assert!(ordered(before.as_ref().expect("a guess")) < 0.7);
    let Search { filled, guessed: any, .. } = guessed(planes, moving, 0.1, before.as_ref());
    assert!(!any, "parallax needs no guess");
    let measured = filled.expect("parallax").found;
    assert!(ordered(&measured) > 0.85, "{}", ordered(&measured));
    // Guesses after it, also where a part of it has no confidence.
    let mut partly = found(planes, moving, 0.1, None).expect("parallax");
    for cell in (0..partly.inverse.len()).filter(|cell| cell % 9 < 4) {
        (partly.inverse[cell], partly.confidence[cell]) = (0.0, 0.0);
    }
    let mut last = partly.clone();
    for _ in 0..6 {
        let Search { filled, guessed: any, .. } = guessed(planes, still, 0.0, Some(&last));
        assert!(any);
        last = filled.expect("carried").found;
    }
    let known = |cell: &usize| partly.confidence[*cell] > 0.5;
    let ratios = (0..last.inverse.len()).filter(known).map(|cell| last.inverse[cell] / partly.inverse[cell]);
    let near = ratios.clone().filter(|ratio| (ratio - 1.0).abs() < 0.15).count();
    assert!(near as f64 > 0.9 * ratios.clone().count() as f64, "{near} cells of {}", ratios.count());
    assert!((last.nearest / partly.nearest - 1.0).abs() < 0.5, "{} after {}", last.nearest, partly.nearest);
}

#[test]
fn nothing_is_guessed_against_what_the_flow_shows() {
    let ceiling: Scene = |x, y| ground(x, SIZE[0] as f64 - 1.0 - y);
    let Search { filled, guessed, .. } = guessed(ceiling, motion([0.0; 3], [1.0, 0.0, 0.0]), 0.12, None);
    assert!(filled.is_none() && !guessed, "what is higher seems nearer");
}

#[test]
fn a_guess_fits_pictures_of_any_size() {
    for size in [[1, 1], [1, 9], [9, 1], [3, 5]] {
        let [there, back] = [Field::zero(size), Field::zero(size)];
        let rgb = vec![0.5; 3 * size[0] * size[1]];
        let evidence = Evidence { rgb: &rgb, there: &there, back: &back };
        let Search { filled, .. } = search(Level::scalar(), evidence, None, &Window::default(), STREAM, true);
        assert!(filled.is_none_or(|filled| filled.found.contradiction(size).is_none()), "{size:?}");
    }
}
