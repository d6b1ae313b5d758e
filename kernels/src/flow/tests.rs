//! Known motion, extremes, and bits across levels and threads.

use proptest::prelude::*;

use super::reference::{self, Picture};
use super::search::{Found, Grid, Guess, search};
use super::*;
use crate::testing::{noise, on_every_level_and_thread_count};

/// Sizes that are no multiple of anything, one pixel wide or high, smaller than a patch, and large enough for several
/// scales and tasks.
const SIZES: [[usize; 2]; 9] = [[1, 1], [1, 40], [33, 1], [2, 3], [7, 9], [8, 8], [17, 50], [61, 97], [150, 131]];

/// A smooth texture at a point: noise on lattices of 5 to 40 pixels, so that no part looks like another.
fn texture(x: f32, y: f32) -> f32 {
    let lattice = |x: f32, y: f32| {
        let hash = (x as i32).wrapping_mul(0x27d4_eb2f) ^ (y as i32).wrapping_mul(0x1656_67b1);
        let hash = (hash ^ (hash >> 15)).wrapping_mul(0x2c1b_3c6d);
        ((hash ^ (hash >> 13)) & 0xffff) as f32 / 65536.0 - 0.5
    };
    let octave = |size: f32| {
        let (x, y) = (x / size, y / size);
        let (x0, y0) = (x.floor(), y.floor());
        let ease = |f: f32| f * f * (3.0 - 2.0 * f);
        let (fx, fy) = (ease(x - x0), ease(y - y0));
        let row = |y: f32| lattice(x0, y) * (1.0 - fx) + lattice(x0 + 1.0, y) * fx;
        row(y0) * (1.0 - fy) + row(y0 + 1.0) * fy
    };
    0.5 + 0.3 * octave(5.0) + 0.3 * octave(11.0) + 0.3 * octave(40.0)
}

fn picture([h, w]: [usize; 2], at: impl Fn(f32, f32) -> f32) -> Vec<f32> {
    (0..h * w).map(|i| at((i % w) as f32, (i / w) as f32)).collect()
}

fn pair(level: Level, a: &[f32], b: &[f32], size: [usize; 2], options: &Options) -> Field {
    let [a, b] = [a, b].map(|x| Pyramid::new(level, x, size, options).expect("finite luma"));
    between(level, &a, &b, None, options)
}

fn assert_bounded(field: &Field) {
    let [h, w] = field.size;
    assert_eq!((field.u.len(), field.v.len()), (h * w, h * w));
    assert!(field.u.iter().all(|x| x.abs() <= w as f32), "{h}×{w}: {:?}", field.u);
    assert!(field.v.iter().all(|x| x.abs() <= h as f32), "{h}×{w}: {:?}", field.v);
}

/// Mean distance from (u, v), without `margin` pixels at the border.
fn error(field: &Field, u: f32, v: f32, margin: usize) -> f32 {
    let [h, w] = field.size;
    let (mut sum, mut count) = (0.0, 0.0);
    for y in margin..h - margin {
        for x in margin..w - margin {
            sum += (field.u[y * w + x] - u).hypot(field.v[y * w + x] - v);
            count += 1.0;
        }
    }
    sum / count
}

#[test]
fn translations_are_found_below_a_tenth_of_a_pixel() {
    let size = [120, 160];
    let first = picture(size, texture);
    for (u, v) in [(0.0, 0.0), (0.5, -0.25), (3.0, 2.0), (-7.3, 4.6), (11.0, -6.5)] {
        let second = picture(size, |x, y| texture(x - u, y - v));
        for finest in [0, 1] {
            let options = Options { finest, ..Options::default() };
            let field = pair(Level::detect(), &first, &second, size, &options);
            let error = error(&field, u, v, 16);
            assert!(error < 0.1, "motion ({u}, {v}), finest scale {finest}: off by {error} pixels");
        }
    }
}

/// The finest scale of a picture, and the same for the reference.
fn scale(luma: &[f32], size: [usize; 2]) -> (Pyramid, Picture) {
    let options = Options { finest: 0, ..Options::default() };
    let pyramid = Pyramid::new(Level::detect(), luma, size, &options).expect("finite luma");
    let picture = Picture::new(size, |y, x| f64::from(pyramid.scales[0].luma.row(y as usize)[x as usize]));
    (pyramid, picture)
}

fn as_picture(plane: &[f32], size: [usize; 2]) -> Picture {
    Picture::new(size, |y, x| f64::from(plane[y as usize * size[1] + x as usize]))
}

/// Pairs for the stages: a picture and where it moved, of odd and even sizes, one pixel wide, smaller than a patch.
fn stages() -> impl Iterator<Item = ([usize; 2], [(Pyramid, Picture); 2])> {
    [[48, 70], [33, 47], [9, 8], [5, 21], [1, 12], [30, 1]].into_iter().map(|size| {
        let moved = picture(size, |x, y| texture(x - 1.3 - 0.02 * y, y + 0.8));
        (size, [scale(&picture(size, texture), size), scale(&moved, size)])
    })
}

#[test]
fn patches_are_compared_as_in_the_reference() {
    for (size, [(first, a), (second, b)]) in stages() {
        let (first, second) = (&first.scales[0], &second.scales[0].luma);
        let grid = Grid::new(size, 3);
        let guess = |x: f32, y: f32| Some([0.3 * (x * 0.7).sin() - 0.2, 2.0 * (y * 0.9).cos()]);
        let guesses: &[&dyn Guess] = &[&guess];
        let cost = |found: &Found, at: [usize; 2]| {
            let flow = [f64::from(found.u), f64::from(found.v)];
            reference::patch(&a, &b, at.map(|i| i as isize), flow).0
        };
        let places: Vec<[usize; 2]> = grid.ys.iter().flat_map(|&y| grid.xs.iter().map(move |&x| [y, x])).collect();
        let started =
            search(Level::detect(), first, second, &grid, guesses, &Options { iterations: 0, ..Options::default() });
        let descended = search(Level::detect(), first, second, &grid, guesses, &Options::default());
        for (found, at) in started.iter().chain(&descended).zip(places.iter().chain(&places)) {
            let expected = cost(found, *at);
            let close = (f64::from(found.cost) - expected).abs() < 1e-2 + 1e-4 * expected;
            assert!(close, "{size:?}, {at:?}: cost {} instead of {expected}", found.cost);
        }
        let sum = |found: &[Found]| found.iter().map(|f| f64::from(f.cost)).sum::<f64>();
        assert!(sum(&descended) <= sum(&started));
    }
}

#[test]
fn slopes_are_those_of_the_reference() {
    // A Gauss–Newton step with a diagonal of 64 more than the structure tensor's, from the reference's slope.
    let size = [40, 52];
    let (first, a) = scale(&picture(size, texture), size);
    let (second, b) = scale(&picture(size, |x, y| texture(x - 0.4, y + 0.3)), size);
    let grid = Grid::new(size, 8);
    let none = |_: f32, _: f32| Some([0.0; 2]);
    let guesses: &[&dyn Guess] = &[&none];
    let options = Options { iterations: 30, ..Options::default() };
    let found = search(Level::detect(), &first.scales[0], &second.scales[0].luma, &grid, guesses, &options);
    for (k, found) in found.iter().enumerate() {
        let at = [grid.ys[k / grid.xs.len()], grid.xs[k % grid.xs.len()]].map(|i| i as isize);
        let (_, slope) = reference::patch(&a, &b, at, [f64::from(found.u), f64::from(found.v)]);
        let still = reference::patch(&a, &b, at, [0.0; 2]).1;
        let length = |[x, y]: [f64; 2]| x.hypot(y);
        assert!(length(slope) < 0.2 * length(still) + 20.0, "{at:?}: {slope:?} from {still:?}");
    }
}

#[test]
fn densification_agrees_with_the_reference() {
    for (size, [(first, a), (second, b)]) in stages() {
        let grid = Grid::new(size, 3);
        let random = noise(2 * grid.ys.len() * grid.xs.len(), 9);
        let found: Vec<Found> =
            random.chunks(2).map(|r| Found { u: 3.0 * r[0].max(-0.3), v: 3.0 * r[1].min(0.1), cost: 0.0 }).collect();
        let inside = |at: usize, by: f32, n: usize| at as f32 + by > -7.9 && at as f32 + by < n as f32 - 1.1;
        let mut patches = Vec::new();
        let mut kept = found.clone();
        for (k, found) in kept.iter_mut().enumerate() {
            let at = [grid.ys[k / grid.xs.len()], grid.xs[k % grid.xs.len()]];
            if !inside(at[0], found.v, size[0]) || !inside(at[1], found.u, size[1]) {
                *found = Found::default();
            }
            patches.push((at, [f64::from(found.u), f64::from(found.v)]));
        }
        let (first, second) = (&first.scales[0].luma, &second.scales[0].luma);
        let dense = densify::densify(Level::detect(), first, second, &grid, &kept);
        for (plane, expected) in dense.iter().zip(reference::densify(&a, &b, &patches)) {
            for (x, expected) in plane.iter().zip(&expected.values) {
                assert!((f64::from(*x) - expected).abs() < 1e-4, "{size:?}: {x} instead of {expected}");
            }
        }
    }
}

#[test]
fn refinement_agrees_with_the_reference() {
    for (size, [(first, a), (second, b)]) in stages() {
        let wave = |at: f32| move |x: f32, y: f32| 0.4 * (0.2 * x + at).sin() * (0.3 * y - at).cos() + 0.5;
        let start = [picture(size, wave(0.3)), picture(size, wave(1.9))];
        for refinement in [1, 5] {
            let options = Options { refinement, ..Options::default() };
            let mut flow = start.clone();
            let (first, second) = (&first.scales[0].luma, &second.scales[0].luma);
            refine::refine(Level::detect(), first, second, &mut flow, &options);
            let weights = [options.smoothness, options.brightness, options.gradient].map(f64::from);
            let start = [as_picture(&start[0], size), as_picture(&start[1], size)];
            let expected = reference::refine(&a, &b, &start, weights, refinement);
            for (plane, expected) in flow.iter().zip(&expected) {
                for (x, expected) in plane.iter().zip(&expected.values) {
                    assert!((f64::from(*x) - expected).abs() < 2e-3, "{size:?}: {x} instead of {expected}");
                }
            }
        }
    }
}

#[test]
fn warps_and_blends_agree_with_the_reference() {
    for size @ [h, w] in SIZES {
        let area = h * w;
        let (a, b) = (noise(3 * area, 1), noise(3 * area, 2));
        let scattered = |seed: u32| noise(area, seed).iter().map(|x| x * 9.0).collect::<Vec<f32>>();
        let f = Field { size, u: scattered(3), v: scattered(4) };
        let g = Field { size, u: scattered(5), v: scattered(6) };
        let warped = warp(Level::detect(), &a, size, &f);
        for k in 0..3 {
            let plane = as_picture(&a[k * area..][..area], size);
            for i in 0..area {
                let (y, x) = ((i / w) as f64 + f64::from(f.v[i]), (i % w) as f64 + f64::from(f.u[i]));
                let expected = plane.between(y, x);
                let got = warped[k * area + i];
                assert!((f64::from(got) - expected).abs() < 2e-5, "{size:?}: {got} instead of {expected}");
            }
        }
        let planes = |x: &[f32]| [0, 1, 2].map(|k| as_picture(&x[k * area..][..area], size));
        let fields = [&f, &g].map(|f| [as_picture(&f.u, size), as_picture(&f.v, size)]);
        let blend = Blend::new(Level::detect(), [&a, &b], [&f, &g]);
        for t in [0.25, 0.7] {
            let blended = blend.at(t);
            let expected = reference::blend(&planes(&a), &planes(&b), &fields, f64::from(t));
            for (got, expected) in blended.iter().zip(expected.iter().flat_map(|p| &p.values)) {
                assert!((f64::from(*got) - expected).abs() < 1e-3, "{size:?}: {got} instead of {expected}");
            }
        }
    }
}

#[test]
fn equal_and_flat_pictures_do_not_move() {
    for size in SIZES {
        let n = size[0] * size[1];
        for x in [vec![0.0; n], vec![0.7; n], noise(n, 1)] {
            let field = pair(Level::detect(), &x, &x, size, &Options::default());
            assert!(field.u.iter().chain(&field.v).all(|x| *x == 0.0), "{size:?}");
        }
        let field = pair(Level::detect(), &vec![0.1; n], &vec![0.9; n], size, &Options::default());
        assert!(field.u.iter().chain(&field.v).all(|x| *x == 0.0), "{size:?} in other light");
    }
}

#[test]
fn bits_are_equal_on_every_level_and_for_any_number_of_threads() {
    for (size, finest) in SIZES.into_iter().zip([0, 1, 2].into_iter().cycle()) {
        let area = size[0] * size[1];
        let options = Options { finest, ..Options::default() };
        let noise = [noise(area, 1), noise(area, 2)];
        let moved = [picture(size, texture), picture(size, |x, y| texture(x - 5.3, y + 2.1))];
        for [a, b] in [noise, moved] {
            on_every_level_and_thread_count(13 * area, |level, out| {
                let [a, b] = [&a, &b].map(|x| [x.as_slice(), x, x].concat());
                let [first, second] =
                    [&a, &b].map(|x| Pyramid::new(level, &luma(level, x), size, &options).expect("finite luma"));
                let [forward, backward] = both(level, &first, &second, [None; 2], &options);
                let again = between(level, &first, &second, Some(&backward), &options);
                let mut rest = out;
                for field in [&forward, &backward, &again, &forward.then(level, &backward)] {
                    for plane in [&field.u, &field.v] {
                        rest.split_off_mut(..area).expect("room").copy_from_slice(plane);
                    }
                }
                rest.split_off_mut(..area).expect("room").copy_from_slice(&forward.round_trip(level, &backward));
                rest.split_off_mut(..3 * area).expect("room").copy_from_slice(&warp(level, &a, size, &forward));
                let blended = Blend::new(level, [&a, &b], [&forward, &backward]).at(0.3);
                assert!(blended.iter().all(|x| x.is_finite()));
                rest.copy_from_slice(&blended[..area]);
            });
        }
    }
}

#[test]
fn motion_beyond_the_picture_and_noise_stay_inside_it() {
    for size in SIZES {
        let area = size[0] * size[1];
        let first = picture(size, texture);
        let second = picture(size, |x, y| texture(x - 1000.0, y + 777.0));
        for (a, b) in [(&first, &second), (&noise(area, 3), &noise(area, 4)), (&first, &noise(area, 5))] {
            for stride in [1, 5, 8] {
                let options = Options { stride, ..Options::default() };
                assert_bounded(&pair(Level::detect(), a, b, size, &options));
            }
        }
    }
}

#[test]
fn values_that_are_not_finite_are_refused_with_their_place() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut x = vec![0.5; 300 * 301];
        x[299 * 301 + 4] = bad;
        x[7 * 301 + 11] = bad;
        let refused = Pyramid::new(Level::detect(), &x, [300, 301], &Options::default()).err();
        assert_eq!(refused, Some(FlowError::NotFinite { row: 7, column: 11 }));
    }
    let refused = Pyramid::new(Level::detect(), &[], [0, 5], &Options::default()).err();
    assert_eq!(refused, Some(FlowError::Size { size: [0, 5] }));
}

#[test]
fn weights_are_refused_by_name_or_give_finite_flow() {
    let size = [30, 41];
    let (a, b) = (picture(size, texture), noise(size[0] * size[1], 6));
    let set: [(&str, fn(&mut Options, f32)); 3] = [
        ("smoothness", |options, weight| options.smoothness = weight),
        ("brightness", |options, weight| options.brightness = weight),
        ("gradient", |options, weight| options.gradient = weight),
    ];
    let made = |options: &Options| Pyramid::new(Level::detect(), &a, size, options).map(drop);
    for (name, set) in set {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, 1_000_001.0, -1e-45, -1.0] {
            let mut options = Options::default();
            set(&mut options, bad);
            assert_eq!(made(&options), Err(FlowError::Weight { name, bits: bad.to_bits() }));
            let text = made(&options).expect_err("refused").to_string();
            assert_eq!(text, format!("the flow's {name}: expected a weight from 0 to 1000000, found {bad}"));
            // Pyramids may have been made with others.
            let pyramid = Pyramid::new(Level::detect(), &a, size, &Options::default()).expect("finite luma");
            let work = || between(Level::detect(), &pyramid, &pyramid, None, &options);
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).is_err(), "{name} of {bad}");
        }
        for weight in [0.0, -0.0, 1e-45, 1e-30, 1e6] {
            for (a, b) in [(&a, &b), (&b, &a)] {
                let mut options = Options { refinement: 40, ..Options::default() };
                set(&mut options, weight);
                assert_bounded(&pair(Level::detect(), a, b, size, &options));
                let mut alone = Options { smoothness: 0.0, brightness: 0.0, gradient: 0.0, ..options };
                set(&mut alone, weight);
                assert_bounded(&pair(Level::detect(), a, b, size, &alone));
            }
        }
    }
    let most = Options { smoothness: 1e6, brightness: 1e6, gradient: 1e6, ..Options::default() };
    assert_bounded(&pair(Level::detect(), &a, &b, size, &most));
    let far = Options { finest: usize::MAX, stride: usize::MAX, iterations: 1000, ..Options::default() };
    assert_bounded(&pair(Level::detect(), &a, &b, size, &far));
}

#[test]
fn values_from_all_over_the_number_line_give_finite_flow() {
    let size = [30, 41];
    let wild = |seed: u32| -> Vec<f32> {
        let values = [0.0, -0.0, 1e-45, 1e38, -1e38, 1.0, f32::MAX, f32::MIN, 0.25, 1e-20];
        noise(size[0] * size[1], seed).iter().map(|x| values[(x.abs() * 9.99) as usize]).collect()
    };
    assert_bounded(&pair(Level::detect(), &wild(1), &wild(2), size, &Options::default()));
}

#[test]
fn a_start_is_taken_where_it_is_better_and_left_where_it_is_not() {
    // A motion that the coarse scales cannot see: a fine texture on a flat one.
    let size = [96, 128];
    let fine = |x: f32, y: f32| 0.5 + 0.2 * ((1.3 * x).sin() * (1.1 * y).cos());
    let patch = |x: f32, y: f32| if (40.0..72.0).contains(&x) && (30.0..66.0).contains(&y) { fine(x, y) } else { 0.5 };
    let (first, second) = (picture(size, patch), picture(size, |x, y| patch(x - 14.0, y + 9.0)));
    let options = Options { finest: 0, ..Options::default() };
    let [a, b] = [&first, &second].map(|x| Pyramid::new(Level::detect(), x, size, &options).expect("finite luma"));
    let area = size[0] * size[1];
    let start = Field { size, u: vec![14.0; area], v: vec![-9.0; area] };
    let found = between(Level::detect(), &a, &b, Some(&start), &options).at(56.0, 48.0);
    assert!((found[0] - 14.0).hypot(found[1] + 9.0) < 0.3, "{found:?}");
    let still = between(Level::detect(), &a, &a, Some(&start), &options);
    assert!(still.u.iter().chain(&still.v).all(|x| x.abs() < 1.5), "a start that is no motion");
    let undefined = Field { size, u: vec![f32::NAN; area], v: vec![f32::INFINITY; area] };
    let without = between(Level::detect(), &a, &b, None, &options);
    assert_eq!(between(Level::detect(), &a, &b, Some(&undefined), &options), without);
}

#[test]
fn fields_chain_and_return() {
    let size = [20, 30];
    let area = 600;
    let constant = |u: f32, v: f32| Field { size, u: vec![u; area], v: vec![v; area] };
    let (f, g) = (constant(2.5, -1.0), constant(-2.5, 1.0));
    assert_eq!(f.then(Level::detect(), &f), constant(5.0, -2.0));
    assert_eq!(f.round_trip(Level::detect(), &g), vec![0.0; area]);
    assert_eq!(f.round_trip(Level::detect(), &constant(0.5, 3.0)), vec![13.0_f32.sqrt(); area]);
    let ramp = Field { size, u: picture(size, |x, y| x + 10.0 * y), v: picture(size, |x, _| -x) };
    assert_eq!(ramp.at(3.25, 4.5), [48.25, -3.25]);
    assert_eq!(ramp.at(-3.0, 100.0), [190.0, 0.0]);
    assert_eq!(ramp.at(f32::NAN, 0.0), [29.0, -29.0]);
}

#[test]
fn a_blend_at_the_ends_is_the_frame_there() {
    let size = [40, 50];
    let (a, b) = (noise(3 * 2000, 1), noise(3 * 2000, 2));
    let scattered = |seed: u32| Field {
        size,
        u: noise(2000, seed).iter().map(|x| x * 9.0).collect(),
        v: noise(2000, seed + 1).iter().map(|x| x * 9.0).collect(),
    };
    let (f, g) = (scattered(3), scattered(5));
    let blend = Blend::new(Level::detect(), [&a, &b], [&f, &g]);
    assert_eq!(blend.at(0.0), a);
    assert_eq!(blend.at(1.0), b);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_pair_has_a_bounded_flow_with_the_same_bits_on_every_level(
        h in 1_usize..40,
        w in 1_usize..40,
        finest in 0_usize..3,
        stride in 0_usize..10,
        refinement in 0_usize..3,
        seed in any::<u32>(),
    ) {
        let options = Options { finest, stride, refinement, ..Options::default() };
        let (a, b) = (noise(h * w, seed), noise(h * w, seed ^ 1));
        let expected = pair(Level::scalar(), &a, &b, [h, w], &options);
        assert_bounded(&expected);
        for level in crate::testing::levels() {
            prop_assert_eq!(&pair(level, &a, &b, [h, w], &options), &expected);
        }
    }
}

/// [`follow`] as documented, point by point.
fn followed([x, y]: [f32; 2], steps: &[Step<'_>]) -> [f32; 2] {
    let none = [f32::NAN; 2];
    if !(x.is_finite() && y.is_finite()) {
        return none;
    }
    let length = |x: f32, y: f32| x.mul_add(x, y * y).sqrt();
    let (mut at, mut sums, mut squares) = ([x, y], [0.0_f32; 2], 0.0_f32);
    for step in steps {
        let [h, w] = step.there.size.map(|side| side as f32);
        let [u, v] = step.there.at(at[0], at[1]);
        at = [at[0] + u, at[1] + v];
        let inside = (-0.5..=w - 0.5).contains(&at[0]) && (-0.5..=h - 0.5).contains(&at[1]);
        let [back_u, back_v] = step.back.at(at[0], at[1]);
        if steps.len() > 1 && (!inside || length(u + back_u, v + back_v) > 0.1_f32.mul_add(length(u, v), 2.0)) {
            break;
        }
        sums = [0, 1].map(|k| step.distance.mul_add(at[k] - [x, y][k], sums[k]));
        squares = step.distance.mul_add(step.distance, squares);
    }
    if squares == 0.0 { none } else { sums.map(|sum| sum / squares) }
}

/// [`trace`] point by point; `None` for a point that strays.
fn traced(start: [f32; 2], steps: &[Step<'_>]) -> Option<[f32; 2]> {
    let length = |x: f32, y: f32| x.mul_add(x, y * y).sqrt();
    let from = Some(start).filter(|start| start.iter().all(|x| x.is_finite()))?;
    steps.iter().try_fold(from, |at, step| {
        let [h, w] = step.there.size.map(|side| side as f32);
        let [u, v] = step.there.at(at[0], at[1]);
        let to = [at[0] + u, at[1] + v];
        let inside = (-0.5..=w - 0.5).contains(&to[0]) && (-0.5..=h - 0.5).contains(&to[1]);
        let [back_u, back_v] = step.back.at(to[0], to[1]);
        let astray = length(u + back_u, v + back_v) > 0.1_f32.mul_add(length(u, v), 2.0);
        (inside && !astray).then_some(to)
    })
}

#[test]
fn points_follow_the_flow_as_in_the_reference_to_the_bit() {
    for size @ [h, w] in [[1, 1], [1, 40], [9, 8], [61, 97]] {
        let field = |seed: u32, long: f32| Field {
            size,
            u: noise(h * w, seed).iter().map(|x| x * long).collect(),
            v: noise(h * w, seed + 1).iter().map(|x| x * long).collect(),
        };
        let fields: Vec<[Field; 2]> =
            (0..4).map(|k| [field(10 * k, 1.0 + k as f32), field(10 * k + 5, 1.0 + k as f32)]).collect();
        // Steps that come back, steps that do not, and steps that are long.
        let steps: Vec<Step<'_>> = fields
            .iter()
            .zip([0.25, 0.5, 0.75, 1.0])
            .map(|([there, back], distance)| Step { there, back, distance })
            .collect();
        let extremes = [f32::NAN, f32::INFINITY, -0.0, -1e30, 1e30, -0.5, w as f32 - 0.5];
        let mut starts: Vec<[f32; 2]> = extremes.iter().flat_map(|&x| [[x, 0.0], [0.0, x]]).collect();
        let places = noise(2 * 3001, 77);
        starts.extend(places.as_chunks::<2>().0.iter().map(|[x, y]| [(x + 0.5) * w as f32, (y + 0.5) * h as f32]));
        for steps in [&steps[..], &steps[..1], &steps[..0]] {
            let expected: Vec<[f32; 2]> = starts.iter().map(|&start| followed(start, steps)).collect();
            let found = on_every_level_and_thread_count(2 * starts.len(), |level, found| {
                follow(level, &starts, steps, found.as_chunks_mut::<2>().0);
            });
            for (i, (found, expected)) in found.as_chunks::<2>().0.iter().zip(&expected).enumerate() {
                let same = |k: usize| {
                    found[k].to_bits() == expected[k].to_bits() || (found[k].is_nan() && expected[k].is_nan())
                };
                assert!(same(0) && same(1), "{h}×{w}, from {:?}: {found:?}, expected {expected:?}", starts[i]);
            }
            let ends = on_every_level_and_thread_count(2 * starts.len(), |level, ends| {
                trace(level, &starts, steps, ends.as_chunks_mut::<2>().0);
            });
            for (start, end) in starts.iter().zip(ends.as_chunks::<2>().0) {
                let expected = traced(*start, steps).unwrap_or([f32::NAN; 2]);
                let same =
                    |k: usize| end[k].to_bits() == expected[k].to_bits() || (end[k].is_nan() && expected[k].is_nan());
                assert!(same(0) && same(1), "{h}×{w}, from {start:?}: {end:?}, expected {expected:?}");
            }
            assert!(steps.is_empty() || expected.iter().any(|v| v[0].is_finite()), "some points are followed");
        }
    }
}

/// [`align`] as documented, point by point.
///
/// `all`: starts and velocities of all points.
fn aligned(
    ([x, y], velocity): ([f32; 2], [f32; 2]),
    lumas: Lumas<'_>,
    steps: &[Step<'_>],
    all: &[([f32; 2], [f32; 2])],
) -> [f32; 2] {
    let Some((last, earlier)) = steps.split_last().filter(|(_, earlier)| !earlier.is_empty()) else { return velocity };
    if !(x.is_finite() && y.is_finite()) {
        return velocity;
    }
    let around = |frame: &[f32], at: [f32; 2]| sample::cross_one(frame, last.there.size, at);
    let sum = 5.0 * earlier.iter().fold(0.0, |sum, step| sum + (1.0 - step.distance / last.distance));
    let misfit = |[u, v]: [f32; 2]| {
        let mut misfit = 0.0_f32;
        for (frame, step) in lumas.to.iter().zip(earlier) {
            let there = [u.mul_add(step.distance, x), v.mul_add(step.distance, y)];
            for (found, base) in around(frame, there).into_iter().zip(around(lumas.from, [x, y])) {
                let difference = (found - base).abs().min(0.12);
                misfit = ((1.0 - step.distance / last.distance) / sum).mul_add(difference, misfit);
            }
        }
        misfit
    };
    let own = if velocity.iter().any(|x| x.is_nan()) { [0.0; 2] } else { velocity };
    let former = misfit(own);
    if former.is_nan() || former < 0.04 {
        return velocity;
    }
    let mut best = (former, own);
    // The column and row of a square of 4×4 pixels of the picture.
    let [height, width] = last.there.size.map(|side| side.div_ceil(4));
    let square = |[x, y]: [f32; 2]| {
        let [column, row] = [x, y].map(|at| ((at + 0.5) / 4.0).floor());
        let inside = (0.0..width as f32).contains(&column) && (0.0..height as f32).contains(&row);
        inside.then_some([column, row])
    };
    let compete = |best: &mut (f32, [f32; 2]), velocity: [f32; 2]| {
        let better = velocity.iter().all(|x| x.is_finite()) && misfit(velocity) < best.0;
        if better {
            *best = (misfit(velocity), velocity);
        }
        better
    };
    let directions: [[f32; 2]; 4] = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    let corners = [[6.0, 6.0], [6.0, -6.0], [-6.0, 6.0], [-6.0, -6.0]];
    for [dx, dy] in directions.map(|direction| direction.map(|x| 8.0 * x)).into_iter().chain(corners) {
        let place = square([x + dx, y + dy]);
        let there = all.iter().find(|(start, velocity)| {
            place.is_some() && square(*start) == place && velocity.iter().all(|x| x.is_finite())
        });
        if let Some((_, velocity)) = there {
            compete(&mut best, *velocity);
        }
    }
    compete(&mut best, [0.0; 2]);
    let mut length = 1.0_f32;
    for _ in 0..3 {
        let [u, v] = best.1;
        let tried = directions.iter().map(|[dx, dy]| [dx.mul_add(length, u), dy.mul_add(length, v)]);
        let better = tried.fold(false, |any, velocity| compete(&mut best, velocity) | any);
        length = if better { length } else { length * 0.5 };
    }
    if best.0 < 0.9 * former - 0.003 { best.1 } else { velocity }
}

#[test]
fn velocities_are_aligned_as_in_the_reference_to_the_bit() {
    for size @ [h, w] in [[1, 1], [1, 40], [9, 8], [61, 97]] {
        let frames: Vec<Vec<f32>> = (0..4)
            .map(|k| {
                let rough = noise(h * w, 40 + k);
                let smooth = picture(size, |x, y| texture(x - 2.0 * k as f32, y + k as f32));
                smooth.iter().zip(rough).map(|(a, b)| (a + 0.1 * b).clamp(0.0, 1.0)).collect()
            })
            .collect();
        let near = |seed: u32, u: f32, v: f32| Field {
            size,
            u: noise(h * w, seed).iter().map(|x| x + u).collect(),
            v: noise(h * w, seed + 1).iter().map(|x| x + v).collect(),
        };
        let fields: Vec<[Field; 2]> = (0..4).map(|k| [near(9 * k, 2.0, -1.0), near(9 * k + 5, -2.0, 1.0)]).collect();
        let distances = [0.25, 0.5, 0.75, 1.0];
        let steps: Vec<Step<'_>> =
            fields.iter().zip(distances).map(|([there, back], distance)| Step { there, back, distance }).collect();
        let extremes = [f32::NAN, f32::INFINITY, -0.0, -1e30, 1e30, -0.5, w as f32 - 0.5];
        let mut starts: Vec<[f32; 2]> = extremes.iter().flat_map(|&x| [[x, 0.0], [0.0, x]]).collect();
        let places = noise(2 * 3001, 77);
        starts.extend(places.as_chunks::<2>().0.iter().map(|[x, y]| [(x + 0.5) * w as f32, (y + 0.5) * h as f32]));
        for count in [4, 2, 1, 0] {
            let steps = &steps[..count];
            let to: Vec<&[f32]> = frames.iter().skip(1).take(count.saturating_sub(1)).map(Vec::as_slice).collect();
            let lumas = Lumas { from: &frames[0], to: &to };
            // Some are right, some are wrong, some are not known.
            let before = starts.iter().enumerate().map(|(i, start)| match i % 3 {
                0 => followed(*start, steps),
                1 => [(i % 17) as f32 - 8.0, (i % 13) as f32 - 6.0],
                _ => [f32::NAN; 2],
            });
            let before: Vec<[f32; 2]> = before.collect();
            let all: Vec<([f32; 2], [f32; 2])> = starts.iter().copied().zip(before.iter().copied()).collect();
            let expected: Vec<[f32; 2]> = all.iter().map(|&point| aligned(point, lumas, steps, &all)).collect();
            let found = on_every_level_and_thread_count(2 * starts.len(), |level, found| {
                let found = found.as_chunks_mut::<2>().0;
                found.copy_from_slice(&before);
                align(level, lumas, &starts, steps, found);
            });
            for (i, (found, expected)) in found.as_chunks::<2>().0.iter().zip(&expected).enumerate() {
                let same = |k: usize| {
                    found[k].to_bits() == expected[k].to_bits() || (found[k].is_nan() && expected[k].is_nan())
                };
                assert!(same(0) && same(1), "{h}×{w}, from {:?}: {found:?}, expected {expected:?}", starts[i]);
            }
            let changed = before.iter().zip(&expected).filter(|(a, b)| a[0].to_bits() != b[0].to_bits()).count();
            assert!((count > 1 && w > 1) == (changed > 0), "{changed} changed over {count} steps at {h}×{w}");
        }
    }
}

/// A square of 40 pixels passes over a still picture, and the flow moves a border of 5 pixels around it along with it.
#[test]
fn what_lies_behind_the_edge_of_a_body_stays_behind() {
    let (size, speed) = ([120, 160], 3.0);
    let inside = |x: f32, y: f32, margin: f32, k: f32| {
        (40.0 - margin..80.0 + margin).contains(&(x - speed * k)) && (40.0 - margin..80.0 + margin).contains(&y)
    };
    let frame = |k: f32| {
        picture(size, |x, y| match inside(x, y, 0.0, k) {
            true => 0.3 * texture(2.0 * (x - speed * k) + 300.0, 2.0 * y),
            false => 2.0 * texture(3.0 * x, 3.0 * y) - 0.5,
        })
    };
    let frames = [0.0, 1.0, 2.0, 3.0].map(frame);
    let flow = |k: f32, sign: f32| Field {
        size,
        u: picture(size, |x, y| if inside(x, y, 5.0, k) { sign * speed } else { 0.0 }),
        v: vec![0.0; size[0] * size[1]],
    };
    let fields = [0.0, 1.0, 2.0, 3.0].map(|k| [flow(k, 1.0), flow(k + 1.0, -1.0)]);
    let steps: Vec<Step<'_>> = fields
        .iter()
        .zip([0.25, 0.5, 0.75, 1.0])
        .map(|([there, back], distance)| Step { there, back, distance })
        .collect();
    let lumas = Lumas { from: &frames[0], to: &[&frames[1], &frames[2], &frames[3]] };
    // Above and to the left of the square, where it covers nothing later on; and in the square.
    let places = |rows: std::ops::Range<i32>, columns: std::ops::Range<i32>| -> Vec<[f32; 2]> {
        rows.flat_map(|y| columns.clone().map(move |x| [x as f32, y as f32])).collect()
    };
    let behind = [places(36..39, 36..80), places(40..80, 36..39)].concat();
    let body = places(42..78, 42..78);
    let level = crate::Level::detect();
    for (starts, own, expected) in [(&behind, 12.0, 0.0), (&body, 12.0, 12.0)] {
        let mut velocities = vec![[0.0; 2]; starts.len()];
        follow(level, starts, &steps, &mut velocities);
        assert!(velocities.iter().all(|v| *v == [own, 0.0]), "the flow moves them");
        align(level, lumas, starts, &steps, &mut velocities);
        let right = velocities.iter().filter(|v| (v[0] - expected).abs() < 0.5 && v[1].abs() < 0.5).count();
        assert!(right * 20 >= starts.len() * 19, "{right} of {}", starts.len());
    }
}
