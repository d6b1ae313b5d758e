//! Matrix products whose terms cancel, in every precision.

use streamsplat_kernels::gemm::{Epilogue, Precision, Weights, linear, reference};

use super::{Case, Computed, Judged, Unit};
use crate::noise::noise;

const GROUP: &str = "Products";
const M: usize = 5;
const N: usize = 19;

struct Operands {
    k: usize,
    x: Vec<f32>,
    w: Vec<f32>,
}

fn case(name: &str, operands: impl Fn() -> Operands + Copy + Send + Sync + 'static) -> [Case; 3] {
    [("f32", Precision::F32), ("bf16", Precision::Bf16), ("int8", Precision::Int8)].map(|(mode, precision)| {
        Case::new(
            GROUP,
            format!("{name}, {mode}"),
            move |place| {
                let Operands { k, x, w } = operands();
                let mut out = vec![0.0; M * N];
                linear(
                    place.level,
                    &x,
                    M,
                    &Weights::pack_as(place.level, precision, &w, N, k),
                    &Epilogue::new(),
                    &mut out,
                );
                Computed::new(&out)
            },
            move |found| {
                let Operands { k, x, w } = operands();
                let exact = reference::product_f64(&x, &w, M, N, k);
                let size = |v: &[f32]| -> Vec<f32> { v.iter().map(|v| v.abs()).collect() };
                let terms = reference::product_f64(&size(&x), &size(&w), M, N, k);
                let mut judged = Judged::new(Unit::OfTerms);
                for ((ours, exact), terms) in found.values.iter().zip(&exact).zip(&terms) {
                    judged.demand(ours.is_finite(), || format!("{ours}, expected {exact}"));
                    judged.take((ours - exact).abs() / terms, *ours, *exact);
                }
                judged
            },
        )
    })
}

/// Equal rows, with weights from `weight`.
fn repeated(row: Vec<f32>, weight: impl Fn(usize) -> f32) -> Operands {
    let k = row.len();
    let w: Vec<f32> = (0..k).map(weight).collect();
    Operands { k, x: row.repeat(M), w: w.repeat(N) }
}

pub(super) fn cases() -> Vec<Case> {
    // Big, small, −big inside one block of k.
    let inside = || {
        let mut row = vec![0.0; 300];
        (row[0], row[1], row[2]) = (1e6, 0.25, -1e6);
        repeated(row, |_| 1.0)
    };
    // The two terms that cancel are in different blocks, near the largest finite number.
    let across = || {
        let mut row = vec![0.0; 600];
        (row[3], row[300], row[599]) = (1.5e38, 1.0, -1.5e38);
        repeated(row, |_| 1.0)
    };
    // Every term has its opposite later in the row, and the sum is a millionth of the terms.
    let pairs = || {
        let half = noise(512, 31);
        let row: Vec<f32> = half.iter().copied().chain(half.iter().map(|x| -x)).collect();
        repeated(row, |i| if i < 512 { 1.0 + 1e-6 } else { 1.0 })
    };
    // An alternating sum over a long row.
    let alternating = || repeated((0..4096).map(|i| if i % 2 == 0 { 1.0 } else { -0.999 }).collect(), |_| 0.7);
    let tiny =
        || repeated(noise(700, 32).iter().map(|x| x * 1e-25).collect(), |i| if i % 2 == 0 { 1e-12 } else { 1e-13 });
    let random = || Operands { k: 3000, x: noise(M * 3000, 33), w: noise(N * 3000, 34) };
    [
        case("1e6 + ¼ − 1e6 in one block", inside),
        case("1.5e38 + 1 − 1.5e38 over three blocks", across),
        case("pairs that leave a millionth", pairs),
        case("4,096 alternating terms", alternating),
        case("terms of 1e-37", tiny),
        case("3,000 random terms, for comparison", random),
    ]
    .into_iter()
    .flatten()
    .collect()
}
