//! Every operation on every level against plain Rust, bit for bit, over difficult values.

use super::{LANES, Operation, Simd, dispatch, fused_mul_add};
use crate::level::Level;
use crate::testing::levels;

/// Ordinary values, and zeros, denormals, powers of two, ties, infinities, values near the limits.
fn values() -> Vec<f32> {
    let mut v = vec![
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        -0.5,
        1.5,
        2.5,
        -2.5,
        0.49999997,
        8_388_607.5,
        8_388_609.0,
        -8_388_607.5,
        1e-45,
        -1e-45,
        1.1754942e-38,
        f32::MIN_POSITIVE,
        f32::MAX,
        f32::MIN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::EPSILON,
        1.0 + f32::EPSILON,
        3.0e-20,
        -7.1e19,
        1e30,
    ];
    let mut state = 1_u32;
    while v.len() < 40 * LANES {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let x = f32::from_bits(state);
        v.push(if x.is_nan() { (state >> 8) as f32 * 1e-3 } else { x });
    }
    v
}

/// The bits of a value, with one pattern for all NaN.
fn bits(x: f32) -> u32 {
    if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() }
}

/// Results of all operations as bits.
struct AllOperations<'a>(&'a [f32], &'a [f32], &'a [f32]);

impl Operation for AllOperations<'_> {
    type Output = Vec<u32>;
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Vec<u32> {
        let mut out = Vec::new();
        let mut f = |v: S::F32| out.extend(s.to_array(v).map(bits));
        let (a, b, c) = (s.load(self.0), s.load(self.1), s.load(self.2));
        f(s.add(a, b));
        f(s.sub(a, b));
        f(s.mul(a, b));
        f(s.div(a, b));
        f(s.mul_add(a, b, c));
        f(s.neg_mul_add(a, b, c));
        f(s.min(a, b));
        f(s.max(a, b));
        f(s.sqrt(a));
        f(s.abs(a));
        f(s.neg(a));
        f(s.round(a));
        f(s.floor(a));
        f(s.select(s.lt(a, b), c, a));
        f(s.select(s.le(a, b), c, a));
        f(s.select(s.eq(a, b), c, a));
        f(s.select(s.not(s.or(s.lt(a, b), s.and(s.lt(b, c), s.lt(a, c)))), c, a));
        f(s.select(s.mask_from_bits(0x9a53), c, a));
        f(s.keep(s.lt(a, b), c));
        let four = self.0[4..].first_chunk().expect("sixteen values");
        f(s.repeat_four(four));
        f(s.spread_four(four));
        // SAFETY: slices of sixteen values.
        unsafe {
            f(s.load_halves(self.0[3..].as_ptr(), self.1[5..].as_ptr()));
        }
        f(s.splat(s.sum(a)));
        f(s.splat(s.max_lane(a)));
        let small = s.max(s.min(a, s.splat(2e9)), s.splat(-2e9));
        let (i, j) = (s.to_i32(small), s.to_bits(b));
        f(s.to_f32(j));
        let mut g = |v: S::I32| out.extend(s.to_array_i32(v).map(i32::cast_unsigned));
        g(i);
        g(s.add_i32(i, j));
        g(s.sub_i32(i, j));
        g(s.and_i32(i, j));
        g(s.or_i32(i, j));
        g(s.xor_i32(i, j));
        g(s.shl::<7>(j));
        g(s.shr::<7>(j));
        g(s.sar::<7>(j));
        g(s.select_i32(s.gt_i32(i, j), i, j));
        g(s.select_i32(s.eq_i32(i, j), i, j));
        let larger = s.max_i32(i, j);
        assert_eq!(s.to_array_i32(larger), s.to_array_i32(s.select_i32(s.gt_i32(i, j), i, j)));
        g(larger);
        out.push(u32::from(s.bits(s.lt(a, b))));
        out.push(u32::from(s.any(s.lt(a, b))));
        out.push(u32::from(s.all(s.lt(a, b))));
        out.push(u32::from(s.bits(s.mask_from_bits(0x1234))));
        out
    }
}

/// Plain Rust for the float operations that have a name there, in the order of [`AllOperations`].
fn plain(a: &[f32], b: &[f32], c: &[f32]) -> Vec<u32> {
    let mut out = Vec::new();
    let mut f = |g: &dyn Fn(f32, f32, f32) -> f32| out.extend((0..LANES).map(|i| bits(g(a[i], b[i], c[i]))));
    f(&|a, b, _| a + b);
    f(&|a, b, _| a - b);
    f(&|a, b, _| a * b);
    f(&|a, b, _| a / b);
    f(&|a, b, c| a.mul_add(b, c));
    f(&|a, b, c| (-a).mul_add(b, c));
    f(&|a, b, _| if a < b { a } else { b });
    f(&|a, b, _| if a > b { a } else { b });
    f(&|a, _, _| a.sqrt());
    f(&|a, _, _| a.abs());
    f(&|a, _, _| -a);
    f(&|a, _, _| a.round_ties_even());
    f(&|a, _, _| a.floor());
    f(&|a, b, c| if a < b { c } else { a });
    f(&|a, b, c| if a <= b { c } else { a });
    f(&|a, b, c| if a == b { c } else { a });
    f(&|a, b, c| if a < b || b < c && a < c { a } else { c });
    out.extend((0..LANES).map(|i| bits(if 0x9a53 >> i & 1 != 0 { c[i] } else { a[i] })));
    out.extend((0..LANES).map(|i| bits(if a[i] < b[i] { c[i] } else { 0.0 })));
    out.extend((0..LANES).map(|i| bits(a[4 + i % 4])));
    out.extend((0..LANES).map(|i| bits(a[4 + i / 4])));
    out
}

#[test]
fn every_level_agrees_with_plain_rust_and_with_the_scalar_level() {
    let v = values();
    for shift in [1, 17, 333] {
        for start in (0..v.len() - LANES).step_by(5) {
            let at =
                |k: usize| -> Vec<f32> { (0..LANES).map(|i| v[(start + k * shift + i * (k + 1)) % v.len()]).collect() };
            let (a, b, c) = (at(0), at(1), at(2));
            let expected = dispatch(Level::scalar(), AllOperations(&a, &b, &c));
            let reference = plain(&a, &b, &c);
            assert_eq!(expected[..reference.len()], reference, "{a:?} {b:?} {c:?}");
            for level in levels() {
                assert_eq!(dispatch(level, AllOperations(&a, &b, &c)), expected, "{level} {a:?} {b:?} {c:?}");
            }
        }
    }
}

#[test]
fn partial_loads_fill_and_partial_stores_stop() {
    struct Partial<'a>(&'a [f32], &'a mut [f32]);
    impl Operation for Partial<'_> {
        type Output = [f32; LANES];
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> [f32; LANES] {
            let v = s.load_partial(self.0, -3.0);
            s.store_partial(v, self.1);
            s.to_array(v)
        }
    }
    let from: Vec<f32> = (0..20).map(|i| i as f32).collect();
    for level in levels() {
        for len in 0..=20 {
            let mut to = vec![9.0; len];
            let all = dispatch(level, Partial(&from[..len], &mut to));
            for i in 0..LANES {
                assert_eq!(all[i], if i < len { i as f32 } else { -3.0 });
            }
            for (i, x) in to.iter().enumerate() {
                assert_eq!(*x, if i < LANES { i as f32 } else { 9.0 });
            }
        }
    }
}

#[test]
fn four_values_of_each_place_reach_their_lanes_on_every_level() {
    struct Fours<'a>(&'a [f32], &'a [u32; LANES]);
    impl Operation for Fours<'_> {
        type Output = [[f32; LANES]; 4];
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> Self::Output {
            assert!(self.1.iter().all(|place| *place as usize + 4 <= self.0.len()));
            // SAFETY: just checked.
            unsafe { s.gather_fours(self.0.as_ptr(), self.1) }.map(|lanes| s.to_array(lanes))
        }
    }
    let from: Vec<f32> = (0..100).map(|i| i as f32).collect();
    // Any order, twice the same, and the last four.
    let places = [0, 96, 5, 5, 41, 7, 90, 13, 2, 77, 50, 51, 52, 53, 1, 96];
    for level in levels() {
        let expected: [[f32; LANES]; 4] = std::array::from_fn(|k| places.map(|place| (place as usize + k) as f32));
        assert_eq!(dispatch(level, Fours(&from, &places)), expected, "{}", level.name());
    }
}

#[test]
fn bytes_are_stored_and_read_back_on_every_level() {
    struct Both<'a>(&'a [u8; 16]);
    impl Operation for Both<'_> {
        type Output = ([f32; 16], [[u8; 16]; 2]);
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> Self::Output {
            let numbers = s.load_u8(self.0);
            let with_more = s.from_array_i32(std::array::from_fn(|i| MORE[i] | i32::from(self.0[i])));
            (s.to_array(numbers), [s.low_bytes(s.to_i32(numbers)), s.low_bytes(with_more)])
        }
    }
    const MORE: [i32; 16] = [
        0,
        0x100,
        0x7f00,
        0x8000,
        0xff00,
        0x1_0000,
        0x7fff_ff00,
        i32::MIN,
        -0x100,
        -0x200,
        0x1234_5600,
        0x80_0000,
        0,
        0,
        -0x8000,
        0x100,
    ];
    let bytes = [0, 1, 2, 255, 254, 127, 128, 129, 200, 64, 3, 50, 40, 130, 7, 9];
    for level in levels() {
        let (numbers, stored) = dispatch(level, Both(&bytes));
        assert_eq!(numbers, bytes.map(f32::from), "{}", level.name());
        assert_eq!(stored, [bytes; 2], "{}", level.name());
    }
}

#[test]
fn the_software_fused_multiply_add_rounds_once() {
    // A product whose low half decides a tie, a result that is denormal, and one that cancels to the product's error.
    let cases = [
        (1.0 + f32::EPSILON, 1.0 + f32::EPSILON, -1.0),
        (1.0 + f32::EPSILON, 1.0 - f32::EPSILON, -1.0),
        (1e-20, 1e-20, 1e-40),
        (1e-30, 1e-30, f32::MIN_POSITIVE),
        (f32::MAX, 2.0, f32::NEG_INFINITY),
        (f32::MAX, 1.0, f32::MAX),
        (-1e-45, 0.5, 0.0),
        (0.0, f32::INFINITY, 1.0),
    ];
    for (a, b, c) in cases {
        assert_eq!(bits(fused_mul_add(a, b, c)), bits(a.mul_add(b, c)), "{a} {b} {c}");
    }
    let v = values();
    for (i, &a) in v.iter().enumerate() {
        for (j, &b) in v.iter().enumerate() {
            let c = v[(i * 31 + j * 7) % v.len()];
            // Addends near the product make the rounding hard.
            for c in [c, -(a * b), a * b * 5.9604645e-8] {
                assert_eq!(bits(fused_mul_add(a, b, c)), bits(a.mul_add(b, c)), "{a:e} {b:e} {c:e}");
            }
        }
    }
}

/// `[whole and part of t, joined again, part, p·2^whole(t) for normal results, for any]`
struct Powers([f32; LANES], [f32; LANES]);

impl Operation for Powers {
    type Output = [[f32; LANES]; 3];
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Self::Output {
        let (whole, part) = s.split_int_frac(s.from_array(self.0));
        let p = s.from_array(self.1);
        [part, s.scale_by_pow2(p, whole), s.scale_by_any_pow2(p, whole)].map(|v| s.to_array(v))
    }
}

#[test]
fn powers_of_two_are_split_off_and_multiplied_back_on_every_level() {
    let exact = |p: f32, n: f64| (f64::from(p) * n.exp2()) as f32;
    for level in levels() {
        for i in 0..40_000 {
            // Both signs, ties, whole numbers; results from the largest to the denormal numbers and zero.
            let t: [f32; LANES] = std::array::from_fn(|j| ((i * 16 + j) as f32 - 320_000.0) / 1280.0);
            let p: [f32; LANES] = std::array::from_fn(|j| [1.0, -1.37, 0.71, 1.999_999_9][(i / 7 + j) % 4]);
            let [part, normal, any] = dispatch(level, Powers(t, p));
            for j in 0..LANES {
                let n = f64::from(t[j]).round_ties_even();
                assert_eq!(part[j], t[j] - n as f32, "{level}: part of {}", t[j]);
                assert_eq!(any[j].to_bits(), exact(p[j], n).to_bits(), "{level}: {} · 2^{n}", p[j]);
                if n.abs() <= 125.0 {
                    assert_eq!(normal[j].to_bits(), any[j].to_bits(), "{level}: {} · 2^{n}", p[j]);
                }
            }
        }
        let [_, _, any] = dispatch(level, Powers([-1.0; LANES], [f32::NAN; LANES]));
        assert!(any.iter().all(|x| x.is_nan()), "{level}");
    }
}
