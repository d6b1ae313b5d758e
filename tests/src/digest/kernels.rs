//! The kernels at sizes that are not multiples of any block.

use streamsplat_kernels::attention::{Rows, Shape, Windows, attend_as};
use streamsplat_kernels::flow::{Field, Options, Pyramid};
use streamsplat_kernels::gemm::{Activation, Epilogue, Precision, Weights, linear};
use streamsplat_kernels::math::{self, f64 as double};
use streamsplat_kernels::philox::Stream;
use streamsplat_kernels::pointwise::{Layer, TOKENS};
use streamsplat_kernels::simd::{LANES, Operation, Simd, dispatch};
use streamsplat_kernels::{Level, flow, harmonics, norm, patches, resize, truncated_normal};

use super::{Digest, Thing};
use crate::noise::noise;

/// Distance of the values' bit patterns: 65,537 values cover every binade, denormals, infinities and NaN included.
const STRIDE: u32 = 65_521;

/// Values from the whole number line.
fn everywhere() -> impl Iterator<Item = f32> {
    (0..u32::MAX / STRIDE).map(|i| f32::from_bits(i * STRIDE))
}

macro_rules! vector_functions {
    ($($name:ident)*) => {
        vec![$(Thing::new(concat!("math/", stringify!($name)), |level, digest| {
            struct Sweep<'a>(&'a mut [f32]);
            impl Operation for Sweep<'_> {
                type Output = ();
                #[inline(always)]
                fn run<S: Simd>(self, s: S) {
                    for x in self.0.chunks_mut(LANES) {
                        s.store_partial(math::$name(s, s.load_partial(x, 0.0)), x);
                    }
                }
            }
            let mut values: Vec<f32> = everywhere().collect();
            dispatch(level, Sweep(&mut values));
            digest.floats(&values);
        })),*]
    };
}

pub(super) fn things() -> Vec<Thing> {
    let mut things =
        vector_functions!(exp exp_nonpositive log softplus sigmoid silu tanh erf erfc erfinv gelu normal_cdf);
    things.extend([
        Thing::new("math/sin_cos", |level, digest| {
            struct Sweep<'a>(&'a mut [f32]);
            impl Operation for Sweep<'_> {
                type Output = ();
                #[inline(always)]
                fn run<S: Simd>(self, s: S) {
                    for x in self.0.chunks_mut(LANES) {
                        let (sin, cos) = math::sin_cos(s, s.load_partial(x, 0.0));
                        s.store_partial(s.sub(sin, s.mul(cos, s.splat(0.75))), x);
                    }
                }
            }
            let mut values: Vec<f32> = everywhere().collect();
            dispatch(level, Sweep(&mut values));
            digest.floats(&values);
        }),
        Thing::new("math/f64", |_, digest| {
            let functions =
                [double::erf, double::erfc, double::exp, double::expm1, double::ln, double::ln_1p, double::sin];
            for function in functions {
                let values: Vec<f64> = (-3000..3000).map(|i| function(f64::from(i) * 0.017)).collect();
                digest.doubles(&values);
            }
            let inverses: Vec<f64> = (-999..1000).map(|i| double::erfinv(f64::from(i) * 1e-3)).collect();
            digest.doubles(&inverses);
        }),
        Thing::new("resize", |level, digest| {
            let (h, w) = (29, 45);
            let source = noise(3 * h * w, 16);
            for (rows, columns) in [(18, 32), (41, 67), (1, 1)] {
                let mut out = vec![0.0; 3 * rows * columns];
                resize::bilinear(level, &source, 3, h, w, rows, columns, &mut out);
                digest.floats(&out);
                resize::bilinear_antialiased(level, &source, 3, h, w, rows, columns, &mut out);
                digest.floats(&out);
                resize::bicubic_antialiased(level, &source, h, w, 3, rows, columns, &mut out);
                digest.floats(&out);
            }
        }),
        Thing::new("flow", |level, digest| {
            // A texture of blurred noise, and the same moved; both use only sums and products.
            let size @ [h, w] = [61, 93];
            let smooth: Vec<f32> = {
                let mut grid = vec![0.0; 3 * h * w];
                resize::bilinear(level, &noise(3 * 16 * 24, 33), 3, 16, 24, h, w, &mut grid);
                grid.iter().map(|x| 0.5 + 0.5 * x).collect()
            };
            let still = Field::zero(size);
            let motion = Field { u: vec![-2.375; h * w], v: vec![1.625; h * w], ..still };
            let moved = flow::warp(level, &smooth, size, &motion);
            for finest in [0, 1] {
                let options = Options { finest, ..Options::default() };
                let [a, b] = [&smooth, &moved].map(|rgb| {
                    Pyramid::new(level, &flow::luma(level, rgb), size, &options).expect("values from 0 to 1")
                });
                let [forth, back] = flow::both(level, &a, &b, [None; 2], &options);
                let again = flow::between(level, &a, &b, Some(&motion), &options);
                for field in [&forth, &back, &again, &forth.then(level, &back)] {
                    digest.floats(&field.u);
                    digest.floats(&field.v);
                }
                digest.floats(&forth.round_trip(level, &back));
                digest.floats(&flow::Blend::new(level, [&smooth, &moved], [&forth, &back]).at(0.375));
            }
        }),
        Thing::new("norm", |level, digest| {
            for (rows, d) in [(7, 128), (3, 131), (2, 1)] {
                let (x, w, b) = (noise(rows * d, 1), noise(d, 2), noise(d, 3));
                let mut out = vec![0.0; rows * d];
                norm::rms_norm(level, &x, &w, 1e-5, &mut out);
                digest.floats(&out);
                norm::layer_norm(level, &x, &w, &b, 1e-6, &mut out);
                digest.floats(&out);
            }
        }),
        Thing::new("pointwise", |level, digest| {
            for (n, k) in [(64, 64), (5, 131), (9, 300)] {
                let (x, w, bias) = (noise(k * TOKENS, 20), noise(n * k, 21), noise(n, 22));
                let layer = Layer::pack(&w, Some(&bias), Activation::Silu, n, k);
                let mut out = vec![0.0; n * TOKENS];
                layer.apply(level, &x, &mut out);
                digest.floats(&out);
            }
        }),
        Thing::new("patches", |_, digest| {
            let (red, green) = (noise(24 * 40, 5), noise(24 * 40, 6));
            let mut out = vec![0.0; 2 * 24 * 40];
            patches::patches(&[&red, &green], 24, 40, 8, &mut out);
            digest.floats(&out);
        }),
        Thing::new("philox", |_, digest| {
            let mut out = vec![0.0; 10_007];
            Stream { seed: 7, frame: 3 }.fill_uniform(11, &mut out);
            digest.floats(&out);
        }),
        Thing::new("harmonics", |level, digest| {
            let count = 1031;
            let (base, mean) = (noise(3 * count, 17), noise(3 * count, 18));
            let (base, mean) = (base.as_chunks::<3>().0, mean.as_chunks::<3>().0);
            for degree in 0..=harmonics::MAX_DEGREE {
                let higher = noise(3 * count * harmonics::rest(degree), 19);
                for eye in [harmonics::Eye::At([0.3, -0.2, 0.1]), harmonics::Eye::Along([0.48, -0.6, 0.64])] {
                    let mut out = vec![[0.0; 3]; count];
                    harmonics::colours(level, degree, base, &higher, mean, eye, &mut out);
                    digest.floats(out.as_flattened());
                }
            }
        }),
        Thing::new("harmonics/adjoint", |level, digest| {
            let count = 1031;
            let [base, mean, of] = [17, 18, 20].map(|seed| noise(3 * count, seed));
            let [base, mean, of] = [&base, &mean, &of].map(|flat| flat.as_chunks::<3>().0);
            for degree in 0..=harmonics::MAX_DEGREE {
                let higher = noise(3 * count * harmonics::rest(degree), 19);
                let eye = harmonics::Eye::At([0.3, -0.2, 0.1]);
                let (mut out, mut first) = (vec![[0.0; 3]; count], vec![[0.0; 3]; count]);
                harmonics::colours(level, degree, base, &higher, mean, eye, &mut out);
                let (mut others, mut centres) = (vec![0.0; higher.len()], vec![[0.0; 3]; count]);
                let to = harmonics::Gradients { base: &mut first, higher: &mut others, mean: &mut centres };
                let of_eye = harmonics::adjoint(level, degree, &higher, mean, eye, &out, of, to);
                digest.floats(first.as_flattened());
                digest.floats(&others);
                digest.floats(centres.as_flattened());
                digest.doubles(&of_eye);
            }
        }),
        Thing::new("truncated_normal", |level, digest| {
            let len = 5003;
            let mean: Vec<f32> = noise(len, 7).iter().map(|x| x * 4.0).collect();
            let scale: Vec<f32> = noise(len, 8).iter().map(|x| x * 20.0).collect();
            let mut out = vec![0.0; len];
            truncated_normal::mean(level, &mean, &mut out);
            digest.floats(&out);
            let bounded = out.clone();
            truncated_normal::draw(Stream { seed: 1, frame: 2 }, &bounded, &scale, &mut out);
            digest.floats(&out);
        }),
    ]);
    for (name, precision) in [("f32", Precision::F32), ("bf16", Precision::Bf16), ("int8", Precision::Int8)] {
        let attention = move |level, digest: &mut Digest| {
            attention(precision, level, digest, [2, 37, 301], Windows::Full);
            attention(precision, level, digest, [3, 131, 131], Windows::Runs { length: 24, roll: 12 });
        };
        things.push(Thing::new(format!("gemm/{name}"), move |level, digest| gemm(precision, level, digest)));
        things.push(Thing::new(format!("attention/{name}"), attention));
    }
    things
}

fn gemm(precision: Precision, level: Level, digest: &mut Digest) {
    for (m, n, k) in [(1, 1, 1), (7, 33, 256), (13, 50, 259), (65, 129, 515), (3, 17, 0)] {
        let (x, w, bias) = (noise(m * k, 9), noise(n * k, 10), noise(n, 11));
        let weights = Weights::pack_as(level, precision, &w, n, k);
        let mut out = noise(m * n, 12);
        for epilogue in [
            Epilogue::new(),
            Epilogue::new().bias(&bias),
            Epilogue::new().bias(&bias).silu(),
            Epilogue::new().gamma(&bias).residual(),
        ] {
            linear(level, &x, m, &weights, &epilogue, &mut out);
            digest.floats(&out);
        }
    }
}

/// `heads` heads of 64 channels, with these numbers of queries and keys.
fn attention(
    precision: Precision,
    level: Level,
    digest: &mut Digest,
    [heads, queries, keys]: [usize; 3],
    windows: Windows,
) {
    let d = heads * 64;
    let loud = |len, seed| -> Vec<f32> { noise(len, seed).iter().map(|x| x * 3.0).collect() };
    let (q, k, v) = (loud(queries * d, 13), loud(keys * d, 14), noise(keys * d, 15));
    let mut out = vec![0.0; queries * d];
    let rows = |x, n| Rows::new(x, n, d, 0);
    let shape = Shape { heads, width: 64, windows };
    attend_as(precision, level, shape, rows(&q, queries), rows(&k, keys), rows(&v, keys), &mut out);
    digest.floats(&out);
}
