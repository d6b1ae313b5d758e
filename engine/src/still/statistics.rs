//! Statistics of a still scene.

use rayon::prelude::*;
use streamsplat_kernels::math::f64::exp;

use super::{Defect, Still};

/// Logit of the opacity 1/255: −ln 254.
const FAINTEST: f32 = -5.537_334;
/// Quantiles in [`Spread`].
const SHARES: [f64; 5] = [0.0, 0.05, 0.5, 0.95, 1.0];

/// The minimum, the 5th, 50th and 95th percentiles, and the maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread(pub [f64; 5]);

/// Sizes and opacities of a scene, and the Gaussians that are not shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// The greatest of a Gaussian's three standard deviations, in the scene's unit.
    pub size: Option<Spread>,
    /// The ratio of the least to the greatest of them.
    pub flatness: Option<Spread>,
    /// Opacities.
    pub opacity: Option<Spread>,
    /// Gaussians with a drawn number that is not finite ([`Still::defect`]).
    pub not_finite: usize,
    /// Other Gaussians whose rotation is the quaternion 0 ([`Still::defect`]).
    pub no_rotation: usize,
    /// Other Gaussians with an opacity under 1/255, which change no pixel.
    pub faint: usize,
}

impl Still {
    /// Sizes and opacities of the Gaussians whose drawn numbers are finite.
    pub fn statistics(&self) -> Statistics {
        let (finite, not_finite): (Vec<u32>, Vec<u32>) =
            (0..self.len() as u32).into_par_iter().partition(|&i| self.defect(i as usize) != Some(Defect::NotFinite));
        let not_turned = |i: usize| self.rotation[i] == [0.0; 4];
        let count =
            |wanted: &(dyn Fn(usize) -> bool + Sync)| finite.par_iter().filter(|&&i| wanted(i as usize)).count();
        let spread = |value: &(dyn Fn(usize) -> f32 + Sync), shown: fn(f64) -> f64| {
            let values = finite.par_iter().map(|&i| value(i as usize)).collect();
            quantiles(values, SHARES).map(|found| Spread(found.map(|x| shown(f64::from(x)))))
        };
        let longest = |i: usize| self.log_scale[i].into_iter().fold(f32::NEG_INFINITY, f32::max);
        let shortest = |i: usize| self.log_scale[i].into_iter().fold(f32::INFINITY, f32::min);
        // A point is as thick as it is wide.
        let ratio = |i: usize| if longest(i) == f32::NEG_INFINITY { 0.0 } else { shortest(i) - longest(i) };
        Statistics {
            size: spread(&longest, length),
            flatness: spread(&ratio, length),
            opacity: spread(&|i| self.logit[i], |x| 1.0 / (1.0 + exp(-x.clamp(-700.0, 700.0)))),
            not_finite: not_finite.len(),
            no_rotation: count(&not_turned),
            faint: count(&|i| !not_turned(i) && self.logit[i] < FAINTEST),
        }
    }
}

/// The median of each axis, rounded to a whole number; `None` if there are no places.
pub(crate) fn middle(along: [Vec<f32>; 3]) -> Option<[f64; 3]> {
    let mut middle = [0.0; 3];
    for (middle, along) in middle.iter_mut().zip(along) {
        let [median] = quantiles(along, [0.5])?;
        *middle = f64::from(median).round();
    }
    Some(middle)
}

/// e^x, also for a standard deviation of 0.
fn length(x: f64) -> f64 {
    if x == f64::NEG_INFINITY { 0.0 } else { exp(x) }
}

/// The quantiles at these ascending shares, each one of the values. `None` if there are no values.
pub(super) fn quantiles<const N: usize>(mut values: Vec<f32>, shares: [f64; N]) -> Option<[f32; N]> {
    let last = values.len().checked_sub(1)?;
    let (mut rest, mut from) = (values.as_mut_slice(), 0);
    Some(shares.map(|share| {
        let at = (share * last as f64).round() as usize - from;
        // Values before a quantile are not above it, and the next quantile is not among them.
        let value = *rest.select_nth_unstable_by(at, f32::total_cmp).1;
        rest = &mut std::mem::take(&mut rest)[at..];
        from += at;
        value
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_sorted_values() {
        for count in [1_usize, 2, 3, 20, 101, 1000] {
            let values: Vec<f32> = (0..count).map(|i| ((i * 7919) % 1009) as f32 * 0.5 - 100.0).collect();
            let mut sorted = values.clone();
            sorted.sort_by(f32::total_cmp);
            let expected = SHARES.map(|share| sorted[(share * (count - 1) as f64).round() as usize]);
            assert_eq!(quantiles(values, SHARES), Some(expected), "{count}");
        }
        assert_eq!(quantiles(Vec::new(), SHARES), None);
    }

    #[test]
    fn what_is_not_drawn_is_counted_once_and_the_rest_is_measured() {
        let count = 25;
        let mut still = Still::zeros(count, 1);
        for i in 0..count {
            still.rotation[i] = [1.0, 0.0, 0.0, 0.0];
            still.log_scale[i] = [(i as f32).max(1.0).ln(), -3.0, (0.5 * (i as f32).max(1.0)).ln()];
        }
        still.mean[1] = [f32::NAN, 0.0, 0.0];
        still.higher[9 * 2 + 8] = f32::INFINITY;
        still.rotation[3] = [0.0; 4];
        still.logit[3] = -9.0;
        (still.logit[4], still.logit[5]) = (-5.55, -5.53);
        let found = still.statistics();
        assert_eq!((found.not_finite, found.no_rotation, found.faint), (2, 1, 1));
        let Spread(size) = found.size.expect("sizes");
        assert!((size[0] - 1.0).abs() < 1e-6 && (size[4] - 24.0).abs() < 1e-4, "{size:?}");
        let Spread(opacity) = found.opacity.expect("opacities");
        assert_eq!(opacity[2..], [0.5; 3]);
        let Spread(flatness) = found.flatness.expect("ratios");
        assert!((flatness[0] - (-3.0_f64).exp() / 24.0).abs() < 1e-6, "{flatness:?}");
        assert_eq!(Still::default().statistics().size, None);
    }
}
