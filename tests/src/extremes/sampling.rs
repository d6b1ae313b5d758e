//! The truncated normal: inside its bounds, and of the exact distribution, tails included.

use streamsplat_kernels::math::scalar;
use streamsplat_kernels::parallel::map_indexed;
use streamsplat_kernels::philox::Stream;
use streamsplat_kernels::truncated_normal::reference::{distribution, published};
use streamsplat_kernels::truncated_normal::{BOUND, EPSILON, quantile, sample};

use super::{Case, Computed, Form, Judged, Unit};

const GROUP: &str = "Truncated normal";
/// Draws in one task.
const CHUNK: usize = 1 << 14;
/// √n·D above this has a probability of 1e-5 by chance.
const UNLIKELY: f64 = 2.47;

/// Part of the distribution that is tested.
#[derive(Clone, Copy, PartialEq)]
enum Part {
    Whole,
    LowTail,
    HighTail,
}

/// Mass of a tail.
const TAIL: f64 = 1e-3;

impl Part {
    /// From a uniform number to one in the part.
    fn u(self, uniform: f64) -> f64 {
        match self {
            Part::Whole => uniform,
            Part::LowTail => TAIL * uniform,
            Part::HighTail => 1.0 - TAIL * uniform,
        }
    }

    /// The mass under (or, in the upper tail, over) `x` in the part.
    fn mass(self, mean: f64, log_scale: f64, x: f64) -> f64 {
        match self {
            Part::Whole => distribution(mean, log_scale, x),
            Part::LowTail => distribution(mean, log_scale, x) / TAIL,
            // The distribution is symmetric: the mass above x with mean m is the mass below −x with mean −m.
            Part::HighTail => distribution(-mean, log_scale, -x) / TAIL,
        }
    }
}

fn draws(form: Form) -> usize {
    if form == Form::Long { 10_000_000 } else { 50_000 }
}

/// √n times the distance of `values` from the distribution with cumulative mass `mass`.
fn kolmogorov_smirnov(values: &[f64], mass: impl Fn(f64) -> f64 + Sync) -> f64 {
    let n = values.len() as f64;
    let parts = map_indexed(values.len().div_ceil(CHUNK), |chunk| {
        let first = chunk * CHUNK;
        values[first..values.len().min(first + CHUNK)].iter().enumerate().fold(0.0_f64, |d, (i, &x)| {
            let (f, i) = (mass(x), (first + i) as f64);
            d.max((f - i / n).abs()).max(((i + 1.0) / n - f).abs())
        })
    });
    parts.into_iter().fold(0.0, f64::max) * n.sqrt()
}

fn quantiles(mean: f64, log_scale: f64, part: Part, label: &str) -> Case {
    let compute = move |place: super::Place| {
        let stream = Stream { seed: 2026, frame: (mean.to_bits() ^ log_scale.to_bits()) >> 20 };
        // 53 bits, from two words.
        let uniform = |k| {
            let [a, b, ..] = stream.words(k);
            (f64::from(a >> 5) * 67_108_864.0 + f64::from(b >> 6) + 0.5) / 9_007_199_254_740_992.0
        };
        let count = draws(place.form);
        let chunks = map_indexed(count.div_ceil(CHUNK), |chunk| -> Vec<f64> {
            let range = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
            range.map(|k| quantile(mean, log_scale, part.u(uniform(k as u64)))).collect()
        });
        Computed { values: chunks.concat(), rest: Vec::new() }
    };
    let judge = move |found: &Computed| {
        let mut values = found.values.clone();
        values.sort_unstable_by(f64::total_cmp);
        if part == Part::HighTail {
            values.reverse();
        }
        let distance = kolmogorov_smirnov(&values, |x| part.mass(mean, log_scale, x));
        let outside = values.iter().filter(|x| x.abs() > f64::from(BOUND) || x.is_nan()).count();
        Judged { error: distance, ours: distance, exact: 0.0, ..Judged::new(Unit::KolmogorovSmirnov) }
            .and(outside == 0, || format!("{outside} draws are outside the bounds"))
            .and(distance < UNLIKELY, || format!("√n·D = {distance}, by chance once in 100,000"))
    };
    Case { long: true, ..Case::new(GROUP, format!("quantile, m = {mean}, σ = e^{log_scale}{label}"), compute, judge) }
}

/// Draws of the engine, in binary32, with the published choices: u clamped to [ε, 1−ε], the mean where s ≤ −5, the
/// lower bound where the mass inside the bounds is at most ε.
fn sampled(mean: f32, log_scale: f32) -> Case {
    let compute = move |place: super::Place| {
        let n = draws(place.form).min(1_000_000);
        let mut uniform = vec![0.0; n];
        Stream { seed: 2027, frame: u64::from(log_scale.to_bits()) }.fill_uniform(0, &mut uniform);
        let mut out = vec![0.0; n];
        sample(&vec![mean; n], &vec![log_scale; n], &uniform, &mut out);
        Computed::with(&out, [n as u64])
    };
    let judge = move |found: &Computed| {
        let n = found.values.len();
        let mut uniform = vec![0.0; n];
        Stream { seed: 2027, frame: u64::from(log_scale.to_bits()) }.fill_uniform(0, &mut uniform);
        let (m, s) = (f64::from(mean), f64::from(log_scale));
        let collapsed = s > 6.7;
        let exact = uniform.iter().map(|u| match (log_scale <= -5.0, collapsed) {
            (true, _) => m,
            (_, true) => -f64::from(BOUND),
            _ => quantile(m, s, f64::from(u.clamp(EPSILON, BOUND))),
        });
        let outside = found.values.iter().filter(|x| x.abs() > f64::from(BOUND) || x.is_nan()).count();
        Judged::of(Unit::Absolute, &found.values, exact)
            .and(outside == 0, || format!("{outside} draws are outside the bounds"))
    };
    Case::new(GROUP, format!("draws of the engine, m = {mean}, σ = e^{log_scale}"), compute, judge)
}

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for mean in [-0.999, 0.0, 0.999] {
        for log_scale in [-20.0, -5.0, 0.0, 6.7, 20.0, 60.0] {
            cases.push(quantiles(mean, log_scale, Part::Whole, ""));
        }
    }
    for (mean, log_scale) in [(0.0, -3.0), (0.6, 0.0), (-0.999, -1.0), (0.999, -1.0), (0.0, 60.0)] {
        cases.push(quantiles(mean, log_scale, Part::LowTail, ", lower tail of 1e-3"));
        cases.push(quantiles(mean, log_scale, Part::HighTail, ", upper tail of 1e-3"));
    }
    for mean in [-0.999, 0.3, 0.999] {
        for log_scale in [-20.0, -4.999, 0.0, 6.6, 60.0] {
            cases.push(sampled(mean, log_scale));
        }
    }
    cases
}

/// Draws that test a formula in [`collapse`].
pub const TRIED: usize = 1001;

/// Quality of a formula at a parameter pair, over u from 0 to 1, or from ε to 1 − ε.
#[derive(Clone, Copy, Debug)]
pub struct Held {
    /// The largest distance from the exact quantile; infinite where a value is NaN.
    pub error: f64,
    /// Different values among [`TRIED`].
    pub different: usize,
    /// Number of values outside the bounds or NaN.
    pub outside: usize,
}

/// The published formula and this one at a parameter pair.
#[derive(Clone, Copy, Debug)]
pub struct Collapse {
    /// The mean.
    pub mean: f32,
    /// The log scale.
    pub log_scale: f32,
    /// The published formula without its guards, all u.
    pub formula: Held,
    /// The published implementation with them, u from ε to 1 − ε.
    pub published: Held,
    /// Draws of the engine, u from ε to 1 − ε.
    pub sampled: Held,
    /// [`quantile`], all u, rounded to binary32.
    pub quantile: Held,
}

/// `m + σ√2·erf⁻¹(2u′ − 1)`, `u′ = u·Δ + Φ(a)`, in binary32 and without guards.
fn formula(mean: f32, log_scale: f32, u: f32) -> f32 {
    let scale = scalar::exp(log_scale);
    let cdf = |x: f32| 0.5 * (1.0 + scalar::erf(x / std::f32::consts::SQRT_2));
    let low = cdf((-BOUND - mean) / scale);
    let mass = cdf((BOUND - mean) / scale) - low;
    mean + scale * std::f32::consts::SQRT_2 * scalar::erfinv(2.0 * (u * mass + low) - 1.0)
}

fn held(mean: f32, log_scale: f32, ends: [f32; 2], value: impl Fn(f32) -> f32) -> Held {
    let mut held = Held { error: 0.0, different: 0, outside: 0 };
    let mut bits = Vec::new();
    for i in 0..TRIED {
        let u = ends[0] + (ends[1] - ends[0]) * i as f32 / (TRIED - 1) as f32;
        let found = value(u);
        let error = (f64::from(found) - quantile(f64::from(mean), f64::from(log_scale), f64::from(u))).abs();
        held.error = held.error.max(if error.is_nan() { f64::INFINITY } else { error });
        held.outside += usize::from(found.is_nan() || found.abs() > BOUND);
        bits.push(found.to_bits());
    }
    bits.sort_unstable();
    bits.dedup();
    Held { different: bits.len(), ..held }
}

/// Parameters at which the published formula collapses, and our result there. The reference is [`quantile`], which the
/// cases above test against the exact distribution.
pub fn collapse() -> Vec<Collapse> {
    let row = |(mean, log_scale): (f32, f32)| {
        let draw = |u| {
            let mut out = [0.0];
            sample(&[mean], &[log_scale], &[u], &mut out);
            out[0]
        };
        let (all, inner) = ([0.0, 1.0], [EPSILON, BOUND]);
        Collapse {
            mean,
            log_scale,
            formula: held(mean, log_scale, all, |u| formula(mean, log_scale, u)),
            published: held(mean, log_scale, inner, |u| published(mean, log_scale, u)),
            sampled: held(mean, log_scale, inner, draw),
            quantile: held(mean, log_scale, all, |u| {
                quantile(f64::from(mean), f64::from(log_scale), f64::from(u)) as f32
            }),
        }
    };
    let scales = [-20.0, -4.9, -2.0, 0.0, 3.0, 6.6, 6.8, 12.0, 20.0, 60.0];
    [0.3, 0.999].into_iter().flat_map(|mean| scales.map(|log_scale| row((mean, log_scale)))).collect()
}
