//! Norms of rows whose squares overflow or underflow binary32.

use streamsplat_kernels::norm::{layer_norm, reference, rms_norm};

use super::{Case, Computed, Judged, Unit};
use crate::noise::noise;

const GROUP: &str = "Norms";
const D: usize = 131;

/// A row of noise times `size`.
fn row(size: f32) -> Vec<f32> {
    noise(D, 21).iter().map(|x| x * size).collect()
}

fn pair(name: &str, x: impl Fn() -> Vec<f32> + Copy + Send + Sync + 'static) -> [Case; 2] {
    let (w, b) = (|| noise(D, 22), || noise(D, 23));
    let judge = |found: &Computed, exact: Vec<f64>| {
        // Errors are relative to the row's largest output: about 1, and less for a vanishing row.
        let most = exact.iter().fold(0.0_f64, |m, e| m.max(e.abs()));
        let mut judged = Judged::of(Unit::Absolute, &found.values, exact);
        judged.error = if most > 0.0 { judged.error / most } else { judged.error };
        judged.unit = Unit::Relative;
        judged
    };
    [
        Case::new(
            GROUP,
            format!("RmsNorm, {name}"),
            move |place| {
                let mut out = vec![0.0; D];
                rms_norm(place.level, &x(), &w(), 1e-5, &mut out);
                Computed::new(&out)
            },
            move |found| judge(found, reference::rms_norm(&x(), &w(), f64::from(1e-5_f32))),
        ),
        Case::new(
            GROUP,
            format!("LayerNorm, {name}"),
            move |place| {
                let mut out = vec![0.0; D];
                layer_norm(place.level, &x(), &w(), &b(), 1e-6, &mut out);
                Computed::new(&out)
            },
            move |found| judge(found, reference::layer_norm(&x(), &w(), &b(), f64::from(1e-6_f32))),
        ),
    ]
}

pub(super) fn cases() -> Vec<Case> {
    let zeros = || vec![0.0; D];
    let constant = || vec![3.7; D];
    let shifted = || row(1.0).iter().map(|x| 1e4 + x).collect();
    let mixed = || {
        let mut x = row(1.0);
        (x[0], x[64], x[130]) = (1e18, -1e-30, 1e-40);
        x
    };
    [
        pair("denormal values, 1e-40", || row(1e-40)),
        pair("values of 1e-30", || row(1e-30)),
        pair("values of 1e-3, near √ε", || row(1e-3)),
        pair("values of 1e18", || row(1e18)),
        pair("values of 1e38", || row(1e38)),
        pair("one value of 1e18 among small ones", mixed),
        pair("all zero", zeros),
        pair("all 3.7", constant),
        pair("1e4 and a spread of 1", shifted),
    ]
    .into_iter()
    .flatten()
    .collect()
}
