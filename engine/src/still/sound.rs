//! The Gaussians of a still scene that can be drawn: one rule for images, exports, pages and statistics.
//!
//! The rule applies to the drawn numbers, not those in files. An opacity whose logit is +∞ is 1, one of −∞ is 0; a
//! logarithm of −∞ is a standard deviation of 0. A Gaussian cannot be drawn if
//!
//! - its centre, a coefficient of its harmonics or its rotation is not finite,
//! - its opacity is NaN,
//! - a standard deviation is NaN or exceeds the range of binary32,
//! - its rotation is the quaternion 0.

use super::Still;

/// The largest logarithm whose exponential is finite in binary32.
const LARGEST_LOG: f32 = 88.722_83;

/// Reason why a Gaussian cannot be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Defect {
    /// A drawn number is not finite.
    NotFinite,
    /// The rotation is the quaternion 0.
    NoRotation,
}

impl Still {
    /// Returns why Gaussian `i` cannot be drawn; `None` if it can.
    pub fn defect(&self, i: usize) -> Option<Defect> {
        let finite = |v: &[f32]| v.iter().all(|x| x.is_finite());
        let width = 3 * self.rest();
        let drawn = finite(&self.mean[i])
            // False for NaN.
            && self.log_scale[i].iter().all(|s| *s <= LARGEST_LOG)
            && !self.logit[i].is_nan()
            && finite(&self.base[i])
            && finite(&self.higher[i * width..(i + 1) * width])
            && finite(&self.rotation[i]);
        match drawn {
            false => Some(Defect::NotFinite),
            true if self.rotation[i] == [0.0; 4] => Some(Defect::NoRotation),
            true => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::draw::{grown, sigmoid};
    use super::*;

    #[test]
    fn the_rule_is_about_the_numbers_that_are_drawn() {
        let limits = [LARGEST_LOG, LARGEST_LOG.next_up(), f32::INFINITY, f32::NEG_INFINITY, f32::NAN, -200.0, 0.0];
        for log in limits {
            let mut still = Still::zeros(1, 0);
            still.rotation[0] = [1.0, 0.0, 0.0, 0.0];
            still.log_scale[0][1] = log;
            assert_eq!(still.defect(0).is_none(), grown(log).is_finite(), "{log}");
        }
        for logit in [f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::NAN] {
            let mut still = Still::zeros(1, 1);
            still.rotation[0] = [0.0, 0.0, 1e-30, 0.0];
            still.logit[0] = logit;
            assert_eq!(still.defect(0).is_none(), sigmoid(logit).is_finite(), "{logit}");
        }
        assert_eq!((grown(f32::NEG_INFINITY), sigmoid(f32::INFINITY), sigmoid(f32::NEG_INFINITY)), (0.0, 1.0, 0.0));
        let mut still = Still::zeros(1, 1);
        assert_eq!(still.defect(0), Some(Defect::NoRotation));
        still.higher[8] = f32::NAN;
        assert_eq!(still.defect(0), Some(Defect::NotFinite));
    }
}
