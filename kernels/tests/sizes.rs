//! Passes sizes that no slice has to every public function that takes sizes and slices: products that wrap around to
//! the length of an existing slice, and sizes near the largest number. All of it is safe code, so every call must end
//! in a result or a panic. Where the true product is not the length, only a panic is correct.

#![forbid(unsafe_code)]

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use streamsplat_kernels::attention::{Rows, Shape, Windows, attend, attend_as, attend_some};
use streamsplat_kernels::change::{Tolerance, moved};
use streamsplat_kernels::exposure::Exposure;
use streamsplat_kernels::feed_forward::FeedForward;
use streamsplat_kernels::fill::fill;
use streamsplat_kernels::flow::{self, Blend, Field, Lumas, Options, Pyramid, Step, between};
use streamsplat_kernels::gemm::{Activation, Epilogue, Input, Precision, Weights, linear};
use streamsplat_kernels::harmonics::{Eye, Gradients, adjoint, colours, rest};
use streamsplat_kernels::memory::{Aligned, Scratch};
use streamsplat_kernels::norm::{Norm, layer_norm, rms_norm};
use streamsplat_kernels::parallel::{for_each_chunk, map_indexed};
use streamsplat_kernels::philox::Stream;
use streamsplat_kernels::raster::{
    ColourFit, ColourMap, Drawing, FitView, FootprintGradient, Gaussians, Image, Lists, MAX_SIDE, Preparation,
    Projection, Rasteriser, Request, WorldGradients, WorldRasteriser, WorldView, render,
};
use streamsplat_kernels::resize::{Filter, Grid, antialiased, bicubic_antialiased, bilinear, bilinear_antialiased};
use streamsplat_kernels::{Level, patches, pointwise, truncated_normal};

const PRECISIONS: [Precision; 3] = [Precision::F32, Precision::Bf16, Precision::Int8];

thread_local! {
    static EXPECTED: Cell<bool> = const { Cell::new(false) };
}

/// Returns true if `call` panics; the panic is not printed.
fn panics<R>(call: impl FnOnce() -> R) -> bool {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let print = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if !EXPECTED.get() {
                print(info);
            }
        }));
    });
    EXPECTED.set(true);
    let panicked = catch_unwind(AssertUnwindSafe(call)).is_err();
    EXPECTED.set(false);
    panicked
}

/// The product in 128 bits.
fn exact(factors: &[usize]) -> u128 {
    factors.iter().fold(1, |product: u128, &factor| product.saturating_mul(factor as u128))
}

/// The product by plain multiplication in release builds.
fn wrapped(factors: &[usize]) -> usize {
    factors.iter().fold(1, |product: usize, &factor| product.wrapping_mul(factor))
}

/// The longest slice allocated here.
const MOST: usize = 1 << 16;

/// Values of the wrapped length, or fewer where that is long.
fn values(sizes: &[usize]) -> Vec<f32> {
    vec![0.5; wrapped(sizes).min(MOST)]
}

/// The inverse of an odd number modulo 2⁶⁴, by Newton's iteration.
fn inverse(odd: usize) -> usize {
    (0..6).fold(odd, |x, _| x.wrapping_mul(2_usize.wrapping_sub(odd.wrapping_mul(x))))
}

/// Sizes around every power of two and near the ends.
fn any_size() -> impl Strategy<Value = usize> {
    prop_oneof![
        0..40_usize,
        (0..usize::BITS, -2..=2_isize).prop_map(|(bit, off)| (1_usize << bit).wrapping_add_signed(off)),
        (0..40_usize).prop_map(|below| usize::MAX - below),
        (0..40_usize).prop_map(|below| isize::MAX.unsigned_abs() - below),
    ]
}

/// `n` sizes whose product wraps around to at most 4096, which unchecked code takes for the length of a small slice.
fn wrapping_sizes(n: usize) -> impl Strategy<Value = Vec<usize>> {
    let by_powers =
        (proptest::collection::vec(0..64_u32, n), 0..n, 0..64_usize).prop_map(move |(bits, last, small)| {
            let mut sizes: Vec<usize> = bits.iter().map(|bit| 1 << bit).collect();
            let others: u32 = bits.iter().enumerate().filter(|(i, _)| *i != last).map(|(_, bit)| bit).sum();
            sizes[last] = (1_usize << 64_u32.saturating_sub(others).min(63)).wrapping_add(small % 2);
            sizes
        });
    let by_inverse =
        (proptest::collection::vec(any::<usize>(), n), 0..n, 0..4096_usize).prop_map(move |(sizes, last, small)| {
            let mut sizes: Vec<usize> = sizes.into_iter().map(|size| size | 1).collect();
            let others: Vec<usize> = sizes.iter().enumerate().filter(|(i, _)| *i != last).map(|(_, s)| *s).collect();
            sizes[last] = inverse(wrapped(&others)).wrapping_mul(small);
            sizes
        });
    let of_any = proptest::collection::vec(any_size(), n);
    prop_oneof![by_powers, by_inverse, of_any]
        .prop_filter("a slice of that length can be made", |sizes| wrapped(sizes) <= 4096)
        // Sizes that do not overflow are allocated, and memory may not suffice.
        .prop_filter("no size is only large", |sizes| {
            sizes.iter().all(|&size| !(1 << 16..1 << 61).contains(&size)) || exact(sizes) > usize::MAX as u128
        })
}

/// Returns true if the true product and every size are at most 4096: then the product is the slice's length.
fn is_small(sizes: &[usize]) -> bool {
    exact(sizes) <= 4096 && sizes.iter().all(|&size| size <= 4096)
}

/// Makes a call with these sizes and a slice of the wrapped length. It must succeed with small sizes, and panic where
/// the true product is not the length. With a 0 and a large one among the sizes it may do either.
fn check<R>(sizes: &[usize], call: impl FnOnce(&mut [f32]) -> R) {
    if wrapped(sizes) > MOST {
        return;
    }
    let mut values = vec![0.5; wrapped(sizes)];
    let panicked = panics(|| call(&mut values));
    if is_small(sizes) {
        assert!(!panicked, "{sizes:?} refused");
    } else if exact(sizes) != values.len() as u128 {
        assert!(panicked, "{sizes:?} taken for the sizes of {} values", values.len());
    }
}

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, rng_seed: RngSeed::Fixed(8), ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(config(256))]

    #[test]
    fn packed_weights_hold_n_times_k_values(sizes in wrapping_sizes(2)) {
        let [n, k] = sizes[..] else { unreachable!() };
        for precision in PRECISIONS {
            check(&sizes, |weight| Weights::pack_as(Level::detect(), precision, weight, n, k).bytes());
        }
        check(&sizes, |weight| pointwise::Layer::pack(weight, None, Activation::Identity, n, k).bytes());
    }

    #[test]
    fn products_read_and_write_m_rows(
        m in prop_oneof![0..8_usize, (58..64_u32, 0..8_usize).prop_map(|(bit, few)| 1 << bit | few), any_size()],
        bits in 0..7_u32,
        k_bits in 0..7_u32,
    ) {
        let (n, k) = (1_usize << bits, 1_usize << k_bits);
        for precision in PRECISIONS {
            let weights = Weights::pack_as(Level::detect(), precision, &vec![0.25; n * k], n, k);
            check(&[m, k], |x| {
                linear(Level::detect(), &*x, m, &weights, &Epilogue::new(), &mut values(&[m, n]));
            });
            let norm = vec![1.0; k];
            check(&[m, n], |out| {
                let x = values(&[m, k]);
                let epilogue = if n < 16 { Epilogue::new() } else { Epilogue::new().in_groups_of(n) };
                linear(Level::detect(), Input::Normed(&x, Norm::rms(&norm, 1e-5)), m, &weights, &epilogue, out);
            });
        }
    }

    #[test]
    fn rows_of_attention_are_a_whole_matrix(sizes in wrapping_sizes(2), first in any_size()) {
        let [rows, stride] = sizes[..] else { unreachable!() };
        check(&sizes, |values| Rows::new(values, rows, stride, first).rows());
        let values = values(&sizes);
        panics(|| Rows::of_heads(&values, rows, stride, first).rows());
    }

    #[test]
    fn attention_with_any_shape_is_computed_or_refused(
        sizes in wrapping_sizes(2),
        queries in wrapping_sizes(2),
        heads in any_size(),
        width in prop_oneof![Just(16), Just(48), (0..64_u32).prop_map(|bit| 1_usize << bit)],
        first in prop_oneof![Just(0_usize), any_size()],
        runs in proptest::option::of((any_size(), any_size())),
        grouped in any::<bool>(),
    ) {
        let windows = runs.map_or(Windows::Full, |(length, roll)| Windows::Runs { length, roll });
        let shape = Shape { heads, width, windows };
        let (keys, of_queries) = (values(&sizes), values(&queries));
        let mut out = values(&[queries[0], heads, width]);
        let rows = |values, sizes: &[usize]| {
            if grouped { Rows::of_heads(values, sizes[0], width, first) } else { Rows::new(values, sizes[0], sizes[1], first) }
        };
        for precision in PRECISIONS {
            panics(|| {
                let (q, k) = (rows(&of_queries, &queries), rows(&keys, &sizes));
                attend_as(precision, Level::detect(), shape, q, k, k, &mut out);
            });
            panics(|| {
                let (q, k) = (rows(&of_queries, &queries), rows(&keys, &sizes));
                let places = vec![0; q.rows().min(MOST)];
                attend_some(precision, Level::detect(), shape, &places, q, k, k, &mut out);
            });
        }
    }

    #[test]
    fn images_are_resized_between_the_shapes_they_have(sizes in wrapping_sizes(3), to in wrapping_sizes(2)) {
        let [channels, h, w] = sizes[..] else { unreachable!() };
        let level = Level::detect();
        let source = vec![0.5; 15];
        // Any source into an image that can be allocated, and such an image into any size.
        if h > 0 && w > 0 {
            check(&sizes, |source| bilinear(level, source, channels, h, w, 2, 3, &mut values(&[channels, 6])));
        }
        check(&[1, to[0], to[1]], |out| bilinear(level, &source, 1, 3, 5, to[0], to[1], out));
        check(&[1, to[0], to[1]], |out| bilinear_antialiased(level, &source, 1, 3, 5, to[0], to[1], out));
        check(&[1, to[0], to[1]], |out| bicubic_antialiased(level, &source, 3, 5, 1, to[0], to[1], out));
    }

    #[test]
    fn grids_are_resized_between_the_shapes_they_have(sizes in wrapping_sizes(4)) {
        let [outer, height, width, inner] = sizes[..] else { unreachable!() };
        let grid = Grid { outer, height, width, inner };
        for filter in [Filter::Triangle, Filter::Cubic] {
            let (source, mut out) = (values(&sizes), values(&[outer, 2, 3, inner]));
            let panicked = panics(|| antialiased(Level::detect(), filter, &source, grid, 2, 3, &mut out));
            prop_assert!(panicked || is_small(&sizes) || exact(&sizes) == 0, "{grid:?}");
        }
    }

    #[test]
    fn patches_are_cut_from_planes_that_are_there(sizes in wrapping_sizes(2), p in any_size()) {
        let [height, width] = sizes[..] else { unreachable!() };
        let plane = values(&sizes);
        for p in [1, p] {
            for count in 0..3 {
                let planes = vec![&plane[..]; count];
                let mut out = vec![0.0; count * plane.len()];
                let panicked = panics(|| patches::patches(&planes, height, width, p, &mut out));
                prop_assert!(panicked || exact(&sizes) == plane.len() as u128, "{sizes:?}");
                prop_assert!(!panicked || !is_small(&sizes) || p != 1, "{sizes:?}");
            }
        }
    }

    #[test]
    fn blocks_of_tokens_hold_48_values_a_channel(k in any_size(), rows in 0..200_usize) {
        let k = if k > MOST { k } else { k % 64 };
        let mut token = vec![0.5; if k < 64 { k } else { 0 }];
        check(&[k, pointwise::TOKENS], |to| pointwise::load(&token, k, to));
        check(&[k, pointwise::TOKENS], |from| pointwise::store(from, k, &mut token));
        let mut out = vec![0.0; rows];
        let panicked = panics(|| pointwise::for_each_block(&mut out, k, |_, _| {}));
        prop_assert_eq!(panicked, rows > 0 && !rows.is_multiple_of(k));
        check(&[k, pointwise::TOKENS], |x| {
            pointwise::Layer::pack(&[], None, Activation::Gelu, 0, k).apply(Level::detect(), x, &mut []);
        });
    }

    #[test]
    fn rows_that_may_have_changed_are_rows_that_are_there(d in any_size(), rows in 0..40_usize, at in any::<u32>()) {
        for tolerance in [Tolerance::Bits, Tolerance::Relative(0.1)] {
            let mut out = vec![false; rows];
            check(&[rows, d], |x| {
                let references = x.to_vec();
                moved(Level::detect(), tolerance, d, x, &references, None, &mut out);
            });
            let x = values(&[rows, d]);
            panics(|| moved(Level::detect(), tolerance, d, &x, &x, Some(&vec![at; rows]), &mut out));
        }
    }

    #[test]
    fn harmonics_of_any_degree_are_computed_or_refused(degree in any_size(), n in 0..40_usize) {
        let (base, mut out) = (vec![[0.5; 3]; n], vec![[0.0; 3]; n]);
        let higher = values(&[n, 3, rest(degree)]);
        let panicked = panics(|| {
            colours(Level::detect(), degree, &base, &higher, &base, Eye::At([0.0; 3]), &mut out);
        });
        prop_assert_eq!(panicked, degree > 3);
    }

    #[test]
    fn flow_takes_frames_of_its_sizes(sizes in wrapping_sizes(2)) {
        let (size, level, options) = ([sizes[0], sizes[1]], Level::detect(), Options::default());
        let mut made = false;
        let panicked = panics(|| made = Pyramid::new(level, &values(&sizes), size, &options).is_ok());
        prop_assert!(is_small(&sizes) || panicked || !made, "{size:?}");
        let field = |len: usize| Field { size, u: vec![0.5; len], v: vec![0.5; len] };
        let len = wrapped(&sizes);
        panics(|| field(len).at(1e9, -1e9));
        panics(|| Field::zero(size));
        let image = vec![0.5; 3 * len];
        let uses: [&dyn Fn(); 4] = [
            &|| drop(field(len).then(level, &field(len))),
            &|| drop(field(len).round_trip(level, &field(len))),
            &|| drop(flow::warp(level, &image, size, &field(len))),
            &|| drop(Blend::new(level, [&image, &image], [&field(len), &field(len)]).at(0.5)),
        ];
        for work in uses {
            let panicked = panics(work);
            prop_assert_eq!(panicked, !(is_small(&sizes) && len > 0), "{:?}", size);
        }
    }

    #[test]
    fn images_have_sides_of_at_most_2_to_the_16(width in any_size(), height in any_size()) {
        let side = |side: usize| if side > MAX_SIDE { side } else { side % 64 };
        let (width, height) = (side(width), side(height));
        let gaussians = Gaussians {
            mean: &[[0.0, 0.0, 1.0]],
            scale: &[[0.1; 3]],
            rotation: None,
            opacity: &[0.5],
            rgb: &[[0.5; 3]],
        };
        let projections = [
            Projection::Orthographic { focal: [8.0; 2] },
            Projection::Pinhole { focal: [8.0; 2], centre: [4.0; 2] },
        ];
        let allowed = width <= MAX_SIDE && height <= MAX_SIDE;
        for projection in &projections {
            let mut request = Request::colour(width, height, [0.0; 3]);
            (request.depth, request.alpha, request.statistics) = (true, true, true);
            let mut rasteriser = Rasteriser::new(Level::detect());
            prop_assert_eq!(panics(|| rasteriser.render(&gaussians, projection, &request).width), !allowed);
            prop_assert_eq!(panics(|| rasteriser.lists(&gaussians, projection, &request, &mut Lists::default())), !allowed);
            let mut map = ColourMap::with_budget(Level::detect(), width);
            prop_assert_eq!(panics(|| map.prepare(&gaussians, projection, [width, height])), !allowed);
            // Includes a map whose preparation panicked.
            let [w, h] = map.size();
            let (mut image, mut sums) = (vec![0.0; 3 * w * h], vec![[0.0; 3]; map.gaussians()]);
            let colours = vec![[0.5; 3]; map.gaussians()];
            prop_assert!(!panics(|| map.forward(&colours, [0.0; 3], &mut image)));
            prop_assert!(!panics(|| map.adjoint(&image, &mut sums)));
            prop_assert!(!panics(|| map.normal(&colours, &mut sums)));
            image.push(0.0);
            prop_assert!(panics(|| map.forward(&colours, [0.0; 3], &mut image)));
            prop_assert!(panics(|| map.adjoint(&image, &mut sums)));
            prop_assert!(panics(|| map.residual_adjoint(&colours, [0.0; 3], &image, &mut sums)));
        }
    }

    #[test]
    fn exposures_take_images_of_their_size(width in any_size(), height in any_size(), transparent: bool) {
        let mut exposure = Exposure::new(Level::detect(), transparent);
        let image = Image { width, height, rgb: vec![0.5; 12], alpha: Some(vec![1.0; 4]), ..Image::default() };
        let fits = width.checked_mul(height) == Some(4);
        prop_assert_eq!(panics(|| exposure.add(&image)), !fits);
        prop_assert_eq!(exposure.mean().rgb.len(), if fits { 12 } else { 0 });
    }

    #[test]
    fn memory_holds_what_was_asked_for_or_nothing(len in any_size()) {
        // Lengths whose bytes overflow, and short ones: lengths between would be allocated.
        let len = if len >= 1 << 60 { len } else { len % 4096 };
        prop_assert_eq!(panics(|| assert_eq!(Aligned::<u32>::zeroed(len).len(), len)), len >= 1 << 60);
        prop_assert_eq!(panics(|| assert_eq!(Scratch::take(len).len(), len)), len >= 1 << 60);
        let mut memory = Aligned::<[u64; 2]>::zeroed(3);
        prop_assert_eq!(panics(|| memory.resize(len)), len >= 1 << 60);
        prop_assert_eq!(memory.len(), if len >= 1 << 60 { 3 } else { len });
    }

    #[test]
    fn loops_with_any_step_reach_every_element_once(step in any_size(), first in any::<u64>()) {
        let mut data = vec![0_u8; 100];
        for_each_chunk(&mut data, step, |_, chunk| chunk.iter_mut().for_each(|x| *x += 1));
        prop_assert!(data.iter().all(|&x| x == 1));
        prop_assert_eq!(map_indexed(step % 100, |i| i).len(), step % 100);
        Stream { seed: first, frame: first }.fill_uniform(first, &mut [0.0; 40]);
    }

    #[test]
    fn lengths_that_differ_are_refused(lengths in proptest::array::uniform4(0..40_usize), d in 0..40_usize) {
        let values = lengths.map(|len| vec![0.5; len]);
        let [a, b, c, e] = &values;
        let mut out = e.clone();
        let equal = |some: &[&Vec<f32>]| some.iter().all(|x| x.len() == e.len());
        prop_assert_eq!(panics(|| truncated_normal::mean(Level::detect(), a, &mut out)), !equal(&[a]));
        prop_assert_eq!(panics(|| truncated_normal::sample(a, b, c, &mut out)), !equal(&[a, b, c]));
        let stream = Stream { seed: 1, frame: 2 };
        prop_assert_eq!(panics(|| truncated_normal::draw(stream, a, b, &mut out)), !equal(&[a, b]));
        let fits = equal(&[a]) && (a.is_empty() || !b.is_empty() && a.len().is_multiple_of(b.len()));
        prop_assert_eq!(panics(|| rms_norm(Level::detect(), a, b, 1e-5, &mut out)), !fits);
        let fits = fits && b.len() == c.len();
        prop_assert_eq!(panics(|| layer_norm(Level::detect(), a, b, c, 1e-5, &mut out)), !fits);
        // A feed-forward layer whose parts have unequal widths.
        let weights = |n: usize, k: usize| Weights::pack(Level::detect(), &vec![0.1; n * k], n, k);
        let (expand, contract) = (weights(32, a.len()), weights(b.len(), d));
        let layer = FeedForward {
            norm: Norm::rms(c, 1e-5),
            expand: &expand,
            hidden: Epilogue::new().gelu(),
            contract: &contract,
            residual: Epilogue::new().residual(),
        };
        let whole = e.is_empty() || !c.is_empty() && e.len().is_multiple_of(c.len());
        let fits = b.len() == c.len() && (c.is_empty() || whole && (e.is_empty() || a.len() == c.len() && d == 32));
        let panicked = panics(|| layer.accumulate(Level::detect(), &mut out));
        prop_assert!(panicked || fits, "{lengths:?} {d}");
    }
}

/// One Gaussian.
const ONE: Gaussians<'_> =
    Gaussians { mean: &[[0.0, 0.0, 1.0]], scale: &[[0.1; 3]], rotation: None, opacity: &[0.5], rgb: &[[0.5; 3]] };
const FLAT: Projection = Projection::Orthographic { focal: [8.0; 2] };

/// A pyramid of this size.
fn pyramid(size: [usize; 2]) -> Pyramid {
    Pyramid::new(Level::detect(), &vec![0.5; size[0] * size[1]], size, &Options::default()).expect("a small frame")
}

/// A call whose result is ignored.
fn without_result<R>(call: impl FnOnce() -> R + 'static) -> Box<dyn FnOnce()> {
    Box::new(move || {
        call();
    })
}

/// Every public function that takes sizes, directly or in a structure, with sizes for which no memory exists: the
/// number of values of 2³² rows of 2³² wraps around to 0 in 64 bits. `engine/cli/tests/program/trust.rs` compares the
/// names with `docs/api/kernels.txt`.
fn wrapping_calls() -> Vec<(&'static str, Box<dyn FnOnce()>)> {
    const HALF: usize = 1 << 32;
    let level = Level::detect();
    let field = |size: [usize; 2]| Field { size, u: vec![0.5; wrapped(&size)], v: vec![0.5; wrapped(&size)] };
    let weights = move || Weights::pack(level, &[0.5; 256], 16, 16);
    let wide = Shape { heads: 1 << 60, width: 16, windows: Windows::Full };
    let row = &[0.5; 16];
    let rows = move || Rows::new(row, 1, 16, 0);
    let request = |width, height| Request::colour(width, height, [0.0; 3]);
    let map = move |size: [usize; 2]| {
        let mut map = ColourMap::new(level);
        map.prepare(&ONE, &FLAT, size);
        map
    };
    let world = |size: [usize; 2]| WorldView::pinhole([[1.0, 0.0, 0.0, 0.0]; 3], [8.0; 2], [4.0; 2], size);
    let drawn = move || {
        let mut rasteriser = WorldRasteriser::new(level);
        rasteriser.project(&ONE, &world([8; 2]));
        rasteriser
    };
    // 64 pixels of 2⁶⁰ channels are 2⁶⁶ values.
    let drawing = Drawing { channels: 1 << 60, colours: &[], background: &[] };
    let image =
        |width, height| Image { width, height, rgb: vec![0.5; 12], alpha: Some(vec![1.0; 4]), ..Image::default() };
    let mut calls: Vec<(&'static str, Box<dyn FnOnce()>)> = Vec::new();
    macro_rules! call {
        ($($name:literal: $work:expr;)*) => { $(calls.push(($name, without_result(move || $work)));)* };
    }
    call! {
        "attention::Rows::new": Rows::new(&[], HALF, HALF, 0).rows();
        "attention::Rows::of_heads": {
            let none = Rows::of_heads(&[], HALF, HALF, 0);
            let shape = Shape { heads: HALF, width: HALF, windows: Windows::Full };
            attend_as(Precision::F32, level, shape, none, none, none, &mut []);
        };
        "attention::attend": attend(level, wide, rows(), rows(), rows(), &mut []);
        "attention::attend_as": attend_as(Precision::Bf16, level, wide, rows(), rows(), rows(), &mut []);
        "attention::attend_some": attend_some(Precision::Int8, level, wide, &[0], rows(), rows(), rows(), &mut []);
        "change::moved": moved(level, Tolerance::Bits, HALF, &[], &[], None, &mut [false; 4]);
        "exposure::Exposure::add": Exposure::new(level, false).add(&image(HALF, HALF));
        "fill::fill": fill(&mut image(HALF, HALF), [0.5; 3]);
        "flow::Blend::new": Blend::new(level, [&[], &[]], [&field([HALF; 2]), &field([HALF; 2])]).at(0.5);
        "flow::Field::round_trip": field([HALF; 2]).round_trip(level, &field([HALF; 2]));
        "flow::Field::then": field([HALF; 2]).then(level, &field([HALF; 2]));
        "flow::Field::zero": Field::zero([HALF; 2]);
        "flow::Field::at": Field { size: [4, 4], u: vec![0.5; 2], v: vec![0.5; 2] }.at(3.0, 3.0);
        "flow::Pyramid::new": pyramid([HALF; 2]);
        "flow::align": {
            let (there, back) = (field([8, 8]), field([8, 8]));
            let steps = [Step { there: &there, back: &back, distance: 1.0 }; 2];
            flow::align(level, Lumas { from: &[0.5; 64], to: &[&[0.5; 63]] }, &[[7.0; 2]], &steps, &mut [[0.0; 2]]);
        };
        "flow::between": {
            let size = [HALF; 2];
            between(level, &pyramid([8, 8]), &pyramid([8, 8]), Some(&field(size)), &Options::default())
        };
        "flow::both": flow::both(level, &pyramid([8, 8]), &pyramid([8, 4]), [None; 2], &Options::default());
        "flow::follow": {
            let (there, back) = (field([HALF; 2]), field([HALF; 2]));
            let steps = [Step { there: &there, back: &back, distance: 1.0 }];
            flow::follow(level, &[[0.0; 2]], &steps, &mut [[0.0; 2]]);
        };
        "flow::trace": {
            let (there, back) = (field([8, 8]), field([8, 4]));
            let steps = [Step { there: &there, back: &back, distance: 1.0 }];
            flow::trace(level, &[[0.0; 2]], &steps, &mut [[0.0; 2]]);
        };
        "flow::sample_one": flow::sample_one(&[], [HALF; 2], 1e9, 1e9);
        "flow::warp": flow::warp(level, &[], [HALF; 2], &field([HALF; 2]));
        "gemm::Epilogue::in_groups_of": {
            let epilogue = Epilogue::new().in_groups_of(HALF);
            linear(level, row, 1, &weights(), &epilogue, &mut [0.0; 16]);
        };
        "gemm::Epilogue::shuffled": {
            let epilogue = Epilogue::new().shuffled(HALF);
            linear(level, row, 1, &weights(), &epilogue, &mut [0.0; 16]);
        };
        "gemm::Weights::pack": Weights::pack(level, &[], 1 << 60, 16);
        "gemm::Weights::pack_as": Weights::pack_as(level, Precision::Int8, &[], HALF, HALF);
        "gemm::linear": linear(level, &[], 1 << 60, &weights(), &Epilogue::new(), &mut []);
        "harmonics::colours": colours(level, HALF, &[[0.5; 3]], &[], &[[0.5; 3]], Eye::At([0.0; 3]), &mut [[0.0; 3]]);
        "harmonics::adjoint": {
            let to = Gradients { base: &mut [[0.0; 3]], higher: &mut [], mean: &mut [[0.0; 3]] };
            adjoint(level, HALF, &[], &[[0.5; 3]], Eye::At([0.0; 3]), &[[0.5; 3]], &[[0.5; 3]], to);
        };
        "memory::Aligned::resize": Aligned::<u64>::zeroed(1).resize(1 << 61);
        "memory::Aligned::zeroed": Aligned::<u64>::zeroed(1 << 61);
        "memory::Scratch::take": Scratch::take(1 << 62);
        "patches::patches": patches::patches(&[&[]], HALF, HALF, 1, &mut []);
        "pointwise::Layer::pack": pointwise::Layer::pack(&[], Some(&[]), Activation::Identity, 0, usize::MAX);
        "pointwise::for_each_block": pointwise::for_each_block(&mut [0.0; 4], HALF, |_, _| {});
        "pointwise::load": pointwise::load(&[0.5; 4], 1 << 60, &mut []);
        "pointwise::store": pointwise::store(&[], 1 << 60, &mut [0.5; 4]);
        "raster::ColourFit::new": {
            let (map, unknowns) = (map([8, 8]), [1_u32 << 31]);
            let view = FitView { map: &map, unknown: &unknowns, factor: &[] };
            drop(ColourFit::new(level, vec![view], 1 << 31, 1.0));
        };
        "raster::ColourMap::prepare": map([HALF; 2]);
        "raster::ColourMap::prepare_in": {
            ColourMap::new(level).prepare_in(&mut Preparation::new(level), &ONE, &FLAT, [HALF; 2], |_| true);
        };
        "raster::ColourMap::prepare_blocks": ColourMap::new(level).prepare_blocks(&ONE, &FLAT, [HALF; 2], |_| true);
        "raster::ColourMap::forward": map([8, 8]).forward(&[[0.5; 3]], [0.0; 3], &mut [0.0; 12]);
        "raster::ColourMap::adjoint": map([8, 8]).adjoint(&[0.5; 192], &mut []);
        "raster::ColourMap::normal": map([8, 8]).normal(&[], &mut [[0.0; 3]]);
        "raster::ColourMap::row_sums": map([8, 8]).row_sums(&mut []);
        "raster::ColourMap::column_sums": map([8, 8]).column_sums(&mut []);
        "raster::ColourMap::residual_adjoint": {
            map([8, 8]).residual_adjoint(&[[0.5; 3]], [0.0; 3], &[0.5; 12], &mut [[0.0; 3]])
        };
        "raster::ColourMap::residual_adjoint_tiles": {
            map([8, 8]).residual_adjoint_tiles(&[[0.5; 3]], [0.0; 3], &[0.5; 192], &mut [[0.0; 3]], &mut [])
        };
        "raster::WorldRasteriser::project": {
            WorldRasteriser::new(level).project(&ONE, &world([HALF; 2]));
        };
        "raster::WorldRasteriser::draw": drawn().draw(&drawing, &mut [], &mut [0.0; 64]);
        "raster::WorldRasteriser::draw_adjoint": {
            let mut to = [FootprintGradient::default()];
            drawn().draw_adjoint(&drawing, [&[], &[0.0; 64]], [&[], &[0.0; 64]], &mut to, &mut [], &mut []);
        };
        "raster::WorldRasteriser::project_adjoint": {
            let (mean, rotation, scale, opacity): (&mut [_], &mut [_], &mut [_], &mut [_]) = (&mut [], &mut [], &mut [], &mut []);
            let to = WorldGradients { mean, rotation, scale, opacity };
            drawn().project_adjoint(&ONE, &[FootprintGradient::default()], None, to);
        };
        "raster::WorldView::pinhole": {
            let matrix = [[1.0, 0.0, 0.0, 0.0]; 3];
            let view = WorldView::pinhole(matrix, [8.0; 2], [4.0; 2], [HALF, HALF]);
            WorldRasteriser::new(level).project(&ONE, &view);
        };
        "raster::Rasteriser::lists": {
            Rasteriser::new(level).lists(&ONE, &FLAT, &request(HALF, HALF), &mut Lists::default());
        };
        "raster::Rasteriser::render": Rasteriser::new(level).render(&ONE, &FLAT, &request(HALF, HALF)).width;
        "raster::render": render(level, &ONE, &FLAT, &request(HALF, HALF));
        "resize::antialiased": {
            let grid = Grid { outer: 1, height: HALF, width: HALF, inner: 1 };
            antialiased(level, Filter::Triangle, &[], grid, 2, 2, &mut [0.0; 4]);
        };
        "resize::bicubic_antialiased": bicubic_antialiased(level, &[0.0; 4], 2, 2, 1, HALF, HALF, &mut []);
        "resize::bilinear": bilinear(level, &[0.0; 4], 1, 2, 2, HALF, HALF, &mut []);
        "resize::bilinear_antialiased": bilinear_antialiased(level, &[0.0; 4], 1, 2, 2, HALF, HALF, &mut []);
    }
    calls
}

#[test]
fn sizes_whose_products_wrap_to_zero_are_refused() {
    for (name, call) in wrapping_calls() {
        assert!(panics(call), "{name} took sizes of which there is nothing");
    }
}

#[test]
fn fields_with_a_side_that_floats_cannot_count_are_refused() {
    // The last column of such a row is not a binary32 number: rounded, it is behind the row.
    let (w, level) = ((1 << 24) + 4, Level::detect());
    let field = Field { size: [1, w], u: vec![1e9; w], v: vec![0.0; w] };
    assert!(panics(|| field.round_trip(level, &field)));
}
