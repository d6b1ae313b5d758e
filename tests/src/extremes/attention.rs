//! Attention over logits that leave only one weight, or none.

use streamsplat_kernels::attention::{Rows, Shape, Windows, attend_as, reference};
use streamsplat_kernels::gemm::Precision;

use super::{Case, Computed, Judged, Unit};
use crate::noise::noise;

const GROUP: &str = "Attention";
const WIDTH: usize = 64;
const QUERIES: usize = 37;
const KEYS: usize = 401;

struct Input {
    q: Vec<f32>,
    k: Vec<f32>,
    v: Vec<f32>,
}

fn attend(precision: Precision, input: &Input, level: streamsplat_kernels::Level) -> Vec<f32> {
    let mut out = vec![0.0; QUERIES * WIDTH];
    let rows = |x, n| Rows::new(x, n, WIDTH, 0);
    let shape = Shape { heads: 1, width: WIDTH, windows: Windows::Full };
    attend_as(precision, level, shape, rows(&input.q, QUERIES), rows(&input.k, KEYS), rows(&input.v, KEYS), &mut out);
    out
}

/// Queries along one axis, so that key j has the logit `8 · size · logit(j)` for query 0 and parts of it for the
/// others.
fn along(logit: impl Fn(usize) -> f32) -> Input {
    let mut input = Input { q: vec![0.0; QUERIES * WIDTH], k: vec![0.0; KEYS * WIDTH], v: noise(KEYS * WIDTH, 3) };
    for (i, q) in input.q.chunks_mut(WIDTH).enumerate() {
        q[7] = 8.0 - 16.0 * i as f32 / (QUERIES - 1) as f32;
    }
    for (j, k) in input.k.chunks_mut(WIDTH).enumerate() {
        k[7] = logit(j);
    }
    input
}

/// The mean of the values of the keys that `takes` selects.
fn mean(v: &[f32], takes: impl Fn(usize) -> bool) -> Vec<f64> {
    let keys: Vec<usize> = (0..KEYS).filter(|&j| takes(j)).collect();
    (0..WIDTH).map(|c| keys.iter().map(|j| f64::from(v[j * WIDTH + c])).sum::<f64>() / keys.len() as f64).collect()
}

fn case(
    name: &str,
    input: impl Fn() -> Input + Copy + Send + Sync + 'static,
    exact: fn(&Input) -> Vec<f64>,
) -> [Case; 2] {
    [("f32", Precision::F32), ("bf16", Precision::Bf16)].map(|(mode, precision)| {
        Case::new(
            GROUP,
            format!("{name}, {mode}"),
            move |place| Computed::new(&attend(precision, &input(), place.level)),
            move |found| {
                let judged = Judged::of(Unit::Absolute, &found.values, exact(&input()));
                let most = found.values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
                judged.and(most <= 1.0, || format!("a mean of values within ±1 is {most}"))
            },
        )
    })
}

pub(super) fn cases() -> Vec<Case> {
    let all = |input: &Input| reference::attend(&input.q, &input.k, &input.v, 1, WIDTH, |_, _| true);
    let ramp = || along(|j| 1e4 * (2.0 * j as f32 / (KEYS - 1) as f32 - 1.0));
    let near = || along(|j| 1e4 - 0.05 * (j % 7) as f32);
    let equal = || Input { k: noise(WIDTH, 5).repeat(KEYS), q: noise(QUERIES * WIDTH, 4), v: noise(KEYS * WIDTH, 3) };
    let one = || {
        let mut input = along(|j| if j == 217 { 1e4 } else { -1e4 + j as f32 });
        input.q.chunks_mut(WIDTH).for_each(|q| q[7] = q[7].abs() + 1.0);
        input
    };
    let only =
        |input: &Input| (0..QUERIES).flat_map(|_| &input.v[217 * WIDTH..218 * WIDTH]).map(|v| f64::from(*v)).collect();
    // Every channel of a key −∞, every channel of a query positive.
    let barred = |j: usize| !j.is_multiple_of(3);
    let some = move || {
        let mut input = along(|_| 0.0);
        input.q.fill(1.0);
        input.k.chunks_mut(WIDTH).enumerate().filter(|(j, _)| barred(*j)).for_each(|(_, k)| k.fill(f32::NEG_INFINITY));
        input
    };
    let none = || {
        let mut input = along(|_| 0.0);
        input.q.fill(1.0);
        input.k.fill(f32::NEG_INFINITY);
        input
    };
    let nan = || {
        let mut input = along(|_| 0.0);
        input.q.fill(1.0);
        input.k[217 * WIDTH + 3] = f32::NAN;
        input
    };
    let overflow = || {
        let mut input = along(|_| 0.0);
        (input.q, input.k) = (vec![1e30; QUERIES * WIDTH], vec![1e30; KEYS * WIDTH]);
        input
    };
    [
        case("logits from −1e4 to 1e4", ramp, all),
        case("logits of 1e4 that differ by 0.05", near, all),
        case("every logit equal", equal, all),
        case("one key at least 2e3 above the others: its value", one, only),
        case("two keys of three at −∞", some, |input| mean(&input.v, |j| j.is_multiple_of(3)).repeat(QUERIES)),
        case("every key at −∞: the mean", none, |input| mean(&input.v, |_| true).repeat(QUERIES)),
        case("one key with a NaN: left out", nan, |input| mean(&input.v, |j| j != 217).repeat(QUERIES)),
        case("every logit overflows: the mean", overflow, |input| mean(&input.v, |_| true).repeat(QUERIES)),
    ]
    .into_iter()
    .flatten()
    .collect()
}
