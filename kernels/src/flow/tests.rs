//! Known motion, extremes, and bits across levels and threads.

use proptest::prelude::*;

use super::*;
use crate::testing::{noise, on_every_level_and_thread_count};

/// Sizes that are no multiple of anything, one pixel wide or high, smaller than a patch, and large enough for several scales and tasks.
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
                let blended = blend(level, &a, &b, size, &forward, &backward, 0.3);
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
    assert_eq!(blend(Level::detect(), &a, &b, size, &f, &g, 0.0), a);
    assert_eq!(blend(Level::detect(), &a, &b, size, &f, &g, 1.0), b);
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
        for level in Level::available() {
            prop_assert_eq!(&pair(level, &a, &b, [h, w], &options), &expected);
        }
    }
}
